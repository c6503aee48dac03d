"""Error ellipses in a plane: what holds a place with a probability of 95 %."""

import numpy as np

from mgsgraph.geometry.records import Array

PROBABILITY = 0.95
_SIGMAS = float(np.sqrt(-2.0 * np.log(1.0 - PROBABILITY)))
"""Semi-axes of such an ellipse in sigmas: chi-square of two degrees of freedom is exponentially distributed."""


def error_ellipses(covariances: Array) -> tuple[Array, Array]:
    """Semi-axes (..., 2), the smaller first, and their directions (..., 2, 2), one in each column, of the ellipses that
    hold places of covariances (..., 2, 2) with that probability; in the unit whose square these are in.
    """
    values, axes = np.linalg.eigh(covariances)
    return _SIGMAS * np.sqrt(np.maximum(values, 0.0)), axes
