"""Do the residuals agree with their sigmas? Normalized residuals group by group.

A residual over its own sigma, w = v / sqrt(r) for a whitened residual v with the redundancy number r, is standard
normal if the sigmas are right and the errors normal. Residuals of a group are correlated. The redundancy of the group
is their number of independent residuals (the eigenvalues of their covariance are at most one); tests and bands use it.
They are conservative: false alarms are rarer than stated.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import Grouping, group_rows
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.sweep import reliability
from mgsgraph.record import Record
from mgsgraph.text import root_mean_square

LEVELS = (1.0, 2.0, 3.0)
"""Sigmas beyond which residuals are counted."""
_CONTROLLED = 1e-3
"""Redundancy number below which a residual says nothing but rounding."""
_FEWEST = 5.0
"""Independent residuals without which no test is made."""
_MARKS = 200
"""Points of a quantile plot."""


@dataclass(frozen=True, slots=True, eq=False)
class QuantilePlot:
    """Sorted residuals against those of a normal distribution."""

    expected: Array
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
        """Third moment about the mean, in standard deviations; 0 is expected."""
        return self._moment(3)

    @property
    def kurtosis(self) -> float:
        """Fourth moment about the mean less 3: 0 is expected, more means long tails."""
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
    def consistent(self) -> bool | None:
        """Whether neither the law nor the rms fails a test at 1%; None with too few residuals for either."""
        if not self.effective >= _FEWEST:
            return None
        return self.p_value >= 0.01 and abs(self.rms - 1.0) <= 2.576 * self.sigmas[1]

    def quantiles(self) -> QuantilePlot:
        """Quantile plot of at most `_MARKS` places."""
        from scipy.special import betaincinv, ndtri  # slow to import

        n = self.values.size
        ranks = np.unique(np.round(np.linspace(0, max(n - 1, 0), min(n, _MARKS))).astype(np.int64))
        share = (ranks + 0.5) / max(n, 1)
        worth = max(self.effective, 1.0)
        # an order statistic of `worth` independent uniform numbers
        low, high = (betaincinv(worth * share + 0.5, worth * (1.0 - share) + 0.5, side) for side in (0.025, 0.975))
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
    statistics = []
    for g, name in enumerate(grouping.names):
        members = groups == g
        values = np.sort(normalised[members & controlled])
        worth = min(float(redundancy[members & controlled].sum()), float(values.size))
        statistics.append(ResidualStatistics(name, values, int(np.count_nonzero(members & ~controlled)), worth))
    return tuple(statistics)


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
    priors = prior_rows(at)
    return JudgedRows(
        np.concatenate([numbers[:, :, 0][taken], priors.misfit]),
        np.concatenate([1.0 - shares[taken], 1.0 - priors.share]),
        np.concatenate([of_observation[taken], grouping.of_priors(layout)]),
        np.concatenate([np.nonzero(taken)[1], np.zeros(priors.misfit.size, dtype=np.int64)]),
    )
