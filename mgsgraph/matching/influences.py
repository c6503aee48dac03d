"""How a window's pixels act on its position in least-squares matching, and the covariances that follow.

Compiled into the kernel of `window`, which says what is estimated.
"""

import math

import numpy as np

from mgsgraph.compiled import compiled
from mgsgraph.matching.equations import (
    BEND,
    MISFIT,
    NARROW,
    NOISE,
    OF_BEND,
    PULL,
    RESIDUAL,
    WEIGHT,
    Reals,
    S,
    T,
    derivatives,
)

_BLOCK = 4
"""pixels along and across a block of pulls: residuals are correlated over fewer, or over more
than a window can tell."""


@compiled
def _solve(a: Reals, b: Reals) -> bool:
    """Solve a x = b for the columns of b, in place, by elimination with row pivots; False where a is singular."""
    n = a.shape[0]
    for k in range(n):
        best = k + int(np.argmax(np.abs(a[k:, k])))
        if not abs(a[best, k]) > 0.0:
            return False
        for m in range(n):
            a[k, m], a[best, m] = a[best, m], a[k, m]
        for m in range(b.shape[1]):
            b[k, m], b[best, m] = b[best, m], b[k, m]
        for i in range(n):
            factor = a[i, k] / a[k, k] if i != k else 0.0
            for m in range(k, n):
                a[i, m] -= factor * a[k, m]
            for m in range(b.shape[1]):
                b[i, m] -= factor * b[k, m]
    for k in range(n):
        b[k] /= a[k, k]
    return True


@compiled
def _influences(pixels: Reals, x: Reals, e: Reals, by: Reals) -> bool:
    """Fill by (unknowns, 4): a pixel's influence on the position is by[:, :2]' w z, on the bend
    by[:, :2]' n z - by[:, 2:]' w z
    with the narrow weights n, scaled to the sum of w. False where the texture does not determine the position.

    The bend leans on the whole window's normal matrix: the middle's own may be singular.
    """
    unknowns = x.size
    z, j = np.empty(unknowns), np.empty(unknowns)
    wide, narrow = np.zeros((unknowns, unknowns)), np.zeros((unknowns, unknowns))
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        for k in range(unknowns):
            for m in range(unknowns):
                wide[m, k] += pixels[i, WEIGHT] * z[k] * j[m]
                narrow[m, k] += pixels[i, NARROW] * z[k] * j[m]
    right = np.zeros((unknowns, 2))
    right[0, 0] = right[1, 1] = 1.0
    if not _solve(wide.copy(), right):
        return False
    by[:, :2], by[:, 2:] = right, 0.0
    for k in range(unknowns):
        for m in range(unknowns):
            by[k, 2] += narrow[k, m] * right[m, 0]
            by[k, 3] += narrow[k, m] * right[m, 1]
    right[:] = by[:, 2:]
    _solve(wide, right)
    by[:, 2:] = right
    return bool(by[0, 0] > 0.0 and by[1, 1] > 0.0 and 4.0 * by[0, 0] * by[1, 1] > (by[0, 1] + by[1, 0]) ** 2)


@compiled
def _sums(pixels: Reals, x: Reals, e: Reals, by: Reals, row: Reals) -> tuple[Reals, Reals, float]:
    """Fill the pulls, the residual and the bend; sums of squared influences on the position and on the bend (2, 2
    each), times the variance of a residual, and by how much sums of squares grow for the unknowns' sake.
    """
    z, j = np.empty(x.size), np.empty(x.size)
    of_place, of_bend, bend = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)
    u, v = np.empty(2), np.empty(2)
    square, weight, weight_square = 0.0, 0.0, 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        residue = pixels[i, T] - x[6] * pixels[i, S] - x[7]
        for k in range(2):
            u[k], v[k] = 0.0, 0.0
            for m in range(x.size):
                u[k] += by[m, k] * z[m]
                v[k] += by[m, 2 + k] * z[m]
            v[k] = pixels[i, NARROW] * u[k] - pixels[i, WEIGHT] * v[k]
            u[k] *= pixels[i, WEIGHT]
        for k in range(2):
            pixels[i, PULL + k] = u[k] * residue
            bend[k] += v[k] * residue
            for m in range(2):
                of_place[k, m] += u[k] * u[m]
                of_bend[k, m] += v[k] * v[m]
        square += pixels[i, WEIGHT] * residue * residue
        weight += pixels[i, WEIGHT]
        weight_square += pixels[i, WEIGHT] * pixels[i, WEIGHT]
    growth = 1.0 / (1.0 - x.size * weight_square / (weight * weight))
    variance = growth * square / weight
    row[RESIDUAL], row[BEND], row[BEND + 1] = math.sqrt(variance), bend[0], bend[1]
    return variance * of_place, variance * of_bend, growth


@compiled
def _misfit(pixels: Reals, x: Reals, e: Reals, row: Reals) -> None:
    """Fill the normal equations (3, 4) of the middle's squared residuals over a constant and squares of derivatives by
    line and sample, c + T00 l l + T01 2 l s + T11 s s; the constant is reduced.

    Derivatives of the two pictures are multiplied with each other: the square of a noisy one is too large.
    """
    z, j = np.empty(x.size), np.empty(x.size)
    squares, own, mean, total = np.empty(3), np.empty(4), np.zeros(4), np.zeros((3, 4))
    sums, weight = np.zeros(3), 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        squares[0], squares[1], squares[2] = z[0] * z[0], 2.0 * z[0] * z[1], z[1] * z[1]
        own[0], own[1], own[2] = z[0] * j[0], z[0] * j[1] + z[1] * j[0], z[1] * j[1]
        own[3] = (pixels[i, T] - x[6] * pixels[i, S] - x[7]) ** 2
        weight += pixels[i, NARROW]
        for m in range(4):
            mean[m] += pixels[i, NARROW] * (own[m] - mean[m]) / weight
        for k in range(3):
            sums[k] += pixels[i, NARROW] * squares[k]
            for m in range(4):
                total[k, m] += pixels[i, NARROW] * squares[k] * own[m]
    for k in range(3):
        for m in range(4):
            row[MISFIT + 4 * k + m] = total[k, m] - sums[k] * mean[m]


@compiled
def _blocks(pixels: Reals, half: tuple[int, int]) -> Reals:
    """Sum of the products (2, 2) of neighbouring pixels' pulls, with Bartlett's weights: over all square blocks, those
    that stand out of the window included, the squared sums of pulls (Newey & West 1987, Conley 1999). Never negative.
    """
    down, across = 2 * half[0] + 1, 2 * half[1] + 1
    total = np.zeros((2, 2))
    for i in range(1 - _BLOCK, down):
        for j in range(1 - _BLOCK, across):
            line, sample = 0.0, 0.0
            for k in range(max(i, 0), min(i + _BLOCK, down)):
                for m in range(max(j, 0), min(j + _BLOCK, across)):
                    line += pixels[k * across + m, PULL]
                    sample += pixels[k * across + m, PULL + 1]
            total[0, 0] += line * line
            total[0, 1] += line * sample
            total[1, 1] += sample * sample
    total[1, 0] = total[0, 1]
    return total / _BLOCK**2


@compiled
def _raise_to(a: Reals, floor: Reals) -> None:
    """Make a (2, 2) no smaller than the floor in any direction."""
    p = math.sqrt(floor[0, 0])
    q = floor[1, 0] / p
    s = math.sqrt(floor[1, 1] - q * q)
    aa = a[0, 0] / (p * p)
    ab = (a[1, 0] / p - q * aa) / s
    bb = (a[1, 1] - 2.0 * q * ab * s - q * q * aa) / (s * s)
    turn = 0.5 * math.atan2(2.0 * ab, aa - bb)
    middle, spread = 0.5 * (aa + bb), math.hypot(0.5 * (aa - bb), ab)
    c, d = math.cos(turn), math.sin(turn)
    for ratio, x, y in ((middle + spread, c, d), (middle - spread, -d, c)):
        if ratio < 1.0:
            line, sample = p * x, q * x + s * y
            a[0, 0] += (1.0 - ratio) * line * line
            a[1, 0] += (1.0 - ratio) * line * sample
            a[1, 1] += (1.0 - ratio) * sample * sample
    a[0, 1] = a[1, 0]


@compiled
def fill_covariance(pixels: Reals, x: Reals, e: Reals, half: tuple[int, int], row: Reals) -> bool:
    """Fill residual, covariance of the noise, bend and its covariance; False where the texture does not determine the
    position.

    The noise's part is the sum of products of the pulls of neighbouring pixels, at least that of white noise. Relief
    that the model does not follow moves the position from the anchor's own to the window's mean. It shows in the bend,
    by how much the position moves when the middle alone counts.
    """
    by = np.empty((x.size, 4))
    if not _influences(pixels, x, e, by):
        return False
    white, of_bend, growth = _sums(pixels, x, e, by, row)
    _misfit(pixels, x, e, row)
    covariance = growth * _blocks(pixels, half)
    if white[0, 0] > 0.0 and white[0, 0] * white[1, 1] > white[0, 1] * white[0, 1]:
        _raise_to(covariance, white)
    for k in range(2):
        for m in range(2):
            row[NOISE + 2 * k + m], row[OF_BEND + 2 * k + m] = covariance[k, m], of_bend[k, m]
    return True
