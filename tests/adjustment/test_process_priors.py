"""Gaussian processes and polynomials as priors of a pass, in whole adjustments: against today's strips, against dense
covariances of all nodes, and against polynomials of images.
"""

from dataclasses import replace

import numpy as np
import pytest
from joint_prior import JointNodePrior
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.orientation import OrientationImages, OrientationPrior, evenly_spaced
from mgsgraph.network import Network, Pass, PassPrior, PolynomialPrior, Process, ProcessPrior
from mgsgraph.network.conditioning import ProcessKind, dense_covariance
from mgsgraph.network.passes import normalised
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block

TIGHT = SolverSettings(cost_tolerance=1e-14, step_tolerance=1e-9)


def with_prior(net: Network, prior: PassPrior) -> Network:
    """The same with another prior of all passes."""
    return replace(net, passes=tuple(replace(one, prior=prior) for one in net.passes))


def as_process(net: Network, kind: ProcessKind = "gauss-markov") -> ProcessPrior:
    """A process of the same sigmas, correlation time, bias and drift as the strips of a network have."""
    prior = net.passes[0].prior
    parts = [Process(kind, prior.sigmas[mine], prior.correlation_time) for mine in (slice(0, 3), slice(3, 6))]
    return ProcessPrior((parts[0],), (parts[1],), prior.bias, prior.drift)


def dense(prior: ProcessPrior, nodes: OrientationImages) -> JointNodePrior:
    """Rows of the inverse of the covariance of all nodes, trend and process, by the covariance functions alone."""
    s, count = normalised(nodes), len(nodes)
    root = np.zeros((6 * count, 6 * count))
    for c in range(6):
        processes = prior.position if c < 3 else prior.attitude
        whole = dense_covariance(processes, c % 3, nodes)
        whole = whole + prior.bias[c] ** 2 + prior.drift[c] ** 2 * np.outer(s, s)
        scale = np.sqrt(np.diagonal(whole))
        lower = np.linalg.cholesky(whole / np.outer(scale, scale))
        root[c * count : (c + 1) * count, c::6] = np.linalg.solve(lower, np.diag(1.0 / scale))
    return JointNodePrior(root)


def differences(one: Solution, other: Solution) -> dict[str, float]:
    """Largest differences of two solutions: of values in sigmas, of sigmas as shares."""
    found = {"cost": abs(one.cost_final / other.cost_final - 1.0)}
    covariances = [np.diagonal(each.covariances, axis1=1, axis2=2) for each in (one, other)]
    found["points"] = float(np.abs((one.places - other.places) / np.sqrt(covariances[1])).max())
    found["sigmas of points"] = float(np.abs(np.sqrt(covariances[0] / covariances[1]) - 1.0).max())
    sigmas = [node_sigmas(each) for each in (one, other)]
    moved = np.abs(np.concatenate([(a - b).ravel() for a, b in zip(one.nodes, other.nodes, strict=True)]))
    found["nodes"] = float((moved / sigmas[1]).max())
    found["sigmas of nodes"] = float(np.abs(sigmas[0] / sigmas[1] - 1.0).max())
    return found


def node_sigmas(solution: Solution) -> np.ndarray:
    """(6 k,) posterior sigmas of the nodes of all passes, one pass after another."""
    every = list[np.ndarray]()
    for one, first in solution.network.numbered_passes:
        blocks = (solution.joint_covariance.of([first + k]) for k in range(len(one.nodes)))
        every += [np.sqrt(np.diagonal(block)) for block in blocks]
    return np.concatenate(every)


def assert_the_same(one: Solution, other: Solution, within: dict[str, float]) -> None:
    assert one.converged
    assert other.converged
    found = differences(one, other)
    for name, most in within.items():
        assert found[name] < most, f"{name}: {found}"


def test_a_gauss_markov_process_gives_todays_strips() -> None:
    net = simulate_hrsc_block(BlockSettings(strips=2, points=120, length=200e3, terrain=None), 1).network
    after = adjust_network(with_prior(net, as_process(net)), TIGHT)
    within = {"cost": 1e-10, "nodes": 1e-5, "sigmas of nodes": 1e-7, "points": 1e-5, "sigmas of points": 1e-7}
    assert_the_same(after, adjust_network(net, TIGHT), within)


@pytest.mark.parametrize("kind", ["gauss-markov", "matern-3/2", "matern-5/2"])
def test_rows_between_neighbours_give_what_the_dense_prior_gives(kind: ProcessKind) -> None:
    block = BlockSettings(strips=1, points=200, length=400e3, spacing=12.0, terrain=None)
    net = simulate_hrsc_block(block, 2).network
    prior = as_process(net, kind)
    sparse, joint = (adjust_network(with_prior(net, one), TIGHT) for one in (prior, dense(prior, net.passes[0].nodes)))
    exact = kind == "gauss-markov"
    share = 1e-6 if exact else 0.02
    within = {"cost": 1e-8 if exact else 2e-3, "nodes": 1e-4 if exact else 0.2, "sigmas of nodes": share,
              "points": 1e-4 if exact else 0.1, "sigmas of points": share}  # fmt: skip
    assert_the_same(sparse, joint, within)


@pytest.mark.parametrize("degrees", [(0, 1), (1, 3), (2, 2)], ids=str)
def test_a_polynomial_of_a_pass_is_that_of_its_image(degrees: tuple[int, int]) -> None:
    """Each image a pass of its own; where the degrees differ, an image's prior holds the higher terms."""
    shares = np.array([1.0, 0.3, 0.1, 0.05])[:, None]
    position, attitude = (
        shares[: degree + 1] * np.full(3, size) for degree, size in zip(degrees, (100.0, 3e-4), strict=True)
    )
    sigmas = np.tile([1e-4 * 100.0] * 3 + [1e-4 * 3e-4] * 3, (max(degrees) + 1, 1))
    sigmas[: degrees[0] + 1, :3], sigmas[: degrees[1] + 1, 3:] = position, attitude
    plain = replace(net := network(pair(ties=60, shots=12)), priors=(OrientationPrior(sigmas),) * len(net.images))
    passes, prior = list[Pass](), PolynomialPrior(position, attitude)
    for j, image in enumerate(plain.images):
        start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), (stop - start) / 3.0)
        passes.append(Pass(image.name, np.array([j]), nodes, prior))
    one, other = (adjust_network(each, TIGHT) for each in (plain, replace(plain, passes=tuple(passes))))
    assert other.cost_final == pytest.approx(one.cost_final, rel=1e-6)
    scale = np.sqrt(np.diagonal(one.covariances, axis1=1, axis2=2))
    np.testing.assert_allclose((other.places - one.places) / scale, 0.0, atol=1e-4)
    np.testing.assert_allclose(np.diagonal(other.covariances, axis1=1, axis2=2) / scale**2, 1.0, atol=1e-4)
    for j, image in enumerate(plain.images):
        lines = np.linspace(0.0, image.lines, 7)
        want, found = (each.correction(j).at(image.moments(lines))[0] for each in (one, other))
        np.testing.assert_allclose((found - want) / np.array([100.0] * 3 + [3e-4] * 3), 0.0, atol=1e-5)
