"""The bundle form: orientation variables and their priors, points solved and eliminated inside (variable projection;
Golub & Pereyra 1973).
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Protocol

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.sparse_cholesky import Factor
from mgsgraph.compiled import in_threads
from mgsgraph.factors.priors import linear_prior, zero_prior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel import sweep
from mgsgraph.kernel.covariance import NUMBERS
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows, partition
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
    ground = np.zeros(0, dtype=np.int64) if ground is None else ground
    begins = np.append(rows.piece[:, 4], rows.weight.shape[1])
    found, chosen = np.empty((begins[-1], 8)), np.empty((ground.size, 3, NUMBERS))
    order = np.argsort(ground)

    def share(ends: tuple[int, int]) -> None:
        first, last = ends
        mine, point = partition(rows, first, last), int(rows.piece[first, 1])
        places = points[point : point + mine.kind.size]
        values = sweep.reliability(mine, groups, target, model, orientation, joint, places)
        of_rows(values, found[begins[first] : begins[last]])
        own = order[slice(*np.searchsorted(ground, [begins[first], begins[last]], sorter=order))]
        chosen[own] = values[ground[own] - begins[first]]

    edges = np.unique(np.searchsorted(begins, [*range(0, begins[-1], _AT_A_TIME), begins[-1]])).tolist()
    in_threads(share, pairwise(edges))
    return found, chosen


def orientation_key(image: int) -> int:
    """GTSAM key of an image's orientation coefficients."""
    return int(gtsam.symbol("o", image))


def point_key(point: int) -> int:
    """GTSAM key of a ground point."""
    return int(gtsam.symbol("p", point))


def shift_key(profile: int) -> int:
    """GTSAM key of the horizontal shift of a laser profile; after these, of the terrain model and of what is shared."""
    return int(gtsam.symbol("s", profile))


def variable_key(layout: Layout, variable: int) -> int:
    """GTSAM key of a shared unknown."""
    images = layout.variables.images
    return orientation_key(variable) if variable < images else shift_key(variable - images)


def shared_values(layout: Layout, vector: Array) -> gtsam.Values:
    """GTSAM values of the vector of shared unknowns (columns,)."""
    values = gtsam.Values()
    for v in layout.variables.adjusted():
        values.insert(variable_key(layout, v), vector[layout.columns_of(v)])
    return values


def shared_vector(layout: Layout, values: gtsam.Values) -> Array:
    """Vector of shared unknowns (columns,) of GTSAM values."""
    vector = np.zeros(layout.columns)
    for v in layout.variables.adjusted():
        vector[layout.columns_of(v)] = values.atVector(variable_key(layout, v))
    return vector


def prior_factors(layout: Layout) -> Iterator[gtsam.NonlinearFactor]:
    """What is known of the shared unknowns beforehand, as GTSAM's factors."""
    for v in layout.variables.adjusted():
        if v not in layout.prior.joined or np.any(layout.prior.weights[layout.columns_of(v)]):
            yield zero_prior(variable_key(layout, v), layout.variables.prior_sigmas[layout.columns_of(v)])
    for factor in layout.prior.factors:
        yield linear_prior([variable_key(layout, v) for v in factor.variables], factor.blocks, factor.target)


class Solving(Protocol):
    """Factored equations."""

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


class Sweeper(Protocol):
    """Who goes over all points: this process, a cluster's workers, or a GPU. Rows are a layout's, or made of them."""

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None
    ) -> Reduction:
        """All points solved (and eliminated), see `kernel.sweep.reduce`; `points` as in `BundleGraph.reduction`."""
        ...

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """(n, 3, 3) m^2, see `kernel.sweep.point_covariances`."""
        ...

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """(t, 2), see `kernel.sweep.all_residuals`."""
        ...

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """(t, 8), see `numbers`."""
        ...

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Solving:
        """Factor of the full linear system at a reduction, see `sparse_factor`."""
        ...


class InProcess:
    """Sweeps by this process's threads."""

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None
    ) -> Reduction:
        """All points solved (and eliminated)."""
        begin = points.points if isinstance(points, Reduction) else points
        return reduce(rows, layout.groups, layout.blocks.target, layout.model, orientation, task, begin)

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        return point_covariances(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        return all_residuals(rows, layout.groups, layout.blocks.target, layout.model, orientation, points)

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage."""
        return numbers(rows, layout.groups, layout.blocks.target, layout.model, orientation, joint, points)[0]

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Factor:
        """Factor of the full linear system at a reduction."""
        return sparse_factor(layout, reduction, damping)


IN_PROCESS = InProcess()


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

    def reduction(self, orientation: Array, task: int = SYSTEM, points: Array | Reduction | None = None) -> Reduction:
        """All points solved (and eliminated) at an orientation vector (columns,), beginning at `points` (n, 3), or
        where an earlier reduction ended.
        """
        return self.sweeper.reduction(self.layout, self.rows, orientation, task, points)

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
