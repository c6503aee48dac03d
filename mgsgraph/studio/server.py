"""The studio's server: a page and its addresses on this machine alone, for whoever has the token.

The token comes with the first address and stays in a cookie that scripts of other pages can't send; addresses under
other host names (a page elsewhere that resolves to this machine) and changes from other origins are refused. Nothing is
asked of the network.
"""

import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.studio.changes import EditLock
from mgsgraph.studio.map_points import map_points, scene_record
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.routes import BROWSER, Views, routes

PAGE = Path(__file__).parent / "page"
HOST = "127.0.0.1"
_COOKIE = "mgsgraph_studio_{}"
"""Name of the cookie; cookies know no ports, and two studios may run."""
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
                               "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}  # fmt: skip


def application(opened: Opened, token: str, port: int) -> Starlette:
    """The server's application.

    Parameters
    ----------
    opened : Opened
        What it shows.
    token : str
        Secret that a browser has to send.
    port : int
        Of the server.
    """

    def index(_: Request) -> Response:
        return FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-store"})

    def error(request: Request, exception: Exception) -> Response:
        # the page shows it; for any other status a browser would write a line of its own to its console
        return JSONResponse({"error": str(exception)}, 200 if BROWSER in request.headers else 400)

    def memory(_: Request, exception: Exception) -> Response:
        return JSONResponse({"error": "out of memory; close other programs, or show a part of the block"}, 503)

    addresses: list[Route | Mount] = [
        Route("/", index), *routes(opened, Views(opened), EditLock()), Mount("/page", StaticFiles(directory=PAGE)),
    ]  # fmt: skip
    return Starlette(
        routes=addresses,
        middleware=[Middleware(_Guard, token=token, port=port), Middleware(GZipMiddleware, minimum_size=2000)],
        exception_handlers={MgsgraphError: error, MemoryError: memory},
    )


class _Guard:
    """Passes requests of this machine's browser that have the token."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app, self._token, self._cookie = app, token, _COOKIE.format(port)
        self._hosts = {f"{host}:{port}" for host in (HOST, "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        refusal = self._refusal(request)
        if refusal is not None:
            await refusal(scope, receive, _with_headers(send))
            return
        await self._app(scope, receive, _with_headers(send))

    def _refusal(self, request: Request) -> Response | None:
        """Answer to a request that is refused; None for others."""
        if request.headers.get("host", "") not in self._hosts:
            return PlainTextResponse(f"Ask for this page at {HOST}.", 421)
        origin = request.headers.get("origin")
        if request.method != "GET" and (origin is None or urlsplit(origin).netloc not in self._hosts):
            return PlainTextResponse("Changes come from the studio's own page alone.", 403)
        token = request.query_params.get("token")
        if request.url.path == "/" and token is not None and self._is_token(token):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._cookie, self._token, httponly=True, samesite="strict")
            return answer
        if not self._is_token(request.cookies.get(self._cookie, "")):
            return PlainTextResponse(
                "This studio needs its token: open the address that the command has printed.", 403
            )
        return None

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode(), self._token.encode())


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


def serve(opened: Opened, port: int | None, ready: Callable[[str], Any]) -> None:
    """Serve until an interrupt; `ready` is called with the address, which holds the token."""
    token = secrets.token_urlsafe(24)
    with closing(listening(port)) as place:
        number = place.getsockname()[1]
        config = uvicorn.Config(
            application(opened, token, number), log_level="warning", access_log=False, timeout_graceful_shutdown=2
        )
        server = uvicorn.Server(config)
        ready(f"http://{HOST}:{number}/?token={token}")
        # while a browser starts, its first answers are prepared
        threading.Thread(target=_prepare, args=(opened,), daemon=True).start()
        server.run(sockets=[place])


def _prepare(opened: Opened) -> None:
    with suppress(MgsgraphError):  # the request for it reports the error
        scene_record(opened)
        map_points(opened).value("sigma")
        opened.footprints()
