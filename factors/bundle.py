"""Bundle factors: all points seen by the same orientation variables as ONE factor on those variables alone.

The kernel solves each point with the orientation held and eliminates it exactly (Schur complement); GTSAM gets a
rank-revealing square root of the reduced normal matrix and one more row for the cost that remains, so that
``factor.error`` is the full cost. Optimum and posterior are those of the explicit graph (variable projection;
Golub & Pereyra 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.factors import kernels
from mgsgraph.factors.rows import Groups, Model, Rows

Array = NDArray[np.float64]

_ROUNDING = 1e-16
"""Eigenvalues below this share of the largest, times the dimension, are rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """All points solved and eliminated at one orientation."""

    orientation: Array
    """(columns,) orientation vector it was made at."""
    cost: float
    """Half the weighted sum of squares of all point rows; infinite when a point is behind a camera."""
    group_cost: Array
    """(g,) the same by group."""
    blocks: list[Array]
    """Reduced normal matrix (d, d) of each group; empty unless asked for."""
    rights: list[Array]
    """Reduced gradient (d,) of each group."""
    points: Array
    """(n, 3) m, solved places in the layout's order."""
    states: NDArray[np.int64]
    """(n,) kernels.GOOD, BEHIND or WEAK."""


def reduce(rows: Rows, groups: Groups, model: Model, orientation: Array, system: bool = True) -> Reduction:
    """Solve all points for an orientation and, if `system`, eliminate them: one pass of the kernel."""
    chunks, width = groups.chunk.shape[0], int(groups.dimension.max(initial=0))
    points, states = rows.point_start.copy(), np.zeros(rows.point_kind.size, dtype=np.int64)
    costs = np.zeros(chunks)
    blocks = np.empty((chunks, width, width) if system else (chunks, 0, 0))
    rights = np.empty((chunks, width) if system else (chunks, 0))
    kernels.reduce_points(rows, groups, model, orientation, system, points, states, costs, blocks, rights)
    owner = groups.chunk[:, 0]
    group_cost = np.bincount(owner, costs, groups.dimension.size).astype(np.float64)
    block_sum: list[Array] = []
    right_sum: list[Array] = []
    for group, d in enumerate(groups.dimension if system else ()):
        mine = slice(*np.searchsorted(owner, [group, group + 1]))
        upper = np.triu(blocks[mine, :d, :d].sum(axis=0))
        block_sum.append(upper + np.triu(upper, 1).T)
        right_sum.append(rights[mine, :d].sum(axis=0))
    return Reduction(orientation.copy(), float(costs.sum()), group_cost, block_sum, right_sum, points, states)


def square_root(block: Array, right: Array, cost: float, sigmas: Array) -> tuple[Array, Array]:
    """Rows (A, e) with A'A = block, A'e = right and |e|^2 = 2 cost: the reduced system as GTSAM wants it.

    Parameters
    ----------
    block, right : (d, d), (d,)
        Reduced normal matrix and gradient, per m and rad.
    cost : float
        Full cost of the rows behind them.
    sigmas : (d,)
        A-priori sigmas: the decomposition is done in these units, where small eigenvalues mean something.

    Returns
    -------
    jacobian : (d + 1, d)
        Its last row, and rows without information, are zero.
    error : (d + 1,)
    """
    d = right.size
    values, vectors = np.linalg.eigh(block * sigmas[:, None] * sigmas)
    gradient = vectors.T @ (right * sigmas)
    largest = float(values.max(initial=0.0))
    floor = _ROUNDING * d * largest
    # a direction whose curvature drowns in rounding may still have a gradient, which the prior has to balance: it is
    # kept, at the curvature of the rounding, which no prior feels
    kept = (values > floor) | (np.abs(gradient) > _ROUNDING * d * np.sqrt(largest * 2.0 * cost))
    root = np.sqrt(np.where(values > floor, values, floor if floor > 0.0 else 1.0))
    jacobian, error = np.zeros((d + 1, d)), np.zeros(d + 1)
    jacobian[:d] = np.where(kept, root, 0.0)[:, None] * vectors.T / sigmas
    error[:d] = np.where(kept, gradient / root, 0.0)
    error[d] = np.sqrt(max(2.0 * cost - float(error[:d] @ error[:d]), 0.0))
    return jacobian, error


class Bundles:
    """The bundle factors of a network; they share one kernel pass per orientation.

    Parameters
    ----------
    rows, groups, model
        Points and their rows, see `rows`.
    keys : sequence of sequence of int
        GTSAM keys of each group's variables, in the order of its columns.
    columns : sequence of sequence of slice
        Columns of each of these variables in the orientation vector.
    sigmas : (columns,)
        Units of the orientation vector, m and rad.
    """

    def __init__(
        self,
        rows: Rows,
        groups: Groups,
        model: Model,
        keys: Sequence[Sequence[int]],
        columns: Sequence[Sequence[slice]],
        sigmas: Array,
    ) -> None:
        self.rows, self.groups, self.model, self.sigmas = rows, groups, model, sigmas
        self._keys, self._columns = keys, columns
        pairs = (pair for group in zip(keys, columns, strict=True) for pair in zip(*group, strict=True))
        self._of_key = dict(pairs)
        self._last: Reduction | None = None

    def at(self, orientation: Array, system: bool = True) -> Reduction:
        """Reduction at an orientation; the last one is kept, so that the factors of one iteration share it."""
        last = self._last
        if last is None or (system and not last.blocks) or not np.array_equal(last.orientation, orientation):
            self._last = last = reduce(self.rows, self.groups, self.model, orientation, system)
        return last

    def factor(self, group: int) -> gtsam.CustomFactor:
        """The bundle factor of one group on its orientation variables; unit noise, its error is the group's cost."""
        d = int(self.groups.dimension[group])
        own = np.concatenate([np.arange(s.start, s.stop) for s in self._columns[group]])
        edges = np.cumsum([0] + [s.stop - s.start for s in self._columns[group]])

        def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            reduction = self.at(self._orientation(values), system=jacobians is not None)
            if jacobians is None:
                return np.append(np.zeros(d), np.sqrt(2.0 * reduction.group_cost[group]))
            jacobian, residual = square_root(
                reduction.blocks[group], reduction.rights[group], reduction.group_cost[group], self.sigmas[own]
            )
            for k in range(edges.size - 1):
                jacobians[k] = np.asfortranarray(jacobian[:, edges[k] : edges[k + 1]])
            return residual

        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(d + 1), list(self._keys[group]), error)

    def _orientation(self, values: gtsam.Values) -> Array:
        """Orientation vector of GTSAM values; variables that aren't among them keep the last orientation."""
        vector = np.zeros(self.sigmas.size) if self._last is None else self._last.orientation.copy()
        for key, part in self._of_key.items():
            if values.exists(key):
                vector[part] = values.atVector(key)
        return vector
