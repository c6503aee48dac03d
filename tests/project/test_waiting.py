"""Projects of cases without tie points, whose images wait and are matched, and of cases with passes."""

import contextlib
import io
import re
import shutil
from pathlib import Path

import matched
import numpy as np
import pytest
from commands import call
from outside import refuses
from pass_files import block, write_block

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.project.changes import take_ties
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import results_of
from mgsgraph.results import matching
from mgsgraph.results.archive import read_solution


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case of the small pair, whose own ties are gone."""
    return matched.write_without_ties(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def project(case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `init` makes it."""
    project = tmp_path_factory.mktemp("projects") / "waiting"
    call("project", "init", project, "--case", case)
    return project


@pytest.fixture(scope="module")
def ready(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the tie points that `match` has found; they are known already."""
    waiting, said = copied(project, tmp_path_factory.mktemp("matched")), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setattr(matching, "match_scene", lambda *_, **__: matched.matches())
        assert call("match", waiting, "--no-figures") == 0
    assert f"Next: mgsgraph project solve {waiting}" in said.getvalue()
    return waiting


def copied(project: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(project, tmp_path / "project"))


def test_images_wait(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call("project", "status", project)
    said = capsys.readouterr().out
    for words in ("2 images", "0 points", f"next: mgsgraph match {project}"):
        assert words in said
    waiting = copied(project, tmp_path)
    refuses(f"nothing to adjust.*mgsgraph match {waiting}", call, "project", "solve", waiting)
    for verb, more, out in (("report", (), "page.html"), ("export", ("--to", "gis"), "gis")):
        with pytest.raises(InputError, match=f"without a batch solution.*mgsgraph project solve {waiting}"):
            call(verb, waiting, *more, "--out", tmp_path / out)
        assert not (tmp_path / out).exists()


@pytest.mark.slow
def test_the_whole_road_by_its_name(
    ready: Path, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    waiting = copied(ready, tmp_path)
    assert call("project", "solve", waiting, "--no-figures") == 0
    results = results_of(waiting)
    network = waiting / "matches" / "network.pvl"
    assert results == (waiting / "solutions" / "0001", case, network, "")
    assert call("report", waiting, "--out", tmp_path / "report.html") == 0
    assert (tmp_path / "report.html").stat().st_size > 0
    assert call("export", waiting, "--to", "isis", "--out", tmp_path / "isis") == 0
    with open_project(waiting) as opened:
        assert [change.verb for change in opened.changes()] == ["init", "match", "solve"]

    # the same as without a project, whose rows count as independent
    known = mgsgraph.read_case(case, ties=network)
    other = adjust_network(known.network.independent, known.settings)
    assert read_solution(results.folder).cost_final == pytest.approx(other.cost_final, rel=1e-9)

    refuses("it has measures already", call, "match", waiting)
    changed_later(waiting, tmp_path, capsys)


def changed_later(solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Results of before are told from results of everything."""
    with open_project(solved) as opened:
        name = opened.store.image_names()[1]
    call("project", "remove", solved, name)
    capsys.readouterr()
    assert results_of(solved).folder == solved / "solutions" / "0001"
    for verb, more, out in (("report", (), "later.html"), ("export", ("--to", "isis"), "later")):
        assert call(verb, solved, *more, "--out", tmp_path / out) == 0
        assert f"has changed since this solution (remove {name}); for" in capsys.readouterr().out


@pytest.mark.slow
def test_a_case_that_says_something_else_by_now(ready: Path, case: Path, tmp_path: Path) -> None:
    """Its settings count until ties are there; other images are refused before they are matched."""
    other = tmp_path / "site"
    shutil.copytree(case.parent, other)
    changed, mine = other / case.name, tmp_path / "mine"
    call("project", "init", mine, "--case", changed)
    text = changed.read_text(encoding="utf-8")
    changed.write_text(f"{text}\n[solver]\nreject = 4.5\n", encoding="utf-8")
    with open_project(mine, write=True) as opened:
        take_ties(opened, ready / "matches" / "network.pvl")
    with open_project(mine) as opened:
        assert opened.settings.solver.reject == 4.5

    third, entry = tmp_path / "third", text[text.index("[[images]]") :].split("\n[", 2)[1]
    call("project", "init", third, "--case", changed)
    name = next(line.split('"')[1] for line in entry.splitlines() if line.startswith("name"))
    more = "\n[" + entry.replace(f'"{name}"', '"third"') + "\n"
    changed.write_text(text + more, encoding="utf-8")
    refuses(f"the images .*third; expected those of {third}, .*; begin another project", call, "match", third)
    assert not (third / "matches").exists()


def test_a_case_of_an_image_alone_is_added(ready: Path, case: Path, tmp_path: Path) -> None:
    """As `fetch` writes it, of an image without a laser profile; its ties come by --ties, if at all."""
    text = case.read_text(encoding="utf-8")
    entries = text[text.index("[[images]]") :].split("[[")
    name = entries[1].split('"')[1]
    tables = [table for table in entries[2:] if not table.startswith(("images", "shots"))]
    alone = case.with_name("alone.toml")
    renamed = entries[1].replace(f'"{name}"', '"third"\nposition_bias_s = 1.0')  # another place: another image
    alone.write_text("".join([text[: text.index("[[images]]")], "[[", renamed, *tables]), encoding="utf-8")
    project = copied(ready, tmp_path)
    assert call("project", "add", project, alone) == 0
    with open_project(project) as opened:
        assert "third" in opened.store.image_names()


def test_what_is_refused(project: Path, case: Path, case_file: Path, tmp_path: Path) -> None:
    before = (project / "project.sqlite").read_bytes()
    with pytest.raises(Exception, match="--out is for a case"):
        call("match", project, "--out", tmp_path / "out")
    for mistyped, said in ((tmp_path / "none", "no such file"), (tmp_path, "neither a case file nor a project")):
        refuses(rf"{said}; .*check the path", call, "match", mistyped)
    call("project", "init", tmp_path / "empty")
    refuses("made without a case", call, "match", tmp_path / "empty")
    call("project", "init", tmp_path / "full", "--case", case_file)
    refuses("it has measures already", call, "match", tmp_path / "full")
    assert (project / "project.sqlite").read_bytes() == before


# --- projects with passes, as a person uses them: what is solved is what `adjust` finds, whatever came and


LAST = "HRSC/01/S2"


@pytest.fixture(scope="module")
def block_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("block")
    write_block(path)
    return path


@pytest.fixture(scope="module")
def batch(block_folder: Path) -> Solution:
    case = mgsgraph.read_case(block_folder / "case.toml")
    return mgsgraph.adjust(case)


def assert_same(project: Path, wanted: Solution) -> None:
    """The project's last results and a solution agree, node by node and point by point."""
    with open_project(project) as opened:
        last = opened.last_results()
    assert last is not None
    assert last.folder is not None
    found = read_solution(project / last.folder)
    place = {name: k for k, name in enumerate(found.network.points.ids)}
    order = [place[name] for name in wanted.network.points.ids]
    assert np.max(np.abs(found.places[order] - wanted.places) / wanted.sigmas) < 1e-3
    mine = {one.name: found.nodes[k] for k, one in enumerate(found.network.passes)}
    for k, one in enumerate(wanted.network.passes):
        first = int(wanted.network.first_of_passes[k])
        for node in range(len(one.nodes)):
            sigmas = np.sqrt(np.diag(wanted.joint_covariance.block(first + node, first + node)))
            assert np.max(np.abs(mine[one.name][node] - wanted.nodes[k][node]) / sigmas) < 1e-3


def added(project: Path, block_folder: Path, *options: str) -> int:
    """The last image joins its pass again, with the ties that others measure, too."""
    isd = f"{LAST}={block_folder / LAST.replace('/', '_')}.isd"
    return call("project", "add", project, isd, "--ties", block_folder / "network.pvl", "--pass", "HRSC/01", *options)


def test_solve_is_adjust_and_an_image_comes_back(
    block_folder: Path, batch: Solution, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = tmp_path / "project"
    assert call("project", "init", project, "--case", block_folder / "case.toml") == 0
    assert call("project", "solve", project, "--no-figures") == 0
    assert_same(project, batch)
    assert call("project", "remove", project, LAST) == 0
    capsys.readouterr()
    assert added(project, block_folder) == 0
    said = capsys.readouterr().out
    assert re.search(r" orientation images? reached; most moved is -?\d+\.\d{3} s of HRSC/0[01]", said)
    assert call("project", "status", project) == 0
    said = capsys.readouterr().out
    nodes = len(batch.network.passes[1].nodes)
    assert f"Pass HRSC/01: 5 images, {nodes} orientation images" in said
    assert call("project", "solve", project, "--no-figures") == 0
    assert "Check against batch: the same" in capsys.readouterr().out
    with open_project(project) as opened:
        assert set(opened.store.image_names()) == set(block().network.image_names)
    assert_same(project, batch)


def test_an_image_file_joins_a_pass_by_option(
    block_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = tmp_path / "project"
    call("project", "init", project, "--case", block_folder / "case.toml")
    call("project", "remove", project, LAST)
    isd = f"{LAST}={block_folder / LAST.replace('/', '_')}.isd"
    with pytest.raises(InputError, match="no pass 'x'; expected a known name"):
        call("project", "add", project, isd, "--ties", block_folder / "network.pvl", "--pass", "x")
    call("project", "add", project, isd, "--ties", block_folder / "network.pvl", "--dry-run")
    assert "--pass 'HRSC/01' puts it on that trajectory" in capsys.readouterr().out
    added(project, block_folder)
    with open_project(project) as opened:
        known = opened.store.definitions().passes["HRSC/01"]
        assert known.images[-1] == LAST
        assert len(opened.store.network().passes[1].images) == 5


def test_a_case_that_waits_for_ties_may_have_passes(block_folder: Path, tmp_path: Path) -> None:
    text = (block_folder / "case.toml").read_text(encoding="utf-8").replace('[ties]\nnetwork = "network.pvl"\n', "")
    waiting = block_folder / "waiting.toml"
    waiting.write_text(text, encoding="utf-8")
    call("project", "init", tmp_path / "waiting", "--case", waiting)
    with open_project(tmp_path / "waiting") as opened:
        assert len(opened.store.image_names()) == 10
    call("project", "init", tmp_path / "empty")
    refuses("what its images share, without any measure", call, "project", "add", tmp_path / "empty", waiting)


def test_a_case_of_an_image_alone_joins_a_pass(block_folder: Path, tmp_path: Path) -> None:
    """What its case says of mountings can't be kept without measures, and is not dropped without a word."""
    project, ties = tmp_path / "project", block_folder / "network.pvl"
    call("project", "init", project, "--case", block_folder / "case.toml")
    call("project", "remove", project, LAST)
    isd = block_folder / f"{LAST.replace('/', '_')}.isd"
    text = f'format = 1\nname = "alone"\n[[images]]\nname = "{LAST}"\nimage = "{isd}"\n'
    alone, mounted = tmp_path / "alone.toml", tmp_path / "mounted.toml"
    alone.write_text(text, encoding="utf-8")
    mounted.write_text(f'{text}[[mountings]]\ncamera = ["{LAST}"]\nboresight_sigma_mrad = 1.0\n', encoding="utf-8")
    with pytest.raises(InputError, match="mountings: what its images share, without any measure"):
        call("project", "add", project, mounted, "--ties", ties, "--pass", "HRSC/01")
    refuses("--pass for its images", call, "project", "add", project, block_folder / "case.toml", "--pass", "HRSC/01")
    call("project", "add", project, alone, "--ties", ties, "--pass", "HRSC/01")
    with open_project(project) as opened:
        assert opened.store.definitions().passes["HRSC/01"].images[-1] == LAST
