"""Grey values between pixels: a picture as an exact cubic B-spline, prefiltered once."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
