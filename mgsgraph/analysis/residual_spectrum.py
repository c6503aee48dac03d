"""Residuals of image rays over time, their spectra, and the vibrations that these show.

At each frequency a cosine and a sine of a turn are fitted to an image's residuals by least squares (Lomb 1976),
together with a polynomial of time, most of which any adjustment has taken up; rays need not be even in time. The fit
knows what share of a move points leave in each residual (`residual_series`). Sums over rays are fast Fourier transforms
of sums over short bins of time (Press & Rybicki 1989).

The surest frequency is then judged without these shortcuts: by the drop of the cost that its cosine and sine, added to
the adjustment's linear model, bring about, q = v' G (G' C G)^-1 G' v with the covariance C of all residuals
(`ResidualRows`). Amplitudes are those of the camera. What G' C G has less than a hundredth of G' G is not seen at all.

Neighbouring rays have errors in common, and how large errors are is seldom well known: so the floor is taken from the
spectrum itself, as the median of the test over the frequencies round about. Against it a test is F with two degrees of
freedom above, exceeding q / s^2 by chance with (1 + q / (s^2 v))^(-v/2), v from the number of frequencies in the
median. Of all frequencies the largest counts: those of a spectrum up to a frequency f exceed z = q / (2 s^2) at most as
often as W sqrt(z) independent ones, W = f sqrt(4 pi var t) (Baluev 2008). Motions of the spacecraft look like turns.
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
from mgsgraph.errors import require
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.kernel.rows import IMAGE
from mgsgraph.record import Record
from mgsgraph.text import some

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
    def duration(self) -> float:
        """s, from the first to the last ray."""
        return float(np.ptp(self.times))

    def waves(self, frequencies: Array) -> Array:
        """(k, 2 f) px, moves by cosines, then by sines, of frequencies (f,) in Hz and of 1 px."""
        phase = 2.0 * np.pi * self.times[:, None] * frequencies
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1) * self.moves[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """A wave of a camera, added to the adjustment's linear model."""

    frequency: float
    """Hz."""
    values: Array
    """(2,) px, cosine and sine."""
    normal: Array
    """(2, 2) per px^2: G' C G."""
    drop: float
    """Of twice the cost, by it."""
    share: float
    """Of it that residuals show."""
    shown: Array
    """(r,) px, what residuals show of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """All r rows, and series of those of rays."""

    rows: ResidualRows
    """Of all points."""
    values: Array
    """(r,) px, measured minus predicted, of rays; else 0."""
    series: tuple[Series, ...]
    """Three for each image with rays enough."""

    def shown(self, series: Series, moved: Array) -> Array:
        """(r,) px, what residuals show of rays of a series that lie off by `moved` (k,) px."""
        return _pixels(self.rows, self.rows.explained(series.own, (self.rows.scale[series.own] * moved)[:, None])[:, 0])

    def share(self, series: Series, frequencies: Array) -> float:
        """Of waves of a series, what neither points nor shared unknowns follow: mean over frequencies (f,) in Hz."""
        columns = self.rows.scale[series.own, None] * series.waves(frequencies)
        total = float(np.sum(columns**2))
        return float(np.trace(self.rows.variance(series.own, columns))) / total if total > 0.0 else 0.0

    def wave(self, series: Series, frequencies: Array, residuals: Array) -> Wave:
        """Of a series, fitted to residuals (r,) in px by their covariance: the clearest of frequencies (f,) in Hz."""
        waves, f = series.waves(frequencies), frequencies.size
        columns = self.rows.scale[series.own, None] * waves
        normal = np.einsum("ifjf->fij", self.rows.variance(series.own, columns).reshape(2, f, 2, f))
        right = ((series.weights * residuals[series.own]) @ waves).reshape(2, f).T
        values = np.einsum("fij,fj->fi", _inverse_normal(normal), right)
        drops = np.einsum("fi,fi->f", values, right)
        k = int(np.argmax(drops))
        share = float(np.trace(normal[k]) / np.sum(columns[:, k::f] ** 2))
        shown = self.shown(series, waves[:, k::f] @ values[k])
        return Wave(float(frequencies[k]), values[k], normal[k], float(drops[k]), share, shown)


def _pixels(rows: ResidualRows, whitened: Array) -> Array:
    """(r,) px of whitened numbers (r,) of rays; 0 of other rows."""
    of_rays = rows.of_kind(IMAGE)
    pixels = np.zeros(whitened.size)
    pixels[of_rays] = whitened[of_rays] / rows.scale[of_rays]
    return pixels


def residual_series(of: Solution | Linearised, fewest: int) -> Residuals:
    """Residuals of an adjustment as series over time, of images with so many rays that took part, back-projected ones
    left out; InputError where no image has as many.
    """
    at = at_solution(of) if isinstance(of, Solution) else of
    rays, rows = at.network.rays, residual_rows(at, np.arange(len(at.network.points)))
    of_rays = rows.of_kind(IMAGE)
    if rays.back_projected is not None:
        of_rays = of_rays[~rays.back_projected[rows.measure[of_rays]]]
    image = rays.image[rows.measure[of_rays]]
    series = [of_turn for j, seen in by_value(image) for of_turn in _of_image(rows, j, of_rays[seen], fewest)]
    require(series, "residuals over time", f"no image with {fewest} rays that took part", "ties matched densely")
    return Residuals(rows, _pixels(rows, rows.residuals), tuple(series))


def _of_image(rows: ResidualRows, image: int, members: Index, fewest: int) -> Iterator[Series]:
    """Three of an image, with the rows of its rays, where these are enough."""
    picture = rows.at.network.images[image]
    for turn in TURNS:
        chosen = members[rows.component[members] == (1 if turn == "roll" else 0)]
        places = rows.at.network.rays.places[rows.measure[chosen]]
        times = picture.timing.at(places[:, 0])[0]
        if chosen.size < fewest or not np.ptp(times) > 0.0:
            return
        moves = 2.0 * places[:, 1] / picture.samples - 1.0 if turn == "yaw" else np.ones(chosen.size)
        shares = 1.0 - rows.own[chosen].power(2).sum(axis=1)
        middle = 0.5 * (times.min() + times.max())
        yield Series(image, picture.name, turn, chosen, times - middle, moves, shares, rows.scale[chosen] ** 2)


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
_LEAST = 1e-12
"""Of a test, its floor: residuals may have no noise."""
_SAMPLED = 8
"""Frequencies over which the share that residuals show is taken."""
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
    """Drop of the cost over the floor: chi-square of two degrees of freedom, were it noise."""
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
        return float(max(self.tests[np.abs(self.frequencies - frequency) < resolution], default=0.0))


class SeriesSpectrum:
    """Spectra of one series."""

    def __init__(self, series: Series) -> None:
        self.series = series
        self.resolution = once = 1.0 / series.duration
        highest = max(min(series.times.size / _PER_WAVE, _MOST_FREQUENCIES), 2.0 * _LOWEST)
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
        transform = np.fft.rfft(binned)[numbers] * np.exp(-2j * np.pi * numbers * ahead)
        return np.stack([transform.real, -transform.imag], axis=1)

    def _normal(self) -> Array:
        """(f, 2, 2) of cosine and sine, less what polynomials of time take up."""
        squares = self._root**2
        double = self._transformed(squares, 2 * self._numbers)
        normal = np.empty((self.grid.size, 2, 2))
        normal[:, 0, 0], normal[:, 1, 1] = 0.5 * (squares.sum() + double[:, 0]), 0.5 * (squares.sum() - double[:, 0])
        normal[:, 0, 1] = normal[:, 1, 0] = 0.5 * double[:, 1]
        beside = np.stack([self._transformed(self._root * column, self._numbers) for column in self._basis.T], axis=2)
        return np.asarray(normal - beside @ beside.mT)

    def _floor(self, tests: Array) -> tuple[Array, float]:
        """(f,) running median of the tests over that of chi-square with two degrees of freedom, and its own freedom."""
        from scipy.ndimage import median_filter  # slow to import

        size = min(2 * round(_ROUND_ABOUT * _FINE) + 1, tests.size)
        floor = median_filter(tests, size=size, mode="reflect") / (2.0 * math.log(2.0))
        freedom = max(2.0 * _EFFICIENCY * size / _FINE, 4.0)
        return np.maximum(floor, max(_LEAST * float(tests.max()), np.finfo(np.float64).tiny)), freedom

    def peak(self, wave: Wave, rest: Array) -> Peak:
        """How sure a wave is, by the floor of the residuals (k,) in px that it leaves."""
        fits, at = self.fits(rest), int(np.argmin(np.abs(self.grid - wave.frequency)))
        # the floor is of tests that count what points follow alone, the drop counts all unknowns
        counted = 0.5 * float(np.trace(fits.covariance[at] @ wave.normal))
        floor = max(float(fits.floor[at]) / counted, _LEAST * wave.drop)
        amplitude, test = float(np.hypot(*wave.values)), wave.drop / floor
        along = wave.values / amplitude
        sigma = math.sqrt(floor * float(along @ _inverse_normal(wave.normal[None])[0] @ along))
        return Peak(wave.frequency, amplitude, sigma, test, chance(test, self.width, fits.freedom))


def _inverse_normal(normal: Array) -> Array:
    """Covariances (f, 2, 2) of normal equations (f, 2, 2), finite where these say nothing."""
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    return np.asarray(np.linalg.inv(normal + (1e-9 * size + 1e-12) * np.eye(2)))


def chance(test: float, width: float, freedom: float) -> float:
    """Probability that noise alone shows a test as large at any frequency (Baluev 2008; the floor has few degrees)."""
    single = math.exp(-0.5 * freedom * math.log1p(test / freedom))
    return -math.expm1((1.0 + width * math.sqrt(0.5 * test)) * math.log1p(-min(single, 1.0 - 1e-15)))


def level_of_test(probability: float, width: float, freedom: float) -> float:
    """The test that noise alone exceeds at any frequency with a probability."""
    from scipy.optimize import brentq  # slow to import

    return float(brentq(lambda test: chance(test, width, freedom) - probability, 0.0, 1e9, xtol=1e-12))


BLIND = 0.01
"""Share of a wave below which residuals count as not showing it: what they show then is of other turns, or nothing."""
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
        note = ""
        if self.alternatives:
            note = f"; or of {', '.join(self.alternatives)}, or of both: residuals show their difference alone"
        return (
            f"{self.image}: vibration of {self.frequency:.{digits}f} +- {self.frequency_sigma:.{digits}f} Hz, "
            f"{self.amplitude:.2f} +- {self.sigma:.2f} px {way} ({self.turn}, or a motion that looks the same; "
            f"{chance}){note}."
        )


@dataclass(frozen=True, slots=True)
class ImageSpectrum:
    """What residuals of one image show of one turn of its camera."""

    image: str
    """Its name."""
    turn: str
    """pitch, roll or yaw."""
    share: float
    """Of waves along it that residuals show, mean over frequencies."""
    frequencies: Array
    """(f,) Hz, increasing."""
    amplitudes: Array
    """(f,) px, before anything was taken out; like floor and level empty where it is blind."""
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
    def limit(self) -> float | None:
        """px, amplitude from which on a vibration would be named, median over the frequencies; None where blind."""
        return None if self.blind else float(np.median(self.level))


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
        lines = [vibration.sentence for vibration in self.vibrations]
        if not lines:
            lines = [f"No image's residuals show a vibration ({100.0 * FALSE_ALARMS:g} % false alarms per angle)."]
        blind = [f"{entry.turn} of {entry.image}" for entry in self.spectra if entry.blind and entry.turn != "yaw"]
        if blind:
            lines.append(f"Vibrations not tested: {some(blind)} (heights of points absorb them).")
        return lines


def residual_vibrations(of: Solution | Linearised, false_alarms: float = FALSE_ALARMS) -> ResidualVibrations:
    """Search the residuals of all images for vibrations, of which a share of `false_alarms` of calm turns has one.

    What close orientation images have followed is no longer in residuals. Raises InputError where no image has rays
    enough.
    """
    residuals = residual_series(of, _FEWEST)
    able = [SeriesSpectrum(series) for series in residuals.series]
    search = _Search(residuals, able, false_alarms)
    while len(search.waves) < _MOST_NAMED and search.next():
        pass
    return ResidualVibrations(tuple(map(search.spectrum, range(len(able)))), tuple(search.vibrations))


class _Search:
    """Vibrations named one after another."""

    def __init__(self, residuals: Residuals, able: Sequence[SeriesSpectrum], false_alarms: float) -> None:
        self._residuals, self._able, self._false_alarms = residuals, able, false_alarms
        self._values = residuals.values
        sampled = [np.linspace(spectrum.grid[0], spectrum.grid[-1], _SAMPLED) for spectrum in able]
        self._shares = [residuals.share(spectrum.series, at) for spectrum, at in zip(able, sampled, strict=True)]
        self._seeing = [k for k, share in enumerate(self._shares) if share >= BLIND]
        self._searched = set(self._seeing)
        self._first = self._now = self._fits()
        self.vibrations = list[Vibration]()
        self.waves = list[tuple[int, Peak, bool]]()
        """Of each the number of its search, and whether it is named: traces are not."""

    def _fits(self) -> dict[int, WaveFits]:
        return {k: self._able[k].fits(self._values[self._able[k].series.own]) for k in self._seeing}

    def next(self) -> bool:
        """Name the surest and take it out, or search its series no more; False where there is none."""
        best = min(self._searched, key=lambda k: self._now[k].probability, default=-1)
        if best < 0 or self._now[best].probability > self._false_alarms:
            return False
        spectrum, fits = self._able[best], self._now[best]
        near = fits.frequencies[np.argmax(fits.tests)] + spectrum.resolution / _FINE * np.linspace(-1.0, 1.0, _ZOOM)
        wave = self._residuals.wave(spectrum.series, near, self._values)
        rest = self._values - wave.shown
        if wave.share >= BLIND and self._confirmed(best, peak := spectrum.peak(wave, rest[spectrum.series.own])):
            self._take_out(best, peak, rest)
        else:
            self._searched.discard(best)
        return True

    def _confirmed(self, number: int, peak: Peak) -> bool:
        """Whether the cost drops enough, no frequency recurs and no amplitude grows."""
        before, near = [each for k, each, _ in self.waves if k == number], self._able[number].resolution
        recurs = any(abs(each.frequency - peak.frequency) < near for each in before)
        grows = any(each.amplitude < peak.amplitude for each in before[-1:])
        return peak.probability <= self._false_alarms and not recurs and not grows

    def _take_out(self, best: int, peak: Peak, rest: Array) -> None:
        """Leave residuals (r,) px, and name what is no trace of another."""
        spectrum, before = self._able[best], self._now
        near = {k: before[k].near(peak.frequency, spectrum.resolution) for k in self._seeing}
        self._values = rest
        self._now = self._fits()
        # what was as clear in another image, and has gone with it, may as well be that image's
        alternatives = tuple(
            f"{self._able[k].series.name} ({self._able[k].series.turn})" for k in self._seeing
            if self._able[k].series.image != spectrum.series.image and near[k] > _ALIKE * near[best]
            and self._now[k].near(peak.frequency, spectrum.resolution) < _TRACE * near[k]
        )  # fmt: skip
        # beside a clearer one of the same turn it is a trace of that
        trace = any(
            abs(peak.frequency - each.frequency) < _NEAR * spectrum.resolution and peak.test < _TRACE * each.test
            for k, each, _ in self.waves if self._able[k].series.turn == spectrum.series.turn
        )  # fmt: skip
        if not trace:
            self.vibrations.append(_vibration(spectrum.series, peak, alternatives))
        self.waves.append((best, peak, not trace))

    def spectrum(self, number: int) -> ImageSpectrum:
        """Of a series, before anything was taken out."""
        searched, none = self._able[number], np.zeros(0)
        what = searched.series.name, searched.series.turn, self._shares[number], searched.grid
        if number not in self._first:
            return ImageSpectrum(*what, none, none, none, ())
        fits = self._first[number]
        amplitudes, needed = np.hypot(*fits.values.T), level_of_test(self._false_alarms, searched.width, fits.freedom)
        floor = np.sqrt(fits.floor * np.trace(fits.covariance, axis1=1, axis2=2))
        level = floor.copy()  # of any phase, where none was found
        np.divide(amplitudes, np.sqrt(fits.tests), out=level, where=fits.tests > 0.0)
        peaks = tuple(peak for k, peak, named in self.waves if k == number and named)
        return ImageSpectrum(*what, amplitudes, floor, level * math.sqrt(needed), peaks)


def _vibration(series: Series, peak: Peak, alternatives: tuple[str, ...]) -> Vibration:
    spread = math.sqrt(3.0) * peak.sigma / (math.pi * series.duration * peak.amplitude)
    values = peak.frequency, spread, peak.amplitude, peak.sigma, peak.probability
    return Vibration(series.name, series.turn, *values, alternatives)
