"""The equations of a window's pixels in least-squares matching: grey values between pixels (a picture as an exact cubic
B-spline, prefiltered once), what each unknown changes in them, how the pixels act on the position, and the covariances
that follow. Compiled into the kernel of `window`, which says what is estimated.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import compiled
from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import read_only

GOOD, EXTREME, MISSING = 0, 1, 2
"""Marks of a pixel: a measured grey value; one at an end of the scale; none (NaN)."""
MARGIN = (1, 2)
"""Coefficients that are kept before the first and after the last pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class SplinePicture:
    """A picture as a cubic B-spline through its pixels, mirrored about its outermost ones (Unser 1999)."""

    coefficients: NDArray[np.float32]
    """(lines + 3, samples + 3) of the spline, with `MARGIN` around them."""
    marks: NDArray[np.uint8]
    """(lines, samples) what each pixel is: `GOOD`, `EXTREME` or `MISSING`."""

    @classmethod
    def of(cls, pixels: NDArray[Any], where: str = "picture") -> "SplinePicture":
        """Filter a picture; takes some 50 ns per pixel.

        Parameters
        ----------
        pixels : (lines, samples)
            Grey values of any real type; NaN where there is none. Whole numbers at an end of their scale are saturated.
        where : str
            Name of the picture, for messages.

        Raises
        ------
        InputError
            If it is no picture of at least 4 x 4 pixels, or nothing in it is finite.
        """
        pixels = np.asarray(pixels)
        if pixels.ndim != 2 or pixels.dtype.kind not in "uif" or min(pixels.shape) < 4:
            raise InputError(where, f"{pixels.dtype} of shape {pixels.shape}", "(lines, samples) of at least 4 x 4")
        marks = _marks(pixels)
        require(not np.all(marks == MISSING), where, "no pixel with a grey value", "a picture")
        return cls(_filtered(_without_gaps(pixels, marks)), marks)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        lines, samples = self.marks.shape
        return lines, samples


def _marks(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    marks = np.zeros(pixels.shape, dtype=np.uint8)
    if pixels.dtype.kind == "f":
        marks[~np.isfinite(pixels)] = MISSING
    else:
        scale = np.iinfo(pixels.dtype)
        marks[(pixels == scale.min) | (pixels == scale.max)] = EXTREME
    return marks


def _without_gaps(pixels: NDArray[Any], marks: NDArray[np.uint8]) -> NDArray[Any]:
    """The picture with the nearest grey value where there is none: a NaN would spread along its line and sample."""
    missing = marks == MISSING
    if not missing.any():
        return pixels
    from scipy.ndimage import distance_transform_edt  # heavy

    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(pixels[tuple(nearest)])


def _filtered(pixels: NDArray[Any]) -> NDArray[np.float32]:
    from scipy.ndimage import spline_filter  # heavy

    inner = spline_filter(pixels, order=3, output=np.float32, mode="mirror")
    return read_only(np.pad(inner, (MARGIN, MARGIN), mode="reflect"))


# --- equations


Reals = NDArray[np.float64]
Symmetric = tuple[float, float, float]
"""A symmetric matrix (2, 2): upper left, beside it, lower right."""

PLAIN, RELIEF = 8, 11
"""Unknowns without and with relief."""
POSITION, AFFINE, GAIN, OFFSET, CORRELATION, RESIDUAL, NOISE, BEND, OF_BEND, MISFIT = 0, 2, 6, 7, 8, 9, 10, 14, 16, 20
NUMBERS = 32
"""Where in a row of results what begins."""
T, T_LINE, T_SAMPLE, S, S_LINE, S_SAMPLE, DOWN, ACROSS, WEIGHT, NARROW, PULL = range(11)
"""Columns of a window's pixels: grey value and gradient of the template, of the search picture; d in units of half the
window; weight, and weight that counts the middle alone; by how much the pixel pulls the position (2)."""
WIDTH = PULL + 2
NO_CONTRAST = 1e-5
"""Scatter of grey values relative to their size, which float32 coefficients don't resolve."""


class Room(NamedTuple):
    """Where windows are worked on, one after the other."""

    z: Reals
    j: Reals
    """(unknowns,) instruments and derivatives of a pixel."""
    step: Reals
    """(unknowns,)"""
    system: Reals
    """(unknowns, 2 unknowns + 4) a normal matrix, and right sides."""


@compiled
def spline_at(c: NDArray[np.float32], line: float, sample: float) -> tuple[float, float, float]:
    """Grey value and its derivatives per line and per sample at a position inside the picture."""
    y, x = line - 0.5, sample - 0.5
    i, j = int(y), int(x)
    v, u = y - i, x - j
    p, q = 1.0 - v, 1.0 - u
    u0, u1, u2, u3 = q * q * q, 4.0 - 3.0 * u * u * (2.0 - u), 4.0 - 3.0 * q * q * (2.0 - q), u * u * u
    e0, e1, e2, e3 = -q * q, u * (3.0 * u - 4.0), q * (4.0 - 3.0 * q), u * u
    value, by_line, by_sample = 0.0, 0.0, 0.0
    weights = (p * p * p, 4.0 - 3.0 * v * v * (2.0 - v), 4.0 - 3.0 * p * p * (2.0 - p), v * v * v)
    slopes = (-p * p, v * (3.0 * v - 4.0), p * (4.0 - 3.0 * p), v * v)
    for k in range(4):
        c0, c1, c2, c3 = c[i + k, j], c[i + k, j + 1], c[i + k, j + 2], c[i + k, j + 3]
        along = u0 * c0 + u1 * c1 + u2 * c2 + u3 * c3
        value += weights[k] * along
        by_line += slopes[k] * along
        by_sample += weights[k] * (e0 * c0 + e1 * c1 + e2 * c2 + e3 * c3)
    return value / 36.0, by_line / 12.0, by_sample / 12.0


@compiled
def read_template(
    c: NDArray[np.float32], anchor: Reals, half: tuple[int, int], weights: Reals, pixels: Reals
) -> bool:
    """Fill the template's columns; False where it has no contrast."""
    k, total, square = 0, 0.0, 0.0
    for down in range(-half[0], half[0] + 1):
        for across in range(-half[1], half[1] + 1):
            value, by_line, by_sample = spline_at(c, anchor[0] + down, anchor[1] + across)
            pixels[k, T], pixels[k, T_LINE], pixels[k, T_SAMPLE] = value, by_line, by_sample
            pixels[k, DOWN], pixels[k, ACROSS] = down / half[0], across / half[1]
            pixels[k, WEIGHT], pixels[k, NARROW] = weights[k, 0], weights[k, 1]
            total += value
            k += 1
    for i in range(k):
        square += (pixels[i, T] - total / k) ** 2
    return math.sqrt(square / k) > NO_CONTRAST * abs(total / k)


@compiled
def seen(x: Reals, e: Reals, half: tuple[int, int], down: float, across: float) -> tuple[float, float]:
    """Line and sample in the search picture of a position in units of half the window."""
    lines, samples = half[0] * down, half[1] * across
    line, sample = x[0] + x[2] * lines + x[3] * samples, x[1] + x[4] * lines + x[5] * samples
    if x.size == RELIEF:
        rise = x[8] * down * down + x[9] * down * across + x[10] * across * across
        line, sample = line + e[0] * rise, sample + e[1] * rise
    return line, sample


@compiled
def resample(c: NDArray[np.float32], x: Reals, e: Reals, half: tuple[int, int], pixels: Reals) -> None:
    """Fill the search picture's columns for the unknowns x."""
    for i in range(pixels.shape[0]):
        line, sample = seen(x, e, half, pixels[i, DOWN], pixels[i, ACROSS])
        pixels[i, S], pixels[i, S_LINE], pixels[i, S_SAMPLE] = spline_at(c, line, sample)


@compiled
def inside(x: Reals, e: Reals, half: tuple[int, int], lines: int, samples: int) -> bool:
    """Whether the whole window lies between the centres of the picture's outermost pixels."""
    down, across = abs(x[2]) * half[0] + abs(x[3]) * half[1], abs(x[4]) * half[0] + abs(x[5]) * half[1]
    if x.size == RELIEF:
        most = abs(x[8]) + abs(x[9]) + abs(x[10])
        down, across = down + abs(e[0]) * most, across + abs(e[1]) * most
    return bool(
        x[0] - down >= 0.5 and x[0] + down <= lines - 0.5 and x[1] - across >= 0.5 and x[1] + across <= samples - 0.5
    )


@compiled
def derivatives(pixels: Reals, i: int, x: Reals, e: Reals, z: Reals, j: Reals) -> None:
    """Instruments z and derivatives j of a pixel's model by all unknowns, in units of half the window for A."""
    determinant = x[2] * x[5] - x[3] * x[4]
    z[0] = (x[5] * pixels[i, T_LINE] - x[4] * pixels[i, T_SAMPLE]) / determinant
    z[1] = (x[2] * pixels[i, T_SAMPLE] - x[3] * pixels[i, T_LINE]) / determinant
    j[0], j[1] = x[6] * pixels[i, S_LINE], x[6] * pixels[i, S_SAMPLE]
    for k in range(2):
        z[2 + 2 * k], z[3 + 2 * k] = z[k] * pixels[i, DOWN], z[k] * pixels[i, ACROSS]
        j[2 + 2 * k], j[3 + 2 * k] = j[k] * pixels[i, DOWN], j[k] * pixels[i, ACROSS]
    z[6], z[7] = 0.5 * (pixels[i, S] + (pixels[i, T] - x[7]) / x[6]), 1.0
    j[6], j[7] = pixels[i, S], 1.0
    if x.size == RELIEF:
        down, across = pixels[i, DOWN], pixels[i, ACROSS]
        along_z, along_j = e[0] * z[0] + e[1] * z[1], e[0] * j[0] + e[1] * j[1]
        z[8], z[9], z[10] = along_z * down * down, along_z * down * across, along_z * across * across
        j[8], j[9], j[10] = along_j * down * down, along_j * down * across, along_j * across * across


_BLOCK = 4
"""pixels along and across a block of pulls: residuals are correlated over fewer, or over more
than a window can tell."""


@compiled
def _influences(pixels: Reals, x: Reals, e: Reals, room: Room) -> bool:
    """Leave `by` (unknowns, 4) right of the normal matrix: a pixel's influence on the position is by[:, :2]' w z, on
    the bend
    by[:, :2]' n z - by[:, 2:]' w z
    with the narrow weights n, scaled to the sum of w. False where the texture does not determine the position.

    The bend leans on the whole window's normal matrix: the middle's own may be singular.
    """
    z, j, system, unknowns = room.z, room.j, room.system, x.size
    bend, narrow = unknowns + 2, unknowns + 4
    for k in range(unknowns):
        for m in range(system.shape[1]):
            system[k, m] = 1.0 if m == unknowns + k and m < bend else 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        for k in range(unknowns):
            for m in range(unknowns):
                system[m, k] += pixels[i, WEIGHT] * z[k] * j[m]
                system[m, narrow + k] += pixels[i, NARROW] * z[k] * j[m]
    if not solve(system):
        return False
    for k in range(unknowns):
        for c in range(2):
            for m in range(unknowns):
                system[k, bend + c] += system[k, narrow + m] * system[m, unknowns + c]
    line, sample = system[0, unknowns], system[1, unknowns + 1]
    both = system[0, unknowns + 1] + system[1, unknowns]
    return bool(line > 0.0 and sample > 0.0 and 4.0 * line * sample > both * both)


@compiled
def solve(system: Reals) -> bool:
    """Solve a x = b, given [a b] (n, n + columns), in place, by elimination with partial pivoting; False where a is
    singular.
    """
    n, end = system.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            pivot = i if abs(system[i, k]) > abs(system[pivot, k]) else pivot
        if not abs(system[pivot, k]) > 0.0:
            return False
        for m in range(k, end):
            system[k, m], system[pivot, m] = system[pivot, m], system[k, m]
        for i in range(k + 1, n):
            factor = system[i, k] / system[k, k]
            for m in range(k + 1, end):
                system[i, m] -= factor * system[k, m]
    for k in range(n - 1, -1, -1):
        for m in range(n, end):
            for i in range(k + 1, n):
                system[k, m] -= system[k, i] * system[i, m]
            system[k, m] /= system[k, k]
    return True


@compiled
def _sums(pixels: Reals, x: Reals, e: Reals, room: Room, row: Reals) -> tuple[Symmetric, Symmetric, float]:
    """Fill the pulls, the residual and the bend; sums of squared influences on the position and on the bend, times the
    variance of a residual, and by how much sums of squares grow for the unknowns' sake.
    """
    z, by, first = room.z, room.system, x.size
    square, weight, weight_square, bend0, bend1 = 0.0, 0.0, 0.0, 0.0, 0.0
    place00, place01, place11, bend00, bend01, bend11 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, room.j)
        residue = pixels[i, T] - x[6] * pixels[i, S] - x[7]
        u0, u1, v0, v1, wide, narrow = 0.0, 0.0, 0.0, 0.0, pixels[i, WEIGHT], pixels[i, NARROW]
        for m in range(x.size):
            u0, u1 = u0 + by[m, first] * z[m], u1 + by[m, first + 1] * z[m]
            v0, v1 = v0 + by[m, first + 2] * z[m], v1 + by[m, first + 3] * z[m]
        u0, u1, v0, v1 = wide * u0, wide * u1, narrow * u0 - wide * v0, narrow * u1 - wide * v1
        pixels[i, PULL], pixels[i, PULL + 1] = u0 * residue, u1 * residue
        bend0, bend1 = bend0 + v0 * residue, bend1 + v1 * residue
        place00, place01, place11 = place00 + u0 * u0, place01 + u0 * u1, place11 + u1 * u1
        bend00, bend01, bend11 = bend00 + v0 * v0, bend01 + v0 * v1, bend11 + v1 * v1
        square, weight, weight_square = square + wide * residue * residue, weight + wide, weight_square + wide * wide
    growth = 1.0 / (1.0 - x.size * weight_square / (weight * weight))
    variance = growth * square / weight
    row[RESIDUAL], row[BEND], row[BEND + 1] = math.sqrt(variance), bend0, bend1
    return times(variance, (place00, place01, place11)), times(variance, (bend00, bend01, bend11)), growth


@compiled
def _misfit(pixels: Reals, x: Reals, e: Reals, room: Room, row: Reals) -> None:
    """Fill the normal equations (3, 4) of the middle's squared residuals over a constant and squares of derivatives by
    line and sample, c + T00 l l + T01 2 l s + T11 s s; the constant is reduced.

    Derivatives of the two pictures are multiplied with each other: the square of a noisy one is too large.
    """
    z, j, total = room.z, room.j, room.system
    for k in range(4):
        for m in range(5):
            total[k, m] = 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        residue = pixels[i, T] - x[6] * pixels[i, S] - x[7]
        squares = 1.0, z[0] * z[0], 2.0 * z[0] * z[1], z[1] * z[1]
        own = 1.0, z[0] * j[0], z[0] * j[1] + z[1] * j[0], z[1] * j[1], residue * residue
        for k in range(4):
            for m in range(5):
                total[k, m] += pixels[i, NARROW] * squares[k] * own[m]
    for k in range(3):
        for m in range(4):
            row[MISFIT + 4 * k + m] = total[1 + k, 1 + m] - total[1 + k, 0] * total[0, 1 + m] / total[0, 0]


@compiled
def _blocks(pixels: Reals, half: tuple[int, int]) -> Symmetric:
    """Sum of the products of neighbouring pixels' pulls, with Bartlett's weights: over all square blocks, those
    that stand out of the window included, the squared sums of pulls (Newey & West 1987, Conley 1999). Never negative.
    """
    down, across = 2 * half[0] + 1, 2 * half[1] + 1
    total00, total01, total11 = 0.0, 0.0, 0.0
    for i in range(1 - _BLOCK, down):
        for j in range(1 - _BLOCK, across):
            line, sample = 0.0, 0.0
            for k in range(max(i, 0), min(i + _BLOCK, down)):
                for m in range(max(j, 0), min(j + _BLOCK, across)):
                    line += pixels[k * across + m, PULL]
                    sample += pixels[k * across + m, PULL + 1]
            total00, total01, total11 = total00 + line * line, total01 + line * sample, total11 + sample * sample
    return times(1.0 / _BLOCK**2, (total00, total01, total11))


@compiled
def times(factor: float, a: Symmetric) -> Symmetric:
    """The product of a factor and a matrix."""
    return factor * a[0], factor * a[1], factor * a[2]


@compiled
def raised(a: Symmetric, floor: Symmetric) -> Symmetric:
    """a, no smaller than the floor in any direction: plus the positive part of d = floor - a, to which belong the
    positive ones of the roots of det(d - root floor) = 0.
    """
    d0, d1, d2 = floor[0] - a[0], floor[1] - a[1], floor[2] - a[2]
    determinant = floor[0] * floor[2] - floor[1] * floor[1]
    middle = 0.5 * (floor[0] * d2 - 2.0 * floor[1] * d1 + floor[2] * d0) / determinant
    product = (d0 * d2 - d1 * d1) / determinant
    if product >= 0.0:  # of one sign
        return floor if middle > 0.0 else a
    apart = math.sqrt(middle * middle - product)
    high = middle + apart if middle > 0.0 else product / (middle - apart)
    low = product / high
    part = 0.5 * high / apart
    return (
        a[0] + part * (d0 - low * floor[0]), a[1] + part * (d1 - low * floor[1]), a[2] + part * (d2 - low * floor[2]),
    )  # fmt: skip


@compiled
def fill_covariance(pixels: Reals, x: Reals, e: Reals, half: tuple[int, int], room: Room, row: Reals) -> bool:
    """Fill residual, covariance of the noise, bend and its covariance; False where the texture does not determine the
    position.

    The noise's part is the sum of products of the pulls of neighbouring pixels, at least that of white noise. Relief
    that the model does not follow moves the position from the anchor's own to the window's mean. It shows in the bend,
    by how much the position moves when the middle alone counts.
    """
    if not _influences(pixels, x, e, room):
        return False
    white, of_bend, growth = _sums(pixels, x, e, room, row)
    _misfit(pixels, x, e, room, row)
    covariance = times(growth, _blocks(pixels, half))
    if white[0] > 0.0 and white[0] * white[2] > white[1] * white[1]:
        covariance = raised(covariance, white)
    for k in range(2):
        for m in range(2):
            row[NOISE + 2 * k + m], row[OF_BEND + 2 * k + m] = covariance[k + m], of_bend[k + m]
    return True
