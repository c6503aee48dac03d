"""What a folder holds, from where: whole files with their SHA-256 in fetch.lock, by which a second run asks no network;
and what has come in part, in NAME.part, and beside it NAME.part.json with what the archive said of the whole. Whatever
lies at these two, no link is followed, and no file is taken up or written to that has another name, too.
"""

import errno
import json
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import require_address
from mgsgraph.fetch.needs import ImageNeeds
from mgsgraph.files.opening import read_json, sha256_of
from mgsgraph.files.records import read_record, record_text
from mgsgraph.files.writing import write_file
from mgsgraph.text import many, some

LOCK = "fetch.lock"
"""Its name in the folder."""
_FORMAT = 1
FOLDERS = ("images", "index", "kernels", "megdr", "pedr", "shots")
"""In the folder, for what is fetched."""
_NAME = re.compile(rf"({'|'.join(FOLDERS)})/\w[\w.-]*")
"""Paths of files in the folder: nothing of a lock leads out of it."""


_SPARE = 1 << 20
"""bytes that stay free on the disk."""
_LONGEST = 1 << 16
"""bytes of NAME.part.json."""


def _is_own(path: Path) -> bool:
    """Whether a file is there, no link to one, and under this name alone."""
    try:
        about = path.lstat()
    except OSError:
        return False
    return stat.S_ISREG(about.st_mode) and about.st_nlink == 1


def _write(path: Path, how: int, content: bytes) -> None:
    """Write to a file that is new, or appended to, and not reached by a link."""
    flags = os.O_WRONLY | how | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    with open(os.open(path, flags, 0o666), "wb") as file:
        file.write(content)


@dataclass(frozen=True, slots=True)
class RemoteSource:
    """What an archive says of a file."""

    url: str
    total: int | None
    """bytes; None where it doesn't say."""
    etag: str
    """Its ETag; empty where there is none."""
    modified: str
    """Its Last-Modified; empty where there is none."""

    @property
    def sound(self) -> bool:
        """Whether its values are of the kinds that they should be: it may have been read from a file."""
        texts = all(isinstance(one, str) for one in (self.url, self.etag, self.modified))
        return texts and (self.total is None or (type(self.total) is int and self.total >= 0))

    @property
    def validator(self) -> str:
        """By what If-Range knows the content again: a strong ETag, or the date; empty for neither."""
        return self.etag if self.etag and not self.etag.startswith("W/") else self.modified

    def same_content(self, other: "RemoteSource") -> bool:
        """Whether the other is the same content, as far as both say."""
        return all(
            not mine or not others or mine == others
            for mine, others in ((self.etag, other.etag), (self.modified, other.modified), (self.total, other.total))
        )


class PartialFile:
    """Grows to the file at `path`; what is there of an earlier attempt is taken up where the archive's content can be
    known again.
    """

    def __init__(self, path: Path, url: str) -> None:
        self.path, self.file = path, path.with_name(f"{path.name}.part")
        self._said = path.with_name(f"{path.name}.part.json")
        self.source: RemoteSource | None = None
        self._take_up(url)

    def _take_up(self, url: str) -> None:
        if not _is_own(self._said) or not _is_own(self.file):
            return
        try:
            source = RemoteSource(**read_json(self._said, limit=_LONGEST))
        except (InputError, TypeError):  # no part, or one that says nothing
            return
        if source.sound and source.url == url and self.size > 0:
            self.source = source

    @property
    def size(self) -> int:
        """Bytes that are there."""
        return self.file.lstat().st_size if _is_own(self.file) else 0

    @property
    def whole(self) -> bool:
        """Whether all bytes are there, as far as the archive said how many."""
        return self.source is not None and self.source.total in (None, self.size)

    def wanted(self) -> Mapping[str, str]:
        """Headers that ask for the rest, if the content is still the same; none to begin anew."""
        if self.source is None or not self.source.validator:
            return {}
        return {"Range": f"bytes={self.size}-", "If-Range": self.source.validator}

    def begin(self, source: RemoteSource) -> None:
        """Begin anew: nothing is there."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(self.path.parent).free
            if source.total is not None and source.total + _SPARE > free:
                raise InputError(
                    str(self.path), f"{free / 1e6:.1f} MB free on the disk", f"{source.total / 1e6:.1f} MB for it",
                    "free some space, or choose another --out",
                )
            for path, content in ((self.file, b""), (self._said, json.dumps(asdict(source)).encode())):
                path.unlink(missing_ok=True)
                _write(path, os.O_CREAT | os.O_EXCL, content)
        except OSError as error:
            raise self._refusal(error) from None
        self.source = source

    def add(self, more: bytes) -> None:
        """Bytes that follow on those that are there."""
        try:
            _write(self.file, os.O_APPEND, more)
        except OSError as error:
            raise self._refusal(error) from None

    def finish(self) -> None:
        """Let it take the file's place."""
        try:
            self.file.replace(self.path)
            self._said.unlink(missing_ok=True)
        except OSError as error:
            raise self._refusal(error) from None

    def discard(self) -> None:
        """Forget what is there."""
        self.source = None
        try:
            self.file.unlink(missing_ok=True)
            self._said.unlink(missing_ok=True)
        except OSError as error:
            raise self._refusal(error) from None

    def _refusal(self, error: OSError) -> InputError:
        space = "free some space, or " if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        remedy = f"{space}choose another --out; what has come is kept"
        return InputError(str(self.path), f"can't be written ({error.strerror or error})", remedy=remedy)


@dataclass(frozen=True, slots=True)
class LockedFile:
    """One file as it came."""

    url: str
    size: int
    """bytes."""
    sha256: str
    fetched: str
    """UTC."""
    etag: str = ""
    modified: str = ""
    """Last-Modified."""

    @property
    def source(self) -> RemoteSource:
        """What the archive said of it."""
        return RemoteSource(self.url, self.size, self.etag, self.modified)

    def differs(self, path: Path) -> str:
        """How what is at `path` differs from it, in words; empty for not at all."""
        try:
            if path.is_symlink():
                return "a link"
            size = path.stat().st_size
            if size != self.size:
                return f"{size} bytes instead of {self.size}"
            return "" if sha256_of(path) == self.sha256 else "another SHA-256"
        except FileNotFoundError:
            return "missing"
        except OSError as error:
            return f"can't be read ({error.strerror})"
        except InputError as error:
            return error.found


@dataclass(slots=True)
class Lock:
    """All files of a folder by their paths in it, what each image needs, and what we wrote ourselves."""

    folder: Path
    files: dict[str, LockedFile] = field(default_factory=dict)
    images: dict[str, ImageNeeds] = field(default_factory=dict)
    """By product id."""
    written: dict[str, str] = field(default_factory=dict)
    """SHA-256 of what was written here, case and meta-kernel, by paths."""

    @classmethod
    def read(cls, folder: Path) -> "Lock":
        """That of a folder, or an empty one where there is none; InputError where it can't be understood."""
        path = folder / LOCK
        if not path.exists():
            return cls(folder)
        content = read_record(path)
        if content.get("format") != _FORMAT:
            raise InputError(f"{path}, format", f"{content.get('format')}", f"{_FORMAT}", "use a newer mgsgraph")
        try:
            return cls(
                folder,
                {name: _locked(name, entry) for name, entry in content["files"].items()},
                {name: ImageNeeds.of(entry) for name, entry in content["images"].items()},
                {str(name): str(digest) for name, digest in content["written"].items()},
            )
        except (TypeError, ValueError, KeyError, AttributeError):
            found, remedy = "entries that are not ours", "move the folder away, and fetch anew"
            raise InputError(str(path), found, remedy=remedy) from None

    def write(self) -> None:
        """Whole or not at all."""
        content: dict[str, Any] = {
            "program": "mgsgraph", "format": _FORMAT,
            "images": {name: needs.entry() for name, needs in self.images.items()},
            "files": {name: asdict(self.files[name]) for name in sorted(self.files)},
            "written": self.written,
        }  # fmt: skip
        write_file(self.folder / LOCK, record_text(content), remedy="choose another --out")

    def whole(self, name: str) -> bool:
        """Whether a file is there as it was locked."""
        return name in self.files and not self.files[name].differs(self.folder / name)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files.values())


def _locked(name: str, entry: Mapping[str, Any]) -> LockedFile:
    """A file's entry; TypeError or ValueError for one that is not ours."""
    file = LockedFile(**entry)
    require_address(file.url, name)
    texts = file.url, file.sha256, file.fetched, file.etag, file.modified
    if not is_ours(name) or type(file.size) is not int or not all(isinstance(one, str) for one in texts):
        raise ValueError(name)
    return file


def is_ours(name: str) -> bool:
    """Whether a path in the folder may be one of a file that is fetched; none leads out of it."""
    return _NAME.fullmatch(name) is not None


def verify(folder: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> Lock:
    """Compare a folder with its lock; `progress` is called with bytes done and bytes in all.

    Returns
    -------
    Lock
        Of a folder that is whole.

    Raises
    ------
    InputError
        Where there is no lock, or a file is missing or differs: the first few are named.
    """
    if not (folder / LOCK).is_file():
        raise InputError(str(folder), f"no {LOCK}", "a folder made by `mgsgraph fetch`")
    lock = Lock.read(folder)
    wrong = list(_wrong(lock, progress))
    if wrong:
        raise InputError(
            str(folder), f"{many(len(wrong), 'file')} of {len(lock.files)} not as locked: {some(wrong, len(wrong))}",
            remedy="fetch again into the same folder: only these are brought",
        )
    return lock


def _wrong(lock: Lock, progress: Callable[[int, int], None]) -> Iterable[str]:
    done = 0
    for name, file in lock.files.items():
        if how := file.differs(lock.folder / name):
            yield f"{name} ({how})"
        done += file.size
        progress(done, lock.size)
