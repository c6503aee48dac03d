"""Figures for papers: the map's window and linked images as the page shows them, as SVG, PNG or PDF with a caption."""

from collections.abc import Callable, Collection, Sequence
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.responses import Response

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.studio.linked import LinkedImages, Prediction
from mgsgraph.studio.map_points import map_points, shaded_relief
from mgsgraph.studio.marks import shots_of, ties_of
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.tiles import Pyramid, Tiles

if TYPE_CHECKING:
    from mgsgraph.results.figures.image_views import ImageView
    from mgsgraph.results.figures.sheet import Sheet

_TYPES = {"svg": "image/svg+xml", "png": "image/png", "pdf": "application/pdf"}
_MATPLOTLIB = Lock()
"""Its settings are one for all threads."""
_MOST = 1200
"""Lines and samples of a picture in a figure; more are halved."""
_MOST_IMAGES = 4
LAYERS = ("footprints", "points", "ellipses", "moved", "relief")
"""Layers of the map that a figure has."""
_SIGNED = "moved_up"
_EVERY = 5
"""Columns and rows of cells, of which one has its correction drawn."""
_Window = tuple[float, float, float, float]
"""Line from and to, sample from and to."""


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


# --- images


def images_figure(
    linked: LinkedImages, tiles: Tiles, name: str, window: _Window, others: Sequence[str], factor: float
) -> "Sheet":
    """A window of an image, and the same ground in others; residuals are enlarged by the factor.

    Raises
    ------
    InputError
        No such image; an empty window.
    """
    from mgsgraph.results.figures.image_views import images_sheet

    if not (window[0] < window[1] and window[2] < window[3]):
        raise InputError("figure of images", f"lines and samples {window}", "from smaller to larger ones")
    others = [one for one in others if one and one != name][: _MOST_IMAGES - 1]
    middle = 0.5 * (window[0] + window[1]), 0.5 * (window[2] + window[3])
    _, found = linked.under(name, *middle, wanted=others)
    places = {linked.block.images[one.image].name: one for one in found}
    every = [_view(linked, tiles, name, window, None)]
    for other in others:
        if other in places:
            seen = _same_ground(places[other], window, middle)
            every.append(_view(linked, tiles, other, seen, places[other]))
    return images_sheet(every, factor, linked.block.adjusted)


def _view(
    linked: LinkedImages, tiles: Tiles, name: str, window: _Window, predicted: Prediction | None
) -> "ImageView":
    from mgsgraph.results.figures.image_views import ImageView

    block = linked.block
    j = block.network.image_number(name)
    grey, contrast = None, (0.0, 1.0)
    extent = 0.0, float(block.images[j].samples), float(block.images[j].lines), 0.0
    if tiles.has(name):
        pyramid = tiles.picture(name)
        contrast = pyramid.low, pyramid.high
        grey, extent = part_of(pyramid, window)
    ellipse = None
    if predicted is not None and predicted.ellipse is not None:
        ellipse = predicted.place, predicted.ellipse.semi_axes, np.degrees([predicted.ellipse.angle])
    ties, shots = ties_inside(ties_of(block, j), window), shots_of(block, j)
    return ImageView(name, grey, extent, window, contrast, ties, shots, ellipse)


def part_of(
    pyramid: Pyramid, window: _Window
) -> tuple[Array | None, _Window]:
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
    found: Prediction, window: _Window, middle: tuple[float, float]
) -> _Window:
    """The window of another image that holds the ground of the first one's."""
    corners = np.array([(line, sample) for line in window[:2] for sample in window[2:]]) - middle
    places = found.place + corners @ found.jacobian.T
    (line0, sample0), (line1, sample1) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return line0, line1, sample0, sample1


def ties_inside(ties: dict[str, Any], window: _Window) -> dict[str, Any]:
    """The ties of an image that were measured in a window of it."""
    measured = np.array(ties["measured"], dtype=np.float64).reshape(-1, 2)
    line0, line1, sample0, sample1 = window
    above, below = (line0, sample0), (line1, sample1)
    mine = np.flatnonzero(np.all((measured >= above) & (measured <= below), axis=1)).tolist()
    return ties | {key: [ties[key][k] for k in mine] for key in ("names", "measured", "residuals", "used")}


# --- the map


def map_figure(
    opened: Opened, box: Array, size: tuple[float, float], value: str, kinds: Mask, layers: Collection[str],
    factor: float = 0.0,
) -> "Sheet":
    """A window of the map as a figure.

    Parameters
    ----------
    opened : Opened
    box : (4,)
        x and y, low and high, m on the map.
    size : tuple of float
        Width and height of the window in CSS pixels, for the size of cells.
    value : str
        By which points are coloured, one of `VALUES`.
    kinds : (classes,)
        Which points.
    layers : collection of str
        Those of `LAYERS` that are drawn; others are left out.
    factor : float, optional
        Enlargement of ellipses and corrections; 0 for round ones that suit.

    Raises
    ------
    InputError
        No layer that a figure has; an unknown value; a negative factor.
    """
    from mgsgraph.results.figures.map import MapWindow, window_sheet

    if not any(one in LAYERS for one in layers):
        raise InputError("figure of the map", "no layer", f"some of {', '.join(LAYERS)}")
    if factor < 0.0:
        raise InputError("figure of the map, factor", f"{factor:g}", "0 or above")
    record = map_points(opened).window(box, size, value, kinds)
    low, high = record["low"], record["high"]
    if value == _SIGNED:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    names = [image.name for image in opened.block().images]
    terrain = opened.block().terrain is not None
    shown = MapWindow(
        opened.name, opened.centre, box,
        dict(zip(names, opened.footprints(), strict=True)) if "footprints" in layers else {},
        *_points(record, layers), (record["title"], record["unit"]), (low, high), record["count"],
        np.array(record["classes"], dtype=np.int64) if record["form"] == "points" else None,
        _covariances(record, layers), _moved(record, layers),
        shaded_relief(opened, box, size) if terrain and "relief" in layers else None, factor,
    )  # fmt: skip
    return window_sheet(shown)


def _points(record: dict[str, Any], layers: Collection[str]) -> tuple[Array, Array]:
    """Places and values; of cells the middles of those whose corrections are drawn, and the values of all."""
    hidden = "points" not in layers
    if record["form"] == "points":
        values = _known(record["values"])
        return np.column_stack([record["x"], record["y"]]), np.full_like(values, np.nan) if hidden else values
    rows, columns = record["rows"], record["columns"]
    values = np.full(rows * columns, np.nan)
    if not hidden:
        values[record["cells"]] = _known(record["values"])
    box, (row, column) = np.array(record["box"]), np.divmod(np.array(record["cells"])[_chosen(record)], columns)
    steps = (box[2:] - box[:2]) / [columns, rows]
    return box[:2] + (np.column_stack([column, row]) + 0.5) * steps, values.reshape(rows, columns)


def _chosen(record: dict[str, Any]) -> Mask:
    """(cells,) those whose corrections are drawn."""
    row, column = np.divmod(np.array(record["cells"], dtype=np.int64), record["columns"])
    return np.asarray((row % _EVERY == _EVERY // 2) & (column % _EVERY == _EVERY // 2))


def _covariances(record: dict[str, Any], layers: Collection[str]) -> Array | None:
    if "ellipses" not in layers or record["form"] != "points":
        return None
    east, both, north = _known(record["covariance"])
    return np.stack([east, both, both, north], axis=1).reshape(-1, 2, 2)


def _moved(record: dict[str, Any], layers: Collection[str]) -> Array | None:
    if "moved" not in layers:
        return None
    moved = _known(record["moved"])[:2].T
    return moved if record["form"] == "points" else moved[_chosen(record)]


def _known(values: Any) -> Array:
    """Numbers, of any shape, in which None stands for what is not known; NaN for these."""
    return np.array(values, dtype=object).astype(np.float64)
