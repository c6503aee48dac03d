"""One measurement as a GTSAM factor on the unknowns that move its instrument and on its ground point.

What unknowns do to a measurement is its *state*, ten numbers: of the instrument's position (3, m), its attitude
(3, rad), what a pixel looks along (3, m: x, y, focal length), and what a measured distance is too long (1, m). It is
linear in the unknowns, and a function of the image line: state(l) = sum_e E_e(l) x_e (Yoon & Shan 2005, Eq. 2). Each
E_e is an *effect*. What moves a known place, of a laser profile or of a terrain model, takes the first three.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, PointBehindCamera

if TYPE_CHECKING:
    import gtsam

Array = NDArray[np.float64]
STATE = 10
"""Numbers of a state."""
AT_REST = np.zeros(STATE)
Vector = tuple[float, ...]


class Effect(Protocol):
    """What one or several unknowns do to the state of a measurement, along an image."""

    @property
    def keys(self) -> tuple[int, ...]:
        """GTSAM keys of the unknowns, each a Vector."""
        ...

    @property
    def widths(self) -> tuple[int, ...]:
        """Length of each."""
        ...

    def at(self, line: float) -> tuple[Array, Array]:
        """(10, columns of all unknowns) at a line, m or rad per unit, and its derivative per line."""
        ...


class PolynomialEffect(NamedTuple):
    """Coefficients of a polynomial of the normalized line u, from -1 at the first line to 1 at the last."""

    keys: tuple[int, ...]
    """One GTSAM key."""
    coefficients: Array
    """(degree + 1, 10, columns) m or rad per unit of the unknown, of u^0, u^1, ..."""
    lines: float = 2.0
    """Of the image; of no meaning for a constant."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Length of the unknown."""
        return (self.coefficients.shape[2],)

    def at(self, line: float) -> tuple[Array, Array]:
        """(10, columns), and per line."""
        terms, rows, columns = self.coefficients.shape
        u, rate, values, slopes = 2.0 * line / self.lines - 1.0, 2.0 / self.lines, [1.0], [0.0]
        for k in range(1, terms):
            slopes.append(k * rate * values[-1])
            values.append(u * values[-1])
        value, slope = np.array([values, slopes]) @ self.coefficients.reshape(terms, -1)
        return value.reshape(rows, columns), slope.reshape(rows, columns)


def orientation_polynomial(key: int, degree: int, lines: float) -> PolynomialEffect:
    """The polynomial EO correction of one image: 6 (degree + 1) numbers, six of u^0 first: m body-fixed, rad about the
    camera's axes (Yoon & Shan 2005, Eq. 2).
    """
    terms = degree + 1
    coefficients = np.zeros((terms, STATE, 6 * terms))
    coefficients[:, :6] = np.eye(6 * terms).reshape(terms, 6, 6 * terms)
    return PolynomialEffect((key,), coefficients, lines)


def constant(key: int, rows: slice, matrix: Array) -> PolynomialEffect:
    """What doesn't change along an image: a matrix (rows, columns) for some numbers of the state."""
    coefficients = np.zeros((1, STATE, matrix.shape[1]))
    coefficients[0, rows] = matrix
    return PolynomialEffect((key,), coefficients)


class Linear(NamedTuple):
    """Rows of one measurement, not whitened, and their derivatives; r rows."""

    residual: Array
    """(r,)"""
    by_point: Array
    """(r, 3) per m."""
    by_state: Array
    """(r, 10)."""
    line: float = 0.0
    """Whose state was taken."""


StateAt = Callable[[float], tuple[Array, Array]]
"""State at a line, and its rate per line."""
Measurement = Callable[[StateAt, Array], Linear | None]
"""Rows at a state and a ground point (3,) in m, body-fixed; None for a point behind the camera."""


def measurement_factor(
    effects: Sequence[Effect],
    point: int | Array,
    measurement: Measurement,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of one measurement.

    Parameters
    ----------
    effects : sequence of Effect
        What the unknowns do; an unknown may be in several.
    point : int or (3,)
        GTSAM key of the ground point (Point3, m), or the coordinates of a known one.
    measurement : callable
        Its rows: `collinearity.ImageRay`, `laser_range.Range`, `ground.GroundPrior` or `surface.SurfaceHeight`.
    noise : gtsam.noiseModel.Base
        Of the rows; robust if wanted.
    label : str
        Point and image, for the error message.

    Raises
    ------
    PointBehindCamera
        On linearization at a point behind the camera; its plain error is infinite there.
    """
    import gtsam  # the equations of `factors` serve those who need no graph, too

    every = [(key, width) for one in effects for key, width in zip(one.keys, one.widths, strict=True)]
    widths = dict(every)
    keys, ends = list(widths), dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    columns = np.concatenate([np.zeros(0, dtype=int), *(ends[key] + np.arange(width) for key, width in every)])
    total, plain = sum(widths.values()), len(every) == len(widths)

    def matrices(line: float) -> tuple[Array, Array]:
        parts = [one.at(line) for one in effects]
        if len(parts) == 1 and plain:
            return parts[0]
        found = np.zeros((2, STATE, total))
        for k in (0, 1):
            np.add.at(found[k].T, columns, np.hstack([part[k] for part in parts]).T)
        return found[0], found[1]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        place = values.atPoint3(point) if isinstance(point, int) else point
        if not keys:
            rows = measurement(lambda line: (AT_REST, AT_REST), place)
        else:
            x = np.concatenate([values.atVector(key) for key in keys]) if len(keys) > 1 else values.atVector(keys[0])
            rows = measurement(lambda line: _state(matrices(line), x), place)
        if rows is None:
            if jacobians is not None:
                raise PointBehindCamera(label, "the point is behind the camera")
            return np.full(noise.dim(), np.inf)
        if jacobians is not None:
            if keys:
                whole = rows.by_state @ matrices(rows.line)[0]
                for k, key in enumerate(keys):
                    jacobians[k] = np.asfortranarray(whole[:, ends[key] : ends[key] + widths[key]])
            if isinstance(point, int):
                jacobians[len(keys)] = np.asfortranarray(rows.by_point)
        return rows.residual

    return gtsam.CustomFactor(noise, [*keys, point] if isinstance(point, int) else keys, error)


def _state(matrices: tuple[Array, Array], x: Array) -> tuple[Array, Array]:
    return matrices[0] @ x, matrices[1] @ x


def noise_model(
    sigmas: Array | float, robust: tuple[str, float] | None, rows: int, where: str
) -> gtsam.noiseModel.Base:
    """Noise of independent rows with sigmas (r,), or one for all; `robust` is a loss ("huber", "cauchy", "tukey") on
    the norm of the whitened rows and its width in sigmas. Raises InputError, naming `where`, for sigmas that are none.
    """
    import gtsam

    every = np.broadcast_to(np.asarray(sigmas, dtype=np.float64), (rows,)).copy()
    if not (np.all(np.isfinite(every)) and np.all(every > 0.0)):
        raise InputError(where, f"sigma {every.min():g}", "positive numbers")
    diagonal = gtsam.noiseModel.Diagonal.Sigmas(every)
    if robust is None:
        return diagonal
    estimator = getattr(gtsam.noiseModel.mEstimator, robust[0].capitalize())
    return gtsam.noiseModel.Robust.Create(estimator.Create(robust[1]), diagonal)
