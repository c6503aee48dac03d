"""How close orientation images should stand: what rays support, what those held out say; strengths of processes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.process_strengths import estimated_strengths
from mgsgraph.analysis.spacing import (
    choose_spacing,
    hold_out,
    misfits,
    respaced,
    whitening,
    with_nodes,
)
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Network, NodePrior, Process, ProcessPrior
from mgsgraph.network.conditioning import dense_covariance
from mgsgraph.network.corrections import (
    pass_rays,
    require_supported,
    support_of,
    supported_spacing,
    useful_rays,
)
from mgsgraph.network.passes import normalised
from mgsgraph.results.spacing import nodes_section
from mgsgraph.simulation.hrsc_block import BlockSettings, SimulatedBlock, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import Jitter, PointMatching
from mgsgraph.units import MGON

PITCH = Jitter(4.0 * MGON, 0.06, "pitch")
EXACT = TrajectoryErrors(*[1e-9] * 3, *[1e-3] * 3)


@cache
def block(
    jitter: Jitter | None = None,
    errors: TrajectoryErrors | None = None,
    spacing: float = 8.0,
    seed: int = 1,
    points: int = 700,
) -> SimulatedBlock:
    """One strip of 80 s, without terrain."""
    settings = BlockSettings(
        strips=1, length=150e3, points=points, terrain=None, spacing=spacing, jitter=jitter,
        errors=errors or TrajectoryErrors(),
    )  # fmt: skip
    return simulate_hrsc_block(settings, seed)


# --- support


def test_spacing_that_is_said_to_be_supported_is() -> None:
    net = block().network
    require_supported(net)
    with pytest.raises(InputError, match=r"nodes closer than the data supports: of 1704 nodes.*what they support"):
        require_supported(respaced(net, 0.05))
    rays = useful_rays(net, 0)
    spacing = supported_spacing(respaced(net, 0.05).passes[0].nodes, rays)
    assert 0.05 < spacing < 8.0
    require_supported(respaced(net, spacing))


def test_node_without_rays_is_named() -> None:
    """A cloud over all that one node depends on: this node is weak, and no other."""
    net = block().network
    nodes = evenly_spaced("lagrange", net.passes[0].nodes.epoch, net.passes[0].nodes.coverage, 4.0)
    net = with_nodes(net, [nodes])
    mine, reach = pass_rays(net, 0), 1
    hidden = np.zeros(net.rays.point.size, dtype=bool)
    hidden[mine.rays[(mine.times >= nodes.times[9 - reach]) & (mine.times <= nodes.times[9 + reach])]] = True
    net = replace(net, rays=replace(net.rays, rejected=hidden))
    assert np.flatnonzero(support_of(net.passes[0].nodes, useful_rays(net, 0)).weak).tolist() == [9]
    with pytest.raises(InputError, match=r" 10 at .*rays near it"):
        require_supported(net)


def test_rays_that_place_nothing_do_not_count() -> None:
    """Of points whose other rays are gone."""
    net = block().network
    first = np.unique(net.rays.point, return_index=True)[1]
    taken = np.zeros(net.rays.point.size, dtype=bool)
    taken[first] = True
    assert support_of(net.passes[0].nodes, useful_rays(net, 0, taken)).rays.max() == 0


# --- rays held out


@given(st.floats(0.05, 1.0), st.integers(0, 100))
def test_one_ray_of_a_point_is_held_out(share: float, seed: int) -> None:
    net = block().network
    held = hold_out(net, share, np.random.default_rng(seed))
    points = net.rays.point[held.rays]
    assert np.unique(points).size == points.size == round(share * len(net.points))
    assert np.bincount(net.rays.point, held.taken(net)).min() >= 2
    np.testing.assert_array_equal(held.rays, hold_out(net, share, np.random.default_rng(seed)).rays)


def test_prediction_knows_nothing_of_the_ray() -> None:
    """A ray held out that is moved by 20 and -10 px is predicted where it was."""
    net = block().network
    held = hold_out(net, 0.3, np.random.default_rng(1))
    places = net.rays.places.copy()
    places[held.rays] += [20.0, -10.0]
    moved = replace(net, rays=replace(net.rays, places=places))
    before, after = (
        misfits(adjust_network(one, SolverSettings(), left_in=held.left_in(one)), held)[0] for one in (net, moved)
    )
    np.testing.assert_allclose(after - before, np.broadcast_to([20.0, -10.0], before.shape), atol=1e-6)


def test_misfits_of_a_known_orientation_are_noise_of_unit_size() -> None:
    net = block(errors=EXACT, points=2000).network
    held = hold_out(net, 1.0, np.random.default_rng(2))
    solution = adjust_network(net, SolverSettings(), left_in=held.left_in(net))
    white = np.einsum("hij,hj->hi", whitening(solution, held), misfits(solution, held)[0])
    assert white.shape == (2000, 2)
    for squares in (white**2).T:
        assert squares.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 2000))


def test_jitter_asks_for_nodes_that_follow_it() -> None:
    """A period of 17 s: nodes every 4 s follow it, such every 20 s don't, and rays held out know."""
    choice = choose_spacing(block(PITCH).network, SolverSettings(), [20.0, 0.05, 4.0, 10.0])
    assert [one.spacing for one in choice.candidates] == [0.05, 4.0, 10.0, 20.0]
    assert "nodes closer than the data supports" in choice.candidates[0].refused
    assert choice.spacing == 4.0
    close, _, wide = choice.candidates[1:]
    assert close.rms < 1.1 < 1.3 < wide.rms
    assert choice.worse[3] > 5.0 * choice.worse_errors[3]
    assert len(choice.chosen_network.passes[0].nodes) == close.nodes


def test_rule_of_one_standard_error() -> None:
    """By another way to the standard error: the mean without each stretch in turn (the jackknife). The chosen one is
    as good as the best within it, and all that are coarser are worse.
    """
    choice = choose_spacing(block().network, SolverSettings(), [3.0, 5.0, 8.0, 14.0, 28.0])
    means = np.array([one.squares.mean() for one in choice.candidates])
    assert choice.best == np.argmin(means)
    assert choice.best <= choice.chosen < 4
    for k in range(choice.best + 1, 5):
        difference = choice.candidates[k].squares - choice.candidates[choice.best].squares
        left = np.array([difference[choice.stretch != one].mean() for one in np.unique(choice.stretch)])
        error = np.sqrt((left.size - 1) / left.size * np.sum((left - left.mean()) ** 2))
        assert choice.worse_errors[k] == pytest.approx(error, rel=0.1)
        assert choice.worse[k] == pytest.approx(difference.mean(), rel=1e-12)
        assert k != choice.chosen or difference.mean() <= error
        assert k <= choice.chosen or difference.mean() > error


def test_points_off_the_model_are_judged() -> None:
    """Half of the posts are missing: rays of points there are judged by their other rays alone."""
    made = simulate_hrsc_block(BlockSettings(strips=1, length=150e3, points=400), 1)
    surface = made.network.surface
    assert surface is not None
    radii = surface.grid.radii.copy()
    radii[: radii.shape[0] // 2] = np.nan
    grid = replace(surface.grid, radii=radii)
    there = np.isfinite(grid.at(made.true_points))
    assert 0.2 < there.mean() < 0.8
    net = replace(made.network, surface=replace(surface, grid=grid, sigmas=np.where(there, surface.sigmas, np.inf)))
    choice = choose_spacing(net, SolverSettings(), [5.0, 20.0], 0.5)
    assert choice.unjudged == 0
    assert choice.candidates[0].squares.size + choice.blunders == 200
    assert choice.candidates[0].rms == pytest.approx(1.0, abs=0.15)


def test_blunders_do_not_choose() -> None:
    """1 % of the rays 5 to 100 px off: with a blunder limit most are found, once, and candidates don't see them."""
    settings = BlockSettings(
        strips=1, length=150e3, points=500, terrain=None, jitter=PITCH, matches=PointMatching(blunders=0.01)
    )  # fmt: skip
    made = simulate_hrsc_block(settings, 1)
    choice = choose_spacing(made.network, SolverSettings(reject=4.0), [20.0, 4.0])
    assert 0.8 * made.blunders.sum() < choice.rejected < 1.5 * made.blunders.sum()
    assert nodes_section(choice, "block").numbers["rays_rejected"] == choice.rejected
    assert choice.spacing == 4.0
    assert all(one.sigma0 < 1.8 for one in choice.candidates)  # 9 with the blunders
    assert choice.candidates[0].rms < 1.1 < 1.3 < choice.candidates[1].rms
    assert not np.any(choice.chosen_network.rays.rejected)


# --- strengths of processes


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


# above two seconds: a search that adjusts a dozen times, to 1e-5
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


def test_nothing_to_estimate_is_said() -> None:
    with pytest.raises(InputError, match="none that is to be estimated"):
        estimated_strengths(network(1, 1.0, estimated=False), SolverSettings())


# above two seconds: a search over two strips
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
