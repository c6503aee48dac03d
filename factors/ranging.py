"""Laser range: the distance from where the instrument was at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    r = rho - |P - C| - b - c' (P0 - P)        m, measured minus predicted

C is the instrument's corrected position at the shot's time, b a range bias. The last term is what an error of the
a-priori footprint P0 says of that of the range, where both have one in common (`geometry.altimetry`); else c is zero.
The derivative by P is c minus the unit vector from the instrument to the footprint; by C it is that vector, by b
minus one. What moves P0 by m acts as a bias c'm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.errors import InputError, require
from mgsgraph.factors.algebra import dot, scale, subtract
from mgsgraph.factors.effects import STATE, Effect, orientation_polynomial
from mgsgraph.factors.measurement import Linear, StateAt, Vector, measurement_factor, noise_model, point_names
from mgsgraph.factors.records import Array, PushbroomImage

if TYPE_CHECKING:
    import gtsam


_FARTHEST = 10.0
"""Images from the first line, within which a shot may lie: a time in place of a line is farther."""


@equation
def range_residual(measured, point, centre, bias, shares):
    """Residual in m, and its derivatives (3) by the point and by the centre; `measured` is without c'P0."""
    ray = subtract(point, centre)
    distance = np.sqrt(dot(ray, ray))
    beam = scale(1.0 / distance, ray)
    return measured - distance - bias + dot(shares, point), subtract(shares, beam), beam


@dataclass(frozen=True, slots=True, eq=False)
class Range:
    """One range; called, its row for a GTSAM factor (`measurement.measurement_factor`)."""

    measured: float
    """m, one-way."""
    line: float
    """Of the image, at the shot's time."""
    centre: Array
    """(3,) m, nominal position of the instrument."""
    shares: Vector = (0.0, 0.0, 0.0)
    """m per m, c; `measured` is then without c'P0."""

    def __call__(self, state_at: StateAt, point: Array) -> Linear:
        """Row (m) at a state: its correction of the position, and its range bias."""
        state, _ = state_at(self.line)
        centre = tuple((self.centre + state[:3]).tolist())
        place = tuple(point.tolist())
        value, by_point, by_centre = range_residual(self.measured, place, centre, float(state[9]), self.shares)
        by_state = np.zeros((1, STATE))
        by_state[0, :3], by_state[0, 9] = by_centre, -1.0
        return Linear(np.array([value]), np.array([by_point]), by_state, (self.line,))


def laser_range(
    image_key: int | None,
    point: int | Array,
    image: PushbroomImage,
    line: float,
    measured: float,
    sigma: float,
    degree: int = 2,
    *,
    shared: Sequence[Effect] = (),
    footprint: tuple[Array, Array] | None = None,
    robust: tuple[str, float] | None = None,
    label: str = "",
) -> "gtsam.CustomFactor":
    """Laser range from where an image's camera is at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    Parameters
    ----------
    image_key, point, image, degree, shared, robust, label
        As of `pushbroom_projection`; the image's EO carries the range.
    line : float
        Of that image at the shot's time, `image.timing.lines(times - image.trajectory.epoch)`; before its first or
        after its last one, too.
    measured, sigma : float
        m, one-way.
    footprint : (3,) and (3,), optional
        A-priori position (m) whose errors the range has, too, and by how much of each (m per m); `sigma` is then of
        the rest.

    Returns
    -------
    gtsam.CustomFactor
        One row (m), measured minus predicted.

    Raises
    ------
    InputError
        For a sigma or a range that is not positive; for a line more than ten images away.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L, X
    >>> factor = mgsgraph.factors.laser_range(X(0), L(17), network.images[0], 2500.0, 379872.0, 10.0)
    """
    where = label or ", ".join([*point_names(point), f"range at line {line:g} of image {image.name}"])
    require(measured > 0.0, where, f"{measured:g} m", "a positive number of meters")
    if not abs(line) <= _FARTHEST * image.lines:
        remedy = "image.timing.lines(times - image.trajectory.epoch) gives it"
        raise InputError(where, f"an image of {image.lines} lines", "its line at the shot's time", remedy)
    orientation = [] if image_key is None else [orientation_polynomial(image_key, degree, float(image.lines))]
    prior, shares = np.zeros((2, 3)) if footprint is None else footprint
    row = Range(
        float(measured - prior @ shares), line, image.pose(np.array([line])).position[0], tuple(shares.tolist())
    )
    return measurement_factor([[*orientation, *shared]], point, row, noise_model(sigma, robust, 1, where), where)
