"""Columns of CSV text read by Arrow, without a Python object for each row or field.

`csv_columns` reads a table with a header, and says in which line something is wrong. `PlainRows`, `numbers_of` and
`short_names` are for readers that have brought a text into rows of their own: where anything is odd they give None.
"""

import csv
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError
from mgsgraph.files.opening import LARGEST_NUMBER, finite_number, read_text
from mgsgraph.geometry.records import LONGEST_NAME, Array, Index, Mask
from mgsgraph.names import Names

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
    """By the names of the columns, (n) each: texts without blanks around them, empty ones for nothing; or float64, null
    for nothing.
    """

    def where(self, row: int) -> str:
        """File, and line or row."""
        return f"{self.path}, {self.row} {self.numbers[row]}"

    def filled(self, name: str) -> Mask:
        """Which cells (n,) of a column hold anything."""
        column = self.values[name]
        return np.asarray(column.is_valid() if pa.types.is_floating(column.type) else pc.not_equal(column, ""))

    def chosen(self, rows: Index) -> "Columns":
        """Some of the rows, by their numbers from 0."""
        values = {name: column.take(pa.array(rows)) for name, column in self.values.items()}
        return replace(self, numbers=self.numbers[rows], values=values)


def csv_columns(path: Path) -> Columns:
    """A table in CSV (RFC 4180; UTF-8; a quoted field ends in its line), all of whose columns are texts.

    Blank lines, and lines that begin with #, count for nothing.

    Raises
    ------
    InputError
        With file and line: no header; a name twice; a row that is none, or of another number of fields.
    """
    text, numbers = read_text(path).rstrip(), None
    if '"' in text or _COMMENT.match(text) or _LEFT_OUT.search(text):
        lines = [(k, line) for k, line in enumerate(text.split("\n"), start=1) if not _COMMENT.match(line)]
        for k, line in lines:
            if '"' in line:
                _fields(line, f"{path}, line {k}")
        text, numbers = "\n".join(line for _, line in lines), np.array([k for k, _ in lines], dtype=np.int64)
    head, _, body = text.partition("\n")
    if not head:
        raise InputError(str(path), "an empty table", "a header, and rows below it")
    numbers = np.arange(1, text.count("\n") + 2) if numbers is None else numbers
    header = f"line {numbers[0]}"
    names = [name.strip() for name in _fields(head, f"{path}, {header}")]
    for name in [name for k, name in enumerate(names) if name.lower() in map(str.lower, names[:k])][:1]:
        raise InputError(f"{path}, {header}", f"the column {name!r} twice", "each once")
    columns = [pa.array([], pa.large_string())] * len(names)
    if body:
        try:
            columns = _read(pa.py_buffer(body.encode()), range(len(names)), texts=range(len(names)))
        except pa.ArrowInvalid as error:
            for k, row in zip(numbers[1:], body.split("\n"), strict=True):
                _require_width(_fields(row, f"{path}, line {k}"), len(names), f"{path}, line {k}")
            raise InputError(str(path), f"no CSV ({error})", "RFC 4180") from None
    trimmed = [pc.utf8_trim_whitespace(column) for column in columns]
    return Columns(path, header, "line", numbers[1:], dict(zip(names, trimmed, strict=True)))


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


def _read(
    content: pa.Buffer, places: Collection[int], numbers: Collection[int] = (), texts: Collection[int] = (),
    quoted: bool = True,
) -> list[pa.Array]:  # fmt: skip
    """Some columns, by their places from 0, of as many: float64, or texts; ArrowInvalid where they are none."""
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in places]
    kinds = {str(k): pa.float64() for k in numbers} | {str(k): pa.large_string() for k in texts}
    table = arrow_csv.read_csv(
        pa.BufferReader(content),
        arrow_csv.ReadOptions(column_names=names, block_size=_BLOCK, use_threads=content.size > _BLOCK),
        arrow_csv.ParseOptions(quote_char='"' if quoted else False, double_quote=quoted),
        arrow_csv.ConvertOptions(column_types=kinds, include_columns=list(kinds), null_values=[]),
    )  # fmt: skip
    return [table[name].combine_chunks() for name in kinds]


@dataclass(frozen=True, slots=True, eq=False)
class PlainRows:
    """Rows of a plain text without quotation marks, and without blank lines between them."""

    content: bytes
    start: int
    """Where the first row begins."""
    end: int
    """Behind the last row's last character."""

    def __len__(self) -> int:
        return self.content.count(b"\n", self.start, self.end) + 1

    def columns(self, width: int, numbers: Collection[int], texts: Collection[int] = ()) -> dict[int, pa.Array] | None:
        """Columns, by their places from 0, of rows of `width` fields, more than one: float64, and texts without blanks
        around them. None for a row of another width, or what is no number; infinite ones and NaN may be there.
        """
        if width < 2 or not (numbers or texts):
            return None
        given = pa.py_buffer(self.content).slice(self.start, self.end - self.start)
        try:
            read = dict(zip([*numbers, *texts], _read(given, range(width), numbers, texts, quoted=False), strict=True))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            return None
        rows = len(self)
        if any(len(column) != rows for column in read.values()):
            return None
        return {k: pc.utf8_trim(found, " ") if k in set(texts) else found for k, found in read.items()}

    def numbers(self, width: int, wanted: Collection[int], largest: float) -> dict[int, Array] | None:
        """Columns of numbers, each (n,), whose magnitudes are all smaller than the `largest`; None as `columns`."""
        found = self.columns(width, wanted)
        if found is None:
            return None
        values = {k: np.asarray(column) for k, column in found.items()}
        return values if all(np.all(np.abs(one) < largest) for one in values.values()) else None


def numbers_of(texts: pa.Array, largest: float) -> Array | None:
    """(n,) numbers that texts (n) spell in decimal, NaN for empty ones; None where one spells none, or one that is not
    smaller than the `largest`.
    """
    there = pc.not_equal(texts, "")
    try:
        values = np.asarray(pc.if_else(there, texts, None).cast(pa.float64()).fill_null(0.0))
    except pa.ArrowInvalid:
        return None
    return np.where(np.asarray(there), values, np.nan) if np.all(np.abs(values) < largest) else None


def measured(column: pa.Array, where: Callable[[int], str]) -> Array:
    """(n,) finite numbers of a table's column, NaN for empty cells; InputError, with the words for `where` the k-th of
    them is, for the first that is none.
    """
    if pa.types.is_floating(column.type):
        given, there = np.asarray(column.fill_null(0.0)), np.asarray(column.is_valid())
        found = np.where(there, given, np.nan) if np.all(np.abs(given) < LARGEST_NUMBER) else None
    else:
        found = numbers_of(column, LARGEST_NUMBER)
    if found is not None:
        return found
    values = np.full(len(column), np.nan)
    for k, value in enumerate(column.to_pylist()):  # Arrow doesn't know all numbers, such as "+1.5"
        if text := "" if value is None else str(value):
            try:
                values[k] = finite_number(text)
            except ValueError:
                remedy = "write a decimal point, not a comma" if _DECIMAL_COMMA.fullmatch(text) else ""
                raise InputError(where(k), repr(text[:60]), "a finite number", remedy) from None
    return values


def short_names(texts: pa.Array, gaps: bool = False) -> Names | None:
    """Texts as names; None where one is overlong, or empty unless there may be `gaps`."""
    names = Names.of(texts)
    sizes = np.diff(names.offsets)
    return names if sizes.min(initial=1) >= 1 - gaps and sizes.max(initial=1) <= LONGEST_NAME else None
