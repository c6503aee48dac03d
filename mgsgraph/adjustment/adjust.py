"""The main job: lay a network out, solve it (in passes, when blunders are sought), and read off the posterior."""

import importlib.metadata
import time
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.passes import (
    Progress,
    Selection,
    Solved,
    determined_points,
    everything,
    places_of_all,
    solve_in_passes,
    what_changes,
)
from mgsgraph.adjustment.posterior import (
    explicit_covariances,
    fit,
    orientation_covariance,
    point_covariances,
    require_strength,
    residuals,
)
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, PointBehindCamera
from mgsgraph.factors.bundle import Reduction
from mgsgraph.factors.kernels import BEHIND, WEAK
from mgsgraph.factors.rows import FIXED, PRIOR
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, PointClass

_Kind = TypeVar("_Kind", np.float64, np.bool_)


@dataclass(slots=True)
class _Clock:
    """Wall time by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.perf_counter)

    def stop(self, stage: str) -> None:
        """Book the time since the last stop."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now


def adjust_network(
    network: Network, settings: SolverSettings, name: str = "adjustment", progress: Progress = lambda _: None
) -> Solution:
    """Adjust a network.

    Parameters
    ----------
    network : Network
    settings : SolverSettings
    name : str
        What to call it in reports.
    progress : callable
        Called with every iteration.

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
    """
    clock = _Clock()
    layout = lay_out(network, settings)
    selection = everything(network)
    before = _before(layout, selection)
    selection = _without_weak(layout, before, selection)
    require_strength(layout, before)
    clock.stop("set up")
    solved = solve_in_passes(layout, settings, selection, progress)
    clock.stop("solve")
    return _posterior(settings, name, solved, before, clock)


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
    layout = lay_out(network, settings)
    selection = everything(network)
    before = _before(layout, selection)
    selection = _without_weak(layout, before, selection)
    require_strength(layout, before)
    rows, nominal = selection.rows(layout), np.zeros(layout.columns)
    joint = orientation_covariance(BundleGraph(layout, rows), nominal)
    covariances = point_covariances(layout, rows, nominal, before.points, joint)
    places = _places_before(layout, before)
    image, ranges = residuals(layout, nominal, places)
    blank = np.where(determined_points(rows), 1.0, np.nan)
    return Prediction(
        _unsorted(places * blank[:, None], layout.point_order),
        _unsorted(covariances * blank[:, None, None], layout.point_order),
        _unsorted(image * np.repeat(blank, np.diff(rows.ray_first))[:, None], layout.ray_order),
        _unsorted(ranges, layout.range_order),
    )


def _before(layout: Layout, selection: Selection) -> Reduction:
    """All points solved and eliminated with the nominal orientation."""
    return BundleGraph(layout, selection.rows(layout)).reduction(np.zeros(layout.columns))


def _without_weak(layout: Layout, reduction: Reduction, selection: Selection) -> Selection:
    """Leave out points whose rays determine no place; refuse points behind a camera."""
    network = layout.network
    behind = np.flatnonzero(reduction.states == BEHIND)
    if behind.size:
        raise _behind(layout, int(behind[0]), reduction.points[behind[0]])
    out = selection.out.copy()
    out[layout.point_order[reduction.states == WEAK]] = True
    if np.all(out):
        raise InputError(
            "network",
            f"none of {len(network.points)} points is determined by its rays",
            "points seen from two sides, or with an a-priori place",
        )
    return Selection(selection.rays, selection.ranges, out)


def _behind(layout: Layout, place: int, point: Array) -> PointBehindCamera:
    """The error for a point (place in the layout) that lies behind a camera: names point and image."""
    network, i = layout.network, int(layout.point_order[place])
    for k in np.flatnonzero(network.rays.point == i):
        image = network.images[network.rays.image[k]]
        pose = image.pose(network.rays.places[[k], 0])
        if (pose.matrix[0] @ (point - pose.position[0]))[2] <= 0.0:
            break
    return PointBehindCamera(
        f"point {network.points.ids[i]}, image {image.name}",
        "the point lies behind the camera",
        "a point before it",
        "check the point's a-priori place, the measure and the image's orientation",
    )


def _posterior(settings: SolverSettings, name: str, solved: Solved, before: Reduction, clock: _Clock) -> Solution:
    """Covariances, residuals and the record of it all."""
    layout, rows, orientation = solved.layout, solved.rows, solved.orientation
    network = layout.network
    graph = BundleGraph(layout, rows)
    if solved.explicit is not None:
        joint, covariances = explicit_covariances(layout, solved.explicit, solved.outcome.values)
    else:
        joint = orientation_covariance(graph, orientation)
        covariances = point_covariances(layout, rows, orientation, solved.points, joint)
    without_laser = _sigmas_without_laser(layout, solved)
    clock.stop("covariance")
    image, ranges = residuals(layout, orientation, places_of_all(layout, solved))
    places_before = _places_before(layout, before)
    image_before, ranges_before = residuals(layout, np.zeros(layout.columns), places_before)
    determined = determined_points(rows)
    owner = np.repeat(np.arange(determined.size), np.diff(rows.ray_first))
    never = solved.selection.out[layout.point_order][owner]
    image[never] = image_before[never] = np.nan
    profiles = range(len(network.images), layout.variables.first.size)
    coefficients = tuple(
        np.zeros_like(prior.sigmas) if network.held[j] else orientation[layout.columns_of(j)].reshape(-1, 6)
        for j, prior in enumerate(network.priors)
    )
    blank = np.where(determined, 1.0, np.nan)
    message = solved.outcome.message
    if solved.circling:
        what = what_changes(settings, network).capitalize()
        message += f" {what} don't come to rest; the best of the passes is kept."
    elif solved.passes > 1:
        message += f" {solved.passes} passes, until {what_changes(settings, network)} stayed as they were."
    return Solution(
        name=name,
        network=network,
        settings=settings,
        converged=solved.outcome.converged,
        message=message,
        history=solved.history,
        cost_initial=solved.cost_initial,
        cost_final=solved.outcome.cost_final,
        fit=fit(layout, rows, orientation, solved.points),
        coefficients=coefficients,
        first_column=layout.variables.first[: len(network.images)],
        shifts=np.array([orientation[layout.columns_of(v)] for v in profiles]).reshape(-1, 2),
        joint_covariance=joint,
        places_before=_unsorted(places_before * blank[:, None], layout.point_order),
        places=_unsorted(solved.points * blank[:, None], layout.point_order),
        covariances=_unsorted(covariances * blank[:, None, None], layout.point_order),
        determined=_unsorted(determined, layout.point_order),
        rays_used=_unsorted((rows.weight[:, 0] > 0.0) & determined[owner], layout.ray_order),
        ranges_used=_unsorted(rows.range_weight > 0.0, layout.range_order),
        residuals=_unsorted(image, layout.ray_order),
        residuals_before=_unsorted(image_before, layout.ray_order),
        range_residuals=_unsorted(ranges, layout.range_order),
        range_residuals_before=_unsorted(ranges_before, layout.range_order),
        sigmas_without_laser=without_laser,
        seconds=clock.seconds,
        versions=versions(),
    )


def _places_before(layout: Layout, before: Reduction) -> Array:
    """(n, 3) m, layout order: a-priori places; for free points the intersection with the nominal orientation."""
    return np.where((layout.rows.point_kind == PRIOR)[:, None], layout.rows.point_start, before.points)


def _unsorted(values: NDArray[_Kind], order: Index) -> NDArray[_Kind]:
    """Values in the layout's order, back in the network's."""
    result = np.empty_like(values)
    result[order] = values
    return result


def _sigmas_without_laser(layout: Layout, solved: Solved) -> Array | None:
    """(3,) m mean sigmas of the tie points, had there been no laser rows: covariance needs no observed values."""
    classes = layout.network.points.classes
    ties = classes == PointClass.TIE
    laser = classes == PointClass.LASER
    if not (np.any(ties) and np.any(laser)):
        return None
    rows = Selection(solved.selection.rays, np.zeros_like(solved.selection.ranges), solved.selection.out | laser).rows(
        layout
    )
    if np.any(np.isinf(layout.sigmas)):
        return None  # without the laser nothing may hold the datum
    joint = orientation_covariance(BundleGraph(layout, rows), solved.orientation)
    covariances = point_covariances(layout, rows, solved.orientation, solved.points, joint)
    mine = ties[layout.point_order] & (rows.point_kind != FIXED) & determined_points(rows)
    return np.sqrt(np.diagonal(covariances[mine], axis1=1, axis2=2)).mean(axis=0) if np.any(mine) else None


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in ("mgsgraph", "gtsam", "numpy", "numba")}
