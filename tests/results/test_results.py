"""Result folders appear whole or not at all, and nothing that isn't ours is ever replaced."""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from full_disk import files_of_at_most
from outside import refuses

import mgsgraph
from mgsgraph import atomic_write
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import fresh_folder, require_replaceable
from mgsgraph.results.results import write_into, write_results

TABLES = ["solution.json", "points.csv", "orientation.csv", "residuals.csv", "connectivity.csv", "solution.npz"]


def make_result(folder: Path, text: str = "old") -> Path:
    folder.mkdir()
    (folder / "solution.json").write_text(json.dumps({"program": "mgsgraph", "text": text}))
    (folder / "points.csv").write_text(text)
    return folder


def everything(folder: Path) -> dict[str, str]:
    """All files below a folder, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def assert_refused(path: Path, says: str) -> None:
    for make in (lambda: require_replaceable(path), lambda: fresh_folder(path).__enter__()):
        with pytest.raises(InputError, match=says) as caught:
            make()
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def written(out: Path, act: Callable[[Path], object]) -> None:
    """A fresh folder in which `act` writes."""
    with fresh_folder(out) as folder:
        act(folder)


@contextmanager
def working_in(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


# --- the folder


def test_an_earlier_result_stays_whole_until_the_new_one_is(tmp_path: Path) -> None:
    out = make_result(tmp_path / "out")
    before = everything(out)
    with fresh_folder(out) as folder:
        (folder / "solution.json").write_text("new")
        assert everything(out) == before
    assert everything(tmp_path) == {"out/solution.json": "new"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("problem", [KeyboardInterrupt(), OSError(errno.EIO, "broken")])
def test_an_exception_leaves_all_as_it_was(tmp_path: Path, problem: BaseException) -> None:
    out = make_result(tmp_path / "out")
    before = everything(tmp_path)

    def fail(folder: Path) -> None:
        (folder / "half").write_text("half")
        raise problem

    with pytest.raises(InputError if isinstance(problem, OSError) else type(problem)):
        written(out, fail)
    assert everything(tmp_path) == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_results_are_exchanged_in_one_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No moment at which a kill would leave none."""
    if not can_exchange(tmp_path):
        pytest.skip("a file system without an exchange")
    out = make_result(tmp_path / "out")
    monkeypatch.setattr(Path, "rename", None)
    with fresh_folder(out) as folder:
        (folder / "solution.json").write_text("new")
    assert everything(tmp_path) == {"out/solution.json": "new"}


def can_exchange(folder: Path) -> bool:
    for name in "ab":
        (folder / name).mkdir()
    try:
        return atomic_write._exchanged(folder / "a", folder / "b")
    finally:
        for name in "ab":
            (folder / name).rmdir()


def test_a_kill_between_two_renames_is_put_right(tmp_path: Path) -> None:
    """Where the file system knows no exchange."""
    new = atomic_write.beside(tmp_path / "out")
    before = everything(make_result(new.with_suffix(".replaced")))
    make_result(new, "new")
    require_replaceable(tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert everything(tmp_path / "out") == before
    make_result(atomic_write.beside(tmp_path / "out").with_suffix(".replaced"), "older")  # the new one was in place
    require_replaceable(tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert everything(tmp_path / "out") == before


def test_a_link_that_leads_to_itself_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert_refused(tmp_path / "loop", "a link that leads to itself; choose another --out")
    assert_refused(tmp_path / "loop" / "out", "a link that leads to itself; choose another --out")


def test_a_link_that_leads_nowhere_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "absent" / "out")
    assert_refused(tmp_path / "link", "a link that leads nowhere")
    assert not (tmp_path / "absent").exists()


def test_a_failing_exchange_brings_the_old_result_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = make_result(tmp_path / "out")
    before, rename = everything(tmp_path), Path.rename

    def failing(self: Path, target: Path) -> Path:
        if self.name.endswith(".unfinished"):
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(atomic_write, "_exchanged", lambda one, other: False)
    monkeypatch.setattr(Path, "rename", failing)
    refuses("Input/output error", written, out, str)
    assert everything(tmp_path) == before


@pytest.mark.parametrize("empty", [True, False])
def test_an_empty_folder_is_taken_and_a_new_one_is_not_there_until_all_is(tmp_path: Path, empty: bool) -> None:
    out = tmp_path / "deep" / "out"
    if empty:
        out.mkdir(parents=True)
    with fresh_folder(out) as folder:
        (folder / "a").write_text("1")
        assert out.exists() == empty
    assert everything(tmp_path) == {"deep/out/a": "1"}


def test_a_link_to_a_result_is_followed(tmp_path: Path) -> None:
    make_result(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with fresh_folder(tmp_path / "link") as folder:
        (folder / "a").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert everything(tmp_path / "real") == {"a": "1"}


def test_folders_of_others_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    assert_refused(other, "exists and is not a result of mgsgraph; choose another --out")
    for text in ('{"program": "other"}', "[1]", "{", "", '"mgsgraph"'):  # a file of that name may be anybody's
        (other / "solution.json").write_text(text)
        assert_refused(other, "exists and is not a result of mgsgraph")
    assert (other / "thesis.tex").read_text() == "years of work"
    assert_refused(other / "thesis.tex", "exists and is a file")


def test_a_folder_that_fills_meanwhile_is_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def write_elsewhere(_: Path) -> None:
        out.mkdir()
        (out / "thesis.tex").write_text("years of work")

    refuses("not a result", written, out, write_elsewhere)
    assert everything(tmp_path) == {"out/thesis.tex": "years of work"}


def test_a_demonstration_is_replaced_by_another_one_alone_and_no_file_among_its_inputs_is_lost(tmp_path: Path) -> None:
    out = make_result(tmp_path / "out")
    (out / "inputs").mkdir()
    (out / "inputs" / "case.toml").write_text("")
    assert_refused(out, "'inputs', too, which would be lost")
    (out / "demo.json").write_text(json.dumps({"program": "mgsgraph", "files": ["inputs/case.toml"]}))
    assert_refused(out, "another kind of result")
    require_replaceable(out, "demo.json")
    (out / "inputs" / "mine.toml").write_text("")
    refuses(r"'inputs/mine\.toml', too, which would be lost", require_replaceable, out, "demo.json")


def test_the_working_folder_is_not_pulled_away(tmp_path: Path) -> None:
    with working_in(make_result(tmp_path / "out")):
        assert_refused(Path(), "the folder you are in")
    with working_in(tmp_path):
        require_replaceable(Path("out"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    def fill(_: Path) -> None:
        Path("/dev/full").write_text("x")

    with pytest.raises(InputError, match=r"No space left on device.*free some space") as caught:
        written(tmp_path / "out", fill)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


# --- what is in it


def test_all_tables_are_written(pair_solution: Solution, tmp_path: Path) -> None:
    names = write_results(pair_solution, tmp_path / "out", figures=False)
    assert names == TABLES
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(TABLES)
    record = json.loads((tmp_path / "out" / "solution.json").read_text(encoding="utf-8"))
    assert record["status"] == "converged"
    assert mgsgraph.read_solution(tmp_path / "out").sigma0 == record["sigma0"]
    require_replaceable(tmp_path / "out")  # known as ours
    write_results(pair_solution, tmp_path / "out", figures=False)


def test_tables_are_the_same_each_time(pair_solution: Solution, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_into(pair_solution, tmp_path / name, figures=False)
    assert [(tmp_path / "a" / name).read_bytes() for name in TABLES] == [
        (tmp_path / "b" / name).read_bytes() for name in TABLES
    ]


@pytest.mark.usefixtures("light_figures")
def test_figures_are_named_with_the_tables(pair_solution: Solution, tmp_path: Path) -> None:
    names = write_results(pair_solution, tmp_path / "out")
    assert names[: len(TABLES)] == TABLES
    assert "map.png" in names
    assert sorted(names) == sorted(p.name for p in (tmp_path / "out").iterdir())


def test_matplotlib_is_left_alone_without_figures(tmp_path: Path) -> None:
    code = "import sys, mgsgraph.results.results; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False).returncode == 0


@pytest.mark.parametrize("name", ["points.csv", "solution.npz"])
def test_a_disk_that_fills_up_leaves_nothing(pair_solution: Solution, tmp_path: Path, name: str) -> None:
    """No file may grow as large as one of them has to."""
    make_result(tmp_path / "out")
    (tmp_path / "sizes").mkdir()
    write_into(pair_solution, tmp_path / "sizes", figures=False)
    size = (tmp_path / "sizes" / name).stat().st_size
    shutil.rmtree(tmp_path / "sizes")
    before = everything(tmp_path)
    with files_of_at_most(size - 1), pytest.raises(InputError, match="can't be written") as caught:
        write_results(pair_solution, tmp_path / "out", figures=False)
    assert "\n" not in str(caught.value)
    assert everything(tmp_path) == before
