"""The layout of networks: every point once, every constant from where it belongs, in memory or in a mapped file; and at
the optimum every row is that of the true trajectory at the true predicted line, wherever its samples are.
"""

import mmap
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from explicit_form import by_gtsam
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from odd_networks import random_network
from outside import refuses

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph import BundleGraph, lay_out, patterns, rows
from mgsgraph.adjustment.rounds import about_predicted_lines
from mgsgraph.adjustment.settings import Angles, Line, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.kernel.rows import BEHIND, FIXED, FREE, OUT, PRIOR
from mgsgraph.names import Names
from mgsgraph.network import Network, Ranges
from mgsgraph.network.observations import build_network
from mgsgraph.network.parallel import nearly_parallel, parallel
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
    net = build_network({one.name: KnownImage(one, prior), "twin": KnownImage(twin, prior)}, [ties])
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
    stereo = build_network(both, [apart])
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
    net = build_network({image.name: KnownImage(image, prior) for image in (one, other, twin)}, [ties])
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
    active = made.active(rays, ranges, out)
    among = made.observation_rows
    every = np.concatenate([among.rays, among.ranges, among.heights])
    assert np.unique(every).size == every.size
    np.testing.assert_array_equal(active.weight[:, among.rays], np.where(rays, 1.0 / net.rays.sigmas.T, 0.0))
    np.testing.assert_array_equal(active.weight[0, among.ranges], np.where(ranges, 1.0 / net.ranges.sigmas, 0.0))
    kept = made.network_order(active.kind) != OUT
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


# --- rows in a mapped file


LITTLE = 1e-9
"""GB: everything goes to files."""


def in_a_file(values: Any) -> bool:
    """Whether an array lies in a mapped file."""
    while isinstance(values, np.ndarray):
        values = values.base
    return isinstance(values.obj if isinstance(values, memoryview) else values, mmap.mmap)


@pytest.mark.parametrize("settings", [SolverSettings(), SolverSettings(reject=4.0), SolverSettings(line="measured")])
def test_in_a_file_as_in_memory(settings: SolverSettings) -> None:
    net = with_shift_and_surface(network(pair()))
    inside = adjust_network(net, settings)
    outside = adjust_network(net, replace(settings, memory_gb=LITTLE))
    for name in ("places", "covariances", "residuals", "range_residuals"):
        np.testing.assert_array_equal(getattr(outside, name), getattr(inside, name))
    for one, other in zip(outside.coefficients, inside.coefficients, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("line", ["predicted", "measured"])
def test_constants_lie_in_a_file_where_memory_is_short(line: Line) -> None:
    for memory, outside in ((LITTLE, True), (1.0, False), (None, False)):
        made = lay_out(network(pair()), SolverSettings(line=line, memory_gb=memory))
        for layout in (made, made.about(made.lines + 0.5)):
            assert in_a_file(layout.rows.data) == outside


def test_a_container_has_less_memory_than_its_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rows.memory()
    monkeypatch.setattr(rows, "_LIMITS", (tmp_path / "max", tmp_path / "none", tmp_path / "limit"))
    assert rows.memory() >= whole
    (tmp_path / "max").write_text("max\n")
    (tmp_path / "limit").write_text("1000000\n")
    assert rows.memory() == 1e6
    assert rows.Storage.within(None).most < 1e6
    assert rows.Storage.within(2.0).most == 2e9 * rows._SHARE


def test_no_room_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rows.os, "posix_fallocate", full)
    refuses("No space left", rows.Storage(0.0).room, 10)


@pytest.mark.parametrize("net", [network(pair()), with_shift_and_surface(network(pair()))])
def test_renewed_as_laid_out_anew(net: Network) -> None:
    made = lay_out(net, SolverSettings())
    lines = made.lines + np.random.default_rng(1).normal(0.0, 20.0, made.lines.size)
    anew = made._sorted_again(lines, made.bent)
    before = made.rows.data.copy()
    apart = made.about(lines)
    np.testing.assert_array_equal(made.rows.data, before)
    np.testing.assert_array_equal(apart.rows.data, anew.rows.data)
    own = made.about(lines, in_place=True)
    assert own.rows.data is made.rows.data
    np.testing.assert_array_equal(own.rows.data, anew.rows.data)


# --- the predicted line


TIGHT = {"cost_tolerance": 1e-15, "step_tolerance": 1e-9, "max_iterations": 60}


def exact_residuals(solution: Solution, before: bool = False) -> np.ndarray:
    """(k, 2) measured minus predicted place, by Newton's method on the tables themselves (`ground_to_image`)."""
    every = solution.places_before if before else solution.places
    net, found = solution.network, np.full((solution.network.rays.point.size, 2), np.nan)
    for j, image in enumerate(net.images):
        mine = np.flatnonzero((net.rays.image == j) & solution.rays_used)
        correction = None if before else solution.correction(j)
        predicted, _ = image.ground_to_image(every[net.rays.point[mine]], correction, net.rays.places[mine, 0])
        found[mine] = net.rays.places[mine] - predicted
    return found


def assert_exact(solution: Solution) -> None:
    used = solution.rays_used
    np.testing.assert_allclose(solution.residuals[used], exact_residuals(solution)[used], rtol=0.0, atol=1e-7)


@pytest.fixture(scope="module")
def lro_pair(shared_data: Path) -> Solution:
    case = mgsgraph.read_case(Path(__file__).parents[2] / "scripts" / "cases" / "lro_nac_lola.toml")
    return adjust_network(case.network, case.settings)


def test_rows_of_the_lro_pair_are_exact(lro_pair: Solution) -> None:
    """Its attitude is sampled every 0.2 s, 550 lines; carried by the rates at the measured line, 1e-3 px were wrong."""
    assert lro_pair.converged
    assert_exact(lro_pair)


class Dense:
    """All rows of a network of free and constrained points by functions of `geometry` on the tables themselves;
    derivatives by differences. Nothing of the kernel or of the lay-out takes part.
    """

    def __init__(self, net: Network) -> None:
        self.net = net
        self.sigmas = np.stack([prior.sigmas for prior in net.priors])
        self.known = np.flatnonzero(net.points.kinds == PointKind.CONSTRAINED)
        self.roots = np.linalg.inv(np.linalg.cholesky(net.points.covariances[self.known]))

    def rows(self, coefficients: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """Whitened residuals of rays (k, 2) and ranges (r,), priors (images, d, 6), and a-priori places (c, 3)."""
        net, rays, ranges = self.net, np.empty((self.net.rays.point.size, 2)), np.empty(self.net.ranges.point.size)
        for j, image in enumerate(net.images):
            correction = OrientationCorrection(coefficients[j])
            mine = np.flatnonzero(net.rays.image == j)
            predicted, _ = image.ground_to_image(points[net.rays.point[mine]], correction, net.rays.places[mine, 0])
            rays[mine] = (net.rays.places[mine] - predicted) / net.rays.sigmas[mine]
            shots = np.flatnonzero(net.ranges.image == j)
            lines = image.timing.lines(net.ranges.times[shots] - image.trajectory.epoch)
            ray = points[net.ranges.point[shots]] - image.pose(lines, correction).position
            distance = np.sqrt((ray**2).sum(axis=1))
            ranges[shots] = (net.ranges.values[shots] - distance) / net.ranges.sigmas[shots]
        known = np.einsum("cij,cj->ci", self.roots, (points - net.points.places)[self.known])
        return rays, ranges, coefficients / self.sigmas, known

    def cost(self, coefficients: np.ndarray, points: np.ndarray) -> float:
        return float(0.5 * sum((part**2).sum() for part in self.rows(coefficients, points)))

    def slope(self, coefficients: np.ndarray, points: np.ndarray, d: np.ndarray, e: np.ndarray) -> list[np.ndarray]:
        """Derivatives of all rows as coefficients and points move by so much."""
        ahead, behind = self.rows(coefficients + d, points + e), self.rows(coefficients - d, points - e)
        return [0.5 * (a - b) for a, b in zip(ahead, behind, strict=True)]

    def step(self, coefficients: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A Gauss-Newton step: every ray sees one point and one image, so that all move at once in each column."""
        net, images = self.net, coefficients.shape[0]
        k, r, own = net.rays.point.size, net.ranges.point.size, coefficients[0].size
        size, first = coefficients.size, 2 * k + r + coefficients.size
        matrix = np.zeros((first + 3 * self.known.size, size + points.size))
        right = np.concatenate([part.ravel() for part in self.rows(coefficients, points)])
        every, shots, none = np.arange(k), 2 * k + np.arange(r), np.zeros_like(coefficients)
        for c in range(own):
            move = none.reshape(images, own).copy()
            small = 1e-4 * self.sigmas.reshape(images, own)[:, c]
            move[:, c] = small
            rays, ranges, *_ = self.slope(coefficients, points, move.reshape(none.shape), np.zeros_like(points))
            for row in range(2):
                matrix[2 * every + row, own * net.rays.image + c] = rays[:, row] / small[net.rays.image]
            matrix[shots, own * net.ranges.image + c] = ranges / small[net.ranges.image]
        for axis in range(3):
            move = np.zeros_like(points)
            move[:, axis] = small = 0.01
            rays, ranges, *_ = self.slope(coefficients, points, none, move)
            for row in range(2):
                matrix[2 * every + row, size + 3 * net.rays.point + axis] = rays[:, row] / small
            matrix[shots, size + 3 * net.ranges.point + axis] = ranges / small
        priors = np.arange(size)
        matrix[2 * k + r + priors, priors] = 1.0 / self.sigmas.ravel()
        for c, (point, root) in enumerate(zip(self.known.tolist(), self.roots, strict=True)):
            matrix[first + 3 * c : first + 3 * c + 3, size + 3 * point : size + 3 * point + 3] = root
        scale = np.sqrt((matrix**2).sum(axis=0))
        found = -scipy.linalg.lstsq(matrix / scale, right, lapack_driver="gelsy")[0] / scale
        return coefficients + found[:size].reshape(none.shape), points + found[size:].reshape(-1, 3)


# above two seconds: every row of 363 points by the tables themselves, and least squares of all of them
def test_the_lro_pairs_cost_is_that_of_an_exact_dense_solution(lro_pair: Solution) -> None:
    """To 1e-9: minimised anew, with the tables' own interpolation at the true predicted line."""
    solution, dense = lro_pair, Dense(lro_pair.network)
    points = np.where(solution.determined[:, None], solution.places, 0.0)
    assert np.all(solution.rays_used)
    state = np.stack(solution.coefficients), points
    at_ours = dense.cost(*state)
    state = dense.step(*state)
    assert at_ours == pytest.approx(solution.cost_final, rel=1e-9)
    assert solution.cost_final == pytest.approx(dense.cost(*state), rel=1e-9)


def shaken(image: PushbroomImage) -> PushbroomImage:
    """The image with an attitude sampled some 40 times over its lines, each sample 5 microradians aside."""
    old = image.trajectory
    assert isinstance(old, Trajectory)
    times = np.linspace(*old.coverage, 200)
    matrix, _ = old.camera.at(times)
    noise = np.random.default_rng(3).normal(0.0, 5e-6, (times.size, 3))
    quaternions = rotation.from_matrix(rotation.exponential(noise) @ matrix)
    return replace(image, trajectory=replace(old, camera=AttitudeTable(times, quaternions, np.eye(3))))


@pytest.fixture(name="jittery", scope="module")
def make_jittery() -> Network:
    net = network(pair(ties=40, shots=6))
    return replace(net, images=tuple(map(shaken, net.images)))


def test_both_forms_have_the_same_exact_optimum_across_samples_of_the_attitude(jittery: Network) -> None:
    bundle = adjust_network(jittery, SolverSettings(**TIGHT))
    assert_exact(bundle)
    before = exact_residuals(bundle, before=True)  # with the nominal orientation, hundreds of lines off
    np.testing.assert_allclose(bundle.residuals_before, before, rtol=0.0, atol=1e-6)
    assert by_gtsam(bundle).cost_final == pytest.approx(bundle.cost_final, rel=1e-9)


def test_rows_carried_from_the_measured_line_are_not(jittery: Network) -> None:
    """The test above can fail: without laying rays out anew the same rows are off."""
    layout, solution = lay_out(jittery, SolverSettings()), adjust_network(jittery, SolverSettings())
    x = np.concatenate([part.ravel() for part in solution.coefficients])
    points = solution.places[layout.point_order]
    carried = BundleGraph(layout).sweeper.residuals(layout, layout.rows, x, points)[layout.observation_rows.rays]
    assert np.abs(carried - exact_residuals(solution)).max() > 1e-5
    again = about_predicted_lines(layout, x, points)
    assert again is not layout
    assert about_predicted_lines(again, x, solution.places[again.point_order]) is again
