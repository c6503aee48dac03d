"""The main job: lay a network out, solve it (in passes, when blunders are sought), and read off the posterior."""

import importlib.metadata
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.batch import Iteration, Outcome, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, Layout, explicit_graph, lay_out
from mgsgraph.adjustment.graph.bundle import point_key, shared_vector, variable_key
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
from mgsgraph.factors.rows import FIXED, OUT, PRIOR, Rows
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network, PointClass
from mgsgraph.ties import PointKind

Progress = Callable[[Iteration], None]
_Kind = TypeVar("_Kind", np.float64, np.bool_)

_MOST_PASSES = 10
_POINT_SCALE = 100.0
"""m, unit of a point's step in the damping of the explicit form."""
_FLOOR = 0.1
"""A-priori sigmas below which a class's spread is not taken at its word when blunders are sought."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _Selection:
    """Which rows take part, in network order."""

    rays: Mask
    """(k,)"""
    ranges: Mask
    """(r,)"""
    out: Mask
    """(n,) points that nothing determines, whatever is rejected."""

    def same(self, other: "_Selection") -> bool:
        """Whether the same rays and ranges take part."""
        return np.array_equal(self.rays, other.rays) and np.array_equal(self.ranges, other.ranges)

    def rows(self, layout: Layout) -> Rows:
        """The layout's rows that take part; free points that rejection has left with fewer than two rays go too."""
        network = layout.network
        left = np.bincount(network.rays.point, self.rays, len(network.points))
        return layout.active(self.rays, self.ranges, self.out | ((network.points.kinds == PointKind.FREE) & (left < 2)))


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
    selection = _everything(network)
    before = _before(layout, selection)
    selection = _without_weak(layout, before, selection)
    require_strength(layout, before)
    clock.stop("set up")
    solved = _solve_in_passes(layout, settings, selection, progress)
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
    selection = _everything(network)
    before = _before(layout, selection)
    selection = _without_weak(layout, before, selection)
    require_strength(layout, before)
    rows, nominal = selection.rows(layout), np.zeros(layout.columns)
    joint = orientation_covariance(BundleGraph(layout, rows), nominal)
    covariances = point_covariances(layout, rows, nominal, before.points, joint)
    places = _places_before(layout, before)
    image, ranges = residuals(layout, nominal, places)
    blank = np.where(_determined(rows), 1.0, np.nan)
    return Prediction(
        _unsorted(places * blank[:, None], layout.point_order),
        _unsorted(covariances * blank[:, None, None], layout.point_order),
        _unsorted(image * np.repeat(blank, np.diff(rows.ray_first))[:, None], layout.ray_order),
        _unsorted(ranges, layout.range_order),
    )


def _everything(network: Network) -> _Selection:
    """All rows; points that nothing determines stay out."""
    rays, ranges = np.ones(network.rays.point.size, dtype=bool), np.ones(network.ranges.point.size, dtype=bool)
    return _Selection(rays, ranges, network.undetermined.copy())


def _before(layout: Layout, selection: _Selection) -> Reduction:
    """All points solved and eliminated with the nominal orientation."""
    return BundleGraph(layout, selection.rows(layout)).reduction(np.zeros(layout.columns))


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """What the passes leave."""

    layout: Layout
    outcome: Outcome
    history: tuple[Iteration, ...]
    cost_initial: float
    orientation: Array
    points: Array
    rows: Rows
    selection: _Selection
    explicit: gtsam.NonlinearFactorGraph | None
    passes: int
    circling: bool = False


def _solve_in_passes(layout: Layout, settings: SolverSettings, selection: _Selection, progress: Progress) -> _Solved:
    """Solve, and solve again until nothing changes: terrain patches follow their points, and, when blunders are sought,
    rows are rejected and re-admitted. Where the passes run in a circle (points on the edge of two patches), the best of
    it counts.
    """
    orientation, history, initial = np.zeros(layout.columns), tuple[Iteration, ...](), float("nan")
    seen: dict[bytes, _Solved] = {}
    for number in range(1, _MOST_PASSES + 1):
        rows = selection.rows(layout)
        outcome, orientation, points, explicit = _solve(layout, rows, orientation, settings, progress)
        history += outcome.history
        initial = outcome.cost_initial if number == 1 else initial
        solved = _Solved(layout, outcome, history, initial, orientation, points, rows, selection, explicit, number)
        chosen = _select(layout, solved, settings.reject) if settings.reject > 0.0 else selection
        followed = layout.following(points)
        if followed is layout and chosen.same(selection):
            return solved
        seen[_state(layout, selection)] = solved
        layout, selection = followed, chosen
        if _state(layout, selection) in seen:
            break
    best = min(seen.values(), key=lambda one: one.outcome.cost_final)
    return replace(best, history=history, circling=True)


def _state(layout: Layout, selection: _Selection) -> bytes:
    """What a pass depends on beside its start."""
    return layout.rows.terrain_cell.tobytes() + selection.rays.tobytes() + selection.ranges.tobytes()


def _solve(
    layout: Layout, rows: Rows, orientation: Array, settings: SolverSettings, progress: Progress
) -> tuple[Outcome, Array, Array, gtsam.NonlinearFactorGraph | None]:
    """One optimisation in the form that was asked for."""
    bundle = BundleGraph(layout, rows)
    scales = {variable_key(layout, v): layout.scales[layout.columns_of(v)] for v in layout.variables.adjusted()}
    if settings.form == "bundle":
        start = bundle.values(orientation)
        outcome = levenberg_marquardt(bundle.graph, start, scales, settings, progress, bundle.constant_cost)
        result = shared_vector(layout, outcome.values)
        return outcome, result, bundle.reduction(result).points, None
    points = bundle.reduction(orientation).points
    graph, start = explicit_graph(layout, rows, orientation, points)
    for i in range(points.shape[0]):
        if start.exists(point_key(i)):
            scales[point_key(i)] = np.full(3, _POINT_SCALE)
    outcome = levenberg_marquardt(graph, start, scales, settings, progress)
    for i in range(points.shape[0]):
        if outcome.values.exists(point_key(i)):
            points[i] = outcome.values.atPoint3(point_key(i))
    return outcome, shared_vector(layout, outcome.values), points, graph


def _without_weak(layout: Layout, reduction: Reduction, selection: _Selection) -> _Selection:
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
    return _Selection(selection.rays, selection.ranges, out)


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


def _select(layout: Layout, solved: _Solved, limit: float) -> _Selection:
    """Rows within `limit` robust standard deviations of their class; all are judged anew, so rejected ones may return.

    The spread of a class is estimated from its median (median of a Rayleigh-distributed norm: 1.1774 sigma; of a normal
    modulus: 0.6745 sigma), but not below a tenth of the a-priori sigma.
    """
    network, points = layout.network, _places_of_all(layout, solved)
    image, ranges = residuals(layout, solved.orientation, points)
    rays, shots = np.empty(solved.selection.rays.size), np.empty(solved.selection.ranges.size)
    rays[layout.ray_order] = np.linalg.norm(image * layout.rows.weight, axis=1)
    shots[layout.range_order] = np.abs(ranges * layout.rows.range_weight)
    class_of_ray = network.points.classes[network.rays.point]
    keep = np.ones_like(solved.selection.rays)
    for point_class in PointClass:
        mine = class_of_ray == point_class
        keep[mine] = _within(rays[mine], limit, 1.1774)
    return _Selection(keep, _within(shots, limit, 0.6745), solved.selection.out)


def _places_of_all(layout: Layout, solved: _Solved) -> Array:
    """(n, 3) m, layout order: solved places; for points whose rays were rejected, the place that all its rays give."""
    selection = solved.selection
    everything = _Selection(np.ones_like(selection.rays), np.ones_like(selection.ranges), selection.out)
    by_all = BundleGraph(layout, everything.rows(layout)).reduction(solved.orientation, system=False).points
    return np.where(_determined(solved.rows)[:, None], solved.points, by_all)


def _within(sizes: Array, limit: float, median_of_unit: float) -> Mask:
    if sizes.size == 0:
        return np.ones(0, dtype=bool)
    spread = max(float(np.nanmedian(sizes)) / median_of_unit, _FLOOR)
    return np.asarray(sizes <= limit * spread)


def _posterior(settings: SolverSettings, name: str, solved: _Solved, before: Reduction, clock: _Clock) -> Solution:
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
    image, ranges = residuals(layout, orientation, _places_of_all(layout, solved))
    places_before = _places_before(layout, before)
    image_before, ranges_before = residuals(layout, np.zeros(layout.columns), places_before)
    determined = _determined(rows)
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
        what = _what_changes(settings, network).capitalize()
        message += f" {what} don't come to rest; the best of the passes is kept."
    elif solved.passes > 1:
        message += f" {solved.passes} passes, until {_what_changes(settings, network)} stayed as they were."
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


def _what_changes(settings: SolverSettings, network: Network) -> str:
    blunders, patches = "rejected rows", "terrain patches"
    if settings.reject == 0.0:
        return patches
    return f"{blunders} and {patches}" if network.surface else blunders


def _places_before(layout: Layout, before: Reduction) -> Array:
    """(n, 3) m, layout order: a-priori places; for free points the intersection with the nominal orientation."""
    return np.where((layout.rows.point_kind == PRIOR)[:, None], layout.rows.point_start, before.points)


def _determined(rows: Rows) -> Mask:
    return np.asarray(rows.point_kind != OUT)


def _unsorted(values: NDArray[_Kind], order: Index) -> NDArray[_Kind]:
    """Values in the layout's order, back in the network's."""
    result = np.empty_like(values)
    result[order] = values
    return result


def _sigmas_without_laser(layout: Layout, solved: _Solved) -> Array | None:
    """(3,) m mean sigmas of the tie points, had there been no laser rows: covariance needs no observed values."""
    classes = layout.network.points.classes
    ties = classes == PointClass.TIE
    laser = classes == PointClass.LASER
    if not (np.any(ties) and np.any(laser)):
        return None
    rows = _Selection(solved.selection.rays, np.zeros_like(solved.selection.ranges), solved.selection.out | laser).rows(
        layout
    )
    if np.any(np.isinf(layout.sigmas)):
        return None  # without the laser nothing may hold the datum
    joint = orientation_covariance(BundleGraph(layout, rows), solved.orientation)
    covariances = point_covariances(layout, rows, solved.orientation, solved.points, joint)
    mine = ties[layout.point_order] & (rows.point_kind != FIXED) & _determined(rows)
    return np.sqrt(np.diagonal(covariances[mine], axis1=1, axis2=2)).mean(axis=0) if np.any(mine) else None


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in ("mgsgraph", "gtsam", "numpy", "numba")}
