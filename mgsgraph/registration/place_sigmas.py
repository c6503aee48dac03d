"""How well an adjusted orientation knows where the image of a ground point lies: the law of error propagation.

Turning the camera by w about its own axes moves the image of a point P like moving P by M' (r x w), where r = M (P - C)
is its ray in the camera; moving the camera by dC, like moving P by -dC. So everything follows from the derivative of
the image place by the ground point, at the basis values of the line where the point is seen.
"""

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array


def place_jacobian(image: PushbroomImage, points: Array, correction: OrientationCorrection) -> tuple[Array, Array]:
    """Image places of ground points, and how they follow the orientation coefficients.

    Parameters
    ----------
    image : PushbroomImage
        With its nominal orientation.
    points : (n, 3)
        m, body-fixed.
    correction : OrientationCorrection
        Of the nominal orientation; m coefficients (6-vectors).

    Returns
    -------
    places : (n, 2)
        line and sample; NaN where unseen.
    jacobian : (n, 2, 6 m)
        pixels per m and per rad, in the order of `coefficients.ravel()`.
    """
    places, by_point = image.ground_to_image(points, correction)
    lines = np.nan_to_num(places[:, 0])  # the Jacobian of an unseen point is NaN by `by_point`
    moments = image.moments(lines)
    pose = image.pose(lines, correction)
    ray = np.einsum("nij,nj->ni", pose.matrix, points - pose.position)
    turned = np.swapaxes(pose.matrix, 1, 2) @ rotation.skew(ray) @ correction.axes(image.pose(lines), moments)
    moved = np.concatenate([np.broadcast_to(-np.eye(3), turned.shape), turned], axis=2)
    jacobian = np.einsum("nk,nij->nikj", correction.basis(moments), by_point @ moved)
    return places, jacobian.reshape(points.shape[0], 2, -1)


def propagated(jacobian: Array, covariance: Array) -> Array:
    """Standard deviations (n, 2) of n functions' two components by Jacobian (n, 2, c) and covariance (c, c)."""
    return np.asarray(np.sqrt(np.einsum("nic,cd,nid->ni", jacobian, covariance, jacobian)))
