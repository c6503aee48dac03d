"""Levenberg-Marquardt and marginal covariances of any GTSAM graph, in time linear in the number of factors.

GTSAM's optimizers hand each Python factor a copy of all values: their time grows with the square of the number of
variables. `graph.linearize(values)` doesn't. And GTSAM's Cholesky takes columns of m and of rad beside each other for
an indeterminate system: here columns are scaled to unit length before they are factored (van der Sluis 1969).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from mgsgraph.errors import WeakNetwork
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

_FIRST_DAMPING, _LEAST, _MOST = 1e-8, 1e-12, 1e8


@dataclass(frozen=True, slots=True)
class Iteration(Record):
    """One step that was tried.

    Examples
    --------
    >>> first = solution.history[0]
    >>> first.number, first.accepted, round(first.cost, 1)
    (1, True, 44.9)
    """

    number: int
    """Counted from 1."""
    cost: float
    """Half the weighted sum of squares (or of the loss) after the step."""
    decrease: float
    """Cost before minus cost after."""
    predicted: float
    """Decrease that the linear model promised."""
    step: float
    """Length of the step in posterior sigmas: the square root of minus gradient times step."""
    damping: float
    """Levenberg-Marquardt damping, in inverse squared scales."""
    accepted: bool
    """Whether the step was taken."""


@dataclass(frozen=True, slots=True, eq=False)
class Optimized(Record):
    """What `optimize` found."""

    values: gtsam.Values
    """Of all variables."""
    cost: float
    """Half the weighted sum of squares (or of the losses)."""
    converged: bool
    """Whether it stopped because nothing more was to be gained."""
    message: str
    """Why it stopped."""
    history: tuple[Iteration, ...]
    """Every step tried."""


class _Linearized:
    """A graph about values, its columns scaled to unit length."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        from scipy.sparse import csc_array  # slow to import

        zeros = values.zeroVectors()
        self.keys = list(values.keys())
        sizes = [zeros.at(key).size for key in self.keys]
        self.first = dict(zip(self.keys, np.cumsum([0, *sizes]).tolist(), strict=False))
        self.sizes = dict(zip(self.keys, sizes, strict=True))
        count = sum(sizes)
        rows, columns, entries = graph.linearize(values).sparseJacobian_()
        row, column = rows.astype(np.int64) - 1, columns.astype(np.int64) - 1
        whole = csc_array((entries, (row, column)), shape=(int(row.max()) + 1, count + 1))
        jacobian, self.right = whole[:, :count], np.asarray(whole[:, [count]].todense())[:, 0]
        lengths = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
        for key in self.keys:
            if np.any(lengths[self.columns_of(key)] == 0.0):
                raise WeakNetwork([f"variable {gtsam.DefaultKeyFormatter(key)}"], 1)
        self.scales = 1.0 / lengths
        self.jacobian = csc_array(jacobian.multiply(self.scales[None]))
        self.normal = csc_array(self.jacobian.T @ self.jacobian)
        self.gradient = -(self.jacobian.T @ self.right)

    def columns_of(self, key: int) -> slice:
        """Columns of a variable."""
        return slice(self.first[key], self.first[key] + self.sizes[key])

    def factor(self, damping: float = 0.0) -> Any:
        """Factor of the normal matrix; None where it isn't positive definite."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        damped = self.normal + damping * diags_array(np.ones(self.gradient.size), format="csc")
        options = {"SymmetricMode": True}
        try:
            found = splu(damped, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        except RuntimeError:
            return None
        return found if np.all(found.U.diagonal() > 0.0) else None

    @cached_property
    def _undamped(self) -> Any:
        found = self.factor()
        if found is None:
            raise WeakNetwork(["some direction of the variables"], 1)
        return found

    def solved(self, right: Array) -> Array:
        """Solution (columns, ...) of the normal equations, scaled; WeakNetwork where they are singular."""
        return np.asarray(self._undamped.solve(right))

    def step_of(self, scaled: Array) -> gtsam.VectorValues:
        """A step in units of the scales, as GTSAM has it."""
        step, found = scaled * self.scales, gtsam.VectorValues()
        for key in self.keys:
            found.insert(key, step[self.columns_of(key)])
        return found


def optimize(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    progress: Callable[[Iteration], None] = no_progress,
    *,
    max_iterations: int = 200,
    cost_tolerance: float = 1e-11,
    step_tolerance: float = 1e-6,
) -> Optimized:
    """Least squares over a GTSAM graph by Levenberg-Marquardt.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Of any factors.
    values : gtsam.Values
        Where to begin.
    progress : callable
        Called with every iteration.
    max_iterations : int
        The most steps to try.
    cost_tolerance : float
        Stop when a step lowers the cost, or promises to, by less than this share of it.
    step_tolerance : float
        Stop when the step is shorter than this many posterior sigmas.

    Returns
    -------
    Optimized

    Raises
    ------
    WeakNetwork
        No factor depends on some variable.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> found = mgsgraph.optimize(graph, values)
    >>> found.converged
    True
    """
    cost, damping, history = graph.error(values), _FIRST_DAMPING, list[Iteration]()
    linear = _Linearized(graph, values)
    while len(history) < max_iterations:
        factor = linear.factor(damping)
        if factor is None:
            damping *= 10.0
            if damping > _MOST:
                return Optimized(values, cost, False, "Stopped: the equations are singular.", tuple(history))
            continue
        step = factor.solve(-linear.gradient)
        predicted = -float(linear.gradient @ step) - 0.5 * float(step @ (linear.normal @ step))
        length = float(np.sqrt(max(-float(linear.gradient @ step), 0.0)))
        trial = values.retract(linear.step_of(step))
        new = graph.error(trial)
        accepted = bool(new <= cost + cost_tolerance * abs(cost))
        last = Iteration(len(history) + 1, new, cost - new, predicted, length, damping, accepted)
        history.append(last)
        progress(last)
        if accepted:
            values, cost, damping = trial, new, max(0.1 * damping, _LEAST)
        if length < step_tolerance or max(predicted, abs(last.decrease)) <= cost_tolerance * cost:
            return Optimized(values, cost, True, f"Converged after {len(history)} iterations.", tuple(history))
        if accepted:
            linear = _Linearized(graph, values)
        else:
            damping *= 10.0
            if damping > _MOST:
                return Optimized(values, cost, False, "Stopped: no step lowers the cost.", tuple(history))
    return Optimized(values, cost, False, f"Stopped after {max_iterations} iterations.", tuple(history))


def steps_left(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
    """Posterior sigmas from values to the minimum, by the graph's linearization there."""
    linear = _Linearized(graph, values)
    step = linear.solved(-linear.gradient)
    return float(np.sqrt(max(-float(linear.gradient @ step), 0.0)))


class Marginals:
    """Covariances of a graph's variables at values, for sigma0 = 1: those of `gtsam.Marginals`, for units of any size.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Where the cost is least.

    Raises
    ------
    WeakNetwork
        Some direction is not determined.
    """

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._linear = _Linearized(graph, values)

    def covariance(self, *keys: int) -> Array:
        """Joint covariance of some variables, in the order asked for, m^2, m rad, rad^2."""
        linear = self._linear
        columns = np.concatenate([np.arange(linear.gradient.size)[linear.columns_of(key)] for key in keys])
        units = np.zeros((linear.gradient.size, columns.size))
        units[columns, np.arange(columns.size)] = linear.scales[columns]
        found = (linear.solved(units) * linear.scales[:, None])[columns]
        return np.asarray(0.5 * (found + found.T))
