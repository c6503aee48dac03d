"""Addresses of the page: what is open, the map, images, points, changes, questions and figures."""

from collections.abc import Awaitable, Callable, Mapping
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from mgsgraph.analysis.posterior import Pixel
from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.files.opening import json_object
from mgsgraph.files.output.table import plain
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.results.answers import Questions, answered
from mgsgraph.studio.changes import EditLock, change
from mgsgraph.studio.figures import drawn, map_figure
from mgsgraph.studio.linked import LinkedImages, NoGround, ground_record
from mgsgraph.studio.map_points import (
    CLASSES,
    longitude_latitude,
    map_points,
    outlines_record,
    relief_png,
    residual_vectors,
    scene_record,
    selected,
    sigma_cells,
)
from mgsgraph.studio.marks import shots_of, ties_of
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.point_sheet import chip, correlations, next_measures, point_sheet, refine, tests_of
from mgsgraph.studio.tiles import Tiles
from mgsgraph.units import DEG

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet

_LONGEST = 200_000
"""bytes of a request's body."""
BROWSER = "x-browser"
"""Header by which the page says which browser asks."""


class Views:
    """Linked images and tiles of what is open, as it is now.

    Parameters
    ----------
    opened : Opened
    """

    def __init__(self, opened: Opened) -> None:
        self.opened, self.tiles = opened, Tiles({})
        self._linked: tuple[int, LinkedImages] | None = None
        self._lock = Lock()

    @property
    def linked(self) -> LinkedImages:
        """Images linked by geometry, as the block is now."""
        with self._lock:
            if self._linked is None or self._linked[0] != self.opened.revision:
                self._linked = self.opened.revision, LinkedImages(self.opened.block())
                files, images = self.opened.pictures, self._linked[1].block.images
                self.tiles.pictures = {item.name: (files.get(item.name), item.lines, item.samples) for item in images}
            return self._linked[1]

    def image_record(self, name: str) -> dict[str, Any]:
        """Size, picture, ties and shots of an image; in place of a picture that can't be read, the sentence why."""
        block = self.linked.block
        number = block.network.image_number(name)
        picture, sentence, image = None, "", block.images[number]
        try:
            picture = self.tiles.record(name)
        except InputError as error:
            sentence = str(error)
        return {
            "name": name, "lines": image.lines, "samples": image.samples, "picture": picture, "sentence": sentence,
            "revision": self.opened.revision, "adjusted": block.adjusted,
            "ties": ties_of(block, number), "shots": shots_of(block, number),
        }  # fmt: skip


# --- requests


def number_of(query: Mapping[str, str], key: str, default: float | None = None) -> float:
    """A finite number of an address's query; InputError where it is invalid or missing."""
    text = query.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"request, {key}", repr(text)[:60], "a finite number")
    return value


def _box(query: Mapping[str, str]) -> Array:
    """(4,) m on the map, x and y, low and high; InputError for an empty box."""
    box = np.array([number_of(query, key) for key in ("x0", "y0", "x1", "y1")])
    if not np.all(box[2:] > box[:2]):
        raise InputError("request, box", f"{box.tolist()}", "x0 < x1 and y0 < y1")
    return box


def _size(query: Mapping[str, str]) -> tuple[float, float]:
    width, height = (float(np.clip(number_of(query, key, 800.0), 16.0, 8000.0)) for key in ("w", "h"))
    return width, height


def _kinds(query: Mapping[str, str]) -> Mask:
    """(classes,) mask of the requested ones; all by default."""
    names = [name for name in query.get("classes", ",".join(CLASSES)).split(",") if name]
    unknown = [name for name in names if name not in CLASSES]
    if unknown:
        raise InputError("request, classes", repr(unknown[0])[:60], f"some of {', '.join(CLASSES)}")
    return np.array([name in names for name in CLASSES])


def _browser(request: Request) -> str:
    """Which browser asks; empty where it does not say."""
    return request.headers.get(BROWSER, "")[:80]


def questions_of(content: dict[str, Any]) -> Questions:
    """Questions of a browser; InputError where one is invalid, or there are none."""
    expected = "points, pairs, poses, projections or pixels"
    try:
        pixels = tuple(
            Pixel(str(pixel["image"]), float(pixel["line"]), float(pixel["sample"]), float(pixel.get("sigma_px", 1.0)))
            for pixel in content.get("pixels", ())
        )
        questions = Questions(
            tuple(map(str, content.get("points", ()))), tuple((str(a), str(b)) for a, b in content.get("pairs", ())),
            tuple((str(image), float(line)) for image, line in content.get("poses", ())),
            tuple((str(point), str(image)) for point, image in content.get("projections", ())), pixels,
            bool(content.get("correlations", False)),
        )  # fmt: skip
    except (TypeError, ValueError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("questions", repr(content)[:80], expected) from None
    if not questions:
        raise InputError("questions", "none", expected)
    return questions


# --- answers


def state_record(opened: Opened, lock: EditLock, browser: str) -> dict[str, Any]:
    """Whether it may be changed, and why not, as JSON; changes of other processes are noticed."""
    opened.notice()
    refusal = lock.refusal(browser)
    return {
        "revision": opened.revision, "writable": opened.kind == "project" and not refusal, "lock": refusal,
        "warning": opened.warning,
    }  # fmt: skip


def _png(data: bytes, seconds: int) -> Response:
    return Response(data, media_type="image/png", headers={"Cache-Control": f"private, max-age={seconds}"})


def routes(opened: Opened, views: Views, lock: EditLock) -> list[Route]:
    """All addresses but those of the page's own files, for the server's list."""

    def points(request: Request) -> Any:
        query = request.query_params
        return map_points(opened).window(_box(query), _size(query), query.get("value", "sigma"), _kinds(query))

    def relief(request: Request) -> Any:
        return _png(relief_png(opened, _box(request.query_params), _size(request.query_params)), 0)

    def select(request: Request) -> Any:
        query = request.query_params
        least = number_of(query, "least") if "least" in query else None
        box = _box(query) if "x0" in query else None
        return selected(opened, query.get("value", "sigma"), least, box, _kinds(query))

    def where(request: Request) -> Any:
        place = np.array([[number_of(request.query_params, "x"), number_of(request.query_params, "y")]])
        longitude, latitude = longitude_latitude(opened, place)[0] / DEG
        return {"longitude_deg": longitude % 360.0, "latitude_deg": latitude}

    def tile(request: Request) -> Any:
        part, query = request.path_params, request.query_params
        contrast = number_of(query, "low"), number_of(query, "high")
        if part["name"] not in views.tiles.pictures:
            _ = views.linked  # which finds the pictures
        return _png(views.tiles.tile(part["name"], part["level"], part["row"], part["column"], *contrast), 86400)

    def ground(request: Request) -> Any:
        query, linked = request.query_params, views.linked
        required = [name for name in query.getlist("with") if name]
        pixel = number_of(query, "line"), number_of(query, "sample")
        try:
            ground_at_pixel, predictions = linked.under(request.path_params["name"], *pixel, required=required)
        except NoGround as error:  # no error: users look at limbs, too
            return {"sentence": str(error), "others": {}}
        map_m = np.asarray(opened.map_places(ground_at_pixel.point[None]))[0].tolist()
        return ground_record(ground_at_pixel, predictions, linked.block) | {"map_m": map_m}

    def picture(request: Request) -> Any:
        query = request.query_params
        image = query.get("image", "")
        path = opened.pictures.get(image)
        if path is None:
            raise InputError(f"image {image}", "no file of its pixels is known")
        return _png(chip(path, number_of(query, "line"), number_of(query, "sample")), 3600)

    def figure_of_map(request: Request) -> "Sheet":
        query = request.query_params
        layers, value = query.get("layers", "footprints,points").split(","), query.get("value", "sigma")
        box, size, kinds, factor = _box(query), _size(query), _kinds(query), number_of(query, "factor", 0.0)
        return map_figure(opened, box, size, value, kinds, layers, factor)

    def figure(request: Request) -> Any:
        return drawn("map", request.path_params["kind"], lambda: figure_of_map(request))

    def changed(content: Any, browser: str) -> Any:
        if content.get("kind") == "take over":
            lock.take(browser)
            sentences = ["This browser changes the project now."]
            return state_record(opened, lock, browser) | {"sentences": sentences, "moved": []}
        held = lock.require(browser)
        try:
            return change(opened, content) | {"writable": True, "lock": ""}
        except MgsgraphError:
            if not held:  # a refused change locks nobody out
                lock.release(browser)
            raise

    def refined(content: Any, _: str) -> Any:
        try:
            reference = content["reference"]
            fixed = str(reference["image"]), float(reference["line"]), float(reference["sample"])
            clicked = str(content["image"]), float(content["line"]), float(content["sample"])
        except (TypeError, KeyError, ValueError):
            expected = "reference {image, line, sample}, image, line, sample"
            raise InputError("refine", repr(content)[:80], expected) from None
        match = refine(views.linked, opened.pictures, fixed, clicked)
        line, sample = match.place.tolist()
        sentence = (f"Refined against {fixed[0]}: line {line:.2f}, sample {sample:.2f}, sigma {match.sigma:.2g} px, "
                 f"correlation {match.correlation:.2f}.")  # fmt: skip
        return {"line": line, "sample": sample, "sigma_px": match.sigma, "correlation": match.correlation,
                "sentence": sentence}  # fmt: skip

    def answers(content: Any, _: str) -> Any:
        sections = answered(opened.posterior(), questions_of(content))
        return [{"text": "\n".join(section.sentences), "record": plain(section.numbers)} for section in sections]

    getting: dict[str, Callable[[Request], Any]] = {
        "/api/state": lambda request: state_record(opened, lock, _browser(request)),
        "/api/scene": lambda _: scene_record(opened),
        "/api/map/outlines": lambda _: outlines_record(opened),
        "/api/map/points": points,
        "/api/map/relief.png": relief,
        "/api/map/sigmas": lambda _: opened.once("sigma cells", lambda: sigma_cells(opened)),
        "/api/map/residuals": lambda request: residual_vectors(opened, request.query_params.get("image", "")),
        "/api/map/where": where,
        "/api/select": select,
        "/api/images/{name:path}/tiles/{level:int}/{row:int}/{column:int}.png": tile,
        "/api/images/{name:path}/ground": ground,
        "/api/images/{name:path}": lambda request: views.image_record(request.path_params["name"]),
        "/api/points/{name:path}/tests": lambda request: tests_of(opened, request.path_params["name"]),
        "/api/points/{name:path}/correlations": lambda request: correlations(opened, request.path_params["name"]),
        "/api/points/{name:path}": lambda request: point_sheet(opened, request.path_params["name"]),
        "/api/chip.png": picture,
        "/api/plan": lambda _: opened.once("next measures", lambda: next_measures(opened, views.linked)),
        "/api/figure/map.{kind:str}": figure,
    }
    posting: dict[str, Callable[[Any, str], Any]] = {
        "/api/changes": changed,
        "/api/refine": refined,
        "/api/questions": answers,
    }
    return [
        *(Route(path, _got(answer)) for path, answer in getting.items()),
        *(Route(path, _posted(answer), methods=["POST"]) for path, answer in posting.items()),
    ]


def _got(answer: Callable[[Request], Any]) -> Callable[[Request], Response]:
    def endpoint(request: Request) -> Response:
        result = answer(request)
        return result if isinstance(result, Response) else JSONResponse(result)

    return endpoint


def _posted(answer: Callable[[Any, str], Any]) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > _LONGEST:
                raise InputError("request", f"more than {_LONGEST} bytes", "a shorter one")
        content = json_object(body, "request")
        return JSONResponse(await run_in_threadpool(answer, content, _browser(request)))

    return endpoint
