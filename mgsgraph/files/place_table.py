"""Tables of places to be projected (CSV): image places or ground places, other columns beside them kept as they are.

Columns of image places: isis_line, isis_sample (the first pixel's centre is (1, 1)) or line, sample (it is (0.5, 0.5)),
and of the ground under them height_m (above the ellipsoid) or radius_m, where they have their own. Columns of ground
places: x_m, y_m, z_m (body-fixed); longitude_deg, latitude_deg (planetocentric), radius_m; longitude_deg,
geodetic_latitude_deg, height_m; or longitude_deg, latitude_deg alone, of the surface.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.table import Row, csv_rows
from mgsgraph.files.networks.table_columns import CARTESIAN, GEODETIC, ISIS, OURS, PLACES, PLANETOCENTRIC
from mgsgraph.files.opening import finite_number
from mgsgraph.geometry.body import Ellipsoid, distances, from_geodetic, from_planetocentric, require_near
from mgsgraph.geometry.records import Array, frozen
from mgsgraph.units import DEG, ISIS_OFFSET

Sort = Literal["image", "ground"]
"""Whether places are image places or ground places."""
_SURFACE = PLANETOCENTRIC[:2]
_DISTANCE = re.compile(r"(radius|height)(_?(km|meters?|metres?))?")
"""Names of heights and radii whose unit is none of ours."""
_MOST = 360.0, 90.0
"""Degrees of a longitude and a latitude."""
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
        _require_degrees(frozen(places, "--place", (None, 2)), _SURFACE, lambda _: "--place")
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
        than the header; what is no number; a longitude beyond a whole turn; a latitude beyond a pole.
    """
    rows = csv_rows(path)
    number, header = next(rows, (1, []))
    names = [name.strip() for name in header]
    known = {name.lower(): name for name in names}
    lower = [name.lower() for name in names]
    for name in [name for k, name in enumerate(lower) if name in lower[:k]][:1]:
        raise InputError(f"{path}, line {number}", f"the column {name!r} twice", "each once")
    for name in lower:
        if _DISTANCE.fullmatch(name):  # else it would be kept beside the places, which would be of the surface
            expected = f"{GEODETIC[2]} or {PLANETOCENTRIC[2]}, in metres"
            raise InputError(f"{path}, line {number}", f"the column {name!r}", expected, "rename it, and mend its unit")
    pixel = next((pair for pair in (ISIS, OURS) if set(pair) <= set(known)), ())
    ground = next((group for group in (*PLACES, _SURFACE) if set(group) <= set(known)), ())
    if pixel and ground and sort is None:
        remedy = "--into image takes its ground places, --into ground its image places"
        raise InputError(f"{path}, line {number}", "image places and ground places", "one of them", remedy)
    if not (pixel if sort == "image" else ground if sort == "ground" else pixel or ground):
        found = f"the columns {', '.join(names)[:80]}" if names else "an empty table"
        raise InputError(f"{path}, line {number}", found, _WANTED)
    lines, texts = list[int](), list[list[str]]()
    for number, fields in rows:
        if len(fields) != len(names):
            raise InputError(f"{path}, line {number}", f"{len(fields)} fields", f"{len(names)}, as in the header")
        lines.append(number)
        texts.append(fields)
    if not lines:
        raise InputError(str(path), "a header alone", "places below it")
    columns = dict(zip(names, map(list, zip(*texts, strict=True)), strict=True))
    read = _Rows(path, lines, dict(zip(known, columns.values(), strict=True)))
    if sort == "image" or (sort is None and pixel):
        return _image_places(read, columns, pixel, body)
    return _ground_places(read, columns, ground, body, pixel == ISIS if pixel else None)


class _Rows(NamedTuple):
    """Rows below a header, column by column."""

    path: Path
    lines: list[int]
    """Of each row."""
    columns: dict[str, list[str]]
    """By their names in small letters."""

    def where(self, row: int) -> str:
        """File and line."""
        return f"{self.path}, line {self.lines[row]}"

    def numbers(self, names: Sequence[str]) -> Array:
        """(n, k) numbers; NaN in a row that has none of them, as places have that were projected and not found."""
        texts = list(zip(*([text.strip() for text in self.columns[name]] for name in names), strict=True))
        none = [math.nan] * len(names)
        try:
            return np.array([[*map(finite_number, row)] if any(row) else none for row in texts])
        except ValueError:
            for k, row in enumerate(texts):
                record = Row(self.where(k), f"line {self.lines[k]}", dict(zip(names, row, strict=True)))
                for name in names if any(row) else ():
                    record.number(name)
            raise


def _image_places(rows: _Rows, columns: dict[str, list[str]], pixel: tuple[str, ...], body: Ellipsoid) -> PlaceTable:
    isis = pixel == ISIS
    pixels = rows.numbers(pixel) - (ISIS_OFFSET if isis else 0.0)
    heights, radii = (
        rows.numbers((name,))[:, 0] if name in rows.columns else None for name in (GEODETIC[2], PLANETOCENTRIC[2])
    )
    none, plane = np.zeros((0, 3)), np.zeros((0, 2))
    if radii is not None:
        heights = None
        require_near(radii, body, lambda k: f"{rows.where(k)}, {PLANETOCENTRIC[2]}")
    return PlaceTable(str(rows.path), columns, "image", isis, pixels, heights, radii, none, plane)


def _ground_places(
    rows: _Rows, columns: dict[str, list[str]], ground: tuple[str, ...], body: Ellipsoid, isis: bool | None
) -> PlaceTable:
    none, points, plane = np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 2))
    given = rows.numbers(ground)
    if ground != CARTESIAN:
        _require_degrees(given[:, :2], ground, rows.where)
    if ground == _SURFACE:
        plane = given * DEG
    else:
        turned = given * [DEG, DEG, 1.0]
        points = (
            given if ground == CARTESIAN
            else from_planetocentric(turned) if ground == PLANETOCENTRIC else from_geodetic(turned, body)
        )  # fmt: skip
        radii = given[:, 2] if ground == PLANETOCENTRIC else distances(points)  # with its sign
        require_near(radii, body, lambda k: f"{rows.where(k)}, {ground[-1]}")
    return PlaceTable(str(rows.path), columns, "ground", isis, none, None, None, points, plane)


def _require_degrees(directions: Array, names: Sequence[str], where: Callable[[int], str]) -> None:
    """Raise InputError for a longitude beyond a whole turn, or a latitude (n, 2) beyond a pole."""
    for column, most in enumerate(_MOST):
        for k in np.flatnonzero(np.abs(directions[:, column]) > most + 1e-9)[:1].tolist():
            raise InputError(
                f"{where(k)}, {names[column]}", f"{directions[k, column]:g}", f"-{most:g} .. {most:g} degrees"
            )


def _texts(places: Array) -> list[list[str]]:
    return [[repr(value) for value in column] for column in places.T.tolist()]
