"""Tables of places to be projected (CSV): image places or ground places, other columns beside them kept as they are.

Columns of image places: isis_line, isis_sample (the first pixel's centre is (1, 1)) or line, sample (it is (0.5, 0.5)),
and of the ground under them height_m (above the ellipsoid) or radius_m, where they have their own. Columns of ground
places: x_m, y_m, z_m (body-fixed); longitude_deg, latitude_deg (planetocentric), radius_m; longitude_deg,
geodetic_latitude_deg, height_m; or longitude_deg, latitude_deg alone, of the surface.
"""

import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.csv_columns import (
    GEODETIC,
    ISIS,
    OURS,
    PLACES,
    PLANETOCENTRIC,
    csv_columns,
    measured,
    on_body,
    require_degrees,
)
from mgsgraph.geometry.body import Ellipsoid, require_near
from mgsgraph.geometry.records import Array, frozen
from mgsgraph.units import DEG, ISIS_OFFSET

Sort = Literal["image", "ground"]
"""Whether places are image places or ground places."""
_SURFACE = PLANETOCENTRIC[:2]
_DISTANCE = re.compile(r"(radius|height)(_?(km|meters?|metres?))?")
"""Names of heights and radii whose unit is none of ours."""
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
    isis: bool | None = None
    """Whether its columns of image places count from 1; None where it has none."""
    pixels: Array = field(default_factory=partial(np.zeros, (0, 2)))
    """(n, 2) line and sample, first pixel's centre at (0.5, 0.5); (0, 2) of ground places."""
    heights: Array | None = None
    """(n,) m above the ellipsoid, of the ground of each image place; None where the table has none."""
    radii: Array | None = None
    """(n,) m, the same as distance from the body's centre."""
    points: Array = field(default_factory=partial(np.zeros, (0, 3)))
    """(n, 3) m, body-fixed, of ground places; (0, 3) of those on the surface."""
    directions: Array = field(default_factory=partial(np.zeros, (0, 2)))
    """(n, 2) rad, planetocentric longitude and latitude of ground places on the surface; (0, 2) of others."""

    @classmethod
    def of_pixels(cls, places: Array, isis: bool) -> "PlaceTable":
        """Image places (n, 2) that stand in no file; counted from 1 or not."""
        pixels = frozen(places, "--pixel", (None, 2)) - (ISIS_OFFSET if isis else 0.0)
        return cls("--pixel", _texts(ISIS if isis else OURS, places), "image", isis, pixels)

    @classmethod
    def of_surface(cls, places: Array) -> "PlaceTable":
        """Planetocentric longitudes and latitudes (n, 2) in degrees that stand in no file."""
        require_degrees(_SURFACE, frozen(places, "--ground", (None, 2)), lambda _, name: f"--ground, {name}")
        return cls("--ground", _texts(_SURFACE, places), "ground", directions=places * DEG)


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
        than the header; what is no number; a longitude beyond a whole turn; a latitude beyond a pole.
    """
    table = csv_columns(path)
    names = {name.lower(): name for name in table.values}
    for name in filter(_DISTANCE.fullmatch, names):  # else it would be kept beside the places, as of the surface
        expected = f"{GEODETIC[2]} or {PLANETOCENTRIC[2]}, in metres"
        raise InputError(f"{path}, {table.header}", f"the column {name!r}", expected, "rename it, and fix its unit")
    pixel = next((pair for pair in (ISIS, OURS) if set(pair) <= set(names)), ())
    ground = next((group for group in (*PLACES, _SURFACE) if set(group) <= set(names)), ())
    if pixel and ground and sort is None:
        remedy = "--into image takes its ground places, --into ground its image places"
        raise InputError(f"{path}, {table.header}", "image places and ground places", "one of them", remedy)
    if not (pixel if sort == "image" else ground if sort == "ground" else pixel or ground):
        raise InputError(f"{path}, {table.header}", f"the columns {', '.join(table.values)[:80]}", _WANTED)
    require(table.numbers.size, str(path), "a header alone", "places below it")

    def where(row: int, name: str) -> str:
        return f"{table.where(row)}, {name}"

    def numbers(*wanted: str) -> Array:
        """(n, k) numbers; NaN in a row that has none of them, as places have that were projected and not found."""
        columns = [measured(table.values[names[name]], partial(where, name=name)) for name in wanted]
        missing = np.isnan(np.column_stack(columns))
        for row, column in np.argwhere(missing & ~np.all(missing, axis=1, keepdims=True))[:1].tolist():
            raise InputError(where(row, wanted[column]), "nothing", "a finite number")
        return np.column_stack(columns)

    isis = pixel == ISIS if pixel else None
    columns = {name: column.to_pylist() for name, column in table.values.items()}
    if sort == "image" or (sort is None and pixel):
        pixels = numbers(*pixel) - (ISIS_OFFSET if isis else 0.0)
        heights, radii = (numbers(name)[:, 0] if name in names else None for name in (GEODETIC[2], PLANETOCENTRIC[2]))
        if radii is not None:
            heights = None
            require_near(radii, body, partial(where, name=PLANETOCENTRIC[2]))
        return PlaceTable(str(path), columns, "image", isis, pixels, heights, radii)
    given = numbers(*ground)
    if ground == _SURFACE:
        require_degrees(ground, given, where)
        return PlaceTable(str(path), columns, "ground", isis, directions=given * DEG)
    return PlaceTable(str(path), columns, "ground", isis, points=on_body(ground, given, body, where))


def _texts(names: tuple[str, ...], places: Array) -> dict[str, list[str]]:
    return dict(zip(names, ([repr(value) for value in column] for column in places.T.tolist()), strict=True))
