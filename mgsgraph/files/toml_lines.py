"""In which line of a TOML text each key stands, which `tomllib` doesn't say.

The text is one that `tomllib` has read: it is scanned here, not judged. Grammar: TOML 1.0 (keys, tables, arrays of
tables, inline tables).
"""

import re
import tomllib
from collections.abc import Sequence

Place = tuple[str | int, ...]
"""Keys and, in arrays, indices from the top of a document: ("images", 0, "isd")."""

_BLANK = re.compile(r"(?:\s+|#[^\n]*)*")
_KEY = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'|[A-Za-z0-9_-]+")
_DOT = re.compile(r"[ \t]*\.[ \t]*")
_SCALAR = re.compile(
    r"\"\"\"(?:[^\\]|\\.)*?\"{3,5}|'''.*?'{3,5}|\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'|"
    r"[^\s,\[\]{}#]+(?: \d\d:[^\s,\[\]{}#]+)?",
    re.DOTALL,
)
"""A date and a time of day may have a blank between them."""


def key_lines(text: str) -> dict[Place, int]:
    """Line, counted from 1, in which each table, key and item of an array begins; what opens a table without a line of
    its own (dotted keys, ``[a.b]``) is that of the first key that does so.
    """
    scan = _Scan(text)
    scan.document()
    return scan.lines


def line_of(text: str, place: Sequence[str | int]) -> int | None:
    """Line of what is at a place, or of the innermost table around it; None where there is neither."""
    lines, wanted = key_lines(text), tuple(place)
    return next((lines[wanted[:k]] for k in range(len(wanted), 0, -1) if wanted[:k] in lines), None)


class _Scan:
    """One pass over a text; `at` is the place that is read next, in characters."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.lines: dict[Place, int] = {}
        self.tables: dict[Place, int] = {}
        """Tables seen so far of each array of tables."""

    def document(self) -> None:
        """Headers of tables, and keys with their values."""
        table: Place = ()
        while self._next():
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)

    def _next(self) -> str:
        """The next character that counts; empty at the end."""
        blank = _BLANK.match(self.text, self.at)
        self.at = blank.end() if blank else self.at
        return self.text[self.at : self.at + 1]

    def _note(self, place: Place, start: int) -> None:
        self.lines.setdefault(place, self.text.count("\n", 0, start) + 1)

    def _keys(self) -> list[str]:
        """A key, dotted or not, of which each part is as it is meant, without quotation marks."""
        keys: list[str] = []
        while True:
            self._next()
            found = _KEY.match(self.text, self.at)
            assert found is not None, "the text is no TOML"
            keys += tomllib.loads(f"{found[0]} = 0")
            dot = _DOT.match(self.text, found.end())
            if dot is None:
                self.at = found.end()
                return keys
            self.at = dot.end()

    def _header(self) -> Place:
        """The place of the table that ``[...]`` or ``[[...]]`` begins."""
        start, several = self.at, self.text.startswith("[[", self.at)
        self.at += 2 if several else 1
        place: Place = ()
        keys = self._keys()
        for k, key in enumerate(keys):
            place = (*place, key)
            self._note(place, start)
            if several and k == len(keys) - 1:
                self.tables[place] = self.tables.get(place, -1) + 1
            if place in self.tables:
                place = (*place, self.tables[place])
                self._note(place, start)
        self._next()
        self.at += 2 if several else 1
        return place

    def _pair(self, table: Place) -> None:
        start, place = self.at, table
        for key in self._keys():
            place = (*place, key)
            self._note(place, start)
        self._next()
        self.at += 1  # the equals sign
        self._value(place)

    def _value(self, place: Place) -> None:
        first = self._next()
        if first in ("[", "{"):
            self.at += 1
            count, closing = 0, "]" if first == "[" else "}"
            while (mark := self._next()) not in (closing, ""):
                if mark == ",":
                    self.at += 1
                elif first == "[":
                    self._note((*place, count), self.at)
                    self._value((*place, count))
                    count += 1
                else:
                    self._pair(place)
            self.at += 1
            return
        found = _SCALAR.match(self.text, self.at)
        assert found is not None, "the text is no TOML"
        self.at = found.end()
