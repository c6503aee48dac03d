"""What an adjustment cannot explain, by name: tests of its residuals against time, sample, slope and height, along
profiles, and of near points against each other.

Each effect has a score test (`residual_rows`), exact whatever the residuals' correlations are. A family of effects at
one place counts as many tests as it has hypotheses (Bonferroni), and all families together share one probability of a
false alarm, `LEVEL` for a whole run. The clearest effect is named, its share is taken out of the residuals and of their
covariance, and the rest is tested again: what it had brought about elsewhere goes with it.

Errors that are simply larger than stated would look like every effect at once. So each test is held against Fisher's
law, too, with the scatter of the residuals of the same points, and the larger p-value counts.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.correlated import correlations
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_rows import ResidualRows, residual_rows
from mgsgraph.analysis.systematic import EffectKind, Family, Hypothesis, families
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network

LEVEL = 0.01
"""Probability that a run on good data names anything."""
_MOST_NAMED = 12
"""Effects after which the search ends."""
_MOST_POINTS = 20_000
"""Points whose rows are tested; of a larger network some of each image and profile."""
_PER_OWNER = 1000, 100
"""Of each image and profile at most, and where these are many at least."""
_SHOWN = 1e-3
"""Share of an effect that residuals have to show: below, it is absorbed by the unknowns."""
_ALIKE = 0.8
"""Share of the named effect's test from which on another, which is gone with it, can't be told apart from it."""
_LEAST_REST = 1e-3
"""Share of the squares that an effect leaves at the least."""
_FINE = 9
"""Periods tried about the best one."""


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that residuals show and the adjustment has no unknown for."""

    kind: EffectKind
    """What it is."""
    where: str
    """Image, profile or model."""
    p_value: float
    """Probability that good data show anything as clear anywhere in this run."""
    amplitude: float
    """In `unit`; of jitter that of the sinusoid, of a correlation its coefficient."""
    unit: str
    """px, m, m/km, mrad; empty for a correlation."""
    term: str
    """What to add to the case file."""
    sigma: float
    """Of the amplitude, for sigma0 = 1."""
    quantity: str
    """What varies: line, sample; up, east and north."""
    period: float
    """s, of jitter; correlation length in px, m or s; else NaN."""
    statistic: float
    """The test."""
    degrees: int
    """Its degrees of freedom."""
    alternatives: tuple[str, ...] = ()
    """Where else an effect of this kind would explain the residuals as well, with its period there."""

    @property
    def words(self) -> str:
        """The finding in one sentence, with the term to add."""
        size = f"{self.amplitude:.2g} {self.unit}".strip()
        how = {
            EffectKind.JITTER: f"{self.quantity} residuals vary with time (period {self.period:.2g} s, {size}",
            EffectKind.TREND: f"{self.quantity} residuals vary slowly with time ({size}",
            EffectKind.DISTORTION: f"{self.quantity} residuals vary with the sample ({size} at the edge",
            EffectKind.FOCAL_LENGTH: f"{self.quantity} residuals grow with the sample ({size} at the edge",
            EffectKind.SLOPE: f"heights vary with the slope of the ground (shift of {size}",
            EffectKind.HEIGHT: f"heights are off in common, {self.quantity} ({size}",
            EffectKind.TILT: f"heights are tilted ({size}",
            EffectKind.DRIFT: f"residuals vary along the track, {self.quantity} ({size}",
            EffectKind.BEAM: f"footprints are off by a turn of the beam ({size}",
            EffectKind.CORRELATION: f"{self.quantity} of points within {self.period:.3g} {self.unit} resemble each "
            f"other (correlation {self.amplitude:.2g}",
        }[self.kind]
        other = f"; or {', '.join(self.alternatives)}, which cannot be told apart" if self.alternatives else ""
        return f"{self.where}: {how}, p = {self.p_value:.1g}): {self.kind}{other}; {self.term}"


class _Judged:
    """A family with what the residuals say of it, while others are named."""

    def __init__(self, rows: ResidualRows, family: Family, residuals: Array) -> None:
        self.family = family
        self.score = family.columns.T @ residuals[family.rows]
        self.variance = rows.variance(family.rows, family.columns)
        self.size = np.einsum("qk,qk->k", family.columns, family.columns)
        points = np.unique(rows.point[family.rows])
        self.beside = np.flatnonzero(np.isin(rows.point, points[points >= 0]))
        self.freedom = float(rows.redundancy[self.beside].sum())

    def tests(self, residuals: Array) -> list["_Test"]:
        """Of all hypotheses."""
        squares = float(residuals[self.beside] @ residuals[self.beside])
        found, hypotheses = list[_Test](), self.family.hypotheses
        widths = np.array([len(one.columns) for one in hypotheses])
        for width in np.unique(widths).tolist():
            mine = np.flatnonzero(widths == width)
            chosen = np.array([hypotheses[k].columns for k in mine.tolist()])
            size = np.sqrt(self.size[chosen])
            inner = self.variance[chosen[:, :, None], chosen[:, None, :]]
            scaled = inner / np.maximum(size[:, :, None] * size[:, None, :], np.finfo(float).tiny)
            values, vectors = np.linalg.eigh(scaled)
            seen = values > _SHOWN
            turned = np.einsum("tkd,tk->td", vectors, self.score[chosen] / np.maximum(size, np.finfo(float).tiny))
            weighted = np.where(seen, turned / np.where(seen, values, 1.0), 0.0)
            statistic, degrees = np.einsum("td,td->t", turned, weighted), seen.sum(axis=1)
            single = _p_values(statistic, degrees, squares, self.freedom)
            found += [
                _Test(self, hypotheses[k], float(statistic[n]), int(degrees[n]), float(single[n]))
                for n, k in enumerate(mine.tolist())
            ]
        return found

    def without(self, cross: Array, inverse: Array, estimate: Array) -> None:
        """Take an effect out: its covariance (k, d) with the columns, inverse (d, d) of its own, estimate (d,)."""
        self.score = self.score - cross @ estimate
        self.variance = self.variance - cross @ inverse @ cross.T


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    judged: _Judged
    hypothesis: Hypothesis
    statistic: float
    degrees: int
    single: float
    """p-value of this test alone."""

    @property
    def p_value(self) -> float:
        """Of all hypotheses of its family."""
        return self.single * len(self.judged.family.hypotheses)


def _p_values(statistic: Array, degrees: Index, squares: float, freedom: float) -> Array:
    """Larger one of the p-values by chi-square and, with the scatter of residuals of a sum of squares and a redundancy,
    by Fisher's law.
    """
    from scipy.special import chdtrc, fdtrc  # slow to import

    left, count = freedom - degrees, np.maximum(degrees, 1)
    tested = (degrees > 0) & (left > 0.0)
    rest = np.maximum(squares - statistic, _LEAST_REST * squares) / np.where(tested, left, 1.0)
    sure = fdtrc(count, np.where(tested, left, 1.0), statistic / count / np.maximum(rest, np.finfo(float).tiny))
    return np.where(tested, np.maximum(chdtrc(count, statistic), sure), 1.0)


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What the tests of the residuals found."""

    level: float
    """Probability that a run on good data names anything."""
    effects: tuple[Effect, ...]
    """Named, clearest first."""
    others: tuple[Effect, ...]
    """Of each place and kind of rows the clearest of what isn't named, once the named effects are taken out."""
    tests: int
    """Number of tests."""

    def words(self) -> str:
        """What was found, a line for each effect."""
        if not self.effects:
            return f"{self.tests} tests of the residuals by time, sample, slope, height and neighbours find nothing."
        return "\n".join(one.words for one in self.effects)


def unexplained(of: Solution | Linearised, level: float = LEVEL) -> Unexplained:
    """What residuals show and the adjustment has no unknown for.

    Parameters
    ----------
    of : Solution or Linearised
        At its solution.
    level : float
        Probability that a run on good data names anything.
    """
    if not 0.0 < level < 1.0:
        raise InputError("tests of the residuals, level", f"{level}", "a probability between 0 and 1")
    at = of if isinstance(of, Linearised) else at_solution(of)
    return _Search(residual_rows(at, _chosen(at.network)), level).found()


def named_effects(of: Solution | Linearised, level: float = LEVEL) -> tuple[Effect, ...]:
    """The named effects of `unexplained`, clearest first."""
    return unexplained(of, level).effects


class _Search:
    """Effects named one after another."""

    def __init__(self, rows: ResidualRows, level: float) -> None:
        self._rows, self._level = rows, level
        self._residuals = rows.residuals.copy()
        self._judged = [_Judged(rows, one, rows.residuals) for one in families(rows)]
        self._taken = list[tuple[Array, Array]]()
        """Of each named effect C g (r, d), once those before it are taken out, and the inverse of g' C g."""

    def found(self) -> Unexplained:
        """All of it."""
        named, count = list[Effect](), len(self._judged) + 3  # kinds of rows whose correlation is tested at last
        while True:
            tests = [min(one.tests(self._residuals), key=lambda test: test.single) for one in self._judged]
            best = min(tests, key=lambda test: test.p_value, default=None)
            if best is None or best.p_value * count > self._level or len(named) == _MOST_NAMED:
                break
            named.append(self._named(best, count))
        last = [
            Effect(
                EffectKind.CORRELATION, one.where, min(1.0, one.p_value * count), one.coefficient, one.unit, one.term,
                one.sigma, one.quantity, one.length, one.statistic, 1,
            )
            for one in correlations(self._rows, self._residuals, self._taken)
        ]  # fmt: skip
        named += [one for one in last if one.p_value <= self._level]
        others = [self._effect(test, count, *self._estimate(test)) for test in tests if test.degrees]
        others += [one for one in last if one.p_value > self._level]
        number = sum(len(one.family.hypotheses) for one in self._judged) + len(last)
        return Unexplained(self._level, tuple(named), tuple(others), number)

    def _estimate(self, test: "_Test") -> tuple[Array, Array]:
        """Amplitudes (d,) of an effect and their covariance (d, d)."""
        chosen = list(test.hypothesis.columns)
        inverse = _inverse(test.judged.variance[np.ix_(chosen, chosen)])
        return inverse @ test.judged.score[chosen], inverse

    def _named(self, best: _Test, count: int) -> Effect:
        family, hypothesis = best.judged.family, best.hypothesis
        columns = family.columns[:, list(hypothesis.columns)]
        shown = self._shown(family.rows, columns)
        if hypothesis.kind is EffectKind.JITTER:
            hypothesis, columns, shown = self._refined(best)
        variance = columns.T @ shown[family.rows]
        inverse = _inverse(variance)
        estimate = inverse @ (columns.T @ self._residuals[family.rows])
        kind = hypothesis.kind
        before = self._clearest(kind)
        self._residuals -= shown @ estimate
        self._taken.append((shown, inverse))
        for one in self._judged:
            one.without(one.family.columns.T @ shown[one.family.rows], inverse, estimate)
        after = self._clearest(kind)
        alike = [
            where + (f" (period {test.hypothesis.period:.2g} s)" if kind is EffectKind.JITTER else "")
            for where, test in before.items()
            if where != family.where and test.statistic > _ALIKE * best.statistic
            and after[where].p_value * count > self._level
        ]  # fmt: skip
        return self._effect(replace(best, hypothesis=hypothesis), count, estimate, inverse, tuple(alike))

    def _clearest(self, kind: EffectKind) -> dict[str, "_Test"]:
        """Clearest test of a kind at each place."""
        found = dict[str, _Test]()
        for one in self._judged:
            for test in one.tests(self._residuals):
                where = one.family.where
                if test.hypothesis.kind is kind and (where not in found or test.single < found[where].single):
                    found[where] = test
        return found

    def _effect(
        self, test: "_Test", count: int, estimate: Array, covariance: Array, alternatives: tuple[str, ...] = ()
    ) -> Effect:
        where, hypothesis = test.judged.family.where, test.hypothesis
        amplitude = float(np.linalg.norm(estimate)) if estimate.size > 1 else float(estimate[0])
        return Effect(
            hypothesis.kind, where, min(1.0, test.p_value * count), amplitude, hypothesis.unit,
            _term(self._rows.at.network, where, hypothesis), float(np.sqrt(np.mean(np.diagonal(covariance)))),
            hypothesis.quantity, hypothesis.period, test.statistic, test.degrees, alternatives,
        )  # fmt: skip

    def _shown(self, rows: Index, columns: Array) -> Array:
        """C G (r, k) with the covariance C of the residuals that are left."""
        found = self._rows.explained(rows, columns)
        for taken, inverse in self._taken:
            found -= taken @ (inverse @ (taken[rows].T @ columns))
        return found

    def _refined(self, best: _Test) -> tuple[Hypothesis, Array, Array]:
        """Jitter of the period that explains most near the best one: hypothesis, columns (q, 2) and what they show."""
        family, period = best.judged.family, best.hypothesis.period
        assert family.times is not None
        step = 0.5 / max(float(np.ptp(family.times)), 1e-9)
        tried = 1.0 / (1.0 / period + step * np.linspace(-0.8, 0.8, _FINE))
        columns = np.concatenate([family.jitter(one) for one in tried.tolist()], axis=1)
        shown = self._shown(family.rows, columns)
        score = (columns.T @ self._residuals[family.rows]).reshape(-1, 2)
        inner = np.stack([
            columns[:, 2 * k : 2 * k + 2].T @ shown[family.rows, 2 * k : 2 * k + 2] for k in range(_FINE)
        ])  # fmt: skip
        gain = np.einsum("tk,tkj,tj->t", score, _inverse(inner), score)
        k = int(np.argmax(gain))
        mine = slice(2 * k, 2 * k + 2)
        return best.hypothesis._replace(period=float(tried[k])), columns[:, mine], shown[:, mine]


def _inverse(matrices: Array) -> Array:
    """(..., d, d) inverses of symmetric matrices, of directions that residuals hardly show none."""
    return np.asarray(np.linalg.pinv(matrices, rcond=_SHOWN, hermitian=True))


def _chosen(network: Network) -> Index:
    """Points whose rows are tested: all of a small network, else some of each image and profile, evenly spread."""
    n = len(network.points)
    if n <= _MOST_POINTS:
        return np.arange(n)
    owners = [network.rays.point[network.rays.image == j] for j in range(len(network.images))]
    if network.shifts is not None:
        owners += [np.flatnonzero(network.shifts.profile == p) for p in range(len(network.shifts.names))]
    most, least = _PER_OWNER
    each = max(least, min(most, _MOST_POINTS // max(len(owners), 1)))
    every = [np.unique(one)[:: max(1, -(-np.unique(one).size // each))] for one in owners]
    return np.unique(np.concatenate(every))


def _term(network: Network, where: str, hypothesis: Hypothesis) -> str:
    """What to add to the case file."""
    image = where.removeprefix("image ")
    j = next((k for k, one in enumerate(network.images) if one.name == image), -1)
    if hypothesis.kind in (EffectKind.JITTER, EffectKind.TREND):
        if j >= 0 and network.strip_of[j] >= 0:
            spacing = f"{hypothesis.period / 4.0:.2g}" if math.isfinite(hypothesis.period) else "less"
            return f"[[strips]] {network.strips[network.strip_of[j]].name!r}: nodes = {{ spacing_s = {spacing} }}"
        if hypothesis.kind is EffectKind.TREND:
            degree = network.priors[j].degree + 1 if j >= 0 else 3
            return f"[[images]] {image!r}: orientation = {{ degree = {degree} }}, or a wider trend"
        return f"[[strips]] images = [{image!r}], nodes = {{ spacing_s = {hypothesis.period / 4.0:.2g} }}"
    if hypothesis.kind is EffectKind.FOCAL_LENGTH:
        return '[[shared]] kind = "focal length"' + (f", images = [{image!r}]" if j >= 0 else "")
    if hypothesis.kind is EffectKind.DISTORTION:
        return "the camera's distortion (support data optical_distortion, or the instrument kernel)"
    return _TERMS[hypothesis.kind, where.split()[0]]


_TERMS = {
    (EffectKind.SLOPE, "terrain"): "[terrain] planimetric_sigma_m larger, shift = true",
    (EffectKind.HEIGHT, "terrain"): "[terrain] height_sigma_m",
    (EffectKind.TILT, "terrain"): "[terrain] tilt_sigma_mrad",
    (EffectKind.SLOPE, "stereo"): "[[altimetry]] shift_sigma_m larger",
    (EffectKind.HEIGHT, "stereo"): "[[altimetry]] shift_sigma_m, its third number, larger",
    (EffectKind.TILT, "stereo"): "[[altimetry]] drift_sigma_m",
    (EffectKind.SLOPE, "profile"): "[[mola]] shift_sigma_m, or [[altimetry]] shift_sigma_m, larger",
    (EffectKind.HEIGHT, "profile"): '[[shared]] kind = "range bias", or [[altimetry]] shift_sigma_m',
    (EffectKind.DRIFT, "profile"): "[[mola]] drift_sigma_m, or [[altimetry]] drift_sigma_m",
    (EffectKind.BEAM, "profile"): '[[shared]] kind = "altimeter boresight", or [[mola]] beam_sigma_mrad',
}
