"""What an altimeter measures of rough ground: the mean range over its spot, weighted with the energy, and the spread of
the ranges there, which widens the pulse.
"""

import numpy as np

from mgsgraph.geometry.altimeters import MOLA
from mgsgraph.geometry.altimetry import SPOT_WIDTHS
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.ground import SiteTerrain

_NODES = 91
"""Rays of equal energy in a spot: 15 m apart on the ground."""
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""rad between one ray and the next about the beam's axis."""


def ranges_over_spots(terrain: SiteTerrain, origins: Array, beams: Array) -> tuple[Array, Array]:
    """Mean range (n,) in m over MOLA's spot, and standard deviation (n,) of the ranges in it.

    Parameters
    ----------
    terrain : SiteTerrain
        Met by all rays.
    origins, beams : (n, 3)
        m, body-fixed, of the spacecraft, and unit vectors along the axes of the beams. The energy falls off as a
        Gaussian about the axis, whose standard deviation is a quarter of the spot's diameter.
    """
    met = np.linalg.norm(terrain.intersect(origins, beams) - origins, axis=1)
    beside = east_north(-beams)  # any two directions across the beam
    offsets = _nodes() * (MOLA.footprint / SPOT_WIDTHS)
    rays = met[:, None, None] * beams[:, None] + np.einsum("kc,ncj->nkj", offsets, beside)
    starts = np.broadcast_to(origins[:, None], rays.shape).reshape(-1, 3)
    points = terrain.intersect(starts, rays.reshape(-1, 3))
    ranges = np.linalg.norm(points - starts, axis=1).reshape(len(beams), -1)
    return ranges.mean(axis=1), ranges.std(axis=1)


def _nodes() -> Array:
    """(k, 2) places of equal weight in a standard normal distribution: a sunflower's, with its mean and covariance."""
    order = np.arange(_NODES)
    radius = np.sqrt(-2.0 * np.log1p(-(order + 0.5) / _NODES))
    places = radius[:, None] * np.stack([np.cos(_GOLDEN * order), np.sin(_GOLDEN * order)], axis=1)
    places -= places.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(places.T, bias=True)), places.T).T)
