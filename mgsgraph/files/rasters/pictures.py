"""Pixels of images of any camera: MOC's own formats, and rasters that GDAL reads (ISIS cubes, GeoTIFF, PDS, ...).

Where the pixels of a MOC image of the archive lie in its file (ISIS moc2isis).
"""

import os
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.cameras.camera import LineScanLabel
from mgsgraph.files.cameras.label import label_of
from mgsgraph.files.opening import opened, understood
from mgsgraph.files.pvl import Block, bytes_around, cube_of, data_location, instrument_of, read_label
from mgsgraph.files.rasters.raster_file import open_raster, read_band

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

Pixels = NDArray[np.uint8]
"""(lines, samples) of an image, as they came down (not calibrated)."""
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
    return read_moc_pixels(path) if _is_whole(path) else _by_gdal(path)


def _is_whole(path: Path) -> bool:
    """Whether a picture is in one of MOC's own formats; cubes are rasters, for calibrated ones hold real numbers."""
    return path.suffix.lower() != ".cub" and is_moc(path)


def picture_size(path: Path) -> tuple[int, int]:
    """Lines and samples of an image's pixels, without reading these; InputError as `read_picture` has them."""
    if _is_whole(path):
        label = label_of(path, read_label(path))
        return label.lines, label.samples
    with _opened_band(path) as file:
        lines, samples = file.shape
    return int(lines), int(samples)


def read_picture_part(path: Path, lines: slice, samples: slice) -> NDArray[Any]:
    """Some lines and samples of an image as `read_picture` gives them: of a raster no others are read; one of MOC's own
    formats, which are small and may be compressed as a whole, is read whole.

    Parameters
    ----------
    path : Path
    lines, samples : slice
        px, from the first to before the last, within the image.

    Raises
    ------
    InputError
        As `read_picture`.
    """
    return read_moc_pixels(path)[lines, samples] if _is_whole(path) else _by_gdal(path, (lines, samples))


def as_bytes(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Grey values to look at: bytes as they are, others stretched between their quantiles of 0.5 and 99.5 %."""
    if pixels.dtype == np.uint8:
        return pixels
    valid = pixels[np.isfinite(pixels)]
    low, high = np.quantile(valid, [0.005, 0.995]) if valid.size else (0.0, 1.0)
    stretched = (np.nan_to_num(pixels, nan=low) - low) * (255.0 / max(high - low, 1e-30))
    return np.asarray(np.clip(stretched, 0.0, 255.0).astype(np.uint8))


def is_moc(path: Path) -> bool:
    """Whether an image (or its label) says that MOC took it."""
    if path.suffix.lower() not in (".img", ".imq", ".lbl", ".cub"):
        return False
    try:
        return instrument_of(path).startswith("MOC")
    except InputError:
        return False


@contextmanager
def _opened_band(path: Path) -> Iterator["DatasetReader"]:
    """An image's raster, opened; InputError where it has several bands, or pixels that are no grey values."""
    with open_raster(path, "an image") as file:
        require(file.count == 1, str(path), f"{file.count} bands", "one band")
        if not file.dtypes[0].startswith(("int", "uint", "float")):
            raise InputError(str(path), f"pixels of type {file.dtypes[0]}", "grey values")
        yield file


def _by_gdal(path: Path, part: tuple[slice, slice] | None = None) -> NDArray[Any]:
    from rasterio.windows import Window  # heavy

    with _opened_band(path) as file:
        window = None if part is None else Window.from_slices(*part)
        pixels, null = read_band(file, path, window), file.nodata
    if pixels.dtype.kind == "f":
        with np.errstate(over="ignore", invalid="ignore"):  # what float32 can't hold is none
            pixels = pixels.astype(np.float32)
            hollow = ~(pixels > _NULL) | ~np.isfinite(pixels) | (pixels == np.float32(np.nan if null is None else null))
        pixels[hollow] = np.nan
    elif path.suffix.lower() == ".cub" and pixels.dtype.name in _SPECIAL:
        low, high = _SPECIAL[pixels.dtype.name]
        hollow = (pixels <= low) | ((pixels >= high) if pixels.dtype.kind == "u" else False)
        pixels = np.where(hollow, np.nan, pixels.astype(np.float32))
    elif null is not None and pixels.dtype.itemsize > 1 and np.any(hollow := pixels == null):
        pixels = np.where(hollow, np.nan, pixels.astype(np.float32))
    return np.asarray(pixels)


# --- where MOC's pixels lie

_LABEL = 2048
"""bytes before the first fragment of a compressed image."""
_FRAGMENT = 62
"""bytes of a fragment's header; one follows its content."""
_CELL = 16
"""Lines and samples in which fragments are counted."""
_TRANSFORMED, _LAST = 0b1100, 0b10
"""Bits of a header's compression, and of its status."""
_NOTHING = {"n/a", "none", "unk", "null"}


@dataclass(frozen=True, slots=True)
class PixelArea:
    """Where the pixels of a PDS3 image lie, one byte each unless compressed."""

    file: Path
    """Which holds them."""
    offset: int
    """bytes before the first line."""
    prefix: int
    """bytes before each line's pixels."""
    suffix: int
    """bytes after each line's pixels."""
    encoding: str
    """As the label calls the compression, such as MOC-PRED-X-5; empty when there is none."""
    file_size: int
    """bytes that the label says the file has; 0 where it doesn't."""


def pixel_area(path: Path, root: Block) -> PixelArea:
    """Pixel area of an image, by its PDS3 label in the file `path` or beside it."""
    image = root.inner("IMAGE")
    if image.number("SAMPLE_BITS", {"": 1.0}) != 8.0:
        raise InputError(image.where("SAMPLE_BITS"), image.text("SAMPLE_BITS"), "8, as all MOC images have")
    prefix, suffix = bytes_around(image)
    encoding = image.text("ENCODING_TYPE") if "ENCODING_TYPE" in image else ""
    size = root.count("RECORD_BYTES") * root.count("FILE_RECORDS") if "FILE_RECORDS" in root else 0
    file, offset = data_location(path, root)
    return PixelArea(file, offset, prefix, suffix, "" if encoding.lower() in _NOTHING else encoding, size)


def require_fragments(area: PixelArea, lines: int, samples: int) -> None:
    """Raise InputError unless the fragments of a compressed image follow each other up to the last one, and are of an
    image of this size: what is decompressed takes memory and time by their headers (which pdr follows).
    """
    where, damaged = str(area.file), "it is damaged: fetch it again"
    if area.offset != _LABEL:
        raise InputError(where, f"compressed pixels after {area.offset} bytes", f"a label of {_LABEL}", damaged)
    with opened(area.file, 1 << 32) as file, understood(where, "a compressed MOC image", damaged):
        size, place, high = os.fstat(file.fileno()).st_size, _LABEL, 0
        while True:
            file.seek(place)
            head = file.read(_FRAGMENT)
            length = struct.unpack_from("<I", head, 58)[0]
            place += _FRAGMENT + length + 1
            part, whole = (_CELL * struct.unpack_from("<H", head, at)[0] for at in (6, 40))
            transformed = head[44] & _TRANSFORMED
            high = high + part if transformed else whole
            counted = (high, _CELL * head[43])
            if length == 0 or place > size + 1 or counted[1] != samples or counted[0] > lines:
                raise InputError(
                    where, f"a fragment of {length} bytes for {counted[0]} x {counted[1]} pixels",
                    f"one of those of {lines} x {samples}", damaged,
                )  # fmt: skip
            if head[13] & _LAST or (transformed and high == lines):
                return


# --- MOC


def read_moc_pixels(path: Path) -> Pixels:
    """Pixels (lines, samples) of a MOC image.

    Parameters
    ----------
    path : Path
        ``.img``, ``.imq``, or a detached ``.lbl`` of these.

    Raises
    ------
    InputError
        No such image, a file shorter than its label says, a compressed one where pdr is not installed, or a cube.
    """
    root = read_label(path)
    require(cube_of(root) is None, str(path), "the label of a cube", "the cube, or a PDS3 image or its label")
    label, area = label_of(path, root), pixel_area(path, root)
    _require_size(label, area)
    return _decompressed(label, area) if area.encoding else _plain(label, area)


def _require_size(label: LineScanLabel, area: PixelArea) -> None:
    """Raise InputError unless the file is as long as its label says."""
    plain = area.offset + label.lines * (area.prefix + label.samples + area.suffix)
    expected, size = area.file_size if area.encoding else plain, area.file.stat().st_size
    require(
        size >= expected, str(area.file), f"{size} bytes",
        f"{expected} for {label.lines} lines of {label.samples} samples", "it is cut short: fetch it again",
    )  # fmt: skip


def _plain(label: LineScanLabel, area: PixelArea) -> Pixels:
    width = area.prefix + label.samples + area.suffix
    with opened(area.file) as file:
        file.seek(area.offset)
        rows = np.fromfile(file, np.uint8, label.lines * width).reshape(label.lines, width)
    return np.ascontiguousarray(rows[:, area.prefix : area.prefix + label.samples])


def _decompressed(label: LineScanLabel, area: PixelArea) -> Pixels:
    try:
        from pdr.formats.mgs_moc import mgs_moc_comp_image_loader  # heavy, and only compressed images need it
    except ImportError:
        raise InputError(
            str(area.file), f"pixels compressed as {area.encoding}, and pdr is not installed",
            remedy='pip install "mgsgraph[moc]", or give the decompressed .img',
        ) from None
    require_fragments(area, label.lines, label.samples)
    what = f"pixels compressed as {area.encoding}"
    with warnings.catch_warnings(), understood(str(area.file), what, "fetch it again"):
        warnings.simplefilter("error")
        try:
            pixels = mgs_moc_comp_image_loader(str(area.file), {"DATA_QUALITY_DESC": "OK"})
        except UserWarning as error:  # of parts that are missing, in place of which it puts zeros
            raise ValueError(str(error)) from None
    return _checked(label, area.file, pixels)


def _checked(label: LineScanLabel, file: Path, pixels: Any) -> Pixels:
    """Pixels from another library, after a comparison with the label."""
    shape = (label.lines, label.samples)
    if not isinstance(pixels, np.ndarray) or pixels.shape != shape:
        found = f"an array of shape {pixels.shape}" if isinstance(pixels, np.ndarray) else "no image"
        raise InputError(str(file), found, f"{shape[0]} x {shape[1]} pixels", "it is damaged: fetch it again")
    require(pixels.dtype == np.uint8, str(file), f"pixels of type {pixels.dtype}", "unsigned bytes, as they came down")
    return np.ascontiguousarray(pixels)
