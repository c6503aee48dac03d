"""Score tests of families of effects, by the stated sigmas and by the residuals' own scatter."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.analysis.residual_rows import ResidualRows
from mgsgraph.analysis.systematic import Family, Hypothesis
from mgsgraph.geometry.records import Array, Index

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
        found, hypotheses = list[Test](), self.family.hypotheses
        widths = np.array([len(one.columns) for one in hypotheses])
        for width in np.unique(widths).tolist():
            mine = np.flatnonzero(widths == width)
            chosen = np.array([hypotheses[k].columns for k in mine.tolist()])
            inverse, degrees = solved(self.variance[chosen[:, :, None], chosen[:, None, :]], self.size[chosen])
            statistic = np.einsum("td,tde,te->t", self.score[chosen], inverse, self.score[chosen]) / spread
            stated, own = _p_values(statistic, degrees, squares, self.freedom)
            found += [
                Test(self, hypotheses[k], float(statistic[n]), int(degrees[n]), float(stated[n]), float(own[n]))
                for n, k in enumerate(mine.tolist())
            ]
        return found

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
        every = count * len(self.judged.family.hypotheses)
        return every * self.single <= level and every * self.own <= OWN_LEVEL


def solved(variance: Array, size: Array) -> tuple[Array, Index]:
    """Inverses (t, d, d) of the covariances of scores, whose columns have square sums (t, d), without the directions
    that residuals hardly show; and how many (t,) they show.
    """
    scale = 1.0 / np.sqrt(np.maximum(size, np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(variance * scale[:, :, None] * scale[:, None, :])
    seen = values > _SHOWN
    vectors = vectors * scale[:, :, None]
    weight = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    return np.einsum("tik,tk,tjk->tij", vectors, weight, vectors), seen.sum(axis=1)


def _p_values(statistic: Array, degrees: Index, squares: float, freedom: float) -> tuple[Array, Array]:
    """By chi-square, and by Fisher's law with the scatter of residuals of a sum of squares and a redundancy."""
    from scipy.special import chdtrc, fdtrc  # slow to import

    left, count = freedom - degrees, np.maximum(degrees, 1)
    tested = (degrees > 0) & (left > 0.0)
    rest = np.maximum(squares - statistic, _LEAST_REST * squares) / np.where(tested, left, 1.0)
    own = fdtrc(count, np.where(tested, left, 1.0), statistic / count / np.maximum(rest, np.finfo(np.float64).tiny))
    return np.where(tested, chdtrc(count, statistic), 1.0), np.where(tested, own, 1.0)
