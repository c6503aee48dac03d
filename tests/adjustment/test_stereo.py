"""Laser shots on the surface that two images show: rows, both forms, the state that they end at, their statistics."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import pair
from outside import refuses
from stereo_pair import stereo_network, surface

from mgsgraph import compiled
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.graph.stereo import require_seen
from mgsgraph.adjustment.settings import Loss, SolverSettings
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.stereo_surface import SurfaceHeights, heights_above
from mgsgraph.network import PointClass, Ranges, SharedKind, SharedUnknown
from mgsgraph.planning.plan import Targets, TargetSigmas
from mgsgraph.planning.state import CurrentState, state_of_solution
from mgsgraph.results.archive import read_solution, write_archive
from mgsgraph.simulation.observations import NoiseSettings


def test_true_footprints_lie_on_the_surface() -> None:
    made = pair(12, 24)
    found = heights_above(surface(made), *made.images, made.true_footprints, made.true_corrections)
    assert found.covered.sum() >= 20
    assert np.abs(found.heights[found.covered]).max() < 1.5  # the average over a footprint is not its middle
    assert np.abs(found.parallax[found.covered]).max() < 0.1


def test_rows_change_as_the_heights_themselves() -> None:
    """By all unknowns of both images and by the points, about a state drawn from the priors; exact on the surface."""
    made = pair(12, 24)
    net = stereo_network(made, displaced=False)
    begun, rng = lay_out(net, SolverSettings()), np.random.default_rng(5)
    assert net.stereo is not None
    on = np.flatnonzero(net.stereo.surface >= 0)

    def heights(x: np.ndarray, points: np.ndarray) -> SurfaceHeights:
        own = [OrientationCorrection(one.reshape(-1, 6)) for one in begun.variables.split(x)[:2]]
        return heights_above(surface(made), *made.images, points[on], (own[0], own[1]))

    x, points = 0.5 * rng.standard_normal(begun.columns) * begun.sigmas, net.points.places.copy()
    for _ in range(6):
        found = heights(x, points)
        points[on] -= found.heights[:, None] * found.normals
    rows = begun.about_stereo(points, x)
    assert np.abs(residuals(rows, x, points[rows.point_order]).stereo[on]).max() < 1e-6
    for _ in range(5):
        more = x + 0.01 * rng.standard_normal(x.size) * begun.sigmas
        moved = points + rng.normal(0.0, 0.5, points.shape)
        want = heights(more, moved).heights
        found = residuals(rows, more, moved[rows.point_order]).stereo[on]
        np.testing.assert_allclose(found, want, rtol=0.0, atol=0.01 * np.abs(want).max())


@pytest.mark.parametrize(("held", "loss"), [(False, "none"), (True, "none"), (False, "huber")])
def test_both_forms_agree(held: bool, loss: Loss) -> None:
    noise = NoiseSettings() if loss == "none" else NoiseSettings(ground=1.0)
    net = replace(stereo_network(pair(noise=noise)), held=np.array([held, False]))
    if loss == "huber":  # which acts on a shot whose place, known to a metre, is 30 m beside the surface
        places = net.points.places.copy()
        places[-1] *= 1.0 - 30.0 / np.linalg.norm(places[-1])
        net = replace(net, points=replace(net.points, places=places))
    settings = SolverSettings(loss=loss, cost_tolerance=1e-11 if loss == "none" else 1e-13)
    bundle = adjust_network(net, settings)
    explicit = by_gtsam(bundle)
    assert bundle.converged
    # derivatives hold the normal of the surface, which counts 30 m beside it: two solvers then end a little apart
    cost, off, share = (1e-9, 1e-3, 1e-5) if loss == "none" else (1e-8, 0.05, 1e-4)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=cost)
    np.testing.assert_allclose(bundle.places, explicit.places, rtol=0.0, atol=off)
    for one, other in zip(bundle.covariances, explicit.covariances, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=share * max(np.abs(other).max(), 1e-12))
    first, second = bundle.shift_covariance(0), explicit.shift_covariance(0)
    np.testing.assert_allclose(first, second, rtol=0.0, atol=share * second.max())


def test_level_ground_gives_height_and_moves_nothing_horizontally() -> None:
    """A profile whose place is not known: no relief acts on its shift, whatever the slopes."""
    made = pair(12, 24)
    found = heights_above(
        surface(made), *made.images, made.true_footprints, made.true_corrections, np.ones(24, dtype=bool)
    )
    up = made.true_footprints / np.linalg.norm(made.true_footprints, axis=1, keepdims=True)
    np.testing.assert_allclose(found.normals, up, atol=1e-5)

    net = stereo_network(made)
    assert net.stereo is not None
    assert net.shifts is not None
    level = replace(net, stereo=replace(net.stereo, level=net.stereo.surface >= 0))
    by_relief, alone, without = (
        adjust_network(one, SolverSettings()) for one in (net, level, replace(net, stereo=None))
    )
    prior = net.shifts.sigmas[0]
    assert np.sqrt(np.diag(by_relief.shift_covariance(0))).max() < 0.6 * prior
    np.testing.assert_allclose(np.sqrt(np.diag(alone.shift_covariance(0))), prior, rtol=1e-3)
    np.testing.assert_allclose(alone.shifts, without.shifts, atol=0.1 * prior)
    laser = net.points.classes == PointClass.LASER
    heights = [np.trace(one.covariances[laser], axis1=1, axis2=2).mean() for one in (alone, without)]
    assert heights[0] <= heights[1] * (1.0 + 1e-6)


def test_an_adjustment_begins_where_another_ended() -> None:
    """Its first step is tiny, and it ends there."""
    net = stereo_network(pair(12, 24))
    found = adjust_network(net, SolverSettings())
    again, bare = (
        adjust_network(net, SolverSettings(), begin=one.values)
        for one in (found, adjust_network(replace(net, stereo=None), SolverSettings()))
    )
    assert again.history[0].step < 1e-2 < bare.history[0].step
    for one in (again, bare):
        assert one.cost_final == pytest.approx(found.cost_final, rel=1e-8)


def test_rows_filled_in_anew_are_those_of_a_layout_made_anew() -> None:
    net = stereo_network(pair(12, 24))
    moved = net.points.places + np.random.default_rng(2).normal(0.0, 20.0, net.points.places.shape)
    begun = lay_out(net, SolverSettings())
    made = begun.about_stereo(moved, np.zeros(begun.columns))
    again = made.about(made.lines)
    assert np.abs(made.rows.data - begun.rows.data).max() > 1.0
    for name in ("data", "weight", "start", "kind", "observation_numbers"):
        np.testing.assert_array_equal(getattr(made.rows, name), getattr(again.rows, name))


@pytest.mark.parametrize("begin", [False, True])
def test_heights_of_many_points_are_those_of_each(begin: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shared out among threads, and where the lines are known."""
    made = pair(12, 24)
    points = made.true_footprints + np.random.default_rng(4).normal(0.0, 100.0, made.true_footprints.shape)
    few = heights_above(surface(made), *made.images, points, made.true_corrections)
    monkeypatch.setattr(compiled, "threads", lambda: 3)
    copies = 1 + 15_000 // len(points)
    many, lines = (np.tile(part, (copies, 1)) for part in (points, few.lines + 5.0))
    found = heights_above(surface(made), *made.images, many, made.true_corrections, start=lines if begin else None)
    for one, whole in zip(few, found, strict=True):
        expected = np.broadcast_to(one, (copies, *one.shape))
        np.testing.assert_allclose(whole.reshape(expected.shape), expected, atol=1e-6 * (np.abs(one).max() or 1.0))


def test_a_plan_begins_with_the_sigmas_of_the_adjustment() -> None:
    """Parts of the network keep the rows, without which its shots' sigmas would be those of their priors."""
    found = adjust_network(stereo_network(pair(12, 24)), SolverSettings())
    targets = Targets(found.network.points.ids, (), ("all",))
    sigmas = TargetSigmas(CurrentState(state_of_solution(found)), targets).before()[:, 0]
    np.testing.assert_allclose(sigmas, np.sqrt(np.trace(found.covariances, axis1=1, axis2=2)), rtol=1e-6)


def test_points_that_the_images_do_not_see_are_refused() -> None:
    net = stereo_network(pair())
    assert net.stereo is not None
    far = np.where(net.stereo.surface[:, None] >= 0, -1.0, 1.0) * np.nan_to_num(net.points.places)
    layout = lay_out(replace(net, stereo=replace(net.stereo, starts=far)), SolverSettings())
    assert layout.stereo is not None
    refuses("stereo surface", require_seen, layout.network, layout.stereo)


def test_a_profile_of_unknown_height_and_drift_is_raised_to_the_surface() -> None:
    """Its shots lie 12 m low, and 5 m more at one end; without ranges the images hold the height."""
    made = pair(40, 60)
    net = stereo_network(made, displaced=False)
    assert net.shifts is not None
    laser = np.flatnonzero(net.shifts.profile == 0)
    along = np.linspace(-1.0, 1.0, laser.size)  # shots follow one another
    places = net.points.places.copy()
    up = places[laser] / np.linalg.norm(places[laser], axis=1, keepdims=True)
    places[laser] -= (12.0 + 5.0 * along)[:, None] * up
    height = SharedUnknown(
        "height", SharedKind.PROFILE_HEIGHT, np.zeros(0, dtype=int), np.array([30.0, 20.0]), "profile"
    )
    none = Ranges(*(np.zeros(0, dtype=kind) for kind in (int, int, float, float, float)))
    net = replace(net, points=replace(net.points, places=places), ranges=none, shared=(height,))
    bundle = adjust_network(net, SolverSettings())
    explicit = by_gtsam(bundle)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    first, second = bundle.shared_covariance(0), explicit.shared_covariance(0)
    np.testing.assert_allclose(first, second, rtol=0.0, atol=1e-5 * second.max())
    sigmas = np.sqrt(np.diag(bundle.shared_covariance(0)))
    middle, drift = bundle.shared[0]
    assert abs(middle - 12.0) < 4.0 * sigmas[0] < 120.0
    assert abs(abs(drift) - 5.0) < 4.0 * sigmas[1] < 80.0


def test_a_solution_with_stereo_rows_is_archived_whole(tmp_path: Path) -> None:
    found = adjust_network(stereo_network(pair()), SolverSettings())
    write_archive(found, tmp_path / "solution.npz")
    read = read_solution(tmp_path / "solution.npz")
    assert read.network.stereo is not None
    whole = surface(pair())
    for name in ("first", "step", "places", "covered", "sigmas", "roughness"):
        np.testing.assert_array_equal(getattr(read.network.stereo.surfaces[0], name), getattr(whole, name))
    posterior = Posterior.of(read)
    shot = found.network.points.ids[-1]
    scale = np.abs(found.covariances[-1]).max()
    np.testing.assert_allclose(posterior.point(shot).covariance, found.covariances[-1], atol=1e-6 * scale)
