"""Data and programs from outside, which the project does not ship."""

import os
from pathlib import Path

import pytest


def require(path: Path, what: str) -> Path:
    """The path if something is there; else the test is skipped, or fails where MGSGRAPH_NO_SKIPS is set (in CI)."""
    if not path.exists():
        message = f"{what} is not here ({path})"
        if os.environ.get("MGSGRAPH_NO_SKIPS"):
            pytest.fail(message)
        pytest.skip(message)
    return path
