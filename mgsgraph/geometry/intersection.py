"""Several rays to a point: the place nearest to all of them, for arrays of rays (equations: `factors.intersection`).

Where rays meet a terrain model, for arrays of rays: the first meeting with the bilinear surface of its posts.
"""

import numpy as np

from mgsgraph.factors.algebra import dot, scale, subtract
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid


def intersect_rays(origins: Array, directions: Array, point_of_ray: Index, points: int) -> tuple[Array, Array, Array]:
    """Least-squares intersection of the rays of many points at once.

    Parameters
    ----------
    origins, directions : (n, 3)
        m, body-fixed; directions of any length.
    point_of_ray : (n,)
        which point each ray belongs to, in any order.
    points : int
        number of points m.

    Returns
    -------
    places : (m, 3)
        m, body-fixed; NaN where a point has fewer than two rays or all are parallel.
    skew : (m,)
        m, root mean square distance of the point from its rays; NaN where the place is.
    angle : (m,)
        rad between the outermost rays, about (of two rays less than 90 deg apart exactly): twice the arc sine of the
        spread of unit directions; zero where the place is NaN.
    """
    unit = tuple((directions / np.linalg.norm(directions, axis=1, keepdims=True)).T)
    count = np.bincount(point_of_ray, minlength=points)
    reference = np.zeros((points, 3))  # body-fixed numbers would cost six digits
    reference[point_of_ray[::-1]] = origins[::-1]
    shifted = tuple((origins - reference[point_of_ray]).T)
    terms = add_ray((0.0,) * 6, (0.0,) * 3, shifted, unit)
    normal, right = (tuple(np.bincount(point_of_ray, part, points) for part in parts) for parts in terms)
    weakest = least_eigenvalue(normal) / np.maximum(count, 1)
    good = (count >= 2) & (weakest > 1e-14)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.stack(solve_symmetric(normal, right), axis=1) + reference
    places = np.where(good[:, None], found, np.nan)
    offset = subtract(tuple(np.nan_to_num(places - reference)[point_of_ray].T), shifted)
    across = subtract(offset, scale(dot(offset, unit), unit))
    square = np.bincount(point_of_ray, dot(across, across), points)
    skew = np.where(good, np.sqrt(square / np.maximum(count, 1)), np.nan)
    return places, skew, 2.0 * np.arcsin(np.sqrt(np.where(good, np.clip(weakest, 0.0, 1.0), 0.0)))


# --- rays and a terrain model

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
