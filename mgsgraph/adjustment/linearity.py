"""Whether the joint error ellipsoid of the shared unknowns may be used for statements about them.

Their covariance S = N^-1 is that of a cost that is a paraboloid about the optimum x. It is none where a-priori sigmas
are so wide that rows bend within them. So states x + e are drawn from the ellipsoid, e of covariance S, the points meet
anew at each, and twice the rise of the cost, L, is held against q = e' S^-1 e. L is the square of a likelihood ratio,
chi-square with as many degrees of freedom as unknowns whatever coordinates these are counted in; q is what the
ellipsoid makes of it. Where L is larger on the average, the ellipsoid holds states that the measures exclude: it lies
across a valley that bends, and the truth, down in the valley, lies farther out in it than chi-square says. Single
unknowns may be well behaved all the same. (Bates & Watts, 1980, take second derivatives at x; draws see the whole
region, at the price of one sweep each.)
"""

import math
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.graph import BundleGraph
from mgsgraph.adjustment.square_root import SquareRoot
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import COSTS, Reduction
from mgsgraph.record import Record

DRAWS = 32
"""States drawn: the ratio then has a sigma of 0.02 where it is near one."""
LINEAR = 1.1
"""Ratio up to which statements are made by the ellipsoid: normalised errors a tenth too large, sigmas a twentieth."""
MOST_POINTS, MOST_UNKNOWNS = 5_000, 1_000
"""Size up to which `adjust` looks for itself, in 0.05 s. Larger ones are looked at when asked."""


@dataclass(frozen=True, slots=True)
class Linearity(Record):
    """What draws from the ellipsoid say of it.

    Examples
    --------
    >>> solution.linearity.linear
    True
    >>> round(solution.linearity.ratio, 2)
    1.0
    """

    ratio: float
    """Mean of L / q over the draws; infinite where one of them sees a point from behind."""
    scatter: float
    """Standard deviation of L / q."""
    unknowns: int
    """Shared unknowns, jointly."""
    draws: int
    """How many."""

    @property
    def linear(self) -> bool:
        """Whether the ellipsoid may be used for statements about all of them."""
        return 1.0 / LINEAR <= self.ratio <= LINEAR


def linearity(graph: BundleGraph, at: Reduction, root: SquareRoot) -> Linearity | None:
    """Of an optimum.

    Parameters
    ----------
    graph : BundleGraph
    at : Reduction
        There.
    root : SquareRoot
        Of the information there; considered unknowns held.

    Returns
    -------
    Linearity or None
        None where nothing is shared. The same network gives the same draws.
    """
    if root.columns == 0:
        return None
    drawn = np.random.default_rng(0).standard_normal((root.columns, DRAWS))
    squares, lowest = np.sum(drawn**2, axis=0), graph.cost(at)
    rises = np.array([_cost(graph, at, move) for move in root.back(drawn).T]) - lowest
    if not np.all(np.isfinite(rises)):
        return Linearity(math.inf, math.inf, root.columns, DRAWS)
    ratios = 2.0 * rises / squares
    return Linearity(float(ratios.mean()), float(ratios.std(ddof=1)), root.columns, DRAWS)


def _cost(graph: BundleGraph, at: Reduction, move: Array) -> float:
    """Full cost at a state that lies a move (columns,) from the optimum."""
    return graph.cost(graph.reduction(at.orientation + move, COSTS, at))
