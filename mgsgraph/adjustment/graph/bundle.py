"""The bundle form: orientation variables, their priors, and one bundle factor per set of them."""

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.factors.bundle import Bundles, Reduction
from mgsgraph.factors.priors import zero_prior
from mgsgraph.factors.rows import Rows
from mgsgraph.geometry.records import Array


def orientation_key(image: int) -> int:
    """GTSAM key of an image's orientation coefficients."""
    return int(gtsam.symbol("o", image))


def point_key(point: int) -> int:
    """GTSAM key of a ground point."""
    return int(gtsam.symbol("p", point))


def shift_key(profile: int) -> int:
    """GTSAM key of the horizontal shift of a laser profile (or, after them, of the terrain model)."""
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


class BundleGraph:
    """Factor graph on orientation variables alone; points are solved inside.

    Parameters
    ----------
    layout : Layout
    rows : Rows, optional
        The layout's rows with some left out (`Layout.active`); all of them when absent.
    """

    def __init__(self, layout: Layout, rows: Rows | None = None) -> None:
        self.layout = layout
        groups = layout.group_variables
        self._bundles = Bundles(
            layout.rows if rows is None else rows,
            layout.groups,
            layout.model,
            [[variable_key(layout, v) for v in group] for group in groups],
            [[layout.columns_of(v) for v in group] for group in groups],
            layout.scales,
        )
        self.graph = gtsam.NonlinearFactorGraph()
        for v in layout.variables.adjusted():
            self.graph.add(zero_prior(variable_key(layout, v), layout.sigmas[layout.columns_of(v)]))
        for group in range(len(groups)):
            if groups[group]:
                self.graph.add(self._bundles.factor(group))

    def values(self, orientation: Array) -> gtsam.Values:
        """GTSAM values of an orientation vector (columns,)."""
        return shared_values(self.layout, orientation)

    @property
    def constant_cost(self) -> float:
        """Cost of points that only held images see: no variable, so no factor carries it."""
        reduction = self._bundles.at(np.zeros(self.layout.columns), system=False)
        alone = [group for group, members in enumerate(self.layout.group_variables) if not members]
        return float(reduction.group_cost[alone].sum())

    def reduction(self, orientation: Array, system: bool = True) -> Reduction:
        """All points solved (and eliminated) at an orientation vector (columns,)."""
        return self._bundles.at(orientation, system)
