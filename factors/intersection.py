"""Several rays to a point: the point nearest to all of them, least squares of the distances.

    sum_k (I - u_k u_k') (P - C_k) = 0

with C_k the origins and u_k the unit directions. The least eigenvalue of the normal matrix over the number of rays is
the spread of the directions: sin^2 of half the angle between two.
"""

import numpy as np

from mgsgraph.compiled import equation


@equation
def add_ray(normal, right, origin, unit):
    """Normal matrix (upper triangle: xx, xy, xz, yy, yz, zz) and right side with one more ray."""
    x, y, z = unit
    along = x * origin[0] + y * origin[1] + z * origin[2]
    xx, xy, xz, yy, yz, zz = normal
    return (
        (xx + 1.0 - x * x, xy - x * y, xz - x * z, yy + 1.0 - y * y, yz - y * z, zz + 1.0 - z * z),
        (right[0] + origin[0] - along * x, right[1] + origin[1] - along * y, right[2] + origin[2] - along * z),
    )


@equation
def minors(normal):
    """Cofactors (xx, xy, xz, yy, yz, zz) of a symmetric matrix, and its determinant."""
    a, b, c, d, e, f = normal
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    return (xx, xy, xz, a * f - c * c, b * c - a * e, a * d - b * b), a * xx + b * xy + c * xz


@equation
def solve_symmetric(normal, right):
    """Solution of the normal equations, by cofactors."""
    (xx, xy, xz, yy, yz, zz), determinant = minors(normal)
    x, y, z = right
    return (
        (xx * x + xy * y + xz * z) / determinant,
        (xy * x + yy * y + yz * z) / determinant,
        (xz * x + yz * y + zz * z) / determinant,
    )


@equation
def least_eigenvalue(normal, steps):
    """Smallest eigenvalue of a positive semidefinite matrix: Laguerre's method from below on its characteristic
    polynomial. Two steps are right to rounding for rays within 45 degrees, six for any within 80.
    """
    (xx, _, _, yy, _, zz), determinant = minors(normal)
    trace, second, value = normal[0] + normal[3] + normal[5], xx + yy + zz, 0.0 * determinant
    for _ in range(steps):
        slope = second - value * (2.0 * trace - 3.0 * value)
        left = determinant - value * (second - value * (trace - value))
        root = np.sqrt(np.maximum(4.0 * slope * slope - 12.0 * left * (trace - 3.0 * value), 0.0))
        value = value + 3.0 * left / np.maximum(slope + root, 1e-300)
    return value
