"""Residuals of image rays over time, their spectra, and the vibrations that these show.

At each frequency a cosine and a sine of a turn are fitted to an image's residuals by least squares (Lomb 1976),
together with a polynomial of time, most of which any adjustment has taken up; rays need not be even in time. The fit
knows what share of a move residuals show (`residual_series`), so that amplitudes are those of the camera. Sums over
rays are fast Fourier transforms of sums over short bins of time (Press & Rybicki 1989).

Neighbouring rays have errors in common, and how large errors are is seldom well known: so the floor is taken from the
spectrum itself, as the median of the test over the frequencies round about. Against it a test is F with two degrees of
freedom above, exceeding q / s^2 by chance with (1 + q / (s^2 v))^(-v/2), v from the number of frequencies in the
median. Of all frequencies the largest counts: those of a spectrum up to a frequency f exceed z = q / (2 s^2) at most as
often as W sqrt(z) independent ones, W = f sqrt(4 pi var t) (Baluev 2008).

A series is one image's residuals over time: what points do not follow with orientation known (`ResidualRows.own`), in
a stereo pair half across the epipolar line and nothing along it. Motions of the spacecraft look like turns.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_rows import ResidualRows, residual_rows
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import IMAGE
from mgsgraph.record import Record
from mgsgraph.text import some
from mgsgraph.workers import Count, no_progress

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
    """(k,) of `ResidualRows`: line (pitch, yaw) or sample (roll) of each."""
    times: Array
    """(k,) s from the middle of the first and last."""
    moves: Array
    """(k,) px per px of amplitude: 1, or of a yaw the place between the edges."""
    shares: Array
    """(k,) of such a move that is left in the ray's own residual."""
    weights: Array
    """(k,) per px^2."""

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
    """All r rows, and series of those of rays."""

    rows: ResidualRows
    """Of all points."""
    values: Array
    """(r,) px, measured minus predicted, of rays; else 0."""
    series: tuple[Series, ...]
    """Three for each image with rays enough."""

    def shown(self, one: Series, moved: Array) -> Array:
        """(r,) px, what residuals show of rays of a series that lie off by `moved` (k,) px."""
        off, scale, own = np.zeros(self.values.size), self.rows.scale, self.rows.own
        off[one.own] = moved * scale[one.own]
        return _pixels(self.rows, off - own @ (own.T @ off))


def _pixels(rows: ResidualRows, whitened: Array) -> Array:
    """(r,) px of whitened numbers (r,) of rays; 0 of other rows."""
    there = rows.of_kind(IMAGE)
    found = np.zeros(whitened.size)
    found[there] = whitened[there] / rows.scale[there]
    return found


def residual_series(of: Solution | Linearised, fewest: int) -> Residuals:
    """Residuals of an adjustment as series over time, of images with so many rays that took part; back-projected ones
    have no noise and don't count.

    Raises InputError where no image has as many.
    """
    at = at_solution(of) if isinstance(of, Solution) else of
    rays, rows = at.network.rays, residual_rows(at, np.arange(len(at.network.points)))
    mine = rows.of_kind(IMAGE)
    if rays.back_projected is not None:
        mine = mine[~rays.back_projected[rows.measure[mine]]]
    image = rays.image[rows.measure[mine]]
    series = [one for j in np.unique(image).tolist() for one in _of_image(rows, j, mine[image == j], fewest)]
    if not series:
        raise InputError("residuals over time", f"no image with {fewest} rays that took part", "ties matched densely")
    return Residuals(rows, _pixels(rows, rows.residuals), tuple(series))


def _of_image(rows: ResidualRows, image: int, mine: Index, fewest: int) -> Iterator[Series]:
    """Three of an image, with the rows of its rays, where these are enough."""
    one = rows.at.network.images[image]
    for turn in TURNS:
        own = mine[rows.component[mine] == (1 if turn == "roll" else 0)]
        places = rows.at.network.rays.places[rows.measure[own]]
        times = one.timing.at(places[:, 0])[0]
        if own.size < fewest or not np.ptp(times) > 0.0:
            return
        moves = 2.0 * places[:, 1] / one.samples - 1.0 if turn == "yaw" else np.ones(own.size)
        shares = 1.0 - rows.own[own].power(2).sum(axis=1)
        middle = 0.5 * (times.min() + times.max())
        yield Series(image, one.name, turn, own, times - middle, moves, shares, rows.scale[own] ** 2)


FALSE_ALARMS = 0.01
"""Share of turns without any vibration in which one is named all the same."""
_FINE = 6.0
"""Frequencies per reciprocal of the time that an image takes."""
_ZOOM = 41
"""Places tried about a peak."""
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



BLIND = 0.01
"""Share of a move, on the average, below which residuals count as not showing it: what they show then is of other
turns, or nothing."""
_FEWEST = 60
"""Rays of an image without which nothing is asked."""
_MOST_NAMED = 12
_ALIKE = 0.5
"""Share of a vibration's test that it has elsewhere, where it may be as well."""
_TRACE, _NEAR = 0.25, 2.0
"""Of the test of a vibration: what is less sure, of the same turn, and nearer than so many reciprocals of the time, is
a trace of it: of an amplitude that isn't quite constant, or of two images' vibrations, whose times run otherwise."""


@dataclass(frozen=True, slots=True)
class Vibration(Record):
    """A vibration that residuals show."""

    image: str
    """Whose residuals show it best."""
    turn: str
    """pitch (lines), roll (samples) or yaw (lines, by the sample)."""
    frequency: float
    """Hz."""
    frequency_sigma: float
    """Hz."""
    amplitude: float
    """px, were it of this image alone; of a yaw at the image's edges."""
    sigma: float
    """px, of the amplitude."""
    probability: float
    """That noise alone shows one as clear at any frequency of this image and turn."""
    alternatives: tuple[str, ...]
    """Images, with their turns, of which it may be as well, or in part: residuals don't tell."""

    @property
    def sentence(self) -> str:
        """In a sentence."""
        chance = f"p = {self.probability:.1g}" if self.probability > 1e-12 else "p < 1e-12"
        way = {"pitch": "along lines", "roll": "along samples", "yaw": "along lines at the edges"}[self.turn]
        digits = max(2, min(4, 1 - math.floor(math.log10(max(self.frequency_sigma, 1e-9)))))
        other = ""
        if self.alternatives:
            other = f"; or of {', '.join(self.alternatives)}, or of both: residuals show their difference alone"
        return (
            f"{self.image}: vibration of {self.frequency:.{digits}f} +- {self.frequency_sigma:.{digits}f} Hz, "
            f"{self.amplitude:.2f} +- {self.sigma:.2f} px {way} ({self.turn}, or a motion that looks the same; "
            f"{chance}){other}."
        )


@dataclass(frozen=True, slots=True)
class ImageSpectrum:
    """What residuals of one image show of one turn of its camera."""

    image: str
    """Its name."""
    turn: str
    """pitch, roll or yaw."""
    share: float
    """Of a move along it that residuals show, mean over the rays."""
    frequencies: Array
    """(f,) Hz, increasing."""
    amplitudes: Array
    """(f,) px, before anything was taken out."""
    floor: Array
    """(f,) px, rms of what noise alone shows."""
    level: Array
    """(f,) px, amplitude that counts as a vibration, of the phase found there."""
    peaks: tuple[Peak, ...]
    """Vibrations that are named here."""

    @property
    def blind(self) -> bool:
        """Whether residuals show so little of such a turn that vibrations of it stay unseen: points take them up."""
        return self.share < BLIND

    @property
    def limit(self) -> float:
        """px, amplitude from which on a vibration would be named, median over the frequencies."""
        return float(np.median(self.level))


@dataclass(frozen=True, slots=True)
class ResidualVibrations(Record):
    """All that residuals show."""

    spectra: tuple[ImageSpectrum, ...]
    """Three of each image."""
    vibrations: tuple[Vibration, ...]
    """Clearest first."""

    @property
    def sentences(self) -> list[str]:
        """Sentences: each vibration, and what would not be seen."""
        found = [one.sentence for one in self.vibrations]
        if not found:
            found = [f"No image's residuals show a vibration ({100.0 * FALSE_ALARMS:g} % false alarms per turn)."]
        blind = [f"{one.turn} of {one.image}" for one in self.spectra if one.blind and one.turn != "yaw"]
        if blind:
            found.append(
                f"Not seen would be vibrations in {some(blind, len(blind))}: points take them up as heights. To see "
                "them, give control (laser, terrain model) or a third image."
            )
        return found


def residual_vibrations(
    of: Solution | Linearised,
    false_alarms: float = FALSE_ALARMS,
    progress: Count = no_progress,
) -> ResidualVibrations:
    """Search the residuals of all images for vibrations, of which a share of `false_alarms` of calm turns has one.

    Orientation should not be able to follow the vibrations looked for (polynomials, wide nodes): what close nodes have
    followed is no longer in residuals. `progress` is called with the number of searches done, and of all at most.

    Raises InputError where no image has rays enough.
    """
    residuals = residual_series(of, _FEWEST)
    able = [SeriesSpectrum(one) for one in residuals.series]
    found = _Found(residuals, able, false_alarms)
    while len(found.waves) < _MOST_NAMED and found.next():
        progress(len(found.waves), _MOST_NAMED)
    progress(_MOST_NAMED, _MOST_NAMED)
    return ResidualVibrations(found.spectra(), tuple(found.vibrations))


class _Found:
    """Vibrations named one after another."""

    def __init__(self, residuals: Residuals, able: Sequence[SeriesSpectrum], false_alarms: float) -> None:
        self._residuals, self._able, self._false_alarms = residuals, able, false_alarms
        self._values = residuals.values
        self._first = self._fits()
        self._now = self._first
        self.vibrations = list[Vibration]()
        self.waves = list[tuple[int, Wave]]()
        """Of each the number of its search; with traces."""

    def _fits(self) -> list[WaveFits]:
        return [one.fits(self._values[one.series.own]) for one in self._able]

    def next(self) -> bool:
        """Name the surest, and take it out; False where there is none."""
        seeing = [k for k, one in enumerate(self._able) if one.series.share >= BLIND]
        best = min(seeing, key=lambda k: self._now[k].probability, default=-1)
        if best < 0 or self._now[best].probability > self._false_alarms:
            return False
        one = self._able[best]
        wave = one.wave(self._values[one.series.own], self._now[best])
        trace = any(self._traces(one, wave, *before) for before in self.waves)
        near = [each.near(wave.peak.frequency, one.resolution) for each in self._now]
        self._values = self._values - self._residuals.shown(one.series, wave.moved)
        self._now = self._fits()
        # what was as clear in another image, and has gone with it, may as well be that image's
        alike = tuple(
            f"{self._able[k].series.name} ({self._able[k].series.turn})" for k in seeing
            if self._able[k].series.image != one.series.image and near[k] > _ALIKE * near[best]
            and self._now[k].near(wave.peak.frequency, one.resolution) < _TRACE * near[k]
        )  # fmt: skip
        self.waves.append((best, wave))
        if not trace:
            self.vibrations.append(_vibration(one.series, wave.peak, alike))
        return True

    def _traces(self, one: SeriesSpectrum, wave: Wave, number: int, before: Wave) -> bool:
        """Whether a wave is a trace of one that was named before it."""
        near = abs(wave.peak.frequency - before.peak.frequency) < _NEAR * one.resolution
        same = self._able[number].series.turn == one.series.turn
        return near and same and wave.peak.test < _TRACE * before.peak.test

    def spectra(self) -> tuple[ImageSpectrum, ...]:
        """Before anything was taken out."""
        named = {(one.image, one.turn, one.frequency) for one in self.vibrations}
        return tuple(
            _spectrum(one, self._first[k], [wave.peak for j, wave in self.waves if j == k], named, self._false_alarms)
            for k, one in enumerate(self._able)
        )


def _vibration(series: Series, peak: Peak, alternatives: tuple[str, ...]) -> Vibration:
    spread = math.sqrt(3.0) * peak.sigma / (math.pi * series.duration * peak.amplitude)
    return Vibration(
        series.name, series.turn, peak.frequency, spread, peak.amplitude, peak.sigma, peak.probability, alternatives
    )


def _spectrum(
    one: SeriesSpectrum, fits: WaveFits, peaks: Sequence[Peak], named: set[tuple[str, str, float]], false_alarms: float
) -> ImageSpectrum:
    amplitudes, (image, turn) = np.hypot(*fits.values.T), (one.series.name, one.series.turn)
    needed = level_of_test(false_alarms, one.width, fits.freedom)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.where(fits.tests > 0.0, amplitudes * np.sqrt(needed / fits.tests), np.inf)
    floor = np.sqrt(fits.floor * np.trace(fits.covariance, axis1=1, axis2=2))
    mine = tuple(peak for peak in peaks if (image, turn, peak.frequency) in named)
    return ImageSpectrum(image, turn, one.series.share, one.grid, amplitudes, floor, level, mine)
