"""The SQLite file of a project, opened: one transaction, one writer, one clear line for whatever is wrong with it.

The file has a checksum, by which one flipped bit is found, for SQLite's pages have none: the CRC-32 of all bytes but
those by which a commit counts itself and what is on free pages (which nobody reads, and no journal restores). It stands
in the field of the header that SQLite leaves to its users (`PRAGMA user_version`), written in the transaction that it
is of. 0 is no checksum: of a file that somebody has changed and wants to be signed.
"""

import functools
import inspect
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.project.schema import APPLICATION, FORMAT, TABLES

_READ_TIMEOUT, _COMMIT_TIMEOUT = 5_000, 60_000
"""ms that a reader waits for a commit, and a commit for readers."""
A_PROJECT = "a project as mgsgraph writes it"
ELSEWHERE = "take a copy of the project's folder back; the results in its folder solutions are files of their own"
OLDER = "read it with mgsgraph 0.2.0, or build it anew from its case: mgsgraph project init"
_Kind = TypeVar("_Kind")
_FORMAT_NUMBER = re.compile(r"[1-9][0-9]{0,5}")


@contextmanager
def connected(folder: Path, write: bool) -> Iterator[sqlite3.Connection]:
    """The project's file inside one transaction, which is committed at the end and rolled back on any exception.

    Its checksum is compared first, and written anew with a change.

    Parameters
    ----------
    folder : Path
        The project.
    write : bool
        Lock it for changes, at once or not at all. Readers go on meanwhile, and see what was there before.

    Raises
    ------
    InputError
        No project there, a damaged one, one of another format; one that another process is changing; a disk that is
        full or can't be written.
    """
    path = _existing(folder)
    with _refused(folder, sqlite3.Error):
        with _refused(folder, UnicodeError):  # from the names in a damaged schema, which SQLite quotes
            if not write:
                _recover(path, folder)
            connection = _opened(path, write, folder)
        try:
            with _refused(folder, UnicodeError):
                _require_format(connection, folder)
                _require_sound(connection, folder)
                if write:
                    # a read-only file lets even a transaction for writing begin, and complains at its first change
                    note(connection, 0)
            yield connection
            if write:
                note(connection, checksum(connection))
            _commit(connection, folder)
        finally:
            with suppress(sqlite3.Error):
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
            connection.close()


@contextmanager
def _refused(folder: Path, kind: type[sqlite3.Error | UnicodeError]) -> Iterator[None]:
    """What SQLite has against a project, errors of a kind, as InputErrors."""
    try:
        yield
    except kind as error:
        raise _refusal(folder, error) from error


def _commit(connection: sqlite3.Connection, folder: Path) -> None:
    try:
        connection.execute("COMMIT")
    except sqlite3.OperationalError as error:
        if not getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
            raise
        found = "another process has been reading it for a minute; nothing was changed"
        raise InputError(str(folder), found, remedy="do it again when that has ended") from None


@contextmanager
def made(folder: Path, shown: Path) -> Iterator[sqlite3.Connection]:
    """A new file with empty tables, inside a transaction that is committed at the end; errors name what is `shown`."""
    with _refused(shown, sqlite3.Error), closing(sqlite3.connect(folder / PROJECT, isolation_level=None)) as connection:
        _set_up(connection, write=True)
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute("BEGIN IMMEDIATE")
        for statement in TABLES:
            connection.execute(statement)
        connection.execute("INSERT INTO meta VALUES ('format', ?)", (str(FORMAT),))
        yield connection
        note(connection, checksum(connection))
        connection.execute("COMMIT")


_REFUSALS = (
    (("SQLITE_READONLY_R",),  # ROLLBACK, RECOVERY: a journal that only a writer can play back
     "a process was killed while it changed this, and the disk is read-only, so that it can't be put right",
     "copy the folder to where you may write, or make it writable once"),
    (("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM", "SQLITE_AUTH"), "can't be written or opened ({})",
     "copy the folder to where you may write, or change its permissions"),
    (("SQLITE_FULL",), "the disk is full; nothing was changed", "free some space and do it again"),
    (("SQLITE_IOERR",), "the disk can't be read or written ({})", "look at the disk"),
)  # fmt: skip
"""How names of SQLite's errors begin, what is wrong, and what to do."""


def _refusal(folder: Path, error: sqlite3.Error | UnicodeError) -> InputError:
    """What SQLite has to say, in one line."""
    name = getattr(error, "sqlite_errorname", "")
    shown = str(folder)
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return InputError(shown, "another mgsgraph process is changing it", remedy="wait for it")
    for beginnings, found, remedy in _REFUSALS:
        if name.startswith(beginnings):
            return InputError(shown, found.format(error), remedy=remedy)
    said = "words that are not UTF-8" if isinstance(error, UnicodeError) else error
    return InputError(shown, f"{PROJECT} is damaged ({said})", remedy=ELSEWHERE)


def guarded_readings(kind: type[_Kind]) -> type[_Kind]:
    """A class whose methods read what is in a project's file: what they stumble over becomes an InputError that names
    its attribute `_where`. Public properties and methods that give something back are meant; others write.
    """
    for name, member in list(vars(kind).items()):
        if name.startswith("_"):
            continue
        if isinstance(member, property):
            setattr(kind, name, property(_guarded(member.fget), doc=member.__doc__))
        elif inspect.isfunction(member) and member.__annotations__["return"] is not None:
            setattr(kind, name, _guarded(member))
    return kind


def _guarded(method: Callable[..., Any] | None) -> Callable[..., Any]:
    assert method is not None

    @functools.wraps(method)
    def guarded(self: Any, *arguments: Any) -> Any:
        with errors_from(self._where), understood(self._where, A_PROJECT, ELSEWHERE):
            return method(self, *arguments)

    return guarded


def _existing(folder: Path) -> Path:
    """The project's file, after a look at what can be seen without SQLite."""
    path, start = folder / PROJECT, f"make one with: mgsgraph project init {folder}"
    try:
        if not folder.exists():
            raise InputError(str(folder), "no such project", remedy=start)
        if not folder.is_dir():
            case = f"make one of the case: mgsgraph project init PROJECT --case {folder}"
            remedy = case if folder.suffix == ".toml" else "give the folder that it is in"
            raise InputError(str(folder), "is a file", "the folder of a project", remedy)
        if not path.is_file():
            other = f"begin one in a folder of its own: mgsgraph project init {folder / 'project'}"
            remedy = f"give the folder of a project, or {other}" if any(folder.iterdir()) else start
            raise InputError(str(folder), f"is no project: there is no {PROJECT} in it", remedy=remedy)
        empty = path.stat().st_size == 0
    except OSError as error:
        raise _unreadable(folder, error) from None
    if empty:
        raise InputError(str(folder), f"{PROJECT} is empty", remedy=ELSEWHERE)
    return path


def _unreadable(folder: Path, error: OSError) -> InputError:
    return InputError(str(folder), f"can't be read ({error.strerror})", remedy="change its permissions")


def _opened(path: Path, write: bool, folder: Path) -> sqlite3.Connection:
    mode = "rw" if write else "ro"
    connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode={mode}", uri=True, isolation_level=None)
    try:
        _set_up(connection, write)
        connection.execute("BEGIN IMMEDIATE" if write else "BEGIN")
        connection.execute("SELECT count(*) FROM sqlite_master")  # a deferred transaction begins with its first reading
        connection.execute(f"PRAGMA busy_timeout = {_COMMIT_TIMEOUT if write else _READ_TIMEOUT}")
    except BaseException:
        connection.close()
        raise
    return connection


def _set_up(connection: sqlite3.Connection, write: bool) -> None:
    connection.execute(f"PRAGMA busy_timeout = {0 if write else _READ_TIMEOUT}")
    if write:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA cache_spill = OFF")  # pages written before the commit would lock readers out


def _recover(path: Path, folder: Path) -> None:
    """What a reader can't do itself: play back the journal of a process that was killed."""
    try:
        _opened(path, False, folder).close()
    except sqlite3.Error as error:
        if not getattr(error, "sqlite_errorname", "").startswith("SQLITE_READONLY"):
            raise
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=rw", uri=True)) as player:
            player.execute("SELECT 1 FROM sqlite_master")


def _require_format(connection: sqlite3.Connection, folder: Path) -> None:
    """Raise InputError unless the file is a project of this format."""
    where = str(folder / PROJECT)
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION:
        raise InputError(where, "is an SQLite file of another program", remedy="give the folder of a project")
    found = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    text = str(found[0]) if found else ""
    if not _FORMAT_NUMBER.fullmatch(text):
        raise InputError(where, f"no known format ({text})", f"format {FORMAT}", ELSEWHERE)
    if int(text) < FORMAT:
        raise InputError(where, f"a project of format {text}", f"format {FORMAT}", OLDER)
    if int(text) > FORMAT:
        made_by = connection.execute("SELECT value FROM meta WHERE key = 'version'").fetchone()
        by = f"mgsgraph {made_by[0]}" if made_by else "mgsgraph"
        raise InputError(
            where, f"written by a newer version of the program ({by}, format {text})", f"format {FORMAT}",
            "install that version, or a newer one",
        )  # fmt: skip


def _require_sound(connection: sqlite3.Connection, folder: Path) -> None:
    """Raise InputError where the file isn't as it was written; of one without a checksum, where its pages don't fit."""
    expected = noted(connection)
    if expected and checksum(connection) != expected:
        found = f"{PROJECT} is damaged, or another program has changed it (its checksum is another one)"
        own = f"sqlite3 {folder / PROJECT} 'PRAGMA user_version = 0'"
        raise InputError(str(folder), found, remedy=f"{ELSEWHERE}; if the change was yours, have it signed: {own}")
    if not expected:
        found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if found != "ok":
            raise InputError(str(folder), f"{PROJECT} is damaged ({' '.join(found.split())})", remedy=ELSEWHERE)


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
