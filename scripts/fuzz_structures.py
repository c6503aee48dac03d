"""Damage to files by their structure: values of JSON and PVL, cells of tables and databases, members of archives,
fields
of records; what is not damaged stays whole, checksums included, so that the damage gets far.
"""

import gzip
import io
import json
import random
import re
import sqlite3
import zipfile
import zlib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from fuzz_mutations import NAMES, NUMBERS, TEXT, Change, flip

_ODD_INTEGERS = (0, 1, -1, 2, 255, 256, 32767, -32768, 65535, 2**31 - 1, -(2**31), 2**31, 2**32 - 1, 2**53, 2**63 - 1)
ODD_FLOATS = (
    np.nan,
    np.inf,
    -np.inf,
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e308,
    -1.7976931348623157e308,
    5e-324,
    1e19,
    2.0**31,
    3e38,
)
TIMES = (1e3, 1e-3, -1.0, 1.001, 57.29577951308232, 1e6, 0.0)
_ODD_VALUES: tuple[Any, ...] = (None, True, False, "", "text", "NaN", "1e5", [], {}, [[]], 0, -1, 1, 1e308, -1e308,
1e-320, 10**400, 2**63, 0.5,
                                "\x1b[2J", "a" * 3000, [1, 2, 3], {"a": 1}, "../../x", 1e19)  # fmt: skip


def _number(value: np.generic, rng: random.Random) -> Any:
    """An odd value for a number's place, or the number in another unit."""
    with np.errstate(all="ignore"):
        if value.dtype.kind == "f":
            return value.dtype.type(rng.choice(ODD_FLOATS) if rng.random() < 0.5 else value * rng.choice(TIMES))
        limits = np.iinfo(value.dtype)
        changed = (
            rng.choice(_ODD_INTEGERS)
            if rng.random() < 0.5
            else int(float(value) * rng.choice(TIMES)) + rng.choice((-1, 0, 1))
        )
        return value.dtype.type(min(max(changed, limits.min), limits.max))


def _plain(dtype: np.dtype[Any], offset: int = 0) -> Iterator[tuple[int, np.dtype[Any]]]:
    """Places and types of the numbers in a record."""
    if dtype.subdtype:
        inner, shape = dtype.subdtype
        for k in range(int(np.prod(shape))):
            yield from _plain(inner, offset + k * inner.itemsize)
    elif dtype.names:
        for name in dtype.names:
            assert dtype.fields is not None
            yield from _plain(dtype.fields[name][0], offset + dtype.fields[name][1])
    elif dtype.kind in "iuf":
        yield offset, dtype


def records(dtype: np.dtype[Any] | str, start: int) -> Change:
    """A number in a table of records; seldom the same one in all of them."""
    whole = np.dtype(dtype)
    numbers = list(_plain(whole))

    def change(data: bytearray, rng: random.Random) -> str:
        count = max((len(data) - start) // whole.itemsize, 0)
        if not count:
            return "a field of a record"
        offset, kind = rng.choice(numbers)
        rows = [rng.randrange(count)] if rng.random() < 0.8 else list(range(count))
        odd: Any = None
        for row in rows:
            place = start + row * whole.itemsize + offset
            value = np.frombuffer(data, kind, 1, place)[0]
            odd = _number(value, rng) if odd is None else odd
            data[place : place + kind.itemsize] = np.array(odd, dtype=kind).tobytes()
        return "a field of a record"

    return change


# --- JSON, PVL, CSV


def _leaves(value: Any, keys: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if keys:
        yield keys
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _leaves(one, (*keys, key))
    elif isinstance(value, list):
        for k in range(len(value)) if len(value) < 8 else (0, 1, len(value) // 2, len(value) - 1):
            yield from _leaves(value[k], (*keys, k))


def json_value(data: bytearray, rng: random.Random) -> str:
    """A value, key or element of JSON, which stays JSON."""
    heading = data[: max(data.find(b"{"), 0)]
    try:
        content = json.loads(data[len(heading) :])
    except (ValueError, RecursionError):
        return flip(data, rng)
    places = list(_leaves(content))
    if not places:
        return "a value of JSON"
    *way, last = rng.choice(places)
    inner = content
    for key in way:
        inner = inner[key]
    value, kind = inner[last], rng.randrange(6)
    if kind == 0:
        del inner[last]
    elif kind == 1 and isinstance(inner, list):
        inner.insert(last, value)
    elif kind == 2 and isinstance(value, (int, float)) and not isinstance(value, bool):
        inner[last] = value * rng.choice(TIMES)
    elif kind == 3 and isinstance(value, list):
        numbers = all(isinstance(one, (int, float)) for one in value)
        inner[last] = (
            value[:-1] if not numbers or rng.random() < 0.5 else [one * rng.choice((1e3, 1e-3)) for one in value]
        )
    else:
        inner[last] = rng.choice(_ODD_VALUES)
    data[:] = heading + json.dumps(content, indent=1).encode()
    return ("a key left out", "an element twice", "another unit", "a list changed", "an odd value", "an odd value")[
        kind
    ]


_ASSIGNMENT = re.compile(rb"^([ \t]*[\w^:/-]+[ \t]*=[ \t]*)([^\r\n]*)", re.MULTILINE)
_UNITS = (b" <km>", b" <m>", b" <ms>", b" <seconds>", b" <degrees>", b" <>", b" <", b" <KM/PIXEL>", b"")


def assignment(data: bytearray, rng: random.Random) -> str:
    """A value of PVL, TOML or a text kernel, its unit, or its key."""
    found = list(_ASSIGNMENT.finditer(data[: 1 << 16]))
    if not found:
        return "another value of a key"
    one = rng.choice(found)
    value, kind = one[2].strip(), rng.randrange(5)
    if kind == 0:
        new = value + rng.choice(_UNITS)
    elif kind == 1:
        new = b"(" + value + b", " + value + b")"
    elif kind == 2:
        new = rng.choice(found)[2]
    elif kind == 3:
        new = b'"' + value + b'"' if not value.startswith(b'"') else value.strip(b'"')
    else:
        new = rng.choice(NUMBERS) if re.fullmatch(rb"[-+\d.eE]+", value) else rng.choice(NAMES)
    data[one.start(2) : one.end(2)] = new
    return ("another unit", "a list for a value", "another key's value", "other quotation marks", "another value")[kind]


def cell(data: bytearray, rng: random.Random) -> str:
    """A cell, column or row of a table of commas or blanks."""
    lines = bytes(data).split(b"\n")
    k, comma = rng.randrange(len(lines)), b"," if data.count(b",") > data.count(b" ") else b" "
    parts = lines[k].split(comma)
    i, kind = rng.randrange(len(parts)), rng.randrange(5)
    if kind == 0:
        parts[i] = rng.choice(NUMBERS)
    elif kind == 1:
        del parts[i]
    elif kind == 2:
        parts.insert(i, parts[i])
    elif kind == 3:
        rows = [line.split(comma) for line in lines]
        j = rng.randrange(len(parts))
        for row in rows:
            if max(i, j) < len(row):
                row[i], row[j] = row[j], row[i]
        data[:] = b"\n".join(comma.join(row) for row in rows)
        return "columns swapped"
    else:
        data[:] = b"\n".join(lines).replace(comma, rng.choice((b";", b"\t", b", ", b",,")))
        return "another delimiter"
    lines[k] = comma.join(parts)
    data[:] = b"\n".join(lines)
    return ("an odd cell", "a cell left out", "a cell twice")[kind]


# --- archives and databases


def npz(data: bytearray, rng: random.Random) -> str:
    """A member of a NumPy archive: its values, shape, type, name or declared size; the archive is whole."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, ValueError, zlib.error, NotImplementedError, OSError, EOFError):
        return flip(data, rng)
    name, kind = rng.choice(list(members)), rng.randrange(7)
    content = bytearray(members[name])
    head = 10 + int.from_bytes(content[8:10], "little") if content[:6] == b"\x93NUMPY" else 0
    if kind <= 1 and len(content) >= head + 8:
        place = head + 8 * rng.randrange((len(content) - head) // 8)
        if rng.random() < 0.5:
            content[place + rng.randrange(8)] ^= 1 << rng.randrange(8)
        else:
            content[place : place + 8] = np.array(rng.choice(ODD_FLOATS)).tobytes()
    elif kind == 2:
        shape = rng.choice((b"(99999999999,)", b"(-1,)", b"()", b"(0,)", b"(3, 3)", b"(1,) * 9", b"(2147483647, 8)"))
        line = re.sub(rb"'shape': \([^)]*\)", b"'shape': " + shape, bytes(content[:head]))[:head].ljust(head)
        content[:head] = line
    elif kind == 3:
        line = re.sub(
            rb"'descr': '[^']*'",
            rng.choice(
                (
                    b"'descr': '|O'",
                    b"'descr': '<f4'",
                    b"'descr': '>f8'",
                    b"'descr': '<c16'",
                    b"'descr': 'S999999999'",
                    b"'descr': '<i8'",
                )
            ),
            bytes(content[:head]),
        )
        content[:head] = line[:head].ljust(head)
    elif kind == 4:
        del members[name]
    elif kind == 5:
        members[rng.choice(("../x.npy", "a" * 300 + ".npy", "record.npy", "x"))] = members[name]
    else:
        members[name + ".npy"] = bytes(50_000_000)
    if kind != 4:
        members[name] = bytes(content)
    new = io.BytesIO()
    with zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED if kind == 6 else zipfile.ZIP_STORED) as archive:
        for key, value in members.items():
            archive.writestr(zipfile.ZipInfo(key), value)
    data[:] = new.getvalue()
    return (
        "a value of a member",
        "a value of a member",
        "another shape",
        "another type",
        "a member left out",
        "a member more",
        "a huge member",
    )[kind]


_UNSIGNED = 0.7
"""Share of databases without a checksum, as a killed writer leaves one: else it stops what is behind it."""


def sqlite(data: bytearray, rng: random.Random) -> str:
    """A cell, row or setting of a database that is whole."""
    base = sqlite3.connect(":memory:", isolation_level=None)
    try:
        base.deserialize(bytes(data))
        tables = [
            row[0]
            for row in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            if "sqlite" not in row[0]
        ]
        table = rng.choice(tables)
        count = base.execute(f'SELECT count(*) FROM "{table}"').fetchone()[0]
        if rng.random() < 0.05:
            base.execute(
                rng.choice(
                    (
                        f'DROP TABLE "{table}"',
                        "PRAGMA user_version = 99",
                        f'ALTER TABLE "{table}" ADD COLUMN odd',
                        "PRAGMA application_id = 1",
                    )
                )
            )
        elif count:
            row = base.execute(f'SELECT rowid, * FROM "{table}" LIMIT 1 OFFSET ?', (rng.randrange(count),)).fetchone()
            columns = [one[1] for one in base.execute(f'PRAGMA table_info("{table}")')]
            column = rng.randrange(len(columns))
            value = _cell(row[column + 1], rng)
            if rng.random() < 0.1:
                base.execute(f'DELETE FROM "{table}" WHERE rowid = ?', (row[0],))
            else:
                base.execute(f'UPDATE "{table}" SET "{columns[column]}" = ? WHERE rowid = ?', (value, row[0]))
        if rng.random() < _UNSIGNED:
            base.execute("PRAGMA user_version = 0")
        data[:] = base.serialize()
    except (sqlite3.Error, TypeError, IndexError, OverflowError, MemoryError):
        return flip(data, rng)
    finally:
        base.close()
    return "a cell of the database"


def _cell(value: Any, rng: random.Random) -> Any:
    if isinstance(value, bytes) and value and rng.random() < 0.8:
        content = bytearray(value)
        kind = rng.randrange(4)
        if kind == 0:
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        elif kind == 1:
            place = 8 * rng.randrange(max(len(content) // 8, 1))
            content[place : place + 8] = np.array(rng.choice(ODD_FLOATS)).tobytes()
        elif kind == 2:
            del content[rng.randrange(len(content)) :]
        else:
            content = content + content
        return bytes(content)
    if isinstance(value, str) and value and rng.random() < 0.8:
        content = bytearray(value.encode())
        (json_value if value[0] in "[{" and rng.random() < 0.7 else rng.choice(TEXT))(content, rng)
        return bytes(content).decode(errors="replace")
    if isinstance(value, (int, float)) and rng.random() < 0.5:
        return max(min(value * rng.choice(TIMES), 2**62), -(2**62)) if value == value else 0.0
    return rng.choice((None, "", "text", b"", b"\0" * 8, -1, 0, 1, 2**62, 1e308, "[1]", "{}", "[" * 1200, "\x1b[2J"))


def packed(data: bytearray, rng: random.Random) -> str:
    """What gzip has packed, damaged and packed again; or a bomb; or a wrong end."""
    kind = rng.randrange(20)
    if kind == 0:
        data[:] = bomb()
        return "a gzip bomb"
    if kind < 5 or len(data) > 1_000_000:  # a bomb already
        return flip(data, rng)
    try:
        content = bytearray(gzip.decompress(data))
    except (OSError, EOFError, zlib.error):
        return flip(data, rng)
    said = rng.choice((*TEXT, cell))(content, rng)
    data[:] = gzip.compress(bytes(content), 1, mtime=0)
    return f"{said}, packed"


@lru_cache
def bomb() -> bytes:
    """3 GB of blanks in 3 MB."""
    return gzip.compress(b" " * (64 << 20), 1, mtime=0) * 48
