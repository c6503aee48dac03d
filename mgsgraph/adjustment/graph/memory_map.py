"""Room for the constants of all observations: memory, or a mapped file of its own where they would take much of it.

Of mapped pages the system keeps in memory what there is room for, and reads the others when their turn comes: a sweep
takes the constants from the first to the last. The kernel sees an array like any other, so that results are the same.
"""

import mmap
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array

_SHARE = 0.25
"""Of the memory, above which an array goes to a file: the rest of an adjustment takes about as much again."""
_GIGA = 1e9
_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Where Linux says how much memory a container may take: control groups of version 2 and 1."""


def memory() -> float:
    """Bytes that this machine has, or its container may take; infinite where the system doesn't say."""
    try:
        found = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        found = float("inf")
    for path in _LIMITS:
        try:
            found = min(found, float(path.read_text(encoding="ascii")))  # "max" where there is no limit
        except (OSError, ValueError):
            continue
    return found


@dataclass(frozen=True, slots=True)
class Storage:
    """Where the long arrays of an adjustment go."""

    most: float
    """Bytes above which an array goes to a file."""

    @classmethod
    def within(cls, memory_gb: float | None) -> "Storage":
        """Storage of an adjustment that may take so much memory; all that there is when None."""
        return cls(_SHARE * (memory() if memory_gb is None else _GIGA * memory_gb))

    def room(self, size: int) -> Array:
        """An array (size,) to be filled, in memory or in a file of the temporary folder that goes with it.

        Raises
        ------
        InputError
            Where the temporary folder has no room for it.
        """
        needed = 8 * size
        return np.empty(size) if needed <= self.most or not size else _in_file(needed)

    def copied(self, values: Array) -> Array:
        """A copy of values (n,), in room of its own."""
        found = self.room(values.size)
        found[:] = values
        return found


def _in_file(needed: int) -> Array:
    """An array of so many bytes in a file that nobody else sees, gone with the array."""
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
