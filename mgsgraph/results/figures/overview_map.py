"""The ground points of a large block by cells of the ground: how dense, how well known, and how far they were moved.

A strip is a thousand times as long as wide: such a block is drawn along and across its own middle line, each to a scale
of its own; any other block is drawn to one scale, east and north.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import counts, medians, span
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import PointClass
from mgsgraph.registration.measured import thinned
from mgsgraph.results.figures.aggregate import cell_numbers, limit
from mgsgraph.results.figures.sheet import CLASS_COLOUR, CLASS_NAME, Sheet, new_sheet, number, plain_style
from mgsgraph.units import KM

_LONG = 4.0
"""Length over width from which on a block is drawn along and across."""
_DEGREE = 5
"""Of the polynomial that the middle line of a long block follows."""
_CELLS_ALONG, _CELLS_ACROSS = 240, 40
"""Cells of a long block; another one has as many along its longer side, of square shape."""
WEAK = 5.0
"""Times the median sigma: points beyond are no part of cells, whose colours they would take, but marked one by one."""
_MOST_WEAK, MOST_TRACK = 500, 400
"""Marks of weak points, and places of a laser track that are drawn."""
WEAK_COLOUR, _EMPTY = "#CC0000", "#EEEEEE"


@dataclass(frozen=True, slots=True, eq=False)
class GroundFrame:
    """Where places are drawn: along and across the middle of a block."""

    places: Array
    """(n, 2) km, first coordinate rightward; NaN where a point has no place."""
    low: Array
    """(2,) km, lower left corner."""
    high: Array
    """(2,) km, upper right corner."""
    sound: Mask
    """(n,) points that are drawn by cells: determined, and not weak."""
    long: bool
    """Whether the axes are along and across the block, not east and north."""
    cells: tuple[int, int]
    """Of the first and second coordinate."""


def ground_frame(places: Array, sound: Mask) -> GroundFrame:
    """Coordinates of places (n, 3) m, body-fixed, in which a picture of the sound ones (n,) is full."""
    plane = east_north(places, centre_of(places)) / KM
    middle = plane[sound].mean(axis=0)
    spread, turn = np.linalg.eigh(np.cov((plane[sound] - middle).T))
    long = bool(spread[1] > _LONG**2 * spread[0])
    if long:
        axis = turn[:, 1] * np.sign(turn[np.argmax(np.abs(turn[:, 1])), 1])
        along = (plane - middle) @ axis
        plane = np.stack([along, (plane - middle) @ np.array([-axis[1], axis[0]])], axis=1)
        plane[:, 1] -= _middle_line(plane[sound])(along)
    low, high = plane[sound].min(axis=0), plane[sound].max(axis=0)
    size = np.maximum(high - low, 1e-6)
    cells = (_CELLS_ALONG, _CELLS_ACROSS) if long else _square(size)
    return GroundFrame(plane, low, low + size, sound, long, cells)


def _middle_line(plane: Array) -> np.polynomial.Polynomial:
    """Second coordinate of the middle over the first, of places (n, 2) km."""
    low, high = plane[:, 0].min(), plane[:, 0].max()
    part = np.clip((plane[:, 0] - low) / (high - low) * _CELLS_ALONG, 0.0, _CELLS_ALONG - 1.0).astype(np.int64)
    middle = medians(plane[:, 1], part, _CELLS_ALONG)
    known = np.flatnonzero(np.isfinite(middle))
    along = low + (known + 0.5) * (high - low) / _CELLS_ALONG
    return np.polynomial.Polynomial.fit(along, middle[known], min(_DEGREE, known.size - 1))


def _square(size: Array) -> tuple[int, int]:
    edge = float(size.max()) / _CELLS_ALONG * 2.0
    east, north = np.maximum(np.ceil(size / edge), 1.0).astype(int).tolist()
    return east, north


@dataclass(frozen=True, slots=True, eq=False)
class GroundCells:
    """What a block's points say by cells of the ground."""

    density: Array
    """(first, second) points per km^2; NaN where there are none."""
    sigma: Array
    """(first, second) m, median 3-D sigma."""
    horizontal: Array
    """(first, second) m, median length of the horizontal correction."""
    upward: Array
    """(first, second) m, median correction upward."""


def ground_cells(solution: Solution, frame: GroundFrame) -> GroundCells:
    """Medians of the sound points of all classes in each cell."""
    sound = np.flatnonzero(frame.sound)
    first, second = frame.cells
    cell, total = cell_numbers(frame.places[sound] - frame.low, frame.high - frame.low, frame.cells), first * second
    there, before = solution.places[sound], solution.places_before[sound]
    east, north, up = np.einsum("nij,nj->in", east_north_up(there), there - before)
    sigma = np.sqrt(np.trace(solution.covariances[sound], axis1=1, axis2=2))
    of = counts(cell, total)
    area = float(np.prod((frame.high - frame.low) / frame.cells))
    middles = [medians(values, cell, total) for values in (sigma, np.hypot(east, north), up)]
    found = (np.where(of > 0, of / area, np.nan), *middles)
    return GroundCells(*(values.reshape(first, second) for values in found))


@plain_style()
def overview_map(solution: Solution) -> Sheet:
    """Density, sigma and corrections, one panel each, with the laser's tracks and weak points on them."""
    weak = weak_points(solution)
    frame = ground_frame(solution.places, solution.determined & ~weak)
    cells = ground_cells(solution, frame)
    sheet = new_sheet(
        "overview_map", 11.0, 10.4, "Ground points of the block by cells", _caption(solution, frame, cells, weak),
        vector=False,
    )  # fmt: skip
    panels = (sheet.panels(4, 1, sharex="all", sharey="all") if frame.long else sheet.panels(2, 2)).ravel().tolist()
    up = limit(cells.upward)
    shown = (
        (cells.density, "viridis", _positive(cells.density), "points per km² (logarithmic)"),
        (cells.sigma, "viridis", Normalize(*span(cells.sigma)), "median 3-D sigma (m, sigma0 = 1)"),
        (cells.horizontal, "viridis", Normalize(*span(cells.horizontal)), "median horizontal correction (m)"),
        (cells.upward, "RdBu_r", Normalize(-up, up), "median correction upward (m)"),
    )
    for panel, (values, colours, norm, label) in zip(panels, shown, strict=True):
        draw_cells(sheet, panel, frame, values, colours, norm, label)
    handles = _draw_marks(panels, solution, frame, weak)
    panels[0].set(xlim=(frame.low[0], frame.high[0]), ylim=(frame.low[1], frame.high[1]))
    axes = ("km along the block", "km across,\nfrom its middle") if frame.long else ("km east", "km north")
    for k, panel in enumerate(panels):
        if not frame.long or k == 3:
            panel.set_xlabel(axes[0])
        panel.set_ylabel(axes[1])
    sheet.legend(handles)
    return sheet


def _positive(values: Array) -> Normalize:
    low, high = span(values)
    return LogNorm(max(low, 1e-9), max(high, 1.01 * low, 1e-8))


def draw_cells(
    sheet: Sheet, panel: Axes, frame: GroundFrame, values: Array, colours: str, norm: Normalize, label: str
) -> None:
    """Values (first, second) of a frame's cells as colours, with their bar."""
    panel.set_facecolor(_EMPTY)
    panel.grid(visible=False)
    drawn = panel.imshow(
        np.ma.masked_invalid(values.T), origin="lower", cmap=colours, norm=norm, interpolation="nearest",
        aspect="auto" if frame.long else "equal",
        extent=(frame.low[0], frame.high[0], frame.low[1], frame.high[1]),
    )  # fmt: skip
    ticks = LogLocator(subs=(1.0, 2.0, 5.0)) if isinstance(norm, LogNorm) else MaxNLocator(5)
    bar = sheet.figure.colorbar(drawn, ax=panel, extend="both", ticks=ticks, pad=0.015, aspect=14,
                                format="%g" if isinstance(norm, LogNorm) else None)  # fmt: skip
    bar.ax.minorticks_off()
    panel.set_title(label, loc="left")


def weak_points(solution: Solution) -> Mask:
    """(n,) determined points whose 3-D sigma is far above the median."""
    sigma = np.sqrt(np.trace(solution.covariances, axis1=1, axis2=2))
    sound = solution.determined & np.isfinite(sigma)
    middle = float(np.median(sigma[sound])) if np.any(sound) else 0.0
    return np.asarray(sound & (np.nan_to_num(sigma) > WEAK * middle))


def _draw_marks(panels: Sequence[Axes], solution: Solution, frame: GroundFrame, weak: Mask) -> list[Line2D]:
    """Weak points on the sigmas, and the laser's tracks on the densities; handles."""
    handles = []
    laser = solution.members(PointClass.LASER)
    if laser.size:
        track = frame.places[laser[thinned(laser.size, MOST_TRACK)]]
        colour, name = CLASS_COLOUR[PointClass.LASER], f"{CLASS_NAME[PointClass.LASER]} (thinned)"
        panels[0].plot(*track.T, ls="", marker=".", ms=2.0, mew=0.0, color=colour)
        handles.append(Line2D([], [], ls="", marker="o", ms=3.5, mew=0.0, color=colour, label=name))
    few = np.flatnonzero(weak)
    if few.size:
        places = frame.places[few[thinned(few.size, _MOST_WEAK)]]
        handles += panels[1].plot(*places.T, ls="", marker="x", ms=4.0, mew=0.9, color=WEAK_COLOUR,
                                  label=f"sigma above {WEAK:g} times the median")  # fmt: skip
    return handles


def _caption(solution: Solution, frame: GroundFrame, cells: GroundCells, weak: Mask) -> str:
    """What one sees, with figures."""
    length, width = (frame.high - frame.low).tolist()
    edge = [number(v) for v in ((frame.high - frame.low) / frame.cells).tolist()]
    medians_of = [number(float(np.nanmedian(v))) for v in (cells.density, cells.sigma, cells.horizontal, cells.upward)]
    worded = "along and across its middle line, each to its own scale" if frame.long else "to one scale, east and north"
    return (
        f"{int(np.count_nonzero(frame.sound))} points in a block of {number(length)} by {number(width)} km, "
        f"drawn {worded}, in cells of {edge[0]} by {edge[1]} km: in the cell in the middle {medians_of[0]} points per "
        f"km², a median 3-D sigma of {medians_of[1]} m, a median horizontal correction (adjusted minus before) of "
        f"{medians_of[2]} m and {medians_of[3]} m upward; colours end at the 2 % and 98 % quantiles of the cells; "
        f"{int(np.count_nonzero(weak))} points of a sigma above {WEAK:g} times the median are left out of the "
        f"cells and marked apart (at most {_MOST_WEAK}, those within the panel)."
    )
