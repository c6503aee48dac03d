"""Pixels of images of any camera: MOC's own formats, and raster files that GDAL reads (ISIS cubes, GeoTIFF, PDS)."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.io.cameras.camera import LineScanLabel
from mgsgraph.io.cameras.label import label_of
from mgsgraph.io.image_label import cube_of, instrument_of, read_label
from mgsgraph.io.moc_pixels import PixelArea, pixel_area

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

Pixels = NDArray[np.uint8]
"""(lines, samples) of an image, as they came down (not calibrated)."""
_DRIVERS = [
    "GTiff", "ISIS3", "ISIS2", "PDS4", "PDS", "VICAR", "ENVI", "EHdr", "HFA", "AAIGrid", "PNG", "JPEG", "JP2OpenJPEG",
    "PCIDSK", "netCDF", "HDF5", "VRT",
]  # fmt: skip
"""GDAL's of raster files: its others, of databases and of services on the network, are not asked."""
_NULL = -1e30
"""ISIS's special pixels (null, saturated) of real type lie below."""
_SPECIAL = {"int16": (-32752, 32767), "uint16": (2, 65522)}
"""ISIS's of whole numbers: up to the first, and for unsigned ones from the second on (SpecialPixel.h)."""


@contextmanager
def open_raster(path: Path, expected: str) -> Iterator["DatasetReader"]:
    """A raster file opened by GDAL; InputError where it is missing, or can't be read inside the block."""
    from rasterio import Env  # heavy
    from rasterio.errors import NotGeoreferencedWarning, RasterioError
    from rasterio.io import DatasetReader

    if not path.is_file():
        raise InputError(str(path), "no such file", expected)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with Env(), DatasetReader(str(path), driver=_DRIVERS) as file:  # rasterio.open takes one driver alone
                yield file
    except InputError:
        raise
    except (RasterioError, MemoryError, ValueError) as error:
        raise InputError(str(path), f"can't be read ({_short(error)})", expected) from None


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
    with open_raster(path, "an ISIS cube, GeoTIFF or PDS image") as file:
        bands, pixels, null = file.count, file.read(1), file.nodata
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


# --- MOC


def read_moc_pixels(path: Path) -> Pixels:
    """Pixels (lines, samples) of a MOC image.

    Parameters
    ----------
    path : Path
        ``.img``, ``.imq``, a detached ``.lbl`` of these, or an ISIS ``.cub`` (or its ``.lbl``, the cube beside it).

    Raises
    ------
    InputError
        No such image, a file shorter than its label says, a compressed one where pdr is not installed, or a cube that
        does not hold the eight bits that came down.
    """
    root = read_label(path)
    cube, label = cube_of(root), label_of(path, root)
    if cube is not None:
        return _from_cube(label)
    area = pixel_area(path, root)
    _require_size(label, area)
    return _decompressed(label, area) if area.encoding else _plain(label, area)


def _require_size(label: LineScanLabel, area: PixelArea) -> None:
    """Raise InputError unless the file is as long as its label says."""
    plain = area.offset + label.lines * (area.prefix + label.samples + area.suffix)
    wanted, size = area.file_size if area.encoding else plain, area.file.stat().st_size
    if size < wanted:
        raise InputError(
            str(area.file), f"{size} bytes", f"{wanted} for {label.lines} lines of {label.samples} samples",
            "it is cut short: fetch it again",
        )


def _plain(label: LineScanLabel, area: PixelArea) -> Pixels:
    width = area.prefix + label.samples + area.suffix
    rows = np.fromfile(area.file, np.uint8, label.lines * width, offset=area.offset).reshape(label.lines, width)
    return np.ascontiguousarray(rows[:, area.prefix : area.prefix + label.samples])


def _decompressed(label: LineScanLabel, area: PixelArea) -> Pixels:
    try:
        import pdr  # heavy, and only compressed images need it
    except ImportError:
        raise InputError(
            str(area.file), f"pixels compressed as {area.encoding}, and pdr is not installed",
            remedy='pip install "mgsgraph[moc]", or give the decompressed .img',
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pdr's about what it doesn't find; a missing image shows below
            pixels = pdr.read(str(area.file))["IMAGE"]
    except Exception as error:  # whatever its parsers raise on a damaged stream
        raise InputError(str(area.file), f"can't be decompressed ({_short(error)})", remedy="fetch it again") from None
    return _checked(label, area.file, pixels)


def _from_cube(label: LineScanLabel) -> Pixels:
    path = label.path
    if path.suffix.lower() != ".cub":
        beside = [path.with_suffix(suffix) for suffix in (".cub", ".CUB") if path.with_suffix(suffix).is_file()]
        if not beside:
            raise InputError(str(path), "the label of a cube, without the cube", f"{path.stem}.cub beside it")
        path = beside[0]
    with open_raster(path, "a whole ISIS cube") as cube:
        pixels = cube.read(1)
    return _checked(label, path, pixels)


def _checked(label: LineScanLabel, file: Path, pixels: Any) -> Pixels:
    """Pixels as another library gave them, after a look whether they are what the label says."""
    shape = (label.lines, label.samples)
    if not isinstance(pixels, np.ndarray) or pixels.shape != shape:
        found = f"an array of shape {pixels.shape}" if isinstance(pixels, np.ndarray) else "no image"
        raise InputError(str(file), found, f"{shape[0]} x {shape[1]} pixels", "it is damaged: fetch it again")
    if pixels.dtype != np.uint8:
        raise InputError(str(file), f"pixels of type {pixels.dtype}", "unsigned bytes, as they came down")
    return np.ascontiguousarray(pixels)


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:100] or type(error).__name__
