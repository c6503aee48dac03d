"""Pose of the camera at a line: the nominal one, carried to that line, and corrected (Yoon & Shan 2005, Eq. 2).

    C = C0 + carry V + dC                               perspective centre, m, body-fixed
    M = Exp([theta]x)' Exp([carry tau]x)' M0            attitude: body-fixed to camera components, +Z out of the lens

C0, M0 are the nominal pose at the line about which a ray is laid out; V (m) and tau (rad, in camera axes) are its rates
per line, `carry` counts lines from there. dC and theta are sums of basis functions times coefficients; clock biases and
boresights enter these sums as basis functions of their own. Rotations are passive: the frame turns by theta, components
turn back. Derivatives of M d go by the axes A: d(M d) = [M d]x A dtheta, where A is the right Jacobian of SO(3).

The papers' own way, coefficients that add to omega, phi, kappa, takes `opk_paper` or `opk_peer` in place of
`about_axes`.
"""

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, product, scale, transform, transpose
from mgsgraph.factors.rotation import (
    opk_paper_axes,
    opk_peer_axes,
    opk_rotation,
    quaternion_matrix,
    right_jacobian,
    rotation,
)


@equation
def perspective_centre(nominal, velocity, carry, correction):
    """C, m, body-fixed."""
    return add(add(nominal, scale(carry, velocity)), correction)


@equation
def about_axes(nominal, turning, carry, theta, rate):
    """Attitude M, axes A, and how the camera turns per line (rad, in its own axes), corrections turning it about its
    axes.

    `nominal` is M0 as a quaternion, `turning` tau, `rate` that of theta per line.
    """
    corrected, axes = rotation(theta), right_jacobian(theta)
    carried = product(rotation(scale(carry, turning)), quaternion_matrix(nominal))
    return product(corrected, carried), axes, add(transform(corrected, turning), transform(axes, rate))


@equation
def opk_paper(nominal, turning, carry, addition, rate):
    """The same for additions to omega, phi, kappa, camera to body; `nominal` are these angles, `turning` rates."""
    angles = add(add(nominal, scale(carry, turning)), addition)
    axes = opk_paper_axes(angles)
    return transpose(opk_rotation(angles)), axes, transform(axes, add(turning, rate))


@equation
def opk_peer(nominal, turning, carry, addition, rate):
    """The same for additions to omega, phi, kappa, body to camera."""
    angles = add(add(nominal, scale(carry, turning)), addition)
    axes = opk_peer_axes(angles)
    return opk_rotation(angles), axes, transform(axes, add(turning, rate))
