"""The main job: lay a network out, solve it (in passes, when blunders are sought), and compute the posterior.

The module also computes positions and residuals with the nominal orientation, before anything is solved.
"""

import importlib.metadata
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mgsgraph.adjustment.cluster.connection import Connection
from mgsgraph.adjustment.cluster.partitions import Partitions
from mgsgraph.adjustment.covariances import (
    MOST_POINTS,
    MOST_UNKNOWNS,
    Linearity,
    linearity,
    orientation_covariance,
    point_covariances,
)
from mgsgraph.adjustment.datum import require_strength
from mgsgraph.adjustment.drivers import Drivers, driver_sentences, drivers_of
from mgsgraph.adjustment.fit import Fit, Residuals, errors_with_footprints, fit, residuals, strained_orientations
from mgsgraph.adjustment.gpu import require_usable, sweeper_of
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.graph.forms import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.variables import pass_values, shared_values, shift_values
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.multistart import best_of_starts, starts_wanted
from mgsgraph.adjustment.rounds import (
    Selection,
    Solved,
    all_rows,
    determined_points,
    exactly,
    places_of_all,
    relinearized,
    solve_in_rounds,
    without_weak,
)
from mgsgraph.adjustment.settings import Progress, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import InputError, SolverError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.kernel.rows import FIXED, NO_LOSS, PRIOR
from mgsgraph.kernel.sweep import Reduction
from mgsgraph.kernel.sweep import compile_sweep_beside as compile_sweep_beside
from mgsgraph.network import Network, PointClass
from mgsgraph.network.corrections import require_supported
from mgsgraph.workers import no_progress


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """Positions and residuals with the nominal orientation."""

    places: Array
    """(n, 3) m, network order: a-priori places; for free points the intersection of their rays."""
    residuals: Residuals
    """There."""


def nominal_state(layout: Layout, before: Reduction, sweeper: Sweeper = IN_PROCESS) -> Nominal:
    """Places and residuals with the nominal orientation; `before` is the reduction there."""
    places = np.where((layout.rows.kind == PRIOR)[:, None], layout.rows.start, before.points)
    nominal, orientation = layout.network_order(places), np.zeros(layout.columns)
    layout, places = exactly(layout, orientation, places, sweeper)  # a-priori places are not where the rays alone meet
    return Nominal(nominal, residuals(layout, orientation, places, sweeper))


def nominal_reduction(
    layout: Layout, sweeper: Sweeper = IN_PROCESS, left_in: Selection | None = None
) -> tuple[Layout, Selection, Reduction]:
    """All points that are determined, and their reduction with the nominal orientation, rays laid out about the lines
    that it predicts.

    Raises PointBehindCamera, and WeakNetwork where nothing determines some direction of the orientation.
    """
    wanted, nominal = left_in or all_rows(layout.network), np.zeros(layout.columns)
    selection = wanted.without_stereo()
    before = BundleGraph(layout, selection.rows(layout), sweeper).reduction(nominal)
    strong = without_weak(layout, before, selection)
    require(
        not np.all(strong.out), "network", f"none of {len(layout.network.points)} points is determined by its rays",
        "points seen from two sides, or with an a-priori place",
    )  # fmt: skip
    if not np.array_equal(strong.out, selection.out):
        selection, before = strong, BundleGraph(layout, strong.rows(layout), sweeper).reduction(nominal)
    require_strength(layout, before)
    layout, before = relinearized(layout, selection, before, in_place=True, sweeper=sweeper)
    return layout, replace(selection, stereo=wanted.stereo), before


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predictions from the geometry and the a-priori sigmas, before anything is solved."""

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
    layout, selection, before = nominal_reduction(lay_out(network, settings).convex)
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




@dataclass(slots=True)
class Clock:
    """Wall time by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.perf_counter)

    def stop(self, stage: str) -> None:
        """Record the time since the last stop."""
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
    at_end, judged, drivers = _misfit(solved, nominal, unknowns, sweeper, clock)
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
        residuals=at_end.image,
        residuals_before=nominal.residuals.image,
        range_residuals=at_end.ranges,
        range_residuals_before=nominal.residuals.ranges,
        sigmas_without_laser=without_laser[0],
        median_sigmas_without_laser=without_laser[1],
        seconds=clock.seconds,
        versions=versions(),
        rays_rejected=~selection.rays,
        ranges_rejected=~selection.ranges,
        stereo_rejected=~selection.stereo,
        test_dimensions=solved.dimensions,
        stereo_heights=np.where(determined, at_end.stereo, np.nan),
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
        orientation[layout.columns_of(j)].reshape(-1, 6) if adjusted else np.zeros_like(network.priors[j].sigmas)
        for j, adjusted in enumerate(network.with_polynomial.tolist())
    )
    shifts, lift = shift_values(network, variables, orientation)
    nodes, trends = pass_values(network, variables, orientation)
    shared = shared_values(network, variables, orientation)
    common = tuple(variables.split(orientation)[int(network.first_of_passes[-1]) :])
    return {"coefficients": coefficients, "shifts": shifts, "lift": lift, "shared": shared, "nodes": nodes,
            "trends": trends, "common": common}  # fmt: skip


# --- residuals, and what drives an adjustment that failed the sanity checks


def _misfit(
    solved: Solved, nominal: Nominal, unknowns: Mapping[str, Any], sweeper: Sweeper, clock: Clock
) -> tuple[Residuals, Fit, Drivers | None]:
    """Residuals at the end, sigma0 of the rows that take part, and what drives an adjustment that is not valid; records
    the time of its stages. Raises SolverError (`_require_covariance`).
    """
    layout, orientation = solved.layout, solved.orientation
    at_end = residuals(layout, orientation, solved.points, sweeper)
    judged, drivers = fit(layout, solved.rows, orientation, solved.points, at_end), None
    strained = strained_orientations(layout.network, unknowns["coefficients"], unknowns["nodes"])
    if not solved.outcome.converged or judged.absurd or any(image.impossible for image in strained):
        drivers = drivers_of(BundleGraph(layout, solved.rows, sweeper), solved.reduction, at_end)
        clock.stop("drivers")
    places = solved.points
    if not np.all(solved.selection.rays):  # points with rejected rays are shown where all rays put them
        places = places_of_all(layout, solved, sweeper)
        at_end = residuals(layout, orientation, places, sweeper)
    at_end.ranges[:] += errors_with_footprints(layout, orientation, places)
    rays = layout.network.common_rays
    if rays is not None:
        at_end.image[rays.members] += rays.errors(unknowns["common"]) * layout.network.rays.sigmas[rays.members]
    never = solved.selection.out[layout.network.rays.point]
    at_end.image[never] = nominal.residuals.image[never] = np.nan
    clock.stop("residuals")
    if drivers is not None:
        _require_covariance(solved, drivers)
    return at_end, judged, drivers


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
    selection = solved.selection
    rows = replace(selection, ranges=np.zeros_like(selection.ranges), out=selection.out | laser).rows(layout)
    if np.any(np.isinf(layout.sigmas)):
        return None, None  # without the laser nothing may hold the datum
    graph = BundleGraph(layout, rows, sweeper)
    joint = orientation_covariance(graph, graph.reduction(solved.orientation, points=solved.points))
    covariances = point_covariances(layout, rows, solved.orientation, solved.points, joint, sweeper)
    chosen = ties[layout.point_order] & (rows.kind != FIXED) & determined_points(rows)
    if not np.any(chosen):
        return None, None
    sigmas = [np.sqrt(covariances[chosen, axis, axis]) for axis in range(3)]
    return np.array([of_axis.mean() for of_axis in sigmas]), np.array([np.median(of_axis) for of_axis in sigmas])


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in ("mgsgraph", "gtsam", "numpy", "numba")}




def adjust_network(
    network: Network,
    settings: SolverSettings | None = None,
    name: str = "adjustment",
    progress: Progress = no_progress,
    cluster: Connection | None = None,
    left_in: Selection | None = None,
    begin: Sequence[Array] | None = None,
) -> Solution:
    """Adjust a network.

    Parameters
    ----------
    network : Network
    settings : SolverSettings, optional
        The defaults when absent.
    name : str
        What to call it in reports.
    progress : callable
        Called with every iteration.
    cluster : Connection, optional
        Whose workers hold the points, in partitions (`cluster.open_cluster`); this process when absent.
    left_in : Selection, optional
        Rays and ranges that take part; all when absent. Not together with a blunder limit, which judges all anew.
    begin : sequence of array, optional
        Value of each variable, as `Solution.values`, where the optimiser begins; the nominal orientation when absent,
        or, with stereo rows, the images' own adjustment.

    Returns
    -------
    Solution
        Also when it did not converge: its message says so.

    Raises
    ------
    PointBehindCamera
        A point lies behind a camera that has seen it, with the nominal orientation.
    WeakNetwork
        Nothing determines some direction of the orientation.
    InputError
        Orientation images with too few rays near them, closer than the data supports.
        A GPU on a cluster; a partition that is too large for its worker; no GPU, or one
        with too little memory, where one is asked for.
    SolverError
        The cluster has gone.

    Examples
    --------
    >>> settings = mgsgraph.SolverSettings(loss="huber")
    >>> robust = mgsgraph.adjust_network(network, settings, "with Huber's loss")
    >>> robust.converged, round(robust.sigma0, 2)
    (True, 1.1)
    """
    clock, settings = Clock(), settings or SolverSettings()
    if cluster is not None and settings.device == "cuda":
        raise InputError(cluster.where, "solver, device 'cuda'", "'cpu' on a cluster", "take one of both")
    require_usable(settings)
    network.require_observed()
    require_supported(network, taken=None if left_in is None else left_in.rays, between=True)
    layout = lay_out(network, settings)
    clock.stop("set up")
    with _sweeper(layout, settings, cluster) as sweeper:
        if cluster is not None:
            clock.stop("send to workers")
        layout, selection, before = nominal_reduction(layout.convex, sweeper, left_in)
        if settings.loss != "none":
            _require_redundancy(layout, selection)
        clock.stop("solve")
        nominal = nominal_state(layout, before, sweeper)
        clock.stop("residuals")
        orientation = None if begin is None else layout.variables.joined(begin)
        solved = solve_in_rounds(layout, settings, selection, before, progress, sweeper, orientation)
        clock.stop("solve")
        starts = 0 if begin is not None else starts_wanted(network, settings, layout)
        minima, mixture = None, None
        if starts and solved.outcome.converged:
            solved, minima, mixture = best_of_starts(solved, settings, before, starts, sweeper)
            clock.stop("starts")
        _require_ties(name, solved)
        del before, layout  # the posterior needs the memory
        solution = read_off(settings, name, solved, nominal, clock, sweeper, mixture)
        return replace(solution, minima=minima, message=" ".join(filter(None, [solution.message, sweeper.remark])))


def _require_redundancy(layout: Layout, selection: Selection) -> None:
    """Raise InputError for a robust loss where each row is needed for its point, or for an unknown without a prior: its
    residual is always zero.
    """
    network, n = layout.network, len(layout.network.points)
    kinds, surface, stereo = network.points.kinds, network.surface, network.stereo
    rows = 2 * np.bincount(network.rays.point[selection.rays], minlength=n)
    rows += np.bincount(network.ranges.point[selection.ranges], minlength=n) + 3 * (kinds == PointKind.CONSTRAINED)
    rows += 0 if surface is None else np.isfinite(surface.sigmas)
    rows += 0 if stereo is None else selection.stereo & (stereo.surface >= 0)
    spare = np.maximum(rows - 3 * (kinds != PointKind.FIXED), 0)[~selection.out].sum()
    if spare <= np.count_nonzero(np.isinf(layout.sigmas)):
        raise InputError(
            "solver, loss", "a robust loss, and no redundancy: each measurement is needed",
            "points with more measurements than it takes to place them", "take loss = \"none\", or add measurements",
        )  # fmt: skip


def _require_ties(name: str, solved: Solved) -> None:
    """Raise InputError where all tie points with two rays or more are lost: the remaining observations do not connect
    the images.
    """
    network = solved.layout.network
    ties = (network.points.classes == PointClass.TIE) & (network.ray_counts > 1)
    taking = np.bincount(network.rays.point, solved.selection.rays, len(network.points))
    remaining = solved.layout.network_order(determined_points(solved.rows)) & (taking > 0)
    if np.any(ties) and not np.any(ties & remaining):
        total, weak = int(np.count_nonzero(ties)), int(np.count_nonzero(ties & (taking > 1)))
        raise InputError(
            name, f"none of {total} tie points is left ({total - weak} rejected, {weak} not determined by their rays)",
            "ties that agree with the orientations, heights and laser shots",
            "look at mgsgraph check: images, lines and samples, or columns interchanged, orientations far off; "
            "without rejection (reject = 0) the table of residuals shows by how much",
        )


@contextmanager
def _sweeper(layout: Layout, settings: SolverSettings, cluster: Connection | None) -> Iterator[Sweeper]:
    """Who goes over the points."""
    if cluster is None:
        yield sweeper_of(settings, layout)
        return
    with Partitions(cluster, layout) as partitions:
        yield partitions
