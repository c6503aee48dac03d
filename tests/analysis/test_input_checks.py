"""Residuals before anything is solved: what sigmas explain is let be, what is interchanged is named."""

from dataclasses import replace

import numpy as np
import pytest
from networks import network, pair
from rigs import adjusted_rig, rig

from mgsgraph.adjustment.adjust import predict
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.soundness import unexplained_ranges, unexplained_residuals
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.results.soundness import beyond_priors_statements, range_statements


def found(net: Network) -> tuple[str, ...]:
    residuals = predict(net, SolverSettings()).residuals
    named = tuple(net.images[one.image].name for one in unexplained_residuals(net, residuals))
    assert bool(beyond_priors_statements(net, residuals)) == bool(named)
    return named


@pytest.mark.parametrize("seed", range(20, 24))
def test_what_the_priors_explain_is_let_be(seed: int) -> None:
    assert not found(network(pair(seed=seed)))


def turned(net: Network, image: int, columns: bool) -> Network:
    """The network with an image's measures of two ties, or lines and samples, interchanged."""
    places, mine = net.rays.places.copy(), np.flatnonzero(net.rays.image == image)
    places[mine] = places[mine][:, ::-1] if columns else places[np.roll(mine, 1)]
    return replace(net, rays=replace(net.rays, places=places))


@pytest.mark.parametrize("columns", [True, False])
def test_interchanged_measures_are_named(columns: bool) -> None:
    net = network(pair(ties=30, shots=4))
    assert net.images[1].name in found(turned(net, 1, columns))


def test_unknown_orientations_explain_anything() -> None:
    net = turned(network(pair(ties=30, shots=4)), 1, columns=False)
    unknown = OrientationPrior(np.full_like(net.priors[1].sigmas, np.inf))
    residuals = predict(net, SolverSettings()).residuals
    assert not unexplained_residuals(replace(net, priors=(net.priors[0], unknown)), residuals)


@pytest.mark.parametrize("seed", [20, 21])
def test_what_a_pass_and_its_boresight_explain_is_let_be(seed: int) -> None:
    net = rig(seed=seed)
    assert not found(net)
    assert not range_statements(net, predict(net, SolverSettings()).range_residuals)
    assert not adjusted_rig(seed).strained


def test_interchanged_lines_and_samples_in_a_pass_are_named() -> None:
    assert found(turned(rig(), 1, columns=True))[0] == "R"


def test_ranges_of_a_pass_are_named_where_no_orbit_explains_them() -> None:
    net = rig()
    residuals = predict(scaled(net, 1.02), SolverSettings()).range_residuals
    assert [one.image for one in unexplained_ranges(net, residuals)] == [0]


def test_nodes_that_are_moved_beyond_their_sigmas_are_named() -> None:
    solution = adjusted_rig()
    sigmas = solution.network.passes[0].prior.own_sigmas(solution.network.passes[0].nodes)
    moved = solution.nodes[0] + 8.0 * sigmas * (np.arange(6) == 4)
    (one,) = replace(solution, nodes=(moved,)).strained
    assert one.image == 0
    assert one.most == pytest.approx(8.0, abs=1.0)


def scaled(net: Network, factor: float) -> Network:
    """The network with all its laser ranges so many times longer."""
    return replace(net, ranges=replace(net.ranges, values=factor * net.ranges.values))


def test_ranges_are_let_be_unless_their_mean_is_beyond_the_orbit() -> None:
    for seed in range(20, 24):
        net = network(pair(seed=seed))
        assert not range_statements(net, predict(net, SolverSettings()).range_residuals)
    residuals = predict(scaled(net, 1.02), SolverSettings()).range_residuals
    (one,) = unexplained_ranges(net, residuals)
    assert one.image == 0
    assert one.size == pytest.approx(0.02 * net.ranges.values.mean(), rel=0.1)
    assert net.images[0].name in range_statements(net, residuals)[0]


def test_of_images_that_share_a_range_bias_nothing_is_said() -> None:
    net = scaled(network(pair(seed=20)), 1.02)
    residuals = predict(net, SolverSettings()).range_residuals
    bias = SharedUnknown("bias", SharedKind.RANGE_BIAS, np.array([0]), np.array([1e4]))
    assert unexplained_ranges(net, residuals)
    assert not unexplained_ranges(replace(net, shared=(bias,)), residuals)
