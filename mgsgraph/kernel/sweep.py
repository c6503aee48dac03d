"""The kernel: one sweep over points that solves them, and eliminates them, or states their covariances or residuals;
and what it leaves at one orientation, a `Reduction` (variable projection; Golub & Pereyra 1973).

Compiled once and cached on disk, in parts that processes compile side by side; it holds no lock, so that threads share
a sweep, each with pieces of its own.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import address_of, compile_beside, threads
from mgsgraph.kernel.covariance import NUMBERS, covariance_tile, reliability_tile
from mgsgraph.kernel.elimination import (
    PLAIN_TOLERANCE,
    ROUGH_TOLERANCE,
    eliminate_tile,
    move_basis,
    solve_tile,
    sum_singles,
)
from mgsgraph.kernel.lanes import (
    BASIS,
    BETWEEN_STATES,
    BY_POINT,
    BY_STATE,
    LANES,
    MOST_SUMS,
    RESIDUAL,
    RESULT,
    ROW,
    TILE,
    WIDTH,
    blocks_of,
    call,
    inlined,
    lane,
    pair_of,
    registers,
)
from mgsgraph.kernel.measurements import Loops, kernel, loops_of, row_count
from mgsgraph.kernel.rows import NO_LOSS, PREDICTED, Groups, Model, NormalBlocks, Rows, Small
from mgsgraph.kernel.tile import (
    BEGIN,
    END,
    fill,
    observation_index,
    observations_of,
    pose_components,
    store_points,
    store_residuals,
    workspace,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COSTS, GRADIENT, SYSTEM, COVARIANCES, RESIDUALS, RELIABILITY, DESIGN = 0, 1, 2, 3, 4, 5, 6
"""What a sweep is for: costs of the solved points; the reduced gradient there, too; that and the reduced normal matrix;
covariances, or residuals of all rows, taking part or not, or reliability or design of those that take part, at given
points.
"""

ROW_NUMBERS = 4
"""Numbers of a row before its columns: the residual, and the derivatives by the point (3)."""

_WORTHWHILE = 5000.0
"""Observations below which a second thread costs more than it saves."""
_MOST_PARTS = 16
"""Parts of a sweep, each summed by itself."""
_PER_SUM = 4
"""Numbers in the sums of all parts for each observation: with more, adding them takes longer than parts save."""


@lane
def design_tile(rows, model, segments, count, w, depth, values):
    """Of each row of a tile's observations `ROW_NUMBERS`, then its derivatives: six columns per basis term, then the
    single ones.
    """
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        if model.line == PREDICTED:
            move_basis(rows, i, w, TILE + (i - begin) * depth)
        for k in range(count):
            first, last = segments[k, BEGIN], segments[k, END]
            at = observation_index(rows, segments, k, i - begin)
            store_design(rows, i, at, first, last, w, TILE + (i - begin) * depth, values)


@inlined
def store_design(rows, i, at, first, last, w, s, values):
    """Residual and derivatives of the rows of observation i, in lanes first .. last."""
    terms, width = rows.observation_terms[i], rows.observation_width[i]
    for row in range(row_count(rows.observation_kind[i])):
        point, state = s + RESULT + BY_POINT + row * ROW, s + RESULT + BY_STATE + row * ROW
        for l in range(first, last):
            values[at + l, row, 0] = w[s + RESULT + RESIDUAL + row * ROW + l]
            for c in range(3):
                values[at + l, row, 1 + c] = w[point + c * LANES + l]
            for t in range(terms):
                for a in range(pose_components(width)):
                    by_state = w[state + a * LANES + l]
                    values[at + l, row, ROW_NUMBERS + 6 * t + a] = by_state * w[s + BASIS + t * LANES + l]
            for e in range(rows.observation_shared[i]):
                direction, total = s + BASIS + 2 * terms * LANES + e * WIDTH, 0.0
                for a in range(width):
                    total += w[state + a * LANES + l] * w[direction + a * LANES + l]
                values[at + l, row, ROW_NUMBERS + 6 * terms + e] = total


class Scratch(NamedTuple):
    """What a thread works in."""

    work: Array
    """Registers of a tile."""
    depth: int
    """Numbers per observation among them."""
    segments: Index
    """(LANES, 5) of a tile."""
    transposed: Array
    """Numbers to be summed, lane by lane."""
    weights: Array
    """Products of two observations' basis values."""
    sums: Array
    """Of a segment's lanes, for each product."""
    pair: Array
    """What is between two observations' states."""


def scratch_for(rows: Rows) -> Scratch:
    """Room for a thread."""
    size, depth = workspace(rows)
    pairs = max(2, int(rows.observation_terms.max(initial=0)) ** 2)
    sums = np.zeros(LANES * MOST_SUMS), np.zeros(pairs * LANES), np.zeros((pairs + 1) * MOST_SUMS)
    return Scratch(np.zeros(size), depth, np.zeros((LANES, 5), dtype=np.int64), *sums, np.zeros(BETWEEN_STATES))


@kernel
def solve_part(rows, model, x, task, tolerance, loops, count, scratch, points):
    """Solve the points of a tile of `count` segments (`elimination.solve_tile`)."""
    w, move = registers(scratch.work), task <= SYSTEM
    solve_tile(
        rows, model, scratch.segments, count, x, points, move, task == RESIDUALS, tolerance, w, scratch.depth,
        task != COSTS, loops,
    )  # fmt: skip


@kernel
def eliminate_part(rows, groups, target, model, task, singles, count, scratch, blocks, gradient):
    """Eliminate the solved points of a tile (`elimination.eliminate_tile`)."""
    eliminate_tile(rows, groups, target, model, scratch, count, task == SYSTEM, singles, blocks, gradient)


@kernel
def singles_part(rows, groups, target, i, j, begin, count, scratch, blocks):
    """What pairs of observations with single columns add to the normal matrix (`elimination.sum_singles`)."""
    sum_singles(rows, groups, target, scratch, count, i, j, begin, blocks_of(blocks))


@kernel
def covariances_part(rows, groups, target, model, task, count, scratch, joint, values):
    """COVARIANCES or RELIABILITY of the points of a tile."""
    w, pair, segments, depth = registers(scratch.work), pair_of(scratch.pair), scratch.segments, scratch.depth
    if task == COVARIANCES:
        covariance_tile(rows, groups, target, model, segments, count, joint, w, depth, pair, values)
    else:
        reliability_tile(rows, groups, target, model, segments, count, joint, w, depth, pair, values)


@kernel
def residuals_part(rows, groups, target, model, task, count, scratch, joint, values):
    """RESIDUALS of the points of a tile."""
    store_residuals(rows, scratch.segments, count, registers(scratch.work), scratch.depth, values[:, :, 0])


@kernel
def design_part(rows, groups, target, model, task, count, scratch, joint, values):
    """DESIGN of the points of a tile."""
    design_tile(rows, model, scratch.segments, count, registers(scratch.work), scratch.depth, values)


_REPORTS = {
    COVARIANCES: covariances_part, RELIABILITY: covariances_part, RESIDUALS: residuals_part, DESIGN: design_part
}  # fmt: skip
"""By task; all take the same arguments, for the sweep calls whichever it is given."""


@kernel
def sweep(
    rows, groups, target, model, x, task, tolerance, parts, loops, first_piece, last_piece, scratch, points, states,
    costs, blocks, gradient, values,
):  # fmt: skip
    """One sweep over the pieces first_piece .. last_piece.

    COSTS, GRADIENT and SYSTEM begin at `points` (n, 3) and leave the best ones there, with states (n,) and the cost
    of each piece in costs (m,); the latter two add the reduced gradient to `gradient`, SYSTEM the normal matrix to
    `blocks`.
    COVARIANCES and RELIABILITY take the covariance of the shared unknowns from `blocks`; `values` are (n, 3, 3)
    covariances, (t, 2, 1) residuals, (t, 3, 7) `reliability.NUMBERS` or (t, 3, c) rows as in `design`.
    `parts` are where the parts lie that it calls, `loops` those that it solves points with.
    """
    solve, eliminate, singles, report = parts
    segments = scratch.segments
    costs[first_piece:last_piece] = 0.0
    piece, first = first_piece, 0
    while piece < last_piece:
        count, piece, first = fill(rows, piece, first, last_piece, segments)
        call(solve, (rows, model, x, task, tolerance, loops, count, scratch, points))
        if task <= SYSTEM:
            store_points(rows, segments, count, registers(scratch.work), points, states, costs)
        if task == GRADIENT or task == SYSTEM:
            call(eliminate, (rows, groups, target, model, task, singles, count, scratch, blocks, gradient))
        elif task > SYSTEM:
            call(report, (rows, groups, target, model, task, count, scratch, blocks, values))


def compile_sweep_beside() -> None:
    """Let other processes compile the parts of the sweep, if they are not cached."""
    for parts in ((solve_part, sweep, residuals_part, design_part), (eliminate_part, covariances_part)):
        names = ", ".join(part.__name__ for part in parts)
        compile_beside(parts[0], f"from {__name__} import place_of_part, {names}; list(map(place_of_part, ({names})))")


@cache
def place_of_part(part: Any) -> Any:
    """Where a part of the sweep lies, compiled or loaded for arguments of the types that it always has."""
    kinds = {Small: np.int8, Index: np.int64, Array: np.float64}
    tables = "start", "weight", "piece", "observation_slope", "terrain"

    def none_of(fields: Any) -> Any:
        shapes = {name: (0, 0) if name in tables else (0,) for name in fields._fields}
        of_kind = fields.__annotations__.items()
        return fields(*(0 if kind is int else np.zeros(shapes[name], kinds[kind]) for name, kind in of_kind))

    scratch = Scratch(np.zeros(0), 0, np.zeros((0, 5), dtype=np.int64), *(np.zeros(0) for _ in range(4)))
    arguments = {
        "rows": as_compiled(none_of(Rows)), "groups": none_of(Groups), "target": none_of(NormalBlocks),
        "model": Model(0, 0, 0, 0.0), "scratch": scratch, "points": np.zeros((0, 3)), "values": np.zeros((0, 0, 0)),
        "states": np.zeros(0, dtype=np.int8), "tolerance": PLAIN_TOLERANCE, "parts": (0, 0, 0, 0),
        "loops": Loops(*len(Loops._fields) * [0]),
        **dict.fromkeys(("x", "costs", "blocks", "joint", "gradient"), np.zeros(0)),
        **dict.fromkeys(("task", "count", "first_piece", "last_piece", "singles", "i", "j", "begin"), 0),
    }  # fmt: skip
    return address_of(part, arguments)


def even_parts(rows: Rows, parts: int) -> Index:
    """(p + 1,) pieces at which the work is divided into so many even parts."""
    observations = np.diff(rows.pattern_observation)[rows.piece[:, 0]]
    costs = rows.piece[:, 2] * (observations + 0.25 * observations**2) + 8.0 * observations**2
    work = np.concatenate([[0.0], np.cumsum(costs)])
    edges = np.searchsorted(work, work[-1] * np.arange(1, parts) / parts)
    return np.concatenate([[0], np.maximum.accumulate(edges), [costs.size]]).astype(np.int64)


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="sweep")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # threads don't come along


def as_compiled(rows: Rows) -> Rows:
    """The rows as the kernel is compiled for: a terrain model that is read-only, as the network's is, and weights in C
    order.
    """
    terrain = rows.terrain.view()
    terrain.flags.writeable = False
    return rows._replace(terrain=terrain, weight=writable(rows.weight))


def writable(values: NDArray[Any]) -> NDArray[Any]:
    """The array itself, or a copy of one that is read-only (as what comes over a wire may be), strided or not aligned:
    to the kernel that would be another type.
    """
    return np.require(values, requirements=("C", "A", "W"))


def sweep_all(
    rows: Rows,
    groups: Groups,
    target: NormalBlocks,
    model: Model,
    x: Array,
    task: int,
    points: Array,
    states: NDArray[np.int8] | None = None,
    costs: Array | None = None,
    joint: Array | None = None,
    values: Array | None = None,
    tolerance: float = PLAIN_TOLERANCE,
) -> tuple[Array, Array]:
    """A sweep over all pieces, in parts that `threads` share; blocks and gradient, summed.

    The number of parts depends on the rows alone, and their sums are added in their order: any number of threads gives
    the same bits.
    """
    observations = rows.weight.shape[1]
    fitting = max(2, _PER_SUM * observations // max(1, target.size))
    count = min(1 + int(observations / _WORTHWHILE), fitting, _MOST_PARTS)
    edges = even_parts(rows, count)
    with_matrix, with_gradient = task == SYSTEM, task in (GRADIENT, SYSTEM)
    states = np.empty(rows.kind.size, dtype=np.int8) if states is None else states
    costs = np.empty(rows.piece.shape[0]) if costs is None else costs
    values = np.empty((0, 0, 0)) if values is None else values
    none = np.empty(0) if joint is None else writable(joint)
    x, points = writable(x), writable(points)
    rows, spare = as_compiled(rows), list[tuple[Array, Array]]()
    reported, has_singles = _REPORTS.get(task), with_matrix and bool(rows.observation_shared.any())
    place_of_part(sweep)
    used = (solve_part, True), (eliminate_part, with_gradient), (singles_part, has_singles), (reported, reported)
    loops = loops_of(rows, model)  # first: other processes may be compiling the parts
    code = tuple(place_of_part(part) if called else 0 for part, called in used), loops

    def zeros() -> tuple[Array, Array]:
        """Room for sums, of a part that has been added: memory that is touched for the first time costs more."""
        sizes = target.size if with_matrix else 0, target.columns if with_gradient else 0
        room = spare.pop() if spare else (np.empty(sizes[0]), np.empty(sizes[1]))
        for numbers in room:
            numbers.fill(0.0)
        return room

    blocks, gradient = zeros()
    left, waiting, added, lock = iter(range(count)), dict[int, tuple[Array, Array]](), 0, Lock()

    def share() -> None:
        nonlocal added
        scratch = scratch_for(rows)
        for k in left:
            sums = zeros()
            results = (scratch, points, states, costs, sums[0] if with_matrix else none, sums[1], values)
            sweep(rows, groups, target, model, x, task, tolerance, *code, int(edges[k]), int(edges[k + 1]), *results)
            with lock:
                waiting[k] = sums
                while added in waiting:
                    for total, more in zip((blocks, gradient), waiting[added], strict=True):
                        np.add(total, more, out=total)
                    spare.append(waiting.pop(added))
                    added += 1

    others = min(threads(), count) - 1
    running = [_threads(others).submit(share) for _ in range(others)]
    share()
    for other in running:
        other.result()
    return blocks, gradient




@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """All points solved and eliminated at one orientation."""

    task: int
    """What was asked for: sweep.COSTS, GRADIENT or SYSTEM."""
    orientation: Array
    """(columns,) orientation vector it was made at."""
    cost: float
    """Half the weighted sum of squares of all point rows; infinite when a point is behind a camera."""
    piece_cost: Array
    """(m,) the same by piece."""
    blocks: Array | None
    """Reduced normal matrix in the blocks of a `NormalBlocks`; None unless it was asked for."""
    gradient: Array
    """(columns,) reduced gradient; empty unless it was asked for."""
    points: Array
    """(n, 3) m, solved coordinates in the layout's order."""
    states: NDArray[np.int8]
    """(n,) rows.GOOD, BEHIND or WEAK."""

    def serves(self, orientation: Array, task: int) -> bool:
        """Whether it is of this orientation and has what a task asks for: then it needs no other."""
        return self.task >= task and np.array_equal(self.orientation, orientation)


def reduce(
    rows: Rows,
    groups: Groups,
    target: NormalBlocks,
    model: Model,
    orientation: Array,
    task: int = SYSTEM,
    points: Array | None = None,
    rough: bool = False,
) -> Reduction:
    """Solve all points for an orientation (sweep.COSTS) and eliminate them (GRADIENT, SYSTEM): one pass of the kernel.

    The inner solve begins at `points` (n, 3), where an earlier call ended (with a robust loss, and without them, at
    `rows.start`): that saves steps; the result is the same to the tolerance of that solve, which may be `rough`.
    """
    points = (rows.start if points is None else points).copy()
    states, costs = np.empty(rows.kind.size, dtype=np.int8), np.empty(rows.piece.shape[0])
    tolerance, results = ROUGH_TOLERANCE if rough else PLAIN_TOLERANCE, (points, states, costs)
    blocks, gradient = sweep_all(rows, groups, target, model, orientation, task, *results, tolerance=tolerance)
    matrix, cost = blocks if task == SYSTEM else None, float(costs.sum())
    return Reduction(task, orientation.copy(), cost, costs, matrix, gradient, points, states)


def point_covariances(
    rows: Rows, groups: Groups, target: NormalBlocks, model: Model, orientation: Array, joint: Array, points: Array
) -> Array:
    """Covariances (n, 3, 3) in m^2 of points (n, 3) for sigma0 = 1; zero for known ones and those left out.

    `joint` holds the covariance of the shared unknowns in the blocks of `target`.
    """
    values = np.zeros((points.shape[0], 3, 3))
    sweep_all(rows, groups, target, model, orientation, COVARIANCES, points, joint=joint, values=values)
    return values


def reliability(
    rows: Rows, groups: Groups, target: NormalBlocks, model: Model, orientation: Array, joint: Array, points: Array
) -> Array:
    """What each row of each observation says of itself (t, 3, 7): whitened residual, its row of H, effect on its point.

    H (3 columns) is the covariance of the adjusted measures in units of their own, 1 minus which is the residuals'; the
    effect (3 columns) is how far, in m, an error of one sigma in the row moves the point. An image ray has two rows, a
    range and a height above the terrain one, a ground prior three (whitened). Rows that don't take part are zero, those
    of points left out or not determined NaN. `joint` as for `point_covariances`.
    """
    values = np.zeros((rows.weight.shape[1], 3, NUMBERS))
    sweep_all(rows, groups, target, model, orientation, RELIABILITY, points, joint=joint, values=values)
    return values


def design(rows: Rows, groups: Groups, target: NormalBlocks, model: Model, orientation: Array, points: Array) -> Array:
    """Whitened rows of observations (t, 3, 4 + c) with points at (n, 3): the residual, its derivatives by the point per
    m, and by the unknowns that the observation depends on per m and rad: six columns of each basis term, then single
    ones.

    With a robust loss each is scaled by the root of its weight. Rows that don't take part, or that an observation
    hasn't, are zero.
    """
    most_columns = ROW_NUMBERS + int((6 * rows.observation_terms + rows.observation_shared).max(initial=0))
    values = np.zeros((rows.weight.shape[1], 3, most_columns))
    sweep_all(rows, groups, target, model, orientation, DESIGN, points, values=values)
    return values


def all_residuals(
    rows: Rows, groups: Groups, target: NormalBlocks, model: Model, orientation: Array, points: Array
) -> Array:
    """Residuals (t, 2) of all observations with points at (n, 3), measured minus predicted, of rows in and out alike.

    An image ray's in pixels, a range's in m and a point's height above the terrain in m, the latter two in the first
    column; NaN for a ray whose point is behind the camera, and where there is no terrain. `rows` need full weights.
    """
    values = np.zeros((rows.weight.shape[1], 2, 1))
    plain = model._replace(loss=NO_LOSS)
    sweep_all(rows, groups, target, plain, orientation, RESIDUALS, points, values=values)
    return values[:, :, 0]


def dense(reduction: Reduction, groups: Groups, target: NormalBlocks, group: int) -> tuple[Array, Array]:
    """Reduced normal matrix (d, d) and gradient (d,) of a group, which the target keeps by itself."""
    assert reduction.blocks is not None
    first, last = groups.member_first[group : group + 2]
    d = int(groups.member_width[first:last].sum())
    block = np.zeros((d, d))
    for rows, columns, at in _blocks(groups, target, group):
        part = block[rows, columns]
        part[:] = reduction.blocks[at : at + part.size].reshape(part.shape)
        block[columns, rows] = part.T
    at = target.right[first] if last > first else 0
    return block, reduction.gradient[at : at + d]


def sparse(block: Array, groups: Groups, target: NormalBlocks, group: int) -> Array:
    """Blocks of the target with the dense matrix (d, d) of one group; zero elsewhere."""
    blocks = np.zeros(target.size)
    for rows, columns, at in _blocks(groups, target, group):
        part = block[rows, columns]
        blocks[at : at + part.size] = part.ravel()
    return blocks


def _blocks(groups: Groups, target: NormalBlocks, group: int) -> Iterator[tuple[slice, slice, int]]:
    """Of the pairs of a group's members: rows and columns in its dense matrix, and where the target has their block."""
    first, last = groups.member_first[group : group + 2]
    ends = np.concatenate([[0], np.cumsum(groups.member_width[first:last])]).tolist()
    parts, start = [slice(a, b) for a, b in pairwise(ends)], int(groups.pair_first[group])
    for i, rows in enumerate(parts):
        for j, columns in enumerate(parts[i:], i):
            yield rows, columns, int(target.pair[start + i * len(parts) + j])
