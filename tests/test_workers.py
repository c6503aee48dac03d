"""Workers: results in order, errors as they were raised, and no process left behind, however it ends."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import mgsgraph.workers as workers_module
from mgsgraph.errors import InputError
from mgsgraph.kernel import sweep
from mgsgraph.workers import called_in_workers

linux = pytest.mark.skipif(sys.platform != "linux", reason="workers are forks, which only Linux has soundly")
CALLED = partial(called_in_workers, what="figures", remedy="none")


@pytest.fixture(autouse=True)
def two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers_module, "threads", lambda: 2)


def _children() -> set[str]:
    return set(Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split())


@pytest.fixture
def children() -> Callable[[], set[str]]:
    """What tells the processes that a test has begun and not ended; other tests' servers were there before."""
    before = _children()
    return lambda: _children() - before


def result(number: int) -> Callable[[], tuple[int, np.ndarray]]:
    return lambda: (os.getpid(), np.full(100_000, number))  # more than a pipe holds


@linux
def test_results_come_in_the_order_of_the_tasks_from_other_processes(children: Callable[[], set[str]]) -> None:
    with CALLED([result(k) for k in range(20)]) as found:
        got = found()
    assert [int(values[0]) for _, values in got] == list(range(20))
    assert all(values.size == 100_000 for _, values in got)
    processes = {process for process, _ in got}
    assert os.getpid() not in processes
    assert len(processes) <= 2
    assert not children()


@pytest.mark.parametrize("here", ["one thread", "another thread", "a worker"])
def test_tasks_are_called_here_where_no_fork_would_be_sound(here: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = list[int]()

    def call() -> None:
        with CALLED([os.getpid, os.getpid]) as drawn:
            found.extend(drawn())

    if here == "one thread":
        monkeypatch.setattr(workers_module, "threads", lambda: 1)
    if here == "a worker":
        monkeypatch.setattr(workers_module, "parent_process", lambda: object())
    if here == "another thread":
        thread = threading.Thread(target=call)
        thread.start()
        thread.join()
    else:
        call()
    assert found == [os.getpid()] * 2


@linux
def test_errors_are_raised_here_and_end_the_others(children: Callable[[], set[str]]) -> None:
    def fails() -> None:
        raise InputError("a.png", "no room", remedy="free some")

    with pytest.raises(InputError, match=r"a\.png: no room; free some"), CALLED([fails, partial(time.sleep, 0)]) as got:
        got()
    assert not children()


@linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_worker_that_dies_is_one_line(number: signal.Signals, children: Callable[[], set[str]]) -> None:
    with pytest.raises(InputError) as error, CALLED([lambda: os.kill(os.getpid(), number)]) as got:
        got()
    assert number.name in str(error.value)
    assert "\n" not in str(error.value)
    assert not children()


@linux
def test_an_interrupt_ends_the_workers(children: Callable[[], set[str]]) -> None:
    def interrupted() -> None:
        with CALLED([partial(time.sleep, 600.0)] * 2):
            assert len(children()) == 2
            signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs ignore
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not children()


@linux
def test_workers_end_with_the_process_that_is_killed(tmp_path: Path) -> None:
    """Nobody tidies up then: the system ends them. A pipe that they hold closes with the last of them."""
    program = (
        "import sys, time; import mgsgraph.workers as w; w.threads = lambda: 2\n"
        "with w.called_in_workers([lambda: time.sleep(600)] * 2, '', ''): print('begun', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, cwd=tmp_path) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"begun\n"
        running.kill()
        assert running.stdout.read() == b""  # waits for all who hold it


@linux
def test_threads_of_the_kernel_are_made_anew_in_a_worker() -> None:
    """Those of this process don't come along: a worker that waited for them would wait for ever."""
    assert sweep._threads(2).submit(lambda: 1).result() == 1
    with CALLED([lambda: sweep._threads(2).submit(lambda: 2).result(60.0)]) as got:
        assert got() == [2]
