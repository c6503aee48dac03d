"""Terrain as control: the height of a point above the terrain model, along the local normal (Ebner et al. 2004)."""

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.factors.equations import surface_row
from mgsgraph.factors.rows import Rows

Array = NDArray[np.float64]


def surface_factor(key: int, shift_key: int | None, rows: Rows, point: int, sigma: float) -> gtsam.CustomFactor:
    """Factor of one point on the terrain: residual its height (m) above the bilinear patch under it.

    The patch is that of `rows.terrain_cell[point]`, moved by the terrain model's unknown shift (2,) in m, if any.
    Where there is no patch (off the terrain model, beside missing posts) residual and Jacobian are zero.
    """
    local = rows._replace(
        terrain_cell=rows.terrain_cell[point : point + 1],
        surface_column=np.array([-1 if shift_key is None else 0]),
        surface_direction=rows.surface_direction[point : point + 1],
    )

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        shift = np.zeros(0) if shift_key is None else values.atVector(shift_key)
        by_point = np.zeros(3)
        height, there = surface_row(local, 0, shift, values.atPoint3(key), by_point)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(by_point[None, :] * there)
            if shift_key is not None:
                jacobians[1] = np.asfortranarray(-jacobians[0] @ local.surface_direction[0].T)
        return np.array([height])

    keys = [key] if shift_key is None else [key, shift_key]
    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), keys, error)
