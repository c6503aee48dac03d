"""CSV files with a header: columns by the letters and digits of their names, numbers with errors that name the line."""

import csv
import re
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array
from mgsgraph.io.files import finite_number, name_of

_LARGEST = 1e50
"""m, s, degrees or whatever: squares of larger numbers of an altimeter would be none."""


def measured(text: str, where: str, line: int, column: str) -> float:
    """The number that a text spells in decimal; InputError with `where`, line and column for anything else, and for
    what is too large to be computed with.
    """
    try:
        if abs(value := finite_number(text)) < _LARGEST:
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


def plain_name(name: str) -> str:
    """The letters and digits of a column's name, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


class CsvTable:
    """Rows of a CSV file below a header; columns are called by the letters and digits of their names, in lower case."""

    def __init__(self, content: bytes, path: Path, header: str | None = None) -> None:
        """`header` is that of a file which has none."""
        self.path = path
        try:
            text = content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
        except UnicodeDecodeError as error:
            raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a CSV file") from None
        lines = [_unquoted(line, f"{path}, line {k}") for k, line in enumerate(text.split("\n"), start=1)]
        filled = [k for k, line in enumerate(lines) if line.strip()]
        if header is None:
            require(filled, str(path), "an empty file", "a header and rows")
            header = lines[filled.pop(0)]
        self.written = [name.strip() for name in (header.split(",") if "," in header else header.split())]
        """Names as the header has them."""
        self.names = [plain_name(name) for name in self.written]
        self._numbers = [k + 1 for k in filled]
        self._lines = [lines[k] for k in filled]

    def read(self, *wanted: str) -> dict[str, Array]:
        """Finite numbers (n,) of those of the wanted columns that there are.

        InputError for a header alone, a name twice, a line of another number of columns than the header, or a value
        that is no number.
        """
        self._require_rows()
        there = [name for name in wanted if name in self.names]
        columns = [self.names.index(name) for name in there]
        if not columns:
            return {}
        try:
            values = np.loadtxt(self._lines, delimiter=",", usecols=columns, comments=None, ndmin=2)
        except ValueError:
            values = np.full((1, 1), np.nan)
        if not np.all(np.abs(values) < _LARGEST):  # say which one
            values = np.array([
                [self._measured(texts[m].strip(), k, m) for m in columns]
                for k, texts in enumerate(line.split(",") for line in self._lines)
            ])
        return dict(zip(there, values.T, strict=True))

    def _require_rows(self) -> None:
        if not self._lines:
            raise InputError(str(self.path), "a header alone", "shots below it")
        for name in [name for k, name in enumerate(self.names) if name and name in self.names[:k]][:1]:
            raise InputError(f"{self.path}, header", f"the column {name!r} twice", "each column once")
        for k, line in enumerate(self._lines):
            if line.count(",") != len(self.names) - 1:
                found, expected = f"{line.count(',') + 1} values", f"{len(self.names)}, as the header has names"
                raise InputError(self.where(k), found, expected, "the file may be cut short")

    def __len__(self) -> int:
        return len(self._lines)

    def where(self, row: int) -> str:
        """File and line of a row, for errors."""
        return f"{self.path}, line {self._numbers[row]}"

    def called(self, name: str) -> str:
        """File and a column as the header writes it, for errors."""
        return f"{self.path}, {self.written[self.names.index(name)]}"

    def line_numbers(self) -> list[int]:
        """Numbers (n) of the rows' lines in the file, from 1."""
        return self._numbers

    def texts(self, name: str, gaps: bool = False) -> list[str]:
        """Texts (n) of a column, none of which is empty unless there may be `gaps`."""
        column = self.names.index(name)
        texts = [line.split(",", column + 1)[column].strip() for line in self._lines]
        for k in [k for k, text in enumerate(texts) if not (text or gaps)][:1]:
            raise InputError(f"{self.where(k)}, {self.written[column]}", "nothing", "a text")
        for text in dict.fromkeys(texts):
            if text:
                name_of(text, self.called(name), "a text")
        return texts

    def with_gaps(self, name: str) -> Array:
        """Numbers (n,) of a column, NaN where it is empty; NaN throughout where there is no such column."""
        if name not in self.names:
            return np.full(len(self), np.nan)
        column, texts = self.names.index(name), self.texts(name, gaps=True)
        return np.array([self._measured(text, k, column) if text else np.nan for k, text in enumerate(texts)])

    def _measured(self, text: str, row: int, column: int) -> float:
        return measured(text, f"{self.path}, line", self._numbers[row], self.written[column])
