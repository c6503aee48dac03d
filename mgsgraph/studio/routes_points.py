"""Addresses of single points: their sheets and chips, changes, refinement, questions, what to measure next."""

from collections.abc import Awaitable, Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from mgsgraph.analysis.posterior import Pixel
from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.files.opening import json_object
from mgsgraph.files.output.csv_json import plain
from mgsgraph.results.answers import Questions, answered
from mgsgraph.studio.changes import EditLock, change
from mgsgraph.studio.next_measures import next_measures
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.point_sheet import chip, correlations, point_sheet, tests_of
from mgsgraph.studio.refinement import refine
from mgsgraph.studio.views import Views, number_of

_LONGEST = 200_000
"""bytes of a request's body."""
BROWSER = "x-browser"
"""Header by which the page says which browser asks."""
_Answer = Callable[[Any, str], dict[str, Any] | list[dict[str, Any]]]


def browser_of(request: Request) -> str:
    """Which browser asks; empty where it does not say."""
    return request.headers.get(BROWSER, "")[:80]


def state_record(opened: Opened, lock: EditLock, browser: str) -> dict[str, Any]:
    """Whether it may be changed, and why not, as JSON; what another process has changed is noticed."""
    opened.notice()
    words = lock.words(browser)
    return {
        "revision": opened.revision, "writable": opened.kind == "project" and not words, "lock": words,
        "warning": opened.warning,
    }  # fmt: skip


def questions_of(asked: dict[str, Any]) -> Questions:
    """Questions as a browser puts them; InputError where one is none."""
    try:
        pixels = tuple(
            Pixel(str(one["image"]), float(one["line"]), float(one["sample"]), float(one.get("sigma_px", 1.0)))
            for one in asked.get("pixels", ())
        )
        return Questions(
            tuple(map(str, asked.get("points", ()))), tuple((str(a), str(b)) for a, b in asked.get("pairs", ())),
            tuple((str(image), float(line)) for image, line in asked.get("poses", ())),
            tuple((str(a), float(m), str(b), float(n)) for a, m, b, n in asked.get("pose_pairs", ())),
            tuple((str(point), str(image)) for point, image in asked.get("projections", ())), pixels,
            bool(asked.get("correlations", False)), float(asked.get("probability", 0.95)),
        )  # fmt: skip
    except (TypeError, ValueError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("questions", repr(asked)[:80], "points, pairs, poses, projections or pixels") from None


def routes(opened: Opened, views: Views, lock: EditLock) -> list[Route]:
    """Addresses of points, for the server's list."""

    def state(request: Request) -> Response:
        return JSONResponse(state_record(opened, lock, browser_of(request)))

    def sheet(request: Request) -> Response:
        return JSONResponse(point_sheet(opened, request.path_params["name"]))

    def tests(request: Request) -> Response:
        return JSONResponse(tests_of(opened, request.path_params["name"]))

    def along(request: Request) -> Response:
        return JSONResponse(correlations(opened, request.path_params["name"]))

    def picture(request: Request) -> Response:
        image = request.query_params.get("image", "")
        path = opened.pictures.get(image)
        if path is None:
            raise InputError(f"image {image}", "no file of its pixels is known")
        data = chip(path, number_of(request.query_params, "line"), number_of(request.query_params, "sample"))
        return Response(data, media_type="image/png", headers={"Cache-Control": "private, max-age=3600"})

    def changed(asked: Any, browser: str) -> dict[str, Any]:
        if asked.get("kind") == "take over":
            lock.take(browser)
            return state_record(opened, lock, browser) | {"sentences": ["This browser changes the project now."],
                                                          "moved": []}  # fmt: skip
        held = lock.require(browser)
        try:
            return change(opened, asked) | {"writable": True, "lock": ""}
        except MgsgraphError:
            if not held:  # what was refused keeps nobody out
                lock.release(browser)
            raise

    def refined(asked: Any, _: str) -> dict[str, Any]:
        try:
            reference = asked["reference"]
            first = str(reference["image"]), float(reference["line"]), float(reference["sample"])
            second = str(asked["image"]), float(asked["line"]), float(asked["sample"])
        except (TypeError, KeyError, ValueError):
            expected = "reference {image, line, sample}, image, line, sample"
            raise InputError("refine", repr(asked)[:80], expected) from None
        found = refine(views.linked, opened.pictures, first, second)
        sigma = float((0.5 * found.covariance.trace()) ** 0.5)
        words = (f"Refined against {first[0]}: line {found.place[0]:.2f}, sample {found.place[1]:.2f}, "
                 f"sigma {sigma:.2g} px, correlation {found.correlation:.2f}.")  # fmt: skip
        return {"line": float(found.place[0]), "sample": float(found.place[1]), "sigma_px": sigma,
                "correlation": found.correlation, "sentence": words}  # fmt: skip

    def asked(wanted: Any, _: str) -> list[dict[str, Any]]:
        found = questions_of(wanted)
        if not found:
            raise InputError("questions", "none", "points, pairs, poses, projections or pixels")
        return [
            {"text": "\n".join(one.sentences), "record": plain(one.numbers)}
            for one in answered(opened.posterior(), found)
        ]

    def planned(_: Request) -> Response:
        return JSONResponse(opened.once("next measures", lambda: next_measures(opened, views.linked)))

    getting: list[tuple[str, Callable[[Request], Response]]] = [
        ("/api/state", state), ("/api/points/{name:path}/tests", tests),
        ("/api/points/{name:path}/correlations", along), ("/api/points/{name:path}", sheet), ("/api/chip.png", picture),
        ("/api/plan", planned),
    ]  # fmt: skip
    posting: list[tuple[str, _Answer]] = [
        ("/api/changes", changed), ("/api/refine", refined), ("/api/questions", asked)
    ]  # fmt: skip
    return [
        *(Route(path, endpoint) for path, endpoint in getting),
        *(Route(path, _posted(answer), methods=["POST"]) for path, answer in posting),
    ]


def _posted(answer: _Answer) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > _LONGEST:
                raise InputError("request", f"more than {_LONGEST} bytes", "a shorter one")
        asked = json_object(body, "request")
        return JSONResponse(await run_in_threadpool(answer, asked, browser_of(request)))

    return endpoint
