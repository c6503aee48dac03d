"""Several rays to a point: the place nearest to all of them, for arrays of rays (equations: `factors.intersection`).

Where rays meet a terrain model, for arrays of rays: the first meeting with the bilinear surface of its posts.

Crossovers of laser profiles: where two tracks cross, and what each says of the ground's height and slope there.

At a crossing both profiles show the same ground. Each has its height between the two shots around it, and the slope
of the ground along its track; both slopes together are the ground's gradient G. When the first of the profiles is
shifted by a horizontal vector d against the second, the crossing moves along both tracks, and the difference of their
heights changes by -G d.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.factors.algebra import dot, scale, subtract, transform
from mgsgraph.factors.collinearity import image_motion, ray_motion
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid


def image_steps(image: PushbroomImage, lines: Array, samples: Array, axes: Array | None = None) -> Array:
    """(n, 2, 2) m in the focal plane by which the ground's image moves from a line to the next, and from a sample to
    the one before, where an image shows the ellipsoid, or comes closest to it; in the `axes` of its pass.
    """
    ground = image.image_to_ground(lines, samples)[0]
    origins, looks = image.sightlines(lines, samples)
    closest = origins - looks * np.einsum("nc,nc->n", origins, looks)[:, None]
    ground = np.where(np.isfinite(ground), ground, closest)
    pose, focal = image.pose(lines).in_axes(axes), image.interior.focal_length
    attitude = rotation.rows(pose.matrix)
    ray = transform(attitude, rotation.components(ground - pose.position))
    moved = ray_motion(attitude, ray, rotation.components(pose.velocity), rotation.components(pose.angular_rate))
    slope = Detector(*image.interior.focal_plane(samples)).in_axes(axes, focal).slope
    return np.stack([rotation.stacked(image_motion(ray, moved, focal)), -slope], axis=2)


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
    unit = tuple(unit_vectors(directions).T)
    count = np.bincount(point_of_ray, minlength=points)
    reference = np.zeros((points, 3))  # body-fixed numbers would cost six digits
    reference[point_of_ray[::-1]] = origins[::-1]
    shifted = tuple((origins - reference[point_of_ray]).T)
    terms = add_ray((0.0,) * 6, (0.0,) * 3, shifted, unit)
    normal, right = (tuple(np.bincount(point_of_ray, part, points) for part in parts) for parts in terms)
    weakest = least_eigenvalue(normal, 6) / np.maximum(count, 1)
    good = (count >= 2) & (weakest > 1e-14)
    with np.errstate(divide="ignore", invalid="ignore"):
        solution = np.stack(solve_symmetric(normal, right), axis=1) + reference
    places = np.where(good[:, None], solution, np.nan)
    offset = subtract(tuple(np.nan_to_num(places - reference)[point_of_ray].T), shifted)
    across = subtract(offset, scale(dot(offset, unit), unit))
    square = np.bincount(point_of_ray, dot(across, across), points)
    skew = np.where(good, np.sqrt(square / np.maximum(count, 1)), np.nan)
    return places, skew, 2.0 * np.arcsin(np.sqrt(np.where(good, np.clip(weakest, 0.0, 1.0), 0.0)))


# --- rays and a terrain model

_RAYS = 2000
"""Rays taken at a time."""
_STEPS = 4000
"""Stations along a ray at the most: one for every half post of its way from the model's highest to its lowest post."""
_REFINEMENTS = 60
_TOLERANCE = 1e-7
"""m of height above the model at which a place is on it."""


def meet_terrain(origins: Array, directions: Array, terrain: TerrainGrid) -> Array:
    """Points (n, 3) in m, body-fixed, at which rays come down to a terrain model for the first time.

    A ray is followed from the height of the model's highest post to that of its lowest one, in steps of half a post,
    and the step in which it falls below the surface is halved until the height there is 1e-7 m.

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
        _meet(origins[first : first + _RAYS], directions[first : first + _RAYS], terrain)
        for first in range(0, len(origins), _RAYS)
    ]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _meet(origins: Array, directions: Array, terrain: TerrainGrid) -> Array:
    unit = unit_vectors(directions)
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
    at = after
    for _ in range(_REFINEMENTS):
        at = 0.5 * (before + after)
        clear = _clearance(origins, unit, at, terrain)
        if not np.any(np.abs(clear) > _TOLERANCE):
            break
        before, after = np.where(clear > 0.0, at, before), np.where(clear > 0.0, after, at)
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
    finite = np.isfinite(at)
    clear[finite] = np.linalg.norm(points[finite], axis=1) - terrain.at(points[finite])
    return clear


LEAST_ANGLE = 0.1
"""rad, between tracks: what crosses at less has no certain place, and gives no certain gradient."""
_LEAST = 8
"""Shots of a profile, to know how rough the ground is."""
_NEAR = 20
"""Shots about a crossing through which a straight track is laid."""
_ROUNDS = 10
"""Of the search for a crossing, at most."""
_STILL = 0.01
"""m, by which a crossing moves no more."""
_SLOPE = 150.0
"""m along a track on either side of a crossing, over which the slope is taken; between two shots at least."""
_GAP = 3.0
"""Usual gaps between shots: a crossing in a wider one is none."""
_OWN = 1.5
"""Variance of a shot minus the mean of two others, in variances of one."""
_ROUGH = 40
"""Shots about a crossing that say how rough the ground is."""


class TrackHeight(NamedTuple):
    """Height of a profile at a crossing."""

    shots: Index
    """(2,) before and after it."""
    shares: Array
    """(2,) of their heights, which add up to one."""
    along: Array
    """(2,) unit vector along the track, east and north."""
    slope: float
    """m per m, along it."""
    sigma: float
    """m, of the height between the shots: what interpolation misses of rough ground, and noise of the shots."""


def crossing(first: Array, second: Array, sigmas: tuple[float, float]) -> tuple[TrackHeight, TrackHeight] | None:
    """Where two profiles cross.

    Parameters
    ----------
    first, second : (n, 3), (k, 3)
        m, body-fixed, shots of each in any order, of one beam or of several.
    sigmas : (float, float)
        m, of the shots' heights.

    Returns
    -------
    tuple or None
        What each says there; None where they don't cross, or at less than `LEAST_ANGLE`, or in a gap.
    """
    if min(len(first), len(second)) < _LEAST:
        return None
    centre = first.mean(axis=0) + second.mean(axis=0)
    ways, centre = east_north(centre[None])[0], centre / np.linalg.norm(centre)
    tracks = [_plane(points, ways, centre) for points in (first, second)]
    at = _meeting([_line(track) for track in tracks])
    for _ in range(_ROUNDS):
        if at is None:
            return None
        before, near = at, [_nearest(track, at, _NEAR) for track in tracks]
        at = _meeting([_line(track[members]) for track, members in zip(tracks, near, strict=True)])
        if at is not None and np.linalg.norm(at - before) < _STILL:
            break
    else:
        return None
    heights = [
        _height(track, np.linalg.norm(points, axis=1), at, sigma)
        for track, points, sigma in zip(tracks, (first, second), sigmas, strict=True)
    ]
    return None if heights[0] is None or heights[1] is None else (heights[0], heights[1])


def gradient(tracks: tuple[TrackHeight, TrackHeight]) -> Array:
    """(2,) m per m east and north, of the ground whose slopes along two tracks are known."""
    return np.asarray(np.linalg.solve([track.along for track in tracks], [track.slope for track in tracks]))


def _plane(points: Array, ways: Array, centre: Array) -> Array:
    """(n, 2) m, eastward and northward in the plane at a direction, where great circles are straight."""
    return np.asarray(points @ ways.T * (np.linalg.norm(points, axis=1).mean() / (points @ centre))[:, None])


def _line(track: Array) -> tuple[Array, Array]:
    """Middle (2,) and unit vector (2,) of the straight line through places (n, 2)."""
    middle = track.mean(axis=0)
    return middle, np.linalg.svd(track - middle, full_matrices=False)[2][0]


def _meeting(lines: list[tuple[Array, Array]]) -> Array | None:
    """(2,) where two lines meet; None where they are nearly parallel."""
    (start, first), (other, second) = lines
    across = first[0] * second[1] - first[1] * second[0]
    if abs(across) < np.sin(LEAST_ANGLE):
        return None
    offset = other - start
    return np.asarray(start + first * ((offset[0] * second[1] - offset[1] * second[0]) / across))


def _nearest(track: Array, at: Array, count: int) -> Index:
    """The `count` of places (n, 2) that lie nearest."""
    distance = np.linalg.norm(track - at, axis=1)
    return np.argpartition(distance, min(count, distance.size) - 1)[:count]


def _height(track: Array, radii: Array, at: Array, sigma: float) -> TrackHeight | None:
    """Height of a profile at a place (2,) on its track."""
    nearby = _nearest(track, at, _ROUGH)
    along = _line(track[_nearest(track, at, _NEAR)])[1]
    place = (track[nearby] - at) @ along
    nearby, place = nearby[np.argsort(place)], np.sort(place)
    after = int(np.searchsorted(place, 0.0))
    if after in (0, place.size):
        return None
    gaps = np.linalg.norm(np.diff(track[nearby], axis=0), axis=1)
    gap = float(gaps[after - 1])
    if gap > _GAP * np.median(gaps):
        return None
    share = float(-place[after - 1] / max(place[after] - place[after - 1], 1e-9))
    shares, heights = np.array([1.0 - share, share]), radii[nearby]
    about = np.abs(place) <= _SLOPE
    about[after - 1 : after + 1] = True
    slope = float(np.polyfit(place[about], heights[about], 1)[0])
    rough = _missed(place, heights, sigma) * gap / float(np.median(gaps)) * 2.0 * np.sqrt(share * (1.0 - share))
    sigma = float(np.hypot(rough, sigma * np.linalg.norm(shares)))
    return TrackHeight(nearby[after - 1 : after + 1], shares, along, slope, sigma)


def _missed(place: Array, heights: Array, sigma: float) -> float:
    """m, rms error of a straight line between two shots in the middle: of shots one and two away on either side,
    where there is one in the middle, and as it falls from two to one, from one to a half; without the shots' own
    noise, which is `sigma` for each.
    """
    squares = [
        np.mean(
            (heights[lag:-lag]
            - heights[: -2 * lag]
            - (heights[2 * lag :] - heights[: -2 * lag])
            * ((place[lag:-lag] - place[: -2 * lag]) / np.maximum(place[2 * lag :] - place[: -2 * lag], 1e-9)))
            ** 2
        )
        for lag in (1, 2)
    ]
    single, double = (max(float(square) - _OWN * sigma**2, 0.0) for square in squares)
    return float(np.sqrt(single * min(single / max(double, 1e-9), 1.0)))
