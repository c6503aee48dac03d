"""Reads a solution off the state at which an adjustment has stopped: unknowns, residuals, drivers, covariances."""

import importlib.metadata
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mgsgraph.adjustment.covariances import orientation_covariance, point_covariances
from mgsgraph.adjustment.drivers import Drivers, driver_sentences, drivers_of
from mgsgraph.adjustment.fit import Fit, fit, strained_orientations
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.graph.bundle import Sweeper
from mgsgraph.adjustment.graph.shared import pass_values, shared_values, shift_values
from mgsgraph.adjustment.linearity import MOST_POINTS, MOST_UNKNOWNS, Linearity, linearity
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.nominal import Nominal
from mgsgraph.adjustment.residuals import Residuals, residuals
from mgsgraph.adjustment.rounds import Solved, determined_points, places_of_all
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.kernel.rows import FIXED, NO_LOSS
from mgsgraph.network import PointClass


@dataclass(slots=True)
class Clock:
    """Wall time by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.perf_counter)

    def stop(self, stage: str) -> None:
        """Book the time since the last stop."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now


def read_off(
    settings: SolverSettings,
    name: str,
    solved: Solved,
    nominal: Nominal,
    clock: Clock,
    sweeper: Sweeper,
    mixture: JointCovariance | None,
) -> Solution:
    """The record of an adjustment; with several minima the joint covariance is their mixture's."""
    layout, rows, selection = solved.layout, solved.rows, solved.selection
    network, determined = layout.network, layout.network_order(determined_points(rows))
    without_laser = (None, None) if mixture is not None else _sigmas_without_laser(layout, solved, sweeper)
    clock.stop("without laser")
    unknowns = _unknowns(solved)
    left, judged, drivers = _misfit(solved, nominal, unknowns, sweeper, clock)
    joint, covariances, straight = _covariances(solved, mixture, sweeper, clock)
    return Solution(
        name=name,
        network=network,
        settings=settings,
        converged=solved.outcome.converged,
        message=_message(solved),
        history=solved.history,
        cost_initial=solved.cost_initial,
        cost_final=solved.outcome.cost_final,
        fit=judged,
        joint_covariance=joint,
        places_before=np.where(determined[:, None], nominal.places, np.nan),
        places=_blanked(layout, solved.points, determined),
        covariances=_blanked(layout, covariances, determined),
        determined=determined,
        rays_used=(rows.weight[0, layout.observation_rows.rays] > 0.0) & determined[network.rays.point],
        ranges_used=rows.weight[0, layout.observation_rows.ranges] > 0.0,
        residuals=left.image,
        residuals_before=nominal.residuals.image,
        range_residuals=left.ranges,
        range_residuals_before=nominal.residuals.ranges,
        sigmas_without_laser=without_laser[0],
        median_sigmas_without_laser=without_laser[1],
        seconds=clock.seconds,
        versions=versions(),
        rays_rejected=~selection.rays,
        ranges_rejected=~selection.ranges,
        stereo_rejected=~selection.stereo,
        test_dimensions=solved.dimensions,
        stereo_heights=np.where(determined, left.stereo, np.nan),
        linearity=straight,
        drivers=drivers,
        **unknowns,
    )


def _message(solved: Solved) -> str:
    """Why it stopped, and after how many passes."""
    if solved.circling:
        more = f" This holds for the best of {solved.rounds} passes; what was rejected still changed in each."
    else:
        more = f" {solved.rounds} passes, until rejected rows stayed as they were." if solved.rounds > 1 else ""
    return f"{solved.outcome.message}{more}"


def _unknowns(solved: Solved) -> dict[str, Any]:
    """Values of what points share, as `Solution` has them."""
    layout, orientation = solved.layout, solved.orientation
    network, variables = layout.network, layout.variables
    coefficients = tuple(
        orientation[layout.columns_of(j)].reshape(-1, 6) if own else np.zeros_like(network.priors[j].sigmas)
        for j, own in enumerate(network.with_polynomial.tolist())
    )
    shifts, lift = shift_values(network, variables, orientation)
    nodes, trends = pass_values(network, variables, orientation)
    shared = shared_values(network, variables, orientation)
    return {"coefficients": coefficients, "shifts": shifts, "lift": lift, "shared": shared, "nodes": nodes,
            "trends": trends}  # fmt: skip


# --- residuals, and what drives an adjustment that is no result


def _misfit(
    solved: Solved, nominal: Nominal, unknowns: Mapping[str, Any], sweeper: Sweeper, clock: Clock
) -> tuple[Residuals, Fit, Drivers | None]:
    """How the observations fit at the end, sigma0 of those that take part, and what drives an adjustment that is no
    result; books its stages. Raises SolverError (`_require_covariance`).
    """
    layout, orientation = solved.layout, solved.orientation
    found = residuals(layout, orientation, solved.points, sweeper)
    judged, drivers = fit(layout, solved.rows, orientation, solved.points, found), None
    strained = strained_orientations(layout.network, unknowns["coefficients"], unknowns["nodes"])
    if not solved.outcome.converged or judged.absurd or any(one.impossible for one in strained):
        drivers = _drivers(solved, found, sweeper)
        clock.stop("drivers")
    if not np.all(solved.selection.rays):  # points whose rays were rejected are shown where all their rays put them
        found = residuals(layout, orientation, places_of_all(layout, solved, sweeper), sweeper)
    never = solved.selection.out[layout.network.rays.point]
    found.image[never] = nominal.residuals.image[never] = np.nan
    clock.stop("residuals")
    if drivers is not None:
        _require_covariance(solved, drivers)
    return found, judged, drivers


def _drivers(solved: Solved, found: Residuals, sweeper: Sweeper) -> Drivers:
    """Which images and points drive an adjustment; `found` are the residuals at its end."""
    graph = BundleGraph(solved.layout, solved.rows, sweeper)
    damping = solved.outcome.history[-1].damping if solved.outcome.history else 0.0
    return drivers_of(graph, solved.reduction, damping, found)


def _require_covariance(solved: Solved, drivers: Drivers) -> None:
    """Raise SolverError, with what drives it, where an adjustment that did not converge has no covariance either."""
    layout, message = solved.layout, solved.outcome.message
    if solved.outcome.converged:
        return
    try:
        BundleGraph(layout, solved.rows).factor(solved.reduction)
    except NotDefinite:
        words = " ".join(driver_sentences(drivers, layout.network))
        raise SolverError(f"{message} What it stopped at determines no orientation. {words}") from None


# --- covariances


def _covariances(
    solved: Solved, mixture: JointCovariance | None, sweeper: Sweeper, clock: Clock
) -> tuple[JointCovariance, Array, Linearity | None]:
    """Joint covariance, covariances (n, 3, 3) of points in m^2, layout order, and whether it is linear enough."""
    layout, rows = solved.layout, solved.rows
    joint = orientation_covariance(BundleGraph(layout, rows), solved.reduction)
    straight = _linearity(layout, solved, joint, sweeper)
    clock.stop("linearity")
    joint = joint if mixture is None else mixture
    covariances = point_covariances(layout, rows, solved.orientation, solved.points, joint, sweeper)
    clock.stop("covariance")
    return joint, covariances, straight


def _linearity(layout: Layout, solved: Solved, joint: JointCovariance, sweeper: Sweeper) -> Linearity | None:
    """Whether the joint covariance may be used; None of large networks, and of costs that are no sums of squares."""
    large = len(layout.network.points) > MOST_POINTS or layout.columns > MOST_UNKNOWNS
    if large or layout.model.loss != NO_LOSS or not solved.outcome.converged:
        return None
    graph = BundleGraph(layout, solved.rows, sweeper)
    if layout.prior.considered:
        joint = orientation_covariance(graph, solved.reduction, consider=False)
    return linearity(graph, solved.reduction, joint.square_root)


def _blanked(layout: Layout, values: Array, determined: Mask) -> Array:
    """Values (n, ...) in the network's order, NaN for undetermined points; done in place, a component at a time."""
    for column in values.reshape(values.shape[0], -1).T:
        column[:] = np.where(determined, layout.network_order(column), np.nan)
    return values


def _sigmas_without_laser(
    layout: Layout, solved: Solved, sweeper: Sweeper
) -> tuple[Array, Array] | tuple[None, None]:
    """(3,) m mean and median sigmas of the tie points, had there been no laser rows; no observed values are needed."""
    classes = layout.network.points.classes
    ties = classes == PointClass.TIE
    laser = classes == PointClass.LASER
    if not (np.any(ties) and np.any(laser)):
        return None, None
    left = solved.selection
    rows = replace(left, ranges=np.zeros_like(left.ranges), out=left.out | laser).rows(layout)
    if np.any(np.isinf(layout.sigmas)):
        return None, None  # without the laser nothing may hold the datum
    graph = BundleGraph(layout, rows, sweeper)
    reduction = graph.reduction(solved.orientation, points=solved.points)
    joint = orientation_covariance(graph, reduction)
    covariances = point_covariances(layout, rows, solved.orientation, solved.points, joint, sweeper)
    mine = ties[layout.point_order] & (rows.kind != FIXED) & determined_points(rows)
    if not np.any(mine):
        return None, None
    sigmas = [np.sqrt(covariances[mine, axis, axis]) for axis in range(3)]
    return np.array([one.mean() for one in sigmas]), np.array([np.median(one) for one in sigmas])


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in ("mgsgraph", "gtsam", "numpy", "numba")}
