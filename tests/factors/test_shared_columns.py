"""Single columns that observations share, and nodes, through the one kernel: rows put together by hand.

Time biases, boresight, focal length and range bias are single columns that several observations share, each with a
direction in the observation's state; nodes are basis terms with a variable of their own each. Held against finite
differences (each row), against NumPy's Schur complement (the sums), and against a camera that truly is so (the
meaning).
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from jacobians import assert_jacobians
from networks import network, pair, with_shift_and_surface
from normals import (
    HandObservation,
    HandPoint,
    System,
    assert_bundle_is_explicit,
    assert_gradient_is_that_of_the_cost,
    explicit_factors,
    of_layout,
    pack,
    point_key,
    take_apart,
    values_at,
    variable_key,
)

from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.kernel.rows import IMAGE, PIECE, RANGE

NODES = 6
"""Per image, evenly over its lines and one interval beyond both ends."""


@dataclass(eq=False)
class Draft:
    """Points and units of the unknowns, before they are packed."""

    layout: Layout
    points: list[HandPoint]
    units: list[np.ndarray]

    def variable(self, *units: float) -> int:
        """A new variable with these units."""
        self.units.append(np.array(units))
        return len(self.units) - 1

    def observations(self, kind: int) -> list[tuple[HandObservation, PushbroomImage, float]]:
        """All observations of a kind, each with its image and its line (or, of a range, its time past the epoch)."""
        network, places = self.layout.network, self.layout.observation_rows
        table, among = (network.rays, places.rays) if kind == IMAGE else (network.ranges, places.ranges)
        row = {int(at): k for k, at in enumerate(among)}
        found = []
        for observation in (s for point in self.points for s in point.observations if s.kind == kind):
            k = row[observation.among]
            image = network.images[table.image[k]]
            at = network.rays.places[k, 0] if kind == IMAGE else network.ranges.times[k] - image.trajectory.epoch
            found.append((observation, image, float(at)))
        return found

    def pack(self, most: int = PIECE) -> System:
        return pack(self.points, self.units, self.layout, most)


def draft(degree: int = 2, surface: bool = True) -> Draft:
    """The pair's points with what the adjustment itself gives them."""
    net = network(pair())
    prior = OrientationPrior(net.priors[0].sigmas[:1] * np.array([1.0, 0.1, 0.01, 0.001])[: degree + 1, None])
    net = replace(net, priors=(prior, prior))
    layout = lay_out(with_shift_and_surface(net) if surface else net, SolverSettings())
    units = [layout.scales[layout.columns_of(v)] for v in range(layout.variables.first.size)]
    return Draft(layout, take_apart(layout), units)


def period(image: PushbroomImage) -> float:
    return float(image.timing.periods[0])


def add(observation: HandObservation, variable: int, inside: int, direction: np.ndarray) -> None:
    observation.singles.append((variable, inside))
    observation.directions.append(np.asarray(direction, dtype=np.float64))


def widen(observation: HandObservation, width: int) -> None:
    """Let the state have more components; what is there already doesn't touch them."""
    observation.directions = [np.append(d, np.zeros(width - observation.width)) for d in observation.directions]
    observation.width = width


def attitude_time(made: Draft) -> None:
    """One column for the camera, in s, shared by its images: it turns along its nominal angular_rate."""
    variable = made.variable(0.05)
    for observation, image, _ in made.observations(IMAGE):
        angular_rate = observation.own[-6:-3] / period(image)
        add(observation, variable, 0, np.concatenate([np.zeros(3), angular_rate, np.zeros(observation.width - 6)]))


def position_time(made: Draft) -> None:
    """One column, in s, shared by images and ranges: the instrument is further along its path."""
    variable = made.variable(0.01)
    for observation, image, _ in made.observations(IMAGE):
        motion = observation.own[-9:-6] / period(image)
        add(observation, variable, 0, np.append(motion, np.zeros(observation.width - 3)))
    for observation, image, time in made.observations(RANGE):
        velocity = image.trajectory.pose(np.array([time])).velocity[0]
        add(observation, variable, 0, np.append(velocity, np.zeros(observation.width - 3)))


def boresight(made: Draft) -> None:
    """Three columns, in rad, about the camera axes."""
    variable = made.variable(1e-4, 1e-4, 1e-4)
    for observation, _, _ in made.observations(IMAGE):
        for axis in range(3):
            add(observation, variable, axis, np.eye(observation.width)[3 + axis])


def focal_length(made: Draft) -> None:
    """One column, in m, on the ninth component of the state."""
    variable = made.variable(0.01)
    for observation, _, _ in made.observations(IMAGE):
        widen(observation, 9)
        add(observation, variable, 0, np.eye(9)[8])


def principal_point(made: Draft) -> None:
    """Two columns, in m, on the seventh and eighth component of the state."""
    variable = made.variable(1e-4, 1e-4)
    for observation, _, _ in made.observations(IMAGE):
        widen(observation, 9)
        for axis in range(2):
            add(observation, variable, axis, -np.eye(9)[6 + axis])


def radial_distortion(made: Draft) -> None:
    """One column, in m, along each ray's place in the focal plane."""
    variable = made.variable(1e-4)
    for observation, _, _ in made.observations(IMAGE):
        widen(observation, 9)
        add(observation, variable, 0, np.concatenate([np.zeros(6), observation.own[7:9] / 0.013, [0.0]]))


def range_bias(made: Draft) -> None:
    """One column, in m, on a fourth component of a range's state."""
    variable = made.variable(5.0)
    for observation, _, _ in made.observations(RANGE):
        widen(observation, 4)
        add(observation, variable, 0, np.eye(4)[3])


def node_lines() -> np.ndarray:
    """(NODES,) u at the nodes."""
    step = 2.0 / (NODES - 3)
    return -1.0 + step * (np.arange(NODES) - 1.0)


def lagrange(u: float) -> tuple[int, np.ndarray, np.ndarray]:
    """First of the four nodes around u, and their Lagrange polynomials and d/du there, by Vandermonde's matrix."""
    at = node_lines()
    first = int(np.clip(np.searchsorted(at, u, side="right") - 2, 0, NODES - 4))
    powers = np.vander(at[first : first + 4], increasing=True)
    basis = np.linalg.solve(powers.T, u ** np.arange(4.0))
    slope = np.linalg.solve(powers.T, np.array([0.0, 1.0, 2.0 * u, 3.0 * u * u]))
    return first, basis, slope


def nodes(made: Draft) -> None:
    """Corrections at nodes in place of polynomials; the points fall apart into groups by the nodes that they touch."""
    own = [[made.variable(*[30.0] * 3, *[1e-4] * 3) for _ in range(NODES)] for _ in made.layout.network.images]
    for kind in (IMAGE, RANGE):
        for observation, image, at in made.observations(kind):
            line = at if kind == IMAGE else float(image.timing.lines(np.array([at]))[0])
            first, observation.basis, slope = lagrange(float(image.normalised(line)))
            observation.terms = [(variable, 0) for variable in own[_index(made, image)][first : first + 4]]
            observation.rates = slope * image.normalised_rate if kind == IMAGE else np.zeros(0)
    made.units[:2] = [np.zeros(0), np.zeros(0)]


def _index(made: Draft, image: PushbroomImage) -> int:
    return next(j for j, other in enumerate(made.layout.network.images) if other is image)


def everything(made: Draft) -> None:
    """All of them at once."""
    for build in (nodes, *SINGLE):
        build(made)


SINGLE = (attitude_time, position_time, boresight, focal_length, principal_point, radial_distortion, range_bias)


Build = Callable[[Draft], None]
COLUMNS: dict[str, Build] = {
    f.__name__: f for f in (*SINGLE, nodes, everything)
}


@cache
def system(name: str, most: int = PIECE) -> System:
    made = draft()
    COLUMNS[name](made)
    return made.pack(most)


def state(made: System, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(made.columns) * made.sigmas


def test_the_layout_taken_apart_and_packed_again_is_itself() -> None:
    """So that what the tests below find is due to the columns alone."""
    made = draft()
    again, own = made.pack(), of_layout(made.layout)
    x = state(own)
    first, second = again.reduce(x), own.reduce(x)
    assert first.cost == pytest.approx(second.cost, rel=1e-14)
    np.testing.assert_allclose(first.gradient, second.gradient, rtol=1e-7)
    np.testing.assert_allclose(again.matrix(first.blocks), own.matrix(second.blocks), rtol=1e-6)


@pytest.mark.parametrize("name", COLUMNS)
def test_rows(name: str) -> None:
    """The oracle on every observation of four points: the first and last of the layout's, and two between.

    The tolerance is a share of a block's largest entry, which of a focal length is next to nothing in mid-image.
    """
    made = system(name)
    x, points = state(made), made.reduce(state(made)).points
    steps = {variable_key(v): 0.1 * made.sigmas[made.variables.columns_of(v)] for v in made.variables.adjusted()}
    chosen = np.linspace(0, points.shape[0] - 1, 4).astype(int)
    felt = set[int]()
    for mine in explicit_factors(made):
        if mine.point in chosen:
            everything = values_at(made, x, points)
            for key in set(everything.keys()) - set(mine.factor.keys()):
                everything.erase(key)
            assert_jacobians(mine.factor, everything, steps | {point_key(mine.point): np.ones(3)}, tolerance=2e-5)
            felt |= set(mine.felt)
    assert len(felt) >= min(len(made.variables.adjusted()), 4)


@pytest.mark.parametrize("name", ["nodes", "everything"])
def test_bundle_is_explicit(name: str) -> None:
    """Newton's method on the line takes its steps for all lanes of a tile together, up to 1e-4 lines more than a single
    observation needs: with many points in a tile that is 1e-4 of some thousand lines, or of the 1700 between two nodes.
    """
    alone, together = system(name, 1), system(name)
    assert_bundle_is_explicit(alone, state(alone), 1e-11)
    assert_bundle_is_explicit(together, state(together), 1e-7)


@pytest.mark.parametrize("name", ["nodes", "everything"])
def test_gradient_is_that_of_the_reduced_cost(name: str) -> None:
    made = system(name)
    assert_gradient_is_that_of_the_cost(made, state(made))


def test_nodes_make_groups_of_the_nodes_touched() -> None:
    made = system("nodes")
    sizes = np.diff(made.groups.member_first)
    assert sizes.size > 2
    assert sizes.max() < 2 * NODES
    assert np.all(made.rows.observation_terms[made.rows.observation_kind == IMAGE] == 4)


def residuals(made: System, x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Of all observations that take part, one after the other, in pixels and m."""
    found = []
    for mine in explicit_factors(made):
        values = values_at(made, x, points)
        found.append(mine.factor.unwhitenedError(values))
    return np.concatenate(found)


def shift_attitude(observation: HandObservation, image: PushbroomImage, line: float, amount: float) -> None:
    pose = image.pose(np.array([line + amount / period(image)]))
    observation.own[3:7] = rotation.from_matrix(pose.matrix)[0]


def shift_position(observation: HandObservation, image: PushbroomImage, at: float, amount: float) -> None:
    time = image.timing.at(np.array([at]))[0] if observation.kind == IMAGE else np.array([at])
    observation.own[:3] = image.trajectory.pose(time + amount).position[0]


def turn_camera(observation: HandObservation, image: PushbroomImage, line: float, amount: float) -> None:
    turned = rotation.exponential(np.array([0.0, amount, 0.0])).T @ image.pose(np.array([line])).matrix
    observation.own[3:7] = rotation.from_matrix(turned)[0]
    observation.own[-6:-3] = rotation.exponential(np.array([0.0, amount, 0.0])).T @ observation.own[-6:-3]


def lengthen(observation: HandObservation, image: PushbroomImage, line: float, amount: float) -> None:
    observation.focal += amount


def displace(observation: HandObservation, image: PushbroomImage, line: float, amount: float) -> None:
    observation.own[8] -= amount


def delay(observation: HandObservation, image: PushbroomImage, time: float, amount: float) -> None:
    observation.own[3] -= amount


@pytest.mark.parametrize(
    ("build", "inside", "amount", "truly", "kinds"),
    [
        # rotations of constant speed: exact but for the poles' precession in the tables' interpolation
        (attitude_time, 0, 0.02, shift_attitude, (IMAGE,)),
        # an orbit bends by half of 3.5 m/s2 times the time squared: 2e-4 m
        (position_time, 0, 0.01, shift_position, (IMAGE, RANGE)),
        (boresight, 1, 3e-4, turn_camera, (IMAGE,)),
        (focal_length, 0, 0.02, lengthen, (IMAGE,)),
        (principal_point, 1, 1e-4, displace, (IMAGE,)),
        (range_bias, 0, 4.0, delay, (RANGE,)),
    ],
)
def test_a_column_does_what_its_name_says(
    build: Build,
    inside: int,
    amount: float,
    truly: Callable[[HandObservation, PushbroomImage, float, float], None],
    kinds: tuple[int, ...],
) -> None:
    """A column's value has the same residuals as an instrument that truly is so, to 1e-3 pixels and m."""
    made = draft(surface=False)
    build(made)
    other = replace(made, points=deepcopy(made.points))
    for kind in kinds:
        for observation, image, at in other.observations(kind):
            truly(observation, image, at, amount)
    columned, true = made.pack(), other.pack()
    x = np.zeros(columned.columns)
    points = columned.reduce(x).points
    nominal, changed = residuals(columned, x, points), residuals(true, x, points)
    x[columned.variables.first[-1] + inside] = amount
    np.testing.assert_allclose(residuals(columned, x, points), changed, rtol=0.0, atol=1e-3)
    assert np.abs(changed - nominal).max() > 1.0


def test_nodes_on_a_cubic_are_the_polynomial() -> None:
    """Cubic interpolation has cubics right: same residuals as orientation polynomials of degree three."""
    polynomial, noded = draft(degree=3), draft(degree=3)
    nodes(noded)
    first, second = polynomial.pack(), noded.pack()
    x = np.random.default_rng(5).standard_normal(first.columns) * first.sigmas
    y = np.zeros(second.columns)
    for v in noded.layout.variables.adjusted():
        if v > 1:  # shifts
            y[second.variables.columns_of(v)] = x[first.variables.columns_of(v)]
            continue
        cubic = x[first.variables.columns_of(v)].reshape(4, 6)
        begin = len(polynomial.units) + v * NODES
        for k, u in enumerate(node_lines()):
            y[second.variables.columns_of(begin + k)] = u ** np.arange(4.0) @ cubic
    found, other = first.reduce(x), second.reduce(y)
    assert found.cost == pytest.approx(other.cost, rel=1e-10)
    by_place, by_other = np.argsort(found.points[:, 0]), np.argsort(other.points[:, 0])
    np.testing.assert_allclose(found.points[by_place], other.points[by_other], atol=1e-6)
