"""Columns of a table of tie points and control points: what is said of a header that isn't one, and what columns of
a-priori places and of their uncertainties mean.
"""

from collections.abc import Callable, Sequence
from difflib import get_close_matches

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import MeasureType, PointType
from mgsgraph.files.networks.tie_points import FARTHEST
from mgsgraph.geometry.body import (
    Ellipsoid,
    distances,
    east_north_up,
    from_geodetic,
    from_planetocentric,
    require_near,
)
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG

ISIS, OURS = ("isis_line", "isis_sample"), ("line", "sample")
"""Places counted from 1 as in ISIS (first pixel's centre at 1, 1), or from its corner (its centre at 0.5, 0.5)."""
CARTESIAN = ("x_m", "y_m", "z_m")
PLANETOCENTRIC = ("longitude_deg", "latitude_deg", "radius_m")
GEODETIC = ("longitude_deg", "geodetic_latitude_deg", "height_m")
PLACES = (CARTESIAN, PLANETOCENTRIC, GEODETIC)
"""Ways to say an a-priori place, one of which a table has."""
AXES = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
RADIAL = ("sigma_longitude_m", "sigma_latitude_m", "sigma_radius_m")
NORMAL = ("sigma_longitude_m", "sigma_latitude_m", "sigma_height_m")
MATRIX = tuple(f"covariance_{axes}_m2" for axes in ("xx", "xy", "xz", "yy", "yz", "zz"))
UNCERTAINTIES = (AXES, RADIAL, NORMAL, MATRIX)
"""Ways to say how well it is known, one of which a table has."""
OF_POINT = ("type", "point_ignore", *dict.fromkeys(name for group in (*PLACES, *UNCERTAINTIES) for name in group))
"""Columns that are of the point: said in one of its rows, or alike in all."""
OF_MEASURE = (*ISIS, *OURS, "sigma_line_px", "sigma_sample_px", "measure_type", "ignore", "reference")
"""Columns that are of the measure, besides its image."""
COLUMNS = ("id", "image", *OF_POINT, *OF_MEASURE)
TEXTS, TRUTHS = ("id", "image", "type", "measure_type"), ("point_ignore", "ignore", "reference")
"""Columns of words, and of truth values; all others are numbers."""
_MEANT = {
    **dict.fromkeys(("product", "product_id", "serial_number", "serialnumber", "camera", "picture", "scene"), "image"),
    **dict.fromkeys(("point", "point_id", "pointid", "name", "number"), "id"),
    **dict.fromkeys(("row", "y"), "line"), **dict.fromkeys(("column", "col", "x"), "sample"),
    **dict.fromkeys(("lat", "latitude"), "latitude_deg"), **dict.fromkeys(("lon", "longitude"), "longitude_deg"),
    **dict.fromkeys(("height", "elevation", "h"), "height_m"), "radius": "radius_m", "z": "z_m",
    **dict.fromkeys(("point_type", "pointtype", "kind"), "type"), "measuretype": "measure_type",
    "line_sigma": "sigma_line_px", "sample_sigma": "sigma_sample_px", "sigma_px": "sigma_line_px",
}  # fmt: skip
"""Other programs' names."""
POINT_TYPES = {kind.name.lower(): kind for kind in PointType}
MEASURE_TYPES = {kind.name.lower().replace("_", ""): kind for kind in MeasureType} | {
    "regpixel": MeasureType.REGISTERED_PIXEL, "regsubpixel": MeasureType.REGISTERED_SUBPIXEL,
}  # fmt: skip
"""By their names in ISIS, and as plio shortens them."""
FLAGS = {"true": 1, "yes": 1, "1": 1, "false": 0, "no": 0, "0": 0}
_MOST = 360.0, 90.0
"""Degrees of a longitude and a latitude."""
LARGEST_SIGMA = 1e100
"""Of sigmas, whose squares must be numbers."""
_ALIKE = 0.7
"""Of difflib: 'note' is not meant to be 'ignore'."""
_COUNTS = "name line and sample isis_line and isis_sample if the first pixel is (1, 1), as in ISIS"


def header_of(fields: Sequence[str], where: str) -> tuple[str, ...]:
    """Names of the columns; InputError for an unknown one, one twice, or too few or too many of those that go together.

    In capitals or not; `where` is file and line.
    """
    names = tuple(field.strip().lower() for field in fields)
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        mark = "semicolons" if ";" in names[0] else "tabs"
        remedy = "save it as CSV with commas between the fields and points in the numbers"
        raise InputError(where, f"fields with {mark} between them", "commas", remedy)
    for name in names:
        if name not in COLUMNS:
            raise _unknown(name, names, where)
        if names.count(name) > 1:
            raise InputError(where, f"the column {name!r} twice", "each once")
    for name in ("id", "image"):
        if name not in names:
            raise InputError(where, f"no column {name!r}", "id, image, and isis_line, isis_sample or line, sample")
    if len(whole(names, (ISIS, OURS), where)) != 2:
        raise InputError(where, "no columns of places", "isis_line and isis_sample, or line and sample", _COUNTS)
    place, uncertainty = whole(names, PLACES, where), whole(names, UNCERTAINTIES, where)
    if uncertainty and not place:
        raise InputError(where, f"{uncertainty[0]} without an a-priori place", "x_m, y_m and z_m, or others")
    if uncertainty == NORMAL and place != GEODETIC:
        raise InputError(where, "sigma_height_m without height_m", "sigma_radius_m")
    return names


def whole(names: Sequence[str], groups: Sequence[Sequence[str]], where: str = "") -> tuple[str, ...]:
    """The one group of columns of which a table has any; InputError for a part of it or for two groups."""
    mine = {name for group in groups for name in group if name in names}
    for group in groups:
        if mine == set(group):
            return tuple(group)
    if not mine:
        return ()
    ways = ", or ".join(" and ".join(group) for group in groups if mine & set(group))
    raise InputError(where, f"columns {', '.join(name for name in names if name in mine)}", ways)


def on_body(columns: Sequence[str], values: Array, body: Ellipsoid | None, where: Callable[[int, str], str]) -> Array:
    """Points (m, 3) in m, body-fixed, of one group of `PLACES`.

    Parameters
    ----------
    columns : sequence of str
        The group.
    values : (m, 3) array
        What its columns say; NaN passes.
    body : Ellipsoid, optional
        To which geodetic latitudes and heights refer, and near which the points must lie.
    where : callable
        Place of the k-th point and a column of it, for messages.

    Raises
    ------
    InputError
        A longitude beyond a whole turn, a latitude beyond a pole, a radius that is not positive, a point far from the
        body, heights above an unknown one.
    """
    columns = tuple(columns)
    if columns != CARTESIAN:
        require_degrees(columns, values, where)
    if columns == PLANETOCENTRIC:
        for k in np.flatnonzero(values[:, 2] <= 0.0)[:1].tolist():
            raise InputError(where(k, columns[2]), f"{values[k, 2]:g}", "a positive number below 1e100")
        values = from_planetocentric(values * [DEG, DEG, 1.0])
    elif columns == GEODETIC and len(values):
        if body is None:
            remedy = "say it (--radii, or --case), or write longitude_deg, latitude_deg and radius_m"
            raise InputError(where(0, columns[2]), "a height above an unknown ellipsoid", "its radii", remedy)
        values = from_geodetic(values * [DEG, DEG, 1.0], body)
    if body is not None:
        require_near(distances(values), body, lambda k: where(k, columns[2]))
    for k in np.flatnonzero(np.any(np.abs(values) > FARTHEST, axis=1))[:1].tolist():
        raise InputError(where(k, ""), f"a place at {tuple(values[k].tolist())} m", "one on the body")
    return values


def require_degrees(columns: Sequence[str], values: Array, where: Callable[[int, str], str]) -> None:
    """Raise InputError for a longitude beyond a whole turn, or a latitude (m, 2 or more) beyond a pole."""
    for column, most in enumerate(_MOST):
        for k in np.flatnonzero(np.abs(values[:, column]) > most + 1e-9)[:1].tolist():
            expected = f"-{most:g} .. {most:g} degrees"
            raise InputError(where(k, columns[column]), f"{values[k, column]:g}", expected)


def upper_triangles(columns: Sequence[str], values: Array, directions: Array) -> Array:
    """Covariances (m, 6) in m^2, body-fixed, xx, xy, xz, yy, yz, zz, of one group of `UNCERTAINTIES` but `MATRIX`.

    Its columns say `values` (m, 3) in m; `directions` (m, 3) point upward, along the radius or the normal.
    """
    axes = np.eye(3)[None] if tuple(columns) == AXES else east_north_up(directions)
    full = (np.swapaxes(axes, 1, 2) * values[:, None, :] ** 2) @ axes
    return np.asarray(full[:, *np.triu_indices(3)])


def _unknown(name: str, names: Sequence[str], where: str) -> InputError:
    if not name:
        return InputError(where, "a column without a name", "a name for each", "remove it, with the comma before it")
    close = get_close_matches(name, COLUMNS, n=1, cutoff=_ALIKE)
    nearest = _MEANT.get(name) or (close[0] if close else "")
    remedy = f"rename it to {nearest!r}" if nearest else f"the columns there are: {', '.join(COLUMNS)}"
    if nearest and set(OURS) & set(names):
        remedy += f"; and {_COUNTS}"
    return InputError(where, f"an unknown column {name[:60]!r}", "names of columns in the first line", remedy)
