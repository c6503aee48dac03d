"""A project of a case without tie points: its images wait, are matched, and go the rest of the road by its name."""

import shutil
from pathlib import Path

import matched
import pytest

from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.products.archive import read_solution
from mgsgraph.project.project import open_project
from mgsgraph.project.results import results_of


def call(*arguments: str | Path) -> int:
    """A command in this process; its exit status."""
    return group([str(one) for one in arguments], standalone_mode=False) or 0


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case of the small pair, whose own ties are gone."""
    case = matched.write(tmp_path_factory.mktemp("site"))
    head, _, rest = case.read_text(encoding="utf-8").partition("[ties]")
    case.write_text(head + rest[rest.index("\n[") :], encoding="utf-8")
    (case.parent / "network.pvl").unlink()
    return case


@pytest.fixture(scope="module")
def project(case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `init` makes it."""
    project = tmp_path_factory.mktemp("projects") / "waiting"
    call("init", project, "--case", case)
    return project


def copied(project: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(project, tmp_path / "project"))


def test_images_wait(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call("status", project)
    said = capsys.readouterr().out
    for words in ("2 images", "points: 0", f"next: mgsgraph match {project}"):
        assert words in said
    waiting = copied(project, tmp_path)
    with pytest.raises(InputError, match=f"nothing to adjust.*mgsgraph match {waiting}"):
        call("solve", waiting)
    for verb, more, out in (("report", (), "page.html"), ("export", ("--to", "gis"), "gis")):
        with pytest.raises(InputError, match=f"without a batch solution.*mgsgraph solve {waiting}"):
            call(verb, waiting, *more, "--out", tmp_path / out)
        assert not (tmp_path / out).exists()


def test_the_whole_road_by_its_name(
    project: Path, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    waiting = copied(project, tmp_path)
    assert call("match", waiting, "--cells", 40, "--no-figures") == 0
    assert f"Next: mgsgraph solve {waiting}" in capsys.readouterr().out
    assert call("solve", waiting, "--no-figures") == 0
    results = results_of(waiting)
    network = waiting / "matches" / "network.pvl"
    assert results == (waiting / "solutions" / "0001", case, network)
    assert call("report", waiting, "--out", tmp_path / "report.html") == 0
    assert 'class="scene"' in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert call("export", waiting, "--to", "isis", "--out", tmp_path / "isis") == 0
    with open_project(waiting) as opened:
        assert [change.verb for change in opened.changes()] == ["init", "match", "solve"]

    # the same as by the way without a project
    assert call("adjust", case, "--ties", network, "--out", tmp_path / "result", "--no-figures") == 0
    one, other = (read_solution(folder) for folder in (results.folder, tmp_path / "result"))
    assert one.cost_final == pytest.approx(other.cost_final, rel=1e-9)

    with pytest.raises(InputError, match="it has measures already"):
        call("match", waiting)


def test_what_is_refused(project: Path, case: Path, case_file: Path, tmp_path: Path) -> None:
    before = (project / "project.sqlite").read_bytes()
    with pytest.raises(Exception, match="--out is for a case"):
        call("match", project, "--out", tmp_path / "out")
    with pytest.raises(Exception, match="Missing option '--out'"):
        call("match", case)
    call("init", tmp_path / "empty")
    with pytest.raises(InputError, match="made without a case"):
        call("match", tmp_path / "empty")
    call("init", tmp_path / "full", "--case", case_file)
    with pytest.raises(InputError, match="it has measures already"):
        call("match", tmp_path / "full")
    shared = case.with_name("shared.toml")
    table = '\n[[shared]]\nkind = "attitude-time bias"\nsigma_s = 1.0\n'
    shared.write_text(case.read_text(encoding="utf-8") + table, encoding="utf-8")
    with pytest.raises(InputError, match="shared: a table that no project has"):
        call("init", tmp_path / "shared", "--case", shared)
    assert not (tmp_path / "shared").exists()
    assert (project / "project.sqlite").read_bytes() == before
