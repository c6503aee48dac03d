"""Sigmas in the terms of a flight: of orientation along the lines of an image, and of points along X (flight), Y
(across, to the left) and Z (up).
"""

import numpy as np

from mgsgraph.adjustment.analysis.frames import camera_axes, flight_axes
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.corrections import designs

_LEVEL = 1e-9
"""Share of the velocity below which its level part says nothing."""


def pose_sigmas(
    network: Network, image: int, correction: OrientationCorrection, joint: JointCovariance, lines: Array
) -> Array:
    """Sigmas of the orientation of one image at some lines.

    Parameters
    ----------
    network : Network
        Whose numbering of variables `joint` has.
    image : int
    correction : OrientationCorrection
        Of the image, whole.
    joint : JointCovariance
        Of the shared unknowns, a-priori or of a solution.
    lines : (n,)

    Returns
    -------
    (n, 6)
        m along, across and radial, and rad of roll, pitch and yaw (`analysis.frames`), for sigma0 = 1.
    """
    picture = network.images[image]
    moments, nominal = picture.moments(lines), picture.pose(lines)
    axes, result = correction.axes(nominal, moments), np.empty((lines.size, 6))
    for k, felt in enumerate(designs(network, image, correction, lines)):
        level = flight_axes(nominal.position[k], nominal.velocity[k])
        turn = np.zeros((6, 6))
        turn[:3, :3] = level
        turn[3:, 3:] = camera_axes(nominal.matrix[k] @ level[0]) @ axes[k]
        design = turn @ np.concatenate([np.zeros((6, 0)), *felt.values()], axis=1)
        result[k] = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", design, joint.of(felt), design), 0.0))
    return result


def point_sigmas(covariances: Array, places: Array, velocities: Array) -> Array:
    """(n, 3) m, sigmas of points along X, Y, Z of a flight.

    Parameters
    ----------
    covariances : (n, 3, 3)
        m^2, body-fixed.
    places : (n, 3)
        m, body-fixed: where up is.
    velocities : (n, 3)
        Body-fixed, of any length: of the camera that flies over each (`overhead`).
    """
    axes = flight_axes_at(places, velocities)
    return np.asarray(np.sqrt(np.maximum(np.einsum("nai,nij,naj->na", axes, covariances, axes), 0.0)))


def flight_axes_at(places: Array, velocities: Array) -> Array:
    """(n, 3, 3) rows: unit vectors along, across (left) and up at many places (n, 3), as `frames.flight_axes`."""
    up = places / np.linalg.norm(places, axis=1, keepdims=True)
    along = velocities - up * np.einsum("ni,ni->n", up, velocities)[:, None]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    some = size > _LEVEL * np.linalg.norm(velocities, axis=1, keepdims=True)
    along = np.where(some, along / np.where(some, size, 1.0), np.nan)
    return np.stack([along, np.cross(up, along), up], axis=1)


def overhead(image: PushbroomImage, lines: Array) -> Array:
    """(n, 3) velocities, body-fixed, m per line, of a camera at some lines."""
    return image.pose(lines).velocity
