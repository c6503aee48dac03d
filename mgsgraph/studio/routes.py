"""Addresses of the page: what is open, the map, images, points, changes, questions and figures."""

from asyncio import Semaphore
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from itertools import chain
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.errors import InputError, MgsgraphError, require
from mgsgraph.files.opening import json_object
from mgsgraph.files.output.table import plain
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.results.answers import Questions, replies
from mgsgraph.studio.changes import EditLock, change, reversible
from mgsgraph.studio.figures import drawn, map_figure
from mgsgraph.studio.inputs import bounded, number, number_of, place_of, text_of
from mgsgraph.studio.linked import LinkedImages, NoGround, ground_record
from mgsgraph.studio.lists import compute, csv_of, window
from mgsgraph.studio.map_distance import distance
from mgsgraph.studio.map_graticule import graticule
from mgsgraph.studio.map_images import MapImages
from mgsgraph.studio.map_points import (
    CLASSES,
    longitude_latitude,
    map_points,
    outlines_record,
    residual_vectors,
    scene_record,
    selected,
    sigma_cells,
)
from mgsgraph.studio.marks import shots_of, ties_of
from mgsgraph.studio.opened import Block, Opened
from mgsgraph.studio.point_sheet import answer_of, chip, correlations, next_measures, point_sheet, refine, tests_of
from mgsgraph.studio.start import verdict_record, worst_record
from mgsgraph.studio.tiles import Tiles
from mgsgraph.studio.work import Work
from mgsgraph.units import DEG

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet

_LONGEST = 200_000
"""bytes of a request's body."""
_AT_ONCE, _MOST_WAITING = 4, 40
"""Questions of one kind that are answered at a time, and those that wait or are answered."""
_MOST_PRIOR = 200_000
"""Most points of a block whose a-priori covariance is computed while the user waits."""
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

    @property
    def nominal(self) -> LinkedImages:
        """The same before the adjustment: nominal orientation, a-priori places and, in smaller blocks, sigmas."""

        def make() -> LinkedImages:
            block = self.opened.block()
            before = Block.of_network(block.network, block.settings)
            return LinkedImages(before if len(before.places) <= _MOST_PRIOR else replace(before, joint_of=lambda: None))

        return self.opened.once("nominal images", make)

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


def _box(query: Mapping[str, Any]) -> Array:
    """(4,) m on the map, x and y, low and high; InputError for an empty box."""
    box = np.array([number_of(query, key) for key in ("x0", "y0", "x1", "y1")])
    require(np.all(box[2:] > box[:2]), "request, box", f"{box.tolist()}", "x0 < x1 and y0 < y1")
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


def _name(request: Request) -> str:
    """Name of an image or a point: in the query, for in a path `A/tests` would be two things."""
    return text_of(request.query_params, "name")


def _browser(request: Request) -> str:
    """Which browser asks; empty where it does not say."""
    return request.headers.get(BROWSER, "")[:80]


def questions_of(content: dict[str, Any]) -> Questions:
    """Questions of a browser; InputError where one is invalid, or there are none."""
    expected = "points, pairs, poses, projections or pixels"
    try:
        pixels = tuple(
            Pixel(*place_of(pixel), number_of(pixel, "sigma_px", 1.0)) for pixel in content.get("pixels", ())
        )
        questions = Questions(
            tuple(map(str, content.get("points", ()))), tuple((str(a), str(b)) for a, b in content.get("pairs", ())),
            tuple((str(image), number(line, "request, line")) for image, line in content.get("poses", ())),
            tuple((str(point), str(image)) for point, image in content.get("projections", ())), pixels,
            bool(content.get("correlations", False)),
        )  # fmt: skip
    except (TypeError, ValueError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("questions", repr(content)[:80], expected) from None
    require(questions, "questions", "none", expected)
    return questions


# --- answers


def state_record(opened: Opened, lock: EditLock, work: Work, browser: str) -> dict[str, Any]:
    """Whether it may be changed, and why not, what can be undone, and the present job, as JSON; changes of other
    processes are noticed.
    """
    opened.notice()
    refusal = lock.refusal(browser)
    return {
        "revision": opened.revision, "writable": opened.kind == "project" and not refusal, "lock": refusal,
        "warning": opened.warning, "job": work.record, **reversible(opened, opened.revision),
    }  # fmt: skip


def _png(data: bytes, seconds: int) -> Response:
    return Response(data, media_type="image/png", headers={"Cache-Control": f"private, max-age={seconds}"})


_Getting = dict[str, Callable[[Request], Any]]
_Posting = dict[str, Callable[[Any, str], Any]]
"""By address: answer to a body and the browser that sends it."""


def routes(opened: Opened, views: Views, lock: EditLock, work: Work) -> list[Route]:
    """All addresses but those of the page's own files, for the server's list."""
    getting: _Getting = {
        "/api/state": lambda request: state_record(opened, lock, work, _browser(request)),
        "/api/scene": lambda _: scene_record(opened),
        **_map(opened, views),
        **_images(opened, views),
        **_points(opened, views),
        "/api/list": lambda request: window(opened, request.query_params),
        "/api/list/compute": lambda request: compute(opened, request.query_params.get("group", "")),
        "/api/list/csv": lambda request: Response(csv_of(opened, request.query_params), media_type="text/csv"),
        "/api/verdict": lambda _: opened.once("verdict", lambda: verdict_record(opened)),
        "/api/worst": lambda _: opened.once("worst", lambda: worst_record(opened)),
        "/api/work/files": lambda _: work.files(),
    }
    posting: _Posting = {**_asked(opened, views), **_changing(opened, lock, work)}
    return [
        *(Route(path, _got(answer)) for path, answer in getting.items()),
        *(Route(path, _posted(answer), methods=["POST"]) for path, answer in posting.items()),
    ]


def _map(opened: Opened, views: Views) -> _Getting:
    def points(request: Request) -> Any:
        query = request.query_params
        return map_points(opened).window(_box(query), _size(query), query.get("value", "sigma"), _kinds(query))

    def images() -> MapImages:
        _ = views.linked  # which finds the pictures
        return opened.once("map images", lambda: MapImages(opened, views.tiles))

    def tile(request: Request) -> Any:
        query = request.query_params
        level, row, column = (int(number_of(query, key)) for key in ("level", "row", "column"))
        return _png(images().tile((level, row, column), text_of(query, "layers").split(","), text_of(query, "top")), 0)

    def between(request: Request) -> Any:
        query = request.query_params
        plane = np.array([[number_of(query, f"{axis}{k}") for axis in "xy"] for k in range(2)])
        return distance(opened, (text_of(query, "from"), text_of(query, "to")), plane)

    def select(request: Request) -> Any:
        query = request.query_params
        least = number_of(query, "least") if "least" in query else None
        box = _box(query) if "x0" in query else None
        return selected(opened, query.get("value", "sigma"), least, box, _kinds(query))

    def where(request: Request) -> Any:
        place = np.array([[number_of(request.query_params, "x"), number_of(request.query_params, "y")]])
        longitude, latitude = longitude_latitude(opened, place)[0] / DEG
        return {"longitude_deg": longitude % 360.0, "latitude_deg": latitude}

    def figure_of_map(request: Request) -> "Sheet":
        query = request.query_params
        layers, value = query.get("layers", "footprints,points").split(","), query.get("value", "sigma")
        box, size, kinds, factor = _box(query), _size(query), _kinds(query), number_of(query, "factor", 0.0)
        return map_figure(images(), box, size, value, kinds, layers, factor, text_of(query, "top"))

    def figure(request: Request) -> Any:
        return drawn("map", text_of(request.query_params, "kind"), lambda: figure_of_map(request))

    return {
        "/api/map/outlines": lambda _: outlines_record(opened),
        "/api/map/points": points,
        "/api/map/images": lambda _: images().record(),
        "/api/map/tile.png": tile,
        "/api/map/graticule": lambda request: {"lines": graticule(opened, _box(request.query_params))},
        "/api/map/distance": between,
        "/api/map/sigmas": lambda _: opened.once("sigma cells", lambda: sigma_cells(opened)),
        "/api/map/residuals": lambda request: residual_vectors(opened, request.query_params.get("image", "")),
        "/api/map/where": where,
        "/api/map/figure": figure,
        "/api/select": select,
    }


def _images(opened: Opened, views: Views) -> _Getting:
    def tile(request: Request) -> Any:
        query, name = request.query_params, _name(request)
        level, row, column = (int(number_of(query, key)) for key in ("level", "row", "column"))
        contrast = number_of(query, "low"), number_of(query, "high")
        if name not in views.tiles.pictures:
            _ = views.linked  # which finds the pictures
        return _png(views.tiles.tile(name, level, row, column, *contrast), 86400)

    def ground(request: Request) -> Any:
        query = request.query_params
        linked = views.nominal if "before" in query else views.linked
        required = [name for name in query.getlist("with") if name]
        pixel = number_of(query, "line"), number_of(query, "sample")
        try:
            ground_at_pixel, predictions = linked.under(_name(request), *pixel, required=required)
        except NoGround as error:  # no error: users look at limbs, too
            return {"sentence": str(error), "others": {}}
        map_m = np.asarray(opened.map_places(ground_at_pixel.point[None]))[0].tolist()
        record = ground_record(ground_at_pixel, predictions, linked.block)
        places = {_name(request): pixel} | {key: (one["line"], one["sample"]) for key, one in record["others"].items()}
        grey = {key: views.tiles.value(key, *place) for key, place in places.items()}
        return record | {"map_m": map_m, "grey": plain(grey)}

    def contrast(request: Request) -> Any:
        corners = [[number_of(request.query_params, f"{key}{end}") for key in ("line", "sample")] for end in (0, 1)]
        low, high = views.tiles.picture(_name(request)).contrast(np.array(corners))
        return {"low": low, "high": high}

    return {
        "/api/image": lambda request: views.image_record(_name(request)),
        "/api/image/tile.png": tile,
        "/api/image/ground": ground,
        "/api/image/contrast": contrast,
    }


def _points(opened: Opened, views: Views) -> _Getting:
    def picture(request: Request) -> Any:
        query = request.query_params
        image = query.get("image", "")
        path = opened.pictures.get(image)
        if path is None:
            raise InputError(f"image {image}", "no file of its pixels is known")
        return _png(chip(path, number_of(query, "line"), number_of(query, "sample")), 3600)

    return {
        "/api/point": lambda request: point_sheet(opened, _name(request)),
        "/api/point/answer": lambda request: answer_of(opened, _name(request)),
        "/api/point/tests": lambda request: tests_of(opened, _name(request)),
        "/api/point/correlations": lambda request: correlations(opened, _name(request)),
        "/api/chip.png": picture,
        "/api/plan": lambda _: opened.once("next measures", lambda: next_measures(opened, views.linked)),
    }


def _asked(opened: Opened, views: Views) -> _Posting:
    def refined(content: Any, _: str) -> Any:
        fixed, clicked = place_of(content.get("reference")), place_of(content)
        match = refine(views.linked, opened.pictures, fixed, clicked)
        line, sample = match.place.tolist()
        sentence = (f"Refined against {fixed[0]}: line {line:.2f}, sample {sample:.2f}, sigma {match.sigma:.2g} px, "
                 f"correlation {match.correlation:.2f}; Store keeps it.")  # fmt: skip
        return {"line": line, "sample": sample, "sigma_px": match.sigma, "correlation": match.correlation,
                "sentence": sentence}  # fmt: skip

    def answers(content: Any, _: str) -> Any:
        questions = questions_of(content)
        sections = replies(_posterior_for(opened, questions), questions)
        return [{"text": "\n".join(section.sentences), "record": plain(section.numbers)} for section in sections]

    return {"/api/refine": refined, "/api/questions": answers}


def _posterior_for(opened: Opened, questions: Questions) -> Posterior:
    """The posterior of the points that are asked about; of the whole block where these can't be read alone."""
    names = [*questions.points, *chain(*questions.pairs), *(point for point, _ in questions.projections)]
    solution, numbers = opened.now.solution, opened.block().network.points.ids.find(names)
    if solution is None or np.any(numbers < 0):
        return opened.posterior()
    return opened.posterior_of(numbers if names else np.flatnonzero(solution.determined)[:1])


def _changing(opened: Opened, lock: EditLock, work: Work) -> _Posting:
    def changed(content: Any, browser: str) -> Any:
        if content.get("kind") == "take over":
            lock.take(browser)
            sentences = ["This browser changes the project now."]
            return state_record(opened, lock, work, browser) | {"sentences": sentences, "moved": []}
        return holding(browser, lambda: change(opened, content) | {"writable": True, "lock": ""})

    def holding(browser: str, act: Callable[[], Any]) -> Any:
        work.require_free()
        held = lock.require(browser)
        try:
            return act()
        except MgsgraphError:
            if not held:  # a refused change locks nobody out
                lock.release(browser)
            raise

    def judged(content: Any, _: str) -> Any:
        points, note = content.get("points"), text_of(content, "note") if "note" in content else None
        if opened.judging is None or not isinstance(points, list):
            raise InputError("verdicts", "no case is known, or no list of points", "points of a case")
        opened.judging.judge(list(map(str, points)), text_of(content, "verdict"), note)
        return {"file": str(opened.judging.path)}

    def worked(content: Any, browser: str) -> Any:
        kind, box = text_of(content, "kind"), _box(content) if "x0" in content else None
        if kind == "cancel" and work.job is not None:
            lock.require(browser)
            work.job.cancel()
            return {"job": work.record}
        return {"job": holding(browser, lambda: work.start(kind, content.get("files"), box))}

    return {"/api/changes": changed, "/api/verdicts": judged, "/api/work": worked}


_Endpoint = Callable[[Request], Awaitable[Response]]


def _got(answer: Callable[[Request], Any]) -> _Endpoint:
    queued = in_turn(answer)

    async def endpoint(request: Request) -> Response:
        for key, value in request.query_params.multi_items():
            bounded(value, f"request, {key}"[:60])
        result = await queued(request)
        return result if isinstance(result, Response) else JSONResponse(result)

    return endpoint


def _posted(answer: Callable[[Any, str], Any]) -> _Endpoint:
    queued = in_turn(answer)

    async def endpoint(request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            require(len(body) <= _LONGEST, "request", f"more than {_LONGEST} bytes", "a shorter one")
        content = bounded(json_object(body, "request"), "request")
        return JSONResponse(await queued(content, _browser(request)))

    return endpoint


def in_turn(answer: Callable[..., Any]) -> Callable[..., Awaitable[Any]]:
    """Answer one kind of question, a few at a time; with too many waiting, others are refused by status 503."""
    places, waiting = Semaphore(_AT_ONCE), 0

    async def queued(*about: Any) -> Any:
        nonlocal waiting
        if waiting >= _MOST_WAITING:
            raise HTTPException(503, "Too many questions of this kind are waiting for their answers; ask again later.")
        waiting += 1
        try:
            async with places:
                return await run_in_threadpool(answer, *about)
        finally:
            waiting -= 1

    return queued
