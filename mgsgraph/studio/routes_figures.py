"""Figures for papers: every view of the studio as SVG, PNG or PDF with its caption, from the data of the page."""

from collections.abc import Callable, Iterable
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.studio.linked import Prediction
from mgsgraph.studio.marks import shots_of, ties_of
from mgsgraph.studio.registration import footprints_record
from mgsgraph.studio.tiles import Pyramid
from mgsgraph.studio.views import Pictured, Views, number_of

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.results.figures.image_views import ImageView
    from mgsgraph.results.figures.sheet import Sheet

_TYPES = {"svg": "image/svg+xml", "png": "image/png", "pdf": "application/pdf"}
_MATPLOTLIB = Lock()
"""Its settings are one for all threads."""
_MOST = 1200
"""Lines and samples of a picture in a figure; more are halved."""
_MOST_IMAGES = 4
_OF_SOLUTION = ("residuals", "map", "orientation", "connectivity", "minima")
"""Views of which a figure is what the results have."""


class Figures:
    """Draws views; matplotlib is imported when the first one is asked for.

    Parameters
    ----------
    scene : Pictured
    views : Views
        Its pictures and linked images.
    """

    def __init__(self, scene: Pictured, views: Views) -> None:
        self._scene, self._views = scene, views
        self._every: dict[str, Callable[[Request], Sheet]] = {
            "images": self._images, "footprints": self._footprints,
        }

    def sheet(self, view: str, request: Request) -> "Sheet":
        """A view; InputError where there is no such view, or nothing to be drawn."""
        if view in self._every:
            return self._every[view](request)
        if view in _OF_SOLUTION:
            return self._of_solution(view)
        raise InputError("figure", f"{view!r}"[:60], f"one of {', '.join((*self._every, *_OF_SOLUTION))}")

    # --- images

    def _images(self, request: Request) -> "Sheet":
        from mgsgraph.results.figures.image_views import images_sheet

        asked, linked = request.query_params, self._views.linked
        name = asked.get("image") or linked.block.images[0].name
        image = linked.block.images[linked.block.network.image_number(name)]
        window = (
            number_of(asked, "line0", 0.0), number_of(asked, "line1", float(image.lines)),
            number_of(asked, "sample0", 0.0), number_of(asked, "sample1", float(image.samples)),
        )  # fmt: skip
        if not (window[0] < window[1] and window[2] < window[3]):
            raise InputError("figure of images", f"lines and samples {window}", "from smaller to larger ones")
        others = [one for one in asked.getlist("with") if one and one != name][: _MOST_IMAGES - 1]
        middle = 0.5 * (window[0] + window[1]), 0.5 * (window[2] + window[3])
        _, found = linked.under(name, *middle, wanted=others)
        places = {linked.block.images[one.image].name: one for one in found}
        every = [self._view(name, window, None)]
        for other in others:
            if other in places:
                every.append(self._view(other, _same_ground(places[other], window, middle), places[other]))
        return images_sheet(every, number_of(request.query_params, "factor", 20.0), linked.block.adjusted)

    def _view(
        self, name: str, window: tuple[float, float, float, float], predicted: Prediction | None
    ) -> "ImageView":
        from mgsgraph.results.figures.image_views import ImageView

        block = self._views.linked.block
        j = block.network.image_number(name)
        grey, contrast = None, (0.0, 1.0)
        extent = 0.0, float(block.images[j].samples), float(block.images[j].lines), 0.0
        if self._views.tiles.has(name):
            pyramid = self._views.tiles.picture(name)
            contrast = pyramid.low, pyramid.high
            grey, extent = part_of(pyramid, window)
        ellipse = None
        if predicted is not None and predicted.ellipse is not None:
            ellipse = predicted.place, predicted.ellipse.semi_axes, np.degrees([predicted.ellipse.angle])
        ties, shots = ties_inside(ties_of(block, j), window), shots_of(block, j)
        return ImageView(name, grey, extent, window, contrast, ties, shots, ellipse)

    # --- registration

    def _footprints(self, request: Request) -> "Sheet":
        from mgsgraph.results.figures.image_views import footprints_sheet

        images = footprints_record(self._views.linked.block)["images"]
        return footprints_sheet(_chosen(images, "image", request.query_params.get("image"), "a shot in an image"))

    # --- of the solution: the sheets that results have

    def _of_solution(self, view: str) -> "Sheet":
        from mgsgraph.results.figures.connectivity import links_sheet
        from mgsgraph.results.figures.map import map_sheets, minima_sheets
        from mgsgraph.results.figures.orientation import orientation_sheets
        from mgsgraph.results.figures.residuals import residual_sheets

        drawn_by: dict[str, Callable[[Solution], Iterable[Sheet]]] = {
            "minima": minima_sheets, "residuals": residual_sheets, "map": map_sheets,
            "orientation": orientation_sheets, "connectivity": lambda found: [links_sheet(found)],
        }  # fmt: skip
        solution = self._scene.solution
        if solution is None:
            found, remedy = "a block without a batch solution", "adjust it: mgsgraph adjust, or solve"
            raise InputError(f"figure {view}", found, "results of an adjustment", remedy)
        sheet = next(iter(drawn_by[view](solution)), None)
        if sheet is None:
            raise InputError(f"figure {view}", "nothing to be drawn: there are none, or too many points for a figure")
        return sheet


def part_of(
    pyramid: Pyramid, window: tuple[float, float, float, float]
) -> "tuple[Array | None, tuple[float, float, float, float]]":
    """Grey values of a window (line from and to, sample from and to) of a picture, and their extent as matplotlib has
    it (left, right, bottom, top) in px; None where the window lies beside it.
    """
    line0, line1 = max(0.0, window[0]), min(float(pyramid.lines), window[1])
    sample0, sample1 = max(0.0, window[2]), min(float(pyramid.samples), window[3])
    if not (line0 < line1 and sample0 < sample1):
        return None, (0.0, 1.0, 1.0, 0.0)
    level = int(np.clip(np.ceil(np.log2(max(line1 - line0, sample1 - sample0) / _MOST)), 0, pyramid.levels - 1))
    return pyramid.window(level, (line0, line1), (sample0, sample1))


def _same_ground(
    found: Prediction, window: tuple[float, float, float, float], middle: tuple[float, float]
) -> tuple[float, float, float, float]:
    """The window of another image that holds the ground of the first one's."""
    corners = np.array([(line, sample) for line in window[:2] for sample in window[2:]]) - middle
    places = found.place + corners @ found.jacobian.T
    (line0, sample0), (line1, sample1) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return line0, line1, sample0, sample1


def ties_inside(ties: dict[str, Any], window: tuple[float, float, float, float]) -> dict[str, Any]:
    """The ties of an image that were measured in a window of it."""
    measured = np.array(ties["measured"], dtype=np.float64).reshape(-1, 2)
    line0, line1, sample0, sample1 = window
    above, below = (line0, sample0), (line1, sample1)
    mine = np.flatnonzero(np.all((measured >= above) & (measured <= below), axis=1)).tolist()
    return ties | {key: [ties[key][k] for k in mine] for key in ("names", "measured", "residuals", "used")}


def _chosen(records: list[dict[str, Any]], key: str, wanted: str | None, what: str) -> dict[str, Any]:
    """The record asked for, or the first one; InputError where there is none."""
    found = [one for one in records if wanted is None or one[key] == wanted]
    if not found:
        raise InputError("figure", f"nothing of {wanted!r}" if records else f"no {what}", what)
    return found[0]


def drawn(view: str, kind: str, make: "Callable[[], Sheet]") -> Response:
    """A view, drawn by `make`, as an attachment with its caption; InputError of what can't be written."""
    from mgsgraph.results.figures.sheet import encoded

    if kind not in _TYPES:
        raise InputError("figure", f"{view}.{kind}"[:60], f"one of {', '.join(_TYPES)}")
    with _MATPLOTLIB:
        sheet = make()
        about: dict[str, str | None] = {"Title": sheet.title, "Description": sheet.caption}
        if kind == "pdf":
            about = {"Title": sheet.title, "Subject": sheet.caption, "Creator": "mgsgraph", "CreationDate": None}
        elif kind == "svg":
            about |= {"Date": None, "Creator": "mgsgraph"}
        data = encoded(sheet, kind, metadata=about)
    return Response(data, media_type=_TYPES[kind], headers={
        "Content-Disposition": f'attachment; filename="{view}.{kind}"', "Cache-Control": "no-store",
    })  # fmt: skip


def routes(scene: Pictured, views: Views) -> list[Route]:
    """The address of figures, for the server's list."""
    figures = Figures(scene, views)

    def figure(request: Request) -> Response:
        view, kind = request.path_params["view"], request.path_params["kind"]
        return drawn(view, kind, lambda: figures.sheet(view, request))

    return [Route("/api/figure/{view:str}.{kind:str}", figure)]
