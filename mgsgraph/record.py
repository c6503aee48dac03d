"""How records show themselves: a line as text; title, sentences and a table in a notebook. Plain HTML, all escaped."""

import ast
import inspect
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

_SHOWN = 8
"""Numbers of an array, or members of a sequence, that are written out; of more, only how many they are."""
_LONGEST = 120
"""Characters of a record within a record."""


class Record:
    """Shows itself: `repr` is one line, a notebook has a table of the fields with what they mean; both give large
    arrays by their shapes. `str` is its `sentence`, or its `sentences`, where it has such.

    A class with more to say of itself has a `__repr__` or a `_repr_html_` of its own.
    """

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__repr__ = cls.__repr__  # type: ignore[method-assign]  # in the class, or @dataclass writes one of its own

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={_brief(value)}' for name, value in _fields(self))})"

    def __str__(self) -> str:
        return "\n".join(_sentences(self)) or repr(self)

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        kind: Any = type(self)
        said = meanings(kind)
        rows = [(name, _brief(value), said.get(name, "")) for name, value in _fields(self)]
        title = kind.__name__ if kind.__repr__ is Record.__repr__ else repr(self)
        return card(title, _sentences(self), [("field", "value", "meaning"), *rows] if rows else (), head=1)


def card(title: str, sentences: Sequence[str] = (), rows: Sequence[Sequence[str]] = (), head: int = 0) -> str:
    """HTML of a record; the first `head` rows are headings."""
    said = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    lines = "".join(
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"
        for k, row in enumerate(rows)
        for tag in ("th" if k < head else "td",)
    )
    table = f"<table>{lines}</table>" if lines else ""
    return f"<b>{escape(title)}</b>" + (f"<ul>{said}</ul>" if said else "") + table


def _sentences(record: object) -> list[str]:
    """What a record says of itself; nothing of most."""
    one = getattr(record, "sentence", None)
    return [*([one] if one else []), *getattr(record, "sentences", ())]


def _fields(record: Any) -> list[tuple[str, Any]]:
    shown = fields(record) if is_dataclass(record) else ()
    return [(one.name, getattr(record, one.name)) for one in shown if one.repr]


def _brief(value: Any) -> str:
    """A value on one line, whole where it is short."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, np.generic):
        return repr(value.item())
    if isinstance(value, Path):
        return repr(str(value))
    if value is None or isinstance(value, str | float | int | complex | bytes | Enum):
        return repr(value)
    if isinstance(value, Mapping):
        return _several(value, [f"{key!r}: {_brief(one)}" for key, one in _first(value.items())], "{}")
    if type(value) in (tuple, list):
        return _several(value, [_brief(one) for one in _first(value)], "()" if isinstance(value, tuple) else "[]")
    if isinstance(value, Sequence):  # of names, which are brief themselves
        return repr(value)
    if isinstance(value, Record) and len(whole := repr(value)) <= _LONGEST:
        return whole
    return getattr(value, "__qualname__", None) or f"{type(value).__name__}(...)"


def _first(values: Iterable[Any]) -> list[Any]:
    """No more of them than are shown."""
    return [one for one, _ in zip(values, range(_SHOWN), strict=False)]


def _array(values: np.ndarray[Any, Any]) -> str:
    if values.ndim == 1 and values.size <= _SHOWN:
        return repr(values.tolist())
    return f"array{values.shape}"


def _several(values: Any, parts: Sequence[str], brackets: str) -> str:
    whole = ", ".join(parts)
    if len(values) <= _SHOWN and len(whole) <= _LONGEST:
        one = "," if brackets == "()" and len(parts) == 1 else ""
        return f"{brackets[0]}{whole}{one}{brackets[1]}"
    return f"{type(values).__name__} of {len(values)}"


@cache
def meanings(kind: type[Any]) -> dict[str, str]:
    """What stands under the fields of a class in its source: shapes, units, frames."""
    found = dict[str, str]()
    for base in reversed(kind.__mro__):
        if "__annotations__" not in vars(base):
            continue
        try:
            source = textwrap.dedent(inspect.getsource(base))
        except (OSError, TypeError):  # a session's own class, or a program without its sources
            continue
        (definition,) = ast.parse(source).body
        assert isinstance(definition, ast.ClassDef)
        for field, said in pairwise(definition.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(said, ast.Expr) \
                    and isinstance(said.value, ast.Constant) and isinstance(said.value.value, str):  # fmt: skip
                found[field.target.id] = " ".join(said.value.value.split())
    return found
