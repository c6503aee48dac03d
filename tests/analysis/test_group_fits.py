"""sigma0 by group: it names the group whose errors are larger than stated, and nothing where sigmas are right."""

import math
from dataclasses import replace

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from scipy.stats import chi2

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import residual_tests as module
from mgsgraph.analysis.residual_tests import group_fits
from mgsgraph.network import ImageRays, Network, PointClass
from mgsgraph.results.results import statements
from mgsgraph.results.soundness import weight_unit

PLAIN = SolverSettings(starts=0)
TIES, CAUTIOUS = "tie image points, lines", "ground priors"


def noisier(net: Network, factor: float, seed: int) -> Network:
    """Ties with errors so many times larger than stated."""
    rays = net.rays
    ties = net.points.classes[rays.point] == PointClass.TIE
    more = np.random.default_rng([seed, 5]).normal(0.0, math.sqrt(factor**2 - 1.0), rays.places.shape) * rays.sigmas
    return replace(net, rays=replace(rays, places=rays.places + more * ties[:, None]))


def hidden(seed: int, factor: float = 1.5) -> Network:
    """Ties with larger errors than stated, behind many laser rows whose sigmas are three times too large."""
    net = noisier(network(pair(ties=60, shots=200, seed=seed)), factor, seed)
    points = replace(net.points, covariances=9.0 * net.points.covariances)
    return replace(net, points=points, ranges=replace(net.ranges, sigmas=3.0 * net.ranges.sigmas))


def adjusted(net: Network) -> Solution:
    return adjust_network(net, PLAIN)


@pytest.fixture(scope="module")
def behind() -> Solution:
    return adjusted(hidden(3))


def test_groups_add_up_to_the_whole() -> None:
    for net in (network(pair()), with_shift_and_surface(network(pair()))):
        solution = adjusted(net)
        fits = group_fits(solution)
        assert fits is not None
        assert sum(one.rows for one in fits) == solution.fit.observations
        assert sum(one.redundancy for one in fits) == pytest.approx(solution.fit.degrees_of_freedom, rel=1e-6)
        assert sum(one.squares for one in fits) == pytest.approx(solution.fit.squares, rel=1e-6)
        assert len({one.name for one in fits}) == len(fits)
        assert group_fits(solution) is fits  # a solution never changes


def test_noisy_ties_are_named_behind_cautious_laser_rows(behind: Solution) -> None:
    """The sigma0 of all is below one: it would have been called cautious."""
    fits = {one.name: one for one in group_fits(behind) or ()}
    assert behind.sigma0 < 1.0
    assert fits[TIES].worse
    assert 1.2 < fits[TIES].sigma0 < 1.8
    assert fits[CAUTIOUS].better
    said = " ".join(weight_unit(behind))
    assert TIES in said
    assert "if you trust the fit" not in said
    assert "if you trust the fit" not in " ".join(statements(behind))


def test_right_sigmas_name_nothing_and_wrong_ones_always() -> None:
    """Two draws; 100 of each are in docs/analysis.md."""
    for seed in range(2):
        clean = group_fits(adjusted(network(pair(ties=30, shots=60, seed=400 + seed)))) or ()
        assert not [one.name for one in clean if one.worse or one.better]
        wrong = group_fits(adjusted(hidden(500 + seed, 1.8))) or ()
        assert [one.name for one in wrong if one.worse] == [TIES]


def test_all_groups_share_one_probability_of_a_false_alarm(behind: Solution) -> None:
    """What lies beyond all bands together, of chi-square with their redundancies."""
    judged = [one for one in group_fits(behind) or () if one.judged]
    beyond = [
        chi2.cdf(one.redundancy * one.low**2, one.redundancy) + chi2.sf(one.redundancy * one.high**2, one.redundancy)
        for one in judged
    ]
    assert len(judged) > 2
    np.testing.assert_allclose(beyond, module.ODDS / len(judged), rtol=1e-6)


def test_rejection_and_losses_are_allowed_for(behind: Solution) -> None:
    """Tails that rejection takes lower the squares; a robust loss makes of them no chi-square at all."""
    net = network(pair(ties=60, shots=60, seed=8))
    plain = {one.name: one for one in group_fits(adjusted(net)) or ()}
    rejecting = {one.name: one for one in group_fits(adjust_network(net, replace(PLAIN, reject=2.0))) or ()}
    assert rejecting[TIES].low < 0.9 * plain[TIES].low
    robust = group_fits(adjust_network(net, replace(PLAIN, loss="huber")))
    assert robust is not None
    assert not any(one.judged for one in robust)


def test_back_projected_places_are_no_measures() -> None:
    net = network(pair(ties=30, shots=60))
    laser = net.points.classes[net.rays.point] == PointClass.LASER
    own = net.rays
    rays = ImageRays(own.point, own.image, own.places, own.sigmas, back_projected=laser)
    fits = group_fits(adjusted(replace(net, rays=rays))) or ()
    assert any("back-projected" in one.name for one in fits)
    assert not any(one.judged for one in fits if "back-projected" in one.name)
