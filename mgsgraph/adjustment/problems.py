"""The two forms of the adjustment as problems for an optimiser, ours or GTSAM's own."""

from collections.abc import Callable, Mapping

import gtsam
import numpy as np

from mgsgraph.adjustment.batch import Iteration, Outcome, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, Layout, explicit_graph
from mgsgraph.adjustment.graph.bundle import shared_vector, variable_key
from mgsgraph.adjustment.graph.explicit import all_points
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.factors.bundle import Reduction
from mgsgraph.geometry.records import Array

_POINT_SCALE = np.full(3, 100.0)
"""m, unit of a point's step in the damping of the explicit form."""


def variable_scales(layout: Layout) -> dict[int, Array]:
    """Scale of each shared unknown's components, m and rad, by GTSAM key."""
    return {variable_key(layout, v): layout.scales[layout.columns_of(v)] for v in layout.variables.adjusted()}


class BundleProblem:
    """The bundle form; its state is the orientation vector (columns,). Each sweep begins where the last one ended."""

    def __init__(self, graph: BundleGraph, known: Reduction | None = None) -> None:
        self.graph = graph
        self.scales: Mapping[int, Array] = variable_scales(graph.layout)
        self._last = known

    def at(self, state: Array, system: bool) -> Reduction:
        """All points solved (and eliminated) at a state."""
        last = self._last
        if last is None or not last.serves(state, system):
            begin = last if last is not None and np.isfinite(last.cost) else None
            self._last = last = self.graph.reduction(state, system, begin)
        return last

    def cost(self, state: Array, system: bool) -> float:
        """Full cost."""
        return self.graph.cost(self.at(state, system))

    def exact_cost(self, state: Array) -> float:
        """Full cost, all points solved from their first places."""
        return self.graph.cost(self.graph.reduction(state, system=False))

    def linear(self, state: Array) -> gtsam.GaussianFactorGraph:
        """Linear system."""
        return self.graph.linear(self.at(state, True))

    def moved(self, state: Array, step: gtsam.VectorValues) -> Array:
        """State after a step."""
        layout, result = self.graph.layout, state.copy()
        for v in layout.variables.adjusted():
            result[layout.columns_of(v)] += step.at(variable_key(layout, v))
        return result


class GraphProblem:
    """Any GTSAM graph; its state is GTSAM values."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, scales: Mapping[int, Array]) -> None:
        self.graph, self.scales = graph, scales

    def cost(self, state: gtsam.Values, system: bool) -> float:
        """Full cost."""
        return float(self.graph.error(state))

    def exact_cost(self, state: gtsam.Values) -> float:
        """Full cost."""
        return float(self.graph.error(state))

    def linear(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Linear system."""
        return self.graph.linearize(state)

    def moved(self, state: gtsam.Values, step: gtsam.VectorValues) -> gtsam.Values:
        """State after a step."""
        return state.retract(step)


def solve_bundle(
    graph: BundleGraph,
    start: Array,
    known: Reduction | None,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
) -> tuple[Outcome[Array], Reduction]:
    """Solve the bundle form from an orientation vector (columns,); the reduction at the optimum comes with it."""
    problem = BundleProblem(graph, known)
    if settings.method == "levenberg-marquardt":
        outcome = levenberg_marquardt(problem, start, settings, progress)
    else:
        found = by_gtsam(graph.graph, graph.values(start), settings, progress, graph.constant_cost)
        state = shared_vector(graph.layout, found.state)
        outcome = Outcome(state, found.cost_initial, found.cost_final, found.converged, found.message, found.history)
    return outcome, problem.at(outcome.state, True)


def solve_explicit(
    graph: BundleGraph, start: Array, points: Array, settings: SolverSettings, progress: Callable[[Iteration], None]
) -> tuple[Outcome[gtsam.Values], Array, Array, gtsam.NonlinearFactorGraph]:
    """Solve the explicit form: outcome, orientation vector (columns,), points (n, 3) in m, and the graph."""
    layout = graph.layout
    explicit, values = explicit_graph(layout, graph.rows, start, points)
    scales = variable_scales(layout)
    scales |= {key: _POINT_SCALE for key in values.keys() if key not in scales}  # noqa: SIM118
    if settings.method == "levenberg-marquardt":
        outcome = levenberg_marquardt(GraphProblem(explicit, scales), values, settings, progress)
    else:
        outcome = by_gtsam(explicit, values, settings, progress, 0.0)
    return outcome, shared_vector(layout, outcome.state), all_points(layout, outcome.state, points), explicit


def by_gtsam(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
    constant: float,
) -> Outcome[gtsam.Values]:
    """One of GTSAM's own optimisers, by name; `constant` is cost that no factor carries.

    They copy all values at every factor's call: good for small graphs, and as a second opinion.
    """
    if start.size() == 0:
        return Outcome(start, constant, constant, True, "Nothing to adjust: every image is held.", ())
    optimizer: gtsam.NonlinearOptimizer
    if settings.method == "dogleg":
        optimizer = gtsam.DoglegOptimizer(graph, start, gtsam.DoglegParams())
    else:
        optimizer = gtsam.GaussNewtonOptimizer(graph, start, gtsam.GaussNewtonParams())
    initial = cost = optimizer.error() + constant
    history = list[Iteration]()
    for number in range(1, settings.max_iterations + 1):
        before = cost
        optimizer.iterate()
        cost = optimizer.error() + constant
        nan = float("nan")
        history.append(Iteration(number, cost, before - cost, nan, nan, 0.0, True))
        progress(history[-1])
        if not np.isfinite(cost) or abs(before - cost) <= settings.cost_tolerance * cost:
            break
    converged = bool(np.isfinite(cost)) and abs(before - cost) <= settings.cost_tolerance * cost
    name = "Dogleg" if settings.method == "dogleg" else "Gauss-Newton"
    message = f"Converged: GTSAM's {name} changed the cost by no more than {settings.cost_tolerance:.0e} of it."
    if not converged:
        message = f"Stopped after {len(history)} iterations of GTSAM's {name} without converging; try our own solver."
    return Outcome(optimizer.values(), initial, cost, converged, message, tuple(history))
