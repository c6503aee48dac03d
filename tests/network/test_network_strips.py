"""What is known of a strip's orientation images beforehand: the process that it says it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_prior import JointNodePrior
from networks import as_nodes, network, pair

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationImages, OrientationPrior, evenly_spaced
from mgsgraph.network import NodePrior, Pass
from mgsgraph.network.passes import normalised

TIMES = np.array([0.0, 2.0, 3.0, 7.0, 11.0])
NODES = OrientationImages("lagrange", 0.0, TIMES)
SIGMAS = np.array([1.0, 2.0, 3.0, 1e-5, 2e-5, 3e-5])


def whole(prior: NodePrior | JointNodePrior, trend: int, nodes: OrientationImages = NODES) -> np.ndarray:
    """(6 k + w, 6 k + w) normal matrix of all its rows."""
    first = np.cumsum([0] + [6] * len(nodes) + [trend])
    normal = np.zeros((first[-1],) * 2)
    for unknowns, blocks, about in prior.factors(nodes):
        assert all(block.shape[0] == len(about) for block in blocks)
        for v, left in zip(unknowns, blocks, strict=True):
            for w, right in zip(unknowns, blocks, strict=True):
                normal[first[v] : first[v + 1], first[w] : first[w + 1]] += left.T @ right
    return normal


@given(st.sampled_from([0.0, 1.5, 20.0, 1e4]), st.sampled_from([0.0, 4.0]), st.sampled_from([0.0, 3.0]))
def test_rows_are_bias_drift_and_a_gauss_markov_process(time: float, bias: float, drift: float) -> None:
    """Their covariance: bias^2 + s s' drift^2 + sigma^2 exp(-|dt| / time)."""
    prior = NodePrior(SIGMAS, bias * SIGMAS, drift * SIGMAS, time)
    trend = 6 * (bool(bias) + bool(drift))
    covariance = np.linalg.inv(whole(prior, trend))[: 6 * len(NODES), : 6 * len(NODES)]
    s = normalised(NODES)
    apart = np.abs(np.subtract.outer(TIMES, TIMES))
    memory = np.exp(-apart / time) if time else np.eye(len(NODES))
    want = np.kron(bias**2 + drift**2 * np.outer(s, s) + memory, np.diag(SIGMAS**2))

    scale = np.sqrt(np.diagonal(want))
    np.testing.assert_allclose(covariance / np.outer(scale, scale), want / np.outer(scale, scale), atol=1e-8)
    np.testing.assert_allclose(prior.node_sigmas(s).ravel(), scale, rtol=1e-12)


def test_closer_nodes_do_not_say_more() -> None:
    """The prior of nodes 2 s apart, with those between integrated out, is the prior of nodes 4 s apart."""
    prior = NodePrior(SIGMAS, 3.0 * SIGMAS, SIGMAS, 9.0)

    def covariance(nodes: OrientationImages, chosen: slice) -> np.ndarray:
        found = np.linalg.inv(whole(prior, 12, nodes))[: 6 * len(nodes), : 6 * len(nodes)]
        return found.reshape(len(nodes), 6, len(nodes), 6)[chosen][:, :, chosen]

    coarse = covariance(evenly_spaced("lagrange", 0.0, (0.0, 16.0), 4.0), slice(None))
    fine = covariance(evenly_spaced("lagrange", 0.0, (0.0, 16.0), 2.0), slice(None, None, 2))
    np.testing.assert_allclose(fine, coarse, rtol=1e-7, atol=1e-20)


def test_unknown_components_have_no_rows() -> None:
    prior = NodePrior(np.where(np.arange(6) < 3, np.inf, 1e-4), np.zeros(6), np.zeros(6), 5.0)
    normal = whole(prior, 0)
    assert np.linalg.matrix_rank(normal) == 3 * len(NODES)
    assert np.all(np.isinf(prior.node_sigmas(normalised(NODES))[:, :3]))


def test_bad_priors() -> None:
    with pytest.raises(InputError, match="six positive sigmas"):
        NodePrior(-SIGMAS, np.zeros(6), np.zeros(6))
    with pytest.raises(InputError, match="bias: -1"):
        NodePrior(SIGMAS, np.full(6, -1.0), np.zeros(6))
    with pytest.raises(InputError, match="nodes have none"):
        NodePrior(np.full(6, np.inf), np.ones(6), np.zeros(6))
    with pytest.raises(InputError, match="correlation time"):
        NodePrior(SIGMAS, np.zeros(6), np.zeros(6), -1.0)


def test_strips_of_a_network() -> None:
    net = network(pair())
    image = net.images[0]
    start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0].tolist()
    nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), 1.0)
    prior = NodePrior(SIGMAS, np.zeros(6), np.zeros(6))
    with_strip = replace(net, passes=(Pass("A", np.array([0]), nodes, prior),))

    assert with_strip.pass_of.tolist() == [0, -1]
    assert with_strip.with_polynomial.tolist() == [False, True]
    assert not np.any(with_strip.held)
    assert np.all(replace(with_strip, passes=()).with_polynomial)
    with pytest.raises(InputError, match="it is held"):
        replace(with_strip, held=np.array([True, False]))
    assert with_strip.first_of_passes.tolist() == [2, 2 + len(nodes)]
    with pytest.raises(InputError, match=r"pass 'A', images: image 0; expected .* one pass alone"):
        replace(net, passes=(Pass("A", np.array([0]), nodes, prior), Pass("B", np.array([0]), nodes, prior)))
    short = evenly_spaced("lagrange", image.trajectory.epoch, (start, 0.5 * stop), 1.0)
    with pytest.raises(InputError, match=r"pass 'A', image .*: lines from .* within its nodes'"):
        replace(net, passes=(Pass("A", np.array([0]), short, prior),))
    with pytest.raises(InputError, match="passes"):
        replace(net, passes=(Pass("A", np.array([0]), nodes, prior),) * 2)
    with pytest.raises(InputError, match="at least one, each once"):
        Pass("A", np.array([0, 0]), nodes, prior)


def test_rows_of_a_joint_prior_are_about_what_they_hold() -> None:
    """Also where some coefficient is unknown: then no node has a finite sigma of that component."""
    sigmas = np.ones((4, 6)) * SIGMAS
    sigmas[3, 0] = np.inf
    nodes = evenly_spaced("lagrange", 0.0, (0.0, 9.0), 3.0)
    prior = as_nodes(OrientationPrior(sigmas), nodes, normalised(nodes))
    (factor,) = prior.factors(nodes)
    chief = prior.root[np.arange(len(factor.about)), 6 * factor.about[:, 0] + factor.about[:, 1]]
    assert len(factor.about) == 23
    assert np.all(chief != 0.0)
    assert set(factor.about[:, 1].tolist()) == set(range(6))


@given(st.floats(1e5, 1e9))
def test_departures_that_hardly_forget_themselves(time: float) -> None:
    for unknowns, blocks, _ in NodePrior(SIGMAS, np.zeros(6), np.zeros(6), time).factors(NODES):
        assert all(np.all(np.isfinite(block)) for block in blocks), unknowns
