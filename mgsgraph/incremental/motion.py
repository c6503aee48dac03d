"""What a coefficient of the orientation does: to image places, and to the ground under the image's middle."""

import math

import numpy as np

from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.network.parts import KnownImage


def image_motion(known: KnownImage) -> Array:
    """(6 (degree + 1),) pixels by which image places move, at most, per m and per rad of each coefficient."""
    image = known.image
    middle = np.array([[0.5 * image.lines, 0.5 * image.samples]])
    per_radian = 1.0 / image.pixel_angle
    ground, _ = image.image_to_ground(*middle.T)
    position = image.pose(middle[:, 0]).position
    distance = float(np.linalg.norm(ground[0] - position[0]))
    if not math.isfinite(distance):  # it looks past the body
        distance = float(np.linalg.norm(position[0])) - image.body.equatorial
    return np.tile(np.repeat([per_radian / distance, per_radian], 3), known.prior.degree + 1)


def ground_motion(known: KnownImage, angles: Angles) -> Array:
    """(3, 6 (degree + 1)) by which the ground under an image's middle (u = 0) moves, m per m and per rad of each
    coefficient, on the ellipsoid; zero where it looks past the body.
    """
    image, terms = known.image, known.prior.degree + 1
    line, sample = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
    origin, direction, _, _ = image.rays(line, sample)
    _, by_origin, by_direction = intersect_ellipsoid(origin, direction, image.body, 0.0)
    pose = image.pose(line)
    turn = OrientationCorrection(np.zeros((terms, 6)), angles).axes(pose, image.moments(line))[0]
    look = pose.matrix[0] @ direction[0]
    # M = Exp([theta]x)' M0: a ray d = M' look turns by M0' (theta x look)
    turned = -pose.matrix[0].T @ _cross(look) @ turn
    jacobian = np.zeros((3, 6 * terms))
    jacobian[:, :3], jacobian[:, 3:6] = by_origin[0], by_direction[0] @ turned
    return jacobian if np.all(np.isfinite(jacobian)) else np.zeros_like(jacobian)


def _cross(vector: Array) -> Array:
    """(3, 3) matrix of the cross product with a vector from the left."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
