"""A project is there whole or not at all, changes whole or not at all, and says in one line what is wrong with it."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from projects import StopHere, change, digest, images, interrupted

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.schema import OrientationInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.schema import FORMAT
from mgsgraph.project.settings import ProjectSettings, read_settings

FORMAT_1 = Path(__file__).with_name("format_1.sql")
"""Dump of a project as the first format wrote it."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "project"
    with Project.create(path, "a project", ProjectSettings()) as project:
        change(project.store, 1)
        project.record("init", "by the test", {})
    return path


def state(folder: Path) -> str:
    with open_project(folder) as project:
        return digest(project.store)


def refused(folder: Path, said: str, write: bool = False) -> str:
    with pytest.raises(InputError, match=said) as caught, open_project(folder, write, thorough=True) as project:
        digest(project.store)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- beginning


def test_settings_come_back(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(
        'format = 1\nname = "x"\n[orientation]\nposition_sigma_m = [inf, 3.0, 1e-3]\n'
        '[spice]\nkernels = ["a.tm"]\n[solver]\nloss = "huber"\n[measures]\ntie_sigma_px = 0.5\n'
    )
    name, settings = read_settings(file)
    with Project.create(tmp_path / "p", name, settings):
        pass
    with open_project(tmp_path / "p") as project:
        assert project.name == "x"
        assert project.settings == settings
        assert project.settings.orientation == OrientationInput(position_sigma_m=[np.inf, 3.0, 1e-3])
        assert project.settings.spice == SpiceInput((str(tmp_path / "a.tm"),))
        assert project.settings.solver.settings == SolverSettings(loss="huber")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("format = 1\n[[images]]\nname = 'a'\n", "--case"), ("format = 9\n", "format = 1"), ("[orientation", "TOML"),
        ("format = 1\n[orientation]\ndegre = 1\n", "orientation"),
        ("format = 1\n[measures]\ntie_sigma_px = 0\n", "tie_sigma_px"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_settings(tmp_path / "s.toml")


def test_a_beginning_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(StopHere), Project.create(tmp_path / "p", "p", ProjectSettings()):
        raise StopHere
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_not_overwritten(folder: Path, tmp_path: Path) -> None:
    before = state(folder)
    (tmp_path / "file").touch()
    for path, said in ((folder, "not empty"), (tmp_path / "file", "is a file"), (tmp_path / "file" / "p", "written")):
        with pytest.raises(InputError, match=said), Project.create(path, "p", ProjectSettings()):
            pass
    assert state(folder) == before
    (tmp_path / "empty").mkdir()
    with Project.create(tmp_path / "empty", "", ProjectSettings()) as project:
        assert project.name == "empty"


# --- one change at a time, whole or not at all


def test_an_exception_takes_everything_back(folder: Path) -> None:
    before = state(folder)
    with pytest.raises(StopHere), open_project(folder, write=True) as project:  # noqa: PT012
        change(project.store, 2)
        project.record("add", "x", {})
        raise StopHere
    assert state(folder) == before
    with open_project(folder) as project:
        assert [one.verb for one in project.changes()] == ["init"]


def test_a_second_writer_is_refused_at_once_and_told_by_whom(folder: Path) -> None:
    with open_project(folder, write=True) as project:
        change(project.store, 2)
        message = refused(folder, "another mgsgraph process is changing it", write=True)
        assert f"process {os.getpid()}" in message
        code = f"from mgsgraph.project.project import open_project\nwith open_project({str(folder)!r}, True): pass"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "is changing it" in done.stderr
    with open_project(folder, write=True):
        pass
    assert sorted(path.name for path in folder.iterdir()) == ["project.sqlite"]


def test_readers_see_what_was_there_before(folder: Path) -> None:
    before = state(folder)
    with open_project(folder, write=True) as project:
        for seed in range(3):
            change(project.store, seed)
        after = digest(project.store)
        assert state(folder) == before
    assert after != before
    assert state(folder) == after


def test_a_full_disk_loses_nothing(folder: Path) -> None:
    before = state(folder)
    with pytest.raises(InputError, match="disk is full"), open_project(folder, write=True) as project:  # noqa: PT012
        pages = project._connection.execute("PRAGMA page_count").fetchone()[0]
        project._connection.execute(f"PRAGMA max_page_count = {pages + 2}")
        for known in images():
            project.store.put_image(known)
        for seed in range(20):
            change(project.store, seed)
    assert state(folder) == before


@pytest.fixture
def nobody() -> Iterator[Path]:
    """A folder of our own that we may not write to (root may always, so that it becomes somebody else)."""
    path = Path(tempfile.mkdtemp())
    with Project.create(path / "project", "kept", ProjectSettings()) as project:
        change(project.store, 1)
    for one in (path / "project" / "project.sqlite", path / "project", path):
        one.chmod(0o444 if one.is_file() else 0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    yield path / "project"
    if root:
        os.seteuid(0)
    for one in (path, path / "project"):
        one.chmod(0o755)
    shutil.rmtree(path)


def test_a_read_only_disk_after_a_kill(nobody: Path) -> None:
    """A journal that can't be played back there: the file alone would show a state between."""
    os.seteuid(os.getuid())
    for path in (nobody, nobody / "project.sqlite"):
        path.chmod(0o755)
    copy = nobody.parent.parent / f"{nobody.parent.name}-copy"
    try:
        interrupted(nobody, copy)
        for path in (*copy.iterdir(), copy):
            path.chmod(0o444 if path.is_file() else 0o555)
        if os.getuid() == 0:
            os.seteuid(65534)
        assert "disk is read-only" in refused(copy, "killed while it changed this")
    finally:
        os.seteuid(os.getuid())
        copy.chmod(0o755)
        shutil.rmtree(copy)


def test_a_read_only_disk(nobody: Path) -> None:
    assert len(state(nobody)) == 64
    refused(nobody, "can't be written", write=True)
    with pytest.raises(InputError, match="written"), Project.create(nobody / "p", "p", ProjectSettings()):
        pass


# --- what isn't a project, or isn't ours


def test_what_is_no_project(folder: Path, tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "no such project.*mgsgraph init")
    refused(tmp_path, "no project.sqlite")
    refused(folder / "project.sqlite", "is a file")
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "project.sqlite").write_text("What is this?")
    assert "project.sqlite is damaged" in refused(tmp_path / "text", "is damaged")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "project.sqlite").touch()
    refused(tmp_path / "empty", "is empty", write=True)
    (tmp_path / "foreign").mkdir()
    other = sqlite3.connect(tmp_path / "foreign" / "project.sqlite")
    other.execute("CREATE TABLE meta (key, value)")
    other.commit()
    other.close()
    before = (tmp_path / "foreign" / "project.sqlite").read_bytes()
    refused(tmp_path / "foreign", "another program", write=True)
    assert (tmp_path / "foreign" / "project.sqlite").read_bytes() == before


def test_damage_is_named(folder: Path) -> None:
    path = folder / "project.sqlite"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refused(folder, "is damaged")
    refused(folder, "is damaged", write=True)
    rng = np.random.default_rng(0)
    for _ in range(25):
        broken, place = bytearray(whole), int(rng.integers(100, len(whole) - 200))
        broken[place : place + 150] = rng.bytes(150)
        path.write_bytes(bytes(broken))
        with suppress(InputError), open_project(folder, thorough=True) as project:  # never another exception
            digest(project.store)
    path.write_bytes(whole)
    assert state(folder)


def _edit(folder: Path, statement: str) -> None:
    other = sqlite3.connect(folder / "project.sqlite")
    other.execute(statement)
    other.commit()
    other.close()


def test_a_newer_format_is_refused(folder: Path) -> None:
    _edit(folder, f"UPDATE meta SET value = '{FORMAT + 1}' WHERE key = 'format'")
    before = (folder / "project.sqlite").read_bytes()
    refused(folder, "newer version")
    refused(folder, "newer version", write=True)
    assert (folder / "project.sqlite").read_bytes() == before


@pytest.mark.parametrize("write", [False, True])
def test_an_older_format_becomes_this_one(tmp_path: Path, write: bool) -> None:
    old = tmp_path / "old"
    old.mkdir()
    made = sqlite3.connect(old / "project.sqlite")
    made.executescript(FORMAT_1.read_text(encoding="utf-8"))
    made.close()
    with open_project(old, write) as project:
        last = project.last_solution()
        assert last is not None
        assert (last.kind, last.converged, last.cost, last.folder) == ("batch", True, 12.5, "solutions/0001")
        assert project.name == "an old one"
    with Project.create(tmp_path / "new", "new", ProjectSettings()):
        pass
    assert columns(old) == columns(tmp_path / "new")
    made = sqlite3.connect(old / "project.sqlite")
    assert made.execute("SELECT value FROM meta WHERE key = 'format'").fetchone() == (str(FORMAT),)
    made.close()


def test_a_migration_that_fails_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = tmp_path / "old"
    old.mkdir()
    made = sqlite3.connect(old / "project.sqlite")
    made.executescript(FORMAT_1.read_text(encoding="utf-8"))
    made.close()
    before = (old / "project.sqlite").read_bytes()
    monkeypatch.setitem(
        __import__("mgsgraph.project.schema", fromlist=["MIGRATIONS"]).MIGRATIONS, 1,
        ("ALTER TABLE solution ADD COLUMN kind TEXT", "ALTER TABLE nothing ADD COLUMN x"),
    )  # fmt: skip
    with pytest.raises(sqlite3.OperationalError), open_project(old, write=True):
        pass
    assert (old / "project.sqlite").read_bytes() == before


def columns(folder: Path) -> dict[str, set[tuple[object, ...]]]:
    """Columns of each table, with their types and rules."""
    made = sqlite3.connect(folder / "project.sqlite")
    names = [name for (name,) in made.execute("SELECT name FROM sqlite_master WHERE type IN ('table', 'view')")]
    found = {name: {tuple(row[1:5]) for row in made.execute(f"PRAGMA table_info({name})")} for name in names}
    made.close()
    return found
