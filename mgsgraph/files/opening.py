"""Opens every file from outside: a regular file of a limited size, with errors that name it.

What a damaged file makes its parser raise becomes an InputError in one place, `understood`.
"""

import csv
import json
import math
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import file_digest
from io import BufferedReader
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import LONGEST_NAME

LARGEST = 1 << 32
"""bytes of a file that is read whole."""
ANY_SIZE = 1 << 63
"""The same of a file of which a part is read: no limit."""
LARGEST_TEXT = 1 << 30
"""bytes of one that is read as text, which takes several times as much memory."""
DEEPEST = 100
"""Levels of brackets in JSON and TOML; support data has four."""
_NUMBER = re.compile(r"[+-]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?", re.ASCII)
LARGEST_NUMBER = 1e300
"""ISIS writes its Null as -1.797e308 where a number was never set: larger ones are no numbers."""
_LARGEST_COUNT = 1 << 63
"""Whole numbers beyond are no counts, ticks or ids."""
_NO_FILES = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)  # fmt: skip
_MOST_PACKED, _LEAST_LIMIT = 100, 1 << 25
"""By how much a table may be packed (those of the archives are to a fourth), and bytes that it may always have."""
_PIECE = 1 << 16
"""bytes read at a time."""
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Not to wait for whoever writes into a pipe."""
_DAMAGE = (
    ValueError, LookupError, TypeError, ArithmeticError, AttributeError, EOFError, RuntimeError, struct.error,
    zlib.error, zipfile.BadZipFile, tokenize.TokenError, csv.Error,
)  # fmt: skip
"""What parsers raise on content that isn't theirs: UnicodeError and RecursionError are among them; NumPy's, on the head
of an array, those of Python's own source. MemoryError is none of them: sizes are looked at before."""

# --- opening and reading


@contextmanager
def _system_errors(path: Path) -> Iterator[None]:
    """Errors of the operating system as InputErrors that name the file."""
    try:
        yield
    except FileNotFoundError:
        remedy = "check the path; those in a case file begin at its folder"
        raise InputError(str(path), "no such file", remedy=remedy) from None
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror or error})") from None


@contextmanager
def opened(path: Path, limit: int = LARGEST) -> Iterator[BufferedReader]:
    """A file from outside, opened to read its bytes; no other function opens one.

    Parameters
    ----------
    path : Path
    limit : int
        bytes that it may have.

    Raises
    ------
    InputError
        No such file, a folder, a pipe, a device or a socket, one that can't be read, or one longer than `limit`: all
        before anything is read; also what the operating system says inside the block.
    """
    with _system_errors(path), os.fdopen(_regular(path, limit), "rb") as file:
        yield file


def _regular(path: Path, limit: int) -> int:
    """Descriptor of a file that may be read."""
    try:
        descriptor = os.open(path, _FLAGS)
    except ValueError:  # a zero or a lone surrogate, out of JSON
        raise InputError(str(path), "no name of a file", "a path") from None
    status = os.fstat(descriptor)
    kind = next((word for is_kind, word in _NO_FILES if is_kind(status.st_mode)), "")
    if not kind and status.st_size <= limit:
        return descriptor
    os.close(descriptor)
    require(not kind, str(path), kind, "a file")
    raise InputError(str(path), f"{status.st_size / 1e6:.0f} MB", f"at most {limit / 1e6:.0f} MB of such a file")


def read_bytes(path: Path, limit: int = LARGEST) -> bytes:
    """The whole of a file; InputError as `opened` has them."""
    with opened(path, limit) as file:
        content = file.read(os.fstat(file.fileno()).st_size + 1)
        while len(content) <= limit and (more := file.read(_PIECE)):  # those of /proc don't say how long they are
            content += more
    require(len(content) <= limit, str(path), "a file without an end", f"at most {limit / 1e6:.0f} MB")
    return content


def head_of(path: Path, count: int) -> bytes:
    """The first bytes of a file of any size, as many as there are up to `count`; InputError as `opened` has them."""
    with opened(path, ANY_SIZE) as file:
        return file.read(count)


def read_text(
    path: Path, expected: str = "a text file", limit: int = LARGEST_TEXT, encoding: str = "utf-8-sig"
) -> str:
    """The whole of a text file, lines ended by line feeds; InputError as `opened` has them, or where it is not text."""
    return decoded_text(read_bytes(path, limit), path, expected, encoding)


def decoded_text(content: bytes, path: Path, expected: str = "a text file", encoding: str = "utf-8-sig") -> str:
    """The content of a text file as `read_text` gives it; InputError where it is not text."""
    try:
        return content.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", expected) from None


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits; InputError where it can't be read."""
    with opened(path, ANY_SIZE) as file:
        return file_digest(file, "sha256").hexdigest()


# --- understanding


@contextmanager
def understood(where: str, what: str, remedy: str = "") -> Iterator[None]:
    """Around a parser or decoder: what damaged content makes it raise becomes an InputError; InputErrors pass.

    What was raised is its cause, for whoever looks for a fault of ours.

    Parameters
    ----------
    where : str
        File, and place in it.
    what : str
        What should be there: "a NumPy archive".
    remedy : str
        What the user can do.
    """
    try:
        yield
    except InputError:
        raise
    except _DAMAGE as error:
        reason = " ".join(str(error).split())[:100]
        found = f"is not {what}, or a damaged one ({reason or type(error).__name__})"
        raise InputError(where, found, remedy=remedy) from error


def unpacked_gzip(content: bytes, where: str, limit: int = LARGEST_TEXT) -> bytes:
    """What gzip has packed, of all members one after the other; InputError where it is damaged, cut short, or longer
    than `limit` bytes or than any table is that packs into so few.
    """
    pieces, size = list[bytes](), 0
    limit = min(limit, max(_LEAST_LIMIT, _MOST_PACKED * len(content)))
    with understood(where, "a gzip file", "fetch it again"):
        while content:
            member = zlib.decompressobj(wbits=31)
            pieces.append(member.decompress(content, limit + 1 - size))
            size += len(pieces[-1])
            if size > limit:
                raise InputError(where, "unpacks without an end", f"at most {limit / 1e6:.0f} MB", "unpack it yourself")
            if not member.eof:
                raise EOFError("it is cut short")
            content = member.unused_data.lstrip(b"\0")  # what tapes and disks pad with
    return b"".join(pieces)


def read_json(path: Path, heading: str = "", limit: int = LARGEST_TEXT) -> dict[str, Any]:
    """A JSON object in a file, before which a heading may stand; InputError as `opened` and `json_object` have them."""
    return json_object(read_text(path, limit=limit).removeprefix(heading), str(path))


def json_object(text: str | bytes, where: str) -> dict[str, Any]:
    """A JSON object; InputError, with line and column, when it is malformed, truncated, nested too deeply, or holds a
    key twice or a number that is not finite or too large.
    """
    if isinstance(text, bytes):
        with understood(where, "UTF-8 text"):
            text = text.decode()

    def refuse(constant: str) -> float:
        raise InputError(where, f"the value {constant}", "finite numbers")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(where, f"the key {twice!r} twice", "each key once")
        return table

    try:
        value = json.loads(text, parse_constant=refuse, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        place = f"{where}, line {error.lineno}, column {error.colno}"
        raise InputError(place, f"malformed or truncated JSON ({error.msg})", remedy="write the file again") from None
    except RecursionError:
        raise _too_deep(where) from None
    except InputError:
        raise
    except ValueError:  # Python's limit of digits
        raise InputError(where, "a whole number of thousands of digits", "numbers") from None
    if not isinstance(value, dict):
        raise InputError(where, f"a JSON {type(value).__name__}", "a JSON object")
    require_bearable(value, where)
    return value


def require_bearable(value: object, where: str, infinite: bool = False) -> None:
    """Raise InputError where tables and lists are nested too deeply, or hold numbers that can't be any; whether
    `infinite` ones may be there.
    """
    level = [value]
    for _ in range(DEEPEST):
        inner = list[object]()
        for outer in level:
            for item in outer.values() if isinstance(outer, dict) else outer if isinstance(outer, list) else ():
                kind = type(item)
                if kind is dict or kind is list:
                    inner.append(item)
                elif kind is float and not infinite and not math.isfinite(item):  # 1e999 is infinite to JSON
                    raise InputError(where, f"the number {item}", "finite numbers")
                elif kind is int and not -_LARGEST_COUNT <= item < _LARGEST_COUNT:
                    raise InputError(where, f"a whole number of {item.bit_length()} bits", "64 bits at most")
        if not inner:
            return
        level = inner
    raise _too_deep(where)


def _too_deep(where: str) -> InputError:
    return InputError(where, f"brackets nested more than {DEEPEST} deep", "a file of this kind")


# --- numbers and names in text


def finite_number(text: str) -> float:
    """The number a text spells in decimal; ValueError for anything else, NaN, infinity and ISIS's Null included."""
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not abs(value) < LARGEST_NUMBER:
        raise ValueError(text)
    return value


def number_of(text: str, where: str) -> float:
    """The finite number that a text spells in decimal; InputError with `where` for anything else."""
    try:
        return finite_number(text)
    except ValueError:
        raise InputError(where, f"{text[:60]!r}", "a finite number") from None


def name_of(text: str, where: str, what: str = "a name") -> str:
    """The text as a name of an image, a point or a profile; InputError with `where` when it is empty, overlong, or
    holds control characters, which no terminal and no table should be given.
    """
    if not 0 < len(text) <= LONGEST_NAME:
        raise InputError(where, f"{what} of {len(text)} characters", f"1 to {LONGEST_NAME} characters")
    if not text.isprintable():
        raise InputError(where, f"{what} with control characters ({text[:60]!r})", "characters that can be printed")
    return text
