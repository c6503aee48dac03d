"""One measurement as a GTSAM factor on the unknowns that move its instrument and on its ground point.

The unknowns act through the *state* of the instrument, and each through its *effect*: `factors.effects`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.errors import InputError, PointBehindCamera
from mgsgraph.factors.effects import STATE, Effect
from mgsgraph.factors.records import Array

if TYPE_CHECKING:
    import gtsam

AT_REST = np.zeros(STATE)
LOSSES = ("huber", "cauchy", "tukey")
_KEPT = 4
"""Lines: the measured one, the predicted one, and those of the step before."""
Vector = tuple[float, ...]


class Linear(NamedTuple):
    """Rows of one measurement, not whitened, and their derivatives; r rows, one state of each of its instruments."""

    residual: Array
    """(r,)"""
    by_point: Array
    """(r, 3) per m."""
    by_state: Array
    """(r, 13) of one instrument, (r, 26) of two."""
    lines: tuple[float, ...] = (0.0,)
    """Whose states were taken."""


StateAt = Callable[[float], tuple[Array, Array]]
"""State at a line, and its rate per line."""
Measurement = Callable[..., Linear | None]
"""Rows at a state of each instrument and a ground point (3,) in m, body-fixed; None for a point that isn't seen."""


class _Instrument:
    """What all unknowns of a factor do to the state of one of its instruments."""

    def __init__(self, effects: Sequence[Effect], first: dict[int, int], total: int) -> None:
        unknowns = [(key, width) for effect in effects for key, width in zip(effect.keys, effect.widths, strict=True)]
        self._effects, self._total = effects, total
        self._columns = np.concatenate(
            [np.zeros(0, dtype=int), *(first[key] + np.arange(width) for key, width in unknowns)]
        )
        self._whole = len(effects) == 1 and np.array_equal(self._columns, np.arange(total))
        self._kept: dict[float, tuple[Array, Array]] = {}

    def matrices(self, line: float) -> tuple[Array, Array]:
        """(13, columns) at a line, and per line; those of the last few lines are kept."""
        if line not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            self._kept[line] = self._matrices(line)
        return self._kept[line]

    def _matrices(self, line: float) -> tuple[Array, Array]:
        parts = [effect.at(line) for effect in self._effects]
        if self._whole:
            return parts[0]
        matrices = np.zeros((2, STATE, self._total))
        for k in (0, 1) if parts else ():
            np.add.at(matrices[k].T, self._columns, np.hstack([part[k] for part in parts]).T)
        return matrices[0], matrices[1]

    def states(self, x: Array) -> StateAt:
        """State as a function of the line, at unknowns (columns,)."""
        if not self._effects:
            return lambda line: (AT_REST, AT_REST)

        def at(line: float) -> tuple[Array, Array]:
            value, rate = self.matrices(line)
            return value @ x, rate @ x

        return at


def measurement_factor(
    effects: Sequence[Sequence[Effect]],
    point: int | Array,
    measurement: Measurement,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of one measurement.

    Parameters
    ----------
    effects : sequence of sequences of Effect
        What the unknowns do to each instrument that takes part; an unknown may be in several.
    point : int or (3,)
        GTSAM key of the ground point (Point3, m), or the coordinates of a known one.
    measurement : callable
        Its rows: `projection.ImageRay`, `ranging.Range`, `ground.GroundPrior`, `surface.SurfaceHeight` or
        `stereo_surface.StereoHeight`.
    noise : gtsam.noiseModel.Base
        Of the rows; robust if wanted.
    label : str
        Point and image, for the error message.

    Raises
    ------
    InputError
        When the point's key is that of another unknown.
    PointBehindCamera
        On linearization at a point that an image doesn't see; its plain error is infinite there.
    """
    import gtsam  # the equations of `factors` serve those who need no graph, too

    widths = {
        key: width for some in effects for effect in some for key, width in zip(effect.keys, effect.widths, strict=True)
    }
    keys, ends = list(widths), np.cumsum([0, *widths.values()]).tolist()
    columns = [slice(*edges) for edges in pairwise(ends)]
    point = _key_or_position(point, label)
    if isinstance(point, int) and point in widths:
        raise InputError(label, f"key {gtsam_name(point)} of an unknown and of the point", "a key of its own for each")
    instruments = [_Instrument(some, dict(zip(keys, ends, strict=False)), ends[-1]) for some in effects]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        place = values.atPoint3(point) if isinstance(point, int) else point
        x = np.concatenate([np.zeros(0), *(values.atVector(key) for key in keys)])
        if x.size != ends[-1]:
            raise _of_other_length(label, widths, values)
        rows = measurement(*(item.states(x) for item in instruments), place)
        if rows is None:
            if jacobians is not None:
                found = "the image doesn't see the point: behind the camera, or far outside"
                raise PointBehindCamera(label, found if np.all(np.isfinite(place)) else f"a point at {place} m")
            return np.full(noise.dim(), np.inf)
        if jacobians is not None:
            if keys:
                parts = zip(np.split(rows.by_state, len(instruments), axis=1), instruments, rows.lines, strict=True)
                derivatives = np.asarray(sum(by_state @ item.matrices(line)[0] for by_state, item, line in parts))
                for k, part in enumerate(columns):
                    jacobians[k] = np.asfortranarray(derivatives[:, part])
            if isinstance(point, int):
                jacobians[len(keys)] = np.asfortranarray(rows.by_point)
        return rows.residual

    return gtsam.CustomFactor(noise, [*keys, point] if isinstance(point, int) else keys, error)


def _key_or_position(point: int | Array, label: str) -> int | Array:
    """A key, of NumPy, too; or a position (3,)."""
    if np.ndim(point) == 0 and isinstance(point, int | np.integer):
        return int(point)
    if np.shape(point) != (3,):
        raise InputError(label, f"point: {point}", "a GTSAM key, or a position (3,) in m")
    return np.asarray(point, dtype=np.float64)


def _of_other_length(label: str, widths: dict[int, int], values: gtsam.Values) -> InputError:
    key = next(key for key, width in widths.items() if values.atVector(key).size != width)
    name, size = gtsam_name(key), values.atVector(key).size
    return InputError(label, f"{size} numbers of variable {name}", f"{widths[key]}", "check the degree")


def gtsam_name(key: int) -> str:
    """What GTSAM calls a key."""
    import gtsam

    return str(gtsam.DefaultKeyFormatter(key))


def point_names(point: int | Array) -> list[str]:
    """What messages call a point that has a key; nothing of a known one."""
    return [f"point {gtsam_name(int(point))}"] if isinstance(point, int | np.integer) else []


def noise_model(
    sigmas: Array | float, robust: tuple[str, float] | None, rows: int, where: str
) -> gtsam.noiseModel.Base:
    """Noise of independent rows with sigmas (r,), or one for all; `robust` is a loss ("huber", "cauchy", "tukey") on
    the norm of the whitened rows and its width in sigmas. Raises InputError, naming `where`, for sigmas that are none.
    """
    import gtsam

    given = np.asarray(sigmas, dtype=np.float64)
    if given.shape not in ((), (rows,)):
        raise InputError(where, f"{given.size} sigmas", f"one or {rows}")
    all_sigmas = np.broadcast_to(given, (rows,)).copy()
    if not (np.all(np.isfinite(all_sigmas)) and np.all(all_sigmas > 0.0)):
        raise InputError(where, f"sigma {all_sigmas.min():g}", "positive numbers")
    diagonal = gtsam.noiseModel.Diagonal.Sigmas(all_sigmas)
    if robust is None:
        return diagonal
    if not (isinstance(robust, tuple) and len(robust) == 2 and robust[0] in LOSSES and robust[1] > 0.0):
        raise InputError(where, f"robust: {robust!r}", f"None, or one of {', '.join(LOSSES)} with its width in sigmas")
    estimator = getattr(gtsam.noiseModel.mEstimator, robust[0].capitalize())
    return gtsam.noiseModel.Robust.Create(estimator.Create(robust[1]), diagonal)
