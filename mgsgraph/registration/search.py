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
surface. What is stated of a shot's height is mostly its profile's, which has gone with the level, so the scale of its
sigma is hardly known: marginalised over that scale, whose prior counts as ten shots that are as stated, twice the
logarithm of the likelihood of a shift against another is -D,

    D = ((m + 6) ln((chi^2_1 + 10) / (chi^2_2 + 10)) + sum_i ln(sigma_i1^2 / sigma_i2^2)) / k,  k = (1 + r) / (1 - r),

k being the number of shots that count as one, by the correlation r of successive heights at the best shift. The weight
of a minimum is exp(-D / 2) times the root of its covariance's determinant: the probability that its neighbourhood is
the right one when all shifts are alike beforehand. Relief ties a profile when few minima hold all of the probability.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface

REACH = 1500.0
"""m, shifts that are searched, in every direction, at least."""
_MOST_SHOTS = 600
"""Of a profile, evenly taken, that are enough to find a minimum; more where there are few shifts."""
_MOST_TRIALS = 10_000_000
"""Shots times shifts, up to which more shots are taken."""
_LEAST_SHOTS = 12
"""On the surface, below which a shift says nothing."""
_LEAST_SHARE = 0.8
"""Of the most shots that any shift has on the surface, below which a shift is none: half of them fit by chance."""
_NEARLY_ALL = 0.9
"""Of the most shots: shifts by whose best a shot beside the surface counts."""
_HUBER = 2.0
"""Sigmas from which on a shot counts linearly."""
_ROUNDS = 3
"""Of reweighting."""
_AS_STATED = 10.0
"""Shots by whose weight stated sigmas are believed beforehand: the papers state ten times too much for MOLA."""
_CLEAR = 1e-3
"""Weight of the second-best minimum up to which the best is the only one."""
_MOST_COMPARED = 40
"""Minima, the lowest, that are compared with one another."""
_MOST_POSSIBLE = 5
"""Minima above that weight up to which relief ties a profile: more are a plain, in which noise fits anywhere."""
_MOST_CORRELATED = 0.9
"""Correlation of successive heights that is taken at its word."""
_FITTED = 4
"""Level, slope and two shifts, which misfits have lost."""
_CHANGE = 50.0
"""m, sigma of the change of a shift from the middle of a profile to its end."""
_ONE_PLACE = 13.8
"""chi-square of two degrees of freedom (99.9 %), up to which two minima are one place."""
_STEPS = 12
"""Of the fit of a shift and its change."""


_NONE = np.zeros(2)


class StereoPair(NamedTuple):
    """Two images as they are oriented now, and the surface that they show."""

    surface: StereoSurface
    """Averaged over the footprint of the shots."""
    images: tuple[PushbroomImage, PushbroomImage]
    """First and second."""
    corrections: tuple[OrientationCorrection, OrientationCorrection]
    """Of their nominal orientations."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """One shift at which a profile fits."""

    shift: Array
    """(2,) m east and north, to be added to the footprints."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, of the shift."""
    change: Array
    """(2,) m east and north, from the middle of the profile to its end, of the shift."""
    weight: float
    """Probability, all shifts being alike beforehand."""


@dataclass(frozen=True, slots=True, eq=False)
class CostSurface:
    """Misfit of a profile (or of several together) over shifts."""

    name: str
    """Of the profile."""
    shifts: Array
    """(k,) m, eastward and northward alike."""
    misfits: Array
    """(k, k) chi^2, by shift east (rows) and north (columns); NaN where too few shots are on the surface."""
    shots: int
    """On the surface, at most."""
    minima: tuple[Minimum, ...]
    """Likeliest first."""
    span: tuple[float, float] = (0.0, 0.0)
    """Numbers of the first and the last shot that both images see, before any shift."""

    def best(self, count: int) -> Array:
        """(count, 2) m east and north, by which each shot of the profile is to be moved to the likeliest minimum."""
        first, last = self.span
        along = (2.0 * np.arange(count) - first - last) / max(last - first, 1.0)
        found = self.minima[0]
        return np.asarray(found.shift + found.change * np.clip(along, -1.0, 1.0)[:, None])

    @property
    def possible(self) -> tuple[Minimum, ...]:
        """Minima one of which may be the right one."""
        return tuple(one for one in self.minima if one.weight >= _CLEAR)

    @property
    def tied(self) -> bool:
        """Whether relief ties the profile at all: few minima are possible, each narrow beside the shifts searched."""
        widest = (0.25 * np.ptp(self.shifts) / 2.0) ** 2
        return 0 < len(self.possible) <= _MOST_POSSIBLE and all(
            float(np.linalg.eigvalsh(one.covariance)[-1]) < widest for one in self.possible
        )

    @property
    def clear(self) -> bool:
        """Whether it does so at one place only."""
        return self.tied and len(self.possible) == 1


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
    step: float | None = None,
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
        m, up to which shifts are tried.
    step : float, optional
        m between shifts; a node of the surface when absent.

    Returns
    -------
    CostSurface
        Without minima where too few shots are on the surface.
    """
    step = step or _node_size(pair)
    half = int(np.ceil(reach / step))
    moved = _moved(pair, footprints, sigmas, max(_MOST_SHOTS, _MOST_TRIALS // (2 * half + 1) ** 2))
    shifts = np.asarray(step * np.arange(-half, half + 1, dtype=np.float64))
    east, north = np.meshgrid(shifts, shifts, indexing="ij")
    misfits, shots = _misfits(pair.surface, moved, np.stack([east.ravel(), north.ravel()], axis=1))
    misfits = misfits.reshape(shifts.size, shifts.size)
    lowest = local_minima(shifts, misfits)[:_MOST_COMPARED]
    found = _compared(pair.surface, moved, lowest, step)
    return CostSurface(name, shifts, misfits, shots, found, moved.span)


def _node_size(pair: StereoPair) -> float:
    """Distance on the ground between nodes of the surface, m."""
    image, surface = pair.images[0], pair.surface
    middle = surface.first + 0.5 * surface.step * np.array(surface.covered.shape)
    places = middle + np.array([[0.0, 0.0], [surface.step[0], 0.0], [0.0, surface.step[1]]])
    points = image.image_to_ground(places[:, 0], places[:, 1], 0.0, pair.corrections[0])[0]
    return float(np.linalg.norm(points[1:] - points[0], axis=1).max())


def _moved(pair: StereoPair, footprints: Array, sigmas: Array, most: int) -> _Moved:
    """Shots that both images see, or would after a shift, at most so many of them."""
    every = np.arange(0, len(footprints), max(1, -(-len(footprints) // most)))
    points = footprints[every]
    found = [
        image.ground_to_image(points, one) for image, one in zip(pair.images, pair.corrections, strict=True)
    ]
    seen = np.all([np.isfinite(places[:, 0]) for places, _ in found], axis=0)
    points = points[seen]
    (places, by_point), (others, other_by_point) = ((part[seen] for part in one) for one in found)
    ways = np.swapaxes(east_north(points), 1, 2)
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    rays = -pair.images[0].sightlines(places[:, 0], places[:, 1], pair.corrections[0])[1]
    epipolar = np.einsum("nij,nj->ni", other_by_point, rays)
    epipolar /= np.linalg.norm(epipolar, axis=1, keepdims=True)
    _, slopes = pair.surface.disparity(places)
    parallax = np.einsum("ni,nij,nj->n", epipolar, other_by_point - slopes @ by_point, up)
    number = every[seen].astype(np.float64)
    first, last = (number[0], number[-1]) if number.size else (0.0, 0.0)
    along = (2.0 * number - first - last) / max(last - first, 1.0)
    return _Moved(
        places, others, by_point @ ways, other_by_point @ ways, epipolar, parallax, sigmas[every][seen], along,
        (float(first), float(last)),
    )  # fmt: skip


def _misfits(surface: StereoSurface, moved: _Moved, shifts: Array) -> tuple[Array, int]:
    """Misfits (s,) of shifts (s, 2) in m, NaN where too few shots are on the surface; most shots that any has there."""
    result, counts = np.full(len(shifts), np.nan), np.zeros(len(shifts), dtype=np.int64)
    at_once = max(1, 200_000 // max(len(moved.places), 1))
    for begin in range(0, len(shifts), at_once):
        heights, weights = _heights(surface, moved, shifts[begin : begin + at_once], surface.nearly)
        counts[begin : begin + at_once] = np.count_nonzero(weights, axis=1)
        result[begin : begin + at_once] = _left(heights, weights, moved.along)[0]
    most = int(counts.max(initial=0))
    enough = counts >= max(_LEAST_SHOTS, _LEAST_SHARE * most)
    nearly_all = enough & (counts >= _NEARLY_ALL * most)
    each = float(np.min(result[nearly_all] / counts[nearly_all])) if np.any(nearly_all) else 0.0
    return np.where(enough, result + (most - counts) * each, np.nan), most


def _heights(
    surface: StereoSurface, moved: _Moved, shifts: Array, values: Callable[[Array], Array] | None = None
) -> tuple[Array, Array]:
    """Heights (s, n), m, of shots above the surface after shifts (s, 2) or (s, n, 2) in m, and their weights (s, n),
    1/m^2: zero beside the surface. The disparities are `values` of the surface, the exact ones when absent.
    """
    places, others = _seen(moved, shifts)
    flat = places.reshape(-1, 2)
    at = surface.disparity(flat)[0] if values is None else values(flat)
    off = others - at.reshape(others.shape)
    covered, sigmas, roughness = (part.reshape(places.shape[:2]) for part in surface.at_nodes(flat))
    noise = np.hypot(sigmas, roughness) / moved.pixels_per_metre
    heights = np.einsum("ni,sni->sn", moved.epipolar, off) / moved.pixels_per_metre
    return heights, covered / (moved.sigmas**2 + noise**2)


def _slopes(surface: StereoSurface, moved: _Moved, shifts: Array) -> Array:
    """(s, n, 2) derivative of the heights by shifts (s, n, 2)."""
    places, _ = _seen(moved, shifts)
    slopes = surface.disparity(places.reshape(-1, 2))[1].reshape(*places.shape, 2)
    off = moved.other_by_shift - slopes @ moved.place_by_shift
    return np.einsum("ni,snij->snj", moved.epipolar, off) / moved.pixels_per_metre[:, None]


def _seen(moved: _Moved, shifts: Array) -> tuple[Array, Array]:
    """(s, n, 2) where shots are in both images after shifts (s, 2) or (s, n, 2) in m."""
    every = np.broadcast_to(shifts if shifts.ndim == 3 else shifts[:, None], (len(shifts), len(moved.places), 2))
    return (
        moved.places + np.einsum("nij,snj->sni", moved.place_by_shift, every),
        moved.others + np.einsum("nij,snj->sni", moved.other_by_shift, every),
    )


def _left(heights: Array, weights: Array, along: Array) -> tuple[Array, Array]:
    """Of heights (s, n) with weights (s, n) about a level and a slope along the track: (s,) sum of the losses, and
    (s, n) what is left of each, in sigmas.
    """
    terms = np.stack([np.ones_like(along), along], axis=1)
    robust = np.ones_like(heights)
    for _ in range(_ROUNDS):
        both = weights * robust
        normal = np.einsum("sn,ni,nj->sij", both, terms, terms) + 1e-12 * np.eye(2)
        right = np.einsum("sn,ni,sn->si", both, terms, heights)
        level = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        left = (heights - level @ terms.T) * np.sqrt(weights)
        ratio = np.abs(left)
        robust = np.where(ratio > _HUBER, _HUBER / np.maximum(ratio, 1e-12), 1.0)
    loss = np.where(ratio > _HUBER, 2.0 * _HUBER * ratio - _HUBER**2, ratio**2)
    return np.asarray(np.sum(loss * (weights > 0.0), axis=1)), left


class _Bowl(NamedTuple):
    """A minimum of the misfit by itself."""

    shift: Array
    """(2,) m east and north."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, by the sigmas that are stated."""
    change: Array = _NONE
    """(2,) m, of the shift from the middle of the profile to its end."""


def local_minima(shifts: Array, misfits: Array) -> list[_Bowl]:
    """Local minima of a misfit (k, k) over shifts (k,), refined by a paraboloid through neighbours; lowest first."""
    filled = np.where(np.isfinite(misfits), misfits, np.inf)
    inner = filled[1:-1, 1:-1]
    around = [filled[1 + i : filled.shape[0] - 1 + i, 1 + j : filled.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    lowest = np.isfinite(inner) & np.all([inner <= one for one in around], axis=0)
    found = [_refined(shifts, filled, row + 1, column + 1) for row, column in np.argwhere(lowest)]
    return sorted(found, key=lambda one: one.misfit)


def _compared(surface: StereoSurface, moved: _Moved, bowls: Sequence[_Bowl], step: float) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first; each is compared with the lowest over the shots of both."""
    if not bowls:
        return ()
    fitted = _bent(surface, moved, np.array([one.shift for one in bowls]), step)
    heights, weights = _heights(surface, moved, fitted.along(moved))
    misfits, left = _left(heights, weights, moved.along)
    counts = np.count_nonzero(weights, axis=1)
    each = (misfits + fitted.penalty) / np.maximum(counts, 1)
    each[counts < _LEAST_SHARE * counts.max()] = np.inf
    apart = _apart(fitted, each, step)
    fitted = _Bent(*(part[apart] for part in fitted))
    heights, weights, left = heights[apart], weights[apart], left[apart]
    first = int(np.argmin(each[apart]))
    both = (weights > 0.0) & (weights[first] > 0.0)
    misfits, lowest = (
        _left(some, weight * both, moved.along)[0] + penalty
        for some, weight, penalty in (
            (heights, weights, fitted.penalty),
            (heights[[first]], weights[[first]], fitted.penalty[first]),
        )
    )
    logs = np.log(np.where(both, weights, 1.0))
    variances = np.sum(np.where(both, logs[first] - logs, 0.0), axis=1)
    alike = shots_alike(left[first][both[first]])
    found = [
        _Bowl(shift, float(misfit), covariance, change)
        for shift, misfit, covariance, change in zip(
            fitted.shifts, misfits, fitted.covariances, fitted.changes, strict=True
        )
    ]
    return weighted(found, misfits, lowest, np.count_nonzero(both, axis=1), variances, alike)


class _Bent(NamedTuple):
    """Shifts that change along a profile, at s minima."""

    shifts: Array
    """(s, 2) m east and north, in the middle."""
    changes: Array
    """(s, 2) m, from there to the end."""
    covariances: Array
    """(s, 2, 2) m^2, of the shifts, by the sigmas that are stated."""

    def along(self, moved: _Moved) -> Array:
        """(s, n, 2) m, shift of each shot."""
        return self.shifts[:, None] + self.changes[:, None] * moved.along[:, None]

    @property
    def penalty(self) -> Array:
        """(s,) chi^2 of the changes."""
        return np.asarray(np.sum((self.changes / _CHANGE) ** 2, axis=1))


def _bent(surface: StereoSurface, moved: _Moved, begin: Array, step: float) -> _Bent:
    """Shifts and their changes of least misfit, from shifts (s, 2) in m on: robust Gauss-Newton steps, none longer than
    `step` m, with a level and a slope along the track.
    """
    found = _Bent(begin.copy(), np.zeros_like(begin), np.zeros((len(begin), 2, 2)))
    level = np.stack([np.ones_like(moved.along), moved.along], axis=1)
    known = np.diag([1e-12, 1e-12, _CHANGE**-2, _CHANGE**-2, 1e-12, 1e-12])
    for _ in range(_STEPS):
        shifts = found.along(moved)
        heights, weights = _heights(surface, moved, shifts)
        slopes = _slopes(surface, moved, shifts)
        _, left = _left(heights, weights, moved.along)
        weights = weights * np.where(np.abs(left) > _HUBER, _HUBER / np.maximum(np.abs(left), 1e-12), 1.0)
        every = np.broadcast_to(level, (len(begin), *level.shape))
        terms = np.concatenate([slopes, slopes * moved.along[:, None], every], axis=2)
        normal = np.einsum("sn,sni,snj->sij", weights, terms, terms) + known
        right = np.einsum("sn,sni,sn->si", weights, terms, heights)
        right[:, 2:4] += found.changes / _CHANGE**2
        move = -np.linalg.solve(normal, right[:, :, None])[:, :4, 0]
        move *= np.minimum(1.0, step / np.maximum(np.abs(move).max(axis=1, keepdims=True), 1e-12))
        found = _Bent(found.shifts + move[:, :2], found.changes + move[:, 2:], np.linalg.inv(normal)[:, :2, :2])
    return found


def _apart(fitted: _Bent, misfits: Array, step: float) -> Index:
    """Minima that are places of their own: further from a lower one than `step` m and than the sigmas of both allow.

    Misfits (s,) are per shot, infinite for fits that have left the surface.
    """
    apart = list[int]()
    for k in np.argsort(misfits)[: np.count_nonzero(np.isfinite(misfits))].tolist():
        off = fitted.shifts[k] - fitted.shifts[apart]
        both = misfits[k] * (fitted.covariances[k] + fitted.covariances[apart])
        ratio = np.einsum("si,si->s", off, np.linalg.solve(both, off[:, :, None])[:, :, 0])
        if np.all((np.linalg.norm(off, axis=1) > step) & (ratio > _ONE_PLACE)):
            apart.append(k)
    return np.array(apart)


def weighted(
    bowls: Sequence[_Bowl], misfits: Array, lowest: Array, shots: Index, variances: Array, alike: float
) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first.

    Parameters
    ----------
    bowls : sequence of n
        In any order.
    misfits, lowest : (n,)
        chi^2 of each, and of the one that fits best, over the shots of both.
    shots : (n,)
        Those of both.
    variances : (n,)
        Sum of the logarithms of their variances, less that at the best.
    alike : float
        Shots that count as one.
    """
    freedom = np.maximum(shots - _FITTED, 1) + _AS_STATED
    misfits, lowest = misfits + _AS_STATED, lowest + _AS_STATED
    scale = float(np.min(lowest / freedom)) * alike
    logs = -0.5 * (freedom * np.log(misfits / lowest) + variances) / alike
    logs += np.array([0.5 * np.linalg.slogdet(one.covariance)[1] for one in bowls])
    weights = np.exp(logs - logs.max())
    every = [
        Minimum(one.shift, one.misfit, scale * one.covariance, one.change, float(weight / weights.sum()))
        for one, weight in zip(bowls, weights, strict=True)
    ]
    return tuple(sorted(every, key=lambda one: -one.weight))


def shots_alike(left: Array) -> float:
    """Number of successive shots that count as one, by the correlation of what is left of their heights (n,)."""
    if left.size <= _FITTED:
        return 1.0
    correlation = float(np.sum(left[1:] * left[:-1]) / max(np.sum(left**2), 1e-12))
    correlation = min(max(correlation, 0.0), _MOST_CORRELATED)
    return (1.0 + correlation) / (1.0 - correlation)


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _refined(shifts: Array, misfits: Array, row: int, column: int) -> _Bowl:
    """The paraboloid through a minimum and its eight neighbours."""
    step = shifts[1] - shifts[0]
    i, j = (part.ravel() for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    values = misfits[row - 1 : row + 2, column - 1 : column + 2].ravel()
    here, at = misfits[row, column], np.array([shifts[row], shifts[column]])
    if not np.all(np.isfinite(values)):
        return _Bowl(at, float(here), np.eye(2) * step**2)
    terms = np.stack([np.ones(9), i, j, 0.5 * i * i, i * j, 0.5 * j * j], axis=1)
    c, gi, gj, hii, hij, hjj = np.linalg.lstsq(terms, values, rcond=None)[0]
    hessian = np.array([[hii, hij], [hij, hjj]])
    if not (hii > 0.0 and np.linalg.det(hessian) > 1e-6 * hii * hjj):
        return _Bowl(at, float(here), np.eye(2) * step**2)
    move = -np.linalg.solve(hessian, [gi, gj])
    if np.abs(move).max() > 1.0:
        return _Bowl(at, float(here), 2.0 * np.linalg.inv(hessian) * step**2)
    misfit = min(float(here), float(c + 0.5 * np.array([gi, gj]) @ move))
    return _Bowl(at + step * move, misfit, 2.0 * np.linalg.inv(hessian) * step**2)
