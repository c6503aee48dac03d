"""Connection to the SQLite file of a project: one transaction, one writer, a one-line message for every error.

SQLite's pages have no checksum. The file therefore has one, which finds a single flipped bit: the CRC-32 of all bytes
except the counters of commits and the content of free pages (nobody reads it, and no journal restores it). It stands in
the header field that SQLite leaves to applications (`PRAGMA user_version`) and is written in the same transaction as
the change. 0 means no checksum: the user has changed the file, and the next change of mgsgraph signs it.
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

from mgsgraph.errors import InputError, command_line, errors_from, require
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.project.schema import APPLICATION, FORMAT, TABLES

_READ_TIMEOUT, _COMMIT_TIMEOUT = 5_000, 60_000
"""ms that a reader waits for a commit, and a commit for readers."""
EXPECTED_PROJECT = "a project as mgsgraph writes it"
RESTORE_COPY = "take a copy of the project's folder back; the results in its folder solutions are files of their own"
USE_OLD_VERSION = "read it with mgsgraph 0.2.0, or build it anew from its case: mgsgraph project init"
_Kind = TypeVar("_Kind")
_FORMAT_NUMBER = re.compile(r"[1-9][0-9]{0,5}")


@contextmanager
def connected(folder: Path, write: bool, discard: bool = False) -> Iterator[sqlite3.Connection]:
    """Connection to the project's file in one transaction: committed at the end, rolled back on any exception.

    Compares the checksum first; a change writes a new one.

    Parameters
    ----------
    folder : Path
        The project.
    write : bool
        Lock the file for changes, at once or not at all. Readers continue, and see the state before the change.
    discard : bool
        Roll the changes back at the end.

    Raises
    ------
    InputError
        No project, a damaged one or one of another format; a project that another process is changing; a disk that is
        full or not writable.
    """
    path = _project_file(folder)
    with _as_input_errors(folder, sqlite3.Error):
        with _as_input_errors(folder, UnicodeError):  # from the names in a damaged schema, which SQLite quotes
            if not write:
                _recover(path, folder)
            connection = _open_connection(path, write, folder)
        try:
            with _as_input_errors(folder, UnicodeError):
                _require_format(connection, folder)
                _require_sound(connection, folder)
                if write:
                    # a read-only file lets even a transaction for writing begin, and complains at its first change
                    store_checksum(connection, 0)
            yield connection
            if write and not discard:
                store_checksum(connection, checksum(connection))
            if not discard:
                _commit(connection, folder)
        finally:
            with suppress(sqlite3.Error):
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
            connection.close()


@contextmanager
def _as_input_errors(folder: Path, kind: type[sqlite3.Error | UnicodeError]) -> Iterator[None]:
    """Turn SQLite's errors of a kind into InputErrors that name the project."""
    try:
        yield
    except kind as error:
        raise _input_error(folder, error) from error


def _commit(connection: sqlite3.Connection, folder: Path) -> None:
    try:
        connection.execute("COMMIT")
    except sqlite3.OperationalError as error:
        if not getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
            raise
        found = "another process has been reading it for a minute; nothing was changed"
        raise InputError(str(folder), found, remedy="do it again when that has ended") from None


@contextmanager
def new_file(folder: Path, shown: Path) -> Iterator[sqlite3.Connection]:
    """Connection to a new file with empty tables, in one transaction, committed at the end; errors name `shown`."""
    database = folder / PROJECT
    with _as_input_errors(shown, sqlite3.Error), closing(sqlite3.connect(database, isolation_level=None)) as connection:
        _configure(connection, write=True)
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute("BEGIN IMMEDIATE")
        for statement in TABLES:
            connection.execute(statement)
        connection.execute("INSERT INTO meta VALUES ('format', ?)", (str(FORMAT),))
        yield connection
        store_checksum(connection, checksum(connection))
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
"""Beginnings of SQLite's error names, what is wrong, and what to do."""


def _input_error(folder: Path, error: sqlite3.Error | UnicodeError) -> InputError:
    """An error of SQLite as a one-line InputError."""
    name = getattr(error, "sqlite_errorname", "")
    shown = str(folder)
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return InputError(shown, "another mgsgraph process is changing it", remedy="wait for it")
    for beginnings, found, remedy in _REFUSALS:
        if name.startswith(beginnings):
            return InputError(shown, found.format(error), remedy=remedy)
    reason = "words that are not UTF-8" if isinstance(error, UnicodeError) else error
    return InputError(shown, f"{PROJECT} is damaged ({reason})", remedy=RESTORE_COPY)


def with_read_errors(kind: type[_Kind]) -> type[_Kind]:
    """Class decorator: errors of reading a project's file become InputErrors that name the attribute `_where`.

    It changes public properties and public methods that return something; the others write.
    """
    for name, member in list(vars(kind).items()):
        if name.startswith("_"):
            continue
        if isinstance(member, property):
            setattr(kind, name, property(_with_read_errors(member.fget), doc=member.__doc__))
        elif inspect.isfunction(member) and member.__annotations__["return"] is not None:
            setattr(kind, name, _with_read_errors(member))
    return kind


def _with_read_errors(method: Callable[..., Any] | None) -> Callable[..., Any]:
    assert method is not None

    @functools.wraps(method)
    def guarded(self: Any, *arguments: Any) -> Any:
        with errors_from(self._where), understood(self._where, EXPECTED_PROJECT, RESTORE_COPY):
            return method(self, *arguments)

    return guarded


def _project_file(folder: Path) -> Path:
    """Path of the project's file; InputError for what is wrong without opening it."""
    path, init_remedy = folder / PROJECT, f"make one with: {command_line('project', 'init', folder)}"
    try:
        require(folder.exists(), str(folder), "no such project", remedy=init_remedy)
        if not folder.is_dir():
            case = f"make one of the case: {command_line('project', 'init', 'PROJECT', '--case', folder)}"
            remedy = case if folder.suffix == ".toml" else "give the folder that it is in"
            raise InputError(str(folder), "is a file", "the folder of a project", remedy)
        if not path.is_file():
            alternative = f"begin one in a folder: {command_line('project', 'init', folder / 'project')}"
            remedy = f"give the folder of a project, or {alternative}" if any(folder.iterdir()) else init_remedy
            raise InputError(str(folder), f"is no project: there is no {PROJECT} in it", remedy=remedy)
        empty = path.stat().st_size == 0
    except OSError as error:
        raise InputError(str(folder), f"can't be read ({error.strerror})", remedy="change its permissions") from None
    require(not empty, str(folder), f"{PROJECT} is empty", remedy=RESTORE_COPY)
    return path


def _open_connection(path: Path, write: bool, folder: Path) -> sqlite3.Connection:
    mode = "rw" if write else "ro"
    connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode={mode}", uri=True, isolation_level=None)
    try:
        _configure(connection, write)
        connection.execute("BEGIN IMMEDIATE" if write else "BEGIN")
        connection.execute("SELECT count(*) FROM sqlite_master")  # a deferred transaction begins with its first reading
        connection.execute(f"PRAGMA busy_timeout = {_COMMIT_TIMEOUT if write else _READ_TIMEOUT}")
    except BaseException:
        connection.close()
        raise
    return connection


def _configure(connection: sqlite3.Connection, write: bool) -> None:
    connection.execute(f"PRAGMA busy_timeout = {0 if write else _READ_TIMEOUT}")
    if write:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA cache_spill = OFF")  # pages written before the commit would lock readers out


def _recover(path: Path, folder: Path) -> None:
    """Play back the journal of a killed process, which a read-only connection can't."""
    try:
        _open_connection(path, False, folder).close()
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
    format_row = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    text = str(format_row[0]) if format_row else ""
    require(_FORMAT_NUMBER.fullmatch(text), where, f"no known format ({text})", f"format {FORMAT}", RESTORE_COPY)
    require(int(text) >= FORMAT, where, f"a project of format {text}", f"format {FORMAT}", USE_OLD_VERSION)
    if int(text) > FORMAT:
        version_row = connection.execute("SELECT value FROM meta WHERE key = 'version'").fetchone()
        program = f"mgsgraph {version_row[0]}" if version_row else "mgsgraph"
        raise InputError(
            where, f"written by a newer version of the program ({program}, format {text})", f"format {FORMAT}",
            "install that version, or a newer one",
        )  # fmt: skip


def _require_sound(connection: sqlite3.Connection, folder: Path) -> None:
    """Raise InputError unless the checksum fits; for a file without a checksum, unless SQLite's quick check passes."""
    expected = stored_checksum(connection)
    if expected and checksum(connection) != expected:
        found = f"{PROJECT} is damaged, or another program has changed it (its checksum is another one)"
        sign = f"sqlite3 {folder / PROJECT} 'PRAGMA user_version = 0'"
        raise InputError(str(folder), found, remedy=f"{RESTORE_COPY}; if the change was yours, have it signed: {sign}")
    if not expected:
        found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        require(found == "ok", str(folder), f"{PROJECT} is damaged ({' '.join(found.split())})", remedy=RESTORE_COPY)


_UNSUMMED_SPANS = (slice(24, 28), slice(60, 64), slice(92, 100))
"""Bytes of the header outside the checksum: the change counter, the checksum, and the change counter and SQLite version
of the file size (https://www.sqlite.org/fileformat.html).
"""


def checksum(connection: sqlite3.Connection) -> int:
    """Checksum of the file in the open transaction, 1 to 2^32 - 1."""
    content = connection.serialize()
    header = bytearray(content[:100])
    page_size = int.from_bytes(header[16:18])
    page_size = 1 << 16 if page_size == 1 else max(page_size, 512)
    free_pages = _free_pages(content, int.from_bytes(header[32:36]), page_size)
    for span in _UNSUMMED_SPANS:
        header[span] = bytes(len(header[span]))
    crc, content_view, position = zlib.crc32(header), memoryview(content), len(header)
    for start in sorted(number * page_size for number in free_pages):
        crc, position = zlib.crc32(content_view[position:start], crc), start + page_size
    return zlib.crc32(content_view[position:], crc) or 1


def _free_pages(content: bytes, trunk: int, page_size: int) -> set[int]:
    """Numbers of the free pages, from 0 on, without the list pages themselves (`trunk` is the first of these)."""
    free_pages, seen_trunks, page_count = set[int](), set[int](), len(content) // page_size
    while 0 < trunk <= page_count and trunk not in seen_trunks:
        seen_trunks.add(trunk)
        next_trunk, listed_count = struct.unpack_from(">2I", content, start := (trunk - 1) * page_size)
        numbers = struct.unpack_from(f">{min(listed_count, page_size // 4 - 2)}I", content, start + 8)
        free_pages.update(number - 1 for number in numbers if 1 < number <= page_count)
        trunk = next_trunk
    return free_pages


def stored_checksum(connection: sqlite3.Connection) -> int:
    """The checksum in the file; 0 for none."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0]) % (1 << 32)


def store_checksum(connection: sqlite3.Connection, value: int) -> None:
    """Write a checksum in the open transaction."""
    connection.execute(f"PRAGMA user_version = {value - (1 << 32) if value >= 1 << 31 else value}")
