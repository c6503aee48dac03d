"""What a network says besides what an adjustment needs: it comes back in the network that is exported, or is missed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

import mgsgraph
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.export.isis import adjusted_network
from mgsgraph.export.network_content import with_content
from mgsgraph.export.solution_export import ExportSettings, export_solution
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import AprioriSource, ControlMeasure, ControlNetwork, ControlPoint, MeasureType
from mgsgraph.project.changes import create_project, solve_project
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import results_of
from mgsgraph.results.results import write_results

OF_ADJUSTMENT = {"line_residual": None, "sample_residual": None, "jigsaw_rejected": False}


def furnished(network: ControlNetwork) -> ControlNetwork:
    """The network with all that matching programs say of points and measures; the last point is ignored, and the first
    has an ignored measure, by which another image was tried.
    """

    def measure(i: int, k: int, one: ControlMeasure) -> ControlMeasure:
        assert one.line is not None
        assert one.sample is not None
        line_sigma, sample_sigma = (0.25, 0.5) if i % 2 else (None, None)
        return structs.replace(
            one, type=MeasureType((i + k) % 4), chooser_name=f"chooser{k}", date_time="2001-02-03T04:05:06",
            edit_lock=k == 1, diameter=3.5 if k else None, apriori_line=one.line + 1.25, log=((2, 0.5 + 0.01 * i),),
            apriori_sample=one.sample - 2.5, line_sigma=line_sigma, sample_sigma=sample_sigma,
        )  # fmt: skip

    def point(i: int, one: ControlPoint) -> ControlPoint:
        measures = tuple(measure(i, k, seen) for k, seen in enumerate(one.measures))
        if i == 0:
            measures = (structs.replace(measures[0], ignore=True, line=77.0), *measures)
        return structs.replace(
            one, measures=measures, chooser_name="autoseed", date_time="2001", reference=1, edit_lock=i == 3,
            apriori_source=AprioriSource.USER, apriori_source_file="base.cub", apriori=(1.0 + i, 2.0, 3.39e6),
            ignore=i == len(network.points) - 1,
        )  # fmt: skip

    points = tuple(point(i, one) for i, one in enumerate(network.points))
    return structs.replace(
        network, points=points, network_id="of_old", created="2001-01-01T00:00:00", description="Of old",
        user_name="somebody", target_name="Mars",
    )  # fmt: skip


@pytest.fixture
def case(case_file: Path) -> Case:
    path = case_file.with_name("network.pvl")
    write_pvl_network(furnished(read_network(path)), path)
    return mgsgraph.read_case(case_file)


@pytest.fixture
def results(case: Case, tmp_path: Path) -> Path:
    solution = mgsgraph.adjust(case)
    write_results(solution, tmp_path / "results", figures=False, case=case.path, networks=case.networks)
    return tmp_path / "results"


def as_adjusted(point: ControlPoint) -> ControlPoint:
    """Without what an adjustment says of it."""
    measures = tuple(
        structs.replace(one, **OF_ADJUSTMENT, line_sigma=None, sample_sigma=None) for one in point.measures
    )
    return structs.replace(point, measures=measures, adjusted=None, adjusted_covariance=(), jigsaw_rejected=False)


def test_everything_comes_back(results: Path, case: Case, tmp_path: Path) -> None:
    done = export_solution(results, "isis", tmp_path / "out")
    source, written = read_network(case.networks[0]), read_network(tmp_path / "out" / "network.net")
    n = len(source.points)

    assert [as_adjusted(one) for one in written.points[:n]] == [as_adjusted(one) for one in source.points]
    assert len(written.points) == n + 8  # and the laser's footprints
    for i, (old, new) in enumerate(zip(source.points, written.points, strict=False)):
        assert (new.adjusted is None) == old.ignore
        for before, after in zip(old.measures, new.measures, strict=True):
            idle = old.ignore or before.ignore
            assert (after.line_residual is None) == idle
            stated = (0.25, 0.5) if i % 2 else (None, None) if idle else (1.0, 1.0)
            assert (after.line_sigma, after.sample_sigma) == stated
    assert (written.network_id, written.created, written.target_name) == ("of_old", source.created, "Mars")
    assert written.description.startswith("Of old. Adjusted by mgsgraph")
    kept, sigmas, *rest = done.notes
    counts = [int(found) for found in re.findall(r"(\d+) (?:Cand|Man|Registered)", kept)]
    assert sum(counts) == sum(not one.ignore for point in source.points[:-1] for one in point.measures)
    assert str(case.networks[0]) in kept
    assert re.search(r"\d+ measures without a sigma", sigmas)
    assert "1 point and 1 measure" in rest[-1]
    assert json.loads((tmp_path / "out" / "export.json").read_text())["notes"] == list(done.notes)


def test_what_is_exported_may_be_adjusted_and_exported_again(results: Path, case: Case, tmp_path: Path) -> None:
    export_solution(results, "isis", tmp_path / "out")
    with pytest.raises(InputError, match=r"each id once; name .*/out/network_without_laser\.net, or"):
        mgsgraph.read_case(case.path, ties=tmp_path / "out" / "network.net")
    again = mgsgraph.read_case(case.path, laser=False, ties=tmp_path / "out" / "network_without_laser.net")
    plain = mgsgraph.read_case(case.path, laser=False)
    np.testing.assert_array_equal(again.network.rays.places, plain.network.rays.places)
    write_results(mgsgraph.adjust(again), tmp_path / "second", figures=False, networks=again.networks)
    export_solution(tmp_path / "second", "isis", tmp_path / "again")

    first, second = (read_network(tmp_path / name) for name in ("out/network_without_laser.net", "again/network.net"))
    assert [as_adjusted(one) for one in first.points] == [as_adjusted(one) for one in second.points]
    assert second.description.count("Adjusted by") == 1


def test_a_network_that_is_gone_or_changed_is_missed(results: Path, case: Case, tmp_path: Path) -> None:
    path = case.networks[0]
    moved = path.rename(tmp_path / "moved.pvl")
    gone = export_solution(results, "isis", tmp_path / "out")
    written = read_network(tmp_path / "out" / "network.net")
    path.write_text(moved.read_text() + "\n")
    changed = export_solution(results, "isis", tmp_path / "out")

    for done in (gone, changed):
        assert [note for note in done.notes if str(path) in note and "--ties" in note] == list(done.notes)
    assert written.points[0].measures[0].type == MeasureType.REGISTERED_SUBPIXEL
    assert written.points[0].measures[0].log == ()
    named = export_solution(results, "isis", tmp_path / "out", ExportSettings(networks=(moved,)))
    assert str(moved) in named.notes[0]
    assert read_network(tmp_path / "out" / "network.net").points[0].measures[0].log
    foreign = structs.replace(read_network(moved), points=(ControlPoint("X", read_network(moved).points[0].type),))
    write_pvl_network(foreign, moved)
    with pytest.raises(InputError, match="none of the points that were adjusted"):
        export_solution(results, "isis", tmp_path / "out", ExportSettings(networks=(moved,)))


def test_a_project_remembers_its_networks(case: Case, tmp_path: Path) -> None:
    create_project(tmp_path / "project", "p", case.path)
    with open_project(tmp_path / "project", write=True) as project:
        assert project.networks == (case.networks[0].resolve(),)
        solve_project(project, figures=False)
    done = export_solution(results_of(tmp_path / "project").folder, "isis", tmp_path / "out")

    assert str(case.networks[0]) in done.notes[0]
    mine = {one.id: one for one in read_network(tmp_path / "out" / "network.net").points}
    for old in read_network(case.networks[0]).points:
        assert as_adjusted(mine[old.id]) == as_adjusted(old)


def test_other_images_and_other_places_are_said(case: Case) -> None:
    solution: Solution = mgsgraph.adjust(case)
    source = read_network(case.networks[0])
    first, second, *others = source.points
    stray = structs.replace(first.measures[0], serial_number="SIM/X")
    moved = structs.replace(second.measures[0], line=(second.measures[0].line or 0.0) + 0.5)
    far = structs.replace(first, id="far", measures=(stray,), reference=0)
    source = structs.replace(source, points=(
        structs.replace(first, measures=(stray, *first.measures), reference=0),
        structs.replace(second, measures=(moved, *second.measures[1:])), *others, far,
    ))  # fmt: skip

    made = with_content(adjusted_network(solution), source, set(solution.network.image_names))

    points = {one.id: one for one in made.network.points}
    assert [one.serial_number for one in points[first.id].measures] == ["SIM/A", "SIM/A", "SIM/B"]
    assert points[first.id].reference is not None
    assert points[second.id].measures[0].line == second.measures[0].line
    assert "far" not in points
    said = " ".join(made.notes)
    assert "1 measure with other coordinates" in said
    assert "2 measures in images" in said
    assert "1 point that none" in said
