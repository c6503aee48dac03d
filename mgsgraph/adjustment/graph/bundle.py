"""The bundle form: orientation variables, their priors, and one bundle factor per set of them."""

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.factors.bundle import Bundles, Reduction
from mgsgraph.factors.priors import orientation_prior
from mgsgraph.factors.rows import Rows
from mgsgraph.geometry.records import Array


def orientation_key(image: int) -> int:
    """GTSAM key of an image's orientation coefficients."""
    return int(gtsam.symbol("o", image))


def point_key(point: int) -> int:
    """GTSAM key of a ground point."""
    return int(gtsam.symbol("p", point))


def orientation_values(layout: Layout, orientation: Array) -> gtsam.Values:
    """GTSAM values of an orientation vector (columns,)."""
    values = gtsam.Values()
    for j in layout.adjusted_images():
        values.insert(orientation_key(j), orientation[layout.columns_of(j)])
    return values


def orientation_vector(layout: Layout, values: gtsam.Values) -> Array:
    """Orientation vector (columns,) of GTSAM values."""
    vector = np.zeros(layout.columns)
    for j in layout.adjusted_images():
        vector[layout.columns_of(j)] = values.atVector(orientation_key(j))
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
        images = layout.group_images
        self._bundles = Bundles(
            layout.rows if rows is None else rows,
            layout.groups,
            layout.model,
            [[orientation_key(j) for j in group] for group in images],
            [[layout.columns_of(j) for j in group] for group in images],
            layout.scales,
        )
        self.graph = gtsam.NonlinearFactorGraph()
        for j in layout.adjusted_images():
            self.graph.add(orientation_prior(orientation_key(j), layout.sigmas[layout.columns_of(j)]))
        for group in range(len(images)):
            if images[group]:
                self.graph.add(self._bundles.factor(group))

    def values(self, orientation: Array) -> gtsam.Values:
        """GTSAM values of an orientation vector (columns,)."""
        return orientation_values(self.layout, orientation)

    @property
    def constant_cost(self) -> float:
        """Cost of points that only held images see: no variable, so no factor carries it."""
        reduction = self._bundles.at(np.zeros(self.layout.columns), system=False)
        alone = [group for group, images in enumerate(self.layout.group_images) if not images]
        return float(reduction.group_cost[alone].sum())

    def reduction(self, orientation: Array, system: bool = True) -> Reduction:
        """All points solved (and eliminated) at an orientation vector (columns,)."""
        return self._bundles.at(orientation, system)
