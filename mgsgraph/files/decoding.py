"""TOML and JSON files as validated records; errors name the place in the file, and what was found there."""

import math
import re
import tomllib
import typing
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec

from mgsgraph.errors import InputError
from mgsgraph.files.opening import read_text, require_bearable

FORMAT = 1
"""Of case files, settings of projects and candidates."""
CASE_FILE = "case file"
"""What errors call one."""
Number = Annotated[float, msgspec.Meta(ge=-1e300, le=1e300)]
"""Magnitudes beyond are no measurements."""
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e300)]
Count = Annotated[int, msgspec.Meta(ge=1)]
Name = Annotated[str, msgspec.Meta(min_length=1)]

_Record = TypeVar("_Record", bound=msgspec.Struct)
LARGEST_TOML = 1 << 24
"""bytes: a hundred thousand tables."""
_DEEP = re.compile(
    r"(?:(?:(?<![\w-])[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+){20}|(?:[\[{][\s,]*+){100}"
)
"""Dotted keys of which tomllib makes tables by the square of their number, and brackets on which it breaks down."""
_Place = tuple[str | int, ...]
_PART = r"(?:\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'|[\w-]+)"
_TABLE = re.compile(rf"\s*(\[\[?)\s*({_PART}(?:\s*\.\s*{_PART})*)\s*\]")
_PAIR = re.compile(rf"\s*({_PART}(?:\s*\.\s*{_PART})*)\s*=")
_LONG_TEXT = re.compile(r"\"\"\"(?:[^\\]|\\.)*?\"{3,5}|'''.*?'{3,5}", re.DOTALL)
_STEP = re.compile(r"\.?(\w+)|\[(\d+|\.\.\.)\]")
_KEY = re.compile(r"Object (missing required|contains unknown) field `(.*)`")
_WORDS = {
    "`float`": "a number", "`int`": "a whole number", "`str`": "a text", "`bool`": "true or false", "`array`": "a list",
    "`object`": "a table", "`float | null`": "a number", "`float | array`": "a number or a list",
    "`float | array | null`": "a number or a list", "`array | null`": "a list", "`int | null`": "a whole number",
    "`str | null`": "a text",
}  # fmt: skip
"""msgspec's names of types."""
_NO_VALUE = object()
_LIKENESS = 0.6
"""Likeness (difflib) from which on a known key may be meant by an unknown one."""


class Toml(NamedTuple):
    """A TOML file that has been read."""

    path: Path
    """Where it is."""
    text: str
    """What it says."""
    tables: dict[str, Any]
    """The same as mappings and lists."""


def read_toml(path: Path, what: str) -> Toml:
    """A TOML file that begins with `format`; `what` it is, in words of errors."""
    text = read_text(path, limit=LARGEST_TOML)
    table = toml_table(text, str(path))
    version = table.get("format")
    if version != FORMAT:
        found = "no key 'format'" if version is None else f"format {version!r}"
        raise InputError(str(path), found, f"format = {FORMAT}", f"write it at the head of the {what}")
    return Toml(path, text, table)


def toml_table(text: str, where: str) -> dict[str, Any]:
    """What a TOML text says; InputError, with the line, when it is malformed, nested too deeply, or holds a
    whole number that can't be any.
    """
    if match := _DEEP.search(text):
        line = text.count("\n", 0, match.start()) + 1
        raise InputError(f"{where}, line {line}", "keys or brackets nested too deeply", "TOML of few levels")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"malformed TOML ({error})", remedy="fix that line") from None
    except RecursionError:
        raise InputError(where, "brackets nested too deeply", "TOML of few levels") from None
    except ValueError as error:  # Python's limit of digits, which tomllib lets through
        raise InputError(where, f"malformed TOML ({str(error).split(';')[0]})", remedy="fix that number") from None
    require_bearable(table, where, infinite=True)
    return table


def validated(
    given: Toml | dict[str, Any], kind: type[_Record], source: Path | str, remedy: str = ""
) -> _Record:
    """Tables as a record of a kind; InputError with the place (of TOML with its line) of what is wrong, what was found
    and expected there.
    """
    table, text = (given.tables, given.text) if isinstance(given, Toml) else (given, "")
    try:
        record = msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise _refusal(str(error), table, kind, str(source), remedy, text) from None
    except UnicodeEncodeError:  # JSON may escape one
        raise InputError(str(source), "half a character", "text") from None
    _refuse_nan(table, str(source))
    return record


def line_of(text: str, place: Sequence[str | int]) -> int | None:
    """Line, counted from 1, of what is at a place of a TOML text that `tomllib` has read: ("images", 0, "isd").

    That of its key, or of the innermost table around it, or array or inline table that holds it; None where there is
    neither.
    """
    lines, counts = dict[_Place, int](), dict[_Place, int]()
    table: _Place = ()
    plain = _LONG_TEXT.sub(lambda match: "\n" * match[0].count("\n"), text)
    for number, line in enumerate(plain.split("\n"), start=1):
        head, pair = _TABLE.match(line), _PAIR.match(line)
        key_path: _Place = () if head else table
        keys = _keys(head[2] if head else pair[1] if pair else "")
        for k, key in enumerate(keys, start=1):
            key_path = (*key_path, key)
            lines.setdefault(key_path, number)
            if head and head[1] == "[[" and k == len(keys):
                counts[key_path] = counts.get(key_path, -1) + 1
            if head and key_path in counts:
                key_path = (*key_path, counts[key_path])
                lines.setdefault(key_path, number)
        table = key_path if head else table
    wanted = tuple(place)
    return next((lines[wanted[:k]] for k in range(len(wanted), 0, -1) if wanted[:k] in lines), None)


def _keys(dotted: str) -> list[str]:
    """The parts of a key, without quotation marks."""
    keys, value = list[str](), tomllib.loads(f"{dotted} = 0") if dotted else {}
    while isinstance(value, dict) and value:
        ((key, value),) = value.items()
        keys.append(key)
    return keys


def _refusal(
    message: str, table: dict[str, Any], kind: type[msgspec.Struct], source: str, remedy: str, text: str
) -> InputError:
    """The InputError for what msgspec says: what is wrong, and " - at `$.images[0].name`"."""
    detail, _, place = message.partition(" - at `$")
    place = place.rstrip("`").removeprefix(".")
    steps = _STEP.findall(place)
    value, owner = _value_at(table, steps)
    key = _KEY.fullmatch(detail)
    if text:
        wanted = [name or int(index) for name, index in steps if name or index.isdecimal()]
        line = line_of(text, [*wanted, key[2]] if key else wanted)
        source += f", line {line}" if line else ""
    where = f"{source}, {place}{owner}" if place else source
    if key:
        if key[1] == "missing required":
            return InputError(where, f"no key {key[2]!r}", remedy=remedy)
        keys = [field.encode_name for part in _kinds_at(kind, steps) if _is_record(part) for field in fields_of(part)]
        close = get_close_matches(key[2], keys, n=1, cutoff=_LIKENESS)
        expected = f"did you mean {close[0]!r}?" if close else f"known keys are {', '.join(keys)}"
        if homes := sorted(set(_homes(kind, key[2]))):
            expected = f"it is a key of {' and '.join(f'[{home}]' if home else 'the head' for home in homes)}"
        return InputError(where, f"the unknown key {key[2]!r}", remedy="; ".join(filter(None, (expected, remedy))))
    if value is _NO_VALUE:
        return InputError(where, detail[0].lower() + detail[1:], remedy=remedy)
    if detail == "Number out of range":
        return InputError(where, "a number out of range", "a finite number", remedy)
    words = [repr(word) for choice in _kinds_at(kind, steps) if typing.get_origin(choice) is typing.Literal
             for word in typing.get_args(choice)]  # fmt: skip
    expected = f"one of {', '.join(sorted(words))}" if words else detail.removeprefix("Expected ").partition(", got")[0]
    for type_name, word in _WORDS.items():
        expected = expected.replace(type_name, word)
    return InputError(where, repr(value)[:60], expected, remedy)


def _value_at(table: Any, steps: list[tuple[str, str]]) -> tuple[Any, str]:
    """What is at a place, and the name or id, in parentheses, of the innermost record of a list around it."""
    value, owner = table, ""
    try:
        for name, index in steps:
            value = value[name] if name else value[int(index)]
            if index and isinstance(value, dict) and isinstance(label := value.get("name", value.get("id")), str):
                owner = f" ({label[:60]})"
    except (LookupError, TypeError, ValueError):  # msgspec gives no key of a mapping
        return _NO_VALUE, owner
    return value, owner


def _homes(kind: Any, key: str, path: str = "") -> Iterator[str]:
    """Tables below a type that have a key."""
    if _is_record(kind):
        for field in fields_of(kind):
            if field.encode_name == key:
                yield path
            yield from _homes(field.type, key, f"{path}.{field.encode_name}".lstrip("."))
        return
    for part in typing.get_args(kind):
        yield from _homes(part, key, path)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


@cache
def fields_of(kind: Any) -> tuple[msgspec.structs.FieldInfo, ...]:
    """Fields of a record."""
    return msgspec.structs.fields(kind)


def _kinds_at(kind: Any, steps: list[tuple[str, str]]) -> list[Any]:
    """Records and choices that may stand at a place below a type."""
    names = [name for name, _ in steps if name]
    if _is_record(kind):
        inner = {field.encode_name: field.type for field in fields_of(kind)}
        return _kinds_at(inner.get(names[0]), [(name, "") for name in names[1:]]) if names else [kind]
    if typing.get_origin(kind) is typing.Literal:
        return [] if names else [kind]
    return [inner_kind for part in typing.get_args(kind) for inner_kind in _kinds_at(part, steps)]


def _refuse_nan(value: object, where: str) -> None:
    """Refuse nan, which TOML allows."""
    if isinstance(value, float) and math.isnan(value):
        raise InputError(where, "nan", "a number")
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_nan(item, f"{where}, {key}")
    if isinstance(value, list):
        for k, item in enumerate(value):
            _refuse_nan(item, f"{where}[{k}]")
