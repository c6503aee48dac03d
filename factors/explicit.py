"""The same rows one by one: a GTSAM factor of a single sight on its unknowns and its point. The reference."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import PointBehindCamera
from mgsgraph.factors.lanes import BASIS, BY_POINT, BY_STATE, CARRY, FRONT, LANES, RESIDUAL, STATE_WIDTH
from mgsgraph.factors.pose import pose_components
from mgsgraph.factors.rows import IMAGE, NO_LOSS, Groups, Model, Rows, Target
from mgsgraph.factors.sweep import RESIDUALS, still, sweep
from mgsgraph.factors.tile import row_count, workspace

Array = NDArray[np.float64]

_NOTHING = np.zeros(0)
_NO_GROUPS = Groups(*(np.zeros(0, dtype=np.int64) for _ in Groups._fields))
_NO_TARGET = Target(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), 0, 0)


class Sight:
    """One sight of one point: its residuals and Jacobians, by the kernel.

    Parameters
    ----------
    rows : Rows
        See `rows.one_sight`.
    model : Model
        Forms of the measurement model; its loss is left to the factor's noise.
    """

    def __init__(self, rows: Rows, model: Model) -> None:
        self._rows, self._model = still(rows), model._replace(loss=NO_LOSS)
        self._kind, self._width = int(rows.sight_kind[0]), int(rows.sight_width[0])
        self.count = int(row_count.py_func(self._kind))
        size, self._base, self._depth = workspace(rows)
        self._work = np.zeros(size)

    def at(self, x: Array, place: Array) -> bool:
        """Work the rows out for unknowns (columns,) and a point (3,) in m; whether it is before the camera."""
        scratch = (self._work, self._base, self._depth, _NOTHING)
        results = (place[None].astype(np.float64), np.zeros(1, dtype=np.int8), _NOTHING, _NOTHING, _NOTHING)
        task = (RESIDUALS, 0, 1, *scratch, *results, np.zeros((1, 2, 1)))
        sweep(self._rows, _NO_GROUPS, _NO_TARGET, self._model, x, *task)
        return self._kind != IMAGE or bool(self._registers(FRONT, 1)[0] == 1.0)

    def _registers(self, first: int, count: int) -> Array:
        """The only lane of registers of the sight."""
        begin = self._base + first
        return self._work[begin : begin + count * LANES : LANES]

    @property
    def residual(self) -> Array:
        """(rows,) in pixels, m, or (a ground prior) whitened."""
        return self._registers(RESIDUAL, self.count).copy()

    @property
    def by_point(self) -> Array:
        """(rows, 3) per m."""
        return self._registers(BY_POINT, 3 * self.count).reshape(self.count, 3).copy()

    def by_unknowns(self, columns: int) -> Array:
        """(rows, columns) per m and rad: through the sight's state."""
        rows = self._rows
        terms, shared = int(rows.sight_terms[0]), int(rows.sight_shared[0])
        state = self._registers(BY_STATE, STATE_WIDTH * self.count).reshape(self.count, STATE_WIDTH)[:, : self._width]
        basis = self._registers(BASIS, 2 * terms).reshape(2, terms)
        values = basis[0] + self._registers(CARRY, 1) * basis[1]
        jacobian = np.zeros((self.count, columns))
        components = int(pose_components.py_func(self._width))
        for t in range(terms):
            first = int(rows.entry_column[t])
            jacobian[:, first : first + components] += values[t] * state[:, :components]
        for e in range(shared):
            direction = self._registers(BASIS + (2 * terms + STATE_WIDTH * e) * LANES, self._width)
            jacobian[:, int(rows.entry_column[terms + e])] += state @ direction
        return jacobian


def sight_factor(
    keys: Sequence[int],
    widths: Sequence[int],
    point_key: int | Array,
    rows: Rows,
    model: Model,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of one sight.

    Parameters
    ----------
    keys, widths : sequence of int
        GTSAM keys of the variables that the sight feels, in the order of its columns, and their numbers of columns.
    point_key : int or (3,)
        Variable of the ground point (Point3, m), or the place of a known one.
    rows, model
        The sight, see `rows.one_sight`.
    noise : gtsam.noiseModel.Base
        Two rows in pixels, one in m, or three whitened ones; robust if wanted.
    label : str
        Point and image, for the error message.

    Raises
    ------
    PointBehindCamera
        On linearisation at a point behind the camera; its plain error is infinite there.
    """
    sight, ends = Sight(rows, model), np.cumsum([0, *widths])

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x = np.concatenate([_NOTHING, *(values.atVector(key) for key in keys)])
        place = values.atPoint3(point_key) if isinstance(point_key, int) else point_key
        if not sight.at(x, place):
            if jacobians is not None:
                raise PointBehindCamera(label, "the point is behind the camera")
            return np.full(sight.count, np.inf)
        if jacobians is not None:
            whole = sight.by_unknowns(int(ends[-1]))
            for k in range(len(keys)):
                jacobians[k] = np.asfortranarray(whole[:, ends[k] : ends[k + 1]])
            if isinstance(point_key, int):
                jacobians[len(keys)] = np.asfortranarray(sight.by_point)
        return sight.residual

    everything = [*keys, point_key] if isinstance(point_key, int) else list(keys)
    return gtsam.CustomFactor(noise, everything, error)
