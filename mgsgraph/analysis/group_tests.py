"""Does every group of observations and of priors fit its stated sigmas, at any redundancy?

With right sigmas the whitened residuals v of a group have the covariance C, the group's part of I - A Q A' (Baarda
1968), and their squares v'v the law of a sum of l_k chi^2_1 with its eigenvalues l_k, 0 to 1, which add up to the
group's redundancy. The probability of so large a sum is exact for few rows (saddlepoint formula of Lugannani & Rice;
Kuonen 1999, Biometrika 86, 929), and else that of a multiple of chi-square with the same mean and variance, tr C and
2 tr C^2 (Satterthwaite 1946).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from mgsgraph.analysis.grouping import BACK_PROJECTED, Grouping
from mgsgraph.analysis.linearised import PriorRows
from mgsgraph.analysis.residual_rows import ResidualRows, quadratic_tail
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.kernel.rows import GROUND, IMAGE, RANGE, STEREO, SURFACE
from mgsgraph.record import Record

UNTESTED = 1e-6
"""Redundancy of a row, on the average, that is rounding: nothing tests it."""
_EXACT = 30.0
"""Redundancy from which on a sum of squares is nearly enough a multiple of chi-square."""
_MOST_ROWS = 800
"""Rows whose covariance is taken as a whole."""
_MOST_COLUMNS, _MOST_NUMBERS = 1_000, 5_000_000
"""Shared unknowns, and numbers of a dense matrix of rows by these, beyond which the variance is replaced by its upper
bound: p-values are too large then."""


@dataclass(frozen=True, slots=True)
class GroupTest(Record):
    """How a group of observations, or of priors, fits its stated sigmas.

    Examples
    --------
    >>> ties = mgsgraph.verdict(solution).groups[0]
    >>> ties.name, ties.rows, round(ties.sigma0, 1), ties.tested
    ('tie image points, lines', 40, 1.1, True)
    """

    name: str
    """Of the group."""
    rows: int
    """Scalar observations that were looked at."""
    redundancy: float
    """Sum of their redundancy numbers."""
    sum_of_squares: float
    """Sum of the squares of their whitened residuals."""
    p_value: float
    """Chance of so large a sum, or of a larger one, if the stated sigmas are right; NaN where nothing tests them."""
    weights: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    """(k,) eigenvalues of their residuals' covariance C, or of many of them tr C^2 / tr C alone."""

    def hidden_factor(self, level: float, power: float) -> float:
        """Errors larger than stated by this factor are found with a power by a test of a level; infinite where nothing
        tests the group.

        With errors k times larger the residuals have the covariance C + (k^2 - 1) C^2.
        """
        from scipy.optimize import brentq  # slow to import
        from scipy.special import chdtri

        if not self.tested:
            return math.inf
        if self.weights.size == 1:
            freedom, share = self.redundancy / self.weights[0], float(self.weights[0])
            ratio = float(chdtri(freedom, level) / chdtri(freedom, power))
            return math.sqrt(1.0 + max(ratio - 1.0, 0.0) / share)
        mean = float(self.weights.sum())
        critical = brentq(lambda value: quadratic_tail(value, self.weights) - level, mean, 1e3 * mean)

        def missed(logarithm: float) -> float:
            larger = self.weights * (1.0 + (math.exp(2.0 * logarithm) - 1.0) * self.weights)
            return power - quadratic_tail(critical, larger)

        return math.exp(brentq(missed, 0.0, 30.0, xtol=1e-3))

    @property
    def sigma0(self) -> float:
        """Root of the sum of squares over redundancy; NaN where nothing tests the group."""
        return math.sqrt(self.sum_of_squares / self.redundancy) if self.tested else math.nan

    @property
    def tested(self) -> bool:
        """Whether others control it."""
        return math.isfinite(self.p_value)


def fit_of_groups(rows: ResidualRows, priors: PriorRows, grouping: Grouping) -> tuple[GroupTest, ...]:
    """Tests of all groups of chosen points' rows and of the priors; of image places lines and samples apart.

    Parameters
    ----------
    rows : ResidualRows
    priors : PriorRows
        There.
    grouping : Grouping
        Of the same network.
    """
    redundancy = np.append(rows.redundancy[: rows.begin_of_priors], 1.0 - priors.share)
    redundancy += np.sum(rows.considered**2, axis=1)
    number, names = numbers_of_groups(rows, grouping)
    tests = list[GroupTest]()
    for k, members in by_value(number):
        of_group, total = float(redundancy[members].sum()), float(rows.residuals[members] @ rows.residuals[members])
        tested = of_group > UNTESTED * members.size and BACK_PROJECTED not in names[k]
        p, weights = _tail(rows, members, of_group, total) if tested else (math.nan, np.zeros(0))
        tests.append(GroupTest(names[k], members.size, of_group, total, p, weights))
    return tuple(tests)


def numbers_of_groups(rows: ResidualRows, grouping: Grouping) -> tuple[Index, list[str]]:
    """Number (r,) of the group of each row, two for each group of a grouping, and their names."""
    groups = np.zeros(rows.kind.size, dtype=np.int64)
    for kind, of, by in (
        (IMAGE, grouping.rays, rows.measure), (RANGE, grouping.ranges, rows.measure),
        (GROUND, grouping.ground, rows.point), (SURFACE, grouping.heights, rows.point),
        (STEREO, grouping.stereo, rows.point),
    ):  # fmt: skip
        members = rows.of_kind(kind)
        groups[members] = of[by[members]]
    groups[rows.begin_of_priors :] = grouping.of_priors(rows.at.layout)
    coordinates = np.isin(np.arange(len(grouping.names)), grouping.rays)
    names = [
        f"{name}, {way}" if of_rays else name
        for name, of_rays in zip(grouping.names, coordinates.tolist(), strict=True)
        for way in ("lines", "samples")
    ]
    return 2 * groups + ((rows.kind == IMAGE) & (rows.component == 1)), names


def _tail(rows: ResidualRows, members: Index, redundancy: float, total: float) -> tuple[float, Array]:
    """Probability of so large a sum of squares of some rows, or of a larger one; `GroupTest.weights`."""
    from scipy.special import chdtrc  # slow to import

    if members.size <= _MOST_ROWS and redundancy < _EXACT:
        weights = np.linalg.eigvalsh(rows.variance(members, np.eye(members.size)))
        weights = weights[weights > 1e-9 * weights.max()]
        return quadratic_tail(total, weights), weights
    factor = _square_of_covariance(rows, members, redundancy) / redundancy
    return float(chdtrc(redundancy / factor, total / factor)), np.array([factor])


def _square_of_covariance(rows: ResidualRows, members: Index, redundancy: float) -> float:
    """Trace of C^2 of some rows (q,), C = I - O O' - T S T' + B B' (`ResidualRows`); or of C, which is more, where
    that is too large to be formed.
    """
    own, through, joint = rows.own[members], rows.through[members], rows.at.joint
    if joint.columns > _MOST_COLUMNS or members.size * joint.columns > _MOST_NUMBERS:
        return redundancy
    spread = np.asarray(through @ joint.square_root.back(np.eye(joint.columns)))
    parts = own.power(2).sum() + np.sum(spread**2), (own.T @ own).power(2).sum(), np.sum((own.T @ spread) ** 2)
    trace = members.size - 2.0 * parts[0] + parts[1] + 2.0 * parts[2] + np.sum((spread.T @ spread) ** 2)
    brought = rows.considered[members]
    rest = brought - own @ (own.T @ brought) - spread @ (spread.T @ brought)
    trace += 2.0 * np.sum(brought * rest) + np.sum((brought.T @ brought) ** 2)
    return max(float(trace), 1e-12)
