"""Sigmas in the terms of a flight: of orientation along the lines of an image, and of points along X (flight), Y
(across, to the left) and Z (up).
"""

import numpy as np

from mgsgraph.adjustment.datum.frames import camera_axes, flight_axes
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles, Moments, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import Network
from mgsgraph.network.corrections import designs
from mgsgraph.network.passes import nominal_poses

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
        m along, across and radial, and rad of roll, pitch and yaw (`datum.frames`), for sigma0 = 1.
    """
    picture = network.images[image]
    moments, nominal = picture.moments(lines), picture.pose(lines)
    turns, result = _turns(nominal, correction.axes(nominal, moments)), np.empty((lines.size, 6))
    for k, felt in enumerate(designs(network, image, correction.angles, lines)):
        design = turns[k] @ np.concatenate([np.zeros((6, 0)), *felt.values()], axis=1)
        result[k] = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", design, joint.of(felt), design), 0.0))
    return result


def strip_turns(network: Network, strip: int, times: Array, angles: Angles) -> Array:
    """(n, 6, 6) from the components of a strip's corrections, m and rad, to along, across and radial, roll, pitch and
    yaw of its flight, at times (n,) in s TDB past J2000.

    Each time is taken from an image of the strip that knows it (`network.passes.nominal_poses`).
    """
    pose = nominal_poses(network.pictures(strip), times)
    axes = OrientationCorrection(np.zeros((1, 6)), angles).axes(pose, Moments.of_times(times, 0.0))
    return _turns(pose, axes)


def _turns(pose: Pose, axes: Array) -> Array:
    """(n, 6, 6) from components of corrections to the axes of the flight; `axes` (n, 3, 3) are how the camera turns
    about its own axes per rad of each rotation component.
    """
    found = np.zeros((axes.shape[0], 6, 6))
    for k, (position, velocity) in enumerate(zip(pose.position, pose.velocity, strict=True)):
        level = flight_axes(position, velocity)
        found[k, :3, :3] = level
        found[k, 3:, 3:] = camera_axes(pose.matrix[k] @ level[0]) @ axes[k]
    return found


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
