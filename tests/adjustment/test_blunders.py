"""Blunder limits by redundancy: clean data stay, what can be seen goes, what can't is said to be unchecked."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from block_ground import TerrainErrors
from mex_block import BlockSettings, simulate_hrsc_block
from mex_flight import PointMatching
from networks import network, pair
from scipy.stats import chi2, kstest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import closure, judged, observed_tests, squared_unit
from mgsgraph.adjustment.covariances import PointRows
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.geometry.body import east_north_up
from mgsgraph.network import Network, PointClass

LIMIT = SolverSettings(reject=4.0)


@cache
def block() -> Network:
    """Points in three to five lines each of two passes; no blunders of its own."""
    settings = BlockSettings(
        passes=2, length=120e3, points=120, matches=PointMatching(blunders=0.0), terrain=None
    )  # fmt: skip
    return simulate_hrsc_block(settings, 3).network


def planted(net: Network, share: float, seed: int) -> tuple[Network, np.ndarray]:
    """The network with errors of 12 to 100 sigmas in any direction, in one ray of a point at most; which rays."""
    rng = np.random.default_rng(seed)
    points = rng.permutation(np.unique(net.rays.point))[: round(share * net.rays.point.size)]
    rows = np.array([rng.choice(np.flatnonzero(net.rays.point == i)) for i in points])
    angle, size = rng.uniform(0.0, 2.0 * np.pi, rows.size), np.exp(rng.uniform(np.log(12), np.log(100), rows.size))
    places = net.rays.places.copy()
    places[rows] += (size * np.stack([np.cos(angle), np.sin(angle)])).T * net.rays.sigmas[rows]
    return replace(net, rays=replace(net.rays, places=places)), rows


def rejected(solution: Solution) -> np.ndarray:
    assert solution.rays_rejected is not None
    return np.flatnonzero(solution.rays_rejected)


def test_tests_of_good_rays_are_chi_square() -> None:
    """By the a-priori sigmas, of as many degrees of freedom as there is redundancy; one ray of a point, for the others
    depend on it.
    """
    chances = []
    for seed in range(6):
        net = network(pair(ties=40, shots=12, seed=300 + seed))
        at = at_solution(adjust_network(net, SolverSettings()))
        tests, dimensions = observed_tests(at, judged(at.layout))
        first = np.unique(net.rays.point, return_index=True)[1]
        assert set(dimensions[first].tolist()) == {1, 2}
        chances.append(chi2.sf(tests[first], dimensions[first]))
    assert kstest(np.concatenate(chances), "uniform").pvalue > 1e-3


def test_closures_of_good_rows_are_chi_square() -> None:
    """Of as many degrees of freedom as rows are chosen beyond the point's coordinates."""
    rng, m, r = np.random.default_rng(8), 400, 7
    by_point, by_shared = rng.standard_normal((m, r, 3)), rng.standard_normal((m, r, 4))
    root = 2.0 * rng.standard_normal((4, 4))
    off = np.einsum("mrc,cd,md->mr", by_shared, root, rng.standard_normal((m, 4)))
    off += np.einsum("mrk,mk->mr", by_point, 100.0 * rng.standard_normal((m, 3))) + rng.standard_normal((m, r))
    rows = PointRows((0,), off, by_point, by_shared, np.arange(r), np.zeros(r, dtype=np.int64), False)
    chosen = np.ones((m, r), dtype=bool)
    chosen[::2, 0] = False
    tests, dimensions = closure(rows, chosen, root @ root.T)
    assert dimensions.tolist() == [3, 4] * (m // 2)
    assert kstest(chi2.sf(tests, dimensions), "uniform").pvalue > 1e-3


def test_clean_data_stay() -> None:
    """Of 900 rays 0.06 are beyond four sigmas by chance; norms of residuals threw away three in a hundred."""
    gone = total = 0
    for seed in range(6):
        solution = adjust_network(network(pair(ties=60, shots=12, seed=500 + seed)), LIMIT)
        gone, total = gone + rejected(solution).size, total + solution.rays_used.size
    assert total > 840
    assert gone <= 2  # a tie goes with both rays


@pytest.mark.parametrize("stated", [1.0, 0.3, 3.0])
def test_many_blunders_go_and_others_stay_whatever_the_sigmas_are_said_to_be(stated: float) -> None:
    wrong, rows = planted(block(), 0.08, 1)
    solution = adjust_network(replace(wrong, rays=replace(wrong.rays, sigmas=wrong.rays.sigmas * stated)), LIMIT)
    gone = rejected(solution)
    assert np.isin(rows, gone).mean() > 0.95
    others = np.setdiff1d(gone, rows)
    assert np.all(np.isin(wrong.rays.point[others], wrong.rays.point[rows]))  # what can't be told from a blunder
    assert others.size < 0.1 * rows.size
    assert stated * solution.sigma0 == pytest.approx(1.0, abs=0.2)  # the priors' sigmas are as they were


def test_what_nothing_checks_is_neither_rejected_nor_called_good() -> None:
    """An error along the epipolar line of a tie with two rays is another height."""
    net = network(pair(ties=40, shots=12))
    clean = adjust_network(net, LIMIT)
    assert clean.test_dimensions is not None
    ties = net.points.classes[net.rays.point] == PointClass.TIE
    assert np.all(clean.test_dimensions[: ties.size][ties] == 1)
    at, k = at_solution(clean), int(np.flatnonzero(ties)[0])
    rows = at.rows_of(int(net.rays.point[k]))
    along = np.linalg.svd(rows.by_point[0])[0][:2, 3]  # of this ray's rows, what the point can't follow
    places = net.rays.places.copy()
    places[k] += 10.0 * np.array([-along[1], along[0]]) / np.linalg.norm(along) * net.rays.sigmas[k]
    assert not rejected(adjust_network(replace(net, rays=replace(net.rays, places=places)), LIMIT)).size
    places[k] = net.rays.places[k] + 12.0 * along / np.linalg.norm(along) * net.rays.sigmas[k]
    gone = adjust_network(replace(net, rays=replace(net.rays, places=places)), LIMIT)
    assert rejected(gone).tolist() == np.flatnonzero(net.rays.point == net.rays.point[k]).tolist()


def test_a_unit_is_the_a_priori_one_unless_the_class_contradicts_it() -> None:
    rng = np.random.default_rng(2)
    assert squared_unit(rng.chisquare(1, 20) / chi2.median(1), 20) == 1.0
    assert squared_unit(0.25 * rng.chisquare(2, 4000) / chi2.median(2), 4000) == pytest.approx(0.25, rel=0.1)
    few = 4.0 * rng.chisquare(1, 2) / chi2.median(1)
    assert squared_unit(few, 2) == 1.0


# above two seconds: adjusts a block of two passes twice
def test_blunders_are_sought_without_the_terrain_and_then_with_it() -> None:
    """The two steps of Spiegel et al. (2006): rays that contradict each other go in the first call, a point whose rays
    all agree on a place 900 m above the ground in the second.
    """
    settings = BlockSettings(passes=2, length=80e3, points=140, matches=PointMatching(blunders=0.01),
                             terrain=TerrainErrors(missing=0.01))  # fmt: skip
    made, wrong = simulate_hrsc_block(settings, seed=4), 7
    net, places = made.network, made.network.rays.places.copy()
    own = np.flatnonzero(net.rays.point == wrong)
    raised = made.true_points[[wrong]] + 900.0 * east_north_up(made.true_points[[wrong]])[0, 2]
    for k, image in zip(own.tolist(), net.rays.image[own].tolist(), strict=True):
        places[k] = net.images[image].ground_to_image(raised, made.corrections[image], places[[k], 0])[0][0]
    net = replace(net, rays=replace(net.rays, places=places))
    free = adjust_network(replace(net, surface=None), replace(LIMIT, starts=0))
    assert rejected(free).tolist() == np.flatnonzero(made.blunders).tolist()
    assert free.determined[wrong]
    rest = replace(net, rays=net.rays.chosen(free.rays_used))
    fitted = adjust_network(rest, replace(LIMIT, starts=0))
    assert free.converged
    assert fitted.converged
    assert not fitted.determined[wrong]
    assert set(rest.rays.point[rejected(fitted)].tolist()) == {wrong}
