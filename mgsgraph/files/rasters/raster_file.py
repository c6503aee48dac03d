"""Raster files by GDAL, each alone: nothing but the file itself is opened, or the data file beside its label.

GDAL opens whatever a file names: sources of a virtual raster, services on the network, overviews that a GeoTIFF says it
has, masks and metadata that lie beside. Here one driver is asked (`raster_kinds`); sidecars are not looked for, and
where one would change what is read, the file is refused. So are pixels by the gigabyte that a small file declares.
"""

import logging
import os
import re
import struct
import sys
import threading
import warnings
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from io import BufferedReader
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.opening import ANY_SIZE, opened, read_bytes, understood
from mgsgraph.files.rasters.raster_kinds import raster_kind, whole_remedy

if TYPE_CHECKING:
    from rasterio.io import DatasetReader
    from rasterio.windows import Window

_SMALL = 1 << 26
"""bytes that pixels may take whatever the size of their file."""
_PACKED = 100
"""Times that those of a larger raster may be as large as its file: compressed terrain with wide gaps is 20 times."""
_ENVIRONMENT = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no sidecars
    "GDAL_PAM_ENABLED": "NO",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",  # nothing on the network
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",  # no pixels made up after a damaged place
    "CPL_LOG": os.devnull,  # what its threads print
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",  # nor what happens to lie in memory
}
_SIDECAR_SIZE = 1 << 24
_PIECE = 1 << 16
"""bytes unpacked at a time, of which at most a thousand times as many come."""
_ROWS_PER_STRIP = 278
"""TIFF's tag; absent where all rows are in one strip (TIFF 6.0, page 39)."""
_SILENT = logging.NullHandler()


@contextmanager
def open_raster(path: Path, expected: str) -> Iterator["DatasetReader"]:
    """A raster file opened by GDAL, and nothing else by it.

    Raises
    ------
    InputError
        Where it is missing, can't be read, is of a kind that is read from other files, or has a mask or the value of
        missing pixels in one.
    """
    os.environ.setdefault("PROJ_DEBUG", "0")  # PROJ prints what it doesn't find; it looks here when it is loaded
    from rasterio import Env  # heavy
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.io import DatasetReader

    kind = raster_kind(path, expected)
    _require_alone(path)
    logging.getLogger("rasterio").addHandler(_SILENT)  # what GDAL says is in the error
    with warnings.catch_warnings(), Env(**_ENVIRONMENT):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with raster_understood(path, expected):
            file = DatasetReader(path.absolute(), driver=[kind.driver])
        with file:
            _require_own(file, path)
            if kind.stated is not None and (found := (*file.shape, np.dtype(file.dtypes[0]).itemsize)) != kind.stated:
                said = " x ".join(map(str, kind.stated))
                raise InputError(str(path), f"a label of which GDAL takes {found}", f"{said} bytes", "fetch it anew")
            yield file


_HOOKS = threading.RLock()
"""Python's hooks for errors are one for all threads: two that exchange them at once would leave the wrong ones."""


@contextmanager
def raster_understood(path: Path | str, expected: str) -> Iterator[None]:
    """As `understood`, around calls of rasterio."""
    from rasterio._err import CPLE_BaseError  # GDAL's own errors, which rasterio lets through here and there
    from rasterio.errors import RasterioError

    with understood(str(path), expected), _HOOKS:
        hooks = sys.excepthook, sys.unraisablehook  # of rasterio's log, for what GDAL quotes and is no text
        sys.excepthook, sys.unraisablehook = lambda *_: None, lambda _: None
        try:
            yield
        except (RasterioError, CPLE_BaseError) as error:
            raise ValueError(str(error.__cause__ or error)) from None
        finally:
            sys.excepthook, sys.unraisablehook = hooks


def read_band(file: "DatasetReader", path: Path, window: "Window | None" = None, **how: Any) -> NDArray[Any]:
    """The first band of an open raster, or a window of it; `how` as of rasterio's `read`.

    Raises
    ------
    InputError
        Where it can't be read, declares more than its file can hold, or lacks pixels and doesn't say what stands for
        missing ones.
    """
    with raster_understood(path, "a whole raster"):
        _require_held(file, path, window)
        if file.driver == "GTiff":
            _require_blocks(file, path, window)
        return np.asanyarray(file.read(1, window=window, **how))


def require_in_file(path: Path, keys: Collection[str]) -> None:
    """Raise InputError where one of these is in the metadata that GDAL keeps beside a file, and doesn't read here; the
    statistics there change nothing.
    """
    beside = path.with_name(f"{path.name}.aux.xml")
    if not beside.exists():
        return
    said = dict.fromkeys(re.findall(r"<(\w+)", read_bytes(beside, _SIDECAR_SIZE).decode("latin-1")))
    if found := [key for key in said if key in keys]:
        _refuse(path, f"its {', '.join(found)} in {beside.name}")


def _require_alone(path: Path) -> None:
    """Raise InputError where a mask, or the value of missing pixels, is in another file."""
    if path.with_name(f"{path.name}.msk").exists():
        _refuse(path, f"its mask in {path.name}.msk")
    require_in_file(path, ("NoDataValue", "MaskBand"))


def _refuse(path: Path, found: str) -> NoReturn:
    raise InputError(str(path), found, "a file that has everything in it", whole_remedy(path))


def _require_own(file: "DatasetReader", path: Path) -> None:
    """Raise InputError where an open raster leads to another one, has no band, or no place that is finite."""
    if file.tags(ns="OVERVIEWS"):
        _refuse(path, "overviews in another file")
    if file.count < 1:
        raise InputError(str(path), "a file of several rasters", "one", "choose one: gdal_translate")
    bits = file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", "8")
    if bits not in ("8", "16", "32"):
        raise InputError(str(path), f"pixels of {bits} bits", "8, 16 or 32", "gdal_translate -co NBITS=16")
    if not np.all(np.isfinite(file.transform[:6])):
        raise InputError(str(path), "pixels at places that are not finite", "a georeferenced raster, or none")


def _require_held(file: "DatasetReader", path: Path, window: "Window | None") -> None:
    """Raise InputError where pixels take more memory than their file can hold: for it is hollow, or a trap."""
    size = sum(os.stat(name).st_size for name in file.files)
    rows, columns = file.shape if window is None else (int(window.height), int(window.width))
    down, across = file.block_shapes[0]
    bands = file.count if file.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1
    wanted = max(rows * columns, bands * down * across) * max(np.dtype(one).itemsize for one in file.dtypes)
    if wanted > max(_SMALL, _PACKED * size):
        raise InputError(
            str(path), f"{rows} x {columns} pixels ({wanted / 1e6:.0f} MB) in a file of {size / 1e6:.3g} MB",
            f"at most {_PACKED} times its size",
            "fetch it anew; of a hollow one cut out the part that is needed: gdal_translate -projwin",
        )  # fmt: skip


def _require_blocks(file: "DatasetReader", path: Path, window: "Window | None") -> None:
    """Raise InputError where a GeoTIFF lacks a block of pixels, in place of which GDAL gives zeros, or where the check
    sum of one (deflate) is wrong, which GDAL passes over.
    """
    (down, across), (rows, columns), tags = file.block_shapes[0], file.shape, file.tags(ns="IMAGE_STRUCTURE")
    (top, bottom), (left, right) = ((0, rows), (0, columns)) if window is None else window.toranges()
    stated = file.nodata is not None or any(flag.name == "per_dataset" for flag in file.mask_flag_enums[0])
    bands = file.count if tags.get("INTERLEAVE") == "PIXEL" else 1
    with opened(path, ANY_SIZE) as content:
        if down == 1 and _in_one_strip(file, content):
            down = rows  # one block, which GDAL gives row by row
        size = down * across * bands * max(np.dtype(one).itemsize for one in file.dtypes)
        for i, j in product(range(top // down, -(-bottom // down)), range(left // across, -(-right // across))):
            offset, length = (
                file.get_tag_item(f"BLOCK_{what}_{j}_{i}", "TIFF", bidx=1) for what in ("OFFSET", "SIZE")
            )
            if offset is None and not stated:
                raise InputError(
                    str(path), f"no pixels from row {i * down + 1}, column {j * across + 1} on",
                    "a whole raster, or nodata", "fetch it anew; where they are to be missing, state the value of "
                    "such: gdal_edit.py -a_nodata",
                )  # fmt: skip
            if offset is not None and tags.get("COMPRESSION") == "DEFLATE":
                content.seek(int(offset))
                if not _has_end(content, int(length), size):
                    raise ValueError(f"the block at row {i * down + 1}, column {j * across + 1} has no end")


def _has_end(content: BufferedReader, length: int, most: int) -> bool:
    """Whether a deflated block, from here on, is whole, with its check sum, and unpacks to so many bytes at most."""
    block = zlib.decompressobj()
    while not block.eof and most >= 0 and (piece := content.read(min(length, _PIECE))):
        length -= len(piece)
        most -= len(block.decompress(piece))
    return block.eof and most >= 0


def _in_one_strip(file: "DatasetReader", content: BufferedReader) -> bool:
    """Whether a GeoTIFF says that all rows of a band are one strip, and lacks the second: blocks of its rows, which
    GDAL makes of long ones, are no others than where each row is a strip, and most are missing.
    """
    if file.get_tag_item("BLOCK_OFFSET_0_1", "TIFF", bidx=1) is not None:
        return False
    order = "<" if content.read(2) == b"II" else ">"
    big = struct.unpack(f"{order}H", content.read(2)) == (43,)
    content.seek(int(file.get_tag_item("IFD_OFFSET", "TIFF", bidx=1) or 0))
    (count,) = struct.unpack(f"{order}{'Q' if big else 'H'}", content.read(8 if big else 2))
    size = 20 if big else 12
    for _ in range(min(count, _PIECE)):
        entry = content.read(size)
        tag, kind = struct.unpack_from(f"{order}HH", entry)
        if tag == _ROWS_PER_STRIP:
            form = {3: "H", 4: "I", 16: "Q"}[kind]
            return bool(struct.unpack_from(order + form, entry, size - (8 if big else 4))[0] >= file.height)
    return True
