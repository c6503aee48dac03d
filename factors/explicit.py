"""One measurement as a GTSAM factor on the unknowns that it depends on and on its ground point: the explicit form.

What the shared unknowns x do to a measurement is its *state*: correction of the pose (m, rad) and of the focal
length (m), range bias, or shift (m), linear in x: state = sum_t (B_t + o B_t') c_t + sum_e direction_e x_e.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import PointBehindCamera

if TYPE_CHECKING:
    import gtsam

Array = NDArray[np.float64]
Vector = tuple[float, ...]


class Correction(NamedTuple):
    """How the unknowns x (columns,) act on the state of one measurement."""

    width: int
    """Components of the state."""
    components: int
    """Of these, what each basis term moves: 6 (position and rotation), or 3 (position alone)."""
    first: tuple[int, ...]
    """First column of each term's coefficients in x."""
    basis: Vector
    """Basis values B_t."""
    rates: Vector
    """Their derivatives per line."""
    columns: tuple[int, ...]
    """Single columns of x."""
    directions: tuple[Vector, ...]
    """How each of them moves the state."""

    def matrix(self, columns: int, line_offset: float) -> Array:
        """(width, columns) derivative of the state by x, `line_offset` lines from where the basis was evaluated."""
        result, step = np.zeros((self.width, columns)), np.arange(self.components)
        for first, value, rate in zip(self.first, self.basis, self.rates, strict=True):
            result[step, first + step] += value + line_offset * rate
        for column, direction in zip(self.columns, self.directions, strict=True):
            result[:, column] += direction
        return result


class Linear(NamedTuple):
    """Rows of one measurement, not whitened, and their derivatives; r rows."""

    residual: Array
    """(r,)"""
    by_point: Array
    """(r, 3) per m."""
    by_state: Array
    """(r, width)."""
    line_offset: float = 0.0
    """Lines from where the basis was evaluated to the line whose pose was taken."""


StateAt = Callable[[float], tuple[Vector, Vector]]
"""State a number of lines from the reference line, and its rate per line."""
Measurement = Callable[[StateAt, Vector], Linear | None]
"""Rows at a state and a ground point (m, body-fixed); None for a point behind the camera."""


def measurement_factor(
    keys: Sequence[int],
    widths: Sequence[int],
    point_key: int | Array,
    measurement: Measurement,
    correction: Correction,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of one measurement.

    Parameters
    ----------
    keys, widths : sequence of int
        GTSAM keys of the variables that it depends on, in the order of the columns of x, and their numbers of columns.
    point_key : int or (3,)
        Variable of the ground point (Point3, m), or the coordinates of a known one.
    measurement : callable
        Its rows: `collinearity.ImageRay`, `laser_range.Range`, `ground.GroundPrior` or `surface.SurfaceHeight`.
    correction : Correction
    noise : gtsam.noiseModel.Base
        Rows in pixels (image), in m (range, surface), or whitened (ground prior); robust if wanted.
    label : str
        Point and image, for the error message.

    Raises
    ------
    PointBehindCamera
        On linearisation at a point behind the camera; its plain error is infinite there.
    """
    import gtsam  # the equations of `factors` serve those who need no graph, too

    ends = np.cumsum([0, *widths])

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x = np.concatenate([np.zeros(0), *(values.atVector(key) for key in keys)])
        position = values.atPoint3(point_key) if isinstance(point_key, int) else point_key
        rows = measurement(lambda line_offset: _state(correction, x, line_offset), tuple(position.tolist()))
        if rows is None:
            if jacobians is not None:
                raise PointBehindCamera(label, "the point is behind the camera")
            return np.full(noise.dim(), np.inf)
        if jacobians is not None:
            whole = rows.by_state @ correction.matrix(int(ends[-1]), rows.line_offset)
            for k in range(len(keys)):
                jacobians[k] = np.asfortranarray(whole[:, ends[k] : ends[k + 1]])
            if isinstance(point_key, int):
                jacobians[len(keys)] = np.asfortranarray(rows.by_point)
        return rows.residual

    everything = [*keys, point_key] if isinstance(point_key, int) else list(keys)
    return gtsam.CustomFactor(noise, everything, error)


def _state(correction: Correction, x: Array, line_offset: float) -> tuple[Vector, Vector]:
    state = correction.matrix(x.size, line_offset) @ x
    rate = correction.matrix(x.size, line_offset + 1.0) @ x - state
    return tuple(state.tolist()), tuple(rate.tolist())
