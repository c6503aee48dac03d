"""Raster files by GDAL, each alone: nothing but the file itself is opened, or the data file beside its label.

GDAL opens whatever a file names: sources of a virtual raster, services on the network, overviews that a GeoTIFF says it
has, masks and metadata that lie beside. Here one driver is asked (`raster_kind`); sidecars are not looked for, and
where one would change what is read, the file is refused. So are pixels by the gigabyte that a small file declares.

What a raster file is, by its head, whatever it is called: GDAL's driver for it, and no other, may open it.

A label may lead to data beside it, and nowhere else. GDAL takes damaged keys of labels for absent ones, and these for
zero or the usual: what it needs must be there.

Coordinate reference systems on a body, by its name, are WKT2 and PROJJSON, out of PROJ's registry or of its radii.
Latitudes are planetocentric and longitudes count east, on a sphere of the body's equatorial radius. Where that is the
IAU's (Archinal et al. 2018), the system is that of PROJ's authority IAU_2015, "Mars (2015) - Sphere / Ocentric" (49900)
or "Moon (2015) - Sphere / Ocentric" (30100): its code is the body's NAIF id and 00. Of other radii one is made, which
has the body's name and its radius.

What is written is a cloud-optimized GeoTIFF, made in memory: what does not fit on a disk, GDAL tells nobody when it
closes a file.
"""

import logging
import os
import re
import struct
import sys
import threading
import warnings
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import cache
from io import BufferedReader
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import ANY_SIZE, head_of, opened, read_bytes, understood
from mgsgraph.files.pvl import Block, Document, files_called, label_text, whole_label
from mgsgraph.geometry.body import Ellipsoid, naif_id, target_name

if TYPE_CHECKING:
    from rasterio.io import DatasetReader
    from rasterio.windows import Window

_HEAD = 1 << 20
"""bytes in which a label has to end."""
_NAME = rb"[\w.\-]+"
"""Of a file in the label's folder."""


class _Kind(NamedTuple):
    """Signs of a kind of raster file, and where it names other files."""

    driver: str
    """GDAL's."""
    begins: re.Pattern[bytes]
    """The head of such a file."""
    label_ends: re.Pattern[bytes] | None = None
    """How its label does, where it has one."""
    names: re.Pattern[bytes] | None = None
    """Keys by which the label names files."""
    allowed: re.Pattern[bytes] | None = None
    """The same with a value that is none, or is the name of a file beside it, which is the group of the pattern."""


_PVL_ENDS = re.compile(rb"\n(?:END|End)(?=[ \t]*(?:[\r\n\0]|\Z))")
_KINDS = (
    _Kind("GTiff", re.compile(rb"II[*+]\0|MM\0[*+]")),
    _Kind("PNG", re.compile(rb"\x89PNG\r\n\x1a\n")),
    _Kind("JPEG", re.compile(rb"\xff\xd8\xff")),
    _Kind("VICAR", re.compile(rb"LBLSIZE=\d")),
    _Kind(
        "PDS4", re.compile(rb"\s*<\?xml.{0,3000}<(?:\w+:)?Product_Observational", re.DOTALL),
        re.compile(rb"</(?:\w+:)?Product_Observational>"), re.compile(rb"file_name", re.IGNORECASE),
        re.compile(rb"<file_name>\s*(" + _NAME + rb")\s*</file_name>"),
    ),
)  # fmt: skip
"""Kinds known by their first bytes."""
_CUBE = _Kind(
    "ISIS3", re.compile(rb""), _PVL_ENDS,
    re.compile(rb"\^core|\bformat(?:[\s=\"'(]|(?>/\*.*?\*/)|(?>#[^\n]*))*+geotiff", re.IGNORECASE | re.DOTALL),
    re.compile(rb"\^core\s*=\s*\"?(" + _NAME + rb")\"?\s", re.IGNORECASE),
)  # fmt: skip
_PDS = _Kind(
    "PDS", re.compile(rb""), _PVL_ENDS, re.compile(rb"\^(?:\w*_)?(?:qube|image)\b|compressed_file", re.IGNORECASE),
    re.compile(
        rb"\^(?:\w*_)?(?:qube|image)\s*=\s*(?:\d+(?:\s*<bytes>)?|\(?\s*\"(" + _NAME
        + rb")\"\s*(?:,\s*\d+(?:\s*<bytes>)?\s*)?\)?)\s",
        re.IGNORECASE,
    ),
)  # fmt: skip
"""Kinds known by the labels that `pvl.label_text` knows."""
_BYTES = {
    "unsignedbyte": 1, "signedword": 2, "unsignedword": 2, "signedinteger": 4, "unsignedinteger": 4, "real": 4,
    "double": 8,
}  # fmt: skip
"""Of a pixel, by what ISIS calls its type."""
_OTHERS = {
    rb"\s*(?:<\?xml[^>]*>\s*)?<(?:VRTDataset|OGRVRT)": "a virtual raster (VRT), which names the files to be read",
    rb"\s*(?:<\?xml[^>]*>\s*)?<(?:GDAL_W|WMS_|WCS_|WMTS|GDALTileIndex)": "the description of a service, not a raster",
    rb"\x89HDF": "an HDF5 or netCDF-4 file, which may name others",
    rb"CDF[\1\2\5]": "a netCDF file",
    rb"EHFA_HEADER_TAG": "an Erdas Imagine file, which may name others",
    rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51": "a JPEG 2000 file, whose damage doesn't show",
    rb"PCIDSK": "a PCIDSK file, which may name others",
}
"""By their heads, what users have besides, and GDAL translates."""


class RasterKind(NamedTuple):
    """How a raster file is to be opened."""

    driver: str
    """GDAL's."""
    stated: tuple[int, int, int] | None = None
    """Lines, samples and bytes of a pixel by its PVL label."""


def raster_kind(path: Path, expected: str) -> RasterKind:
    """What a raster file is.

    Raises
    ------
    InputError
        Where it is missing, none of those that are known here, or its label is damaged or leads elsewhere.
    """
    head = head_of(path, _HEAD)
    kind = next((candidate for candidate in _KINDS if candidate.begins.match(head)), None)
    label = label_text(head) if kind is None else None
    if label is not None:
        kind = _PDS if label.startswith("PDS_VERSION_ID") else _CUBE
    if kind is None:
        found = next((name for begin, name in _OTHERS.items() if re.match(begin, head)), "no raster that is known here")
        kinds = "GeoTIFF, ISIS cube, PDS image, VICAR, PNG or JPEG"
        raise InputError(str(path), found, f"{expected} ({kinds})", whole_remedy(path))
    if kind.label_ends is None:
        return RasterKind(kind.driver)
    end = kind.label_ends.search(head)
    if end is None:
        raise InputError(str(path), "a label without an end", f"one within {_HEAD} bytes", "fetch it again")
    _require_beside(path, head, kind)
    if label is None:
        return RasterKind(kind.driver)
    root = whole_label(Document(str(path), label))
    stated, begin = (_of_cube if kind is _CUBE else _of_image)(root)
    if begin is not None and begin < end.end():
        raise InputError(str(path), f"pixels from byte {begin} on, within its label", "behind it", "fetch it again")
    return RasterKind(kind.driver, stated)


def whole_remedy(path: Path) -> str:
    """The command that makes one file of a raster in several."""
    whole = f"{path.stem}_whole.tif" if path.suffix.lower().startswith(".tif") else f"{path.stem}.tif"
    return f"make one GeoTIFF of it: gdal_translate {path.name} {whole}"


def _require_beside(path: Path, head: bytes, kind: _Kind) -> None:
    """Raise InputError where a label names data in another folder, compressed ones, or what is no file; all of the head
    is looked at, for a label that ends here may go on for GDAL.
    """
    if kind.names is None or kind.allowed is None:
        return
    for name in kind.allowed.findall(head):
        for beside in files_called(path, name.decode()) if name else ():
            with opened(beside, ANY_SIZE):  # no pipe, for which GDAL would wait
                pass
    if kind.names.search(kind.allowed.sub(b"", head)):
        raise InputError(
            str(path), "a label whose data are in another folder, or compressed in another file",
            "the data in the file, or in one beside it", whole_remedy(path),
        )  # fmt: skip


def _of_cube(root: Block) -> tuple[tuple[int, int, int], int | None]:
    """What a cube's label states, and the byte of its first pixel, None where that is in another file; InputError where
    it lacks what GDAL needs.
    """
    core = root.inner("IsisCube").inner("Core")
    size, pixels = core.inner("Dimensions"), core.inner("Pixels")
    size.count("Bands")
    for block, key in ((pixels, "ByteOrder"), (core, "Format")):
        block.text(key)
    for key in ("TileSamples", "TileLines") if core.text("Format").lower() == "tile" else ():
        core.count(key)
    each = _BYTES.get(pixels.text("Type").lower())
    if each is None:
        raise InputError(pixels.where("Type"), pixels.text("Type"), f"one of {', '.join(_BYTES)}")
    return (size.count("Lines"), size.count("Samples"), each), None if "^Core" in core else core.count("StartByte") - 1


def _of_image(root: Block) -> tuple[tuple[int, int, int] | None, int | None]:
    """The same of a PDS3 label; nothing of a qube."""
    if "^IMAGE" not in root:
        return None, None
    image = root.inner("IMAGE")
    image.text("SAMPLE_TYPE")
    stated = image.count("LINES"), image.count("LINE_SAMPLES"), image.count("SAMPLE_BITS") // 8
    entry = root.entries["^image"]
    *names, last = [entry.value] if isinstance(entry.value, str) else entry.value
    record = int(last) if last.isdecimal() else 1
    begin = (record - 1) * (1 if entry.unit == "bytes" or record == 1 else root.count("RECORD_BYTES"))
    return stated, None if names or not last.isdecimal() else begin


# --- raster files

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
    with Env(**_ENVIRONMENT):
        with raster_understood(path, expected), warnings.catch_warnings():  # filters, too, are one for all threads
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            file = DatasetReader(path.absolute(), driver=[kind.driver])
        with file:
            _require_own(file, path)
            if kind.stated is not None and (found := (*file.shape, np.dtype(file.dtypes[0]).itemsize)) != kind.stated:
                stated = " x ".join(map(str, kind.stated))
                raise InputError(str(path), f"a label of which GDAL takes {found}", f"{stated} bytes", "fetch it again")
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
        _require_possible_size(file, path, window)
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
    tags = dict.fromkeys(re.findall(r"<(\w+)", read_bytes(beside, _SIDECAR_SIZE).decode("latin-1")))
    if found := [key for key in tags if key in keys]:
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
    require(file.count >= 1, str(path), "a file of several rasters", "one", "choose one: gdal_translate")
    bits = file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", "8")
    if bits not in ("8", "16", "32"):
        raise InputError(str(path), f"pixels of {bits} bits", "8, 16 or 32", "gdal_translate -co NBITS=16")
    if not np.all(np.isfinite(file.transform[:6])):
        raise InputError(str(path), "pixels at places that are not finite", "a georeferenced raster, or none")


def _require_possible_size(file: "DatasetReader", path: Path, window: "Window | None") -> None:
    """Raise InputError where pixels take more memory than their file can hold: it is sparse, or malicious."""
    size = sum(os.stat(name).st_size for name in file.files)
    rows, columns = file.shape if window is None else (int(window.height), int(window.width))
    down, across = file.block_shapes[0]
    bands = file.count if file.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1
    needed = max(rows * columns, bands * down * across) * max(np.dtype(dtype).itemsize for dtype in file.dtypes)
    if needed > max(_SMALL, _PACKED * size):
        raise InputError(
            str(path), f"{rows} x {columns} pixels ({needed / 1e6:.0f} MB) in a file of {size / 1e6:.3g} MB",
            f"at most {_PACKED} times its size",
            "fetch it again; of a hollow one cut out the part that is needed: gdal_translate -projwin",
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
        size = down * across * bands * max(np.dtype(dtype).itemsize for dtype in file.dtypes)
        for i, j in product(range(top // down, -(-bottom // down)), range(left // across, -(-right // across))):
            offset, length = (
                file.get_tag_item(f"BLOCK_{what}_{j}_{i}", "TIFF", bidx=1) for what in ("OFFSET", "SIZE")
            )
            if offset is None and not stated:
                raise InputError(
                    str(path), f"no pixels from row {i * down + 1}, column {j * across + 1} on",
                    "a whole raster, or nodata", "fetch it again; where they are to be missing, state the value of "
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


_AUTHORITY = "IAU_2015"
_SAME = 1e-3
"""m, by which a radius may differ from the IAU's."""


def authority_code(body: Ellipsoid) -> str | None:
    """PROJ's name of the system of planetocentric degrees, such as "IAU_2015:49900"; None where the radius is not the
    IAU's.
    """
    code = _iau_code(body.equatorial)
    return None if code is None else f"{_AUTHORITY}:{code}"


def geographic_crs(body: Ellipsoid) -> dict[str, Any]:
    """Planetocentric degrees on the sphere of a body's equatorial radius, as PROJJSON."""
    return deepcopy(_geographic(body.equatorial))


def equal_area_crs(body: Ellipsoid, longitude: float, latitude: float) -> dict[str, Any]:
    """Lambert's equal-area plane about a place in degrees on that sphere, in m, as PROJJSON.

    PROJ's `+proj=laea` (Snyder 1987, Map Projections, p. 182; EPSG method 1027); its name says the body and the place.
    """
    base = geographic_crs(body)
    where = f"{abs(latitude):g}{'S' if latitude < 0.0 else 'N'} {longitude % 360.0:g}E"
    plane = _of_terms(f"+proj=laea +lat_0={latitude!r} +lon_0={longitude!r} +R={body.equatorial!r} +units=m")
    plane["base_crs"] = {key: base[key] for key in ("name", "datum", "coordinate_system", "id") if key in base}
    plane["name"] = f"{base['name']} / Lambert Azimuthal Equal Area {where}"
    plane["conversion"]["name"] = f"Lambert Azimuthal Equal Area {where}"
    return plane


def wkt2(system: Mapping[str, Any]) -> str:
    """A system that is given as PROJJSON, in the words of ISO 19162:2019."""
    from rasterio.crs import CRS  # PROJ takes its time

    return str(CRS.from_dict(dict(system)).to_wkt(version="WKT2_2019"))


@cache
def _iau_code(radius: float) -> int | None:
    """Code of the IAU's sphere of this radius in m."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    number = naif_id(target_name(Ellipsoid(radius, radius)))
    if number is None:
        return None
    try:
        crs = CRS.from_authority(_AUTHORITY, str(100 * number)).to_dict(projjson=True)
    except CRSError:  # a body whose system the IAU doesn't have, or a PROJ without its systems
        return None
    ellipsoid = crs["datum"]["ellipsoid"]
    return 100 * number if abs(ellipsoid.get("radius", 0.0) - radius) < _SAME else None


@cache
def _geographic(radius: float) -> dict[str, Any]:
    from rasterio.crs import CRS

    code = _iau_code(radius)
    if code is not None:
        return dict(CRS.from_authority(_AUTHORITY, str(code)).to_dict(projjson=True))
    name = target_name(Ellipsoid(radius, radius)).title()
    sphere = f"{'Body' if name == 'Unknown' else name}, sphere of {radius:.3f} m"
    system = _of_terms(f"+proj=longlat +R={radius!r}")
    system["name"], system["datum"]["name"] = f"{sphere} / Ocentric", sphere
    system["datum"]["ellipsoid"]["name"] = sphere
    return system


def _of_terms(terms: str) -> dict[str, Any]:
    """A system by PROJ's own words, as PROJJSON; its names are unknown."""
    from rasterio.crs import CRS

    return dict(CRS.from_proj4(f"{terms} +no_defs").to_dict(projjson=True))


MEDIA_TYPE = "image/tiff; application=geotiff; profile=cloud-optimized"
"""Of such a file, as catalogues name it."""
_BLOCK = 256
"""pixels, side of a file's tiles."""
_LAYOUT = {
    "compress": "DEFLATE", "predictor": "YES", "blocksize": str(_BLOCK), "overview_resampling": "AVERAGE",
    "bigtiff": "IF_SAFER",
}  # fmt: skip
"""Options of GDAL's COG driver; overviews are halved until one fits into a tile."""


@contextmanager
def geotiff(
    path: Path, shape: tuple[int, int, int], crs: str, corner: tuple[float, float], steps: tuple[float, float],
    **kind: Any,
) -> Iterator[Any]:
    """A dataset of rasterio's, to be written; then, when all went well, a file in the layout of GDAL's COG driver.

    The shape is that of bands, rows, columns; the corner (2,), x and y, the upper left one of the first pixel; steps
    (2,) are width and height of a pixel; `kind` is dtype, nodata and what else rasterio takes.
    """
    import rasterio  # takes its time; only who writes one waits for it
    from rasterio.shutil import copy

    count, rows, columns = shape
    with rasterio.MemoryFile() as memory, rasterio.MemoryFile(ext=".tif") as ordered:
        with rasterio.open(
            memory.name, "w", driver="GTiff", width=columns, height=rows, count=count, crs=crs, compress="deflate",
            zlevel=1, transform=rasterio.Affine(steps[0], 0.0, corner[0], 0.0, -steps[1], corner[1]),
            tiled=True, blockxsize=_BLOCK, blockysize=_BLOCK, **kind,
        ) as file:  # fmt: skip
            yield file
        copy(memory.name, ordered.name, driver="COG", **_LAYOUT)  # the driver can't be written to piece by piece
        path.write_bytes(ordered.getbuffer())
