"""Pose of the camera at a line: the nominal one, moved to that line, and corrected (Yoon & Shan 2005, Eq. 2).

    C = C0 + o V + dC                               perspective centre, m, body-fixed
    M = Exp([theta]x)' Exp([o tau]x)' M0            attitude: body-fixed to camera components, +Z out of the lens

C0, M0 are the nominal pose at the reference line; V (m) and tau (rad, in camera axes) are its rates
per line, `line_offset` counts lines from there. dC and theta are sums of basis functions times coefficients; clock
biases and boresights enter these sums as basis functions of their own. Rotations are passive: the frame turns by theta,
components turn back. Derivatives of M d go by the axes A: d(M d) = [M d]x A dtheta, where A is the right Jacobian of
SO(3).

The papers' own way, coefficients that add to omega, phi, kappa, takes `opk_paper` or `opk_peer` in place of
`about_axes`.
"""

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, product, scale, transform, transpose
from mgsgraph.factors.rotation import (
    opk_angles,
    opk_paper_axes,
    opk_peer_axes,
    opk_rotation,
    quaternion_matrix,
    right_jacobian,
    rotation,
)


@equation
def perspective_centre(nominal, velocity, line_offset, correction):
    """C, m, body-fixed."""
    return add(add(nominal, scale(line_offset, velocity)), correction)


@equation
def about_axes(nominal, angular_rate, line_offset, theta, rate):
    """Attitude M, axes A, and how the camera turns per line (rad, in its own axes), corrections turning it about its
    axes.

    `nominal` is M0 as a quaternion, `angular_rate` tau, `rate` that of theta per line.
    """
    corrected, axes = rotation(theta), right_jacobian(theta)
    at_line = product(rotation(scale(line_offset, angular_rate)), quaternion_matrix(nominal))
    return product(corrected, at_line), axes, add(transform(corrected, angular_rate), transform(axes, rate))


@equation
def turned_about_axes(matrix, angular_rate, theta, rate):
    """The same of a nominal attitude M0 (rows) at its own line."""
    corrected, axes = rotation(theta), right_jacobian(theta)
    return product(corrected, matrix), axes, add(transform(corrected, angular_rate), transform(axes, rate))


@equation
def opk_paper(nominal, angular_rate, line_offset, addition, rate):
    """The same for additions to omega, phi, kappa, camera to body; `nominal` are these angles, `angular_rate` rates."""
    angles = add(add(nominal, scale(line_offset, angular_rate)), addition)
    axes = opk_paper_axes(angles)
    return transpose(opk_rotation(angles)), axes, transform(axes, add(angular_rate, rate))


@equation
def opk_peer(nominal, angular_rate, line_offset, addition, rate):
    """The same for additions to omega, phi, kappa, body to camera."""
    angles = add(add(nominal, scale(line_offset, angular_rate)), addition)
    axes = opk_peer_axes(angles)
    return opk_rotation(angles), axes, transform(axes, add(angular_rate, rate))


def opk_paper_from(matrix, angular_rate, addition, rate):
    """`opk_paper` of a nominal attitude M0 (rows) at its own line; for Python alone."""
    angles = opk_angles(transpose(matrix))
    return opk_paper(angles, _rates(opk_paper_axes(angles), angular_rate), 0.0, addition, rate)


def opk_peer_from(matrix, angular_rate, addition, rate):
    """The same of `opk_peer`."""
    angles = opk_angles(matrix)
    return opk_peer(angles, _rates(opk_peer_axes(angles), angular_rate), 0.0, addition, rate)


def _rates(axes, angular_rate):
    """Rates of the angles at which the camera turns by `angular_rate`."""
    return tuple(np.linalg.solve(np.array(axes), np.array(angular_rate)).tolist())


ATTITUDES = {"camera": turned_about_axes, "opk-paper": opk_paper_from, "opk-peer": opk_peer_from}
"""What the rotation part of corrections is, by name."""
