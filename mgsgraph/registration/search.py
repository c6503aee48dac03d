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
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.stereo_surface import StereoSurface, SurfaceHeights
from mgsgraph.network import PointClass
from mgsgraph.record import Record

_HUBER = 2.0
"""Sigmas from which on a shot counts linearly."""
_ROUNDS = 3
"""Of reweighting."""


@cached_kernel
def misfits_of_shifts(
    shifts: Array, places: Array, others: Array, place_by_shift: Array, other_by_shift: Array, epipolar: Array,
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
                other = others[i, j] + other_by_shift[i, j, 0] * east + other_by_shift[i, j, 1] * north
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
    """Factors (...) of the weights of what is left of heights (...), in sigmas, by Huber's loss."""
    return np.asarray(_HUBER / np.maximum(np.abs(left), _HUBER))



_AS_STATED = 10.0
"""Shots by whose weight stated sigmas are believed beforehand: the papers state ten times too much for MOLA."""
_MOST_CORRELATED = 0.9
"""Correlation of successive heights that is taken at its word."""
_ALIKE = 5.0
"""m, up to which two fits are the same."""
FITTED = 4
"""Level, slope and two shifts, which misfits have lost."""
_NONE = np.zeros(2)


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
    """Probability."""


class Bowl(NamedTuple):
    """A minimum of the misfit by itself."""

    shift: Array
    """(2,) m east and north."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, by the sigmas that are stated."""
    change: Array = _NONE
    """(2,) m, of the shift from the middle of the profile to its end."""


def local_minima(shifts: Array, misfits: Array) -> list[Bowl]:
    """Local minima of a misfit (k, k) over shifts (k,), refined by a paraboloid through neighbours; lowest first."""
    filled = np.where(np.isfinite(misfits), misfits, np.inf)
    inner = filled[1:-1, 1:-1]
    around = [filled[1 + i : filled.shape[0] - 1 + i, 1 + j : filled.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    lowest = np.isfinite(inner) & np.all([inner <= one for one in around], axis=0)
    found = [_refined(shifts, filled, row + 1, column + 1) for row, column in np.argwhere(lowest)]
    return sorted(found, key=lambda one: one.misfit)


def weighted(
    bowls: Sequence[Bowl],
    misfits: Array,
    lowest: Array,
    shots: Index,
    variances: Array,
    alike: float,
    known: Array,
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
    known : (n,)
        chi^2 of their shifts by what is known beforehand.
    """
    freedom = np.maximum(shots - FITTED, 1) + _AS_STATED
    misfits, lowest = misfits + _AS_STATED, lowest + _AS_STATED
    scale = float(np.min(lowest / freedom)) * alike
    logs = -0.5 * (freedom * np.log(misfits / lowest) + variances) / alike - 0.5 * known
    logs += np.array([0.5 * np.linalg.slogdet(one.covariance)[1] for one in bowls])
    weights = np.exp(logs - logs.max())
    every = [
        Minimum(one.shift, one.misfit, scale * one.covariance, one.change, float(weight / weights.sum()))
        for one, weight in zip(bowls, weights, strict=True)
    ]
    return tuple(sorted(every, key=lambda one: -one.weight))


def merged(shifts: Array, covariances: Array, misfits: Array, owner: Index, scale: float) -> Array:
    """(s, 2, 2) m^2, covariances of minima; of each that stands for others its mean square over the mixture of them.

    Parameters
    ----------
    shifts : (s, 2)
        m.
    covariances : (s, 2, 2)
        m^2, by the sigmas that are stated.
    misfits : (s,)
        chi^2 over as many shots each.
    owner : (s,)
        Number of the minimum that stands for each, -1 for none.
    scale : float
        By which chi^2 is too large.
    """
    found = covariances.copy()
    for k in np.unique(owner[owner >= 0]).tolist():
        mine = [k]
        for other in np.flatnonzero(owner == k).tolist():  # fits that ended at the same place count once
            if np.linalg.norm(shifts[other] - shifts[mine], axis=1).min() > _ALIKE:
                mine.append(other)
        logs = 0.5 * np.linalg.slogdet(covariances[mine])[1] - 0.5 * (misfits[mine] - misfits[k]) / scale
        weights, off = np.exp(logs - logs.max()), shifts[mine] - shifts[k]
        every = covariances[mine] + off[:, :, None] * off[:, None] / scale
        found[k] = np.einsum("k,kij->ij", weights / weights.sum(), every)
    return found


def shots_alike(left: Array) -> float:
    """Number of successive shots that count as one, by the correlation of what is left of their heights (n,)."""
    if left.size <= FITTED:
        return 1.0
    correlation = float(np.sum(left[1:] * left[:-1]) / max(np.sum(left**2), 1e-12))
    correlation = min(max(correlation, 0.0), _MOST_CORRELATED)
    return (1.0 + correlation) / (1.0 - correlation)


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _refined(shifts: Array, misfits: Array, row: int, column: int) -> Bowl:
    """The paraboloid through a minimum and its eight neighbours."""
    step = shifts[1] - shifts[0]
    i, j = (part.ravel() for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    values = misfits[row - 1 : row + 2, column - 1 : column + 2].ravel()
    here, at = misfits[row, column], np.array([shifts[row], shifts[column]])
    if not np.all(np.isfinite(values)):
        return Bowl(at, float(here), np.eye(2) * step**2)
    terms = np.stack([np.ones(9), i, j, 0.5 * i * i, i * j, 0.5 * j * j], axis=1)
    c, gi, gj, hii, hij, hjj = np.linalg.lstsq(terms, values, rcond=None)[0]
    hessian = np.array([[hii, hij], [hij, hjj]])
    if not (hii > 0.0 and np.linalg.det(hessian) > 1e-6 * hii * hjj):
        return Bowl(at, float(here), np.eye(2) * step**2)
    move = -np.linalg.solve(hessian, [gi, gj])
    if np.abs(move).max() > 1.0:
        return Bowl(at, float(here), 2.0 * np.linalg.inv(hessian) * step**2)
    misfit = min(float(here), float(c + 0.5 * np.array([gi, gj]) @ move))
    return Bowl(at + step * move, misfit, 2.0 * np.linalg.inv(hessian) * step**2)



REACH = 1500.0
"""m, shifts that are searched, in every direction, at least."""
_MOST_SHOTS = 300
"""Of a profile, evenly taken, that are enough to find a minimum; more where there are few shifts."""
_MOST_TRIALS = 1_500_000
"""Shots times shifts, up to which more shots are taken."""
_LEAST_SHOTS = 12
"""On the surface, below which a shift says nothing."""
_LEAST_SHARE = 0.8
"""Of the most shots that any shift has on the surface, below which a shift is none: half of them fit by chance."""
_NEARLY_ALL = 0.9
"""Of the most shots: shifts by whose best a shot beside the surface counts."""
_CLEAR = 1e-3
"""Weight of the second-best minimum up to which the best is the only one."""
_MOST_COMPARED = 40
"""Minima, the lowest, that are compared with one another."""
_LEAST_COMPARED = 4
"""Of them, however badly the others fit."""
_WORST_COMPARED = 10.0
"""Times the lowest misfit on the grid up to which a minimum may be the lowest after the fit."""
_MOST_POSSIBLE = 5
"""Minima above that weight up to which relief ties a profile: more are a plain, in which noise fits anywhere."""
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
    reached: bool = True
    """False where adjustments have not come to the likeliest minimum: then it isn't clear."""

    def best(self, count: int) -> Array:
        """(count, 2) m east and north, by which each shot of the profile is to be moved to the likeliest minimum."""
        first, last = self.span
        along = (2.0 * np.arange(count) - first - last) / max(last - first, 1.0)
        found = self.minima[0]
        return np.asarray(found.shift + found.change * np.clip(along, -1.0, 1.0)[:, None])

    @property
    def scale(self) -> float:
        """Least misfit per shot: in its units misfits are chi-square."""
        lowest = float(np.nanmin(self.misfits)) if np.any(np.isfinite(self.misfits)) else 0.0
        return lowest / max(self.shots - FITTED, 1) or 1.0

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
        """Whether it does so at one place only, which adjustments reach."""
        return self.tied and len(self.possible) == 1 and self.reached


class Expected(NamedTuple):
    """What is known of the shift at which a terrain model fits."""

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
    moved = _moved(pair, footprints, sigmas, max(_MOST_SHOTS, _MOST_TRIALS // (2 * half + 1) ** 2))
    shifts = np.asarray(step * np.arange(-half, half + 1, dtype=np.float64))
    east, north = np.meshgrid(shifts, shifts, indexing="ij")
    misfits, shots = _misfits(pair.surface, moved, np.stack([east.ravel(), north.ravel()], axis=1))
    misfits = misfits.reshape(shifts.size, shifts.size)
    lowest = local_minima(shifts, misfits)[:_MOST_COMPARED]
    likely = sum(one.misfit <= _WORST_COMPARED * lowest[0].misfit for one in lowest)
    lowest = lowest[: max(likely, _LEAST_COMPARED)]
    found = _compared(pair.surface, moved, lowest, step, half * step, expected)
    return CostSurface(name, shifts, misfits, shots, found, moved.span)


def _footprint_width(pair: StereoPair) -> float:
    """Standard deviation of the footprint, m on the ground: two nodes of the surface."""
    image, surface = pair.images[0], pair.surface
    middle = surface.first + 0.5 * surface.step * np.array(surface.covered.shape)
    places = middle + np.array([[0.0, 0.0], [surface.step[0], 0.0], [0.0, surface.step[1]]])
    points = image.image_to_ground(places[:, 0], places[:, 1], 0.0, pair.corrections[0])[0]
    return 2.0 * float(np.linalg.norm(points[1:] - points[0], axis=1).max())


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
    places, others = _seen(moved, shifts)
    values, slopes = surface.disparity(places.reshape(-1, 2))
    heights, weights = _heights(surface, moved, places, others - values.reshape(others.shape))
    turned = moved.other_by_shift - slopes.reshape(*places.shape, 2) @ moved.place_by_shift
    by_shift = np.einsum("ni,snij->snj", moved.epipolar, turned) / moved.pixels_per_metre[:, None]
    return heights, weights, by_shift


def _seen(moved: _Moved, shifts: Array) -> tuple[Array, Array]:
    """(s, n, 2) where shots are in both images after shifts (s, n, 2) in m."""
    return (
        moved.places + np.einsum("nij,snj->sni", moved.place_by_shift, shifts),
        moved.others + np.einsum("nij,snj->sni", moved.other_by_shift, shifts),
    )


def _compared(
    surface: StereoSurface, moved: _Moved, bowls: Sequence[Bowl], step: float, reach: float, expected: Expected | None
) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first; each is compared with the lowest over the shots of both.

    Fits that leave the shifts searched, up to `reach` m, are none.
    """
    if not bowls:
        return ()
    change = _CHANGE if expected is None else _RIGID
    fitted = _bent(surface, moved, np.array([one.shift for one in bowls]), step, change)
    heights, weights, _ = _exact(surface, moved, fitted.along(moved))
    misfits, left = left_of_lines(heights, weights, moved.along)
    counts = np.count_nonzero(weights, axis=1)
    each = (misfits + fitted.penalty) / np.maximum(counts, 1)
    away = np.abs(fitted.shifts).max(axis=1) > reach + step
    each[away | (counts < _LEAST_SHARE * counts[~away].max(initial=0))] = np.inf
    owner = _places(fitted, each, step)
    apart = np.flatnonzero(owner == np.arange(owner.size))
    if not apart.size:
        return ()
    lone, first = int(np.argmin(each)), int(np.argmin(each[apart]))
    alike = shots_alike(left[lone][weights[lone] > 0.0])
    if expected is not None:  # posts are alike in two directions, and have neighbours in one of them
        alike = alike**2
    spreads = merged(fitted.shifts, fitted.covariances, each * counts[lone], owner, float(each[lone]) * alike)
    fitted = fitted._replace(shifts=fitted.shifts[apart], changes=fitted.changes[apart], covariances=spreads[apart])
    heights, weights = heights[apart], weights[apart]
    both = (weights > 0.0) & (weights[first] > 0.0)
    misfits, lowest = (
        left_of_lines(np.ascontiguousarray(np.broadcast_to(some, both.shape)), weight * both, moved.along)[0] + penalty
        for some, weight, penalty in (
            (heights, weights, fitted.penalty),
            (heights[first], weights[first], fitted.penalty[first]),
        )
    )
    logs = np.log(np.where(both, weights, 1.0))
    variances = np.sum(np.where(both, logs[first] - logs, 0.0), axis=1)
    known = np.zeros(len(both)) if expected is None else expected.misfits(fitted.shifts)
    found = [
        Bowl(shift, float(misfit), covariance, change)
        for shift, misfit, covariance, change in zip(
            fitted.shifts, misfits, fitted.covariances, fitted.changes, strict=True
        )
    ]
    return weighted(found, misfits, lowest, np.count_nonzero(both, axis=1), variances, alike, known)


class _Bent(NamedTuple):
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


def _bent(surface: StereoSurface, moved: _Moved, begin: Array, step: float, change: float) -> _Bent:
    """Shifts and their changes of least misfit, from shifts (s, 2) in m on: robust Gauss-Newton steps, none longer than
    `step` m, with a level and a slope along the track; changes have a sigma of `change` m.
    """
    found = _Bent(begin.copy(), np.zeros_like(begin), np.zeros((len(begin), 2, 2)), change)
    level = np.stack([np.ones_like(moved.along), moved.along], axis=1)
    known = np.diag([1e-12, 1e-12, change**-2, change**-2, 1e-12, 1e-12])
    going = np.arange(len(begin))
    for _ in range(_STEPS):
        heights, weights, slopes = _exact(surface, moved, found.along(moved)[going])
        _, left = left_of_lines(heights, weights, moved.along)
        weights = weights * robust_weights(left)
        every = np.broadcast_to(level, (going.size, *level.shape))
        terms = np.concatenate([slopes, slopes * moved.along[:, None], every], axis=2)
        normal = np.einsum("sn,sni,snj->sij", weights, terms, terms) + known
        right = np.einsum("sn,sni,sn->si", weights, terms, heights)
        right[:, 2:4] += found.changes[going] / change**2
        move = -np.linalg.solve(normal, right[:, :, None])[:, :4, 0]
        move *= np.minimum(1.0, step / np.maximum(np.abs(move).max(axis=1, keepdims=True), 1e-12))
        found.shifts[going] += move[:, :2]
        found.changes[going] += move[:, 2:]
        found.covariances[going] = np.linalg.inv(normal)[:, :2, :2]
        going = going[np.abs(move).max(axis=1) > _FITTED_TO]
        if not going.size:
            break
    return found


def _places(fitted: _Bent, misfits: Array, step: float) -> Index:
    """(s,) of each minimum the one that stands for its place: itself where it is further from any lower one than `step`
    m and than the sigmas of both allow; -1 for a fit that has left the surface (its misfit per shot is infinite).
    """
    apart, owner = list[int](), np.full(misfits.size, -1, dtype=np.int64)
    for k in np.argsort(misfits)[: np.count_nonzero(np.isfinite(misfits))].tolist():
        off = fitted.shifts[k] - fitted.shifts[apart]
        both = misfits[k] * (fitted.covariances[k] + fitted.covariances[apart])
        ratio = np.einsum("si,si->s", off, np.linalg.solve(both, off[:, :, None])[:, :, 0])
        near = np.flatnonzero((np.linalg.norm(off, axis=1) <= step) | (ratio <= _ONE_PLACE))
        owner[k] = apart[near[0]] if near.size else k
        if not near.size:
            apart.append(k)
    return owner



MOST_REACH = 20_000.0
"""m, up to which shifts may be searched: images are a few kilometres wide."""


@dataclass(frozen=True, slots=True)
class ReliefSettings(Record):
    """How laser and images are registered by relief.

    Examples
    --------
    >>> settings = mgsgraph.ReliefSettings(reach=500.0, terrain="spline")
    >>> settings.reach, settings.crossovers
    (500.0, True)
    """

    footprint: float | None = None
    """m, diameter on the ground of all shots; that of each profile's altimeter (`Case.footprints`) when None."""
    reach: float = REACH
    """m, up to which shifts are searched."""
    spacing: float | None = None
    """m between dense matches; a quarter of the smallest footprint when None, but not less than the matching's own."""
    images: tuple[str, ...] = ()
    """Names of those to match; all of the case when empty."""
    terrain: Literal["cells", "spline"] = "cells"
    """Posts of terrain models lie on the surface that the images show, or tie points stay on the surface of those
    of the first model, as in an adjustment without relief."""
    crossovers: bool = True
    """Where two laser profiles cross, their heights agree."""

    def __post_init__(self) -> None:
        for name, value in (("footprint", self.footprint), ("reach", self.reach), ("spacing", self.spacing)):
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"registration by relief, {name}", f"{value} m", "a positive number")
        if self.reach > MOST_REACH:
            found, most = f"shifts up to {self.reach:g} m", f"{MOST_REACH:g} m at most"
            raise InputError("registration by relief, reach", found, most, "mend the orientation or the profiles first")


class ProfileState(NamedTuple):
    """A laser profile and the surface by one orientation of the images; n shots."""

    points: Array
    """(n, 3) m, body-fixed, of the footprints."""
    heights: SurfaceHeights
    """Of the footprints above the surface."""
    cost: CostSurface
    """Misfit over shifts of the profile from here: its minimum is at zero where images and laser agree."""

    @property
    def misplacement(self) -> Array:
        """(2,) m east and north, by which the profile has to move onto the surface; NaN where relief doesn't tie it."""
        return self.cost.minima[0].shift if self.cost.tied else np.full(2, np.nan)

    @property
    def misplacement_covariance(self) -> Array:
        """(2, 2) m^2, of the misplacement: that of all possible minima about the likeliest, by their weights; NaN where
        relief doesn't tie the profile.
        """
        if not self.cost.tied:
            return np.full((2, 2), np.nan)
        weights = np.array([one.weight for one in self.cost.possible])
        off = np.array([one.shift for one in self.cost.possible]) - self.misplacement
        each = np.array([one.covariance for one in self.cost.possible]) + off[:, :, None] * off[:, None]
        return np.asarray(np.einsum("k,kij->ij", weights / weights.sum(), each))


@dataclass(frozen=True, slots=True, eq=False)
class ReliefProfile(Record):
    """One laser profile, or one terrain model, against the stereo surface.

    Examples
    --------
    >>> profile = registration.profiles[0]
    >>> print(f"{profile.taken.sum()} shots: {profile.rms_before:.0f} m before, {profile.rms_after:.1f} m after")
    114 shots: 839 m before, 1.0 m after
    >>> np.sqrt(np.diagonal(profile.covariance)).round(1)
    array([62.5, 62.6])
    """

    name: str
    """Of the profile or the model."""
    point_class: PointClass
    """What it consists of: laser shots, or posts."""
    mine: Index
    """(n,) its points in the network, in the order of their times."""
    taken: Mask
    """(n,) whether they lie on the surface and take part."""
    sigmas: Array
    """(n,) m, of the heights above the surface, along its normal; of no meaning for shots that don't take part."""
    before: ProfileState
    """By the adjustment without stereo rows: its orientation, the footprints where it shifts the profile."""
    after: ProfileState
    """The same by the adjustment with them."""
    shift: Array
    """(2,) m east and north, adjusted."""
    covariance: Array
    """(2, 2) m^2, of the shift."""

    @property
    def of_posts(self) -> bool:
        """Whether it is a terrain model."""
        return self.point_class is PointClass.POST

    @property
    def unit(self) -> str:
        """What one of its points is called."""
        return "post" if self.of_posts else "shot"

    @property
    def rms_before(self) -> float:
        """m, of the heights of the shots above the surface, before."""
        return _rms(self.before.heights, self.taken)

    @property
    def rms_after(self) -> float:
        """m, of the heights of the shots above the surface, after."""
        return _rms(self.after.heights, self.taken)


@dataclass(frozen=True, slots=True, eq=False)
class ReliefRegistration(Record):
    """Laser and images, registered.

    Examples
    --------
    >>> for profile in registration.profiles:
    ...     print(f"{profile.name}: shifted by {np.hypot(*profile.shift):.0f} m")
    ap18933l: shifted by 180 m
    ap19043l: shifted by 62 m
    >>> registration.solution.shifts.shape
    (2, 2)
    """

    name: str
    """Of the case."""
    settings: ReliefSettings
    """Choices."""
    before: Solution
    """Adjusted without stereo rows."""
    solution: Solution
    """Adjusted with them."""
    profiles: tuple[ReliefProfile, ...]
    """Those of the network."""


def _rms(found: SurfaceHeights, taken: Mask) -> float:
    """Of the heights of the shots taken, where the surface is known; NaN without any."""
    taken = found.covered & taken
    return float(np.sqrt(np.mean(found.heights[taken] ** 2))) if np.any(taken) else float("nan")
