"""Where compiled kernels are kept: never among installed packages."""

import os
import tempfile
from pathlib import Path

import pytest

from mgsgraph import compiled
from mgsgraph.compiled import find_a_place_for_compiled_kernels, find_a_place_for_fonts


def place_of(package: Path, monkeypatch: pytest.MonkeyPatch, caches: Path) -> str | None:
    unset(monkeypatch, "NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(caches))
    find_a_place_for_compiled_kernels(package)
    return os.environ.get("NUMBA_CACHE_DIR")


def unset(monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    """Until the test ends; set before, for `delenv` keeps nothing in mind of what isn't there. Of a cache that stayed
    set, processes of later tests would compile everything anew, for minutes.
    """
    monkeypatch.setenv(variable, "")
    monkeypatch.delenv(variable)


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


def test_a_folder_that_somebody_else_has_made_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in it would be run."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    planted = tmp_path / f"mgsgraph-kernels-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    (tmp_path / "file").write_text("")
    compiled._temporary_caches.cache_clear()
    installed = tmp_path / "site-packages" / "mgsgraph"
    found = place_of(installed, monkeypatch, tmp_path / "file")
    assert found is not None
    assert Path(found) != planted
    assert Path(found).stat().st_mode & 0o777 == 0o700
    compiled._temporary_caches.cache_clear()
    planted.chmod(0o700)
    assert place_of(installed, monkeypatch, tmp_path / "file") == str(planted)
    compiled._temporary_caches.cache_clear()


def test_matplotlib_has_a_place_where_home_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "file").write_text("")
    compiled._temporary_caches.cache_clear()
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / "fine"))
    unset(monkeypatch, "MPLCONFIGDIR")
    find_a_place_for_fonts()
    assert "MPLCONFIGDIR" not in os.environ
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file" / "config"))
    find_a_place_for_fonts()
    found = os.environ["MPLCONFIGDIR"]
    assert Path(found).parent.parent == tmp_path
    compiled._temporary_caches.cache_clear()
