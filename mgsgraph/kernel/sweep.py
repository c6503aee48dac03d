"""The kernel: one sweep over points that solves them, and eliminates them, or states their covariances or residuals.

Compiled once and cached on disk; it holds no lock, so that threads share a sweep, each with pieces of its own.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import cached_kernel, threads
from mgsgraph.kernel.covariance import covariance_tile
from mgsgraph.kernel.elimination import eliminate_tile, move_basis
from mgsgraph.kernel.lanes import (
    BASIS,
    BY_POINT,
    BY_STATE,
    COST,
    COUPLED,
    FRONT,
    LANES,
    MOST_SUMS,
    POINT,
    RESIDUAL,
    RESULT,
    ROW,
    STATUS,
    TILE,
    WIDTH,
    blocks_of,
    coupling_of,
    inlined,
    lane,
    registers,
    transposed_of,
)
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.points import solve_tile
from mgsgraph.kernel.reliability import reliability_tile
from mgsgraph.kernel.rows import BEHIND, GROUND, IMAGE, PREDICTED, Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.tile import (
    BEGIN,
    END,
    PIECE_OF,
    fill,
    observation_index,
    observations_of,
    point_of,
    pose_components,
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


@inlined
def store_points(rows, segments, count, w, points, states, costs):
    """Places (n, 3) and states (n,) of a tile; its costs are added to those of its pieces, infinite where a point is
    behind a camera.
    """
    for k in range(count):
        point, cost = point_of(rows, segments, k), 0.0
        for l in range(segments[k, BEGIN], segments[k, END]):
            for j in range(3):
                points[point + l, j] = w[POINT + j * LANES + l]
            states[point + l] = w[STATUS + l]
            cost += np.inf if w[STATUS + l] == BEHIND else w[COST + l]
        costs[segments[k, PIECE_OF]] += cost


@lane
def store_residuals(rows, segments, count, w, depth, values):
    """Residuals (t, 2) of a tile's observations, measured minus predicted: of an image ray in pixels, of a range in m,
    of a surface row its height in m; NaN for a ray whose point is behind the camera.
    """
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        s, kind = TILE + (i - begin) * depth, rows.observation_kind[i]
        for k in range(count):
            at = observation_index(rows, segments, k, i - begin)
            for row in range(2 if kind == IMAGE else 0 if kind == GROUND else 1):
                for l in range(segments[k, BEGIN], segments[k, END]):
                    value = w[s + RESULT + RESIDUAL + row * ROW + l] / rows.weight[row, at + l]
                    if kind == IMAGE and w[s + RESULT + FRONT + l] == 0.0:
                        value = np.nan
                    values[at + l, row] = value


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
    coupling: Array
    """Of the observations to their points."""


def scratch_for(rows: Rows) -> Scratch:
    """Room for a thread."""
    (size, depth), most = workspace(rows), int(np.diff(rows.pattern_observation).max(initial=0))
    pairs = max(2, int(rows.observation_terms.max(initial=0)) ** 2)
    sums = np.zeros(LANES * MOST_SUMS), np.zeros(pairs * LANES), np.zeros((pairs + 1) * MOST_SUMS)
    return Scratch(np.zeros(size), depth, np.zeros((LANES, 5), dtype=np.int64), *sums, np.zeros(most * COUPLED))


@partial(cached_kernel, fastmath={"contract", "nsz"})
def sweep(
    rows,
    groups,
    target,
    model,
    x,
    task,
    first_piece,
    last_piece,
    scratch,
    points,
    states,
    costs,
    blocks,
    gradient,
    values,
):
    """One sweep over the pieces first_piece .. last_piece.

    COSTS, GRADIENT and SYSTEM begin at `points` (n, 3) and leave the best ones there, with states (n,) and the cost
    of each piece in costs (m,); the latter two add the reduced gradient to `gradient`, SYSTEM the normal matrix to
    `blocks`.
    COVARIANCES and RELIABILITY take the covariance of the shared unknowns from `blocks`; `values` are (n, 3, 3)
    covariances, (t, 2, 1) residuals, (t, 3, 7) `reliability.NUMBERS` or (t, 3, c) rows as in `design`.
    """
    w, flat, y = registers(scratch.work), blocks_of(blocks), coupling_of(scratch.coupling)
    buffers = transposed_of(scratch.transposed), transposed_of(scratch.weights), transposed_of(scratch.sums)
    segments, depth = scratch.segments, scratch.depth
    costs[first_piece:last_piece] = 0.0
    piece, first = first_piece, 0
    while piece < last_piece:
        count, piece, first = fill(rows, piece, first, last_piece, segments)
        solve_tile(
            rows, model, segments, count, x, points, task <= SYSTEM, task == RESIDUALS, w, depth, task != COSTS
        )
        if task <= SYSTEM:
            store_points(rows, segments, count, w, points, states, costs)
        if task == GRADIENT or task == SYSTEM:
            tile = rows, groups, target, model, segments, count
            eliminate_tile(*tile, task == SYSTEM, w, depth, y, buffers, flat, gradient)
        elif task == COVARIANCES:
            covariance_tile(rows, groups, target, model, segments, count, blocks, w, depth, y, values)
        elif task == RESIDUALS:
            store_residuals(rows, segments, count, w, depth, values[:, :, 0])
        elif task == RELIABILITY:
            reliability_tile(rows, groups, target, model, segments, count, blocks, w, depth, y, values)
        elif task == DESIGN:
            design_tile(rows, model, segments, count, w, depth, values)


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


def with_frozen_terrain(rows: Rows) -> Rows:
    """The rows with a terrain model that is read-only, as the network's is: the kernel is compiled for that alone."""
    terrain = rows.terrain.view()
    terrain.flags.writeable = False
    return rows._replace(terrain=terrain)


def writable(values: NDArray[Any]) -> NDArray[Any]:
    """The array itself, or a copy of one that is read-only (as what comes over a wire may be), strided or not aligned:
    to the kernel that would be another type, compiled anew.
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
) -> tuple[Array, Array]:
    """A sweep over all pieces, shared by `threads`; blocks and gradient, summed.

    The threads' sums are added in their order, so that the result depends on their number alone (in the last digits).
    """
    count = min(threads(), 1 + int(rows.weight.shape[1] / _WORTHWHILE))
    edges = even_parts(rows, count) if count > 1 else np.array([0, rows.piece.shape[0]])
    whole, with_gradient = task == SYSTEM, task in (GRADIENT, SYSTEM)
    states = np.empty(rows.kind.size, dtype=np.int8) if states is None else states
    costs = np.empty(rows.piece.shape[0]) if costs is None else costs
    values = np.empty((0, 0, 0)) if values is None else values
    none = np.empty(0) if joint is None else writable(joint)
    x, points = writable(x), writable(points)
    rows = with_frozen_terrain(rows)

    def part(k: int) -> tuple[Array, Array]:
        blocks = np.zeros(target.size) if whole else none
        gradient = np.zeros(target.columns) if with_gradient else none
        results = (scratch_for(rows), points, states, costs, blocks, gradient, values)
        sweep(rows, groups, target, model, x, task, edges[k], edges[k + 1], *results)
        return blocks, gradient

    if count == 1:
        return part(0)
    running = _threads(count - 1).map(part, range(1, count))
    blocks, gradient = part(0)
    for more, slope in running:
        if whole:
            blocks += more
        if with_gradient:
            gradient += slope
    return blocks, gradient
