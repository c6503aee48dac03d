"""Rotations: of a rotation vector, of a quaternion, of omega, phi, kappa; and what small changes of these do.

All matrices are passive: components of a frame to components of the frame that is turned. A rotation vector theta turns
the frame about its axis by its length t, R = Exp([theta]x)' = 1 - sin t / t [theta]x + (1 - cos t) / t^2 [theta]x^2.
The papers' angles are those of R3(kappa) R2(phi) R1(omega), camera to Mars (Yoon & Shan 2005; Shan et al. 2005).
"""

from math import factorial

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import dot

_TWO_OVER_PI = 2.0 / np.pi
_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""pi / 2 in three parts, the first two short enough that products with small whole numbers are exact (Cody & Waite)."""


_SECOND = tuple((-1.0) ** k / factorial(2 * k + 2) for k in range(13, -1, -1))
_THIRD = tuple((-1.0) ** k / factorial(2 * k + 3) for k in range(13, -1, -1))
"""Series of (1 - cos t) / t^2 and (t - sin t) / t^3 in t^2 (Stumpff's functions c2, c3), highest power first."""


@equation
def stumpff(square):
    """(1 - cos t) / t^2 and (t - sin t) / t^3 of t^2: right to 2e-15 up to half a turn, and exact about 0."""
    second, third = 0.0, 0.0
    for coefficient in _SECOND:
        second = coefficient + square * second
    for coefficient in _THIRD:
        third = coefficient + square * third
    return second, third


@equation
def rotation(theta):
    """Exp([theta]x)', rows: components of a frame in those of the same frame turned by theta (Rodrigues)."""
    x, y, z = theta
    second, third = stumpff(dot(theta, theta))
    sine = 1.0 - dot(theta, theta) * third  # sin t / t
    return (
        (1.0 - second * (y * y + z * z), second * x * y + sine * z, second * x * z - sine * y),
        (second * x * y - sine * z, 1.0 - second * (x * x + z * z), second * y * z + sine * x),
        (second * x * z + sine * y, second * y * z - sine * x, 1.0 - second * (x * x + y * y)),
    )


@equation
def right_jacobian(theta):
    """Jr, rows: Exp([theta + d]x) = Exp([theta]x) Exp([Jr d]x) to first order."""
    x, y, z = theta
    second, third = stumpff(dot(theta, theta))
    return (
        (1.0 - third * (y * y + z * z), third * x * y + second * z, third * x * z - second * y),
        (third * x * y - second * z, 1.0 - third * (x * x + z * z), third * y * z + second * x),
        (third * x * z + second * y, third * y * z - second * x, 1.0 - third * (x * x + y * y)),
    )


@equation
def quaternion_matrix(q):
    """Matrix of a unit quaternion, scalar first (NAIF q2m)."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@equation
def sine_cosine(angle):
    """Sine and cosine by arithmetic alone, right to 4e-16: reduced to +-pi/4, then minimax polynomials (fdlibm 5.3)."""
    quarter = np.floor(angle * _TWO_OVER_PI + 0.5)
    r = ((angle - quarter * _HALF_PI[0]) - quarter * _HALF_PI[1]) - quarter * _HALF_PI[2]
    s = r * r
    sine = 2.75573137070700676789e-06 + s * (-2.50507602534068634195e-08 + s * 1.58969099521155010221e-10)
    sine = r + r * s * (
        -1.66666666666666324348e-01 + s * (8.33333333332248946124e-03 + s * (-1.98412698298579493134e-04 + s * sine))
    )
    cosine = -2.75573143513906633035e-07 + s * (2.08757232129817482790e-09 - s * 1.13596475577881948265e-11)
    cosine = 4.16666666666666019037e-02 + s * (
        -1.38888888888741095749e-03 + s * (2.48015872894767294178e-05 + s * cosine)
    )
    cosine = 1.0 - (0.5 * s - s * s * cosine)
    odd = quarter - 2.0 * np.floor(0.5 * quarter)  # 1 where sine and cosine are swapped
    half = np.floor(0.5 * quarter)
    sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))  # -1 in the second half of the turn
    return sign * (sine + odd * (cosine - sine)), sign * (cosine - odd * (cosine + sine))


@equation
def opk_rotation(angles):
    """R3(kappa) R2(phi) R1(omega), rows, passive; its third column is the boresight, camera to body, in the papers."""
    (so, co), (sp, cp), (sk, ck) = sine_cosine(angles[0]), sine_cosine(angles[1]), sine_cosine(angles[2])
    return (
        (cp * ck, co * sk + so * sp * ck, so * sk - co * sp * ck),
        (-cp * sk, co * ck - so * sp * sk, so * ck + co * sp * sk),
        (sp, -so * cp, co * cp),
    )


@equation
def opk_paper_axes(angles):
    """Axes A about which omega, phi, kappa turn the camera where M' = R3 R2 R1 (Yoon & Shan 2005)."""
    (so, co), (sp, cp) = sine_cosine(angles[0]), sine_cosine(angles[1])
    zero = 0.0 * so
    return (zero - 1.0, zero, -sp), (zero, -co, so * cp), (zero, -so, -co * cp)


@equation
def opk_peer_axes(angles):
    """Axes A about which omega, phi, kappa turn the camera where M = R3 R2 R1 (body-fixed to camera)."""
    (sp, cp), (sk, ck) = sine_cosine(angles[1]), sine_cosine(angles[2])
    zero = 0.0 * sp
    return (cp * ck, sk, zero), (-cp * sk, ck, zero), (sp, zero, zero + 1.0)


@equation
def opk_angles(product):
    """omega, phi, kappa of R3(kappa) R2(phi) R1(omega), rows; the way back of `opk_rotation`.

    The arc sine would lose half the digits near +-90 deg, where a camera is whose lines lie across a polar orbit.
    """
    (a, _, _), (b, _, _), (c, d, e) = product
    return np.arctan2(-d, e), np.arctan2(c, np.sqrt(a * a + b * b)), np.arctan2(-b, a)


@equation
def matrix_quaternion(matrix):
    """Unit quaternion, scalar first, of a rotation matrix; the way back of `quaternion_matrix` (Shepperd's method).

    One matrix at a time: which of four ways keeps the digits depends on it.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix
    if a + e + i >= max(a, e, i):
        w, x, y, z = 1.0 + a + e + i, h - f, c - g, d - b
    elif a >= max(e, i):
        w, x, y, z = h - f, 1.0 + a - e - i, b + d, c + g
    elif e >= i:
        w, x, y, z = c - g, b + d, 1.0 + e - a - i, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, 1.0 + i - a - e
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm
