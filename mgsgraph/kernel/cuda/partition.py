"""A partition of a layout's points on the device: its arrays there, and the launches of its sweeps."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.kernel.covariance import NUMBERS as OF_ROW
from mgsgraph.kernel.cuda.coupling import add_up, clear, couple, residuals
from mgsgraph.kernel.cuda.covariance import cover, judge
from mgsgraph.kernel.cuda.device import SIMULATED, THREADS, cuda
from mgsgraph.kernel.cuda.solving import NUMBERS, solve, sum_costs
from mgsgraph.kernel.cuda.tables import Jobs, Tables, make_jobs, make_tables, numbers_left, parts
from mgsgraph.kernel.rows import NO_LOSS, Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM

Array = NDArray[np.float64]
MIDDLE = 6
"""Numbers of a point's M (`covariance.cover`)."""
_BYTES = 8


def to_device(values: Any) -> Any:
    """A copy of an array on the device; in the simulator's memory, which is this process's, where that stands in."""
    return np.array(values) if SIMULATED else cuda.to_device(np.ascontiguousarray(values))


def to_host(values: Any) -> NDArray[Any]:
    """A copy of a device's array."""
    return np.array(values) if SIMULATED else np.asarray(values.copy_to_host())


def room(shape: int | tuple[int, ...], dtype: Any = np.float64) -> Any:
    """An array on the device, to be filled."""
    return np.empty(shape, dtype) if SIMULATED else cuda.device_array(shape, dtype)


def _blocks(count: int) -> int:
    """Blocks of threads, a thread each for so many."""
    return max(1, -(-count // THREADS))


def zeros(size: int) -> Any:
    """Zeros (size,) on the device."""
    values = room(size)
    if size:
        clear[_blocks(size), THREADS](values)
    return values


class Workspace:
    """Room on the device that the sweeps of all partitions take in turn: memory that is asked for once.

    Parameters
    ----------
    numbers : int
        The most that a sweep takes (`Partition.work`).
    """

    def __init__(self, numbers: int) -> None:
        self._room, self._taken = room(numbers), 0

    def begin(self) -> None:
        """Nothing is needed any longer."""
        self._taken = 0

    def take(self, *shape: int) -> Any:
        """An array to be filled."""
        begin, self._taken = self._taken, self._taken + math.prod(shape)
        return self._room[begin : self._taken].reshape(shape)


class _Arrays(NamedTuple):
    """What of a partition lies on the device."""

    tables: Tables
    data: Any
    weight: Any
    kind: Any
    start: Any


class Partition:
    """Some neighbouring pieces of a layout's points, by themselves (`rows.partition`), as the device sweeps them.

    Parameters
    ----------
    rows, groups, target, model
        As the kernel of the CPU takes them.
    deterministic : bool
        Whether sums have an order.
    """

    def __init__(
        self, rows: Rows, groups: Groups, target: NormalBlocks, model: Model, deterministic: bool = False
    ) -> None:
        self._rows, self._groups, self._target = rows, groups, target
        self._deterministic = deterministic
        # plain numbers, for whose types kernels are compiled
        self.model = Model(int(model.line), int(model.angles), int(model.loss), float(model.width))
        self._tables, self._coupling = make_tables(rows, groups, target, model)
        self._jobs: dict[bool, Any] = {}
        self._arrays: _Arrays | None = None
        self.points, self.observations = int(rows.kind.size), int(rows.weight.shape[1])

    @property
    def pieces(self) -> int:
        """Number of its pieces."""
        return int(self._rows.piece.shape[0])

    @property
    def work(self) -> int:
        """Numbers that its sweeps take of a `Workspace`, the largest of them."""
        each = points_work(self.points, self.pieces) + self._coupling
        return each + max(9 * self.points, 3 * OF_ROW * self.observations)

    def renew(self, rows: Rows, constants: bool) -> None:
        """Go on with rows of the same observations: others that take part, and, where it is so, other constants."""
        self._rows = rows
        if self._arrays is not None:
            names = ("kind", "weight", "data", "start") if constants else ("kind", "weight")
            self._arrays = self._arrays._replace(**{name: to_device(getattr(rows, name)) for name in names})

    def hold(self) -> _Arrays:
        """Its arrays, sent to the device unless they are there."""
        if self._arrays is None:
            rows = self._rows
            sent = map(to_device, (rows.data, rows.weight, rows.kind, rows.start))
            self._arrays = _Arrays(Tables(*map(to_device, self._tables)), *sent)
        return self._arrays

    def let_go(self) -> None:
        """Give its arrays' memory on the device back."""
        self._arrays = None
        self._jobs.clear()

    def _jobs_of(self, with_matrix: bool) -> Any:
        if with_matrix not in self._jobs:
            jobs = make_jobs(self._rows, self._groups, self._target, with_matrix, self._deterministic)
            self._jobs[with_matrix] = Jobs(*map(to_device, jobs)), jobs.edges.size - 1
        return self._jobs[with_matrix]

    def reduce(
        self, work: Workspace, x: Any, task: int, begin: Any, points: Any, states: Any, gradient: Any, blocks: Any
    ) -> Array:
        """Solve all points from `begin` (n, 3), which end at `points` (n, 3) with `states` (n,), and, as the task says
        (sweep.COSTS, GRADIENT, SYSTEM), add to the gradient and to the blocks: arrays on the device. The cost of each
        piece (m,) comes back.
        """
        work.begin()
        held, costs, of_pieces = self.hold(), work.take(self.points), work.take(self.pieces)
        left = self._solve(work, held, x, begin, True, points, states, costs)
        sum_costs[self.pieces, THREADS](held.tables, costs, of_pieces)
        if task != COSTS:
            result = self._couple(work, held, x, states, left)
            jobs, count = self._jobs_of(task == SYSTEM)
            if count:
                add_up[count, THREADS](held.tables, jobs.table, jobs.edges, result, gradient, blocks)
        return to_host(of_pieces)

    def covariances(self, work: Workspace, x: Any, joint: Any, points: Any) -> Array:
        """(n, 3, 3) m^2 of points (n, 3), see `kernel.sweep.point_covariances`."""
        work.begin()
        values = work.take(self.points, 3, 3)
        self._cover(work, x, joint, points, values)
        return to_host(values)

    def residuals(self, work: Workspace, x: Any, points: Any) -> Array:
        """(t, 2), see `kernel.sweep.all_residuals`."""
        work.begin()
        held, values = self.hold(), work.take(self.observations, 2)
        model = self.model._replace(loss=NO_LOSS)
        residuals[_blocks(self.observations), THREADS](
            held.tables, model, held.data, held.weight, held.kind, x, points, values
        )
        return to_host(values)

    def reliability(self, work: Workspace, x: Any, joint: Any, points: Any) -> Array:
        """(t, 3, 7), see `kernel.sweep.reliability`."""
        work.begin()
        held, values = self.hold(), work.take(self.observations, 3, OF_ROW)
        middle, states, left, result = self._cover(work, x, joint, points, room((0, 3, 3)))
        judge[_blocks(self.observations), THREADS](
            held.tables, self.model, held.data, held.weight, held.kind, x, states, left, result, joint, middle, values
        )
        return to_host(values)

    def _solve(
        self, work: Workspace, held: _Arrays, x: Any, begin: Any, move: bool, points: Any, states: Any, costs: Any
    ) -> Any:
        left = work.take(NUMBERS, self.points)
        solve[_blocks(self.points), THREADS](
            held.tables, self.model, held.data, held.weight, held.kind, x, begin, held.start, move, points, states,
            costs, left,
        )  # fmt: skip
        return left

    def _couple(self, work: Workspace, held: _Arrays, x: Any, states: Any, left: Any) -> Any:
        result = work.take(self._coupling)
        couple[_blocks(self.observations), THREADS](
            held.tables, self.model, held.data, held.weight, held.kind, x, states, left, result
        )
        return result

    def _cover(self, work: Workspace, x: Any, joint: Any, points: Any, values: Any) -> tuple[Any, Any, Any, Any]:
        """M of all points, their states, and what solving and coupling leave there; `values` as in `cover`."""
        held, states, middle = self.hold(), room(self.points, np.int8), work.take(MIDDLE, self.points)
        left = self._solve(work, held, x, points, False, points, states, room(0))
        result = self._couple(work, held, x, states, left)
        cover[_blocks(self.points), THREADS](held.tables, held.kind, states, left, result, joint, middle, values)
        return middle, states, left, result


def points_work(points: int, pieces: int) -> int:
    """Numbers of a `Workspace` that points and pieces take, whatever is done with them."""
    return (NUMBERS + MIDDLE + 1) * points + pieces


def bytes_of_pieces(rows: Rows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(m,) bytes that each piece takes on the device as long as it is held, and those that a sweep over it takes."""
    count, sizes, pattern = np.diff(rows.pattern_observation), rows.piece[:, 2], rows.piece[:, 0]
    owner = np.repeat(np.arange(count.size), count)
    stored, left, each = (
        np.bincount(owner, values, count.size).astype(np.int64)[pattern]
        for values in (rows.observation_numbers, numbers_left(rows), parts(rows))
    )
    observations = count[pattern]
    held = sizes * (_BYTES * (stored + 2 * observations + 3) + 5 + 4 * observations)
    held += 5 * 4 * (2 * each + each * (each + 1) // 2)
    work = sizes * (points_work(1, 1) + left + np.maximum(9, 3 * OF_ROW * observations))
    return held, _BYTES * work
