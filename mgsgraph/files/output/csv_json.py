"""Arrays and names as JSON and CSV: no NaN in JSON, numbers of CSV read back bit for bit."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, TextIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv
from pyarrow.csv import WriteOptions

from mgsgraph.files.records import record_text
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names, RepeatedNames

_CHUNK = 2_000
"""Rows written at a time: so few that they stay in the cache."""
_SPECIAL = frozenset(',"\r\n')


def plain(value: Any) -> Any:
    """The value with arrays as lists, NumPy scalars as Python's, and None for NaN and infinity."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def vector(values: Array) -> list[Any] | None:
    """A place or vector for JSON: null where one of its numbers is not known."""
    found: list[Any] = values.tolist()
    return found if np.all(np.isfinite(values)) else None


def digits(values: Array, count: int = 6) -> list[float | None]:
    """Numbers (n,) for JSON, of so many digits; null where there is none."""
    return [float(f"{value:.{count}g}") if math.isfinite(value) else None for value in values.tolist()]


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as strict JSON, as `plain` makes it, which ends with its checksum."""
    path.write_text(record_text(plain(record)), encoding="utf-8", newline="\n")


def columns(names: Sequence[str], values: Array) -> dict[str, Array]:
    """Columns of values (n, k) by their names."""
    return dict(zip(names, values.T, strict=True))


def padded(values: Array, before: int, after: int) -> Array:
    """Values with so many NaN before and after them."""
    return np.pad(values, (before, after), constant_values=np.nan)


def picked(names: Sequence[str], index: np.ndarray) -> Names | RepeatedNames:
    """The name for each index."""
    if isinstance(names, Names | RepeatedNames):
        return names[index]
    distinct = tuple(dict.fromkeys(names))
    number = {name: k for k, name in enumerate(distinct)}
    return RepeatedNames(distinct, np.array([number[name] for name in names], dtype=np.int64)[index])


def write_csv(out: Path | TextIO, table: pa.Table) -> None:
    """Write a table as a CSV file, or to a stream; numbers read back bit for bit, what is not known is an empty field,
    texts are quoted where one of their column must be (RFC 4180).
    """
    head = ",".join(map(quoted, table.column_names)) + "\n"
    if isinstance(out, Path):
        with out.open("wb") as file:
            file.write(head.encode())
            _write_rows(table, file)
        return
    lines = io.BytesIO()
    _write_rows(table, lines)
    out.write(head + lines.getvalue().decode())


def _write_rows(table: pa.Table, file: IO[bytes]) -> None:
    quoting = "needed" if any(map(_special, table.itercolumns())) else "none"
    options = WriteOptions(include_header=False, batch_size=_CHUNK, quoting_style=quoting)
    arrow_csv.write_csv(table, file, options)


def _special(column: pa.ChunkedArray) -> bool:
    """Whether a text of a column must be quoted."""
    if pa.types.is_dictionary(column.type):
        return any(not _SPECIAL.isdisjoint(name) for chunk in column.chunks for name in chunk.dictionary.to_pylist())
    if not pa.types.is_large_string(column.type):
        return False
    return any(pc.any(pc.match_substring(column, mark)).as_py() for mark in _SPECIAL)


def quoted(text: str) -> str:
    """A field of a CSV file, quoted where it must be (RFC 4180)."""
    if _SPECIAL.isdisjoint(text):
        return text
    return '"' + text.replace('"', '""') + '"'
