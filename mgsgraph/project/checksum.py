"""The checksum of a project's file, by which one flipped bit is found: SQLite's pages have none.

It is the CRC-32 of all bytes of the file but those by which a commit counts itself and what is on free pages (which
nobody reads, and no journal restores). It stands in the field of the header that SQLite leaves to its users
(`PRAGMA user_version`). 0 is no checksum: whoever wrote the file was killed after its change and before the checksum.
"""

import os
import sqlite3
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

_HEADER = 100
"""bytes of SQLite's header."""
_LEFT_OUT = (slice(24, 28), slice(60, 64), slice(92, 100))
"""Bytes of it that are not summed: the counter of changes, the checksum itself, and the change and the library that a
size is of (https://www.sqlite.org/fileformat.html).
"""
_CHUNK = 1 << 20
"""bytes read at a time."""


class _Files:
    """Files that are to stay open as long as any of them: for whoever closes one gives up all locks (POSIX) that the
    process has on that file, those of other connections, too.
    """

    def __init__(self) -> None:
        self._users, self._open = dict[tuple[int, int], int](), dict[tuple[int, int], list[BinaryIO]]()
        self._lock = threading.Lock()

    @contextmanager
    def held_open(self, path: Path) -> Iterator[BinaryIO]:
        file = path.open("rb")
        found = os.fstat(file.fileno())
        key = found.st_dev, found.st_ino
        with self._lock:
            self._users[key] = self._users.get(key, 0) + 1
            self._open.setdefault(key, []).append(file)
        try:
            yield file
        finally:
            with self._lock:
                self._users[key] -= 1
                if not self._users[key]:
                    del self._users[key]
                    for one in self._open.pop(key):
                        one.close()


held_open = _Files().held_open
"""A project's file for reading; to be opened before a connection to it, and left after that is closed."""


def checksum(file: BinaryIO) -> int:
    """Checksum of what is in a file, 1 to 2^32 - 1; nobody may be writing it."""
    file.seek(0)
    head = bytearray(file.read(_HEADER).ljust(_HEADER, b"\0"))
    page = int.from_bytes(head[16:18])
    page = 1 << 16 if page == 1 else max(page, 512)
    size = os.fstat(file.fileno()).st_size
    free = sorted(number for number in _free(file, int.from_bytes(head[32:36]), page, size) if number * page < size)
    for part in _LEFT_OUT:
        head[part] = bytes(len(head[part]))
    found, place = zlib.crc32(head), _HEADER
    for start in (number * page for number in free):
        if start > place:  # free pages lie side by side by the thousand
            found = _summed(file, place, start, found)
        place = start + page
    return _summed(file, place, size, found) or 1


def _free(file: BinaryIO, trunk: int, size: int, end: int) -> set[int]:
    """Free pages of `size` bytes, from 0 on, but those that list them, the `trunk` and what it leads to
    before the file's `end`.
    """
    free, seen = set[int](), set[int]()
    while trunk and trunk not in seen and trunk * size <= end:
        seen.add(trunk)
        file.seek((trunk - 1) * size)
        following, count = struct.unpack(">2I", file.read(8).ljust(8, b"\0"))
        listed = file.read(4 * min(count, size // 4))
        free.update(number - 1 for (number,) in struct.iter_unpack(">I", listed[: len(listed) // 4 * 4]) if number > 1)
        trunk = following
    return free


def _summed(file: BinaryIO, start: int, end: int, found: int) -> int:
    """The checksum `found` of what is before, of the bytes from `start` to `end`, too."""
    file.seek(start)
    while start < end and (chunk := file.read(min(_CHUNK, end - start))):
        found, start = zlib.crc32(chunk, found), start + len(chunk)
    return found


def noted(connection: sqlite3.Connection) -> int:
    """The checksum that the file says it has; 0 for none."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0]) % (1 << 32)


def note(connection: sqlite3.Connection, value: int) -> None:
    """Write it, in the transaction that is open."""
    connection.execute(f"PRAGMA user_version = {value - (1 << 32) if value >= 1 << 31 else value}")


def sign(connection: sqlite3.Connection, file: BinaryIO) -> None:
    """Write the checksum of what was committed, in a transaction of its own."""
    connection.execute("BEGIN IMMEDIATE")
    note(connection, checksum(file))
    connection.execute("COMMIT")
