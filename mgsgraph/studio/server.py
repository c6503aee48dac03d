"""The studio's server: a page and its addresses on this machine alone, for browsers that have access.

Addresses under other host names (a page elsewhere that resolves to this machine) and changes from other origins are
refused. Nothing is asked of the network.
"""

import asyncio
import secrets
import socket
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from contextlib import closing, suppress
from mimetypes import guess_type
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h11
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.files.opening import read_bytes
from mgsgraph.studio.changes import EditLock
from mgsgraph.studio.figures import load_figures
from mgsgraph.studio.lists import compute_at_once, table
from mgsgraph.studio.map_points import map_points, scene_record
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.routes import BROWSER, Views, routes
from mgsgraph.studio.start import verdict_record, worst_record
from mgsgraph.studio.work import Work

PAGE = Path(__file__).parent / "page"
HOST = "127.0.0.1"
_COOKIE = "mgsgraph_studio_{}"
"""Name of the cookie; cookies know no ports, and two studios may run."""
_ENTRANCE = '<!doctype html><title>mgsgraph studio</title><script src="/page/enter.js" data-secret="{}"></script>'
FORWARD = '<!doctype html><title>mgsgraph studio</title><meta http-equiv="refresh" content="0;url={}">'
_LOOK, _PATIENCE = 0.5, 2.0
"""s between two looks for something to prepare, and for which its end is waited for."""
_TURN = 5e-4
"""s after which a thread that computes lets others answer: they would wait for it ten times as long, several times."""
IDLE = 12 * 3600.0
"""s without a request, after which the command ends."""
_SECONDS: dict[object, float] = {h11.IDLE: 10.0, h11.SEND_BODY: 30.0}
"""s, time for the headers of a request and for its body."""
_MOST_CONNECTIONS = 200
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
                               "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}  # fmt: skip


class Access:
    """Who may ask: a browser enters with a token, which is printed and works once; then it sends a cookie and a secret.

    The cookie alone shows the page, which holds nothing: browsers send it to every port of this machine. The secret
    stays with the page, in a storage that pages of other ports can't read.

    Parameters
    ----------
    port : int
        Of the server.
    entered : callable
        Called with the next address when one has been used.
    """

    def __init__(self, port: int, entered: Callable[[str], Any]) -> None:
        self.host, self._entered = f"{HOST}:{port}", entered
        self._cookie_name = _COOKIE.format(port)
        self._cookie, self._secret, self._token = (secrets.token_urlsafe(24) for _ in range(3))
        self.last = time.monotonic()
        """s, time of the last request that was answered."""

    @property
    def address(self) -> str:
        """Where a browser enters, once."""
        return f"http://{self.host}/?token={self._token}"

    def refusal(self, request: Request) -> Response | None:
        """Answer to a request that is refused, or enters; None for others."""
        path = request.scope["path"]
        if request.headers.get("host", "") != self.host:
            return PlainTextResponse(f"Ask for this page at {HOST}.", 421)
        if request.method != "GET" and request.headers.get("origin") != f"http://{self.host}":
            return PlainTextResponse("Changes come from the studio's own page alone.", 403)
        if path == "/" and _same(request.query_params.get("token", ""), self._token):
            self._token = secrets.token_urlsafe(24)
            with suppress(OSError):  # nobody reads what the command prints
                self._entered(self.address)
            answer = HTMLResponse(_ENTRANCE.format(self._secret), headers={"Cache-Control": "no-store"})
            answer.set_cookie(self._cookie_name, self._cookie, httponly=True, samesite="strict")
            return answer
        known = path == "/" or path.startswith("/page/") or _same(request.headers.get("x-secret", ""), self._secret)
        if not (known and _same(request.cookies.get(self._cookie_name, ""), self._cookie)):
            sentence = "This studio does not know the browser: open the address that the command has printed last."
            return PlainTextResponse(sentence, 403)
        self.last = time.monotonic()
        return None


def _same(text: str, secret: str) -> bool:
    return secrets.compare_digest(text.encode(), secret.encode())


def application(opened: Opened, access: Access, work: Work) -> Starlette:
    """The server's application, which shows what is opened to those who have access."""
    files = {file.name: read_bytes(file) for file in PAGE.iterdir()}

    async def index(_: Request) -> Response:  # answered at once, without a thread
        return HTMLResponse(files["index.html"], headers={"Cache-Control": "no-store"})

    async def of_page(request: Request) -> Response:
        data = files.get(name := request.path_params["name"])
        return Response(data, 404 if data is None else 200, media_type=guess_type(name)[0])

    def error(request: Request, exception: Exception) -> Response:
        # the page shows it; for any other status a browser would write a line of its own to its console
        return JSONResponse({"error": str(exception)}, 200 if BROWSER in request.headers else 400)

    def memory(_: Request, exception: Exception) -> Response:
        return JSONResponse({"error": "out of memory; close other programs, or show a part of the block"}, 503)

    return Starlette(
        routes=[Route("/", index), *routes(opened, Views(opened), EditLock(), work), Route("/page/{name}", of_page)],
        middleware=[Middleware(_Guard, access=access), Middleware(GZipMiddleware, minimum_size=2000, compresslevel=1)],
        exception_handlers={MgsgraphError: error, MemoryError: memory},
    )


class _Guard:
    """Passes requests of browsers that have access."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._access.refusal(Request(scope)) if scope["type"] == "http" else None
        await (refusal or self._app)(scope, receive, _with_headers(send))


class _Timed(H11Protocol):
    """Connections that are closed where a request does not come whole in time, or where there are too many."""

    _state: object = None
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        super().connection_made(transport)
        if len(self.connections) > _MOST_CONNECTIONS:
            transport.abort()
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._watch()

    def _watch(self) -> None:
        """Begin to wait for headers or a body; what is waited for already has its time."""
        if self.conn.their_state is self._state:
            return
        self._state = self.conn.their_state
        if self._timer is not None:
            self._timer.cancel()
        seconds = _SECONDS.get(self._state)
        self._timer = None if seconds is None else self.loop.call_later(seconds, self.transport.abort)


def _with_headers(send: Send) -> Callable[[Message], Awaitable[None]]:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *((k.lower().encode(), v.encode()) for k, v in _HEADERS.items())]
        await send(message)

    return sending


def listening(port: int | None) -> socket.socket:
    """A socket of this machine alone, at a port or at any free one; InputError where that is taken."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port or 0))
    except OSError as error:
        listener.close()
        raise InputError("--port", f"{port}: {error.strerror}", "a free port", "leave --port out for any") from None
    listener.listen(64)
    return listener


def serve(
    opened: Opened, port: int | None, announce: Callable[[str], Any], show: Callable[[str], Any] | None = None,
    folder: Path | None = None,
) -> None:  # fmt: skip
    """Serve until an interrupt, or 12 hours without a request.

    Parameters
    ----------
    opened : Opened
    port : int, optional
        Any free one when absent.
    announce : callable
        Called with each address that works once.
    show : callable, optional
        Opens a page in a browser. It is a file for this user alone, which leads to the address: other users see the
        command line of a browser.
    folder : Path, optional
        Files that may be added to a project are in it.
    """
    sys.setswitchinterval(_TURN)
    work = Work(opened, folder)
    with closing(listening(port)) as place, TemporaryDirectory(prefix="mgsgraph-studio-") as own:
        page = Path(own) / "studio.html"

        def entered(address: str) -> None:
            page.unlink(missing_ok=True)
            announce(address)

        access = Access(place.getsockname()[1], entered)
        server = uvicorn.Server(uvicorn.Config(
            application(opened, access, work), http=_Timed, ws="none", log_level="error", access_log=False,
            timeout_graceful_shutdown=2,
        ))  # fmt: skip
        announce(access.address)
        if show is not None:
            page.touch(0o600)
            page.write_text(FORWARD.format(access.address), encoding="utf-8")
            show(page.as_uri())
        # while a browser starts, its first answers are prepared
        ended = threading.Event()
        preparing = threading.Thread(target=prepare, args=(opened, ended), daemon=True)
        preparing.start()
        threading.Thread(target=end_when_idle, args=(server, access), daemon=True).start()
        try:
            server.run(sockets=[place])  # a job ends with this process (`work`)
        finally:
            ended.set()
            preparing.join(_PATIENCE)


def end_when_idle(server: uvicorn.Server, access: Access) -> None:
    """Wait until no request has come for long, and end the server."""
    while (left := access.last + IDLE - time.monotonic()) > 0.0:
        time.sleep(left)
    server.should_exit = True


def prepare(opened: Opened, ended: threading.Event) -> None:
    """Compute what a page asks for first, then what it needs for the first list, change and figure, and for the next
    change after one of another process; one thing after the other, until the studio ends.
    """
    for make in (
        lambda: scene_record(opened), lambda: map_points(opened).value("sigma"), opened.footprints,
        lambda: table(opened, "points"), lambda: opened.once("worst", lambda: worst_record(opened)),
        lambda: opened.once("verdict", lambda: verdict_record(opened)), opened.prepare_change,
        lambda: compute_at_once(opened), load_figures,
    ):  # fmt: skip
        if ended.is_set():
            return
        with suppress(MgsgraphError):  # the request for it reports the error
            make()
    while not ended.wait(_LOOK):
        with suppress(MgsgraphError):
            opened.prepare_change()
