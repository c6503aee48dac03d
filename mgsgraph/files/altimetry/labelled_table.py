"""Tables of laser shots by their PDS3 labels.

A PDS3 table has its label beside it, and columns by the label's own names, bytes and units: for products whose layout
no source that could be read gives in full: Kaguya's LALT_LGT_TS and LALT_RD (JAXA, data set SLN-L-LALT-4-TOPO-LGT-TS)
and MESSENGER's binary MLARDR. What a column means is taken from its name, and its unit from its UNIT, as Clementine's
profiles (CLEM1-L-LIDAR-5-TOPO) have UNIVERSAL TIME, and LONGITUDE and LATITUDE in DEGREE; where either leaves a doubt
the file is refused with the columns that the label has. A label of LOLA RDR leads to its records, whose layout is
known.

What a label says a second time (edges in longitude and latitude, first and last time, body) is held against the shots.
"""

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.binary import RECORD, lola_shots
from mgsgraph.files.altimetry.shot_values import crossings, known_ranges, positions, require_records, shots_with
from mgsgraph.files.altimetry.tables import plain_name
from mgsgraph.files.geometric_keys import SHOT_LABEL, all_blocks, require_once, require_usual, texts
from mgsgraph.files.opening import number_of, read_bytes
from mgsgraph.files.pvl import Block, Document, files_called, whole_label
from mgsgraph.geometry.altimetry import ALTIMETERS, ANY, Altimeter, AltimeterShots
from mgsgraph.geometry.body import Ellipsoid, in_turn, planetocentric, require_possible
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.names import Names
from mgsgraph.units import DEG, KM

_GROUND = r"(foot(print)?|spot|pt|point|topo(graphic)?|ground|surface|geoc(entric)?|east|planetocentric)*"
_MEANINGS = {
    "longitude": rf"{_GROUND}lon(g(itude)?)?(east)?",
    "latitude": rf"{_GROUND}lat(itude)?",
    "radius": rf"{_GROUND}(planetary|planet)?radius",
    "height": r"(topo(graphy|graphic)?)(height|elevation)?|height|elevation",
    "utc": r"utc|(utc|universal|shot|observation|transmit)time(utc)?|time",
    "tdb": r"(ephemeris|et|tdb)(time|seconds)?",
    "range": r"range(oneway)?|onewayrange|1wayrange",
}
"""Plain names of columns by what they mean; the first two, one of the next two, and a time are needed."""
_ANGLES = {"deg": DEG, "degree": DEG, "degrees": DEG, "rad": 1.0, "radian": 1.0, "radians": 1.0}
_LENGTHS = {
    "mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0, "meter": 1.0, "meters": 1.0,
    "metre": 1.0, "metres": 1.0, "km": KM, "kilometer": KM, "kilometers": KM, "kilometre": KM,
}  # fmt: skip
_SECONDS = dict.fromkeys(("s", "sec", "second", "seconds"), 1.0)
_UNITS = {"longitude": _ANGLES, "latitude": _ANGLES, "tdb": _SECONDS} | dict.fromkeys(
    ("radius", "height", "range"), _LENGTHS
)
"""rad, m or s, by what a column means."""
_NONES = ("MISSING_CONSTANT", "INVALID_CONSTANT", "NULL_CONSTANT", "UNKNOWN_CONSTANT", "NOT_APPLICABLE_CONSTANT")
_EDGES = {
    "MINIMUM_LATITUDE": (1, 1.0), "MAXIMUM_LATITUDE": (1, -1.0), "MINIMUM_LONGITUDE": (0, 1.0),
    "MAXIMUM_LONGITUDE": (0, -1.0), "WESTERNMOST_LONGITUDE": (0, 1.0), "EASTERNMOST_LONGITUDE": (0, -1.0),
}  # fmt: skip
"""Of a label: the coordinate, and on which side of it shots lie."""
_NO_CONSTANT, _DIGITS = ("N/A", "NONE", "NULL", "UNK", "UNKNOWN"), 1e-6
"""Words for no such constant, and the share by which it may differ from what the table has: single precision."""
_DIRECTION, _HALF_TURN = "POSITIVE_LONGITUDE_DIRECTION", 179.0
_BESIDE, _AROUND = 0.05, 60.0
"""Degrees and s by which shots may lie outside a label's edges and times."""
_SAME_HEIGHT = 50.0
"""m by which radii may be off heights above the altimeter's sphere."""
_OFF = 0.02
"""Share by which the median radius may be off a label's."""
_TYPES = {
    "lsb_integer": "<i", "lsb_unsigned_integer": "<u", "pc_integer": "<i", "pc_unsigned_integer": "<u", "pc_real": "<f",
    "msb_integer": ">i", "msb_unsigned_integer": ">u", "integer": ">i", "unsigned_integer": ">u", "ieee_real": ">f",
    "real": ">f",
}  # fmt: skip
_SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
"""Bytes of a number, by the letter of its type."""
_LARGEST = 1e15
"""m, rad or s: no number of an altimeter."""
_AS_CSV = "write a CSV with longitude_deg, latitude_deg, radius_m, time_s and range_m"


@dataclass(frozen=True, slots=True)
class Column:
    """One column, by its label."""

    block: Block
    name: str
    """Plain."""
    start: int
    """Of its first byte in a row, from 0."""
    size: int
    """bytes."""


def is_label(content: bytes) -> bool:
    """Whether a text file is a PDS3 label."""
    return content.lstrip()[:14].upper() == b"PDS_VERSION_ID"


def read_labelled_shots(path: Path, clock_bias: float = 0.0) -> AltimeterShots:
    """Shots of the table that a detached label names.

    InputError where the label has no table, a file that it names is not there, or its columns leave open what they are.
    """
    root = whole_label(_document(path))
    table = next((block for block in root.blocks if block.name.endswith("table")), None)
    if table is None:
        raise InputError(str(path), "a label without a TABLE", "the label of a table of laser shots")
    pointer = next((key for key in root.entries if key.startswith("^") and key.endswith("table")), "")
    data = _beside(path, root, pointer)
    content = read_bytes(data)
    if "LOLA-3-RDR" in str(root.entries["data_set_id"].value if "DATA_SET_ID" in root else "").upper():
        require_records(root, -(-len(content) // RECORD.itemsize))
        require_usual(texts(root), SHOT_LABEL, str(path))
        shots = lola_shots(content, path, clock_bias)
        _require_stated(shots, root)
        return shots
    return _Rows(path, root, table, content).shots(clock_bias)


def require_whole(path: Path, content: bytes) -> None:
    """Raise InputError where LOLA's records in a file are not as many as a label beside it counts."""
    for label in (path.with_suffix(ending) for ending in (".LBL", ".lbl")):
        if label.is_file():
            require_records(whole_label(_document(label)), -(-len(content) // RECORD.itemsize))
            return


def _beside(path: Path, block: Block, key: str) -> Path:
    """The file that a pointer names, in the label's folder, whatever the case of its letters."""
    require(key, str(path), "no pointer such as ^TABLE", "the label of a table in a file of its own")
    items = block.words(key)
    if len(items) > 1 and items[1] != "1":
        raise InputError(block.where(key), f"a table from {items[1]} on in its file", "a table that is all of its file")
    name = items[0] if items else ""
    if not (files := files_called(path, name)):
        raise InputError(block.where(key), f"{name}, which is not beside the label", "the file", "fetch it, too")
    return files[0]


def _document(path: Path) -> Document:
    """A label's text."""
    return Document(str(path), read_bytes(path).decode("latin-1").replace("\r\n", "\n"))


class _Rows:
    """Rows of a table by its label."""

    def __init__(self, path: Path, root: Block, table: Block, content: bytes) -> None:
        self.path, self._binary = path, table.text("INTERCHANGE_FORMAT").upper() == "BINARY"
        blocks = list(table.blocks)
        if "^STRUCTURE" in table:
            structure = _beside(path, table, "^structure")
            blocks += whole_label(_document(structure)).blocks
        self._columns = [
            Column(block, plain_name(block.text("NAME")), block.count("START_BYTE") - 1, block.count("BYTES"))
            for block in blocks if block.name == "column"
        ]  # fmt: skip
        size = table.count("ROW_BYTES")
        rows, rest = divmod(len(content), size)
        require(rows and not rest, str(path), f"{len(content)} bytes", f"whole rows of {size} bytes, as the label says")
        if "ROWS" in table and table.count("ROWS") != rows:
            found, remedy = f"{table.count('ROWS')}, and {rows} rows in the file", "fetch label and table again"
            raise InputError(table.where("ROWS"), found, "as many", remedy)
        for column in self._columns:
            if column.start + column.size > size:
                found = f"bytes {column.start + 1} .. {column.start + column.size} of a row"
                raise InputError(column.block.where("BYTES"), found, f"1 .. {size}, as ROW_BYTES says")
        self._rows = np.frombuffer(content, f"{'V' if self._binary else 'S'}{size}")
        instrument = str(root.entries["instrument_id"].value) if "INSTRUMENT_ID" in root else ""
        self._altimeter: Altimeter = ALTIMETERS.get(instrument.upper(), ANY)

        self._require_columns(table)
        require_once(root, SHOT_LABEL)
        for block in (*all_blocks(root), *(column.block for column in self._columns)):
            require_usual(texts(block), SHOT_LABEL, block.where())
        self._labels = tuple({id(block): block for block in (*all_blocks(root), *blocks)}.values())
        self._around = (root, table)

    def _require_columns(self, table: Block) -> None:
        """Raise InputError where columns overlap, or are not as many as the label counts."""
        if "COLUMNS" in table and table.count("COLUMNS") != len(self._columns):
            found = f"{table.count('COLUMNS')}, and {len(self._columns)} described"
            raise InputError(table.where("COLUMNS"), found, "as many", "fetch label and table again")
        ordered = sorted(self._columns, key=lambda column: column.start)
        for before, after in pairwise(ordered):
            if (end := before.start + before.size) > after.start:
                found = f"bytes {before.start + 1} .. {end}, and {after.block.text('NAME')} begins at {after.start + 1}"
                raise InputError(before.block.where("BYTES"), found, "columns side by side")

    def shots(self, clock_bias: float) -> AltimeterShots:
        """The shots of all rows, in their order; those without a place or radius are no ground returns."""
        columns = {meaning: self._column(meaning) for meaning in _MEANINGS}
        radius, height = columns["radius"], columns["height"]
        if columns["longitude"] is None or columns["latitude"] is None or (radius is None and height is None):
            raise self._unknown("longitude, latitude, and radius or topography")
        above = self._altimeter.height_sphere if radius is None else 0.0
        if np.isnan(above):
            raise InputError(
                str(self.path), f"heights of {self._altimeter.name} without radii, above an unknown surface",
                "a column of radii, or INSTRUMENT_ID = LALT, whose heights stand above 1737.4 km", _AS_CSV,
            )
        if radius is not None and height is not None and not np.isnan(self._altimeter.height_sphere):
            self._require_same_heights(radius, height)
        lengths, has_radius = self._valid(radius or height, "radius" if radius else "height")
        places = [self._valid(columns[name], name) for name in ("longitude", "latitude")]
        ground = has_radius & places[0][1] & places[1][1]
        require(np.any(ground), str(self.path), f"{ground.size} rows without a ground return", "some with one")
        times, n = self._times(columns["tdb"], columns["utc"]), self._rows.size
        unknown = np.full(n, np.nan), np.zeros(n, dtype=bool)
        ranges, has_range = self._valid(columns["range"], "range") if columns["range"] is not None else unknown
        degrees = np.column_stack([values for values, _ in places]) / DEG
        if self._west:
            degrees[:, 0] = np.mod(-degrees[:, 0], 360.0)
        radii = above + np.where(ground, lengths, np.median(lengths[ground]))
        shots = shots_with(
            str(self.path), self._altimeter, times + clock_bias,
            positions(np.where(ground[:, None], degrees, 0.0), radii, lambda k: f"{self.path}, row {k + 1}"),
            orbits=crossings(times, str(self.path)), ground=ground,
            ranges=known_ranges(np.where(has_range, ranges, np.nan), np.ones(n, dtype=bool)),
        )  # fmt: skip
        for label in self._labels:
            _require_stated(shots, label, self._west)
        return shots

    def _require_same_heights(self, radius: Column, height: Column) -> None:
        """Raise InputError where radii minus the altimeter's sphere are not the heights in the same rows."""
        both = [self._valid(radius, "radius"), self._valid(height, "height")]
        off = np.abs(both[0][0] - both[1][0] - self._altimeter.height_sphere)[both[0][1] & both[1][1]]
        if off.size and np.median(off) > _SAME_HEIGHT:
            found = f"radii {np.median(off):.0f} m off {height.block.text('NAME')} (median)"
            raise InputError(radius.block.where("NAME"), found, "the same ground", "look at the columns' units")

    @property
    def _west(self) -> bool:
        """Whether the label counts longitudes westward."""
        directions = dict[str, Block]()
        for label in self._labels:
            if _DIRECTION in label:
                directions[label.text(_DIRECTION).upper()] = label
        for direction, label in directions.items():
            if direction not in ("EAST", "WEST") or len(directions) > 1:
                raise InputError(label.where(_DIRECTION), " and ".join(directions), "EAST or WEST")
        return "WEST" in directions

    def _valid(self, column: Column | None, meaning: str) -> tuple[Array, Mask]:
        """Values of a column in rad, m or s, and which of them are valid: not the constants for missing values."""
        assert column is not None
        block, raw = column.block, self._raw(column)
        valid = np.ones(raw.size, dtype=bool)
        values = self._measured(column, meaning, raw, valid)
        factor = block.number("SCALING_FACTOR") if "SCALING_FACTOR" in block else 1.0
        for label in (block, *self._around):
            for key in _NONES:
                if key in label and label.text(key).upper() not in _NO_CONSTANT:
                    none = label.number(key)
                    valid &= ~(np.isclose(raw, none, rtol=_DIGITS) | np.isclose(raw * factor, none, rtol=_DIGITS))
        return np.where(valid, values, np.nan), valid

    def _unknown(self, expected: str) -> InputError:
        names = ", ".join(column.block.text("NAME") for column in self._columns)
        return InputError(
            str(self.path), f"the columns {names}"[:200], expected, _AS_CSV,
        )

    def _column(self, meaning: str) -> Column | None:
        fits = [column for column in self._columns if re.fullmatch(_MEANINGS[meaning], column.name)]
        if len(fits) > 1:
            raise self._unknown(f"one column for the {meaning}")
        return fits[0] if fits else None

    def _bytes(self, column: Column) -> NDArray[np.uint8]:
        """(n, size) bytes of a column, shot by shot."""
        whole = self._rows.view(np.uint8).reshape(self._rows.size, -1)
        return np.ascontiguousarray(whole[:, column.start : column.start + column.size])

    def _texts(self, column: Column) -> NDArray[np.bytes_]:
        """(n,) without blanks, quotation marks and the zeros that fill up a row."""
        return np.char.strip(self._bytes(column).view(f"S{column.size}")[:, 0], b' "')

    def _raw(self, column: Column) -> Array:
        """Numbers of a column as written in the file."""
        if not self._binary:
            return self._numbers(column)
        block = column.block
        kind = block.text("DATA_TYPE").lower()
        require(kind in _TYPES, block.where("DATA_TYPE"), kind, ", ".join(_TYPES))
        sizes = _SIZES[_TYPES[kind][1]]
        if column.size not in sizes:
            found = f"{kind} of {column.size} bytes"
            raise InputError(block.where("BYTES"), found, " or ".join(map(str, sizes)), _AS_CSV)
        return self._bytes(column).view(f"{_TYPES[kind]}{column.size}")[:, 0].astype(np.float64)

    def _measured(self, column: Column, meaning: str, raw: Array, valid: Mask) -> Array:
        """Numbers of a column in m, rad or s; NaN where there is none."""
        block, units = column.block, _UNITS[meaning]
        unit = block.text("UNIT").lower() if "UNIT" in block else ""
        if unit not in units:
            found = f"the unit {unit!r} of {block.text('NAME')}" if unit else f"no UNIT of {block.text('NAME')}"
            raise InputError(block.where("UNIT"), found, ", ".join(units))
        factor = block.number("SCALING_FACTOR") if "SCALING_FACTOR" in block else 1.0
        offset = block.number("OFFSET") if "OFFSET" in block else 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.where(valid, (raw * factor + offset) * units[unit], np.nan)
        for k in np.flatnonzero(valid & ~(np.abs(values) < _LARGEST))[:1]:
            raise InputError(f"{self.path}, row {k + 1}, {column.name}", f"{values[k]:g}", "a number that can be")
        return values

    def _numbers(self, column: Column) -> Array:
        """Numbers of a column of text."""
        texts = self._texts(column)
        try:
            return texts.astype(np.float64)
        except ValueError:
            places = (f"{self.path}, row {k + 1}, {column.name}" for k in range(texts.size))
            return np.array([number_of(text.decode("latin-1"), at) for text, at in zip(texts, places, strict=True)])

    def _times(self, tdb: Column | None, utc: Column | None) -> Array:
        if tdb is not None:
            return self._measured(tdb, "tdb", self._raw(tdb), np.ones(self._rows.size, dtype=bool))
        if utc is None:
            raise self._unknown("a column UTC or EPHEMERIS_TIME")
        texts = (text.decode("latin-1").replace("/", "-").replace(" ", "T") for text in self._texts(utc).tolist())
        return tdb_of_utc(Names.of(list(texts)), str(self.path))


def _require_stated(shots: AltimeterShots, label: Block, west: bool = False) -> None:
    """Raise InputError where a label's edges, times or body are not those of its ground returns."""
    ground = shots.ground
    longitudes, latitudes, radii = planetocentric(shots.footprints[ground]).T
    longitudes = -longitudes if west else longitudes
    stated = {key: label.number(key) for key in _EDGES if key in label}
    for key, edge in stated.items():
        axis, side = _EDGES[key]
        if axis == 0 and any(abs(edge - stated[other]) > _HALF_TURN for other in stated if _EDGES[other][0] == 0):
            continue  # all around
        off = side * ((latitudes if axis else longitudes) / DEG - edge)
        off = off if axis else in_turn(off * DEG) / DEG
        if off.min() < -_BESIDE:
            found = f"{edge:g} degrees, {-off.min():.4g} degrees inside the shots"
            raise InputError(label.where(key), found, "the shots' own edge", "look at the unit and way of longitudes")
    for key, side in (("START_TIME", 1.0), ("STOP_TIME", -1.0)):
        if key in label and label.text(key)[:1].isdigit():
            (time,) = tdb_of_utc([label.text(key).removesuffix("Z")], label.where(key))
            late = side * (shots.times[ground] - time)
            if late.min() < -_AROUND:
                raise InputError(label.where(key), f"{-late.min():.0f} s inside the shots' times", "their own edge")
    median = float(np.median(radii))
    if "TARGET_NAME" in label:
        require_possible(Ellipsoid(median, median), label.text("TARGET_NAME"), label.where("TARGET_NAME"))
    for key in ("A_AXIS_RADIUS", "C_AXIS_RADIUS"):
        if key in label and abs(median / (label.number(key, {"km": KM, "m": 1.0, "": KM})) - 1.0) > _OFF:
            found, expected = f"{label.text(key)}", f"about {median / KM:.1f} km, as the shots have it"
            raise InputError(label.where(key), found, expected)
