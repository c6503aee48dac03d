"""Camera constants by their SPICE names (``INS-74021_FOCAL_LENGTH``), wherever they come from: kernels, cubes, JSON."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.opening import finite_number
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.records import Array


class Keywords(Protocol):
    """Constants by name, in the units of SPICE's instrument kernels: km, mm, degrees, seconds."""

    def numbers(self, name: str, count: int) -> Array:
        """The first `count` numbers of a keyword (cubes hold as much of a list as ISIS asked for); InputError where it
        is missing, a text, or shorter.
        """
        ...

    def __contains__(self, name: str) -> bool:
        """Whether there is such a keyword."""
        ...


def number(keywords: Keywords, name: str) -> float:
    """The one number of a keyword; InputError as `Keywords.numbers`."""
    return float(keywords.numbers(name, 1)[0])


@dataclass(frozen=True, slots=True)
class NaifKeywords:
    """What spiceinit copied out of the kernels into a cube (object NaifKeywords) or into JSON ("naif_keywords")."""

    source: str
    """Where they stand, for messages."""
    values: Mapping[str, Any]
    """Words, numbers or lists of them, by name."""

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def numbers(self, name: str, count: int) -> Array:
        """See `Keywords.numbers`."""
        where = f"{self.source}, {name}"
        if name not in self.values:
            remedy = "run spiceinit again with the camera's addendum kernel"
            raise InputError(f"{self.source}, NaifKeywords", f"no {name}", f"{name} = {count} number(s)", remedy)
        value = self.values[name]
        items = [value] if isinstance(value, str) or not isinstance(value, Sequence) else list(value)
        if len(items) < count:
            raise InputError(where, f"{len(items)} items", f"{count} number(s)")
        return np.array([_finite(item, where) for item in items[:count]])

    def time(self, name: str) -> float:
        """A time in s TDB past J2000, which ISIS writes as the number's 8 bytes in hexadecimal, the lowest first."""
        text = str(self.values.get(name, ""))
        try:
            (time,) = struct.unpack("<d", bytes.fromhex(text))
            return finite_number(repr(time))
        except (ValueError, struct.error):
            raise InputError(f"{self.source}, {name}", repr(text[:60]), "16 hexadecimal digits of a time") from None


def _finite(item: Any, where: str) -> float:
    try:
        return finite_number(str(item))
    except ValueError:
        raise InputError(where, repr(item)[:60], "a finite number") from None


def keywords_of(block: Block) -> NaifKeywords:
    """Those of a block of a label."""
    return NaifKeywords(block.document.source, _ByName({name: entry.value for name, entry in block.entries.items()}))


class _ByName(dict[str, Any]):
    """Values by name in any case: a label's blocks keep their keywords in lower case."""

    def __contains__(self, name: object) -> bool:
        return super().__contains__(str(name).lower())

    def __getitem__(self, name: str) -> Any:
        return super().__getitem__(name.lower())

    def get(self, name: str, default: Any = None) -> Any:
        return super().get(name.lower(), default)
