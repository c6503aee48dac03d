"""Levenberg-Marquardt and marginal covariances of any GTSAM graph, in time about linear in the number of factors.

GTSAM's optimizers hand each Python factor a copy of all values: their time grows with the square of the number of
variables. `graph.linearize(values)` doesn't. And GTSAM's Cholesky takes columns of m and of rad beside each other for
an indeterminate system: here columns are scaled to unit length before they are factored (van der Sluis 1969).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from mgsgraph.adjustment.settings import Iteration, Progress
from mgsgraph.errors import InputError, WeakNetwork, require
from mgsgraph.geometry.records import Array, Index, no_rows
from mgsgraph.record import Record, card
from mgsgraph.workers import no_progress

_FIRST_DAMPING, _LEAST, _MOST = 1e-8, 1e-12, 1e8
_HARDLY_DAMPED = 1e-6
"""Length up to which a step is the distance to the minimum."""


@dataclass(frozen=True, slots=True, eq=False)
class Optimized(Record):
    """The result of `optimize`.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> mgsgraph.optimize(graph, values).message
    'Converged after 3 iterations.'
    """

    values: gtsam.Values
    """Of all variables."""
    cost: float
    """Half the weighted sum of squares (or of the losses)."""
    converged: bool
    """Whether it converged."""
    message: str
    """Why it stopped."""
    history: tuple[Iteration, ...]
    """Every step tried."""


class _Structure:
    """Columns of a graph's variables, and which of these are eliminated first: no factor has two of them, as of ground
    points. The rest is small, and time linear in the number of factors.
    """

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self.keys, zeros = sorted(graph.keyVector()), values.zeroVectors()  # GTSAM's own order of columns
        require(self.keys, "graph", "no factors", "at least one")
        for key in self.keys:
            if not values.exists(key):
                problem = f"none of variable {gtsam.DefaultKeyFormatter(key)}"
                raise InputError("values", problem, "one of each variable of the graph")
        self.cost = float(graph.error(values))
        """Of the graph where it began."""
        if not np.isfinite(self.cost):
            _require_finite(graph, values)
        self.sizes = {key: int(zeros.at(key).size) for key in self.keys}
        ends = np.cumsum([0, *self.sizes.values()])
        self.first = dict(zip(self.keys, ends.tolist(), strict=False))
        self.columns = int(ends[-1])
        joined: dict[int, set[int]] = {key: set() for key in self.keys}
        for i in range(graph.size()):
            members = list(graph.at(i).keys())
            for key in members:
                joined[key].update(members)
        eliminated = set[int]()
        for key in sorted(self.keys, key=lambda variable: len(joined[variable])):
            if eliminated.isdisjoint(joined[key]):
                eliminated.add(key)
        self.inner = np.concatenate([np.full(self.sizes[key], key in eliminated) for key in self.keys])
        """(columns,) of variables that are eliminated first."""
        sizes = np.array([self.sizes[key] for key in self.keys if key in eliminated])
        self.blocks = [(int(width), np.cumsum(sizes)[sizes == width] - width) for width in np.unique(sizes)]
        """Of each width, the first inner columns (n,) of the variables that have it."""

    def columns_of(self, key: int) -> slice:
        """Columns of a variable."""
        return slice(self.first[key], self.first[key] + self.sizes[key])


def _require_finite(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Raise InputError, naming the first factor whose error is not finite."""
    for i in range(graph.size()):
        if not np.isfinite(graph.at(i).error(values)):
            graph.at(i).linearize(values)  # says why, where a point is not seen
            where = f"factor {i} on {', '.join(map(gtsam.DefaultKeyFormatter, graph.at(i).keys()))}"
            raise InputError(where, "an error that is not finite", "values where every factor is defined")


class _Factored:
    """A normal matrix, its inner variables eliminated: N = [S + W B^-1 W', W; W', B], B block-diagonal."""

    def __init__(self, normal: Any, structure: _Structure) -> None:
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        self._inner, self._outer = np.flatnonzero(structure.inner), np.flatnonzero(~structure.inner)
        inner = normal[self._inner]
        self._inverse = _inverted_blocks(inner[:, self._inner], structure.blocks)
        self._across = csc_array(normal[self._outer][:, self._inner])
        reduced = csc_array(normal[self._outer][:, self._outer] - self._across @ self._inverse @ self._across.T)
        self._reduced = None
        if self._outer.size:
            options = {"SymmetricMode": True}
            self._reduced = splu(reduced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
            if not np.all(self._reduced.U.diagonal() > 0.0):
                raise np.linalg.LinAlgError("not positive definite")

    def solve(self, right: Array) -> Array:
        """N x = right (columns, ...)."""
        solution, inner = np.empty_like(right), self._inverse @ right[self._inner]
        solution[self._outer] = self._solved_outer(right[self._outer] - self._across @ inner)
        solution[self._inner] = inner - self._inverse @ (self._across.T @ solution[self._outer])
        return solution

    def _solved_outer(self, right: Array) -> Array:
        return right if self._reduced is None else np.asarray(self._reduced.solve(right))

    def covariance(self, columns: Index, structure: _Structure) -> Array:
        """(k, k) of N^-1 at some columns: B^-1 + G S^-1 G', where G is how these depend on the outer ones."""
        number = np.cumsum(structure.inner) - 1
        inner = np.flatnonzero(structure.inner[columns])
        at = number[columns[inner]]
        by_outer = np.zeros((columns.size, self._outer.size))
        by_outer[inner] = -(self._inverse[at] @ self._across.T).toarray()
        outer = np.flatnonzero(~structure.inner[columns])
        by_outer[outer, (np.cumsum(~structure.inner) - 1)[columns[outer]]] = 1.0
        inverse = by_outer @ self._solved_outer(by_outer.T)
        inverse[np.ix_(inner, inner)] += self._inverse[at][:, at].toarray()
        return np.asarray(0.5 * (inverse + inverse.T))


def _inverted_blocks(diagonal: Any, blocks: list[tuple[int, Index]]) -> Any:
    """Inverse of a block-diagonal matrix, sparse; raises LinAlgError where a block isn't positive definite."""
    from scipy.sparse import csr_array

    rows, columns, entries = [no_rows()], [no_rows()], [np.zeros(0)]
    for width, first in blocks:
        at = first[:, None] + np.arange(width)
        places = np.repeat(at, width, axis=1), np.tile(at, (1, width))
        dense = np.asarray(diagonal[places[0].ravel(), places[1].ravel()]).reshape(-1, width, width)
        np.linalg.cholesky(dense)
        rows.append(places[0].ravel())
        columns.append(places[1].ravel())
        entries.append(np.linalg.inv(dense).ravel())
    return csr_array((np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=diagonal.shape)


class _Linearized:
    """A graph about values, its columns scaled to unit length."""

    def __init__(self, structure: _Structure, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        from scipy.sparse import csc_array  # slow to import

        self.structure, count = structure, structure.columns
        rows, columns, entries = graph.linearize(values).sparseJacobian_()
        row, column = rows.astype(np.int64) - 1, columns.astype(np.int64) - 1
        bordered = csc_array((entries, (row, column)), shape=(int(row.max()) + 1, count + 1))
        jacobian, right = bordered[:, :count], np.asarray(bordered[:, [count]].todense())[:, 0]
        lengths = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
        for key in structure.keys:
            if np.any(lengths[structure.columns_of(key)] == 0.0):
                raise WeakNetwork([f"variable {gtsam.DefaultKeyFormatter(key)}"], 1)
        self.scales = 1.0 / lengths
        scaled = csc_array(jacobian.multiply(self.scales[None]))
        self.normal, self.gradient = csc_array(scaled.T @ scaled), -(scaled.T @ right)

    def factored(self, damping: float = 0.0) -> _Factored | None:
        """The damped normal matrix; None where it isn't positive definite."""
        from scipy.sparse import diags_array

        try:
            damped = self.normal + damping * diags_array(np.ones(self.gradient.size), format="csc")
            return _Factored(damped.tocsr(), self.structure)
        except (RuntimeError, np.linalg.LinAlgError):
            return None

    @cached_property
    def undamped(self) -> _Factored:
        """The normal matrix; WeakNetwork where it is singular."""
        factored = self.factored()
        if factored is None:
            raise WeakNetwork(["some direction of the variables"], 1)
        return factored

    def step_of(self, scaled: Array) -> gtsam.VectorValues:
        """A step in units of the scales, as a GTSAM record."""
        step, vectors = scaled * self.scales, gtsam.VectorValues()
        for key in self.structure.keys:
            vectors.insert(key, step[self.structure.columns_of(key)])
        return vectors


def optimize(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    progress: Progress = no_progress,
    *,
    max_iterations: int = 200,
    cost_tolerance: float = 1e-10,
    step_tolerance: float = 1e-6,
) -> Optimized:
    """Least squares over a GTSAM graph by Levenberg-Marquardt.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Of any factors.
    values : gtsam.Values
        Where to begin; of further variables they stay as they are.
    progress : callable
        Called with every iteration.
    max_iterations : int
        The most steps to try.
    cost_tolerance : float
        Stop when a step lowers the cost, or promises to, by less than this share of it; the last one may raise it by
        as much.
    step_tolerance : float
        Stop when the step is shorter than this many posterior sigmas.

    Returns
    -------
    Optimized

    Raises
    ------
    InputError
        Where a variable has no value, or a factor has no finite error.
    WeakNetwork
        Nothing depends on some variable of the graph.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> found = mgsgraph.optimize(graph, values)
    >>> found.converged
    True
    """
    structure = _Structure(graph, values)
    cost, damping, history = structure.cost, _FIRST_DAMPING, list[Iteration]()
    linear = _Linearized(structure, graph, values)
    while len(history) < max_iterations:
        factor = linear.factored(damping)
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
        small = length < step_tolerance or max(predicted, abs(last.decrease)) <= cost_tolerance * cost
        if small and damping <= _HARDLY_DAMPED:
            return Optimized(values, cost, True, f"Converged after {len(history)} iterations.", tuple(history))
        if accepted:
            linear = _Linearized(structure, graph, values)
        else:
            damping *= 10.0
            if damping > _MOST:
                return Optimized(values, cost, False, "Stopped: no step lowers the cost.", tuple(history))
    return Optimized(values, cost, False, f"Stopped after {max_iterations} iterations.", tuple(history))


class Marginals:
    """Covariances of a graph's variables at values, for sigma0 = 1: those of `gtsam.Marginals`, for units of any size.
    Considered unknowns of a network are held in its graph: only a Solution includes their uncertainty.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Where the cost is least.

    Raises
    ------
    WeakNetwork
        Some direction is not determined.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(solution)
    >>> marginals = mgsgraph.Marginals(graph, values)
    >>> marginals.covariance(keys.point("TIE00001"), keys.image("SIM/A")).shape
    (21, 21)
    """

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._linear = _Linearized(_Structure(graph, values), graph, values)

    def __repr__(self) -> str:
        return f"Marginals({len(self._linear.structure.keys)} variables)"

    def _repr_html_(self) -> str:
        return card(repr(self))

    def steps_left(self) -> float:
        """Posterior sigmas from the values to the minimum, by the graph's linearization there."""
        step = self._linear.undamped.solve(-self._linear.gradient)
        return float(np.sqrt(max(-float(self._linear.gradient @ step), 0.0)))

    def covariance(self, *keys: int) -> Array:
        """Joint covariance of some variables, in the order asked for, m^2, m rad, rad^2."""
        linear, structure = self._linear, self._linear.structure
        if not keys:
            return np.zeros((0, 0))
        columns = np.concatenate([np.arange(structure.columns)[structure.columns_of(key)] for key in keys])
        scales = linear.scales[columns]
        return np.asarray(linear.undamped.covariance(columns, structure) * scales * scales[:, None])
