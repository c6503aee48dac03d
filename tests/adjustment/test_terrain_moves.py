"""A terrain model that lies beside the truth, too low and tilted: its own unknowns, found and told; and several minima
of its shift.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, terrain, with_shift_and_surface, with_tilting_surface
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.multistart import starts_wanted
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import group_rows, scaled
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up, from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import TERRAIN, GroundPoints, Network, PointClass, Surface
from mgsgraph.network.parts import select_points
from mgsgraph.results.archive import read_solution, write_archive
from mgsgraph.results.ground import control_section
from mgsgraph.units import ARCSEC, DEG

RADIUS = 3.39e6
MIDDLE = from_planetocentric(np.array([[20.0 * DEG, 12.0 * DEG, RADIUS]]))[0]
HALF = 2.5 * DEG
TRUE = np.array([150.0, -40.0, 30.0, 20.0 * ARCSEC, -8.0 * ARCSEC])
"""m and rad: how the truth lies beside the model."""
UNKNOWN = {"shift_sigma": 200.0, "height_sigma": 50.0, "tilt_sigma": 1e-4, "middle": MIDDLE}


def ground(longitude: Array, latitude: Array) -> Array:
    """(n, 3) m, hills of 600 m, some 20 km from one to the next."""
    x, y = (longitude - 20.0 * DEG) * 60.0 / DEG, (latitude - 12.0 * DEG) * 60.0 / DEG
    height = 600.0 * np.sin(x / 3.3 + 0.3 * np.sin(y / 5.0)) * np.cos(y / 4.1) + 200.0 * np.sin((x + y) / 7.0)
    return from_planetocentric(np.column_stack([longitude, latitude, RADIUS + height]))


@cache
def model() -> TerrainGrid:
    """The posts of a model that must be moved by what is `TRUE` to lie on the ground."""
    step, count = DEG / 96.0, int(2.0 * HALF / (DEG / 96.0)) + 21
    first = 20.0 * DEG - HALF - 10 * step, 12.0 * DEG + HALF + 10 * step
    posts = np.stack(np.meshgrid(first[0] + step * np.arange(count), first[1] - step * np.arange(count)), axis=-1)
    surface = Surface(terrain(network(pair())), np.ones(1), **UNKNOWN)
    above = ground(*posts.reshape(-1, 2).T)
    for _ in range(5):  # the place of the ground that a post has when the model is moved onto it
        here = above - surface.moved(above, TRUE)
        off = posts.reshape(-1, 2) - planetocentric(here)[:, :2]
        above = ground(*(planetocentric(above)[:, :2] + off).T)
    radii = np.linalg.norm(above - surface.moved(above, TRUE), axis=1)
    return TerrainGrid("made up", radii.reshape(posts.shape[:2]), *first, step, step)


@cache
def control(seed: int, shown: tuple[str, ...] = tuple(UNKNOWN)) -> Network:
    """The pair, and 400 known points over 300 km, on a model that lies beside them."""
    net, rng = network(pair()), np.random.default_rng(seed)
    n, ties = 400, len(net.points)
    place = np.array([20.0, 12.0]) * DEG + rng.uniform(-HALF, HALF, (n, 2))
    true = ground(*place.T)
    points = GroundPoints(
        net.points.ids + tuple(f"c{i}" for i in range(n)),
        np.append(net.points.classes, np.full(n, PointClass.CONTROL)),
        np.append(net.points.kinds, np.full(n, PointKind.CONSTRAINED)),
        np.concatenate([net.points.places, true + rng.normal(0.0, 3.0, (n, 3))]),
        np.concatenate([net.points.covariances, np.tile(9.0 * np.eye(3), (n, 1, 1))]),
    )
    # the model's own error of 10 m: heights are differences, and the places may have it as well as the posts
    noisy = points.places.copy()
    noisy[ties:] += 10.0 * rng.standard_normal((n, 1)) * (true / np.linalg.norm(true, axis=1)[:, None])
    points = replace(points, places=noisy)
    sigmas = np.append(np.full(ties, np.inf), np.full(n, 10.0))
    return replace(net, points=points, surface=Surface(model(), sigmas, **{k: UNKNOWN[k] for k in shown}))  # type: ignore[arg-type]


@cache
def solved(seed: int = 1) -> Solution:
    return adjust_network(control(seed), SolverSettings())


def test_the_truth_is_found_within_the_sigmas() -> None:
    squares = []
    for seed in (1, 2, 3):
        solution = solved(seed)
        assert solution.converged
        error = solution.shift_values[-1] - TRUE
        spread = solution.shift_spread(0)
        sigmas = np.sqrt(np.diag(spread))
        assert np.all(sigmas < [30.0, 30.0, 1.0, 2.0 * ARCSEC, 2.0 * ARCSEC])
        assert np.all(np.abs(error) < 4.0 * sigmas)
        squares.append(float(error @ np.linalg.solve(spread, error)))
    assert 0.1 < np.mean(squares) / 5.0 < 3.0


def test_without_these_unknowns_the_heights_do_not_fit() -> None:
    level = adjust_network(control(1, ("shift_sigma",)), SolverSettings())
    assert level.cost_final > 1.5 * solved().cost_final
    assert level.lift is None
    assert level.shift_values[-1].size == 2


def test_any_of_them_may_be_unknown_alone() -> None:
    lifted = adjust_network(control(1, ("height_sigma",)), SolverSettings())
    assert lifted.shifts.tolist() == [[0.0, 0.0]]
    assert np.all(lifted.shift_covariance(0) == 0.0)
    assert lifted.lift is not None
    assert abs(lifted.lift[0] - 30.0) < 5.0
    assert "upward shift +" in " ".join(control_section(lifted).sentences)
    tilted = adjust_network(control(1, ("tilt_sigma", "middle")), SolverSettings())
    assert [term.unit for term in tilted.network.shift_terms[0]] == ["rad", "rad"]


def test_what_moves_the_model_is_its_derivative() -> None:
    """Directions against a model that is turned and moved as a whole: a rotation about axes through the middle."""
    surface = control(1).surface
    assert surface is not None
    points = ground(*(np.array([20.0, 12.0]) * DEG + np.random.default_rng(4).uniform(-HALF, HALF, (20, 2))).T)
    axes = east_north_up(MIDDLE[None])[0]
    for k in range(2):
        turn = 1e-4
        arm = points - MIDDLE
        rotated = (
            arm * np.cos(turn) + np.cross(axes[k], arm) * np.sin(turn)
            + np.outer(arm @ axes[k], axes[k]) * (1.0 - np.cos(turn))
        )  # fmt: skip
        np.testing.assert_allclose(surface.moved(points, turn * np.eye(5)[3 + k]), rotated - arm, rtol=0, atol=2e-3)
    up = surface.moved(points, np.array([0.0, 0.0, 7.0, 0.0, 0.0]))
    np.testing.assert_allclose(up, 7.0 * points / np.linalg.norm(points, axis=1)[:, None], atol=1e-9)
    assert np.abs(np.einsum("nkj,nj->nk", surface.directions(points)[:, :2], points)).max() < 1e-6


def test_the_answer_is_a_stationary_point() -> None:
    """Posts are 600 m apart, the model moves by 150 m, over cells: begun at the answer, nothing moves."""
    solution = solved()
    again = adjust_network(solution.network, solution.settings, begin=solution.values)
    moved = (again.shift_values[-1] - solution.shift_values[-1]) / np.sqrt(np.diag(solution.shift_spread(0)))
    assert np.abs(moved).max() < 1e-6
    assert again.cost_final == pytest.approx(solution.cost_final, rel=1e-6)


def test_the_archive_keeps_them_and_knows_what_is_missing(tmp_path: Path) -> None:
    solution = solved()
    write_archive(solution, tmp_path / "solution.npz")
    again = read_solution(tmp_path)
    assert np.array_equal(again.shift_values[0], solution.shift_values[0])
    assert again.network.shift_terms == solution.network.shift_terms
    write_archive(replace(solution, lift=None), tmp_path / "solution.npz")
    refuses("lift: shapes", read_solution, tmp_path)


def test_groups_scale_their_own_sigmas() -> None:
    net = with_tilting_surface(network(pair()))
    grouping = group_rows(net)
    assert {grouping.names[g] for g in grouping.unknowns[-1]} == {"shifts", "tilts"}
    wider = scaled(net, grouping, np.where(np.array(grouping.names) == "tilts", 3.0, 2.0)).surface
    assert wider is not None
    assert (wider.shift_sigma, wider.height_sigma) == (300.0, 80.0)
    assert wider.tilt_sigma == pytest.approx(6e-4)


def test_what_is_kept_image_by_image_cannot_hold_them() -> None:
    net = with_tilting_surface(network(pair()))
    refuses("unknown height or tilt", select_points, net, np.arange(3))


def test_a_tilt_needs_a_middle_and_sigmas_are_not_negative() -> None:
    grid = terrain(network(pair()))
    refuses("middle of the points", Surface, grid, np.ones(1), tilt_sigma=1e-4)
    for name in ("shift", "height", "tilt"):
        with pytest.raises(InputError, match=f"surface, {name} sigma: -1"):
            Surface(grid, np.ones(1), **{f"{name}_sigma": -1.0})  # type: ignore[arg-type]


# --- several minima over its shift: found, weighted, and carried into the covariance


TERRAIN_VARIABLE = 3
"""Two images, the profile, the terrain model."""


@cache
def rolling() -> Network:
    """Few ties on a terrain model that may lie kilometres off: ground of sines looks alike in several places."""
    found = with_shift_and_surface(network(pair()))
    assert found.surface is not None
    return replace(found, surface=replace(found.surface, shift_sigma=2000.0))


@cache
def mixed(starts: int | None = None) -> Solution:
    return adjust_network(rolling(), SolverSettings(starts=starts))


def test_they_are_what_adjustments_begun_at_them_find() -> None:
    """Each is a minimum: an adjustment that begins a third of its sigma beside it comes back to its cost and shift."""
    minima = mixed().minima
    assert minima is not None
    assert minima.starts == 16
    assert sum(one.starts for one in minima.each) + minima.lost == 17
    assert len(minima.each) >= 3
    assert minima.each[0].cost == min(one.cost for one in minima.each) == mixed().cost_final
    assert sum(one.weight for one in minima.each) == pytest.approx(1.0)
    for one in minima.each:
        values = [value.copy() for value in mixed().values]
        values[TERRAIN_VARIABLE] = one.shift + 0.3 * np.sqrt(np.diag(one.spread))
        again = adjust_network(rolling(), SolverSettings(), begin=values)
        assert again.minima is None
        assert again.cost_final == pytest.approx(one.cost, abs=1e-4)
        np.testing.assert_allclose(again.shift_values[-1], one.shift, atol=1.0)
        np.testing.assert_allclose(again.shift_spread(1), one.spread, rtol=1e-2, atol=1.0)


def test_the_covariance_is_the_mean_square_about_the_lowest() -> None:
    mixture, alone, minima = mixed(), mixed(0), mixed().minima
    assert minima is not None
    assert alone.minima is None
    best = minima.each[0].shift
    expected = sum(
        one.weight * (one.spread + np.outer(one.shift - best, one.shift - best)) for one in minima.each
    )  # fmt: skip
    np.testing.assert_allclose(mixture.shift_spread(1), expected, rtol=1e-6)
    assert np.all(np.diag(minima.covariance) <= np.diag(expected))
    larger = np.linalg.eigvalsh(mixture.joint_covariance.dense() - alone.joint_covariance.dense())
    assert larger.max() > 1e6  # m^2: kilometres
    assert mixture.places == pytest.approx(alone.places, abs=1e-2)
    name = rolling().points.ids[0]
    np.testing.assert_allclose(Posterior.of(mixture).point(name).covariance, mixture.covariances[0], rtol=1e-3)
    assert np.all(np.trace(mixture.covariances, axis1=1, axis2=2) > 0.9 * np.trace(alone.covariances, axis1=1, axis2=2))


def test_weights_are_laplaces() -> None:
    """Of minima so alike in their curvature, by their costs and the determinants of their shifts' covariances to some
    tens of a per cent.
    """
    minima = mixed().minima
    assert minima is not None
    first, second = minima.each[:2]
    root = np.sqrt(np.linalg.det(second.spread) / np.linalg.det(first.spread))
    assert second.weight / first.weight == pytest.approx(np.exp(first.cost - second.cost) * root, rel=0.5)


def test_redundancy_is_that_of_one_minimum() -> None:
    found = reliability(at_solution(mixed())).measures
    assert found.redundancy.sum() == pytest.approx(mixed().fit.degrees_of_freedom, abs=1e-3)


def test_without_a_shift_to_be_estimated_there_are_none() -> None:
    for one in (network(pair()), replace(rolling(), considered=(TERRAIN,))):
        settings = SolverSettings(starts=4)
        assert starts_wanted(one, settings, lay_out(one, settings)) == 0
    layout = lay_out(rolling(), SolverSettings())
    assert starts_wanted(rolling(), SolverSettings(), layout) == 16
    assert starts_wanted(rolling(), SolverSettings(starts=4), layout) == 4
    assert starts_wanted(rolling(), SolverSettings(loss="huber"), layout.with_loss("huber")) == 0
