"""Points where their rays alone put them: forward intersection with any orientation, and what it is worth.

A point is put where its rays meet, each ray by its own sigma, and what is not known of the orientation is carried on:
with V = B'B and W = A'B of the point's rays alone,

    S_p = V^-1 + V^-1 W' S_x W V^-1,

where S_x is the covariance of all shared unknowns that the point's rays feel. No point helps another one. With the
nominal orientation and the a-priori S_x, correlations among nodes included, that is the theoretical standard deviation
which Spiegel et al. (LPSC 2006) have a bundle adjustment improve by a factor of 2 to 3.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.covariances import point_covariances, prior_covariance
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.bundle import IN_PROCESS
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.predicted_lines import settled
from mgsgraph.adjustment.rounds import Selection, determined_points
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.sweep import COSTS
from mgsgraph.network import Network


class RaysAlone:
    """Forward intersection in a network without a terrain model (what is known of points beforehand counts, too).

    Parameters
    ----------
    network : Network
        Without a surface.
    selection : Selection
        Rays and ranges that take part.
    """

    def __init__(self, network: Network, settings: SolverSettings, selection: Selection) -> None:
        self._layout, self._selection = lay_out(network, settings), selection

    @cached_property
    def joint(self) -> JointCovariance | None:
        """A-priori covariance of the shared unknowns; None where of some nothing is known."""
        return prior_covariance(self._layout)

    def nominal(self) -> tuple[Array, Array]:
        """Positions (n, 3) in m with the nominal orientation, NaN for points that nothing determines, and covariances
        (n, 3, 3) in m^2 with the a-priori one, for sigma0 = 1; NaN there, and all where there is none.
        """
        orientation = np.zeros(self._layout.columns)
        layout, points = self._placed(orientation)
        if self.joint is None:
            covariances = np.full((*points.shape, 3), np.nan)
        else:
            covariances = point_covariances(layout, self._selection.rows(layout), orientation, points, self.joint)
        return self._whole(layout, points), self._whole(layout, covariances)

    def at(self, values: Sequence[Array]) -> tuple[Array, Array]:
        """Positions (n, 3), m, at given values of the shared unknowns, numbered as `Network` has them, and covariances
        (n, 3, 3) in m^2 as if these were true: of the rays' noise alone.
        """
        orientation = self._layout.variables.joined(values)
        layout, points = self._placed(orientation)
        known, rows = np.zeros(layout.blocks.target.size), self._selection.rows(layout)
        covariances = IN_PROCESS.covariances(layout, rows, orientation, known, points)
        return self._whole(layout, points), self._whole(layout, covariances)

    def _placed(self, orientation: Array) -> tuple[Layout, Array]:
        """Points (n, 3) where the unknowns put them, and the layout in whose order they are."""

        def again(layout: Layout) -> Reduction:
            return BundleGraph(layout, self._selection.rows(layout)).reduction(orientation, COSTS)

        layout, found = settled(self._layout, again(self._layout), again)
        return layout, found.points

    def _whole(self, layout: Layout, values: Array) -> Array:
        """Values (n, ...) in the network's order, NaN for points that nothing determines."""
        blank = np.where(determined_points(self._selection.rows(layout)), 1.0, np.nan)
        return layout.network_order(values * blank.reshape(-1, *[1] * (values.ndim - 1)))
