"""Text tables with a header: CSV, or columns of PEDR2TAB; numbers and texts by column, errors with line and column.

Rows are brought into one form, fields between commas and no blank lines, and Arrow reads whole columns of it. Where
Arrow finds something odd, the fields of that column are looked at one by one: the first bad one is named, or all are
numbers that only Arrow does not know (such as "+1.5").
"""

import csv
import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.csv_columns import PlainRows, numbers_of, short_names
from mgsgraph.files.opening import finite_number, name_of
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names

LARGEST = 1e50
"""m, s, degrees or whatever: squares of larger numbers of an altimeter would be none."""
_BLANK = re.compile(rb"\n[^\S\n]*\n")
_AROUND, _BETWEEN = re.compile(rb"^ +| +$", re.MULTILINE), re.compile(rb" +")
_RULE = set(b"-. ")
"""Characters of the line between PEDR2TAB's header and its rows."""
_WIDTHS = {
    "longeast": 9, "latnorth": 10, "topography": 11, "molarange": 10, "planetrad": 12, "c": 2, "a": 2,
    "sclong": 10, "sclat": 10, "scradius": 12, "offndr": 7, "ephemeristime": 16, "areodlat": 10, "areoidrad": 11,
    "shot": 4, "pkt": 6, "orbit": 6, "gm": 3, "hrlcl": 7, "sphas": 7, "sinc": 7, "emissn": 7, "rcorr": 7, "pwt": 8,
    "sigopt": 8, "elaser": 8, "pulsee": 7, "reft": 7, "bkgrd": 7, "thmv": 7, "wct": 3, "ect": 4, "rwnd": 7, "rdly": 8,
}
"""Characters of PEDR2TAB's formats; fields may abut."""
_WIDER = _WIDTHS | {"offndr": 8, "pkt": 7, "orbit": 8}


def plain_name(name: str) -> str:
    """The letters and digits of a column's name, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


class TextTable:
    """Rows of a text below a header; columns are called by the letters and digits of their names, in lower case.

    Parameters
    ----------
    content : bytes
        UTF-8; lines end as they may, fields may be in quotation marks (RFC 4180), blank lines count for nothing.
    path : Path
        For errors.
    header : str, optional
        That of a file which has none.

    Raises
    ------
    InputError
        For what is no text, a header alone, a row of another number of fields or characters than the others.
    """

    def __init__(self, content: bytes, path: Path, header: str | None = None) -> None:
        self.path, self._headed = path, header is None
        lines, self._numbers = _filled_lines(content, path)
        if header is None:
            first, _, lines = lines.partition(b"\n")
            header = first.decode()
            if not header:
                raise InputError(str(path), "an empty file", "a header and rows")
        self.with_commas = "," in header
        """Whether it is CSV."""
        self.written = [name.strip() for name in (header.split(",") if self.with_commas else header.split())]
        """Names as the header has them."""
        self.names = [plain_name(name) for name in self.written]
        second = lines.partition(b"\n")[0]
        self._skipped = self._headed + (not self.with_commas and bool(second) and set(second) <= _RULE)
        if self._skipped > self._headed:
            lines = lines[len(second) + 1 :]
        self._content, self._texts = lines, dict[tuple[str, bool], Names]()

    @cached_property
    def _rows(self) -> PlainRows:
        """Fields between commas."""
        if not self._content:
            raise InputError(str(self.path), "a header alone", "rows below it")
        content = self._content if self.with_commas else self._cut()
        return PlainRows(content, 0, len(content))

    def _cut(self) -> bytes:
        """Rows without commas: cut at the program's widths where lines have their length, at blanks otherwise."""
        rows = self._content.split(b"\n")
        edges = edges_of(self.names, len(rows[0]))
        for k, row in enumerate(rows):
            if edges and len(row) != edges[-1]:
                found, expected = f"{len(row)} characters", f"{edges[-1]}, as in the lines before"
                raise InputError(self.where(k), found, expected, "the file is cut short")
            if b"," in row:
                raise InputError(self.where(k), "a comma", "columns between blanks, as the header has them")
        if not edges:
            return _BETWEEN.sub(b",", _AROUND.sub(b"", self._content))
        block = np.frombuffer(self._content + b"\n", np.uint8).reshape(len(rows), -1)
        return np.insert(block, edges[1:-1], ord(","), axis=1).tobytes().removesuffix(b"\n")

    def __len__(self) -> int:
        return len(self._rows)

    def line_numbers(self) -> Index:
        """Numbers (n,) of the rows' lines in the file, from 1."""
        if self._numbers is None:
            return np.arange(1 + self._skipped, len(self) + 1 + self._skipped)
        return self._numbers[self._skipped :]

    def where(self, row: int) -> str:
        """File and line of a row, for errors."""
        row += self._skipped
        return f"{self.path}, line {row + 1 if self._numbers is None else self._numbers[row]}"

    def called(self, name: str) -> str:
        """File and a column as the header writes it, for errors."""
        return f"{self.path}, {self.written[self.names.index(name)]}"

    def read(self, *wanted: str) -> dict[str, Array]:
        """Finite numbers (n,) of those of the wanted columns that there are.

        InputError for a name twice, or a value that is no number.
        """
        there = [name for name in wanted if name in self.names]
        for name in [name for k, name in enumerate(self.names) if name and name in self.names[:k]][:1]:
            raise InputError(f"{self.path}, header", f"the column {name!r} twice", "each column once")
        columns = [self.names.index(name) for name in there]
        found = self._rows.numbers(len(self.names), columns, LARGEST) if columns else {}
        if found is None:
            found = {k: self._measured(self._fields(k), k) for k in columns}
        return {name: found[k] for name, k in zip(there, columns, strict=True)}

    def texts(self, name: str, gaps: bool = False) -> Names:
        """Texts (n) of a column, none of which is empty unless there may be `gaps`."""
        if (name, gaps) not in self._texts:
            self._texts[name, gaps] = self._read_texts(self.names.index(name), gaps)
        return self._texts[name, gaps]

    def with_gaps(self, name: str) -> Array:
        """Numbers (n,) of a column, NaN where it is empty; NaN throughout where there is no such column."""
        if name not in self.names:
            return np.full(len(self), np.nan)
        texts = self.texts(name, gaps=True)
        values = numbers_of(texts.arrow, LARGEST)
        return self._measured(texts, self.names.index(name), gaps=True) if values is None else values

    def _read_texts(self, column: int, gaps: bool) -> Names:
        found = self._rows.columns(len(self.names), (), (column,))
        names = short_names(found[column], gaps) if found else None
        if names is not None and names.text.isprintable():
            return names
        where, texts = f"{self.path}, {self.written[column]}", self._fields(column)
        for k in [k for k, text in enumerate(texts) if not (text or gaps)][:1]:
            raise InputError(f"{self.where(k)}, {self.written[column]}", "nothing", "a text")
        return Names.of([name_of(text, where, "a text") if text else "" for text in texts])

    def _fields(self, column: int) -> list[str]:
        """Texts (n) of a column, row by row: where Arrow refused a row or a field of it."""
        rows = [row.split(",") for row in self._rows.content.decode().split("\n")]
        for k, row in enumerate(rows):
            if len(row) != len(self.names):
                found, expected = f"{len(row)} values", f"{len(self.names)}, as the header has names"
                raise InputError(self.where(k), found, expected, "the file may be cut short")
        return [row[column].strip() for row in rows]

    def _measured(self, texts: Sequence[str], column: int, gaps: bool = False) -> Array:
        """Numbers (n,) that texts spell in decimal; InputError names the first that is none, or too large."""
        values = np.full(len(texts), np.nan)
        for k, text in enumerate(texts):
            try:
                values[k] = finite_number(text) if text or not gaps else np.nan
            except ValueError:
                values[k] = np.inf
            if abs(values[k]) >= LARGEST:
                raise InputError(f"{self.where(k)}, {self.written[column]}", f"{text[:60]!r}", "a finite number")
        return values


def edges_of(names: Sequence[str], length: int) -> list[int]:
    """Where the columns of PEDR2TAB's lines begin, and the last one ends, by the program's formats that make a line of
    this length; empty where none do.
    """
    for widths in (_WIDTHS, _WIDER):
        if all(name in widths for name in names):
            edges = np.cumsum([0] + [widths[name] for name in names])
            if length == edges[-1]:
                return [int(edge) for edge in edges]
    return []


def _filled_lines(content: bytes, path: Path) -> tuple[bytes, Index | None]:
    """Lines that are not blank, ended by line feeds, without quotation marks; and their numbers in the file, from 1,
    None where no line was left out.
    """
    content = content.removeprefix(b"\xef\xbb\xbf")
    content = (content.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in content else content).rstrip()
    try:
        _ = content.isascii() or content.decode()
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a table") from None
    if b'"' not in content and not _BLANK.search(content) and content[:1].strip():
        return content, None
    lines = [(k, line) for k, line in enumerate(content.decode().split("\n"), start=1) if line.strip()]
    plain = [_unquoted(line, f"{path}, line {k}") for k, line in lines]
    return "\n".join(plain).encode(), np.array([k for k, _ in lines], dtype=np.int64)


def _unquoted(line: str, where: str) -> str:
    """A line whose fields may be in quotation marks (RFC 4180), without these."""
    if '"' not in line:
        return line
    try:
        fields = next(csv.reader((line,), strict=True, skipinitialspace=True))
    except (csv.Error, StopIteration) as error:
        raise InputError(where, f"no row of a CSV file ({error})", "RFC 4180") from None
    for one in fields:
        if "," in one or '"' in one:
            raise InputError(where, f"the field {one[:60]!r}", "fields without commas or quotation marks in them")
    return ",".join(fields)
