"""Points whose rays are too nearly parallel to say how far away they are."""

import numpy as np

from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import Network
from mgsgraph.ties import PointKind

_TIMES = 3.0
"""Sigmas of the angle between two rays within which they count as parallel."""
_MOST = 0.01
"""rad (half a degree), the most that counts as parallel, however little is known of the orientation."""


def parallel(network: Network, angles: Array) -> Mask:
    """(n,) free points, held by nothing but rays, whose nominal rays are parallel within what is known beforehand.

    `angles` (n,) are those between the outermost nominal rays, in rad. Rays that may as well part as cross put a point
    anywhere between the camera and far below the ground; the equations, linear in the distance, have no meaning there.
    Two nadir images of one ground track are like that.
    """
    rays = network.rays
    free = (network.points.kinds == PointKind.FREE) & (network.ray_counts >= 2)
    free[network.ranges.point] = False
    if network.surface is not None:
        free &= ~np.isfinite(network.surface.sigmas)
    unsure = np.array([_pointing(network, j) for j in range(len(network.images))])[rays.image]
    pixel = np.array([image.pixel_angle for image in network.images])[rays.image]
    sigma = np.zeros(free.size)
    np.maximum.at(sigma, rays.point, np.hypot(unsure, pixel * np.maximum(rays.sigmas[:, 0], rays.sigmas[:, 1])))
    return np.asarray(free & (angles < np.minimum(_TIMES * np.sqrt(2.0) * sigma, _MOST)))


def _pointing(network: Network, image: int) -> float:
    """A-priori sigma of the direction of an image's rays, rad, as far as it is known: rotations across the axis."""
    strip = int(network.pass_of[image])
    if network.held[image]:
        return 0.0
    sigmas = (network.priors[image].sigmas if strip < 0 else network.passes[strip].sigmas[0][None])[0, 3:5]
    known = sigmas[np.isfinite(sigmas)]
    return float(known.max(initial=0.0))
