"""A region divided into connected groups, adjusted as projects that grow: killed, continued, nothing done twice."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from outside import refuses
from projects import files_of

from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import read_case
from mgsgraph.files.networks.binary import read_network
from mgsgraph.network.connectivity import connectivity, network_footprints
from mgsgraph.project.campaign import RECORD, run_campaign
from mgsgraph.project.project import open_project
from mgsgraph.project.regions import split_case
from mgsgraph.results.results import Overrides
from mgsgraph.simulation.archive import archive_settings, lay_out
from mgsgraph.simulation.archive_files import write_archive

PROJECTS = Overrides(figures=False, projects=True)


@pytest.fixture(scope="module")
def region(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Case of 20 images, each with a laser profile."""
    return write_archive(lay_out(archive_settings("region", 20, 100), seed=30), tmp_path_factory.mktemp("region"))


def without(case: Path, name: str, pattern: str) -> Path:
    """The case beside it without the tables in which a pattern occurs."""
    tables = re.split(r"\n(?=\[)", case.read_text(encoding="utf-8"))
    path, left = case.with_name(name), [table for table in tables if not re.search(pattern, table)]
    path.write_text("\n".join(left), encoding="utf-8")
    return path


def test_groups_are_the_parts_of_the_network(region: Path, tmp_path: Path) -> None:
    division, whole = split_case(region, tmp_path / "sites"), read_case(region).network

    islands = connectivity(whole, network_footprints(whole, whole.points.places)).islands
    named = {frozenset(whole.images[j].name for j in island) for island in islands if len(island) > 1}
    assert {frozenset(images) for images in division.groups.values()} == named
    assert len(division.groups) > 2
    parts = [read_case(tmp_path / "sites" / folder / "case.toml").network for folder in division.groups]
    for kind in ("rays", "ranges"):
        assert sum(getattr(part, kind).point.size for part in parts) == getattr(whole, kind).point.size
    before = files_of(tmp_path / "sites")
    assert split_case(region, tmp_path / "sites") == division
    assert files_of(tmp_path / "sites") == before


def test_without_ties_footprints_connect(region: Path, tmp_path: Path) -> None:
    division = split_case(without(region, "bare.toml", r"\[ties\]"), tmp_path)
    measured = split_case(region, tmp_path / "measured")

    assert not division.measured
    for images in measured.groups.values():  # a tie point is where footprints overlap
        assert any(set(images) <= set(others) for others in division.groups.values())
    first = decode(tmp_path / next(iter(division.groups)) / "case.toml")
    assert first.tie_groups[0].network == "matches/network.pvl"
    assert len(first.shots) == len(first.images)


def test_what_belongs_to_all_images_and_files_of_others_are_refused(region: Path, tmp_path: Path) -> None:
    shared = region.with_name("shared.toml")
    shared.write_text(region.read_text(encoding="utf-8") + '[[shared]]\nkind = "range bias"\nsigma_m = 1.0\n', "utf-8")
    refuses(r"shared\.toml, shared: ", split_case, shared, tmp_path)
    folder = next(iter(split_case(region, tmp_path / "other").groups))
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "case.toml").write_text("mine", encoding="utf-8")
    refuses(f"{folder}/case.toml: .*--out", split_case, region, tmp_path)


def test_groups_that_an_image_connects_become_one(region: Path, tmp_path: Path) -> None:
    """As where the network lacks what connects them at first."""
    (tmp_path / "REG-other").mkdir()
    (tmp_path / "REG-other" / "case.toml").write_text("# Written by `mgsgraph split` of case.toml", encoding="utf-8")
    assert split_case(region, tmp_path).merged == ("REG-other",)
    assert not (tmp_path / "REG-other" / "case.toml").exists()


def test_a_killed_batch_goes_on_and_its_projects_grow(region: Path, tmp_path: Path) -> None:
    sites, out = tmp_path / "sites", tmp_path / "out"
    division = split_case(region, sites)
    folder, images = next(iter(division.groups.items()))
    split_case(without(region, "first.toml", f'= "{images[-1]}"'), sites)
    command = [sys.executable, "-m", "mgsgraph", "batch", sites, "--out", out, "--projects", "--no-figures"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as running:
        while running.poll() is None and not ((out / RECORD).exists() and (out / RECORD).read_bytes().count(b"\n") > 1):
            time.sleep(0.05)
        running.kill()

    done = run_campaign([sites], out, PROJECTS)
    assert len(done.kept) >= 1
    assert done.count("done") == len(division.groups)
    assert {path.name for path in out.iterdir()} == {RECORD, *division.groups}
    split_case(region, sites)
    grown = run_campaign([sites], out, PROJECTS)
    assert len(grown.kept) == len(division.groups) - 1
    with open_project(out / folder) as project:
        assert set(project.store.image_names()) == set(images)
        assert [change.verb for change in project.changes()][-2:] == ["add", "solve"]
    assert read_network(next((sites / folder).glob("ties_1/*"))).points


def test_a_project_does_not_take_other_settings(region: Path, tmp_path: Path) -> None:
    sites, out = tmp_path / "sites", tmp_path / "out"
    split_case(region, sites)
    case = sorted(sites.glob("*/case.toml"))[0]
    run_campaign([case], out, PROJECTS)
    case.write_text(case.read_text(encoding="utf-8").replace("sigma_m = 30.0", "sigma_m = 20.0"), encoding="utf-8")
    (entry,) = run_campaign([case], out, PROJECTS).entries
    assert entry.status == "failed"
    assert str(case) in entry.message
