"""fetch.lock: what a folder holds, from where, with its SHA-256; by it a second run needs no network."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import require_address
from mgsgraph.fetch.download import RemoteSource
from mgsgraph.fetch.needs import ImageNeeds
from mgsgraph.files.opening import sha256_of
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
