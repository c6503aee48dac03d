"""Passes of one adjustment: solve, let terrain patches follow their points, reject and re-admit rows, solve again."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from mgsgraph.adjustment.batch import Iteration, Outcome, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, Layout, explicit_graph
from mgsgraph.adjustment.graph.bundle import point_key, shared_vector, variable_key
from mgsgraph.adjustment.posterior import residuals
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.factors.rows import OUT, Rows
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import Network, PointClass
from mgsgraph.ties import PointKind

Progress = Callable[[Iteration], None]

_MOST_PASSES = 10
_POINT_SCALE = 100.0
"""m, unit of a point's step in the damping of the explicit form."""
_FLOOR = 0.1
"""A-priori sigmas below which a class's spread is not taken at its word when blunders are sought."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Which rows take part, in network order."""

    rays: Mask
    """(k,)"""
    ranges: Mask
    """(r,)"""
    out: Mask
    """(n,) points that nothing determines, whatever is rejected."""

    def same(self, other: "Selection") -> bool:
        """Whether the same rays and ranges take part."""
        return np.array_equal(self.rays, other.rays) and np.array_equal(self.ranges, other.ranges)

    def rows(self, layout: Layout) -> Rows:
        """The layout's rows that take part; free points that rejection has left with fewer than two rays go too."""
        network = layout.network
        left = np.bincount(network.rays.point, self.rays, len(network.points))
        return layout.active(self.rays, self.ranges, self.out | ((network.points.kinds == PointKind.FREE) & (left < 2)))


def everything(network: Network) -> Selection:
    """All rows; points that nothing determines stay out."""
    rays, ranges = np.ones(network.rays.point.size, dtype=bool), np.ones(network.ranges.point.size, dtype=bool)
    return Selection(rays, ranges, network.undetermined.copy())


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What the passes leave."""

    layout: Layout
    """Rows, with the terrain patches of the last pass."""
    outcome: Outcome
    """How the last pass ended."""
    history: tuple[Iteration, ...]
    """Every step tried, over all passes."""
    cost_initial: float
    """Cost of the nominal orientation."""
    orientation: Array
    """(columns,) shared unknowns, m and rad."""
    points: Array
    """(n, 3) m, layout order."""
    rows: Rows
    """Rows that took part in the last pass."""
    selection: Selection
    """The same in network order."""
    explicit: gtsam.NonlinearFactorGraph | None
    """The explicit graph, where that form was asked for."""
    passes: int
    """How many there were."""
    circling: bool = False
    """Whether they ran in a circle."""


def solve_in_passes(layout: Layout, settings: SolverSettings, selection: Selection, progress: Progress) -> Solved:
    """Solve, and solve again until nothing changes: terrain patches follow their points, and, when blunders are sought,
    rows are rejected and re-admitted. Where the passes run in a circle (points on the edge of two patches), the best of
    it counts.
    """
    orientation, history, initial = np.zeros(layout.columns), tuple[Iteration, ...](), float("nan")
    seen: dict[bytes, Solved] = {}
    for number in range(1, _MOST_PASSES + 1):
        rows = selection.rows(layout)
        outcome, orientation, points, explicit = _solve(layout, rows, orientation, settings, progress)
        history += outcome.history
        initial = outcome.cost_initial if number == 1 else initial
        solved = Solved(layout, outcome, history, initial, orientation, points, rows, selection, explicit, number)
        chosen = select(layout, solved, settings.reject) if settings.reject > 0.0 else selection
        followed = layout.following(points, orientation)
        if followed is layout and chosen.same(selection):
            return solved
        seen[_state(layout, selection)] = solved
        layout, selection = followed, chosen
        if _state(layout, selection) in seen:
            break
    best = min(seen.values(), key=lambda one: one.outcome.cost_final)
    return replace(best, history=history, circling=True)


def _state(layout: Layout, selection: Selection) -> bytes:
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


def select(layout: Layout, solved: Solved, limit: float) -> Selection:
    """Rows within `limit` robust standard deviations of their class; all are judged anew, so rejected ones may return.

    The spread of a class is estimated from its median (median of a Rayleigh-distributed norm: 1.1774 sigma; of a normal
    modulus: 0.6745 sigma), but not below a tenth of the a-priori sigma.
    """
    network, points = layout.network, places_of_all(layout, solved)
    image, ranges = residuals(layout, solved.orientation, points)
    rays, shots = np.empty(solved.selection.rays.size), np.empty(solved.selection.ranges.size)
    rays[layout.ray_order] = np.linalg.norm(image * layout.rows.weight, axis=1)
    shots[layout.range_order] = np.abs(ranges * layout.rows.range_weight)
    class_of_ray = network.points.classes[network.rays.point]
    keep = np.ones_like(solved.selection.rays)
    for point_class in PointClass:
        mine = class_of_ray == point_class
        keep[mine] = _within(rays[mine], limit, 1.1774)
    return Selection(keep, _within(shots, limit, 0.6745), solved.selection.out)


def places_of_all(layout: Layout, solved: Solved) -> Array:
    """(n, 3) m, layout order: solved places; for points whose rays were rejected, the place that all its rays give."""
    selection = solved.selection
    whole = Selection(np.ones_like(selection.rays), np.ones_like(selection.ranges), selection.out)
    by_all = BundleGraph(layout, whole.rows(layout)).reduction(solved.orientation, system=False).points
    return np.where(determined_points(solved.rows)[:, None], solved.points, by_all)


def _within(sizes: Array, limit: float, median_of_unit: float) -> Mask:
    if sizes.size == 0:
        return np.ones(0, dtype=bool)
    spread = max(float(np.nanmedian(sizes)) / median_of_unit, _FLOOR)
    return np.asarray(sizes <= limit * spread)


def what_changes(settings: SolverSettings, network: Network) -> str:
    """What makes another pass necessary, in words."""
    blunders, patches = "rejected rows", "terrain patches"
    if settings.reject == 0.0:
        return patches
    return f"{blunders} and {patches}" if network.surface else blunders


def determined_points(rows: Rows) -> Mask:
    """(n,) points that take part, layout order."""
    return np.asarray(rows.point_kind != OUT)
