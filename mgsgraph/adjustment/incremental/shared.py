"""Shared unknowns of an incremental adjustment: from a-priori values and from a batch solution, and how far a
coefficient of the orientation moves image points and the ground under the image's middle.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.state import Shared
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import skew
from mgsgraph.network import Network, SharedKind
from mgsgraph.network.definitions import NamedPass, NamedShared, definitions
from mgsgraph.network.joining import seconds
from mgsgraph.network.node_priors import normalised
from mgsgraph.network.parts import KnownImage, Unknown, known_images, pass_unknowns, unknowns
from mgsgraph.network.shared import image_effect

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

_PLACES = 17
"""Times of each image at which the basis between nodes is looked at."""


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


def shared_pass(one: NamedPass, images: Mapping[str, KnownImage], angles: Angles) -> dict[Unknown, Shared]:
    """Orientation images and trend of a pass as they are beforehand.

    Raises InputError where nothing is known of some component: iSAM2 needs something to begin with.
    """
    known = [images[name] for name in one.images]
    edges = np.array([seconds(each.image) for each in known]) - one.nodes.epoch
    sigmas = one.prior.node_sigmas(normalised(one.nodes))
    if not np.all(np.isfinite(sigmas)):
        expected = "finite sigmas, which iSAM2 needs to begin with"
        raise InputError(f"pass {one.name!r}", "orientation images without an a-priori sigma", expected)
    moving, names = _node_motion(one, known, edges), pass_unknowns(one)
    every = dict[Unknown, Shared]()
    for name, time, own in zip(names, one.nodes.times.tolist(), sigmas, strict=False):
        near = int(np.maximum(edges[:, 0] - time, time - edges[:, 1]).argmin())
        ground = ground_motion(known[near], angles)[:, :6]
        if one.axes is not None:
            ground = np.hstack([ground[:, :3], ground[:, 3:] @ one.axes[near]])
        every[name] = Shared(own, moving, ground, np.zeros(6), np.diag(own**2))
    if one.prior.trend_sigmas.size:
        every[names[-1]] = _unmoving(one.prior.trend_sigmas)
    return every


def _node_motion(one: NamedPass, known: Sequence[KnownImage], edges: Array) -> Array:
    """(6,) pixels by which image places move, at most, per m and per rad of all nodes of a pass."""
    times = np.linspace(edges[:, 0], edges[:, 1], _PLACES).ravel()
    weights = np.abs(one.nodes.at(times, one.nodes.epoch)[1]).sum(axis=1)
    lenses = {(each.image.pixel_angle, each.image.interior.focal_length): each for each in known}
    return np.asarray(np.max([image_motion(each)[:6] for each in lenses.values()], axis=0) * weights.max())


def _unmoving(sigmas: Array, motion: Array | None = None, considered: bool = False) -> Shared:
    """An unknown that moves no ground of its own, as it is beforehand."""
    nothing = np.zeros(sigmas.size)
    moving = nothing if motion is None else motion
    return Shared(sigmas, moving, np.zeros((3, sigmas.size)), nothing, np.diag(sigmas**2), considered)


def shared_by_images(one: NamedShared, images: Mapping[str, KnownImage], angles: Angles) -> Shared:
    """An unknown that images share as it is beforehand; its motion is that of the image that it moves most."""
    found = np.zeros(one.kind.width)
    for known in {(i.image.pixel_angle, i.image.lines): i for name in one.images if (i := images[name])}.values():
        motion, image = image_motion(known)[:6], known.image
        if one.kind.moves_pose:
            effect = np.abs(image_effect(image, one.kind, angles)).sum(axis=1)
            found = np.maximum(found, effect @ motion)
        elif one.kind is SharedKind.FOCAL_LENGTH:
            place, _ = image.interior.focal_plane(np.array([0.5, image.samples - 0.5]))
            widest = float(np.linalg.norm(place, axis=1).max())
            found = np.maximum(found, widest / image.interior.focal_length**2 / image.pixel_angle)
        elif one.kind.acts_on_rays:
            found = np.maximum(found, 1.0 / one.sigmas)  # they act linearly: a sigma is thought to be a pixel
    return _unmoving(one.sigmas, found, one.considered)


def shared_of(solution: "Solution") -> dict[Unknown, Shared]:
    """The adjusted unknowns of a batch solution."""
    network, found = solution.network, dict[Unknown, Shared]()
    names, count = unknowns(network), len(network.images)
    for j, (image, prior) in enumerate(zip(network.images, network.priors, strict=True)):
        if network.with_polynomial[j]:
            one = shared_image(KnownImage(image, prior), solution.settings.angles)
            value, covariance = solution.coefficients[j].ravel(), solution.image_covariance(j)
            found[names[j]] = replace(one, value=value, covariance=covariance)
    motion = max((float(one.motion[0]) for one in found.values()), default=1.0)
    for p, name in enumerate(network.shift_names):
        one = shared_shift(network, name, motion)
        found[names[count + p]] = replace(one, value=solution.shifts[p], covariance=solution.shift_covariance(p))
    known, every = definitions(network), {one.image.name: one for one in known_images(network)}
    more = {Unknown("shared", n): shared_by_images(s, every, solution.settings.angles) for n, s in known.shared.items()}
    for of_pass in known.passes.values():
        more |= shared_pass(of_pass, every, solution.settings.angles)
    values = solution.values
    for v, unknown in enumerate(names[network.first_shared :], network.first_shared):
        found[unknown] = replace(more[unknown], value=values[v], covariance=solution.joint_covariance.block(v, v))
    return found
