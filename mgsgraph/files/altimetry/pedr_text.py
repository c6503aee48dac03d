"""MOLA shots as text: PEDR2TAB tables and the CSV files of the Orbital Data Explorer (ODE), to AltimeterShots.

Columns are found by the names in the header, whatever their order, case, padding or spelling ("Ephermis Time"). In a
PEDR2TAB table fields may abut, so its lines are cut at the widths of the program's formats (2.71828, and the variant
with wider shot, packet and orbit numbers). A frame number stands for the line in the file, which names the shot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.csv_lines import measured
from mgsgraph.files.altimetry.pedr import IAU2000_VERSION, in_iau2000, pedr_version
from mgsgraph.files.altimetry.pedr_columns import edges_of, names_of, plain_table
from mgsgraph.files.altimetry.places import known_ranges, whole_numbers
from mgsgraph.files.opening import LARGEST_TEXT, read_bytes, read_text
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.time_scales import tdb_of_utc
from mgsgraph.units import DEG

_COLUMNS = {
    "longeast": "longitude", "longitude": "longitude", "eastlongitude": "longitude", "lon": "longitude",
    "latnorth": "latitude", "latitude": "latitude", "lat": "latitude",
    "planetrad": "radius", "planetradius": "radius", "planetaryradius": "radius", "radius": "radius",
    "topography": "topography", "molarange": "range", "range": "range",
    "c": "channel", "a": "flag", "orbit": "orbit", "rev": "orbit", "utc": "utc",
    "ephemeristime": "time", "ephermistime": "time", "et": "time",
    "sclong": "spacecraft_longitude", "sclat": "spacecraft_latitude", "scradius": "spacecraft_radius",
    "offndr": "off_nadir", "areoidrad": "areoid", "rcorr": "range_correction",
}
"""What a column's name means, in lower case letters and digits only; other columns are not needed."""
PEDR_RADII = frozenset({"planetrad", "planetradius", "planetaryradius"})
"""Columns by which a PEDR text is known."""
_NEEDED = {
    "longitude": "long_East", "latitude": "lat_North", "radius": "planet_rad (heights above the areoid don't tell it)",
}
_NOT_GROUND = 4
"""PEDR2TAB adds this to the attitude flag A of a shot that didn't reach the ground."""


def read_pedr_text(
    path: Path, clock_bias: float = 0.0, version: str | None = None
) -> AltimeterShots:
    """Read shots from a PEDR2TAB table or a CSV file of ODE.

    Parameters
    ----------
    path : Path
        Text file; with commas it is CSV.
    clock_bias : float
        s, added to the times of the shots.
    version : str, optional
        Product version of the PEDR they were taken from, a letter. ODE serves version L alone; a table says it only
        by its file's name. Shots of versions before L are turned from the IAU1991 to the IAU2000 frame.

    Returns
    -------
    AltimeterShots
        In the file's order; without the column A all count as ground returns, which alone both programs write unless
        told otherwise.

    Raises
    ------
    InputError
        Where a needed column is missing, a line can't be cut into the header's columns, a value is no number or the
        version is not known.
    """
    table = _in_columns(path) or _by_lines(path)
    letter = IAU2000_VERSION if table.with_commas and version is None else pedr_version(path, None, version)
    shots = _shots(table, clock_bias)
    return in_iau2000(shots) if letter < IAU2000_VERSION else shots


def _in_columns(path: Path) -> "_ShotTable | None":
    """A plain table; None for another one, or one in which something is wrong."""
    found = plain_table(read_bytes(path, LARGEST_TEXT))
    if found is None:
        return None
    wanted = _wanted(found.names, path)
    texts = {k: name for k, name in wanted.items() if name == "utc" and "time" not in wanted.values()}
    columns = found.columns({k: name for k, name in wanted.items() if name != "utc"}, texts)
    lines = np.arange(len(found.rows)) + found.first_line
    return None if columns is None else _ShotTable(path, found.with_commas, lines, columns)


def _by_lines(path: Path) -> "_ShotTable":
    """Any table, of columns of texts; InputError for a line that can't be cut into the header's columns."""
    lines = read_text(path).split("\n")
    header = next((k for k, line in enumerate(lines) if line.strip()), None)
    if header is None:
        raise InputError(str(path), "an empty file", "a header and shots")
    csv, names = "," in lines[header], names_of(lines[header])
    first = header + 1 + (not csv and len(lines) > header + 1 and set(lines[header + 1]) <= set("-. "))
    body = [(k + 1, line.rstrip()) for k, line in enumerate(lines[first:], first) if line.strip()]
    if not body:
        raise InputError(str(path), "a header alone", "shots below it")
    wanted = _wanted(names, path)
    cut = _cut_csv if csv else _cut_table
    return _ShotTable(path, csv, np.array([number for number, _ in body]), cut(body, names, wanted, path))


@dataclass(frozen=True, slots=True, eq=False)
class _ShotTable:
    """Columns of a text, by what they mean."""

    path: Path
    with_commas: bool
    """Whether it is CSV."""
    lines: Index
    """(n,) number of each row's line in the file, from 1."""
    columns: Mapping[str, Array | Sequence[str]]
    """each (n,): numbers, or the texts of some."""

    def numbers(self, name: str) -> Array:
        """A column as numbers; NaN throughout where there is no such column."""
        if name not in self.columns:
            return np.full(self.lines.size, np.nan)
        values = self.columns[name]
        if isinstance(values, np.ndarray):
            return values
        where = f"{self.path}, line"
        return np.array([
            measured(text, where, line, name) for text, line in zip(values, self.lines.tolist(), strict=True)
        ])

    def texts(self, name: str) -> Sequence[str]:
        """A column of texts."""
        texts = self.columns[name]
        assert not isinstance(texts, np.ndarray)
        return texts

    def whole(self, name: str) -> Index:
        """A column of whole numbers; zero throughout where there is no such column."""
        if name not in self.columns:
            return np.zeros(self.lines.size, dtype=np.int64)
        return whole_numbers(self.numbers(name), lambda k: f"{self.path}, line {self.lines[k]}, {name}")

    def within(self, name: str, least: float, largest: float) -> Array:
        """A column of numbers that lie between two bounds."""
        values = self.numbers(name)
        for k in np.flatnonzero((values < least) | (values > largest))[:1]:
            found, expected = f"{values[k]:g}", f"{least:g} .. {largest:g}"
            raise InputError(f"{self.path}, line {self.lines[k]}, {name}", found, expected)
        return values


def _wanted(names: Sequence[str], path: Path) -> dict[int, str]:
    """Column numbers and what they mean; InputError where one is missing that can't be done without."""
    wanted: dict[int, str] = {}
    for k, name in enumerate(names):
        meaning = _COLUMNS.get(name)
        if meaning in wanted.values():
            raise InputError(f"{path}, header", f"two columns for the {meaning}", "one")
        if meaning:
            wanted[k] = meaning
    needed = _NEEDED if {"time", "utc"} & set(wanted.values()) else _NEEDED | {"time": "EphemerisTime or UTC"}
    for meaning, column in needed.items():
        if meaning not in wanted.values():
            raise InputError(
                f"{path}, header", f"no column for the {meaning}", f"{column}",
                "ask ODE for the points file (..._pts_csv.csv), PEDR2TAB for its groups 0 and 2 with header lines",
            )
    return wanted


def _cut_csv(
    body: Sequence[tuple[int, str]], names: Sequence[str], wanted: dict[int, str], path: Path
) -> dict[str, list[str]]:
    rows = [line.split(",") for _, line in body]
    for (number, _), row in zip(body, rows, strict=True):
        if len(row) != len(names):
            raise InputError(f"{path}, line {number}", f"{len(row)} values", f"{len(names)}, as the header has names")
    return {meaning: [row[k].strip() for row in rows] for k, meaning in wanted.items()}


def _cut_table(
    body: Sequence[tuple[int, str]], names: Sequence[str], wanted: dict[int, str], path: Path
) -> dict[str, list[str]]:
    """Cut at the program's widths where lines have its length, at blanks otherwise."""
    if edges := edges_of(names, len(body[0][1])):
        for number, line in body:
            if len(line) != edges[-1]:
                found, expected = f"{len(line)} characters", f"{edges[-1]}, as in the lines before"
                raise InputError(f"{path}, line {number}", found, expected, "the file is cut short")
        return {
            meaning: [line[edges[k] : edges[k + 1]].strip() for _, line in body] for k, meaning in wanted.items()
        }
    rows = [line.split() for _, line in body]
    for (number, _), row in zip(body, rows, strict=True):
        if len(row) != len(names):
            raise InputError(
                f"{path}, line {number}", f"{len(row)} values",
                f"{len(names)}, as the header has names, or lines of PEDR2TAB's length", "write the table anew",
            )
    return {meaning: [row[k] for row in rows] for k, meaning in wanted.items()}


def _shots(table: _ShotTable, clock_bias: float) -> AltimeterShots:
    n = table.lines.size
    longitude = table.within("longitude", -360.0, 360.0) * DEG
    latitude = table.within("latitude", -90.0, 90.0) * DEG
    radius = table.within("radius", 3.3e6, 3.5e6)
    in_utc = "time" not in table.columns
    times = tdb_of_utc(table.texts("utc"), f"{table.path}, UTC") if in_utc else table.numbers("time")
    ranges = table.numbers("range")
    areoid = table.numbers("areoid")
    areoid = np.where(np.isnan(areoid), radius - table.numbers("topography"), areoid)
    spacecraft = np.column_stack([
        table.numbers("spacecraft_longitude") * DEG, table.numbers("spacecraft_latitude") * DEG,
        table.numbers("spacecraft_radius"),
    ])
    ground = ~(table.numbers("flag") >= _NOT_GROUND)
    return AltimeterShots(
        source=str(table.path),
        orbits=table.whole("orbit"),
        frames=table.lines,
        shots=np.ones(n, dtype=np.int64),
        times=times + clock_bias,
        footprints=from_planetocentric(np.column_stack([longitude, latitude, radius])),
        areoid_radii=areoid,
        ranges=known_ranges(ranges, ground),
        range_corrections=table.numbers("range_correction"),
        spacecraft=from_planetocentric(spacecraft),
        off_nadir=table.numbers("off_nadir") * DEG,
        ground=ground,
        channels=table.whole("channel"),
        clocks=np.full(n, np.nan),
        pulses=np.full(n, np.nan),  # in what unit PEDR2TAB writes Sigopt is not known
    )
