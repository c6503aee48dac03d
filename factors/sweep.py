"""The kernel: one sweep over points that solves them, and eliminates them, or states their covariances or residuals.

Compiled once and cached on disk; it holds no lock, so that threads share a sweep, each with pieces of its own.
"""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit
from numpy.typing import NDArray

from mgsgraph.factors.covariance import covariance_tile
from mgsgraph.factors.design import design_tile
from mgsgraph.factors.elimination import eliminate_tile, most_sums, spread
from mgsgraph.factors.lanes import ACTIVE, COST, FRONT, LANES, PLACE, RESIDUAL, STATE, lane, registers
from mgsgraph.factors.reliability import reliability_tile
from mgsgraph.factors.rows import BEHIND, GROUND, IMAGE, SURFACE, Groups, Model, Rows, Target
from mgsgraph.factors.tile import any_state, load, sights_of, solve_tile, workspace

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COSTS, SYSTEM, COVARIANCES, RESIDUALS, RELIABILITY, DESIGN = 0, 1, 2, 3, 4, 5
"""What a sweep is for: costs of the best places; the reduced system there, too; covariances, or residuals of all rows,
taking part or not, or reliability or design of those that take part, at given places.
"""

_WORTHWHILE = 5000.0
"""Sights below which a second thread costs more than it saves."""


@lane
def store_places(point, n, w, places, states):
    """Places (n, 3) and states (n,) of a tile; its cost, infinite when a point is behind a camera."""
    cost = 0.0
    for l in range(n):
        for j in range(3):
            places[point + l, j] = w[PLACE + j * LANES + l]
        states[point + l] = w[STATE + l]
        cost += w[COST + l]
    return np.inf if any_state(n, w, BEHIND) else cost


@lane
def store_residuals(rows, piece, first, n, w, base, depth, values):
    """Residuals (t, 2) of a tile's sights, measured minus predicted: of an image ray in pixels, of a range in m, of a
    surface row its height in m; NaN for a ray whose point is behind the camera, and where there is no terrain.
    """
    begin, end = sights_of(rows, rows.piece[piece, 0])
    point, count = rows.piece[piece, 1] + first, rows.piece[piece, 2]
    for i in range(begin, end):
        s, at, kind = base + (i - begin) * depth, rows.piece[piece, 4] + (i - begin) * count + first, rows.sight_kind[i]
        for row in range(2 if kind == IMAGE else 0 if kind == GROUND else 1):
            for l in range(n):
                value = w[s + RESIDUAL + row * LANES + l] / rows.weight[row, at + l]
                if kind == IMAGE and w[s + FRONT + l] == 0.0:
                    value = np.nan
                if kind == SURFACE and rows.terrain_cell[point + l, 0] < 0:
                    value = np.nan
                values[at + l, row] = value


def _fingerprint() -> str:
    """Digest of the sources that the kernel is compiled from."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _compiled(sources: str) -> Any:
    """The kernel. Numba's cache looks at one file alone; that the kernel holds the digest of all of them makes it
    forget what was compiled from others.
    """

    @njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
    def sweep(
        rows,
        groups,
        target,
        model,
        x,
        task,
        first_piece,
        last_piece,
        work,
        base,
        depth,
        sums,
        places,
        states,
        costs,
        blocks,
        gradient,
        values,
    ):
        """One sweep over the pieces first_piece .. last_piece.

        COSTS and SYSTEM begin at `places` (n, 3) and leave the best ones there, with states (n,) and the cost of each
        piece in costs (m,); SYSTEM adds the reduced normal matrix to `blocks` and the gradient to `gradient`.
        COVARIANCES and RELIABILITY take the covariance of the shared unknowns from `blocks`; `values` are (n, 3, 3)
        covariances, (t, 2, 1) residuals, (t, 3, 7) `reliability.NUMBERS` or (t, 3, c) rows as in `design`. `work` and
        `sums` are scratch.
        """
        w = registers(work)
        if len(sources) == 0:
            return
        for piece in range(first_piece, last_piece):
            pattern, count, cost = rows.piece[piece, 0], rows.piece[piece, 2], 0.0
            for first in range(0, count, LANES):
                n, point = min(LANES, count - first), rows.piece[piece, 1] + first
                load(rows, model, piece, first, n, w, base, depth)
                for l in range(n if task == RESIDUALS else 0):
                    w[ACTIVE + l] = 1.0
                solve_tile(rows, model, piece, x, first, n, places, task <= SYSTEM, w, base, depth)
                if task <= SYSTEM:
                    cost += store_places(point, n, w, places, states)
                if task == SYSTEM:
                    eliminate_tile(rows, groups, target, pattern, n, w, base, depth, sums, gradient)
                elif task == COVARIANCES:
                    covariance_tile(rows, groups, target, pattern, blocks, point, n, w, base, depth, values)
                elif task == RESIDUALS:
                    store_residuals(rows, piece, first, n, w, base, depth, values[:, :, 0])
                elif task == RELIABILITY:
                    reliability_tile(rows, groups, target, piece, first, blocks, n, w, base, depth, values)
                elif task == DESIGN:
                    design_tile(rows, piece, first, n, w, base, depth, values)
            if task <= SYSTEM:
                costs[piece] = cost
            if task == SYSTEM and (piece + 1 == last_piece or rows.piece[piece + 1, 0] != pattern):
                spread(rows, groups, target, pattern, sums, blocks)

    return sweep


sweep = _compiled(_fingerprint())


def even_parts(rows: Rows, parts: int) -> Index:
    """(p + 1,) pieces at which the work is divided into so many even parts."""
    sights = np.diff(rows.pattern_sight)[rows.piece[:, 0]]
    costs = rows.piece[:, 2] * (sights + 0.25 * sights**2) + 8.0 * sights**2
    work = np.concatenate([[0.0], np.cumsum(costs)])
    edges = np.searchsorted(work, work[-1] * np.arange(1, parts) / parts)
    return np.concatenate([[0], np.maximum.accumulate(edges), [costs.size]]).astype(np.int64)


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="sweep")


def still(rows: Rows) -> Rows:
    """The rows with a terrain model that is read-only, as the network's is: the kernel is compiled for that alone."""
    terrain = rows.terrain.view()
    terrain.flags.writeable = False
    return rows._replace(terrain=terrain)


def own(values: NDArray[Any]) -> NDArray[Any]:
    """The array itself, or a copy of one that is read-only (as what comes over a wire may be), strided or not aligned:
    to the kernel that would be another type, compiled anew.
    """
    return np.require(values, requirements=("C", "A", "W"))


def sweep_all(
    rows: Rows,
    groups: Groups,
    target: Target,
    model: Model,
    x: Array,
    task: int,
    places: Array,
    states: NDArray[np.int8] | None = None,
    costs: Array | None = None,
    joint: Array | None = None,
    values: Array | None = None,
) -> tuple[Array, Array]:
    """A sweep over all pieces, shared by numba's number of threads (NUMBA_NUM_THREADS); blocks and gradient, summed.

    The threads' sums are added in their order, so that the result depends on their number alone (in the last digits).
    """
    count = min(numba.get_num_threads(), 1 + int(rows.weight.shape[1] / _WORTHWHILE))
    edges = even_parts(rows, count) if count > 1 else np.array([0, rows.piece.shape[0]])
    size, base, depth = workspace(rows)
    system = task == SYSTEM
    states = np.empty(rows.kind.size, dtype=np.int8) if states is None else states
    costs = np.empty(rows.piece.shape[0]) if costs is None else costs
    values = np.empty((0, 0, 0)) if values is None else values
    none = np.empty(0) if joint is None else own(joint)
    x, places = own(x), own(places)
    rows = still(rows)

    def part(k: int) -> tuple[Array, Array]:
        blocks, gradient = (np.zeros(target.size), np.zeros(target.columns)) if system else (none, none)
        sums = np.zeros(most_sums(rows) if system else 0)
        scratch = (np.zeros(size), base, depth, sums)
        results = (places, states, costs, blocks, gradient, values)
        sweep(rows, groups, target, model, x, task, edges[k], edges[k + 1], *scratch, *results)
        return blocks, gradient

    if count == 1:
        return part(0)
    running = _threads(count - 1).map(part, range(1, count))
    blocks, gradient = part(0)
    for more, slope in running:
        if system:
            blocks += more
            gradient += slope
    return blocks, gradient
