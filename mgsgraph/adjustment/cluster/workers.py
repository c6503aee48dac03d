"""Are the workers fit for the work? Python, packages and their versions, memory, and files that all of them must see.

What is asked of a worker before it is known to have this package must not need the package there: such functions are
made inside others, so that dask sends them as code instead of by name.
"""

import hashlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError

PACKAGES = ("mgsgraph", "numpy", "numba", "gtsam", "distributed")
"""What computes, and what carries it; each must be there in the version that is here."""
GIGA = 1e9
"""bytes in a GB."""
_PAUSE = 0.5
"""s between two looks at a file that isn't there yet."""


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


def require_alike(client: Any, where: str) -> None:
    """Raise InputError unless every worker has this Python and these packages in these versions, and can import them.

    Parameters
    ----------
    client : distributed.Client
    where : str
        How to name the cluster.
    """
    here = sys.version_info[:2]
    for address, answer in sorted(client.get_versions()["workers"].items()):
        there = tuple(int(part) for part in answer["packages"]["python"].split(".")[:2])
        if there != here:  # no code can be sent from one to the other
            raise _unlike(where, address, "Python", _dotted(there), _dotted(here))
    for address, (versions, problem) in sorted(client.run(_looking_for(PACKAGES), on_error="ignore").items()):
        for name, found in versions.items():
            if found is None:
                remedy = 'install "mgsgraph[cluster]" there as it is here'
                raise InputError(f"{where}, worker {address}", f"no package {name}", f"{name} {version(name)}", remedy)
            if found != version(name):
                raise _unlike(where, address, name, found, version(name))
        if problem:
            raise InputError(f"{where}, worker {address}", problem, remedy="mend the installation there")


def _unlike(where: str, address: str, name: str, found: str, expected: str) -> InputError:
    remedy = "install the same version on all workers"
    return InputError(f"{where}, worker {address}", f"{name} {found}", f"{name} {expected}, as here", remedy)


def _dotted(numbers: tuple[int, ...]) -> str:
    return ".".join(str(number) for number in numbers)


def _looking_for(names: tuple[str, ...]) -> Callable[[], tuple[dict[str, str | None], str]]:
    """A function that tells the packages' versions (None for what isn't there), and why one can't be imported."""

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
                said = " ".join(str(error).split())[:200]
                problems.append(f"{name} can't be imported ({type(error).__name__}: {said})")
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
            found = f"a memory limit of {worker.memory_limit / GIGA:.2f} GB"
            raise InputError(f"{where}, {worker}", found, f"at least {needed / GIGA:.2f} GB for {what}", remedy)


def require_visible_file(client: Any, path: Path, where: str, timeout: float) -> None:
    """Raise InputError, naming the worker, where a file is not seen with the content that it has here.

    Network file systems show a new file late: for `timeout` s the workers are asked again.
    """

    def seen(name: str) -> str:
        import hashlib

        try:
            with open(name, "rb") as file:
                return hashlib.sha256(file.read()).hexdigest()
        except OSError as error:
            return error.strerror or str(error)

    here = hashlib.sha256(path.read_bytes()).hexdigest()
    deadline = time.monotonic() + timeout
    while True:
        answers = sorted(client.run(seen, str(path.resolve()), on_error="ignore").items())
        other = [(address, there) for address, there in answers if there != here]
        if not other:
            return
        if time.monotonic() > deadline:
            break
        time.sleep(_PAUSE)
    address, there = other[0]
    found = "another content" if len(there) == len(here) else there
    raise InputError(
        f"{where}, worker {address}",
        f"it does not see {path.resolve()} as it is here ({found})",
        "files that all workers share, under the same paths",
        "work in a folder that is mounted everywhere",
    )
