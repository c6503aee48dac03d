"""Redundancy, tests and minimal detectable blunders, held against adjustments without the measure and against draws.

The cost of a network falls by half the square of a measure's test when the measure gets an unknown of its own: that is
its w-test, whatever the formula.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from odd_networks import with_fixed
from scipy.stats import binom, chi2, ncx2, norm
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import UNCONTROLLED, pair_tests, residual_covariance
from mgsgraph.adjustment.settings import Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.analysis.measures import Levels, MeasureKind
from mgsgraph.analysis.reliability import (
    PointIndex,
    Reliability,
    combinations,
    correlations_of_tests,
    reliability,
    suspects,
)
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Network, Pass, PolynomialPrior

PLAIN = SolverSettings(cost_tolerance=1e-14)


@cache
def net(name: str) -> Network:
    return {
        "pair": lambda: network(pair()),
        "shift and surface": lambda: with_shift_and_surface(network(pair())),
        "one held": lambda: network(pair(), held=(True, False)),
        "fixed points": lambda: with_fixed(network(pair())),
        "stereo": lambda: stereo_network(pair(12, 24), displaced=False),
    }[name]()


@cache
def solved(name: str, loss: Loss = "none") -> Solution:
    return adjust_network(net(name), replace(PLAIN, loss=loss))


@cache
def known(name: str, loss: Loss = "none") -> Reliability:
    return reliability(solved(name, loss))


NAMES = ["pair", "shift and surface", "one held", "fixed points", "stereo"]


def of_kind(found: Reliability, kind: MeasureKind, least: float = 0.01) -> np.ndarray:
    """Measures of a kind that others control."""
    return np.flatnonzero((found.measures.kind == kind) & (found.measures.redundancy > least))


def freed(whole: Network, found: Reliability, k: int) -> Network:
    """A network in which a measure has an unknown of its own: a thousand times its sigma."""
    table = found.measures
    row, component = int(table.row[k]), int(table.component[k])
    kind = table.kind[k]
    parts = {MeasureKind.RAY: "rays", MeasureKind.RANGE: "ranges", MeasureKind.HEIGHT: "surface",
             MeasureKind.STEREO: "stereo"}  # fmt: skip
    if kind in parts:
        part = getattr(whole, parts[kind])
        sigmas = part.sigmas.copy()
        sigmas[(row, component) if kind == MeasureKind.RAY else row] *= 1e5
        return replace(whole, **{parts[kind]: replace(part, sigmas=sigmas)})
    if kind == MeasureKind.GROUND:
        covariances = whole.points.covariances.copy()
        covariances[row, component, component] += 1e10
        return replace(whole, points=replace(whole.points, covariances=covariances))
    image, inside = int(table.image[k]), component
    sigmas = whole.priors[image].sigmas.copy()
    sigmas[divmod(inside, 6)] *= 1e4
    priors = list(whole.priors)
    priors[image] = replace(priors[image], sigmas=sigmas)
    return replace(whole, priors=tuple(priors))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("loss", ["none", "huber"])
def test_redundancy_numbers_add_up_to_the_degrees_of_freedom(name: str, loss: Loss) -> None:
    found, fit = known(name, loss), solved(name, loss).fit
    # the covariance is of where the last step began: on rough terrain that shows
    share = 1e-5 if "surface" in name else 1e-6
    assert found.measures.redundancy.sum() == pytest.approx(fit.degrees_of_freedom, abs=share)
    assert found.sigma0 == pytest.approx(fit.sigma0, rel=1e-6)
    assert len(found) == fit.observations


@pytest.mark.parametrize(
    ("name", "kind"),
    [("shift and surface", kind) for kind in MeasureKind if kind < MeasureKind.STEREO]
    + [("stereo", MeasureKind.STEREO), ("stereo", MeasureKind.GROUND), ("pair", MeasureKind.PRIOR)]
    + [("pair", MeasureKind.GROUND), ("fixed points", MeasureKind.RAY)],
)
def test_a_measure_with_an_unknown_of_its_own_lowers_the_cost_by_its_test(name: str, kind: MeasureKind) -> None:
    found = known(name)
    mine = of_kind(found, kind, 1e-4 if kind == MeasureKind.RANGE else 0.05)
    mine = mine[np.argsort(-np.abs(found.measures.test[mine]))][:3]
    assert mine.size
    for k in mine:
        cost = adjust_network(freed(net(name), found, int(k)), PLAIN).cost_final
        drop = 2.0 * (solved(name).cost_final - cost)
        assert drop == pytest.approx(found.measures.test[k] ** 2, rel=0.03, abs=0.003)


@pytest.mark.parametrize("kind", [MeasureKind.RAY, MeasureKind.GROUND])
def test_a_observation_with_unknowns_of_its_own_lowers_the_cost_by_its_joint_test(kind: MeasureKind) -> None:
    found = known("shift and surface")
    mine = of_kind(found, kind, 0.05)
    worst = mine[np.argsort(-found.measures.joint[mine])]
    rows, first = np.unique(found.measures.row[worst], return_index=True)
    for row in rows[np.argsort(first)][:3]:
        changed = net("shift and surface")
        for k in np.flatnonzero((found.measures.kind == kind) & (found.measures.row == row)):
            changed = freed(changed, found, int(k))
        drop = 2.0 * (solved("shift and surface").cost_final - adjust_network(changed, PLAIN).cost_final)
        assert drop == pytest.approx(found.measures.joint[k], rel=0.03, abs=0.003)


@pytest.mark.parametrize("kind", [MeasureKind.RAY, MeasureKind.RANGE, MeasureKind.GROUND])
def test_an_unnoticed_blunder_moves_its_point_as_far_as_is_said(kind: MeasureKind) -> None:
    found, whole = known("shift and surface"), net("shift and surface")
    for k in of_kind(found, kind, 0.1)[:3] if kind != MeasureKind.RANGE else of_kind(found, kind, 1e-3)[:3]:
        row, component = int(found.measures.row[k]), int(found.measures.component[k])
        size = found.measures.detectable[k]
        if kind == MeasureKind.RAY:
            places = whole.rays.places.copy()
            places[row, component] += size
            changed = replace(whole, rays=replace(whole.rays, places=places))
        elif kind == MeasureKind.RANGE:
            values = whole.ranges.values.copy()
            values[row] += size
            changed = replace(whole, ranges=replace(whole.ranges, values=values))
        else:
            places = whole.points.places.copy()
            places[row, component] += size
            changed = replace(whole, points=replace(whole.points, places=places))
        point = found.measures.point[k]
        moved = adjust_network(changed, PLAIN).places[point] - solved("shift and surface").places[point]
        assert np.linalg.norm(moved) == pytest.approx(found.measures.effect[k], rel=0.03)


def test_signs_are_measured_minus_predicted() -> None:
    found, whole = known("shift and surface"), net("shift and surface")
    solution, table = solved("shift and surface"), known("shift and surface").measures
    rays = table.kind == MeasureKind.RAY
    assert np.allclose(table.residual[rays].reshape(-1, 2), solution.residuals, atol=1e-6)
    ranges = table.kind == MeasureKind.RANGE
    assert np.allclose(table.residual[ranges], solution.range_residuals, atol=1e-6)
    ground = table.kind == MeasureKind.GROUND
    points = table.point[ground][::3]
    shift = np.einsum("k,nkj->nj", solution.shifts[0], east_north(whole.points.places[points]))
    offset = whole.points.places[points] + shift - solution.places[points]
    assert np.allclose(table.residual[ground].reshape(-1, 3), offset, atol=1e-4)
    heights = table.kind == MeasureKind.HEIGHT
    north = east_north(solution.places[table.point[heights]])
    at = solution.places[table.point[heights]] - np.einsum("k,nkj->nj", solution.shifts[1], north)
    assert np.allclose(table.residual[heights], -whole.surface.grid.height_above(at)[0], atol=0.05)
    on_stereo = known("stereo").measures
    mine = on_stereo.kind == MeasureKind.STEREO
    assert np.allclose(on_stereo.residual[mine], -solved("stereo").stereo_heights[on_stereo.point[mine]], atol=1e-6)
    prior = (table.kind == MeasureKind.PRIOR) & (table.image == 0)
    assert np.allclose(table.residual[prior], -solution.coefficients[0].ravel(), atol=1e-9)
    assert np.nanmin((table.test * table.residual)[~ground]) >= 0.0
    assert len(found) == table.test.size


def test_levels_are_the_tables() -> None:
    levels = Levels()
    assert levels.critical == pytest.approx(3.29, abs=0.001)  # Baarda 1968: 0.1 %, 80 %: delta0 = 4.13
    assert levels.shift**2 == pytest.approx(17.075, abs=0.001)
    assert Levels(alpha=0.05).shift**2 == pytest.approx(7.849, abs=0.001)
    for q in (1, 2, 3, 50):
        assert ncx2.sf(levels.critical_squares(q), q, levels.shift**2) == pytest.approx(0.80, abs=1e-6)
    assert chi2.sf(levels.critical_squares(1), 1) == pytest.approx(levels.alpha, rel=1e-6)


def test_what_nothing_controls_is_counted_and_named() -> None:
    found = known("pair")
    loose = found.uncontrolled
    assert 0 < loose.size < len(found)
    assert np.all(found.measures.redundancy[loose] <= UNCONTROLLED)
    assert np.all(np.isnan(found.measures.test[loose]))
    assert f"{loose.size} measures uncontrolled" in repr(found)
    assert any("sample of point TIE" in found.name(int(k)) for k in loose)  # along the parallax of a pair side by side


def test_rejected_rays_do_not_take_part() -> None:
    whole = net("pair")
    left = adjust_network(whole, replace(PLAIN, reject=2.5))
    found = reliability(left)
    assert np.any(~left.rays_used)
    rays = found.measures.kind == MeasureKind.RAY
    assert not np.any(np.isin(found.measures.row[rays], np.flatnonzero(~left.rays_used)))
    assert found.measures.redundancy.sum() == pytest.approx(left.fit.degrees_of_freedom, abs=1e-6)


def test_a_robust_test_is_that_of_the_prediction() -> None:
    """With weights p held, leaving a measure out altogether gives the prediction that its test is made of."""
    rng = np.random.default_rng(3)
    design, weight = rng.normal(size=(9, 3)), rng.uniform(0.2, 1.0, 9)
    observed = rng.normal(size=9) * 2.0
    weight[1] = weight[0]  # the rows of a ray have one weight
    scaled = design * np.sqrt(weight)[:, None]
    hat = scaled @ np.linalg.inv(scaled.T @ scaled) @ scaled.T
    left = np.sqrt(weight) * observed - hat @ (np.sqrt(weight) * observed)
    others = slice(2, None)
    cofactor = np.linalg.inv(scaled[others].T @ scaled[others])
    error = observed[:2] - design[:2] @ cofactor @ scaled[others].T @ (np.sqrt(weight) * observed)[others]
    covariance = np.eye(2) + design[:2] @ cofactor @ design[:2].T
    found, dimensions = pair_tests(left[None, :2], np.diag(hat)[None, :2], hat[0, 1:2], np.sqrt(weight[:1]))
    assert dimensions == 2
    assert found[0] == pytest.approx(error @ np.linalg.solve(covariance, error), rel=1e-9)


def test_ties_with_two_rays_are_one_group_and_others_are_not() -> None:
    found = known("pair")
    groups = suspects(found, len(found))
    listed = np.concatenate([one.measures for one in groups])
    assert np.unique(listed).size == listed.size
    assert np.isin(np.flatnonzero(np.isfinite(found.measures.test)), listed).all()
    ties = [one for one in groups if one.point >= 0 and found.at.network.points.ids[one.point].startswith("TIE")]
    assert len(ties) == 12
    assert all(one.measures.size == 4 for one in ties)
    shots = [one for one in groups if one.point >= 0 and one.point not in {tie.point for tie in ties}]
    assert all(one.measures.size < 4 for one in shots)
    sizes = [abs(one.test) for one in groups]
    assert sizes == sorted(sizes, reverse=True)
    assert [one.measures.tolist() for one in suspects(found, 3)] == [one.measures.tolist() for one in groups[:3]]


def test_correlations_of_tests_give_the_joint_test() -> None:
    """Of all tests of one point, from the kernel's own table: the joint test of a ray follows from them."""
    found = known("shift and surface")
    mine, matrix = correlations_of_tests(found, PointIndex(found.measures.point, len(found.at.network.points)), 13)
    assert np.all(found.measures.point[mine] == 13)
    assert np.allclose(np.diagonal(matrix), 1.0)
    assert np.abs(matrix).max() <= 1.0 + 1e-9
    rays = np.flatnonzero(found.measures.kind[mine] == MeasureKind.RAY)
    joint, w0, w1 = found.measures.joint[mine[rays[0]]], *found.measures.test[mine[rays[:2]]]
    rho = matrix[rays[0], rays[1]]
    assert joint == pytest.approx((w0**2 - 2.0 * rho * w0 * w1 + w1**2) / (1.0 - rho**2), rel=1e-6)


@pytest.mark.parametrize("kind", [MeasureKind.RAY, MeasureKind.RANGE, MeasureKind.GROUND])
def test_a_blunder_is_found_at_baardas_power(kind: MeasureKind) -> None:
    """2000 draws of the residuals v = (1 - H) e of a point's rows, with one measure off by one MDB."""

    found = known("shift and surface")
    k = int(of_kind(found, kind, 1e-3)[-1])
    point = int(found.measures.point[k])
    rows = found.at.rows_of(point)
    (covariance,), _ = residual_covariance(found.at, rows)
    chosen = combinations(found, np.array([k]), rows)[:, 0]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = np.random.default_rng(8).normal(size=(2000, values.size)) @ root.T
    sigma = np.sqrt(chosen @ covariance @ chosen)
    # the blunder, in sigmas of the measure, enters the rows by `chosen` and the residuals by the covariance
    shift = covariance @ chosen * found.measures.detectable[k] / found.measures.sigma[k]
    power = np.count_nonzero(np.abs((noise + shift) @ chosen / sigma) > found.critical)
    alarms = np.count_nonzero(np.abs(noise @ chosen / sigma) > found.critical)
    low, high = binom.ppf([0.005, 0.995], 2000, 0.80)
    assert low <= power <= high
    assert alarms <= binom.ppf(0.995, 2000, 0.001)
    assert norm.sf(found.critical - found.levels.shift) == pytest.approx(0.80)


# --- rows of what is known of passes beforehand


POSITION = np.array([[30.0, 40.0, 50.0], [5.0, 6.0, 7.0]])
ATTITUDE = np.array([[3e-4, 2e-4, 1e-4], [5e-5, 6e-5, 7e-5], [1e-5, 2e-5, 3e-5]])


@cache
def of_polynomials() -> Solution:
    """A pair whose first image is a pass: positions linear in time, attitude quadratic."""
    net = network(pair(ties=30, shots=8, seed=4))
    left = net.images[0]
    start, stop = left.timing.at(np.array([0.0, float(left.lines)]))[0]
    nodes = evenly_spaced("lagrange", left.trajectory.epoch, (start, stop), stop - start)
    one = Pass("one", np.array([0]), nodes, PolynomialPrior(POSITION, ATTITUDE))
    return adjust_network(replace(net, passes=(one,)), SolverSettings())


def test_rows_of_a_polynomial_are_of_its_coefficients() -> None:
    at = at_solution(of_polynomials())
    known, first = prior_rows(at), int(at.network.first_of_passes[0])
    begin = at.layout.columns_of(first).start
    mine = (known.about >= begin) & (known.about < begin + 24)
    found = known.sigma[mine][np.argsort(known.about[mine])].reshape(4, 6)
    np.testing.assert_allclose(found[:2, :3], POSITION)
    np.testing.assert_allclose(found[:3, 3:], ATTITUDE)
    assert np.all(np.isfinite(known.sigma) & (known.sigma > 0.0))
