"""Laser shots of any altimeter's file, known by its content, and the cloud of ground returns, of plain CSV too.

What is read: MOLA PEDR and LOLA RDR, binary (`binary`); tables of PEDR2TAB, of the Orbital Data Explorer (MOLA, LOLA,
MLA) and selections of `mgsgraph footprints` (`tables`); any PDS3 table by its label (`labelled_table`); as a cloud,
plain CSV too. All but PEDR files may be packed by gzip.

A plain CSV names its columns, with their units, in its first line: longitude_deg and latitude_deg (east,
planetocentric) with radius_m, radius_km or height_m (above the body's ellipsoid), or x_m, y_m, z_m (body-fixed); it may
have id, profile or orbit, and time_s (TDB past J2000) or utc.

A profile is what the file calls so: for MOLA an orbit. In files that don't say it, shots that follow one another
without a pause of half an hour are one profile: an orbit takes two hours or so, so that each crossing of a stereo area
is one.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.binary import FRAME, is_lola_rdr, lola_shots, pedr_shots
from mgsgraph.files.altimetry.labelled_table import is_label, read_labelled_shots, require_whole
from mgsgraph.files.altimetry.shot_values import (
    by_pauses,
    positions,
    require_possible_shots,
    require_radii,
    unit_of_radii,
)
from mgsgraph.files.altimetry.tables import LARGEST, is_archive, plain_name, shots_of_table, table_of
from mgsgraph.files.csv_columns import CsvText
from mgsgraph.files.opening import decoded_text, read_bytes, unpacked_gzip
from mgsgraph.geometry.altimetry import AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, ellipsoidal_heights
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import require_years, tdb_of_utc
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import KM

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
    content = _shots_or_table(path, clock_bias, version)
    if isinstance(content, CsvText):
        content = shots_of_table(content, clock_bias, version)
        require_possible_shots(content)
    return content


def _shots_or_table(path: Path, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots | CsvText:
    """Shots of a file as `read_shots` has them; a table that is no altimeter's archive as it is."""
    content = read_bytes(path)
    if packed := content.startswith(b"\x1f\x8b"):
        content = unpacked_gzip(content, str(path), max(_SMALL, _MOST_TIMES * len(content)))
    require(content and not content.isspace(), str(path), "an empty file", "laser shots")
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
    require(not packed, str(path), "a packed PEDR file", "one that is not packed", "unpack it with gunzip")
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
    >>> print(mgsgraph.read_altimetry_cloud(Path("cloud.csv"), network.body))
    AltimetryCloud(1 shots, 1 profiles, from cloud.csv)
    """
    content = _shots_or_table(path, version=version)
    cloud = _plain_table(content, body) if isinstance(content, CsvText) else _cloud_of(content)
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
    require(len(table), str(table.path), "a header alone", "rows below it")
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
        return RepeatedNames((path.name.partition(".")[0],), np.zeros(times.size, dtype=np.int64))
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
        lift = heights - ellipsoidal_heights(points, body)
        points = points * (1.0 + lift / np.linalg.norm(points, axis=1))[:, None]
    return points
