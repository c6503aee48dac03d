"""The folder that files are brought into, two at a time, each checked and entered in fetch.lock once it is whole, with
its SHA-256: by it a second run asks no network for what is there.
"""

import re
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from mgsgraph.errors import InputError, require
from mgsgraph.fetch.download import Remote
from mgsgraph.fetch.needs import ImageNeeds, WantedFile, require_address
from mgsgraph.files.altimetry.binary import FRAME
from mgsgraph.files.opening import head_of, read_bytes, sha256_of
from mgsgraph.files.pvl import read_label
from mgsgraph.files.writing import read_record, record_text, write_file
from mgsgraph.workers import no_progress

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
            found, remedy = "entries that are not ours", "move the folder away, and fetch again"
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

def _locked(name: str, entry: Mapping[str, Any]) -> LockedFile:
    """A file's entry; TypeError or ValueError for one that is not ours."""
    texts = [entry[key] for key in ("url", "sha256", "fetched")]
    file = LockedFile(texts[0], entry["size"], *texts[1:])
    require_address(file.url, name)
    if not is_ours(name) or type(file.size) is not int or not all(isinstance(text, str) for text in texts):
        raise ValueError(name)
    return file


def is_ours(name: str) -> bool:
    """Whether a path in the folder may be one of a file that is fetched; none leads out of it."""
    return _NAME.fullmatch(name) is not None



Progress = Callable[[int, int], None]
"""Called with the bytes that have come and all bytes that are known to come."""
_AT_ONCE = 2


class DownloadFolder:
    """A folder of ours, its lock, and the way to the archives."""

    def __init__(self, lock: Lock, remote: Remote, progress: Progress = no_progress) -> None:
        self.lock, self.remote = lock, remote
        self.notes: list[str] = []
        """Sentences about files that were not as locked."""
        self.brought: dict[str, int] = {}
        """bytes of files that came, by their paths."""
        self._progress = progress
        self._asked: set[str] = set()
        self._bytes: dict[str, tuple[int, int]] = {}
        self._guard = threading.RLock()

    def path(self, name: str) -> Path:
        """Of a file in the folder."""
        return self.lock.folder / name

    def get(self, wanted: WantedFile) -> Path:
        """A file, brought unless it is there as locked.

        Raises
        ------
        NotInArchive
            The archive has none.
        InputError
            It can't be brought whole, or is not the one that was locked.
        """
        name, path = wanted.path, self.path(wanted.path)
        require(is_ours(name), wanted.url, f"to be called {name!r} here", "a plain name", "try another mirror")
        if name in self._asked:
            return path
        locked = self.lock.files.get(name)
        how = locked.differs(path) if locked else ""
        if how:
            self._say(f"{name} was not as fetch.lock has it ({how}), and was fetched again")
        if locked is None or how:
            self._bring(wanted, path, locked)
        self._asked.add(name)
        return path

    def get_all(self, wanted: Iterable[WantedFile]) -> None:
        """Several files, two at a time; the first error ends all, and what has come is kept."""
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            waiting = [pool.submit(self.get, file) for file in wanted]
            try:
                for done in as_completed(waiting):
                    done.result()
            except BaseException:
                self.remote.stop()
                for future in waiting:
                    future.cancel()
                raise

    def mend(self) -> None:
        """Bring again what is locked, not whole, and was not asked for: indices and grids of earlier runs."""
        rest = [(name, file) for name, file in self.lock.files.items() if name not in self._asked]
        self.get_all([WantedFile(file.url, name) for name, file in rest if file.differs(self.path(name))])

    def _bring(self, wanted: WantedFile, path: Path, locked: LockedFile | None) -> None:
        sums: list[str] = []

        def check(came: Path) -> None:
            require_content(came, wanted.path)
            sums.append(sha256_of(came))
            if locked is not None and sums[0] != locked.sha256:
                raise InputError(
                    wanted.path, f"another content (SHA-256 {sums[0][:12]}...) than fetch.lock has",
                    f"{locked.sha256[:12]}... of {locked.fetched}", "fetch into another folder to have it",
                )

        self.remote.download(
            wanted.url, path, check, limit_of(wanted.path), lambda *now: self._count(wanted.path, *now)
        )
        size, now = path.stat().st_size, datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        with self._guard:
            self.brought[wanted.path] = size
            self.lock.files[wanted.path] = LockedFile(wanted.url, size, sums[0], now)
            self.lock.write()

    def _count(self, name: str, done: int, total: int | None) -> None:
        with self._guard:
            self._bytes[name] = done, max(done, total or 0)
            self._progress(*map(sum, zip(*self._bytes.values(), strict=True)))

    def _say(self, sentence: str) -> None:
        with self._guard:
            self.notes.append(sentence)


class _Kind(NamedTuple):
    """What files of an ending are."""

    limit: int = 16_000
    """MB that one may have: ten times those of the archives, or more."""
    marks: tuple[bytes, ...] = ()
    """One of these is in it; in its beginning, where it may be large."""
    record: int = 1
    """bytes of which it is a multiple."""
    called: str = "the file"


_HEAD = 8192
_MEGA = 1_000_000
_TEXT = (64, (b"\\begindata",), 1, "a SPICE kernel, whole")
_KINDS = {
    ".bsp": _Kind(16_000, (b"DAF/SPK", b"NAIF/DAF"), 1024, "a SPICE kernel, whole"),  # NAIF/DAF: of older ones
    ".bc": _Kind(16_000, (b"DAF/CK", b"NAIF/DAF"), 1024, "a SPICE kernel, whole"),
    ".bpc": _Kind(16_000, (b"DAF/PCK", b"NAIF/DAF"), 1024, "a SPICE kernel, whole"),
    **dict.fromkeys((".tls", ".tsc", ".ti", ".tf", ".tpc"), _Kind(*_TEXT)),
    ".tm": _Kind(1, *_TEXT[1:]),
    ".b": _Kind(256, (b"PDS_VERSION_ID",), FRAME.itemsize, "a PEDR file of whole frames"),
    ".lbl": _Kind(1, (b"PDS_VERSION_ID",), 1, "a PDS3 label"),
    ".tab": _Kind(64),
    ".csv": _Kind(4_000, (b",",)),
    ".img": _Kind(record=2),
}


def _kind_of(name: str) -> _Kind:
    return _Kind() if name.startswith("images/") else _KINDS.get(Path(name).suffix.lower(), _Kind())


def limit_of(name: str) -> int:
    """Bytes that a file may have: nothing longer is brought, whether or not the archive says how long it is."""
    return _MEGA * _kind_of(name).limit


def require_content(path: Path, name: str) -> None:
    """Raise InputError unless the file at `path` is what one called `name` has to be: a kernel, an image, a PEDR, a
    label, a table or a grid.
    """
    kind, size = _kind_of(name), path.stat().st_size
    content = read_bytes(path) if kind.limit <= 64 else head_of(path, _HEAD)
    if content.lstrip()[:15].lower().startswith((b"<!doctype", b"<html", b"<?xml", b"<head")):
        raise InputError(name, "a web page instead of the file", kind.called)
    require(size != 0, name, "an empty file", kind.called)
    if size % kind.record or (kind.marks and not any(mark in content for mark in kind.marks)):
        raise InputError(name, f"{size} bytes that begin with {content[:16]!r}", kind.called)
    if name.startswith("images/"):
        _require_whole_image(path, name)


def _require_whole_image(path: Path, name: str) -> None:
    """A label at the head, and as many bytes as it says, at least."""
    label = read_label(path)
    stated = label.count("RECORD_BYTES") * label.count("FILE_RECORDS")
    if path.stat().st_size < stated:  # longer ones are whole, too: some archives pad
        raise InputError(name, f"{path.stat().st_size} bytes", f"{stated} by its own label")
