"""How the images of a large block hang together: which share points with which, as a picture of cells."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.geometry.records import Array
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import connectivity_statements
from mgsgraph.results.figures.aggregate import MOST_ROWS, image_rows
from mgsgraph.results.figures.connectivity import connectivity_sheet, island_colours
from mgsgraph.results.figures.ground_map import frame, map_axes
from mgsgraph.results.figures.sheet import AFTER, INK, Sheet, new_sheet, plain_style
from mgsgraph.units import KM

_MOST_NODES = 50
"""Images up to which a graph shows more than cells do."""
_MOST_OUTLINES = 2000
"""Footprints on the map."""


def links_sheet(solution: Solution, connected: Connectivity | None = None) -> Sheet:
    """A graph of the images, or cells where they are many; `connected` saves finding it anew."""
    connected = connected or solution_connectivity(solution)
    if len(connected.names) <= _MOST_NODES:
        return connectivity_sheet(solution, connected)
    return adjacency_sheet(connected)


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


@plain_style()
def adjacency_sheet(connected: Connectivity) -> Sheet:
    """Points in common by pairs of images, the links of each image, and the footprints on a map."""
    sound = [one.outline for one in connected.footprints if one.outline.shape[0]]
    centre = centre_of(np.concatenate(sound))
    outlines = [east_north(one.outline, centre) / KM for one in connected.footprints]
    low, high, (width, height) = frame(np.concatenate(outlines), least=(2.6, 5.0))
    height = max(height, 6.4)
    sheet = new_sheet(
        "connectivity", 6.0 + 3.0 + width, height + 0.7, "How the images hang together", _caption(connected),
        vector=False,
    )  # fmt: skip
    grid = sheet.figure.add_gridspec(3, 2, width_ratios=[6.0, width], height_ratios=[5.0, 1.0, 1.0])
    matrix, *joined = (sheet.figure.add_subplot(grid[row, 0]) for row in range(3))
    ground = sheet.figure.add_subplot(grid[:, 1])
    _draw_matrix(sheet, matrix, connected)
    _draw_joints(joined, connected)
    map_axes(ground, low, high, centre)
    step = -(-len(outlines) // _MOST_OUTLINES)
    colours = island_colours(connected)
    shown = [(outline, colour) for outline, colour in zip(outlines, colours, strict=True) if outline.size][::step]
    lines = LineCollection([outline for outline, _ in shown], colors=[colour for _, colour in shown], linewidths=0.6)
    ground.add_collection(lines, autolim=False)
    ground.set_title("footprints, islands by colour" if len(connected.islands) > 1 else "footprints")
    sheet.legend([
        Line2D([], [], color=AFTER, lw=1.2, label="of each image"),
        Line2D([], [], color=INK, ls="", marker="x", ms=5.0, label="image without links"),
    ])  # fmt: skip
    return sheet


def _draw_matrix(sheet: Sheet, panel: Axes, connected: Connectivity) -> None:
    values, count = adjacency(connected), len(connected.names)
    panel.grid(visible=False)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 2.0)
    drawn = panel.imshow(
        np.ma.masked_invalid(values), cmap="viridis", norm=LogNorm(low, max(high, 1.1 * low)), interpolation="nearest",
        extent=(-0.5, count - 0.5, count - 0.5, -0.5), aspect="auto",
    )  # fmt: skip
    sheet.colour_bar(drawn, panel, "points that two images share (logarithmic)", LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.set(ylabel="image")


def _draw_joints(panels: Sequence[Axes], connected: Connectivity) -> None:
    number, most = joints(connected)
    alone = np.flatnonzero(number == 0)
    for panel, values, label in zip(panels, (most, number), ("points of the\nstrongest link", "images\nlinked with"),
                                    strict=True):  # fmt: skip
        panel.step(np.arange(values.size), values, color=AFTER, lw=1.0, where="mid")
        if alone.size:  # unclipped marks that aren't there would take room all the same
            panel.plot(alone, np.zeros(alone.size), ls="", marker="x", ms=5.0, color=INK, zorder=5, clip_on=False)
        panel.set(ylabel=label, xlim=(-0.5, values.size - 0.5), ylim=(0.0, 1.1 * max(float(values.max()), 1.0)))
    panels[-1].set_xlabel("image, in the order of the case (from 0)")


def _caption(connected: Connectivity) -> str:
    several = -(-len(connected.names) // MOST_ROWS)
    words = f" A cell has up to {several} by {several} images, and the most points of a pair of them." * (several > 1)
    return (
        f"{' '.join(connectivity_statements(connected))} Each pair of images that shares points is a cell, twice; a "
        f"band along the diagonal is a strip, cells aside of it are overlaps of strips.{words}"
    )
