"""A plane on which a block is drawn: azimuthal equidistant about its middle, on the sphere through it.

Error ellipses in a plane: what holds a place with a probability of 95 %.
"""

import numpy as np

from mgsgraph.geometry.records import Array


def centre_of(points: Array) -> Array:
    """Middle (3,) in m of points (n, 3): the mean of their directions, at their mean distance from the origin."""
    sound = points[np.all(np.isfinite(points), axis=1)]
    radii = np.linalg.norm(sound, axis=1)
    mean = np.mean(sound / radii[:, None], axis=0)
    return np.asarray(mean / np.linalg.norm(mean) * radii.mean())


def east_north(points: Array, centre: Array) -> Array:
    """East and north (n, 2) in m of points (n, 3) around a centre (3,), azimuthal equidistant on the sphere through it.

    Distances and directions from the centre are true however large the block is (Snyder 1987, p. 191).
    """
    radius = float(np.linalg.norm(centre))
    up = centre / radius
    planar = float(np.hypot(up[0], up[1]))
    east = np.array([-up[1], up[0], 0.0]) / planar if planar > 0.0 else np.array([0.0, 1.0, 0.0])
    flat = points @ np.stack([east, np.cross(up, east)], axis=1)
    length = np.linalg.norm(flat, axis=1)
    angle = np.arctan2(length, points @ up)
    return np.asarray(flat * np.where(length > 0.0, radius * angle / np.where(length > 0.0, length, 1.0), 0.0)[:, None])


def places_at(plane: Array, centre: Array) -> Array:
    """(n, 3) m, body-fixed, on the sphere through a centre (3,), of east and north (n, 2) in m around it: the inverse
    of `east_north`.
    """
    radius = float(np.linalg.norm(centre))
    up = centre / radius
    planar = float(np.hypot(up[0], up[1]))
    east = np.array([-up[1], up[0], 0.0]) / planar if planar > 0.0 else np.array([0.0, 1.0, 0.0])
    length = np.linalg.norm(plane, axis=1)
    angle = length / radius
    flat = plane * np.where(length > 0.0, np.sin(angle) / np.where(length > 0.0, length, 1.0), 0.0)[:, None]
    return np.asarray(radius * (np.cos(angle)[:, None] * up + flat @ np.stack([east, np.cross(up, east)])))


# --- error ellipses

PROBABILITY = 0.95
_SIGMAS = float(np.sqrt(-2.0 * np.log(1.0 - PROBABILITY)))
"""Semi-axes of such an ellipse in sigmas: chi-square of two degrees of freedom is exponentially distributed."""


def error_ellipses(covariances: Array) -> tuple[Array, Array]:
    """Semi-axes (..., 2), the smaller first, and their directions (..., 2, 2), one in each column, of the ellipses that
    hold places of covariances (..., 2, 2) with that probability; in the unit whose square these are in.
    """
    values, axes = np.linalg.eigh(covariances)
    return _SIGMAS * np.sqrt(np.maximum(values, 0.0)), axes
