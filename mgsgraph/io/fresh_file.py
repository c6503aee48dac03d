"""A file is there whole or not at all: it is written aside and renamed into place."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mgsgraph.errors import InputError


def beside(path: Path) -> Path:
    """A name in the same folder under which something is made before it takes its place."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.unfinished")


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
        path.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        aside.replace(path)
    except OSError as error:
        found = f"can't be written ({error.strerror or error})"
        raise InputError(str(path), found, expected, remedy) from None
    finally:
        with suppress(OSError):  # gone, or never made
            aside.unlink()
