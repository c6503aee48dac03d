"""Any laser altimetry as control, to an AltimetryCloud: what `shots` reads of altimeters' archives, and plain CSV.

A plain CSV names its columns, with their units, in its first line: longitude_deg and latitude_deg (east,
planetocentric) with radius_m, radius_km or height_m (above the body's ellipsoid), or x_m, y_m, z_m (body-fixed); it may
have id, profile or orbit, and time_s (TDB past J2000) or utc. All but PEDR files may be packed by gzip.

A profile is what the file calls so: for MOLA an orbit. In files that don't say it, shots that follow one another
without a pause of half an hour are one profile: an orbit takes two hours or so, so that each crossing of a stereo area
is one.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shot_values import by_pauses, positions, require_radii, unit_of_radii
from mgsgraph.files.altimetry.shots import shots_of, unpacked
from mgsgraph.files.altimetry.tables import TextTable, is_archive_table, table_of
from mgsgraph.files.opening import read_bytes
from mgsgraph.geometry.altimetry import AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import require_years, tdb_of_utc
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import KM

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
    >>> from mgsgraph.files.altimetry.cloud import read_altimetry_cloud
    >>> _ = Path("cloud.csv").write_text("longitude_deg,latitude_deg,height_m,id,profile\n87.1,4.2,-3700.0,1,9000\n")
    >>> print(read_altimetry_cloud(Path("cloud.csv"), network.images[0].body))
    AltimetryCloud(1 shots, 1 profiles, from cloud.csv)
    """
    content, packed = unpacked(read_bytes(path), path)
    table = None if b"\0" in content or not content or content.isspace() else table_of(content, path)
    if table is None or is_archive_table(table) or table.names[0].startswith("pdsversionid"):
        cloud = _cloud_of(shots_of(content, packed, path, version=version, table=table))
    else:
        cloud = _plain_table(table, body)
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


def _plain_table(table: TextTable, body: Ellipsoid | None) -> AltimetryCloud:
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
    times = numbers["times"] if "times" in numbers else _utc_times(table)
    require_years(times, str(table.path))
    named = [name for name in ("profile", "orbit") if name in names]
    keys = RepeatedNames.of(table.texts(named[0]).arrow) if named else _profiles(table, times)
    ids = table.texts("id") if "id" in names else Names.joined(table.line_numbers())
    return _in_profiles(table.path, ids, points, times, keys, float("nan"))


def _utc_times(table: TextTable) -> Array:
    """Times (n,) in s TDB past J2000 of a column of UTC; NaN where there is none."""
    if "utc" not in table.names:
        return np.full(len(table), np.nan)
    return tdb_of_utc(table.texts("utc"), f"{table.path}, utc")


def _profiles(table: TextTable, times: Array) -> RepeatedNames | Index:
    """Keys (n,) of profiles between pauses: the minute in which the first shot was fired, or numbers from 1."""
    if np.isnan(times[0]):
        return RepeatedNames((_product(table.path),), np.zeros(len(table), dtype=np.int64))
    numbers, first = by_pauses(times)
    if "utc" not in table.names:
        return numbers + 1
    begins = RepeatedNames.of([text[:16] for text in table.texts("utc")[first]])
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
