"""The equations of a window's pixels in least-squares matching: grey values, and what each unknown changes in them.

Compiled into the kernel of `window`, which says what is estimated.

Grey values between pixels: a picture as an exact cubic B-spline, prefiltered once.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import compiled
from mgsgraph.errors import InputError

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
    def of(cls, pixels: NDArray[Any], where: str = "picture", extremes: tuple[float, float] | None = None) -> (
        "SplinePicture"
    ):
        """Filter a picture; takes some 50 ns per pixel.

        Parameters
        ----------
        pixels : (lines, samples)
            Grey values of any real type; NaN where there is none.
        where : str
            Name of the picture, for messages.
        extremes : (2,), optional
            Grey values at or below and at or above which a pixel is saturated. Left out: 0 and 255 for bytes, the ends
            of the scale for other whole numbers, none for floating point.

        Raises
        ------
        InputError
            If it is no picture of at least 4 x 4 pixels, or nothing in it is finite.
        """
        pixels = np.asarray(pixels)
        if pixels.ndim != 2 or pixels.dtype.kind not in "uif" or min(pixels.shape) < 4:
            raise InputError(where, f"{pixels.dtype} of shape {pixels.shape}", "(lines, samples) of at least 4 x 4")
        marks = _marks(pixels, extremes)
        if np.all(marks == MISSING):
            raise InputError(where, "no pixel with a grey value", "a picture")
        return cls(_filtered(_without_gaps(pixels, marks)), marks)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        lines, samples = self.marks.shape
        return lines, samples


def _marks(pixels: NDArray[Any], extremes: tuple[float, float] | None) -> NDArray[np.uint8]:
    marks = np.zeros(pixels.shape, dtype=np.uint8)
    if extremes is None and pixels.dtype.kind in "ui":
        scale = np.iinfo(pixels.dtype)
        extremes = float(scale.min), float(scale.max)
    if extremes is not None:
        marks[(pixels <= extremes[0]) | (pixels >= extremes[1])] = EXTREME
    if pixels.dtype.kind == "f":
        marks[~np.isfinite(pixels)] = MISSING
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
    padded = np.pad(inner, (MARGIN, MARGIN), mode="reflect")
    padded.flags.writeable = False
    return padded


# --- equations


Reals = NDArray[np.float64]

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
