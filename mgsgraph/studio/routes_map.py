"""Addresses of the map: what is open, points in a window, layers, selections, and the comparison of two solutions."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import digits
from mgsgraph.geometry.records import Array, Mask, thinned
from mgsgraph.network import PointClass
from mgsgraph.project.reading import results_of
from mgsgraph.results.archive import read_solution
from mgsgraph.results.comparison import compare
from mgsgraph.studio.map_layers import longitude_latitude, relief_png, residual_vectors, sigma_cells
from mgsgraph.studio.map_points import CLASSES, VALUES, map_points
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.routes_figures import drawn
from mgsgraph.studio.views import number_of
from mgsgraph.units import DEG

_MOST_OUTLINES, _FEW_PLACES = 3000, 5
"""Images whose outlines have all their places; of more, so many of each."""
_MOST_MOVED = 2000
"""Points of a comparison that are drawn."""


def scene_record(opened: Opened) -> dict[str, Any]:
    """What is open: images, classes of points, what can be drawn, as JSON."""
    block = opened.block()
    number = np.bincount(block.network.points.classes, minlength=len(PointClass))
    places = map_points(opened).plane
    known = places[np.all(np.isfinite(places), axis=1)]
    corners = known if len(known) else np.concatenate([one for one in opened.footprints() if len(one)])
    return {
        "kind": opened.kind, "name": opened.name, "path": str(opened.path), "revision": opened.revision,
        "adjusted": block.adjusted, "warning": opened.warning,
        "body": {"equatorial_m": block.images[0].body.equatorial, "polar_m": block.images[0].body.polar},
        "images": [
            {"name": image.name, "lines": image.lines, "samples": image.samples,
             "picture": opened.pictures.get(image.name) is not None}
            for image in block.images
        ],
        "map": {"words": opened.map_words, "bounds_m": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]},
        "classes": [{"name": name, "count": int(count)} for name, count in zip(CLASSES, number, strict=True)],
        "values": [{"name": name, "title": title, "unit": unit} for name, (title, unit) in VALUES.items()],
        "terrain": block.terrain is not None,
    }  # fmt: skip


def outlines_record(opened: Opened) -> dict[str, Any]:
    """Outline (k, 2) of each image in m on the map, empty where it sees nothing of the body, as JSON."""
    outlines = opened.footprints()
    most = None if len(outlines) <= _MOST_OUTLINES else _FEW_PLACES
    return {"outlines_m": [np.round(one[thinned(len(one), most)], 1).tolist() for one in outlines]}


def box_of(request: Request) -> Array:
    """(4,) m on the map, x and y, low and high; InputError where they are none."""
    box = np.array([number_of(request.query_params, key) for key in ("x0", "y0", "x1", "y1")])
    if not np.all(box[2:] > box[:2]):
        raise InputError("request, box", f"{box.tolist()}", "x0 < x1 and y0 < y1")
    return box


def _size(request: Request) -> tuple[float, float]:
    width, height = (float(np.clip(number_of(request.query_params, key, 800.0), 16.0, 8000.0)) for key in ("w", "h"))
    return width, height


def _kinds(request: Request) -> Mask:
    """(classes,) which are asked for; all by default."""
    asked = request.query_params.get("classes")
    names = CLASSES if asked is None else [name for name in asked.split(",") if name]
    unknown = [name for name in names if name not in CLASSES]
    if unknown:
        raise InputError("request, classes", repr(unknown[0])[:60], f"some of {', '.join(CLASSES)}")
    return np.array([name in names for name in CLASSES])


def selected(opened: Opened, asked: Mapping[str, str], box: Array | None, kinds: Mask) -> dict[str, Any]:
    """Points in a box, and of a value (`VALUES`) of at least so much, as JSON."""
    points, value = map_points(opened), asked.get("value", "sigma")
    mine = np.flatnonzero(kinds[points.classes]) if box is None else points.inside(box, kinds)
    if "least" in asked:
        least = number_of(asked, "least")
        with np.errstate(invalid="ignore"):
            mine = mine[points.value(value)[mine] >= least]
    return points.selection(mine, value)


def comparison(opened: Opened, other: Path) -> dict[str, Any]:
    """What is open against other results, as `mgsgraph compare` says it, and how far points moved on the map; their
    folder may be named as it is within the project.
    """
    within = opened.path / other
    earlier = read_solution(results_of(within if within.exists() and not other.exists() else other).folder)
    if opened.solution is None:
        remedy = f"for a new one: mgsgraph solve {opened.path}"
        expected = "a batch solution of it as it is now"
        raise InputError(str(opened.path), "changed since its last batch solution", expected, remedy)
    labels = (other.name or str(other), "this one")
    found = compare(opened.solution, earlier, labels)
    points = found.points
    first = np.argsort(-np.linalg.norm(points.moved, axis=1), kind="stable")
    mine = first[thinned(first.size, _MOST_MOVED)]
    ids = opened.solution.network.points.ids
    return {
        "other": str(other), "sentences": found.section.sentences,
        "tables": [{"name": one.name, "title": one.title, "note": one.note, "headings": one.headings, "rows": one.rows}
                   for one in found.section.tables],
        "names": [ids[i] for i in points.rows[0][mine].tolist()],
        "places": np.round(opened.map_places(points.places[mine]), 2).tolist(),
        "moved": np.round(points.moved[mine], 4).tolist(),
        "ratio": digits(points.ratio[mine]),
    }  # fmt: skip


def earlier_solutions(opened: Opened) -> list[str]:
    """Folders of results that it may be compared with: those of the project."""
    if opened.kind != "project":
        return []
    folders = opened.path / "solutions"
    found = sorted(folders.iterdir()) if folders.is_dir() else []
    return [str(one) for one in found if one.is_dir() and not one.name.startswith(".") and one != opened.folder]


def routes(opened: Opened) -> list[Route]:
    """Addresses of the map, for the server's list."""

    def scene(_: Request) -> Response:
        return JSONResponse(scene_record(opened))

    def outlines(_: Request) -> Response:
        return JSONResponse(outlines_record(opened))

    def points(request: Request) -> Response:
        value = request.query_params.get("value", "sigma")
        return JSONResponse(map_points(opened).window(box_of(request), _size(request), value, _kinds(request)))

    def relief(request: Request) -> Response:
        return Response(relief_png(opened, box_of(request), _size(request)), media_type="image/png")

    def sigmas(_: Request) -> Response:
        return JSONResponse(opened.once("sigma cells", lambda: sigma_cells(opened)))

    def residuals(request: Request) -> Response:
        return JSONResponse(residual_vectors(opened, request.query_params.get("image", "")))

    def select(request: Request) -> Response:
        box = box_of(request) if "x0" in request.query_params else None
        return JSONResponse(selected(opened, request.query_params, box, _kinds(request)))

    def where(request: Request) -> Response:
        place = np.array([[number_of(request.query_params, "x"), number_of(request.query_params, "y")]])
        longitude, latitude = longitude_latitude(opened, place)[0] / DEG
        return JSONResponse({"longitude_deg": longitude % 360.0, "latitude_deg": latitude})

    def figure(request: Request) -> Response:
        from mgsgraph.studio.map_figure import map_figure

        asked, kind = request.query_params, request.path_params["kind"]
        layers, value = asked.get("layers", "footprints,points").split(","), asked.get("value", "sigma")
        box, size, kinds, factor = box_of(request), _size(request), _kinds(request), number_of(asked, "factor", 0.0)
        return drawn("map", kind, lambda: map_figure(opened, box, size, value, kinds, layers, factor))

    def compared(request: Request) -> Response:
        other = request.query_params.get("other", "")
        if not other:
            return JSONResponse({"solutions": earlier_solutions(opened)})
        return JSONResponse(comparison(opened, Path(other)))

    every: list[tuple[str, Callable[[Request], Response]]] = [
        ("/api/scene", scene), ("/api/map/outlines", outlines), ("/api/map/points", points),
        ("/api/map/relief.png", relief), ("/api/map/sigmas", sigmas), ("/api/map/residuals", residuals),
        ("/api/select", select), ("/api/map/where", where), ("/api/map/figure.{kind:str}", figure),
        ("/api/compare", compared),
    ]  # fmt: skip
    return [Route(path, endpoint) for path, endpoint in every]
