"""Tables of tie points and control points (CSV, one measure a row), as they are measured by hand.

The first line names the columns (`files.csv_columns`): id, image, and isis_line, isis_sample (the first pixel's
centre is (1, 1)) or line, sample (it is (0.5, 0.5)); all others may be left out. Blank lines and lines that begin with
# count for nothing. A point without measures has one row without image.

A table is read by columns, without an object for each point and measure; what is wrong is said with its line, its
point and its column.
"""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from mgsgraph.errors import InputError
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
    UNCERTAINTIES,
    CsvText,
    csv_text,
    filled,
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
from mgsgraph.files.opening import read_text
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import DEG, ISIS_OFFSET

TABLE = ".csv"
"""Ending of tables."""
_OF_OTHERS = (".gcp", ".match", ".nvm")
"""Files of tie points that must be converted first."""


def read_table(path: Path, ellipsoid: Ellipsoid | None = None) -> ControlNetwork:
    """Read a table of tie points and control points.

    Parameters
    ----------
    path : Path
        CSV, UTF-8.
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
    return path.suffix.lower() == TABLE


def read_tie_points(path: Path, ellipsoid: Ellipsoid | None = None) -> TiePoints:
    """Tie points of a table (by the ending .csv) or of an ISIS control network, on this body; see
    `read_table`, `read_control_network`.
    """
    ending = path.suffix.lower()
    if is_table(path):
        points = _read(path, ellipsoid)[0]
        return points.tie_points(lambda k, *_: f"{path}, point {points.ids[k]}", ellipsoid)
    if ending in _OF_OTHERS:
        expected = "a control network (.pvl, .net) or a table (.csv)"
        raise InputError(str(path), f"a {ending} file", expected, f"mgsgraph convert {path.name} network.net")
    if ending == ".parquet":
        raise InputError(str(path), "a table in Parquet", "the table as CSV, or a control network", "write it as .csv")
    return read_control_network(path, ellipsoid)


# --- rows, measures and points


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of a table, and which point each is of."""

    text: CsvText
    values: Mapping[str, pa.Array]
    """By the names of the columns, texts (m) without blanks around them, empty ones for nothing."""
    lines: Index
    """(m,) number of each row among those of the text."""
    point: Index
    """(m,) number of each row's point, in the order in which they come."""
    first: Index
    """(n,) first row of each point."""

    def where(self, row: int, name: str = "") -> str:
        """File, line, point and column."""
        point = self.values["id"][row].as_py()[:60]
        return ", ".join(filter(None, (self.text.where(int(self.lines[row])), point and f"point {point}", name)))

    def refuse(
        self, bad: Mask, name: str, found: str | Callable[[int], str], expected: str, rows: Index, remedy: str = ""
    ) -> None:
        """Raise InputError for the first bad one (k,) of some `rows` (k,); `found` may be made of its number."""
        for k in np.flatnonzero(bad)[:1].tolist():
            said = found if isinstance(found, str) else found(k)
            raise InputError(self.where(int(rows[k]), name), said, expected, remedy)

    def numbers(self, name: str, rows: Index) -> Array:
        """(k,) finite numbers of a column in some rows, NaN where it is empty."""
        return measured(self.values[name].take(pa.array(rows)), lambda k: self.where(int(rows[k]), name))

    def require_positive(self, name: str, values: Array, rows: Index) -> None:
        """Raise InputError for a number (k,) that is not above zero; NaN passes."""
        bad = (values <= 0.0) | (values >= LARGEST_SIGMA)
        self.refuse(bad, name, lambda k: f"{values[k]:g}", "a positive number below 1e100", rows)

    def words(self, name: str, rows: Index, known: Mapping[str, int], empty: int, expected: str) -> Index:
        """(k,) what the words of a column mean in some rows; `empty` where there is none."""
        if name not in self.values:
            return np.full(rows.size, empty)
        found = RepeatedNames.of(self.values[name].take(pa.array(rows)))
        meant = [known.get(word.lower().replace("_", ""), -1) if word else empty for word in found.distinct]
        values = np.array([*meant, empty], dtype=np.int64)[found.numbers]
        self.refuse(values < 0, name, lambda k: repr(found[k][:60]), expected, rows)
        return values

    def flags(self, name: str, rows: Index) -> Mask:
        """(k,) truth values, False where there is none."""
        return self.words(name, rows, FLAGS, 0, "true or false").astype(bool)

    def said(self, name: str) -> Index:
        """(n,) the row that says a column of each point first, any where none does; all others must say the same."""
        if name not in self.values:
            return self.first
        there = np.flatnonzero(filled(self.values[name]))
        texts, of_point, rows = self.values[name].take(pa.array(there)), self.point[there], self.first.copy()
        rows[of_point[::-1]] = there[::-1]
        codes = np.zeros(self.point.size, dtype=np.int64)
        codes[there] = np.asarray(texts.dictionary_encode().indices)
        earlier = rows[of_point]

        def found(k: int) -> str:
            first = str(self.values[name][earlier[k]])
            return f"{str(texts[k])[:60]!r}, and {first[:60]!r} in an earlier row"

        self.refuse(codes[there] != codes[earlier], name, found, "the same in all of a point's rows", there)
        return rows

    def group(self, names: Sequence[str]) -> tuple[Array, Mask]:
        """(n, c) numbers of columns that are of the point and go together, and which points (n,) have them."""
        rows = [self.said(name) for name in names]
        columns = [self.numbers(name, of) for name, of in zip(names, rows, strict=True)]
        values = np.column_stack([np.zeros((self.first.size, 0)), *columns])
        stated = np.any(~np.isnan(values), axis=1)
        for name, of, column in zip(names, rows, columns, strict=True):
            self.refuse(stated & np.isnan(column), name, "nothing", "a finite number", of)
        return values, stated


def _read(path: Path, body: Ellipsoid | None) -> tuple[PointArrays, Index, Index]:
    """Points and measures, types of the measures (k,) and the reference of each point (n,), -1 for none."""
    text = csv_text(read_text(path), path)
    values = text.texts(*text.names)
    names = header_of(text.names, f"{path}, {text.header}")
    values = dict(zip(names, values.values(), strict=True))
    lines = np.flatnonzero(np.any([filled(column) for column in values.values()], axis=0))
    if not lines.size:
        raise InputError(str(path), "no point", "one measure in every row below the header")
    values = {name: column.take(pa.array(lines)) for name, column in values.items()}
    coded = values["id"].dictionary_encode()
    point = np.asarray(coded.indices).astype(np.int64)
    rows = _Rows(text, values, lines, point, np.unique(point, return_index=True)[1])
    every, measured_there = np.arange(point.size), filled(values["image"])
    rows.refuse(~filled(values["id"]), "", "no id", "one in every row", every)
    for name in [name for name in OF_MEASURE if name in names]:
        bad = filled(values[name]) & ~measured_there
        rows.refuse(bad, name, "a measure without image", "the image it was measured in", every)
    of_measures = np.flatnonzero(measured_there)
    of_measures = of_measures[np.argsort(point[of_measures], kind="stable")]
    first = np.searchsorted(point[of_measures], np.arange(rows.first.size + 1))
    ids, image = Names.of(coded.dictionary), RepeatedNames.of(values["image"].take(pa.array(of_measures)))
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
    """(k, 4) line and sample as ISIS counts them, and their sigmas, NaN where none are said."""
    columns = rows.values
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
    names, n = tuple(rows.values), rows.first.size
    types = rows.words("type", rows.said("type"), POINT_TYPES, int(PointType.FREE), "free, constrained or fixed")
    ignored = rows.flags("point_ignore", rows.said("point_ignore"))
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
        (careful if str(row["id"]).startswith("#") else plain).writerow(["" if one is None else one for one in values])
    return text.getvalue()


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
                "image": _name(one.serial_number, where), "isis_line": one.line, "isis_sample": one.sample,
                "measure_type": ISIS_MEASURE_TYPES[one.type], "sigma_line_px": _positive(one.line_sigma),
                "sigma_sample_px": _positive(one.sample_sigma), "ignore": one.ignore or None,
                "reference": point.reference == k or None,
            }
            for k, one in enumerate(point.measures) if one.line is not None and one.sample is not None
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
