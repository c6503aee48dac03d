"""Where the work goes, as the user names it: ``local``, ``local:N``, ``tcp://host:port`` or ``tls://host:port``."""

import os
import re
from dataclasses import dataclass
from urllib.parse import urlsplit

from mgsgraph.errors import InputError

OPTION = "--cluster"
"""How errors name what the user gave."""
_EXPECTED = "local, local:N (N worker processes), tcp://host:port or tls://host:port"
_MOST_WORKERS = 1024
"""More processes than this on one machine are a slip of the finger."""


@dataclass(frozen=True, slots=True)
class ClusterAddress:
    """Workers of our own on this machine, or the address of a scheduler."""

    text: str
    """As the user wrote it."""
    workers: int = 0
    """Worker processes to start here; 0 for a scheduler elsewhere."""
    address: str = ""
    """Address of the scheduler; empty for workers of our own."""

    @property
    def local(self) -> bool:
        """Whether the workers are our own."""
        return not self.address


def parse_cluster(text: str) -> ClusterAddress:
    """Understand what the user wrote after ``--cluster``.

    Parameters
    ----------
    text : str
        ``local`` (a worker process for each core), ``local:N``, or the address of a dask scheduler.

    Raises
    ------
    InputError
        Anything else.
    """
    own = re.fullmatch(r"local(?::(\d{1,9}))?", text)
    if own:
        workers = int(own[1]) if own[1] else cores()
        if not 1 <= workers <= _MOST_WORKERS:
            raise InputError(f"{OPTION} {text}", f"{workers} workers", f"1 to {_MOST_WORKERS}")
        return ClusterAddress(text, workers=workers)
    if text.startswith(("tcp://", "tls://")) and _names_host_and_port(text):
        return ClusterAddress(text, address=text)
    raise InputError(f"{OPTION} {text}", "no place for the work", _EXPECTED)


def _names_host_and_port(address: str) -> bool:
    try:
        parts = urlsplit(address)
        return bool(parts.hostname and parts.port) and not (parts.path or parts.query or parts.fragment)
    except ValueError:  # a port that is no number, or beyond 65535
        return False


def cores() -> int:
    """Threads that this process may keep busy: NUMBA_NUM_THREADS where it is set, else its share of the cores."""
    wanted = os.environ.get("NUMBA_NUM_THREADS", "")
    if wanted.isdecimal() and int(wanted) > 0:
        return int(wanted)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_of_each(workers: int) -> int:
    """Threads of the numeric kernel in each of so many workers on this machine, at least one."""
    return max(1, cores() // workers)
