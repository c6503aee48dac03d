"""The bundle form: orientation variables and their priors, points solved and eliminated inside.

For the batch engine the reduced system goes to GTSAM as Hessian factors of variable pairs (`BundleGraph.linear`); as
bundle factors, one per set of variables, it fits any GTSAM graph (`BundleGraph.graph`).
"""

from collections.abc import Iterator
from functools import cached_property
from typing import Protocol

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.bundle_factors import Bundles
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.graph.leverage import numbers
from mgsgraph.adjustment.graph.patterns import group_blocks
from mgsgraph.adjustment.graph.relinearize import about_followed_lines
from mgsgraph.adjustment.sparse_cholesky import Factor
from mgsgraph.factors.priors import linear_prior, zero_prior
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction, all_residuals, point_covariances, reduce
from mgsgraph.kernel.rows import Rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM


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


def pair_factor(first: int, second: int, block: Array) -> gtsam.HessianFactor:
    """Factor of a block off the diagonal of a normal matrix, of the variables of two keys."""
    none, other = np.zeros((block.shape[0],) * 2), np.zeros((block.shape[1],) * 2)
    zero, zeros = np.zeros(block.shape[0]), np.zeros(block.shape[1])
    return gtsam.HessianFactor(first, second, none, block, zero, other, zeros, 0.0)


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
        """All points solved (and eliminated), see `kernel.reduction.reduce`; `points` as in `BundleGraph.reduction`."""
        ...

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """(n, 3, 3) m^2, see `kernel.reduction.point_covariances`."""
        ...

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """(t, 2), see `kernel.reduction.all_residuals`."""
        ...

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """(t, 8), see `leverage.numbers`."""
        ...

    def about_lines(self, layout: Layout, orientation: Array, points: Array, near: float, own: bool) -> Layout:
        """Rays about the lines predicted for points (n, 3), see `following.about_followed_lines`."""
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

    def about_lines(self, layout: Layout, orientation: Array, points: Array, near: float, own: bool) -> Layout:
        """Rays about the lines predicted for points (n, 3)."""
        return about_followed_lines(layout, orientation, points, near, own)

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
        Who goes over the points; bundle factors (`graph`) are always this process's.
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

    def linear(self, reduction: Reduction) -> gtsam.GaussianFactorGraph:
        """The full linear system at a reduction: one Hessian factor per variable (its prior in it) and per pair.

        Single factors of pairs are indefinite; only their sum is a normal matrix.
        """
        assert reduction.blocks is not None
        layout, gradient = self.layout, self.gradient(reduction)
        precision, graph = layout.prior.weights**2, gtsam.GaussianFactorGraph()
        flat = reduction.blocks + layout.prior_information if layout.prior_information.size else reduction.blocks
        for v, w, block in layout.blocks.each(flat, layout.variables.width):
            if v == w:
                columns = layout.columns_of(v)
                graph.push_back(
                    gtsam.HessianFactor(self._keys[v], block + np.diag(precision[columns]), -gradient[columns], 0.0)
                )
            else:
                graph.push_back(pair_factor(self._keys[v], self._keys[w], block))
        return graph

    def factor(self, reduction: Reduction, damping: float = 0.0) -> Factor:
        """Cholesky factor of the same system, damped in units of the unknowns' scales.

        Raises NotDefinite.
        """
        return sparse_factor(self.layout, reduction, damping)

    @cached_property
    def _keys(self) -> dict[int, int]:
        """GTSAM keys of the adjusted variables."""
        return {v: variable_key(self.layout, v) for v in self.layout.variables.adjusted()}

    @cached_property
    def _bundles(self) -> Bundles:
        layout = self.layout
        groups = layout.group_variables
        return Bundles(
            self.rows,
            layout.groups,
            group_blocks(layout.groups),
            layout.model,
            [[self._keys[v] for v in group] for group in groups],
            [[layout.columns_of(v) for v in group] for group in groups],
            layout.scales,
        )

    @cached_property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """Priors and bundle factors, for GTSAM's own optimisers and for iSAM2."""
        graph = gtsam.NonlinearFactorGraph()
        for factor in prior_factors(self.layout):
            graph.add(factor)
        for group, members in enumerate(self.layout.group_variables):
            if members:
                graph.add(self._bundles.factor(group))
        return graph

    def values(self, orientation: Array) -> gtsam.Values:
        """GTSAM values of an orientation vector (columns,)."""
        return shared_values(self.layout, orientation)

    @property
    def constant_cost(self) -> float:
        """Cost of points that only held images see: no variable, so no bundle factor carries it."""
        reduction = self.reduction(np.zeros(self.layout.columns), COSTS)
        alone = [group for group, members in enumerate(self.layout.group_variables) if not members]
        owner = self.rows.pattern_group[self.rows.piece[:, 0]]
        return float(reduction.piece_cost[np.isin(owner, alone)].sum())
