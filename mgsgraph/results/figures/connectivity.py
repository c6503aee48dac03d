"""Which images share points with which: a matrix of all pairs.

Few images have their names and numbers of points written into the matrix, many share rows (`sheet.image_rows`).
"""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.records import Array, Index, no_rows
from mgsgraph.network.connectivity import WEAKEST, Connectivity, connectivity_statements, lacking_ties
from mgsgraph.results.figures.sheet import INK, MOST_ROWS, Sheet, image_rows, new_sheet, plain_style
from mgsgraph.text import short

_FEWEST, _NUMBERED, _NAMED = 3, 15, 40
"""Images from which on the matrix is drawn, up to which cells have numbers of points, and rows names beside them."""
_MARKS = (
    ("weakest links", "s", "#D55E00"), ("overlap without common points", "o", "#777777"),
    ("common points without overlap", "X", "#AA0000"), ("image without links", "x", "#222222"),
)  # fmt: skip


def links_sheets(solution: Solution, connected: Connectivity | None = None) -> Iterator[Sheet]:
    """The figure of a solution; `connected` saves computing it again. No figure of fewer than three images."""
    if len(solution.network.images) >= _FEWEST:
        yield connectivity_sheet(connected or solution_connectivity(solution))


@plain_style()
def connectivity_sheet(connected: Connectivity) -> Sheet:
    """Points in common by pairs of images, with marks of the remarkable ones."""
    values, count = adjacency(connected), len(connected.names)
    side = 6.4 if count > _NUMBERED else 3.0 + 0.25 * count
    sheet = new_sheet("connectivity", side + 2.6, side, "Common points of the images", _caption(connected))
    panel: Axes = sheet.panels()[0, 0]
    panel.grid(visible=False)
    finite = values[np.isfinite(values)]
    high = float(finite.max()) if finite.size else 1.0
    mappable = panel.imshow(
        np.ma.masked_invalid(values), cmap="viridis", vmin=0.0, vmax=high, interpolation="nearest",
        extent=(-0.5, count - 0.5, count - 0.5, -0.5), aspect="auto",
    )  # fmt: skip
    sheet.colour_bar(mappable, panel, "points that two images share", MaxNLocator(6, integer=True))
    if count > _NAMED:
        panel.set(ylabel="image")
    else:
        names = [short(name, 18) for name in connected.names]
        panel.set_yticks(range(count), names, size=7.0)
        panel.set_xticks(range(count), names, size=7.0, rotation=90.0 if count > 3 else 0.0)
    if count <= _NUMBERED:
        for j, k in np.argwhere(np.isfinite(values)).tolist():
            ink = INK if values[j, k] > 0.5 * high else "white"
            panel.annotate(f"{values[j, k]:.0f}", (k, j), ha="center", va="center", size=7.5, color=ink)
    weakest: Index = connected.spine[: min(WEAKEST, connected.spine.size // 2)]
    marked = [connected.pairs[rows[:MOST_ROWS]] for rows in (weakest, lacking_ties(connected), connected.disjoint)]
    isolated = connected.unconnected if count > 1 else no_rows()
    handles = []
    for (label, marker, color), pairs in zip(_MARKS, (*marked, np.stack([isolated, isolated], axis=1)), strict=True):
        if pairs.size:
            cells = np.concatenate([pairs, pairs[:, ::-1]])
            size = float(np.clip(140.0 / count, 3.0, 16.0))
            handles += panel.plot(*cells.T, ls="", marker=marker, ms=size, mfc="none", mec=color, mew=1.2, label=label)
    sheet.legend(handles)
    return sheet


def adjacency(connected: Connectivity, max_rows: int = MOST_ROWS) -> Array:
    """(r, r) most points that a pair of images of each row and column shares, symmetric; NaN where none does."""
    row = image_rows(len(connected.names), max_rows)
    matrix = np.full((int(row[-1]) + 1,) * 2, 0.0)
    first, second = row[connected.pairs[connected.links]].T
    points = connected.points[connected.links].astype(np.float64)
    np.maximum.at(matrix, (first, second), points)
    np.maximum.at(matrix, (second, first), points)
    return np.where(matrix > 0.0, matrix, np.nan)


def _caption(connected: Connectivity) -> str:
    per_row = -(-len(connected.names) // MOST_ROWS)
    remark = f" A cell has up to {per_row} by {per_row} images, and the most points of a pair of them." * (per_row > 1)
    return f"{' '.join(connectivity_statements(connected)) or 'One image.'}{remark}"
