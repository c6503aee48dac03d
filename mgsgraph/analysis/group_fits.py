"""sigma0 by group: how each kind of observation fits its stated sigmas, beside the sigma0 of all, which hides it.

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
from weakref import WeakKeyDictionary

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import BACK_PROJECTED, group_rows
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.residual_tests import judged_rows
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array

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
