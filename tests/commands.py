"""`mgsgraph` as a person uses it, in a process of its own: exit status, both streams, and what bad input looks like."""

import atexit
import csv
import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import click
import pytest

from mgsgraph.errors import MgsgraphError

COMMAND = [sys.executable, "-m", "mgsgraph"]
WIDE = {"COLUMNS": "110"}
"""So that help is not wrapped."""


def call(*arguments: object) -> int:
    """A command in this process; its exit status."""
    from mgsgraph.cli import group

    return group([str(one) for one in arguments], standalone_mode=False) or 0


def rows_of(path: Path) -> list[dict[str, str]]:
    """Of a CSV file, by their headings."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def refusal(*arguments: object) -> str:
    """The one line by which a command in this process refuses its arguments."""
    with pytest.raises((MgsgraphError, click.UsageError)) as caught:
        call(*arguments)
    error = caught.value
    message = error.format_message() if isinstance(error, click.UsageError) else str(error)
    assert "\n" not in message
    return message


def run_afresh(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command in a new interpreter, where no warning goes by."""
    return subprocess.run(
        [COMMAND[0], "-W", "error", *COMMAND[1:], *map(str, arguments)], capture_output=True, text=True, cwd=cwd,
        timeout=300, check=False, env=os.environ | WIDE,
    )  # fmt: skip


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The same, of a process that has what it needs imported: most of a short command's time."""
    words = [str(one) for one in arguments]
    with tempfile.TemporaryDirectory() as folder:
        streams = [Path(folder, name) for name in ("out", "err")]
        for path in streams:
            path.touch()
        status = _server().tell(words, cwd or Path.cwd(), streams)
        return subprocess.CompletedProcess(words, status, *(path.read_text(encoding="utf-8") for path in streams))


class _Server:
    """`command_server`, which lasts as long as this process."""

    def __init__(self) -> None:
        script = Path(__file__).with_name("command_server.py")
        one_thread = {"OPENBLAS_NUM_THREADS": "1"}  # a fork has no other threads
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | one_thread,
        )  # fmt: skip
        atexit.register(self._end)
        assert self._answer() == "ready"

    def tell(self, arguments: list[str], folder: Path, streams: list[Path]) -> int:
        """Exit status of a command."""
        order = {"arguments": arguments, "folder": str(folder), "environment": os.environ | WIDE,
                 "streams": [str(path) for path in streams]}  # fmt: skip
        assert self._process.stdin is not None
        print(json.dumps(order), file=self._process.stdin, flush=True)
        return int(self._answer())

    def _end(self) -> None:
        self._process.communicate()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


_server = cache(_Server)


def refused(
    done: subprocess.CompletedProcess[str], said: str, folder: Path | None = None, names: list[str] | None = None
) -> None:
    """Exit status 2, one line that says it, and the folder as it was."""
    lines = [line for line in done.stderr.splitlines() if line]
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert len(lines) == 1, done.stderr
    assert said in lines[0]
    if folder is not None:
        assert sorted(path.name for path in folder.iterdir()) == names
