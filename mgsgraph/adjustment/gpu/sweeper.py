"""Sweeps by a GPU: a layout's rows are copied there once, the orientation for each iteration.

A layout that is too large for its memory is swept in partitions, which are copied again for every sweep.
"""

from importlib.util import find_spec
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.gpu.find import WHERE, Gpu
from mgsgraph.adjustment.graph.forms import Solving, Sweeper, of_rows, sparse_factor
from mgsgraph.adjustment.graph.layout import Layout
from mgsgraph.adjustment.graph.patterns import within
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.cuda.device import SIMULATED
from mgsgraph.kernel.cuda.partition import Partition, Workspace, bytes_of_pieces, room, to_device, to_host, zeros
from mgsgraph.kernel.rows import Rows, partition
from mgsgraph.kernel.sweep import COSTS, SYSTEM, Reduction

MOST_COLUMNS = 8000
"""A matrix of 0.5 GB."""
_COPIES = 6
"""Arrays of the matrix's size: matrix, factor, gathered numbers, their sources, places and units."""


def dense_libraries() -> tuple[ModuleType, ModuleType] | None:
    """CuPy and its linear algebra, or NumPy's where numba's simulator stands in for the device; None without CuPy."""
    if SIMULATED:
        import scipy.linalg

        return np, scipy.linalg
    if find_spec("cupy") is None:
        return None
    import cupy
    import cupyx.scipy.linalg

    return cupy, cupyx.scipy.linalg


def dense_bytes(columns: int) -> float:
    """Bytes that the elimination of so many columns takes on the device; none of more than `MOST_COLUMNS`."""
    return 8.0 * _COPIES * columns**2 if columns <= MOST_COLUMNS else 0.0


class DenseCholesky:
    """The elimination of a layout's normal equations as one dense matrix, by the libraries of the device (or NumPy's).

    Up to some thousand columns a GPU factors the whole matrix faster than the host finds its way through the sparse
    one, and the blocks needn't leave the device.

    Parameters
    ----------
    layout : Layout
    arrays, algebra : module
        NumPy or CuPy, and the linear algebra that goes with it.
    """

    def __init__(self, layout: Layout, arrays: ModuleType, algebra: ModuleType) -> None:
        self._arrays, self._algebra, self._layout = arrays, algebra, layout
        row, column, place = _places(layout)
        self._from, self._to = arrays.asarray(place), arrays.asarray(column * layout.columns + row)
        self._units = arrays.asarray(layout.scales[row] * layout.scales[column])
        self._scales, self._weights = arrays.asarray(layout.scales), arrays.asarray(layout.prior.weights**2)
        self._more = arrays.asarray(layout.prior_information)

    def factor(self, blocks: Any, damping: float) -> "DenseFactor":
        """Factor of flat blocks plus the priors' information, damped in units of the unknowns' scales.

        Raises NotDefinite.
        """
        arrays, columns = self._arrays, self._layout.columns
        flat = arrays.asarray(blocks)
        flat = flat + self._more if self._more.size else flat
        matrix = arrays.zeros(columns * columns)
        matrix[self._to] = flat[self._from] * self._units
        diagonal = arrays.arange(columns) * (columns + 1)
        matrix[diagonal] += self._weights * self._scales**2 + damping
        try:
            lower = arrays.linalg.cholesky(matrix.reshape(columns, columns))
        except np.linalg.LinAlgError as error:
            raise NotDefinite from error
        # CuPy says nothing of a matrix that is not definite
        if not bool((arrays.isfinite(lower.diagonal()) & (lower.diagonal() > 0.0)).all()):
            raise NotDefinite
        return DenseFactor(lower, self._scales, arrays, self._algebra)


class DenseFactor:
    """Such a factor, in units of `scales`."""

    def __init__(self, lower: Any, scales: Any, arrays: ModuleType, algebra: ModuleType) -> None:
        self._lower, self._scales, self._arrays, self._algebra = lower, scales, arrays, algebra

    def solve(self, right: Array) -> Array:
        """Solution (columns,), m and rad, for a right side per m and rad: arrays of the host."""
        solve = self._algebra.solve_triangular
        half = solve(self._lower, self._arrays.asarray(right) * self._scales, lower=True)
        solution = solve(self._lower, half, trans=1, lower=True) * self._scales
        return np.asarray(solution if self._arrays is np else self._arrays.asnumpy(solution))


def _places(layout: Layout) -> tuple[Index, Index, Index]:
    """Row and column of all numbers of the blocks that are adjusted, in the upper triangle or in a diagonal block, and
    their places in the flat array.
    """
    blocks, first, width = layout.blocks, layout.variables.first, layout.variables.width
    adjusted = np.flatnonzero((first[blocks.first] >= 0) & (first[blocks.second] >= 0))
    first_variable, second_variable = blocks.first[adjusted], blocks.second[adjusted]
    sizes = width[first_variable] * width[second_variable]
    block = np.repeat(np.arange(adjusted.size), sizes)
    inside = within(sizes)
    across = width[second_variable][block]
    row, column = first[first_variable][block] + inside // across, first[second_variable][block] + inside % across
    return row, column, blocks.offset[adjusted][block] + inside


_SHARE = 0.8
"""Share of the free memory: the rest is for driver, libraries and reduced equations."""
_PER_POINT = 4 * 25
"""Bytes: places and states of the reductions that exist at a time."""
_MOST_WORK = 4e9
"""Bytes of scratch for one partition: more don't make a sweep faster."""
_GIGA = 1e9


class GpuReduction(Reduction):
    """A reduction whose points and blocks stay on the device until needed."""

    def __init__(
        self, task: int, orientation: Array, costs: Array, gradient: Array, points: Any, states: Any, blocks: Any
    ) -> None:
        of_parent = {"task": task, "orientation": orientation.copy(), "cost": float(costs.sum()), "piece_cost": costs}
        of_device = {"gradient": gradient, "on_device": points, "blocks_on_device": blocks}
        of_device |= {"_states": states, "_here": {}}
        for name, value in (of_parent | of_device).items():
            object.__setattr__(self, name, value)  # frozen, like its parent

    on_device: Any
    """(n, 3) m, on the device."""
    blocks_on_device: Any
    """Reduced normal matrix there; None unless it was asked for."""
    _states: Any
    _here: dict[str, NDArray[Any]]

    def _fetched(self, name: str, values: Any) -> NDArray[Any]:
        if name not in self._here:
            self._here[name] = to_host(values)
        return self._here[name]

    @property
    def points(self) -> Array:
        """(n, 3) m, solved places in the layout's order."""
        return self._fetched("points", self.on_device)

    @property
    def states(self) -> NDArray[np.int8]:
        """(n,) rows.GOOD, BEHIND or WEAK."""
        return self._fetched("states", self._states)

    @property
    def blocks(self) -> Array | None:
        """Reduced normal matrix; None unless it was asked for."""
        return None if self.blocks_on_device is None else self._fetched("blocks", self.blocks_on_device)


class GpuSweeper(Sweeper):
    """Sweeps by a GPU.

    Parameters
    ----------
    gpu : Gpu
    layout : Layout
        What is adjusted; rows that are swept later are its own but for kinds of points and weights.
    deterministic : bool
        Whether the same sweep gives the same bits twice.

    Raises
    ------
    InputError
        Memory in which not even the smallest part of the points can be swept.
    """

    def __init__(self, gpu: Gpu, layout: Layout, deterministic: bool = False) -> None:
        self._gpu, self._deterministic = gpu, deterministic
        self._parts, self._held = list[Partition](), True
        self._dense: DenseCholesky | None = None
        self._divide(layout)

    @property
    def remark(self) -> str:  # type: ignore[override]
        """Use of the device, for the user."""
        text = f"Swept by the GPU ({self._gpu.name})"
        if not self._held:
            text += f", in {len(self._parts)} partitions that take turns in its {self._gpu.memory / _GIGA:.2f} GB"
        return " ".join(part for part in (f"{text}.", self._gpu.remark) if part)

    def _divide(self, layout: Layout) -> None:
        """Make partitions of a layout's points, and room for their sweeps."""
        self._layout, self._rows, self._dense = layout, layout.rows, None
        for part in self._parts:
            part.let_go()
        edges, self._held = divided(layout.rows, _SHARE * (self._gpu.memory - dense_bytes(layout.columns)))
        common = layout.groups, layout.blocks.target, layout.model, self._deterministic
        self._parts = [Partition(partition(layout.rows, first, last), *common) for first, last in pairwise(edges)]
        self._pieces = edges
        self._points = [*layout.rows.piece[edges[:-1], 1].tolist(), layout.rows.kind.size]
        self._work = Workspace(max((part.work for part in self._parts), default=0))

    def _take(self, layout: Layout, rows: Rows) -> None:
        """Continue with a layout made of the same network, and rows of which others take part."""
        now = self._layout
        if layout.patterns is not now.patterns or layout.model != now.model:
            self._divide(layout)
        laid = all(getattr(layout, name) is getattr(now, name) for name in ("lines", "stereo", "bent"))
        if not laid or rows.kind is not self._rows.kind or rows.weight is not self._rows.weight:
            for part, (first, last) in zip(self._parts, pairwise(self._pieces), strict=True):
                part.renew(partition(rows, first, last), constants=not laid)
        self._layout, self._rows = layout, rows

    def _each(self) -> Any:
        """Partitions, and the places of their points and observations among all; where the memory can't hold all of
        them, each is removed when the next one comes.
        """
        for part, ends in zip(self._parts, pairwise(self._points), strict=True):
            yield part, slice(*ends)
            if not self._held:
                part.let_go()

    # --- what a Sweeper does

    def reduction(
        self, layout: Layout, rows: Rows, orientation: Array, task: int, points: Array | Reduction | None,
        rough: bool = False,
    ) -> Reduction:  # fmt: skip
        """All points solved (and eliminated); `rough` saves nothing here, where a thread ends with its own point."""
        self._take(layout, rows)
        begin = points.on_device if isinstance(points, GpuReduction) else None
        if begin is None:
            places = points.points if isinstance(points, Reduction) else points
            begin = to_device(rows.start if places is None else places)
        target, costs, x = layout.blocks.target, list[Array](), to_device(orientation)
        ends, states = room((rows.kind.size, 3)), room(rows.kind.size, np.int8)
        gradient, blocks = zeros(0 if task == COSTS else target.columns), zeros(target.size if task == SYSTEM else 0)
        for part, inside in self._each():
            arrays = begin[inside], ends[inside], states[inside], gradient, blocks
            costs.append(part.reduce(self._work, x, task, *arrays))
        piece_costs = np.concatenate(costs) if costs else np.zeros(0)
        all_blocks = blocks if task == SYSTEM else None
        return GpuReduction(task, orientation, piece_costs, to_host(gradient), ends, states, all_blocks)

    def covariances(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Covariances (n, 3, 3) of the points in m^2, zero for known ones."""
        self._take(layout, rows)
        x, shared, places = to_device(orientation), to_device(joint), to_device(points)
        blocks = np.empty((points.shape[0], 3, 3))
        for part, inside in self._each():
            blocks[inside] = part.covariances(self._work, x, shared, places[inside])
        return blocks

    def residuals(self, layout: Layout, rows: Rows, orientation: Array, points: Array) -> Array:
        """Residuals (t, 2) of all observations: image rays in pixels, ranges and heights in m."""
        self._take(layout, rows)
        x, places = to_device(orientation), to_device(points)
        parts = [part.residuals(self._work, x, places[inside]) for part, inside in self._each()]
        return np.concatenate([np.zeros((0, 2)), *parts])

    def leverage(self, layout: Layout, rows: Rows, orientation: Array, joint: Array, points: Array) -> Array:
        """Residuals (t, 8) of all observations beside their leverage."""
        self._take(layout, rows)
        x, shared, places = to_device(orientation), to_device(joint), to_device(points)
        numbers, begin = np.empty((rows.weight.shape[1], 8)), 0
        for part, inside in self._each():
            end = begin + part.observations
            of_rows(part.reliability(self._work, x, shared, places[inside]), numbers[begin:end])
            begin = end
        return numbers

    def factor(self, layout: Layout, reduction: Reduction, damping: float) -> Solving:
        """Factor of the damped equations: dense on the device, where these are few, else sparse on the host.

        Raises NotDefinite.
        """
        libraries = dense_libraries()
        if layout.columns > MOST_COLUMNS or libraries is None or not isinstance(reduction, GpuReduction):
            return sparse_factor(layout, reduction, damping)
        if self._dense is None:
            self._dense = DenseCholesky(layout, *libraries)
        return self._dense.factor(reduction.blocks_on_device, damping)


def divided(rows: Rows, memory: float) -> tuple[list[int], bool]:
    """(p + 1,) pieces at which a layout's points are divided so that a device with so many bytes can sweep them, and
    whether it can hold all of them at once.

    Raises
    ------
    InputError
        Where it can't sweep a single piece.
    """
    held, work = bytes_of_pieces(rows)
    available = memory - _PER_POINT * rows.kind.size
    room_for_work = min(available - held.sum(), _MOST_WORK)
    at_once = bool(room_for_work >= work.max(initial=0))
    each = work if at_once else held + work
    limit = room_for_work if at_once else available
    if each.max(initial=0) > limit:
        problem = f"a GPU with {memory / _GIGA:.3f} GB to use"
        needed = f"{(each.max() + memory - available) / _GIGA:.3f} GB for {rows.kind.size} points"
        raise InputError(WHERE, problem, needed, "take device = 'cpu', or a GPU with more memory")
    ends, edges = np.cumsum(each), [0]
    while edges[-1] < each.size:
        before = ends[edges[-1] - 1] if edges[-1] else 0
        edges.append(int(np.searchsorted(ends, before + limit, side="right")))
    return edges, at_once
