"""The kernel of gridding: a plane through the points around each post, compiled.

Points count by their distance (Gaussian), by their matching sigma, and by how far they lie off the plane of least
absolute residuals (Tukey's weights, so that a single blunder counts for nothing). The height at the post is a sum of
theirs, a'h, so its variance is a' S a with S_ij = s_i s_j r_ij: matching errors of one pair of images are correlated by
what their windows share, r = (1 - |dx| / w) (1 - |dy| / w), and n neighbours are not n measurements.

What scatters about the plane beyond that is relief (or noise that nobody stated). With weights W and the projection
Q = W X (X'WX)^-1 X' W the squares' expectation is E r'Wr = tr(WS) - tr(QS) + relief^2 (tr W - tr Q); `surface` returns
both sides, to be pooled over neighbouring posts.
"""

import math
from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit

from mgsgraph.geometry.records import Array, Index

_Function = TypeVar("_Function", bound=Callable[..., object])

LEAST = 4
"""Points that a plane with scatter takes."""
COLUMNS = 7
"""Of a post: height (m), variance by matching (m^2), sigma by orientation (m), number of points, squares in excess of
what matching explains, what a square metre of relief would make of them (m^-2), sum of the squares of a."""
_FINE, _TUKEY = 2.5, 5.0
"""Sigmas up to which all residuals are nothing to look into; scales of one from which on a point doesn't count."""
_ABSOLUTE, _TUKEYS = 6, 2
"""Rounds that lower the sum of absolute residuals, and rounds with Tukey's weights after them."""
_SAME_PLACE = 0.25
"""posts, within which a point counts as one at the post itself: around it no others are needed."""
_SINGULAR = 1e-6
"""Determinant of the normal matrix over the product of its diagonal, below which points lie on a line."""


def compiled(function: _Function) -> _Function:
    """Compile for use without the interpreter's lock, and keep."""
    return cast(_Function, njit(cache=True, nogil=True, error_model="numpy")(function))


@compiled
def _sort(values: Array, n: int) -> None:
    """By insertion: so few are there, and NumPy's takes long to compile."""
    for i in range(1, n):
        one, j = values[i], i - 1
        while j >= 0 and values[j] > one:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = one


@compiled
def _plane(x: Array, y: Array, h: Array, w: Array, n: int, inverse: Array, plane: Array) -> bool:
    """Weighted least squares: the inverse (3, 3) of the normal matrix, and height and slopes at the origin."""
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    p, q, r = 0.0, 0.0, 0.0
    for i in range(n):
        a += w[i]
        b += w[i] * x[i]
        c += w[i] * y[i]
        d += w[i] * x[i] * x[i]
        e += w[i] * x[i] * y[i]
        f += w[i] * y[i] * y[i]
        p += w[i] * h[i]
        q += w[i] * x[i] * h[i]
        r += w[i] * y[i] * h[i]
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
    determinant = a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
    if not determinant > _SINGULAR * a * d * f:
        return False
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant
        plane[i] = inverse[i, 0] * p + inverse[i, 1] * q + inverse[i, 2] * r
    return True


@compiled
def _robust(
    x: Array, y: Array, h: Array, sigma: Array, base: Array, n: int, w: Array, left: Array, spare: Array,
    inverse: Array, plane: Array,
) -> bool:
    """The plane by weights `base` where all points agree with it, else by these times Tukey's; fills w, 0 for points
    that don't count.
    """
    w[:n] = base[:n]
    if not _plane(x, y, h, w, n, inverse, plane):
        return False
    if _residuals(x, y, h, sigma, n, plane, left) <= _FINE:
        return True
    for _ in range(_ABSOLUTE):  # near and far points alike: a blunder at the post itself has no neighbour's weight
        for i in range(n):
            w[i] = 1.0 / (sigma[i] * max(left[i], sigma[i]))
        if not _plane(x, y, h, w, n, inverse, plane):
            return False
        _residuals(x, y, h, sigma, n, plane, left)
    for _ in range(_TUKEYS):
        spare[:n] = left[:n]
        _sort(spare, n)
        scale = 1.4826 * spare[n // 2]
        for i in range(n):
            w[i] = base[i] * max(1.0 - (left[i] / (_TUKEY * max(scale, sigma[i]))) ** 2, 0.0) ** 2
        if not _plane(x, y, h, w, n, inverse, plane):
            return False
        _residuals(x, y, h, sigma, n, plane, left)
    return True


@compiled
def _residuals(x: Array, y: Array, h: Array, sigma: Array, n: int, plane: Array, left: Array) -> float:
    """Fill `left` with absolute residuals (m); the largest of them in its sigmas."""
    largest = 0.0
    for i in range(n):
        left[i] = abs(h[i] - plane[0] - plane[1] * x[i] - plane[2] * y[i])
        largest = max(largest, left[i] / sigma[i])
    return largest


@compiled
def _surrounded(x: Array, y: Array, kept: Array, n: int, angles: Array) -> bool:
    """Whether the origin is among the points kept: no half-plane about it is without one."""
    count = 0
    for i in range(n):
        if kept[i] > 0.0:
            if x[i] * x[i] + y[i] * y[i] < _SAME_PLACE * _SAME_PLACE:
                return True
            angles[count] = math.atan2(y[i], x[i])
            count += 1
    if count < 3:
        return False
    _sort(angles, count)
    gap = angles[0] + 2.0 * math.pi - angles[count - 1]
    for i in range(1, count):
        gap = max(gap, angles[i] - angles[i - 1])
    return bool(gap < math.pi)


@compiled
def surface(
    first_row: int, last_row: int, columns: int, first: Index, points: Array, spread: Array, orientation: Array,
    pair: Index, reach: float, window: float, found: Array,
) -> None:
    """Fit the posts of some rows.

    Parameters
    ----------
    first_row, last_row : int
        Rows that are fitted, the last one excluded.
    columns : int
        Of the map.
    first : (rows * columns + 1,)
        First of the points of each cell; points are sorted by cell, row after row.
    points : (n, 3)
        Row and column (posts) and height (m) above any level.
    spread : (n, 3)
        posts, posts and m, one sigma of matching along x, y, up.
    orientation : (n, 3, 3)
        Covariance by orientation in the same units.
    pair : (n,)
        Of images.
    reach : float
        posts, up to which points count.
    window : float
        posts, width of a matching window.
    found : (rows, columns, COLUMNS)
        Filled; NaN where there is no height.
    """
    rows = (first.size - 1) // columns
    wide = math.ceil(reach + 0.5)
    most = 1
    for row in range(first_row, last_row):
        for column in range(columns):
            count = 0
            for i in range(max(row - wide, 0), min(row + wide + 1, rows)):
                count += first[i * columns + min(column + wide, columns - 1) + 1]
                count -= first[i * columns + max(column - wide, 0)]
            most = max(most, count)
    x, y, h, w = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    base, left, sigma, share, spare = np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    which = np.empty(most, dtype=np.int64)
    inverse, plane = np.empty((3, 3)), np.empty(3)
    for row in range(first_row, last_row):
        for column in range(columns):
            n = 0
            for i in range(max(row - wide, 0), min(row + wide + 1, rows)):
                begin = first[i * columns + max(column - wide, 0)]
                end = first[i * columns + min(column + wide, columns - 1) + 1]
                for k in range(begin, end):
                    east, north = points[k, 1] - column, row - points[k, 0]
                    square = (east * east + north * north) / (reach * reach)
                    if square <= 1.0:
                        x[n], y[n], h[n], which[n] = east, north, points[k, 2], k
                        sigma[n] = max(abs(spread[k, 2]), 1e-9)
                        base[n] = math.exp(-2.0 * square) / (sigma[n] * sigma[n])
                        n += 1
            if n < LEAST:
                continue
            level = h[0]
            for i in range(n):
                h[i] -= level
            if not _robust(x, y, h, sigma, base, n, w, left, spare, inverse, plane):
                continue
            if not _surrounded(x, y, w, n, spare):
                continue
            kept = 0
            for i in range(n):
                if w[i] == 0.0:
                    continue
                k = which[i]
                x[kept], y[kept], h[kept], w[kept], which[kept] = x[i], y[i], h[i], w[i], k
                kept += 1
            if kept < LEAST:
                continue
            east, north = plane[1], plane[2]  # m per post
            squares, weight, diagonal, sizes, own, turned = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(kept):
                k = which[i]
                share[i] = w[i] * (inverse[0, 0] + inverse[0, 1] * x[i] + inverse[0, 2] * y[i])
                sigma[i] = spread[k, 2] - east * spread[k, 0] - north * spread[k, 1]
                common = orientation[k, 2, 2] - 2.0 * (east * orientation[k, 0, 2] + north * orientation[k, 1, 2])
                common += east * east * orientation[k, 0, 0] + north * north * orientation[k, 1, 1]
                common += 2.0 * east * north * orientation[k, 0, 1]
                turned += share[i] * math.sqrt(max(common, 0.0))
                off = h[i] - plane[0] - plane[1] * x[i] - plane[2] * y[i]
                squares += w[i] * off * off
                weight += w[i]
                own += w[i] * sigma[i] * sigma[i]
                sizes += share[i] * share[i]
            variance, explained = 0.0, 0.0
            for i in range(kept):
                u = inverse[0, 0] + inverse[0, 1] * x[i] + inverse[0, 2] * y[i]
                v = inverse[1, 0] + inverse[1, 1] * x[i] + inverse[1, 2] * y[i]
                t = inverse[2, 0] + inverse[2, 1] * x[i] + inverse[2, 2] * y[i]
                diagonal += w[i] * w[i] * (u + v * x[i] + t * y[i])
                for j in range(i, kept):
                    if pair[which[i]] != pair[which[j]]:
                        continue
                    apart = max(1.0 - abs(x[i] - x[j]) / window, 0.0) * max(1.0 - abs(y[i] - y[j]) / window, 0.0)
                    if i == j:
                        apart = 1.0
                    elif apart == 0.0:
                        continue
                    both = (1.0 if i == j else 2.0) * apart * sigma[i] * sigma[j]
                    variance += both * share[i] * share[j]
                    explained += both * w[i] * w[j] * (u + v * x[j] + t * y[j])
            found[row, column, 0] = plane[0] + level
            found[row, column, 1] = max(variance, 0.0)
            found[row, column, 2] = turned
            found[row, column, 3] = kept
            found[row, column, 4] = squares - (own - explained)
            found[row, column, 5] = weight - diagonal
            found[row, column, 6] = sizes
