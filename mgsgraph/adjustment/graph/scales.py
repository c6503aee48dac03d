"""What takes misplacements in the focal plane to residual lines and samples, and rates of added angles."""

import numpy as np

from mgsgraph.factors.algebra import transform
from mgsgraph.factors.collinearity import image_motion, ray_motion, to_lines_and_samples
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.rows import OPK_PAPER


def angle_rates(pose: Pose, angles: int) -> Array:
    """(k, 3) rates per line of omega, phi, kappa in the product M' = R3 R2 R1 (papers) or M = R3 R2 R1."""
    paper = angles == OPK_PAPER
    found = rotation.omega_phi_kappa(pose.matrix if paper else np.swapaxes(pose.matrix, 1, 2))
    chain = rotation.angle_axes(found, camera_to_body=paper)
    return np.asarray(np.linalg.solve(chain, pose.angular_rate[:, :, None])[:, :, 0])


def peer_scale(slope: Array) -> Array:
    """(k, 4) focal-plane m to residuals as opk-peer has them: pixels of the detector's size along and across it."""
    square = slope[:, 0] ** 2 + slope[:, 1] ** 2
    return np.stack([slope[:, 1], -slope[:, 0], -slope[:, 0], -slope[:, 1]], axis=1) / square[:, None]


def frozen_scale(pose: Pose, focal_length: float, points: Array, slope: Array) -> Array:
    """(k, 2, 2) focal-plane m to residual lines and samples: image motion per line, from the nominal, and detector
    slope.
    """
    attitude, angular_rate = tuple(np.moveaxis(pose.matrix, 0, -1)), tuple(pose.angular_rate.T)
    ray = transform(attitude, tuple((points - pose.position).T))
    of_ray = ray_motion(attitude, ray, tuple(pose.velocity.T), angular_rate)
    motion = image_motion(ray, of_ray, focal_length)
    return np.stack([np.stack(row, axis=1) for row in to_lines_and_samples(motion, tuple(slope.T))], axis=1)
