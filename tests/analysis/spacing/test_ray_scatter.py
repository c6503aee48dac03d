"""How much rays scatter: found whatever orientation does; what residuals ask for does not hang on stated sigmas."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.spacing.choice import respaced
from mgsgraph.analysis.spacing.corrections import correction_series
from mgsgraph.analysis.spacing.densify import densify, pattern
from mgsgraph.analysis.spacing.rays import ray_scatter
from mgsgraph.analysis.spacing.spectrum import spectra
from mgsgraph.network import Network
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.strip_truth import Jitter
from mgsgraph.units import MGON

PITCH = Jitter(4.0 * MGON, 0.06, "pitch")
CALM = TrajectoryErrors(attitude_wander=0.3 * MGON, position_wander=0.3)


@cache
def block(jitter: Jitter | None = None, errors: TrajectoryErrors | None = None, seed: int = 1) -> Network:
    """One strip of 80 s, without terrain; nodes every 4 s."""
    settings = BlockSettings(
        strips=1, length=150e3, points=700, terrain=None, spacing=4.0, jitter=jitter,
        errors=errors or TrajectoryErrors(),
    )  # fmt: skip
    return simulate_hrsc_block(settings, seed).network


def misstated(network: Network, factor: float) -> Network:
    """A network whose rays are stated with so many times their sigmas."""
    return replace(network, rays=replace(network.rays, sigmas=factor * network.rays.sigmas))


@pytest.mark.parametrize("stated", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("spacing", [4.0, 20.0])
@pytest.mark.parametrize("jitter", [None, PITCH])
def test_scatter_is_that_of_rays_whatever_nodes_follow(jitter: Jitter | None, spacing: float, stated: float) -> None:
    """Jitter of five times the noise that nodes 20 s apart can't follow counts for none of it; in sigma0 it does."""
    solution = adjust_network(respaced(misstated(block(jitter), stated), spacing), SolverSettings())
    found = ray_scatter(solution)
    assert found.error < 0.016 / stated
    assert found.factor * stated == pytest.approx(1.0, abs=3.5 * found.error * stated)
    assert found.contradicts == (stated != 1.0)
    if jitter and spacing == 20.0:
        assert solution.sigma0 * stated > 1.4


def test_too_few_rays_are_taken_at_their_word() -> None:
    solution = adjust_network(block(), SolverSettings())
    used = np.zeros_like(solution.rays_used)
    used[:20] = True
    found = ray_scatter(replace(solution, rays_used=used & solution.rays_used))
    assert (found.factor, found.error, found.contradicts) == (1.0, float("inf"), False)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sigmas_half_as_large_as_they_are_ask_for_nothing(seed: int) -> None:
    """Neither for closer nodes nor for vibrations: those are compared with what rays do scatter."""
    net = misstated(block(None, CALM, seed), 0.5)
    solution = adjust_network(net, SolverSettings())
    found, plain = pattern(solution, 0), pattern(solution, 0, 1.0)
    assert not found.asking(0.01, 0.1, found.squares.size).any()
    assert plain.asking(0.01, 0.1, plain.squares.size).any()
    scattered, stated = correction_series(solution, 0), correction_series(solution, 0, 1.0)
    assert scattered.factor == ray_scatter(solution).factor > 1.9
    np.testing.assert_allclose(scattered.noise, scattered.factor**2 * stated.noise)
    assert not any(one.vibrations for one in spectra(scattered))


def test_jitter_is_seen_however_rays_are_stated() -> None:
    for stated in (0.5, 2.0):
        found = densify(respaced(misstated(block(PITCH), stated), 20.0), SolverSettings())
        assert found.rounds[0].asked[0] == found.rounds[0].nodes[0] - 1
        assert found.rounds[-1].asked == (0,)
        assert found.rounds[-1].factor * stated == pytest.approx(1.0, abs=0.05)
