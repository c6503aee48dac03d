"""Shared unknowns of an incremental adjustment: from a-priori values and from a batch solution, and how far a
coefficient of the orientation moves image points and the ground under the image's middle.
"""

import math
from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import skew
from mgsgraph.incremental.state import Shared
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage, Unknown, unknowns


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
    turned = -pose.matrix[0].T @ skew(look) @ turn
    jacobian = np.zeros((3, 6 * terms))
    jacobian[:, :3], jacobian[:, 3:6] = by_origin[0], by_direction[0] @ turned
    return jacobian if np.all(np.isfinite(jacobian)) else np.zeros_like(jacobian)


def shared_image(known: KnownImage, angles: Angles) -> Shared:
    """The orientation of an image as it is before anything is observed in it."""
    prior = known.prior.sigmas.ravel()
    return Shared(prior, image_motion(known), ground_motion(known, angles), np.zeros(prior.size), np.diag(prior**2))


def shared_shift(network: Network, name: str, motion: float) -> Shared:
    """A horizontal shift of a network, eastward and northward, as it is beforehand; `motion` is pixels per m."""
    sigma, considered = network.shift_sigma(name), name in network.considered
    unmoved = np.full(2, sigma), np.full(2, motion), np.zeros((3, 2)), np.zeros(2), np.eye(2) * sigma**2
    return Shared(*unmoved, considered)


def shared_of(solution: Solution) -> dict[Unknown, Shared]:
    """The adjusted unknowns of a batch solution."""
    network, found = solution.network, dict[Unknown, Shared]()
    names, count = unknowns(network), len(network.images)
    for j, (image, prior) in enumerate(zip(network.images, network.priors, strict=True)):
        if not network.held[j]:
            one = shared_image(KnownImage(image, prior), solution.settings.angles)
            value, covariance = solution.coefficients[j].ravel(), solution.image_covariance(j)
            found[names[j]] = replace(one, value=value, covariance=covariance)
    motion = max((float(one.motion[0]) for one in found.values()), default=1.0)
    for p, name in enumerate(network.shift_names):
        one = shared_shift(network, name, motion)
        found[names[count + p]] = replace(one, value=solution.shifts[p], covariance=solution.shift_covariance(p))
    return found
