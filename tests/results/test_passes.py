"""Passes in reports: course and sigmas along time, tables; and what a terrain model adds to a block."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from block_ground import TerrainErrors
from commands import call, rows_of
from mex import CHANGES
from mex_block import BlockSettings, simulate_hrsc_block
from pass_files import block, write_block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.frames import flight_frame
from mgsgraph.adjustment.settings import Angles, SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.spacing import respaced
from mgsgraph.analysis.statistics import node_times, pass_corrections, pass_reports
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network.joining import seconds
from mgsgraph.results.archive import read_solution
from mgsgraph.results.figures.orientation import pass_curve
from mgsgraph.results.inventory import unsupported_nodes
from mgsgraph.results.passes import calendar, nodes_table
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


# --- two steps


def test_the_block_does_what_the_paper_says() -> None:
    """Spiegel et al. 2006: pitch and yaw come without the terrain, roll and the heights with it."""
    settings = BlockSettings(passes=2, length=150e3, points=400, terrain=TerrainErrors(missing=0.02))
    net = simulate_hrsc_block(settings, seed=3).network
    assert net.surface is not None
    free, fitted = (adjust_network(one, SolverSettings()) for one in (replace(net, surface=None), net))
    roll, *others = np.rollaxis(np.array([
        pass_corrections(one, 0, node_times(one, 0)).sigmas.mean(axis=0)[3:] for one in (free, fitted)
    ]), 1) / (28.0 * MGON)  # fmt: skip
    assert max(one[0] for one in others) < 1.0 / 3.0
    assert roll[0] > 0.3
    assert roll[1] < 0.5 * roll[0]
    heights = [net.surface.grid.height_above(one)[0] for one in (free.places_before, free.places, fitted.places)]
    assert np.all(np.diff([np.sqrt(np.nanmean(one**2)) for one in heights]) < 0.0)
    sigmas = [np.sqrt(np.nanmean(np.trace(one.covariances, axis1=1, axis2=2))) for one in (free, fitted)]
    assert sigmas[1] < 0.8 * sigmas[0]
