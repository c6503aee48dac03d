"""Points whose rays are too nearly parallel to say how far away they are."""

import numpy as np

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network
from mgsgraph.ties import PointKind

_TIMES = 5.0
"""Sigmas of the angle between two rays within which they count as parallel: the distance of a point is not known to a
fifth then, and an adjustment follows such a point by small steps (72 in place of 10 of 7,000 images)."""
_MOST = 0.01
"""rad (half a degree), the most that counts as parallel, however little is known of the orientation."""
_NEAREST = 1e3
"""m, from which a camera sees the ground at least."""


def parallel(network: Network, angles: Array) -> Mask:
    """(n,) free points, held by nothing but rays, whose nominal rays are parallel within what is known beforehand.

    `angles` (n,) are those between the outermost nominal rays, in rad. Rays that may as well part as cross put a point
    anywhere between the camera and far below the ground; the equations, linear in the distance, have no meaning there.
    Two nadir images of one ground track are like that.
    """
    rays, found = network.rays, _held_by_rays(network) & (angles < _MOST)
    mine = np.flatnonzero(found[rays.point])
    used, number = np.unique(rays.image[mine], return_inverse=True)
    unsure = np.array([_pointing(network, j) for j in used.tolist()])[number]
    pixel = np.array([network.images[j].pixel_angle for j in used.tolist()])[number]
    sigmas, sigma = rays.sigmas[mine], np.zeros(found.size)
    np.maximum.at(sigma, rays.point[mine], np.hypot(unsure, pixel * np.maximum(sigmas[:, 0], sigmas[:, 1])))
    return np.asarray(found & (angles < _TIMES * np.sqrt(2.0) * sigma))


def nearly_parallel(network: Network, points: Index) -> Mask:
    """(m,) which of some points (m,) nothing but rays hold, the nominal rays of each within `_MOST` of its first: where
    these part, they say no more of the point than that it is far away.
    """
    rays, found = network.rays, _held_by_rays(network)[points]
    order = np.argsort(points)
    mine = np.flatnonzero(np.isin(rays.point, points[found]))
    number, looks = order[np.searchsorted(points, rays.point[mine], sorter=order)], np.empty((mine.size, 3))
    for j in np.unique(rays.image[mine]).tolist():
        own = rays.image[mine] == j
        looks[own] = network.images[j].sightlines(*rays.places[mine[own]].T)[1]
    looks /= np.linalg.norm(looks, axis=1)[:, None]
    first = np.zeros((points.size, 3))
    first[number[::-1]] = looks[::-1]
    apart = np.linalg.norm(looks - first[number], axis=1)
    found[number[apart > _MOST]] = False
    return found


def _held_by_rays(network: Network) -> Mask:
    """(n,) free points with rays alone: two or more, no range, no terrain model."""
    free = (network.points.kinds == PointKind.FREE) & (network.ray_counts >= 2)
    free[network.ranges.point] = False
    if network.surface is not None:
        free &= ~np.isfinite(network.surface.sigmas)
    return np.asarray(free)


def _pointing(network: Network, image: int) -> float:
    """A-priori sigma of the direction in which an image sees a place on the ground, rad, as far as it is known: of
    rotations across the axis, and of the camera's position, seen from the ground.
    """
    strip = int(network.pass_of[image])
    if network.held[image]:
        return 0.0
    sigmas = (network.priors[image].sigmas if strip < 0 else network.passes[strip].sigmas[0][None])[0, :5]
    place, turn = (float(part[np.isfinite(part)].max(initial=0.0)) for part in (sigmas[:3], sigmas[3:]))
    picture = network.images[image]
    camera = picture.pose(np.array([0.5 * picture.lines])).position[0]
    return float(np.hypot(turn, place / max(float(np.linalg.norm(camera)) - picture.body.polar, _NEAREST)))
