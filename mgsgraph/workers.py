"""Functions called in forks of this process, which share its memory: nothing is sent to them, and only what they return
comes back. Many are called in workers, which end with this process; one alone, where a library may end with a damaged
file. And what a longer job is doing: progress callbacks, and wall time by stages.
"""

import ctypes
import faulthandler
import gc
import os
import pickle
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from multiprocessing import parent_process
from typing import Any, NamedTuple, TypeVar

from mgsgraph.atomic_write import scratch
from mgsgraph.compiled import threads
from mgsgraph.errors import InputError, MgsgraphError

_Found = TypeVar("_Found")
_SIGNAL_AT_PARENTS_DEATH = 1
"""PR_SET_PDEATHSIG of Linux (prctl)."""
_MOST_TASKS = 255
"""A task's number is one byte."""
_LONGEST = 600
"""s of a processor's time: what takes longer goes round in circles."""
_PATIENCE = 4 * _LONGEST
"""s by the clock: what takes longer waits for a lock that some other thread held when the process was forked."""
_PROTOCOL = 5
"""Of pickle, the first that keeps read-only arrays read-only."""


class _Fork(NamedTuple):
    """A forked process."""

    process: int
    """Its id."""
    receiver: int
    """Descriptor of the pipe by which results come."""

    def read(self) -> bytes:
        """All that it sends until it ends."""
        with open(self.receiver, "rb", closefd=False) as pipe:
            return pipe.read()

    def end(self, wait: bool = False) -> str:
        """How it ended, by a signal or an exit status, empty for well; without `wait` it is ended now."""
        os.close(self.receiver)
        if not wait:
            os.kill(self.process, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])
        if status == 0:
            return ""
        return signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"


def _forked(life: Callable[[int], None]) -> _Fork:
    """A fork that lives for a function of the descriptor by which it sends; it is gone without any tidying up."""
    receiver, sender = os.pipe()
    with warnings.catch_warnings():  # Python warns of forks beside threads, none of which holds what is used here
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if process == 0:
        status = 1
        try:
            faulthandler.disable()
            life(sender)
            status = 0
        finally:
            os._exit(status)
    os.close(sender)
    return _Fork(process, receiver)


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
    workers = list[_Fork]()
    queue, ours = _numbers(len(tasks)), os.getpid()
    try:
        for _ in range(min(len(tasks), threads())):
            workers.append(_forked(lambda sender: _work(tasks, queue, sender, ours)))
        yield lambda: _gathered(workers, len(tasks), what, remedy)
    finally:
        os.close(queue)
        for worker in workers:
            worker.end()


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


def _work(tasks: Sequence[Callable[[], Any]], queue: int, sender: int, parent: int) -> None:
    """The life of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt reaches the parent as well, which ends its workers
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(_SIGNAL_AT_PARENTS_DEATH, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)
    gc.freeze()  # what the parent has made stays where it is, in memory that both share
    with open(sender, "wb") as pipe:
        while number := os.read(queue, 1):
            pickle.dump((number[0], _pickled_outcome(tasks[number[0]])), pipe)


def _gathered(workers: list[_Fork], tasks: int, what: str, remedy: str) -> list[Any]:
    """Results of all tasks; the workers are gone."""
    found = dict[int, bytes]()
    while workers:
        content = BytesIO(workers[0].read())
        if ended := workers.pop(0).end(wait=True):
            raise InputError(what, f"a worker process ended ({ended})", remedy=remedy)
        while content.tell() < len(content.getbuffer()):
            number, outcome = pickle.load(content)
            found[number] = outcome
    return [_result_of(found[number]) for number in range(tasks)]


def read_apart(reading: Callable[[], _Found], where: str, what: str, remedy: str) -> _Found:
    """What a function returns, called in a fork of this process that works in an empty folder of its own.

    The fork is silent, and files that the library leaves in its working folder (as the Fortran below CSPICE does:
    ``fort.N``) go with it. Paths must be absolute therefore. Where a system has
    no fork, or none that is safe once Accelerate is loaded (macOS), the function is called here.

    Parameters
    ----------
    reading : callable
        Without arguments; returns records that can be pickled.
    where, what, remedy : str
        For the message when the fork ends by a signal: the file, what ended it, and what the user can do.

    Raises
    ------
    InputError
        When the fork ends without an answer; and any other error that the function raises.
    """
    if sys.platform == "darwin" or not hasattr(os, "fork"):
        return reading()
    with scratch() as folder:
        fork = _forked(lambda sender: _answer(reading, sender, str(folder)))
        try:
            content = fork.read()
        except BaseException:  # an interrupt, above all
            fork.end()
            raise
        ended = fork.end(wait=True)
    if ended:
        raise InputError(where, f"{what} made the process that read them end ({ended})", "sound ones", remedy)
    return _result_of(content)  # type: ignore[no-any-return]


def _answer(reading: Callable[[], Any], sender: int, folder: str) -> None:
    """The life of the fork: it sends what it found, or the error."""
    import resource  # which systems without forks lack

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.alarm(_PATIENCE)
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)
    os.chdir(folder)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    longest = _LONGEST if hard == resource.RLIM_INFINITY else min(_LONGEST, hard)
    resource.setrlimit(resource.RLIMIT_CPU, (longest, hard))
    with open(sender, "wb") as pipe:
        pipe.write(_pickled_outcome(reading))


def _pickled_outcome(function: Callable[[], Any]) -> bytes:
    """What a function without arguments returns or raises, for `_result_of` in the process that forked this one."""
    try:
        return pickle.dumps((function(), None), _PROTOCOL)
    except Exception as error:  # whatever it is, it goes on where this process began
        args = (*error.args, error.filename) if isinstance(error, OSError) and error.filename else error.args
        return pickle.dumps((None, (type(error), args, error.__dict__, traceback.format_exc())), _PROTOCOL)


def _result_of(outcome: bytes) -> Any:
    """What the function of a `_pickled_outcome` has returned; or what it has raised is raised here."""
    found, error = pickle.loads(outcome)
    if error is not None:
        raise _raised(*error)
    return found


def _raised(kind: type[Exception], args: tuple[Any, ...], fields: dict[str, Any], trace: str) -> Exception:
    """An error as it was, with the way that it went in the fork as a note; ours can't be made of their `args`, nor can
    those of others who make these themselves.
    """
    try:
        error = None if issubclass(kind, MgsgraphError) else kind(*args)
    except TypeError:
        error = None
    if error is None:
        error = kind.__new__(kind, *args)
        error.args = args
    error.__dict__.update(fields)
    error.add_note(trace)
    return error


Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, how many of its parts are done, and how many there are."""
Count = Callable[[int, int], None]
"""Called with how many parts are done, and how many there are."""


def no_progress(*_: object) -> None:
    """Show nothing: the default of callbacks."""


@dataclass(slots=True)
class Stages:
    """Wall time by stage; a stage is announced when it begins."""

    announce: Callable[[str], None] = lambda _: None
    """Called with what is being done, "simulating" and the like."""
    detail: Progress = no_progress
    """Called with what the stage that is running does, how many of its parts are done, and how many there are."""
    seconds: dict[str, float] = field(default_factory=dict)
    """By stage, in their order."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage, and book its time at its end."""
        self.announce(name)
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
