"""A point on the surface that two images show, linear about a state (`mgsgraph.geometry.stereo_surface`).

    r = h0 + n'(P - P0) + g                    m, height of the point above the stereo surface along its normal

h0 is the height at P0 with the orientation about which it is linear, n the unit normal, and g what the orientation
corrections of the two images have moved the surface since: minus h0's own share, so that r depends on the present
corrections alone. The derivative by P is n, by g one.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import dot, subtract
from mgsgraph.factors.explicit import Linear, StateAt, Vector


@equation
def stereo_height(height, normal, point, reference, moved):
    """Residual r in m."""
    return height + dot(normal, subtract(point, reference)) + moved


class StereoHeight(NamedTuple):
    """One height above a stereo surface; called, its row for a GTSAM factor (`explicit.measurement_factor`)."""

    reference: Vector
    """(3,) m, P0."""
    normal: Vector
    """(3,) unit, body-fixed."""
    height: float
    """m, h0 less what the corrections there count."""

    def __call__(self, state_at: StateAt, place: Vector) -> Linear:
        """Row (m) at a state: what the corrections of both images add (m)."""
        value = stereo_height(self.height, self.normal, place, self.reference, state_at(0.0)[0][0])
        return Linear(np.array([value]), np.array([self.normal]), np.ones((1, 1)))
