"""The numba kernels, compiled once before many processes need them: each by itself would take the same minute.

The process that shares the suite out starts `compile_in_background`; the others `wait` for it before the first test
that needs a kernel. The lock is the compiling process's own and goes when it ends, however it ends.
"""

import atexit
import fcntl
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

_LOCK = "MGSGRAPH_TEST_KERNELS"
"""Environment variable with the path of the lock, for all processes of a run."""


def compile_in_background() -> None:
    """Start a process that compiles everything."""
    handle, os.environ[_LOCK] = tempfile.mkstemp(prefix="mgsgraph-kernels-")
    fcntl.flock(handle, fcntl.LOCK_EX)
    subprocess.Popen([sys.executable, __file__], pass_fds=[handle], stdout=subprocess.DEVNULL)
    os.close(handle)
    atexit.register(os.unlink, os.environ[_LOCK])


@cache
def wait() -> None:
    """Until that process has ended, if there is one."""
    if path := os.environ.get(_LOCK):
        with Path(path).open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)


def compile_all() -> None:
    """Adjust a pair, and match a scene: what is left to be compiled then takes seconds."""
    import matched
    from networks import network, pair

    from mgsgraph.adjustment.adjust import adjust_network
    from mgsgraph.adjustment.settings import SolverSettings

    adjust_network(network(pair()), SolverSettings())
    matched.matches()


if __name__ == "__main__":
    compile_all()
