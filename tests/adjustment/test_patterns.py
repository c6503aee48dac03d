"""The layout of random networks: every point once, every constant from where it belongs, blocks that don't overlap."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odd_networks import random_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph import BundleGraph, lay_out, patterns
from mgsgraph.adjustment.graph.rows import nearly_parallel, parallel
from mgsgraph.adjustment.settings import Angles, Line, SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import BEHIND, FIXED, FREE, OUT, PRIOR
from mgsgraph.names import Names
from mgsgraph.network import Network, Ranges
from mgsgraph.network.observations import observed
from mgsgraph.network.parts import KnownImage
from mgsgraph.simulation.pair import PairSettings, simulate_pair

SEEDS = st.integers(0, 2**32 - 1)
@pytest.fixture(params=[1, 3, 2048], name="piece")
def set_piece(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Most points of a piece, for a whole test."""
    monkeypatch.setattr(patterns, "PIECE", request.param)
    return int(request.param)


def outermost_angles(net: Network) -> Array:
    """Largest angle between any two nominal rays of each point, rad, pair by pair."""
    found = np.zeros(len(net.points))
    for i in range(found.size):
        mine = np.flatnonzero(net.rays.point == i)
        looks = [net.images[j].rays(*place[:, None])[1][0] for j, place in
                 zip(net.rays.image[mine], net.rays.places[mine], strict=True)]  # fmt: skip
        units = [look / np.linalg.norm(look) for look in looks]
        found[i] = max((np.linalg.norm(np.cross(a, b)) for a in units for b in units), default=0.0)
    return found


def test_points_of_parallel_rays_stay_out_unless_something_else_places_them() -> None:
    """The same image twice, from one place: the rays of its ties part by what is not known of its pointing, no more."""
    drawn = simulate_pair(PairSettings(ties=12, shots=5))
    one = drawn.images[0]
    twin = replace(one, name="twin")
    places = one.ground_to_image(drawn.true_ties)[0]
    n = len(drawn.ties.ids)
    ties = replace(
        drawn.ties, measure_point=np.repeat(np.arange(n), 2), measure_image=(one.name, "twin") * n,
        measures=np.repeat(places, 2, axis=0), measure_sigmas=np.ones((2 * n, 2)),
    )  # fmt: skip
    prior = drawn.settings.noise.prior
    net = observed({one.name: KnownImage(one, prior), "twin": KnownImage(twin, prior)}, [ties])
    assert net is not None
    made = lay_out(net, SolverSettings())
    assert np.all(made.rows.kind == OUT)
    shot = Ranges(np.array([3]), np.array([0]), one.timing.at(places[3:4, 0])[0] + one.trajectory.epoch,
                  np.array([4e5]), np.array([1.0]))  # fmt: skip
    kinds = (made := lay_out(replace(net, ranges=shot), SolverSettings())).network_order(made.rows.kind)
    assert np.flatnonzero(kinds != OUT).tolist() == [3]
    apart = replace(ties, measure_image=(one.name, drawn.images[1].name) * n)
    both = {image.name: KnownImage(image, prior) for image in drawn.images}
    apart = replace(apart, measures=np.stack(
        [places, drawn.images[1].ground_to_image(drawn.true_ties)[0]], axis=1).reshape(-1, 2))  # fmt: skip
    stereo = observed(both, [apart])
    assert stereo is not None
    assert not np.any(lay_out(stereo, SolverSettings()).rows.kind == OUT)


def test_points_whose_nearly_parallel_rays_part_stay_out() -> None:
    """A camera beside the first looks a third of a degree ahead: what it sees some lines before the other, or after it,
    lies where their rays cross, or behind them, by more than is said of their pointing.
    """
    drawn = simulate_pair(PairSettings(ties=12, shots=1))
    one, other = drawn.images
    n, ahead = len(drawn.ties.ids), np.array([5e-3 / one.pixel_angle, 0.0])
    twin = replace(one, name="twin", interior=replace(one.interior, centre=one.interior.centre + ahead))
    line, middle, step = 0.5 * one.lines, 0.5 * one.samples, 0.05 * one.lines
    odd = [(line, middle), (line + step, middle), (line, middle), (line - step, middle)]
    ties = replace(
        drawn.ties, ids=Names.of([*drawn.ties.ids, "before", "after"]), kinds=np.append(drawn.ties.kinds, [0, 0]),
        places=np.vstack([drawn.ties.places, np.full((2, 3), np.nan)]),
        covariances=np.zeros((n + 2, 3, 3)),
        measure_point=np.append(drawn.ties.measure_point, [n, n, n + 1, n + 1]),
        measure_image=[*drawn.ties.measure_image, one.name, "twin", one.name, "twin"],
        measures=np.vstack([drawn.ties.measures, odd]), measure_sigmas=np.ones((drawn.ties.measures.shape[0] + 4, 2)),
    )  # fmt: skip
    prior = drawn.settings.noise.prior
    net = observed({image.name: KnownImage(image, prior) for image in (one, other, twin)}, [ties])
    assert net is not None
    assert nearly_parallel(net, np.array([n + 1, 0, n])).tolist() == [True, False, True]
    layout = lay_out(net, SolverSettings())
    states = BundleGraph(layout, layout.rows).reduction(np.zeros(layout.columns)).states
    behind = layout.point_order[states == BEHIND].tolist()
    assert len(behind) == 1
    assert behind[0] >= n
    assert np.flatnonzero(~adjust_network(net, SolverSettings()).determined).tolist() == behind


@settings(max_examples=25)
@given(seed=SEEDS)
def test_what_points_are(seed: int) -> None:
    net = random_network(seed)
    made = lay_out(net, SolverSettings())
    kinds = made.network_order(made.rows.kind)
    rays = np.bincount(net.rays.point, minlength=len(net.points))
    expected = np.array([FREE, PRIOR, FIXED])[net.points.kinds]
    expected[(net.points.kinds == PointKind.FREE) & ((rays < 2) | parallel(net, outermost_angles(net)))] = OUT
    np.testing.assert_array_equal(kinds, expected)
    held = net.points.kinds != PointKind.FREE
    np.testing.assert_array_equal(made.network_order(made.rows.start)[held], net.points.places[held])


@settings(max_examples=25)
@given(seed=SEEDS)
def test_rows_left_out(seed: int) -> None:
    """Weights of what takes part are those of the network, of the others zero; each row has a place of its own."""
    net, rng = random_network(seed), np.random.default_rng(seed)
    made = lay_out(net, SolverSettings())
    sizes = (net.rays.point.size, net.ranges.point.size, len(net.points))
    rays, ranges, out = (rng.random(size) < 0.8 for size in sizes)
    rows = made.active(rays, ranges, out)
    among = made.observation_rows
    every = np.concatenate([among.rays, among.ranges, among.heights])
    assert np.unique(every).size == every.size
    np.testing.assert_array_equal(rows.weight[:, among.rays], np.where(rays, 1.0 / net.rays.sigmas.T, 0.0))
    np.testing.assert_array_equal(rows.weight[0, among.ranges], np.where(ranges, 1.0 / net.ranges.sigmas, 0.0))
    kept = made.network_order(rows.kind) != OUT
    np.testing.assert_array_equal(kept, ~out & (made.network_order(made.rows.kind) != OUT))
    np.testing.assert_array_equal(made.rows.weight[:, made.observation_rows.rays], 1.0 / net.rays.sigmas.T)


@pytest.mark.usefixtures("piece")
@pytest.mark.parametrize(
    ("line", "angles"),
    [("predicted", "camera"), ("measured", "camera"), ("predicted", "opk-paper"), ("predicted", "opk-peer")],
)
def test_rows_are_what_geometry_says_of_any_network(line: Line, angles: Angles) -> None:
    """Residuals at some orientation and at points beside their first places: against `ground_to_image`, distances, and
    the terrain itself. What carrying a pose by its rates leaves out is the orbit's curvature; the papers' form has the
    scale of the nominal image motion.
    """
    for seed in range(6):
        net, rng = random_network(seed), np.random.default_rng(seed)
        made = lay_out(net, SolverSettings(line=line, angles=angles))
        x = rng.standard_normal(made.columns) * made.scales * 0.2
        points = made.rows.start + 30.0 * rng.standard_normal(made.rows.start.shape)
        found, places = residuals(made, x, points), made.network_order(points)
        values = made.variables.split(x)
        for j, image in enumerate(net.images):
            correction = OrientationCorrection(values[j].reshape(-1, 6), angles) if values[j].size else None
            mine = np.flatnonzero((net.rays.image == j) & np.isfinite(places[net.rays.point, 0]))
            measured = net.rays.places[mine]
            off = measured - image.ground_to_image(places[net.rays.point[mine]], correction, measured[:, 0])[0]
            bend = 1e-6 * off[:, :1] ** 2 if line == "predicted" else 2e-3 * np.abs(off).max(axis=1, keepdims=True)
            assert np.all(np.abs(found.image[mine] - off) < 1e-5 + bend)
            mine = np.flatnonzero(net.ranges.image == j)
            lines = image.timing.lines(net.ranges.times[mine] - image.trajectory.epoch)
            distances = np.linalg.norm(places[net.ranges.point[mine]] - image.pose(lines, correction).position, axis=1)
            np.testing.assert_allclose(found.ranges[mine], net.ranges.values[mine] - distances, rtol=0.0, atol=1e-7)
        on = made.observation_rows.on_terrain
        assert np.array_equal(on, np.flatnonzero(np.isfinite(found.heights)))
        if net.surface is not None:
            ways = east_north(made.network_order(made.rows.start)[on])
            under = places[on] - (values[-1] @ ways if net.terrain_moves else 0.0)
            np.testing.assert_allclose(found.heights[on], net.surface.grid.height_above(under)[0], atol=1e-6)
            assert np.array_equal(on, np.flatnonzero(np.isfinite(net.surface.sigmas)))


