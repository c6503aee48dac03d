"""Crossovers of laser profiles in the adjustment: rows on their shifts and heights, in both forms and by hand."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import network, pair
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import prior_covariance
from mgsgraph.adjustment.factor_graph import Keys, prior_factors
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.grouping import group_rows, scaled
from mgsgraph.analysis.measures import MeasureKind, names_of
from mgsgraph.analysis.reliability import reliability
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.altimetry import footprint_covariances
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array
from mgsgraph.network import GroundPoints, Network, PointClass, ProfileShifts, SharedUnknown
from mgsgraph.network.effects import footprint_motion
from mgsgraph.network.parts import select_points
from mgsgraph.network.records import Crossovers, crossovers
from mgsgraph.results.archive import read_solution, write_archive

AZIMUTHS = (5.0, -25.0, 40.0, 80.0)
"""Degrees, of the profiles' tracks against north."""
SHIFTS = np.array([[60.0, -40.0], [-30.0, 50.0], [20.0, 70.0], [-50.0, -20.0]])
"""m, east and north: where the profiles are off."""
HEIGHTS = np.array([4.0, -3.0, 2.0, -1.0])
"""m, which they are too low."""
SIGMAS = 1.0, 80.0, 5.0
"""m, of shots, of shifts, of heights."""


@cache
def crossing_network() -> Network:
    """A pair of images, and four laser profiles of 40 shots on hills that cross in six places beside it, off by
    `SHIFTS` and `HEIGHTS`.
    """
    net = network(pair(12, 6))
    middle = net.points.places[net.points.classes == PointClass.LASER][0]
    along, parts = 300.0 * (np.arange(40) - 19.5), []
    for k, azimuth in enumerate(np.radians(AZIMUTHS)):
        level = along[:, None] * [np.sin(azimuth), np.cos(azimuth), 0.0] + [300.0 * k, -200.0 * k, 0.0]
        east, north = level.T[:2]
        hills = 300.0 * np.sin(east / 1300.0) * np.cos(north / 1500.0)
        level[:, 2] = hills - np.sum(level[:, :2] ** 2, axis=1) / (2.0 * np.linalg.norm(middle))
        parts.append(middle + (level - [*SHIFTS[k], HEIGHTS[k]]) @ east_north_up(middle[None])[0])
    shots, n = np.concatenate(parts), len(net.points)
    count = len(shots)
    points = GroundPoints(
        (*net.points.ids, *(f"crossing:{i}" for i in range(count))),
        np.append(net.points.classes, np.full(count, PointClass.LASER)),
        np.append(net.points.kinds, np.full(count, PointKind.CONSTRAINED)),
        np.concatenate([net.points.places, shots]),
        np.concatenate([net.points.covariances, footprint_covariances(shots, SIGMAS[0], SIGMAS[0])]),
    )
    names = tuple(f"profile {k}" for k in range(4))
    profile = np.append(np.full(n, -1), np.repeat(np.arange(4), 40))
    shared = tuple(SharedUnknown.of_height(name, SIGMAS[2], 2.0) for name in names)
    return replace(net, points=points, shifts=ProfileShifts(names, profile, np.full(4, SIGMAS[1])), shared=shared)


def crossed(moved: Array | None = None, unsure: int | None = None) -> Network:
    """The same with its crossovers, the profiles thought to be moved (p, 2), but for an unsure one."""
    net = crossing_network()
    assert net.shifts is not None
    moved = np.zeros(SHIFTS.shape) if moved is None else moved
    return replace(net, crossovers=crossovers(
        net.points, net.shifts, moved, np.ones(len(net.points)), np.arange(4) == unsure
    ))  # fmt: skip


def test_where_the_profiles_lie_right_the_rows_are_zero() -> None:
    """Their differences with the true shifts and heights; and their rows by hand."""
    net = crossed(SHIFTS)
    assert net.crossovers is not None
    assert net.shifts is not None
    assert net.crossovers.profiles(net.shifts).tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    layout = lay_out(net, SolverSettings())
    state, first = np.zeros(layout.columns), layout.variables.first
    for k in range(4):
        state[first[2 + k] : first[2 + k] + 2] = SHIFTS[k]
        state[first[net.first_shared + k]] = HEIGHTS[k]
    rows = layout.prior.residuals(state)[layout.columns :] * net.crossovers.sigmas
    assert np.abs(rows).max() < 10.0  # of hills of 300 m, by straight lines between shots
    assert np.abs(rows / net.crossovers.sigmas).max() < 2.5
    state[:] = 0.0
    assert np.abs(layout.prior.residuals(state)[layout.columns :] * net.crossovers.sigmas).max() > 5.0


def test_rows_are_linear_in_what_moves_the_shots() -> None:
    """Derivatives of the differences of shots that really move, by all unknowns."""
    net = crossed()
    assert net.crossovers is not None
    assert net.shifts is not None
    layout, rng = lay_out(net, SolverSettings()), np.random.default_rng(1)
    state = np.zeros(layout.columns)
    moved = np.zeros((len(net.points), 3))
    for k in range(4):
        own = layout.columns_of(net.first_shared + k)
        state[own] = rng.normal(0.0, 3.0, 2)
        points, motion = footprint_motion(net, net.shared[k])
        moved[points] += np.einsum("k,pkc->pc", state[own], motion)
    change = net.crossovers.differences(net.points.places + moved) - net.crossovers.differences(net.points.places)
    rows = [layout.prior.residuals(one)[layout.columns :] * net.crossovers.sigmas for one in (state, 0.0 * state)]
    np.testing.assert_allclose(rows[0] - rows[1], change, rtol=0, atol=1e-6)
    np.testing.assert_allclose(rows[1], net.crossovers.differences(net.points.places), rtol=0, atol=1e-9)


def test_crossovers_of_a_profile_that_may_lie_anywhere_give_heights_alone() -> None:
    sure, unsure = crossed(SHIFTS).crossovers, crossed(SHIFTS, 1).crossovers
    assert sure is not None
    assert unsure is not None
    of_it = np.array([True, False, False, True, True, False])
    assert np.all(unsure.gradients[of_it] == 0.0)
    np.testing.assert_array_equal(unsure.gradients[~of_it], sure.gradients[~of_it])
    wider = np.hypot(sure.sigmas, np.linalg.norm(sure.gradients, axis=1) * SIGMAS[1])
    np.testing.assert_allclose(unsure.sigmas, np.where(of_it, wider, sure.sigmas))


def test_both_forms_agree_and_shifts_are_found() -> None:
    bundle = adjust_network(crossed(SHIFTS), SolverSettings())
    explicit = by_gtsam(bundle)
    without = adjust_network(crossing_network(), SolverSettings())
    assert bundle.converged
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    np.testing.assert_allclose(bundle.shifts, explicit.shifts, rtol=0, atol=1e-4)
    for p in range(4):
        np.testing.assert_allclose(bundle.shift_covariance(p), explicit.shift_covariance(p), rtol=1e-6)
        np.testing.assert_allclose(bundle.shared_covariance(p), explicit.shared_covariance(p), rtol=1e-6)
    assert bundle.fit.observations == without.fit.observations + 6
    off = [one.shifts - SHIFTS for one in (bundle, without)]
    errors = [np.linalg.norm(one - one.mean(axis=0)) for one in off]
    assert errors[0] < 0.8 * errors[1]
    sigmas = [sum(np.trace(one.shift_covariance(p)) for p in range(4)) for one in (bundle, without)]
    assert sigmas[0] < 0.8 * sigmas[1]


def test_rows_alone_are_the_least_squares_solution_by_hand() -> None:
    net = crossed()
    layout = lay_out(net, SolverSettings())
    found = prior_covariance(layout)
    assert found is not None
    np.testing.assert_allclose(found.dense(), np.linalg.inv(layout.prior.normal()), rtol=1e-6, atol=1e-12)
    graph, values, keys, order = gtsam.NonlinearFactorGraph(), gtsam.Values(), Keys(net), gtsam.Ordering()
    for factor in prior_factors(net, keys):
        graph.add(factor)
    for v in layout.variables.adjusted():
        values.insert(keys.variable(int(v)), np.zeros(int(layout.variables.width[v])))
        order.push_back(keys.variable(int(v)))
    assert graph.size() == len(layout.variables.adjusted()) + 6
    normal = graph.linearize(values).hessian(order)[0]
    np.testing.assert_allclose(layout.prior.normal(), normal, rtol=1e-9, atol=1e-12 * np.abs(normal).max())
    state = np.random.default_rng(3).normal(size=layout.columns) * layout.scales
    step = 1e-3 * layout.scales
    numeric = [
        (layout.prior.cost(state + one) - layout.prior.cost(state - one)) / (2.0 * s)
        for one, s in zip(np.diag(step), step, strict=True)
    ]
    np.testing.assert_allclose(layout.prior.gradient(state), numeric, rtol=1e-5)


def test_they_are_measures_with_redundancy_and_a_group(tmp_path) -> None:  # type: ignore[no-untyped-def]
    solution = adjust_network(crossed(SHIFTS), SolverSettings())
    found = reliability(solution)
    mine = np.flatnonzero(found.measures.kind == MeasureKind.CROSSOVER)
    assert mine.size == 6
    assert np.all((found.measures.redundancy[mine] > 0.0) & (found.measures.redundancy[mine] < 1.0))
    names = names_of(found.at.layout, found.measures, mine)
    assert names[0] == "crossover of profile 0 and profile 1"
    assert found.degrees_of_freedom == pytest.approx(solution.fit.observations - solution.fit.unknowns, abs=1e-6)
    k, crossing = int(np.argmax(np.abs(found.measures.test[mine]))), solution.network.crossovers
    assert crossing is not None
    free = replace(crossing, sigmas=np.where(np.arange(6) == k, 1e6, crossing.sigmas))
    without = adjust_network(replace(solution.network, crossovers=free), SolverSettings())
    drop = 2.0 * (solution.cost_final - without.cost_final)
    assert drop == pytest.approx(found.measures.test[mine[k]] ** 2, rel=1e-3)
    grouping = group_rows(solution.network)
    factors = np.where(np.array(grouping.names) == "crossovers", 3.0, 1.0)
    larger = scaled(solution.network, grouping, factors)
    assert larger.crossovers is not None
    np.testing.assert_allclose(larger.crossovers.sigmas, 3.0 * crossing.sigmas)
    write_archive(solution, tmp_path / "solution.npz")
    again = read_solution(tmp_path / "solution.npz").network.crossovers
    assert isinstance(again, Crossovers)
    np.testing.assert_array_equal(again.shares, crossing.shares)


def test_what_they_cannot_be() -> None:
    net = crossed()
    assert net.crossovers is not None
    refuses("crossovers", replace, net, crossovers=replace(net.crossovers, shots=np.zeros((6, 4))))
    refuses("crossovers of laser profiles", select_points, replace(net, shared=()), np.arange(5))
