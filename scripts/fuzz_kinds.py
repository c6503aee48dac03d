"""Which damage which format takes: some of any text or bytes, and more of its own structure."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fuzz_addresses import daf, tiff, wire
from fuzz_mutations import BYTES, DOTTED, TEXT, Change
from fuzz_structures import assignment, cell, json_value, npz, packed, sqlite
from fuzz_trials import PATIENCE, Seed

JSON: tuple[Change, ...] = (*TEXT, *[json_value] * 12)
PVL: tuple[Change, ...] = (*TEXT, *[assignment] * 8)
TOML: tuple[Change, ...] = (*TEXT, *DOTTED, *[assignment] * 8)
CSV: tuple[Change, ...] = (*TEXT, *[cell] * 8)
TIFF: tuple[Change, ...] = (*BYTES, *[tiff] * 12)
DAF: tuple[Change, ...] = (*BYTES, *[daf] * 20)
NPZ: tuple[Change, ...] = (*BYTES, *[npz] * 12)
SQLITE: tuple[Change, ...] = (*BYTES, *[sqlite] * 20)
WIRE: tuple[Change, ...] = (*BYTES, *[wire] * 15)
GZIP: tuple[Change, ...] = (*BYTES, *[packed] * 10)


class Row(NamedTuple):
    """A reader in the making: its seed is written when it is wanted."""

    name: str
    owner: str
    """Letter of who mends it."""
    read: Callable[[Path], Any]
    seed: Callable[[], Seed]
    changes: Sequence[Change]
    patience: float = PATIENCE
    """s that it may take."""
    share: float = 1.0
    """Of the time that others get."""
    gaps: tuple[str, ...] = ()
    """Ends of the places where what is read may have gaps (NaN): posts that are missing."""
