"""A ground point known beforehand, moved as a whole with its profile (Yoon & Shan 2005, Eq. 4).

    r = U (P - P0 - s),    Q = (U'U)^-1        predicted minus known, whitened

P0 is the a-priori position with covariance Q (m^2), s the shift that its laser profile shares. U is upper triangular,
so the derivative by P is U, by s -U.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import subtract, transform
from mgsgraph.factors.explicit import Linear, StateAt, Vector


@equation
def upper_triangle(u):
    """U, rows, of its six numbers 00, 01, 02, 11, 12, 22."""
    zero = 0.0 * u[0]
    return (u[0], u[1], u[2]), (zero, u[3], u[4]), (zero, zero, u[5])


@equation
def ground_residual(root, point, known, shift):
    """Residuals r (3), whitened; `root` is U as rows."""
    return transform(root, subtract(subtract(point, known), shift))


class GroundPrior(NamedTuple):
    """One a-priori position; called, its rows for a GTSAM factor (`explicit.measurement_factor`)."""

    known: Vector
    """(3,) m."""
    root: Vector
    """(6,) per m, upper triangle of U."""

    def __call__(self, state_at: StateAt, position: Vector) -> Linear:
        """Rows (whitened) at a state: the shift (m)."""
        root = upper_triangle(self.root)
        residual = ground_residual(root, position, self.known, state_at(0.0)[0])
        return Linear(np.array(residual), np.array(root), -np.array(root))
