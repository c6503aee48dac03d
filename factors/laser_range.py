"""Laser range: the distance from where the instrument was at the shot to the footprint (Yoon & Shan 2005, Eq. 3).

    r = rho - |P - C| - b                      m, measured minus predicted

C is the instrument's corrected position at the shot's time, b a range bias. The derivative by P is minus the unit
vector from the instrument to the footprint; by C it is plus that, by b minus one.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, dot, scale, subtract
from mgsgraph.factors.explicit import Linear, StateAt, Vector


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
    centre: Vector
    """(3,) m, nominal position of the instrument."""

    def __call__(self, state_at: StateAt, position: Vector) -> Linear:
        """Row (m) at a state: correction of the position (m), and a range bias (m) where there is one."""
        state, _ = state_at(0.0)
        bias = state[3:4]
        value, by_point = range_residual(self.measured, position, add(self.centre, state[:3]), bias[0] if bias else 0.0)
        by_state = np.array([[*scale(-1.0, by_point), *(-1.0 for _ in bias)]])
        return Linear(np.array([value]), np.array([by_point]), by_state)
