"""Laser range: the distance from where the instrument was at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    r = rho - |P - C| - b                      m, measured minus predicted

C is the instrument's corrected position at the shot's time, b a range bias. The derivative by P is minus the unit
vector from the instrument to the footprint; by C it is plus that, by b minus one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import dot, scale, subtract
from mgsgraph.factors.explicit import STATE, Array, Effect, Linear, StateAt, measurement_factor, noise_model

if TYPE_CHECKING:
    import gtsam


@equation
def range_residual(measured, point, centre, bias):
    """Residual in m, and its derivative (3) by the point."""
    ray = subtract(point, centre)
    distance = np.sqrt(dot(ray, ray))
    return measured - distance - bias, scale(-1.0 / distance, ray)


class Range(NamedTuple):
    """One range; called, its row for a GTSAM factor (`explicit.measurement_factor`)."""

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
        return Linear(np.array([value]), np.array([by_point]), by_state, self.line)


def laser_range_factor(
    effects: Sequence[Effect],
    point: int | Array,
    centre: Array,
    line: float,
    measured: float,
    sigma: float,
    robust: tuple[str, float] | None,
    label: str,
) -> "gtsam.CustomFactor":
    """Factor of one range from a nominal place (3,) in m, at a line of the image that carries it."""
    return measurement_factor(effects, point, Range(measured, line, centre), noise_model(sigma, robust), label)
