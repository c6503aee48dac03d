"""Files out of an archive over HTTP: taken up where they broke off (RFC 9110: Range, If-Range), tried again, checked.

What is done of a fault: a cut connection, a stalled one, too few bytes, 429 and 5xx are tried again with growing waits,
from the byte where it broke off; any byte more begins the count of tries anew. Content that has changed meanwhile, or a
server that ignores Range, means to begin anew. All else (404, an endless redirect, a certificate) is an error at once.
Redirects lead to http and https, not from https to http.

What has come in part is in NAME.part, which ends with the command: another one brings the file anew.
"""

import errno
import re
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import urljoin

from mgsgraph.errors import InputError, printable
from mgsgraph.fetch.needs import require_address
from mgsgraph.files.opening import ANY_SIZE
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
_NOT_THERE = (404, 410)
_NOTHING_MORE = 416
"""Status of a file that ends before the byte asked for."""
_REDIRECTS = 10
"""Followed at the most."""
_LONGEST_PAGE = 1 << 22
"""bytes of a listing that are looked at."""
_SPARE = 1 << 20
"""bytes that stay free on the disk."""


@dataclass(frozen=True, slots=True)
class RemoteSource:
    """What an archive says of a file."""

    total: int | None
    """bytes; None where it doesn't say."""
    etag: str
    """Its ETag; empty where there is none."""
    modified: str
    """Its Last-Modified; empty where there is none."""

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
    """Grows to the file at `path`, by several attempts where the archive's content can be known again."""

    def __init__(self, path: Path) -> None:
        self.path, self.file = path, path.with_name(f"{path.name}.part")
        self.source: RemoteSource | None = None
        self.size = 0
        """Bytes that are there."""

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
            self.file.unlink(missing_ok=True)
            self.file.touch(exist_ok=False)  # new, so that no link is written through
        except OSError as error:
            raise self._refusal(error) from None
        self.source, self.size = source, 0

    def add(self, more: bytes) -> None:
        """Bytes that follow on those that are there."""
        try:
            with self.file.open("ab") as file:
                file.write(more)
        except OSError as error:
            raise self._refusal(error) from None
        self.size += len(more)

    def finish(self) -> None:
        """Let it take the file's place."""
        try:
            self.file.replace(self.path)
        except OSError as error:
            raise self._refusal(error) from None

    def discard(self) -> None:
        """Forget what is there."""
        self.source, self.size = None, 0
        with suppress(OSError):
            self.file.unlink(missing_ok=True)

    def _refusal(self, error: OSError) -> InputError:
        space = "free some space, or " if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        remedy = f"{space}choose another --out; files that have come are kept"
        return InputError(str(self.path), f"can't be written ({error.strerror or error})", remedy=remedy)


class Refused(InputError):
    """An answer that means no, however often one asks."""


class NotInArchive(Refused):
    """A file that the archive says it doesn't have."""


class Stopped(Exception):
    """Another download has failed, or the user has interrupted: this one shall end."""


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
    """Something that may go better next time; `after` s the server asks to be left alone."""

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
        """Let all that is under way in other threads end with Stopped, at once even where no bytes come."""
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
            Where to; its folder is made. What has come lies beside it as NAME.part.
        check : callable
            Looks at the whole NAME.part; what it raises ends the download.
        limit : int
            bytes that the file may have, announced or not.
        progress : callable
            Called as bytes come.

        Raises
        ------
        InputError
            NotInArchive where there is no such file; everything else, one line.
        """
        part = PartialFile(path)
        try:
            self._persist(url, lambda: self._attempt(url, part, limit, progress), lambda: part.size)
            with _said_of(url):
                check(part.file)
            part.finish()
        except BaseException:
            part.discard()
            raise

    # --- one try

    def _attempt(self, url: str, part: PartialFile, limit: int, progress: ByteProgress) -> None:
        if part.source is not None and part.source.total is not None and part.size >= part.source.total:
            if part.whole:
                return
            part.discard()
        with self._answer(url, part.wanted()) as answer:
            said = _source(answer)
            if answer.status_code == _NOTHING_MORE:
                part.discard()
                raise _Trouble("it is shorter than was announced before")
            if said.total is not None and said.total > limit:
                raise _too_long(url, f"{said.total / 1e6:.0f} MB", limit)
            if answer.status_code != 206:
                part.begin(said)
            elif part.source is None or not part.source.same_content(said) or _first(answer) != part.size:
                part.discard()
                raise _Trouble("its content has changed while it was being fetched")
            size = part.size
            progress(size, said.total)
            for piece in _pieces(answer):
                if self._stop.is_set():
                    raise Stopped
                size += len(piece)
                if size > (limit if said.total is None else said.total):
                    part.discard()
                    if said.total is None:
                        raise _too_long(url, "no end", limit)
                    raise _Trouble(f"more bytes came than the {said.total} that were announced")
                part.add(piece)
                progress(size, said.total)
        if not part.whole:
            raise _Trouble(f"{part.size} bytes came of {said.total} that were announced")

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
        remedy = "the same command brings what is missing: try later, or another mirror"
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


@contextmanager
def _said_of(url: str) -> Iterator[None]:
    """What is wrong with a file that has come is said with its address."""
    try:
        yield
    except InputError as error:
        raise InputError(url, error.found, error.expected, error.remedy or _ELSEWHERE) from None


def _too_long(url: str, found: str, limit: int) -> InputError:
    return InputError(url, f"a file of {found}", f"at most {limit / 1e6:.0f} MB of one of its kind", _ELSEWHERE)


def _require_content(url: str, answer: "requests.Response") -> None:
    """Raise _Trouble or InputError unless the answer is a file, or a part of one."""
    status = f"{answer.status_code} {answer.reason}".strip()
    if answer.status_code in _NOT_THERE:
        raise NotInArchive(url, f"not there ({status})", remedy="check the mirror, or the archive's own pages")
    if answer.status_code in _LATER:
        raise _Trouble(f"the server says {status}", _count(answer.headers.get("Retry-After", "")) or 0.0)
    if answer.status_code not in (200, 206, _NOTHING_MORE):
        raise Refused(url, f"the server says {status}", "the file", _ELSEWHERE)
    if answer.headers.get("Content-Encoding", "identity").lower() not in ("identity", ""):
        raise InputError(url, f"sent as {answer.headers['Content-Encoding']}", "the file as it is", _ELSEWHERE)


def _source(answer: "requests.Response") -> RemoteSource:
    """What the answer says of the whole file."""
    headers = answer.headers
    length = headers.get("Content-Length", "")
    if answer.status_code == 206:  # bytes 10-99/100
        length = headers.get("Content-Range", "").rpartition("/")[2]
    return RemoteSource(_count(length), headers.get("ETag", ""), headers.get("Last-Modified", ""))


def _pieces(answer: "requests.Response") -> Iterator[bytes]:
    """Content as it comes: of what broke off nothing is lost that had arrived (as it would be in larger reads)."""
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
    found = b""
    for piece in _pieces(answer):
        found += piece
        if len(found) >= count:
            break
    return found[:count]


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
    while inner := [one for one in (getattr(reason, "reason", None), *getattr(reason, "args", ()))
                    if isinstance(one, Exception)]:  # fmt: skip
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
