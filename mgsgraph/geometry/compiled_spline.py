"""Cubic splines over a regular grid, read with their derivatives by compiled code (de Boor 1978, chapter X)."""

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.geometry.records import Array

_Four = tuple[float, float, float, float]


@compiled
def cubic(knots: Array, at: float) -> tuple[int, _Four, _Four]:
    """First of the four coefficients that count at a place, which is moved into the spline's range, and by how much
    these and their derivatives do. The knots are those of whole numbers from 0 on, the second and the last but one
    left out.
    """
    last = knots.size - 5
    at = min(at if at > knots[3] else knots[3], knots[last + 1])  # NaN, too
    k = min(max(int(at) + 2, 3), last)
    before, near, here = knots[k + 1] - knots[k - 2], knots[k + 1] - knots[k - 1], knots[k + 1] - knots[k]
    after, beyond = knots[k + 2] - knots[k - 1], knots[k + 2] - knots[k]
    end = knots[k + 3] - knots[k]
    down, up = knots[k + 1] - at, at - knots[k]
    q0 = down * down / (here * near)
    q1 = (at - knots[k - 1]) * down / (here * near) + (knots[k + 2] - at) * up / (here * beyond)
    q2 = up * up / (here * beyond)
    p0, p1, p2 = q0 / before, q1 / after, q2 / end
    values = (
        down * p0,
        (at - knots[k - 2]) * p0 + (knots[k + 2] - at) * p1,
        (at - knots[k - 1]) * p1 + (knots[k + 3] - at) * p2,
        up * p2,
    )
    return k - 3, values, (-3.0 * p0, 3.0 * (p0 - p1), 3.0 * (p1 - p2), 3.0 * p2)


@cached_kernel
def read_splines(
    rows: Array, columns: Array, coefficients: Array, at: Array, values: Array, slopes: Array
) -> None:
    """Fill in values (n, s) of s splines, and derivatives (n, s, 2) by row and column, at places (n, 2); outside they
    are those at the edge.

    Parameters
    ----------
    rows, columns : (r + 4,), (c + 4,)
        Knots.
    coefficients : (s, r, c)
    """
    for i in range(at.shape[0]):
        first, down, down_slope = cubic(rows, at[i, 0])
        left, across, across_slope = cubic(columns, at[i, 1])
        for s in range(coefficients.shape[0]):
            value = by_row = by_column = 0.0
            for j in range(4):
                part = slope = 0.0
                for k in range(4):
                    one = coefficients[s, first + j, left + k]
                    part += across[k] * one
                    slope += across_slope[k] * one
                value += down[j] * part
                by_row += down_slope[j] * part
                by_column += down[j] * slope
            values[i, s], slopes[i, s, 0], slopes[i, s, 1] = value, by_row, by_column
