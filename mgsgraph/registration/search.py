"""Where a laser profile fits the relief that the images show: a search over horizontal shifts, from coarse to fine.

For each shift the heights of the shots above the stereo surface are taken, a level and a slope along the track are
fitted and removed (the orientation's part, which the adjustment finds), and what is left is the misfit

    chi^2 = sum_i rho(h_i / sigma_i) + (n - m) c,

over the m of n shots that are on the surface, with Huber's loss; each of the others counts as much as a shot does where
the profile fits best (c, the least misfit per shot of shifts that keep most shots on the surface), so that neither few
shots nor many are the better fit. A shift moves a shot over the images by its linear part: a footprint moves by a
kilometre or two, the camera is 100 km and more away.

Angles that change along the track bend a profile: from its minima on the grid a profile is fitted with a shift that
changes linearly along it, by tens of metres. Minima are then compared two by two, over the shots that both have on the
surface. Their probabilities (`minima`) say whether relief ties the profile: few of them hold all of it.

Loops of the search over shifts: misfits of a profile after thousands of them, and fits of a line to its heights.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.registration.minima import (
    REACH,
    CostSurface,
    Minimum,
    correlated_shots,
    local_minima,
    merged,
    weighted,
)

_HUBER = 2.0
"""Sigmas from which on a shot counts linearly."""
_ROUNDS = 3
"""Of reweighting."""


@cached_kernel
def misfits_of_shifts(
    shifts: Array, places: Array, other_places: Array, place_by_shift: Array, other_by_shift: Array, epipolar: Array,
    pixels_per_metre: Array, variances: Array, along: Array, first: Array, step: Array, finer: int, fine: Array,
    covered: Mask, noise: Array,
) -> tuple[Array, Index]:  # fmt: skip
    """Sums of the losses (s,) of heights about a line along the track, and (s,) how many shots are on the surface.

    Parameters
    ----------
    shifts : (s, 2)
        m east and north.
    places, others, place_by_shift, other_by_shift, epipolar, pixels_per_metre, along
        Of n shots, as in `search`.
    variances : (n,)
        m^2, of the heights of shots.
    first, step : (2,)
        First node of the surface, and pixels between nodes.
    finer : int
        Nodes of `fine` (2, ., .), the surface's disparities, that make one of the surface's.
    covered, noise : (r, c)
        Of the surface's nodes: whether it is known there, and its variance in pixels^2.
    """
    count, n = len(shifts), len(places)
    result, shots = np.empty(count), np.empty(count, dtype=np.int64)
    heights, weights, left = np.empty(n), np.empty(n), np.empty(n)
    rows, columns = covered.shape
    for k in range(count):
        east, north = shifts[k, 0], shifts[k, 1]
        shots[k] = 0
        for i in range(n):
            heights[i] = weights[i] = 0.0
            line = places[i, 0] + place_by_shift[i, 0, 0] * east + place_by_shift[i, 0, 1] * north
            sample = places[i, 1] + place_by_shift[i, 1, 0] * east + place_by_shift[i, 1, 1] * north
            row, column = (line - first[0]) / step[0], (sample - first[1]) / step[1]
            if not (0.0 <= row <= rows - 1.0 and 0.0 <= column <= columns - 1.0):
                continue
            r, c = min(int(row), rows - 2), min(int(column), columns - 2)
            if not (covered[r, c] and covered[r + 1, c] and covered[r, c + 1] and covered[r + 1, c + 1]):
                continue
            parallax = 0.0
            for j in range(2):
                other = other_places[i, j] + other_by_shift[i, j, 0] * east + other_by_shift[i, j, 1] * north
                parallax += epipolar[i, j] * (other - _between(fine[j], row * finer, column * finer))
            scale = pixels_per_metre[i]
            heights[i] = parallax / scale
            weights[i] = 1.0 / (variances[i] + noise[int(row + 0.5), int(column + 0.5)] / scale**2)
            shots[k] += 1
        result[k] = _left_of_line(heights, weights, along, left)
    return result, shots


@cached_kernel
def left_of_lines(heights: Array, weights: Array, along: Array) -> tuple[Array, Array]:
    """Of heights (s, n) in m with weights (s, n) in 1/m^2 about a line along the track: (s,) sums of the losses, and
    (s, n) what is left of each, in sigmas.
    """
    losses, left = np.empty(len(heights)), np.empty(heights.shape)
    for k in range(len(heights)):
        losses[k] = _left_of_line(heights[k], weights[k], along, left[k])
    return losses, left


@compiled
def _between(values: Array, row: float, column: float) -> float:
    """Linear between four nodes."""
    r, c = min(int(row), values.shape[0] - 2), min(int(column), values.shape[1] - 2)
    v, u = row - r, column - c
    upper = (1.0 - u) * values[r, c] + u * values[r, c + 1]
    lower = (1.0 - u) * values[r + 1, c] + u * values[r + 1, c + 1]
    return float((1.0 - v) * upper + v * lower)


@compiled
def _left_of_line(heights: Array, weights: Array, along: Array, left: Array) -> float:
    """Sum of Huber's losses about the robust line; fills what is `left` (n,), in sigmas."""
    for k in range(heights.size):
        left[k] = 0.0
    for _ in range(_ROUNDS):
        n0 = n1 = n2 = right0 = right1 = 0.0
        for k in range(heights.size):
            ratio = abs(left[k])
            weight = weights[k] if ratio <= _HUBER else weights[k] * _HUBER / ratio
            n0 += weight
            n1 += weight * along[k]
            n2 += weight * along[k] ** 2
            right0 += weight * heights[k]
            right1 += weight * along[k] * heights[k]
        n0, n2 = n0 + 1e-12, n2 + 1e-12
        determinant = n0 * n2 - n1 * n1
        level = (n2 * right0 - n1 * right1) / determinant
        slope = (n0 * right1 - n1 * right0) / determinant
        for k in range(heights.size):
            left[k] = (heights[k] - level - slope * along[k]) * math.sqrt(weights[k])
    loss = 0.0
    for k in range(heights.size):
        ratio = abs(left[k])
        loss += 2.0 * _HUBER * ratio - _HUBER**2 if ratio > _HUBER else ratio**2
    return loss


def robust_weights(left: Array) -> Array:
    """Factors (...) of weights by Huber's loss, for height residuals (...) in sigmas."""
    return np.asarray(_HUBER / np.maximum(np.abs(left), _HUBER))


_MOST_SHOTS = 300
"""Of a profile, evenly taken, that are enough to find a minimum; more where there are few shifts."""
_MOST_WORK = 1_500_000
"""Shots times shifts, up to which more shots are taken."""
_LEAST_SHOTS = 12
"""On the surface, below which a shift says nothing."""
_LEAST_SHARE = 0.8
"""Of the most shots that any shift has on the surface, below which a shift is none: half of them fit by chance."""
_NEARLY_ALL = 0.9
"""Of the most shots: shifts by whose best a shot beside the surface counts."""
_MOST_COMPARED = 40
"""Minima, the lowest, that are compared with one another."""
_LEAST_COMPARED = 4
"""Of them, however badly the others fit."""
_WORST_COMPARED = 10.0
"""Times the lowest misfit on the grid up to which a minimum may be the lowest after the fit."""
_CHANGE = 50.0
"""m, sigma of the change of a shift from the middle of a profile to its end."""
_RIGID = 1e-3
"""m, the same of what has one shift everywhere."""
_REACH_OF_EXPECTED = 4.0
"""Sigmas of an expected shift up to which it is sought."""
_ONE_PLACE = 13.8
"""chi-square of two degrees of freedom (99.9 %), up to which two minima are one place."""
_STEPS = 12
"""Of the fit of a shift and its change, at most."""
_FITTED_TO = 1.0
"""m, of a step that ends the fit."""


class StereoPair(NamedTuple):
    """Two images as they are oriented now, and the surface that they show."""

    surface: StereoSurface
    """Averaged over the footprint of the shots."""
    images: tuple[PushbroomImage, PushbroomImage]
    """First and second."""
    corrections: tuple[OrientationCorrection, OrientationCorrection]
    """Of their nominal orientations."""


class Expected(NamedTuple):
    """Prior of the shift of a terrain model."""

    shift: Array
    """(2,) m east and north."""
    sigma: float
    """m, of each."""

    @property
    def reach(self) -> float:
        """m, shifts to be searched."""
        return _REACH_OF_EXPECTED * self.sigma + float(np.abs(self.shift).max())

    def misfits(self, shifts: Array) -> Array:
        """(s,) chi^2 of shifts (s, 2)."""
        return np.asarray(np.sum(((shifts - self.shift) / self.sigma) ** 2, axis=1))


class _Moved(NamedTuple):
    """Shots of a profile and how shifts move their images; n shots."""

    places: Array
    """(n, 2) in the first image."""
    others: Array
    """(n, 2) in the second."""
    place_by_shift: Array
    """(n, 2, 2) pixels per m east and north."""
    other_by_shift: Array
    """(n, 2, 2) the same in the second image."""
    epipolar: Array
    """(n, 2) unit, in the second."""
    pixels_per_metre: Array
    """(n,) of height along the normal, signed: upward is positive."""
    sigmas: Array
    """(n,) m, of a height."""
    along: Array
    """(n,) along the track, -1 .. 1."""
    span: tuple[float, float]
    """Numbers of the first and the last of them."""


def search(
    pair: StereoPair,
    footprints: Array,
    sigmas: Array,
    name: str,
    reach: float = REACH,
    expected: Expected | None = None,
) -> CostSurface:
    """Search the shift of one profile.

    Parameters
    ----------
    pair : StereoPair
    footprints : (n, 3)
        m, body-fixed, in the order of their times.
    sigmas : (n,)
        m, of each height.
    name : str
        Of the profile.
    reach : float
        m, up to which shifts are tried, a standard deviation of the footprint apart.
    expected : Expected, optional
        Of a terrain model, which has one shift everywhere.

    Returns
    -------
    CostSurface
        Without minima where too few shots are on the surface.
    """
    step = _footprint_width(pair)
    if expected is not None:
        reach = min(reach, expected.reach)
        # a post is the mean of its cell: how rough the ground is within makes it no less certain
        smooth = replace(pair.surface, roughness=np.zeros_like(pair.surface.roughness))
        pair = pair._replace(surface=smooth)
    half = int(np.ceil(reach / step))
    moved = _moved(pair, footprints, sigmas, max(_MOST_SHOTS, _MOST_WORK // (2 * half + 1) ** 2))
    shifts = np.asarray(step * np.arange(-half, half + 1, dtype=np.float64))
    east, north = np.meshgrid(shifts, shifts, indexing="ij")
    misfits, shots = _misfits(pair.surface, moved, np.stack([east.ravel(), north.ravel()], axis=1))
    misfits = misfits.reshape(shifts.size, shifts.size)
    lowest = local_minima(shifts, misfits)[:_MOST_COMPARED]
    likely = sum(minimum.misfit <= _WORST_COMPARED * lowest[0].misfit for minimum in lowest)
    lowest = lowest[: max(likely, _LEAST_COMPARED)]
    minima = _compared(pair.surface, moved, lowest, step, half * step, expected)
    return CostSurface(name, shifts, misfits, shots, minima, moved.span)


def _footprint_width(pair: StereoPair) -> float:
    """Standard deviation of the footprint, m on the ground: two nodes of the surface."""
    image, surface = pair.images[0], pair.surface
    middle = surface.first + 0.5 * surface.step * np.array(surface.covered.shape)
    places = middle + np.array([[0.0, 0.0], [surface.step[0], 0.0], [0.0, surface.step[1]]])
    points = image.image_to_ground(places[:, 0], places[:, 1], 0.0, pair.corrections[0])[0]
    return 2.0 * float(np.linalg.norm(points[1:] - points[0], axis=1).max())


def _moved(pair: StereoPair, footprints: Array, sigmas: Array, most: int) -> _Moved:
    """Shots that both images see, or would after a shift, at most so many of them."""
    rows = np.arange(0, len(footprints), max(1, -(-len(footprints) // most)))
    points = footprints[rows]
    by_image = [
        image.ground_to_image(points, c) for image, c in zip(pair.images, pair.corrections, strict=True)
    ]
    visible = np.all([np.isfinite(places[:, 0]) for places, _ in by_image], axis=0)
    points = points[visible]
    (places, by_point), (other_places, other_by_point) = ((part[visible] for part in view) for view in by_image)
    ways = east_north(points).mT
    up = unit_vectors(points)
    rays = -pair.images[0].sightlines(places[:, 0], places[:, 1], pair.corrections[0])[1]
    epipolar = unit_vectors(np.einsum("nij,nj->ni", other_by_point, rays))
    _, slopes = pair.surface.disparity(places)
    parallax = np.einsum("ni,nij,nj->n", epipolar, other_by_point - slopes @ by_point, up)
    number = rows[visible].astype(np.float64)
    first, last = (number[0], number[-1]) if number.size else (0.0, 0.0)
    along = (2.0 * number - first - last) / max(last - first, 1.0)
    return _Moved(
        places, other_places, by_point @ ways, other_by_point @ ways, epipolar, parallax, sigmas[rows][visible], along,
        (float(first), float(last)),
    )  # fmt: skip


def _misfits(surface: StereoSurface, moved: _Moved, shifts: Array) -> tuple[Array, int]:
    """Misfits (s,) of shifts (s, 2) in m, NaN where too few shots are on the surface; most shots that any has there."""
    result, counts = misfits_of_shifts(
        shifts, moved.places, moved.others, moved.place_by_shift, moved.other_by_shift, moved.epipolar,
        moved.pixels_per_metre, moved.sigmas**2, moved.along, surface.first, surface.step, *surface.fine,
        surface.covered, surface.sigmas**2 + surface.roughness**2,
    )  # fmt: skip
    most = int(counts.max(initial=0))
    enough = counts >= max(_LEAST_SHOTS, _LEAST_SHARE * most)
    nearly_all = enough & (counts >= _NEARLY_ALL * most)
    each = float(np.min(result[nearly_all] / counts[nearly_all])) if np.any(nearly_all) else 0.0
    return np.where(enough, result + (most - counts) * each, np.nan), most


def _heights(surface: StereoSurface, moved: _Moved, places: Array, off: Array) -> tuple[Array, Array]:
    """Heights (s, n), m, of shots above the surface, and their weights (s, n), 1/m^2: zero beside the surface.

    The shots are at `places` (s, n, 2) in the first image, and by `off` (s, n, 2) beside what the surface shows in the
    second.
    """
    covered, sigmas, roughness = (part.reshape(off.shape[:2]) for part in surface.at_nodes(places.reshape(-1, 2)))
    noise = np.hypot(sigmas, roughness) / moved.pixels_per_metre
    heights = np.einsum("ni,sni->sn", moved.epipolar, off) / moved.pixels_per_metre
    return heights, covered / (moved.sigmas**2 + noise**2)


def _exact(surface: StereoSurface, moved: _Moved, shifts: Array) -> tuple[Array, Array, Array]:
    """Heights and weights (s, n) of shots after shifts (s, n, 2) in m; (s, n, 2) the heights' derivatives by these."""
    places, other_places = _shifted_places(moved, shifts)
    values, slopes = surface.disparity(places.reshape(-1, 2))
    heights, weights = _heights(surface, moved, places, other_places - values.reshape(other_places.shape))
    turned = moved.other_by_shift - slopes.reshape(*places.shape, 2) @ moved.place_by_shift
    by_shift = np.einsum("ni,snij->snj", moved.epipolar, turned) / moved.pixels_per_metre[:, None]
    return heights, weights, by_shift


def _shifted_places(moved: _Moved, shifts: Array) -> tuple[Array, Array]:
    """(s, n, 2) where shots are in both images after shifts (s, n, 2) in m."""
    return (
        moved.places + np.einsum("nij,snj->sni", moved.place_by_shift, shifts),
        moved.others + np.einsum("nij,snj->sni", moved.other_by_shift, shifts),
    )


def _compared(
    surface: StereoSurface, moved: _Moved, begin: Sequence[Minimum], step: float, reach: float,
    expected: Expected | None,
) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first; each is compared with the lowest over the shots of both.

    Fits that leave the shifts searched, up to `reach` m, are none.
    """
    if not begin:
        return ()
    change = _CHANGE if expected is None else _RIGID
    fitted = _fit_changes(surface, moved, np.array([minimum.shift for minimum in begin]), step, change)
    heights, weights, _ = _exact(surface, moved, fitted.along(moved))
    misfits, left = left_of_lines(heights, weights, moved.along)
    counts = np.count_nonzero(weights, axis=1)
    each = (misfits + fitted.penalty) / np.maximum(counts, 1)
    away = np.abs(fitted.shifts).max(axis=1) > reach + step
    each[away | (counts < _LEAST_SHARE * counts[~away].max(initial=0))] = np.inf
    owner = _places(fitted, each, step)
    own = np.flatnonzero(owner == np.arange(owner.size))
    if not own.size:
        return ()
    lone, first = int(np.argmin(each)), int(np.argmin(each[own]))
    correlated = correlated_shots(left[lone][weights[lone] > 0.0])
    if expected is not None:  # posts are correlated in two directions, and have neighbours in one of them
        correlated = correlated**2
    spreads = merged(fitted.shifts, fitted.covariances, each * counts[lone], owner, float(each[lone]) * correlated)
    fitted = fitted._replace(shifts=fitted.shifts[own], changes=fitted.changes[own], covariances=spreads[own])
    heights, weights = heights[own], weights[own]
    both = (weights > 0.0) & (weights[first] > 0.0)
    misfits, lowest = (
        left_of_lines(np.broadcast_to(some, both.shape).copy(), weight * both, moved.along)[0] + penalty
        for some, weight, penalty in (
            (heights, weights, fitted.penalty),
            (heights[first], weights[first], fitted.penalty[first]),
        )
    )
    logs = np.log(np.where(both, weights, 1.0))
    variances = np.sum(np.where(both, logs[first] - logs, 0.0), axis=1)
    prior = np.zeros(len(both)) if expected is None else expected.misfits(fitted.shifts)
    minima = [
        Minimum(shift, float(misfit), covariance, change)
        for shift, misfit, covariance, change in zip(
            fitted.shifts, misfits, fitted.covariances, fitted.changes, strict=True
        )
    ]
    return weighted(minima, misfits, lowest, np.count_nonzero(both, axis=1), variances, correlated, prior)


class _ChangingShifts(NamedTuple):
    """Shifts that change along a profile, at s minima."""

    shifts: Array
    """(s, 2) m east and north, in the middle."""
    changes: Array
    """(s, 2) m, from there to the end."""
    covariances: Array
    """(s, 2, 2) m^2, of the shifts, by the sigmas that are stated."""
    change: float
    """m, sigma of the changes."""

    def along(self, moved: _Moved) -> Array:
        """(s, n, 2) m, shift of each shot."""
        return self.shifts[:, None] + self.changes[:, None] * moved.along[:, None]

    @property
    def penalty(self) -> Array:
        """(s,) chi^2 of the changes."""
        return np.asarray(np.sum((self.changes / self.change) ** 2, axis=1))


def _fit_changes(surface: StereoSurface, moved: _Moved, begin: Array, step: float, change: float) -> _ChangingShifts:
    """Shifts and their changes of least misfit, from shifts (s, 2) in m on: robust Gauss-Newton steps, none longer than
    `step` m, with a level and a slope along the track; changes have a sigma of `change` m.
    """
    fitted = _ChangingShifts(begin.copy(), np.zeros_like(begin), np.zeros((len(begin), 2, 2)), change)
    level = np.stack([np.ones_like(moved.along), moved.along], axis=1)
    prior = np.diag([1e-12, 1e-12, change**-2, change**-2, 1e-12, 1e-12])
    going = np.arange(len(begin))
    for _ in range(_STEPS):
        heights, weights, slopes = _exact(surface, moved, fitted.along(moved)[going])
        _, left = left_of_lines(heights, weights, moved.along)
        weights = weights * robust_weights(left)
        levels = np.broadcast_to(level, (going.size, *level.shape))
        terms = np.concatenate([slopes, slopes * moved.along[:, None], levels], axis=2)
        normal = np.einsum("sn,sni,snj->sij", weights, terms, terms) + prior
        right = np.einsum("sn,sni,sn->si", weights, terms, heights)
        right[:, 2:4] += fitted.changes[going] / change**2
        move = -np.linalg.solve(normal, right[:, :, None])[:, :4, 0]
        move *= np.minimum(1.0, step / np.maximum(np.abs(move).max(axis=1, keepdims=True), 1e-12))
        fitted.shifts[going] += move[:, :2]
        fitted.changes[going] += move[:, 2:]
        fitted.covariances[going] = np.linalg.inv(normal)[:, :2, :2]
        going = going[np.abs(move).max(axis=1) > _FITTED_TO]
        if not going.size:
            break
    return fitted


def _places(fitted: _ChangingShifts, misfits: Array, step: float) -> Index:
    """(s,) of each minimum the one that stands for its place: itself where it is further from any lower one than `step`
    m and than the sigmas of both allow; -1 for a fit that has left the surface (its misfit per shot is infinite).
    """
    distinct, owner = list[int](), np.full(misfits.size, -1, dtype=np.int64)
    for k in np.argsort(misfits)[: np.count_nonzero(np.isfinite(misfits))].tolist():
        off = fitted.shifts[k] - fitted.shifts[distinct]
        both = misfits[k] * (fitted.covariances[k] + fitted.covariances[distinct])
        ratio = np.einsum("si,si->s", off, np.linalg.solve(both, off[:, :, None])[:, :, 0])
        near = np.flatnonzero((np.linalg.norm(off, axis=1) <= step) | (ratio <= _ONE_PLACE))
        owner[k] = distinct[near[0]] if near.size else k
        if not near.size:
            distinct.append(k)
    return owner
