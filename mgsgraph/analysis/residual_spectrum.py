"""Residuals of image rays over time, and the spectrum of one series of them: fits of a cosine and a sine at all
frequencies, and what noise alone shows.

At each frequency a cosine and a sine of a turn are fitted to an image's residuals by least squares (Lomb 1976),
together with a polynomial of time, most of which any adjustment has taken up; rays need not be even in time. The fit
knows what share of a move residuals show (`residual_series`), so that amplitudes are those of the camera. Sums over
rays are fast Fourier transforms of sums over short bins of time (Press & Rybicki 1989).

Neighbouring rays have errors in common, and how large errors are is seldom well known: so the floor is taken from the
spectrum itself, as the median of the test over the frequencies round about. Against it a test is F with two degrees of
freedom above, exceeding q / s^2 by chance with (1 + q / (s^2 v))^(-v/2), v from the number of frequencies in the
median. Of all frequencies the largest counts: those of a spectrum up to a frequency f exceed z = q / (2 s^2) at most as
often as W sqrt(z) independent ones, W = f sqrt(4 pi var t) (Baluev 2008).

A series is the residuals of one image's rays over time (`residual_series`). Of a ray that lies off by d (2,) px, as the
camera that took it looked elsewhere, residuals show what the point doesn't follow. With J a ray's slopes by the point,
W its weight and C the point's covariance (all of its rays, and what else is known of it),

    v_k = d_k - J_k C J_k' W_k d_k   of the ray itself,      v_i = - J_i C J_k' W_k d_k   of the point's other rays.

The share that is left is the ray's redundancy when orientation is known. In a stereo pair it is one half at right
angles to the epipolar line, and nothing along it: there the point takes up all, as a height.

A pitch moves rays along lines, a roll along samples, a yaw along lines in proportion to the sample's distance from the
middle. Motions of the spacecraft do the same: residuals don't separate them from turns.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.spacing import known_besides_rays, point_covariances, ray_slopes
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import OUT
from mgsgraph.network import Network

Turn = Literal["pitch", "roll", "yaw"]
"""What moves rays: along lines, along samples, along lines at the image's left and right edge the opposite way."""
TURNS: tuple[Turn, ...] = get_args(Turn)


class Series(NamedTuple):
    """Rays of one image that a turn of its camera moves; k rays."""

    image: int
    """Of the network."""
    name: str
    """Of the image."""
    turn: Turn
    """Which."""
    own: Index
    """(k,) of `Residuals.rays`."""
    times: Array
    """(k,) s from the middle of the first and last."""
    moves: Array
    """(k,) px of line (pitch, yaw) or sample (roll) per px of amplitude: 1, or of a yaw the place between the edges."""
    shares: Array
    """(k,) of such a move that is left in the ray's own residual."""
    weights: Array
    """(k,) per px^2."""

    @property
    def component(self) -> int:
        """Of a residual: 0 line, 1 sample."""
        return 1 if self.turn == "roll" else 0

    @property
    def share(self) -> float:
        """Of a move that residuals show, mean over the rays."""
        return float(self.shares.mean())

    @property
    def duration(self) -> float:
        """s, from the first to the last ray."""
        return float(np.ptp(self.times))


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """All rays that took part, by image and line; r of them."""

    rays: Index
    """(r,) of the network."""
    values: Array
    """(r, 2) px, line and sample, measured minus predicted."""
    point: Index
    """(r,) network point."""
    slopes: Array
    """(r, 2, 3) px per m, J."""
    spread: Array
    """(n, 3, 3) m^2, C of each network point; zero of a fixed one."""
    weights: Array
    """(r, 2) per px^2."""
    series: tuple[Series, ...]
    """Three for each image with rays enough."""

    def shown(self, one: Series, moved: Array) -> Array:
        """(r, 2) px, what residuals show of rays of a series that lie off by `moved` (k,) px."""
        found = np.zeros_like(self.values)
        off = np.zeros((one.own.size, 2))
        off[:, one.component] = moved
        found[one.own] = off
        pulled = np.zeros((self.spread.shape[0], 3))
        pull = np.einsum("kij,ki->kj", self.slopes[one.own], self.weights[one.own] * off)
        np.add.at(pulled, self.point[one.own], pull)
        follow = np.einsum("nij,nj->ni", self.spread, pulled)
        return np.asarray(found - np.einsum("rij,rj->ri", self.slopes, follow[self.point]))


def residual_series(of: Solution | Linearised, fewest: int) -> Residuals:
    """Residuals of an adjustment as series over time.

    Parameters
    ----------
    of : Solution or Linearised
        Its rays used count; those that were made from other knowledge (back-projected) have no noise and don't.
    fewest : int
        Rays that an image needs.

    Raises
    ------
    InputError
        Where no image has as many.
    """
    at = at_solution(of) if isinstance(of, Solution) else of
    network, rays, layout = at.network, at.network.rays, at.layout
    places, misfits = layout.network_order(at.points), residuals(layout, at.orientation, at.points).image
    taken_part = at.rows.weight[0, layout.observation_rows.rays] > 0.0
    able = taken_part & (layout.network_order(at.rows.kind) != OUT)[rays.point] & np.isfinite(misfits).all(axis=1)
    if rays.back_projected is not None:
        able &= ~rays.back_projected
    taken = np.flatnonzero(able)
    taken = taken[np.lexsort((rays.places[taken, 0], rays.image[taken]))]
    slopes = ray_slopes(network, taken, places)
    seen = np.isfinite(slopes).all(axis=(1, 2))
    taken, slopes = taken[seen], slopes[seen]
    weights, point = rays.sigmas[taken] ** -2.0, rays.point[taken]
    spread = _spread(network, places, point, slopes, weights)
    shares = 1.0 - np.einsum("rki,rij,rkj->rk", slopes, spread[point], slopes) * weights
    series = [one for j in np.unique(rays.image[taken]).tolist()
              for one in _of_image(network, j, taken, shares, weights, fewest)]  # fmt: skip
    if not series:
        raise InputError("residuals over time", f"no image with {fewest} rays that took part", "ties matched densely")
    return Residuals(taken, misfits[taken], point, slopes, spread, weights, tuple(series))


def _spread(network: Network, places: Array, point: Index, slopes: Array, weights: Array) -> Array:
    """(n, 3, 3) m^2, of all points when orientation is known; zero of fixed ones and of those that nothing places."""
    normal = known_besides_rays(network, np.arange(len(network.points)), places)
    normal = np.where(np.isfinite(normal), normal, 0.0)
    np.add.at(normal, point, np.einsum("rki,rk,rkj->rij", slopes, weights, slopes))
    spread = point_covariances(normal)
    spread[network.points.kinds == PointKind.FIXED] = 0.0
    return np.where(np.isfinite(spread), spread, 0.0)


def _of_image(
    network: Network, image: int, taken: Index, shares: Array, weights: Array, fewest: int
) -> Iterator[Series]:
    """Three of an image with rays enough."""
    own = np.flatnonzero(network.rays.image[taken] == image)
    one, places = network.images[image], network.rays.places[taken[own]]
    times = one.timing.at(places[:, 0])[0]
    if own.size < fewest or not np.ptp(times) > 0.0:
        return
    times = times - 0.5 * (times.min() + times.max())
    for turn in TURNS:
        c = 1 if turn == "roll" else 0
        moves = 2.0 * places[:, 1] / one.samples - 1.0 if turn == "yaw" else np.ones(own.size)
        yield Series(image, one.name, turn, own, times, moves, shares[own, c], weights[own, c])


FALSE_ALARMS = 0.01
"""Share of turns without any vibration in which one is named all the same."""
_FINE = 6.0
"""Frequencies per reciprocal of the time that an image takes."""
_ZOOM = 41
"""Places on either side of a peak where its frequency is looked for."""
_LOWEST = 4.0
"""Periods in that time, of the lowest frequency: what is slower is a drift."""
_PER_WAVE = 4.0
"""Rays in a period of the highest one, on the average."""
_MOST_FREQUENCIES = 1500.0
"""Reciprocals of the time, at most."""
_ROUND_ABOUT = 20.0
"""Reciprocals of the time, to either side, over which the floor's median is taken."""
_EFFICIENCY = 0.5
"""Degrees of freedom of the floor per degree of freedom of the tests in its median, about."""
_BINS = 32.0
"""In a period of the highest frequency."""
_DEGREE = 7
"""Of the polynomials of time beside the waves: adjustments have taken up the cubic ones, and may leave more of drifts.
"""


@dataclass(frozen=True, slots=True)
class Peak:
    """A wave of the camera: a peak of the spectrum."""

    frequency: float
    """Hz."""
    amplitude: float
    """px."""
    sigma: float
    """px, of the amplitude."""
    test: float
    """Chi-square of two degrees of freedom, were it noise."""
    probability: float
    """That noise alone shows one like it at any frequency."""


@dataclass(frozen=True, slots=True, eq=False)
class WaveFits:
    """Fits of cosine and sine at several frequencies."""

    frequencies: Array
    """(f,) Hz."""
    values: Array
    """(f, 2) px."""
    covariance: Array
    """(f, 2, 2) px^2, were errors independent and as stated."""
    floor: Array
    """(f,) s^2, by how much variances are larger."""
    tests: Array
    """(f,) q / s^2."""
    freedom: float
    """v of the floor."""
    probability: float
    """Of the largest test by chance."""

    def near(self, frequency: float, resolution: float) -> float:
        """Largest test within a resolution (Hz) of a frequency (Hz); 0 where there is none."""
        close = np.abs(self.frequencies - frequency) < resolution
        return float(self.tests[close].max()) if close.any() else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """A vibration fitted."""

    peak: Peak
    moved: Array
    """(k,) px of each ray."""


class SeriesSpectrum:
    """Spectra of one series."""

    def __init__(self, series: Series) -> None:
        self.series = series
        once = 1.0 / series.duration
        highest = max(min(series.times.size / _PER_WAVE, _MOST_FREQUENCIES), 2.0 * _LOWEST)
        self.resolution = once
        # times are put into bins so short that a wave of the highest frequency keeps its amplitude to 0.2 %
        bins = int(_BINS * highest)
        self._bin = np.minimum((series.times / series.duration + 0.5) * bins, bins - 1).astype(np.int64)
        self._length = round(_FINE * bins)
        self._numbers = np.arange(round(_LOWEST * _FINE), round(highest * _FINE))
        self.grid: Array = np.asarray(self._numbers * once / _FINE, dtype=np.float64)
        self.width = float(self.grid[-1] - self.grid[0]) * math.sqrt(4.0 * math.pi * float(np.var(series.times)))
        u = series.times / (0.5 * series.duration)
        polynomials = np.polynomial.legendre.legvander(u, _DEGREE) * series.moves[:, None]
        weight = series.weights * np.maximum(series.shares, 0.0)
        self._root = np.sqrt(weight) * series.moves
        self._basis, _ = np.linalg.qr(np.sqrt(weight)[:, None] * polynomials)
        self._covariance = _inverse_normal(self._normal())

    def fits(self, residuals: Array) -> WaveFits:
        """At all frequencies, of residuals (k,) in px."""
        # the score takes residuals whole: what the point has taken up is counted in the share
        right = self._transformed(self.series.weights * self.series.moves * residuals, self._numbers)
        values = np.einsum("fij,fj->fi", self._covariance, right)
        tests = np.einsum("fi,fi->f", values, right)
        floor, freedom = self._floor(tests)
        scaled = tests / floor
        by_chance = chance(float(scaled.max()), self.width, freedom)
        return WaveFits(self.grid, values, self._covariance, floor, scaled, freedom, by_chance)

    def _transformed(self, values: Array, numbers: Index) -> Array:
        """(f, 2) sums of values (k,) times cosine and sine at multiples (f,) of the grid's step."""
        binned = np.bincount(self._bin, values, self._length)
        # a bin's time from the middle, in periods of the grid's step
        ahead = 0.5 * (1.0 - self._length / _FINE) / self._length
        found = np.fft.rfft(binned)[numbers] * np.exp(-2j * np.pi * numbers * ahead)
        return np.stack([found.real, -found.imag], axis=1)

    def _normal(self) -> Array:
        """(f, 2, 2) of cosine and sine, less what polynomials of time take up."""
        squares = self._root**2
        double = self._transformed(squares, 2 * self._numbers)
        normal = np.empty((self.grid.size, 2, 2))
        normal[:, 0, 0], normal[:, 1, 1] = 0.5 * (squares.sum() + double[:, 0]), 0.5 * (squares.sum() - double[:, 0])
        normal[:, 0, 1] = normal[:, 1, 0] = 0.5 * double[:, 1]
        beside = np.stack([self._transformed(self._root * column, self._numbers) for column in self._basis.T], axis=2)
        return np.asarray(normal - beside @ np.swapaxes(beside, 1, 2))

    def _directly(self, residuals: Array, frequencies: Array) -> tuple[Array, Array, Array]:
        """Values (f, 2), covariances (f, 2, 2) and tests (f,) at a few frequencies (f,)."""
        one = self.series
        phase = 2.0 * np.pi * frequencies[:, None] * one.times
        waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
        right = waves @ (one.weights * one.moves * residuals)
        whole = waves * self._root
        beside = whole @ self._basis
        normal = whole @ np.swapaxes(whole, 1, 2) - beside @ np.swapaxes(beside, 1, 2)
        covariance = _inverse_normal(normal)
        values = np.einsum("fij,fj->fi", covariance, right)
        return values, covariance, np.einsum("fi,fi->f", values, right)

    def _floor(self, tests: Array) -> tuple[Array, float]:
        """(f,) running median of the tests over that of chi-square with two degrees of freedom, and its own freedom."""
        from scipy.ndimage import median_filter  # slow to import

        size = min(2 * round(_ROUND_ABOUT * _FINE) + 1, tests.size)
        floor = median_filter(tests, size=size, mode="reflect") / (2.0 * math.log(2.0))
        freedom = max(2.0 * _EFFICIENCY * size / _FINE, 4.0)
        return np.maximum(floor, 1e-12 * max(float(tests.max()), 1e-300)), freedom

    def wave(self, residuals: Array, fits: WaveFits) -> Wave:
        """The largest of fits, its frequency refined; how sure it is by the floor that it leaves, being taken out."""
        best = int(np.argmax(fits.tests))
        step = self.resolution / _FINE
        near = fits.frequencies[best] + step * np.linspace(-1.0, 1.0, _ZOOM)
        values, covariance, tests = self._directly(residuals, near)
        k = int(np.argmax(tests))
        phase = 2.0 * np.pi * near[k] * self.series.times
        moved = self.series.moves * (values[k, 0] * np.cos(phase) + values[k, 1] * np.sin(phase))
        floor = float(self.fits(residuals - self.series.shares * moved).floor[best])
        amplitude = float(np.hypot(*values[k]))
        along = values[k] / amplitude
        test = float(tests[k]) / floor
        peak = Peak(
            frequency=float(near[k]),
            amplitude=amplitude,
            sigma=math.sqrt(floor * float(along @ covariance[k] @ along)),
            test=test,
            probability=chance(test, self.width, fits.freedom),
        )
        return Wave(peak, moved)


def _inverse_normal(normal: Array) -> Array:
    """Covariances (f, 2, 2) of normal equations (f, 2, 2), finite where these say nothing."""
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    return np.asarray(np.linalg.inv(normal + (1e-9 * size + 1e-12) * np.eye(2)))


def chance(test: float, width: float, freedom: float) -> float:
    """Probability that noise alone shows a test as large at any frequency (Baluev 2008, with a floor of few degrees of
    freedom).
    """
    single = math.exp(-0.5 * freedom * math.log1p(test / freedom))
    return -math.expm1((1.0 + width * math.sqrt(0.5 * test)) * math.log1p(-min(single, 1.0 - 1e-15)))


def level_of_test(probability: float, width: float, freedom: float) -> float:
    """The test that noise alone exceeds at any frequency with a probability."""
    low, high = 0.0, 1e4
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chance(middle, width, freedom) > probability else (low, middle)
    return high
