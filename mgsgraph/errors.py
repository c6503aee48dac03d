"""What can go wrong, in few kinds, each also a standard error; one line: where, what was found, expected, to do."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

_LONGEST_PART = 400
"""Characters of a file's name or a finding that a message holds; of longer ones, the beginning and the end."""
_LONGEST_REMEDY = 700


def printable(text: str, kept: str = "") -> str:
    """The text as it may go to a terminal: characters that move its cursor, turn the direction of writing or end a
    line, and bytes that are no text, are escaped as Python writes them, but for the characters `kept`.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one in kept else one.encode("unicode_escape").decode("ascii") for one in text
    )


def one_line(text: str, longest: int = _LONGEST_PART) -> str:
    """A part of a message as it may go to a terminal: on one line, and not longer than that."""
    shown = printable(text.replace("\n", " ").replace("\t", " "))
    return shown if len(shown) <= longest else f"{shown[: longest - 200]} ... {shown[-195:]}"


def command_line(*words: object) -> str:
    """A command of this program as a user types it: what a shell would take otherwise, as a path with spaces, is
    quoted.
    """
    return shlex.join(["mgsgraph", *map(str, words)])


def is_interrupt(error: BaseException | None) -> bool:
    """Whether an error is a KeyboardInterrupt, or what a library has made of one."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


class MgsgraphError(Exception):
    """Anything the program says about its input or its result; the command line prints it as one line.

    Examples
    --------
    >>> try:
    ...     mgsgraph.read_case("absent.toml")
    ... except mgsgraph.MgsgraphError as error:
    ...     print(error)
    absent.toml: no such file; check the path; those in a case file begin at its folder
    """


class InputError(MgsgraphError, ValueError):
    """Input that can't be used: what was found where, what was expected, what to do.

    Parameters
    ----------
    where : str
        File (and key, line or record in it) or the record's name.
    found : str
        What was found there.
    expected : str
        What would have been right; left out when the finding says it.
    remedy : str
        What the user can do.

    Examples
    --------
    >>> try:
    ...     posterior.point("TIE99999")
    ... except mgsgraph.InputError as error:
    ...     print(error.where, "|", error.found)
    point TIE99999 | no such point among 28
    """

    def __init__(self, where: str, found: str, expected: str = "", remedy: str = "") -> None:
        parts = [f"{one_line(where)}: {one_line(found)}", f"expected {one_line(expected)}" if expected else "",
                 one_line(remedy, _LONGEST_REMEDY)]  # fmt: skip
        super().__init__("; ".join(part for part in parts if part))
        self.where, self.found, self.expected, self.remedy = where, found, expected, remedy

    def within(self, source: str) -> "InputError":
        """The same error with the file (or record) that its finding comes from put before it."""
        self.args = (f"{one_line(source)}: {self}",)
        self.where = f"{source}: {self.where}"
        return self


@contextmanager
def errors_from(*sources: str) -> Iterator[None]:
    """Put the first of some files (or records) before an InputError that names none of them."""
    try:
        yield
    except InputError as error:
        if not any(source in str(error) for source in sources):
            error.within(sources[0])
        raise


def require(good: object, where: str, found: str, expected: str = "", remedy: str = "") -> None:
    """Raise InputError unless `good`."""
    if not good:
        raise InputError(where, found, expected, remedy)


class EphemerisGap(InputError):
    """A time at which no position or attitude is known; carries the covered interval in seconds TDB past J2000."""

    def __init__(self, where: str, time: float, start: float, stop: float) -> None:
        super().__init__(
            where,
            f"time {time:.6f} s (TDB past J2000) lies outside the tables",
            f"a time in {start:.6f} .. {stop:.6f} s",
            "leave the observation out or give tables that cover it",
        )
        self.time, self.start, self.stop = time, start, stop


class Unmeasured(InputError):
    """A case, or an image of it, in which no point is measured."""


class PointBehindCamera(InputError):
    """A ground point that lies behind the camera which is said to have seen it."""


class WeakNetwork(MgsgraphError, ArithmeticError):
    """A network with directions that nothing determines: its datum, or orientation that no measurement determines.

    Parameters
    ----------
    directions : sequence of str
        Some of them, by image and axis.
    count : int
        All of them.
    datum : str
        Those that move the whole network, in words; empty for none.
    of_datum : int
        How many these are.
    """

    def __init__(self, directions: Sequence[str], count: int, datum: str = "", of_datum: int = 0) -> None:
        more = count - of_datum - len(directions)
        others = "; or ".join(directions) + (f" (and {more} more)" if more > 0 else "")
        if datum:
            found = f"the datum is not determined: {datum} of the whole network"
            found += f"; besides, nothing determines {others}" if others else ""
            remedy = "give a control point, laser ranges or finite priors"
        else:
            found = f"nothing determines {others}"
            remedy = "give these a finite a-priori sigma, or give ground control or laser rows"
        super().__init__(f"the network is underdetermined (unknowns: {count}): {found}; {remedy}")
        whole = (f"{datum} of the whole network",) if datum else ()
        self.directions, self.count, self.of_datum = (*whole, *directions), count, of_datum


class SolverError(MgsgraphError, ArithmeticError):
    """The adjustment could not be carried out; says at which step and why."""


class Unsolvable(SolverError):
    """An optimisation that can't go on from a state that it has reached, of which `rounds` says more.

    Parameters
    ----------
    message : str
        Why.
    state : object
        There; what the optimiser calls one.
    """

    def __init__(self, message: str, state: object) -> None:
        super().__init__(message)
        self.state = state

    def __reduce__(self) -> tuple[type, tuple[str, object]]:
        return type(self), (str(self), self.state)




def library(name: str, extra: str, wanted_for: str, called: str = "") -> ModuleType:
    """The module of a library that is there only with an extra.

    Parameters
    ----------
    name : str
        What is imported.
    extra : str
        Extra of mgsgraph that brings it.
    wanted_for : str
        What needs it, for the error.
    called : str, optional
        How people call it; by the name of its module when absent.

    Raises
    ------
    InputError
        If it is not installed, or can't be imported.
    """
    try:
        return import_module(name)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == name
        why = "is not installed" if missing else f"can't be imported ({' '.join(str(error).split())})"
        found = f"{called or name} {why}"
        raise InputError(wanted_for, found, remedy=f'pip install "mgsgraph[{extra}]"') from None
