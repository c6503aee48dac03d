"""MOLA shots as text: PEDR2TAB tables and the CSV files of the Orbital Data Explorer (ODE), to AltimeterShots.

Columns are found by the names in the header, whatever their order, case, padding or spelling ("Ephermis Time"). In a
PEDR2TAB table fields may abut, so its lines are cut at the widths of the program's formats (2.71828, and the variant
with wider shot, packet and orbit numbers). A frame number stands for the line in the file, which names the shot.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.pedr import IAU2000_VERSION, in_iau2000, pedr_version
from mgsgraph.files.altimetry.places import known_ranges, whole_numbers
from mgsgraph.files.altimetry.text_table import TextTable
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


def pedr_text_shots(table: TextTable, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots:
    """Shots of a PEDR2TAB table or a CSV file of ODE.

    Parameters
    ----------
    table : TextTable
        With commas it is CSV.
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
        Where a needed column is missing, a value is no number or the version is not known.
    """
    letter = IAU2000_VERSION if table.with_commas and version is None else pedr_version(table.path, None, version)
    names = _wanted(table)
    numbers = table.read(*(name for meaning, name in names.items() if meaning != "utc"))
    shots = _shots(_ShotTable(table, names, numbers), clock_bias)
    return in_iau2000(shots) if letter < IAU2000_VERSION else shots


@dataclass(frozen=True, slots=True, eq=False)
class _ShotTable:
    """Columns of a text, by what they mean."""

    table: TextTable
    columns: Mapping[str, str]
    """Plain names of the columns, by their meaning."""
    values: Mapping[str, Array]
    """(n,) numbers of columns, by their plain names."""

    def numbers(self, meaning: str) -> Array:
        """A column as numbers; NaN throughout where there is no such column."""
        found = self.values.get(self.columns.get(meaning, ""))
        return np.full(len(self.table), np.nan) if found is None else found

    def whole(self, meaning: str) -> Index:
        """A column of whole numbers; zero throughout where there is no such column."""
        if meaning not in self.columns:
            return np.zeros(len(self.table), dtype=np.int64)
        return whole_numbers(self.numbers(meaning), lambda k: f"{self.table.where(k)}, {meaning}")

    def within(self, meaning: str, least: float, largest: float) -> Array:
        """A column of numbers that lie between two bounds."""
        values = self.numbers(meaning)
        for k in np.flatnonzero((values < least) | (values > largest))[:1].tolist():
            found, expected = f"{values[k]:g}", f"{least:g} .. {largest:g}"
            raise InputError(f"{self.table.where(k)}, {meaning}", found, expected)
        return values


def _wanted(table: TextTable) -> dict[str, str]:
    """Plain names of columns by what they mean; InputError where one is missing that can't be done without."""
    wanted, where = dict[str, str](), f"{table.path}, header"
    for name in table.names:
        meaning = _COLUMNS.get(name)
        if meaning in wanted:
            raise InputError(where, f"two columns for the {meaning}", "one")
        if meaning:
            wanted[meaning] = name
    needed = _NEEDED if {"time", "utc"} & set(wanted) else _NEEDED | {"time": "EphemerisTime or UTC"}
    for meaning, column in needed.items():
        if meaning not in wanted:
            raise InputError(
                where, f"no column for the {meaning}", f"{column}",
                "ask ODE for the points file (..._pts_csv.csv), PEDR2TAB for its groups 0 and 2 with header lines",
            )
    return wanted


def _shots(table: _ShotTable, clock_bias: float) -> AltimeterShots:
    text = table.table
    lines, n = text.line_numbers(), len(text)
    longitude = table.within("longitude", -360.0, 360.0) * DEG
    latitude = table.within("latitude", -90.0, 90.0) * DEG
    radius = table.within("radius", 3.3e6, 3.5e6)
    in_utc = "time" not in table.columns
    times = tdb_of_utc(text.texts(table.columns["utc"]), f"{text.path}, UTC") if in_utc else table.numbers("time")
    ranges = table.numbers("range")
    areoid = table.numbers("areoid")
    areoid = np.where(np.isnan(areoid), radius - table.numbers("topography"), areoid)
    spacecraft = np.column_stack([
        table.numbers("spacecraft_longitude") * DEG, table.numbers("spacecraft_latitude") * DEG,
        table.numbers("spacecraft_radius"),
    ])
    ground = ~(table.numbers("flag") >= _NOT_GROUND)
    return AltimeterShots(
        source=str(text.path),
        orbits=table.whole("orbit"),
        frames=lines,
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
