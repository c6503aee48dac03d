"""Images that are added one at a time, and what the result is measured against: batch over the same observations."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import Network
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage, Unknown, without_images
from mgsgraph.simulation.camera import narrow_image
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.orbit import HEADING, MARS, CircularPass, ground_track, site_at
from mgsgraph.simulation.strip import SimulatedStrip, Steps, StripSettings, simulate_strip
from mgsgraph.units import DEG

NOISE = NoiseSettings()
"""What strips are made with."""
WITHIN = 0.01
"""Sigmas that the issue allows the incremental result to differ from batch."""

Observations = list[TiePoints | LaserProfile]


@cache
def strip(images: int = 6, ties: int = 12, shots: int = 5) -> SimulatedStrip:
    """The simulator's own strip: pairs along a track, each image shares ground with two or three others."""
    return simulate_strip(StripSettings(images=images, ties=ties, shots=shots), seed=3)


@cache
def fan(images: int = 5, ties: int = 10, shots: int = 4, known: tuple[int, ...] = ()) -> SimulatedStrip:
    """Images along a track, each tilted otherwise: whatever two of them see converges by at least 9 degrees, so that
    they may come and go in any order. (Where only nadir images see a point, its height is anyone's guess, and batch and
    increments may disagree whether it has one.) The nominal orientation of `known` ones is all but true.
    """
    settings = StripSettings(images=images, ties=ties, shots=shots)
    start = CircularPass(-11e6, site_at(1.58, -0.42), HEADING / np.cos(0.42), settings.altitude)
    sites, headings = ground_track(start, 2.5 * np.arange(float(images)))
    steps = Steps(ties, shots, settings.relief, settings.noise)
    for k, rng in enumerate(np.random.default_rng(5).spawn(images)):
        tilt = (-20.0, 10.0, -10.0, 20.0, 0.0)[k % 5] * DEG
        steps.noise = replace(NOISE, position=0.1, angle=1e-7) if k in known else NOISE
        passage = CircularPass(-11e6 + 88_775.0 * k, sites[k], float(headings[k]), settings.altitude, tilt)
        steps.add(narrow_image(f"FAN/{k}", passage, settings.lines, settings.samples, settings.period), rng)
    return SimulatedStrip.of_steps(settings, 5, tuple(steps.taken))


# --- adding


def take(adjustment: IncrementalAdjustment, made: SimulatedStrip, k: int) -> Impact:
    """The strip's next step."""
    step = made.steps[k]
    return adjustment.add(step.image, _there(step.ties, step.laser), NOISE.prior, NOISE.tie, NOISE.shot_image)


def grown(made: SimulatedStrip, count: int, settings: SolverSettings | None = None) -> IncrementalAdjustment:
    """The strip's first images, added one at a time."""
    adjustment = IncrementalAdjustment(settings)
    for k in range(count):
        take(adjustment, made, k)
    return adjustment


def _there(*observations: TiePoints | LaserProfile | None) -> Observations:
    return [one for one in observations if one is not None]


def take_alone(adjustment: IncrementalAdjustment, made: SimulatedStrip, k: int) -> Impact:
    """One of the strip's images in any order: its own measures bring the points that nobody has seen before."""
    image = made.images[k]
    return adjustment.add(image, own_measures(made, image.name), NOISE.prior, NOISE.tie, NOISE.shot_image)


def own_measures(made: SimulatedStrip, image: str) -> Observations:
    """What one image of a strip sees: measures in it alone, and the ranges of its own shots."""
    return [_own_ties(made.ties, image), *(_own_shots(laser, image) for laser in made.lasers)]


def _own_ties(ties: TiePoints, image: str) -> TiePoints:
    rows = np.flatnonzero(np.array(ties.measure_image) == image)
    kept, point = np.unique(ties.measure_point[rows], return_inverse=True)
    return replace(
        ties, ids=tuple(ties.ids[i] for i in kept), kinds=ties.kinds[kept], places=ties.places[kept],
        covariances=ties.covariances[kept], measure_point=point, measure_image=(image,) * rows.size,
        measures=ties.measures[rows], measure_sigmas=ties.measure_sigmas[rows],
    )  # fmt: skip


def _own_shots(laser: LaserProfile, image: str) -> LaserProfile:
    rows = np.flatnonzero(np.array(laser.measure_image) == image)
    along = laser.simultaneous_image.over([image]) == 0
    return replace(
        laser, measure_shot=laser.measure_shot[rows], measure_image=(image,) * rows.size, measures=laser.measures[rows],
        simultaneous_shot=laser.simultaneous_shot[along], simultaneous_image=laser.simultaneous_image[along],
    )  # fmt: skip


def network_of(made: SimulatedStrip, chosen: Sequence[int]) -> Network:
    """Some images of a strip with all that they see, put together without any incremental adjustment."""
    images = {made.images[k].name: KnownImage(made.images[k], NOISE.prior) for k in chosen}
    parts = [part for name in images for part in own_measures(made, name)]
    network = build_network(images, parts, NOISE.tie, NOISE.shot_image)
    assert network is not None
    seen = without_images(network, ())  # a profile names shots that none of these shows
    assert seen is not None
    return seen


def by_image(network: Network) -> list[Network]:
    """A network taken apart: what each of its images sees by itself."""
    names = set(network.image_names)
    parts = [without_images(network, names - {image.name}) for image in network.images]
    return [one for one in parts if one is not None]


def slope(network: Network) -> TerrainGrid:
    """A terrain model of four posts that falls by a hundredth in either direction. (Where ground is rough
    a few points hold a model's shift at several places, and batch and increments may end at different ones.)
    """
    longitude, latitude, _ = planetocentric(network.points.places[np.isfinite(network.points.places[:, 0])]).T
    at = np.array([longitude.mean(), latitude.mean()])
    posts = [[at + DEG * np.array([i, j]) for i in (-1.0, 1.0)] for j in (1.0, -1.0)]
    level = [[np.linalg.norm(site_at(*post)) for post in row] for row in posts]
    fall = 0.01 * MARS.equatorial * DEG * np.array([[0.0, -1.0], [1.0, 0.0]])
    return TerrainGrid("made by the test", level + fall, *posts[0][0], 2.0 * DEG, 2.0 * DEG)


# --- comparing


Places = dict[str, tuple[np.ndarray, np.ndarray]]
"""Place (3,) in m and sigmas (3,) in m of points by name; NaN for undetermined ones."""
State = dict[str, tuple[np.ndarray, np.ndarray]]
"""Coefficients (d,) and their covariance (d, d), m and rad, of adjusted images by name."""


class Distances(NamedTuple):
    """How far an incremental adjustment lies from batch at most."""

    unknowns: float
    """Orientation coefficients and shifts, in their sigmas."""
    points: float
    """Coordinates of points, in their sigmas; infinite where one of the two has a place and the other has none."""
    covariances: float
    """Of the images' coefficients, in units of sigma times sigma."""
    spreads: float
    """Of the points' covariances, relative to their largest variance."""

    def within(self, sigmas: float = WITHIN, relative: float = 1e-3) -> bool:
        """Whether values are within so many sigmas, covariances within a part of themselves."""
        return max(self.unknowns, self.points) < sigmas and max(self.covariances, self.spreads) < relative


def distances(adjustment: IncrementalAdjustment, batch: Solution) -> Distances:
    """Compare all unknowns and all points, refreshed."""
    network, values, unknowns, covariances = batch.network, adjustment.values, [0.0], [0.0]
    for j, image in enumerate(network.images):
        mine = adjustment.correction(image.name).coefficients
        if network.held[j]:
            assert not np.any(mine)
            continue
        cov = batch.image_covariance(j)
        sigmas = np.sqrt(np.diag(cov))
        unknowns.append(np.max(np.abs(mine - batch.coefficients[j]).ravel() / sigmas))
        covariances.append(np.max(np.abs(adjustment.covariance(image.name) - cov) / np.outer(sigmas, sigmas)))
    for p, name in enumerate(network.shift_names):
        sigmas = np.sqrt(np.diag(batch.shift_covariance(p)))
        unknowns.append(np.max(np.abs(values[Unknown("shift", name)] - batch.shifts[p]) / sigmas))
    points, spreads = _of_points(adjustment, batch)
    return Distances(float(max(unknowns)), points, float(max(covariances)), spreads)


def _of_points(adjustment: IncrementalAdjustment, batch: Solution) -> tuple[float, float]:
    """Of places and of covariances; batch knows every point of the adjustment, and places the same ones."""
    assert set(adjustment.points()[0]) == set(batch.network.points.ids)
    _, places, mine = adjustment.points(batch.network.points.ids)
    if np.any(np.isfinite(places[:, 0]) != batch.determined):
        return np.inf, np.inf
    fixed = batch.network.points.kinds == PointKind.FIXED
    assert not np.any((places - batch.places)[fixed & batch.determined])
    free = ~fixed & batch.determined
    away, largest = np.abs(places - batch.places)[free] / batch.sigmas[free], np.max(batch.sigmas**2, axis=1)
    spread = np.max(np.abs(mine - batch.covariances), axis=(1, 2))[free] / largest[free]
    return float(np.max(away, initial=0.0)), float(np.max(spread, initial=0.0))


def places_of(adjustment: IncrementalAdjustment) -> Places:
    """All points, refreshed."""
    ids, places, spread = adjustment.points()
    return dict(zip(ids, zip(places, np.sqrt(np.diagonal(spread, axis1=1, axis2=2)), strict=True), strict=True))


def state_of(adjustment: IncrementalAdjustment) -> State:
    """All adjusted images."""
    names = [name for name in adjustment.images if not adjustment.store.image(name).held]
    return {name: (adjustment.correction(name).coefficients.ravel(), adjustment.covariance(name)) for name in names}


def largest_difference(one: IncrementalAdjustment, other: tuple[State, Places]) -> float:
    """Largest difference of a value, in its sigmas, from what was noted before; infinite where other things exist."""
    state, places = other
    now, points = state_of(one), places_of(one)
    if set(now) != set(state) or set(points) != set(places):
        return float("inf")
    found = [np.max(np.abs(now[n][0] - state[n][0]) / np.sqrt(np.diag(state[n][1]))) for n in state]
    for name, (place, sigmas) in places.items():
        if np.isfinite(place[0]) != np.isfinite(points[name][0][0]):
            return float("inf")
        if np.isfinite(place[0]):
            found.append(np.max(np.abs(points[name][0] - place) / sigmas))
    return float(max(found, default=0.0))
