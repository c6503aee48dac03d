"""A-priori position of a ground point, moved as a whole with its profile (Yoon & Shan 2005, Eq. 4).

    r = U (P - P0 - s),    Q = (U'U)^-1        predicted minus known, whitened

P0 is the a-priori position with covariance Q (m^2), s the shift that its laser profile shares. U is upper triangular,
so the derivative by P is U, by s -U.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.errors import InputError
from mgsgraph.factors.algebra import subtract, transform
from mgsgraph.factors.effects import STATE, Effect
from mgsgraph.factors.measurement import Linear, StateAt, measurement_factor
from mgsgraph.factors.records import Array

if TYPE_CHECKING:
    import gtsam


@equation
def upper_triangle(u):
    """U, rows, of its six numbers 00, 01, 02, 11, 12, 22."""
    zero = 0.0 * u[0]
    return (u[0], u[1], u[2]), (zero, u[3], u[4]), (zero, zero, u[5])


@equation
def ground_residual(root, point, known, shift):
    """Residuals r (3), whitened; `root` is U as rows."""
    return transform(root, subtract(subtract(point, known), shift))


@dataclass(frozen=True, slots=True, eq=False)
class GroundPrior:
    """One a-priori position; called, its rows for a GTSAM factor (`measurement.measurement_factor`)."""

    known: Array
    """(3,) m."""
    root: Array
    """(3, 3) per m, U."""

    def __call__(self, state_at: StateAt, point: Array) -> Linear:
        """Rows (whitened) at a state: the shift (m)."""
        by_state = np.zeros((3, STATE))
        by_state[:, :3] = -self.root
        return Linear(self.root @ (point - self.known - state_at(0.0)[0][:3]), self.root, by_state)


def ground_prior(
    point_key: int, position: Array, covariance: Array, moved: Sequence[Effect] = ()
) -> "gtsam.CustomFactor":
    """A-priori position of a ground point (Yoon & Shan 2005, Eq. 4).

    Parameters
    ----------
    point_key : int
        GTSAM key of a Point3, m, body-fixed.
    position, covariance : (3,), (3, 3)
        m and m^2, body-fixed: a-priori position of the point.
    moved : sequence of Effect
        What moves that position: `effects.profile_shift` of its laser profile, for one.

    Returns
    -------
    gtsam.CustomFactor
        Three whitened rows, present minus a-priori position.

    Raises
    ------
    InputError
        For a covariance that is not positive definite.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L
    >>> prior = mgsgraph.factors.ground_prior(L(17), solution.places[17], np.diag([50.0, 50.0, 10.0]) ** 2)
    """
    import gtsam

    where = f"a-priori position of point {gtsam.DefaultKeyFormatter(point_key)}"
    if np.shape(position) != (3,) or np.shape(covariance) != (3, 3):
        found = f"a position of shape {np.shape(position)}, a covariance of shape {np.shape(covariance)}"
        raise InputError(where, found, "(3,) and (3, 3)")
    try:
        information = np.linalg.solve(covariance, np.eye(3))
        root = np.linalg.cholesky(0.5 * (information + information.T)).T.astype(np.float64)
    except np.linalg.LinAlgError:
        found = f"a covariance with diagonal {np.diag(covariance)} m^2"
        raise InputError(where, found, "a positive definite one") from None
    noise = gtsam.noiseModel.Unit.Create(3)
    return measurement_factor([moved], point_key, GroundPrior(position, root), noise, where)
