"""Spectrum of a strip's corrections: what vibrates in its orientation, how strongly, and what noise alone would show.

At each frequency a sine and a cosine are fitted to the corrections of one axis by least squares, together with a bias
and a drift (Lomb 1976; Zechmeister & Kuerster 2009 with the mean), weighted by the corrections' own covariance; nodes
need not be even. The fit knows how much of a vibration the adjustment lets through (`series`), so that amplitudes are
those of the spacecraft. Noise is carried through the same fit: its covariance gives the *floor*, the rms amplitude that
noise alone shows there. A fit's two numbers, divided by their covariance, are chi-square with two degrees of freedom
under noise alone, which exceeds q with probability exp(-q / 2). Of many frequencies the largest counts: some number M
of them is as good as independent, and that of the least significant vibration found follows from 1 - (1 - e^(-q/2))^M.
M is taken from simulated noise of the same covariance.

Peaks are named one by one: the strongest is fitted, and what is left is searched again, so that the side lobes of a
strong one are none. Where the prior expects departures from bias and drift (Gauss-Markov), these are real and stand
above the noise at low frequencies; a peak says whether it is more than they explain. Vibrations faster than the Nyquist
limit of the nodes' spacing don't vanish: they appear below it, folded, weakened as far as the basis smoothes them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.analysis.spacing.corrections import AXES, CorrectionSeries
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen

FALSE_ALARMS = 0.01
"""Share of axes without any vibration in which a peak is named all the same."""
FINE = 6.0
"""Frequencies per reciprocal of the time that a pass, or an image, takes."""
_MOST_PEAKS = 5
_DRAWS = 1000
"""Of noise, for the number of independent frequencies."""
_TAIL = 0.9
"""Quantile of their largest from which it is taken."""
ZOOM = 41
"""Places on either side of a peak where its frequency is looked for."""
_CHUNK = 1 << 22
_LEAKS, _LEAKS_NEAR, _NEAR = 0.05, 0.25, 2.0
"""Of the chi-square of a strip's surest vibration: what is less sure in the same strip, or nearer to it than so many
reciprocals of the strip's time and less sure than so much, may be what the basis can't follow of that one, or what the
prior doesn't allow it."""


@dataclass(frozen=True, slots=True)
class Peak:
    """A vibration of the camera: a peak of the spectrum."""

    frequency: float
    """Hz."""
    amplitude: float
    """m or rad."""
    sigma: float
    """m or rad, of the amplitude; with what the prior expects there, too."""
    test: float
    """Chi-square of two degrees of freedom, were it noise."""
    probability: float
    """That noise alone shows one like it at any frequency."""
    beyond_prior: bool
    """Whether it is more than the departures that the prior expects; True, too, where it expects none."""
    echo_of: str = ""
    """Axis of the strip to which the same vibration belongs, or a much stronger one that this may be a trace of; empty
    for none. The amplitude is what it would be if all of it were of this axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Amplitudes of one axis of a strip over frequency."""

    strip: str
    """Its name."""
    axis: str
    """Which of the six."""
    unit: str
    """m or rad."""
    frequencies: Array
    """(f,) Hz, increasing."""
    amplitudes: Array
    """(f,) m or rad."""
    floor: Array
    """(f,) the same, rms of what noise alone shows."""
    level: Array
    """(f,) amplitude that counts as a vibration, of the phase found there."""
    wander: Array
    """(f,) rms of what noise and the departures that the prior expects show together; NaN where it expects none."""
    nyquist: float
    """Hz, half the reciprocal of the nodes' mean spacing."""
    independent: float
    """M, frequencies that are as good as independent."""
    peaks: tuple[Peak, ...]
    """From the strongest test on."""

    def __post_init__(self) -> None:
        count = np.size(self.frequencies)
        for name in ("frequencies", "amplitudes", "floor", "level"):
            assign(self, **{name: frozen(getattr(self, name), f"spectrum, {name}", (count,))})

    @property
    def vibrations(self) -> list[Peak]:
        """Peaks that neither noise nor the prior's departures nor another axis explain, the largest first."""
        mine = [peak for peak in self.peaks if peak.beyond_prior and not peak.echo_of]
        return sorted(mine, key=lambda one: -one.amplitude)


def spectra(series: CorrectionSeries) -> list[Spectrum]:
    """Spectrum of each of the six axes; of a vibration that shows in several, the peaks say to which it belongs.

    Rays hardly tell pitch from a motion along the track, nor roll from one across it: both explain them as well. The
    prior does: a vibration belongs to the axis where it is surest once the square of its amplitude in units of what
    the prior expects there is taken off.
    """
    found = [spectrum(series, axis) for axis in range(len(AXES))]
    resolution = 1.0 / float(np.ptp(series.times))
    known = dict(zip(AXES, series.known.tolist(), strict=True))
    every = [(peak, one.axis) for one in found for peak in one.peaks]

    def evidence(peak: Peak, axis: str) -> float:
        return float(peak.test - (peak.amplitude / known[axis]) ** 2)

    def owner(peak: Peak, axis: str) -> str:
        same = [(evidence(other, of), of) for other, of in every if abs(other.frequency - peak.frequency) < resolution]
        if (best := max(same)[1]) != axis:
            return best
        strong = [(evidence(other, of), of) for other, of in every if other.beyond_prior and leaks(other, peak)]
        return max(strong)[1] if strong else ""

    def leaks(strong: Peak, peak: Peak) -> bool:
        near = abs(strong.frequency - peak.frequency) < _NEAR * resolution
        return peak.test < (_LEAKS_NEAR if near else _LEAKS) * strong.test

    return [
        replace(one, peaks=tuple(replace(peak, echo_of=owner(peak, one.axis)) for peak in one.peaks)) for one in found
    ]


def spectrum(series: CorrectionSeries, axis: int, false_alarms: float = FALSE_ALARMS) -> Spectrum:
    """Spectrum of one axis.

    Parameters
    ----------
    series : CorrectionSeries
        Corrections of a strip with their errors.
    axis : int
        Number in `AXES`.
    false_alarms : float
        Share of spectra of noise alone in which a peak is named.
    """
    if not 0.0 < false_alarms < 0.5:
        raise InputError("spectrum, false alarms", f"{false_alarms}", "more than 0 and less than 0.5")
    white = _WhitenedAxis.of(series, axis)
    grid = white.grid()
    fits = white.fits(grid, [])
    independent = white.independent(fits)
    limit = -2.0 * math.log(-math.expm1(math.log1p(-false_alarms) / independent))
    amplitudes = np.linalg.norm(fits.values, axis=1)
    return Spectrum(
        strip=series.strip,
        axis=AXES[axis],
        unit="m" if axis < 3 else "rad",
        frequencies=grid,
        amplitudes=amplitudes,
        floor=np.sqrt(np.trace(fits.noise, axis1=1, axis2=2)),
        level=amplitudes * np.sqrt(limit / fits.tests),
        wander=np.full(grid.size, np.nan) if fits.wander is None else np.sqrt(np.trace(fits.wander, axis1=1, axis2=2)),
        nyquist=white.nyquist,
        independent=independent,
        peaks=tuple(_peaks(white, grid, limit, independent)),
    )


def _peaks(white: "_WhitenedAxis", grid: Array, limit: float, independent: float) -> list[Peak]:
    """Strongest first; each is searched for in what those before it leave."""
    found, tests = list[float](), list[float]()
    apart = 1.0 / float(np.ptp(white.times))  # closer ones can't be told from one
    while len(found) < min(_MOST_PEAKS, (white.times.size - 4) // 4):
        free = grid[np.all(np.abs(grid[:, None] - np.array(found)) >= apart, axis=1)]
        if not free.size:
            break
        fits = white.fits(free, found)
        best = int(np.argmax(fits.tests))
        if not fits.tests[best] > limit:
            break
        step = float(grid[1] - grid[0])
        near = free[best] + step * np.linspace(-1.0, 1.0, ZOOM)
        near = near[(near >= grid[0]) & (near <= grid[-1])]
        close = white.fits(near, found)
        place = int(np.argmax(close.tests))
        found.append(float(near[place]))
        tests.append(float(close.tests[place]))
    return [white.peak(found, k, test, limit, independent) for k, test in enumerate(tests)]


@dataclass(frozen=True, slots=True, eq=False)
class _Fits:
    """Fits of cosine and sine at several frequencies."""

    values: Array
    """(f, 2) amounts of either."""
    noise: Array
    """(f, 2, 2) their covariance under noise alone."""
    wander: Array | None
    """(f, 2, 2) the same with what the prior expects."""
    weights: Array
    """(f, 2, k) what they are of whitened corrections."""

    @property
    def tests(self) -> Array:
        """(f,) chi-square of two degrees of freedom under noise alone."""
        return _squares(self.values, self.noise)


@dataclass(frozen=True, slots=True, eq=False)
class _WhitenedAxis:
    """One axis of a series, whitened by the covariance of its errors."""

    times: Array
    """(k,) s from its middle."""
    root: Array
    """(k, k) L of the covariance L L'."""
    values: Array
    """(k,) L^-1 times the corrections."""
    response: Array
    """(k, k) L^-1 times the response."""
    noise: Array
    """(k, k) of the whitened corrections under noise alone."""
    wander: Array | None
    """(k, k) the same with what the prior expects."""

    @classmethod
    def of(cls, series: CorrectionSeries, axis: int) -> "_WhitenedAxis":
        if series.times.size < 8:
            found = f"{series.times.size} orientation images"
            raise InputError(f"strip {series.strip!r}, spectrum", found, "at least 8", "a smaller spacing")
        covariance = series.axis(series.covariance, axis)
        if not np.all(np.diagonal(covariance) > 0.0):
            raise InputError(f"strip {series.strip!r}, spectrum", "nodes without sigma", "an adjusted strip")
        root: Array = np.asarray(np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diagonal(covariance))))
        noise = _white(series.axis(series.noise, axis), root)
        wander = None
        if series.wander is not None:
            shown = series.response @ series.wander @ series.response.T
            wander = noise + _white(series.axis(shown, axis), root)
        times = series.times - 0.5 * (series.times[0] + series.times[-1])
        values: Array = np.asarray(np.linalg.solve(root, series.values[:, axis]))
        response: Array = np.asarray(np.linalg.solve(root, series.axis(series.response, axis)))
        return cls(times, root, values, response, noise, wander)

    @property
    def nyquist(self) -> float:
        """Largest frequency in Hz that the times resolve on the average."""
        return 0.5 * (self.times.size - 1) / float(np.ptp(self.times))

    def grid(self) -> Array:
        """Frequencies, Hz, from one period over the whole time to where cosine and sine are two things still."""
        once = 1.0 / float(np.ptp(self.times))
        return np.arange(once, self.nyquist - 0.5 * once, once / FINE)

    def waves(self, frequencies: Array) -> Array:
        """(f, k, 2) cosine and sine as the whitened corrections show them."""
        phase = 2.0 * np.pi * frequencies[:, None] * self.times
        return np.asarray(self.response @ np.stack([np.cos(phase), np.sin(phase)], axis=2))

    def fits(self, frequencies: Array, beside: list[float]) -> _Fits:
        """At each frequency (f,), together with bias, drift and the waves that are known already."""
        plain = np.stack([np.ones_like(self.times), self.times / float(np.ptp(self.times))], axis=1)
        known = [np.linalg.solve(self.root, plain), *self.waves(np.array(beside))]
        basis, _ = np.linalg.qr(np.hstack(known))
        waves = self.waves(frequencies)
        waves = waves - basis @ (basis.T @ waves)
        turned = np.swapaxes(waves, 1, 2)
        normal = turned @ waves
        size = np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        weights = np.linalg.solve(normal + 1e-9 * size, turned)  # a wave that is known already leaves nothing
        noise = weights @ self.noise @ np.swapaxes(weights, 1, 2)
        wander = None if self.wander is None else weights @ self.wander @ np.swapaxes(weights, 1, 2)
        return _Fits(weights @ self.values, noise, wander, weights)

    def independent(self, fits: _Fits) -> float:
        """Number of frequencies that are as good as independent, from the largest tests of simulated noise."""
        values, axes = np.linalg.eigh(self.noise)
        rng = np.random.default_rng(0)
        draws = axes @ (np.sqrt(np.maximum(values, 0.0))[:, None] * rng.standard_normal((values.size, _DRAWS)))
        roots = np.linalg.inv(np.linalg.cholesky(_regular(fits.noise))) @ fits.weights
        largest = np.zeros(_DRAWS)
        step = max(_CHUNK // (2 * _DRAWS), 1)
        for first in range(0, roots.shape[0], step):
            tests = np.sum((roots[first : first + step] @ draws) ** 2, axis=1)
            largest = np.maximum(largest, tests.max(axis=0))
        high = float(np.quantile(largest, _TAIL))
        return max(math.log(_TAIL) / math.log1p(-math.exp(-0.5 * high)), 1.0)

    def peak(self, frequencies: list[float], which: int, test: float, limit: float, independent: float) -> Peak:
        """One of the waves that are known, fitted together with the others."""
        others = [one for k, one in enumerate(frequencies) if k != which]
        fit = self.fits(np.array([frequencies[which]]), others)
        spread = fit.noise if fit.wander is None else fit.wander
        amplitude = float(np.linalg.norm(fit.values[0]))
        along = fit.values[0] / amplitude
        return Peak(
            frequency=frequencies[which],
            amplitude=amplitude,
            sigma=float(np.sqrt(along @ spread[0] @ along)),
            test=test,
            probability=-math.expm1(independent * math.log1p(-math.exp(-0.5 * test))),
            beyond_prior=bool(_squares(fit.values, spread)[0] > limit),
        )


def _white(covariance: Array, root: Array) -> Array:
    half = np.linalg.solve(root, covariance)
    return np.asarray(np.linalg.solve(root, half.T))


def _regular(matrices: Array) -> Array:
    """Covariances (f, 2, 2) that have an inverse, whatever rounding did to them."""
    return np.asarray(matrices + 1e-12 * np.trace(matrices, axis1=1, axis2=2)[:, None, None] * np.eye(2))


def _squares(values: Array, covariances: Array) -> Array:
    """(f,) values (f, 2), divided by their covariances."""
    solved = np.linalg.solve(_regular(covariances), values[:, :, None])[:, :, 0]
    return np.asarray(np.sum(values * solved, axis=1))
