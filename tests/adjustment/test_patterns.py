"""The layout of random networks: every point once, every constant from where it belongs, blocks that don't overlap."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair
from normals import HandObservation, take_apart
from odd_networks import random_network
from strategies import along

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out, patterns
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import BEHIND, FIXED, FREE, GROUND, IMAGE, OUT, PRIOR, RANGE
from mgsgraph.names import Names
from mgsgraph.network import Network, Ranges
from mgsgraph.network.observations import observed
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


def powers(u: float, degree: int, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Basis of an orientation polynomial, and its rate where u grows by `slope`."""
    polynomials = [np.polynomial.Polynomial.basis(k) for k in range(degree + 1)]
    return np.array([p(u) for p in polynomials]), np.array([p.deriv()(u) * slope for p in polynomials])


def check_ray(made: Layout, observation: HandObservation, k: int) -> None:
    """Constants of an image observation of the strict form about the camera axes."""
    net = made.network
    j, (line, sample) = int(net.rays.image[k]), net.rays.places[k]
    image = net.images[j]
    pose = image.pose(np.array([line]))
    detector, slope = image.interior.focal_plane(np.array([sample]))
    assert observation.focal == image.interior.focal_length
    parts = np.split(observation.own, [3, 7, 9, 12, 15, 17])
    position, attitude, place, velocity, angular_rate, along_detector, offset = parts
    np.testing.assert_allclose(position, pose.position[0], rtol=1e-15)
    np.testing.assert_allclose(rotation.to_matrix(attitude), pose.matrix[0], atol=1e-15)
    np.testing.assert_allclose(velocity, pose.velocity[0], rtol=1e-13)
    np.testing.assert_allclose(angular_rate, pose.angular_rate[0], rtol=1e-13, atol=1e-20)
    np.testing.assert_array_equal(place, detector[0])
    np.testing.assert_array_equal(along_detector, slope[0])
    assert offset == 0.0
    if net.held[j]:
        assert observation.terms == []
        return
    basis, rates = powers(2.0 * line / image.lines - 1.0, net.priors[j].degree, 2.0 / image.lines)
    assert observation.terms == [(j, 6 * t) for t in range(net.priors[j].degree + 1)]
    np.testing.assert_allclose(observation.basis, basis, rtol=1e-13)
    np.testing.assert_allclose(observation.rates, rates, rtol=1e-13)


def check_range(made: Layout, observation: HandObservation, k: int) -> None:
    net = made.network
    j = int(net.ranges.image[k])
    image, since = net.images[j], net.ranges.times[[k]] - net.images[j].trajectory.epoch
    position = image.trajectory.pose(since).position[0]
    np.testing.assert_allclose(observation.own, [*position, net.ranges.values[k]], rtol=1e-15)
    if not net.held[j]:
        u = float(2.0 * image.timing.lines(since)[0] / image.lines - 1.0)
        np.testing.assert_allclose(observation.basis, powers(u, net.priors[j].degree, 0.0)[0], rtol=1e-13)


def check_ground(made: Layout, observation: HandObservation, i: int) -> None:
    net = made.network
    root = np.zeros((3, 3))
    root[np.triu_indices(3)] = observation.own[3:]
    np.testing.assert_array_equal(observation.own[:3], net.points.places[i])
    np.testing.assert_allclose(root.T @ root @ net.points.covariances[i], np.eye(3), atol=1e-9)
    check_axes(observation, net.points.places[i])


def check_axes(observation: HandObservation, place: np.ndarray) -> None:
    """A shift goes east and north."""
    assert [inside for _, inside in observation.singles] in ([], [0, 1])
    for direction, axis in zip(observation.directions, east_north(place[None])[0], strict=False):
        np.testing.assert_array_equal(direction, axis)


@pytest.mark.usefixtures("piece")
def test_constants_are_the_networks() -> None:
    """Every number that the kernel is given, against image, tables and terrain themselves."""
    for seed in range(6):
        net = random_network(seed)
        made = lay_out(net, SolverSettings())
        tables = made.observation_rows.rays, made.observation_rows.ranges
        ray, shot = ({int(at): k for k, at in enumerate(table)} for table in tables)
        seen = Counter[int]()
        for place, point in enumerate(take_apart(made)):
            i = int(made.point_order[place])
            for observation in point.observations:
                seen[observation.kind] += 1
                if observation.kind == IMAGE:
                    assert net.rays.point[ray[observation.among]] == i
                    check_ray(made, observation, ray[observation.among])
                elif observation.kind == RANGE:
                    assert net.ranges.point[shot[observation.among]] == i
                    check_range(made, observation, shot[observation.among])
                elif observation.kind == GROUND:
                    check_ground(made, observation, i)
                else:
                    assert net.surface is not None
                    assert observation.weight[0] == 1.0 / net.surface.sigmas[i]
                    check_axes(observation, made.rows.start[place])
        assert (seen[IMAGE], seen[RANGE]) == (net.rays.point.size, net.ranges.point.size)
        assert seen[GROUND] == np.count_nonzero(net.points.kinds == PointKind.CONSTRAINED)


def test_frozen_scale_is_the_nominal_image_motion() -> None:
    """In the papers' form, to residuals: what a still point does in the focal plane from line to line, by differences.
    """
    net = network(pair())
    made = lay_out(net, SolverSettings(line="measured"))
    for place, point in enumerate(take_apart(made)):
        for observation in (s for s in point.observations if s.kind == IMAGE):
            k = int(np.flatnonzero(made.observation_rows.rays == observation.among)[0])
            image, (line, sample) = net.images[net.rays.image[k]], net.rays.places[k]

            def in_focal_plane(lines: float, image=image, line=line, place=place) -> np.ndarray:
                pose = image.pose(np.array([line + lines]))
                ray = pose.matrix[0] @ (made.rows.start[place] - pose.position[0])
                return image.interior.focal_length * ray[:2] / ray[2]

            _, slope = image.interior.focal_plane(np.array([sample]))
            motion, scale = along(in_focal_plane, 5.0), observation.own[-4:].reshape(2, 2)
            np.testing.assert_allclose(scale @ np.stack([motion, slope[0]], axis=1), np.diag([1.0, -1.0]), atol=1e-6)
