"""CSV files with a header: columns by the letters and digits of their names, numbers with errors that name the line."""

import re
from functools import cached_property
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.csv_lines import LARGEST, CsvLines, row_numbers
from mgsgraph.files.csv_columns import PlainRows, numbers_of, plain_text, short_names
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names


def plain_name(name: str) -> str:
    """The letters and digits of a column's name, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


class CsvTable:
    """Rows of a CSV file below a header; columns are called by the letters and digits of their names, in lower case.

    A plain file is read by columns; what is wrong with it, or unusual, is left to `CsvLines`.
    """

    def __init__(self, content: bytes, path: Path, header: str | None = None) -> None:
        """`header` is that of a file which has none."""
        self.path, self._content, self._headed = path, content, header is None
        plain, begin = plain_text(content), 0
        if header is None:
            begin = 0 if plain is None else plain.find(b"\n") + 1
            header = "" if plain is None else plain[: max(begin - 1, 0)].decode()
            if not header.strip():
                header, plain = self._lines.header, None
        self._rows = PlainRows.of(plain, begin) if plain is not None and "," in header else None
        self.written = [name.strip() for name in (header.split(",") if "," in header else header.split())]
        """Names as the header has them."""
        self.names = [plain_name(name) for name in self.written]
        self._texts: dict[tuple[str, bool], Names] = {}

    @cached_property
    def _lines(self) -> CsvLines:
        return CsvLines(self._content, self.path, self._headed)

    def read(self, *wanted: str) -> dict[str, Array]:
        """Finite numbers (n,) of those of the wanted columns that there are.

        InputError for a header alone, a name twice, a line of another number of columns than the header, or a value
        that is no number.
        """
        there = [name for name in wanted if name in self.names]
        columns = [self.names.index(name) for name in there]
        named = [name for name in self.names if name]
        if self._rows is not None and len(set(named)) == len(named):
            found = self._rows.numbers(len(self.names), columns, LARGEST)
            if found is not None:
                return {name: found[k] for name, k in zip(there, columns, strict=True)}
        self._require_rows()
        values = self._lines.values({k: self.written[k] for k in columns}) if columns else []
        return dict(zip(there, values, strict=True))

    def _require_rows(self) -> None:
        if not len(self._lines):
            raise InputError(str(self.path), "a header alone", "shots below it")
        for name in [name for k, name in enumerate(self.names) if name and name in self.names[:k]][:1]:
            raise InputError(f"{self.path}, header", f"the column {name!r} twice", "each column once")
        self._lines.require_width(self.names)

    @cached_property
    def _count(self) -> int:
        return len(self._lines if self._rows is None else self._rows)

    def __len__(self) -> int:
        return self._count

    def where(self, row: int) -> str:
        """File and line of a row, for errors."""
        return f"{self.path}, line {self.line_numbers()[row]}"

    def called(self, name: str) -> str:
        """File and a column as the header writes it, for errors."""
        return f"{self.path}, {self.written[self.names.index(name)]}"

    def line_numbers(self) -> Index:
        """Numbers (n,) of the rows' lines in the file, from 1."""
        return self._lines.numbers if self._rows is None else row_numbers(len(self), self._headed)

    def texts(self, name: str, gaps: bool = False) -> Names:
        """Texts (n) of a column, none of which is empty unless there may be `gaps`."""
        if (name, gaps) not in self._texts:
            self._texts[name, gaps] = self._read_texts(self.names.index(name), gaps)
        return self._texts[name, gaps]

    def _read_texts(self, column: int, gaps: bool) -> Names:
        found = self._rows.columns(len(self.names), (), (column,)) if self._rows is not None else None
        names = short_names(found[column], gaps) if found else None
        return Names.of(self._lines.texts(column, self.written[column], gaps)) if names is None else names

    def with_gaps(self, name: str) -> Array:
        """Numbers (n,) of a column, NaN where it is empty; NaN throughout where there is no such column."""
        if name not in self.names:
            return np.full(len(self), np.nan)
        column = self.names.index(name)
        if self._rows is not None:
            values = numbers_of(self.texts(name, gaps=True).arrow, LARGEST)
            if values is not None:
                return values
        return self._lines.with_gaps(column, self.written[column])
