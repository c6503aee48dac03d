"""Tables of tie points and control points (CSV or Parquet, one measure a row), as they are measured by hand.

The first line names the columns (`networks.table_columns`): id, image, and isis_line, isis_sample (the first pixel's
centre is (1, 1)) or line, sample (it is (0.5, 0.5)); all others may be left out. Blank lines and lines that begin with
# count for nothing. A point without measures has one row without image. A Parquet file has the same columns
(`networks.table_parquet`).
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.network_file import read_control_network, read_network
from mgsgraph.files.networks.pvl import MEASURE_TYPES as ISIS_MEASURE_TYPES
from mgsgraph.files.networks.record import (
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    PointType,
    with_names,
)
from mgsgraph.files.networks.table_columns import (
    AXES,
    CARTESIAN,
    FLAGS,
    GEODETIC,
    ISIS,
    LARGEST_SIGMA,
    MATRIX,
    MEASURE_TYPES,
    OF_MEASURE,
    OF_POINT,
    OURS,
    PLACES,
    PLANETOCENTRIC,
    POINT_TYPES,
    TURN,
    UNCERTAINTIES,
    header_of,
    whole,
)
from mgsgraph.files.networks.table_parquet import PARQUET, parquet_columns, parquet_rows
from mgsgraph.files.networks.table_ties import csv_ties, tie_points_of
from mgsgraph.files.networks.tie_points import tie_points
from mgsgraph.files.opening import LARGEST_TEXT, finite_number, read_bytes, read_text
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.body import (
    Ellipsoid,
    distances,
    from_geodetic,
    from_planetocentric,
    planetocentric,
    require_near,
)
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG, ISIS_OFFSET

TABLES = (".csv", PARQUET)
"""Endings of tables."""
_OF_OTHERS = (".gcp", ".match", ".nvm")
"""Files of tie points that must be converted first."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")


@dataclass(slots=True, eq=False)
class Row:
    """A row of a table."""

    where: str
    """File, line or row, and point."""
    place: str
    """Line or row."""
    values: dict[str, str]
    """By column, those that are not empty."""

    def number(self, column: str) -> float:
        """A finite number; InputError for anything else, or nothing."""
        text = self.values.get(column, "")
        try:
            return finite_number(text)
        except ValueError:
            where, found = f"{self.where}, {column}", repr(text[:60]) if text else "nothing"
            remedy = "write a decimal point, not a comma" if _DECIMAL_COMMA.fullmatch(text) else ""
            raise InputError(where, found, "a finite number", remedy) from None

    def positive(self, column: str) -> float:
        """A number above zero."""
        value = self.number(column)
        if not 0.0 < value < LARGEST_SIGMA:
            raise InputError(f"{self.where}, {column}", f"{value:g}", "a positive number below 1e100")
        return value

    def flag(self, column: str) -> bool:
        """A truth value, False where there is none."""
        text = self.values.get(column, "false")
        if text.lower() not in FLAGS:
            raise InputError(f"{self.where}, {column}", repr(text[:60]), "true or false")
        return FLAGS[text.lower()]


@dataclass(slots=True, eq=False)
class _Point:
    """A point while its rows are read."""

    row: Row
    """Where each of its columns is first filled in, as one row."""
    measures: list[ControlMeasure] = field(default_factory=list)
    places: dict[str, str] = field(default_factory=dict)
    """Line or row of the measure in each image."""
    reference: int | None = None


def read_table(path: Path, ellipsoid: Ellipsoid | None = None) -> ControlNetwork:
    """Read a table of tie points and control points.

    Parameters
    ----------
    path : Path
        CSV, UTF-8, or by its ending .parquet Apache Parquet.
    ellipsoid : Ellipsoid, optional
        To which geodetic_latitude_deg and height_m refer, where the table has them; places must be near it.

    Returns
    -------
    ControlNetwork
        In the table's order; points are Free and measures Manual where their columns don't say otherwise.

    Raises
    ------
    InputError
        With file, line and point: a header that is none; a row with too many or too few fields; a word for a number; a
        measure without image, line or sample, or twice; what rows say of a point in contradiction; a constrained or
        fixed point without place, a constrained one without sigmas or covariance; a place half the body's radius from
        its centre, or twice it.
    """
    rows = parquet_rows(path) if path.suffix.lower() == PARQUET else _csv_places(path)
    place, fields = next(rows, ("line 1", []))
    if not fields:
        raise InputError(str(path), "an empty table", "a header: id,image,isis_line,isis_sample,...")
    names = header_of(fields, f"{path}, {place}")
    points: dict[str, _Point] = {}
    for place, fields in rows:
        if any(text.strip() for text in fields):
            _add_row(points, _row(path, place, fields, names), names)
    if not points:
        raise InputError(str(path), "no point", "one measure in every row below the header")
    apriori, uncertainty = whole(names, PLACES), whole(names, UNCERTAINTIES)
    made = tuple(_point(name, point, apriori, uncertainty, ellipsoid) for name, point in points.items())
    return with_names(ControlNetwork("", "", made, source=str(path)))


def read_whole(path: Path, ellipsoid: Ellipsoid | None = None) -> ControlNetwork:
    """All of a table (`is_table`) or of an ISIS control network; see `read_table`, `read_network`."""
    return read_table(path, ellipsoid) if is_table(path) else read_network(path)


def is_table(path: Path) -> bool:
    """Whether a file is a table by its ending."""
    return path.suffix.lower() in TABLES


def read_tie_points(path: Path, ellipsoid: Ellipsoid | None = None) -> TiePoints:
    """Tie points of a table (by the ending .csv or .parquet) or of an ISIS control network, on this body; see
    `read_table`, `read_control_network`.
    """
    ending = path.suffix.lower()
    if ending in TABLES:
        if ending == PARQUET:
            found = tie_points_of(parquet_columns(path), str(path), ellipsoid)
        else:
            found = csv_ties(read_bytes(path, LARGEST_TEXT), str(path), ellipsoid)
        return tie_points(read_table(path, ellipsoid), body=ellipsoid) if found is None else found
    if ending in _OF_OTHERS:
        expected = "a control network (.pvl, .net) or a table (.csv, .parquet)"
        raise InputError(str(path), f"a {ending} file", expected, f"mgsgraph convert {path.name} network.net")
    return read_control_network(path, ellipsoid)


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and fields of every line but blank ones and comments; a quoted field ends in its line."""
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            yield number, next(csv.reader((line,), strict=True))
        except (csv.Error, StopIteration) as error:
            raise InputError(f"{path}, line {number}", f"no row of a CSV file ({error})", "RFC 4180") from None


def _csv_places(path: Path) -> Iterator[tuple[str, list[str]]]:
    return ((f"line {number}", fields) for number, fields in csv_rows(path))


def _row(path: Path, place: str, fields: list[str], names: Sequence[str]) -> Row:
    where = f"{path}, {place}"
    if len(fields) != len(names):
        remedy = "write decimal points, not commas" if len(fields) > len(names) else ""
        if len(fields) == 1 and ";" in fields[0]:
            remedy = "write commas between the fields, not semicolons"
        raise InputError(where, f"{len(fields)} fields", f"{len(names)}, as in the header", remedy)
    values = {name: text for name, raw in zip(names, fields, strict=True) if (text := raw.strip())}
    if "id" not in values:
        raise InputError(where, "no id", "one in every row")
    return Row(f"{where}, point {values['id'][:60]}", place, values)


def _add_row(points: dict[str, _Point], row: Row, names: Sequence[str]) -> None:
    point = points.setdefault(row.values["id"], _Point(Row(row.where, row.place, {})))
    for name in OF_POINT:
        if name in row.values and point.row.values.setdefault(name, row.values[name]) != row.values[name]:
            found = f"{row.values[name][:60]!r}, and {point.row.values[name][:60]!r} in an earlier row"
            raise InputError(f"{row.where}, {name}", found, "the same in all of a point's rows")
    if "image" in row.values:
        _add_measure(point, row, ISIS if ISIS[0] in names else OURS)
        return
    for name in OF_MEASURE:
        if name in row.values:
            raise InputError(f"{row.where}, {name}", "a measure without image", "the image it was measured in")


def _add_measure(point: _Point, row: Row, place: tuple[str, str]) -> None:
    image = row.values["image"]
    if image in point.places:
        found = f"a second measure in image {image}, the first in {point.places[image]}"
        raise InputError(row.where, found, "one per point", "remove the worse one")
    point.places[image] = row.place
    shift = 0.0 if place == ISIS else ISIS_OFFSET
    if row.flag("reference"):
        if point.reference is not None:
            raise InputError(f"{row.where}, reference", "a second reference measure", "one of a point")
        point.reference = len(point.measures)
    kind = row.values.get("measure_type", "Manual").lower().replace("_", "")
    if kind not in MEASURE_TYPES:
        found = repr(row.values["measure_type"][:60])
        raise InputError(f"{row.where}, measure_type", found, ", ".join(ISIS_MEASURE_TYPES.values()))
    point.measures.append(
        ControlMeasure(
            serial_number=image,
            type=MEASURE_TYPES[kind],
            line=row.number(place[0]) + shift,
            sample=row.number(place[1]) + shift,
            line_sigma=row.positive("sigma_line_px") if "sigma_line_px" in row.values else None,
            sample_sigma=row.positive("sigma_sample_px") if "sigma_sample_px" in row.values else None,
            ignore=row.flag("ignore"),
        )
    )


def _point(
    name: str, point: _Point, place: Sequence[str], uncertainty: Sequence[str], ellipsoid: Ellipsoid | None
) -> ControlPoint:  # fmt: skip
    row = point.row
    kind = POINT_TYPES.get(row.values.get("type", "free").lower())
    if kind is None:
        raise InputError(f"{row.where}, type", repr(row.values["type"][:60]), "free, constrained or fixed")
    apriori = _place(row, place, ellipsoid) if any(column in row.values for column in place) else None
    ignored = row.flag("point_ignore")
    if apriori is None and kind != PointType.FREE and not ignored:
        expected = "x_m, y_m, z_m, or longitude_deg, latitude_deg, radius_m"
        remedy = "fill them in, or make the point free"
        raise InputError(row.where, f"{kind.name.lower()} without an a-priori place", expected, remedy)
    stated = any(column in row.values for column in uncertainty)
    if kind == PointType.CONSTRAINED and not stated and not ignored:
        raise InputError(row.where, "constrained without sigmas", "sigma_x_m, sigma_y_m, sigma_z_m, or others")
    used = kind == PointType.CONSTRAINED and not ignored
    if stated and apriori is None:
        raise InputError(row.where, "sigmas without an a-priori place", "both")
    return ControlPoint(
        id=name,
        type=kind,
        measures=tuple(point.measures),
        ignore=ignored,
        reference=point.reference,
        apriori=None if apriori is None else (float(apriori[0]), float(apriori[1]), float(apriori[2])),
        apriori_covariance=_covariance(row, uncertainty, apriori, used) if stated and apriori is not None else (),
    )


def _place(row: Row, columns: Sequence[str], ellipsoid: Ellipsoid | None) -> Array:
    """(3,) m, body-fixed; near the ellipsoid, where there is one."""
    place = _cartesian(row, columns, ellipsoid)
    if ellipsoid is not None:
        require_near(distances(place[None]), ellipsoid, lambda _: f"{row.where}, {columns[-1]}")
    return place


def _cartesian(row: Row, columns: Sequence[str], ellipsoid: Ellipsoid | None) -> Array:
    """(3,) m, body-fixed."""
    values = np.array([row.number(column) for column in columns])
    if tuple(columns) == CARTESIAN:
        return values
    if abs(values[1]) > 90.0:
        raise InputError(f"{row.where}, {columns[1]}", f"{values[1]:g}", "-90 .. 90 degrees")
    if abs(values[0]) > TURN:
        raise InputError(f"{row.where}, {columns[0]}", f"{values[0]:g}", f"-{TURN:g} .. {TURN:g} degrees")
    turned = values * [DEG, DEG, 1.0]
    if tuple(columns) == PLANETOCENTRIC:
        row.positive("radius_m")
        return from_planetocentric(turned)
    if ellipsoid is None:
        remedy = "say it (--radii, or --case), or write longitude_deg, latitude_deg and radius_m"
        raise InputError(f"{row.where}, height_m", "a height above an unknown ellipsoid", "its radii", remedy)
    return from_geodetic(turned, ellipsoid)


def _covariance(row: Row, columns: Sequence[str], place: Array, used: bool) -> tuple[float, ...]:
    """(6,) m^2, body-fixed: xx, xy, xz, yy, yz, zz; variances may be zero, as ISIS has them, where none is `used`."""
    if tuple(columns) == MATRIX:
        return tuple((row.positive if used and axes in ("xx", "yy", "zz") else row.number)(f"covariance_{axes}_m2")
                     for axes in ("xx", "xy", "xz", "yy", "yz", "zz"))  # fmt: skip
    sigmas = np.array([row.positive(column) for column in columns])
    if tuple(columns) == AXES:
        x, y, z = (sigmas**2).tolist()
        return x, 0.0, 0.0, y, 0.0, z
    longitude, latitude, _ = planetocentric(place)
    if GEODETIC[1] in row.values and columns[2] == "sigma_height_m":
        latitude = row.number(GEODETIC[1]) * DEG
    (sl, cl), (sb, cb) = (np.sin(longitude), np.cos(longitude)), (np.sin(latitude), np.cos(latitude))
    axes = np.array([[-sl, cl, 0.0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])
    return tuple(((axes.T * sigmas**2) @ axes)[np.triu_indices(3)].tolist())
