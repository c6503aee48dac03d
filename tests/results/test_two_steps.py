"""Figures of merit of two steps, heights by cell, and their page, tables and map."""

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.two_steps import adjust_in_two_steps
from mgsgraph.analysis.statistics import node_times, strip_corrections
from mgsgraph.analysis.two_step_statistics import TwoStepStatistics, owners, two_step_statistics
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.results.archive import read_solution
from mgsgraph.results.figures.dem import height_map_sheets
from mgsgraph.results.results import write_results
from mgsgraph.results.two_steps import (
    write_two_steps,
)
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.observations import TerrainErrors
from mgsgraph.units import MGON

TERRAIN = TerrainErrors(missing=0.02)


@cache
def merit(which: str) -> TwoStepStatistics:
    return two_step_statistics(adjust_in_two_steps(networks(which), SolverSettings(reject=4.0), which))


@cache
def networks(which: str) -> Network:
    if which == "pair":
        return with_shift_and_surface(network(pair(ties=40, shots=6)))
    settings = BlockSettings(strips=2, length=150e3, points=400, terrain=TERRAIN)
    return simulate_hrsc_block(settings, seed=3).network


# --- cells


# --- figures of merit


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
    """As `analysis.statistics.strip_corrections` has them at the nodes, between which they hardly change."""
    found, net = merit("block"), networks("block")
    means = np.empty((2, len(net.passes), 6))
    for step, solution in enumerate((found.steps.free, found.steps.fitted)):
        for k, strip in enumerate(net.passes):
            image = net.images[int(strip.images[2])]
            nodes = strip_corrections(solution, k, node_times(solution, k))
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
    """28 mgon of bias, 3 of wander and a drift of 5 at the ends, whose mean over the strip is smaller."""
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

    def rows(name: str) -> list[dict[str, str]]:
        with (out / name).open(encoding="utf-8") as file:
            return list(csv.DictReader(file))

    assert len(rows("two_steps.csv")) == (len(found.groups) + 1) * 14
    pitch = next(
        row for row in rows("two_steps.csv") if (row["strip"], row["quantity"]) == ("all", "pose_sigma_pitch")
    )
    assert float(pitch["before"]) / float(pitch["step_1"]) == pytest.approx(float(pitch["factor_step_1"]))
    assert float(pitch["step_2"]) == pytest.approx(found.whole.poses[2, 4] / MGON)
    used = np.array([float(row["height_step_2_m"]) for row in rows("heights.csv") if row["used"] == "true"])
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
