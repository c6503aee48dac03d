"""PVL text (Parameter Value Language) as ISIS and PDS3 write it, read in one pass, with errors that name file and line.

Understood: nested Object and Group, keywords in any case, quoted strings, lists in parentheses or braces, units in
angle brackets, values carried over lines (a trailing hyphen joins without a blank, as in ISIS PvlKeyword), comments
``/* */`` anywhere and ``#`` up to the end of the line. Language: CCSDS 641.0-B-2; dialect: ISIS Pvl, PvlKeyword.

Labels of images, PDS3 (attached or detached) or of ISIS cubes: found, recognized, and where they say data lie.

Written: equals signs of a block stand in one column, texts in quotes where they need them, lists are wrapped at 80
columns: DOI-USGS/ISIS3, isis/src/base/objs/PvlFormat/PvlFormat.cpp (FormatValue, AddQuotes), and
ControlNetVersioner.truth. Long texts are not wrapped: a wrapped one comes back with its blanks changed. All texts that
a reader might take apart are in quotes.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import finite_number, head_of
from mgsgraph.units import KM

LENGTHS = dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0) | dict.fromkeys(
    ("km", "kilometer", "kilometers", "kilometre", "kilometres"), KM
)
"""m, of the units of lengths, in lower case; without one it is m."""

_BEGIN = {"object": "object", "begin_object": "object", "group": "group", "begin_group": "group"}
_CLOSE = {"end_object": "object", "end_group": "group"}
_LARGEST_COUNT = 1e15
"""Exact as a float64; no file is as long."""
FLAGS = {"true": True, "t": True, "yes": True, "y": True, "on": True, "1": True,
          "false": False, "f": False, "no": False, "n": False, "off": False, "0": False}
"""Truth values, as in ISIS toBool."""

# nearly all lines are "keyword = word <unit>" or "End_...": one match takes them whole, the rest goes the long way
_PLAIN = re.compile(
    r"\s*+([A-Za-z_]\w*+)(?:[ \t]*+=[ \t]*+([^\s\"'(){}<>#,=]++)(?<!-)(?:[ \t]*+<([^<>\n]*+)>)?)?[ \t]*+(?:\n|\Z)"
)
_BLANK = re.compile(r"(?:\s+|/\*.*?\*/|#[^\n]*)*", re.DOTALL)
_KEYWORD = re.compile(r"([A-Za-z_^](?:[\w:^.-]|/(?!\*))*)\s*(=?)")
"""SPICE's, which cubes keep, are such as INS-41210_F/RATIO and CLOCK_ET_-131_922997380.174174_COMPUTED."""
_QUOTED = re.compile(r"\"([^\"]*)\"|'([^']*)'")
_CHARACTER = r"(?:(?!/\*)[^\s,(){}\"'<>=])"
_WORD = re.compile(rf"{_CHARACTER}+(?:(?<=-)\n\s*{_CHARACTER}+)*")
_UNIT = re.compile(r"\s*<([^<>]*)>")
_ENVELOPE = re.compile(r"\A\s*CCSD[^\n]*\n")
"""First line of an SFDU, in which PEDR labels lie; it is no PVL."""
_LINE_END = re.compile(r"[ \t]*(?:/\*.*?\*/[ \t]*)*(?:#[^\n]*)?(?:\n|\Z)", re.DOTALL)
_Value = TypeVar("_Value", str, tuple[str, ...])


class Entry(NamedTuple):
    """Value of a keyword."""

    value: str | tuple[str, ...]
    """A word or string, or the items of a list."""
    unit: str
    """In lower case; empty where none is given."""
    position: int
    """Of the keyword, in characters from the text's start."""


class Document(NamedTuple):
    """A text and the name of its file."""

    source: str
    text: str

    def where(self, position: int) -> str:
        """File and line (counted from 1) of a character."""
        return f"{self.source}, line {self.text.count(chr(10), 0, position) + 1}"

    def excerpt(self, position: int) -> str:
        """The rest of the line, shortened, in quotes."""
        rest = self.text[position : position + 60].split("\n", 1)[0].strip()
        return repr(rest) if rest else "nothing"


@dataclass(slots=True, eq=False)
class Block:
    """An Object or Group; its look-ups take keywords in any case and raise InputError with file and line."""

    document: Document
    kind: str
    """object or group."""
    name: str
    position: int
    """Of its first keyword, in characters from the text's start."""
    entries: dict[str, Entry] = field(default_factory=dict)
    """By keyword in lower case."""
    blocks: list["Block"] = field(default_factory=list)
    """Blocks inside it; empty for an outermost block."""
    label: str = ""
    """What the block describes, said in its messages once it is known."""

    def where(self, key: str = "") -> str:
        """File, line of the keyword (or of the block) and label."""
        entry = self.entries.get(key.lower())
        place = self.document.where(entry.position if entry else self.position)
        return ", ".join(part for part in (place, self.label, key) if part)

    def __contains__(self, key: str) -> bool:
        entry = self.entries.get(key.lower())
        return entry is not None and not (isinstance(entry.value, str) and entry.value.lower() == "null")

    def text(self, key: str) -> str:
        """A word or string that is not empty, or the only item of a list; ISIS's Null counts as missing."""
        items = self.words(key)
        if len(items) != 1 or not items[0]:
            found = "a list" if len(items) > 1 else "an empty text"
            raise InputError(self.where(key), found, "one word or string")
        return items[0]

    def words(self, key: str) -> tuple[str, ...]:
        """The items of a list; one of a word or string."""
        if key not in self:
            raise InputError(self.where(), f"no {key}", f"{key} = ... in this {self.name}")
        value = self.entries[key.lower()].value
        return (value,) if isinstance(value, str) else value

    def number(self, key: str, units: Mapping[str, float] | None = None) -> float:
        """A finite number times the factor of its unit, which must be one of `units` ("" for none), or any without."""
        entry = self.entries.get(key.lower())
        if entry is not None and units is not None and entry.unit in units and isinstance(entry.value, str):
            try:
                return finite_number(entry.value) * units[entry.unit]
            except ValueError:
                pass  # said below
        value = self._finite(key, self.text(key))
        unit = self.entries[key.lower()].unit
        if units is None:
            return value
        if unit not in units:
            raise InputError(self.where(key), f"the unit <{unit}>", f"one of {', '.join(filter(None, units))}, or none")
        return value * units[unit]

    def numbers(self, key: str, count: int) -> list[float]:
        """A list of `count` finite numbers."""
        if key not in self:
            raise InputError(self.where(), f"no {key}", f"{key} = ... in this {self.name}")
        values = self.entries[key.lower()].value
        if isinstance(values, str) or len(values) != count:
            found = "one word" if isinstance(values, str) else f"{len(values)} items"
            raise InputError(self.where(key), found, f"a list of {count} numbers")
        return [self._finite(key, value) for value in values]

    def count(self, key: str) -> int:
        """A whole number of at least 1."""
        value = self.number(key)
        if not 1.0 <= value < _LARGEST_COUNT or value % 1.0 != 0.0:
            raise InputError(self.where(key), f"{value:g}", "a whole number above zero")
        return int(value)

    def inner(self, name: str) -> "Block":
        """The block of this name (in any case) inside."""
        for block in self.blocks:
            if block.name == name.lower():
                return block
        raise InputError(self.where(), f"no {name}", f"Object = {name} or Group = {name} in this {self.name}")

    def flag(self, key: str) -> bool:
        """A truth value; False where it is left out, which is how ISIS writes it."""
        if key not in self:
            return False
        value = self.text(key).lower()
        if value not in FLAGS:
            raise InputError(self.where(key), repr(value), "True or False")
        return FLAGS[value]

    def _finite(self, key: str, value: str) -> float:
        try:
            return finite_number(value)
        except ValueError:
            raise InputError(self.where(key), f"{value[:60]!r}", "a finite number") from None


def inner_blocks(document: Document) -> Iterator[tuple[Block, Block]]:
    """Blocks directly inside an outermost one, each with that one, as soon as they are read.

    The outermost block never holds them, so a large file is never in memory as a tree; it holds the keywords that
    stood before.

    Raises
    ------
    InputError
        Where the text is no PVL, a keyword stands twice in a block, or blocks are not closed, at the latest when the
        text is exhausted.
    """
    root = Block(document, "label", "label", 0)
    for around, closed in _closed_blocks(root, 1):
        if len(around) == 2:
            yield around[1], closed


def whole_label(document: Document) -> Block:
    """All keywords and blocks of a label, up to its END, in one outermost block called label.

    Raises
    ------
    InputError
        Where the text is no PVL, a keyword stands twice in a block, or blocks are not closed.
    """
    root = Block(document, "label", "label", 0)
    for _ in _closed_blocks(root, None):
        pass
    return root


def _closed_blocks(root: Block, left_out: int | None) -> Iterator[tuple[list[Block], Block]]:
    """Every block, once it is closed, with those around it, the outermost first; blocks at a depth that is left out are
    not kept in the one around them.
    """
    stack, document = [root], root.document
    for keyword, entry in _statements(document):
        if keyword in _BEGIN:
            block = Block(document, _BEGIN[keyword], str(entry.value).lower(), entry.position)
            if len(stack) - 1 != left_out:
                stack[-1].blocks.append(block)
            stack.append(block)
        elif keyword in _CLOSE:
            closed = _closed(document, stack, _CLOSE[keyword], entry)
            yield stack, closed
        elif keyword == "end":
            break
        elif keyword in stack[-1].entries:
            raise InputError(document.where(entry.position), f"{keyword} twice in one {stack[-1].kind}", "it once")
        else:
            stack[-1].entries[keyword] = entry
    if len(stack) > 1:
        raise InputError(
            document.where(stack[-1].position), f"the {stack[-1].kind} that begins here is never closed",
            f"End_{stack[-1].kind.capitalize()}", "the file is cut short: write it again",
        )  # fmt: skip


def flat_label(text: str, source: str) -> Block:
    """Keywords of a PDS3 label up to its END in one block, whichever object they stand in; of several that of the
    outermost and first object counts.
    """
    plain = _ENVELOPE.sub("\n", text.replace("\r\n", "\n"), count=1)
    root = whole_label(Document(source, plain))
    flat, blocks = Block(root.document, "label", "label", 0), [root]
    for block in blocks:
        flat.entries = block.entries | flat.entries
        blocks += block.blocks
    return flat


def _closed(document: Document, stack: list[Block], kind: str, entry: Entry) -> Block:
    """Take the innermost block off the stack; it has to be the one that the entry closes."""
    block = stack.pop() if len(stack) > 1 else None
    if block is None or block.kind != kind or entry.value not in ("", block.name):
        expected = f"the end of {block.kind} {block.name}" if block else "no block to close"
        raise InputError(document.where(entry.position), f"the end of {kind} {entry.value}".rstrip(), expected)
    return block


def _statements(document: Document) -> Iterator[tuple[str, Entry]]:
    """Keywords in lower case with their values, in the text's order."""
    text, position = document.text, 0
    while True:
        plain = _PLAIN.match(text, position)
        if plain:
            keyword, value, unit = plain.groups("")
            keyword = keyword.lower()
            if keyword in _CLOSE:
                value = value.lower()
            if (value or keyword in _CLOSE) and "/*" not in value:
                yield keyword, Entry(value, unit.lower(), plain.start(1))
                position = plain.end()
                continue
        position = _skipped(text, position)
        if position == len(text):
            return
        if plain is None and _PLAIN.match(text, position):
            continue  # past a comment the short way may do again
        keyword, entry, position = _statement(document, position)
        yield keyword, entry


def _statement(document: Document, position: int) -> tuple[str, Entry, int]:
    """Keyword in lower case, its value, and where the next statement may begin."""
    match = _KEYWORD.match(document.text, position)
    keyword = match[1].lower() if match else ""
    closes = keyword in _CLOSE or keyword == "end"
    if not match or not (match[2] or closes):
        open_comment = document.text.startswith("/*", position)
        found = "a comment that is never closed" if open_comment else document.excerpt(position)
        raise InputError(document.where(position), found, "PVL text: keyword = value")
    if keyword == "end":
        return keyword, Entry("", "", position), match.end()
    if not match[2]:
        value: str | tuple[str, ...] = ""
        unit, end = "", match.end(1)
    else:
        value, unit, end = _value(document, match.end())
    rest = _LINE_END.match(document.text, end)
    if not rest:
        raise InputError(
            document.where(position), f"{document.excerpt(end)} after the value of {match[1]}",
            "one value, in quotes if it has blanks, or a list in parentheses",
        )
    if closes or keyword in _BEGIN:
        value = str(value).lower()
    return keyword, Entry(value, unit, position), rest.end()


def _value(document: Document, position: int) -> tuple[str | tuple[str, ...], str, int]:
    """A word, string or list (of all items that its inner sequences have), its unit in lower case, where it ends."""
    text, start = document.text, _skipped(document.text, position)
    if not text.startswith(("(", "{"), start):
        return _item(document, start)
    items, unit, position, depth, ended = list[str](), "", start, 0, False
    while True:
        if not ended and text.startswith(("(", "{"), position):
            position, depth = position + 1, depth + 1
        elif text.startswith((")", "}"), position):
            if depth == 1:
                return _with_unit(text, tuple(items), unit, position + 1)
            position, depth, ended = _with_unit(text, "", "", position + 1)[2], depth - 1, True
        elif ended:
            if not text.startswith(",", position):
                raise InputError(document.where(start), f"a list broken by {document.excerpt(position)}", "',' or ')'")
            position, ended = position + 1, False
        else:
            item, item_unit, position = _item(document, position)
            items.append(item)
            unit, ended = unit or item_unit, True
        position = _skipped(text, position)


def _item(document: Document, position: int) -> tuple[str, str, int]:
    """A word or string, its unit in lower case, and where it ends."""
    quoted = _QUOTED.match(document.text, position)
    if quoted:
        joined = re.sub(r"-\n\s*", "", quoted[1] if quoted[1] is not None else quoted[2])
        return _with_unit(document.text, re.sub(r"\s*\n\s*", " ", joined), "", quoted.end())
    word = _WORD.match(document.text, position)
    if not word:
        broken = document.text.startswith(('"', "'"), position)
        found = "a quote that is never closed" if broken else document.excerpt(position)
        raise InputError(document.where(position), found, "a value")
    return _with_unit(document.text, re.sub(r"-\n\s*", "", word[0]), "", word.end())


def _with_unit(text: str, value: _Value, unit: str, position: int) -> tuple[_Value, str, int]:
    """The value with the unit that follows it, if one does."""
    match = _UNIT.match(text, position)
    return (value, match[1].strip().lower(), match.end()) if match else (value, unit, position)


def _skipped(text: str, position: int) -> int:
    """The position behind blanks and comments."""
    blank = _BLANK.match(text, position)
    return blank.end() if blank else position


_HEAD = 1 << 20
"""bytes; no label of a planetary image comes near."""
_DIGITS = 15
"""Of the longest place in a file."""
_LABEL_BEGIN = re.compile(
    rb"(?:\s*(?:CCSD|#)[^\r\n]*[\r\n])*\s*(PDS_VERSION_ID|Object\s*=\s*IsisCube\b)", re.IGNORECASE
)
"""Behind the label of a standard formatted data unit (CCSD...) and comments."""


def read_label(path: Path) -> Block:
    """The label of an image, as one block: at its head, or beside it with the ending ``.lbl``.

    Raises
    ------
    InputError
        Missing or unreadable file, no label, or a label that is no PVL.
    """
    text = _head(path)
    if text is None:
        beside = [path.with_suffix(suffix) for suffix in (".lbl", ".LBL") if path.with_suffix(suffix).is_file()]
        text = _head(beside[0]) if beside else None
        path = beside[0] if beside else path
    if text is None:
        raise InputError(
            str(path), "no label", "PDS_VERSION_ID = PDS3 or Object = IsisCube at its head, or a .lbl beside it"
        )
    return whole_label(Document(str(path), text))


def _head(path: Path) -> str | None:
    """The text at the head of a file; None where there is none."""
    return label_text(head_of(path, _HEAD))


def label_text(head: bytes) -> str | None:
    """The label of an image at the head of a file, from its first key on; None where there is none."""
    begin = _LABEL_BEGIN.match(head)
    # pixels that follow are never parsed: PVL ends at its END; a cube fills up with NUL
    return head[begin.start(1) :].split(b"\0", 1)[0].decode("latin-1").replace("\r\n", "\n") if begin else None


def cube_of(root: Block) -> Block | None:
    """The cube that an ISIS label describes, which is in camera geometry; None for a PDS3 label."""
    if "PDS_VERSION_ID" in root:
        return None
    cube = root.inner("IsisCube")
    for block in cube.blocks:
        if block.name == "mapping":
            raise InputError(block.where(), "a map-projected cube", "an image in camera geometry (before cam2map)")
    return cube


def cube_size(cube: Block) -> tuple[int, int]:
    """Lines and samples of a whole cube: a cropped or reduced one no longer begins when its label says."""
    core = cube.inner("Core").inner("Dimensions")
    size = core.count("Lines"), core.count("Samples")
    for block in cube.blocks:
        if block.name == "alphacube" and (block.count("AlphaLines"), block.count("AlphaSamples")) != size:
            whole = f"{block.count('AlphaLines')} x {block.count('AlphaSamples')}"
            raise InputError(block.where(), f"{size[0]} x {size[1]} pixels cut out of {whole}", "the whole image")
    return size


def instrument_of(path: Path) -> str:
    """Name of the instrument in an image's label, in capitals: MOC-NA, MOC-WA, HRSC."""
    root = read_label(path)
    if "PDS_VERSION_ID" in root:
        return root.text("INSTRUMENT_ID").upper()
    return root.inner("IsisCube").inner("Instrument").text("InstrumentId").upper()


def data_location(path: Path, root: Block) -> tuple[Path, int]:
    """File and offset in bytes of ``^IMAGE``: a record or <BYTES>, in this file or in the one it names."""
    record = root.count("RECORD_BYTES")
    require("^IMAGE" in root, root.where(), "no ^IMAGE", "^IMAGE = record, or (file, record)")
    entry = root.entries["^image"]
    items = [entry.value] if isinstance(entry.value, str) else list(entry.value)
    place = items.pop() if items and items[-1].isdecimal() else "1"
    if len(items) > 1 or len(place) > _DIGITS or int(place) < 1:
        raise InputError(root.where("^IMAGE"), f"{entry.value}", "a record, a file, or (file, record)")
    offset = int(place) - 1 if entry.unit == "bytes" else (int(place) - 1) * record
    return (_beside(path, items[0], root) if items else path), offset


def _beside(path: Path, name: str, root: Block) -> Path:
    """The file of this name, in any case, in the label's folder."""
    if files := files_called(path, name):
        return files[0]
    raise InputError(root.where("^IMAGE"), f"the file {name}, which is not there", "it in the label's folder")


def files_called(path: Path, name: str) -> list[Path]:
    """Those of this name, in any case, in a file's folder; the one in just this case is the first."""
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    matches = [file for file in beside if file.name.lower() == name.lower()]
    return sorted(matches, key=lambda file: file.name != name)


def bytes_around(image: Block) -> tuple[int, int]:
    """Bytes before and after each line's pixels, none where the label has neither."""
    keys = ("LINE_PREFIX_BYTES", "LINE_SUFFIX_BYTES")
    prefix, suffix = (int(image.number(key, {"": 1.0})) if key in image else 0 for key in keys)
    if min(prefix, suffix) < 0:
        raise InputError(image.where(), f"{min(prefix, suffix)} bytes before or after a line", "none, or some")
    return prefix, suffix


# --- writing

_COLUMNS = 80
_UNQUOTED = re.compile(r"[\w.:/$+-]*[\w.:/$+]")
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
    if _UNQUOTED.fullmatch(text):
        return text
    if not text:
        return "Null"
    quote = "'" if '"' in text else '"'
    fault = "a line break" if _LINE_BREAK.search(text) else "both kinds of quotes" if quote in text else ""
    if any("\ud800" <= character <= "\udfff" for character in text):
        fault = "half a character"
    if fault:
        raise InputError(where, f"{fault} in {text[:60]!r}", "what PVL can hold", "change it, or write another format")
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
