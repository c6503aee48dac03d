"""Laser range: the distance from where the instrument was at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    r = rho - |P - C| - b                      m, measured minus predicted

C is the instrument's corrected position at the shot's time, b a range bias. The derivative by P is minus the unit
vector from the instrument to the footprint; by C it is plus that, by b minus one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.errors import InputError
from mgsgraph.factors.algebra import dot, scale, subtract
from mgsgraph.factors.effects import STATE, Effect, orientation_polynomial
from mgsgraph.factors.measurement import Linear, StateAt, measurement_factor, noise_model, point_names
from mgsgraph.factors.records import Array, PushbroomImage

if TYPE_CHECKING:
    import gtsam


@equation
def range_residual(measured, point, centre, bias):
    """Residual in m, and its derivative (3) by the point."""
    ray = subtract(point, centre)
    distance = np.sqrt(dot(ray, ray))
    return measured - distance - bias, scale(-1.0 / distance, ray)


@dataclass(frozen=True, slots=True, eq=False)
class Range:
    """One range; called, its row for a GTSAM factor (`measurement.measurement_factor`)."""

    measured: float
    """m, one-way."""
    line: float
    """Of the image, at the shot's time."""
    centre: Array
    """(3,) m, nominal position of the instrument."""

    def __call__(self, state_at: StateAt, point: Array) -> Linear:
        """Row (m) at a state: its correction of the position, and its range bias."""
        state, _ = state_at(self.line)
        centre = tuple((self.centre + state[:3]).tolist())
        value, by_point = range_residual(self.measured, tuple(point.tolist()), centre, float(state[9]))
        by_state = np.zeros((1, STATE))
        by_state[0, :3], by_state[0, 9] = scale(-1.0, by_point), -1.0
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
    robust: tuple[str, float] | None = None,
    label: str = "",
) -> "gtsam.CustomFactor":
    """Laser range from where an image's camera is at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    Parameters
    ----------
    image_key, point, image, degree, shared, robust, label
        As of `pushbroom_projection`; the image's EO carries the range.
    line : float
        Of that image at the shot's time; before its first or after its last one, too.
    measured, sigma : float
        m, one-way.

    Returns
    -------
    gtsam.CustomFactor
        One row (m), measured minus predicted.

    Raises
    ------
    InputError
        For a sigma or a range that is not positive.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L, X
    >>> factor = mgsgraph.factors.laser_range(X(0), L(17), network.images[0], 2500.0, 379872.0, 10.0)
    """
    where = label or ", ".join([*point_names(point), f"range at line {line:g} of image {image.name}"])
    if not measured > 0.0:
        raise InputError(where, f"{measured:g} m", "a positive number of meters")
    own = [] if image_key is None else [orientation_polynomial(image_key, degree, float(image.lines))]
    row = Range(measured, line, image.pose(np.array([line])).position[0])
    return measurement_factor([[*own, *shared]], point, row, noise_model(sigma, robust, 1, where), where)
