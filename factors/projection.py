"""Pushbroom projection: one image row pair on (orientation, point). Yoon & Shan 2005, Eq. 1 and 2.

Residual [measured - predicted line, measured - predicted sample] in pixels.
"""

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import PointBehindCamera
from mgsgraph.factors.equations import image_row
from mgsgraph.factors.rows import Model, Rows

Array = NDArray[np.float64]
_OF_A_RAY = ("centre", "matrix", "turning", "detector", "focal", "to_pixels")


def projection_factor(
    orientation_key: int | None,
    point_key: int | Array,
    rows: Rows,
    ray: int,
    model: Model,
    noise: gtsam.noiseModel.Base,
    label: str,
) -> gtsam.CustomFactor:
    """Factor of one image measurement.

    Parameters
    ----------
    orientation_key : int or None
        Variable of the image's coefficients (6 (degree + 1),) in m and rad; None when the image is held.
    point_key : int or (3,)
        Variable of the ground point (Point3, m), or the place of a known one.
    rows, ray
        The measurement's constants.
    model : Model
        Forms of the measurement model; its loss is left to `noise`.
    noise : gtsam.noiseModel.Base
        Two rows in pixels, robust if wanted.
    label : str
        Point and image, for the error message.

    Raises
    ------
    PointBehindCamera
        On linearisation at a point behind the camera; its plain error is infinite there.
    """
    first, last = rows.pair_first[ray], rows.pair_first[ray + 1]
    size = 0 if orientation_key is None else 6 * int(last - first)
    local = rows._replace(
        weight=np.ones_like(rows.weight[ray : ray + 1]),
        **{name: getattr(rows, name)[ray : ray + 1] for name in _OF_A_RAY},
        angles=rows.angles[ray : ray + 1] if rows.angles.size else rows.angles,
        pair_first=np.array([0, last - first]),
        pair_column=6 * np.arange(last - first),
        pair_value=rows.pair_value[first:last],
    )
    keys = [key for key in (orientation_key, point_key) if isinstance(key, int)]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x = np.zeros(0) if orientation_key is None else values.atVector(orientation_key)
        point = values.atPoint3(point_key) if isinstance(point_key, int) else point_key
        residual, by_pose, by_point = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
        carry, front = image_row(local, 0, model, x, point, np.empty((5, 9)), residual, by_pose, by_point)
        if not front:
            if jacobians is not None:
                raise PointBehindCamera(label, "the point is behind the camera")
            return np.full(2, np.inf)
        if jacobians is not None:
            blocks = []
            if size:
                basis = local.pair_value[:, 0] + carry * local.pair_value[:, 1]
                blocks.append(np.einsum("t,ri->rti", basis, by_pose).reshape(2, size))
            if isinstance(point_key, int):
                blocks.append(by_point)
            for k, block in enumerate(blocks):
                jacobians[k] = np.asfortranarray(block)
        return residual

    return gtsam.CustomFactor(noise, keys, error)
