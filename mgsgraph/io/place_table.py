"""Tables of places to be projected (CSV): image places or ground places, other columns beside them kept as they are.

Columns of image places: isis_line, isis_sample (the first pixel's centre is (1, 1)) or line, sample (it is (0.5, 0.5)),
and of the ground under them height_m (above the ellipsoid) or radius_m, where they have their own. Columns of ground
places: x_m, y_m, z_m (body-fixed); longitude_deg, latitude_deg (planetocentric), radius_m; longitude_deg,
geodetic_latitude_deg, height_m; or longitude_deg, latitude_deg alone, of the surface.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid, require_near
from mgsgraph.geometry.records import Array, frozen
from mgsgraph.io.control.table import Row, cartesian, csv_rows
from mgsgraph.io.control.table_columns import GEODETIC, ISIS, OURS, PLACES, PLANETOCENTRIC
from mgsgraph.units import DEG, ISIS_OFFSET

Sort = Literal["image", "ground"]
"""Whether places are image places or ground places."""
_SURFACE = PLANETOCENTRIC[:2]
_WANTED = "isis_line, isis_sample or line, sample; or x_m, y_m, z_m, longitude_deg, latitude_deg[, radius_m], ..."


@dataclass(frozen=True, slots=True, eq=False)
class PlaceTable:
    """Rows with places."""

    source: str
    """The file."""
    columns: dict[str, list[str]]
    """Texts of all columns by their names, as the file has them, empty ones too."""
    sort: Sort
    """What its places are."""
    isis: bool | None
    """Whether its columns of image places count from 1; None where it has none."""
    pixels: Array
    """(n, 2) line and sample, first pixel's centre at (0.5, 0.5); (0, 2) of ground places."""
    heights: Array | None
    """(n,) m above the ellipsoid, of the ground of each image place; None where the table has none."""
    radii: Array | None
    """(n,) m, the same as distance from the body's centre."""
    points: Array
    """(n, 3) m, body-fixed, of ground places; (0, 3) of those on the surface."""
    directions: Array
    """(n, 2) rad, planetocentric longitude and latitude of ground places on the surface; (0, 2) of others."""

    @classmethod
    def of_pixels(cls, places: Array, isis: bool) -> "PlaceTable":
        """Image places (n, 2) that stand in no file; counted from 1 or not."""
        pixels = frozen(places, "--pixel", (None, 2)) - (ISIS_OFFSET if isis else 0.0)
        none = np.zeros((0, 3)), np.zeros((0, 2))
        return cls("--pixel", dict(zip(ISIS if isis else OURS, _texts(places), strict=True)), "image", isis, pixels,
                   None, None, *none)  # fmt: skip

    @classmethod
    def of_surface(cls, places: Array) -> "PlaceTable":
        """Planetocentric longitudes and latitudes (n, 2) in degrees that stand in no file."""
        _require_latitudes(frozen(places, "--place", (None, 2))[:, 1], lambda _: "--place")
        none = np.zeros((0, 2)), None, None, np.zeros((0, 3))
        return cls("--place", dict(zip(_SURFACE, _texts(places), strict=True)), "ground", None, *none, places * DEG)


def read_places(path: Path, body: Ellipsoid, sort: Sort | None = None) -> PlaceTable:
    """Read a table of places.

    Parameters
    ----------
    path : Path
        CSV, UTF-8, with a header.
    body : Ellipsoid
        To which geodetic latitudes and heights refer.
    sort : "image" or "ground", optional
        What to take from a table that has both; it has to be said then.

    Raises
    ------
    InputError
        With file, line and column: a header without places, or with both and nothing said; a row of another length
        than the header; what is no number; a latitude beyond a pole.
    """
    rows = csv_rows(path)
    number, header = next(rows, (1, []))
    names = [name.strip() for name in header]
    known = {name.lower(): name for name in names}
    lower = [name.lower() for name in names]
    for name in [name for k, name in enumerate(lower) if name in lower[:k]][:1]:
        raise InputError(f"{path}, line {number}", f"the column {name!r} twice", "each once")
    pixel = next((pair for pair in (ISIS, OURS) if set(pair) <= set(known)), ())
    ground = next((group for group in (*PLACES, _SURFACE) if set(group) <= set(known)), ())
    if pixel and ground and sort is None:
        remedy = "--ground to project image places, --image to project ground places"
        raise InputError(f"{path}, line {number}", "image places and ground places", "one of them", remedy)
    if not (pixel if sort == "image" else ground if sort == "ground" else pixel or ground):
        found = f"the columns {', '.join(names)[:80]}" if names else "an empty table"
        raise InputError(f"{path}, line {number}", found, _WANTED)
    records, texts = list[Row](), list[list[str]]()
    for number, fields in rows:
        if len(fields) != len(names):
            raise InputError(f"{path}, line {number}", f"{len(fields)} fields", f"{len(names)}, as in the header")
        texts.append(fields)
        values = {name: text for name, raw in zip(known, fields, strict=True) if (text := raw.strip())}
        records.append(Row(f"{path}, line {number}", number, values))
    if not records:
        raise InputError(str(path), "a header alone", "places below it")
    columns = dict(zip(names, map(list, zip(*texts, strict=True)), strict=True))
    if sort == "image" or (sort is None and pixel):
        return _image_places(str(path), columns, records, pixel, known, body)
    return _ground_places(str(path), columns, records, ground, body, pixel == ISIS if pixel else None)


def _numbers(records: list[Row], columns: tuple[str, ...]) -> Array:
    """(n, k) numbers; NaN in a row that has none of them, as places have that were projected and not found."""
    none = [math.nan] * len(columns)
    return np.array([
        [row.number(column) for column in columns] if any(column in row.values for column in columns) else none
        for row in records
    ])  # fmt: skip


def _image_places(
    source: str, columns: dict[str, list[str]], records: list[Row], pixel: tuple[str, ...], known: dict[str, str],
    body: Ellipsoid,
) -> PlaceTable:  # fmt: skip
    isis = pixel == ISIS
    pixels = _numbers(records, pixel) - (ISIS_OFFSET if isis else 0.0)
    heights, radii = (
        _numbers(records, (name,))[:, 0] if name in known else None for name in (GEODETIC[2], PLANETOCENTRIC[2])
    )
    none, plane = np.zeros((0, 3)), np.zeros((0, 2))
    if radii is not None:
        heights = None
        require_near(radii, body, lambda k: f"{records[k].where}, {PLANETOCENTRIC[2]}")
    return PlaceTable(source, columns, "image", isis, pixels, heights, radii, none, plane)


def _ground_places(
    source: str, columns: dict[str, list[str]], records: list[Row], ground: tuple[str, ...], body: Ellipsoid,
    isis: bool | None,
) -> PlaceTable:  # fmt: skip
    none, plane = np.zeros((0, 2)), np.zeros((0, 2))
    if ground == _SURFACE:
        plane = _numbers(records, ground) * DEG
        _require_latitudes(plane[:, 1] / DEG, lambda k: records[k].where)
        return PlaceTable(source, columns, "ground", isis, none, None, None, np.zeros((0, 3)), plane)
    none_given = np.full(3, np.nan)
    points = np.array([
        cartesian(row, ground, body) if any(column in row.values for column in ground) else none_given
        for row in records
    ])  # fmt: skip
    require_near(np.linalg.norm(points, axis=1), body, lambda k: f"{records[k].where}, {ground[-1]}")
    return PlaceTable(source, columns, "ground", isis, none, None, None, points, plane)


def _require_latitudes(latitudes: Array, where: Callable[[int], str]) -> None:
    for k in np.flatnonzero(np.abs(latitudes) > 90.0 + 1e-9)[:1].tolist():
        raise InputError(f"{where(k)}, {_SURFACE[1]}", f"{latitudes[k]:g}", "-90 .. 90 degrees")


def _texts(places: Array) -> list[list[str]]:
    return [[repr(value) for value in column] for column in places.T.tolist()]
