"""Columns of CSV text read by Arrow, without a Python object for each row or field.

Only what leaves no doubt is read here: printable text without quotation marks and blank lines, rows of as many fields
as they should have, numbers in decimal. For all else the functions return None, and the caller reads line by line, to
say which line is wrong, or to read what is right though unusual.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.geometry.records import LONGEST_NAME, Array
from mgsgraph.names import Names

_MARK = b"\xef\xbb\xbf"
_PLAIN = bytes(byte for byte in range(32, 127) if byte != ord('"')) + b"\r\n"
_ENDS = b"\r\n"
_BLOCK = 1 << 24
"""bytes that Arrow parses at a time; no row is longer."""


def plain_text(content: bytes) -> bytes | None:
    """A text without byte order mark, lines ended by line feeds, before all of which a carriage return may stand; None
    where it has quotation marks, or other characters than printable ones.
    """
    content = content.removeprefix(_MARK)
    if (returns := content.count(b"\r")) and not returns == content.count(_ENDS) == content.count(b"\n"):
        content = content.replace(_ENDS, b"\n").replace(b"\r", b"\n")
    if others := content.translate(None, _PLAIN):
        if min(others) < 128:
            return None
        try:
            if not content.decode().translate(dict.fromkeys(_ENDS)).isprintable():
                return None
        except UnicodeDecodeError:
            return None
    return content


@dataclass(frozen=True, slots=True, eq=False)
class PlainRows:
    """Rows of a plain text, without blank lines between them."""

    content: bytes
    """Plain (`plain_text`)."""
    start: int
    """Where the first row begins."""
    end: int
    """Behind the last row's last character."""

    @classmethod
    def of(cls, content: bytes, start: int) -> "PlainRows | None":
        """Rows from a place on; None where there are none, or blank lines between them."""
        end = len(content)
        while end > start and content[end - 1] in _ENDS:
            end -= 1
        blank = any(content.find(b"\n" + one, start, end) >= 0 for one in (b"\n", _ENDS))
        return None if end <= start or content[start] in _ENDS or blank else cls(content, start, end)

    def __len__(self) -> int:
        return self.content.count(b"\n", self.start, self.end) + 1

    def columns(self, width: int, numbers: Collection[int], texts: Collection[int] = ()) -> dict[int, pa.Array] | None:
        """Columns, by their places from 0, of rows of `width` fields, more than one: float64, and texts without blanks
        around them. None for a row of another width, or what is no number; infinite ones and NaN may be there.
        """
        from pyarrow import csv

        if width < 2 or not (numbers or texts):
            return None
        names = [str(k) for k in range(width)]
        kinds = {names[k]: pa.float64() for k in numbers} | {names[k]: pa.large_string() for k in texts}
        given = pa.BufferReader(pa.py_buffer(self.content).slice(self.start, self.end - self.start))
        several = self.end - self.start > _BLOCK
        try:
            table = csv.read_csv(
                given, csv.ReadOptions(column_names=names, block_size=_BLOCK, use_threads=several),
                csv.ParseOptions(quote_char=False, double_quote=False),
                csv.ConvertOptions(column_types=kinds, include_columns=list(kinds), null_values=[]),
            )  # fmt: skip
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            return None
        if table.num_rows != len(self):
            return None
        read = {int(name): table[name].combine_chunks() for name in kinds}
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


def short_names(texts: pa.Array, gaps: bool = False) -> Names | None:
    """Texts as names; None where one is overlong, or empty unless there may be `gaps`."""
    names = Names.of(texts)
    sizes = np.diff(names.offsets)
    return names if sizes.min(initial=1) >= 1 - gaps and sizes.max(initial=1) <= LONGEST_NAME else None
