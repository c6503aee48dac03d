"""Atomic files, which replace only an earlier output of their kind; folders for one process.

Among them records of what the program has written, as JSON that ends with its checksum (by it a flipped bit is found),
and pages for a browser: one HTML file each, with no outside address, all with the head of `templates/page.html`.
"""

import getpass
import json
import os
import re
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from mgsgraph.atomic_write import lock, made_beside, put_file
from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import head_of, json_object, read_bytes

_HEAD = 1 << 14
"""bytes by which an earlier output is known."""
_ELSEWHERE = "choose another name, or move what is there away"


@dataclass(frozen=True, slots=True)
class Output:
    """A kind of file that the program writes, by which an earlier one is known: that alone is replaced."""

    what: str
    """In words, as "a page of mgsgraph report"."""
    known: Callable[[Path], bool]
    """Whether the file at a path is one, by its content."""


def begins(what: str, pattern: str) -> Output:
    """A kind of file that is known by how its text begins, in a line of its first bytes."""
    regex = re.compile(pattern, re.IGNORECASE)
    return Output(what, lambda path: regex.match(head_of(path, _HEAD).decode("utf-8-sig", "replace")) is not None)


def account() -> str:
    """Name of the user's account, or its number."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


# --- writing


def file_stem(name: str) -> str:
    """An image's name (or any other) as part of a file's: all but letters, digits, dots and hyphens are underscores."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name)


def require_folder_above(path: Path, shown: str, remedy: str = "") -> None:
    """Raise InputError where a file stands in the place of a folder that `path` would be in; OSError where it can't be
    seen.
    """
    first = next(parent for parent in path.parents if parent.exists())
    require(first.is_dir(), shown, f"can't be written ({first} is a file)", "a folder to make it in", remedy)


@contextmanager
def fresh_file(path: Path, expected: str = "", remedy: str = "", over: Output | None = None) -> Iterator[Path]:
    """A path to write a file to; what is there takes its place at `path` when all went well.

    `expected` and `remedy` are words of the InputError that is raised where it can't be written: also where something
    else than a file is there, a folder, a pipe, or /dev/stdout, whose place no file should take, or a file that is none
    `over` which this one goes (`require_free`).
    """
    require_free(path, over, expected, remedy)
    with writing_to(path, expected, remedy):
        require_folder_above(path, str(path), remedy)
        with made_beside(path) as temporary:
            yield temporary
            require_free(path, over, expected, remedy)
            put_file(temporary, path)


@contextmanager
def writing_to(path: str | Path, expected: str = "", remedy: str = "") -> Iterator[None]:
    """One line for a system error while a file or folder is written."""
    try:
        yield
    except OSError as error:
        found = f"can't be written ({error.strerror or error})"
        raise InputError(str(path), found, expected, remedy) from None


def require_free(path: Path, over: Output | None = None, expected: str = "", remedy: str = "") -> None:
    """Raise InputError unless a file may take its place at `path`: nothing is there, an empty file, or one that is an
    earlier output of its kind; any file where there is no kind. To be asked before long work, too.
    """
    with writing_to(path, expected, remedy):
        if not os.path.lexists(path):
            return
        if not path.is_file() or path.parent == Path("/dev"):
            raise InputError(str(path), "can't be written (what is there is no file)", expected, remedy)
        if over is not None and path.stat().st_size and not over.known(path):
            raise InputError(str(path), f"exists and is not {over.what}", remedy=remedy or _ELSEWHERE)


def write_file(
    path: Path, content: str | bytes, expected: str = "", remedy: str = "", over: Output | None = None
) -> None:
    """Write a file atomically: bytes, or text as UTF-8; see `fresh_file`."""
    with fresh_file(path, expected, remedy, over) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def require_writable(folder: Path) -> None:
    """Raise OSError unless a folder can be made in it, which alone shows permissions, quotas and full disks."""
    with made_beside(folder / "trial", folder=True):
        pass


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> list[Path]:
    """Write files by their names in a folder; their paths."""
    for name, content in contents.items():
        write_file(folder / name, content)
    return [folder / name for name in contents]


# --- one process at a time


def claim(descriptor: int, path: Path, found: str) -> None:
    """Lock an open file, as long as it is open; InputError with `found` where another process has."""
    require(lock(descriptor), str(path), found, remedy="wait for it, or choose another --out")


@contextmanager
def claimed(folder: Path, found: str) -> Iterator[None]:
    """Lock an existing folder; InputError with `found` where another process has."""
    if sys.platform == "win32":  # opens no folders
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        claim(descriptor, folder, found)
        yield
    finally:
        os.close(descriptor)


def page_of(template: str) -> Output:
    """The kind of page that a template makes: an earlier one is known by the generator in its head."""
    verb = Path(template).stem
    return begins(f"a page of mgsgraph {verb}", rf'(?s).{{,2000}}<meta name="generator" content="mgsgraph {verb}">')


def write_page(template: str, content: Mapping[str, Any], path: Path) -> None:
    """Fill in a template, named by its path within the package, and write it; an earlier page of it is replaced.

    Raises
    ------
    InputError
        If the file can't be written, or is another's.
    """
    import jinja2  # takes 0.1 s

    pages = jinja2.Environment(
        loader=jinja2.PackageLoader("mgsgraph", ""), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    with fresh_file(path, "a file that may be written", "choose another --out", page_of(template)) as temporary:
        pages.get_template(template).stream(content).dump(str(temporary), encoding="utf-8")


MATCH = "match.json"
"""Record that lies beside the networks that `mgsgraph match` has written."""
FILES = "sha256"
"""Key of a record for the digests of the files beside it, by their names."""
_KEY = "crc32"
_MARK = f',\n "{_KEY}": "%08x"\n}}\n'
"""How a record ends: with the CRC-32 of what stands before."""
_MARK_BYTES = 10
"""bytes of 18 that an end has in common with the mark, from which on it is the mark, or was: flipped bits may hit it;
other ends of JSON have 3.
"""
_AT_ONCE = 2.0
"""s within which files are written by one command, or distinguished by the times of a file system (FAT)."""
_REMEDY = "do again what wrote it; if it was changed on purpose, take its key crc32 out"


def record_text(record: Mapping[str, Any]) -> str:
    """A record, which is plain values, as the text of its file."""
    text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False).removesuffix("\n}")
    return text + _MARK % zlib.crc32(text.encode())


def read_record(path: Path) -> dict[str, Any]:
    """A record without its checksum; one that was written before records had any is taken as it is.

    Raises
    ------
    InputError
        What `read_json` refuses; one that is not as it was written.
    """
    content, where = read_bytes(path), str(path)
    end = (_MARK % 0).encode()
    body, mark = content[: -len(end)], content[-len(end) :]
    sealed = mark == (_MARK % zlib.crc32(body)).encode()
    same = sum(a == b for k, (a, b) in enumerate(zip(mark, end, strict=False)) if end[k : k + 1] != b"0")
    record = json_object(content, where) if sealed or same < _MARK_BYTES else {_KEY: ""}
    if not sealed and _KEY in record:
        raise InputError(where, "is damaged, or was changed (its checksum is another one)", remedy=_REMEDY)
    record.pop(_KEY, None)
    return record


def require_as_recorded(path: Path, content: bytes) -> None:
    """Raise InputError where a file has another content than `mgsgraph match` gave it, by the record beside it.

    A file that was written later (as qnet and cnetedit do) is another's: damage by a disk or a cable changes no time.
    """
    beside = path.with_name(MATCH)
    if not beside.is_file() or path.stat().st_mtime > beside.stat().st_mtime + _AT_ONCE:
        return
    recorded = read_record(beside).get(FILES)
    digest = recorded.get(path.name) if isinstance(recorded, dict) else None
    if digest is not None and digest != sha256(content).hexdigest():
        found, expected = "is damaged, or was changed since", f"the content that {MATCH} beside it has noted"
        remedy = "match again; if it was changed on purpose, touch it, or give it another name or folder"
        raise InputError(str(path), found, expected, remedy)
