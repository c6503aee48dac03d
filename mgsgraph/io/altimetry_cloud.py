"""Any laser altimetry as control: LOLA RDR (binary, CSV), MOLA PEDR (binary, text) and plain CSV, to an AltimetryCloud.

The content of a file says what it is. LOLA CSV is what the Orbital Data Explorer (ODE) writes. A plain CSV names its
columns, with their units, in its first line: longitude_deg and latitude_deg (east, planetocentric) with radius_m,
radius_km or height_m (above the body's ellipsoid), or x_m, y_m, z_m (body-fixed); it may have id, profile or orbit, and
time_s (TDB past J2000) or utc. All but PEDR files may be packed by gzip.

A profile is what the file calls so: for MOLA an orbit, for LOLA's binary records the file, which holds one orbit. In
files that don't say it, shots that follow one another without a pause of half an hour are one profile: an orbit takes
two hours or so, so that each crossing of a stereo area is one.
"""

import gzip
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import MOLA_FOOTPRINT, AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, geodetic
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.io.files import number_of, read_bytes
from mgsgraph.io.lola import INVALID, SPOTS, is_lola_rdr, lola_records
from mgsgraph.io.pedr import FRAME, read_pedr
from mgsgraph.io.pedr_text import plain_name, read_pedr_text
from mgsgraph.units import DEG, KM

_PAUSE = 1800.0
"""s without a shot, after which another profile begins."""
_TOLERANCE = 0.1
"""Part of the body's radius by which a file's median radius may differ from it."""
LOLA_FOOTPRINT = 5.0
"""m, diameter of LOLA's spots: 0.1 mrad seen from 50 km (Smith et al. 2010)."""
_MOON = Ellipsoid(1737.4 * KM, 1737.4 * KM)
"""Body of LOLA's radii."""
_PEDR_RADII = {"planetrad", "planetradius", "planetaryradius"}
"""Columns by which a PEDR text is known."""
_EXPECTED = (
    "longitude_deg, latitude_deg and radius_m, radius_km or height_m; or x_m, y_m, z_m; or those of LOLA RDR "
    "(Pt_Longitude, Pt_Latitude, Pt_Radius) or of PEDR (long_East, lat_North, planet_rad)"
)


def read_altimetry_cloud(
    path: Path, body: Ellipsoid | None = None, version: str | None = None, leap_seconds: Path | None = None
) -> AltimetryCloud:
    """Read the ground returns of an altimeter.

    Parameters
    ----------
    path : Path
        File of any of the formats above.
    body : Ellipsoid, optional
        Body on which the shots lie; a plain CSV with heights, or with a radius without unit, needs it.
    version : str, optional
        Version letter of a PEDR product, where the file's name doesn't say it.
    leap_seconds : Path, optional
        SPICE leap seconds kernel, needed where a file has times in UTC alone.

    Raises
    ------
    InputError
        With file and line or record: a column that is missing, a value that is no number or out of range, a radius
        whose unit can't be known, radii of another body, an id twice; a file that is empty, cut short, of an unknown
        format, or without ground returns.
    """
    content = read_bytes(path)
    if packed := content.startswith(b"\x1f\x8b"):
        content = _unpacked(content, path)
    if not content.strip():
        raise InputError(str(path), "an empty file", "laser shots")
    if b"\0" not in content:
        table = _CsvTable(content, path)
        if {"ptlongitude", "ptlatitude", "ptradius"} <= set(table.names):
            cloud = _lola_table(table, leap_seconds)
        elif _PEDR_RADII & set(table.names):
            _require_unpacked(packed, path)
            cloud = _pedr(read_pedr_text(path, version=version, leap_seconds=leap_seconds))
        else:
            cloud = _plain_table(table, body, leap_seconds)
    elif is_lola_rdr(content):
        cloud = _lola_records(content, path)
    elif path.suffix.lower() == ".b" or len(content) % FRAME.itemsize == 0:
        _require_unpacked(packed, path)
        cloud = _pedr(read_pedr(path, version=version))
    else:
        raise InputError(
            str(path), f"{len(content)} bytes of an unknown format",
            f"LOLA RDR (records of 256 bytes), PEDR (frames of {FRAME.itemsize} bytes) or text",
        )
    if body is not None:
        _require_body(cloud, body)
    return cloud


def _unpacked(content: bytes, path: Path) -> bytes:
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(str(path), f"can't be unpacked ({error})", "a whole gzip file", "fetch it anew") from None


def _require_unpacked(packed: bool, path: Path) -> None:
    if packed:
        raise InputError(str(path), "a packed PEDR file", "one that is not packed", "unpack it with gunzip")


def _require_body(cloud: AltimetryCloud, body: Ellipsoid) -> None:
    median = float(np.median(np.linalg.norm(cloud.points, axis=1)))
    if abs(median / body.equatorial - 1.0) > _TOLERANCE:
        raise InputError(
            cloud.source, f"a median radius of {median / KM:.1f} km",
            f"that of the images' body, {body.equatorial / KM:.1f} km, to 10 per cent",
            "give shots on this body, or check the unit of their radii",
        )


# --- profiles


def _by_pauses(times: Array) -> tuple[Index, Index]:
    """Number (n,) from 0 of each shot's profile, and the first shot (p,) of each: a pause lies between two profiles."""
    order = np.argsort(times, kind="stable")
    begins = np.diff(times[order], prepend=-np.inf) > _PAUSE
    numbers = np.empty(times.size, dtype=np.int64)
    numbers[order] = np.cumsum(begins) - 1
    return numbers, order[begins]


def _in_profiles(
    path: Path, ids: Sequence[str], points: Array, times: Array, keys: ArrayLike, footprint: float
) -> AltimetryCloud:
    """The cloud of shots in any order; the keys (n,), texts or numbers, of their profiles become the names."""
    names, profile = np.unique(keys, return_inverse=True)
    order = np.lexsort([times, profile])
    ordered = tuple(ids[k] for k in order.tolist())
    profiles = tuple(str(name) for name in names.tolist())
    return AltimetryCloud(str(path), ordered, points[order], times[order], profiles, profile[order], footprint)


def _product(path: Path) -> str:
    """The name of a file up to its first dot."""
    return path.name.partition(".")[0]


def _require_ground(ground: Mask, path: Path) -> None:
    if not np.any(ground):
        raise InputError(str(path), f"{ground.size} shots, none of which reached the ground", "ground returns")


def _positions(angles: Array, radii: Array, where: Callable[[int], str]) -> Array:
    """(n, 3) m, body-fixed, of longitudes and planetocentric latitudes (n, 2) in degrees and radii (n,) in m.

    `where` names the line or record of the k-th shot in errors.
    """
    for name, values, least, largest in (
        ("longitude", angles[:, 0], -180.0, 360.0), ("latitude", angles[:, 1], -90.0, 90.0),
    ):
        for k in np.flatnonzero((values < least) | (values > largest))[:1]:
            raise InputError(f"{where(k)}, {name}", f"{values[k]:g} degrees", f"{least:g} .. {largest:g}")
    for k in np.flatnonzero(radii <= 0.0)[:1]:
        raise InputError(f"{where(k)}, radius", f"{radii[k]:g} m", "a positive number")
    return from_planetocentric(np.column_stack([angles * DEG, radii]))


# --- PEDR and LOLA's binary records


def _pedr(shots: AltimeterShots) -> AltimetryCloud:
    path = Path(shots.source)
    _require_ground(shots.ground, path)
    shots = shots.chosen(shots.ground)
    orbits = shots.orbits if np.any(shots.orbits) else _by_pauses(shots.times)[0] + 1
    return _in_profiles(path, shots.ids, shots.footprints, shots.times, orbits, MOLA_FOOTPRINT)


def _lola_records(content: bytes, path: Path) -> AltimetryCloud:
    """All ground returns; an id is the record's number in the file and the spot's, both from 1."""
    records, ground = lola_records(content, path)
    spots = records["spots"].reshape(-1)
    _require_ground(ground, path)
    chosen = np.flatnonzero(ground)
    record, spot = chosen // SPOTS + 1, chosen % SPOTS + 1
    angles = np.column_stack([spots["longitude"][chosen], spots["latitude"][chosen]]) * 1e-7
    points = _positions(
        angles, spots["radius"][chosen] * 1e-3, lambda k: f"{path}, record {record[k]}, spot {spot[k]}"
    )
    times = (records["seconds"] + records["fraction"] * 2.0**-32)[chosen // SPOTS]
    ids = [f"{k}:{m}" for k, m in zip(record.tolist(), spot.tolist(), strict=True)]
    return _in_profiles(path, ids, points, times, np.full(chosen.size, _product(path)), LOLA_FOOTPRINT)


# --- CSV


class _CsvTable:
    """Rows of a CSV file below a header; columns are called by the letters and digits of their names, in lower case."""

    def __init__(self, content: bytes, path: Path) -> None:
        self.path = path
        try:
            lines = content.decode("utf-8-sig").splitlines()
        except UnicodeDecodeError as error:
            raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a CSV file") from None
        filled = [k for k, line in enumerate(lines) if line.strip()]
        header = lines[filled[0]]
        self.written = [name.strip() for name in (header.split(",") if "," in header else header.split())]
        """Names as the header has them."""
        self.names = [plain_name(name) for name in self.written]
        self._numbers = [k + 1 for k in filled[1:]]
        self._lines = [lines[k] for k in filled[1:]]

    def read(self, *wanted: str) -> dict[str, Array]:
        """Finite numbers (n,) of those of the wanted columns that there are.

        InputError for a header alone, a name twice, a line of another number of columns than the header, or a value
        that is no number.
        """
        if not self._lines:
            raise InputError(str(self.path), "a header alone", "shots below it")
        for name in [name for k, name in enumerate(self.names) if name and name in self.names[:k]][:1]:
            raise InputError(f"{self.path}, header", f"the column {name!r} twice", "each column once")
        for k, line in enumerate(self._lines):
            if line.count(",") != len(self.names) - 1:
                found, expected = f"{line.count(',') + 1} values", f"{len(self.names)}, as the header has names"
                raise InputError(self.where(k), found, expected, "the file may be cut short")
        there = [name for name in wanted if name in self.names]
        columns = [self.names.index(name) for name in there]
        try:
            values = np.loadtxt(self._lines, delimiter=",", usecols=columns, comments=None, ndmin=2)
        except ValueError:
            values = np.full((1, 1), np.nan)
        if not np.all(np.isfinite(values)):  # say which one
            values = np.array([
                [number_of(texts[m].strip(), f"{self.where(k)}, {self.written[m]}") for m in columns]
                for k, texts in enumerate(line.split(",") for line in self._lines)
            ])
        return dict(zip(there, values.T, strict=True))

    def __len__(self) -> int:
        return len(self._lines)

    def where(self, row: int) -> str:
        """File and line of a row, for errors."""
        return f"{self.path}, line {self._numbers[row]}"

    def line_numbers(self) -> list[str]:
        """Numbers (n) of the rows' lines in the file, from 1, as texts."""
        return [str(number) for number in self._numbers]

    def texts(self, name: str) -> list[str]:
        """Texts (n) of a column, none of which is empty."""
        column = self.names.index(name)
        texts = [line.split(",", column + 1)[column].strip() for line in self._lines]
        for k in [k for k, text in enumerate(texts) if not text][:1]:
            raise InputError(f"{self.where(k)}, {self.written[column]}", "nothing", "a text")
        return texts

    def times(self, utc: str, leap_seconds: Path | None) -> Array:
        """Times (n,) in s TDB past J2000 of a column of UTC; NaN where there is none."""
        if utc not in self.names:
            return np.full(len(self), np.nan)
        if leap_seconds is None:
            raise InputError(
                f"{self.path}, header", "times in UTC alone", "a column of s past J2000, or a leap seconds kernel",
                "give the kernel: leap_seconds = \"naif0012.tls\"",
            )
        from mgsgraph.io.kernels import times_of_utc  # SPICE takes half a second, which other files need not wait for

        return times_of_utc(self.texts(utc), [leap_seconds], f"{self.path}, {utc}")

    def profiles(self, times: Array, utc: str) -> ArrayLike:
        """Keys (n,) of profiles between pauses: the minute in which the first shot was fired, or numbers from 1."""
        if np.isnan(times[0]):
            return np.full(len(self), _product(self.path))
        numbers, first = _by_pauses(times)
        if utc not in self.names:
            return numbers + 1
        texts = self.texts(utc)
        return np.array([texts[k][:16] for k in first.tolist()])[numbers]


def _unit(radii: Array, body: Ellipsoid | None, where: str) -> float:
    """M of the unit in which radii (n,) of a column without unit are those of the body."""
    if body is None:
        raise InputError(where, "a radius without unit", "radius_m or radius_km")
    median = float(np.median(radii))
    for unit in (1.0, KM):
        if abs(median * unit / body.equatorial - 1.0) <= _TOLERANCE:
            return unit
    raise InputError(
        where, f"a median of {median:g}", f"the body's radius, {body.equatorial / KM:.1f} km, in m or km",
        "name the column radius_m or radius_km, and give shots on this body",
    )


def _lola_table(table: _CsvTable, leap_seconds: Path | None) -> AltimetryCloud:
    """LOLA RDR of ODE; an id is the second of mission time, the shot's number in it and the spot's."""
    utc, of_shot = "coordinateduniversaltime", ("missionet", "frm", "s")
    numbers = table.read("ptlongitude", "ptlatitude", "ptradius", "flg", "terrestrialdyntime", *of_shot)
    ground = numbers.get("flg", np.zeros(len(table))).astype(np.int64) & INVALID == 0
    _require_ground(ground, table.path)
    chosen = np.flatnonzero(ground)
    radii = numbers["ptradius"][chosen]
    radii = radii * _unit(radii, _MOON, f"{table.path}, Pt_Radius")
    angles = np.column_stack([numbers["ptlongitude"], numbers["ptlatitude"]])[chosen]
    points = _positions(angles, radii, lambda k: table.where(chosen[k]))
    times = numbers["terrestrialdyntime"] if "terrestrialdyntime" in numbers else table.times(utc, leap_seconds)
    keys = np.asarray(table.profiles(times, utc))
    if all(name in numbers for name in of_shot):
        columns = [numbers[name][chosen].astype(np.int64).tolist() for name in of_shot]
        ids = [f"{second}:{shot}:{spot}" for second, shot, spot in zip(*columns, strict=True)]
    else:
        lines = table.line_numbers()
        ids = [lines[k] for k in chosen.tolist()]
    return _in_profiles(table.path, ids, points, times[chosen], keys[chosen], LOLA_FOOTPRINT)


def _plain_table(table: _CsvTable, body: Ellipsoid | None, leap_seconds: Path | None) -> AltimetryCloud:
    """A plain CSV; an id is the number of the line where there is no column of ids."""
    names = set(table.names)
    heights = [name for name in ("radiusm", "radiuskm", "heightm", "radius") if name in names]
    cartesian = {"xm", "ym", "zm"} <= names
    if not (cartesian or ({"longitudedeg", "latitudedeg"} <= names and heights)):
        raise InputError(f"{table.path}, header", f"the columns {', '.join(table.written)[:80]}", _EXPECTED)
    columns = ("xm", "ym", "zm") if cartesian else ("longitudedeg", "latitudedeg", heights[0])
    numbers = table.read(*columns, "times")
    values = np.column_stack([numbers[name] for name in columns])
    if cartesian:
        points = values
    else:
        where = f"{table.path}, {table.written[table.names.index(heights[0])]}"
        points = _planetocentric_points(values, heights[0], body, table.where, where)
    times = numbers["times"] if "times" in numbers else table.times("utc", leap_seconds)
    named = [name for name in ("profile", "orbit") if name in names]
    keys = table.texts(named[0]) if named else table.profiles(times, "utc")
    ids = table.texts("id") if "id" in names else table.line_numbers()
    return _in_profiles(table.path, ids, points, times, keys, float("nan"))


def _planetocentric_points(
    values: Array, kind: str, body: Ellipsoid | None, where_row: Callable[[int], str], where: str
) -> Array:
    """(n, 3) m, body-fixed, of longitudes and latitudes in degrees and radii or heights in the unit of a column's name.

    `where_row` names the k-th row and `where` the column of radii or heights in errors.
    """
    angles, heights = values[:, :2], values[:, 2]
    if kind != "heightm":
        unit = {"radiusm": 1.0, "radiuskm": KM}.get(kind) or _unit(heights, body, where)
        return _positions(angles, heights * unit, where_row)
    if body is None:
        raise InputError(where, "heights above an unknown body", "radius_m or radius_km, or the body")
    points = _positions(angles, body.equatorial + heights, where_row)
    for _ in range(4):  # the vertical is within half a degree of the radius: each step leaves 1e-4 of the error
        lift = heights - geodetic(points, body)[:, 2]
        points = points * (1.0 + lift / np.linalg.norm(points, axis=1))[:, None]
    return points
