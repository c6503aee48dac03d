"""The one place where numbers and texts of a browser come in, out of an address or a JSON body."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import LONGEST_NAME

_LARGEST = 1e12
"""No number of a request is larger: pixels, degrees, m on a map."""
_MOST = 200
"""Entries of a list."""


def bounded(value: Any, where: str) -> Any:
    """A value without texts, lists and numbers that are too large; InputError for another one."""
    if isinstance(value, str):
        expected = f"at most {LONGEST_NAME} characters that can be printed"
        require(len(value) <= LONGEST_NAME and value.isprintable(), where, repr(value)[:60], expected)
    elif isinstance(value, dict):
        for key, inner in value.items():
            bounded(inner, f"{where}, {bounded(key, where)}")
    elif isinstance(value, list):
        require(len(value) <= _MOST, where, f"{len(value)} entries", f"at most {_MOST}", "ask in several requests")
        for inner in value:
            bounded(inner, where)
    elif value is not None and not isinstance(value, bool):
        number(value, where)
    return value


def number(value: object, where: str) -> float:
    """A number, or one written as a text; InputError for others, and where it is not finite or too large."""
    with suppress(ValueError):
        value = float(value) if isinstance(value, str) else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
        raise InputError(where, repr(value)[:60], f"a finite number, at most {_LARGEST:g}")
    return float(value)


def number_of(content: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """A number by its key; InputError where it is invalid, or missing without a default."""
    return number(content.get(key, default), f"request, {key}")


def text_of(content: Mapping[str, Any], key: str) -> str:
    """A text by its key, empty where it is missing; InputError for anything else."""
    value = content.get(key, "")
    if not isinstance(value, str):
        raise InputError(f"request, {key}", repr(value)[:60], "a text")
    return value


def place_of(content: object) -> tuple[str, float, float]:
    """Image, line and sample of a place; InputError where one of them is invalid."""
    if not isinstance(content, dict):
        raise InputError("request", repr(content)[:60], "{image, line, sample}")
    return text_of(content, "image"), number_of(content, "line"), number_of(content, "sample")
