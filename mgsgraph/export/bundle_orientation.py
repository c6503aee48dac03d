"""Orientation of an image in jigsaw's words: polynomials of time of X, Y, Z and of the angles RA, DEC, TWIST.

jigsaw solves for the coefficients of such polynomials; here they are fitted to the orientation before and after at the
papers' 31 lines, and the sigmas of the coefficients follow from the joint covariance by error propagation. Names:
DOI-USGS/ISIS3, IsisBundleObservation.cpp (parameterList, bundleOutputString).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import prior_sigmas
from mgsgraph.analysis.statistics import PLACES
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import in_turn
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import Network, PolynomialPrior
from mgsgraph.network.corrections import designs

PARAMETERS = ("X", "Y", "Z", "RA", "DEC", "TWIST")
"""jigsaw's names: position, and angles about the axes 3, 1, 3 (`rotation.angles_313`). Its RA is 90 deg more than the
right ascension of the optical axis, its DEC what the declination lacks to 90 deg (docs/real_networks.md)."""
_USUAL_DEGREE = 2
"""jigsaw's CKDEGREE and SPKDEGREE, for images without polynomials of their own."""
_NOTHING = 1e-9
"""Of the largest: what counts less in a coefficient is rounding."""


class OrientationPolynomials(NamedTuple):
    """One image: coefficients of (t - centre)^k for each of PARAMETERS; m and rad, per s^k."""

    inertial: bool
    """Whether axes are inertial (J2000); else body-fixed, where the trajectory doesn't know the body's rotation."""
    before: Array
    """(6, d + 1) of the nominal orientation."""
    correction: Array
    """(6, d + 1) adjusted minus nominal."""
    prior: Array
    """(6, d + 1) a-priori sigmas by the prior of the image, or of its pass: infinite where nothing is known, NaN where
    it has none."""
    sigma: Array
    """(6, d + 1) of the adjusted ones, for sigma0 = 1; zero of a held image that shares nothing."""


def common_degree(solution: Solution) -> int:
    """Highest degree of the polynomials of images and passes; jigsaw's usual 2 where none has any."""
    network = solution.network
    degrees = [network.priors[j].degree for j in np.flatnonzero(network.with_polynomial).tolist()]
    for one in network.passes:
        if isinstance(one.prior, PolynomialPrior):
            degrees.append(max(len(one.prior.attitude_sigmas), len(one.prior.position_sigmas)) - 1)
    return max(degrees, default=_USUAL_DEGREE)


def orientation_polynomials(solution: Solution, image: str | int, degree: int) -> OrientationPolynomials:
    """Polynomials of one image's orientation about its centre, the middle between its first and its last line."""
    image = solution.network.image_number(image)
    picture, correction = solution.network.images[image], solution.correction(image)
    lines = np.linspace(0.0, float(picture.lines), PLACES)
    moments = picture.moments(lines)
    before, after = picture.pose(lines), picture.pose(lines, correction)
    centre, half = 0.5 * (moments.times[0] + moments.times[-1]), 0.5 * (moments.times[-1] - moments.times[0])
    fit = np.linalg.pinv(np.vander((moments.times - centre) / half, degree + 1, increasing=True))
    fit /= half ** np.arange(degree + 1)[:, None]
    turn = correction.axes(before, moments)
    trajectory = picture.trajectory
    inertial = isinstance(trajectory, Trajectory)
    outward = np.broadcast_to(np.eye(3), (PLACES, 3, 3))
    if isinstance(trajectory, Trajectory):
        outward = np.swapaxes(trajectory.body.at(moments.times)[0], 1, 2)
    position = [np.einsum("nij,nj->ni", outward, pose.position) for pose in (before, after)]
    matrix = [pose.matrix @ np.swapaxes(outward, 1, 2) for pose in (before, after)]
    angles = [rotation.angles_313(one) for one in matrix]
    values = np.hstack([position[0], np.unwrap(angles[0], axis=0)])
    moved = np.hstack([position[1] - position[0], in_turn(angles[1] - angles[0])])
    to_angles = np.linalg.solve(_axes(matrix[1], angles[1]), turn)
    prior, sigma = _sigmas(solution, image, lines, (outward, np.asarray(to_angles, dtype=np.float64)), fit)
    return OrientationPolynomials(inertial, (fit @ values).T, (fit @ moved).T, prior, sigma)


def _axes(matrix: Array, angles: Array) -> Array:
    """(n, 3, 3) about which axes of its own the camera turns per rad of each of the three angles, in columns."""
    sine, cosine, zero = np.sin(angles[:, 2]), np.cos(angles[:, 2]), np.zeros(angles.shape[0])
    node = np.stack([cosine, -sine, zero], axis=1)
    return np.stack([matrix[:, :, 2], node, np.broadcast_to([0.0, 0.0, 1.0], node.shape)], axis=2)


def _sigmas(
    solution: Solution, image: int, lines: Array, turned: Sequence[Array], fit: Array
) -> tuple[Array, Array]:
    """A-priori and adjusted sigmas (6, d + 1) of the coefficients."""
    network, width = solution.network, solution.joint_covariance.square_root.width
    effects = designs(network, image, solution.correction(image).angles, lines)
    variables = sorted({variable for part in effects for variable in part})
    first = dict(zip(variables, np.cumsum([0, *(int(width[v]) for v in variables)]).tolist(), strict=False))
    design = np.zeros((lines.size, 6, sum(int(width[v]) for v in variables)))
    for part, row in zip(effects, design, strict=True):
        for variable, matrix in part.items():
            row[:, first[variable] : first[variable] + matrix.shape[1]] = matrix
    halves = [np.einsum("nij,njw->niw", turned[k], design[:, 3 * k : 3 * k + 3]) for k in range(2)]
    rows = np.einsum("kn,ncw->ckw", fit, np.concatenate(halves, axis=1))
    shape, rows = rows.shape[:2], rows.reshape(-1, design.shape[2])
    variance = np.einsum("rw,rw->r", rows @ solution.joint_covariance.of(variables), rows)
    prior = np.full(rows.shape[0], np.nan)
    if network.with_polynomial[image]:
        own = rows[:, first[image] : first[image] + int(width[image])]
        own = np.where(np.abs(own) > _NOTHING * np.abs(own).max(axis=1, keepdims=True), own, 0.0)
        counts, sigmas = own != 0.0, np.broadcast_to(network.priors[image].sigmas.ravel(), own.shape)
        prior = np.sqrt(np.sum(np.where(counts, own, 0.0) ** 2 * np.where(counts, sigmas, 0.0) ** 2, axis=1))
    elif network.pass_of[image] >= 0:
        owner, turn = int(network.pass_of[image]), network.axes_of(image)
        prior = _pass_sigmas(network, owner, lines, image, turned, fit, np.eye(3) if turn is None else turn)
    return prior.reshape(shape), np.sqrt(np.maximum(variance, 0.0)).reshape(shape)


def _pass_sigmas(
    network: Network, owner: int, lines: Array, image: int, turned: Sequence[Array], fit: Array, axes: Array
) -> Array:
    """(6 (d + 1),) a-priori sigmas of an image's coefficients by what is known of its pass's nodes and trend."""
    one, moments = network.passes[owner], network.images[image].moments(lines)
    basis, _ = one.nodes.dense(moments.times, moments.epoch)
    halves = [np.einsum("nij,nk->nikj", part, basis) for part in (turned[0], turned[1] @ axes)]
    design = np.zeros((lines.size, 6, basis.shape[1], 6))
    design[:, :3, :, :3], design[:, 3:, :, 3:] = halves
    rows = np.einsum("kn,nc...->ck...", fit, design).reshape(6 * fit.shape[0], -1)
    return prior_sigmas(one, rows)
