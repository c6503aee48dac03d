"""How close orientation images should stand: what rays support, and what those held out say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
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
from mgsgraph.network.corrections import (
    pass_rays,
    require_supported,
    support,
    supported_spacing,
    useful_rays,
)
from mgsgraph.results.spacing import nodes_section
from mgsgraph.simulation.hrsc_block import BlockSettings, SimulatedBlock, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import Jitter, PointMatching
from mgsgraph.units import MGON

PITCH = Jitter(4.0 * MGON, 0.06, "pitch")
CALM = TrajectoryErrors(attitude_wander=0.3 * MGON, position_wander=0.3)
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
    assert np.flatnonzero(support(net, 0).weak).tolist() == [9]
    with pytest.raises(InputError, match=r" 10 at .*rays near it"):
        require_supported(net)


def test_rays_that_place_nothing_do_not_count() -> None:
    """Of points whose other rays are gone."""
    net = block().network
    first = np.unique(net.rays.point, return_index=True)[1]
    taken = np.zeros(net.rays.point.size, dtype=bool)
    taken[first] = True
    assert support(net, 0, taken=taken).rays.max() == 0


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


def test_calm_flight_needs_few_nodes() -> None:
    """Where nothing happens between nodes 28 s apart, closer ones predict no better; the closest isn't chosen."""
    for seed in (1, 2):
        choice = choose_spacing(block(None, CALM, 28.0, seed).network, SolverSettings(), [3.0, 7.0, 28.0])
        assert choice.spacing > 3.0
        assert choice.candidates[2].rms < 1.01 * choice.candidates[choice.best].rms


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
