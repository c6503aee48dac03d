"""A file that has come in part: NAME.part, and beside it NAME.part.json with what the archive said of the whole.

Whatever lies at these names, no link is followed, and no file is taken up or written to that has another name, too.
"""

import errno
import json
import os
import shutil
import stat
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.opening import read_json

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
