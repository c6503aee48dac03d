"""A control network as a table of tie points, CSV or Parquet; `networks.table` reads both."""

import csv
import io
from collections.abc import Mapping, Sequence

import pyarrow as pa

from mgsgraph.errors import InputError
from mgsgraph.files.networks.pvl import MEASURE_TYPES
from mgsgraph.files.networks.record import ControlNetwork, ControlPoint
from mgsgraph.files.networks.table_columns import CARTESIAN, ISIS, MATRIX, OF_MEASURE, OF_POINT, TEXTS, TRUTHS


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
        (careful if row["id"].startswith("#") else plain).writerow([row.get(name, "") for name in names])
    return text.getvalue()


def table_parquet(network: ControlNetwork) -> bytes:
    """The same columns as an Apache Parquet file: numbers as float64, flags as truths, null for nothing."""
    from pyarrow import parquet

    names, rows = _rows(network)
    out = io.BytesIO()
    parquet.write_table(pa.table({name: _column(name, rows) for name in names}), out, compression="zstd")
    return out.getvalue()


def _column(name: str, rows: Sequence[Mapping[str, str]]) -> pa.Array:
    texts = [row.get(name) for row in rows]
    if name in TEXTS:
        return pa.array(texts, pa.string())
    if name in TRUTHS:
        return pa.array([None if text is None else text == "true" for text in texts], pa.bool_())
    return pa.array([None if text is None else float(text) for text in texts], pa.float64())


def _rows(network: ControlNetwork) -> tuple[list[str], list[dict[str, str]]]:
    """Names of the columns that are filled, and rows: a measure in each, or a point without any."""
    rows = list[dict[str, str]]()
    for point in network.points:
        of_point = _point_fields(point, network.source or "network")
        placed = [k for k, one in enumerate(point.measures) if one.line is not None and one.sample is not None]
        rows += [of_point | _measure_fields(point, k, network.source or "network") for k in placed] or [of_point]
    names = [*("id", "image", "type"), *ISIS]
    filled = {name for row in rows for name in row}
    return [*names, *(name for name in (*OF_MEASURE, *OF_POINT) if name in filled and name not in names)], rows


def _point_fields(point: ControlPoint, where: str) -> dict[str, str]:
    fields = {"id": _name(point.id, where), "type": point.type.name.lower()}
    if point.ignore:
        fields["point_ignore"] = "true"
    if point.apriori is not None:
        fields |= zip(CARTESIAN, map(repr, point.apriori), strict=True)
        if len(point.apriori_covariance) == len(MATRIX):
            fields |= zip(MATRIX, map(repr, point.apriori_covariance), strict=True)
    return fields


def _measure_fields(point: ControlPoint, k: int, where: str) -> dict[str, str]:
    measure = point.measures[k]
    fields = {
        "image": _name(measure.serial_number, where), "isis_line": repr(measure.line),
        "isis_sample": repr(measure.sample), "measure_type": MEASURE_TYPES[measure.type],
    }  # fmt: skip
    for name, value in (("sigma_line_px", measure.line_sigma), ("sigma_sample_px", measure.sample_sigma)):
        if value is not None and value > 0.0:
            fields[name] = repr(value)
    if measure.ignore:
        fields["ignore"] = "true"
    if point.reference == k:
        fields["reference"] = "true"
    return fields


def _name(text: str, where: str) -> str:
    if not text or text != text.strip() or len(text.splitlines()) != 1:
        raise InputError(where, f"the name {text[:60]!r}", "one line without blanks around it", "rename it (--rename)")
    return text
