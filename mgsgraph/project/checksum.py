"""The checksum of a project's file, by which one flipped bit is found: SQLite's pages have none.

It is the CRC-32 of all bytes of the file but those by which a commit counts itself and what is on free pages (which
nobody reads, and no journal restores). It stands in the field of the header that SQLite leaves to its users
(`PRAGMA user_version`), written in the transaction that it is of. 0 is no checksum: of a file that somebody has changed
and wants to be signed.
"""

import sqlite3
import struct
import zlib

_LEFT_OUT = (slice(24, 28), slice(60, 64), slice(92, 100))
"""Bytes of the header that are not summed: the counter of changes, the checksum itself, and the change and the library
that a size is of (https://www.sqlite.org/fileformat.html).
"""


def checksum(connection: sqlite3.Connection) -> int:
    """Checksum of the file as the open transaction has it, 1 to 2^32 - 1."""
    content = connection.serialize()
    head = bytearray(content[:100])
    page = int.from_bytes(head[16:18])
    page = 1 << 16 if page == 1 else max(page, 512)
    free = _free(content, int.from_bytes(head[32:36]), page)
    for part in _LEFT_OUT:
        head[part] = bytes(len(head[part]))
    found, view, place = zlib.crc32(head), memoryview(content), len(head)
    for start in sorted(number * page for number in free):
        found, place = zlib.crc32(view[place:start], found), start + page
    return zlib.crc32(view[place:], found) or 1


def _free(content: bytes, trunk: int, page: int) -> set[int]:
    """Free pages, from 0 on, but those that list them: the `trunk` and what it leads to."""
    free, seen, count = set[int](), set[int](), len(content) // page
    while 0 < trunk <= count and trunk not in seen:
        seen.add(trunk)
        following, listed = struct.unpack_from(">2I", content, start := (trunk - 1) * page)
        numbers = struct.unpack_from(f">{min(listed, page // 4 - 2)}I", content, start + 8)
        free.update(number - 1 for number in numbers if 1 < number <= count)
        trunk = following
    return free


def noted(connection: sqlite3.Connection) -> int:
    """The checksum that the file says it has; 0 for none."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0]) % (1 << 32)


def note(connection: sqlite3.Connection, value: int) -> None:
    """Write it, in the transaction that is open."""
    connection.execute(f"PRAGMA user_version = {value - (1 << 32) if value >= 1 << 31 else value}")
