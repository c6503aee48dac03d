"""Where rays meet a terrain model, for arrays of rays: the first meeting with the bilinear surface of its posts."""

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid

_STEPS = 4000
"""Stations along a ray at the most: one for every half post of its way from the model's highest to its lowest post."""
_CHUNK = 2000
"""Rays taken at a time."""
_REFINEMENTS = 60
_TOLERANCE = 1e-7
"""m of height above the model at which a place is on it."""


def meet_terrain(origins: Array, directions: Array, terrain: TerrainGrid) -> Array:
    """Points (n, 3) in m, body-fixed, at which rays come down to a terrain model for the first time.

    A ray is followed from the height of the model's highest post to that of its lowest one, in steps of half a post,
    and the step in which it falls below the surface is divided until the height there is 1e-7 m (regula falsi, Dowell
    & Jarratt 1971's Illinois form).

    Parameters
    ----------
    origins, directions : (n, 3)
        m, body-fixed; directions of any length.
    terrain : TerrainGrid
        Of radii.

    Returns
    -------
    (n, 3)
        NaN where a ray doesn't come down to the model: it misses the body, or goes by the model's edge or a hole.
    """
    parts = [
        _meet(origins[first : first + _CHUNK], directions[first : first + _CHUNK], terrain)
        for first in range(0, len(origins), _CHUNK)
    ]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _meet(origins: Array, directions: Array, terrain: TerrainGrid) -> Array:
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    low, high = float(np.nanmin(terrain.radii)) - 1.0, float(np.nanmax(terrain.radii)) + 1.0
    begin, end = _to_sphere(origins, unit, high), _to_sphere(origins, unit, low)
    nearest = -np.einsum("ni,ni->n", origins, unit)  # a ray that stays above the lowest post is followed to its middle
    end = np.where(np.isfinite(end), end, nearest)
    begin = np.where(np.linalg.norm(origins, axis=1) < high, 0.0, begin)
    post = min(terrain.latitude_step, terrain.longitude_step) * low
    count = int(np.clip(np.ceil(2.0 * np.nanmax(end - begin, initial=0.0) / post), 2, _STEPS)) + 1
    before, after = np.full(len(unit), np.nan), np.full(len(unit), np.nan)
    last_clear, last_at = np.full(len(unit), np.nan), begin
    for share in np.linspace(0.0, 1.0, count):
        at = begin + share * (end - begin)
        clear = _clearance(origins, unit, at, terrain)
        falls = np.isnan(before) & (last_clear > 0.0) & (clear <= 0.0)
        before, after = np.where(falls, last_at, before), np.where(falls, at, after)
        last_clear, last_at = clear, at
    return _refined(origins, unit, before, after, terrain)


def _refined(origins: Array, unit: Array, before: Array, after: Array, terrain: TerrainGrid) -> Array:
    above, below = (_clearance(origins, unit, at, terrain) for at in (before, after))
    at = after
    for _ in range(_REFINEMENTS):
        with np.errstate(invalid="ignore", divide="ignore"):
            at = np.where(above > below, before + (after - before) * above / (above - below), after)
        clear = _clearance(origins, unit, at, terrain)
        if not np.any(np.abs(clear) > _TOLERANCE):
            break
        over = clear > 0.0
        below, above = np.where(over, 0.5 * below, clear), np.where(over, clear, 0.5 * above)
        before, after = np.where(over, at, before), np.where(over, after, at)
    points: Array = origins + at[:, None] * unit
    return points


def _to_sphere(origins: Array, unit: Array, radius: float) -> Array:
    """Distances (n,) in m along rays to a sphere about the body's centre; NaN where they miss it or look away."""
    along = np.einsum("ni,ni->n", origins, unit)
    root = along**2 - np.einsum("ni,ni->n", origins, origins) + radius**2
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(root)
        return np.where(distance >= 0.0, distance, np.nan)


def _clearance(origins: Array, unit: Array, at: Array, terrain: TerrainGrid) -> Array:
    """Heights (n,) in m of the places on rays above the model; NaN beside it."""
    points = origins + at[:, None] * unit
    clear = np.full(len(points), np.nan)
    known = np.isfinite(at)
    clear[known] = np.linalg.norm(points[known], axis=1) - terrain.at(points[known])
    return clear
