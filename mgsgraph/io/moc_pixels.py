"""Pixels of MOC images: decompressed PDS3 files directly, compressed ones through pdr, ISIS cubes through rasterio."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.io.moc_label import MocLabel, PixelArea, read_moc_label

Pixels = NDArray[np.uint8]
"""(lines, samples) of an image, as they came down (not calibrated)."""


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
    label = read_moc_label(path)
    if label.pixels is None:
        return _from_cube(label)
    _require_size(label, label.pixels)
    return _decompressed(label, label.pixels) if label.compressed else _plain(label, label.pixels)


def _require_size(label: MocLabel, area: PixelArea) -> None:
    """Raise InputError unless the file is as long as its label says."""
    plain = area.offset + label.lines * (area.prefix + label.samples + area.suffix)
    wanted, size = area.file_size if label.compressed else plain, area.file.stat().st_size
    if size < wanted:
        raise InputError(
            str(area.file), f"{size} bytes", f"{wanted} for {label.lines} lines of {label.samples} samples",
            "it is cut short: fetch it again",
        )


def _plain(label: MocLabel, area: PixelArea) -> Pixels:
    width = area.prefix + label.samples + area.suffix
    rows = np.fromfile(area.file, np.uint8, label.lines * width, offset=area.offset).reshape(label.lines, width)
    return np.ascontiguousarray(rows[:, area.prefix : area.prefix + label.samples])


def _decompressed(label: MocLabel, area: PixelArea) -> Pixels:
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


def _from_cube(label: MocLabel) -> Pixels:
    import rasterio  # heavy, and only cubes need it
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    path = label.path
    if path.suffix.lower() != ".cub":
        beside = [path.with_suffix(suffix) for suffix in (".cub", ".CUB") if path.with_suffix(suffix).is_file()]
        if not beside:
            raise InputError(str(path), "the label of a cube, without the cube", f"{path.stem}.cub beside it")
        path = beside[0]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as cube:
                pixels = cube.read(1)
    except RasterioError as error:
        raise InputError(str(path), f"can't be read ({_short(error)})", "a whole ISIS cube") from None
    return _checked(label, path, pixels)


def _checked(label: MocLabel, file: Path, pixels: Any) -> Pixels:
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
