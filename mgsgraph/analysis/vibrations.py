"""Vibrations that residuals of image rays show, for any camera: frequency, amplitude in pixels, and how sure each is
(`residual_spectrum`).

The surest vibration of all images is named, what it makes residuals of all images show is taken out, and
what is left is searched again. What has gone with it in another image can't be told from it: two images show the
difference of their vibrations, not either.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.residual_spectrum import (
    FALSE_ALARMS,
    Peak,
    Residuals,
    Series,
    SeriesSpectrum,
    Wave,
    WaveFits,
    level_of_test,
    residual_series,
)
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record
from mgsgraph.text import some

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
    progress: Callable[[int, int], None] = lambda _done, _most: None,
) -> ResidualVibrations:
    """Search the residuals of all images for vibrations.

    Parameters
    ----------
    of : Solution or Linearised
        With orientation that can't follow the vibrations looked for (polynomials, wide nodes): what close nodes have
        followed is no longer in residuals.
    false_alarms : float
        Share of images and turns without any vibration in which one is named.
    progress : callable
        Called with the number of searches done, and of all at most.

    Raises
    ------
    InputError
        Where no image has rays enough.
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
        return [one.fits(self._values[one.series.own, one.series.component]) for one in self._able]

    def next(self) -> bool:
        """Name the surest, and take it out; False where there is none."""
        seeing = [k for k, one in enumerate(self._able) if one.series.share >= BLIND]
        best = min(seeing, key=lambda k: self._now[k].probability, default=-1)
        if best < 0 or self._now[best].probability > self._false_alarms:
            return False
        one = self._able[best]
        wave = one.wave(self._values[one.series.own, one.series.component], self._now[best])
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
