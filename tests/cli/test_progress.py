"""Words while something is under way: they are said where they are true."""

import time

import pytest
from numba.core import event

from mgsgraph import compiled
from mgsgraph.cli import progress

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
