"""Reading in a fork: answers and errors as they were, and an end of the fork that is none of ours."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from outside import refuses

from mgsgraph.errors import EphemerisGap, InputError
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import frozen
from mgsgraph.kernel import sweep
from mgsgraph.workers import read_apart


class Odd(Exception):
    """Its `args` aren't what it is made of."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__(f"{one} and {other}")
        self.one = one


def apart(reading: Callable[[], object]) -> object:
    return read_apart(reading, "here", "SPICE kernels", "fetch them again")


def test_answers_come_as_they_are() -> None:
    """Read-only arrays too: the kernels compiled for them are another signature."""
    array, body = frozen([[1.0, 2.0], [3.0, 4.0]], "array", (None, 2)), Ellipsoid(2.0, 1.0)
    found = apart(lambda: (array, array, body, os.getpid()))
    assert isinstance(found, tuple)
    assert found[0] is found[1]
    assert not found[0].flags.writeable
    np.testing.assert_array_equal(found[0], array)
    assert found[2] == body
    assert found[3] != os.getpid()


@pytest.mark.parametrize(
    "error",
    [
        InputError("a", "b", "c", "d"), EphemerisGap("a", 1.0, 2.0, 3.0), KeyError("x"),
        UnicodeDecodeError("a", b"", 0, 1, "b"), Odd(1, 2), OSError(2, "gone", "a.bsp"),
    ],
)
def test_errors_come_as_they_are(error: Exception) -> None:
    def fail() -> None:
        raise error

    with pytest.raises(type(error)) as caught:
        apart(fail)
    assert str(caught.value) == str(error)
    fields = {**caught.value.__dict__}
    fields.pop("__notes__")
    assert fields == error.__dict__
    assert caught.value.args == error.args
    assert getattr(caught.value, "filename", None) == getattr(error, "filename", None)


_LONG_ANSWER = """
import os, sys, time
from pathlib import Path
from mgsgraph.workers import read_apart

def reading():
    Path(sys.argv[1]).write_text(f"{os.getpid()}\\n")
    time.sleep(0.5)
    return bytes(1 << 20)

read_apart(reading, "here", "files", "look")
"""


def test_a_fork_ends_whose_process_was_killed(tmp_path: Path) -> None:
    """Though its answer is longer than a pipe holds: nobody reads it any more. (Without /proc nothing is seen.)"""
    said, begun = tmp_path / "fork", time.monotonic()
    with subprocess.Popen([sys.executable, "-c", _LONG_ANSWER, str(said)]) as process:
        while not (said.exists() and said.read_text().endswith("\n")):
            assert time.monotonic() - begun < 30.0
            time.sleep(0.01)
        process.kill()
    fork = Path(f"/proc/{said.read_text().strip()}")
    while fork.exists():
        assert time.monotonic() - begun < 60.0
        time.sleep(0.05)


def test_errors_say_where_in_the_fork_they_arose() -> None:
    def fail() -> None:
        raise KeyError("x")

    with pytest.raises(KeyError) as caught:
        apart(fail)
    assert 'in fail\n    raise KeyError("x")' in caught.value.__notes__[0]


def test_a_lower_limit_of_time_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """No process may raise its hard limit, as `ulimit -t 300` sets it: asking for more is a ValueError."""
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda of: (300, 300))
    monkeypatch.setattr(resource, "setrlimit", lambda of, limits: os._exit(3) if limits != (300, 300) else None)
    assert apart(lambda: 1) == 1


def test_a_fork_that_waits_for_ever_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one does whose lock another thread held when it was forked: that costs no processor time."""
    monkeypatch.setattr("mgsgraph.workers._PATIENCE", 1)
    held = threading.Lock()
    held.acquire()
    refuses("SIGALRM", apart, held.acquire)


def test_where_forks_are_unsafe_none_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """On macOS, whose Accelerate and Objective-C don't outlive one."""
    monkeypatch.setattr(sys, "platform", "darwin")
    assert apart(os.getpid) == os.getpid()


@pytest.mark.parametrize("end", [signal.SIGSEGV, signal.SIGKILL])
def test_the_end_of_the_fork_is_an_error(end: signal.Signals, tmp_path: Path) -> None:
    def die() -> None:
        (tmp_path / "fork").write_text(str(os.getpid()))
        os.kill(os.getpid(), end)

    with pytest.raises(InputError) as caught:
        apart(die)
    assert caught.value.where == "here"
    assert end.name in caught.value.found
    with pytest.raises(ChildProcessError):
        os.waitpid(int((tmp_path / "fork").read_text()), os.WNOHANG)


def test_nothing_is_left_or_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Fortran leaves fort.N where it works, and writes what it has against a file to the terminal."""
    monkeypatch.chdir(tmp_path)
    open_ones = len(list(Path("/proc/self/fd").iterdir())) if Path("/proc/self/fd").is_dir() else 0

    def litter() -> str:
        Path("fort.77").write_text("x")
        os.write(1, b"stderr of Fortran")
        os.write(2, b"stderr of Fortran")
        return os.getcwd()

    folder = apart(litter)
    assert not Path(str(folder)).exists()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
    assert Path.cwd() == tmp_path
    if open_ones:
        assert len(list(Path("/proc/self/fd").iterdir())) == open_ones


@pytest.mark.skipif(sys.platform != "linux", reason="forks are sound on Linux alone")
def test_threads_of_the_kernel_are_made_anew_in_a_fork() -> None:
    """Those of this process don't come along: a fork that waited for them would wait for ever."""
    assert sweep._threads(2).submit(lambda: 1).result() == 1
    assert apart(lambda: sweep._threads(2).submit(lambda: 2).result(60.0)) == 2
