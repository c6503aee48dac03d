"""Arrays and names as JSON and CSV: no NaN in JSON, numbers of CSV read back bit for bit."""

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, TextIO

import msgspec
import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.io.records import record_text

_CHUNK = 2_000
"""Rows written at a time: so few that they stay in the cache."""
_SPECIAL = frozenset(',"\r\n')


def plain(value: Any) -> Any:
    """The value with arrays as lists, NumPy scalars as Python's, and None for NaN and infinity."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as strict JSON, as `plain` makes it, which ends with its checksum."""
    path.write_text(record_text(plain(record)), encoding="utf-8", newline="\n")


def columns(names: Sequence[str], values: Array) -> dict[str, Array]:
    """Columns of values (n, k) by their names."""
    return dict(zip(names, values.T, strict=True))


def padded(values: Array, before: int, after: int) -> Array:
    """Values with so many NaN before and after them."""
    return np.pad(values, (before, after), constant_values=np.nan)


def picked(names: Sequence[str], index: np.ndarray) -> list[str]:
    """The name for each index."""
    return [names[i] for i in index.tolist()]


def whole(values: np.ndarray) -> list[str]:
    """Whole numbers as text."""
    return [str(value) for value in values.tolist()]


def truths(values: np.ndarray) -> list[str]:
    """Truth values as text."""
    return picked(("false", "true"), values.astype(np.int64))


def write_csv(out: Path | TextIO, text: Mapping[str, Sequence[str]], numbers: Mapping[str, Array]) -> None:
    """Write a CSV file, or to a stream, columns of text first; numbers read back bit for bit, NaN is an empty field.

    msgspec's JSON gives the shortest digits that do so, in a tenth of the csv module's time.
    """
    names, table = list(text.values()), list(numbers.values())
    with out.open("w", encoding="utf-8", newline="") if isinstance(out, Path) else nullcontext(out) as file:
        file.write(",".join([*text, *numbers]) + "\n")
        for first in range(0, len(names[0]), _CHUNK):
            some = slice(first, first + _CHUNK)
            figures = _figures(np.column_stack([column[some] for column in table]))
            lines = zip(*(column[some] for column in names), figures, strict=True)
            file.write("\n".join(map(",".join, lines)) + "\n")


def _figures(rows: Array) -> list[str]:
    """Numbers (n, c) as text, a row's with commas between them.

    All are one flat list, in which `true` ends a row: a list for each row would keep the garbage collector busy.
    """
    count, width = rows.shape
    flat = np.column_stack([rows, np.zeros(count, dtype=rows.dtype)]).ravel().tolist()
    flat[width :: width + 1] = [True] * count
    figures = msgspec.json.encode(flat).decode()
    return figures[1 : -len(",true]")].replace("null", "").split(",true,")


def all_quoted(texts: list[str]) -> list[str]:
    """Fields of a CSV file, quoted where they must be; hardly ever is one, which a search of all at once finds out."""
    together = "".join(texts)
    return [quoted(text) for text in texts] if any(mark in together for mark in _SPECIAL) else texts


def quoted(text: str) -> str:
    """A field of a CSV file, quoted where it must be (RFC 4180)."""
    if _SPECIAL.isdisjoint(text):
        return text
    return '"' + text.replace('"', '""') + '"'
