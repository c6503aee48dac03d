"""One process at a time: a lock on an open file or folder that ends with whoever holds it."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mgsgraph.errors import InputError


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
