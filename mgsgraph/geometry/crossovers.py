"""Crossovers of laser profiles: where two tracks cross, and what each says of the ground's height and slope there.

At a crossing both profiles show the same ground. Each has its height between the two shots around it, and the slope
of the ground along its track; both slopes together are the ground's gradient G. When the first of the profiles is
shifted by a horizontal vector d against the second, the crossing moves along both tracks, and the difference of their
heights changes by -G d.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index

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
    """What a profile says at a crossing."""

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
        at = _meeting([_line(track[mine]) for track, mine in zip(tracks, near, strict=True)])
        if at is not None and np.linalg.norm(at - before) < _STILL:
            break
    else:
        return None
    found = [
        _height(track, np.linalg.norm(points, axis=1), at, sigma)
        for track, points, sigma in zip(tracks, (first, second), sigmas, strict=True)
    ]
    return None if found[0] is None or found[1] is None else (found[0], found[1])


def gradient(tracks: tuple[TrackHeight, TrackHeight]) -> Array:
    """(2,) m per m east and north, of the ground whose slopes along two tracks are known."""
    return np.asarray(np.linalg.solve([one.along for one in tracks], [one.slope for one in tracks]))


def _plane(points: Array, ways: Array, centre: Array) -> Array:
    """(n, 2) m, eastward and northward in the plane at a direction, where great circles are straight."""
    return np.asarray(points @ ways.T * (np.linalg.norm(points, axis=1).mean() / (points @ centre))[:, None])


def _line(track: Array) -> tuple[Array, Array]:
    """Middle (2,) and unit vector (2,) of the straight line through places (n, 2)."""
    middle = track.mean(axis=0)
    return middle, np.linalg.svd(track - middle, full_matrices=False)[2][0]


def _meeting(lines: list[tuple[Array, Array]]) -> Array | None:
    """(2,) where two lines meet; None where they are nearly parallel."""
    (start, one), (other, two) = lines
    across = one[0] * two[1] - one[1] * two[0]
    if abs(across) < np.sin(LEAST_ANGLE):
        return None
    apart = other - start
    return np.asarray(start + one * ((apart[0] * two[1] - apart[1] * two[0]) / across))


def _nearest(track: Array, at: Array, count: int) -> Index:
    """The `count` of places (n, 2) that lie nearest."""
    distance = np.linalg.norm(track - at, axis=1)
    return np.argpartition(distance, min(count, distance.size) - 1)[:count]


def _height(track: Array, radii: Array, at: Array, sigma: float) -> TrackHeight | None:
    """Height of a profile at a place (2,) on its track."""
    mine = _nearest(track, at, _ROUGH)
    along = _line(track[_nearest(track, at, _NEAR)])[1]
    place = (track[mine] - at) @ along
    mine, place = mine[np.argsort(place)], np.sort(place)
    after = int(np.searchsorted(place, 0.0))
    if after in (0, place.size):
        return None
    gaps = np.linalg.norm(np.diff(track[mine], axis=0), axis=1)
    gap = float(gaps[after - 1])
    if gap > _GAP * np.median(gaps):
        return None
    share = float(-place[after - 1] / max(place[after] - place[after - 1], 1e-9))
    shares, heights = np.array([1.0 - share, share]), radii[mine]
    about = np.abs(place) <= _SLOPE
    about[after - 1 : after + 1] = True
    slope = float(np.polyfit(place[about], heights[about], 1)[0])
    rough = _missed(place, heights, sigma) * gap / float(np.median(gaps)) * 2.0 * np.sqrt(share * (1.0 - share))
    sigma = float(np.hypot(rough, sigma * np.linalg.norm(shares)))
    return TrackHeight(mine[after - 1 : after + 1], shares, along, slope, sigma)


def _missed(place: Array, heights: Array, sigma: float) -> float:
    """m, rms of what a straight line between two shots misses in the middle: of shots one and two away on either side,
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
    one, two = (max(float(square) - _OWN * sigma**2, 0.0) for square in squares)
    return float(np.sqrt(one * min(one / max(two, 1e-9), 1.0)))
