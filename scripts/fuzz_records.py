"""What a reader gives, as places and plain values, so that two readings can be compared."""

import dataclasses
import math
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import PurePath
from typing import Any

import msgspec
import numpy as np

_DEEPEST = 12
_NAN = ("nan",)


def flat(value: Any) -> dict[str, Any]:
    """All values in a record by their places in it; arrays as (shape, type, bytes)."""
    return dict(_leaves("", value, 0))


def _leaves(where: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    if value is None or isinstance(value, (str, bytes, bool, int, Enum, PurePath)):
        yield where, value
    elif isinstance(value, float):
        yield where, _NAN if math.isnan(value) else value
    elif isinstance(value, np.ndarray):
        yield where, (value.shape, value.dtype.str, value.tobytes() if value.dtype != object else repr(value))
    elif isinstance(value, np.generic):
        yield from _leaves(where, value.item(), depth)
    elif depth > _DEEPEST:
        yield where, type(value).__name__
    elif isinstance(value, dict):
        for key, one in value.items():
            yield from _leaves(f"{where}.{key}", one, depth + 1)
        yield f"{where}#", len(value)
    elif isinstance(value, (set, frozenset)):
        yield from _leaves(where, sorted(map(repr, value)), depth)
    elif isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        for k, one in enumerate(value):
            yield from _leaves(f"{where}[{k}]", one, depth + 1)
        yield f"{where}#", len(value)
    else:
        names = _names(value)
        for name in names:
            yield from _leaves(f"{where}.{name}", getattr(value, name, None), depth + 1)
        yield f"{where}#", type(value).__name__


def _names(value: Any) -> tuple[str, ...]:
    """Names of a record's fields; none for a function or a thing that says nothing of itself."""
    if callable(value) and not dataclasses.is_dataclass(value):
        return ()
    if isinstance(value, msgspec.Struct):
        return value.__struct_fields__
    if dataclasses.is_dataclass(value):
        return tuple(one.name for one in dataclasses.fields(value))
    if hasattr(value, "_fields"):
        return tuple(value._fields)
    return tuple(vars(value)) if hasattr(value, "__dict__") else ()


def odd_places(leaves: dict[str, Any]) -> set[str]:
    """Where a record has numbers that are not finite; indices are left out."""
    return {re.sub(r"\[\d+\]", "[]", where) for where, value in leaves.items() if _odd(value)}


def _odd(value: Any) -> bool:
    if isinstance(value, tuple) and len(value) == 3 and value[1][1:2] in "fc":
        return not np.all(np.isfinite(np.frombuffer(value[2], dtype=value[1])))
    return value == _NAN or (isinstance(value, float) and math.isinf(value))
