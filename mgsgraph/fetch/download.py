"""Files out of an archive over HTTP: taken up where they broke off (RFC 9110: Range, If-Range), tried again, checked.

What is done of a fault: a cut connection, a stalled one, too few bytes, 429 and 5xx are tried again with growing waits,
from the byte where it broke off; any byte more begins the count of tries anew. Content that has changed meanwhile, or a
server that ignores Range, means to begin anew. All else (404, an endless redirect, a certificate) is an error at once.
Redirects lead to http and https, not from https to http.

What has come in part is in NAME.part, and beside it NAME.part.json has what the archive said of the whole. Whatever
lies at these two, no link is followed, and no file is taken up or written to that has another name, too.
"""

import errno
import json
import os
import re
import shutil
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import urljoin

from mgsgraph.atomic_write import put_file
from mgsgraph.errors import InputError, printable
from mgsgraph.fetch.needs import require_address
from mgsgraph.files.opening import ANY_SIZE, read_json
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    import requests

T = TypeVar("T")
Check = Callable[[Path], None]
"""Raises InputError when a file that has come is not what it should be."""
ByteProgress = Callable[[int, int | None], None]
"""Called with the bytes that are there and all bytes, where these are known."""

_ELSEWHERE = "try later, or another mirror"
_PIECE = 1 << 16
"""bytes read at a time, at the most."""
_LATER = (429, 500, 502, 503, 504)
"""Statuses of a server that may do better later."""
_MISSING = (404, 410)
_NOTHING_MORE = 416
"""Status of a file that ends before the byte asked for."""
_REDIRECTS = 10
"""Followed at the most."""
_LONGEST_PAGE = 1 << 22
"""bytes of a listing that are looked at."""
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
    """An archive's statements about a file."""

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
        texts = all(isinstance(text, str) for text in (self.url, self.etag, self.modified))
        return texts and (self.total is None or (type(self.total) is int and self.total >= 0))

    @property
    def validator(self) -> str:
        """By what If-Range knows the content again: a strong ETag, or the date; empty for neither."""
        return self.etag if self.etag and not self.etag.startswith("W/") else self.modified

    def same_content(self, other: "RemoteSource") -> bool:
        """Whether the other is the same content, as far as both say."""
        return all(
            not own or not theirs or own == theirs
            for own, theirs in ((self.etag, other.etag), (self.modified, other.modified), (self.total, other.total))
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
        """Begin again with an empty file."""
        with self._writing():
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
        self.source = source

    def add(self, more: bytes) -> None:
        """Bytes that follow on those that are there."""
        with self._writing():
            _write(self.file, os.O_APPEND, more)

    def finish(self) -> None:
        """Move it to the file's place."""
        with self._writing():
            put_file(self.file, self.path)
            self._said.unlink(missing_ok=True)

    def discard(self) -> None:
        """Delete the partial file."""
        self.source = None
        with self._writing():
            self.file.unlink(missing_ok=True)
            self._said.unlink(missing_ok=True)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """InputError in place of the system's error."""
        try:
            yield
        except OSError as error:
            space = "free some space, or " if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
            remedy = f"{space}choose another --out; what has come is kept"
            raise InputError(str(self.path), f"can't be written ({error.strerror or error})", remedy=remedy) from None


class Refused(InputError):
    """An answer that is final: another try is useless."""


class NotInArchive(Refused):
    """A file that the archive says it doesn't have."""


class Stopped(Exception):
    """Another download failed, or the user interrupted: this download ends."""


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How long an archive is waited for; s."""

    tries: int = 6
    """In a row without a byte more."""
    first_wait: float = 1.0
    """Before the second try; each further wait is twice as long."""
    longest_wait: float = 60.0
    connecting: float = 15.0
    """Until a connection stands."""
    reading: float = 30.0
    """Without a byte on one that does."""


class _Trouble(Exception):
    """An error that may pass; the server asks to wait `after` s."""

    def __init__(self, found: str, after: float = 0.0) -> None:
        super().__init__(found)
        self.found, self.after = found, after


class Remote:
    """Archives over HTTP; may be used from several threads at once."""

    def __init__(self, retry: RetryPolicy | None = None, say: Callable[[str], None] = no_progress) -> None:
        """`say` is called, with a sentence, on every wait before something is tried again."""
        _require_requests()
        self._retry = retry or RetryPolicy()
        self._mine = threading.local()
        self._sessions: list[requests.Session] = []
        self._stop = threading.Event()
        self._open: set[requests.Response] = set()
        self._say = say

    def close(self) -> None:
        """Close all connections."""
        for session in self._sessions:
            session.close()

    def stop(self) -> None:
        """Let all that is under way in other threads end with Stopped, at once even where no bytes come; what has come
        is kept.
        """
        self._stop.set()
        for answer in tuple(self._open):
            with suppress(OSError, ValueError, RuntimeError):  # has ended meanwhile, or its connection is free again
                answer.raw.shutdown()

    def head(self, url: str, count: int) -> bytes:
        """The first bytes of a file, as many as there are up to `count`; NotInArchive where there is none."""

        def ask() -> bytes:
            with self._answer(url, {"Range": f"bytes=0-{count - 1}"}) as answer:
                return b"" if answer.status_code == _NOTHING_MORE else _up_to(answer, count)

        return self._persist(url, ask)

    def listing(self, url: str) -> str:
        """The page at the address of a folder; empty where there is none, or none for us."""

        def ask() -> str:
            with self._answer(url, {}) as answer:
                return _up_to(answer, _LONGEST_PAGE).decode("latin-1")

        try:
            return self._persist(url, ask)
        except Refused:
            return ""

    def download(
        self, url: str, path: Path, check: Check, limit: int = ANY_SIZE,
        progress: ByteProgress = no_progress,
    ) -> None:
        """Bring a file; it takes its place at `path` when it is whole and `check` has nothing against it.

        Parameters
        ----------
        url : str
        path : Path
            Where to; its folder is made. What has come lies beside it as NAME.part until it is whole.
        check : callable
            Looks at the whole NAME.part; what it raises ends the download, and the part is forgotten.
        limit : int
            bytes that the file may have, announced or not.
        progress : callable
            Called as bytes come.

        Raises
        ------
        InputError
            NotInArchive where there is no such file; everything else, one line.
        """
        part = PartialFile(path, url)
        self._persist(url, lambda: self._attempt(url, part, limit, progress), lambda: part.size)
        try:
            check(part.file)
        except InputError as error:
            part.discard()
            raise InputError(url, error.found, error.expected, error.remedy or _ELSEWHERE) from None
        part.finish()

    # --- one try

    def _attempt(self, url: str, part: PartialFile, limit: int, progress: ByteProgress) -> None:
        if part.source is not None and part.source.total is not None and part.size >= part.source.total:
            if part.whole:
                return
            part.discard()
        with self._answer(url, part.wanted()) as answer:
            stated = _source(url, answer)
            if answer.status_code == _NOTHING_MORE:
                part.discard()
                raise _Trouble("it is shorter than was announced before")
            if stated.total is not None and stated.total > limit:
                raise _too_long(url, f"{stated.total / 1e6:.0f} MB", limit)
            if answer.status_code != 206:
                part.begin(stated)
            elif part.source is None or not part.source.same_content(stated) or _first(answer) != part.size:
                part.discard()
                raise _Trouble("its content has changed while it was being fetched")
            size = part.size
            progress(size, stated.total)
            for piece in _pieces(answer):
                if self._stop.is_set():
                    raise Stopped
                size += len(piece)
                if size > (limit if stated.total is None else stated.total):
                    part.discard()
                    if stated.total is None:
                        raise _too_long(url, "no end", limit)
                    raise _Trouble(f"more bytes came than the {stated.total} that were announced")
                part.add(piece)
                progress(size, stated.total)
        if not part.whole:
            raise _Trouble(f"{part.size} bytes came of {stated.total} that were announced")

    @contextmanager
    def _answer(self, url: str, headers: Mapping[str, str]) -> Iterator["requests.Response"]:
        """The archive's answer, of a status that means content; all that can go wrong in words."""
        with self._followed(url, headers) as answer:
            _require_content(url, answer)
            self._open.add(answer)
            try:
                yield answer
            finally:
                self._open.discard(answer)

    def _followed(self, url: str, headers: Mapping[str, str]) -> "requests.Response":
        """The answer at an address, or where redirects lead from there; nothing of these' own content is read."""
        address = url
        for _ in range(_REDIRECTS + 1):
            answer = self._asked(url, address, headers)
            if not answer.is_redirect:
                return answer
            answer.close()
            address = _led_to(url, address, answer.headers["Location"])
        raise InputError(url, f"more than {_REDIRECTS} redirects", "a file", _ELSEWHERE)

    def _asked(self, url: str, address: str, headers: Mapping[str, str]) -> "requests.Response":
        """What one address answers."""
        import requests
        import urllib3

        retry = self._retry
        try:
            return self._session().get(
                address, headers=dict(headers), stream=True, timeout=(retry.connecting, retry.reading)
            )
        except requests.exceptions.SSLError as error:
            raise InputError(url, f"its certificate can't be trusted ({_words(error)})", remedy=_ELSEWHERE) from None
        except requests.Timeout:
            raise _Trouble("no answer came") from None
        except requests.ConnectionError as error:
            raise _Trouble(f"it can't be reached ({_words(error)})") from None
        except (requests.RequestException, urllib3.exceptions.HTTPError, ValueError) as error:
            raise InputError(url, f"it can't be asked ({_words(error)})", remedy=_ELSEWHERE) from None

    def _session(self) -> "requests.Session":
        """One for each thread: sessions are not to be shared."""
        import requests

        session: requests.Session | None = getattr(self._mine, "session", None)
        if session is None:
            session = requests.Session()
            session.get_redirect_target = lambda answer: None  # type: ignore[assignment, method-assign]
            session.headers["User-Agent"] = f"mgsgraph/{version('mgsgraph')}"
            session.headers["Accept-Encoding"] = "identity"
            self._mine.session = session
            self._sessions.append(session)
        return session

    # --- many tries

    def _persist(self, url: str, attempt: Callable[[], T], reached: Callable[[], int] = lambda: 0) -> T:
        """Try until it is done, or until `tries` in a row have brought nothing."""
        failures, best = 0, reached()
        while True:
            try:
                return attempt()
            except _Trouble as trouble:
                now = reached()
                failures, best = (0, now) if now > best else (failures + 1, best)
                self._wait(url, trouble, failures)

    def _wait(self, url: str, trouble: _Trouble, failures: int) -> None:
        retry = self._retry
        remedy = "the same command goes on where it was: try later, or another mirror"
        if failures >= retry.tries:
            raise InputError(url, f"{trouble.found}, {failures} times in a row", remedy=remedy)
        if trouble.after > retry.longest_wait:
            raise InputError(url, f"{trouble.found}, and it asks to come back in {trouble.after:.0f} s", remedy=remedy)
        seconds = max(trouble.after, retry.first_wait * 2.0 ** max(0, failures - 1))
        seconds = min(seconds, retry.longest_wait)
        self._say(printable(f"{url}: {trouble.found}; tried again in {seconds:.0f} s"))
        if self._stop.wait(seconds):
            raise Stopped


def _require_requests() -> None:
    try:
        import requests  # noqa: F401
    except ImportError:
        found, remedy = "the package requests is not installed", "pip install 'mgsgraph[fetch]'"
        raise InputError("fetch", found, remedy=remedy) from None


def _too_long(url: str, found: str, limit: int) -> InputError:
    return InputError(url, f"a file of {found}", f"at most {limit / 1e6:.0f} MB of one of its kind", _ELSEWHERE)


def _require_content(url: str, answer: "requests.Response") -> None:
    """Raise _Trouble or InputError unless the answer is a file, or a part of one."""
    status = f"{answer.status_code} {answer.reason}".strip()
    if answer.status_code in _MISSING:
        raise NotInArchive(url, f"not there ({status})", remedy="check the mirror, or the archive's own pages")
    if answer.status_code in _LATER:
        raise _Trouble(f"the server says {status}", _count(answer.headers.get("Retry-After", "")) or 0.0)
    if answer.status_code not in (200, 206, _NOTHING_MORE):
        raise Refused(url, f"the server says {status}", "the file", _ELSEWHERE)
    if answer.headers.get("Content-Encoding", "identity").lower() not in ("identity", ""):
        raise InputError(url, f"sent as {answer.headers['Content-Encoding']}", "the file as it is", _ELSEWHERE)


def _source(url: str, answer: "requests.Response") -> RemoteSource:
    """What the answer says of the whole file."""
    headers = answer.headers
    length = headers.get("Content-Length", "")
    if answer.status_code == 206:  # bytes 10-99/100
        length = headers.get("Content-Range", "").rpartition("/")[2]
    return RemoteSource(url, _count(length), headers.get("ETag", ""), headers.get("Last-Modified", ""))


def _pieces(answer: "requests.Response") -> Iterator[bytes]:
    """Content as it comes: all bytes that arrived before an interruption are kept (larger reads would lose some)."""
    from urllib3.exceptions import HTTPError, ReadTimeoutError

    try:
        while piece := answer.raw.read1(_PIECE, decode_content=False):
            yield piece
    except ReadTimeoutError:
        raise _Trouble("nothing more came") from None
    except HTTPError:
        raise _Trouble("the connection was cut") from None


def _up_to(answer: "requests.Response", count: int) -> bytes:
    """The first bytes of an answer's content."""
    content = b""
    for piece in _pieces(answer):
        content += piece
        if len(content) >= count:
            break
    return content[:count]


def _first(answer: "requests.Response") -> int | None:
    """First byte of a part of a file, by Content-Range."""
    start = answer.headers.get("Content-Range", "").removeprefix("bytes").strip().partition("-")[0]
    return _count(start)


def _count(text: str) -> int | None:
    """A number of bytes, or of seconds; None for anything else."""
    return int(text) if re.fullmatch(r"\s*[0-9]{1,18}\s*", text) else None


def _words(error: Exception) -> str:
    """The innermost reason of an exception of requests, in a few words."""
    reason: object = error
    while inner := [cause for cause in (getattr(reason, "reason", None), *getattr(reason, "args", ()))
                    if isinstance(cause, Exception)]:  # fmt: skip
        reason = inner[0]
    text = getattr(reason, "strerror", None) or str(reason)
    return " ".join(str(text).rpartition(": ")[2].split())[:120]


def _led_to(url: str, address: str, location: str) -> str:
    """The address that a redirect of another one leads to (`url` was asked for); InputError where it is none of http or
    https, or leads from https to http.
    """
    try:
        to = urljoin(address, location)
    except ValueError:
        raise InputError(url, f"redirected to {location!r}", "an address", _ELSEWHERE) from None
    require_address(to.partition("?")[0].partition("#")[0], f"{url}, redirected")
    if address.startswith("https:") and not to.startswith("https:"):
        raise InputError(url, f"redirected to {to}, which is not encrypted", "https", _ELSEWHERE)
    return to
