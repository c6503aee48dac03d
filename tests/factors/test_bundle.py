"""Sweeps over whole networks: against dense normal equations of their rows, by threads, from other beginnings."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from explicit_form import (
    System,
    assert_bundle_is_explicit,
    assert_gradient_is_that_of_the_cost,
    assert_jacobians,
    of_layout,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import (
    network,
    on_passes,
    pair,
    with_echoes,
    with_neighbors,
    with_shift_and_surface,
    with_tilting_surface,
)
from odd_networks import NETWORKS, case, made, one_seen_twice_by_one_image, random_network, with_fixed
from sharing import with_all_kinds
from stereo_pair import stereo_network

from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph import lay_out, patterns
from mgsgraph.adjustment.graph.patterns import group_blocks
from mgsgraph.adjustment.settings import Line, Loss, SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.kernel import sweep
from mgsgraph.kernel.lanes import LANES
from mgsgraph.kernel.rows import BEHIND, FIXED, FREE, GOOD, OUT, WEAK, Rows
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM, dense, reduce
from mgsgraph.network import Network, SharedKind

SEEDS = st.integers(0, 2**32 - 1)
EVERYTHING: dict[str, Callable[[], Network]] = {
    "all shared unknowns": lambda: with_all_kinds(with_tilting_surface(network(pair()))),
    "echoes": lambda: with_all_kinds(with_shift_and_surface(with_echoes(network(pair())))),
    "nodes": lambda: on_passes(network(pair())),
    "stereo surface": lambda: stereo_network(pair(12, 24)),
    "neighbors": lambda: with_neighbors(with_tilting_surface(network(pair(20)))),
}
"""What no network of `NETWORKS` has."""


@cache
def everything(name: str) -> System:
    return of_layout(lay_out(EVERYTHING[name](), SolverSettings()))


def state(system: System, seed: int = 3, size: float = 1.0) -> np.ndarray:
    """Shared unknowns. Those whose effects change along an image are zero: the kernel takes effects for constant about
    a ray, so that its derivatives are wrong by the share by which they change the image's motion, some 1e-4.
    """
    found = np.random.default_rng(seed).standard_normal(system.columns) * system.sigmas * size
    for k, one in enumerate(system.network.shared):
        if one.kind.moves_instrument and one.kind is not SharedKind.CAMERA_BORESIGHT:
            found[system.variables.columns_of(system.network.first_shared + k)] = 0.0
    return found


@pytest.mark.parametrize("name", NETWORKS)
def test_bundle_is_explicit(name: str) -> None:
    """Newton's method on the predicted line steps for all lanes of a tile together, up to 1e-4 lines more than a single
    observation needs, which leaves some 1e-9 of difference; the measured line needs none.
    """
    for line, share in (("measured", 1e-11), ("predicted", 1e-8)):
        now = made(name, line)
        system = of_layout(now.layout, now.rows)
        found = assert_bundle_is_explicit(system, state(system), share)
        assert np.all(found.states == GOOD)


@settings(max_examples=8)
@given(seed=SEEDS)
def test_bundle_is_explicit_on_any_network(seed: int) -> None:
    """Points seen by one of the pair's two orbits alone lie where parallel rays meet, and stay out."""
    net = random_network(seed)
    orbits = [np.bincount(net.rays.point[net.rays.image % 2 == k], minlength=len(net.points)) > 0 for k in (0, 1)]
    lost = np.flatnonzero((net.points.kinds == PointKind.FREE) & ~(orbits[0] & orbits[1]))
    now = case(net, "measured", ((), (), tuple(lost.tolist())))
    system = of_layout(now.layout, now.rows)
    if system.columns:
        assert_bundle_is_explicit(system, state(system, size=0.3), 1e-10)


@pytest.mark.parametrize("name", ["all shared unknowns", "echoes", "nodes"])
def test_rows_have_the_derivatives_of_differences(name: str) -> None:
    """The oracle on every measurement of four points: the first and last of the layout's, and two between. Its
    tolerance is a share of a block's largest entry, which of a focal length is next to nothing in mid-image.
    Derivatives hold the slope of the detector line, which counts where residuals are large: so rays are where they are
    predicted.
    """
    first = everything(name)
    x = state(first)
    now, points = first.relinearized(x)
    missed = residuals(now.layout, x, points).image
    rays = replace(first.network.rays, places=first.network.rays.places - missed)
    system = of_layout(lay_out(replace(first.network, rays=rays), SolverSettings()))
    order = system.layout.point_order.tolist()
    (factors, keys), values = system.graph, system.values(x, now.layout.network_order(points)[order])
    chosen = {keys.point(order[k]) for k in np.linspace(0, len(order) - 1, 4).astype(int)}
    steps = {key: np.ones(3) for key in chosen}
    for v in system.variables.adjusted():
        steps[keys.variable(int(v))] = 0.1 * system.sigmas[system.variables.columns_of(v)]
    for factor in factors:
        if chosen & set(factor.keys()):
            mine = gtsam.Values()
            for key in factor.keys():
                mine.insert(key, values.atPoint3(key) if key in chosen else values.atVector(key))
            assert_jacobians(factor, mine, steps, tolerance=5e-5)


@pytest.mark.parametrize("name", EVERYTHING)
def test_bundle_is_explicit_whatever_is_felt(name: str) -> None:
    system = everything(name)
    assert_bundle_is_explicit(system, state(system), 1e-7)


@pytest.mark.parametrize("piece", [1, LANES + 1])
def test_pieces_are_one_sum(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = made("more than a tile")
    monkeypatch.setattr(patterns, "PIECE", piece)
    cut = case(whole.layout.network)
    assert cut.rows.piece[:, 2].max() == min(piece, whole.rows.piece[:, 2].max())
    first, second = of_layout(whole.layout, whole.rows), of_layout(cut.layout, cut.rows)
    x = state(first)
    found, other = first.reduce(x), second.reduce(x)
    points = whole.layout.network_order(found.points)
    np.testing.assert_allclose(cut.layout.network_order(other.points), points, rtol=0.0, atol=1e-6)
    assert other.cost == pytest.approx(found.cost, rel=1e-11)
    assert other.piece_cost.sum() == pytest.approx(other.cost, rel=1e-13)
    assert_bundle_is_explicit(second, x)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_bundle_is_explicit_with_a_robust_loss(loss: str) -> None:
    """Weights by GTSAM's own estimators. The kernel's rows are those before its last step of 1e-7 sigma."""
    width = 6.0 if loss == "tukey" else 1.0  # beyond Tukey's there is no row at all
    layout = lay_out(with_shift_and_surface(network(pair())), SolverSettings(loss=loss, loss_width=width))
    system = of_layout(layout)
    assert_bundle_is_explicit(system, state(system, size=0.02), 1e-6)


def test_a_point_that_nothing_determines_is_as_if_left_out() -> None:
    """The layout leaves points of parallel rays out beforehand; here one gets through to the kernel."""
    weak, out = case(one_seen_twice_by_one_image()), case(one_seen_twice_by_one_image(), without=((), (), (0,)))
    place = int(weak.layout.patterns.point_index[0])
    kinds = weak.rows.kind.copy()
    assert kinds[place] == OUT
    kinds[place] = FREE
    first, second = of_layout(weak.layout, weak.rows._replace(kind=kinds)), of_layout(out.layout, out.rows)
    x = state(first)
    found, other = first.reduce(x), second.reduce(x)
    assert np.flatnonzero(found.states != GOOD).tolist() == [place]
    assert found.states[place] == WEAK
    assert np.all(other.states == GOOD)
    np.testing.assert_allclose(found.gradient, other.gradient, rtol=1e-12, atol=1e-12 * np.abs(other.gradient).max())
    np.testing.assert_allclose(found.blocks, other.blocks, rtol=1e-12, atol=1e-12 * np.abs(other.blocks).max())
    covariances = first.covariances(x, np.diag(first.sigmas**2), found.points)
    assert np.all(np.isnan(covariances[place]))
    assert np.all(np.isfinite(np.delete(covariances, place, axis=0)))


def test_a_point_behind_its_camera_has_no_finite_cost() -> None:
    now = made("plain")
    system = of_layout(now.layout)
    x = np.zeros(system.columns)
    x[:3] = -2.0 * now.layout.network.images[0].pose(np.array([2500.0])).position[0]
    found = system.reduce(x)
    assert found.cost == np.inf
    assert np.any(found.states == BEHIND)


@pytest.mark.parametrize("name", ["all shared unknowns", "nodes"])
def test_gradient_is_that_of_the_reduced_cost(name: str) -> None:
    """What counts of the reduced system is its gradient, that of the full cost."""
    assert_gradient_is_that_of_the_cost(everything(name), state(everything(name)))


@pytest.mark.parametrize(("line", "loss"), [("predicted", "none"), ("measured", "huber"), ("predicted", "cauchy")])
def test_gradient_is_that_of_the_reduced_cost_with_any_loss(line: Line, loss: Loss) -> None:
    """Huber's curvature jumps, which costs the differences some digits."""
    system = of_layout(lay_out(network(pair()), SolverSettings(line=line, loss=loss)))
    assert_gradient_is_that_of_the_cost(system, state(system), 1e-4 if loss == "huber" else 1e-5)


def test_the_bundles_own_blocks_are_the_shared_ones() -> None:
    """Groups' blocks by themselves, as reduced systems of bundles have them, add up to the blocks of variable pairs."""
    now = made("groups of one point")
    layout, target = now.layout, group_blocks(now.layout.groups)
    system = of_layout(layout)
    x = state(system)
    whole, parts = system.reduce(x), reduce(layout.rows, layout.groups, target, layout.model, x)
    matrix, gradient = np.zeros((layout.columns, layout.columns)), np.zeros(layout.columns)
    for group, members in enumerate(layout.group_variables):
        at = np.concatenate([np.arange(layout.columns)[layout.columns_of(v)] for v in members])
        block, right = dense(parts, layout.groups, target, group)
        matrix[np.ix_(at, at)] += block
        gradient[at] += right
    assert whole.blocks is not None
    scale = layout.scales * layout.scales[:, None]
    expected = system.matrix(whole.blocks) * scale
    np.testing.assert_allclose(matrix * scale, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    atol = 1e-12 * np.abs(whole.gradient * layout.scales).max()
    np.testing.assert_allclose(gradient * layout.scales, whole.gradient * layout.scales, rtol=0.0, atol=atol)


def test_known_points_hold() -> None:
    """Fixed points stay where they are, and so do those left out; both have no covariance."""
    net = with_fixed(network(pair()))
    now = case(net, without=((), (), (2, 3)))
    system = of_layout(now.layout, now.rows)
    found = system.reduce(state(system))
    still = np.isin(found.states, [GOOD]) & np.isin(now.rows.kind, [FIXED, OUT])
    assert np.count_nonzero(still) == 8
    np.testing.assert_array_equal(found.points[still], now.rows.start[still])
    covariances = system.covariances(state(system), np.diag(system.sigmas**2), found.points)
    assert not np.any(covariances[still])
    assert np.all(np.linalg.eigvalsh(covariances[~still]) > 0.0)


# --- sweeps by threads, and from other beginnings


def all_results(system: System, x: np.ndarray) -> dict[str, np.ndarray]:
    """A reduction's numbers, and covariances."""
    found = system.reduce(x)
    names = ("cost", "piece_cost", "blocks", "gradient", "points", "states")
    covariances = system.covariances(x, np.diag(system.sigmas**2), found.points)
    return {name: np.asarray(getattr(found, name)) for name in names} | {"covariances": covariances}


@pytest.mark.parametrize("name", ["more than a tile", "groups of one point"])
def test_threads_share_the_same_work(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, calls, results = sweep.even_parts, list[int](), list[dict[str, np.ndarray]]()

    def counted(rows: Rows, count: int) -> np.ndarray:
        calls.append(count)
        return parts(rows, count)

    monkeypatch.setattr(sweep, "_WORTHWHILE", 1.0)
    monkeypatch.setattr(sweep, "even_parts", counted)
    monkeypatch.setattr(patterns, "PIECE", 32)
    now = case(NETWORKS[name]())
    system = of_layout(now.layout, now.rows)
    for threads in (1, 2):
        monkeypatch.setattr(sweep, "threads", lambda threads=threads: threads)
        results.append(all_results(system, state(system)))
    assert len(set(calls)) == 1 < calls[0]  # parts depend on the rows alone
    for what, one in results[0].items():
        np.testing.assert_array_equal(results[1][what], one, err_msg=what)


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_parts_are_all_pieces_once(count: int) -> None:
    rows = made("groups of one point").rows
    edges = sweep.even_parts(rows, count)
    assert edges.size == count + 1
    assert (edges[0], edges[-1]) == (0, rows.piece.shape[0])
    assert np.all(np.diff(edges) >= 0)


@settings(max_examples=8)
@given(seed=SEEDS)
def test_a_warm_start_saves_steps_and_changes_nothing(seed: int) -> None:
    """Begun where a neighbouring orientation's points are. The gradient is of the place before the last step, which may
    be 1e-3 sigma long: with rows that bend by 1e-4 over a sigma (more on rough terrain) its share is 1e-7.
    """
    now = made("shifts and terrain")
    system = of_layout(now.layout)
    x = state(system, seed)
    near = system.reduce(x + 0.1 * state(system, seed + 1)).points
    cold, warm = system.reduce(x), system.reduce(x, near)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-11)
    np.testing.assert_allclose(warm.points, cold.points, rtol=0.0, atol=1e-5)
    scaled = cold.gradient * system.sigmas
    np.testing.assert_allclose(warm.gradient * system.sigmas, scaled, rtol=0.0, atol=1e-6 * np.abs(scaled).max())
    assert system.reduce(x, near, COSTS).cost == warm.cost


@pytest.mark.parametrize("name", NETWORKS)
def test_the_gradient_alone_is_that_of_the_system(name: str) -> None:
    system = of_layout(made(name).layout)
    x = state(system)
    whole, alone = system.reduce(x), system.reduce(x, task=GRADIENT)
    assert alone.blocks is None
    assert alone.serves(x, COSTS)
    assert not alone.serves(x, SYSTEM)
    assert alone.cost == whole.cost
    for part in ("gradient", "points", "states"):
        np.testing.assert_array_equal(getattr(alone, part), getattr(whole, part))


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_a_robust_loss_has_one_answer(loss: str) -> None:
    """It may have several minima: from `rows.start` on, always the same one is found, wherever the caller begins."""
    system = of_layout(lay_out(network(pair()), SolverSettings(loss=loss)))
    x = state(system)
    cold = system.reduce(x)
    warm = system.reduce(x, cold.points + np.random.default_rng(4).normal(0.0, 3000.0, cold.points.shape))
    assert warm.cost == cold.cost
    np.testing.assert_array_equal(warm.points, cold.points)
    np.testing.assert_array_equal(warm.gradient, cold.gradient)
