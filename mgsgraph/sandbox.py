"""Reading by a library that a damaged file may bring down with its process: done in a fork, which ends in our place."""

import faulthandler
import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

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
    receiver, sender = os.pipe()
    with scratch() as folder:
        with warnings.catch_warnings():  # Python warns of forks beside threads, none of which holds what is used here
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            _answer(reading, sender, str(folder))
        try:
            os.close(sender)
            with open(receiver, "rb") as pipe:
                content = pipe.read()
        except BaseException:  # an interrupt, above all
            os.kill(child, signal.SIGKILL)
            raise
        finally:
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status != 0:
        end = signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"
        raise InputError(where, f"{what} made the process that read them end ({end})", "sound ones", remedy)
    return result_of(content)  # type: ignore[no-any-return]


def _answer(reading: Callable[[], Any], sender: int, folder: str) -> NoReturn:
    """The life of the fork: it sends what it found, or the error, and is gone without any tidying up."""
    import resource  # which systems without forks lack

    status = 1
    try:
        faulthandler.disable()
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
            pipe.write(pickled_outcome(reading))
        status = 0
    finally:
        os._exit(status)


def pickled_outcome(function: Callable[[], Any]) -> bytes:
    """What a function without arguments returns or raises, for `result_of` in the process that forked this one."""
    try:
        return pickle.dumps((function(), None), _PROTOCOL)
    except Exception as error:  # whatever it is, it goes on where this process began
        args = (*error.args, error.filename) if isinstance(error, OSError) and error.filename else error.args
        return pickle.dumps((None, (type(error), args, error.__dict__, traceback.format_exc())), _PROTOCOL)


def result_of(outcome: bytes) -> Any:
    """What the function of a `pickled_outcome` has returned; or what it has raised is raised here."""
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
