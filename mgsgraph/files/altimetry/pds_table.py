"""Laser shots in a PDS3 table with its label beside it: columns by the label's own names, bytes and units.

For products whose layout no source that could be read gives in full: Kaguya's LALT_LGT_TS and LALT_RD (JAXA, data set
SLN-L-LALT-4-TOPO-LGT-TS) and MESSENGER's binary MLARDR. What a column means is taken from its name, and its unit from
its UNIT, as Clementine's profiles (CLEM1-L-LIDAR-5-TOPO) have UNIVERSAL TIME, and LONGITUDE and LATITUDE in DEGREE;
where either leaves a doubt the file is refused with the columns that the label has. A label of LOLA RDR leads to its
records, whose layout is known.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lola import RECORD, lola_shots
from mgsgraph.files.altimetry.shot_values import crossings, known_ranges, positions, require_records, shots_with
from mgsgraph.files.altimetry.tables import plain_name
from mgsgraph.files.opening import number_of, read_bytes
from mgsgraph.files.pvl import Block, Document, whole_label
from mgsgraph.geometry.altimetry import ALTIMETERS, ANY, Altimeter, AltimeterShots
from mgsgraph.geometry.records import Array
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
_UNITS = {
    "deg": DEG, "degree": DEG, "degrees": DEG, "rad": 1.0, "radian": 1.0, "radians": 1.0,
    "mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0, "meter": 1.0, "meters": 1.0,
    "metre": 1.0, "metres": 1.0, "km": KM, "kilometer": KM, "kilometers": KM, "kilometre": KM, "s": 1.0, "sec": 1.0,
    "second": 1.0, "seconds": 1.0,
}  # fmt: skip
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
        return lola_shots(content, path, clock_bias)
    return _Rows(path, root, table, content).shots(clock_bias)


def require_whole(path: Path, content: bytes) -> None:
    """Raise InputError where LOLA's records in a file are not as many as a label beside it counts."""
    for label in (path.with_suffix(ending) for ending in (".LBL", ".lbl")):
        if label.is_file():
            require_records(whole_label(_document(label)), -(-len(content) // RECORD.itemsize))
            return


def _beside(path: Path, block: Block, key: str) -> Path:
    """The file that a pointer names, in the label's folder, whatever the case of its letters."""
    if not key:
        raise InputError(str(path), "no pointer such as ^TABLE", "the label of a table in a file of its own")
    items = block.words(key)
    if len(items) > 1 and items[1] != "1":
        raise InputError(block.where(key), f"a table from {items[1]} on in its file", "a table that is all of its file")
    name = items[0].lower() if items else ""
    found = [one for one in path.parent.iterdir() if one.name.lower() == name]
    if not found:
        raise InputError(block.where(key), f"{name}, which is not beside the label", "the file", "fetch it, too")
    return found[0]


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
            Column(one, plain_name(one.text("NAME")), one.count("START_BYTE") - 1, one.count("BYTES"))
            for one in blocks if one.name == "column"
        ]  # fmt: skip
        size = table.count("ROW_BYTES")
        rows, rest = divmod(len(content), size)
        if not rows or rest:
            raise InputError(str(path), f"{len(content)} bytes", f"whole rows of {size} bytes, as the label says")
        if "ROWS" in table and table.count("ROWS") != rows:
            found, remedy = f"{table.count('ROWS')}, and {rows} rows in the file", "fetch label and table anew"
            raise InputError(table.where("ROWS"), found, "as many", remedy)
        for one in self._columns:
            if one.start + one.size > size:
                found = f"bytes {one.start + 1} .. {one.start + one.size} of a row"
                raise InputError(one.block.where("BYTES"), found, f"1 .. {size}, as ROW_BYTES says")
        self._rows = np.frombuffer(content, f"{'V' if self._binary else 'S'}{size}")
        instrument = str(root.entries["instrument_id"].value) if "INSTRUMENT_ID" in root else ""
        self._altimeter: Altimeter = ALTIMETERS.get(instrument.upper(), ANY)

    def shots(self, clock_bias: float) -> AltimeterShots:
        """The shots of all rows, in their order."""
        found = {meaning: self._column(meaning) for meaning in _MEANINGS}
        radius, height = found["radius"], found["height"]
        if found["longitude"] is None or found["latitude"] is None or (radius is None and height is None):
            raise self._unknown("longitude, latitude, and radius or topography")
        above = self._altimeter.height_sphere if radius is None else 0.0
        if np.isnan(above):
            raise InputError(
                str(self.path), f"heights of {self._altimeter.name} without radii, above no one knows what",
                "a column of radii, or INSTRUMENT_ID = LALT, whose heights stand above 1737.4 km", _AS_CSV,
            )
        radii = above + self._values(radius or height)
        degrees = np.column_stack([self._values(found["longitude"]), self._values(found["latitude"])]) / DEG
        times, n = self._times(found["tdb"], found["utc"]), self._rows.size
        ranges = self._values(found["range"]) if found["range"] is not None else np.full(n, np.nan)
        return shots_with(
            str(self.path), self._altimeter, times + clock_bias,
            positions(degrees, radii, lambda k: f"{self.path}, row {k + 1}"),
            orbits=crossings(times, str(self.path)), ranges=known_ranges(ranges, np.ones(n, dtype=bool)),
        )

    def _unknown(self, expected: str) -> InputError:
        names = ", ".join(one.block.text("NAME") for one in self._columns)
        return InputError(
            str(self.path), f"the columns {names}"[:200], expected, _AS_CSV,
        )

    def _column(self, meaning: str) -> Column | None:
        fits = [one for one in self._columns if re.fullmatch(_MEANINGS[meaning], one.name)]
        if len(fits) > 1:
            raise self._unknown(f"one column for the {meaning}")
        return fits[0] if fits else None

    def _bytes(self, column: Column) -> NDArray[np.uint8]:
        """(n, size)."""
        whole = self._rows.view(np.uint8).reshape(self._rows.size, -1)
        return np.ascontiguousarray(whole[:, column.start : column.start + column.size])

    def _texts(self, column: Column) -> NDArray[np.bytes_]:
        """(n,) without blanks, quotation marks and the zeros that fill up a row."""
        return np.char.strip(self._bytes(column).view(f"S{column.size}")[:, 0], b' "')

    def _values(self, column: Column | None) -> Array:
        """Of a column, in m, rad or s."""
        assert column is not None
        block = column.block
        if self._binary:
            kind = block.text("DATA_TYPE").lower()
            if kind not in _TYPES:
                raise InputError(block.where("DATA_TYPE"), kind, ", ".join(_TYPES))
            sizes = _SIZES[_TYPES[kind][1]]
            if column.size not in sizes:
                found = f"{kind} of {column.size} bytes"
                raise InputError(block.where("BYTES"), found, " or ".join(map(str, sizes)), _AS_CSV)
            numbers = self._bytes(column).view(f"{_TYPES[kind]}{column.size}")[:, 0].astype(np.float64)
        else:
            numbers = self._numbers(column)
        unit = block.text("UNIT").lower() if "UNIT" in block else ""
        if unit not in _UNITS:
            found = f"the unit {unit!r} of {block.text('NAME')}" if unit else f"no UNIT of {block.text('NAME')}"
            raise InputError(block.where("UNIT"), found, "degrees, radians, mm, m, km or seconds")
        factor = block.number("SCALING_FACTOR") if "SCALING_FACTOR" in block else 1.0
        offset = block.number("OFFSET") if "OFFSET" in block else 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            values = (numbers * factor + offset) * _UNITS[unit]
        for k in np.flatnonzero(~(np.abs(values) < _LARGEST))[:1]:
            raise InputError(f"{self.path}, row {k + 1}, {column.name}", f"{values[k]:g}", "a number that can be")
        return values

    def _numbers(self, column: Column) -> Array:
        """Those of a column of text."""
        texts = self._texts(column)
        try:
            return texts.astype(np.float64)
        except ValueError:
            places = (f"{self.path}, row {k + 1}, {column.name}" for k in range(texts.size))
            return np.array([number_of(one.decode("latin-1"), at) for one, at in zip(texts, places, strict=True)])

    def _times(self, tdb: Column | None, utc: Column | None) -> Array:
        if tdb is not None:
            return self._values(tdb)
        if utc is None:
            raise self._unknown("a column UTC or EPHEMERIS_TIME")
        texts = (one.decode("latin-1").replace("/", "-").replace(" ", "T") for one in self._texts(utc).tolist())
        return tdb_of_utc(Names.of(list(texts)), str(self.path))
