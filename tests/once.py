"""What several processes of a run need is made once: results, kept in a folder for the others, and numba kernels."""

import atexit
import fcntl
import hashlib
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_FOLDER = "MGSGRAPH_TEST_RESULTS"
"""Environment variable with the folder of a run; without it nothing is shared."""


def share() -> None:
    """From now on, until the end of this process."""
    os.environ[_FOLDER] = tempfile.mkdtemp(prefix="mgsgraph-results-")
    atexit.register(shutil.rmtree, os.environ[_FOLDER], ignore_errors=True)


def once(make: Function) -> Function:
    """A function of few arguments that are told apart by their words, made once in all processes of a run."""

    @cache
    @wraps(make)
    def found(*arguments: object) -> Any:
        if _FOLDER not in os.environ:
            return make(*arguments)
        key = repr((make.__module__, make.__qualname__, arguments))
        path = Path(os.environ[_FOLDER], hashlib.sha256(key.encode()).hexdigest())
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if path.exists():
                return pickle.loads(path.read_bytes())
            result = make(*arguments)
            path.with_suffix(".new").write_bytes(pickle.dumps(result))
            path.with_suffix(".new").rename(path)
            return result

    return found  # type: ignore[return-value]


# --- kernels: the process that shares the suite out compiles them, others wait before the first test that needs one


_LOCK = "MGSGRAPH_TEST_KERNELS"
"""Environment variable with the path of the lock, for all processes of a run."""


def compile_in_background() -> None:
    """Start a process that compiles everything, once before many processes need it: each by itself would take the same
    minute. The lock is that process's own and goes when it ends, however it ends.
    """
    handle, os.environ[_LOCK] = tempfile.mkstemp(prefix="mgsgraph-kernels-")
    fcntl.flock(handle, fcntl.LOCK_EX)
    subprocess.Popen([sys.executable, __file__], pass_fds=[handle], stdout=subprocess.DEVNULL)
    os.close(handle)
    atexit.register(os.unlink, os.environ[_LOCK])


@cache
def wait_for_kernels() -> None:
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
