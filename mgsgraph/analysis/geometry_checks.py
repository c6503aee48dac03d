"""Common sense of the geometry: do heights agree with their neighbors', and shots with where the camera looks?

A tie of two different places meets somewhere, far above or below the ground, and least squares moves it there without a
residual. A laser and a camera of one spacecraft look nearly the same way along the flight: a clock that is wrong by
seconds, or a profile of another orbit, does not.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import Ellipsoid, distances, nearness
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.records import Array, Index, by_value, finite_rows, no_rows, place_of
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.network import Network

_NEIGHBORS = 8
"""Nearest points that a height is compared with."""
_FAR = 6.0
"""Standard deviations, of the heights and of the scatter of its neighbors, beyond which a height deviates."""
_STEEP = 1.5
"""Height difference over distance beyond which it does: no ground is so steep over the distance of several points."""
_NORMAL = 1.4826
"""Standard deviation of a normal variable over its median deviation."""
_MOST = 20_000
"""Points that are compared with their neighbors, and among which these are looked for."""
_APART = 0.05
"""rad along the flight between a footprint and the camera's line of sight at its time: mountings differ by less."""


class DeviatingHeights(NamedTuple):
    """Points far above or below their neighbors."""

    points: Index
    """(k,) of the network, the farthest first."""
    deviations: Array
    """(k,) m, height minus the median of the neighbors' heights."""


def deviating_heights(network: Network, places: Array, covariances: Array) -> DeviatingHeights:
    """Points whose heights no error within their sigmas and no slope explains, beside their nearest ones of a class.

    Parameters
    ----------
    network : Network
    places : (n, 3) array
        m, adjusted, or where nominal rays meet; NaN for points without a place.
    covariances : (n, 3, 3) array
        m^2.
    """
    by_class = [DeviatingHeights(no_rows(), np.zeros(0))]
    for _, members in network.of_class():
        located = members[finite_rows(places[members]) & (network.points.kinds[members] != PointKind.FIXED)]
        # in a frame that is not body-fixed nothing is known of heights
        if located.size > _NEIGHBORS and _near(float(np.median(distances(places[located]))), network.body):
            points, deviations = _deviating(places[located], covariances[located])
            by_class.append(DeviatingHeights(located[points], deviations))
    points, deviations = (np.concatenate(part) for part in zip(*by_class, strict=True))
    order = np.argsort(-np.abs(deviations), kind="stable")
    return DeviatingHeights(points[order], deviations[order])


def _deviating(places: Array, covariances: Array) -> tuple[Index, Array]:
    """Which of some places (n, 3) with covariances (n, 3, 3) deviate, and by how much (k,)."""
    from scipy.spatial import cKDTree  # slow to import

    heights, up = distances(places), unit_vectors(places)
    flat, sample = up * np.median(heights), np.arange(heights.size)
    chosen = _candidates(flat, heights)
    if sample.size > _MOST:
        sample = np.sort(np.random.default_rng(0).choice(sample.size, _MOST, replace=False))
    away, near = cKDTree(flat[sample]).query(flat[chosen], k=_NEIGHBORS + 1)
    near = sample[near]
    looked_at = np.union1d(chosen, sample)
    sigmas, to = np.zeros(heights.size), up[looked_at]
    sigmas[looked_at] = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", to, covariances[looked_at], to), 0.0))
    itself = near == chosen[:, None]  # else the farthest one is left out
    itself[~itself.any(axis=1), -1] = True
    near, away = (part[~itself].reshape(chosen.size, _NEIGHBORS) for part in (near, away))
    middle = np.median(heights[near], axis=1)
    scatter = _NORMAL * np.median(np.abs(heights[near] - middle[:, None]), axis=1)
    spread = np.sqrt(scatter**2 + sigmas[chosen] ** 2 + np.median(sigmas[near], axis=1) ** 2)
    off = heights[chosen] - middle
    wild = (np.abs(off) > _FAR * spread) & (np.abs(off) > _STEEP * np.median(away, axis=1))
    return chosen[wild], off[wild]


def _near(radius: float, body: Ellipsoid) -> bool:
    """Whether places of a radius in m lie on a body."""
    return body.polar / nearness(body) < radius < body.equatorial * nearness(body)


def _candidates(flat: Array, heights: Array) -> Index:
    """Points (k,) of all (n, 3) that are looked at: of very many those farthest from the median of their cell."""
    if heights.size <= _MOST:
        return np.arange(heights.size)
    edge = np.ptp(flat, axis=0).max() * np.sqrt(100.0 / heights.size)
    cells = np.floor((flat - flat.min(axis=0)) / edge)
    cell = cells @ np.cumprod([1.0, cells[:, 0].max() + 1.0, cells[:, 1].max() + 1.0])
    order = np.argsort(cell + 0.5 * (heights - heights.min()) / (np.ptp(heights) + 1.0))  # within a cell by height
    first = np.flatnonzero(np.diff(cell[order], prepend=-1.0))
    count = np.diff(np.append(first, order.size))
    off = np.abs(heights[order] - np.repeat(heights[order[first + count // 2]], count))  # from the cell's median
    return np.sort(order[np.argpartition(-off, _MOST)[:_MOST]])


def convergence(network: Network, points: Index) -> Array:
    """(k,) rad, angles between the outermost rays of those of some points (m,) that two nominal rays see or more."""
    place = place_of(points, len(network.points))
    chosen = np.flatnonzero(place[network.rays.point] >= 0)
    rays = network.rays.chosen(chosen)
    origins, directions = np.empty((chosen.size, 3)), np.empty((chosen.size, 3))
    for j, of_image in by_value(rays.image):
        origins[of_image], directions[of_image] = network.images[j].sightlines(*rays.places[of_image].T)
    _, _, angles = intersect_rays(origins, directions, place[rays.point], points.size)
    return np.asarray(angles[network.ray_counts[points] >= 2])


class MisplacedProfile(NamedTuple):
    """Laser shots that lie elsewhere than where their image's camera looked at their times."""

    name: str
    """Of the image with their ranges."""
    angle: float
    """rad along the flight, median."""
    shots: int
    """How many."""


def misplaced_profiles(network: Network) -> list[MisplacedProfile]:
    """Images whose laser shots lie far before or behind their lines of sight, along the flight, at the shots' times."""
    ranges, misplaced = network.ranges, list[MisplacedProfile]()
    for j, of_image in by_value(ranges.image):
        image, shots = network.images[j], of_image[network.points.kinds[ranges.point[of_image]] != PointKind.FREE]
        if not shots.size:
            continue
        pose = image.trajectory.pose(ranges.times[shots] - image.trajectory.epoch)
        toward_shots = unit_vectors(network.points.places[ranges.point[shots]] - pose.position)
        line, sample = image.middle
        looks = unit_vectors(image.sightlines(line, sample)[1]) @ image.pose(line).matrix[0].T  # in the camera's axes
        looks = np.einsum("c,nck->nk", looks[0], pose.matrix)
        level = unit_vectors(np.cross(pose.position, np.cross(pose.velocity, pose.position)))
        angle = float(np.median(np.einsum("nk,nk->n", toward_shots - looks, level)))
        if abs(angle) > _APART:
            misplaced.append(MisplacedProfile(image.name, angle, shots.size))
    return misplaced
