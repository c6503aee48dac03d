"""Tables of tie points and control points (CSV or Parquet, one measure a row), as they are measured by hand.

The first line names the columns (`files.csv_columns`): id, image, and isis_line, isis_sample (the first pixel's
centre is (1, 1)) or line, sample (it is (0.5, 0.5)); all others may be left out. Blank lines and lines that begin with
# count for nothing. A point without measures has one row without image. A Parquet file has the same columns: numbers as
float64 or whole ones, flags as truth values or words, null for nothing.

A table is read by columns, without an object for each point and measure; what is wrong is said with its line (or row),
its point and its column.
"""

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError, command_line, require
from mgsgraph.files.csv_columns import (
    CARTESIAN,
    FLAGS,
    ISIS,
    LARGEST_SIGMA,
    MATRIX,
    MEASURE_TYPES,
    NORMAL,
    OF_MEASURE,
    OF_POINT,
    OURS,
    PLACES,
    POINT_TYPES,
    TEXTS,
    TRUTHS,
    UNCERTAINTIES,
    Columns,
    csv_columns,
    header_of,
    measured,
    on_body,
    upper_triangles,
    whole,
)
from mgsgraph.files.networks.binary import read_control_network, read_network
from mgsgraph.files.networks.pvl import MEASURE_TYPES as ISIS_MEASURE_TYPES
from mgsgraph.files.networks.record import ControlNetwork, MeasureType, PointType, require_shown
from mgsgraph.files.networks.tie_points import PointArrays, TiePoints
from mgsgraph.files.opening import ANY_SIZE, opened, read_bytes, understood
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import DEG, ISIS_OFFSET

PARQUET, MAGIC = ".parquet", b"PAR1"
"""Ending of a Parquet file's name, and how its content begins."""
TABLES = (".csv", PARQUET)
"""Endings of tables."""
_OF_OTHERS = (".gcp", ".match", ".nvm")
"""Files of tie points that must be converted first."""
_WHAT = "an Apache Parquet file"
_MOST_PACKED, _LEAST_LIMIT = 100, 1 << 25
"""By how much a table may be packed, and bytes and rows that it may always have."""


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
    points, types, references = _read(path, ellipsoid)
    return points.network(types, references)


def read_whole(path: Path, ellipsoid: Ellipsoid | None = None) -> ControlNetwork:
    """All of a table (`is_table`) or of an ISIS control network; see `read_table`, `read_network`."""
    return read_table(path, ellipsoid) if is_table(path) else read_network(path)


def is_table(path: Path) -> bool:
    """Whether a file is a table by its ending."""
    return path.suffix.lower() in TABLES


def read_tie_points(
    path: Path, ellipsoid: Ellipsoid | None = None, placed: Callable[[Columns], Columns] | None = None
) -> TiePoints:
    """Tie points of a table (by the ending .csv or .parquet) or of an ISIS control network, on this body; see
    `read_table`, `read_control_network`. `placed` makes columns of places of a table's others.
    """
    ending = path.suffix.lower()
    if ending in TABLES:
        points = _read(path, ellipsoid, placed)[0]
        return points.tie_points(lambda k, *_: f"{path}, point {points.ids[k]}", ellipsoid)
    if ending in _OF_OTHERS:
        expected = "a control network (.pvl, .net) or a table (.csv, .parquet)"
        raise InputError(str(path), f"a {ending} file", expected, command_line("convert", path.name, "network.net"))
    return read_control_network(path, ellipsoid)


# --- Parquet


def parquet_names(path: Path) -> list[str]:
    """Names of the columns, in small letters; InputError for a file that is none."""
    from pyarrow import parquet

    with opened(path, ANY_SIZE) as file, understood(str(path), _WHAT), _damage():
        return [name.strip().lower() for name in parquet.read_schema(file).names]


def _parquet_columns(path: Path) -> Columns:
    """All columns; InputError for a file that is none, and for a column of another kind."""
    from pyarrow import parquet

    content, source = read_bytes(path), str(path)
    with understood(source, _WHAT), _damage():
        file = parquet.ParquetFile(pa.BufferReader(content))
        head, limit = file.metadata, max(_LEAST_LIMIT, _MOST_PACKED * len(content))
        size = sum(head.row_group(k).total_byte_size for k in range(head.num_row_groups))
        if head.num_rows > limit or size > limit:
            found = f"{head.num_rows} rows, {size} bytes unpacked"
            raise InputError(source, found, f"up to {limit} of either, the file being so small", "write it again")
        table = file.read(use_threads=False)
        names = header_of(table.column_names, f"{source}, columns")
        columns = {name: _parquet_column(name, table.column(k), source) for k, name in enumerate(names)}
    return Columns(path, "columns", "row", np.arange(1, head.num_rows + 1), columns)


@contextmanager
def _damage() -> Iterator[None]:
    """Turn Arrow's errors of a damaged file into a ValueError."""
    try:
        yield
    except OSError as error:
        raise ValueError(error) from None


def _parquet_column(name: str, chunks: pa.ChunkedArray, source: str) -> pa.Array:
    column = pa.chunked_array(chunks).combine_chunks() if chunks.num_chunks != 1 else chunks.chunk(0)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    column.validate(full=True)  # texts that are none
    of, kind = pa.types, column.type
    sound = of.is_null(kind) or of.is_string(kind) or of.is_large_string(kind) or of.is_integer(kind)
    if name not in TEXTS:
        sound |= of.is_boolean(kind) if name in TRUTHS else of.is_floating(kind)
    if not sound:
        expected = "texts" if name in TEXTS else "truth values" if name in TRUTHS else "numbers"
        raise InputError(f"{source}, column {name}", f"values of the kind {kind}", expected)
    if of.is_floating(kind):
        column = column.cast(pa.float64())
        column = pc.if_else(pc.is_nan(column), None, column)
    return pc.utf8_trim_whitespace(column.cast(pa.large_string()).fill_null(""))  # of numbers all digits


# --- rows, measures and points


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of a table, and which point each is of."""

    table: Columns
    point: Index
    """(m,) number of each row's point, in the order in which they come."""
    first: Index
    """(n,) first row of each point."""

    def where(self, row: int, name: str = "") -> str:
        """File, line or row, point and column."""
        point = self.table.values["id"][row].as_py()[:60]
        return ", ".join(filter(None, (self.table.where(row), point and f"point {point}", name)))

    def refuse(
        self, bad: Mask, name: str, found: str | Callable[[int], str], expected: str, rows: Index, remedy: str = ""
    ) -> None:
        """Raise InputError for the first bad one (k,) of some `rows` (k,); `found` may be made of its number."""
        for k in np.flatnonzero(bad)[:1].tolist():
            text = found if isinstance(found, str) else found(k)
            raise InputError(self.where(int(rows[k]), name), text, expected, remedy)

    def numbers(self, name: str, rows: Index) -> Array:
        """(k,) finite numbers of a column in some rows, NaN where it is empty."""
        return measured(self.table.values[name].take(pa.array(rows)), lambda k: self.where(int(rows[k]), name))

    def require_positive(self, name: str, values: Array, rows: Index) -> None:
        """Raise InputError for a number (k,) that is not above zero; NaN passes."""
        bad = (values <= 0.0) | (values >= LARGEST_SIGMA)
        self.refuse(bad, name, lambda k: f"{values[k]:g}", "a positive number below 1e100", rows)

    def words(self, name: str, rows: Index, meanings: Mapping[str, int], empty: int, expected: str) -> Index:
        """(k,) meanings of the words of a column in some rows; `empty` for an empty cell."""
        if name not in self.table.values:
            return np.full(rows.size, empty)
        cells = RepeatedNames.of(self.table.values[name].take(pa.array(rows)))
        meant = [meanings.get(word.lower().replace("_", ""), -1) if word else empty for word in cells.distinct]
        values = np.array([*meant, empty], dtype=np.int64)[cells.numbers]
        self.refuse(values < 0, name, lambda k: repr(cells[k][:60]), expected, rows)
        return values

    def flags(self, name: str, rows: Index) -> Mask:
        """(k,) truth values, False where there is none."""
        return self.words(name, rows, FLAGS, 0, "true or false").astype(bool)

    def stated_rows(self, name: str) -> Index:
        """(n,) the first row of each point that states a column, any where none does; all must state the same."""
        if name not in self.table.values:
            return self.first
        filled = np.flatnonzero(self.table.filled(name))
        texts, of_point, rows = self.table.values[name].take(pa.array(filled)), self.point[filled], self.first.copy()
        rows[of_point[::-1]] = filled[::-1]
        codes = np.zeros(self.point.size, dtype=np.int64)
        codes[filled] = np.asarray(texts.dictionary_encode().indices)
        first_rows = rows[of_point]

        def found(k: int) -> str:
            first = str(self.table.values[name][first_rows[k]])
            return f"{str(texts[k])[:60]!r}, and {first[:60]!r} in an earlier row"

        self.refuse(codes[filled] != codes[first_rows], name, found, "the same in all of a point's rows", filled)
        return rows

    def group(self, names: Sequence[str]) -> tuple[Array, Mask]:
        """(n, c) numbers of columns that are of the point and go together, and which points (n,) have them."""
        rows = [self.stated_rows(name) for name in names]
        columns = [self.numbers(name, of) for name, of in zip(names, rows, strict=True)]
        values = np.column_stack([np.zeros((self.first.size, 0)), *columns])
        stated = np.any(~np.isnan(values), axis=1)
        for name, of, column in zip(names, rows, columns, strict=True):
            self.refuse(stated & np.isnan(column), name, "nothing", "a finite number", of)
        return values, stated


def _read(
    path: Path, body: Ellipsoid | None, placed: Callable[[Columns], Columns] | None = None
) -> tuple[PointArrays, Index, Index]:
    """Points and measures, types of the measures (k,) and the reference of each point (n,), -1 for none."""
    table = _parquet_columns(path) if path.suffix.lower() == PARQUET else csv_columns(path)
    table = table if placed is None else placed(table)
    names = header_of(tuple(table.values), f"{path}, {table.header}")
    table = replace(table, values=dict(zip(names, table.values.values(), strict=True)))
    table = table.chosen(np.flatnonzero(np.any([table.filled(name) for name in names], axis=0)))
    require(table.numbers.size, str(path), "no point", "one measure in every row below the header")
    coded = table.values["id"].dictionary_encode()
    point = np.asarray(coded.indices).astype(np.int64)
    rows = _Rows(table, point, np.unique(point, return_index=True)[1])
    all_points, has_image = np.arange(point.size), table.filled("image")
    rows.refuse(~table.filled("id"), "", "no id", "one in every row", all_points)
    for name in [name for name in OF_MEASURE if name in names]:
        bad = table.filled(name) & ~has_image
        rows.refuse(bad, name, "a measure without image", "the image it was measured in", all_points)
    of_measures = np.flatnonzero(has_image)
    of_measures = of_measures[np.argsort(point[of_measures], kind="stable")]
    first = np.searchsorted(point[of_measures], np.arange(rows.first.size + 1))
    ids, image = Names.of(coded.dictionary), RepeatedNames.of(table.values["image"].take(pa.array(of_measures)))
    require_shown(ids, lambda k: rows.where(int(rows.first[k])), "an id")
    require_shown(Names.of(image.distinct), lambda k: rows.where(int(of_measures[np.argmax(image.numbers == k)])))
    kinds = rows.words(
        "measure_type", of_measures, MEASURE_TYPES, int(MeasureType.MANUAL), ", ".join(ISIS_MEASURE_TYPES.values())
    )
    measures, left_out = _measures(rows, of_measures), rows.flags("ignore", of_measures)
    reference = np.flatnonzero(rows.flags("reference", of_measures))
    of_point = point[of_measures[reference]]
    twice = np.diff(of_point, prepend=-1) == 0
    rows.refuse(twice, "reference", "a second reference measure", "one of a point", of_measures[reference])
    references = np.full(rows.first.size, -1)
    references[of_point] = reference - first[of_point]
    head = ControlNetwork("", "", (), source=str(path))
    points = PointArrays(head, ids, *_points(rows, body), first, image, measures, left_out)
    points.require_once(lambda i, k, _: rows.where(int(of_measures[first[i] + k]), f"image {image[first[i] + k]}"))
    return points, kinds, references


def _measures(rows: _Rows, of_measures: Index) -> Array:
    """(k, 4) line and sample as ISIS counts them, and their sigmas, NaN where unstated."""
    columns = rows.table.values
    measures = np.full((of_measures.size, 4), np.nan)
    for c, name in enumerate((*(ISIS if ISIS[0] in columns else OURS), "sigma_line_px", "sigma_sample_px")):
        if name in columns:
            measures[:, c] = rows.numbers(name, of_measures)
        if c < len(ISIS):
            rows.refuse(np.isnan(measures[:, c]), name, "nothing", "a finite number", of_measures)
            measures[:, c] += 0.0 if name in ISIS else ISIS_OFFSET
        else:
            rows.require_positive(name, measures[:, c], of_measures)
    return measures


def _points(rows: _Rows, body: Ellipsoid | None) -> tuple[Index, Mask, Array, Array]:
    """Types (n,) by ISIS's numbers, which are ignored, places (n, 3) in m and covariances (n, 6) in m^2, NaN where none
    are said.
    """
    names, n = tuple(rows.table.values), rows.first.size
    types = rows.words("type", rows.stated_rows("type"), POINT_TYPES, int(PointType.FREE), "free, constrained or fixed")
    ignored = rows.flags("point_ignore", rows.stated_rows("point_ignore"))
    place, uncertainty = whole(names, PLACES), whole(names, UNCERTAINTIES)
    (given, placed), (sigmas, stated) = rows.group(place), rows.group(uncertainty)
    constrained = (types == PointType.CONSTRAINED) & ~ignored
    expected = "x_m, y_m, z_m, or longitude_deg, latitude_deg, radius_m"
    bad, remedy = ~placed & (types != PointType.FREE) & ~ignored, "fill them in, or make the point free"

    def without(k: int) -> str:
        return f"{PointType(types[k]).name.lower()} without an a-priori place"

    rows.refuse(bad, "", without, expected, rows.first, remedy)
    places, covariances, chosen = np.full((n, 3), np.nan), np.full((n, 6), np.nan), rows.first[placed]
    if place:
        places[placed] = on_body(place, given[placed], body, lambda k, name: rows.where(int(chosen[k]), name))
    expected = "sigma_x_m, sigma_y_m, sigma_z_m, or others"
    rows.refuse(constrained & ~stated, "", "constrained without sigmas", expected, rows.first)
    rows.refuse(stated & ~placed, "", "sigmas without an a-priori place", "both", rows.first)
    for c, name in enumerate(uncertainty):
        if uncertainty != MATRIX:
            rows.require_positive(name, sigmas[:, c], rows.first)
        elif name[-5] == name[-4]:  # of what no adjustment uses they may be zero, as ISIS has them
            rows.require_positive(name, np.where(constrained, sigmas[:, c], np.nan), rows.first)
    upward = places[stated]
    if uncertainty == NORMAL:
        upward = from_planetocentric(given[stated] * [DEG, DEG, 0.0] + [0.0, 0.0, 1.0])
    if uncertainty:
        covariances[stated] = (
            sigmas[stated] if uncertainty == MATRIX else upper_triangles(uncertainty, sigmas[stated], upward)
        )
    return types, ignored, places, covariances


# --- writing


def table_text(network: ControlNetwork) -> str:
    """A network as a table, counted as in ISIS; numbers are written so that they come back bit for bit.

    Columns that no point fills are left out. Raises InputError for a name that no table can hold, with line breaks or
    blanks around it.
    """
    names, rows = _rows(network)
    text = io.StringIO()
    plain = csv.writer(text, lineterminator="\n")
    careful = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL)
    plain.writerow(names)
    for row in rows:
        values = ("true" if row.get(name) is True else row.get(name) for name in names)
        (careful if str(row["id"]).startswith("#") else plain).writerow(["" if v is None else v for v in values])
    return text.getvalue()


def table_parquet(network: ControlNetwork) -> bytes:
    """The same columns as an Apache Parquet file: numbers as float64, flags as truths, null for nothing."""
    from pyarrow import parquet

    names, rows = _rows(network)
    kinds = [pa.string() if name in TEXTS else pa.bool_() if name in TRUTHS else pa.float64() for name in names]
    columns = [pa.array([row.get(name) for row in rows], kind) for name, kind in zip(names, kinds, strict=True)]
    out = io.BytesIO()
    parquet.write_table(pa.table(columns, names), out, compression="zstd")
    return out.getvalue()


def _rows(network: ControlNetwork) -> tuple[list[str], list[dict[str, str | float | None]]]:
    """Names of the columns that are filled, and rows: a measure in each, or a point without any."""
    rows, where = list[dict[str, str | float | None]](), network.source or "network"
    for point in network.points:
        covariance = point.apriori_covariance if point.apriori is not None else ()
        of_point: dict[str, str | float | None] = {
            "id": _name(point.id, where), "type": point.type.name.lower(), "point_ignore": point.ignore or None,
            **dict(zip(CARTESIAN, point.apriori or (), strict=False)),
            **dict(zip(MATRIX, covariance, strict=False)),
        }  # fmt: skip
        of_measures = [
            of_point | {
                "image": _name(measure.serial_number, where), "isis_line": measure.line, "isis_sample": measure.sample,
                "measure_type": ISIS_MEASURE_TYPES[measure.type], "sigma_line_px": _positive(measure.line_sigma),
                "sigma_sample_px": _positive(measure.sample_sigma), "ignore": measure.ignore or None,
                "reference": point.reference == k or None,
            }
            for k, measure in enumerate(point.measures) if measure.line is not None and measure.sample is not None
        ]  # fmt: skip
        rows += of_measures or [of_point]
    names = [*("id", "image", "type"), *ISIS]
    filled = {name for row in rows for name, value in row.items() if value is not None}
    return [*names, *(name for name in (*OF_MEASURE, *OF_POINT) if name in filled and name not in names)], rows


def _positive(sigma: float | None) -> float | None:
    return sigma if sigma is not None and sigma > 0.0 else None


def _name(text: str, where: str) -> str:
    if not text or text != text.strip() or len(text.splitlines()) != 1:
        raise InputError(where, f"the name {text[:60]!r}", "one line without blanks around it", "rename it (--rename)")
    return text
