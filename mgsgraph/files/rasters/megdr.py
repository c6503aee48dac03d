"""MOLA gridded records (MEGDR), simple cylindrical, to a TerrainGrid: planetary radius, topography, areoid or counts.

A grid's place comes from its PDS3 label (``.lbl`` beside the ``.img``) or, without one, from its name
``MEG{A,C,R,T}{latitude}{N,S}{longitude}{resolution}{version}.IMG``, which gives the upper left corner, and its size.
Where posts lie follows MAP_RESOLUTION and the projection offsets (dsmap.cat: whole lines and samples are pixel centres,
the first is 1); GDAL's georeferencing of these labels is one pixel off, and is not used.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.geometric_keys import GRID_LABEL, all_blocks, require_once, require_usual, texts
from mgsgraph.files.opening import ANY_SIZE, opened, read_text, understood
from mgsgraph.files.pvl import Block, Document, files_called, flat_label, whole_label
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid, TerrainKind, window
from mgsgraph.units import DEG, KM

REFERENCE_RADIUS = 3_396_000.0
"""m, taken off the radii of the planet and of the areoid before they were stored in 16 bits."""
_NAME = re.compile(r"meg([acrt])(\d\d)([ns])(\d{3})([c-h])\w\.img", re.IGNORECASE)
_KINDS: dict[str, TerrainKind] = {"A": "areoid", "C": "counts", "R": "radius", "T": "topography"}
_COARSEST, _FINEST = 0.01, 1e4
"""Pixels per degree; MEGDR has 4 to 128, 512 at the poles."""
_RESOLUTIONS = {"C": 4, "D": 8, "E": 16, "F": 32, "G": 64, "H": 128}
"""pixels per degree, by the letter in the name."""
_SHAPES = {"C": (180, 360), "D": (180, 360), "E": (180, 360), "F": (180, 360), "G": (90, 180), "H": (44, 90)}
"""degrees of latitude and longitude in one file."""
_NAMES = "MEGR90N000CB.IMG (radius), MEGT... (topography), MEGA... (areoid) or MEGC... (counts)"
_SAMPLES = {"MSB_INTEGER 16": ">i2", "INTEGER 16": ">i2"}
_COUNTS = {f"{sign}INTEGER {bits}": kind for sign in ("MSB_", "", "UNSIGNED_", "MSB_UNSIGNED_")
           for bits, kind in ((8, "u1"), (16, ">u2"))}  # fmt: skip
"""NumPy's types of the labels' samples; counts are no less than zero whatever these say."""
_MARGIN = 4
"""Posts kept beyond the points around which a grid is read."""
_ROWS, _SPAN = 64, 0.3
"""Rows, and the least span of squares of their latitudes' sines, by which heights are held against what they are."""
_FALL = {"radius": (5e3, np.inf), "areoid": (5e3, np.inf), "topography": (-np.inf, 13e3)}
"""m, by which the means of rows fall from the equator to a pole. Of MEGDR's 22 tiles (and the whole) those of radii do
so by 7.3 to 28.2 km, for the polar radius is 20 km less, those of topography by -10.2 to 10.2 km.
"""
_MOST = 1e8
"""m, of a label's scale and offset."""
_PART = 0.05
"""Posts by which a label's edges may be off."""
_LOWEST_ROW = -9e3
"""m, of topography, whose lowest post is -8.1 km."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """How a file is to be read, and where its first post lies."""

    kind: TerrainKind
    lines: int
    samples: int
    resolution: float
    """pixels per degree."""
    longitude: float
    latitude: float
    """degrees, centre of the first pixel."""
    offset: float
    """m, to be added."""
    scale: float
    """m per count."""
    skipped: int
    """bytes before the first pixel."""
    types: tuple[str, ...] = (">i2",)
    """NumPy's, of a pixel; of several that which the file's size says."""


def read_megdr(
    path: Path, vertical_sigma: float | None = None, planimetric_sigma: float | None = None, near: Array | None = None
) -> TerrainGrid | None:
    """Read a MEGDR grid of 16-bit numbers (or 8, of counts), or the part of it around points; None where none of it is
    there.

    Parameters
    ----------
    path : Path
        The image file or its label, ``.img`` or ``.lbl``.
    vertical_sigma, planimetric_sigma : float, optional
        m, handed on to the grid; the files don't say.
    near : (n, 3), optional
        m, body-fixed; all of the grid when absent.

    Returns
    -------
    TerrainGrid
        Its `kind` says whether posts are radii, heights above the areoid, radii of the areoid, or numbers of shots.

    Raises
    ------
    InputError
        Where neither label nor name say what the file is, the label is for another projection or sample type, the
        file's size is not what they say, or its heights tell that it is of another kind.
    """
    image, label = _files(path)
    layout = _from_label(label, image) if label is not None else _from_name(image)
    expected = {layout.skipped + layout.lines * layout.samples * np.dtype(kind).itemsize: kind for kind in layout.types}
    with opened(image, ANY_SIZE) as file, understood(str(image), "a MEGDR grid"):
        size = os.fstat(file.fileno()).st_size
        if size not in expected:
            wanted = f"{layout.lines} lines x {layout.samples} samples x {np.dtype(layout.types[0]).itemsize} bytes"
            raise InputError(str(image), f"{size} bytes", f"{next(iter(expected))}: {wanted}", "fetch it again")
        counts = np.memmap(file, expected[size], "r", layout.skipped, (layout.lines, layout.samples))
    _require_kind(layout, counts, image)
    step, wraps = DEG / layout.resolution, abs(layout.samples - 360.0 * layout.resolution) < 0.5
    first = np.array([layout.latitude, layout.longitude]) * DEG
    rows, columns = slice(0, layout.lines), np.arange(layout.samples)
    if near is not None:
        longitudes, latitudes, _ = planetocentric(near).T
        at = np.column_stack([first[0] - latitudes, longitudes - first[1]]) / step
        part = window(at, counts.shape, _MARGIN, 2.0 * np.pi / step, wraps)
        if part is None:
            return None
        rows, columns = part
    # counts are whole metres below 2^15: float32 holds them and the radii (to 0.25 m) in half the memory
    posts = counts[rows][:, columns].astype(np.float32) * np.float32(layout.scale) + np.float32(layout.offset)
    return TerrainGrid(
        str(image), posts, float(first[1] + columns[0] * step), float(first[0] - rows.start * step), step, step,
        wraps=wraps and columns.size == layout.samples, kind=layout.kind, vertical_sigma=vertical_sigma,
        planimetric_sigma=planimetric_sigma,
    )  # fmt: skip


def _require_kind(layout: _Layout, counts: NDArray[Any], image: Path) -> None:
    """Raise InputError where the heights tell that a grid is not what its name or label says: radii and the areoid fall
    towards the poles, topography doesn't.
    """
    rows = np.unique(np.linspace(0, layout.lines - 1, _ROWS).astype(np.int64))
    latitudes = layout.latitude - rows / layout.resolution
    if not np.all(np.abs(latitudes) <= 90.0):
        found = f"latitudes from {latitudes[0]:g} to {latitudes[-1]:g} deg"
        raise InputError(str(image), found, "-90 .. 90", "look at LINE_PROJECTION_OFFSET, MAP_RESOLUTION and the name")
    squares = np.sin(latitudes * DEG) ** 2
    if layout.kind == "counts" or np.ptp(squares) < _SPAN:
        return
    means = counts[rows].mean(axis=1) * layout.scale + layout.offset
    fall = -float(np.polyfit(squares, means, 1)[0])
    low, high = _FALL[layout.kind]
    if not low <= fall <= high or (layout.kind == "topography" and means.min() < _LOWEST_ROW):
        raise InputError(
            str(image), f"{layout.kind} that falls by {fall / KM:.1f} km from the equator to the poles",
            "topography above the areoid, as level there" if layout.kind == "topography" else
            "radii, which fall by about 20 km", "take the file that its name and label say: MEGR... holds radii, "
            "MEGT... topography, MEGA... the areoid",
        )  # fmt: skip


def _files(path: Path) -> tuple[Path, Path | None]:
    """The image file and its label, if it has one; either may be given, in any case of letters."""
    if path.suffix.lower() == ".lbl":
        image = path.with_suffix(".img")
        return next(iter(files_called(path, image.name)), image), path
    return path, next(iter(files_called(path, path.with_suffix(".lbl").name)), None)


def _kind(name: str, where: str) -> TerrainKind:
    letter = name[3:4].upper() if name[:3].upper() == "MEG" else ""
    require(letter in _KINDS, where, f"the product {name!r}", _NAMES)
    return _KINDS[letter]


def _from_name(path: Path) -> _Layout:
    match = _NAME.fullmatch(path.name)
    if not match:
        raise InputError(str(path), "a name without position, and no label", _NAMES, "fetch its label, too")
    _, latitude, side, longitude, letter = match.groups()
    resolution = _RESOLUTIONS[letter.upper()]
    high, wide = _SHAPES[letter.upper()]
    kind = _kind(path.name, str(path))
    return _Layout(
        kind, high * resolution, wide * resolution, resolution,
        float(longitude) + 0.5 / resolution,
        float(latitude) * (1.0 if side.upper() == "N" else -1.0) - 0.5 / resolution,
        _usual_offset(kind), 1.0, 0, ("u1", ">u2") if kind == "counts" else (">i2",),
    )


def _usual_offset(kind: TerrainKind) -> float:
    """m, where no label says."""
    return REFERENCE_RADIUS if kind in ("radius", "areoid") else 0.0


def _from_label(path: Path, image: Path) -> _Layout:
    text = read_text(path)
    label, root = flat_label(text, str(path)), whole_label(Document(str(path), text.replace("\r\n", "\n")))
    require_once(root, GRID_LABEL)
    for block in all_blocks(root):
        require_usual(texts(block), GRID_LABEL, str(path))
    _require_one_kind(label, image)
    projection = label.text("MAP_PROJECTION_TYPE").upper().replace("_", " ")
    require(projection == "SIMPLE CYLINDRICAL", f"{path}, MAP_PROJECTION_TYPE", projection, "SIMPLE CYLINDRICAL")
    kind = _kind(label.text("PRODUCT_ID") if "PRODUCT_ID" in label else image.name, str(path))
    sample = f"{label.text('SAMPLE_TYPE').upper()} {label.count('SAMPLE_BITS')}"
    types = _SAMPLES | (_COUNTS if kind == "counts" else {})
    if sample not in types:
        expected = "MSB_INTEGER 16" + (", or 8 bits" if kind == "counts" else "")
        raise InputError(f"{path}, SAMPLE_TYPE and SAMPLE_BITS", sample, expected)
    resolution = label.number("MAP_RESOLUTION")
    if not _COARSEST <= resolution <= _FINEST:
        expected = f"{_COARSEST:g} to {_FINEST:g}"
        raise InputError(f"{path}, MAP_RESOLUTION", f"{resolution:g} pixels per degree", expected)
    if label.number("CENTER_LATITUDE") != 0.0:
        raise InputError(f"{path}, CENTER_LATITUDE", f"{label.number('CENTER_LATITUDE'):g}", "0, the projection's own")
    offset = label.number("OFFSET") if "OFFSET" in label else _usual_offset(kind)
    scale = label.number("SCALING_FACTOR") if "SCALING_FACTOR" in label else 1.0
    if not (0.0 < scale < _MOST and abs(offset) < _MOST):
        found = f"{scale:g} m per count, from {offset:g} m on"
        raise InputError(f"{path}, SCALING_FACTOR and OFFSET", found, "those of heights or radii of Mars in m")
    if kind != "counts" and (offset != _usual_offset(kind) or scale != 1.0):
        found, expected = f"{scale:g} m per count, from {offset:g} m on", f"1 m and {_usual_offset(kind):g} m of {kind}"
        raise InputError(f"{path}, SCALING_FACTOR and OFFSET", found, expected, "convert it to a GeoTIFF with them")
    layout = _Layout(
        kind, label.count("LINES"), label.count("LINE_SAMPLES"), resolution,
        label.number("CENTER_LONGITUDE") + (1.0 - label.number("SAMPLE_PROJECTION_OFFSET")) / resolution,
        (label.number("LINE_PROJECTION_OFFSET") - 1.0) / resolution,
        offset, scale, _skipped(label), (types[sample],),
    )
    _require_stated_place(layout, label, image)
    return layout


def _require_one_kind(label: Block, image: Path) -> None:
    """Raise InputError where product, pointer and file name belong to different kinds of grids."""
    names = [image.name, *(label.words(key)[0] for key in ("PRODUCT_ID", "^IMAGE", "FILE_NAME") if key in label)]
    kinds = {name[3:4].upper(): name for name in names if re.match(r"MEG[ACRT]\d", name, re.IGNORECASE)}
    if len(kinds) > 1:
        raise InputError(label.document.source, " and ".join(kinds.values()), "one kind of grid", "fetch them again")


def _require_stated_place(layout: _Layout, label: Block, image: Path) -> None:
    """Raise InputError where a grid's edges, its scale or its name are not those of its resolution and offsets."""
    north, west = layout.latitude + 0.5 / layout.resolution, layout.longitude - 0.5 / layout.resolution
    south, east = north - layout.lines / layout.resolution, west + layout.samples / layout.resolution
    scale = label.number("A_AXIS_RADIUS") * DEG / layout.resolution if "A_AXIS_RADIUS" in label else 0.0
    for keys, computed, slack in (
        ("MAXIMUM_LATITUDE", north, _PART / layout.resolution), ("MINIMUM_LATITUDE", south, _PART / layout.resolution),
        ("WESTERNMOST_LONGITUDE WEST_LONGITUDE", west, _PART / layout.resolution),
        ("EASTERNMOST_LONGITUDE EAST_LONGITUDE", east, _PART / layout.resolution), ("MAP_SCALE", scale, 0.01 * scale),
        ("LINE_LAST_PIXEL", layout.lines, 0.0), ("SAMPLE_LAST_PIXEL", layout.samples, 0.0),
    ):  # fmt: skip
        for key in keys.split():
            if key not in label or (key == "MAP_SCALE" and not scale):
                continue
            off = abs(label.number(key) - computed)
            if min(off, abs(off - 360.0) if "LONGITUDE" in key else off) > slack:
                expected = f"{computed:.9g}, as the label's other keys say"
                raise InputError(label.where(key), f"{label.number(key):.9g}", expected, "fetch label and grid again")
    if _NAME.fullmatch(image.name):
        named = _from_name(image)
        turn = (named.longitude - layout.longitude + 180.0) % 360.0 - 180.0
        off = max(abs(named.latitude - layout.latitude), abs(turn))
        if named.resolution != layout.resolution or off > _PART / layout.resolution:
            at = f"first post at {layout.latitude:.6g} N, {layout.longitude:.6g} E, {layout.resolution:g} per degree"
            expected = f"{named.latitude:.6g} N, {named.longitude:.6g} E, {named.resolution:g}, as the name says"
            raise InputError(label.document.source, at, expected, "fetch label and grid again")


def _skipped(label: Block) -> int:
    """Bytes before the image, of a label that stands at the head of its file."""
    return label.count("LABEL_RECORDS") * label.count("RECORD_BYTES") if "LABEL_RECORDS" in label else 0
