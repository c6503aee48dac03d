"""Laser range: one row on (orientation of the simultaneous image, footprint). Yoon & Shan 2005, Eq. 3."""

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.factors.equations import range_row
from mgsgraph.factors.rows import Rows

Array = NDArray[np.float64]


def range_factor(
    orientation_key: int | None, point_key: int | Array, rows: Rows, shot: int, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Factor of one range: residual measured minus predicted, m.

    Parameters
    ----------
    orientation_key : int or None
        Variable of the image's coefficients (6 (degree + 1),) in m and rad; None when the image is held.
    point_key : int or (3,)
        Variable of the footprint (Point3, m), or the place of a known one.
    rows, shot
        The range's constants.
    noise : gtsam.noiseModel.Base
        One row in m, robust if wanted.
    """
    first, last = rows.range_pair_first[shot], rows.range_pair_first[shot + 1]
    size = 0 if orientation_key is None else 6 * int(last - first)
    local = rows._replace(
        range_centre=rows.range_centre[shot : shot + 1],
        range_value=rows.range_value[shot : shot + 1],
        range_weight=np.ones(1),
        range_pair_first=np.array([0, last - first]),
        range_pair_column=6 * np.arange(last - first),
        range_pair_value=rows.range_pair_value[first:last],
    )
    keys = [key for key in (orientation_key, point_key) if isinstance(key, int)]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x = np.zeros(0) if orientation_key is None else values.atVector(orientation_key)
        point = values.atPoint3(point_key) if isinstance(point_key, int) else point_key
        by_point = np.empty(3)
        residual = range_row(local, 0, x, point, by_point)
        if jacobians is not None:
            blocks = []
            if size:
                by_orientation = np.zeros((1, size))
                by_orientation.reshape(-1, 6)[:, :3] = -local.range_pair_value[:, None] * by_point
                blocks.append(by_orientation)
            if isinstance(point_key, int):
                blocks.append(by_point[None, :])
            for k, block in enumerate(blocks):
                jacobians[k] = np.asfortranarray(block)
        return np.array([residual])

    return gtsam.CustomFactor(noise, keys, error)
