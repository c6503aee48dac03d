"""Footprints, regions and tie points of an archive of images."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mgsgraph.geometry.body import surface_radii
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.simulation.archive import Archive
from mgsgraph.simulation.observations import MARGIN, Shots, well_inside
from mgsgraph.simulation.sites import SHIFT_SIGMA
from mgsgraph.workers import Count, no_progress

_REGION = 20_000
"""Points of a region, about."""
_DRAWN = 4
"""Places drawn for each point that is wanted."""
_REACH = 1.15
"""Half diagonals of the largest image about a middle in which ground is looked for: images lie off a little."""
_TICK, _ROUNDS = 0.1, 6
"""s between laser shots, and steps to where a line of sight meets the ground."""
_CACHED = 1 << 13
"""Images kept in memory; those of a region are used several times."""
_WAVES = np.array([[1.0, 61e3, 0.0], [0.5, 23e3, 1.3], [0.2, 9e3, 2.9]])
"""Of each wave of the ground: share of the amplitude, wavelength (m), phase (rad)."""
_DIRECTIONS = np.array([[0.48, 0.60, 0.64], [-0.64, 0.60, 0.48], [0.60, -0.64, 0.48]])
"""(3, 3) unit rows along which they run, body-fixed."""


class Footprints(NamedTuple):
    """The ground of n images as parallelograms, nominal, on the ellipsoid."""

    middles: Array
    """(n, 3) m, body-fixed."""
    halves: Array
    """(n, 2, 3) m, from the middle to the last line's and to the last sample's middle."""

    def directions(self, image: Index, along: Array, across: Array) -> Array:
        """Unit vectors (k, 3) to places in images (k,), -1 to 1 along and across each."""
        places = self.middles[image] + along[:, None] * self.halves[image, 0] + across[:, None] * self.halves[image, 1]
        return unit_vectors(places)

    def coordinates(self, image: Index, directions: Array) -> Array:
        """Places (k, 2) along and across images (k,), within -1 to 1 inside, of directions (k, 3) to the ground."""
        middle = self.middles[image]
        radius = np.linalg.norm(middle, axis=1)
        depth = np.einsum("ki,ki->k", directions, middle) / radius
        off = directions * (radius / depth)[:, None] - middle
        first, second = self.halves[image, 0], self.halves[image, 1]
        a, b, c = (np.einsum("ki,ki->k", *pair) for pair in ((first, first), (first, second), (second, second)))
        e, f = np.einsum("ki,ki->k", off, first), np.einsum("ki,ki->k", off, second)
        return np.asarray(np.column_stack([c * e - b * f, a * f - b * e]) / (a * c - b * b)[:, None])


def footprint(image: PushbroomImage) -> tuple[Array, Array]:
    """Middle (3,) and halves (2, 3) of an image, as `Footprints` has them."""
    lines, samples = np.array([0.5, 0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.5, 0.0, 1.0])
    points, _ = image.image_to_ground(lines * image.lines, samples * image.samples)
    middle, first, last, left, right = points
    return middle, 0.5 * np.stack([last - first, right - left])


class _Nearby:
    """Which images may show the ground in a direction: all whose middles are within half a diagonal, and some more."""

    def __init__(self, footprints: Footprints) -> None:
        radius = np.linalg.norm(footprints.middles, axis=1, keepdims=True)
        self._middles = cKDTree(footprints.middles / radius)
        self._reach = _REACH * float((np.linalg.norm(footprints.halves, axis=(1, 2)) / radius[:, 0]).max())

    def candidates(self, directions: Array) -> tuple[Index, Index]:
        """Points (c,) and images (c,) that may show them, by points."""
        near = cKDTree(directions).sparse_distance_matrix(self._middles, self._reach, output_type="ndarray")
        return near["i"], near["j"]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Tie points of a region with all their measures."""

    points: Array
    """(n, 3) m, body-fixed, true."""
    counts: Index
    """(n,) number of measures of each, 2 or more."""
    images: Index
    """(k,) image of each measure, by points."""
    measures: Array
    """(k, 2) line and sample, with noise."""


def regions(archive: Archive, footprints: Footprints, progress: Count = no_progress) -> Iterator[Region]:
    """All tie points of an archive, region by region.

    Parameters
    ----------
    archive : Archive
    footprints : Footprints
        Of its images.
    progress : Count
        Called with how many images are done.
    """
    nearby = _Nearby(footprints)
    order = _by_place(footprints)
    per_image = archive.settings.ties / len(archive)
    many = max(int(_REGION / per_image), 1)
    image_of = lru_cache(maxsize=_CACHED)(archive.image)
    streams = np.random.default_rng([archive.seed, 1]).spawn(-(-len(archive) // many))
    drawn_so_far = 0
    for k, rng in enumerate(streams):
        owners = order[k * many : (k + 1) * many]
        upto = round(per_image * (k * many + owners.size))
        quota: Index = np.diff(np.linspace(drawn_so_far, upto, owners.size + 1).astype(np.int64)).astype(np.int64)
        drawn_so_far = upto
        directions = _drawn(archive, footprints, nearby, owners, quota, rng)
        yield _projected(archive, footprints, nearby, image_of, directions, rng)
        progress(k * many + owners.size, len(archive))


def _drawn(
    archive: Archive, footprints: Footprints, nearby: _Nearby, owners: Index, quota: Index, rng: np.random.Generator
) -> Array:
    """(n, 3) directions to places at random in some images, which another image shows as well; of each image as many
    as wanted, `quota` (images,), where it has so much ground in common.
    """
    owner = np.repeat(np.arange(owners.size), _DRAWN * quota + 8)
    along, across = rng.uniform(-0.99, 0.99, (2, owner.size))
    directions = footprints.directions(owners[owner], along, across)
    point, image = nearby.candidates(directions)
    slack = _shares(archive, footprints, image)
    inside = np.all(np.abs(footprints.coordinates(image, directions[point])) < 1.0 - slack, axis=1)
    good = np.bincount(point[inside], minlength=owner.size) > 1
    rank: Index = np.cumsum(good) - good
    begun = np.concatenate([[0], np.cumsum(_DRAWN * quota + 8)[:-1]])
    return np.asarray(directions[good & (rank - rank[begun][owner] < quota[owner])])


def _shares(archive: Archive, footprints: Footprints, image: Index) -> Array:
    """(k, 2) shares of the half length and width of images (k,) by which the ground may lie elsewhere than thought."""
    noise, plan = archive.settings.noise, archive.settings.plan
    moved = 2.0 * (noise.position + noise.angle * plan.camera.altitude) + 0.3 * plan.relief
    return np.asarray(moved / np.linalg.norm(footprints.halves[image], axis=2))


def _projected(
    archive: Archive, footprints: Footprints, nearby: _Nearby, image_of: Callable[[int], PushbroomImage],
    directions: Array, rng: np.random.Generator,
) -> Region:  # fmt: skip
    """The points in these directions (n, 3) that two or more images truly show, with measures."""
    points = on_waves(archive, directions)
    point, image = nearby.candidates(directions)
    places = footprints.coordinates(image, directions[point])
    near = np.flatnonzero(np.all(np.abs(places) < 1.0 + _shares(archive, footprints, image), axis=1))
    near = near[np.argsort(image[near], kind="stable")]
    point, image = point[near], image[near]
    pixels = np.full((near.size, 2), np.nan)
    bounds = np.flatnonzero(np.diff(image, prepend=-1, append=-1))
    for first, last in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        j = int(image[first])
        picture = image_of(j)
        shown_at, _ = picture.ground_to_image(points[point[first:last]], archive.true(j))
        shown_at[~well_inside(picture, shown_at)] = np.nan
        pixels[first:last] = shown_at
    visible = np.isfinite(pixels[:, 0])
    counts = np.bincount(point[visible], minlength=len(points))
    chosen = np.flatnonzero(visible & (counts[point] > 1))
    chosen = chosen[np.lexsort([image[chosen], point[chosen]])]
    exact = pixels[chosen]
    return Region(
        points[counts > 1], counts[counts > 1], image[chosen],
        exact + archive.settings.noise.tie * rng.standard_normal(exact.shape),
    )  # fmt: skip


def shots_along(archive: Archive, j: int) -> Shots:
    """Laser shots along the optical axis of image `j`, with noise and the profile's common horizontal error."""
    image, true, rng = archive.image(j), archive.true(j), np.random.default_rng([archive.seed, 2, j])
    elapsed, _ = image.timing.at(np.array([MARGIN, image.lines - MARGIN]))
    times = image.trajectory.epoch + np.arange(elapsed[0], elapsed[1], _TICK)
    lines, height = image.timing.lines(times - image.trajectory.epoch), np.zeros(times.size)
    for _ in range(_ROUNDS):
        points, _ = image.image_to_ground(lines, np.full(times.size, 0.5 * image.samples), height, true)
        height += np.linalg.norm(on_waves(archive, unit_vectors(points)), axis=1) - np.linalg.norm(points, axis=1)
    ranges = np.linalg.norm(points - image.pose(lines, true).position, axis=1)
    error, up = SHIFT_SIGMA * rng.standard_normal(3), unit_vectors(points.mean(axis=0)[None])[0]
    return Shots(times, points + error - (error @ up) * up, ranges).noisy(archive.settings.noise, rng)


def on_waves(archive: Archive, directions: Array) -> Array:
    """(n, 3) m, body-fixed, the true ground in directions (n, 3)."""
    radii = surface_radii(directions, archive.settings.plan.camera.body.ellipsoid)
    on_surface = radii[:, None] * directions
    share, length, phase = _WAVES.T
    heights = np.sin(2.0 * np.pi * (on_surface @ _DIRECTIONS.T) / length + phase) @ share
    return np.asarray((radii + archive.settings.plan.relief * heights)[:, None] * directions)


def _by_place(footprints: Footprints) -> Index:
    """Images (n,) in such an order that those which follow each other are neighbours: in bands of latitude."""
    latitude = np.arcsin(footprints.middles[:, 2] / np.linalg.norm(footprints.middles, axis=1))
    longitude = np.arctan2(footprints.middles[:, 1], footprints.middles[:, 0])
    height = 2.0 * np.linalg.norm(footprints.halves[:, 0], axis=1).max() / np.linalg.norm(footprints.middles[0])
    band = np.floor(latitude / height).astype(np.int64)
    return np.lexsort([np.where(band % 2 == 0, longitude, -longitude), band])
