"""Which points lie on a terrain model, with what sigma, and which don't: those beside it, and those over its holes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.observations import nominal_ground
from mgsgraph.network.records import ImageRays
from mgsgraph.units import DEG

_STEPS = 3
"""Times that a ray's ground is looked up at the height of the terrain under its last place: some metres are left."""


class Coverage(NamedTuple):
    """How a terrain model covers points."""

    on: int
    """Points whose four posts are there."""
    beside: int
    """Points outside the model."""
    over_holes: int
    """Points within it of whose four posts some are missing."""
    points: Array
    """(2, 2) rad, least and largest longitude and latitude of the points; NaN without any."""
    model: Array
    """(2, 2) rad, the same of the model's posts."""

    @property
    def total(self) -> int:
        """All points that were asked about."""
        return self.on + self.beside + self.over_holes

    @property
    def words(self) -> str:
        """Points that the model doesn't cover, and why; empty where it covers all."""
        parts = []
        if self.beside:
            parts.append(
                f"{self.beside} outside the model (points {in_degrees(self.points)}; model {in_degrees(self.model)})"
            )
        if self.over_holes:
            parts.append(f"{self.over_holes} over missing posts")
        return " and ".join(parts)


def coverage(grid: TerrainGrid, places: Array) -> Coverage:
    """How a terrain model covers places (n, 3) in m, body-fixed; those that are NaN count as outside it."""
    known = np.all(np.isfinite(places), axis=1)
    inside = np.zeros(known.size, dtype=bool)
    inside[known] = grid.holds(places[known])
    on = int(np.count_nonzero(np.isfinite(grid.at(places[inside]))))
    within = int(np.count_nonzero(inside))
    return Coverage(on, known.size - within, within - on, box_of(places[known], float(grid.box[:, 0].mean())), grid.box)


def terrain_ground(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> Array:
    """(k, 3) m, where rays meet the terrain model with the nominal orientation, or the ellipsoid where there is none;
    NaN for those that miss the body.
    """
    heights = np.zeros(rays.point.size)
    places = nominal_ground(images, rays, heights)
    for _ in range(_STEPS):
        above = np.linalg.norm(places, axis=1) - grid.at(places)
        heights -= np.where(np.isfinite(above), above, 0.0)
        places = nominal_ground(images, rays, heights)
    return places


def over_terrain(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> tuple[Index, Array]:
    """Points with rays (p,), and places (p, 3) in m where the first ray of each meets the ground (`terrain_ground`)."""
    points, first = np.unique(rays.point, return_index=True)
    return points, terrain_ground(images, rays.chosen(first), grid)


def box_of(places: Array, middle: float) -> Array:
    """(2, 2) rad, least and largest longitude, in the turn about a middle, and latitude of places (n, 3) in m; NaN
    without any.
    """
    if places.shape[0] == 0:
        return np.full((2, 2), np.nan)
    longitudes, latitudes, _ = planetocentric(places).T
    longitudes = in_turn(longitudes, middle)
    corners = np.stack([longitudes, latitudes], axis=1)
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def in_degrees(box: Array) -> str:
    """A box (2, 2) of longitude and latitude in rad, in words."""
    (west, south), (east, north) = box / DEG
    return f"{west:.3f} .. {east:.3f} E, {south:+.3f} .. {north:+.3f} N"
