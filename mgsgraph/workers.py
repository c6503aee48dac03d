"""A function called in a fork of this process, where a library may end with a damaged file: nothing is sent to it, and
only what it returns comes back. And what a longer job is doing: progress callbacks, and wall time by stages.
"""

import faulthandler
import os
import pickle
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from mgsgraph.atomic_write import scratch
from mgsgraph.errors import InputError, MgsgraphError

_Found = TypeVar("_Found")
_LONGEST = 600
"""s of a processor's time: what takes longer goes round in circles."""
_PATIENCE = 4 * _LONGEST
"""s by the clock: what takes longer waits for a lock that some other thread held when the process was forked."""
_PROTOCOL = 5
"""Of pickle, the first that keeps read-only arrays read-only."""


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
        receiver, sender = os.pipe()
        with warnings.catch_warnings():  # Python warns of forks beside threads, none of which holds what is used here
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
        if process == 0:
            try:
                os.close(receiver)  # else its own end would keep it waiting for a reader when this process is killed
                faulthandler.disable()
                _answer(reading, sender, str(folder))
                os._exit(0)
            finally:
                os._exit(1)  # without any tidying up
        os.close(sender)
        try:
            with open(receiver, "rb") as pipe:
                content = pipe.read()
        except BaseException:  # an interrupt, above all
            os.kill(process, signal.SIGKILL)
            raise
        finally:
            status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if status:
        ended = signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"
        raise InputError(where, f"{what} made the process that read them end ({ended})", "sound ones", remedy)
    found, error = pickle.loads(content)
    if error is not None:
        raise _raised(*error)
    return found  # type: ignore[no-any-return]


def _answer(reading: Callable[[], Any], sender: int, folder: str) -> None:
    """The life of the fork: it sends what it found, or the error."""
    import resource  # which systems without forks lack

    for number in (signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both: this process's end must not look like an error
    signal.alarm(_PATIENCE)
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)
    os.chdir(folder)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    longest = _LONGEST if hard == resource.RLIM_INFINITY else min(_LONGEST, hard)
    resource.setrlimit(resource.RLIMIT_CPU, (longest, hard))
    try:
        outcome = pickle.dumps((reading(), None), _PROTOCOL)
    except Exception as error:  # whatever it is, it goes on where this process began
        args = (*error.args, error.filename) if isinstance(error, OSError) and error.filename else error.args
        outcome = pickle.dumps((None, (type(error), args, error.__dict__, traceback.format_exc())), _PROTOCOL)
    with open(sender, "wb") as pipe:
        pipe.write(outcome)


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
