"""PVL as ISIS lays it out: equals signs of a block in one column, texts in quotes where they need them, lists wrapped.

Source: DOI-USGS/ISIS3, isis/src/base/objs/PvlFormat/PvlFormat.cpp (FormatValue, AddQuotes; 80 columns) and what ISIS
wrote with it, ControlNetVersioner/ControlNetVersioner.truth. Long texts are not wrapped: a wrapped one comes back with
its blanks changed. Quotes stand around more than ISIS puts them around: around all that a reader might take apart.
"""

import re

from mgsgraph.errors import InputError

_COLUMNS = 80
_PLAIN = re.compile(r"[\w.:/$+-]*[\w.:/$+]")
_LINE_BREAK = re.compile(r"[\r\n]")

Value = str | tuple[str, ...]
"""As it stands behind the equals sign; items of a list."""


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
