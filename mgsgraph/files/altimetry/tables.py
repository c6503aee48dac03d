"""Tables of laser shots of any altimeter to AltimeterShots: which columns mean what, one layout for each.

* LOLA RDR as CSV, which the Orbital Data Explorer (ODE) and lidar2image have: km, degrees, and as time the terrestrial
  one (TT; its digits are those of UTC and the leap seconds), which becomes TDB.
* MLA RDR as CSV of ODE, names and km as in USGS's ode_csv2shapefile.py. The range is half of the time of flight, for no
  source says the unit of 1way_range; nor that of the spacecraft's height and of the angle off nadir, which are left.
* A selection as `mgsgraph shots` writes it, and any CSV that names its columns so.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lola import INVALID
from mgsgraph.files.altimetry.places import crossings, known_ranges, positions, unit_of_radii, whole_numbers
from mgsgraph.files.altimetry.text_table import TextTable
from mgsgraph.geometry.altimeters import ALTIMETERS, ANY, LOLA, MLA, Altimeter
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.time_scales import require_years, tdb_of_tt, tdb_of_utc
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import DEG, KM, SPEED_OF_LIGHT

_HALF_LIGHT = 0.5e-9 * SPEED_OF_LIGHT
"""m of one way in a ns of both."""


class Columns(Protocol):
    """A table that is read by the plain names of its columns."""

    path: Path
    names: list[str]

    def read(self, *wanted: str) -> dict[str, Array]:
        """Finite numbers (n,) of those of the wanted columns that there are."""

    def texts(self, name: str) -> Names:
        """Texts (n) of a column."""

    def line_numbers(self) -> Index:
        """Numbers (n,) of the rows, from 1."""

    def where(self, row: int) -> str:
        """File and row, for errors."""

    def called(self, name: str) -> str:
        """File and column, for errors."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What a table's columns mean."""

    altimeter: Altimeter
    """Whose shots."""
    columns: Mapping[str, tuple[str, float]]
    """By meaning: the column's plain name, and how many m, rad or s its unit is; lengths in the radius' unit."""

    def fits(self, names: list[str]) -> bool:
        """Whether a header with these plain names has the columns that can't be done without."""
        return {self.columns[one][0] for one in ("longitude", "latitude", "radius")} <= set(names)


LOLA_CSV = Layout(LOLA, {
    "longitude": ("ptlongitude", DEG), "latitude": ("ptlatitude", DEG), "radius": ("ptradius", KM),
    "range": ("ptrange", KM), "tt": ("terrestrialdyntime", 1.0), "utc": ("coordinateduniversaltime", 1.0),
    "spacecraft longitude": ("sclongitude", DEG), "spacecraft latitude": ("sclatitude", DEG),
    "spacecraft radius": ("scradius", KM), "off nadir": ("offnadir", DEG), "flag": ("flg", 1.0),
    "second": ("missionet", 1.0), "frame": ("frm", 1.0), "spot": ("s", 1.0), "geoid": ("geoid", KM),
})  # fmt: skip
MLA_CSV = Layout(MLA, {
    "longitude": ("longitude", DEG), "latitude": ("latitude", DEG), "radius": ("radius", KM),
    "flight": ("tofnset", _HALF_LIGHT), "tdb": ("ephemeristime", 1.0), "utc": ("utc", 1.0), "channel": ("chn", 1.0),
})  # fmt: skip
_LOLA_HEADER = (
    "Coordinated_Universal_Time,Pt_Longitude,Pt_Latitude,Pt_Radius,Pt_Range,Pt_PulseW,Pt_Energy,Pt_noi,Pt_Thr,Pt_Gn,Flg,S,"
    "Frm,Mission_ET,Subseconds,Terrestrial_Dyn_Time,TX_Energy_mJ,TX_PulseW,SC_Longitude,SC_Latitude,SC_radius,Geoid,"
    "Offnadir,Emission,Sol_INC,Sol_Phs,Earth_Centr.,Earth_PW,Earth_E."
)
"""ODE's, of files that users have cut it from."""
_LOLA_ROW = re.compile(rb"\s*\d{4}-\d\d-\d\dT[\d:.]+\s*(,[^,\n]*){28}(\n|$)")
_NONE = -1.0
"""What LOLA writes for a radius or range that there is none of; less is a sign that was damaged."""
_NOISE_CHANNEL = 5
"""Of MLA, from which on a return is noise (pyXover leaves out chn > 4)."""


def table_of(content: bytes, path: Path) -> TextTable:
    """A text as a table; LOLA's columns without a header are known by their number."""
    return TextTable(content, path, _LOLA_HEADER if _LOLA_ROW.match(content) else None)


def layout_of(table: TextTable) -> Layout | None:
    """The archive's layout that a header has; None for any other table."""
    if LOLA_CSV.fits(table.names):
        return LOLA_CSV
    return MLA_CSV if MLA_CSV.fits(table.names) and {"chn", "tofnset"} <= set(table.names) else None


def shots_of_table(table: Columns, layout: Layout, clock_bias: float) -> AltimeterShots:
    """Shots of an archive's table, in its order; a shot without a radius is left out.

    InputError for a column that is missing, a value that can't be, a radius in no unit in which it is the body's.
    """
    names = {meaning: name for meaning, (name, _) in layout.columns.items()}
    numbers = table.read(*[name for meaning, name in names.items() if meaning != "utc"])

    def column(meaning: str) -> Array | None:
        return numbers.get(names.get(meaning, ""))

    radii = numbers[names["radius"]]
    there = ~((radii <= 0.0) & (radii >= _NONE))
    if not np.any(there):
        raise InputError(str(table.path), f"{there.size} shots without a radius", "shots that reached the ground")
    length = unit_of_radii(radii[there], layout.altimeter.body, table.called(names["radius"]))
    known = layout.columns["radius"][1]

    def value(meaning: str) -> Array:
        found = column(meaning)
        if found is None:
            return np.full(radii.size, np.nan)
        unit = layout.columns[meaning][1]
        return found * (length if unit == known else unit)

    times = _times(table, column("tdb"), column("tt"), names)
    angles = np.column_stack([numbers[names["longitude"]], numbers[names["latitude"]]])
    places = positions(angles, np.where(there, radii, 1.0) * length, table.where)
    spacecraft = [value(f"spacecraft {one}") for one in ("longitude", "latitude", "radius")]
    ranges = value("flight") if column("flight") is not None else value("range")

    def whole(meaning: str) -> Index | None:
        found = column(meaning)
        return None if found is None else whole_numbers(found, lambda k: f"{table.where(k)}, {names[meaning]}")

    frames, shots = _numbers_of(table, whole("second"), whole("frame"), whole("spot"))
    channels = whole("channel")
    ground = _ground(whole("flag"), channels, radii.size)
    found = AltimeterShots(
        source=str(table.path), orbits=crossings(times, str(table.path)), frames=frames, shots=shots,
        times=times + clock_bias, footprints=places, areoid_radii=value("geoid"),
        ranges=known_ranges(ranges, ground, _NONE * length), range_corrections=np.full(radii.size, np.nan),
        spacecraft=from_planetocentric(np.column_stack(spacecraft)),
        off_nadir=value("off nadir"), ground=ground,
        channels=np.zeros(radii.size, dtype=np.int64) if channels is None else channels,
        clocks=np.full(radii.size, np.nan), pulses=np.full(radii.size, np.nan), altimeter=layout.altimeter,
    )  # fmt: skip
    return found if np.all(there) else found.chosen(there)


def _times(table: Columns, tdb: Array | None, tt: Array | None, names: Mapping[str, str]) -> Array:
    if tdb is not None:
        return tdb
    if tt is not None:
        return tdb_of_tt(tt)
    if names.get("utc") in table.names:
        return tdb_of_utc(table.texts(names["utc"]), table.called(names["utc"]))
    expected = " or ".join(names[one] for one in ("tdb", "tt", "utc") if one in names)
    raise InputError(f"{table.path}, header", "no column for the time", expected)


def _numbers_of(
    table: Columns, seconds: Index | None, frames: Index | None, spots: Index | None
) -> tuple[Index, Index]:
    if seconds is not None and frames is not None and spots is not None:
        return seconds * 100 + frames, spots
    lines = table.line_numbers()
    return lines, np.ones(lines.size, dtype=np.int64)


def _ground(flags: Index | None, channels: Index | None, n: int) -> Mask:
    ground = np.ones(n, dtype=bool)
    if flags is not None:
        ground &= flags & INVALID == 0
    if channels is not None:
        ground &= channels < _NOISE_CHANNEL
    return ground


# --- our own selections

_OWN = {
    "orbit": "orbits", "frame": "frames", "shot": "shots", "channel": "channels",
}  # fmt: skip
"""Whole numbers of a selection: the column's name and the record's."""
_OWN_GAPS = {
    "range_m": "ranges", "range_correction_m": "range_corrections", "areoid_radius_m": "areoid_radii",
    "off_nadir_deg": "off_nadir", "clock_hz": "clocks", "pulse_s": "pulses",
}  # fmt: skip
_PLACE = ("spacecraft_x_m", "spacecraft_y_m", "spacecraft_z_m")


def is_selection(table: TextTable) -> bool:
    """Whether a table has what a selection of `mgsgraph shots` has, at least: places, times and ranges."""
    return {"longitudedeg", "latitudedeg", "radiusm", "rangem", "times"} <= set(table.names)


def read_selection(table: TextTable, clock_bias: float) -> AltimeterShots:
    """Shots as `selection_columns` has them; lengths are m, empty cells unknown."""
    needed = table.read("longitudedeg", "latitudedeg", "radiusm", "times", *_OWN, "ground")
    n = needed["times"].size
    gaps = {
        name: table.with_gaps(column.replace("_", "")) * (DEG if column.endswith("deg") else 1.0)
        for column, name in _OWN_GAPS.items()
    }
    angles = np.column_stack([needed["longitudedeg"], needed["latitudedeg"]])
    lines = {"frames": table.line_numbers().astype(np.float64), "shots": np.ones(n)}

    def whole(column: str, name: str) -> Index:
        values = needed.get(column, lines.get(name, np.zeros(n)))
        return whole_numbers(values, lambda k: f"{table.where(k)}, {column}", 2.0**53)

    require_years(needed["times"], table.called("times"))
    known: dict[str, Any] = {name: whole(column, name) for column, name in _OWN.items()} | gaps
    return AltimeterShots(
        source=str(table.path), times=needed["times"] + clock_bias,
        footprints=positions(angles, needed["radiusm"], table.where),
        spacecraft=np.column_stack([table.with_gaps(one.replace("_", "")) for one in _PLACE]),
        ground=_flags(table, needed.get("ground", np.ones(n))), altimeter=_altimeter(table), **known,
    )  # fmt: skip


def _flags(table: TextTable, values: Array) -> Mask:
    """Zeros and ones (n,) as truth values."""
    return np.asarray(whole_numbers(values, lambda k: f"{table.where(k)}, ground", 1.0) == 1)


def _altimeter(table: TextTable) -> Altimeter:
    if "altimeter" not in table.names:
        return ANY
    stated = set(RepeatedNames.of(table.texts("altimeter").arrow).distinct)
    if len(stated) > 1 or not stated <= {*ALTIMETERS, ANY.name}:
        raise InputError(table.called("altimeter"), ", ".join(sorted(stated))[:60], f"one of {', '.join(ALTIMETERS)}")
    return ALTIMETERS.get(stated.pop(), ANY)
