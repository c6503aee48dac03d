"""What comes from outside: data and programs that the project does not ship, and input that it refuses.

Where a program or data are absent their tests are skipped, or fail if MGSGRAPH_NO_SKIPS says so: 1, or `data` or
`programs` for these alone.
"""

import os
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest


def require(path: Path, what: str) -> Path:
    """The path if something is there."""
    if not path.exists():
        _absent(f"{what} is not here ({path})", "data")
    return path


def require_program(name: str, *arguments: str, by_ci: bool = True) -> Path:
    """Path of a program on the PATH which, with the arguments if there are any, ends well. Never fails unless `.ci/run`
    installs the program.
    """
    found = shutil.which(name)
    if found is None or (arguments and not _ends_well(found, *arguments)):
        _absent(f"the program `{' '.join((name, *arguments))}` is not here", "programs" if by_ci else "")
    return Path(str(found))


def refuses(said: str, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> None:
    """The call raises InputError, in whose message the pattern `said` is found."""
    from mgsgraph.errors import InputError

    with pytest.raises(InputError, match=said):
        function(*arguments, **named)


@cache
def _ends_well(*words: str) -> bool:
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def _absent(message: str, kind: str) -> None:
    if kind and os.environ.get("MGSGRAPH_NO_SKIPS") in ("1", kind):
        pytest.fail(message)
    pytest.skip(message)
