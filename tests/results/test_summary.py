"""A solution, its connections, and a case to be matched in words: a finding is said when it is there, and only then."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import rows_of
from networks import network, pair
from outside import refuses
from sites import plain_site
from support_data import edited

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.residual_spectrum import residual_vibrations
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.analysis.verdict import Cause, verdict
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.errors import Unmeasured
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.footprint import Footprint
from mgsgraph.network import ImageRays, Network, PointClass
from mgsgraph.network.connectivity import (
    Connectivity,
    connectivity_json,
    connectivity_statements,
)
from mgsgraph.network.parts import select_points
from mgsgraph.results.archive import read_solution
from mgsgraph.results.inventory import images_inventory
from mgsgraph.results.results import solution_json, statements, summary_table, write_results
from mgsgraph.results.summary import points_in_words, summary
from mgsgraph.results.tables import connectivity_table
from mgsgraph.results.verdict import drivers_section, reading_statements
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

LRO = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"


def without(network: Network, *classes: PointClass) -> Network:
    """The network without the points of some classes."""
    return select_points(network, np.flatnonzero(~np.isin(network.points.classes, classes)))


def said(solution: Solution, *words: str) -> str:
    """The one sentence that holds all the words."""
    found = [sentence for sentence in statements(solution) if all(word in sentence for word in words)]
    assert len(found) == 1, statements(solution)
    return found[0]


def test_ending_in_words(solution: Solution) -> None:
    assert "Converged" in said(solution, "cost went from", "iterations")
    failed = replace(solution, converged=False, message="Stopped after 3 iterations without converging; raise it.")
    assert "NOT CONVERGED" in summary_table(failed)
    assert summary(failed)[0].count("INVALID, NOT CONVERGED") == 1
    assert any("Stopped after 3 iterations" in line for line in summary(failed)[1:3])


def test_the_verdict_comes_first_in_few_lines(solution: Solution) -> None:
    lines = summary(solution)
    assert lines[0].startswith(f"{solution.name}: valid")
    assert len(lines) <= 15
    assert all(line.startswith("- ") for line in lines[1:])
    assert "nan" not in " ".join(lines)
    fit = replace(solution.fit, squares=0.1**2 * solution.fit.degrees_of_freedom)
    (merit,) = [line for line in summary(replace(solution, fit=fit)) if "sigma0" in line]
    assert "10 times smaller" in merit
    none = replace(solution.fit, unknowns=solution.fit.observations)
    assert any("Nothing was tested" in line for line in summary(replace(solution, fit=none)))


def test_laser_in_words(solution: Solution, case: Case) -> None:
    sentence = said(solution, "(12 points, 24 rays, 12 ranges)", "times larger")
    assert f", not {', '.join(f'{x:.3g}' for x in np.median(solution.sigmas[:40], axis=0))} m" in sentence
    alone = adjust_network(without(case.network, PointClass.LASER), case.settings)
    assert said(alone, "30 m, 20.6 arcsec")
    points = case.network.points
    control = replace(points, classes=np.where(points.classes == PointClass.LASER, PointClass.CONTROL, points.classes))
    controlled = adjust_network(replace(case.network, points=control), case.settings)
    assert not any("20.6 arcsec" in s or "12 ranges" in s for s in statements(controlled))
    assert "control" in summary_table(controlled)


def test_known_points_of_a_network_are_control_points_in_words(solution: Solution) -> None:
    kinds = np.where(np.arange(52) < 3, PointKind.CONSTRAINED, solution.network.points.kinds)
    points = replace(solution.network.points, kinds=kinds, places=solution.places,
                     covariances=np.where((kinds != PointKind.FREE)[:, None, None], np.eye(3), 0.0))  # fmt: skip
    of_words = {each.name: members.size for each, members in points_in_words(replace(solution.network, points=points))}
    assert of_words == {"TIE": 37, "LASER": 12, "CONTROL": 3}


def test_losses_in_words(lossy: Solution) -> None:
    assert said(lossy, "1 point of 52 took no part", lossy.network.points.ids[1])
    assert said(lossy, "2 of 103 image points and 0 of 12 ranges", f"({lossy.network.points.ids[2]})")
    assert said(lossy, "1 point lost all rays", lossy.network.points.ids[2])
    assert any("100 image points" in line for line in summary(lossy))
    # a point that keeps one ray after the rejection of the other has no place for that reason, not by its rays
    one, place = np.arange(103) == np.flatnonzero(lossy.network.rays.point == 3)[0], np.arange(52) != 3
    used, marked = lossy.rays_used & place[lossy.network.rays.point], lossy.rays_rejected | one
    half = replace(lossy, determined=lossy.determined & place, rays_used=used, rays_rejected=marked)
    assert said(half, "1 point of 52 took no part", lossy.network.points.ids[1])
    assert said(half, "2 points lost all", lossy.network.points.ids[3])
    assert "nan" not in " ".join(statements(lossy))


def test_islands_in_words(case: Case) -> None:
    """Laser points have places of their own, so that images without common points still have an adjustment."""
    network = without(case.network, PointClass.TIE)
    first = network.rays.image == (network.rays.point >= 6)
    r = network.rays
    parted = replace(network, rays=ImageRays(r.point[first], r.image[first], r.places[first], r.sigmas[first]))
    solved = adjust_network(parted, case.settings)
    assert said(solved, "split into 2 parts", "(SIM/A), (SIM/B)")
    assert solution_json(solved)["islands"] == [["SIM/A"], ["SIM/B"]]
    assert solution_json(solved)["laser_effect"] is None


def test_real_case_in_words(solution: Solution, shared_data: Path) -> None:
    """What is known of this data set: trap 4 in its README, a constant offset of the stored measures."""
    case = read_case(LRO)
    lro = adjust(case)
    case.require_images_of(lro)
    refuses("expected those of the solution, such as SIM/A", case.require_images_of, solution)
    found = [one.size for one in verdict(lro).of(Cause.OFFSET) if "laser" in one.what]
    assert sorted(found) == pytest.approx([-2.2, 2.2], abs=0.05)
    assert residual_vibrations(lro).vibrations == ()  # field case 11: samples have no redundancy
    assert said(lro, "(52 points, 104 rays, 52 ranges)", "55.4, 206, 357 m", "24 times larger")
    assert len(summary(lro)) <= 15
    assert max(map(len, summary_table(lro).splitlines())) <= 110


def test_each_remark_is_said_once_with_its_images() -> None:
    net = network(pair())
    assert reading_statements(net.images) == []
    first, second, *others = net.images
    images = (replace(first, remarks=("one", "two")), replace(second, remarks=("two",)), *others)

    one, two = reading_statements(images)
    assert one.endswith(f"{first.name}: one.")
    assert two.endswith(f"{first.name}, {second.name}: two.")


def test_what_drives_an_adjustment_that_stopped_is_in_every_form_of_its_results(tmp_path: Path) -> None:
    stopped, done = (adjust_network(network(pair()), SolverSettings(max_iterations=most)) for most in (1, 50))
    assert "drivers.csv" in write_results(stopped, tmp_path / "result", figures=False)
    rows = rows_of(tmp_path / "result" / "drivers.csv")
    assert solution_json(stopped)["drivers"]["cost"] == pytest.approx(stopped.cost_final, rel=1e-6)
    assert {row["name"] for row in rows if row["kind"] == "image"} <= set(stopped.network.image_names)
    shares = [float(row["share"]) for row in rows if (row["quantity"], row["kind"]) == ("cost", "image")]
    assert sum(shares) <= 1.0 + 1e-12
    assert drivers_section(stopped).sentences[0] in statements(stopped)
    assert drivers_section(read_solution(tmp_path / "result")).numbers == drivers_section(stopped).numbers
    assert "drivers.csv" not in write_results(done, tmp_path / "done", figures=False)
    assert solution_json(done)["drivers"] is None


# --- how images are connected


def box(name: str, west: float) -> Footprint:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * DEG
    corners[:, 0] += west * DEG
    return Footprint(name, from_planetocentric(np.column_stack([corners, np.full(5, MARS.equatorial)])), MARS)


def block() -> Connectivity:
    """Seven images: 0-1-2 a triangle, 2-3 a bridge, 4-5 an island, 6 alone; 5 and 6 overlap; 0 and 3 lie apart."""
    pairs = np.array([[0, 1], [0, 2], [1, 2], [2, 3], [4, 5], [5, 6]])
    tie = [30, 20, 25, 3, 8, 0]
    return Connectivity(
        footprints=tuple(box(f"I{j}", west) for j, west in enumerate((0.0, 0.1, 0.2, 5.0, 9.0, 9.1, 9.5))),
        seen=np.full(7, 40),
        pairs=pairs,
        common=np.column_stack([tie, [0, 0, 1, 0, 0, 0], np.zeros(6, dtype=int)]),
        areas=np.array([9.0, 8.0, 9.0, 0.0, 9.0, 5.0]) * 1e8,
        shares=np.array([0.9, 0.8, 0.9, 0.0, 0.9, 0.6]),
        gaps=np.array([0.0, 0.0, 0.0, 2.2e5, 0.0, 0.0]),
        islands=((0, 1, 2, 3), (4, 5), (6,)),
        bridges=np.array([False, False, False, True, True, False]),
        spine=np.array([3, 4, 2, 0]),
    )


def test_plain_values_of_a_block() -> None:
    record = connectivity_json(block())
    assert record["links"] == 5
    assert [pair["images"] for pair in record["bridges"]] == [["I2", "I3"], ["I4", "I5"]]
    assert record["weakest_joints"][0] == {
        "images": ["I2", "I3"], "common_points": 3, "overlap_km2": 0.0, "overlap_share": 0.0, "gap_km": 220.0,
    }
    assert record["unconnected_images"] == ["I6"]
    assert [one["images"] for one in record["overlaps_without_common_points"]] == [["I5", "I6"]]
    thin = replace(block(), shares=np.array([0.9, 0.8, 0.9, 0.0, 0.9, 0.01]))  # slivers are not worth ties
    assert connectivity_json(thin)["overlaps_without_common_points"] == []


def test_rejected_points_do_not_hold_the_block(pair_solution: Solution) -> None:
    (whole,) = connectivity_statements(solution_connectivity(pair_solution))
    assert whole.startswith("SIM/A and SIM/B have 28 points in common and overlap by ")
    lost = replace(pair_solution, rays_used=pair_solution.rays_used & (pair_solution.network.rays.image == 0))
    assert "split into 2 parts" in " ".join(connectivity_statements(solution_connectivity(lost)))


def test_table_of_a_block(tmp_path: Path) -> None:
    connectivity_table(block()).write_csv(tmp_path / "c.csv")
    rows = rows_of(tmp_path / "c.csv")
    assert [(row["image_a"], row["image_b"], row["common_points"]) for row in rows[:3]] == [
        ("I0", "I1", "30"), ("I0", "I2", "20"), ("I1", "I2", "26"),
    ]  # fmt: skip
    assert [row["remark"] for row in rows] == [
        "", "", "", "bridge, common points without overlap", "bridge", "overlap without common points",
    ]  # fmt: skip
    assert (rows[2]["tie_points"], rows[2]["laser_points"], rows[2]["control_points"]) == ("25", "1", "0")
    assert (float(rows[0]["overlap_km2"]), float(rows[3]["gap_km"])) == (900.0, 220.0)


# --- `check` of cases whose tie points are still to be matched


@pytest.fixture(scope="module")
def site_case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(plain_site(), tmp_path_factory.mktemp("site") / "gusev")


def changed(case: Path, name: str, old: str, new: str) -> Path:
    text = case.read_text()
    assert old in text
    path = case.with_name(f"{name}.toml")
    path.write_text(text.replace(old, new))
    return path


def test_a_network_that_match_will_write(site_case: Path) -> None:
    """The folder of MATCHES isn't there yet; where it is, a missing file is a wrong path."""
    said = images_inventory(changed(site_case, "later", "network.pvl", "matches/network.pvl"))
    assert said is not None
    assert "matches/network.pvl" in said
    assert "Ready for match: 2 images with pixels, 1 overlap" in said
    assert f"mgsgraph match {site_case.with_name('later.toml')} --out {site_case.parent / 'matches'}" in said
    assert images_inventory(changed(site_case, "typo", "network.pvl", "netwrk.pvl")) is None
    assert images_inventory(site_case) is None


def test_a_case_of_which_reading_finds_no_measure(site_case: Path) -> None:
    found = Unmeasured(str(site_case), "no point is measured in it")
    bare = changed(site_case, "bare", '[ties]\nnetwork = "network.pvl"\nsigma_px = 1.0\n', "")
    said = images_inventory(bare, found)
    assert said is not None
    assert "Ready for match" in said
    refuses("no point is measured", images_inventory, site_case, found)


EQUATOR, SOUTH = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 1, 0, 1, 0, -1, 0, 0]
"""Turns of the body that bring longitude 0 or the south pole under the camera of `support_data`."""


@pytest.mark.parametrize(
    ("turn", "middle", "longitudes"), [(EQUATOR, 0.0, (359.99, 0.01)), (SOUTH, -90.0, (0.0, 360.0))]
)
def test_boxes_of_images(turn: list[float], middle: float, longitudes: tuple[float, float], tmp_path: Path) -> None:
    """Of `check`, the middle inside: an image over a pole has all longitudes and the pole."""
    isd = edited(("body_rotation", "constant_rotation"), turn)
    down = [0.0, np.sqrt(0.5), 0.0, -np.sqrt(0.5)]
    isd = edited(("instrument_pointing", "quaternions"), [down] * 3, isd)
    (tmp_path / "a.isd").write_text(json.dumps(edited(("naif_keywords",), {}, isd)))
    case = tmp_path / "case.toml"
    image = '[[images]]\nimage = "a.isd"\nname = "A"\naberration = "NONE"\n'
    sigmas = "[orientation]\ndegree = 1\nposition_sigma_m = 50.0\nangle_sigma_mrad = 1.0\n"
    case.write_text(f'format = 1\nname = "a"\nlaser = false\n{image}{sigmas}')
    said = images_inventory(case)
    assert said is not None
    row = next(line.split() for line in said.splitlines() if line.startswith("  A "))
    west, east, south, north = map(float, row[5:9])
    assert (west, east) == pytest.approx(longitudes, abs=0.01)
    assert south <= middle <= north <= south + 0.15
