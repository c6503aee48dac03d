"""Rotations, vectorised over a leading axis: quaternions, rotation vectors, and the angles omega, phi, kappa.

All matrices are passive: ``b_R_a`` takes components in frame a to components in frame b.
Quaternions have the scalar first and mean the same matrix as in SPICE (NAIF routine ``q2m``).
"""

import numpy as np

from mgsgraph.geometry.records import Array

_SMALL = 1e-4
"""Below this angle (rad) the trigonometric coefficients are taken from their series, exact to the last bit there."""


def skew(vector: Array) -> Array:
    """Cross-product matrices [v]x of vectors (..., 3), so that ``skew(v) @ w == cross(v, w)``; (..., 3, 3)."""
    matrix = np.zeros((*vector.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(vector, -1, 0)
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def _coefficients(angle: Array) -> tuple[Array, Array, Array]:
    """sin(a)/a, (1 - cos a)/a^2 and (a - sin a)/a^3 of angles (...,), in rad."""
    square = angle * angle
    safe = np.where(angle < _SMALL, 1.0, angle)
    near = angle < _SMALL
    sine = np.where(near, 1.0 - square / 6.0, np.sin(safe) / safe)
    half = np.where(near, 0.5 - square / 24.0, 2.0 * np.sin(0.5 * safe) ** 2 / safe**2)
    third = np.where(near, 1.0 / 6.0 - square / 120.0, (safe - np.sin(safe)) / safe**3)
    return sine, half, third


def exponential(vector: Array) -> Array:
    """Rotation matrices Exp([v]x) of rotation vectors (..., 3) in rad (Rodrigues' formula); (..., 3, 3)."""
    sine, half, _ = _coefficients(np.linalg.norm(vector, axis=-1))
    cross = skew(vector)
    return np.eye(3) + sine[..., None, None] * cross + half[..., None, None] * (cross @ cross)


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
    _, half, third = _coefficients(np.linalg.norm(vector, axis=-1))
    cross = skew(vector)
    return np.eye(3) - half[..., None, None] * cross + third[..., None, None] * (cross @ cross)


def to_matrix(quaternion: Array) -> Array:
    """Matrices (..., 3, 3) of unit quaternions (..., 4), scalar first (NAIF ``q2m``)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(matrix: Array) -> Array:
    """Unit quaternions (..., 4), scalar first, of rotation matrices (..., 3, 3) (Shepperd's method)."""
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    squares = np.concatenate([trace[..., None], diagonal], axis=-1)
    best = np.argmax(squares, axis=-1)
    gram = np.empty((*matrix.shape[:-2], 4, 4))  # 4 q q', of which the row with the largest diagonal is safe to use
    gram[..., 0, 0] = 1.0 + trace
    for i in range(3):
        gram[..., i + 1, i + 1] = 1.0 + 2.0 * diagonal[..., i] - trace
    for i, (j, k) in enumerate([(1, 2), (2, 0), (0, 1)]):
        gram[..., 0, i + 1] = gram[..., i + 1, 0] = matrix[..., k, j] - matrix[..., j, k]
        gram[..., j + 1, k + 1] = gram[..., k + 1, j + 1] = matrix[..., j, k] + matrix[..., k, j]
    row = np.take_along_axis(gram, best[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(row / np.linalg.norm(row, axis=-1, keepdims=True))


def omega_phi_kappa(camera_matrix: Array) -> Array:
    """Angles (..., 3) omega, phi, kappa in rad of body-to-camera matrices M (..., 3, 3).

    The papers' product is camera to Mars: M' = R3(kappa) R2(phi) R1(omega), passive, third column the boresight
    (Shan, Yoon et al. 2005; design.md section 5).
    """
    product = np.swapaxes(camera_matrix, -1, -2)
    # the arc sine would lose half the digits near +-90 deg, where a camera is whose lines lie across a polar orbit
    phi = np.arctan2(product[..., 2, 0], np.hypot(product[..., 0, 0], product[..., 1, 0]))
    omega = np.arctan2(-product[..., 2, 1], product[..., 2, 2])
    kappa = np.arctan2(-product[..., 1, 0], product[..., 0, 0])
    return np.stack([omega, phi, kappa], axis=-1)


def from_omega_phi_kappa(angles: Array) -> Array:
    """Body-to-camera matrices (..., 3, 3) of angles omega, phi, kappa (..., 3) in rad; inverse of `omega_phi_kappa`."""
    (so, sp, sk), (co, cp, ck) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        [cp * ck, co * sk + so * sp * ck, so * sk - co * sp * ck],
        [-cp * sk, co * ck - so * sp * sk, so * ck + co * sp * sk],
        [sp, -so * cp, co * cp],
    ]
    product = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.swapaxes(product, -1, -2)


def angle_axes(angles: Array, camera_to_body: bool) -> Array:
    """Axes about which omega, phi, kappa (..., 3) turn the camera: columns of T in d(M d) = [M d]x T da; (..., 3, 3).

    `camera_to_body` True for the papers' product M' = R3 R2 R1, False for the peer's M = R3 R2 R1.
    """
    (so, sp, sk), (co, cp, ck) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    zero, one = np.zeros_like(so), np.ones_like(so)
    if camera_to_body:
        rows = [[-one, zero, -sp], [zero, -co, so * cp], [zero, -so, -co * cp]]
    else:
        rows = [[cp * ck, sk, zero], [-cp * sk, ck, zero], [sp, zero, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
