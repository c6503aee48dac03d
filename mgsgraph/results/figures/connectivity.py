"""Which images share points with which: a matrix of all pairs.

Few images have their names and numbers of points written into the matrix, many share rows (`sheet.image_rows`).
"""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network.connectivity import WEAKEST, Connectivity, connectivity_statements, worth_tying
from mgsgraph.results.figures.sheet import INK, MOST_ROWS, Sheet, image_rows, new_sheet, plain_style
from mgsgraph.text import short

_FEWEST, _NUMBERED, _NAMED = 3, 15, 40
"""Images from which on the matrix is drawn, up to which cells have numbers of points, and rows names beside them."""
_MARKS = (
    ("weakest links", "s", "#D55E00"), ("overlap without common points", "o", "#777777"),
    ("common points without overlap", "X", "#AA0000"), ("image without links", "x", "#222222"),
)  # fmt: skip


def links_sheets(solution: Solution, connected: Connectivity | None = None) -> Iterator[Sheet]:
    """The figure of a solution; `connected` saves finding it anew. None of two images, of which one number says all."""
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
    known = values[np.isfinite(values)]
    high = float(known.max()) if known.size else 1.0
    drawn = panel.imshow(
        np.ma.masked_invalid(values), cmap="viridis", vmin=0.0, vmax=high, interpolation="nearest",
        extent=(-0.5, count - 0.5, count - 0.5, -0.5), aspect="auto",
    )  # fmt: skip
    sheet.colour_bar(drawn, panel, "points that two images share", MaxNLocator(6, integer=True))
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
    marked = [connected.pairs[rows[:MOST_ROWS]] for rows in (weakest, worth_tying(connected), connected.apart)]
    alone = connected.unconnected if count > 1 else np.zeros(0, dtype=np.int64)
    handles = []
    for (label, marker, color), pairs in zip(_MARKS, (*marked, np.stack([alone, alone], axis=1)), strict=True):
        if pairs.size:
            both = np.concatenate([pairs, pairs[:, ::-1]])
            size = float(np.clip(140.0 / count, 3.0, 16.0))
            handles += panel.plot(*both.T, ls="", marker=marker, ms=size, mfc="none", mec=color, mew=1.2, label=label)
    sheet.legend(handles)
    return sheet


def adjacency(connected: Connectivity, most: int = MOST_ROWS) -> Array:
    """(r, r) most points that a pair of images of each row and column shares, symmetric; NaN where none does."""
    row = image_rows(len(connected.names), most)
    found = np.full((int(row[-1]) + 1,) * 2, 0.0)
    one, other = row[connected.pairs[connected.links]].T
    points = connected.points[connected.links].astype(np.float64)
    np.maximum.at(found, (one, other), points)
    np.maximum.at(found, (other, one), points)
    return np.where(found > 0.0, found, np.nan)


def _caption(connected: Connectivity) -> str:
    several = -(-len(connected.names) // MOST_ROWS)
    words = f" A cell has up to {several} by {several} images, and the most points of a pair of them." * (several > 1)
    return f"{' '.join(connectivity_statements(connected)) or 'One image.'}{words}"
