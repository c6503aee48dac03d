"""Tables of PEDR2TAB and CSV files of ODE by columns, where they are plain; `pedr_text` reads all others by lines."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc

from mgsgraph.files.altimetry.csv_lines import LARGEST
from mgsgraph.files.altimetry.csv_table import plain_name
from mgsgraph.files.csv_columns import PlainRows, numbers_of, plain_text
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names

_WIDTHS = {
    "longeast": 9, "latnorth": 10, "topography": 11, "molarange": 10, "planetrad": 12, "c": 2, "a": 2,
    "sclong": 10, "sclat": 10, "scradius": 12, "offndr": 7, "ephemeristime": 16, "areodlat": 10, "areoidrad": 11,
    "shot": 4, "pkt": 6, "orbit": 6, "gm": 3, "hrlcl": 7, "sphas": 7, "sinc": 7, "emissn": 7, "rcorr": 7, "pwt": 8,
    "sigopt": 8, "elaser": 8, "pulsee": 7, "reft": 7, "bkgrd": 7, "thmv": 7, "wct": 3, "ect": 4, "rwnd": 7, "rdly": 8,
}
"""Characters of PEDR2TAB's formats."""
_WIDER = _WIDTHS | {"offndr": 8, "pkt": 7, "orbit": 8}
_RULE = set("-. ")
"""Characters of the line between header and rows."""
_BLANK = ord(" ")
_AROUND, _BETWEEN = re.compile(rb"^ +| +$", re.MULTILINE), re.compile(rb" +")


@dataclass(frozen=True, slots=True, eq=False)
class PlainTable:
    """A plain text below its header."""

    names: list[str]
    """Plain names of the columns."""
    with_commas: bool
    """Whether it is CSV."""
    first_line: int
    """Number of the first row's line in the file, from 1."""
    rows: PlainRows

    def columns(self, numbers: Mapping[int, str], texts: Mapping[int, str]) -> dict[str, Array | Names] | None:
        """Columns by their names here, from their places: numbers, each (n,), and texts; None for what is no number, or
        a row of other columns than the header has.
        """
        if not self.with_commas and any(edges_of(self.names, self._first_length)):
            return self._cut(edges_of(self.names, self._first_length), numbers, texts)
        rows = self.rows if self.with_commas else self._comma_separated()
        found = rows.columns(len(self.names), numbers, texts) if rows else None
        if found is None:
            return None
        values = {name: np.asarray(found[k]) for k, name in numbers.items()}
        if not all(np.all(np.abs(one) < LARGEST) for one in values.values()):
            return None
        return values | {name: Names.of(found[k]) for k, name in texts.items()}

    @property
    def _first_length(self) -> int:
        end = self.rows.content.find(b"\n", self.rows.start)
        return (self.rows.end if end < 0 else min(end, self.rows.end)) - self.rows.start

    def _comma_separated(self) -> PlainRows | None:
        """Rows with commas in place of blanks; None where a row is of blanks alone."""
        body = self.rows.content[self.rows.start : self.rows.end]
        found = None if b"," in body else PlainRows.of(_BETWEEN.sub(b",", _AROUND.sub(b"", body)), 0)
        return found if found and len(found) == len(self.rows) else None

    def _cut(
        self, edges: Sequence[int], numbers: Mapping[int, str], texts: Mapping[int, str]
    ) -> dict[str, Array | Names] | None:
        """Columns between edges, of rows that are all as long; None for others."""
        content, start, end = self.rows.content, self.rows.start, self.rows.end
        data, width, n = np.frombuffer(content, np.uint8, end - start, start), edges[-1], len(self.rows)
        if data.size + 1 != n * (width + 1) or np.any(data[width :: width + 1] != ord("\n")):
            return None
        block = np.lib.stride_tricks.as_strided(data, (n, width), (width + 1, 1), writeable=False)
        if np.any(block[:, -1] == _BLANK) or not content.isascii():
            return None
        found = dict[str, Array | Names]()
        for k, name in (*numbers.items(), *texts.items()):
            piece = np.ascontiguousarray(block[:, edges[k] : edges[k + 1]])
            trimmed = pc.utf8_trim(Names(piece.ravel(), np.arange(n + 1) * piece.shape[1]).arrow, " ")
            values = Names.of(trimmed) if k in texts else numbers_of(trimmed, LARGEST)
            if values is None or (isinstance(values, np.ndarray) and np.any(np.isnan(values))):
                return None
            found[name] = values
        return found


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


def plain_table(content: bytes) -> PlainTable | None:
    """A text's header and rows; None where its lines leave a doubt."""
    text = plain_text(content)
    end = -1 if text is None else text.find(b"\n")
    header = "" if text is None else text[: max(end, 0)].decode()
    if text is None or not header.strip():
        return None
    with_commas = "," in header
    if not with_commas and b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
        end = text.find(b"\n")
    begin, first = end + 1, 2
    if not with_commas and set(text[begin : max(text.find(b"\n", begin), begin)].decode()) - _RULE == set():
        begin, first = text.find(b"\n", begin) + 1, 3
        if begin == 0:
            return None
    rows = PlainRows.of(text, begin)
    return PlainTable(names_of(header), with_commas, first, rows) if rows else None


def names_of(header: str) -> list[str]:
    """Plain names of the columns."""
    return [plain_name(name) for name in (header.split(",") if "," in header else header.split())]
