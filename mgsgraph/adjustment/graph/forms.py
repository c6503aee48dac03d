"""The bundle form of the graph, of every adjustment: orientation variables and their priors; points are solved and
eliminated inside (variable projection; Golub & Pereyra 1973). The explicit form is `adjustment.factor_graph`.
"""

from typing import Protocol

import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.sparse_cholesky import Factor
from mgsgraph.compiled import in_threads
from mgsgraph.geometry.records import Array, Index, no_rows
from mgsgraph.kernel import sweep
from mgsgraph.kernel.covariance import NUMBERS
from mgsgraph.kernel.rows import (
    Groups,
    Model,
    NormalBlocks,
    Rows,
    neighboring_pieces,
    partition,
)
from mgsgraph.kernel.sweep import SYSTEM, Reduction, all_residuals, point_covariances, reduce

MISFIT, SHARE, EFFECT, BETWEEN = slice(0, 2), slice(2, 4), slice(4, 6), 6
"""Columns of the kernel's numbers of the first two rows of observations (t, 8), side by side, lest each look-up cost
several: whitened residuals; diagonal of H; m that an error of one sigma moves the point; H between the two rows."""
_AT_A_TIME = 1 << 17
"""Observations that a thread takes at a time: their 3 x 7 numbers are 22 MB."""


def of_rows(values: Array, into: Array) -> None:
    """What observations say of themselves (t, 8), from the kernel's numbers of their rows (t, 3, 7)."""
    moved = values[:, :2, 4:]
    into[:, MISFIT], into[:, BETWEEN] = values[:, :2, 0], values[:, 0, 2]
    into[:, SHARE] = values[:, [0, 1], [1, 2]]
    into[:, EFFECT] = np.sqrt(np.einsum("tik,tik->ti", moved, moved))


def numbers(
    rows: Rows,
    groups: Groups,
    target: NormalBlocks,
    model: Model,
    orientation: Array,
    joint: Array,
    points: Array,
    ground: Index | None = None,
) -> tuple[Array, Array]:
    """What observations say of themselves (t, 8), and all that some of them (g,) do (g, 3, 7); other parameters as of
    `kernel.sweep.reliability`.
    """
    ground = no_rows() if ground is None else ground
    begins = np.append(rows.piece[:, 4], rows.weight.shape[1])
    of_all, chosen = np.empty((begins[-1], 8)), np.empty((ground.size, 3, NUMBERS))
    order = np.argsort(ground)

    def share(ends: tuple[int, int]) -> None:
        first, last = ends
        part, point = partition(rows, first, last), int(rows.piece[first, 1])
        places = points[point : point + part.kind.size]
        values = sweep.reliability(part, groups, target, model, orientation, joint, places)
        of_rows(values, of_all[begins[first] : begins[last]])
        of_part = order[slice(*np.searchsorted(ground, [begins[first], begins[last]], sorter=order))]
        chosen[of_part] = values[ground[of_part] - begins[first]]

    in_threads(share, neighboring_pieces(begins, _AT_A_TIME))
    return of_all, chosen


class Solving(Protocol):
    """Normal equations that are factored, ready for right sides."""

    def solve(self, right: Array) -> Array:
        """Solution (columns,), m and rad, for a right side per m and rad."""
        ...


def sparse_factor(layout: Layout, reduction: Reduction, damping: float = 0.0) -> Factor:
    """Cholesky factor of the full linear system at a reduction, damped in units of the unknowns' scales.

    Raises NotDefinite.
    """
    assert reduction.blocks is not None
    return factor_of_blocks(layout, reduction.blocks, damping)


def factor_of_blocks(layout: Layout, blocks: Array, damping: float = 0.0) -> Factor:
    """The same, of a reduced normal matrix (flat blocks of a layout)."""
    flat = blocks + layout.prior_information if layout.prior_information.size else blocks
    return layout.cholesky.factor(flat, layout.prior.weights**2 + damping / layout.scales**2, layout.scales)


class Sweeper:
    """Who goes over all points: this process's threads; a cluster's workers or a GPU where they take over what is here.
    Rows are a layout's, or made of them.
    """

    remark = ""
    """What a user should know of who it was."""

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None,
        rough: bool = False,
    ) -> Reduction:  # fmt: skip
        """All points solved (and eliminated), see `kernel.sweep.reduce`; `points` as in `BundleGraph.reduction`."""
        begin = points.points if isinstance(points, Reduction) else points
        return reduce(rows, layout.groups, layout.blocks.target, layout.model, orientation, task, begin, rough)

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        return point_covariances(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        return all_residuals(rows, layout.groups, layout.blocks.target, layout.model, orientation, points)

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage, see `numbers`."""
        return numbers(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)[0]

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Solving:
        """Factor of the full linear system at a reduction, see `sparse_factor`."""
        return sparse_factor(layout, reduction, damping)


IN_PROCESS = Sweeper()


class BundleGraph:
    """Factor graph on orientation variables alone; points are solved inside.

    Parameters
    ----------
    layout : Layout
    rows : Rows, optional
        The layout's rows with some left out (`Layout.active`); all of them when absent.
    sweeper : Sweeper
        Who goes over the points.
    """

    def __init__(self, layout: Layout, rows: Rows | None = None, sweeper: Sweeper = IN_PROCESS) -> None:
        self.layout, self.sweeper = layout, sweeper
        self.rows = layout.rows if rows is None else rows

    def reduction(
        self, orientation: Array, task: int = SYSTEM, points: Array | Reduction | None = None, rough: bool = False
    ) -> Reduction:
        """All points solved (and eliminated) at an orientation vector (columns,), beginning at `points` (n, 3), or
        where an earlier reduction ended; `rough` far from the optimum.
        """
        return self.sweeper.reduction(self.layout, self.rows, orientation, task, points, rough)

    def cost(self, reduction: Reduction) -> float:
        """Full cost: of all points, and of the priors on the shared unknowns."""
        return reduction.cost + self.layout.prior.cost(reduction.orientation)

    def gradient(self, reduction: Reduction) -> Array:
        """(columns,) of the full cost, per m and rad."""
        return reduction.gradient + self.layout.prior.gradient(reduction.orientation)

    def factor(self, reduction: Reduction, damping: float = 0.0) -> Factor:
        """Cholesky factor of the full linear system at a reduction, damped in units of the unknowns' scales.

        Raises NotDefinite.
        """
        return sparse_factor(self.layout, reduction, damping)
