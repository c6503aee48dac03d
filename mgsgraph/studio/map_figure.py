"""The map's window as a figure: what the page shows of it, from the same records."""

from collections.abc import Collection
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.results.figures.image_views import known
from mgsgraph.results.figures.map import MapWindow, window_sheet
from mgsgraph.results.figures.sheet import Sheet
from mgsgraph.studio.map_layers import shaded_relief
from mgsgraph.studio.map_points import map_points
from mgsgraph.studio.opened import Opened

LAYERS = ("footprints", "points", "ellipses", "moved", "relief")
"""Layers of the page that a figure has."""
_SIGNED = "moved_up"
_EVERY = 5
"""Columns and rows of cells, of which one has its correction drawn."""


def map_figure(
    opened: Opened, box: Array, size: tuple[float, float], value: str, kinds: Mask, layers: Collection[str],
    factor: float = 0.0,
) -> Sheet:
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
        values = known(record["values"])
        return np.column_stack([record["x"], record["y"]]), np.full_like(values, np.nan) if hidden else values
    rows, columns = record["rows"], record["columns"]
    values = np.full(rows * columns, np.nan)
    if not hidden:
        values[record["cells"]] = known(record["values"])
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
    east, both, north = known(record["covariance"])
    return np.stack([east, both, both, north], axis=1).reshape(-1, 2, 2)


def _moved(record: dict[str, Any], layers: Collection[str]) -> Array | None:
    if "moved" not in layers:
        return None
    moved = known(record["moved"])[:2].T
    return moved if record["form"] == "points" else moved[_chosen(record)]
