"""Several minima over a terrain model's shift: found, weighted, and carried into the covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.multistart import starts_wanted
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.network import TERRAIN, Network

TERRAIN_VARIABLE = 3
"""Two images, the profile, the terrain model."""


@cache
def net() -> Network:
    """Few ties on a terrain model that may lie kilometres off: ground of sines looks alike in several places."""
    found = with_shift_and_surface(network(pair()))
    assert found.surface is not None
    return replace(found, surface=replace(found.surface, shift_sigma=2000.0))


@cache
def solved(starts: int | None = None) -> Solution:
    return adjust_network(net(), SolverSettings(starts=starts))


def test_they_are_what_adjustments_begun_at_them_find() -> None:
    """Each is a minimum: an adjustment that begins a third of its sigma beside it comes back to its cost and shift."""
    minima = solved().minima
    assert minima is not None
    assert minima.starts == 16
    assert sum(one.starts for one in minima.each) + minima.lost == 17
    assert len(minima.each) >= 3
    assert minima.each[0].cost == min(one.cost for one in minima.each) == solved().cost_final
    assert sum(one.weight for one in minima.each) == pytest.approx(1.0)
    for one in minima.each:
        values = [value.copy() for value in solved().values]
        values[TERRAIN_VARIABLE] = one.shift + 0.3 * np.sqrt(np.diag(one.spread))
        again = adjust_network(net(), SolverSettings(), begin=values)
        assert again.minima is None
        assert again.cost_final == pytest.approx(one.cost, abs=1e-4)
        np.testing.assert_allclose(again.shift_values[-1], one.shift, atol=1.0)
        np.testing.assert_allclose(again.shift_spread(1), one.spread, rtol=1e-2, atol=1.0)


def test_the_covariance_is_the_mean_square_about_the_lowest() -> None:
    mixture, alone, minima = solved(), solved(0), solved().minima
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
    name = net().points.ids[0]
    np.testing.assert_allclose(Posterior.of(mixture).point(name).covariance, mixture.covariances[0], rtol=1e-3)
    assert np.all(np.trace(mixture.covariances, axis1=1, axis2=2) > 0.9 * np.trace(alone.covariances, axis1=1, axis2=2))


def test_weights_are_laplaces() -> None:
    """Of minima so alike in their curvature, by their costs and the determinants of their shifts' covariances to some
    tens of a per cent.
    """
    minima = solved().minima
    assert minima is not None
    first, second = minima.each[:2]
    root = np.sqrt(np.linalg.det(second.spread) / np.linalg.det(first.spread))
    assert second.weight / first.weight == pytest.approx(np.exp(first.cost - second.cost) * root, rel=0.5)


def test_redundancy_is_that_of_one_minimum() -> None:
    found = reliability(at_solution(solved())).measures
    assert found.redundancy.sum() == pytest.approx(solved().fit.degrees_of_freedom, abs=1e-3)


def test_without_a_shift_to_be_estimated_there_are_none() -> None:
    for one in (network(pair()), replace(net(), considered=(TERRAIN,))):
        settings = SolverSettings(starts=4)
        assert starts_wanted(one, settings, lay_out(one, settings)) == 0
    layout = lay_out(net(), SolverSettings())
    assert starts_wanted(net(), SolverSettings(), layout) == 16
    assert starts_wanted(net(), SolverSettings(starts=4), layout) == 4
    assert starts_wanted(net(), SolverSettings(loss="huber"), layout.with_loss("huber")) == 0
