"""Laser shots of any altimeter's file, known by its content, and the cloud of ground returns, of plain CSV too.

What is read: MOLA PEDR and LOLA RDR, binary (`binary`); tables of PEDR2TAB, of the Orbital Data Explorer (MOLA, LOLA,
MLA) and selections of `mgsgraph shots` (`tables`); any PDS3 table by its label; as a cloud, plain CSV too. All but PEDR
files may be packed by gzip.

A PDS3 table has its label beside it, and columns by the label's own names, bytes and units: for products whose layout
no source that could be read gives in full: Kaguya's LALT_LGT_TS and LALT_RD (JAXA, data set SLN-L-LALT-4-TOPO-LGT-TS)
and MESSENGER's binary MLARDR. What a column means is taken from its name, and its unit from its UNIT, as Clementine's
profiles (CLEM1-L-LIDAR-5-TOPO) have UNIVERSAL TIME, and LONGITUDE and LATITUDE in DEGREE; where either leaves a doubt
the file is refused with the columns that the label has. A label of LOLA RDR leads to its records, whose layout is
known.

A plain CSV names its columns, with their units, in its first line: longitude_deg and latitude_deg (east,
planetocentric) with radius_m, radius_km or height_m (above the body's ellipsoid), or x_m, y_m, z_m (body-fixed); it may
have id, profile or orbit, and time_s (TDB past J2000) or utc.

A profile is what the file calls so: for MOLA an orbit. In files that don't say it, shots that follow one another
without a pause of half an hour are one profile: an orbit takes two hours or so, so that each crossing of a stereo area
is one.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.binary import FRAME, RECORD, is_lola_rdr, lola_shots, pedr_shots
from mgsgraph.files.altimetry.shot_values import (
    by_pauses,
    crossings,
    known_ranges,
    positions,
    require_possible_shots,
    require_radii,
    require_records,
    shots_with,
    unit_of_radii,
)
from mgsgraph.files.altimetry.tables import LARGEST, is_archive, plain_name, shots_of_table, table_of
from mgsgraph.files.csv_columns import CsvText
from mgsgraph.files.opening import decoded_text, number_of, read_bytes, unpacked_gzip
from mgsgraph.files.pvl import Block, Document, files_called, whole_label
from mgsgraph.geometry.altimetry import ALTIMETERS, ANY, Altimeter, AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import require_years, tdb_of_utc
from mgsgraph.names import Names, RepeatedNames
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
    name = items[0] if items else ""
    if not (found := files_called(path, name)):
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
        """(n, size) bytes of a column, shot by shot."""
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


_SMALL, _MOST_TIMES = 1 << 24, 30
"""bytes that any packed file may unpack to, and times its own: gzip packs tables of numbers to a fifth or so."""


def read_shots(
    path: Path, clock_bias: float = 0.0, version: str | None = None
) -> AltimeterShots:
    """Shots of an altimeter, ground or not, in the file's order.

    Parameters
    ----------
    path : Path
        File of any of the formats above; of a table with a label, the label.
    clock_bias : float
        s, added to the times of the shots (the footprints stay where the archive has them).
    version : str, optional
        Version letter of a PEDR product, where the file's name doesn't say it.

    Raises
    ------
    InputError
        With file and line or record: a file that is missing, empty, cut short or of an unknown format; a column that is
        missing; a value that is no number or can't be; radii in no unit in which they are the body's, ranges in another
        than the way from the spacecraft, where the file has that.

    Examples
    --------
    >>> shots = mgsgraph.read_shots(Path("gusev/ap18933l.b"))
    >>> print(shots)
    AltimeterShots(MOLA: 280 shots, 272 on the ground, 1 orbits)
    """
    found = _shots_or_table(path, clock_bias, version)
    if isinstance(found, CsvText):
        found = shots_of_table(found, clock_bias, version)
        require_possible_shots(found)
    return found


def _shots_or_table(path: Path, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots | CsvText:
    """Shots of a file as `read_shots` has them; a table that is no altimeter's archive as it is."""
    content = read_bytes(path)
    if packed := content.startswith(b"\x1f\x8b"):
        content = unpacked_gzip(content, str(path), max(_SMALL, _MOST_TIMES * len(content)))
    if not content or content.isspace():
        raise InputError(str(path), "an empty file", "laser shots")
    if b"\0" in content:
        shots = _of_records(content, packed, path, clock_bias, version)
    elif content.lstrip().startswith(b"{"):
        raise InputError(str(path), "JSON", "a file of an altimeter's archive", "ISIS lidar data go into [laser]")
    elif is_label(content):
        shots = read_labelled_shots(path, clock_bias)
    else:
        table = table_of(decoded_text(content, path, "a table"), path)
        if not is_archive(table.names):
            return table
        shots = shots_of_table(table, clock_bias, version)
    require_possible_shots(shots)
    return shots


def _of_records(content: bytes, packed: bool, path: Path, clock_bias: float, version: str | None) -> AltimeterShots:
    if is_lola_rdr(content):
        require_whole(path, content)
        return lola_shots(content, path, clock_bias)
    if path.suffix.lower() != ".b" and len(content) % FRAME.itemsize:
        raise InputError(
            str(path), f"{len(content)} bytes of an unknown format",
            f"LOLA RDR (records of 256 bytes), PEDR (frames of {FRAME.itemsize} bytes) or text",
        )
    if packed:
        raise InputError(str(path), "a packed PEDR file", "one that is not packed", "unpack it with gunzip")
    return pedr_shots(content, path, clock_bias, version)


_EXPECTED = (
    "longitude_deg, latitude_deg and radius_m, radius_km or height_m; or x_m, y_m, z_m; or those of LOLA RDR "
    "(Pt_Longitude, Pt_Latitude, Pt_Radius) or of PEDR (long_East, lat_North, planet_rad)"
)


def read_altimetry_cloud(
    path: Path, body: Ellipsoid | None = None, version: str | None = None
) -> AltimetryCloud:
    r"""Read the ground returns of an altimeter.

    Parameters
    ----------
    path : Path
        File of any of the formats above.
    body : Ellipsoid, optional
        Body on which the shots lie; a plain CSV with heights, or with a radius without unit, needs it.
    version : str, optional
        Version letter of a PEDR product, where the file's name doesn't say it.

    Raises
    ------
    InputError
        With file and line or record: a column that is missing, a value that is no number or out of range, a radius
        whose unit can't be known, radii of another body, an id twice; a file that is empty, cut short, of an unknown
        format, or without ground returns.

    Examples
    --------
    >>> _ = Path("cloud.csv").write_text("longitude_deg,latitude_deg,height_m,id,profile\n87.1,4.2,-3700.0,1,9000\n")
    >>> print(mgsgraph.read_altimetry_cloud(Path("cloud.csv"), network.images[0].body))
    AltimetryCloud(1 shots, 1 profiles, from cloud.csv)
    """
    found = _shots_or_table(path, version=version)
    cloud = _plain_table(found, body) if isinstance(found, CsvText) else _cloud_of(found)
    if body is not None:
        require_radii(np.linalg.norm(cloud.points, axis=1), body, cloud.source)
    return cloud


def _in_profiles(
    path: Path, ids: Names, points: Array, times: Array, keys: RepeatedNames | Index, footprint: float
) -> AltimetryCloud:
    """The cloud of shots in any order; the keys (n,), texts or numbers, of their profiles become the names."""
    if isinstance(keys, RepeatedNames):
        profiles = tuple(sorted(keys.used))
        profile = keys.over(profiles)
    else:
        numbers, profile = np.unique(keys, return_inverse=True)
        profiles = tuple(str(number) for number in numbers.tolist())
    order = np.lexsort([times, profile])
    return AltimetryCloud(str(path), ids[order], points[order], times[order], profiles, profile[order], footprint)


def _product(path: Path) -> str:
    """The name of a file up to its first dot."""
    return path.name.partition(".")[0]


def _cloud_of(shots: AltimeterShots) -> AltimetryCloud:
    """Ground returns of an altimeter."""
    path = Path(shots.source)
    if not np.any(shots.ground):
        raise InputError(str(path), f"{shots.times.size} shots, none of which reached the ground", "ground returns")
    shots = shots.chosen(shots.ground)
    if not np.any(shots.orbits):
        shots = replace(shots, orbits=by_pauses(shots.times)[0] + 1)
    spot = shots.altimeter.spot(shots.ranges)
    return _in_profiles(path, shots.ids, shots.footprints, shots.times, shots.profile_names(), spot)


# --- plain CSV


def _plain_table(table: CsvText, body: Ellipsoid | None) -> AltimetryCloud:
    """A plain CSV; an id is the number of the line where there is no column of ids."""
    names = {plain_name(name): name for name in table.names}
    heights = [name for name in ("radiusm", "radiuskm", "heightm", "radius") if name in names]
    cartesian = {"xm", "ym", "zm"} <= set(names)
    if not (cartesian or ({"longitudedeg", "latitudedeg"} <= set(names) and heights)):
        raise InputError(f"{table.path}, header", f"the columns {', '.join(table.names)[:80]}", _EXPECTED)
    if not len(table):
        raise InputError(str(table.path), "a header alone", "rows below it")
    columns = ("xm", "ym", "zm") if cartesian else ("longitudedeg", "latitudedeg", heights[0])
    wanted = [names[name] for name in (*columns, "times") if name in names]
    numbers = table.measured(*wanted, largest=LARGEST)
    values = np.column_stack([numbers[name] for name in wanted[:3]])
    if cartesian:
        points = values
    else:
        where = f"{table.path}, {names[heights[0]]}"
        points = _planetocentric_points(values, heights[0], body, table.where, where)
    utc = table.shown(names["utc"]) if "utc" in names else None
    if "times" in names:
        times = numbers[names["times"]]
    else:
        times = np.full(len(table), np.nan) if utc is None else tdb_of_utc(utc, f"{table.path}, utc")
    require_years(times, str(table.path))
    named = [names[name] for name in ("profile", "orbit") if name in names]
    keys = RepeatedNames.of(table.shown(named[0]).arrow) if named else _profiles(table.path, times, utc)
    ids = table.shown(names["id"]) if "id" in names else Names.joined(table.numbers)
    return _in_profiles(table.path, ids, points, times, keys, float("nan"))


def _profiles(path: Path, times: Array, utc: Names | None) -> RepeatedNames | Index:
    """Keys (n,) of profiles between pauses: the minute in which the first shot was fired, or numbers from 1."""
    if np.isnan(times[0]):
        return RepeatedNames((_product(path),), np.zeros(times.size, dtype=np.int64))
    numbers, first = by_pauses(times)
    if utc is None:
        return numbers + 1
    begins = RepeatedNames.of([text[:16] for text in utc[first]])
    return RepeatedNames(begins.distinct, begins.numbers[numbers])


def _planetocentric_points(
    values: Array, kind: str, body: Ellipsoid | None, where_row: Callable[[int], str], where: str
) -> Array:
    """(n, 3) m, body-fixed, of longitudes and latitudes in degrees and radii or heights in the unit of a column's name.

    `where_row` names the k-th row and `where` the column of radii or heights in errors.
    """
    angles, heights = values[:, :2], values[:, 2]
    if kind != "heightm":
        unit = {"radiusm": 1.0, "radiuskm": KM}.get(kind) or unit_of_radii(heights, body, where)
        return positions(angles, heights * unit, where_row)
    if body is None:
        raise InputError(where, "heights above an unknown body", "radius_m or radius_km, or the body")
    points = positions(angles, body.equatorial + heights, where_row)
    for _ in range(4):  # the vertical is within half a degree of the radius: each step leaves 1e-4 of the error
        lift = heights - geodetic(points, body)[:, 2]
        points = points * (1.0 + lift / np.linalg.norm(points, axis=1))[:, None]
    return points
