"""Control networks written as PVL text, version 5, as ISIS's cnetbin2pvl does, but with all digits of a number.

Written beside what ISIS writes: JigsawRejected of a point, which ISIS reads; zeros (diameter, residuals, covariances);
RadiusConstrained by itself, for which ISIS asks the longitude. Left out: comments, and texts that say Null. Source:
`networks.pvl`.

Equals signs of a block stand in one column, texts in quotes where they need them, lists are wrapped at 80 columns:
DOI-USGS/ISIS3, isis/src/base/objs/PvlFormat/PvlFormat.cpp (FormatValue, AddQuotes), and ControlNetVersioner.truth. Long
texts are not wrapped: a wrapped one comes back with its blanks changed. All texts that a reader might take apart are in
quotes.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.networks.pvl import (
    HEAD_TEXTS,
    LOG_NAMES,
    MEASURE_KEYS,
    MEASURE_TYPES,
    POINT_KEYS,
    POINT_TYPES,
    REJECTED,
    SOURCES,
)
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint
from mgsgraph.files.writing import write_file

_COLUMNS = 80
_PLAIN = re.compile(r"[\w.:/$+-]*[\w.:/$+]")
_LINE_BREAK = re.compile(r"[\r\n]")

Value = str | tuple[str, ...]
"""As it stands behind the equals sign; items of a list."""
_LARGEST = 1e300
_Keywords = list[tuple[str, Value]]


def write_pvl_network(network: ControlNetwork, path: Path) -> None:
    """Write a network as PVL text, version 5.

    Parameters
    ----------
    network : ControlNetwork
        All of it is kept but texts that say Null, which is how ISIS spells none.
    path : Path
        Its folder is made when absent; a file of that name is replaced, once the new one is there whole.

    Raises
    ------
    InputError
        A network without points; a number that is not finite; a text that PVL can't hold; a figure of merit that has no
        name, or twice the same; or a file that can't be written.
    """
    write_file(path, network_text(network))


def network_text(network: ControlNetwork) -> str:
    """What `write_pvl_network` writes."""
    where = network.source or "network"
    if not network.points:
        raise InputError(where, "no control point", "some to write")
    head: _Keywords = [
        (key, text_value(getattr(network, attribute), f"{where}, {key}")) for key, attribute in HEAD_TEXTS.items()
    ]
    if network.target_radii:
        head.append(("TargetRadii", _numbers(network.target_radii, "TargetRadii", 3)))
    lines = ["Object = ControlNetwork", *keyword_lines([*head, ("Version", "5")], 2)]
    for index, point in enumerate(network.points):
        try:
            lines += _point_lines(point)
        except InputError as error:
            raise error.within(network.where(index)) from None
    return "\n".join([*lines, "End_Object", "End", ""])


def _point_lines(point: ControlPoint) -> list[str]:
    keywords: _Keywords = [("PointType", POINT_TYPES[point.type]), ("PointId", _name(point.id, "PointId"))]
    lines = ["", "  Object = ControlPoint", *keyword_lines([*keywords, *_keywords(point, POINT_KEYS)], 4)]
    for k, measure in enumerate(point.measures):
        try:
            lines += _measure_lines(measure, k == point.reference)
        except InputError as error:
            raise error.within(f"measure {k + 1}") from None
    return [*lines, "  End_Object"]


def _measure_lines(measure: ControlMeasure, reference: bool) -> list[str]:
    keywords = list(_keywords(measure, MEASURE_KEYS))
    keywords += _logged(measure)
    if reference:
        keywords.append(("Reference", "True"))
    return ["", "    Group = ControlMeasure", *keyword_lines(keywords, 6), "    End_Group"]


def _logged(measure: ControlMeasure) -> _Keywords:
    kinds = [kind for kind, _ in measure.log]
    for kind in kinds:
        if kind not in LOG_NAMES or kinds.count(kind) > 1:
            found = f"number {kind} twice" if kind in LOG_NAMES else f"number {kind}"
            raise InputError("figures of merit", found, f"1 .. {max(LOG_NAMES)}, each once", "write another format")
    return [(LOG_NAMES[kind], _number(value, LOG_NAMES[kind])) for kind, value in measure.log]


def _keywords(
    record: ControlPoint | ControlMeasure, keys: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, Value]]:
    """Keywords with their values, but for those of which there is nothing to say."""
    for key, (attribute, kind) in keys.items():
        value = getattr(record, attribute)
        if kind == "name":
            yield key, _name(value, key)
        elif kind == "type":
            yield key, MEASURE_TYPES[value]
        elif value is None or not (value or kind in ("number", "pixels")):
            continue
        elif kind == "text":
            yield from [(key, text_value(value, key))] if value.lower() != "null" else []
        elif kind == "flag":
            yield key, "Yes" if key in REJECTED else "True"
        elif kind == "source":
            yield key, SOURCES[value]
        elif kind == "matrix":
            yield key, _numbers(value, key, 6)
        elif kind == "place":
            for axis, one in zip("XYZ", value, strict=True):
                yield key + axis, _number(one, key + axis) + " <meters>"
        else:
            yield key, _number(value, key) + (" <pixels>" if kind == "pixels" else "")


def _name(text: str, key: str) -> str:
    if not text or text.lower() == "null":
        raise InputError(key, repr(text), "a name that PVL can hold", "change it, or write another format")
    return text_value(text, key)


def _numbers(values: tuple[float, ...], key: str, count: int) -> tuple[str, ...]:
    if len(values) != count:
        raise InputError(key, f"{len(values)} numbers", f"{count}")
    return tuple(_number(value, key) for value in values)


def _number(value: float, key: str) -> str:
    """All digits, so that the same number comes back."""
    if not -_LARGEST < value < _LARGEST:
        raise InputError(key, f"{value}", "a finite number")
    return repr(float(value))


# --- layout


def text_value(text: str, where: str) -> str:
    """A text, in quotes if it needs them; ISIS's Null for an empty one.

    Raises
    ------
    InputError
        If it has a line break or both kinds of quotes, which PVL can't hold, or characters that UTF-8 can't.
    """
    if _PLAIN.fullmatch(text):
        return text
    if not text:
        return "Null"
    quote = "'" if '"' in text else '"'
    found = "a line break" if _LINE_BREAK.search(text) else "both kinds of quotes" if quote in text else ""
    if any("\ud800" <= character <= "\udfff" for character in text):
        found = "half a character"
    if found:
        raise InputError(where, f"{found} in {text[:60]!r}", "what PVL can hold", "change it, or write another format")
    return f"{quote}{text}{quote}"


def keyword_lines(keywords: list[tuple[str, Value]], indent: int) -> list[str]:
    """Lines of a block's keywords."""
    width = max(len(key) for key, _ in keywords)
    blanks = " " * indent
    return [
        f"{blanks}{key:{width}} = {value}" if isinstance(value, str) else _list(f"{blanks}{key:{width}} = ", value)
        for key, value in keywords
    ]


def _list(head: str, items: tuple[str, ...]) -> str:
    """A list, its items below one another's first column where a line would be longer than 80."""
    lines, line = list[str](), head + "("
    for index, item in enumerate(items):
        piece = item + (")" if index == len(items) - 1 else ",")
        gap = " " if index else ""
        if index and len(line) + len(gap + piece) > _COLUMNS:
            lines.append(line)
            line, gap = " " * (len(head) + 1), ""
        line += gap + piece
    return "\n".join([*lines, line])
