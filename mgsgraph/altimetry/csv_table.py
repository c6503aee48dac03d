"""CSV files with a header: columns by the letters and digits of their names, numbers with errors that name the line."""

import re
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.io.files import number_of


def plain_name(name: str) -> str:
    """The letters and digits of a column's name, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


class CsvTable:
    """Rows of a CSV file below a header; columns are called by the letters and digits of their names, in lower case."""

    def __init__(self, content: bytes, path: Path, header: str | None = None) -> None:
        """`header` is that of a file which has none."""
        self.path = path
        try:
            lines = content.decode("utf-8-sig").splitlines()
        except UnicodeDecodeError as error:
            raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a CSV file") from None
        filled = [k for k, line in enumerate(lines) if line.strip()]
        if header is None:
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
        if not np.all(np.isfinite(values)):  # say which one
            values = np.array([
                [number_of(texts[m].strip(), f"{self.where(k)}, {self.written[m]}") for m in columns]
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
        return texts

    def with_gaps(self, name: str) -> Array:
        """Numbers (n,) of a column, NaN where it is empty; NaN throughout where there is no such column."""
        if name not in self.names:
            return np.full(len(self), np.nan)
        where = self.written[self.names.index(name)]
        texts = self.texts(name, gaps=True)
        return np.array([
            number_of(text, f"{self.where(k)}, {where}") if text else np.nan for k, text in enumerate(texts)
        ])
