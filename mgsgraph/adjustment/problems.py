"""The two forms of the adjustment as problems for an optimiser."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.batch import Iteration, Outcome, levenberg_marquardt, minimum, settled_minimum
from mgsgraph.adjustment.graph import BundleGraph, explicit_graph
from mgsgraph.adjustment.graph.bundle import Solving, shared_vector, variable_key
from mgsgraph.adjustment.graph.explicit import all_points
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.adjustment.square_root import is_indeterminate
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM, Reduction

_POINT_SCALE = np.full(3, 100.0)
"""m, unit of a point's step in the damping of the explicit form."""


class ReducedEquations:
    """Normal equations of the shared unknowns (`batch.LinearSystem`), damped in units of their scales.

    With the factor of `kept`, the matrix is that of another state; the gradient is that of the reduction.
    """

    def __init__(self, graph: BundleGraph, reduction: Reduction, kept: "ReducedEquations | None" = None) -> None:
        self._graph, self._reduction, self.gradient = graph, reduction, graph.gradient(reduction)
        self._damping, self._inverse_squares = 0.0, graph.layout.scales**-2.0
        self._factor: Solving | None = None
        self.kept = kept is not None
        if kept is not None:
            self._factor, self._damping = kept._factor, kept._damping

    def step(self, damping: float) -> Array | None:
        """Solution of the damped equations; None when they are not positive definite."""
        if self._factor is None or damping != self._damping:
            assert self._reduction.task == SYSTEM, "a kept factor has the damping that it was made with"
            try:
                self._factor = self._graph.sweeper.factor(self._graph.layout, self._reduction, damping)
                self._damping = damping
            except NotDefinite:
                return None
        return self._factor.solve(-self.gradient)

    def slope(self, step: Array) -> float:
        """Minus gradient times step."""
        return -float(self.gradient @ step)

    def gain(self, step: Array) -> float:
        """Of a step that solves the equations with the damping asked for last: (N + damping) step = -gradient."""
        return 0.5 * (self.slope(step) + self._damping * float(step @ (self._inverse_squares * step)))


class FactorEquations:
    """Normal equations of GTSAM's factors, eliminated by GTSAM (`batch.LinearSystem`); scales by key."""

    kept = False
    gradient: Any

    def __init__(self, linear: gtsam.GaussianFactorGraph, scales: Mapping[int, Array]) -> None:
        self._linear, self._scales, self.gradient = linear, scales, linear.gradientAtZero()
        self._ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)

    def step(self, damping: float) -> gtsam.VectorValues | None:
        """Solution of the damped equations; None when they are not positive definite."""
        damped = gtsam.GaussianFactorGraph()
        damped.push_back(self._linear)  # the factors themselves, not copies
        for key, scale in self._scales.items():
            root = np.diag(math.sqrt(damping) / scale)
            damped.add(gtsam.JacobianFactor(key, root, np.zeros(scale.size), gtsam.noiseModel.Unit.Create(scale.size)))
        try:
            return damped.optimize(self._ordering)
        except RuntimeError as error:
            if is_indeterminate(error):
                return None
            raise

    def slope(self, step: gtsam.VectorValues) -> float:
        """Minus gradient times step."""
        return -float(self.gradient.dot(step))

    def gain(self, step: gtsam.VectorValues) -> float:
        """Decrease of the cost that the linear model promises of a step."""
        return float(self._linear.error(gtsam.VectorValues.Zero(step)) - self._linear.error(step))


class BundleProblem:
    """The bundle form; its state is the orientation vector (columns,). Each sweep begins where the last one ended."""

    def __init__(self, graph: BundleGraph, known: Reduction | None = None) -> None:
        self.graph, self.adjusts = graph, graph.layout.columns > 0
        self._last = known

    def at(self, state: Array, task: int) -> Reduction:
        """All points solved (and eliminated) at a state."""
        last = self._last
        if last is None or not last.serves(state, task):
            begin = last if last is not None and np.isfinite(last.cost) else None
            self._last = last = self.graph.reduction(state, task, begin)
        return last

    def cost(self, state: Array, task: int) -> float:
        """Cost of all points and of the priors at a state (columns,); the sweep of `task` is kept for `linear`."""
        return self.graph.cost(self.at(state, task))

    def exact_cost(self, state: Array) -> float:
        """Full cost, all points solved from their first places."""
        return self.graph.cost(self.graph.reduction(state, COSTS))

    def linear(self, state: Array, kept: ReducedEquations | None = None) -> ReducedEquations:
        """Normal equations at a state (columns,), with the factor of `kept` where it is given."""
        return ReducedEquations(self.graph, self.at(state, SYSTEM if kept is None else GRADIENT), kept)

    def moved(self, state: Array, step: Array) -> Array:
        """State after a step."""
        return state + step


class GraphProblem:
    """Any GTSAM graph; its state is GTSAM values."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, scales: Mapping[int, Array]) -> None:
        self.graph, self._scales, self.adjusts = graph, scales, len(scales) > 0

    def cost(self, state: gtsam.Values, task: int) -> float:
        """Cost of all factors at GTSAM values."""
        return float(self.graph.error(state))

    def exact_cost(self, state: gtsam.Values) -> float:
        """Cost of all factors at GTSAM values."""
        return float(self.graph.error(state))

    def linear(self, state: gtsam.Values, kept: FactorEquations | None = None) -> FactorEquations:
        """Linear system, always with a matrix of its own."""
        return FactorEquations(self.graph.linearize(state), self._scales)

    def moved(self, state: gtsam.Values, step: gtsam.VectorValues) -> gtsam.Values:
        """State after a step."""
        return state.retract(step)


def solve_bundle(
    graph: BundleGraph,
    start: Array,
    known: Reduction | None,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
    slow: bool = False,
) -> tuple[Outcome[Array], Reduction]:
    """Solve the bundle form from an orientation vector (columns,); the reduction at the optimum comes with it. `slow`
    says that an earlier pass converged slowly.
    """
    problem = BundleProblem(graph, known)
    if graph.layout.network.on_relief:
        outcome = settled_minimum(problem, start, settings, progress)
    else:
        outcome = minimum(problem, start, settings, progress, slow)
    return outcome, problem.at(outcome.state, SYSTEM)


def solve_explicit(
    graph: BundleGraph, start: Array, points: Array, settings: SolverSettings, progress: Callable[[Iteration], None]
) -> tuple[Outcome[gtsam.Values], Array, Array, gtsam.NonlinearFactorGraph]:
    """Solve the explicit form: outcome, orientation vector (columns,), points (n, 3) in m, and the graph."""
    layout = graph.layout
    explicit, values = explicit_graph(layout, graph.rows, start, points)
    scales = {variable_key(layout, v): layout.scales[layout.columns_of(v)] for v in layout.variables.adjusted()}
    scales |= {key: _POINT_SCALE for key in values.keys() if key not in scales}  # noqa: SIM118
    outcome = levenberg_marquardt(GraphProblem(explicit, scales), values, settings, progress)
    return outcome, shared_vector(layout, outcome.state), all_points(layout, outcome.state, points), explicit


class HeldEquations(ReducedEquations):
    """Normal equations whose steps leave directions A (columns, m) as they are: with N dx = -g the step is

    dx = -N^-1 (g + A k),    A' dx = 0:    dx = s - N^-1 A (A' N^-1 A)^-1 A' s,    s = -N^-1 g.
    """

    def __init__(
        self, graph: BundleGraph, reduction: Reduction, directions: Array, kept: "HeldEquations | None" = None
    ) -> None:
        super().__init__(graph, reduction, kept)
        self._directions = directions
        self._through: tuple[Solving, Array] | None = None if kept is None else kept._through

    def step(self, damping: float) -> Array | None:
        """Solution of the damped equations; None when they are not positive definite."""
        free, held = super().step(damping), self._directions
        if free is None:
            return None
        assert self._factor is not None
        if self._through is None or self._through[0] is not self._factor:
            self._through = self._factor, np.stack([self._factor.solve(one) for one in held.T], axis=1)
        through = self._through[1]
        return np.asarray(free - through @ np.linalg.solve(held.T @ through, held.T @ free))


class HeldProblem(BundleProblem):
    """The bundle form with directions (columns, m) of its state held."""

    def __init__(self, graph: BundleGraph, directions: Array, known: Reduction) -> None:
        super().__init__(graph, known)
        self._directions = directions

    def linear(self, state: Array, kept: ReducedEquations | None = None) -> HeldEquations:
        """Normal equations at a state (columns,), with the factor of `kept` where it is given."""
        assert kept is None or isinstance(kept, HeldEquations)
        reduction = self.at(state, SYSTEM if kept is None else GRADIENT)
        return HeldEquations(self.graph, reduction, self._directions, kept)
