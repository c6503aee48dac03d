"""The spectrum of one series of residuals: fits of a cosine and a sine at all frequencies, and what noise alone shows.

At each frequency a cosine and a sine of a turn are fitted to an image's residuals by least squares (Lomb 1976),
together with a polynomial of time, most of which any adjustment has taken up; rays need not be even in time. The fit
knows what share of a move residuals show (`residual_series`), so that amplitudes are those of the camera. Sums over
rays are fast Fourier transforms of sums over short bins of time (Press & Rybicki 1989).

Neighbouring rays have errors in common, and how large errors are is seldom well known: so the floor is taken from the
spectrum itself, as the median of the test over the frequencies round about. Against it a test is F with two degrees of
freedom above, exceeding q / s^2 by chance with (1 + q / (s^2 v))^(-v/2), v from the number of frequencies in the
median. Of all frequencies the largest counts: those of a spectrum up to a frequency f exceed z = q / (2 s^2) at most as
often as W sqrt(z) independent ones, W = f sqrt(4 pi var t) (Baluev 2008).
"""

import math
from dataclasses import dataclass

import numpy as np

from mgsgraph.analysis.spacing.residual_series import Series
from mgsgraph.analysis.spacing.spectrum import Peak
from mgsgraph.geometry.records import Array, Index

_FINE = 6.0
"""Frequencies per reciprocal of the time from the first to the last ray."""
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
_ZOOM = 41
_BINS = 32.0
"""In a period of the highest frequency."""
_DEGREE = 7
"""Of the polynomials of time beside the waves: adjustments have taken up the cubic ones, and may leave more of drifts.
"""


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
            beyond_prior=True,
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
