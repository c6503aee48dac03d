"""A project is there whole or not at all, changes whole or not at all, and says in one line what is wrong with it."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from outside import refuses
from projects import StopHere, change, digest, images, interrupted

from mgsgraph.adjustment.incremental.state import InMemory
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.schema import OrientationInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.project.connection import checksum
from mgsgraph.project.project import AdjustmentCache, Project, open_project
from mgsgraph.project.schema import FORMAT
from mgsgraph.project.settings import ProjectSettings, read_settings
from mgsgraph.project.status import status


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "project"
    with Project.create(path, "a project", ProjectSettings()) as project:
        change(project.store, 1)
        project.record("init", "by the test", {})
    return path


def test_an_adjustment_is_kept_until_another_process_changes_the_project() -> None:
    settings, store, cache = SolverSettings(), InMemory(), AdjustmentCache()
    first = cache.resumed("before", settings, store)
    cache.noted("ours")
    assert cache.resumed("ours", settings, store) is first
    assert cache.resumed("ours", settings, store) is not first  # a change that was begun, and never noted
    second = cache.resumed("ours", settings, store)
    cache.noted("ours, too")
    assert cache.resumed("another's", settings, store) is not second


def state(folder: Path) -> str:
    with open_project(folder) as project:
        return digest(project.store)


def refused(folder: Path, said: str, write: bool = False) -> str:
    with pytest.raises(InputError, match=said) as caught, open_project(folder, write) as project:
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
    refuses(said, read_settings, tmp_path / "s.toml")


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


def test_a_second_writer_is_refused_at_once(folder: Path) -> None:
    with open_project(folder, write=True) as project:
        change(project.store, 2)
        refused(folder, "another mgsgraph process is changing it", write=True)
        assert state(folder)  # whoever closes a descriptor on the file gives up all locks of the process (POSIX)
        code = f"from mgsgraph.project.project import open_project\nwith open_project({str(folder)!r}, True): pass"
        command = [sys.executable, "-P", "-c", code]  # what is installed, not the sources of the working folder
        done = subprocess.run(command, capture_output=True, text=True, check=False)
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
            project.store.add_image(known)
        for seed in range(20):
            change(project.store, seed)
    assert state(folder) == before


@pytest.fixture
def nobody() -> Iterator[Path]:
    """A folder of our own that we may not write to (root may always, so that it becomes somebody else)."""
    path = Path(tempfile.mkdtemp())
    with Project.create(path / "project", "kept", ProjectSettings()) as project:
        change(project.store, 1)
    state(path / "project")  # imports what reading needs: Python's own files may be closed to that somebody
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
    refused(tmp_path / "nowhere", "no such project.*mgsgraph project init")
    said = refused(tmp_path, "no project.sqlite")  # there is a file in it
    assert f"mgsgraph project init {tmp_path / 'project'}" in said
    assert "mgsgraph project init" not in refused(folder / "project.sqlite", "is a file")
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


def test_a_flipped_bit_is_found_wherever_it_is(folder: Path) -> None:
    """Refused, or nothing that anybody reads: free pages, and what a commit counts itself by."""
    path = folder / "project.sqlite"
    with open_project(folder, write=True) as project:
        project.store.replace(project.store.members(), {})  # so that there are free pages
        change(project.store, 3)
    whole, before, rng, refusals = path.read_bytes(), state(folder), np.random.default_rng(1), 0
    path.write_bytes(whole[: len(whole) // 2])
    refused(folder, "is damaged")
    refused(folder, "is damaged", write=True)
    for place in (*range(0, 100, 6), *rng.integers(0, len(whole), 30).tolist()):
        broken = bytearray(whole)
        broken[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(broken)
        try:
            assert state(folder) == before
        except InputError:
            refusals += 1
    assert refusals > 25
    path.write_bytes(whole)


def test_a_change_of_ones_own_may_be_signed(folder: Path) -> None:
    """VACUUM, for one: the refusal says how."""
    before, other = state(folder), "; if the change was yours, have it signed: sqlite3 "
    with closing(sqlite3.connect(folder / "project.sqlite", isolation_level=None)) as file:
        file.execute("CREATE TABLE note (text)")
        file.execute("VACUUM")
    path, statement = refused(folder, "its checksum is another one").split(other)[1].split(" ", 1)
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute(statement.strip("'"))
    assert state(folder) == before


@pytest.mark.parametrize("write", [False, True])
def test_what_the_caller_stumbles_over_is_no_damage(folder: Path, write: bool) -> None:
    with pytest.raises(UnicodeDecodeError), open_project(folder, write):
        b"\xff".decode()


def test_nothing_is_looked_for_beyond_the_end() -> None:
    """Where a damaged list of free pages leads to."""
    content = bytes(16) + b"\0\1" + bytes(14) + b"\xff" * 4 + bytes(1000)
    assert checksum(SimpleNamespace(serialize=lambda: content)) > 0  # type: ignore[arg-type]


def test_a_file_that_was_not_signed_is_signed_by_the_next_change(folder: Path) -> None:
    before = state(folder)
    reseal(folder)
    assert state(folder) == before
    with open_project(folder, write=True):
        pass
    assert int.from_bytes((folder / "project.sqlite").read_bytes()[60:64]) != 0
    assert state(folder) == before


def reseal(folder: Path) -> None:
    """Take a project's file for whole as it is: what a damaged one is that somebody has signed."""
    with closing(sqlite3.connect(folder / "project.sqlite", isolation_level=None)) as file:
        file.execute("PRAGMA user_version = 0")


@pytest.mark.parametrize("statement", [
    "UPDATE bundle SET members = '[[1' WHERE id = 1",
    "UPDATE bundle SET points = 'many'",
    "UPDATE packed SET cell = x'09' WHERE kind = 'points' AND name = 'class'",
    "UPDATE packed SET cell = x'00' WHERE kind = 'points' AND name = 'covariance'",
    "UPDATE packed SET cell = x'4d000000' WHERE kind = 'rays' AND name = 'image'",
    "UPDATE packed SET cell = x'ffffffff' WHERE kind = 'rays' AND name = 'point'",
    "UPDATE packed SET size = 3000000000 WHERE kind = 'rays'",
    "UPDATE bundle SET rays = 1", "UPDATE packed SET cell = x'' WHERE name = 'ends'",
    "UPDATE packed SET cell = zeroblob(length(cell)) WHERE name = 'ends'", "DELETE FROM packed WHERE kind = 'adjusted'",
    "UPDATE shared SET value = 'v'", "UPDATE bundle SET at = 3", "UPDATE image SET record = 'r'",
    "UPDATE change SET summary = '{'", "UPDATE change SET summary = '[]'", "UPDATE change SET at = x'ff'",
    "UPDATE meta SET value = x'ff' WHERE key = 'format'", "UPDATE meta SET value = '²' WHERE key = 'format'",
    "UPDATE packed SET cell = zeroblob(length(cell) - 1) || x'ff' WHERE name = 'text'",
    "DROP TABLE packed", "DROP TABLE meta",
    "UPDATE packed SET cell = 'nan' WHERE kind = 'ranges' AND name = 'sigma'",
    "UPDATE image SET name = 'x' WHERE id = 1", "UPDATE bundle_image SET bundle = 99 WHERE bundle = 1",
    "UPDATE shared SET prior = x'0000000000000000'", "UPDATE bundle SET unknowns = '[[\"image\", \"SIM/A\"]]'",
    "UPDATE bundle SET members = '[[\"image\", {}]]' WHERE id = 1", "UPDATE image SET held = 1",
    "UPDATE bundle SET unknowns = '[[\"image\", \"SIM/C\"]]'",
])  # fmt: skip
def test_cells_that_nobody_of_ours_wrote(folder: Path, statement: str) -> None:
    _edit(folder, statement)
    reseal(folder)
    refusals = list[str]()
    for read in (lambda one: digest(one.store), Project.changes, status):
        try:
            with open_project(folder) as project:
                read(project)
        except InputError as error:
            refusals.append(str(error))
    assert refusals
    assert all(str(folder) in said for said in refusals)


def test_a_schema_that_is_no_text(folder: Path) -> None:
    path = folder / "project.sqlite"
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"CREATE TABLE image (", b"CREATE TABLE im\xffge ("))
    refused(folder, "damaged")
    path.write_bytes(whole.replace(b"tableimage", b"table\xff\xfeage"))
    refused(folder, "damaged")


def _edit(folder: Path, statement: str) -> None:
    other = sqlite3.connect(folder / "project.sqlite")
    other.execute(statement)
    other.commit()
    other.close()


@pytest.mark.parametrize("write", [False, True])
@pytest.mark.parametrize(
    ("number", "said"),
    [(FORMAT + 1, "newer version"), (FORMAT - 1, r"read it with mgsgraph 0\.2\.0, or build it anew")],
)
def test_another_format_is_refused_with_what_to_do(folder: Path, number: int, said: str, write: bool) -> None:
    _edit(folder, f"UPDATE meta SET value = '{number}' WHERE key = 'format'")
    before = (folder / "project.sqlite").read_bytes()
    refused(folder, said, write)
    assert (folder / "project.sqlite").read_bytes() == before
