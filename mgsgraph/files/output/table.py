"""A table, stated once: its columns have a name, a unit, a meaning and formats, and every form of it is made from them.

A table is written as CSV (`write_csv`), as values for JSON (`records`), as aligned text for the terminal (`text`), and
as cells for the report page (`headings`, `rows`). Values come in SI units and leave in the unit that the column names.

Arrays and names leave as JSON and CSV: no NaN in JSON, numbers of CSV read back bit for bit.
"""

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, TextIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv
from pyarrow.csv import WriteOptions

from mgsgraph.files.writing import record_text
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names, RepeatedNames, arrow_of, numbered
from mgsgraph.text import cell, many, short
from mgsgraph.units import ARCSEC, DEG, KM

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
    listed: list[Any] = values.tolist()
    return listed if np.all(np.isfinite(values)) else None


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
    number = numbered(distinct)
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


NONE = "–"
"""What stands on the page for a number that is not known."""
_UNITS = {"deg": DEG, "arcsec": ARCSEC, "km": KM, "km2": KM**2, "percent": 0.01}
"""SI units in one of each; of any other unit it is one."""
_SIGNS = {"percent": "%"}
"""Headings' sign of a unit that files spell out."""
_WIDEST = 64
"""Characters of a word in aligned text that are never cut."""
_LAYOUT = re.compile(r"([<>])([+]?)(\d*)(\.\d+[a-z]|d|g)?")


def numbers(records: Sequence[Any], attribute: str) -> Array:
    """(n, ...) numbers that records have under one attribute."""
    return np.array([getattr(record, attribute) for record in records], dtype=np.float64)


def fixed(value: float, decimals: int = 2) -> str:
    """A number with so many decimals; a dash for none."""
    if not math.isfinite(value):
        return NONE
    text = f"{value:.{decimals}f}" if abs(value) < 1e7 else f"{value:.4g}"
    return text.removeprefix("-") if not text.strip("-0.") else text


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column; a vector is a column with several parts. What is not known is NaN, or an empty word."""

    key: str
    """Name in files, without its unit; `{}` stands for the part of a vector, `{unit}` for the unit that a row has."""
    values: Sequence[Any] | np.ndarray
    """(n,) words, numbers (SI, or in `unit` where that differs by row), whole numbers, truths; lists, for JSON;
    (n, k) for a vector."""
    unit: str | Sequence[str] = ""
    """In which it is written; one for all rows, or (n,) one for each, which then stands in a column of its own."""
    meaning: str = ""
    """What it is, in a few words, with frame and sign."""
    parts: tuple[str, ...] = ()
    """(k,) names of a vector's parts."""
    head: str | tuple[str, ...] = ""
    """Heading on the page, `{}` as in `key`, or (k,) one for each part; the key when empty."""
    page: str = ""
    """Format on the page, as of `format`; "s": words and whole numbers as they are. Empty: the column is not there."""
    label: str | None = None
    """Heading in aligned text, of all parts of a vector together; `head` when None."""
    text: str = ""
    """Layout in aligned text: < or >, sign, width, format. Without a format numbers have as many of three decimals as
    the width holds, and words are cut in their middle. Empty: the column is not there."""
    gap: int = 1
    """Blanks before it in aligned text."""
    files: bool = True
    """Whether it is there in files."""
    scale: float | None = None
    """SI units in one of `unit`, where its name doesn't say so: 1 for values that are in that unit already."""
    json: str = ""
    """Its key in JSON with the unit, where that differs from what follows from `key`."""

    @property
    def vector(self) -> bool:
        """Whether it has several parts."""
        return isinstance(self.values, np.ndarray) and self.values.ndim == 2

    @property
    def scaled(self) -> Sequence[Any] | np.ndarray:
        """The values in their unit."""
        scale = _UNITS.get(self.unit, 1.0) if self.scale is None and isinstance(self.unit, str) else self.scale or 1.0
        return self.values if scale == 1.0 else np.asarray(self.values) / scale

    def name(self, unit: str | None = None) -> str:
        """Name in files with its unit: the column's, or one row's where they differ."""
        unit = unit or (self.unit if isinstance(self.unit, str) else "")
        if "{unit}" in self.key:
            return self.key.replace("{unit}", unit or "unit")
        return f"{self.key}_{unit}" if unit and unit != self.key else self.key

    def json_key(self, row: int) -> str:
        """Name of a value in JSON: a vector's is that of the whole, with the unit that the row has."""
        if self.json:
            return self.json
        name = self.name(None if isinstance(self.unit, str) else self.unit[row])
        return name.replace("_{}", "").replace("{}_", "")

    @property
    def split(self) -> list["Column"]:
        """The parts of a vector, each a column; of any other column, itself."""
        if not self.vector:
            return [self]
        values, head = np.asarray(self.values).T, self.head
        heads = [head.format(part) for part in self.parts] if isinstance(head, str) else head
        return [
            replace(self, key=self.key.format(part), values=values[k], parts=(), head=heads[k])
            for k, part in enumerate(self.parts)
        ]

    def cells(self) -> list[str]:
        """(n,) text for the page."""
        values = self.scaled
        if not isinstance(values, np.ndarray):
            return [value or NONE for value in values]
        if values.dtype.kind != "f":
            return [str(value) for value in values.tolist()]
        if self.page.endswith("f"):
            return [fixed(value, int(self.page[1:-1])) for value in values.tolist()]
        return [f"{value:{self.page}}" if math.isfinite(value) else NONE for value in values.tolist()]

    @property
    def _layout(self) -> tuple[str, str, int, str]:
        """Side, sign, width and format in aligned text; words widen their column up to a limit before they are cut."""
        match = _LAYOUT.fullmatch(self.text)
        assert match is not None, self.text
        side, sign, width, form = match[1], match[2], int(match[3] or 0), match[4] or ""
        if width and side == "<" and not isinstance(self.values, np.ndarray):
            longest = max((len(value) for value in self.values if isinstance(value, str)), default=0)
            width = max(width, min(longest, _WIDEST))
        return side, sign, width, form

    def aligned(self) -> list[str]:
        """(n,) text in the column's width."""
        side, sign, width, form = self._layout
        values = self.scaled
        if isinstance(values, np.ndarray) and values.ndim == 2:
            return [" ".join(_aligned(value, side, sign, width, form) for value in row) for row in values.tolist()]
        return [_aligned(value, side, sign, width, form) for value in
                (values.tolist() if isinstance(values, np.ndarray) else values)]

    def titles(self, units: bool) -> tuple[str, str]:
        """Two lines of heading in the column's width: its name, and its parts, or its unit where that is wanted."""
        side, _, width, _ = self._layout
        name = str(self.head or self.key) if self.label is None else self.label
        if self.vector:
            below = " ".join(f"{part:{side}{width}}" for part in self.parts)
            return f"{name:{side}{len(below)}}", below
        unit = _SIGNS.get(self.unit, self.unit) if units and isinstance(self.unit, str) else ""
        return f"{name:{side}{width}}", f"{unit:{side}{width}}"


def _aligned(value: Any, side: str, sign: str, width: int, form: str) -> str:
    if isinstance(value, str):
        return f"{short(value, width) if width and side == '<' else value:{side}{width}}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"{'-':{side}{width}}"
    if isinstance(value, int) or form:
        return f"{f'{value:{sign}{form}}':{side}{width}}"
    return f"{cell(value, width):{side}{width}}"


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of as many rows each."""

    name: str
    """Of its file, and its place on the page."""
    title: str
    """What it lists."""
    columns: tuple[Column, ...]
    """In their order."""
    note: str = ""
    """What one has to know, and what was cut."""
    instead: Mapping[int, tuple[str, str]] = field(default_factory=dict)
    """Of some rows: from the column of which key on, which words stand in aligned text instead of numbers."""

    def __len__(self) -> int:
        return len(self.columns[0].values)

    def pick(self, *keys: str) -> "Table":
        """The table with these columns alone, in this order."""
        of = {column.key: column for column in self.columns}
        return replace(self, columns=tuple(of[key] for key in keys))

    def take(self, rows: Index) -> "Table":
        """The table with these rows (m,) alone, in this order."""
        chosen = rows.tolist()

        def some_of(values: Any) -> Any:
            if isinstance(values, str):
                return values
            if isinstance(values, np.ndarray | Names | RepeatedNames):
                return values[rows]
            return [values[k] for k in chosen]

        some = [replace(column, values=some_of(column.values), unit=some_of(column.unit)) for column in self.columns]
        instead = {new: self.instead[old] for new, old in enumerate(chosen) if old in self.instead}
        return replace(self, columns=tuple(some), instead=instead)

    def last(self, *keys: str) -> "Table":
        """The table with these columns at its end."""
        return replace(self, columns=(*self.drop(*keys).columns, *self.pick(*keys).columns))

    def drop(self, *keys: str) -> "Table":
        """The table without these columns."""
        return replace(self, columns=tuple(column for column in self.columns if column.key not in keys))

    # --- files

    def write_csv(self, out: Path | TextIO) -> None:
        """Write a CSV file, or to a stream; numbers read back bit for bit, what is not known is an empty field."""
        write_csv(out, self.arrow)

    @property
    def arrow(self) -> pa.Table:
        """The columns that files have, first those that are no decimal numbers; null for what is not known."""
        parts = [part for column in self.columns if column.files for part in column.split]
        arrays = {column.name(): _arrow(column.scaled) for column in parts}
        decimal = [name for name, array in arrays.items() if pa.types.is_floating(array.type)]
        return pa.table({name: arrays[name] for name in [*(n for n in arrays if n not in decimal), *decimal]})

    def records(self) -> list[dict[str, Any]]:
        """One mapping for each row, for JSON; units in the keys, None for what is not known."""
        lists = [(column, plain(column.scaled)) for column in self.columns if column.files]
        return [
            {
                column.json_key(k): values[k] if values[k] != "" else None
                for column, values in lists
            }
            for k in range(len(self))
        ]

    # --- the page

    @property
    def _shown(self) -> list[Column]:
        return [part for column in self.columns if column.page for part in column.split]

    @property
    def headings(self) -> list[tuple[str, str]]:
        """Heading and unit of each column on the page; an empty unit for a pure number or a word."""
        return [
            (str(column.head or column.key), column.unit if isinstance(column.unit, str) else "")
            for column in self._shown
        ]

    @property
    def rows(self) -> list[list[str]]:
        """Text of each cell on the page."""
        return [list(row) for row in zip(*(column.cells() for column in self._shown), strict=True)]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Columns of the page that hold nothing but numbers."""
        return tuple(all(_is_number(text) for text in cells) for cells in zip(*self.rows, strict=True))

    # --- aligned text

    def text(self, most: int | None = None, more: str = "", indent: int = 0, units: bool = False) -> list[str]:
        """Lines of aligned text.

        Parameters
        ----------
        most : int, optional
            Rows that are shown.
        more : str
            Noun of the rest, and after a colon where it is: "more strip: see passes.csv".
        indent : int
            Blanks before each row, over which the first heading reaches.
        units : bool
            Whether units stand in a line of their own under the headings.
        """
        rows = len(self) if most is None else min(most, len(self))
        shown = [column for column in self.take(np.arange(rows)).columns if column.text]
        if not shown:
            return []
        lines = []
        for k, (first, *rest) in enumerate(zip(*(column.titles(units) for column in shown), strict=True)):
            begin = " " * indent + first if k else f"{first.rstrip():<{indent + len(first)}}"
            lines.append(begin + "".join(" " * c.gap + word for c, word in zip(shown[1:], rest, strict=True)))
        lines = [line.rstrip() for line in lines if line.strip()]
        texts = [column.aligned() for column in shown]
        for row in range(rows):
            stop, words = self.instead.get(row, ("", ""))
            line = ""
            for column, cells in zip(shown, texts, strict=True):
                gap = " " * column.gap if line else ""
                if stop and column.key == stop:
                    line += gap + words
                    break
                line += gap + cells[row]
            lines.append((" " * indent + line).rstrip())
        if most is not None and len(self) > most:
            noun, _, where = more.partition(":")
            lines.append(f"{' ' * indent}and {many(len(self) - most, noun)}:{where}")
        return lines


def write_parquet(path: Path, pieces: Iterable[Table], metadata: Mapping[str, str] | None = None) -> None:
    """Write an Apache Parquet file of the columns that files have, with further metadata of the file; the rows come in
    one table or more, so that a long one need not be in memory as a whole.
    """
    from pyarrow import parquet

    with ExitStack() as open_files:
        writer = None
        for piece in pieces:
            rows = piece.arrow
            if writer is None:
                schema = rows.schema.with_metadata(dict(metadata or {}))
                writer = open_files.enter_context(parquet.ParquetWriter(path, schema, compression="zstd"))
            writer.write_table(rows)


def _arrow(values: Sequence[Any] | np.ndarray) -> pa.Array:
    """An Arrow array of words, numbers (null for what is not finite) or truths."""
    if isinstance(values, Names | RepeatedNames):
        return values.arrow
    if isinstance(values, pa.Array):
        return values
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub":
        return Names.of(list(values)).arrow
    return arrow_of(values)


def _is_number(text: str) -> bool:
    if text == NONE:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True


def cut(total: int, shown: int, which: str, file: str) -> str:
    """A note where a table lacks rows; empty where it has all."""
    return "" if shown >= total else f"{shown} of {total} are listed, {which}; {file} in the results has all."
