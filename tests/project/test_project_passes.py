"""Projects with passes, as a person uses them: what is solved is what `adjust` finds, whatever came and went."""

import re
from pathlib import Path

import numpy as np
import pytest
from commands import call
from strip_files import block, write_block

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.project.project import open_project
from mgsgraph.results.archive import read_solution

LAST = "HRSC/01/S2"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("block")
    write_block(path)
    return path


@pytest.fixture(scope="module")
def batch(folder: Path) -> Solution:
    case = mgsgraph.read_case(folder / "case.toml")
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


def added(project: Path, folder: Path, *options: str) -> int:
    """The last image joins its pass again, with the ties that others measure, too."""
    isd = f"{LAST}={folder / LAST.replace('/', '_')}.isd"
    return call("add", project, isd, "--ties", folder / "network.pvl", "--pass", "HRSC/01", *options)


def test_solve_is_adjust_and_an_image_comes_back(
    folder: Path, batch: Solution, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = tmp_path / "project"
    assert call("init", project, "--case", folder / "case.toml") == 0
    assert call("solve", project, "--no-figures") == 0
    assert_same(project, batch)
    assert call("remove", project, LAST) == 0
    capsys.readouterr()
    assert added(project, folder) == 0
    said = capsys.readouterr().out
    assert re.search(r" orientation images? reached; most moved is -?\d+\.\d{3} s of HRSC/0[01]", said)
    assert call("status", project) == 0
    said = capsys.readouterr().out
    nodes = len(batch.network.passes[1].nodes)
    assert f"pass HRSC/01: 5 images, {nodes} orientation images" in said
    assert call("solve", project, "--no-figures") == 0
    assert "Closing check against batch: the same" in capsys.readouterr().out
    with open_project(project) as opened:
        assert set(opened.store.image_names()) == {image.name for image in block().network.images}
    assert_same(project, batch)


def test_an_image_file_joins_a_pass_by_option(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = tmp_path / "project"
    call("init", project, "--case", folder / "case.toml")
    call("remove", project, LAST)
    isd = f"{LAST}={folder / LAST.replace('/', '_')}.isd"
    with pytest.raises(InputError, match="no pass 'x'; expected one that is there"):
        call("add", project, isd, "--ties", folder / "network.pvl", "--pass", "x")
    call("add", project, isd, "--ties", folder / "network.pvl", "--dry-run")
    assert "--pass 'HRSC/01' puts it on that trajectory" in capsys.readouterr().out
    added(project, folder)
    with open_project(project) as opened:
        known = opened.store.definitions().passes["HRSC/01"]
        assert known.images[-1] == LAST
        assert len(opened.store.network().passes[1].images) == 5


def test_a_case_that_waits_for_ties_may_have_passes(folder: Path, tmp_path: Path) -> None:
    text = (folder / "case.toml").read_text(encoding="utf-8").replace('[ties]\nnetwork = "network.pvl"\n', "")
    waiting = folder / "waiting.toml"
    waiting.write_text(text, encoding="utf-8")
    call("init", tmp_path / "waiting", "--case", waiting)
    with open_project(tmp_path / "waiting") as opened:
        assert len(opened.store.image_names()) == 10
    call("init", tmp_path / "empty")
    with pytest.raises(InputError, match="what its images share, without any measure"):
        call("add", tmp_path / "empty", waiting)


def test_a_case_of_an_image_alone_joins_a_pass(folder: Path, tmp_path: Path) -> None:
    """What its case says of mountings can't be kept without measures, and is not dropped without a word."""
    project, ties = tmp_path / "project", folder / "network.pvl"
    call("init", project, "--case", folder / "case.toml")
    call("remove", project, LAST)
    text = f'format = 1\nname = "alone"\n[[images]]\nname = "{LAST}"\nimage = "{folder / LAST.replace("/", "_")}.isd"\n'
    alone, mounted = tmp_path / "alone.toml", tmp_path / "mounted.toml"
    alone.write_text(text, encoding="utf-8")
    mounted.write_text(f'{text}[[mountings]]\ncamera = ["{LAST}"]\nboresight_sigma_mrad = 1.0\n', encoding="utf-8")
    with pytest.raises(InputError, match="mountings: what its images share, without any measure"):
        call("add", project, mounted, "--ties", ties, "--pass", "HRSC/01")
    with pytest.raises(InputError, match="--pass for its images"):
        call("add", project, folder / "case.toml", "--pass", "HRSC/01")
    call("add", project, alone, "--ties", ties, "--pass", "HRSC/01")
    with open_project(project) as opened:
        assert opened.store.definitions().passes["HRSC/01"].images[-1] == LAST
