"""Room for the constants of all observations: memory, or a mapped file of its own where they would take much of it.

Of mapped pages the system keeps in memory what there is room for, and reads the others when their turn comes: a sweep
takes the constants from the first to the last. The kernel sees an array like any other, so that results are the same.
"""

import mmap
import os
import tempfile

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array

_SHARE = 0.25
"""Of the machine's memory, above which an array goes to a file."""
_GIGA = 1e9


def most_in_memory() -> float:
    """Bytes above which an array goes to a file; infinite where the system doesn't tell its memory."""
    try:
        return _SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return float("inf")


def room(size: int) -> Array:
    """An array (size,) to be filled, in memory or in a file of the temporary folder that goes with it.

    Raises
    ------
    InputError
        Where the temporary folder has no room for it.
    """
    needed = 8 * size
    if needed <= most_in_memory() or not size:
        return np.empty(size)
    try:
        with tempfile.TemporaryFile(prefix="mgsgraph-rows-") as file:
            if hasattr(os, "posix_fallocate"):  # a mapped page for which the disk has no room would end the process
                os.posix_fallocate(file.fileno(), 0, needed)
            else:
                file.truncate(needed)
            return np.frombuffer(mmap.mmap(file.fileno(), needed), dtype=np.float64)
    except OSError as error:
        found = f"no room for a file ({error.strerror or error})"
        expected = f"{needed / _GIGA:.1f} GB for the rows of the adjustment"
        raise InputError(f"folder {tempfile.gettempdir()}", found, expected, "set TMPDIR to another folder") from error


def copied(values: Array) -> Array:
    """A copy of values (n,), in room of its own."""
    found = room(values.size)
    found[:] = values
    return found
