"""How close orientation images should stand: what rays support, what those held out say; strengths of processes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ctx_pair import PIXEL, CtxSettings, TrueJitter, image_times, simulate_ctx_pair
from hypothesis import given
from hypothesis import strategies as st
from mex_block import BlockSettings, SimulatedBlock, TrajectoryErrors, simulate_hrsc_block
from mex_flight import Jitter, PointMatching, pass_correction
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.factor_graph import factor_graph
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis import process_strengths
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.process_strengths import Evidence, estimated_strengths, where_passes_differ
from mgsgraph.analysis.spacing import (
    choose_spacing,
    hold_out,
    misfits,
    respaced,
    whitening,
    with_nodes,
)
from mgsgraph.analysis.strengths import Strength, of_each_pass, spread_beforehand
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
    """One pass of 80 s, without terrain."""
    settings = BlockSettings(
        passes=1, length=150e3, points=points, terrain=None, spacing=spacing, jitter=jitter,
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
    refuses(r" 10 at .*rays near it", require_supported, net)


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
    assert np.bincount(net.rays.point, held.rays_left(net)).min() >= 2
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


def test_rule_of_one_standard_error() -> None:
    """By another way to the standard error: the mean without each stretch in turn (the jackknife). The chosen one is
    as good as the best within it, and all that are coarser are worse.
    """
    choice = choose_spacing(block().network, SolverSettings(), [3.0, 5.0, 8.0, 14.0, 28.0])
    means = np.array([one.squared_errors.mean() for one in choice.candidates])
    assert choice.best == np.argmin(means)
    assert choice.best <= choice.chosen < 4
    for k in range(choice.best + 1, 5):
        difference = choice.candidates[k].squared_errors - choice.candidates[choice.best].squared_errors
        left = np.array([difference[choice.stretch != one].mean() for one in np.unique(choice.stretch)])
        error = np.sqrt((left.size - 1) / left.size * np.sum((left - left.mean()) ** 2))
        assert choice.worse_errors[k] == pytest.approx(error, rel=0.1)
        assert choice.worse[k] == pytest.approx(difference.mean(), rel=1e-12)
        assert k != choice.chosen or difference.mean() <= error
        assert k <= choice.chosen or difference.mean() > error


def test_points_off_the_model_are_judged() -> None:
    """Half of the posts are missing: rays of points there are judged by their other rays alone."""
    made = simulate_hrsc_block(BlockSettings(passes=1, length=150e3, points=400), 1)
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
    assert choice.candidates[0].squared_errors.size + choice.blunders == 200
    assert choice.candidates[0].rms == pytest.approx(1.0, abs=0.15)


def test_blunders_do_not_choose() -> None:
    """1 % of the rays 5 to 100 px off: with a blunder limit most are found, once, and candidates don't see them."""
    settings = BlockSettings(
        passes=1, length=150e3, points=500, terrain=None, jitter=PITCH, matches=PointMatching(blunders=0.01)
    )  # fmt: skip
    made = simulate_hrsc_block(settings, 1)
    choice = choose_spacing(made.network, SolverSettings(reject=4.0), [20.0, 4.0])
    assert 0.8 * made.blunders.sum() < choice.rejected < 1.5 * made.blunders.sum()
    assert nodes_section(choice, "block").numbers["rays_rejected"] == choice.rejected
    assert choice.spacing == 4.0
    assert all(one.sigma0 < 1.8 for one in choice.candidates)  # 9 with the blunders
    assert choice.candidates[0].rms < 1.1 < 1.3 < choice.candidates[1].rms
    assert not np.any(choice.network.rays.rejected)


# --- strengths of processes


ERRORS = TrajectoryErrors(correlation_time=30.0, position_wander=10.0)
SETTINGS = BlockSettings(passes=1, length=200e3, points=200, spacing=5.0, terrain=None, errors=ERRORS)


def network(seed: int, off: float, estimated: bool = True, errors: TrajectoryErrors = ERRORS) -> Network:
    """A pass whose processes' strengths are off by a factor."""
    net = simulate_hrsc_block(replace(SETTINGS, errors=errors), seed).network
    prior = net.passes[0].prior
    assert isinstance(prior, NodePrior)
    position, attitude = (
        Process("gauss-markov", off * prior.sigmas[part], 30.0, estimated=estimated) for part in (slice(3), slice(3, 6))
    )
    mine = ProcessPrior((position,), (attitude,), prior.bias, prior.drift)
    return replace(net, passes=(replace(net.passes[0], prior=mine),))


def test_it_is_the_maximum_of_the_posterior() -> None:
    """-log of the likelihood, from the data's own information on the nodes and the dense process, and of what is known
    beforehand: level there, and curved upward.
    """
    found = estimated_strengths(network(4, 3.0), SolverSettings(), tolerance=1e-5)
    solution, one = found.solution, found.network.passes[0]
    prior, begin = one.prior, network(4, 3.0).passes[0].prior
    assert isinstance(prior, ProcessPrior)
    assert isinstance(begin, ProcessPrior)
    size = 6 * len(one.nodes)
    first = int(found.network.first_of_passes[0])
    joint = at_solution(solution).of_estimator().joint.of(range(first, first + len(one.nodes) + 1))[:size, :size]
    s = normalised(one.nodes)
    now, then = (np.append(of.position[0].sigmas, of.attitude[0].sigmas) for of in (prior, begin))
    parts, off = [*prior.position] * 3 + [*prior.attitude] * 3, np.log(now / then)
    spread = np.kron(np.eye(2), np.ones((3, 3))) + 0.36 * np.eye(6)

    def covariance(factors: np.ndarray) -> np.ndarray:
        whole = np.zeros((size, size))
        for c in range(6):
            part = parts[c].scaled(np.full(3, factors[c]))
            trend = prior.bias[c] ** 2 + prior.drift[c] ** 2 * np.outer(s, s)
            whole[c::6, c::6] = dense_covariance((part,), c % 3, one.nodes) + trend
        return whole

    data = np.linalg.inv(joint) - np.linalg.inv(covariance(np.ones(6)))
    push = np.linalg.solve(joint, solution.nodes[0].ravel())

    def cost(logs: np.ndarray) -> float:
        both = data + np.linalg.inv(covariance(np.exp(logs)))
        signs = np.linalg.slogdet(both)[1] + np.linalg.slogdet(covariance(np.exp(logs)))[1]
        beforehand = (off + logs) @ np.linalg.solve(spread, off + logs)
        return 0.5 * float(signs - push @ np.linalg.solve(both, push) + beforehand)

    step = 0.02
    for way in np.eye(6):
        low, middle, high = (cost(k * step * way) for k in (-1, 0, 1))
        slope, curvature = (high - low) / (2.0 * step), (high - 2.0 * middle + low) / step**2
        assert curvature > 0.0
        assert abs(slope / np.sqrt(curvature)) < 0.01


# above two seconds: two searches
def test_planted_strengths_are_found() -> None:
    """From three times too much and from a third: nearly the same, and within 3.5 deviations of the truth."""
    ends = [estimated_strengths(network(5, off), SolverSettings()) for off in (3.0, 0.33)]
    logs = np.log([[one.sigma for one in end.strengths] for end in ends])
    errors = np.array([one.error for one in ends[0].strengths])
    assert np.all(np.abs(logs[0] - logs[1]) < errors)
    truth = np.log(np.repeat([ERRORS.position_wander, ERRORS.attitude_wander], 3))
    assert np.all(np.abs(logs - truth) / errors < 3.5)
    assert all(end.converged for end in ends)


def test_nothing_to_estimate_is_said() -> None:
    refuses("none that is to be estimated", estimated_strengths, network(1, 1.0, estimated=False), SolverSettings())


def test_other_strengths_need_no_adjustment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Covariance and values of everything, from one adjustment for other strengths: as an adjustment with them has."""
    net, settings = network(7, 1.0), SolverSettings()
    other = estimated_strengths(network(7, 1.7), settings, most=1)
    monkeypatch.setattr(process_strengths, "_mixture", lambda every: (np.zeros((1, 6)), np.ones(1), moved(every)))

    def moved(every: list[tuple[float, Evidence]]) -> np.ndarray:
        return every[0][1].moved(np.full(6, np.log(1.7)))

    found, there = estimated_strengths(net, settings, most=1).solution, adjust_network(other.network, settings)
    members = there.joint_covariance.adjusted.tolist()
    after, before = (np.concatenate([one.values[v] for v in members]) for one in (there, found))
    off = after - before
    wanted = there.joint_covariance.dense() + np.outer(off, off)
    scale = np.sqrt(np.diagonal(wanted))
    np.testing.assert_allclose(found.joint_covariance.dense() / scale / scale[:, None], wanted / scale / scale[:, None],
                               atol=1e-4)  # fmt: skip


# above two seconds: a search over two passes
def test_passes_have_their_strengths_in_common() -> None:
    """Of two passes that begin unlike each other: one strength about each axis, and after a round both have it."""
    net = simulate_hrsc_block(replace(SETTINGS, passes=2), 3).network
    passes = []
    for k, one in enumerate(net.passes):
        assert isinstance(one.prior, NodePrior)
        slow = Process("gauss-markov", (1.0 + k) * one.prior.sigmas[3:], 30.0, estimated=True)
        still = Process("gauss-markov", one.prior.sigmas[:3], 30.0)
        passes.append(replace(one, prior=ProcessPrior((still,), (slow,), one.prior.bias, one.prior.drift)))
    found = estimated_strengths(replace(net, passes=tuple(passes)), SolverSettings(), most=2)
    assert {one.passes for one in found.strengths} == {tuple(one.name for one in net.passes)}
    assert [one.axis for one in found.strengths] == [0, 1, 2]
    np.testing.assert_array_equal(*attitudes(found.network))


def attitudes(network: Network) -> list[np.ndarray]:
    """(3,) strengths of the attitude of each pass."""
    priors = [one.prior for one in network.passes]
    return [one.attitude[0].sigmas for one in priors if isinstance(one, ProcessPrior)]


@pytest.mark.slow
def test_of_two_strips_the_one_that_moves_more_is_found() -> None:
    """Two searches over two passes, the second's departures a fifth of the first's: strengths of the first pass are the
    larger ones, and the factor graph has the same cost.
    """
    made = simulate_hrsc_block(replace(SETTINGS, passes=2, points=600, wander=(1.0, 0.2)), 1)
    attitude = Process("gauss-markov", np.full(3, ERRORS.attitude_wander), 30.0, estimated=True)
    position = Process("gauss-markov", np.full(3, ERRORS.position_wander), 30.0, estimated=True)
    prior = ProcessPrior((position,), (attitude,), ERRORS.prior.bias, ERRORS.prior.drift)
    net = replace(made.network, passes=tuple(replace(one, prior=prior) for one in made.network.passes))
    common, own = (estimated_strengths(net, SolverSettings(), in_common=some) for some in (True, False))
    assert (len(common.strengths), len(own.strengths)) == (6, 12)
    assert own.converged
    assert all(one.error > 0.05 for one in own.strengths)
    first, second = attitudes(own.network)
    assert np.all(first > second)
    np.testing.assert_array_equal(*attitudes(common.network))
    explicit = factor_graph(own.solution)
    assert explicit.graph.error(explicit.values) == pytest.approx(own.solution.cost_final, rel=1e-9)


STRENGTHS = [
    Strength(("one", "other"), "attitude", "gauss-markov", axis, ((0, 0), (1, 0)), 0, 1.0, 1.0) for axis in range(3)
]


def evidence(ratio: float, seed: int, noise: tuple[float, float] = (0.1, 0.1)) -> Evidence:
    """What two passes of 20 nodes say whose departures are seen with some noise, those of the second times a ratio."""
    rng, k = np.random.default_rng(seed), np.arange(20)
    own = np.exp(-0.5 * np.abs(k[:, None] - k))
    moves = np.linalg.cholesky(own) @ rng.standard_normal((3, 2, 20, 1)) * np.array([1.0, ratio])[:, None, None]
    rows = np.arange(120).reshape(3, 2, 20)
    variances = np.tile(np.repeat(np.square(noise), 20), 3)
    start = np.linalg.inv(np.kron(np.eye(6), own) + np.diag(variances))
    push = start @ (moves.ravel() + np.sqrt(variances) * rng.standard_normal(120))
    parts = tuple(tuple((mine, own) for mine in axis) for axis in rows)
    return Evidence(start, push, np.zeros((0, 120)), (), parts, np.zeros(3), spread_beforehand(STRENGTHS))


def test_passes_that_differ_have_strengths_of_their_own() -> None:
    """The second moves a fifth as much: each axis of each pass is found, within its stated error."""
    one = replace(evidence(0.2, 2), mean=np.array([0.1, 0.2, 0.3]))
    wide, strengths, steps = where_passes_differ(one, STRENGTHS, one.maximum())
    np.testing.assert_array_equal(wide.mean, [0.1, 0.1, 0.2, 0.2, 0.3, 0.3])
    assert [(each.passes, each.axis) for each in strengths] == [((of,), k) for k in range(3) for of in ("one", "other")]
    errors = np.sqrt(np.diagonal(np.linalg.inv(wide.density(steps).information)))
    assert np.all(errors < 0.4)
    assert np.all(np.abs(steps - np.log([1.0, 0.2] * 3)) < 3.0 * errors)


def test_passes_that_do_not_differ_have_none() -> None:
    """Of 12 draws at most two get them by chance: where 95 % of many do not, with a probability of 0.98."""
    found = [where_passes_differ(one, STRENGTHS, one.maximum()) for one in (evidence(1.0, k) for k in range(20))]
    assert sum(len(strengths) > 3 for _, strengths, _ in found) <= 3


def test_a_strength_that_is_taken_over_is_as_uncertain_as_its_source() -> None:
    """Of a pass that rays don't show: the other's error, and the deviation of passes."""
    wide, _, _ = evidence(1.0, 2, (0.1, 1e4)).by_pass(STRENGTHS)
    joint = np.linalg.inv(wide.density(wide.maximum()).information)
    seen, unseen = np.diagonal(joint).reshape(3, 2).T
    assert np.all(seen < 0.4**2)
    assert np.all(unseen > seen)


@given(st.floats(0.1, 7.0), st.integers(2, 5))
def test_passes_depart_from_what_they_have_in_common(spread: float, count: int) -> None:
    """Beforehand by half the deviation of the strengths themselves, whatever the prior's; axes of a pass jointly."""
    names, members = tuple("abcde"[:count]), tuple((k, 0) for k in range(count))
    common = [replace(one, passes=names, members=members, spread=spread) for one in STRENGTHS]
    each, of = of_each_pass(common)
    axes, whole = spread_beforehand(common), spread_beforehand(each)
    np.testing.assert_allclose(axes, spread**2 + 0.36 * np.eye(3))
    first = np.array([one.members[0][0] for one in each])
    np.testing.assert_allclose(whole, axes[np.ix_(of, of)] * np.where(first[:, None] == first, 1.25, 1.0))
    np.linalg.cholesky(whole)


def test_what_is_hardly_seen_has_a_limit() -> None:
    """Processes far smaller than what measures can see stay as uncertain as they are beforehand."""
    net = network(6, 1.0, errors=TrajectoryErrors(*[1e-9] * 3, *[1e-3] * 3))
    for one in estimated_strengths(net, SolverSettings()).strengths:
        assert not one.seen
        assert one.error == pytest.approx(np.sqrt(1.36), rel=0.2)
        assert one.interval[0] < one.sigma < one.interval[1] < 12.0 * one.sigma


@pytest.mark.parametrize("same_motion", [True, False])
def test_passes_that_move_in_the_same_way(same_motion: bool) -> None:
    """Their difference shows nothing: strengths stay as uncertain as beforehand, and sigmas fit the errors even so."""
    rng, blank = np.random.default_rng(3), simulate_ctx_pair(CtxSettings(ties=20)).network
    moving = Process("matern-3/2", np.full(3, PIXEL), 4.0, estimated=True)
    prior = ProcessPrior((), (moving,), np.array([10.0] * 3 + [1e-4] * 3), np.zeros(6))
    nodes = [evenly_spaced("lagrange", one.trajectory.epoch, image_times(one), 2.0) for one in blank.images]
    root = np.linalg.cholesky(dense_covariance((moving,), 0, nodes[0]))
    values, moves = rng.standard_normal((2, 1, 6)) * prior.bias, rng.standard_normal((2, len(root), 3))
    values = values + np.concatenate([np.zeros_like(moves), root @ moves[[0, 0] if same_motion else [0, 1]]], axis=2)
    truth = [TrueJitter(pass_correction(*pair), np.zeros((2, 2))) for pair in zip(nodes, values, strict=True)]
    net = simulate_ctx_pair(CtxSettings(ties=300, control=None), 3, truth).network
    passes = [replace(one, nodes=some, prior=prior) for one, some in zip(net.passes, nodes, strict=True)]
    found = estimated_strengths(replace(net, passes=tuple(passes)), SolverSettings())
    assert (found.same_motion > 0.5) == same_motion
    assert (found.strengths[1].seen, found.strengths[1].error < 0.3) == (not same_motion, not same_motion)  # pitch
    assert all(one.interval[0] < PIXEL < one.interval[1] for one in found.strengths)
    variables = [first + k for one, first in found.network.numbered_passes for k in range(len(one.nodes))]
    covariance, error = found.solution.joint_covariance.of(variables), np.concatenate(found.solution.nodes)
    error = (error - np.concatenate(list(values))).ravel()
    assert 0.3 < float(error @ np.linalg.solve(covariance, error)) / error.size < 2.0
