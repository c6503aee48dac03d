"""A figure for papers: the map's window as the page shows it, as SVG, PNG or PDF with a caption."""

from collections.abc import Callable, Collection
from importlib import import_module
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.responses import Response

from mgsgraph.errors import require
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.studio.map_graticule import graticule
from mgsgraph.studio.map_images import MapImages
from mgsgraph.studio.map_points import map_points, pixels_of
from mgsgraph.units import KM

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet

_TYPES = {"svg": "image/svg+xml", "png": "image/png", "pdf": "application/pdf"}
_MATPLOTLIB = Lock()
"""All threads share matplotlib's settings."""
LAYERS = ("footprints", "points", "ellipses", "moved", "images", "relief", "graticule")
"""Layers of the map that a figure has."""
_SIGNED = "moved_up"


def load_figures() -> None:
    """Import what draws a figure; under the lock, for threads would take each other's half-made modules."""
    with _MATPLOTLIB:
        import_module("mgsgraph.results.figures.map")


def drawn(view: str, kind: str, make: "Callable[[], Sheet]") -> Response:
    """A view, drawn by `make`, as an attachment with its caption; InputError of what can't be written."""
    require(kind in _TYPES, "figure", f"{view}.{kind}"[:60], f"one of {', '.join(_TYPES)}")
    load_figures()
    from mgsgraph.results.figures.sheet import encoded

    with _MATPLOTLIB:
        sheet = make()
        metadata: dict[str, str | None] = {"Title": sheet.title, "Description": sheet.caption}
        options: dict[str, Any] = {"pil_kwargs": {"compress_level": 1}} if kind == "png" else {}
        if kind == "pdf":
            metadata = {"Title": sheet.title, "Subject": sheet.caption, "Creator": "mgsgraph", "CreationDate": None}
        elif kind == "svg":
            metadata |= {"Date": None, "Creator": "mgsgraph"}
        data = encoded(sheet, kind, metadata=metadata, **options)
    return Response(data, media_type=_TYPES[kind], headers={
        "Content-Disposition": f'attachment; filename="{view}.{kind}"', "Cache-Control": "no-store",
    })  # fmt: skip


def map_figure(
    images: MapImages, box: Array, size: tuple[float, float], value: str, kinds: Mask, layers: Collection[str],
    factor: float = 0.0, top: str = "",
) -> "Sheet":
    """A window of the map as a figure.

    Parameters
    ----------
    images : MapImages
        Of the block.
    box : (4,)
        x and y, low and high, m on the map.
    size : tuple of float
        Width and height of the window in CSS pixels, for the size of cells.
    value : str
        Value that colors the points, one of `VALUES`.
    kinds : (classes,)
        Classes of points that are drawn.
    layers : collection of str
        Those of `LAYERS` that are drawn; others are left out.
    factor : float, optional
        Enlargement of ellipses and corrections; 0 chooses a round one.
    top : str, optional
        Image that lies on the others.

    Raises
    ------
    InputError
        No layer that a figure has; an unknown value; a negative factor.
    """
    from mgsgraph.results.figures.map import MapWindow, window_sheet

    require(any(layer in LAYERS for layer in layers), "figure of the map", "no layer", f"some of {', '.join(LAYERS)}")
    require(factor >= 0.0, "figure of the map, factor", f"{factor:g}", "0 or above")
    opened = images.opened
    points = map_points(opened)
    record = points.window(box, size, value, kinds)
    classes_and_ellipses: tuple[Index | None, Array | None] = None, None
    if record["form"] == "points":
        chosen = points.inside(box, kinds)
        places, values, moved = points.plane[chosen], points.value(value)[chosen], points.moved[chosen][:, :2]
        classes_and_ellipses = points.classes[chosen], points.local[chosen][:, :2, :2] if "ellipses" in layers else None
    else:
        values, cells = np.full((record["rows"], record["columns"]), np.nan), np.array(record["cells"], dtype=np.int64)
        values.flat[cells] = np.array(record["values"], dtype=np.float64)
        places, moved = np.array(record["places"]).reshape(-1, 2), np.array(record["moved"]).reshape(2, -1).T
    low, high = record["low"], record["high"]
    if value == _SIGNED:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    names = [image.name for image in opened.block().images]
    ground = images.picture(box, pixels_of(size)[::-1], layers, top) / 255.0
    sheet = window_sheet(MapWindow(
        opened.now.name, opened.centre, box,
        dict(zip(names, opened.footprints(), strict=True)) if "footprints" in layers else {},
        places, values if "points" in layers else np.full_like(values, np.nan), (record["title"], record["unit"]),
        (low, high), record["count"], *classes_and_ellipses, moved if "moved" in layers else None,
        ground if np.any(np.isfinite(ground)) else None, factor,
    ))  # fmt: skip
    for line in graticule(opened, box) if "graticule" in layers else []:
        _draw_line(sheet.figure.axes[0], line["label"], np.array(line["places"]) / KM)
    return sheet


def _draw_line(panel: Any, label: str, line: Array) -> None:
    """A meridian or parallel (k, 2) in km, with its label where it begins in the panel."""
    panel.plot(*line.T, color="gray", lw=0.5, zorder=1.5)
    low, high = np.transpose([panel.get_xlim(), panel.get_ylim()])
    for place in line[np.all((line > low) & (line < high), axis=1)][:1]:
        panel.annotate(label, place, xytext=(2, 2), textcoords="offset points", size=6.5, zorder=8)
