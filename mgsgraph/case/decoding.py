"""TOML files that people write, as validated tables: what is wrong is said with its path in the file."""

import math
import tomllib
import typing
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from mgsgraph.errors import InputError
from mgsgraph.io.files import read_text

FORMAT = 1
"""Of case files, settings of projects and candidates."""
_Table = TypeVar("_Table", bound=msgspec.Struct)


def read_table(path: Path, what: str) -> dict[str, Any]:
    """The tables of a TOML file that begins with `format`; `what` it is, in words of errors."""
    try:
        table = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), f"malformed TOML ({error})", remedy="mend that line") from None
    version = table.get("format")
    if version != FORMAT:
        found = "no key 'format'" if version is None else f"format {version!r}"
        raise InputError(str(path), found, f"format = {FORMAT}", f"write it at the head of the {what}")
    return table


def validated(table: dict[str, Any], kind: type[_Table], path: Path, remedy: str) -> _Table:
    """Tables as a record of a kind; InputError with the place of what is wrong."""
    try:
        found = msgspec.convert(table, kind, strict=False)
    except msgspec.ValidationError as error:
        said, _, place = str(error).partition(" - at `$.")
        place = place.rstrip("`")
        where = f"{path}, {place}" if place else str(path)
        expected = _choices(kind, place) if said.startswith("Invalid enum value") else ""
        raise InputError(where, said[0].lower() + said[1:], expected, remedy) from None
    _refuse_nan(table, str(path))
    return found


def _choices(kind: type[msgspec.Struct], place: str) -> str:
    """The words that may stand at a place of a file: the only Literal of that name below the record."""
    name = place.rpartition(".")[2].partition("[")[0]
    found = {repr(word) for words in _literals(kind, name, set()) for word in words}
    return f"one of {', '.join(sorted(found))}" if found else ""


def _literals(kind: Any, name: str, seen: set[Any]) -> list[tuple[Any, ...]]:
    """Words of all Literal fields of a name in a type and the records below it."""
    if kind in seen:
        return []
    seen.add(kind)
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return [words for part in typing.get_args(kind) for words in _literals(part, name, seen)]
    found: list[tuple[Any, ...]] = []
    for key, hint in typing.get_type_hints(kind).items():
        parts = (hint, *typing.get_args(hint))
        if key == name:
            found += [typing.get_args(part) for part in parts if typing.get_origin(part) is typing.Literal]
        found += _literals(hint, name, seen)
    return found


def _refuse_nan(value: object, where: str) -> None:
    """TOML has nan; nothing here may be it."""
    if isinstance(value, float) and math.isnan(value):
        raise InputError(where, "nan", "a number")
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_nan(item, f"{where}, {key}")
    if isinstance(value, list):
        for k, item in enumerate(value):
            _refuse_nan(item, f"{where}[{k}]")
