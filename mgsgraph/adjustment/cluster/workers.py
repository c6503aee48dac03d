"""The cluster as the user names it (``local``, ``local:N``, ``tls://host:port``, ``tcp://host:port``), and checks of
its workers: Python, packages and their versions, memory, and files that all of them must see.

Functions that run on a worker before it is known to have this package must not need the package there: they are made
inside others, so that dask sends them as code instead of by name.
"""

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from mgsgraph.errors import InputError, require

OPTION = "--cluster"
"""Name of the option in errors."""
_EXPECTED = "local, local:N (N worker processes) or tls://host:port"
_MOST_WORKERS = 1024
"""More processes than this on one machine are a typing error."""
PACKAGES = ("mgsgraph", "numpy", "numba", "gtsam", "distributed")
"""Packages that a worker needs, in the versions of this machine."""
GIGA = 1e9
"""bytes in a GB."""
_LOOK = 0.5
"""s between two checks of a file that isn't there yet."""


@dataclass(frozen=True, slots=True)
class ClusterAddress:
    """Worker processes on this machine, or the address of a scheduler."""

    text: str
    """As the user wrote it."""
    workers: int = 0
    """Worker processes to start on this machine; 0 for a scheduler."""
    address: str = ""
    """Address of the scheduler; empty for worker processes on this machine."""

    @property
    def local(self) -> bool:
        """Whether the workers are processes on this machine."""
        return not self.address


def parse_cluster(text: str, insecure: bool = False) -> ClusterAddress:
    """The meaning of the text after ``--cluster``.

    Parameters
    ----------
    text : str
        ``local`` (a worker process for each core), ``local:N``, or the address of a dask scheduler.
    insecure : bool
        Take an address without TLS, too.

    Raises
    ------
    InputError
        Anything else.
    """
    local = re.fullmatch(r"local(?::(\d{1,9}))?", text)
    if local:
        workers = int(local[1]) if local[1] else cores()
        require(1 <= workers <= _MOST_WORKERS, f"{OPTION} {text}", f"{workers} workers", f"1 to {_MOST_WORKERS}")
        return ClusterAddress(text, workers=workers)
    if text.startswith(("tcp://", "tls://")) and _names_host_and_port(text):
        if text.startswith("tcp:") and not insecure:
            expected = f"tls{text.removeprefix('tcp')}, or --insecure"
            remedy = "start scheduler and workers with certificates (docs/cluster.md)"
            raise InputError(f"{OPTION} {text}", "a connection without certificates", expected, remedy)
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


# --- checks of the workers


@dataclass(frozen=True, slots=True)
class Worker:
    """One process that takes work."""

    address: str
    """By which the scheduler calls it."""
    host: str
    """Name of its machine."""
    process: int
    """Its number there."""
    threads: int
    """Tasks that it takes at a time; the kernel has threads of its own."""
    memory_limit: int
    """bytes at which dask ends it; 0 for none."""

    def __str__(self) -> str:
        return f"worker {self.address} ({self.host}, process {self.process})"


def require_same_versions(client: Any, where: str) -> None:
    """Raise InputError unless every worker has this Python and these packages in these versions, and can import them.

    Parameters
    ----------
    client : distributed.Client
    where : str
        How to name the cluster.
    """
    python = sys.version_info[:2]
    for address, answer in sorted(client.get_versions()["workers"].items()):
        python_there = tuple(int(part) for part in answer["packages"]["python"].split(".")[:2])
        if python_there != python:  # no code can be sent from one to the other
            raise _unlike(where, address, "Python", _dotted(python_there), _dotted(python))
    for address, (versions, problem) in sorted(client.run(_looking_for(PACKAGES), on_error="ignore").items()):
        for name, installed in versions.items():
            if installed is None:
                remedy = 'install "mgsgraph[cluster]" on that worker'
                raise InputError(f"{where}, worker {address}", f"no package {name}", f"{name} {version(name)}", remedy)
            if installed != version(name):
                raise _unlike(where, address, name, installed, version(name))
        require(not problem, f"{where}, worker {address}", problem, remedy="repair the installation of that worker")


def _unlike(where: str, address: str, name: str, installed: str, expected: str) -> InputError:
    remedy = "install the same version on all workers"
    return InputError(f"{where}, worker {address}", f"{name} {installed}", f"{name} {expected}, as here", remedy)


def _dotted(numbers: tuple[int, ...]) -> str:
    return ".".join(str(number) for number in numbers)


def _looking_for(names: tuple[str, ...]) -> Callable[[], tuple[dict[str, str | None], str]]:
    """A function that returns the packages' versions (None for a missing one), and why one can't be imported."""

    def look() -> tuple[dict[str, str | None], str]:
        import importlib
        import importlib.metadata

        versions: dict[str, str | None] = dict.fromkeys(names)
        problems = []
        for name in names:
            try:
                versions[name] = importlib.metadata.version(name)
                importlib.import_module(name)
            except importlib.metadata.PackageNotFoundError:
                pass
            except Exception as error:  # whatever a package does when it is imported
                message = " ".join(str(error).split())[:200]
                problems.append(f"{name} can't be imported ({type(error).__name__}: {message})")
        return versions, "; ".join(problems)

    return look


def known_workers(client: Any) -> tuple[Worker, ...]:
    """The workers that are there now, in the order of their addresses."""

    def facts(dask_worker: Any) -> tuple[str, int, int, int]:
        import os
        import socket

        limit = dask_worker.memory_manager.memory_limit
        return socket.gethostname(), os.getpid(), dask_worker.state.nthreads, int(limit or 0)

    answers = client.run(facts, on_error="ignore")  # one that dies while it is asked is no worker any more
    return tuple(Worker(address, *answer) for address, answer in sorted(answers.items()))


def require_memory(workers: tuple[Worker, ...], needed: float, what: str, where: str, remedy: str) -> None:
    """Raise InputError, naming the worker, where a memory limit lies below what is needed.

    Parameters
    ----------
    workers : tuple of Worker
    needed : float
        bytes in one worker at a time.
    what : str
        What needs them, such as "a partition of 200000 points".
    where : str
        How to name the cluster.
    remedy : str
    """
    for worker in sorted(workers, key=lambda worker: worker.memory_limit):
        if 0 < worker.memory_limit < needed:
            problem = f"a memory limit of {worker.memory_limit / GIGA:.2f} GB"
            raise InputError(f"{where}, {worker}", problem, f"at least {needed / GIGA:.2f} GB for {what}", remedy)


def require_visible_file(client: Any, path: Path, where: str, timeout: float) -> None:
    """Raise InputError, naming the worker, where a file does not have the content that it has on this machine.

    Network file systems show a new file late: for `timeout` s the workers are asked again.
    """

    def content(name: str) -> str:
        import hashlib

        try:
            with open(name, "rb") as file:
                return hashlib.sha256(file.read()).hexdigest()
        except OSError as error:
            return error.strerror or str(error)

    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    deadline = time.monotonic() + timeout
    while True:
        answers = sorted(client.run(content, str(path.resolve()), on_error="ignore").items())
        different = [(address, answer) for address, answer in answers if answer != digest]
        if not different:
            return
        if time.monotonic() > deadline:
            break
        time.sleep(_LOOK)
    address, answer = different[0]
    problem = "another content" if len(answer) == len(digest) else answer
    raise InputError(
        f"{where}, worker {address}",
        f"it does not see {path.resolve()} as it is here ({problem})",
        "files that all workers share, under the same paths",
        "work in a folder that is mounted everywhere",
    )
