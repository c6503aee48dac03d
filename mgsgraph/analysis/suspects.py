"""Measures that may be blunders, and those that can't be separated from them.

Tests of the same point are correlated. Where the modulus of a correlation is above 0.99, a blunder of one minimal
detectable blunder (4.13 sigmas of its test) shifts the two tests by amounts that differ by 0.3 sigmas of their
difference: the wrong one is the larger in four cases of ten, so both are named (Foerstner 1983 on separability). The
four coordinates of a tie with two rays share a single redundancy, and always are one group. Measures of different
points are not grouped, nor are a-priori values of the orientation with what they could be mistaken for.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.linearised import PointRows
from mgsgraph.adjustment.redundancy import INSEPARABLE, residual_covariance
from mgsgraph.analysis.measures import Indices, MeasureKind
from mgsgraph.analysis.reliability import Reliability
from mgsgraph.geometry.records import Array, Index

_NOTHING = 1e-12
"""Redundancy that is rounding: it has no direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A measure with a large test, and those that can't be separated from it."""

    measures: Index
    """(k,) in `Reliability.measures`: the one with the largest test, then the others, by the size of theirs."""
    point: int
    """Network point; -1 for an a-priori value of what points share."""
    test: float
    """Largest test, with its sign."""
    over: bool
    """Whether it exceeds the critical value."""


def suspects(found: Reliability, most: int = 20) -> tuple[Suspect, ...]:
    """The `most` suspicious measures, or groups of such as can't be separated, worst first."""
    groups, listed = list[Suspect](), set[int]()
    index = PointIndex(found.measures.point, len(found.at.network.points))
    correlations: dict[int, tuple[Index, Array]] = {}
    for k in _worst_first(found, most):
        if len(groups) == most:
            break
        if k in listed:
            continue
        point, together = int(found.measures.point[k]), np.array([k])
        if point >= 0:
            if point not in correlations:
                correlations[point] = correlations_of_tests(found, index, point)
            mine, matrix = correlations[point]
            row = np.abs(matrix[np.flatnonzero(mine == k)[0]])
            others = mine[(row > INSEPARABLE) & (mine != k)]
            size = np.nan_to_num(np.abs(found.measures.test[others]), nan=-1.0)
            together = np.append(together, others[np.argsort(-size, kind="stable")])
        listed.update(together.tolist())
        test = float(found.measures.test[k])
        groups.append(Suspect(together, point, test, abs(test) > found.critical))
    return tuple(groups)


def _worst_first(found: Reliability, most: int) -> Iterator[int]:
    """Controlled measures by the size of their tests; all are sorted only where the first few don't do."""
    seen, count = 0, 16 * most
    while seen < len(found):
        order = found.order(count)
        for k in order[seen:].tolist():
            if np.isnan(found.measures.test[k]):
                return
            yield k
        seen, count = order.size, len(found)


class PointIndex:
    """Which rows each point has.

    Parameters
    ----------
    points : (m,)
        Point of each row; -1 for rows of none.
    count : int
        Number of points.
    """

    def __init__(self, points: Index | Indices, count: int) -> None:
        self._order = np.argsort(points, kind="stable")
        self._first = np.searchsorted(points[self._order], np.arange(count + 1))

    def of(self, point: int) -> Index:
        """(q,) rows of a point, ascending."""
        return self._order[self._first[point] : self._first[point + 1]]


def correlations_of_tests(found: Reliability, index: PointIndex, point: int) -> tuple[Index, Array]:
    """Measures (q,) of a network point, and the correlations (q, q) of their tests; NaN where they have no test."""
    mine = index.of(point)
    rows = found.at.rows_of(point)
    chosen = combinations(found, mine, rows)
    covariance = chosen.T @ residual_covariance(found.at, rows)[0][0] @ chosen
    variance, size = np.diagonal(covariance), np.einsum("rq,rq->q", chosen, chosen)
    sigma = np.sqrt(np.where(variance > _NOTHING * size, variance, np.nan))
    return mine, np.asarray(covariance / sigma[:, None] / sigma)


def combinations(found: Reliability, measures: Index, rows: PointRows) -> Array:
    """(r, q) whitened rows of a point that an error of one sigma in each of its measures goes into.

    A ray's coordinates are rows; errors of an a-priori place go through the square root of its information.
    """
    table, at = found.measures, found.at
    point = int(table.point[measures[0]])
    index = int(at.layout.patterns.point_index[point])
    _, first, count, _, observation = at.rows.piece[at.layout.patterns.piece_of(index)].tolist()
    slot = (table.observation[measures] - observation - (index - first)) // count
    chosen = np.zeros((rows.row.size, measures.size))
    for q, k in enumerate(measures.tolist()):
        here = np.flatnonzero(rows.observation == slot[q])
        if table.kind[k] == MeasureKind.GROUND:
            chosen[here, q] = _root(at.network.points.covariances[point])[:, table.component[k]] * table.sigma[k]
        else:
            chosen[here[table.component[k]], q] = 1.0
    return chosen


def _root(covariance: Array) -> Array:
    """Upper triangular U with U'U the inverse."""
    information = np.linalg.inv(covariance)
    return np.asarray(np.linalg.cholesky(0.5 * (information + information.T)).T)
