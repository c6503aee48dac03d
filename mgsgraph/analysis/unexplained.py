"""What an adjustment cannot explain, by name: tests of its residuals against time, sample, slope and height, along
profiles, and of near points against each other.

Each effect has a score test (`residual_rows`), exact whatever the residuals' correlations are. A family of effects at
one place counts as many tests as it has hypotheses (Bonferroni), and all families together share one probability of a
false alarm, `LEVEL` for a whole run. The clearest effect is named, its share is taken out of the residuals and of their
covariance, and the rest is tested again: what it had brought about elsewhere goes with it.

Errors that are simply larger than stated would look like every effect at once. So a test has to be clear by Fisher's
law, too, with the scatter that the residuals of the same points have: then a run names nothing with a probability of
1 - `OWN_LEVEL` whatever the sigmas are. That scatter holds the effects themselves, so its level is a wider one.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_rows import ResidualRows, correlations, residual_rows
from mgsgraph.analysis.systematic import EffectKind, Family, Hypothesis, families
from mgsgraph.errors import require
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.network import Network
from mgsgraph.record import Record
from mgsgraph.units import MRAD

OWN_LEVEL = 0.2
"""Probability that a run names anything where errors are larger than stated, but nothing else."""
_LEAST_REST = 1e-3
"""Share of the squares that an effect leaves at the least."""
_SHOWN = 0.02
"""Share of an effect's squares that residuals have to show: below, it is absorbed by the unknowns, but for what isn't
linear: at Eos, with its wide priors, a share of 0.003 was named where nothing had been planted."""


class Judged:
    """A family with what the residuals say of it, while others are named."""

    def __init__(self, rows: ResidualRows, family: Family, residuals: Array) -> None:
        self.family = family
        self.score = family.columns.T @ residuals[family.rows]
        self.variance = rows.variance(family.rows, family.columns)
        self.size = np.einsum("qk,qk->k", family.columns, family.columns)
        points = np.unique(rows.point[family.rows])
        self.beside = np.flatnonzero(np.isin(rows.point, points[points >= 0]))
        self.freedom = float(rows.redundancy[self.beside].sum())

    def tests(self, residuals: Array, spread: float = 1.0) -> list["Test"]:
        """Of all hypotheses, where sums over many rows scatter more than stated by a factor of their variance."""
        squares = float(residuals[self.beside] @ residuals[self.beside])
        results, hypotheses = list[Test](), self.family.hypotheses
        widths = np.array([len(hypothesis.columns) for hypothesis in hypotheses])
        for _, of_width in by_value(widths):
            chosen = np.array([hypotheses[k].columns for k in of_width.tolist()])
            inverse, degrees = solved(self.variance[chosen[:, :, None], chosen[:, None, :]], self.size[chosen])
            statistic = np.einsum("td,tde,te->t", self.score[chosen], inverse, self.score[chosen]) / spread
            stated, fisher = _p_values(statistic, degrees, squares, self.freedom)
            results += [
                Test(self, hypotheses[k], float(statistic[n]), int(degrees[n]), float(stated[n]), float(fisher[n]))
                for n, k in enumerate(of_width.tolist())
            ]
        return results

    def without(self, cross: Array, inverse: Array, estimate: Array) -> None:
        """Take an effect out: its covariance (k, d) with the columns, inverse (d, d) of its own, estimate (d,)."""
        self.score = self.score - cross @ estimate
        self.variance = self.variance - cross @ inverse @ cross.T


@dataclass(frozen=True, slots=True, eq=False)
class Test:
    """Test of one hypothesis."""

    judged: Judged
    """Its family."""
    hypothesis: Hypothesis
    """What is asked."""
    statistic: float
    """Chi-square."""
    degrees: int
    """Its degrees of freedom; 0 of what the unknowns absorb."""
    single: float
    """p-value of this test alone."""
    own: float
    """The same with the scatter that the residuals have."""

    @property
    def p_value(self) -> float:
        """Of all hypotheses of its family."""
        return self.single * len(self.judged.family.hypotheses)

    def named(self, count: int, level: float) -> bool:
        """Whether it is to be named, one of `count` families."""
        number = count * len(self.judged.family.hypotheses)
        return number * self.single <= level and number * self.own <= OWN_LEVEL


def solved(variance: Array, size: Array) -> tuple[Array, Index]:
    """Inverses (t, d, d) of the covariances of scores, whose columns have square sums (t, d), without the directions
    that residuals hardly show; and how many (t,) they show.
    """
    scale = 1.0 / np.sqrt(np.maximum(size, np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(variance * scale[:, :, None] * scale[:, None, :])
    shown = values > _SHOWN
    vectors = vectors * scale[:, :, None]
    weight = np.where(shown, 1.0 / np.where(shown, values, 1.0), 0.0)
    return np.einsum("tik,tk,tjk->tij", vectors, weight, vectors), shown.sum(axis=1)


def _p_values(statistic: Array, degrees: Index, squares: float, freedom: float) -> tuple[Array, Array]:
    """By chi-square, and by Fisher's law with the scatter of residuals of a sum of squares and a redundancy."""
    from scipy.special import chdtrc, fdtrc  # slow to import

    free, count = freedom - degrees, np.maximum(degrees, 1)
    tested = (degrees > 0) & (free > 0.0)
    rest = np.maximum(squares - statistic, _LEAST_REST * squares) / np.where(tested, free, 1.0)
    fisher = fdtrc(count, np.where(tested, free, 1.0), statistic / count / np.maximum(rest, np.finfo(np.float64).tiny))
    return np.where(tested, chdtrc(count, statistic), 1.0), np.where(tested, fisher, 1.0)


LEVEL = 0.01
"""Probability that a run on good data names anything."""
_MOST_NAMED = 12
"""Effects after which the search ends."""
_MOST_POINTS = 20_000
"""Points whose rows are tested; of a larger network some of each image and profile."""
_PER_OWNER = 1000, 100
"""Of each image and profile at most, and where these are many at least."""
_ALIKE = 0.8
"""Share of the named effect's test from which on another, which is gone with it, is inseparable from it."""
_CONFOUNDED = ("image places", "terrain model")
"""Kinds of rows of which the clearer correlation alone is named."""
_PAIR = 2
"""Sine and cosine."""
_FINE = 9
"""Periods tried about the best one."""


@dataclass(frozen=True, slots=True)
class Effect(Record):
    """An effect that residuals show and the adjustment has no unknown for.

    Examples
    --------
    >>> from mgsgraph.analysis.systematic import EffectKind
    >>> from mgsgraph.analysis.unexplained import Effect
    >>> kind, term = EffectKind.JITTER, "[[passes]] images = ['SIM/A']"
    >>> effect = Effect(kind, "image SIM/A", 1e-9, 1.2, "px", term, 0.1, "line and sample", 1.9, 60.0, 4)
    >>> print(effect.sentence)
    image SIM/A: line and sample residuals vary with time (period 1.9 s, 1.2 px, p = 1e-09): jitter; [[passes]]
    images = ['SIM/A']
    """

    kind: EffectKind
    """What it is."""
    where: str
    """Image, profile or model."""
    p_value: float
    """Probability that good data show anything as clear anywhere in this run."""
    amplitude: float
    """In `unit`; of jitter that of the sinusoid, of a correlation its coefficient."""
    unit: str
    """px, m, m/km, arcsec; empty for a correlation."""
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
    def sentence(self) -> str:
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
            EffectKind.BEAM: f"footprints are off by a rotation of the beam ({size}",
            EffectKind.CORRELATION: f"{self.quantity} of points within {self.period:.3g} {self.unit} resemble each "
            f"other (correlation {self.amplitude:.2g}",
        }[self.kind]
        note = f"; or {', '.join(self.alternatives)}, which is inseparable from it" if self.alternatives else ""
        return f"{self.where}: {how}, p = {self.p_value:.1g}): {self.kind}{note}; {self.term}"


@dataclass(frozen=True, slots=True, eq=False)
class Pattern(Record):
    """How the residuals go with an effect: for a picture."""

    effect: Effect
    """Which."""
    along: Array
    """(n,) what they vary with: s within a period, px or m of the effect itself, distance of points."""
    residuals: Array
    """(n,) px or m, as they were when the effect was named; of a correlation its coefficient at each distance."""
    shown: Array
    """(n,) the part of it that the effect explains; of a correlation its sigma."""


@dataclass(frozen=True, slots=True)
class Unexplained(Record):
    """What the tests of the residuals found."""

    level: float
    """Probability that a run on good data names anything."""
    effects: tuple[Effect, ...]
    """Named, clearest first."""
    others: tuple[Effect, ...]
    """Of each place and kind of rows the clearest of what isn't named, once the named effects are taken out."""
    tests: int
    """Number of tests."""
    patterns: tuple[Pattern, ...] = ()
    """Of each named effect."""

    @property
    def sentences(self) -> list[str]:
        """What was found, one for each effect."""
        if not self.effects:
            return [f"{self.tests} tests by time, sample, slope, height and neighbors find no significant effect."]
        return [effect.sentence for effect in self.effects]


def unexplained(of: Solution | Linearised, level: float = LEVEL) -> Unexplained:
    r"""What residuals show and the adjustment has no unknown for.

    Parameters
    ----------
    of : Solution or Linearised
        At its solution.
    level : float
        Probability that a run on good data names anything.

    Examples
    --------
    >>> found = mgsgraph.unexplained(solution)
    >>> print(*found.sentences, sep="\n")
    203 tests by time, sample, slope, height and neighbors find no significant effect.
    """
    require(0.0 < level < 1.0, "tests of the residuals, level", f"{level}", "a probability between 0 and 1")
    at = of if isinstance(of, Linearised) else at_solution(of)
    return _Search(residual_rows(at, _chosen(at.network)), level).found()


class _Search:
    """Effects named one after another."""

    def __init__(self, rows: ResidualRows, level: float) -> None:
        self._rows, self._level = rows, level
        self._residuals = rows.residuals.copy()
        self._judged = [Judged(rows, family, rows.residuals) for family in families(rows)]
        self._taken = list[tuple[Array, Array]]()
        """Of each named effect C g (r, d), once those before it are taken out, and the inverse of g' C g."""
        self._patterns = list[Pattern]()
        self._spread = 1.0
        """Factor of the variance of scores that a correlation of near points makes, which is clearer than they are."""

    def found(self) -> Unexplained:
        """All of it."""
        named, count = list[Effect](), len(self._judged) + 3  # kinds of rows whose correlation is tested at last
        while True:
            tests = [min(self._tests(judged), key=lambda test: test.single) for judged in self._judged]
            clear = [test for test in tests if test.named(count, self._level)]
            if not clear or len(named) == _MOST_NAMED:
                break
            best = min(clear, key=lambda test: test.p_value)
            if not named and self._spread == 1.0:
                near = correlations(self._rows, self._residuals, self._taken)
                self._spread = max((kind.spread for kind in near if kind.p_value < best.p_value), default=1.0)
                if self._spread > 1.0:
                    continue
            named.append(self._named(best, count))
        last = [
            (Effect(
                EffectKind.CORRELATION, kind.where, min(1.0, kind.p_value * count), kind.coefficient, kind.unit,
                kind.term, kind.sigma, kind.quantity, kind.length, kind.statistic, 1,
            ), kind.course)
            for kind in correlations(self._rows, self._residuals, self._taken)
        ]  # fmt: skip
        # matching errors in common make the ties' heights alike, and errors of a terrain model their image places
        confounded = sorted((effect.p_value, effect.where) for effect, _ in last if effect.where in _CONFOUNDED)
        for effect, course in last:
            if effect.p_value <= self._level and (effect.where not in _CONFOUNDED or effect.where == confounded[0][1]):
                self._patterns.append(Pattern(effect, *(np.array(part) for part in zip(*course, strict=True))))
        self._patterns.sort(key=lambda pattern: pattern.effect.p_value)
        others = [self._effect(test, count, *self._estimate(test)) for test in tests if test.degrees]
        others += [effect for effect, _ in last if effect not in [pattern.effect for pattern in self._patterns]]
        number = sum(len(judged.family.hypotheses) for judged in self._judged) + len(last)
        named = [pattern.effect for pattern in self._patterns]
        return Unexplained(self._level, tuple(named), tuple(others), number, tuple(self._patterns))

    def _tests(self, judged: Judged) -> list[Test]:
        return judged.tests(self._residuals, self._spread)

    def _estimate(self, test: Test) -> tuple[Array, Array]:
        """Amplitudes (d,) of an effect and their covariance (d, d)."""
        chosen = list(test.hypothesis.columns)
        inverse = solved(test.judged.variance[np.ix_(chosen, chosen)][None], test.judged.size[None, chosen])[0][0]
        return inverse @ test.judged.score[chosen], inverse

    def _named(self, best: Test, count: int) -> Effect:
        family, hypothesis = best.judged.family, best.hypothesis
        columns = family.columns[:, list(hypothesis.columns)]
        shown = self._shown(family.rows, columns)
        if hypothesis.kind is EffectKind.JITTER:
            hypothesis, columns, shown = self._refined(best)
        variance = columns.T @ shown[family.rows]
        inverse = solved(variance[None], np.sum(columns**2, axis=0)[None])[0][0]
        estimate = inverse @ (columns.T @ self._residuals[family.rows])
        kind = hypothesis.kind
        before, pattern = self._clearest(kind), self._pattern(best.judged, hypothesis, columns, shown, estimate)
        self._residuals -= shown @ estimate
        self._taken.append((shown, inverse))
        for judged in self._judged:
            judged.without(judged.family.columns.T @ shown[judged.family.rows], inverse, estimate)
        after = self._clearest(kind)
        places = [
            where + (f" (period {test.hypothesis.period:.2g} s)" if kind is EffectKind.JITTER else "")
            for where, test in before.items()
            if where != family.where and test.statistic > _ALIKE * best.statistic
            and not after[where].named(count, self._level)
        ]  # fmt: skip
        effect = self._effect(replace(best, hypothesis=hypothesis), count, estimate, inverse, tuple(places))
        self._patterns.append(Pattern(effect, *pattern))
        return effect

    def _pattern(
        self, judged: Judged, hypothesis: Hypothesis, columns: Array, shown: Array, estimate: Array
    ) -> tuple[Array, Array, Array]:
        """What the residuals vary with, they, and what the effect explains of them, in px or m."""
        family, rows = judged.family, self._rows
        unit = np.where(rows.scale > 0.0, rows.scale, np.linalg.norm(rows.by_point, axis=1))[family.rows]
        wave = hypothesis.kind is EffectKind.JITTER and estimate.size == 2 * _PAIR
        part = slice(_PAIR * int(np.argmax(np.hypot(estimate[::2], estimate[1::2]))), None) if wave else slice(None)
        acting = np.any(columns[:, part][:, :_PAIR] != 0.0, axis=1) & (unit > 0.0)
        effect = (columns @ estimate)[acting] / unit[acting]
        along = effect
        if hypothesis.kind in (EffectKind.JITTER, EffectKind.TREND):
            assert family.times is not None
            along = family.times[acting] % hypothesis.period if wave or estimate.size > 1 else family.times[acting]
        chosen = family.rows[acting]
        return along, self._residuals[chosen] / unit[acting], (shown @ estimate)[chosen] / unit[acting]

    def _clearest(self, kind: EffectKind) -> dict[str, Test]:
        """Clearest test of a kind at each place."""
        clearest = dict[str, Test]()
        for judged in self._judged:
            for test in self._tests(judged):
                where = judged.family.where
                if test.hypothesis.kind is kind and (where not in clearest or test.single < clearest[where].single):
                    clearest[where] = test
        return clearest

    def _effect(
        self, test: Test, count: int, estimate: Array, covariance: Array, alternatives: tuple[str, ...] = ()
    ) -> Effect:
        where, hypothesis = test.judged.family.where, test.hypothesis
        # sine and cosine, east and north; of two coordinates the larger one's
        amplitude = float(estimate[0]) if estimate.size == 1 else float(np.hypot(estimate[::2], estimate[1::2]).max())
        return Effect(
            hypothesis.kind, where, min(1.0, test.p_value * count), amplitude, hypothesis.unit,
            _term(self._rows.at.network, where, hypothesis, amplitude),
            float(np.sqrt(np.mean(np.diagonal(covariance)))), hypothesis.quantity, hypothesis.period, test.statistic,
            test.degrees, alternatives,
        )  # fmt: skip

    def _shown(self, rows: Index, columns: Array) -> Array:
        """C G (r, k) with the covariance C of the residuals that are left."""
        shown = self._rows.explained(rows, columns)
        for taken, inverse in self._taken:
            shown -= taken @ (inverse @ (taken[rows].T @ columns))
        return shown

    def _refined(self, best: Test) -> tuple[Hypothesis, Array, Array]:
        """Jitter of the period that explains most near the best one: hypothesis, columns (q, 2) and what they show."""
        family, period = best.judged.family, best.hypothesis.period
        assert family.times is not None
        step = 0.5 / max(float(np.ptp(family.times)), 1e-9)
        tried = 1.0 / (1.0 / period + step * np.linspace(-0.8, 0.8, _FINE))
        columns = [family.jitter(best.hypothesis, trial) for trial in tried.tolist()]
        width = columns[0].shape[1]
        shown = self._shown(family.rows, np.concatenate(columns, axis=1)).reshape(-1, _FINE, width).swapaxes(0, 1)
        score = np.array([column.T @ self._residuals[family.rows] for column in columns])
        inner = np.array([column.T @ effect[family.rows] for column, effect in zip(columns, shown, strict=True)])
        inverse, _ = solved(inner, np.array([np.sum(column**2, axis=0) for column in columns]))
        k = int(np.argmax(np.einsum("td,tde,te->t", score, inverse, score)))
        return best.hypothesis._replace(period=float(tried[k])), columns[k], shown[k]


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
    points = [np.unique(of_owner)[:: max(1, -(-np.unique(of_owner).size // each))] for of_owner in owners]
    return np.unique(np.concatenate(points))


def _term(network: Network, where: str, hypothesis: Hypothesis, amplitude: float) -> str:
    """What to add to the case file."""
    image = where.removeprefix("image ")
    j = next((k for k, picture in enumerate(network.images) if picture.name == image), -1)
    if hypothesis.kind in (EffectKind.JITTER, EffectKind.TREND):
        if j >= 0 and network.held[j] and hypothesis.kind is EffectKind.TREND:
            return f"[[images]] {image!r}: held = false"
        if j >= 0 and network.pass_of[j] >= 0:
            pass_ = network.passes[network.pass_of[j]].name
            return f"[[passes]] {pass_!r}: {_nodes(network, j, hypothesis, amplitude)}"
        if hypothesis.kind is EffectKind.TREND:
            degree = network.priors[j].degree + 1 if j >= 0 else 3
            return f"[[images]] {image!r}: orientation = {{ degree = {degree} }}, or a wider trend"
        return (
            f"[[passes]] with the keys images = [{image!r}], {_nodes(network, j, hypothesis, amplitude)}; the image "
            "then has nominal = 'trajectory' and no orientation sigmas of its own"
        )
    if hypothesis.kind is EffectKind.FOCAL_LENGTH:
        return '[[shared]] kind = "focal length"' + (f", images = [{image!r}]" if j >= 0 else "")
    if hypothesis.kind is EffectKind.DISTORTION:
        return "the camera's distortion (support data optical_distortion, or the instrument kernel)"
    return _TERMS[hypothesis.kind, where.split()[0]]


def _nodes(network: Network, image: int, hypothesis: Hypothesis, amplitude: float) -> str:
    """Keys of a pass whose nodes can follow: as close as a quarter of the period, free by the vibration's size."""
    if not math.isfinite(hypothesis.period):
        return "nodes closer to each other (spacing_s)"
    picture, step = network.images[image], f"{hypothesis.period / 4.0:.2g}"
    places = np.full(2, 0.5 * picture.lines), 0.5 * picture.samples + np.array([0.0, 1.0])
    looks = picture.sightlines(*places)[1]
    angle = float(np.linalg.norm(np.cross(*looks)) / np.linalg.norm(looks[0]) ** 2) * amplitude / MRAD
    return (
        f"nodes = {{ spacing_s = {step} }}, prior = {{ correlation_time_s = {step}, angle_sigma_mrad = {angle:.2g} }}"
    )


_TERMS = {
    (EffectKind.SLOPE, "terrain"): "[terrain] planimetric_sigma_m larger, shift = true",
    (EffectKind.HEIGHT, "terrain"): "[terrain] height_sigma_m",
    (EffectKind.TILT, "terrain"): "[terrain] tilt_sigma_mrad",
    (EffectKind.SLOPE, "stereo"): "[[altimetry]] shift_sigma_m larger",
    (EffectKind.HEIGHT, "stereo"): "[[altimetry]] shift_sigma_m, its third number, larger",
    (EffectKind.TILT, "stereo"): "[[altimetry]] drift_sigma_m",
    (EffectKind.SLOPE, "profile"): "[[shots]] shift_sigma_m, or [[altimetry]] shift_sigma_m, larger",
    (EffectKind.HEIGHT, "profile"): '[[shared]] kind = "range bias", or [[altimetry]] shift_sigma_m',
    (EffectKind.DRIFT, "profile"): "[[shots]] drift_sigma_m, or [[altimetry]] drift_sigma_m",
    (EffectKind.BEAM, "profile"): '[[shared]] kind = "altimeter boresight", or [[shots]] beam_sigma_mrad',
}
