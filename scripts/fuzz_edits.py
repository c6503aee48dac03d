"""Strategies of damage: files of every form edited from a sound one, so that Hypothesis draws and shrinks the damage.

What is not damaged stays whole, packing and checksums of archives included, so that the damage gets far.
"""

import gzip
import io
import json
import re
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import lru_cache
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

NUMBERS = (
    b"0", b"1", b"-1", b"", b"NaN", b"inf", b"-inf", b"Infinity", b"1e308", b"1e400", b"5e-324", b"-0.0", b"1e3",
    b"9" * 400, b"7" * 5000, b"0x10", b"1_000", "١٢".encode(), b"1,5", b"true", b"null", b"[]", b"{}", b"2147483648",
    b"-2147483649", b"9223372036854775808", b"1e19", b"99999999999", b"1d5", b"1e", b"++1", b"1 km", b'"1"',
)  # fmt: skip
"""Texts that replace a number."""
NAMES = (
    b"", b"..", b"../../../../etc/passwd", b"/dev/zero", b"/", b"a" * 300, b"a\0b", b"\xff\xfe", b"\x1b[31m",
    "\u202e".encode(), b"\xed\xa0\x80", b"<script>", b"None", b"%s%n", b"/vsizip/x.zip/y", b"Moon", b"' OR 1=1", b"\\",
    b"\n", b"#", b"a=b", b"2#1111#", b'"', b"{", b"(", b"=", b"NULL", b"\0", b"\x85", "\u2028".encode(), b"\r",
)  # fmt: skip
"""Texts that replace a name."""
LONG = tuple(
    piece * times
    for times in (101, 1200, 20_000)
    for piece in (b"[", b"{", b"(", b'{"a":', b"Object = a\n", b"Group = a\n", b"-", b'"', b"a.", b"a,", b"1 ", b" ")
)
"""Deep nesting and long lines."""
ODD: tuple[float, ...] = (
    0, 1, -1, 2, 255, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, float("nan"), float("inf"), float("-inf"),
    1e308, -1.7976931348623157e308, 5e-324, 1e19, 3e38,
)  # fmt: skip
TIMES = (1e3, 1e-3, -1.0, 1.001, 57.29577951308232, 1e6)
VALUES: tuple[Any, ...] = (
    None, True, "", "text", "NaN", [], {}, [[]], 0, -1, 1e308, 1e-320, 10**400, 2**63, 0.5, "\x1b[2J", "a" * 3000,
    [1, 2, 3], {"a": 1}, "../../x",
)  # fmt: skip
_TOKEN = re.compile(rb'"[^"\n]{0,200}"|[-+]?\d[\d.]*(?:[eE][-+]?\d+)?|[A-Za-z_^][\w.:/^-]*|[^\s\w]')
_VALUE = re.compile(rb"(?<==)[ \t]*([^\r\n]+)")
_UNITS = (b" <km>", b" <m>", b" <ms>", b" <seconds>", b" <degrees>", b" <>", b" <")
_ENCODINGS = ("utf-16", "utf-8-sig", "utf-32", "utf-7", "cp037")
_CODES = ("B", "<H", ">H", "<i", ">i", "<q", "<f", ">f", "<d", ">d")
_REACH = 4096
"""bytes at both ends of a file, which hold its structure: they are edited as often as all others."""
Change = Callable[[bytes], SearchStrategy[bytes]]


def place(size: int) -> SearchStrategy[int]:
    """A place in a file of some bytes."""
    parts = (0, min(size, _REACH)), (0, size), (max(size - _REACH, 0), size)
    return st.one_of(*(st.integers(begin, max(end - 1, begin)) for begin, end in parts))


@st.composite
def bit(draw: DrawFn, data: bytes) -> bytes:
    """A flipped bit, as by a disk error."""
    at, position = draw(place(len(data))), draw(st.integers(0, 7))
    return data[:at] + bytes(byte ^ 1 << position for byte in data[at : at + 1]) + data[at + 1 :]


@st.composite
def stretch(draw: DrawFn, data: bytes) -> bytes:
    """Bytes removed, inserted, repeated, blanked; the file cut short or made longer."""
    at, size = draw(place(len(data))), draw(st.sampled_from((0, 1, 2, 4, 8, 40, 512, len(data))))
    piece = data[at : at + min(size, 1000)]
    fixed = b"", piece * 2, piece * 100, *(filler * len(piece) for filler in (b"\0", b"\xff", b" "))
    new = draw(st.sampled_from(fixed) | st.binary(max_size=16))
    return data[:at] + new + data[at + size :]


@st.composite
def field(draw: DrawFn, data: bytes) -> bytes:
    """A number in binary: odd, or in another unit."""
    code = draw(st.sampled_from(_CODES))
    size, at = struct.calcsize(code), draw(place(len(data)))
    at = max(min(at - at % min(size, 4), len(data) - size), 0)
    if len(data) < size:
        return draw(stretch(data))
    old = struct.unpack_from(code, data, at)[0]
    value = draw(st.sampled_from(ODD) | st.sampled_from(TIMES).map(lambda times: old * times))
    try:
        new = struct.pack(code, value if code[-1] in "fd" else int(value))
    except (struct.error, OverflowError, ValueError):
        new = b"\xff" * size
    return data[:at] + new + data[at + size :]


@lru_cache(maxsize=8)
def _spans(data: bytes, pattern: re.Pattern[bytes], group: int = 0) -> list[tuple[int, int]]:
    return [match.span(group) for match in pattern.finditer(data)]


def _scaled(token: bytes, times: float) -> bytes:
    try:
        return repr(float(token) * times).encode()
    except ValueError:
        return token.swapcase()


@st.composite
def token(draw: DrawFn, data: bytes) -> bytes:
    """A number or name of a text replaced, left out, repeated, in another unit, nested deeply or made long."""
    if not (spans := _spans(data, _TOKEN)):
        return draw(stretch(data))
    (start, stop), (begin, end) = draw(st.sampled_from(spans)), draw(st.sampled_from(spans))
    old = data[start:stop]
    new = draw(st.one_of(
        st.sampled_from(NUMBERS), st.sampled_from(NAMES), st.sampled_from(TIMES).map(lambda times: _scaled(old, times)),
        st.sampled_from((data[begin:end], old + old)), st.sampled_from(LONG),
        st.sampled_from(NAMES).map(lambda name: old[:1] + name + old[1:]),
    ))  # fmt: skip
    return data[:start] + new + data[stop:]


@st.composite
def value(draw: DrawFn, data: bytes) -> bytes:
    """The value of a key of PVL, TOML or a text kernel: another's, a list, in other quotation marks or units."""
    if not (spans := _spans(data, _VALUE, 1)):
        return draw(token(data))
    (start, stop), (begin, end) = draw(st.sampled_from(spans)), draw(st.sampled_from(spans))
    old = data[start:stop]
    new = draw(st.sampled_from((
        data[begin:end], b"(" + old + b", " + old + b")", b'"' + old + b'"', old.strip(b'"'),
        *(old + unit for unit in _UNITS),
    )))  # fmt: skip
    return data[:start] + new + data[stop:]


@st.composite
def line(draw: DrawFn, data: bytes) -> bytes:
    """A line left out, repeated or elsewhere."""
    lines = data.split(b"\n")
    k, to = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
    moved = lines.pop(k)
    lines[to:to] = [moved] * draw(st.sampled_from((0, 1, 2, 300)))
    return b"\n".join(lines)


@st.composite
def whole(draw: DrawFn, data: bytes) -> bytes:
    """Other ends of lines, another delimiter or another encoding."""
    ends = *((b"\n", mark) for mark in (b"\r\n", b"\r", b"", b"\n\n")), *((b",", mark) for mark in (b";", b"\t", b",,"))
    texts = [data.replace(*pair) for pair in ends]
    return draw(st.sampled_from([*texts, *(data.decode("latin-1").encode(name, "replace") for name in _ENCODINGS)]))


def _places(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, item in pairs:
        yield (*path, key)
        yield from _places(item, (*path, key))


@st.composite
def json_value(draw: DrawFn, data: bytes) -> bytes:
    """A value, key or element of JSON, which stays JSON."""
    head = max(data.find(b"{"), 0)
    try:
        content = json.loads(data[head:])
    except (ValueError, RecursionError):
        return draw(token(data))
    if not (places := list(_places(content))):
        return draw(token(data))
    *path, last = draw(st.sampled_from(places))
    inner = content
    for key in path:
        inner = inner[key]
    old = inner[last]
    replacements = [old[:-1], old + old] if isinstance(old, list) else []
    replacements += [old * times for times in TIMES] if isinstance(old, float) else []
    if draw(st.booleans()):
        inner[last] = draw(st.sampled_from((*replacements, *VALUES)))
    else:
        del inner[last]
    return data[:head] + json.dumps(content, indent=1).encode()


@st.composite
def member(draw: DrawFn, data: bytes) -> bytes:
    """A member of a NumPy archive: its numbers, shape and type, or its name; the archive stays valid."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, ValueError, zlib.error, NotImplementedError, OSError, EOFError):
        return draw(stretch(data))
    name = draw(st.sampled_from(sorted(members) or ["x"]))
    old = members.pop(name, b"")
    head = token(old[:128]).map(lambda text: text[:128].ljust(128) + old[128:])  # of an array: its shape and type
    new = draw(st.none() | field(old) | stretch(old) | head)
    if new is not None:
        members[draw(st.sampled_from((name, name, name, "../x.npy", "record.npy", "a" * 300)))] = new
    with io.BytesIO() as file:
        with zipfile.ZipFile(file, "w") as archive:
            for key, content in members.items():
                archive.writestr(zipfile.ZipInfo(key), content)
        return file.getvalue()


@st.composite
def cell(draw: DrawFn, data: bytes) -> bytes:
    """A cell or row of a valid database; mostly without its checksum, as a killed writer leaves it."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        try:
            base.deserialize(data)
            names = base.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite%'")
            tables = [(name, base.execute(f'SELECT rowid, * FROM "{name}"').fetchall()) for (name,) in names.fetchall()]
            table, rows = draw(st.sampled_from([entry for entry in tables if entry[1]] or [("", [])]))
            if not rows:
                return draw(stretch(data))
            columns = [info[1] for info in base.execute(f'PRAGMA table_info("{table}")')]
            row, column = draw(st.sampled_from(rows)), draw(st.integers(0, len(columns) - 1))
            odd = st.sampled_from((None, "", "text", b"", b"\0" * 8, -1, 0, 2**62, 1e308, "[1]", "{}", "[" * 1200))
            old = row[column + 1]
            if isinstance(old, bytes) and old:
                odd = odd | field(old) | stretch(old) | bit(old)
            elif isinstance(old, str) and old:
                text = json_value(old.encode()) | token(old.encode())
                odd = odd | text.map(lambda content: content.decode(errors="replace"))
            elif isinstance(old, float):
                odd = odd | st.sampled_from(TIMES).map(lambda times: old * times)
            base.execute(f'UPDATE "{table}" SET "{columns[column]}" = ? WHERE rowid = ?', (draw(odd), row[0]))
            if draw(st.booleans()):
                base.execute("PRAGMA user_version = 0")
            return base.serialize()
        except (sqlite3.Error, OverflowError):
            return draw(stretch(data))


@lru_cache
def bomb() -> bytes:
    """3 GB of blanks in 3 MB."""
    return gzip.compress(b" " * (64 << 20), 1, mtime=0) * 48


def packed(data: bytes) -> SearchStrategy[bytes]:
    """Content of a gzip file, damaged and packed again; or a bomb."""
    try:
        content = gzip.decompress(data) if len(data) < 1_000_000 else b""
    except (OSError, EOFError, zlib.error):
        return stretch(data)
    inside = st.one_of(*(change(content) for change in (token, line, whole)))
    return inside.map(lambda text: gzip.compress(text, 1, mtime=0)) | st.builds(bomb)


PATHS = (
    "missing", "folder", "pipe", "zero", "full", "loop", "", ".", "..", "a\nb", "\x1b[2Jname", "\udcff\udcfe.toml",
    "n" * 300, "folder/deep/er", "empty", "broken.isd", "broken.toml", "~", "case.toml/x", "image_A.isd",
    "network.pvl", "lidar.json", "case.toml", "result", "project", "/proc/self/mem", "zero/x", "dangling",
)  # fmt: skip
WORDS = (
    "nan", "inf", "1e308", "-1", "0", "1e-320", "9" * 400, "0x10", "1_000", "1,5", "text", "\x1b[31m", "\u202e",
    "a" * 5000, "--out", "-", "--", "-1e9", "true", "SIM/A", "A,B", "local:99999999", "tcp://:1", "[", "*", "\n",
)  # fmt: skip


@st.composite
def words(draw: DrawFn, data: bytes) -> bytes:
    """A command line, as JSON: a word replaced, removed, repeated or longer, or one more option of the verb."""
    from mgsgraph.cli import group

    line: list[str] = json.loads(data)
    command = group.get_command(None, line[0])  # type: ignore[arg-type]
    assert command is not None
    parameters = [parameter for parameter in command.params if parameter.opts[0].startswith("-")]
    options = [(max(parameter.opts, key=len), getattr(parameter, "is_flag", False)) for parameter in parameters]
    odd, k = draw(st.sampled_from((*PATHS, *WORDS))), draw(st.integers(1, len(line)))
    name, flag = draw(st.sampled_from([*options, (odd, True)]))
    option = [name] if flag else [name, odd]
    old = line[k : k + 1]
    longer = [word + more for word in old for more in ("\x1b[1m", "\udcff", "/", "=", " ", "x" * 2000)][:6]
    line[k : k + 1] = draw(st.sampled_from(([odd], [], old * 2, [*old, *option], *([word] for word in longer))))
    return json.dumps(line).encode()


FORMS: dict[str, tuple[Change, ...]] = {
    "bytes": (stretch, bit, field), "text": (token, line, whole, stretch, bit), "csv": (token, line, whole, stretch),
    "pvl": (value, token, line, whole, stretch, bit), "labelled": (value, token, field, field, stretch, bit),
    "json": (json_value, json_value, token, line, whole, stretch), "npz": (member, member, stretch, bit),
    "sqlite": (cell, cell, stretch, bit), "gzip": (packed, packed, stretch), "words": (words,), "bit": (bit,),
}  # fmt: skip
"""Edits of files of a form."""


def edited(sound: bytes, form: str) -> SearchStrategy[bytes]:
    """The file with one edit, or two; single bits only once."""

    def once(data: bytes) -> SearchStrategy[bytes]:
        return st.one_of(*(change(data) for change in FORMS[form]))

    return once(sound) if form == "bit" else once(sound) | once(sound).flatmap(once)
