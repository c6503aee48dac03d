"""Bundles of whole networks against dense normal equations of their rows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from normals import HandPoint, System, assert_bundle_is_explicit, of_layout, pack, take_apart
from odd_networks import NETWORKS, case, made, one_seen_twice_by_one_image, random_network, with_fixed

from mgsgraph.adjustment.graph import BundleGraph, lay_out, patterns
from mgsgraph.adjustment.graph.patterns import group_blocks
from mgsgraph.adjustment.settings import Line, SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.kernel.lanes import LANES
from mgsgraph.kernel.rows import BEHIND, FIXED, FREE, GOOD, GROUND, IMAGE, OUT, RANGE, SURFACE, WEAK
from mgsgraph.kernel.sweep import COSTS, dense, reduce

SEEDS = st.integers(0, 2**32 - 1)
STATE_UNITS = {
    IMAGE: np.array([30.0] * 3 + [1e-4] * 5 + [1e-2]),
    RANGE: np.array([30.0] * 3 + [5.0]),
    GROUND: np.full(3, 30.0),
    SURFACE: np.full(3, 30.0),
}
"""What the components of an observation's state are of the order of, the widest state of each kind."""


def state(system: System, seed: int = 3, size: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(system.columns) * system.sigmas * size


def test_the_cases_are_what_they_are_called() -> None:
    assert np.count_nonzero(made("weights of zero").rows.weight[0] == 0.0) == 6
    assert np.count_nonzero(made("points left out").rows.kind == OUT) == 3
    assert np.count_nonzero(made("fixed points").rows.kind == FIXED) == 6
    assert np.diff(made("twelve rays").rows.pattern_observation).max() >= 12
    assert made("more than a tile").rows.piece[:, 2].min() > LANES
    sizes = made("groups of one point").rows.piece[:, 2]
    assert np.count_nonzero(sizes == 1) > 3
    assert np.diff(made("measured twice").rows.pattern_observation).max() == 5


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


@settings(max_examples=15)
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


def with_any_columns(points: list[HandPoint], units: list[np.ndarray], seed: int) -> None:
    """Give half the observations up to three single columns of any direction: of a new variable, or of one that is
    there.
    """
    rng = np.random.default_rng(seed)
    units += [np.array([1.0, 1.0, 1.0]), np.array([1.0])]
    for observation in (s for point in points for s in point.observations):
        if rng.random() < 0.5:
            continue
        widest = STATE_UNITS[observation.kind]
        missing = np.zeros(widest.size - observation.width)
        observation.directions = [np.append(d, missing) for d in observation.directions]
        observation.width = widest.size
        for variable in rng.choice(len(units), size=rng.integers(1, 4)):
            if units[variable].size:
                inside = int(rng.integers(units[variable].size))
                observation.singles.append((int(variable), inside))
                observation.directions.append(rng.standard_normal(widest.size) * widest / units[variable][inside])


@pytest.mark.parametrize(
    "name", ["shifts and terrain", "measured twice", "second held", "fixed points", "weights of zero"]
)
@pytest.mark.parametrize(("seed", "line"), [(1, "measured"), (2, "predicted")])
def test_bundle_is_explicit_with_any_columns(name: str, seed: int, line: Line) -> None:
    """Whatever feels whatever: a variable through a polynomial and a single column, one column twice in an observation,
    ...
    """
    now = made(name, line)
    variables = now.layout.variables
    points = take_apart(now.layout, now.rows)
    units = [
        now.layout.scales[now.layout.columns_of(v)] if variables.first[v] >= 0 else np.zeros(0)
        for v in range(variables.first.size)
    ]
    with_any_columns(points, units, seed)
    system = pack(points, units, now.layout)
    assert_bundle_is_explicit(system, state(system, size=0.3), 1e-11 if line == "measured" else 1e-8)


@pytest.mark.parametrize("piece", [1, LANES, LANES + 1])
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


@settings(max_examples=10)
@given(seed=SEEDS, line=st.sampled_from(["predicted", "measured"]), loss=st.sampled_from(["none", "huber", "cauchy"]))
def test_bundle_gradient_is_that_of_the_full_cost(seed: int, line: str, loss: str) -> None:
    """What counts of the reduced system is its gradient, that of the full cost."""
    layout = lay_out(network(pair()), SolverSettings(line=line, loss=loss))
    graph = BundleGraph(layout)
    x = np.random.default_rng(seed).standard_normal(36) * layout.scales
    gradient = graph.reduction(x).gradient * layout.scales
    numeric = np.empty(36)
    for k in range(36):
        step = np.zeros(36)
        step[k] = 1e-4 * layout.scales[k]
        difference = [graph.reduction(x + times * step, COSTS).cost for times in (1.0, -1.0, 2.0, -2.0)]
        numeric[k] = (8.0 * (difference[0] - difference[1]) - (difference[2] - difference[3])) / 12e-4
    # Huber's curvature jumps, which costs the differences some digits
    share = 1e-4 if loss == "huber" else 1e-5
    np.testing.assert_allclose(gradient, numeric, rtol=share, atol=share * np.abs(gradient).max())


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
