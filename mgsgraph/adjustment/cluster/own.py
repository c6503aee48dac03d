"""Scheduler and workers of our own: every port that they open asks for the certificate of this one cluster.

Dask's status pages (health, metrics, log of a worker) would answer anyone: none is served. Beside connection.py, since
classes that are made of dask's can't be made before dask is imported.
"""

import os
from pathlib import Path
from typing import Any

import dask
import distributed


class _WithoutPages:
    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Open no port."""


class Scheduler(_WithoutPages, distributed.Scheduler):  # type: ignore[misc]
    """Dask's, without pages."""


class Worker(_WithoutPages, distributed.Worker):  # type: ignore[misc]
    """Dask's, without pages."""


def own_cluster(count: int, memory: int, threads: int, silence: int, folder: Path) -> Any:
    """A scheduler in this process and workers in processes of their own, reached by TLS alone.

    Parameters
    ----------
    count : int
        Workers.
    memory : int
        bytes at which dask ends one.
    threads : int
        Of the numeric kernel in each.
    silence : int
        Level below which their logs are silent.
    folder : Path
        Private one for their files and the certificate with its key, which are no good without this cluster.
    """
    made, pem = distributed.Security.temporary(), folder / "cluster.pem"
    with open(os.open(pem, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(made.tls_client_key + made.tls_client_cert)
    roles = ("client", "scheduler", "worker")
    named = {f"tls_{role}_cert": str(pem) for role in roles} | {f"tls_{role}_key": None for role in roles}
    security = distributed.Security(require_encryption=True, tls_ca_file=str(pem), **named)
    ports = {"host": "127.0.0.1", "protocol": "tls", "security": security}
    # a worker takes one task at a time; the kernel has threads of its own
    options = ports | {"nthreads": 1, "memory_limit": memory, "silence_logs": silence}
    options |= {"worker_class": Worker, "env": {"NUMBA_NUM_THREADS": str(threads)}}
    worker = {"cls": distributed.Nanny, "options": options}
    scheduler = {"cls": Scheduler, "options": ports | {"dashboard": False}}
    # dask puts a folder of its own on Python's path: never one that has been made by somebody else under its usual name
    with dask.config.set({"temporary-directory": str(folder)}):
        return distributed.SpecCluster(
            workers=dict.fromkeys(range(count), worker), worker=worker, scheduler=scheduler, security=security,
            silence_logs=silence,
        )  # fmt: skip
