"""What several processes of a run need is made once, by the first that asks, and read by the others from a folder."""

import atexit
import fcntl
import hashlib
import os
import pickle
import shutil
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
