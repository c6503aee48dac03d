"""The two steps: each is the adjustment it says it is, heights are judged, and a-priori sigmas are the prior's own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import prior_covariance
from mgsgraph.adjustment.frames import flight_frame
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.rounds import all_rows
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.adjustment.two_steps import (
    RaysAlone,
    TwoSteps,
    adjust_in_two_steps,
    heights_above,
    orientation_values,
    selection_of,
    without_heights,
    without_terrain,
)
from mgsgraph.analysis.statistics import pose_sigmas
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import Network
from mgsgraph.simulation.hrsc_block import (
    BlockSettings,
    SimulatedBlock,
    TrajectoryErrors,
    simulate_hrsc_block,
)
from mgsgraph.simulation.hrsc_flight import PointMatching
from mgsgraph.simulation.observations import TerrainErrors

SETTINGS = SolverSettings(reject=4.0, starts=0)
WRONG, HIGH = 7, 900.0
"""A point whose rays all agree on a place so many m above the ground."""


@cache
def block() -> SimulatedBlock:
    settings = BlockSettings(
        passes=2, length=80e3, points=140, matches=PointMatching(blunders=0.01), terrain=TerrainErrors(missing=0.01)
    )
    return simulate_hrsc_block(settings, seed=4)


@cache
def with_wrong_match() -> Network:
    """The block, and all rays of one point see a place above it."""
    net, truth = block().network, block()
    up = east_north_up(truth.true_points[[WRONG]])[0, 2]
    places = net.rays.places.copy()
    for k in np.flatnonzero(net.rays.point == WRONG).tolist():
        image = int(net.rays.image[k])
        raised, _ = net.images[image].ground_to_image(
            (truth.true_points[WRONG] + HIGH * up)[None], truth.corrections[image], places[[k], 0]
        )
        places[k] = raised[0]
    return replace(net, rays=replace(net.rays, places=places))


@cache
def steps() -> TwoSteps:
    return adjust_in_two_steps(with_wrong_match(), SETTINGS)


def same(one: Solution, other: Solution) -> None:
    """To the last bit."""
    for name in ("places", "covariances", "residuals", "rays_used", "cost_final", "places_before"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for mine, others in zip(one.values, other.values, strict=True):
        np.testing.assert_array_equal(mine, others)
    np.testing.assert_array_equal(one.joint_covariance.blocks, other.joint_covariance.blocks)


# above two seconds: both steps, and each again by itself
def test_either_step_is_an_adjustment() -> None:
    net, done = with_wrong_match(), steps()
    free = adjust_network(without_terrain(net), SETTINGS)
    same(done.free, free)
    quiet, selection = replace(SETTINGS, reject=0.0), selection_of(net, free)
    same(done.fitted, adjust_network(without_heights(net, done.rejected), quiet, left_in=selection))
    assert done.converged
    np.testing.assert_array_equal(done.fitted.rays_rejected, done.free.rays_rejected)
    assert len(done.history[0]) == done.free.iterations
    assert len(done.history[1]) > done.fitted.iterations  # the first pass had the wrong height in


def test_a_match_that_is_wrong_in_all_images_is_off_the_terrain() -> None:
    done, net = steps(), with_wrong_match()
    assert np.flatnonzero(done.rejected).tolist() == [WRONG]
    assert done.heights_converged
    own = net.rays.point == WRONG
    assert np.any(done.free.rays_used[own])
    assert done.fitted.determined[WRONG]
    assert heights_above(net, done.fitted.places, done.fitted)[0][WRONG] == pytest.approx(HIGH, rel=0.2)
    rejected = done.free.rays_rejected
    assert rejected is not None
    gross = block().blunders & ~own & np.isin(net.rays.point, np.flatnonzero(net.ray_counts > 3))
    assert np.mean(rejected[gross]) > 0.8

    nothing = adjust_in_two_steps(net, SolverSettings(starts=0))
    assert not np.any(nothing.rejected)
    assert nothing.free.rays_rejected is not None
    assert not np.any(nothing.free.rays_rejected)


def test_nothing_to_fit_to() -> None:
    net = block().network
    with pytest.raises(InputError, match="no terrain model as control"):
        adjust_in_two_steps(without_terrain(net), SETTINGS)
    with pytest.raises(InputError, match="no point lies"):
        adjust_in_two_steps(without_heights(net, np.ones(len(net.points), dtype=bool)), SETTINGS)


def test_what_is_unknown_without_terrain_is_numbered_without_it() -> None:
    net, solution = block().network, steps().fitted
    mine, every = orientation_values(net, solution), solution.values
    assert [one.size for one in mine] == lay_out(without_terrain(net), SETTINGS).variables.width.tolist()
    assert len(every) == len(mine) + 1
    terrain = next(one for one in every if not any(one is other or np.array_equal(one, other) for other in mine))
    np.testing.assert_array_equal(terrain, solution.shift_values[-1])


def test_an_image_of_which_nothing_is_known_has_no_a_priori_covariance() -> None:
    net = network(pair())
    unknown = OrientationPrior(np.full_like(net.priors[0].sigmas, np.inf))
    net = replace(net, priors=(unknown, net.priors[1]))
    assert prior_covariance(lay_out(net, SolverSettings())) is None
    places, covariances = RaysAlone(net, SolverSettings(), all_rows(net)).nominal()
    assert np.all(np.isfinite(places))
    assert np.all(np.isnan(covariances))


@pytest.mark.parametrize(("share", "forgets"), [(1.0, 0.0), (1e-2, 60.0), (1e-6, 0.0), (1e-6, 60.0)])
def test_a_priori_covariance_of_nodes_that_hardly_leave_their_trend(share: float, forgets: float) -> None:
    """In closed form: bias, drift, and departures that are correlated by the time between them."""
    errors = TrajectoryErrors()
    errors = replace(errors, attitude_wander=share * errors.attitude_wander, correlation_time=forgets,
                     position_wander=share * errors.position_wander)  # fmt: skip
    settings = BlockSettings(passes=2, length=120e3, points=100, terrain=None, errors=errors)
    net = simulate_hrsc_block(settings, seed=4).network
    joint = prior_covariance(lay_out(net, SolverSettings()))
    assert joint is not None
    for pass_, first in zip(net.passes, net.first_of_passes.tolist(), strict=False):
        times = pass_.nodes.times
        ago = np.abs(times[:, None] - times)
        along = 2.0 * (times - times[0]) / (times[-1] - times[0]) - 1.0
        course = np.exp(-ago / forgets) if forgets else np.eye(times.size)
        sizes = [(errors.position, errors.position_drift, errors.position_wander)] * 3
        sizes += [(errors.attitude, errors.attitude_drift, errors.attitude_wander)] * 3
        found = joint.of(range(first, first + times.size))
        for axis, (bias, drift, wander) in enumerate(sizes):
            want = bias**2 + drift**2 * np.multiply.outer(along, along) + wander**2 * course
            np.testing.assert_allclose(found[axis::6, axis::6], want, rtol=1e-9)
    first, second, end = net.first_of_passes.tolist()
    assert not np.any(joint.of(range(first, end))[: joint.of(range(first, second)).shape[0], -6:])
    assert np.all(np.isfinite(RaysAlone(net, SolverSettings(), all_rows(net)).nominal()[1]))


# above two seconds: every unknown is moved by itself
def test_forward_intersection_carries_the_orientation_on() -> None:
    """Its covariance against places that are moved with each unknown, one after another."""
    small = BlockSettings(passes=2, length=40e3, points=20, spacing=20.0, matches=PointMatching(blunders=0.01))
    drawn = simulate_hrsc_block(small, seed=4)
    net = without_terrain(drawn.network)
    rays_alone = RaysAlone(net, SolverSettings(), all_rows(net))
    layout = lay_out(net, SolverSettings())
    places, covariances = rays_alone.nominal()
    zero = [np.zeros(width) for width in layout.variables.width.tolist()]
    at_zero, noise = rays_alone.at(zero)
    np.testing.assert_array_equal(at_zero, places)
    moved = np.empty((layout.columns, *places.shape))
    for v in layout.variables.adjusted():
        for c in range(zero[v].size):
            column = layout.columns_of(v).start + c
            step = 0.01 * layout.sigmas[column]
            both = []
            for sign in (1.0, -1.0):
                values = [one.copy() for one in zero]
                values[v][c] = sign * step
                both.append(rays_alone.at(values)[0])
            moved[column] = (both[0] - both[1]) / (2.0 * step)
    prior = np.linalg.inv(layout.prior.normal())
    want = noise + np.einsum("cni,cd,dnj->nij", moved, prior, moved)
    size = np.sqrt(np.einsum("nii->ni", want))
    error = np.abs(covariances - want) / (size[:, :, None] * size[:, None, :])
    # the covariance is Gauss-Newton's, of wrong rays, too: it leaves the curvature times the residuals out
    wrong = np.isin(np.arange(len(net.points)), net.rays.point[drawn.blunders])
    assert error[~wrong].max() < 0.02
    assert np.median(error[~wrong]) < 1e-3


def test_pose_sigmas_at_mid_image_are_those_of_the_constant_terms() -> None:
    """In the frame's own axes; elsewhere their sums of variances are the profile's, which turning keeps."""
    solution = adjust_network(with_shift_and_surface(network(pair(ties=20, shots=6))), SolverSettings())
    profile = orientation_profile(solution, 1, 7)
    found = pose_sigmas(solution.network, 1, solution.correction(1), solution.joint_covariance, profile.lines)
    for mine, want in ((found[:, :3], profile.position_sigma), (found[:, 3:], profile.rotation_sigma)):
        np.testing.assert_allclose(np.sum(mine**2, axis=1), np.sum(want**2, axis=1), rtol=1e-9)
    turn = flight_frame(solution.network.images[1]).turn
    covariance = turn @ solution.image_covariance(1)[:6, :6] @ turn.T
    np.testing.assert_allclose(found[3], np.sqrt(np.diagonal(covariance)), rtol=1e-6)
