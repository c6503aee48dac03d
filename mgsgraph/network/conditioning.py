"""Gaussian processes in time, what is known of errors of a trajectory between its nodes; and their sequential
conditioning on few neighbours: the rows of a prior whose cost is linear in nodes.

The density of the values x_0 .. x_n is the product of those of each x_k given all before it. Given the m before it
only (Vecchia 1988), x_k - a' x_{k-m .. k-1} has the variance s_m^2 of the covariance function, exactly. What is lost is
known: the Kullback-Leibler divergence from the whole process is the sum of log(s_m / s_all). Of a Gauss-Markov process
m = 1 loses nothing.

Values that hardly differ make covariances singular to the precision of numbers. So stationary processes of m > 1 have
white noise of `NUGGET` times their sigma added, and covariances of neighbours are factorised in extended precision.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.orientation import OrientationImages
from mgsgraph.geometry.records import Array, Index, assign, frozen
from mgsgraph.record import Record

ProcessKind = Literal["white", "gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener"]
"""The kinds of processes."""
_LONGEST_TIME = 1e9
"""s; a process that takes longer to forget itself can't be told from a constant."""


@dataclass(frozen=True, slots=True, eq=False)
class Process(Record):
    """A Gaussian process of three components that know nothing of each other.

    A process has a kind and a strength (sigma) along each of three axes. Stationary kinds have covariance sigma^2
    rho(dt):

        white            rho = 1 at dt = 0, else 0
        gauss-markov     exp(-r),                    r = |dt| / correlation time    (Rasmussen & Williams 2006, 4.18)
        matern-3/2       (1 + c) exp(-c),            c = sqrt(3) r                  (4.17)
        matern-5/2       (1 + c + c^2 / 3) exp(-c),  c = sqrt(5) r                  (4.17)

    The integrated Wiener process is an acceleration of white noise: x'' = sigma w(t), zero and at rest at its origin,
    from which it goes on both ways; with t and t' counted from there,

        integrated-wiener   sigma^2 a^2 (3 b - a) / 6,   a = min(|t|, |t'|), b = max(|t|, |t'|)     (Wahba 1978)

    on the same side of the origin, and 0 across it.
    """

    kind: ProcessKind
    """Which."""
    sigmas: Array
    """(3,) strength: m or rad; of an integrated Wiener process m/s^1.5 or rad/s^1.5."""
    correlation_time: float = 0.0
    """s, of gauss-markov and Matern processes; of others 0."""
    estimated: bool = False
    """Whether its strength is found from the measures, `sigmas` being its a-priori value."""
    spread: float = 1.0
    """Standard deviation beforehand of the logarithm of a strength that is found."""

    def __post_init__(self) -> None:
        where = f"process {self.kind}"
        if self.kind not in get_args(ProcessKind):
            raise InputError("process, kind", repr(self.kind), f"one of {', '.join(get_args(ProcessKind))}")
        sigmas = frozen(self.sigmas, f"{where}, sigmas", (3,))
        if not np.all(np.isfinite(sigmas) & (sigmas > 0.0)):
            raise InputError(f"{where}, sigmas", f"{sigmas.tolist()}", "three positive finite numbers")
        assign(self, sigmas=sigmas)
        timed = self.kind in ("gauss-markov", "matern-3/2", "matern-5/2")
        time, expected = self.correlation_time, f"a positive number up to {_LONGEST_TIME:g} s"
        require(not timed or 0.0 < time <= _LONGEST_TIME, f"{where}, correlation time", f"{time} s", expected)
        if not timed and time != 0.0:
            raise InputError(f"{where}, correlation time", f"{time} s", f"none: {self.kind} has no correlation time")

    @property
    def stationary(self) -> bool:
        """Whether its covariance depends on the difference of times alone."""
        return self.kind != "integrated-wiener"

    def covariance(self, first: Array, second: Array, origin: float) -> Array:
        """Covariance, for sigma = 1, between times of two arrays that broadcast, in their precision; times in s.

        Parameters
        ----------
        origin : float
            s, when an integrated Wiener process is zero and at rest.
        """
        if self.kind == "integrated-wiener":
            t, u = first - origin, second - origin
            low, high = np.minimum(np.abs(t), np.abs(u)), np.maximum(np.abs(t), np.abs(u))
            return np.asarray(np.where(t * u > 0.0, low**2 * (3.0 * high - low) / 6.0, 0.0))
        return self._correlation(np.abs(first - second))

    def _correlation(self, intervals: Array) -> Array:
        """Of time differences (s, not negative)."""
        if self.kind == "white":
            return np.asarray(np.where(intervals == 0.0, 1.0, 0.0).astype(intervals.dtype))
        r = intervals / self.correlation_time
        if self.kind == "matern-3/2":
            r = np.sqrt(intervals.dtype.type(3.0)) * r
            return np.asarray((1.0 + r) * np.exp(-r))
        if self.kind == "matern-5/2":
            r = np.sqrt(intervals.dtype.type(5.0)) * r
            return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))
        return np.asarray(np.exp(-r))

    def scaled(self, factors: Array) -> "Process":
        """With its sigmas times factors (3,)."""
        return replace(self, sigmas=self.sigmas * factors)


NUGGET = 1e-5
"""Times a process's sigma: white noise that keeps its covariances regular."""
DIVERGENCE = 0.01
"""Nats a node: Kullback-Leibler divergence from the whole process below which neighbours are enough."""
_AT_ORIGIN = 1e-3
"""Times its sigma at the ends of the trend's span: how well an integrated Wiener process is known at its origin."""
_MEMORIES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24)
"""Numbers of neighbours that are tried."""
_WINDOW = 48
"""Nodes before one that stand for all of them."""
_SAMPLES = 32
"""Nodes at which the divergence is taken."""
_FINE: Any = np.longdouble


@dataclass(frozen=True, slots=True, eq=False)
class Conditionals:
    """x_k - sum_j weights[k, j] x_{k-1-j}, of standard deviation sigmas[k], of k nodes."""

    weights: Array
    """(k, m), nearest neighbour first; 0 where there is none."""
    sigmas: Array
    """(k,) m or rad."""
    divergence: float
    """Nats a node, Kullback-Leibler divergence from the whole process."""

    def __post_init__(self) -> None:
        assign(self, weights=frozen(self.weights, "conditionals, weights", (None, None)))
        assign(self, sigmas=frozen(self.sigmas, "conditionals, sigmas", (self.weights.shape[0],)))

    @property
    def memory(self) -> int:
        """Number m of neighbours."""
        return int(self.weights.shape[1])


def variances(processes: Sequence[Process], axis: int, nodes: OrientationImages) -> Array:
    """(k,) variance of the coefficient at each node along one axis (0 .. 2): m^2 or rad^2."""
    times = nodes.times.astype(_FINE)
    return np.asarray(_covariance(processes, axis, nodes, times[:, None], times[:, None])[:, 0], dtype=np.float64)


def dense_covariance(processes: Sequence[Process], axis: int, nodes: OrientationImages) -> Array:
    """(k, k) covariance of all nodes' coefficients along one axis, without nugget: m^2 or rad^2."""
    times = nodes.times.astype(_FINE)
    return np.asarray(_covariance(processes, axis, nodes, times[:, None], times[None, :]), dtype=np.float64)


def conditionals(processes: Sequence[Process], axis: int, nodes: OrientationImages) -> Conditionals:
    """Of the coefficients of nodes along one axis, for a sum of processes, with as few neighbours as lose nothing.

    Raises
    ------
    InputError
        Where no number of neighbours is enough.
    """
    kinds = {process.kind for process in processes}
    count = len(nodes)
    if kinds == {"white"}:
        return Conditionals(np.zeros((count, 0)), np.sqrt(variances(processes, axis, nodes)), 0.0)
    if len(processes) == 1 and kinds == {"gauss-markov"}:
        return _gauss_markov(processes[0], axis, nodes.times)
    memory, divergence = _memory(processes, axis, nodes)
    root, along, variance = _windows(processes, axis, nodes, np.arange(count), memory)
    weights = _solved_back(root, along)
    remaining = variance - np.sum(along**2, axis=1)
    return Conditionals(weights.astype(np.float64), np.sqrt(remaining).astype(np.float64), divergence)


def _gauss_markov(process: Process, axis: int, times: Array) -> Conditionals:
    """Each node given the one before it: exact, and without cancellation."""
    intervals = np.diff(times) / process.correlation_time
    weights = np.append(0.0, np.exp(-intervals))[:, None]
    return Conditionals(weights, process.sigmas[axis] * np.append(1.0, np.sqrt(-np.expm1(-2.0 * intervals))), 0.0)


def _memory(processes: Sequence[Process], axis: int, nodes: OrientationImages) -> tuple[int, float]:
    """Number of neighbours that is enough, and the divergence in nats a node."""
    count, steps = len(nodes), np.diff(nodes.times)
    at = np.unique(np.linspace(1, count - 1, min(_SAMPLES, count - 1)).astype(np.int64))
    at = np.union1d(at, [int(steps.argmin()) + 1, int(steps.argmax()) + 1])
    _, along, variance = _windows(processes, axis, nodes, at, min(_WINDOW, count - 1))
    remaining = variance[:, None] - np.cumsum(along**2, axis=1)
    lost = np.maximum(0.5 * np.log(remaining / remaining[:, -1:]), 0.0).mean(axis=0)
    for memory in _MEMORIES:
        if memory >= remaining.shape[1] or lost[memory - 1] < DIVERGENCE:
            used = min(memory, remaining.shape[1])
            return used, float(lost[used - 1])
    raise InputError(
        f"process {' + '.join(process.kind for process in processes)}",
        f"nodes {steps.min():.3g} s apart, of which {_MEMORIES[-1]} neighbours lose {lost[_MEMORIES[-1] - 1]:.2g} nats",
        f"less than {DIVERGENCE} nats a node (Kullback-Leibler divergence from the whole process)",
        "take a larger spacing, or a rougher process",
    )


def _windows(
    processes: Sequence[Process], axis: int, nodes: OrientationImages, at: Index, size: int
) -> tuple[Array, Array, Array]:
    """Of nodes `at` (n,) and the `size` before each: L (n, m, m) of the covariance of these, nearest first, L^-1 times
    their covariance with the node (n, m), and its variance (n,), in extended precision; neighbours that aren't there
    have nothing to do with it.
    """
    number = at[:, None] - 1 - np.arange(size)
    present = number >= 0
    times = nodes.times.astype(_FINE)
    near, moments = times[np.maximum(number, 0)], times[at]
    both_present = present[:, :, None] & present[:, None, :]
    among = np.where(both_present, _covariance(processes, axis, nodes, near[:, :, None], near[:, None, :]), 0.0)
    across = np.where(present, _covariance(processes, axis, nodes, near, moments[:, None]), 0.0)
    variance = _covariance(processes, axis, nodes, moments, moments)
    nugget = float(NUGGET**2 * sum(process.sigmas[axis] ** 2 for process in processes if process.stationary))
    diagonal = np.arange(size)
    among[:, diagonal, diagonal] = np.where(present, among[:, diagonal, diagonal] + nugget, 1.0)
    root, along = _factorised(among, across)
    return root, along, variance + nugget


def _factorised(matrices: Array, right: Array) -> tuple[Array, Array]:
    """Cholesky factors L of (n, m, m), and L^-1 times right sides (n, m), in their precision."""
    rest, right = matrices.copy(), right.copy()
    root = np.zeros_like(rest)
    for j in range(rest.shape[1]):
        pivot = np.sqrt(rest[:, j, j])
        root[:, j:, j] = rest[:, j:, j] / pivot[:, None]
        right[:, j] = right[:, j] / pivot
        below = root[:, j + 1 :, j]
        right[:, j + 1 :] -= below * right[:, j, None]
        rest[:, j + 1 :, j + 1 :] -= below[:, :, None] * below[:, None, :]
    return root, right


def _solved_back(root: Array, right: Array) -> Array:
    """L'^-1 times right sides (n, m)."""
    solution = right.copy()
    for j in reversed(range(right.shape[1])):
        solution[:, j] = (solution[:, j] - np.sum(root[:, j + 1 :, j] * solution[:, j + 1 :], axis=1)) / root[:, j, j]
    return solution


def _covariance(
    processes: Sequence[Process], axis: int, nodes: OrientationImages, first: Array, second: Array
) -> Array:
    """Of the coefficients at times (s past the nodes' epoch) along one axis; the times broadcast."""
    return np.asarray(sum(p.sigmas[axis] ** 2 * _of_values(p, nodes.trend_span, first, second) for p in processes))


def _of_values(process: Process, span: tuple[float, float], first: Array, second: Array) -> Array:
    """Covariance of a process of sigma 1 at times that broadcast; an integrated Wiener process has its origin amid the
    trend's span, where bias and drift say its value and its rate. So neither the spacing nor later nodes change it.
    """
    covariance = process.covariance(first, second, 0.5 * (span[0] + span[1]))
    if process.stationary:
        return covariance
    # a node at the origin needs a variance: of a constant, so that no spacing is too small for it
    return np.asarray(covariance + _AT_ORIGIN**2 * (0.5 * (span[1] - span[0])) ** 3 / 3.0)
