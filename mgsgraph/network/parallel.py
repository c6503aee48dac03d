"""Points whose rays are nearly parallel: their distance is undetermined."""

import numpy as np

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index, Mask, by_value
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.network.network import Network

_TIMES = 3.0
"""Sigmas of the angle between two rays within which they count as parallel."""
_MOST = 0.01
"""rad (half a degree), the most that counts as parallel, however little is known of the orientation."""


def parallel(network: Network, angles: Array) -> Mask:
    """(n,) free points, held by nothing but rays, whose nominal rays are parallel within their a-priori sigmas.

    `angles` (n,) are those between the outermost nominal rays, in rad. Rays that may as well part as cross put a point
    anywhere between the camera and far below the ground; the equations, linear in the distance, have no meaning there.
    Two nadir images of one ground track are like that.
    """
    rays, suspect = network.rays, _held_by_rays(network) & (angles < _MOST)
    rows = np.flatnonzero(suspect[rays.point])
    if rows.size == 0:
        return suspect
    unsure = np.array([_pointing(network, j) for j in range(len(network.images))])[rays.image[rows]]
    pixel = np.array([image.pixel_angle for image in network.images])[rays.image[rows]]
    sigma = np.zeros(suspect.size)
    np.maximum.at(sigma, rays.point[rows], np.hypot(unsure, pixel * network.ray_sigmas[rows].max(axis=1)))
    return np.asarray(suspect & (angles < _TIMES * np.sqrt(2.0) * sigma))


def nearly_parallel(network: Network, points: Index) -> Mask:
    """(m,) which of some points (m,) nothing but rays hold, the nominal rays of each within `_MOST` of its first: where
    these part, they say no more of the point than that it is far away. `parallel` knows of directions alone, not of how
    well the cameras' positions are known.
    """
    rays, held = network.rays, _held_by_rays(network)[points]
    order = np.argsort(points)
    rows = np.flatnonzero(np.isin(rays.point, points[held]))
    number, looks = order[np.searchsorted(points, rays.point[rows], sorter=order)], np.empty((rows.size, 3))
    for j, of_image in by_value(rays.image[rows]):
        looks[of_image] = network.images[j].sightlines(*rays.places[rows[of_image]].T)[1]
    looks, first = unit_vectors(looks), np.zeros((points.size, 3))
    first[number[::-1]] = looks[::-1]
    distances = np.linalg.norm(looks - first[number], axis=1)
    held[number[distances > _MOST]] = False
    return held


def _held_by_rays(network: Network) -> Mask:
    """(n,) free points with rays alone: two or more, no range, no terrain model."""
    free = (network.points.kinds == PointKind.FREE) & (network.ray_counts >= 2)
    free[network.ranges.point] = False
    if network.surface is not None:
        free &= ~np.isfinite(network.surface.sigmas)
    return np.asarray(free)


def _pointing(network: Network, image: int) -> float:
    """A-priori sigma of the direction of an image's rays, rad, as far as it is known: rotations across the axis."""
    number = int(network.pass_of[image])
    if network.held[image]:
        return 0.0
    sigmas = (network.priors[image].sigmas if number < 0 else network.passes[number].sigmas[0][None])[0, 3:5]
    finite = sigmas[np.isfinite(sigmas)]
    return float(finite.max(initial=0.0))
