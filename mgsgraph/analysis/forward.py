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

import gtsam
import numpy as np

from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, prior_factors, shared_values
from mgsgraph.adjustment.marginals import JointCovariance, joint_covariance
from mgsgraph.adjustment.passes import Selection, determined_points
from mgsgraph.adjustment.posterior import point_covariances, shared_marginals
from mgsgraph.adjustment.predicted_lines import settled
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.square_root import SquareRoot, in_cliques, is_indeterminate
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
        orientation = np.zeros(self._layout.columns)
        for v in self._layout.variables.adjusted():
            orientation[self._layout.columns_of(v)] = values[v]
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


def prior_covariance(layout: Layout) -> JointCovariance | None:
    """Joint covariance of the shared unknowns as their priors alone have it; None where of some nothing is known."""
    if np.any(np.isinf(layout.sigmas)):
        return None
    graph = gtsam.NonlinearFactorGraph()
    for factor in prior_factors(layout):
        graph.add(factor)
    try:
        return shared_marginals(layout, graph.linearize(shared_values(layout, np.zeros(layout.columns))))
    except RuntimeError as error:
        if not is_indeterminate(error):
            raise
    return joint_covariance(_strip_by_strip(layout))


def _strip_by_strip(layout: Layout) -> SquareRoot:
    """Square root of the priors' information by a dense QR decomposition of each strip's rows.

    GTSAM calls a clique indeterminate when a pivot falls below 2^-24 of the diagonal it began with, which nodes
    bring about that may hardly leave a trend of which little is known. The rows themselves lose half as many digits as
    their squares.
    """
    variables, every, scales = layout.variables, layout.prior.every.tocsc(), layout.scales
    cliques, rows = _known_together(layout), list[Array]()
    for members in cliques:
        columns = np.concatenate([np.arange(variables.first[v], variables.columns_of(v).stop) for v in members])
        part = every[:, columns]
        own = part[np.unique(part.nonzero()[0])].toarray() * scales[columns]
        rows.append(np.linalg.qr(own, mode="r") / scales[columns])
    return in_cliques(variables.first, variables.width, cliques, rows)


def _known_together(layout: Layout) -> list[list[int]]:
    """Adjusted variables in groups that no prior joins: strip by strip, and any other by itself."""
    adjusted = np.array(layout.variables.adjusted(), dtype=np.int64)
    strip = np.searchsorted(layout.network.first_of_strips, adjusted, side="right") - 1
    alone = [[v] for v in adjusted[strip < 0].tolist()]
    return alone + [adjusted[strip == k].tolist() for k in np.unique(strip[strip >= 0]).tolist()]
