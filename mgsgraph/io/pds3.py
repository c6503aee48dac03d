"""The keywords of a PDS3 label, flat: for labels of tables and grids, of which only a few words are needed."""

import re

from mgsgraph.errors import InputError
from mgsgraph.io.pvl import Block, Document, finite_number, whole_label

_ENVELOPE = re.compile(r"\A\s*CCSD[^\n]*\n")
"""First line of an SFDU, in which PEDR labels lie; it is no PVL."""


class Pds3Label:
    """Keywords of a label up to its END, whichever object they stand in; of several the outermost and first counts."""

    def __init__(self, text: str, source: str) -> None:
        plain = _ENVELOPE.sub("", text.replace("\r\n", "\n"), count=1)
        self.where = source
        self._values: dict[str, str] = {}
        self._gather(whole_label(Document(source, plain)))

    def _gather(self, block: Block) -> None:
        for key, entry in block.entries.items():
            if isinstance(entry.value, str):
                self._values.setdefault(key, entry.value)
        for inner in block.blocks:
            self._gather(inner)

    def __contains__(self, key: str) -> bool:
        return key.lower() in self._values

    def text(self, key: str) -> str:
        """A word or string."""
        if key not in self:
            raise InputError(self.where, f"no keyword {key}", "a complete PDS3 label")
        return self._values[key.lower()]

    def number(self, key: str) -> float:
        """A number, in whatever unit: the keywords asked for have but one."""
        value = self.text(key)
        try:
            return finite_number(value)
        except ValueError:
            raise InputError(f"{self.where}, {key}", repr(value), "a number") from None

    def count(self, key: str) -> int:
        """A whole number above zero."""
        value = self.number(key)
        if value < 1 or value % 1:
            raise InputError(f"{self.where}, {key}", f"{value:g}", "a whole number above zero")
        return int(value)
