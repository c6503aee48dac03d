"""What the nominal orientation makes of a network, before anything is solved."""

from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance, point_covariances
from mgsgraph.adjustment.datum import require_strength
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.bundle import IN_PROCESS, Sweeper
from mgsgraph.adjustment.predicted_lines import exactly, settled
from mgsgraph.adjustment.residuals import Residuals, residuals
from mgsgraph.adjustment.rounds import Selection, determined_points, everything, without_weak
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import PRIOR
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.network import Network


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """What the nominal orientation makes of the network."""

    places: Array
    """(n, 3) m, network order: a-priori places; for free points the intersection of their rays."""
    residuals: Residuals
    """There."""


def nominal_state(layout: Layout, before: Reduction, sweeper: Sweeper = IN_PROCESS) -> Nominal:
    """Places and residuals with the nominal orientation; `before` is the reduction there."""
    places = np.where((layout.rows.kind == PRIOR)[:, None], layout.rows.start, before.points)
    kept, orientation = layout.network_order(places), np.zeros(layout.columns)
    layout, places = exactly(layout, orientation, places, sweeper)  # a-priori places are not where the rays alone meet
    return Nominal(kept, residuals(layout, orientation, places, sweeper))


def nominal_reduction(
    layout: Layout, sweeper: Sweeper = IN_PROCESS, left_in: Selection | None = None
) -> tuple[Layout, Selection, Reduction]:
    """All points that are determined, and their reduction with the nominal orientation, rays laid out about the lines
    that it predicts.

    Raises PointBehindCamera, and WeakNetwork where nothing determines some direction of the orientation.
    """
    wanted, nominal = left_in or everything(layout.network), np.zeros(layout.columns)
    selection = wanted.without_stereo()
    before = BundleGraph(layout, selection.rows(layout), sweeper).reduction(nominal)
    strong = without_weak(layout, before, selection)
    if np.all(strong.out):
        raise InputError(
            "network",
            f"none of {len(layout.network.points)} points is determined by its rays",
            "points seen from two sides, or with an a-priori place",
        )
    if not np.array_equal(strong.out, selection.out):
        selection, before = strong, BundleGraph(layout, strong.rows(layout), sweeper).reduction(nominal)
    require_strength(layout, before)

    def again(anew: Layout) -> Reduction:
        return BundleGraph(anew, selection.rows(anew), sweeper).reduction(nominal)

    layout, before = settled(layout, before, again, own=True, sweeper=sweeper)
    return layout, replace(selection, stereo=wanted.stereo), before


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What the geometry and the a-priori sigmas alone say, before anything is solved."""

    places: Array
    """(n, 3) m, where the nominal orientation puts the points; NaN for undetermined ones."""
    covariances: Array
    """(n, 3, 3) m^2, of the points after the adjustment, for sigma0 = 1; NaN for undetermined ones."""
    residuals: Array
    """(k, 2) pixels, with the nominal orientation."""
    range_residuals: Array
    """(r,) m, with the nominal orientation."""


def predict(network: Network, settings: SolverSettings) -> Prediction:
    """Covariances that an adjustment of the network will have; raises what `adjust_network` raises before solving."""
    network.require_observed()
    layout, selection, before = nominal_reduction(lay_out(network, settings))
    rows, orientation = selection.rows(layout), np.zeros(layout.columns)
    joint = orientation_covariance(BundleGraph(layout, rows), before)
    covariances = point_covariances(layout, rows, orientation, before.points, joint)
    nominal = nominal_state(layout, before)
    blank = layout.network_order(np.where(determined_points(rows), 1.0, np.nan))
    return Prediction(
        nominal.places * blank[:, None],
        layout.network_order(covariances) * blank[:, None, None],
        nominal.residuals.image * blank[network.rays.point][:, None],
        nominal.residuals.ranges,
    )
