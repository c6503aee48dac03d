"""True orientation of strips: draws against what the prior's own rows state, and jitter."""

import numpy as np
import pytest
from redraw import assert_unit_variance

from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import NodePrior
from mgsgraph.network.passes import LinearFactor, normalised
from mgsgraph.simulation.hrsc_block import TrajectoryErrors
from mgsgraph.simulation.hrsc_flight import Jitter, correction_at, drawn_nodes, true_correction


def information(prior: NodePrior, count: int, factors: list[LinearFactor]) -> np.ndarray:
    """(6 k, 6 k) of the nodes, the trend eliminated."""
    widths = [6] * count + [prior.trend_sigmas.size]
    edges = np.concatenate([[0], np.cumsum(widths)])
    whole = np.zeros((edges[-1], edges[-1]))
    for factor in factors:
        rows = np.zeros((factor.blocks[0].shape[0], edges[-1]))
        for unknown, part in zip(factor.unknowns, factor.blocks, strict=True):
            rows[:, edges[unknown] : edges[unknown + 1]] = part
        whole += rows.T @ rows
    n = 6 * count
    return np.asarray(whole[:n, :n] - whole[:n, n:] @ np.linalg.solve(whole[n:, n:], whole[n:, :n]))


@pytest.mark.parametrize("correlation_time", [0.0, 30.0])
def test_drawn_nodes_have_the_covariance_that_the_prior_s_rows_state(correlation_time: float) -> None:
    """Draws whitened by the root of the rows' information, the trend eliminated, are standard normal numbers."""
    prior = TrajectoryErrors(correlation_time=correlation_time).prior
    nodes, rng = evenly_spaced("lagrange", 0.0, (-40.0, 60.0), 20.0), np.random.default_rng(4)
    root = np.linalg.cholesky(information(prior, len(nodes), list(prior.factors(nodes))))
    drawn = np.array([drawn_nodes(prior, nodes, rng).ravel() for _ in range(1500)])
    white = drawn @ root
    assert_unit_variance(white)
    assert np.abs(np.cov(white.T) - np.eye(white.shape[1])).max() < 6.0 * np.sqrt(2.0 / 1500)
    spread = drawn.reshape(1500, -1, 6) / prior.node_sigmas(normalised(nodes))
    np.testing.assert_allclose(np.sqrt(np.mean(spread**2, axis=0)), 1.0, atol=4.5 / np.sqrt(2 * 1500))


def test_a_jitter_on_no_correction_is_the_jitter_itself() -> None:
    still = NodePrior(np.full(6, 1e-12), np.zeros(6), np.zeros(6))
    nodes = evenly_spaced("lagrange", 0.0, (-10.0, 10.0), 2.0)
    found = true_correction(still, nodes, None, Jitter(1e-5, 0.5, "pitch"), np.random.default_rng(0))
    values = correction_at(found, np.linspace(-10.0, 10.0, 2001), 0.0)
    assert np.abs(values[:, 3]).max() == pytest.approx(1e-5, rel=0.01)
    assert np.abs(values[:, [0, 1, 2, 4, 5]]).max() < 1e-10
