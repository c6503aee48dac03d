"""Words while something is under way: they are said where they are true."""

import io
import time

import pytest
from numba.core import event
from tqdm import tqdm

from mgsgraph import compiled
from mgsgraph.cli import progress
from mgsgraph.cli.options import PrintableStream

KIND = "numba:compile"


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_EXPLAIN_AFTER", 0.02)
    monkeypatch.setattr(progress, "_BEAT", 0.01)
    compiled._watch_compiler()


def test_a_slow_machine_compiles_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.word_of_compiling():
        time.sleep(0.08)
    with progress.iteration_bar(False, 3):
        time.sleep(0.08)
    assert "compil" not in capsys.readouterr().err


def test_what_numba_compiles_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.word_of_compiling(), event.trigger_event(KIND):
        assert compiled.is_compiling()
        time.sleep(0.15)
    assert not compiled.is_compiling()
    assert capsys.readouterr().err.count("compiling") == 1


# --- what goes to a terminal: names out of files can't move its cursor, and our own bars can


def test_one_bar_in_another_moves_up() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for _ in tqdm(range(2), file=said, mininterval=0.0):
        for _ in tqdm(range(2), file=said, mininterval=0.0, leave=False):
            pass
    assert "\\x1b" not in stream.getvalue()
    assert "\n\r" in stream.getvalue()
    assert "\x1b[A" in stream.getvalue()


def test_names_move_nothing() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for text in ("a\x1b[A", "\x1b[Ab", "\x1b[2A", "\x1b[A\r", "\x1b[B", "\x1b[A\x1b[2J"):
        said.write(text)
    assert "\x1b" not in stream.getvalue()
