"""Two solutions on one map: how far each common point moved, and by what factor its sigma changed.

A block of many points is drawn by cells of the ground, medians in each.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FixedLocator, MaxNLocator

from mgsgraph.analysis.statistics import CommonPoints, medians, span
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.aggregate import cell_means, cell_numbers, limit
from mgsgraph.results.figures.overview_map import GroundFrame, draw_cells, ground_frame
from mgsgraph.results.figures.sheet import MOST_MARKS, Sheet, new_sheet, number, plain_style
from mgsgraph.units import KM

_FEWEST = 3
"""Points of which a map can be made."""


@plain_style()
def comparison_sheet(points: CommonPoints, labels: tuple[str, str]) -> Sheet | None:
    """Horizontal and upward movement and the ratio of the 3-D sigmas of the common points; None of fewer than three."""
    if len(points.places) < _FEWEST:
        return None
    frame = ground_frame(points.places, np.isfinite(points.ratio) | np.isfinite(points.moved[:, 0]))
    many = len(points.places) > MOST_MARKS
    horizontal, upward = np.hypot(points.moved[:, 0], points.moved[:, 1]), points.moved[:, 2]
    up, low, high = limit(upward), *span(horizontal)
    factor = max(float(np.exp(limit(np.log(points.ratio)))), 1.01)
    shown: tuple[tuple[Array, str, Normalize, str], ...] = (
        (horizontal, "viridis", Normalize(low, high), "moved horizontally (m)"),
        (upward, "RdBu_r", Normalize(-up, up), "moved upward (m)"),
        (points.ratio, "PuOr_r", LogNorm(1.0 / factor, factor), "3-D sigma, later over earlier (logarithmic)"),
    )
    height = 7.8 if frame.long else 4.0
    caption = _caption(points, labels, many, not frame.long)
    sheet = new_sheet("comparison", 11.0, height, "Two solutions compared", caption, band=0.0, vector=not many)
    rows, columns = (3, 1) if frame.long else (1, 3)
    panels = sheet.panels(rows, columns, sharex="all", sharey="all").ravel()
    for k, (panel, (values, colours, norm, label)) in enumerate(zip(panels.tolist(), shown, strict=True)):
        if many:
            draw_cells(sheet, panel, frame, _cells(frame, values), colours, norm, label)
        else:
            _draw_marks(sheet, panel, frame, values, colours, norm, label)
        if not frame.long or k == 2:
            panel.set_xlabel("km along the block" if frame.long else "km east")
        if frame.long or k == 0:
            panel.set_ylabel("km across, from\nits middle" if frame.long else "km north")
    if not frame.long:
        _draw_arrows(panels[0], frame, points.moved)
    return sheet


def _cells(frame: GroundFrame, values: Array) -> Array:
    """(first, second) median in each cell."""
    sound = np.flatnonzero(np.isfinite(values))
    first, second = frame.cells
    cell = cell_numbers(frame.places[sound] - frame.low, frame.high - frame.low, frame.cells)
    return medians(values[sound], cell, first * second).reshape(first, second)


def _draw_marks(
    sheet: Sheet, panel: Axes, frame: GroundFrame, values: Array, colours: str, norm: Normalize, label: str
) -> None:
    drawn = panel.scatter(frame.places[:, 0], frame.places[:, 1], c=values, s=12.0, cmap=colours, norm=norm,
                          edgecolors="#55555580", linewidths=0.3, zorder=3)  # fmt: skip
    panel.set_aspect("auto" if frame.long else "equal")
    ratio = isinstance(norm, LogNorm)
    ticks = FixedLocator(np.geomspace(norm.vmin or 1.0, norm.vmax or 1.0, 5).tolist()) if ratio else MaxNLocator(5)
    bar = sheet.figure.colorbar(drawn, ax=panel, extend="both", ticks=ticks, pad=0.015, aspect=22,
                                format="%.3g" if ratio else None)  # fmt: skip
    bar.ax.minorticks_off()
    panel.set_title(label, loc="left")


def _draw_arrows(panel: Axes, frame: GroundFrame, moved: Array) -> None:
    """Mean movement of cells, a 16th of the longer side each; the longest arrow is one and a half of them long."""
    size = frame.high - frame.low
    edge = float(size.max()) / 16.0
    cells = (max(int(np.ceil(size[0] / edge)), 1), max(int(np.ceil(size[1] / edge)), 1))
    middles, mean = cell_means(frame.places - frame.low, moved[:, :2] / KM, (float(size[0]), float(size[1])), cells, 1)
    middles = middles + frame.low
    longest = float(np.linalg.norm(mean, axis=1).max())
    if longest > 0.0:
        panel.quiver(*middles.T, *mean.T, angles="xy", scale_units="xy", scale=longest / (1.5 * edge), width=0.004,
                     color="#CC0000", zorder=4)  # fmt: skip


def _caption(points: CommonPoints, labels: tuple[str, str], many: bool, arrows: bool) -> str:
    """What one sees, with figures."""
    horizontal = np.hypot(points.moved[:, 0], points.moved[:, 1])
    known = points.ratio[np.isfinite(points.ratio)]
    ratio = f"{number(float(np.median(known)))} (median)" if known.size else "not defined: the points are fixed"
    half, most = number(float(np.median(horizontal))), number(float(horizontal.max()))
    drawn = "medians of cells" if many else "one mark for each point"
    red = "red arrows (exaggerated, to scale among each other) are the mean movement of cells; " if arrows else ""
    return (
        f"{points.solution.name}: {labels[1]} minus {labels[0]}, {len(horizontal)} common points, {drawn}; half of "
        f"them moved by at most {half} m horizontally, the largest movement is {most} m; {red}the ratio of the 3-D "
        f"sigmas is {ratio}, below 1 where a point is better known; colours end at the 2 % and 98 % quantiles."
    )
