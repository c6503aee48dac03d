"""Columns of CSV text read by Arrow, without a Python object for each row or field; where Arrow finds something odd,
fields are looked at one by one: the first bad one is named with its line, or only Arrow doesn't know it ("+1.5").

Of tables of tie points, control points and other places: what is said of a header that isn't one, and what columns of
a-priori places and of their uncertainties mean.
"""

import csv
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.record import MeasureType, PointType, require_shown
from mgsgraph.files.networks.tie_points import FARTHEST
from mgsgraph.files.opening import LARGEST_NUMBER, finite_number, read_text
from mgsgraph.geometry.body import (
    Ellipsoid,
    distances,
    east_north_up,
    from_geodetic,
    from_planetocentric,
    require_near,
)
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names
from mgsgraph.units import DEG

_BLOCK = 1 << 24
"""bytes that Arrow parses at a time; no row is longer."""
_COMMENT = re.compile(r"\s*(?:#|$)")
_LEFT_OUT = re.compile(r"\n[^\S\n]*(?:#|\n)")
"""A comment or a blank line, unless it is the first one."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The columns of a table, CSV or Parquet."""

    path: Path
    header: str
    """Place of the names in the file: "line 1"."""
    row: str
    """What the file calls a row: "line"."""
    numbers: Index
    """(n,) number of each row in the file."""
    values: Mapping[str, pa.Array]
    """By the names of the columns, (n) each: texts without blanks around them, empty ones for nothing."""

    def where(self, row: int) -> str:
        """File, and line or row."""
        return f"{self.path}, {self.row} {self.numbers[row]}"

    def filled(self, name: str) -> Mask:
        """Which cells (n,) of a column are filled."""
        return np.asarray(pc.not_equal(self.values[name], ""))

    def chosen(self, rows: Index) -> "Columns":
        """Some of the rows, by their numbers from 0."""
        values = {name: column.take(pa.array(rows)) for name, column in self.values.items()}
        return replace(self, numbers=self.numbers[rows], values=values)


@dataclass(frozen=True, slots=True, eq=False)
class CsvText:
    """Rows of a table in CSV, of which columns are read when they are asked for."""

    path: Path
    header: str
    """Place of the names in the file: "line 1"."""
    names: tuple[str, ...]
    """Of the columns, as the header writes them."""
    numbers: Index
    """(n,) number of each row's line in the file."""
    body: bytes
    """The rows, in UTF-8."""
    with_commas: bool = True
    """Whether there were commas in the file, not blanks."""

    def __len__(self) -> int:
        return self.numbers.size

    def where(self, row: int, name: str = "") -> str:
        """File, line, and column where there is one."""
        return ", ".join(filter(None, (str(self.path), f"line {self.numbers[row]}", name)))

    def texts(self, *names: str) -> dict[str, pa.Array]:
        """Columns (n) of texts without blanks around them; InputError for a bad row, or one with another number of
        fields.
        """
        if not self.body:
            return dict.fromkeys(names, pa.array([], pa.large_string()))
        try:
            columns = self._read(names, pa.large_string())
        except pa.ArrowInvalid as error:
            for k, row in enumerate(self.body.decode().split("\n")):
                _require_width(_fields(row, self.where(k)), len(self.names), self.where(k))
            raise InputError(str(self.path), f"no CSV ({error})", "RFC 4180") from None
        return {name: pc.utf8_trim_whitespace(column) for name, column in columns.items()}

    def shown(self, name: str) -> Names:
        """Texts (n) of a column, none of which is empty; InputError for one that can't be shown."""
        names = Names.of(self.texts(name)[name])
        require_shown(names, partial(self.where, name=name), "a text")
        return names

    def measured(self, *names: str, gaps: Collection[str] = (), largest: float = LARGEST_NUMBER) -> dict[str, Array]:
        """Columns (n,) of finite numbers below the `largest`; NaN for empty cells of those that may have `gaps`.

        InputError for the first that is none.
        """
        full = [name for name in names if name not in gaps]
        try:
            columns = {name: np.asarray(column) for name, column in self._read(full, pa.float64()).items()}
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # where, or what Arrow doesn't know, is seen below
            columns = {}
        sound = {name: values for name, values in columns.items() if np.all(np.abs(values) < largest)}
        for name, column in self.texts(*(name for name in names if name not in sound)).items():
            sound[name] = measured(column, partial(self.where, name=name), largest)
            if name not in gaps and np.any(missing := np.isnan(sound[name])):
                raise InputError(self.where(int(np.argmax(missing)), name), "nothing", "a finite number")
        return sound

    def _read(self, names: Collection[str], kind: pa.DataType) -> dict[str, pa.Array]:
        """Columns of one kind; ArrowInvalid where they are none."""
        from pyarrow import csv as arrow_csv

        if not names:
            return {}
        column_names = [str(k) for k in range(len(self.names))]
        kinds = {str(self.names.index(name)): kind for name in names}
        table = arrow_csv.read_csv(
            pa.BufferReader(self.body),
            arrow_csv.ReadOptions(column_names=column_names, block_size=_BLOCK, use_threads=len(self.body) > _BLOCK),
            convert_options=arrow_csv.ConvertOptions(column_types=kinds, include_columns=list(kinds), null_values=[]),
        )
        if len(table) != len(self):
            raise pa.ArrowInvalid(f"{len(table)} rows in {len(self)} lines")
        return {name: table[str(self.names.index(name))].combine_chunks() for name in names}


def csv_text(text: str, path: Path, numbers: Index | None = None) -> CsvText:
    """A table in CSV (RFC 4180; UTF-8; a quoted field ends in its line), below a header.

    Blank lines, and lines that begin with #, count for nothing; `numbers` are those of its lines where they are other
    ones in the file.

    Raises
    ------
    InputError
        With file and line: no header; a name twice; a row that is none.
    """
    text = text.rstrip()
    if '"' in text or _COMMENT.match(text) or _LEFT_OUT.search(text):
        lines = [(k, line) for k, line in enumerate(text.split("\n"), start=1) if not _COMMENT.match(line)]
        for k, line in lines:
            if '"' in line:
                _fields(line, f"{path}, line {k}")
        text, numbers = "\n".join(line for _, line in lines), np.array([k for k, _ in lines], dtype=np.int64)
    head, _, body = text.partition("\n")
    require(head, str(path), "an empty table", "a header, and rows below it")
    numbers = np.arange(1, text.count("\n") + 2) if numbers is None else numbers
    header = f"line {numbers[0]}"
    names = tuple(name.strip() for name in _fields(head, f"{path}, {header}"))
    for name in [name for k, name in enumerate(names) if name and name.lower() in map(str.lower, names[:k])][:1]:
        raise InputError(f"{path}, {header}", f"the column {name!r} twice", "each once")
    return CsvText(path, header, names, numbers[1:], body.encode())


def csv_columns(path: Path) -> Columns:
    """All columns of a table in CSV as texts; see `csv_text`."""
    table = csv_text(read_text(path), path)
    return Columns(path, table.header, "line", table.numbers, table.texts(*table.names))


def _fields(line: str, where: str) -> list[str]:
    try:
        return next(csv.reader((line,), strict=True))
    except (csv.Error, StopIteration) as error:
        raise InputError(where, f"no row of a CSV file ({error})", "RFC 4180") from None


def _require_width(fields: list[str], width: int, where: str) -> None:
    if len(fields) != width:
        remedy = "write decimal points, not commas" if len(fields) > width else ""
        if len(fields) == 1 and ";" in fields[0]:
            remedy = "write commas between the fields, not semicolons"
        raise InputError(where, f"{len(fields)} fields", f"{width}, as in the header", remedy)


def _numbers_of(texts: pa.Array, largest: float) -> Array | None:
    """(n,) numbers that texts (n) spell in decimal, NaN for empty ones; None where one spells none, or one that is not
    smaller than the `largest`.
    """
    nonempty = pc.not_equal(texts, "")
    try:
        values = np.asarray(pc.if_else(nonempty, texts, None).cast(pa.float64()).fill_null(0.0))
    except pa.ArrowInvalid:
        return None
    return np.where(np.asarray(nonempty), values, np.nan) if np.all(np.abs(values) < largest) else None


def measured(column: pa.Array, where: Callable[[int], str], largest: float = LARGEST_NUMBER) -> Array:
    """(n,) finite numbers below the `largest` of a table's column, NaN for empty cells; InputError, with the words for
    `where` the k-th of them is, for the first that is none.
    """
    if (numbers := _numbers_of(column, largest)) is not None:
        return numbers
    values = np.full(len(column), np.nan)
    for k, text in enumerate(column.to_pylist()):  # Arrow doesn't know all numbers, such as "+1.5"
        if text:
            try:
                values[k] = finite_number(text)
            except ValueError:
                values[k] = math.inf
            if not abs(values[k]) < largest:
                remedy = "write a decimal point, not a comma" if _DECIMAL_COMMA.fullmatch(text) else ""
                raise InputError(where(k), repr(text[:60]), "a finite number", remedy)
    return values


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
"""Columns that are of the point: stated in one of its rows, or the same in all."""
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
    "sigma_east_m": "sigma_longitude_m", "sigma_north_m": "sigma_latitude_m", "sigma_up_m": "sigma_radius_m",
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
_LIKENESS = 0.7
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
        require(names.count(name) <= 1, where, f"the column {name!r} twice", "each once")
    for name in ("id", "image"):
        require(name in names, where, f"no column {name!r}", "id, image, and isis_line, isis_sample or line, sample")
    if len(whole(names, (ISIS, OURS), where)) != 2:
        raise InputError(where, "no columns of places", "isis_line and isis_sample, or line and sample", _COUNTS)
    place, uncertainty = whole(names, PLACES, where), whole(names, UNCERTAINTIES, where)
    if uncertainty and not place:
        raise InputError(where, f"{uncertainty[0]} without an a-priori place", "x_m, y_m and z_m, or others")
    require(uncertainty != NORMAL or place == GEODETIC, where, "sigma_height_m without height_m", "sigma_radius_m")
    return names


def whole(names: Sequence[str], groups: Sequence[Sequence[str]], where: str = "") -> tuple[str, ...]:
    """The one group of columns of which a table has any; InputError for a part of it or for two groups."""
    present = {name for group in groups for name in group if name in names}
    for group in groups:
        if present == set(group):
            return tuple(group)
    if not present:
        return ()
    ways = ", or ".join(" and ".join(group) for group in groups if present & set(group))
    raise InputError(where, f"columns {', '.join(name for name in names if name in present)}", ways)


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
    full = (axes.mT * values[:, None, :] ** 2) @ axes
    return np.asarray(full[:, *np.triu_indices(3)])


def _unknown(name: str, names: Sequence[str], where: str) -> InputError:
    if not name:
        return InputError(where, "a column without a name", "a name for each", "remove it, with the comma before it")
    close = get_close_matches(name, COLUMNS, n=1, cutoff=_LIKENESS)
    nearest = _MEANT.get(name) or (close[0] if close else "")
    remedy = f"rename it to {nearest!r}" if nearest else f"the columns there are: {', '.join(COLUMNS)}"
    if nearest and set(OURS) & set(names):
        remedy += f"; and {_COUNTS}"
    return InputError(where, f"an unknown column {name[:60]!r}", "names of columns in the first line", remedy)
