"""Tables of laser shots of any altimeter to AltimeterShots: the meaning of columns, one layout for each table.

* LOLA RDR as CSV, which the Orbital Data Explorer (ODE) and lidar2image have: km, degrees, and as time the terrestrial
  one (TT; its digits are those of UTC and the leap seconds), which becomes TDB.
* MLA RDR as CSV of ODE, names and km as in USGS's ode_csv2shapefile.py. The range is half of the time of flight, for no
  source says the unit of 1way_range; nor that of the spacecraft's height and of the angle off nadir, which are left.
* A selection as `mgsgraph footprints` writes it, and any CSV that names its columns so; empty cells are unknown.
* MOLA PEDR as PEDR2TAB and ODE write it. ODE serves version L alone; a table says it only by its file's name. Shots of
  versions before L are turned from the IAU1991 to the IAU2000 frame.

Columns are found by the names in the header, whatever their order, case, padding or spelling ("Ephermis Time").

Columns of PEDR2TAB are brought into CSV first.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.binary import IAU2000_VERSION, INVALID, in_iau2000, pedr_version
from mgsgraph.files.altimetry.shot_values import (
    crossings,
    known_ranges,
    positions,
    shots_with,
    unit_of_radii,
    whole_numbers,
)
from mgsgraph.files.csv_columns import CsvText, csv_text
from mgsgraph.geometry.altimetry import ALTIMETERS, ANY, LOLA, MLA, MOLA, Altimeter, AltimeterShots
from mgsgraph.geometry.body import from_planetocentric, surface_radii
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import require_years, tdb_of_tt, tdb_of_utc
from mgsgraph.names import RepeatedNames
from mgsgraph.units import DEG, KM, SPEED_OF_LIGHT

LARGEST = 1e50
"""m, s, degrees or whatever: squares of larger numbers of an altimeter would be none."""
_HEAD = 1 << 16
"""Characters in which a header stands."""
_RULE = set("-. ")
"""Characters of the line between PEDR2TAB's header and its rows."""
_WIDTHS = {
    "longeast": 9, "latnorth": 10, "topography": 11, "molarange": 10, "planetrad": 12, "c": 2, "a": 2,
    "sclong": 10, "sclat": 10, "scradius": 12, "offndr": 7, "ephemeristime": 16, "areodlat": 10, "areoidrad": 11,
    "shot": 4, "pkt": 6, "orbit": 6, "gm": 3, "hrlcl": 7, "sphas": 7, "sinc": 7, "emissn": 7, "rcorr": 7, "pwt": 8,
    "sigopt": 8, "elaser": 8, "pulsee": 7, "reft": 7, "bkgrd": 7, "thmv": 7, "wct": 3, "ect": 4, "rwnd": 7, "rdly": 8,
}
"""Characters of PEDR2TAB's formats; fields may abut."""
_WIDER = _WIDTHS | {"offndr": 8, "pkt": 7, "orbit": 8}


def plain_name(name: str) -> str:
    """The letters and digits of a column's name, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def edges_of(names: Sequence[str], length: int) -> list[int]:
    """Where the columns of PEDR2TAB's lines begin, and the last one ends, by the program's formats that make a line of
    this length; empty where none do.
    """
    for widths in (_WIDTHS, _WIDER):
        if all(name in widths for name in names):
            edges = np.cumsum([0] + [widths[name] for name in names])
            if length == edges[-1]:
                return [int(edge) for edge in edges]
    return []


# --- layouts

_HALF_LIGHT = 0.5e-9 * SPEED_OF_LIGHT
"""m of one way in a ns of both."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What a table's columns mean."""

    altimeter: Altimeter | None
    """Whose shots; None: a column says it."""
    columns: Mapping[str, str]
    """By meaning, the plain names that a column may have, between blanks."""
    known_by: frozenset[str]
    """Plain names that tell the layout."""
    name: tuple[str, ...] = ()
    """Meanings of the columns that call a shot; where one lacks, its line does."""
    bare: bool = False
    """Whether lengths are km or m, which the radii tell, a shot may have no radius (0 to -1), and no orbit is stated.
    """
    remedy: str = ""
    """What gives a table with all columns."""


_LOLA = Layout(LOLA, {
    "longitude": "ptlongitude", "latitude": "ptlatitude", "radius": "ptradius", "range": "ptrange",
    "tt": "terrestrialdyntime", "utc": "coordinateduniversaltime", "spacecraft longitude": "sclongitude",
    "spacecraft latitude": "sclatitude", "spacecraft radius": "scradius", "off nadir": "offnadir", "flg": "flg",
    "missionet": "missionet", "frm": "frm", "s": "s", "areoid": "geoid",
}, frozenset({"ptlongitude", "ptlatitude", "ptradius"}), ("missionet", "frm", "s"), bare=True)  # fmt: skip
_MLA = Layout(MLA, {
    "longitude": "longitude", "latitude": "latitude", "radius": "radius", "flight": "tofnset", "tdb": "ephemeristime",
    "utc": "utc", "channel": "chn",
}, frozenset({"longitude", "latitude", "radius", "chn", "tofnset"}), bare=True)  # fmt: skip
_OWN = Layout(None, {
    "longitude": "longitudedeg", "latitude": "latitudedeg", "radius": "radiusm", "tdb": "times", "orbit": "orbit",
    "frame": "frame", "shot": "shot", "channel": "channel", "ground": "ground", "range": "rangem",
    "range correction": "rangecorrectionm", "areoid": "areoidradiusm", "off nadir": "offnadirdeg", "clock": "clockhz",
    "pulse": "pulses", "spacecraft x": "spacecraftxm", "spacecraft y": "spacecraftym", "spacecraft z": "spacecraftzm",
}, frozenset({"longitudedeg", "latitudedeg", "radiusm", "rangem", "times"}), ("frame", "shot"))  # fmt: skip
_GAPS = frozenset(list(_OWN.columns)[9:])
"""What may be empty in a selection, from the range on."""
_PEDR = Layout(MOLA, {
    "longitude": "longeast longitude eastlongitude lon", "latitude": "latnorth latitude lat",
    "radius": "planetrad planetradius planetaryradius radius", "topography": "topography", "range": "molarange range",
    "channel": "c", "attitude": "a", "orbit": "orbit rev", "utc": "utc", "tdb": "ephemeristime ephermistime et",
    "spacecraft longitude": "sclong", "spacecraft latitude": "sclat", "spacecraft radius": "scradius",
    "off nadir": "offndr", "areoid": "areoidrad", "range correction": "rcorr",
}, frozenset({"planetrad", "planetradius", "planetaryradius"}), remedy=(
    "ask ODE for the points file (..._pts_csv.csv), PEDR2TAB for its groups 0 and 2 with header lines"
))  # fmt: skip
"""In what unit PEDR2TAB writes Sigopt is not known."""
_LENGTHS = ("radius", "range", "spacecraft radius", "areoid")
_LOLA_HEADER = (
    "Coordinated_Universal_Time,Pt_Longitude,Pt_Latitude,Pt_Radius,Pt_Range,Pt_PulseW,Pt_Energy,Pt_noi,Pt_Thr,Pt_Gn,Flg,S,"
    "Frm,Mission_ET,Subseconds,Terrestrial_Dyn_Time,TX_Energy_mJ,TX_PulseW,SC_Longitude,SC_Latitude,SC_radius,Geoid,"
    "Offnadir,Emission,Sol_INC,Sol_Phs,Earth_Centr.,Earth_PW,Earth_E."
)
"""ODE's, of files that users have cut it from."""
LOLA_ROW = re.compile(r"\s*\d{4}-\d\d-\d\dT[\d:.]+\s*(,[^,\n]*){28}(\n|$)")
_NONE = -1.0
"""What LOLA writes for a radius or range that there is none of; less is a sign that was damaged."""
_NOISE_CHANNEL = 5
"""Of MLA, from which on a return is noise (pyXover leaves out chn > 4); other altimeters have no such channel."""
_NOT_GROUND = 4
"""PEDR2TAB adds this to the attitude flag A of a shot that didn't reach the ground."""
_SAME_AREOID, _AREOID = 10.0, 5e3
"""m by which radius minus topography may be off the areoid's radius beside it, and off the ellipsoid."""
_SAME_TIME, _LOOKS = 0.1, 1000
"""s by which two times of a row may differ, and rows that are looked at."""
_TIMES = ("tdb", "tt", "utc")
_LARGEST = 2.0**53
"""Of whole numbers."""


def table_of(text: str, path: Path) -> CsvText:
    """A text as a table: CSV, columns of PEDR2TAB, or LOLA's columns without a header, known by their number."""
    text = text.rstrip()
    if LOLA_ROW.match(text):
        return csv_text(f"{_LOLA_HEADER}\n{text}", path, np.arange(text.count("\n") + 2))
    head = next((line for line in text[:_HEAD].split("\n") if line.strip()), "")
    return csv_text(text, path) if "," in head or not head else _with_commas(text, path)


def _with_commas(text: str, path: Path) -> CsvText:
    """Rows without commas: cut at the program's widths where lines have their length, at blanks otherwise."""
    lines = [(k, line) for k, line in enumerate(text.split("\n"), 1) if line.strip() and set(line) - _RULE]
    (_, head), *rows = lines
    edges = edges_of([plain_name(name) for name in head.split()], len(rows[0][1]) if rows else 0)
    for k, row in rows:
        if edges and len(row) != edges[-1]:
            found, expected = f"{len(row)} characters", f"{edges[-1]}, as in the lines before"
            raise InputError(f"{path}, line {k}", found, expected, "the file is cut short")
        require("," not in row, f"{path}, line {k}", "a comma", "columns between blanks, as the header has them")
    if edges:
        block = np.frombuffer("".join(f"{row}\n" for _, row in rows).encode("ascii", "replace"), np.uint8)
        body = np.insert(block.reshape(len(rows), -1), edges[1:-1], ord(","), axis=1).tobytes().decode()
    else:
        body = "\n".join(",".join(row.split()) for _, row in rows)
    table = csv_text(",".join(head.split()) + f"\n{body}", path, np.array([k for k, _ in lines]))
    return replace(table, with_commas=False)


def is_archive(header: Iterable[str]) -> bool:
    """Whether names of columns are those of an altimeter's archive, or of a selection, not of a cloud of points."""
    names = set(map(plain_name, header))
    archives = any(layout.known_by <= names for layout in (_LOLA, _MLA))
    return archives or bool(_PEDR.known_by & names) or "altimeter" in names


def shots_of_table(table: CsvText, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots:
    """Shots of a table, in its order.

    Parameters
    ----------
    table : CsvText
        Without a column that says otherwise all are ground returns, which alone most programs write.
    clock_bias : float
        s, added to the times of the shots.
    version : str, optional
        Product version, a letter, of the PEDR that a table was taken from.

    Raises
    ------
    InputError
        A column that is missing or there twice, a value that can't be, radii in no unit in which they are the body's,
        a PEDR2TAB table whose version is not known.
    """
    require(len(table), str(table.path), "a header alone", "rows below it")
    plain = set(map(plain_name, table.names))
    layout = next((candidate for candidate in (_LOLA, _MLA, _OWN) if candidate.known_by <= plain), _PEDR)
    if layout is not _PEDR:
        return _shots(table, layout, clock_bias)
    letter = IAU2000_VERSION if table.with_commas and version is None else pedr_version(table.path, None, version)
    shots = _shots(table, layout, clock_bias)
    return in_iau2000(shots) if letter < IAU2000_VERSION else shots


def _shots(table: CsvText, layout: Layout, clock_bias: float) -> AltimeterShots:
    names = _meant(table, layout)
    values, has_radius = _values(table, layout, names), None
    if layout.bare:
        has_radius, unit = _with_radius(table, layout, names, values)
        values |= {meaning: values[meaning] * unit for meaning in _LENGTHS if meaning in values}
        values["radius"] = np.where(has_radius, values["radius"], unit)
    if "flight" in values:
        values["range"] = _HALF_LIGHT * values["flight"]
    if "tdb" in values or "tt" in values:
        times = values["tdb"] if "tdb" in values else tdb_of_tt(values["tt"])
    else:
        times = tdb_of_utc(table.shown(names["utc"]), f"{table.path}, {names['utc']}")
    require_years(times, str(table.path))
    _require_same_times(table, names, times)
    n = times.size

    def value(meaning: str) -> Array:
        return values.get(meaning, np.full(n, np.nan))

    def whole(meaning: str, largest: float = _LARGEST) -> Index:
        return whole_numbers(value(meaning), partial(table.where, name=meaning), largest)

    ground = np.ones(n, dtype=bool)
    if "flg" in values:
        ground &= whole("flg", 2.0**32) & INVALID == 0
    if "ground" in values:
        ground &= whole("ground", 1.0) == 1
    ground &= ~(value("channel") >= _NOISE_CHANNEL) & ~(value("attitude") >= _NOT_GROUND)
    stated: dict[str, Array | Index | Mask] = {"frames": table.numbers, "ground": ground}
    if layout.name and set(layout.name) <= set(values):
        *seconds, frames, shots = (whole(meaning) for meaning in layout.name)
        stated |= {"frames": seconds[0] * 100 + frames if seconds else frames, "shots": shots}
    if "orbit" in values or layout.bare:
        stated["orbits"] = crossings(times, str(table.path)) if layout.bare else whole("orbit")
    if "channel" in values:
        stated["channels"] = whole("channel")
    if "topography" in values:
        areoid = values["radius"] - values["topography"]
        _require_areoid(areoid, values, ground, table, names)
        values.setdefault("areoid", areoid)
    all_shots = shots_with(
        str(table.path), layout.altimeter or _altimeter(table), times + clock_bias,
        positions(np.column_stack([values["longitude"], values["latitude"]]), values["radius"], table.where),
        ranges=known_ranges(value("range"), ground, _NONE * KM if layout.bare else 0.0), spacecraft=_spacecraft(value),
        areoid_radii=value("areoid"), range_corrections=value("range correction"), off_nadir=value("off nadir") * DEG,
        clocks=value("clock"), pulses=value("pulse"), **stated,
    )  # fmt: skip
    return all_shots if has_radius is None or np.all(has_radius) else all_shots.chosen(has_radius)


def _require_same_times(table: CsvText, names: Mapping[str, str], times: Array) -> None:
    """Raise InputError where UTC differs from the other time of a row, tested in some rows."""
    other = next((names[meaning] for meaning in ("tdb", "tt") if meaning in names), "")
    if not other or "utc" not in names:
        return
    rows = np.unique(np.linspace(0, times.size - 1, min(times.size, _LOOKS)).astype(np.int64))
    shown = table.shown(names["utc"])
    texts = [shown[int(k)] for k in rows]
    off = float(np.median(np.abs(tdb_of_utc(texts, f"{table.path}, {names['utc']}") - times[rows])))
    if off > _SAME_TIME:
        found = f"{other} and {names['utc']}, {off:.3f} s apart (median)"
        raise InputError(str(table.path), found, "one time", "look at units, and at leap seconds")


def _require_areoid(
    computed: Array, values: Mapping[str, Array], ground: Mask, table: CsvText, names: Mapping[str, str]
) -> None:
    """Raise InputError where radius minus topography of the ground is not the areoid's radius that the table has, too,
    or lies far from Mars's ellipsoid there.
    """
    assert MOLA.body is not None
    if not MOLA.body.polar / 1.1 < np.median(values["radius"]) < 1.1 * MOLA.body.equatorial:
        return  # another check reports it
    planetocentric = np.stack([values["longitude"] * DEG, values["latitude"] * DEG, values["radius"]], axis=1)
    stated, what, allowed = surface_radii(from_planetocentric(planetocentric), MOLA.body), "Mars's ellipsoid", _AREOID
    if "areoid" in values:
        stated, what, allowed = values["areoid"], names["areoid"], _SAME_AREOID
    off = np.abs(computed - stated)[ground]
    if np.any(np.isfinite(off)) and (middle := float(np.nanmedian(off))) > allowed:
        found = f"{names['radius']} minus {names['topography']}, {middle:.0f} m off {what} (median)"
        raise InputError(str(table.path), found, "the areoid", "look at the columns' units and order")


def _meant(table: CsvText, layout: Layout) -> dict[str, str]:
    """Names of columns by their meaning; InputError where a necessary one is missing."""
    columns, where = dict[str, str](), f"{table.path}, header"
    for meaning, names in layout.columns.items():
        matches = [name for name in table.names if plain_name(name) in names.split()]
        require(len(matches) <= 1, where, f"two columns for the {meaning}", "one")
        if matches:
            columns[meaning] = matches[0]
    for what, meanings in (
        ("longitude", ("longitude",)), ("latitude", ("latitude",)), ("radius", ("radius",)), ("time", _TIMES)
    ):  # fmt: skip
        if not set(meanings) & set(columns):
            names = " ".join(layout.columns.get(meaning, "") for meaning in meanings)
            raise InputError(where, f"no column for the {what}", " or ".join(names.split()), layout.remedy)
    return columns


def _values(table: CsvText, layout: Layout, names: Mapping[str, str]) -> dict[str, Array]:
    """Columns (n,) of numbers by their meaning, in the file's units."""
    gaps = [names[meaning] for meaning in _GAPS & set(names)] if layout is _OWN else []
    numbers = {meaning: name for meaning, name in names.items() if meaning != "utc"}
    columns = table.measured(*numbers.values(), gaps=gaps, largest=LARGEST)
    return {meaning: columns[name] for meaning, name in numbers.items()}


def _with_radius(
    table: CsvText, layout: Layout, names: Mapping[str, str], values: Mapping[str, Array]
) -> tuple[Mask, float]:
    """Which shots (n,) have a radius, and the unit of lengths in m."""
    radii = values["radius"]
    has_radius = ~((radii <= 0.0) & (radii >= _NONE))
    if not np.any(has_radius):
        raise InputError(str(table.path), f"{has_radius.size} shots without a radius", "shots that reached the ground")
    assert layout.altimeter is not None
    return has_radius, unit_of_radii(radii[has_radius], layout.altimeter.body, f"{table.path}, {names['radius']}")


def _spacecraft(value: Callable[[str], Array]) -> Array:
    """(n, 3) m, body-fixed, by axes or by planetocentric places; NaN where neither is known."""
    axes = np.column_stack([value(f"spacecraft {axis}") for axis in "xyz"])
    degrees = [value(f"spacecraft {coordinate}") * DEG for coordinate in ("longitude", "latitude")]
    places = from_planetocentric(np.column_stack([*degrees, value("spacecraft radius")]))
    return np.where(np.isnan(axes), places, axes)


def _altimeter(table: CsvText) -> Altimeter:
    for name in [name for name in table.names if plain_name(name) == "altimeter"]:
        stated = set(RepeatedNames.of(table.shown(name).arrow).distinct)
        if len(stated) > 1 or not stated <= {*ALTIMETERS, ANY.name}:
            found, expected = ", ".join(sorted(stated))[:60], f"one of {', '.join(ALTIMETERS)}"
            raise InputError(f"{table.path}, {name}", found, expected)
        return ALTIMETERS.get(stated.pop(), ANY)
    return ANY
