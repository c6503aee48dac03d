"""Variance components: Helmert's matrix against R itself, planted factors found; blunders that the search removes."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from odd_networks import seen_by_the_held_one_alone, with_fixed
from outside import refuses
from redraw import redraw
from scipy.stats import kstest
from stereo_pair import on_surface, stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.components import (
    Judgement,
    components,
    iterated_components,
    judge_groups,
)
from mgsgraph.analysis.grouping import CORRELATED, Grouping, group_redundancy, group_rows, scaled
from mgsgraph.analysis.linearised import at_solution, at_values
from mgsgraph.analysis.measures import Levels
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.residual_tests import (
    ResidualStatistics,
    residual_statistics,
)
from mgsgraph.errors import InputError
from mgsgraph.kernel.rows import OUT
from mgsgraph.network import Network
from mgsgraph.simulation.observations import NoiseSettings

SETTINGS = SolverSettings()
NAMES = ["shift and surface", "held alone", "both held", "fixed points", "a blunder", "stereo"]
CLEAR = NoiseSettings(tie=1.0, shot_image=1.0, range=10.0, ground=3.0)
"""Under which ties, laser image points, ranges and ground priors of a pair can all be judged."""


@cache
def solved(name: str) -> Solution:
    nets: dict[str, Network] = {
        "shift and surface": with_shift_and_surface(network(pair())),
        "one held": network(pair(), held=(True, False)),
        "held alone": seen_by_the_held_one_alone(network(pair(), held=(True, False))),
        "both held": network(pair(), held=(True, True)),
        "fixed points": with_fixed(network(pair())),
        "a blunder": with_blunder(network(pair())),
        "stereo": stereo_network(pair(), displaced=False),
    }
    return adjust_network(nets[name], SolverSettings(reject=4.0 if name == "a blunder" else 0.0))


def with_blunder(net: Network) -> Network:
    places = net.rays.places.copy()
    places[net.rays.point == 14] += 400.0
    return replace(net, rays=replace(net.rays, places=places))


def linearised_at_solution(solution: Solution) -> Linearised:
    """Where it was solved, with the covariance of exactly that place."""
    marked = replace(
        solution.network,
        rays=replace(solution.network.rays, rejected=~solution.rays_used),
        ranges=replace(solution.network.ranges, rejected=~solution.ranges_used),
    )
    return at_values(marked, solution.settings, solution.values, solution.places)


def whole_system(at: Linearised, grouping: Grouping) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All whitened rows on all unknowns, points among them, their residuals and groups; nothing eliminated."""
    rows, of_observation, columns = at.rows, grouping.of_observations(at.layout), at.layout.columns
    wide = columns + 3 * at.points.shape[0]
    matrix, residuals, groups = list[np.ndarray](), list[float](), list[int]()
    for piece, (pattern, first, count, _, among) in enumerate(rows.piece.tolist()):
        part = at.rows_of_piece(piece)
        own = [np.arange(columns)[at.layout.columns_of(v)] for v in part.variables]
        mine = np.concatenate([np.zeros(0, dtype=int), *own])
        for i in range(count):
            for k in range(part.observation.size):
                if rows.kind[first + i] == OUT or not (np.any(part.by_point[i, k]) or np.any(part.by_shared[i, k])):
                    continue
                row = np.zeros(wide)
                row[mine] = part.by_shared[i, k]
                if not rows.pattern_fixed[pattern]:
                    row[columns + 3 * (first + i) : columns + 3 * (first + i) + 3] = part.by_point[i, k]
                matrix.append(row)
                residuals.append(part.residuals[i, k])
                groups.append(int(of_observation[among + part.observation[k] * count + i]))
    priors = np.eye(columns, wide) / at.layout.sigmas[:, None]
    values = -at.orientation / at.layout.sigmas
    return np.vstack([*matrix, priors]), np.append(residuals, values), np.append(groups, grouping.of_columns(at.layout))


def projector(matrix: np.ndarray) -> np.ndarray:
    """R = 1 - A (A'A)^-1 A', by the orthogonal basis of A's columns."""
    used = matrix[:, np.any(matrix != 0.0, axis=0)]
    basis = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)[0]
    return np.asarray(np.eye(len(matrix)) - basis @ basis.T)


@pytest.mark.parametrize("name", NAMES)
def test_helmert_s_matrix_is_that_of_the_whole_projector(name: str) -> None:
    at = linearised_at_solution(solved(name))
    grouping = group_rows(at.network)
    found = group_redundancy(at, grouping)
    matrix, residuals, groups = whole_system(at, grouping)
    cofactors = projector(matrix)
    size = len(grouping.names)
    right = np.array([
        [np.sum(cofactors[np.ix_(groups == g, groups == k)] ** 2) for k in range(size)] for g in range(size)
    ])  # fmt: skip
    assert np.array_equal(found.counts, np.bincount(groups, minlength=size))
    assert np.allclose(found.redundancy, np.bincount(groups, np.diag(cofactors), size), atol=1e-6)
    assert np.allclose(found.sums_of_squares, np.bincount(groups, residuals**2, size), rtol=1e-9)
    assert np.allclose(found.helmert, right, atol=1e-6 * right.max())


def test_random_signs_come_near_the_exact_matrix() -> None:
    at = linearised_at_solution(solved("shift and surface"))
    exact, estimate = (group_redundancy(at, group_rows(at.network), dense) for dense in (2000, 0))
    assert exact.exact
    assert not estimate.exact
    assert 0.0 < np.abs(exact.helmert - estimate.helmert).max() < 0.1
    assert np.allclose(estimate.helmert.sum(axis=1), exact.redundancy, atol=1e-6)


def test_scaling_a_group_scales_its_sigmas_and_no_others() -> None:
    net = on_surface(with_shift_and_surface(network(pair())), pair())
    grouping = group_rows(net)
    assert net.shifts is not None
    assert net.surface is not None
    assert net.stereo is not None
    for g, name in enumerate(grouping.names):
        factors = np.ones(len(grouping.names))
        factors[g] = 3.0
        new = scaled(net, grouping, factors)
        assert new.shifts is not None
        assert new.surface is not None
        ratios = {
            "tie image points": new.rays.sigmas[0] / net.rays.sigmas[0],
            "laser image points": new.rays.sigmas[-1] / net.rays.sigmas[-1],
            "ranges": new.ranges.sigmas / net.ranges.sigmas,
            "ground priors": np.sqrt(np.diag(new.points.covariances[-1]) / np.diag(net.points.covariances[-1])),
            "surface heights": new.surface.sigmas[0] / net.surface.sigmas[0],
            "stereo heights": new.stereo.sigmas[-1] / net.stereo.sigmas[-1],
            "position priors": new.priors[1].sigmas[:, :3] / net.priors[1].sigmas[:, :3],
            "pointing priors": new.priors[0].sigmas[:, 3:] / net.priors[0].sigmas[:, 3:],
            "shifts": np.array([new.shifts.sigmas[0] / net.shifts.sigmas[0], new.surface.shift_sigma / 150.0]),
        }
        for other, ratio in ratios.items():
            assert np.allclose(ratio, 3.0 if other == name else 1.0), (name, other)
    refuses("factors of sigmas", scaled, net, grouping, np.zeros(len(grouping.names)))


@cache
def clear_pair() -> Network:
    return network(pair(120, 90, 1, CLEAR))


@cache
def clear_stereo() -> Network:
    """Shots whose heights range, a-priori place and stereo surface give alike."""
    noise = NoiseSettings(tie=1.0, shot_image=1.0, range=3.0, ground=3.0)
    net = stereo_network(pair(40, 90, 1, noise), displaced=False, laser_rays=True)
    assert net.stereo is not None
    return replace(net, stereo=replace(net.stereo, sigmas=np.where(net.stereo.surface >= 0, 3.0, np.inf)))


def drawn(truth: dict[str, float], seed: int, net: Network | None = None) -> tuple[Network, np.ndarray]:
    """The pair with errors that are so many times larger than the sigmas that it states; and these factors."""
    net = net or clear_pair()
    grouping = group_rows(net)
    factors = np.array([truth.get(name, 1.0) for name in grouping.names])
    larger = redraw(scaled(net, grouping, factors), np.random.default_rng(seed)).network
    return scaled(larger, grouping, 1.0 / factors), factors


@pytest.mark.parametrize(
    "truth",
    [
        {"tie image points": 0.5, "laser image points": 2.0, "ranges": 5.0},
        {"tie image points": 5.0, "laser image points": 0.5, "ranges": 2.0, "ground priors": 5.0},
    ],
)
def test_planted_factors_are_found_within_their_uncertainty(truth: dict[str, float]) -> None:
    net, factors = drawn(truth, 5)
    found = iterated_components(net, SETTINGS)
    assert found.converged
    for one, factor in zip(found.components.groups[:4], factors, strict=False):
        if one.judgement is Judgement.ENTANGLED:  # vague, and correlated with that of the laser's image points
            assert one.name == "ground priors"
            assert abs(one.correlation) > CORRELATED
            assert one.factor == pytest.approx(factor, rel=0.6)
            assert math.isnan(one.sigma)
            assert one.consistent is None
            continue
        assert one.judgement is Judgement.JUDGED
        assert one.interval()[0] < factor < one.interval()[1]
        assert one.sigma < 0.25 * one.factor
        assert one.consistent is bool(factor == 1.0), one.sentence
    again = components(found.solution)
    for one in again.groups[:4]:
        assert one.factor == pytest.approx(1.0, abs=0.011)
    ratio = found.network.rays.sigmas[0, 0] / net.rays.sigmas[0, 0]
    assert ratio == pytest.approx(found.components["tie image points"].factor)


def test_a_planted_factor_of_the_stereo_sigmas_is_found() -> None:
    """And no other: the rest of the network stays as it is stated."""
    net, _ = drawn({"stereo heights": 2.0}, 5, clear_stereo())
    found = iterated_components(net, SETTINGS).components
    one = found["stereo heights"]
    assert one.judgement is Judgement.JUDGED
    assert one.interval()[0] < 2.0 < one.interval()[1]
    assert one.consistent is False
    assert all(other.consistent is not False for other in found.groups if other is not one)


def test_what_can_t_be_judged_keeps_its_sigmas_and_is_named() -> None:
    net = network(pair(60, 30))
    found = iterated_components(net, SETTINGS)
    one = found.components["ranges"]
    assert one.judgement in (Judgement.FEW, Judgement.INSEPARABLE)
    assert np.isnan(one.factor)
    assert one.consistent is None
    assert np.array_equal(found.network.ranges.sigmas, net.ranges.sigmas)
    with pytest.raises(InputError, match="no such group; expected one of tie image points"):
        _ = found.components["stars"]


@cache
def solved_default() -> Solution:
    return adjust_network(network(pair(60, 120)), SETTINGS)


def test_residuals_that_are_none_are_held_not_chased_to_zero() -> None:
    truth = {"tie image points": 1e-6}
    net, _ = drawn(truth, 3)
    found = iterated_components(net, SETTINGS)
    assert found.components["tie image points"].judgement is Judgement.ZERO
    assert found.components["tie image points"].factor == pytest.approx(0.02)
    assert found.components["laser image points"].consistent


@pytest.mark.parametrize("name", ["shift and surface", "a blunder", "stereo"])
def test_normalised_residuals_have_the_groups_redundancy(name: str) -> None:
    at = linearised_at_solution(solved(name))
    grouping = group_rows(at.network)
    groups, found = group_redundancy(at, grouping), residual_statistics(at, grouping)
    matrix, residuals, of_row = whole_system(at, grouping)
    r = np.diag(projector(matrix))
    for g, one in enumerate(found):
        assert one.values.size + one.uncontrolled == groups.counts[g]
        assert one.effective == pytest.approx(groups.redundancy[g], abs=0.02)
        mine = (of_row == g) & (r >= 1e-3)
        assert np.allclose(one.values, np.sort(residuals[mine] / np.sqrt(r[mine])), atol=1e-4)


def test_statistics_of_normal_and_other_residuals() -> None:
    rng = np.random.default_rng(2)
    plain = ResidualStatistics("normal", np.sort(rng.standard_normal(3000)), 0, 3000.0)
    tails = ResidualStatistics("tails", np.sort(rng.standard_t(3, 3000)), 0, 3000.0)
    assert plain.consistent
    assert tails.consistent is False
    assert plain.distance == pytest.approx(kstest(plain.values, "norm").statistic)
    assert plain.p_value == pytest.approx(kstest(plain.values, "norm").pvalue, abs=0.02)
    assert plain.beyond[0] == pytest.approx(0.3173, abs=0.03)
    assert abs(plain.kurtosis) < 3.0 * plain.sigmas[3] < tails.kurtosis
    assert abs(plain.skewness) < 3.0 * plain.sigmas[2]
    few = ResidualStatistics("few", plain.values[:3], 2, 1.5)
    assert np.isnan(few.p_value)
    assert few.consistent is None


def test_a_negative_square_is_said_to_be_foerstners(monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups that share redundancy, the first with residuals that are too small for what the others leave it."""
    solution = solved_default()
    found = group_redundancy(at_solution(solution), group_rows(solution.network))
    judged = [g for g, one in enumerate(judge_groups(found, {})) if one is Judgement.JUDGED]
    part, g = found.helmert[np.ix_(judged, judged)], judged[0]
    own = 9.0 * found.redundancy
    own[g] = 0.01 * found.redundancy[g]
    expected = 1.0 + np.linalg.solve(part, (own - found.redundancy)[judged])
    assert expected[0] < 0.0
    monkeypatch.setattr("mgsgraph.analysis.components.group_redundancy", lambda *_: replace(found, sums_of_squares=own))
    groups = components(solution).groups
    assert [groups[k].negative for k in judged] == (expected <= 0.0).tolist()
    assert groups[g].factor == pytest.approx(groups[g].foerstner) == pytest.approx(0.1)
    assert "negative" in groups[g].sentence


# --- data snooping: planted blunders go, good measures stay, what is inseparable goes together


TIE, SHOT, RANGE, PLACE = 3, 45, 8, 50


@cache
def clean() -> Network:
    return with_shift_and_surface(network(pair(ties=40, shots=20)))


def ray(net: Network, point: int, move: tuple[float, float]) -> tuple[Network, int]:
    """A network with a blunder in the first ray of a point."""
    k = int(np.flatnonzero(net.rays.point == point)[0])
    places = net.rays.places.copy()
    places[k] += move
    return replace(net, rays=replace(net.rays, places=places)), k


@cache
def planted() -> Network:
    net, _ = ray(clean(), TIE, (40.0, 5.0))
    net, _ = ray(net, SHOT, (-1.0, 90.0))
    values, places = net.ranges.values.copy(), net.points.places.copy()
    values[RANGE] += 300.0
    places[PLACE] += [0.0, 300.0, 200.0]
    return replace(net, ranges=replace(net.ranges, values=values), points=replace(net.points, places=places))


def snooped(net: Network) -> tuple[Solution, set[str]]:
    """Adjusted with the search at Baarda's critical value, and the points that it takes measurements of."""
    found = adjust_network(net, SolverSettings(reject=Levels().critical))
    points = net.rays.point[found.rays_rejected], net.ranges.point[found.ranges_rejected]
    return found, {net.points.ids[i] for i in np.concatenate(points).tolist()}


def test_planted_blunders_go_and_nothing_else_does() -> None:
    """A tie with two rays goes as a point, and so does what contradicts a wrong a-priori place."""
    found, gone = snooped(planted())
    assert gone == {"TIE00004", "SHOT00006", "SHOT00009", "SHOT00011"}
    assert np.sum(planted().rays.point[found.rays_rejected] == TIE) == 2
    tested = reliability(found, Levels()).measures
    for k in (1, 2, 3):
        assert np.all(tested.joint[tested.dimensions == k] <= Levels().critical_squares(k))
    assert found.sigma0 == pytest.approx(adjust_network(clean(), SolverSettings()).sigma0, abs=0.1)


def test_a_clean_network_is_left_alone() -> None:
    assert not snooped(clean())[1]


def test_known_blunders_stay_out_of_honest_sigmas() -> None:
    solution = adjust_network(planted(), SolverSettings(reject=4.0))
    rays, ranges = solution.rays_rejected, solution.ranges_rejected
    assert rays is not None and ranges is not None and np.any(rays)  # noqa: PT018
    marked = planted().with_rejected(rays, ranges, solution.stereo_rejected)
    settings = SolverSettings()
    one = components(at_values(marked, settings, solution.values, solution.places))
    first = iterated_components(marked, settings, most=1)
    assert not np.any(first.solution.rays_used & rays)
    assert not np.any(first.solution.ranges_used & ranges)
    for group, again in zip(one.groups, first.components.groups, strict=True):
        assert (again.name, again.rows) == (group.name, group.rows)
        assert again.sum_of_squares == pytest.approx(group.sum_of_squares, rel=1e-4)
    rest = iterated_components(marked, settings)
    assert rest.components["tie image points"].factor == pytest.approx(one["tie image points"].factor, rel=0.05)
    judged_anew = iterated_components(marked, replace(settings, reject=1e4), most=1).solution
    assert np.any(judged_anew.rays_used & rays)


@cache
def off_the_surface() -> Network:
    """Shots on a stereo surface with sigmas of 4 m; range and a-priori place of SHOT put it 30 m too low."""
    net = stereo_network(pair(40, 24, 1, NoiseSettings(range=1.0, ground=1.0)), displaced=False)
    assert net.stereo is not None
    values, places = net.ranges.values.copy(), net.points.places.copy()
    places[SHOT] -= 30.0 * places[SHOT] / np.linalg.norm(places[SHOT])
    values[net.ranges.point == SHOT] += 30.0
    sigmas = np.where(net.stereo.surface >= 0, 4.0, np.inf)
    return replace(
        net, ranges=replace(net.ranges, values=values), points=replace(net.points, places=places),
        stereo=replace(net.stereo, sigmas=sigmas),
    )  # fmt: skip


@pytest.mark.parametrize("settings", [SolverSettings(reject=4.0), SolverSettings(loss="tukey")])
def test_rejection_and_robust_losses_judge_heights_above_stereo_surfaces(settings: SolverSettings) -> None:
    """Where the sigma of the height is not the smallest, so that the residual shows the blunder."""
    whole = off_the_surface()
    found, plain = (adjust_network(whole, one) for one in (settings, SolverSettings()))
    assert found.converged
    assert np.flatnonzero(found.stereo_rejected).tolist() == [SHOT]
    others = np.delete(np.arange(40, 64), SHOT - 40)
    assert found.stereo_heights[SHOT] < -25.0 < plain.stereo_heights[SHOT]
    assert np.sqrt(np.mean(found.stereo_heights[others] ** 2)) < np.sqrt(np.mean(plain.stereo_heights[others] ** 2))
    again = at_solution(found)
    assert again.fit().squares == pytest.approx(found.fit.squares, rel=1e-6)
    assert again.fit().observations == found.fit.observations
