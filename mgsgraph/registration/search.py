"""Where a laser profile fits the relief that the images show: a search over horizontal shifts, from coarse to fine.

For each shift the heights of the shots above the stereo surface are taken, a level and a slope along the track are
fitted and removed (the orientation's part, which the adjustment finds), and what is left is the misfit

    chi^2 = sum_i rho(h_i / sigma_i) + (n - m) c,

over the m of n shots that are on the surface, with Huber's loss; each of the others counts as much as a shot does where
the profile fits best (c, the least misfit per shot of shifts that keep most shots on the surface), so that neither few
shots nor many are the better fit. A shift moves a shot over the images by its linear part: a footprint moves by a
kilometre or two, the camera is 100 km and more away.

Each minimum gets a weight: the probability that its neighbourhood is the right one when all shifts are alike
beforehand, exp(-chi^2 / 2) times the root of its covariance's determinant, chi^2 being counted in units of the best
one's misfit per shot: what is stated of a shot's height is mostly its profile's, which has gone with the level. Where
no minimum lies clearly below the rest, relief doesn't tie the profile.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
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
_TIED = 25.0
"""By how much chi^2 of the best minimum has to lie below the median over all shifts: five sigmas."""
_LEAST_SCALE = 1e-3
"""Of the misfit per shot: nothing fits better than a thirtieth of what is stated."""
_CLEAR = 1e-3
"""Weight of the second-best minimum up to which the best is the only one."""


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
    """Best first."""

    @property
    def tied(self) -> bool:
        """Whether relief ties the profile at all."""
        return bool(self.minima) and float(np.nanmedian(self.misfits)) - self.minima[0].misfit > _TIED * self.scale

    @property
    def scale(self) -> float:
        """Misfit of the best minimum per shot: in its units misfits are chi-square."""
        return _scale(self.minima[0].misfit, self.shots) if self.minima else 1.0

    @property
    def clear(self) -> bool:
        """Whether it does so at one place only."""
        return self.tied and (len(self.minima) == 1 or self.minima[1].weight < _CLEAR)


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
    return CostSurface(name, shifts, misfits, shots, minima(shifts, misfits, shots))


def together(name: str, each: Sequence[CostSurface]) -> CostSurface:
    """Cost surface of one shift for several profiles, searched over the same shifts."""
    misfits = np.sum([one.misfits for one in each], axis=0)
    shots = sum(one.shots for one in each)
    return CostSurface(name, each[0].shifts, misfits, shots, minima(each[0].shifts, misfits, shots))


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
        places, others, by_point @ ways, other_by_point @ ways, epipolar, parallax, sigmas[every][seen], along
    )


def _misfits(surface: StereoSurface, moved: _Moved, shifts: Array) -> tuple[Array, int]:
    """Misfits (s,) of shifts (s, 2) in m, NaN where too few shots are on the surface; most shots that any has there."""
    result, counts = np.full(len(shifts), np.nan), np.zeros(len(shifts), dtype=np.int64)
    at_once = max(1, 200_000 // max(len(moved.places), 1))
    for begin in range(0, len(shifts), at_once):
        some = shifts[begin : begin + at_once]
        places = moved.places + np.einsum("nij,sj->sni", moved.place_by_shift, some)
        flat = places.reshape(-1, 2)
        others = moved.others + np.einsum("nij,sj->sni", moved.other_by_shift, some)
        off = others - surface.nearly(flat).reshape(others.shape)
        covered, sigmas, roughness = surface.at_nodes(flat)
        covered = covered.reshape(places.shape[:2])
        heights = np.einsum("ni,sni->sn", moved.epipolar, off) / moved.pixels_per_metre
        noise = np.hypot(sigmas, roughness).reshape(heights.shape) / moved.pixels_per_metre
        weights = covered / (moved.sigmas**2 + noise**2)
        counts[begin : begin + at_once] = covered.sum(axis=1)
        result[begin : begin + at_once] = _left(heights, weights, moved.along)
    most = int(counts.max(initial=0))
    enough = counts >= max(_LEAST_SHOTS, _LEAST_SHARE * most)
    nearly_all = enough & (counts >= _NEARLY_ALL * most)
    each = float(np.min(result[nearly_all] / counts[nearly_all])) if np.any(nearly_all) else 0.0
    return np.where(enough, result + (most - counts) * each, np.nan), most


def _left(heights: Array, weights: Array, along: Array) -> Array:
    """(s,) sum of the losses of heights (s, n) with weights (s, n) about a level and a slope along the track."""
    terms = np.stack([np.ones_like(along), along], axis=1)
    robust = np.ones_like(heights)
    for _ in range(_ROUNDS):
        both = weights * robust
        normal = np.einsum("sn,ni,nj->sij", both, terms, terms) + 1e-12 * np.eye(2)
        right = np.einsum("sn,ni,sn->si", both, terms, heights)
        level = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        ratio = np.abs(heights - level @ terms.T) * np.sqrt(weights)
        robust = np.where(ratio > _HUBER, _HUBER / np.maximum(ratio, 1e-12), 1.0)
    loss = np.where(ratio > _HUBER, 2.0 * _HUBER * ratio - _HUBER**2, ratio**2)
    return np.asarray(np.sum(loss * (weights > 0.0), axis=1))


def minima(shifts: Array, misfits: Array, shots: int) -> tuple[Minimum, ...]:
    """Local minima of a misfit (k, k) over shifts (k,), refined by a paraboloid through neighbours; best first."""
    filled = np.where(np.isfinite(misfits), misfits, np.inf)
    inner = filled[1:-1, 1:-1]
    around = [filled[1 + i : filled.shape[0] - 1 + i, 1 + j : filled.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    lowest = np.isfinite(inner) & np.all([inner <= one for one in around], axis=0)
    found = [_refined(shifts, filled, row + 1, column + 1) for row, column in np.argwhere(lowest)]
    best = min((misfit for _, misfit, _ in found), default=0.0)
    scale = _scale(best, shots)
    logs = np.array([-0.5 * (misfit - best) / scale + 0.5 * np.linalg.slogdet(one)[1] for _, misfit, one in found])
    weights = np.exp(logs - logs.max(initial=-np.inf)) if len(found) else logs
    every = [
        Minimum(shift, misfit, scale * covariance, float(weight / weights.sum()))
        for (shift, misfit, covariance), weight in zip(found, weights, strict=True)
    ]
    return tuple(sorted(every, key=lambda one: one.misfit))


def _scale(best: float, shots: int) -> float:
    """Misfit per shot of a minimum: level, slope and two shifts are fitted."""
    return max(best / max(shots - 4, 1), _LEAST_SCALE)


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _refined(shifts: Array, misfits: Array, row: int, column: int) -> tuple[Array, float, Array]:
    """Shift (2,), misfit and covariance (2, 2) of the paraboloid through a minimum and its eight neighbours."""
    step = shifts[1] - shifts[0]
    i, j = (part.ravel() for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    values = misfits[row - 1 : row + 2, column - 1 : column + 2].ravel()
    here, at = misfits[row, column], np.array([shifts[row], shifts[column]])
    if not np.all(np.isfinite(values)):
        return at, float(here), np.eye(2) * step**2
    terms = np.stack([np.ones(9), i, j, 0.5 * i * i, i * j, 0.5 * j * j], axis=1)
    c, gi, gj, hii, hij, hjj = np.linalg.lstsq(terms, values, rcond=None)[0]
    hessian = np.array([[hii, hij], [hij, hjj]])
    if not (hii > 0.0 and np.linalg.det(hessian) > 1e-6 * hii * hjj):
        return at, float(here), np.eye(2) * step**2
    move = -np.linalg.solve(hessian, [gi, gj])
    if np.abs(move).max() > 1.0:
        return at, float(here), 2.0 * np.linalg.inv(hessian) * step**2
    misfit = min(float(here), float(c + 0.5 * np.array([gi, gj]) @ move))
    return at + step * move, misfit, 2.0 * np.linalg.inv(hessian) * step**2
