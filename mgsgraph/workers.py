"""Functions called in worker processes, while this one does something else.

Workers are forks of this process: they share its memory, so that nothing is sent to them, and only what they return
comes back. They end with this process, whatever ends it.
"""

import ctypes
import faulthandler
import gc
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from multiprocessing import parent_process
from typing import Any, NoReturn, TypeVar

from mgsgraph.compiled import threads
from mgsgraph.errors import InputError
from mgsgraph.sandbox import pickled_outcome, result_of

_Found = TypeVar("_Found")
_SIGNAL_AT_PARENTS_DEATH = 1
"""PR_SET_PDEATHSIG of Linux (prctl)."""
_MOST_TASKS = 255
"""A task's number is one byte."""


@dataclass(frozen=True, slots=True)
class _Worker:
    """A forked process."""

    process: int
    """Its id."""
    receiver: int
    """Descriptor of the pipe by which results come."""


@contextmanager
def called_in_workers(
    tasks: Sequence[Callable[[], _Found]], what: str, remedy: str
) -> Iterator[Callable[[], list[_Found]]]:
    """Call functions in as many workers as this process may have threads (`compiled.threads`).

    Each worker takes the next task as soon as it is done with one, in their order: long ones should come first.
    Without workers the functions are called here, when their results are asked for: with one thread, outside Linux
    (forks aren't safe on macOS and unknown to Windows), and where this process is a worker itself or calls from another
    thread than its first one, whose locks a fork would find held.

    Parameters
    ----------
    tasks : sequence of callable
        Up to 255 functions without arguments; what they return can be pickled. They must use no thread of this process.
    what, remedy : str
        For the message when a worker ends by a signal: what ended, and what the user can do.

    Yields
    ------
    callable
        Waits for all tasks and returns their results, in the order of the tasks. On leaving the context workers that
        are still at work are ended.

    Raises
    ------
    InputError
        When a worker ends without its results; and any other error that a task raises.
    """
    if not (tasks and threads() > 1 and _may_fork()):
        yield lambda: [task() for task in tasks]
        return
    workers = list[_Worker]()
    queue = _numbers(len(tasks))
    try:
        for _ in range(min(len(tasks), threads())):
            workers.append(_begin(tasks, queue))
        yield lambda: _gathered(workers, len(tasks), what, remedy)
    finally:
        os.close(queue)
        for worker in workers:
            _end(worker)


def _may_fork() -> bool:
    first = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and first and parent_process() is None


def _numbers(tasks: int) -> int:
    """A pipe with the numbers of the tasks, a byte each, from which every worker reads its next one."""
    assert tasks <= _MOST_TASKS
    queue, writer = os.pipe()
    os.write(writer, bytes(range(tasks)))
    os.close(writer)
    return queue


def _begin(tasks: Sequence[Callable[[], Any]], queue: int) -> _Worker:
    receiver, sender = os.pipe()
    ours = os.getpid()
    with warnings.catch_warnings():  # Python warns of forks beside threads, none of which holds what is used here
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if process == 0:
        _work(tasks, queue, sender, ours)
    os.close(sender)
    return _Worker(process, receiver)


def _work(tasks: Sequence[Callable[[], Any]], queue: int, sender: int, parent: int) -> NoReturn:
    """The life of a worker: it is gone without any tidying up, which is its parent's."""
    status = 1
    try:
        faulthandler.disable()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt reaches the parent as well, which ends its workers
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        ctypes.CDLL(None).prctl(_SIGNAL_AT_PARENTS_DEATH, signal.SIGKILL, 0, 0, 0)
        if os.getppid() == parent:
            gc.freeze()  # what the parent has made stays where it is, in memory that both share
            with open(sender, "wb") as pipe:
                while number := os.read(queue, 1):
                    pickle.dump((number[0], pickled_outcome(tasks[number[0]])), pipe)
            status = 0
    finally:
        os._exit(status)


def _gathered(workers: list[_Worker], tasks: int, what: str, remedy: str) -> list[Any]:
    """Results of all tasks; the workers are gone."""
    found = dict[int, bytes]()
    while workers:
        with open(workers[0].receiver, "rb", closefd=False) as pipe:
            content = BytesIO(pipe.read())
        status = _end(workers.pop(0), wait=True)
        if status != 0:
            named = signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"
            raise InputError(what, f"a worker process ended ({named})", remedy=remedy)
        while content.tell() < len(content.getbuffer()):
            number, outcome = pickle.load(content)
            found[number] = outcome
    return [result_of(found[number]) for number in range(tasks)]


def _end(worker: _Worker, wait: bool = False) -> int:
    """Exit status of a worker that has ended, or (without `wait`) that is ended now."""
    os.close(worker.receiver)
    if not wait:
        os.kill(worker.process, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(worker.process, 0)[1])
