"""All points solved and eliminated at one orientation, and what the kernel says of them there: covariances, residuals,
reliability, rows (variable projection; Golub & Pereyra 1973).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mgsgraph.kernel.reliability import NUMBERS
from mgsgraph.kernel.rows import NO_LOSS, Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.sweep import COVARIANCES, DESIGN, RELIABILITY, RESIDUALS, ROW_NUMBERS, SYSTEM, sweep_all

Array = NDArray[np.float64]


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
) -> Reduction:
    """Solve all points for an orientation (sweep.COSTS) and eliminate them (GRADIENT, SYSTEM): one pass of the kernel.

    The inner solve begins at `points` (n, 3), where an earlier call ended (with a robust loss, and without them, at
    `rows.start`): that saves steps; the result is the same to the tolerance of that solve.
    """
    points = (rows.start if points is None else points).copy()
    states, costs = np.empty(rows.kind.size, dtype=np.int8), np.empty(rows.piece.shape[0])
    blocks, gradient = sweep_all(rows, groups, target, model, orientation, task, points, states, costs)
    own, cost = blocks if task == SYSTEM else None, float(costs.sum())
    return Reduction(task, orientation.copy(), cost, costs, own, gradient, points, states)


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
        own = block[rows, columns]
        own[:] = reduction.blocks[at : at + own.size].reshape(own.shape)
        block[columns, rows] = own.T
    at = target.right[first] if last > first else 0
    return block, reduction.gradient[at : at + d]


def sparse(block: Array, groups: Groups, target: NormalBlocks, group: int) -> Array:
    """Blocks of the target with the dense matrix (d, d) of one group; zero elsewhere."""
    blocks = np.zeros(target.size)
    for rows, columns, at in _blocks(groups, target, group):
        own = block[rows, columns]
        blocks[at : at + own.size] = own.ravel()
    return blocks


def _blocks(groups: Groups, target: NormalBlocks, group: int) -> Iterator[tuple[slice, slice, int]]:
    """Of the pairs of a group's members: rows and columns in its dense matrix, and where the target has their block."""
    first, last = groups.member_first[group : group + 2]
    ends = np.concatenate([[0], np.cumsum(groups.member_width[first:last])]).tolist()
    parts, start = [slice(a, b) for a, b in pairwise(ends)], int(groups.pair_first[group])
    for i, rows in enumerate(parts):
        for j, columns in enumerate(parts[i:], i):
            yield rows, columns, int(target.pair[start + i * len(parts) + j])
