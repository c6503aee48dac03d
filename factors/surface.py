"""Terrain as control: the height of a point above the terrain model, along the local normal (Ebner et al. 2004)."""

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.factors.equations import surface_row
from mgsgraph.factors.rows import Rows

Array = NDArray[np.float64]


def surface_factor(key: int, rows: Rows, point: int, sigma: float) -> gtsam.CustomFactor:
    """Factor of one point on the terrain: residual its height (m) above the bilinear patch under it.

    The patch is that of `rows.terrain_cell[point]`. Where there is none (off the terrain model, beside missing posts)
    there is no row: residual and Jacobian are zero.
    """

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        by_point = np.zeros(3)
        height, there = surface_row(rows, point, values.atPoint3(key), by_point)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(by_point[None, :] * there)
        return np.array([height])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), [key], error)
