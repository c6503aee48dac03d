"""The kernel of gridding: a plane through the points around each post, compiled.

Points count by their distance (Gaussian), by their matching sigma, and by how far they lie off the plane of least
absolute residuals (Tukey's weights, so that a single blunder counts for nothing). The height at the post is a sum of
theirs, a'h, so its variance is a' S a with S_ij = s_i s_j r_ij: matching errors of pairs that have images in common are
correlated by what their windows share, r = (1 - |dx| / w) (1 - |dy| / w), and n neighbours are not n measurements.

What scatters about the plane beyond that is relief (or unstated noise). With weights W and the projection
Q = W X (X'WX)^-1 X' W the squares' expectation is E r'Wr = tr(WS) - tr(QS) + relief^2 (tr W - tr Q); `surface` returns
both sides, to be pooled over neighbouring posts.
"""

import math
from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.geometry.records import Array, Index

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
_LEAST_SIGMA = 1e-9
"""m, of a point by matching, at least, so that its weight is a number."""


class _Given(NamedTuple):
    """Input of `surface` about the points."""

    columns: int
    first: Index
    points: Array
    spread: Array
    orientation: Array
    pair: Index
    reach: float
    window: float


class _Near(NamedTuple):
    """Points near a post, and work arrays; each is large enough for any post."""

    x: Array
    """posts eastward from the post."""
    y: Array
    """posts northward."""
    h: Array
    """m above any level."""
    sigma: Array
    """m, of the height by matching; of that at a fixed position with its sign, when the plane's slopes are known."""
    base: Array
    """Weight by distance and sigma."""
    w: Array
    """That weight, where the point agrees with the others; 0 where it doesn't count."""
    left: Array
    """m, absolute residual."""
    share: Array
    """In the height at the post: a."""
    spare: Array
    """For whatever has to be sorted."""
    which: Index
    """Number among all points."""
    inverse: Array
    """(3, 3) of the plane's normal matrix."""
    plane: Array
    """(3,) height at the post (m), slopes (m per post)."""


@compiled
def _sort(values: Array, n: int) -> None:
    """Insertion sort: there are few values, and NumPy's sort takes long to compile."""
    for i in range(1, n):
        value, j = values[i], i - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value


@compiled
def _cells(given: _Given, row: int, column: int) -> tuple[int, int, int, int]:
    """First row and the one past the last, first and last column, of the cells that may hold points for a post."""
    wide = math.ceil(given.reach + 0.5)
    rows = (given.first.size - 1) // given.columns
    return (
        max(row - wide, 0), min(row + wide + 1, rows), max(column - wide, 0), min(column + wide, given.columns - 1)
    )  # fmt: skip


@compiled
def _most(given: _Given, first_row: int, last_row: int) -> int:
    """Points at most in the cells about a post of these rows."""
    most = 1
    for row in range(first_row, last_row):
        for column in range(given.columns):
            begin, end, west, east = _cells(given, row, column)
            count = 0
            for i in range(begin, end):
                count += given.first[i * given.columns + east + 1] - given.first[i * given.columns + west]
            most = max(most, count)
    return most


@compiled
def _gather(given: _Given, row: int, column: int, near: _Near) -> int:
    """Fill in the points within reach of a post; their number."""
    n = 0
    begin, end, west, east = _cells(given, row, column)
    for i in range(begin, end):
        for k in range(given.first[i * given.columns + west], given.first[i * given.columns + east + 1]):
            x, y = given.points[k, 1] - column, row - given.points[k, 0]
            square = (x * x + y * y) / (given.reach * given.reach)
            if square <= 1.0:
                near.x[n], near.y[n], near.h[n], near.which[n] = x, y, given.points[k, 2], k
                near.sigma[n] = max(abs(given.spread[k, 2]), _LEAST_SIGMA)
                near.base[n] = math.exp(-2.0 * square) / (near.sigma[n] * near.sigma[n])
                n += 1
    return n


@compiled
def _plane(near: _Near, n: int) -> bool:
    """Weighted least squares: fill in `inverse` and `plane`; whether there is one."""
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    p, q, r = 0.0, 0.0, 0.0
    for i in range(n):
        x, y, h, w = near.x[i], near.y[i], near.h[i], near.w[i]
        a += w
        b += w * x
        c += w * y
        d += w * x * x
        e += w * x * y
        f += w * y * y
        p += w * h
        q += w * x * h
        r += w * y * h
    inverse = near.inverse
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
    determinant = a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
    if not determinant > _SINGULAR * a * d * f:
        return False
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant
        near.plane[i] = inverse[i, 0] * p + inverse[i, 1] * q + inverse[i, 2] * r
    return True


@compiled
def _residuals(near: _Near, n: int) -> float:
    """Fill in absolute residuals; the largest of them in its sigmas."""
    largest = 0.0
    for i in range(n):
        near.left[i] = abs(near.h[i] - near.plane[0] - near.plane[1] * near.x[i] - near.plane[2] * near.y[i])
        largest = max(largest, near.left[i] / near.sigma[i])
    return largest


@compiled
def _robust(near: _Near, n: int) -> bool:
    """The plane by weights `base` where all points agree with it, else by these times Tukey's; whether there is one."""
    for i in range(n):
        near.w[i] = near.base[i]
    if not _plane(near, n):
        return False
    if _residuals(near, n) <= _FINE:
        return True
    for _ in range(_ABSOLUTE):  # near and far points in one way: a blunder at the post itself has no neighbour's weight
        for i in range(n):
            near.w[i] = 1.0 / (near.sigma[i] * max(near.left[i], near.sigma[i]))
        if not _plane(near, n):
            return False
        _residuals(near, n)
    for _ in range(_TUKEYS):
        for i in range(n):
            near.spare[i] = near.left[i]
        _sort(near.spare, n)
        scale = 1.4826 * near.spare[n // 2]
        for i in range(n):
            scaled = near.left[i] / (_TUKEY * max(scale, near.sigma[i]))
            near.w[i] = near.base[i] * max(1.0 - scaled**2, 0.0) ** 2
        if not _plane(near, n):
            return False
        _residuals(near, n)
    return True


@compiled
def _surrounded(near: _Near, n: int) -> bool:
    """Whether the post is among the points that count: no half-plane about it is without one."""
    count, angles = 0, near.spare
    for i in range(n):
        if near.w[i] > 0.0:
            if near.x[i] ** 2 + near.y[i] ** 2 < _SAME_PLACE * _SAME_PLACE:
                return True
            angles[count] = math.atan2(near.y[i], near.x[i])
            count += 1
    if count < 3:
        return False
    _sort(angles, count)
    gap = angles[0] + 2.0 * math.pi - angles[count - 1]
    for i in range(1, count):
        gap = max(gap, angles[i] - angles[i - 1])
    return bool(gap < math.pi)


@compiled
def _compact(near: _Near, n: int) -> int:
    """Move the points that count to the front; their number."""
    count = 0
    for i in range(n):
        if near.w[i] > 0.0:
            near.x[count], near.y[count], near.h[count] = near.x[i], near.y[i], near.h[i]
            near.w[count], near.which[count] = near.w[i], near.which[i]
            count += 1
    return count


@compiled
def _solved(near: _Near, i: int) -> tuple[float, float, float]:
    """(X'WX)^-1 (1, x, y)' of a point."""
    inverse, x, y = near.inverse, near.x[i], near.y[i]
    return (
        inverse[0, 0] + inverse[0, 1] * x + inverse[0, 2] * y,
        inverse[1, 0] + inverse[1, 1] * x + inverse[1, 2] * y,
        inverse[2, 0] + inverse[2, 1] * x + inverse[2, 2] * y,
    )


@compiled
def _by_orientation(given: _Given, near: _Near, i: int) -> float:
    """m, sigma of a point's height at a fixed position by the orientation."""
    covariance, east, north = given.orientation[near.which[i]], near.plane[1], near.plane[2]
    variance = covariance[2, 2] - 2.0 * (east * covariance[0, 2] + north * covariance[1, 2])
    variance += east * east * covariance[0, 0] + north * north * covariance[1, 1]
    variance += 2.0 * east * north * covariance[0, 1]
    return math.sqrt(max(variance, 0.0))


@compiled
def _shared(given: _Given, near: _Near, i: int, j: int) -> float:
    """Correlation of two points' matching errors: what their windows share."""
    if given.pair[near.which[i]] != given.pair[near.which[j]]:
        return 0.0
    along, across = abs(near.x[i] - near.x[j]) / given.window, abs(near.y[i] - near.y[j]) / given.window
    return float(max(1.0 - along, 0.0) * max(1.0 - across, 0.0))


@compiled
def _sigmas(given: _Given, near: _Near, n: int, out: Array) -> None:
    """Fill in columns 1 to 6 of a post with n points that count."""
    orientation, squares, weight, own, sizes = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        spread = given.spread[near.which[i]]
        near.share[i] = near.w[i] * _solved(near, i)[0]
        near.sigma[i] = spread[2] - near.plane[1] * spread[0] - near.plane[2] * spread[1]
        orientation += near.share[i] * _by_orientation(given, near, i)
        off = near.h[i] - near.plane[0] - near.plane[1] * near.x[i] - near.plane[2] * near.y[i]
        squares += near.w[i] * off * off
        weight += near.w[i]
        own += near.w[i] * near.sigma[i] * near.sigma[i]
        sizes += near.share[i] * near.share[i]
    variance, explained, diagonal = _correlated(given, near, n)
    out[1], out[2], out[3] = max(variance, 0.0), orientation, n
    out[4], out[5], out[6] = squares - (own - explained), weight - diagonal, sizes


@compiled
def _correlated(given: _Given, near: _Near, n: int) -> tuple[float, float, float]:
    """a'Sa, tr(QS) and tr Q."""
    variance, explained, diagonal = 0.0, 0.0, 0.0
    for i in range(n):
        u, v, t = _solved(near, i)
        projected = near.w[i] * near.w[i] * (u + v * near.x[i] + t * near.y[i])
        square = near.sigma[i] * near.sigma[i]
        diagonal += projected
        variance += square * near.share[i] * near.share[i]
        explained += square * projected
        for j in range(i + 1, n):
            common = _shared(given, near, i, j)
            if common > 0.0:
                both = 2.0 * common * near.sigma[i] * near.sigma[j]
                variance += both * near.share[i] * near.share[j]
                explained += both * near.w[i] * near.w[j] * (u + v * near.x[j] + t * near.y[j])
    return variance, explained, diagonal


@cached_kernel
def surface(
    first_row: int, last_row: int, columns: int, first: Index, points: Array, spread: Array, orientation: Array,
    pair: Index, reach: float, window: float, posts: Array,
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
        Of images; the same number for pairs whose errors are not independent.
    reach : float
        posts, up to which points count.
    window : float
        posts, width of a matching window.
    posts : (rows, columns, COLUMNS)
        Filled; left as it is where there is no height.
    """
    given = _Given(columns, first, points, spread, orientation, pair, reach, window)
    most = _most(given, first_row, last_row)
    real = np.empty((9, most))
    near = _Near(
        real[0], real[1], real[2], real[3], real[4], real[5], real[6], real[7], real[8],
        np.empty(most, dtype=np.int64), np.empty((3, 3)), np.empty(3),
    )  # fmt: skip
    for row in range(first_row, last_row):
        for column in range(columns):
            n = _gather(given, row, column, near)
            if n < LEAST:
                continue
            level = near.h[0]
            for i in range(n):
                near.h[i] -= level
            if not _robust(near, n) or not _surrounded(near, n):
                continue
            n = _compact(near, n)
            if n < LEAST:
                continue
            posts[row, column, 0] = near.plane[0] + level
            _sigmas(given, near, n, posts[row, column])
