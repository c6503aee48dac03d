"""Tables and keys of a case file, as its schema has them: for `mgsgraph help case`, and for docs/case_file.md."""

import textwrap
import types
import typing
from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from typing import Any, NamedTuple

import msgspec

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.schema import CaseInput, SolverInput
from mgsgraph.errors import InputError
from mgsgraph.record import meanings

HEAD = "head"
"""What the keys before the first table go by."""
_WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false", types.NoneType: ""}
_Kind = type[msgspec.Struct]


class Key(NamedTuple):
    """What a case file may say in one place."""

    name: str
    """The key; the unit of its value stands at its end."""
    kind: str
    """What its value is: text, number, list of them, one of some words."""
    default: str
    """What holds where it is left out; empty where nothing does."""
    required: bool
    """Whether it must be there."""
    meaning: str
    """In one or two sentences."""


class KeyTable(NamedTuple):
    """One table of a case file."""

    path: str
    """Its keys, with dots between them; empty at the head of the file."""
    head: str
    """As it stands in the file: ``[ties]``, ``[[images]]``."""
    meaning: str
    """What it says."""
    keys: tuple[Key, ...]
    """In the schema's order, without those that are tables of their own."""


@cache
def key_tables() -> tuple[KeyTable, ...]:
    """All tables, a table's own tables after it."""
    return tuple(_tables("", CaseInput, False))


def _tables(path: str, kind: _Kind, several: bool) -> Iterator[KeyTable]:
    fields = msgspec.structs.fields(kind)
    keys = tuple(_key(field, kind) for field in fields)
    head = (f"[[{path}]]" if several else f"[{path}]") if path else "At the head of the file"
    yield KeyTable(path, head, " ".join((kind.__doc__ or "").split()), keys)
    for field in fields:
        below = _record(field.type)
        if below is not None and not (path and field.name == "orientation"):  # an image's is as that of all
            yield from _tables(f"{path}.{field.name}".lstrip("."), below, "tuple" in str(field.type))


def _record(hint: Any) -> _Kind | None:
    """The record within a type, if there is one."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return hint
    return next((found for part in typing.get_args(hint) if (found := _record(part)) is not None), None)


def _key(field: msgspec.structs.FieldInfo, kind: _Kind) -> Key:
    meaning = meanings(SolverSettings if kind is SolverInput else kind)[field.name]  # the same names, said there
    return Key(field.name, _words(field.type), _default(field), field.required, meaning)


def _words(hint: Any) -> str:
    """A type in words."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _words(parts[0])
    if origin is typing.Literal:
        return ", ".join(f'"{word}"' for word in parts)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(filter(None, map(_words, parts))))
    if origin in (tuple, list):
        if _record(parts[0]) is not None:
            return "tables"
        plural = {"text": "texts", "number": "numbers", "whole number": "whole numbers"}
        count = "list of" if origin is list or parts[-1] is Ellipsis else f"list of {len(parts)}"
        return f"{count} {plural.get(_words(parts[0]), _words(parts[0]))}"
    return "table" if _record(hint) is not None else _WORDS.get(hint, getattr(hint, "__name__", str(hint)))


def _default(field: msgspec.structs.FieldInfo) -> str:
    value = field.default
    if value is msgspec.NODEFAULT or value in (None, "", ()) or isinstance(value, msgspec.Struct):
        return ""
    if isinstance(value, str):
        return f'"{value}"'
    return f"{str(value).lower() if isinstance(value, bool) else list(value) if isinstance(value, tuple) else value}"


def keys_text(table: str | None = None, width: int = 110) -> str:
    """Tables and keys as text for the terminal: all, or one table by its name (as ``images``, ``[[images]]``,
    ``passes.nodes``, ``head``); InputError, with the nearest, for one that there isn't.
    """
    if table is None:
        said = "\n\n".join(_table_text(one, width) for one in key_tables())
        return f"{said}\n\nPaths are relative to the file. One table alone: mgsgraph help case TABLE"
    names = {one.path or HEAD: one for one in key_tables()}
    wanted = table.strip("[]").lower()
    if wanted not in names:
        last = {name.split(".")[-1]: name for name in names}
        near = last.get(wanted) or next(iter(get_close_matches(wanted, names, n=1)), "")
        remedy = f"did you mean {near}?" if near else f"there are {', '.join(names)}"
        raise InputError(f"case file, {table}", "no such table", remedy=remedy)
    found = names[wanted]
    below = [one for one in key_tables() if found.path and one.path.startswith(f"{found.path}.")]
    return "\n\n".join(_table_text(one, width) for one in (found, *below))


def _table_text(table: KeyTable, width: int) -> str:
    lines = [table.head, *textwrap.wrap(table.meaning, width - 2, initial_indent="  ", subsequent_indent="  ")]
    for key in table.keys:
        said = "must be there" if key.required else f"default {key.default}" if key.default else ""
        lines.append(f"  {key.name} ({'; '.join(filter(None, (key.kind, said)))})")
        lines += textwrap.wrap(key.meaning, width - 6, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return "\n".join(lines)


def keys_markdown() -> str:
    """The same as sections of a page, a heading and a list for each table."""
    lines: list[str] = []
    for table in key_tables():
        head = f"`{table.head}`" if table.path else table.head
        lines += [f"### {head}", "", table.meaning, "", "| key | what it is | when left out | what it says |"]
        lines.append("|---|---|---|---|")
        for key in table.keys:
            default = "**must be there**" if key.required else f"`{key.default}`" if key.default else ""
            kind = key.kind.replace('"', "`")
            cells = f"`{key.name}`", kind, default, key.meaning.replace("|", r"\|")
            lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
        lines.append("")
    return "\n".join(lines)
