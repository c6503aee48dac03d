"""Which images share points with which: a matrix of all pairs, the links of each image, and the footprints on a map.

One figure for two images and for thousands: few images have their names and numbers of points written into the matrix,
many share rows (`aggregate.image_rows`).
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.body import centre_of, plane_coordinates
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network.connectivity import WEAKEST, Connectivity, connectivity_statements, worth_tying
from mgsgraph.results.figures.aggregate import MOST_ROWS, image_rows
from mgsgraph.results.figures.map import frame, map_axes
from mgsgraph.results.figures.sheet import AFTER, INK, SOFT, Sheet, new_sheet, plain_style, short
from mgsgraph.units import KM

_ISLANDS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors of the largest islands; smaller ones are gray."""
_NUMBERED, _NAMED = 15, 40
"""Images up to which numbers of points are written into the cells, and names beside them."""
_MOST_OUTLINES = 2000
"""Footprints on the map."""
_MARKS = (
    ("weakest links", "s", "#D55E00"), ("overlap without common points", "o", "#777777"),
    ("common points without overlap", "X", "#AA0000"), ("image without links", "x", "#222222"),
)  # fmt: skip


def links_sheet(solution: Solution, connected: Connectivity | None = None) -> Sheet:
    """The figure of a solution; `connected` saves finding it anew."""
    return connectivity_sheet(connected or solution_connectivity(solution))


@plain_style()
def connectivity_sheet(connected: Connectivity) -> Sheet:
    """Points in common by pairs of images, the links of each image, and the footprints on a map."""
    count = len(connected.names)
    sound = [one.outline for one in connected.footprints if one.outline.shape[0]]
    centre = centre_of(np.concatenate(sound))
    outlines = [plane_coordinates(one.outline, centre) / KM for one in connected.footprints]
    low, high, (width, height) = frame(np.concatenate(outlines), least=(2.6, 5.0))
    wide, many = (6.0, True) if count > _NUMBERED else (3.0 + 0.25 * count, False)
    sheet = new_sheet(
        "connectivity", wide + 3.0 + width, max(height, 6.4 if many else 3.6) + 0.7, "Common points of the images",
        _caption(connected), vector=count <= _NAMED,
    )  # fmt: skip
    grid = sheet.figure.add_gridspec(
        3 if many else 1, 2, width_ratios=[wide, width], height_ratios=[5.0, 1.0, 1.0] if many else [1.0]
    )
    matrix, ground = sheet.figure.add_subplot(grid[0, 0]), sheet.figure.add_subplot(grid[:, 1])
    handles = _draw_matrix(sheet, matrix, connected)
    if many:
        _draw_joints([sheet.figure.add_subplot(grid[row, 0]) for row in (1, 2)], connected)
    map_axes(ground, low, high, centre)
    step = -(-count // _MOST_OUTLINES)
    few = len(connected.islands) == 1 and count <= len(_ISLANDS)
    colors = list(_ISLANDS[:count]) if few else island_colors(connected)
    shown = [(outline, color) for outline, color in zip(outlines, colors, strict=True) if outline.size][::step]
    lines = LineCollection([outline for outline, _ in shown], colors=[color for _, color in shown], linewidths=0.8)
    ground.add_collection(lines, autolim=False)
    ground.set_title("footprints, islands by color" if len(connected.islands) > 1 else "footprints")
    if not many:
        for k, (outline, name, color) in enumerate(zip(outlines, connected.names, colors, strict=True)):
            if outline.size:  # names of neighbors stand in different rows, inside
                place, below = outline[np.argmax(outline[:, 1])].tolist(), -12.0 - 8.0 * (k % 4)
                ground.annotate(
                    short(name, 18), place, (0.0, below), textcoords="offset points", size=6.5, ha="center", color=color
                )
    sheet.legend(handles)
    return sheet


def island_colors(connected: Connectivity) -> list[str]:
    """Of each image: one for each of the largest islands, gray for smaller ones and for images without links."""
    colors = [SOFT] * len(connected.names)
    for island, color in zip(connected.islands, _ISLANDS, strict=False):
        for j in island:
            colors[j] = color if len(island) > 1 or len(colors) == 1 else SOFT
    return colors


def adjacency(connected: Connectivity, most: int = MOST_ROWS) -> Array:
    """(r, r) most points that a pair of images of each row and column shares, symmetric; NaN where none does."""
    row = image_rows(len(connected.names), most)
    found = np.full((int(row[-1]) + 1,) * 2, 0.0)
    one, other = row[connected.pairs[connected.links]].T
    points = connected.points[connected.links].astype(np.float64)
    np.maximum.at(found, (one, other), points)
    np.maximum.at(found, (other, one), points)
    return np.where(found > 0.0, found, np.nan)


def joints(connected: Connectivity) -> tuple[Array, Array]:
    """(images,) number of images that each shares points with, and the points of its strongest link; zero without."""
    number, most = np.zeros(len(connected.names)), np.zeros(len(connected.names))
    ends, points = connected.pairs[connected.links], connected.points[connected.links].astype(np.float64)
    for column in ends.T:
        np.add.at(number, column, 1.0)
        np.maximum.at(most, column, points)
    return number, most


def _draw_matrix(sheet: Sheet, panel: Axes, connected: Connectivity) -> list[Line2D]:
    """Cells of all pairs, with marks of the remarkable ones; handles of these."""
    values, count = adjacency(connected), len(connected.names)
    panel.grid(visible=False)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 2.0)
    drawn = panel.imshow(
        np.ma.masked_invalid(values), cmap="viridis", norm=LogNorm(low, max(high, 1.1 * low)), interpolation="nearest",
        extent=(-0.5, count - 0.5, count - 0.5, -0.5), aspect="auto",
    )  # fmt: skip
    if high > low:
        sheet.colour_bar(drawn, panel, "points that two images share (logarithmic)", LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        panel.set_title("points that two images share")
    if count > _NAMED:
        panel.set(ylabel="image")
    else:
        names = [short(name, 18) for name in connected.names]
        panel.set_yticks(range(count), names, size=7.0)
        panel.set_xticks(range(count), names, size=7.0, rotation=90.0 if count > 3 else 0.0)
    if count <= _NUMBERED:
        for j, k in np.argwhere(np.isfinite(values)).tolist():
            ink = INK if values[j, k] > np.sqrt(low * high) else "white"
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
    return handles


def _draw_joints(panels: Sequence[Axes], connected: Connectivity) -> None:
    """Strongest link and number of links of each image."""
    number, most = joints(connected)
    labels = "points of the\nstrongest link", "images\nlinked with"
    for panel, values, label in zip(panels, (most, number), labels, strict=True):
        panel.step(np.arange(values.size), values, color=AFTER, lw=1.0, where="mid")
        panel.set(ylabel=label, xlim=(-0.5, values.size - 0.5), ylim=(0.0, 1.1 * max(float(values.max()), 1.0)))
    panels[-1].set_xlabel("image, in the order of the case (from 0)")


def _caption(connected: Connectivity) -> str:
    several = -(-len(connected.names) // MOST_ROWS)
    words = f" A cell has up to {several} by {several} images, and the most points of a pair of them." * (several > 1)
    band = " A band along the diagonal is a strip, cells beside it are overlaps of strips."
    statements = " ".join(connectivity_statements(connected)) or "One image."
    return f"{statements} Each pair of images that shares points is a cell, twice.{band * (several > 1)}{words}"
