"""Files written whole or not at all, over nothing but an earlier output of their kind; folders for one process."""

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mgsgraph.atomic_write import lock, made_beside
from mgsgraph.errors import InputError
from mgsgraph.files.opening import head_of

_HEAD = 1 << 14
"""bytes by which an earlier output is known."""
_ELSEWHERE = "choose another name, or move what is there away"


@dataclass(frozen=True, slots=True)
class Output:
    """A kind of file that the program writes, by which an earlier one is known: that alone is replaced."""

    what: str
    """In words, as "a page of mgsgraph report"."""
    known: Callable[[Path], bool]
    """Whether the file at a path is one, by its content."""


def begins(what: str, pattern: str) -> Output:
    """A kind of file that is known by how its text begins, in a line of its first bytes."""
    wanted = re.compile(pattern, re.IGNORECASE)
    return Output(what, lambda path: wanted.match(head_of(path, _HEAD).decode("utf-8-sig", "replace")) is not None)


# --- writing


def file_stem(name: str) -> str:
    """An image's name (or any other) as part of a file's: all but letters, digits, dots and hyphens are underscores."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name)


def require_folder_above(path: Path, shown: str, remedy: str = "") -> None:
    """Raise InputError where a file stands in the place of a folder that `path` would be in; OSError where it can't be
    seen.
    """
    first = next(parent for parent in path.parents if parent.exists())
    if not first.is_dir():
        raise InputError(shown, f"can't be written ({first} is a file)", "a folder to make it in", remedy)


@contextmanager
def fresh_file(path: Path, expected: str = "", remedy: str = "", over: Output | None = None) -> Iterator[Path]:
    """A path to write a file to; what is there takes its place at `path` when all went well.

    `expected` and `remedy` are words of the InputError that is raised where it can't be written: also where something
    else than a file is there, a folder, a pipe, or /dev/stdout, whose place no file should take, or a file that is none
    `over` which this one goes (`require_free`).
    """
    require_free(path, over, expected, remedy)
    with writing_to(path, expected, remedy):
        require_folder_above(path, str(path), remedy)
        with made_beside(path) as aside:
            yield aside
            require_free(path, over, expected, remedy)
            aside.replace(path)


@contextmanager
def writing_to(path: str | Path, expected: str = "", remedy: str = "") -> Iterator[None]:
    """One line for what the system has against a file or folder that is being written."""
    try:
        yield
    except OSError as error:
        found = f"can't be written ({error.strerror or error})"
        raise InputError(str(path), found, expected, remedy) from None


def require_free(path: Path, over: Output | None = None, expected: str = "", remedy: str = "") -> None:
    """Raise InputError unless a file may take its place at `path`: nothing is there, an empty file, or one that is an
    earlier output of its kind; any file where there is no kind. To be asked before long work, too.
    """
    with writing_to(path, expected, remedy):
        if not os.path.lexists(path):
            return
        if not path.is_file() or path.parent == Path("/dev"):
            raise InputError(str(path), "can't be written (what is there is no file)", expected, remedy)
        if over is not None and path.stat().st_size and not over.known(path):
            raise InputError(str(path), f"exists and is not {over.what}", remedy=remedy or _ELSEWHERE)


def write_file(
    path: Path, content: str | bytes, expected: str = "", remedy: str = "", over: Output | None = None
) -> None:
    """Write a file that is there whole or not at all: bytes, or text as UTF-8; see `fresh_file`."""
    with fresh_file(path, expected, remedy, over) as aside:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)


def require_writable(folder: Path) -> None:
    """Raise OSError unless a folder can be made in it, which alone shows permissions, quotas and full disks."""
    with made_beside(folder / "trial", folder=True):
        pass


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> list[Path]:
    """Write files by their names in a folder; their paths."""
    for name, content in contents.items():
        write_file(folder / name, content)
    return [folder / name for name in contents]


# --- one process at a time


def claim(descriptor: int, path: Path, found: str) -> None:
    """Lock what is open, as long as it is; InputError with `found` where another process has."""
    if not lock(descriptor):
        raise InputError(str(path), found, remedy="wait for it, or choose another --out")


@contextmanager
def claimed(folder: Path, found: str) -> Iterator[None]:
    """Hold a folder that is there; InputError with `found` where another process does."""
    if sys.platform == "win32":  # opens no folders
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        claim(descriptor, folder, found)
        yield
    finally:
        os.close(descriptor)
