"""Rows of a CSV file line by line: errors name the line. Plain files are read by columns (`csv_table`)."""

import csv
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import finite_number, name_of
from mgsgraph.geometry.records import Array, Index

LARGEST = 1e50
"""m, s, degrees or whatever: squares of larger numbers of an altimeter would be none."""


def measured(text: str, where: str, line: int, column: str) -> float:
    """The number that a text spells in decimal; InputError with `where`, line and column for anything else, and for
    what is too large to be computed with.
    """
    try:
        if abs(value := finite_number(text)) < LARGEST:
            return value
    except ValueError:
        pass
    raise InputError(f"{where} {line}, {column}", f"{text[:60]!r}", "a finite number")


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


class CsvLines:
    """Rows of any CSV file below a header; columns are told by their number."""

    def __init__(self, content: bytes, path: Path, headed: bool) -> None:
        """`headed`: whether the first line is a header."""
        self.path = path
        try:
            text = content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
        except UnicodeDecodeError as error:
            raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a CSV file") from None
        lines = [_unquoted(line, f"{path}, line {k}") for k, line in enumerate(text.split("\n"), start=1)]
        filled = [k for k, line in enumerate(lines) if line.strip()]
        self.header = ""
        if headed:
            require(filled, str(path), "an empty file", "a header and rows")
            self.header = lines[filled.pop(0)]
        self.numbers = np.array(filled, dtype=np.int64) + 1
        """(n,) of the rows' lines in the file, from 1."""
        self._lines = [lines[k] for k in filled]

    def __len__(self) -> int:
        return len(self._lines)

    def require_width(self, names: list[str]) -> None:
        """Raise InputError unless each line has a value for each name."""
        for k, line in enumerate(self._lines):
            if line.count(",") != len(names) - 1:
                found, expected = f"{line.count(',') + 1} values", f"{len(names)}, as the header has names"
                raise InputError(self.where(k), found, expected, "the file may be cut short")

    def values(self, columns: dict[int, str]) -> list[Array]:
        """Finite numbers (n,) of columns, by their places and names; InputError for a value that is no number."""
        try:
            values = np.loadtxt(self._lines, delimiter=",", usecols=list(columns), comments=None, ndmin=2)
        except ValueError:
            values = np.full((1, 1), np.nan)
        if not np.all(np.abs(values) < LARGEST):  # say which one
            values = np.array([
                [self._measured(texts[m].strip(), k, name) for m, name in columns.items()]
                for k, texts in enumerate(line.split(",") for line in self._lines)
            ])
        return list(values.T)

    def texts(self, column: int, name: str, gaps: bool) -> list[str]:
        """Texts (n) of a column, none of which is empty unless there may be `gaps`."""
        texts = [line.split(",", column + 1)[column].strip() for line in self._lines]
        for k in [k for k, text in enumerate(texts) if not (text or gaps)][:1]:
            raise InputError(f"{self.where(k)}, {name}", "nothing", "a text")
        for text in dict.fromkeys(texts):
            if text:
                name_of(text, f"{self.path}, {name}", "a text")
        return texts

    def with_gaps(self, column: int, name: str) -> Array:
        """Numbers (n,) of a column, NaN where it is empty."""
        texts = self.texts(column, name, gaps=True)
        return np.array([self._measured(text, k, name) if text else np.nan for k, text in enumerate(texts)])

    def where(self, row: int) -> str:
        """File and line of a row, for errors."""
        return f"{self.path}, line {self.numbers[row]}"

    def _measured(self, text: str, row: int, name: str) -> float:
        return measured(text, f"{self.path}, line", int(self.numbers[row]), name)


def row_numbers(count: int, headed: bool) -> Index:
    """(n,) lines of rows without blank lines before or between them."""
    return np.arange(1 + headed, count + 1 + headed)
