"""Files: read with errors that name them, written whole or not at all, locked against a second process."""

import hashlib
import json
import math
import os
import re
import secrets
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_NULL = 1e300
"""ISIS writes its Null as -1.797e308 where a number was never set: larger ones are no numbers."""

# --- reading


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Errors of the operating system as InputErrors that name the file."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(str(path), "no such file", remedy="check the path; a case file's are relative to it") from None
    except IsADirectoryError:
        raise InputError(str(path), "a folder", "a file") from None
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror})") from None


def read_bytes(path: Path) -> bytes:
    """The whole of a file; InputError when it is missing or can't be read."""
    with _reading(path):
        return path.read_bytes()


def read_text(path: Path, expected: str = "a text file") -> str:
    """The whole of a UTF-8 text file; InputError when it is missing, unreadable or not text."""
    try:
        return read_bytes(path).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", expected) from None


def read_json(path: Path, heading: str = "") -> dict[str, Any]:
    """A JSON object; InputError with line and column when it is malformed, truncated, or holds NaN. A heading may stand
    before it.
    """

    def refuse(constant: str) -> float:
        raise InputError(str(path), f"the value {constant}", "finite numbers")

    try:
        value = json.loads(read_text(path).removeprefix(heading), parse_constant=refuse)
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}, column {error.colno}"
        raise InputError(where, f"malformed or truncated JSON ({error.msg})", remedy="write the file anew") from None
    except RecursionError:
        raise InputError(str(path), "JSON nested too deeply", "image support data") from None
    if not isinstance(value, dict):
        raise InputError(str(path), f"a JSON {type(value).__name__}", "a JSON object")
    return value


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits; OSError where it can't be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --- numbers in text


def finite_number(text: str) -> float:
    """The number a text spells in decimal; ValueError for anything else, NaN, infinity and ISIS's Null included."""
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not abs(value) < _NULL:
        raise ValueError(text)
    return value


def number_of(text: str, where: str) -> float:
    """The finite number that a text spells in decimal; InputError with `where` for anything else."""
    try:
        return finite_number(text)
    except ValueError:
        raise InputError(where, f"{text[:60]!r}", "a finite number") from None


# --- writing


def file_stem(name: str) -> str:
    """An image's name (or any other) as part of a file's: all but letters, digits, dots and hyphens are underscores."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name)


def beside(path: Path) -> Path:
    """A name in the same folder under which something is made before it takes its place."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.unfinished")


def is_aside(name: str) -> bool:
    """Whether a name is one of `beside`."""
    return name.startswith(".") and name.endswith(".unfinished")


def require_folder_above(path: Path, shown: str, remedy: str = "") -> None:
    """Raise InputError where a file stands in the place of a folder that `path` would be in; OSError where it can't be
    seen.
    """
    first = next(parent for parent in path.parents if parent.exists())
    if not first.is_dir():
        raise InputError(shown, f"can't be written ({first} is a file)", "a folder to make it in", remedy)


@contextmanager
def fresh_file(path: Path, expected: str = "", remedy: str = "") -> Iterator[Path]:
    """A path to write a file to; what is there takes its place at `path` when all went well.

    `expected` and `remedy` are words of the InputError that is raised where it can't be written: also where something
    else than a file is there, a folder, a pipe, or /dev/stdout, whose place no file should take.
    """
    if os.path.exists(path) and (not os.path.isfile(path) or path.parent == Path("/dev")):
        raise InputError(str(path), "can't be written (what is there is no file)", expected, remedy)
    aside = beside(path)
    try:
        require_folder_above(path, str(path), remedy)
        path.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        aside.replace(path)
    except OSError as error:
        found = f"can't be written ({error.strerror or error})"
        raise InputError(str(path), found, expected, remedy) from None
    finally:
        with suppress(OSError):  # gone, or never made
            aside.unlink()


def write_file(path: Path, content: str | bytes, expected: str = "", remedy: str = "") -> None:
    """Write a file that is there whole or not at all: bytes, or text as UTF-8; see `fresh_file`."""
    with fresh_file(path, expected, remedy) as aside:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> list[Path]:
    """Write files by their names in a folder; their paths."""
    for name, content in contents.items():
        write_file(folder / name, content)
    return [folder / name for name in contents]


# --- one process at a time


def claim(descriptor: int, path: Path, found: str) -> None:
    """Lock what is open, as long as it is; InputError with `found` where another process has."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(str(path), found, remedy="wait for it, or choose another --out") from None


@contextmanager
def claimed(folder: Path, found: str) -> Iterator[None]:
    """Hold a folder that is there; InputError with `found` where another process does."""
    if sys.platform == "win32":  # opens no folders
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        claim(descriptor, folder, found)
        yield
    finally:
        os.close(descriptor)
