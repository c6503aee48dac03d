"""Where compiled kernels are kept: never among installed packages."""

import os
from pathlib import Path

import pytest

from mgsgraph.compiled import find_a_place_for_compiled_kernels


def place_of(package: Path, monkeypatch: pytest.MonkeyPatch, caches: Path) -> str | None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(caches))
    find_a_place_for_compiled_kernels(package)
    found = os.environ.get("NUMBA_CACHE_DIR")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that monkeypatch puts back what was there before
    return found


def test_place_of_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout, installed = tmp_path / "mgsgraph" / "factors", tmp_path / "site-packages" / "mgsgraph" / "factors"
    for folder in (checkout, installed):
        folder.mkdir(parents=True)
    assert place_of(checkout, monkeypatch, tmp_path / "caches") is None
    assert place_of(installed, monkeypatch, tmp_path / "caches") == str(tmp_path / "caches" / "mgsgraph")
    (tmp_path / "file").write_text("")
    found = place_of(installed, monkeypatch, tmp_path / "file")
    assert found is not None
    assert "mgsgraph-kernels" in found


def test_the_users_own_choice_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    find_a_place_for_compiled_kernels(tmp_path / "site-packages" / "mgsgraph" / "factors")
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path)
