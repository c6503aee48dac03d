"""Do the residuals look as their sigmas promise? The global test, and normalised residuals group by group.

A residual over its own sigma, w = v / sqrt(r) for a whitened residual v with the redundancy number r, is standard
normal if the sigmas are right and the errors normal. Residuals of a group are correlated: of n of them only as many are
worth an independent one as the group has redundancy (the eigenvalues of their covariance are at most one), and tests
and bands count with that number. They err on the safe side: false alarms are rarer than stated.

sigma0 by group: how each kind of observation fits its stated sigmas, beside the sigma0 of all, which hides it.

Many rows of one kind that fit too well, such as heights above a terrain model with a cautious sigma, leave the sigma0
of all near one whatever ties do. So each group has its own: the squares of its whitened residuals over the sum of its
redundancy numbers (Foerstner 1979), lines and samples of image points apart.

With right sigmas these squares are distributed as sum l_i chi^2_1 with the eigenvalues l_i <= 1 of the residuals'
covariance, which add up to the redundancy r. That scatters no more than chi-square with r degrees of freedom, whose
band a group is held against: what is said of its false alarms is an upper limit. All groups of a solution share
one probability of a false alarm (Bonferroni). Which group is wrong where several seem so, and by what factor,
`components` finds.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.fit import Fit
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import BACK_PROJECTED, Grouping, group_rows
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.sweep import reliability
from mgsgraph.record import Record
from mgsgraph.text import root_mean_square

ALPHA = 0.05
"""Probability of a false alarm of the tests."""
LEVELS = (1.0, 2.0, 3.0)
"""Sigmas beyond which residuals are counted."""
_CONTROLLED = 1e-3
"""Redundancy number below which a residual says nothing but rounding."""
_FEWEST = 5.0
"""Independent residuals without which no test is made."""
_MARKS = 200
"""Points of a quantile plot."""


@dataclass(frozen=True, slots=True)
class ChiSquareTest(Record):
    """The global test: weighted squares of all residuals against their degrees of freedom."""

    squares: float
    degrees: int
    alpha: float
    """Probability of a false alarm."""
    larger: float
    """Probability of so large a sum, or a larger one, if all sigmas are right."""
    smaller: float
    """Of so small a one, or a smaller one."""
    bounds: tuple[float, float]
    """Two-sided bounds of `squares`, at alpha."""
    upper_bound: float
    """One-sided upper bound of `squares`, at alpha."""

    @property
    def two_sided(self) -> float:
        """p-value of the two-sided test."""
        return min(1.0, 2.0 * min(self.larger, self.smaller))

    @property
    def passed(self) -> bool:
        """Whether the two-sided test finds nothing."""
        return self.two_sided >= self.alpha

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        low, high = self.bounds
        found, advice = "passed", ""
        if not self.passed:
            large = self.squares > high
            found = f"FAILED, too {'large' if large else 'small'}"
            advice = (
                ". Residuals are larger than their stated sigmas: look for blunders, then enlarge the sigmas" if large
                else ". Residuals are smaller than their stated sigmas: no blunder, but reduce the sigmas"
            ) + " of groups whose factor is far from 1"
        return (
            f"Global test {found}: squares {self.squares:.6g} for {self.degrees} degrees of freedom, "
            f"{low:.6g} to {high:.6g} in {100 * (1 - self.alpha):g}% of cases (p = {self.two_sided:.3g}; one-sided "
            f"{self.larger:.3g}, up to {self.upper_bound:.6g}){advice}"
        )


def chi_square_test(fit: Fit, alpha: float = ALPHA) -> ChiSquareTest:
    """The global test at a probability alpha of a false alarm; without redundancy there is none."""
    from scipy.stats import chi2  # slow to import

    if not 0.0 < alpha < 1.0:
        raise InputError("global test, alpha", f"{alpha}", "a probability between 0 and 1")
    degrees = fit.degrees_of_freedom
    if degrees < 1:
        raise InputError("global test", f"{degrees} degrees of freedom", "at least 1", "measure more")
    low, high, upper = chi2.ppf([0.5 * alpha, 1.0 - 0.5 * alpha, 1.0 - alpha], degrees).tolist()
    larger, smaller = float(chi2.sf(fit.squares, degrees)), float(chi2.cdf(fit.squares, degrees))
    return ChiSquareTest(fit.squares, degrees, alpha, larger, smaller, (low, high), upper)


@dataclass(frozen=True, slots=True, eq=False)
class QuantilePlot:
    """Sorted residuals against what a normal law promises."""

    promised: Array
    """(m,) standard normal quantiles."""
    found: Array
    """(m,) those of the normalised residuals."""
    low: Array
    """(m,) pointwise band for `found`, 95%."""
    high: Array
    """(m,)"""


@dataclass(frozen=True, slots=True, eq=False)
class ResidualStatistics(Record):
    """Normalised residuals of one group."""

    name: str
    """Name of the group."""
    values: Array
    """(n,) sorted; of rows with a redundancy number of at least 0.001."""
    uncontrolled: int
    """Rows left out because no other row controls them."""
    effective: float
    """Number of independent residuals that they are worth."""

    @property
    def mean(self) -> float:
        """Mean; 0 is expected."""
        return float(self.values.mean()) if self.values.size else math.nan

    @property
    def rms(self) -> float:
        """Root mean square; 1 is expected."""
        return root_mean_square(self.values)

    @property
    def skewness(self) -> float:
        """Third moment about the mean, in standard deviations; 0 is promised."""
        return self._moment(3)

    @property
    def kurtosis(self) -> float:
        """Fourth moment about the mean less 3: 0 is promised, more means long tails."""
        return self._moment(4) - 3.0

    @property
    def sigmas(self) -> tuple[float, float, float, float]:
        """Of mean, rms, skewness and kurtosis, of that many independent normal residuals."""
        n = self.effective if self.effective > 0.0 else math.nan
        return math.sqrt(1.0 / n), math.sqrt(0.5 / n), math.sqrt(6.0 / n), math.sqrt(24.0 / n)

    @property
    def beyond(self) -> tuple[float, ...]:
        """Share beyond 1, 2, 3 sigmas; of a normal law 0.317, 0.0455, 0.0027."""
        return tuple(float(np.mean(np.abs(self.values) > level)) if self.values.size else math.nan for level in LEVELS)

    @property
    def distance(self) -> float:
        """Largest difference of the cumulative shares from the standard normal law's (Kolmogorov & Smirnov)."""
        from scipy.special import ndtr  # slow to import

        if not self.values.size:
            return math.nan
        steps, law = np.arange(self.values.size + 1) / self.values.size, ndtr(self.values)
        return float(max(np.max(steps[1:] - law), np.max(law - steps[:-1])))

    @property
    def p_value(self) -> float:
        """Of that distance, for as many independent residuals (Stephens 1970); NaN for fewer than 5."""
        from scipy.special import kolmogorov  # slow to import

        if not self.effective >= _FEWEST:
            return math.nan
        root = math.sqrt(self.effective)
        return float(kolmogorov(self.distance * (root + 0.12 + 0.11 / root)))

    @property
    def as_promised(self) -> bool | None:
        """Whether neither the law nor the rms fails a test at 1%; None with too few residuals for either."""
        if not self.effective >= _FEWEST:
            return None
        return self.p_value >= 0.01 and abs(self.rms - 1.0) <= 2.576 * self.sigmas[1]

    def quantiles(self) -> QuantilePlot:
        """Quantile plot of at most `_MARKS` places."""
        from scipy.special import ndtri  # slow to import
        from scipy.stats import beta

        n = self.values.size
        ranks = np.unique(np.round(np.linspace(0, max(n - 1, 0), min(n, _MARKS))).astype(np.int64))
        share = (ranks + 0.5) / max(n, 1)
        worth = max(self.effective, 1.0)
        # an order statistic of `worth` independent uniform numbers
        low, high = (beta.ppf(side, worth * share + 0.5, worth * (1.0 - share) + 0.5) for side in (0.025, 0.975))
        return QuantilePlot(ndtri(share), self.values[ranks], ndtri(low), ndtri(high))

    def _moment(self, order: int) -> float:
        if self.values.size < 2:
            return math.nan
        away = self.values - self.mean
        scale = root_mean_square(away)
        return float(np.mean(away**order)) / scale**order if scale > 0.0 else math.nan


def residual_statistics(
    solution: Solution | Linearised, grouping: Grouping | None = None
) -> tuple[ResidualStatistics, ...]:
    """Statistics of the normalised residuals of each group (`group_rows` when absent); priors' are corrections."""
    at = (solution if isinstance(solution, Linearised) else at_solution(solution)).of_estimator()
    grouping = grouping or group_rows(at.network)
    residuals, redundancy, groups, _ = judged_rows(at, grouping)
    controlled = redundancy >= _CONTROLLED
    normalised = np.where(controlled, residuals / np.sqrt(np.where(controlled, redundancy, 1.0)), 0.0)
    found = []
    for g, name in enumerate(grouping.names):
        mine = groups == g
        values = np.sort(normalised[mine & controlled])
        worth = min(float(redundancy[mine & controlled].sum()), float(values.size))
        found.append(ResidualStatistics(name, values, int(np.count_nonzero(mine & ~controlled)), worth))
    return tuple(found)


class JudgedRows(NamedTuple):
    """Scalar rows that take part, those of points first, then priors."""

    residual: Array
    """(m,) whitened."""
    redundancy: Array
    """(m,) redundancy numbers."""
    group: Index
    """(m,) of a grouping."""
    component: Index
    """(m,) which row of its observation: line 0, sample 1; x, y, z of an a-priori place; 0 of priors."""


def judged_rows(at: Linearised, grouping: Grouping) -> JudgedRows:
    """Whitened residual, redundancy number and group of each row that takes part."""
    layout = at.layout
    target, pairs = layout.blocks.target, at.pair_blocks(layout)
    numbers = reliability(at.rows, layout.groups, target, layout.model, at.orientation, pairs, at.points)
    # rows that don't take part are zero, those of points left out or undetermined NaN
    taken = np.any(numbers != 0.0, axis=2) & np.all(np.isfinite(numbers), axis=2)
    of_observation = np.repeat(grouping.of_observations(layout)[:, None], 3, axis=1)
    shares = np.stack([numbers[:, row, 1 + row] for row in range(3)], axis=1)
    known = prior_rows(at)
    return JudgedRows(
        np.concatenate([numbers[:, :, 0][taken], known.misfit]),
        np.concatenate([1.0 - shares[taken], 1.0 - known.share]),
        np.concatenate([of_observation[taken], grouping.of_priors(layout)]),
        np.concatenate([np.nonzero(taken)[1], np.zeros(known.misfit.size, dtype=np.int64)]),
    )


ODDS = 0.0027
"""Chance (three sigma) that a solution whose sigmas are right has a group out of its band."""
LEAST = 5.0
"""Redundancy below which a group is not judged: its band is wider than a factor of two."""
_MOST_POINTS = 100_000
"""Points of a network up to which its groups are looked at without being asked: some seconds."""


@dataclass(frozen=True, slots=True)
class GroupFit:
    """How a group of observations fits its stated sigmas."""

    name: str
    """Of the group."""
    rows: int
    """Scalar observations that take part."""
    redundancy: float
    """Sum of their redundancy numbers."""
    squares: float
    """Sum of the squares of their whitened residuals."""
    low: float
    """Least sigma0 that chance gives; NaN where the group isn't judged."""
    high: float
    """Largest."""

    @property
    def sigma0(self) -> float:
        """Root of squares over redundancy; NaN where others don't check the group."""
        return math.sqrt(self.squares / self.redundancy) if self.redundancy >= 0.5 else math.nan

    @property
    def judged(self) -> bool:
        """Whether it is held against a band."""
        return math.isfinite(self.high)

    @property
    def worse(self) -> bool:
        """Whether it fits worse than its stated sigmas say."""
        return self.judged and self.sigma0 > self.high

    @property
    def better(self) -> bool:
        """Whether it fits better."""
        return self.judged and self.sigma0 < self.low


_FOUND: "WeakKeyDictionary[Solution, tuple[GroupFit, ...] | None]" = WeakKeyDictionary()
"""What was found of solutions, which never change: tables, sentences and files all ask for it."""


def group_fits(solution: Solution) -> tuple[GroupFit, ...] | None:
    """sigma0 of each group of a solution; None of one that has not converged, has no covariance or redundancy, or of a
    very large network.
    """
    if solution not in _FOUND:
        _FOUND[solution] = _group_fits(solution)
    return _FOUND[solution]


def _group_fits(solution: Solution) -> tuple[GroupFit, ...] | None:
    large = len(solution.network.points) > _MOST_POINTS
    if large or not solution.converged or solution.fit.degrees_of_freedom < 1:
        return None
    try:
        at = at_solution(solution).of_estimator()
    except InputError:  # no covariance
        return None
    grouping = group_rows(at.network)
    rows, size = judged_rows(at, grouping), len(grouping.names)
    coordinates = np.isin(np.arange(size), grouping.rays)
    # two numbers for each group: of image points lines and samples, of all else the first alone
    number = 2 * rows.group + (coordinates[rows.group] & (rows.component == 1))
    names = [
        name + f", {way}" if both else name
        for name, both in zip(grouping.names, coordinates.tolist(), strict=True)
        for way in ("lines", "samples")
    ]
    counts = np.bincount(number, minlength=2 * size)
    redundancy = np.bincount(number, rows.redundancy, 2 * size)
    squares = np.bincount(number, rows.residual**2, 2 * size)
    measured = np.repeat([BACK_PROJECTED not in name for name in grouping.names], 2)
    judged = measured & (redundancy >= LEAST) & (solution.settings.loss == "none")
    low, high = _bands(np.where(judged, redundancy, np.nan), int(judged.sum()), solution.settings.reject)
    return tuple(
        GroupFit(names[k], int(counts[k]), float(redundancy[k]), float(squares[k]), float(low[k]), float(high[k]))
        for k in np.flatnonzero(counts).tolist()
    )


def _bands(redundancy: Array, judged: int, reject: float) -> tuple[Array, Array]:
    """(g,) bands of sigma0 of groups of which so many are judged; NaN of the others, whose redundancy is NaN.

    Rejection beyond so many standard deviations takes from the squares what the tails of the normal law hold.
    """
    from scipy.stats import chi2  # slow to import

    odds = 0.5 * ODDS / max(judged, 1)
    low, high = (np.sqrt(chi2.ppf(share, redundancy) / redundancy) for share in (odds, 1.0 - odds))
    if reject > 0.0:
        law = NormalDist()
        low *= math.sqrt(1.0 - 2.0 * reject * law.pdf(reject) / (2.0 * law.cdf(reject) - 1.0))
    return low, high
