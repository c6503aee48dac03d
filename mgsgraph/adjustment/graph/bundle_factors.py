"""Bundle factors: all points seen by the same orientation variables as ONE factor on those variables alone.

The kernel solves each point with the orientation held and eliminates it exactly (Schur complement); GTSAM gets a
square root of the reduced normal matrix and one more row for the cost that remains, so that ``factor.error`` is the
full cost. Optimum and posterior are those of the explicit graph (variable projection; Golub & Pereyra 1973).
"""

from collections.abc import Sequence

import gtsam
import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction, dense, reduce
from mgsgraph.kernel.rows import Groups, Model, NormalBlocks, Rows
from mgsgraph.kernel.sweep import COSTS, SYSTEM

_ROUNDING = tuple(10.0**k for k in range(-15, -7))
"""Shares of a system's largest curvature that rounding may have put wrong, and taken below zero: the least one that
makes Cholesky's method go through is added. How much that is depends on how much of the rows the points have taken:
1e-15 to 1e-10."""
_CORNER = 1e200
"""In place of the cost where only the gradient's row of the factor is wanted: no pivot runs out there."""


def square_root(block: Array, right: Array, cost: float, sigmas: Array) -> tuple[Array, Array]:
    """Rows (A, e) with A'A = block, A'e = right and |e|^2 = 2 cost: the reduced system as GTSAM wants it.

    Parameters
    ----------
    block, right : (d, d), (d,)
        Reduced normal matrix and gradient, per m and rad.
    cost : float
        Full cost of the rows behind them.
    sigmas : (d,)
        A-priori sigmas: the decomposition is done in these units, where small pivots mean something.

    Returns
    -------
    jacobian : (d + 1, d)
        Its last row is zero.
    error : (d + 1,)

    Raises
    ------
    RuntimeError
        "Indeterminate linear system", as GTSAM words it, for a block that is not positive semidefinite.
    """
    d, bordered = right.size, np.empty((right.size + 1, right.size + 1))
    bordered[:d, :d], bordered[d, d] = block * sigmas[:, None] * sigmas, _CORNER
    bordered[d, :d] = bordered[:d, d] = right * sigmas
    plain = np.diagonal(bordered)[:d].copy()
    largest = float(plain.max(initial=0.0)) or 1.0
    jacobian, error = np.zeros((d + 1, d)), np.zeros(d + 1)
    # Eigenvalues would tell the rank, but their routine is threaded, and waits for a busy second core (as `product` of
    # adjustment.square_root says). The gradient is kept in directions without curvature, too: the prior balances it.
    for share in _ROUNDING:
        np.fill_diagonal(bordered[:d, :d], plain + share * largest)
        try:
            lower = np.linalg.cholesky(bordered)
        except np.linalg.LinAlgError:
            continue
        jacobian[:d], error[:d] = lower[:d, :d].T / sigmas, lower[d, :d]
        error[d] = np.sqrt(max(2.0 * cost - float(error[:d] @ error[:d]), 0.0))
        return jacobian, error
    raise RuntimeError("Indeterminate linear system: a reduced system that is not positive semidefinite")


class Bundles:
    """The bundle factors of a network; they share one kernel pass per orientation.

    Parameters
    ----------
    rows, groups, target, model
        Points and their rows, see `rows`; the target keeps each group's blocks by themselves.
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
        target: NormalBlocks,
        model: Model,
        keys: Sequence[Sequence[int]],
        columns: Sequence[Sequence[slice]],
        sigmas: Array,
    ) -> None:
        self.rows, self.groups, self.target, self.model, self.sigmas = rows, groups, target, model, sigmas
        self._keys, self._columns = keys, columns
        pairs = (pair for group in zip(keys, columns, strict=True) for pair in zip(*group, strict=True))
        self._of_key = dict(pairs)
        self._last: Reduction | None = None

    def at(self, orientation: Array, task: int = SYSTEM) -> Reduction:
        """Reduction at an orientation; the last one is kept, so that the factors of one iteration share it."""
        last = self._last
        if last is None or not last.serves(orientation, task):
            points = None if last is None or not np.isfinite(last.cost) else last.points
            self._last = last = reduce(self.rows, self.groups, self.target, self.model, orientation, task, points)
        return last

    def group_cost(self, reduction: Reduction) -> Array:
        """(g,) cost of each group's points."""
        group = self.rows.pattern_group[self.rows.piece[:, 0]]
        return np.bincount(group, reduction.piece_cost, len(self._keys)).astype(np.float64)

    def factor(self, group: int) -> gtsam.CustomFactor:
        """The bundle factor of one group on its orientation variables; unit noise, its error is the group's cost."""
        edges = np.cumsum([0] + [s.stop - s.start for s in self._columns[group]])
        own = np.concatenate([np.arange(s.start, s.stop) for s in self._columns[group]])
        d = own.size

        def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            reduction = self.at(self._orientation(values), COSTS if jacobians is None else SYSTEM)
            cost = float(self.group_cost(reduction)[group])
            if jacobians is None:
                return np.append(np.zeros(d), np.sqrt(2.0 * cost))
            jacobian, residual = square_root(*dense(reduction, self.groups, self.target, group), cost, self.sigmas[own])
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
