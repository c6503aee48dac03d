"""The folder that files are brought into, two at a time, each checked and entered in its lock once it is whole."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.fetch.download import Remote
from mgsgraph.fetch.lock import Lock, LockedFile, is_ours
from mgsgraph.fetch.needs import WantedFile
from mgsgraph.files.altimetry.pedr import FRAME
from mgsgraph.files.labels.image_label import read_label
from mgsgraph.files.opening import head_of, read_bytes, sha256_of

Progress = Callable[[int, int], None]
"""Called with the bytes that have come and all bytes that are known to come."""
_AT_ONCE = 2


class DownloadFolder:
    """A folder of ours, its lock, and the way to the archives."""

    def __init__(
        self, lock: Lock, remote: Remote, update: bool = False, progress: Progress = lambda done, total: None
    ) -> None:
        self.lock, self.remote = lock, remote
        self.notes: list[str] = []
        """Sentences about files that were not as locked."""
        self.brought: dict[str, int] = {}
        """bytes of files that came, by their paths."""
        self._update, self._progress = update, progress
        self._asked: set[str] = set()
        self._bytes: dict[str, tuple[int, int]] = {}
        self._guard = threading.RLock()

    def path(self, name: str) -> Path:
        """Of a file in the folder."""
        return self.lock.folder / name

    def get(self, wanted: WantedFile) -> Path:
        """A file, brought unless it is there as locked (and, to update, still the archive's).

        Raises
        ------
        NotInArchive
            The archive has none.
        InputError
            It can't be brought whole, or is not the one that was locked.
        """
        name, path = wanted.path, self.path(wanted.path)
        if not is_ours(name):
            raise InputError(wanted.url, f"to be called {name!r} here", "a plain name", "try another mirror")
        if name in self._asked:
            return path
        locked = self.lock.files.get(name)
        how = locked.differs(path) if locked else ""
        if locked is None or how or self._update:
            if how:
                self._say(f"{name} was not as fetch.lock has it ({how}), and was fetched again")
            self._bring(wanted, path, locked, whole=not how)
        self._asked.add(name)
        return path

    def get_all(self, wanted: Iterable[WantedFile]) -> None:
        """Several files, two at a time; the first error ends all, and what has come is kept."""
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            waiting = [pool.submit(self.get, one) for one in wanted]
            try:
                for done in as_completed(waiting):
                    done.result()
            except BaseException:
                self.remote.stop()
                for one in waiting:
                    one.cancel()
                raise

    def mend(self) -> None:
        """Bring again what is locked, not whole, and was not asked for: indices and grids of earlier runs."""
        rest = [(name, file) for name, file in self.lock.files.items() if name not in self._asked]
        self.get_all([WantedFile(file.url, name) for name, file in rest if file.differs(self.path(name))])

    def _bring(self, wanted: WantedFile, path: Path, locked: LockedFile | None, whole: bool) -> None:
        sums: list[str] = []

        def check(came: Path) -> None:
            require_content(came, wanted.path)
            sums.append(sha256_of(came))
            if locked is not None and not self._update and sums[0] != locked.sha256:
                raise InputError(
                    wanted.path, f"another content (SHA-256 {sums[0][:12]}...) than fetch.lock has",
                    f"{locked.sha256[:12]}... of {locked.fetched}", "--update takes what the archive has now",
                )

        # another server's ETag and date say nothing of this one's file
        known = locked.source if locked is not None and whole and locked.url == wanted.url else None
        came = self.remote.download(wanted.url, path, check, limit_of(wanted.path),
                                    lambda *now: self._count(wanted.path, *now), known)  # fmt: skip
        if came is None:  # the archive still has what is here
            return
        size, now = path.stat().st_size, datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        with self._guard:
            self.brought[wanted.path] = size
            self.lock.files[wanted.path] = LockedFile(wanted.url, size, sums[0], now, came.etag, came.modified)
            self.lock.write()
        if self._update and locked is not None and locked.sha256 != sums[0]:
            self._say(f"{wanted.path} has changed at the archive since {locked.fetched}")

    def _count(self, name: str, done: int, total: int | None) -> None:
        with self._guard:
            self._bytes[name] = done, max(done, total or 0)
            self._progress(*map(sum, zip(*self._bytes.values(), strict=True)))

    def _say(self, sentence: str) -> None:
        with self._guard:
            self.notes.append(sentence)


_MEGA = 1_000_000
_LIMITS = {".lbl": 1, ".tm": 1, ".tab": 64, ".tls": 64, ".tsc": 64, ".ti": 64, ".tf": 64, ".tpc": 64, ".b": 256,
           ".csv": 4_000}  # fmt: skip
"""MB that a file may have, by its ending; ten times those of the archives, or more."""
_LARGEST = 16_000
"""MB of images, grids and binary kernels."""


def limit_of(name: str) -> int:
    """Bytes that a file may have: nothing longer is brought, whether or not the archive says how long it is."""
    return _MEGA * _LIMITS.get(Path(name).suffix.lower(), _LARGEST)


_HEAD = 8192
_RECORD = 1024
"""bytes of a record of SPICE's binary kernels."""
_BINARY = {
    ".bsp": (b"DAF/SPK", b"NAIF/DAF"), ".bc": (b"DAF/CK", b"NAIF/DAF"), ".bpc": (b"DAF/PCK", b"NAIF/DAF"),
}  # fmt: skip
"""Beginnings of SPICE's binary kernels; NAIF/DAF is the older one."""
_TEXT = (".tls", ".tsc", ".ti", ".tf", ".tpc", ".tm")


def require_content(path: Path, name: str) -> None:
    """Raise InputError unless the file at `path` is what one called `name` has to be: a kernel, an image, a PEDR, a
    label, a table or a grid.
    """
    head = head_of(path, _HEAD)
    size, suffix = path.stat().st_size, Path(name).suffix.lower()
    if head.lstrip()[:15].lower().startswith((b"<!doctype", b"<html", b"<?xml", b"<head")):
        raise InputError(name, "a web page instead of the file", _expected(suffix))
    if size == 0:
        raise InputError(name, "an empty file", _expected(suffix))
    sound = True
    if suffix in _BINARY:
        sound = head.startswith(_BINARY[suffix]) and size % _RECORD == 0
    elif suffix in _TEXT:
        sound = b"\\begindata" in read_bytes(path)
    elif suffix == ".b":
        sound = b"PDS_VERSION_ID" in head and size % FRAME.itemsize == 0
    elif suffix == ".lbl":
        sound = b"PDS_VERSION_ID" in head
    elif name.startswith("images/"):
        _require_whole_image(path, name)
    elif suffix == ".csv":
        sound = b"," in head and head.count(b"\n") > 0
    elif suffix == ".img":
        sound = size % 2 == 0
    if not sound:
        raise InputError(name, f"{size} bytes that begin with {head[:16]!r}", _expected(suffix))


def _expected(suffix: str) -> str:
    if suffix in _BINARY or suffix in _TEXT:
        return "a SPICE kernel, whole"
    return {".b": "a PEDR file of whole frames", ".lbl": "a PDS3 label"}.get(suffix, "the file")


def _require_whole_image(path: Path, name: str) -> None:
    """A label at the head, and as many bytes as it says, at least."""
    label = read_label(path)
    said = label.count("RECORD_BYTES") * label.count("FILE_RECORDS")
    if path.stat().st_size < said:  # longer ones are whole, too: some archives pad
        raise InputError(name, f"{path.stat().st_size} bytes", f"{said} by its own label")
