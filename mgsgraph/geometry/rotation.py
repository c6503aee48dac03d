"""Rotations, vectorised over a leading axis: quaternions, rotation vectors, and the angles omega, phi, kappa.

All matrices are passive: ``b_R_a`` takes components in frame a to components in frame b.
Quaternions have the scalar first and mean the same matrix as in SPICE (NAIF routine ``q2m``).
"""

import numpy as np

from mgsgraph.factors import rotation as equations
from mgsgraph.factors.algebra import transpose
from mgsgraph.geometry.records import Array

_SMALL = 1e-4
"""rad: below this angle a rotation vector is taken from its quaternion's series."""


def components(vector: Array) -> tuple[Array, ...]:
    """Vectors (..., n) as the equations of `factors` take them: a tuple of their components."""
    return tuple(np.moveaxis(vector, -1, 0))


def rows(matrix: Array) -> tuple[tuple[Array, ...], ...]:
    """Matrices (..., 3, 3) likewise: three rows of components."""
    return tuple(components(row) for row in np.moveaxis(matrix, -2, 0))


def stacked(values: tuple[Array, ...]) -> Array:
    """Components as vectors (..., n); the way back."""
    return np.stack(np.broadcast_arrays(*values), axis=-1)


def matrices(values: tuple[tuple[Array, ...], ...]) -> Array:
    """Rows as matrices (..., 3, 3); the way back."""
    return np.stack([stacked(row) for row in values], axis=-2)


def skew(vector: Array) -> Array:
    """Cross-product matrices [v]x of vectors (..., 3), so that ``skew(v) @ w == cross(v, w)``; (..., 3, 3)."""
    matrix = np.zeros((*vector.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(vector, -1, 0)
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def exponential(vector: Array) -> Array:
    """Rotation matrices Exp([v]x) of rotation vectors (..., 3) in rad (Rodrigues' formula); (..., 3, 3)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    whole = 2.0 * np.pi * np.round(angle / (2.0 * np.pi))  # the equation is for half a turn at most
    within = vector * (1.0 - whole / np.where(angle == 0.0, 1.0, angle))
    return matrices(transpose(equations.rotation(components(within))))


def logarithm(matrix: Array) -> Array:
    """Shortest rotation vectors (..., 3) in rad of rotation matrices (..., 3, 3); inverse of `exponential`."""
    quaternion = from_matrix(matrix)
    quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    axis = quaternion[..., 1:]
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    small = sine < _SMALL
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    return np.asarray(np.where(small, 2.0 + sine**2 / 3.0, angle / np.where(small, 1.0, sine)) * axis)


def right_jacobian(vector: Array) -> Array:
    """Jr of rotation vectors (..., 3): Exp(v + d) = Exp(v) Exp(Jr(v) d) to first order; (..., 3, 3)."""
    return matrices(equations.right_jacobian(components(vector)))


def to_matrix(quaternion: Array) -> Array:
    """Matrices (..., 3, 3) of unit quaternions (..., 4), scalar first (NAIF ``q2m``)."""
    return matrices(equations.quaternion_matrix(components(quaternion)))


def from_matrix(matrix: Array) -> Array:
    """Unit quaternions (..., 4), scalar first, of rotation matrices (..., 3, 3) (Shepperd's method)."""
    from mgsgraph.geometry.compiled_pose import quaternions  # compiled: not before it is needed

    result = np.empty((*matrix.shape[:-2], 4))
    quaternions(np.ascontiguousarray(matrix, dtype=np.float64).reshape(-1, 3, 3), result.reshape(-1, 4))
    return result


def continuous(quaternion: Array) -> Array:
    """The same rotations (n, 4) without jumps of sign between neighbours, so that they can be interpolated."""
    signs = np.where(np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0.0, -1.0, 1.0)
    return quaternion * np.cumprod(np.concatenate([[1.0], signs]))[:, None]


def omega_phi_kappa(camera_matrix: Array) -> Array:
    """Angles (..., 3) omega, phi, kappa in rad of body-to-camera matrices M (..., 3, 3).

    The papers' product is camera to Mars: M' = R3(kappa) R2(phi) R1(omega), passive, third column the boresight
    (Shan, Yoon et al. 2005).
    """
    return stacked(equations.opk_angles(transpose(rows(camera_matrix))))


def from_omega_phi_kappa(angles: Array) -> Array:
    """Body-to-camera matrices (..., 3, 3) of angles omega, phi, kappa (..., 3) in rad; inverse of `omega_phi_kappa`."""
    return matrices(transpose(equations.opk_rotation(components(angles))))


def angles_313(matrix: Array) -> Array:
    """Angles (..., 3) a, b, c in rad of matrices (..., 3, 3) M = R3(c) R1(b) R3(a), passive, b from 0 to pi.

    ISIS's angles of a camera (SpiceRotation, SetPolynomial): a is 90 deg more than the optical axis's right ascension,
    b what its declination lacks to 90 deg, c its twist.
    """
    a = np.arctan2(matrix[..., 2, 0], -matrix[..., 2, 1])
    b = np.arctan2(np.hypot(matrix[..., 2, 0], matrix[..., 2, 1]), matrix[..., 2, 2])
    node = np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1)
    along = np.einsum("...ij,...j->...i", matrix, node)
    return np.stack([a, b, np.arctan2(-along[..., 1], along[..., 0])], axis=-1)


def from_angles_313(angles: Array) -> Array:
    """Matrices (..., 3, 3) of angles a, b, c (..., 3) in rad; inverse of `angles_313`."""
    axes = np.zeros((*angles.shape, 3))
    axes[..., 0, 2], axes[..., 1, 0], axes[..., 2, 2] = np.moveaxis(-angles, -1, 0)
    return np.asarray(exponential(axes[..., 2, :]) @ exponential(axes[..., 1, :]) @ exponential(axes[..., 0, :]))


def angle_axes(angles: Array, camera_to_body: bool) -> Array:
    """Axes about which omega, phi, kappa (..., 3) turn the camera: columns of T in d(M d) = [M d]x T da; (..., 3, 3).

    `camera_to_body` True for the papers' product M' = R3 R2 R1 (opk-paper), False for M = R3 R2 R1 (opk-peer).
    """
    parts = components(angles)
    return matrices(equations.opk_paper_axes(parts) if camera_to_body else equations.opk_peer_axes(parts))


def unit_vectors(vectors: Array) -> Array:
    """Vectors (..., k) in any unit, each by its length."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), dtype=np.float64)
