"""Passes in reports: course and sigmas along time; figures of merit of two steps, heights by cell, tables and map."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import call, rows_of
from mex import CHANGES
from networks import network, pair, with_shift_and_surface
from pass_files import block, write_block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.frames import flight_frame
from mgsgraph.adjustment.settings import Angles, SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.adjustment.two_steps import adjust_in_two_steps
from mgsgraph.analysis.spacing import respaced
from mgsgraph.analysis.statistics import node_times, pass_corrections, pass_reports
from mgsgraph.analysis.two_step_statistics import TwoStepStatistics, owners, two_step_statistics
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.network.joining import seconds
from mgsgraph.results.archive import read_solution
from mgsgraph.results.figures.dem import height_map_sheets
from mgsgraph.results.figures.orientation import pass_curve
from mgsgraph.results.inventory import unsupported_nodes
from mgsgraph.results.passes import calendar, nodes_table
from mgsgraph.results.results import write_results
from mgsgraph.results.two_steps import (
    write_two_steps,
)
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.observations import TerrainErrors
from mgsgraph.units import ARCSEC, MGON


@pytest.fixture(scope="module")
def solution() -> Solution:
    return adjust_network(respaced(block().network, 3.0), SolverSettings(), "block")


# --- the course


@pytest.mark.parametrize("angles", ["opk-paper", "opk-peer"])
def test_the_course_is_what_each_image_has(angles: Angles) -> None:
    """Lengths of corrections, and sums of variances, are those of the images' own profiles, whatever the axes."""
    solved = adjust_network(respaced(block().network, 3.0), SolverSettings(angles=angles), "block")
    for image in (0, 2, 9):
        profile = orientation_profile(solved, image, 7)
        course = pass_corrections(solved, image // 5, profile.times)
        for part, correction, sigma in (
            (slice(0, 3), profile.position_after - profile.position_before, profile.position_sigma),
            (slice(3, 6), profile.rotation, profile.rotation_sigma),
        ):
            for ours, theirs in ((course.values[:, part], correction), (course.sigmas[:, part], sigma)):
                np.testing.assert_allclose(np.linalg.norm(ours, axis=1), np.linalg.norm(theirs, axis=1), rtol=1e-3)


def test_axes_are_those_of_the_analysis(solution: Solution) -> None:
    """Roll, pitch and yaw, along, across and radial, in the middle of an image: `datum.frames` finds the same."""
    for number, image in ((0, 2), (1, 7)):
        picture = solution.network.images[image]
        middle = picture.moments(np.array([0.5 * picture.lines]))
        course = pass_corrections(solution, number, middle.times + middle.epoch)
        correction, _ = solution.correction(image).at(middle)
        np.testing.assert_allclose(course.values, correction @ flight_frame(picture).turn.T, rtol=1e-6, atol=1e-9)


def test_course_and_truth_agree_within_sigmas(solution: Solution) -> None:
    """84 corrections at nodes, with those of the true trajectory."""
    errors = []
    for k in range(2):
        times = node_times(solution, k)
        truth = replace(solution, nodes=tuple(block().corrections[5 * k].nodes.dense(
            times - block().corrections[5 * k].nodes.epoch, block().corrections[5 * k].nodes.epoch
        )[0] @ block().true_nodes(k) for k in range(2)))  # fmt: skip
        found, true = (pass_corrections(one, k, times) for one in (solution, truth))
        errors.append((found.values - true.values) / found.sigmas)
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 2.0


# --- tables


def test_report(solution: Solution) -> None:
    one, image = pass_reports(solution)[0], solution.network.images[2]
    start, stop = seconds(image)
    assert (one.name, one.images[2], one.nodes) == ("HRSC/00", "HRSC/00/ND", len(solution.network.passes[0].nodes))
    assert one.spacing == pytest.approx(np.diff(solution.network.passes[0].nodes.times)[0])
    assert one.lines == pytest.approx(one.spacing / (stop - start) * image.lines)
    middle = image.pose(np.array([0.5 * image.lines]))
    speed = np.linalg.norm(middle.velocity) * image.lines / (stop - start) * 3396e3 / np.linalg.norm(middle.position)
    assert one.ground == pytest.approx(speed * one.spacing, rel=0.03)
    assert [part[:2] for part in one.trend[:4]] == [("bias", "X"), ("bias", "Y"), ("bias", "Z"), ("bias", "rotation x")]
    assert [part[2] for part in one.trend] == solution.trends[0].tolist()
    first = int(solution.network.first_of_passes[1]) - 1
    variances = np.diagonal(solution.joint_covariance.block(first, first))
    np.testing.assert_allclose([part[3] for part in one.trend], np.sqrt(variances))


def test_csv_has_a_row_for_each_node(solution: Solution, tmp_path: Path) -> None:
    nodes_table(solution).write_csv(tmp_path / "passes.csv")
    rows = rows_of(tmp_path / "passes.csv")
    assert len(rows) == sum(len(pass_.nodes) for pass_ in solution.network.passes)
    assert [row["node"] for row in rows[:3]] == ["1", "2", "3"]
    for k, row in enumerate(rows[: len(solution.nodes[0])]):
        nodes = solution.network.passes[0].nodes
        assert float(row["time_et_s"]) == nodes.times[k] + nodes.epoch
        size = np.linalg.norm([float(row[f"correction_{name}_m"]) for name in ("along", "across", "radial")])
        assert size == pytest.approx(np.linalg.norm(solution.nodes[0][k, :3]))
        turn = np.linalg.norm([float(row[f"correction_{name}_arcsec"]) for name in ("roll", "pitch", "yaw")])
        assert turn * ARCSEC == pytest.approx(np.linalg.norm(solution.nodes[0][k, 3:]))
        assert min(float(row[name]) for name in row if name.startswith("sigma")) > 0.0


def test_calendar_is_tdb() -> None:
    """h5270 begins at 2008-02-08T12:08:53.843 UTC, which is 65.184 s behind."""
    assert calendar(CHANGES[0][0]) == "2008-02-08T12:09:59.027"
    assert calendar(-0.0004) == "2000-01-01T12:00:00.000"


def test_bare_nodes_are_counted() -> None:
    """Rays between the third and the fifth node are taken out: the fourth one has none; and none at the end."""
    net = block().network
    pass_ = net.passes[0]
    pass_ = replace(pass_, nodes=evenly_spaced("lagrange", pass_.nodes.epoch, pass_.nodes.coverage, 6.0))
    net = replace(net, passes=(pass_,), rays=net.rays.chosen(net.rays.image < 5))
    assert unsupported_nodes(net) == []
    times = np.empty(net.rays.point.size)
    for j in range(5):
        mine = net.rays.image == j
        times[mine] = net.images[j].timing.at(net.rays.places[mine, 0])[0]
    gone = (times > pass_.nodes.times[2]) & (times < pass_.nodes.times[4])
    (said,) = unsupported_nodes(replace(net, rays=net.rays.chosen(~gone)))
    assert said.startswith(f"pass HRSC/00: fewer than 3 rays near 1 of its {len(pass_.nodes)} nodes, between others")
    (said,) = unsupported_nodes(replace(net, rays=net.rays.chosen(times < pass_.nodes.times[-3])))
    assert said == "pass HRSC/00: no rays near 2 nodes at its ends: there it follows its prior"


def test_the_curve_passes_through_its_nodes(solution: Solution) -> None:
    drawn = pass_curve(solution, 1)
    assert drawn.node_shares[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-9)
    assert np.all(drawn.sigmas > 0.0)
    for curve, at in zip(drawn.values.T, drawn.node_values.T, strict=True):
        near = np.interp(drawn.node_shares, drawn.shares, curve)
        np.testing.assert_allclose(near, at, atol=max(0.1 * float(np.ptp(curve)), 1e-6))


@pytest.mark.usefixtures("light_figures")
def test_the_command_line_reports_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_block(tmp_path)
    nodes = len(block().network.passes[1].nodes)
    assert call("check", path, "--details") == 0
    said = capsys.readouterr().out
    assert "  pass HRSC/01\n" in said
    assert f", {nodes} orientation images (lagrange) every " in said
    assert call("adjust", path, "--out", tmp_path / "out", "--details") == 0
    said = capsys.readouterr().out
    assert re.search(rf"^  HRSC/01 +{nodes} ", said, re.MULTILINE)
    assert "(50 m, 91.2 arcsec)" in said  # 28 and 3 mgon together
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"passes.csv", "passes.png"} <= names
    assert not any(name.startswith("orientation") and name.endswith("png") for name in names)
    record = json.loads((tmp_path / "out" / "solution.json").read_text(encoding="utf-8"))["passes"][0]
    assert (record["images"][0], record["trend"][3]["component"]) == ("HRSC/00/S1", "rotation x")
    trend = read_solution(tmp_path / "out").trends[0]
    assert record["trend"][3]["value_arcsec"] * ARCSEC == pytest.approx(trend[3])


# --- figures of merit of two steps


TERRAIN = TerrainErrors(missing=0.02)


@cache
def merit(which: str) -> TwoStepStatistics:
    return two_step_statistics(adjust_in_two_steps(networks(which), SolverSettings(reject=4.0), which))


@cache
def networks(which: str) -> Network:
    if which == "pair":
        return with_shift_and_surface(network(pair(ties=40, shots=6)))
    settings = BlockSettings(passes=2, length=150e3, points=400, terrain=TERRAIN)
    return simulate_hrsc_block(settings, seed=3).network


# --- figures of merit


# above two seconds: adjusts a block in two steps, once for all tests here
@pytest.mark.parametrize("which", ["pair", "block"])
def test_the_whole_is_its_parts(which: str) -> None:
    found = merit(which)
    assert [group.name for group in found.groups] == [name for name, _ in owners(networks(which))]
    assert found.whole.points <= sum(group.points for group in found.groups)
    for group in (found.whole, *found.groups):
        assert np.all(group.mean[1] < group.mean[0])  # what an adjustment knows is no less than what each point knows
        assert np.all(group.poses[2] <= group.poses[0] * (1.0 + 1e-9))
    assert found.whole.heights.count == int(found.used.sum())
    np.testing.assert_allclose(found.whole.heights.rms, np.sqrt(np.mean(found.heights[:, found.used] ** 2, axis=1)))


@pytest.mark.parametrize("which", ["pair", "block"])
def test_sigmas_of_points_are_those_of_the_solutions(which: str) -> None:
    """Along the vertical of each point, whatever flew over it."""
    found, steps = merit(which), merit(which).steps
    ties = (steps.network.points.classes == PointClass.TIE) & steps.free.determined & steps.fitted.determined
    up = steps.fitted.places[ties] / np.linalg.norm(steps.fitted.places[ties], axis=1, keepdims=True)
    stages = (steps.rays_alone.nominal()[1], steps.free.covariances, steps.fitted.covariances)
    sigmas = [np.sqrt(np.einsum("ni,nij,nj->n", up, one[ties], up)) for one in stages]
    assert found.whole.points == int(ties.sum())
    np.testing.assert_allclose(found.whole.mean[:, 2], np.mean(sigmas, axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.whole.median[:, 2], np.median(sigmas, axis=1), rtol=1e-9)


def test_sigmas_of_the_orientation_are_those_of_the_nodes() -> None:
    """As `analysis.statistics.pass_corrections` has them at the nodes, between which they hardly change."""
    found, net = merit("block"), networks("block")
    means = np.empty((2, len(net.passes), 6))
    for step, solution in enumerate((found.steps.free, found.steps.fitted)):
        for k, pass_ in enumerate(net.passes):
            image = net.images[int(pass_.images[2])]
            nodes = pass_corrections(solution, k, node_times(solution, k))
            at = image.moments(np.linspace(0.0, float(image.lines), 101))
            times = at.times + at.epoch
            means[step, k] = [np.interp(times, nodes.times, nodes.sigmas[:, axis]).mean() for axis in range(6)]
            np.testing.assert_allclose(found.groups[k].poses[step + 1], means[step, k], rtol=0.01)
    np.testing.assert_allclose(found.whole.poses[1:], means.mean(axis=1), rtol=0.01)


def test_what_is_held_is_known_beforehand() -> None:
    """Without unknowns the orientation is not uncertain, and step 1 has nothing to add to the rays."""
    net = replace(networks("block"), passes=(), held=np.ones(10, dtype=bool))
    found = two_step_statistics(adjust_in_two_steps(net, SolverSettings()))
    assert np.all(found.whole.poses == 0.0)
    np.testing.assert_allclose(found.whole.mean[0], found.whole.mean[1], rtol=1e-9)
    assert np.all(found.whole.mean[2] < found.whole.mean[1])


def test_a_priori_attitude_is_the_settings() -> None:
    """28 mgon of bias, 3 of wander and a drift of 5 at the ends, whose mean over the pass is smaller."""
    found = merit("block").whole.poses[0, 3:] / MGON
    assert np.all(found > np.hypot(28.0, 2.0))
    assert np.all(found < np.sqrt(28.0**2 + 3.0**2 + 5.0**2))


def test_the_block_does_what_the_paper_says() -> None:
    whole = merit("block").whole
    assert np.all(whole.poses[1, 4:] < whole.poses[0, 4:] / 3.0)  # pitch and yaw come without the terrain
    assert whole.poses[1, 3] > 0.3 * whole.poses[0, 3]  # roll doesn't
    assert whole.mean[0, 2] > 1.3 * whole.mean[1, 2]
    assert np.all(np.diff(whole.heights.rms) < 0.0)


def test_heights_before_are_of_the_places_that_fit_the_images_best() -> None:
    """By Gauss-Newton on the pixels, with differences for derivatives, from where the rays come closest in space."""
    net, found = networks("block"), merit("block")
    assert net.surface is not None
    left_out = found.steps.free.rays_rejected
    assert left_out is not None
    rays = np.flatnonzero(~left_out)
    point, origins, directions = net.rays.point[rays], *np.empty((2, rays.size, 3))
    for j, image in enumerate(net.images):
        mine = net.rays.image[rays] == j
        origins[mine], directions[mine] = image.sightlines(*net.rays.places[rays[mine]].T)
    places, _, _ = intersect_rays(origins, directions, point, len(net.points))

    def misfit(at: Array) -> Array:
        result = np.empty((rays.size, 2))
        for j, image in enumerate(net.images):
            mine = net.rays.image[rays] == j
            measured = net.rays.places[rays[mine]]
            result[mine] = image.ground_to_image(at[point[mine]], start=measured[:, 0])[0] - measured
        return result / net.rays.sigmas[rays]

    for _ in range(3):
        r = misfit(places)
        by = np.stack([(misfit(places + step) - misfit(places - step)) / 20.0 for step in 10.0 * np.eye(3)], axis=2)
        normal, right = np.zeros((len(net.points), 3, 3)), np.zeros((len(net.points), 3))
        np.add.at(normal, point, np.einsum("rki,rkj->rij", by, by))
        np.add.at(right, point, np.einsum("rki,rk->ri", by, r))
        some = np.unique(point)
        places[some] -= np.linalg.solve(normal[some], right[some, :, None])[:, :, 0]
    np.testing.assert_allclose(found.heights[0], above(net, places[found.points]), atol=0.02, rtol=0.02)
    assert np.std(found.heights[0]) > 50.0


def test_heights_after_step_1_are_of_its_places() -> None:
    net, found = networks("block"), merit("block")
    np.testing.assert_allclose(found.heights[1], above(net, found.steps.free.places[found.points]), rtol=0.02)


def above(net: Network, places: Array) -> Array:
    """m above the terrain model, along its normal."""
    assert net.surface is not None
    return net.surface.grid.height_above(places)[0]


def test_points_over_missing_posts_are_counted() -> None:
    surface = networks("block").surface
    assert surface is not None
    assert merit("block").without_row == int(np.isinf(surface.sigmas).sum()) > 0
    ties = len(networks("block").points)
    assert merit("block").points.size + merit("block").without_row + merit("block").left_out == ties


# --- tables, map


@pytest.mark.usefixtures("light_figures")
@pytest.mark.parametrize("which", ["pair", "block"])
def test_files(which: str, tmp_path: Path) -> None:
    found, out = merit(which), tmp_path / "out"
    write_two_steps(found, out)
    drawn = {path.name for path in out.iterdir()}
    assert {"map.png", "height_map_1.png", "height_map_2.png"} <= drawn
    record = json.loads((out / "two_steps.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in record["steps"]] == [f"{which}, step 1", which]
    heights = next(row for row in record["figures"] if row["quantity"] == "terrain_rms_height")
    assert heights["values"] == found.whole.heights.rms.tolist()
    np.testing.assert_array_equal(read_solution(out).places, found.steps.fitted.places)

    assert len(rows_of(out / "two_steps.csv")) == (len(found.groups) + 1) * 14
    pitch = next(
        row for row in rows_of(out / "two_steps.csv") if (row["pass"], row["quantity"]) == ("all", "pose_sigma_pitch")
    )
    assert float(pitch["before"]) / float(pitch["step_1"]) == pytest.approx(float(pitch["factor_step_1"]))
    assert float(pitch["step_2"]) == pytest.approx(found.whole.poses[2, 4] / ARCSEC)
    used = np.array([float(row["height_step_2_m"]) for row in rows_of(out / "heights.csv") if row["used"] == "true"])
    assert np.sqrt(np.mean(used**2)) == pytest.approx(found.whole.heights.rms[2])
    write_two_steps(found, out, figures=False)  # an earlier result is replaced, by an adjustment in one step, too
    write_results(found.steps.fitted, out, figures=False)
    assert not any(path.name.startswith(("passes.png", "two_steps")) for path in out.iterdir())


@pytest.mark.parametrize("which", ["pair", "block"])
def test_the_maps_show_before_and_after_on_one_scale(which: str) -> None:
    found = merit(which)
    for sheet, heights in zip(height_map_sheets(found), found.heights[[0, -1]], strict=True):
        (marks,) = [one for one in sheet.figure.axes[0].collections if one.get_array() is not None]
        np.testing.assert_array_equal(marks.get_array(), heights[found.used])
        low, high = marks.get_clim()
        assert -low == high == pytest.approx(np.quantile(np.abs(found.heights[:, found.used]), 0.98))
