"""Pixels of images of any camera: MOC's own formats, and whatever GDAL reads (ISIS cubes, GeoTIFF, PDS)."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.io.image_label import instrument_of
from mgsgraph.io.moc_pixels import read_moc_pixels

_NULL = -1e30
"""ISIS's special pixels (null, saturated) of real type lie below."""
_SPECIAL = {"int16": (-32752, 32767), "uint16": (2, 65522)}
"""ISIS's of whole numbers: up to the first, and for unsigned ones from the second on (SpecialPixel.h)."""


def read_picture(path: Path) -> NDArray[Any]:
    """Pixels (lines, samples) of an image; whole numbers as they are, real ones as float32.

    NaN where the file says that there is none (then whole numbers of more than a byte become float32, too).

    Raises
    ------
    InputError
        No such file, or none that can be read as an image of one band.
    """
    cube = path.suffix.lower() == ".cub"  # calibrated ones hold real numbers
    return _by_gdal(path) if cube or not is_moc(path) else read_moc_pixels(path)


def as_bytes(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Grey values to look at: bytes as they are, others stretched between their quantiles of 0.5 and 99.5 %."""
    if pixels.dtype == np.uint8:
        return pixels
    valid = pixels[np.isfinite(pixels)]
    low, high = np.quantile(valid, [0.005, 0.995]) if valid.size else (0.0, 1.0)
    shown = (np.nan_to_num(pixels, nan=low) - low) * (255.0 / max(high - low, 1e-30))
    return np.asarray(np.clip(shown, 0.0, 255.0).astype(np.uint8))


def is_moc(path: Path) -> bool:
    """Whether an image (or its label) says that MOC took it."""
    if path.suffix.lower() not in (".img", ".imq", ".lbl", ".cub"):
        return False
    try:
        return instrument_of(path).startswith("MOC")
    except InputError:
        return False


def _by_gdal(path: Path) -> NDArray[Any]:
    import rasterio  # heavy
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    if not path.is_file():
        raise InputError(str(path), "no such file", "an image's pixels")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                bands, pixels, null = file.count, file.read(1), file.nodata
    except (RasterioError, MemoryError, ValueError) as error:
        found = f"can't be read as an image ({' '.join(str(error).split())[:100]})"
        raise InputError(str(path), found, "an ISIS cube, GeoTIFF or PDS image") from None
    if bands != 1:
        raise InputError(str(path), f"{bands} bands", "one band")
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32)
        pixels[~(pixels > _NULL) | ~np.isfinite(pixels)] = np.nan
        if null is not None:
            pixels[pixels == np.float32(null)] = np.nan
    elif pixels.dtype.kind not in "iu":
        raise InputError(str(path), f"pixels of type {pixels.dtype}", "grey values")
    elif path.suffix.lower() == ".cub" and pixels.dtype.name in _SPECIAL:
        low, high = _SPECIAL[pixels.dtype.name]
        hollow = (pixels <= low) | ((pixels >= high) if pixels.dtype.kind == "u" else False)
        pixels = np.where(hollow, np.nan, pixels.astype(np.float32))
    elif null is not None and pixels.dtype.itemsize > 1 and np.any(hollow := pixels == null):
        pixels = np.where(hollow, np.nan, pixels.astype(np.float32))
    return np.asarray(pixels)
