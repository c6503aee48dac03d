"""Strengths of processes: against the likelihood of the dense Gaussian process, and against planted ones."""

from dataclasses import replace

import numpy as np
import pytest
from networks import network as pair_network
from networks import pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.process_strengths import estimated_strengths
from mgsgraph.analysis.separability import inseparable
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Network, NodePrior, Pass, Process, ProcessPrior
from mgsgraph.network.conditioning import dense_covariance
from mgsgraph.network.passes import normalised
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block

ERRORS = TrajectoryErrors(correlation_time=30.0, position_wander=10.0)
SETTINGS = BlockSettings(strips=1, length=200e3, points=200, spacing=5.0, terrain=None, errors=ERRORS)


def network(seed: int, off: float, estimated: bool = True) -> Network:
    """A strip whose processes' strengths are off by a factor."""
    net = simulate_hrsc_block(SETTINGS, seed).network
    prior = net.passes[0].prior
    assert isinstance(prior, NodePrior)
    position, attitude = (
        Process("gauss-markov", off * prior.sigmas[part], 30.0, estimated=estimated) for part in (slice(3), slice(3, 6))
    )
    mine = ProcessPrior((position,), (attitude,), prior.bias, prior.drift)
    return replace(net, passes=(replace(net.passes[0], prior=mine),))


def test_it_is_the_maximum_of_the_likelihood() -> None:
    """-log L from the data's own information on the nodes and the dense process, maximised by brute force."""
    net = network(4, 3.0)
    found = estimated_strengths(net, SolverSettings(), tolerance=1e-5)
    solution, one = found.solution, found.network.passes[0]
    prior = one.prior
    assert isinstance(prior, ProcessPrior)
    size = 6 * len(one.nodes)
    first = int(found.network.first_of_passes[0])
    joint = at_solution(solution).of_estimator().joint.of(range(first, first + len(one.nodes) + 1))[:size, :size]
    s = normalised(one.nodes)

    def covariance(factors: np.ndarray) -> np.ndarray:
        whole = np.zeros((size, size))
        for c in range(6):
            part = (prior.position if c < 3 else prior.attitude)[0].scaled(np.full(3, factors[c // 3]))
            trend = prior.bias[c] ** 2 + prior.drift[c] ** 2 * np.outer(s, s)
            whole[c::6, c::6] = dense_covariance((part,), c % 3, one.nodes) + trend
        return whole

    before = np.linalg.inv(covariance(np.ones(2)))
    data = np.linalg.inv(joint) - before
    push = np.linalg.solve(joint, solution.nodes[0].ravel())

    def cost(logs: np.ndarray) -> float:
        both = data + np.linalg.inv(covariance(np.exp(logs)))
        signs = np.linalg.slogdet(both)[1] + np.linalg.slogdet(covariance(np.exp(logs)))[1]
        return 0.5 * float(signs - push @ np.linalg.solve(both, push))

    step = 0.02
    for way in np.eye(2):
        low, middle, high = (cost(k * step * way) for k in (-1, 0, 1))
        slope, curvature = (high - low) / (2.0 * step), (high - 2.0 * middle + low) / step**2
        assert curvature > 0.0
        assert abs(slope / np.sqrt(curvature)) < 0.01


# above two seconds: each of two searches adjusts a dozen times
def test_planted_strengths_are_found() -> None:
    """From three times too much and from a third: the same, and within 3.5 of its sigmas of the truth."""
    ends = [estimated_strengths(network(5, off), SolverSettings()) for off in (3.0, 0.33)]
    for one, other in zip(*(end.strengths for end in ends), strict=True):
        assert one.sigma == pytest.approx(other.sigma, abs=0.25 * one.error)
    truth = (ERRORS.position_wander, ERRORS.attitude_wander)
    logs = [np.log(one.sigma / true) for one, true in zip(ends[0].strengths, truth, strict=True)]
    assert np.all(np.abs(logs / np.sqrt(np.diagonal(ends[0].covariance))) < 3.5)
    assert ends[0].converged
    assert str(ends[0]).count("gauss-markov") >= 2


def test_what_cannot_be_told_apart_is_said() -> None:
    """Of a narrow camera each image by itself: along the track and pitch, across and roll do the same to its rays."""
    net = pair_network(pair(ties=60, shots=12))
    prior = ProcessPrior(
        (Process("matern-3/2", np.full(3, 80.0), 4.0),), (Process("matern-3/2", np.full(3, 2e-4), 4.0),),
        np.array([200.0] * 3 + [4e-4] * 3), np.zeros(6),
    )  # fmt: skip
    passes = []
    for j, image in enumerate(net.images):
        start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), (stop - start) / 5.0)
        passes.append(Pass(image.name, np.array([j]), nodes, prior))
    solution = adjust_network(replace(net, passes=tuple(passes)), SolverSettings())
    found = inseparable(solution.network, solution.joint_covariance, solution.settings.angles)
    name = solution.network.passes[1].name
    wanted = {f"along-track position of pass {name}", f"pitch of pass {name}"}
    assert any(wanted <= {part.name for part in one.quantities} for one in found)
    for one in found:
        assert one.sigma < 0.35 * one.quantities[0].sigma
        assert "inseparable" in one.sentence


def test_nothing_to_estimate_is_said() -> None:
    with pytest.raises(InputError, match="none that is to be estimated"):
        estimated_strengths(network(1, 1.0, estimated=False), SolverSettings())


def test_passes_have_their_strengths_in_common() -> None:
    """Of two strips that begin unlike each other: one strength, and after a round both have it."""
    net = simulate_hrsc_block(replace(SETTINGS, strips=2), 3).network
    passes = []
    for k, one in enumerate(net.passes):
        assert isinstance(one.prior, NodePrior)
        slow = Process("gauss-markov", (1.0 + k) * one.prior.sigmas[3:], 30.0, estimated=True)
        still = Process("gauss-markov", one.prior.sigmas[:3], 30.0)
        passes.append(replace(one, prior=ProcessPrior((still,), (slow,), one.prior.bias, one.prior.drift)))
    found = estimated_strengths(replace(net, passes=tuple(passes)), SolverSettings(), most=2)
    (only,) = found.strengths
    assert only.passes == tuple(one.name for one in net.passes)
    assert "common to 2 passes" in str(found)
    priors = [one.prior for one in found.network.passes]
    first, second = (one.attitude[0].sigmas for one in priors if isinstance(one, ProcessPrior))
    np.testing.assert_array_equal(first, second)


def test_what_is_hardly_seen_is_held_at_nothing() -> None:
    """Processes a thousand times smaller than what measures can see."""
    net = network(6, 1e-3)
    found = estimated_strengths(net, SolverSettings(), most=1)
    assert not any(one.searched for one in found.strengths)
    assert str(found).count("held at nothing") == 2
