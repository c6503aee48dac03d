"""Two solutions on one map: how far each common point moved, and by what factor its sigma changed.

A block of many points is drawn by cells of the ground, medians in each.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FixedLocator, MaxNLocator

from mgsgraph.analysis.statistics import CommonPoints, span
from mgsgraph.geometry.body import centre_of, plane_coordinates
from mgsgraph.geometry.records import Array, thinned
from mgsgraph.results.figures.aggregate import limit
from mgsgraph.results.figures.map import cell_medians, frame, map_axes
from mgsgraph.results.figures.sheet import MOST_MARKS, Sheet, new_sheet, number, plain_style
from mgsgraph.units import KM

_FEWEST, _ARROWS = 3, 100
"""Points of which a map can be made, and movements that are drawn, exaggerated and to scale among each other."""


@plain_style()
def comparison_sheet(points: CommonPoints, labels: tuple[str, str]) -> Sheet | None:
    """Horizontal and upward movement and the ratio of the 3-D sigmas of the common points; None of fewer than three."""
    if len(points.places) < _FEWEST:
        return None
    centre = centre_of(points.places)
    places = plane_coordinates(points.places, centre) / KM
    many = len(places) > MOST_MARKS
    horizontal, upward = np.hypot(points.moved[:, 0], points.moved[:, 1]), points.moved[:, 2]
    up, low, high = limit(upward), *span(horizontal)
    factor = max(float(np.exp(limit(np.log(points.ratio)))), 1.01)
    shown: tuple[tuple[Array, str, Normalize, str], ...] = (
        (horizontal, "viridis", Normalize(low, high), "moved horizontally (m)"),
        (upward, "RdBu_r", Normalize(-up, up), "moved upward (m)"),
        (points.ratio, "PuOr_r", LogNorm(1.0 / factor, factor), "3-D sigma, later over earlier (logarithmic)"),
    )
    south_west, north_east, (width, height) = frame(places)
    rows, columns = (3, 1) if width > 2.0 * height else (1, 3)
    size = (11.0, 7.8) if rows == 3 else (11.0, max(4.0, 3.0 * height / width))
    caption = _caption(points, labels, many)
    sheet = new_sheet("comparison", *size, "Two solutions compared", caption, band=0.0, vector=not many)
    panels = sheet.panels(rows, columns).ravel().tolist()
    for panel, (values, colors, norm, label) in zip(panels, shown, strict=True):
        map_axes(panel, south_west, north_east, centre)
        _draw(sheet, panel, places, values, (colors, norm), many)
        panel.set_title(label, loc="left")
    some = thinned(len(places), _ARROWS)
    if np.any(points.moved[some, :2]):
        arrows = (*places[some].T, *points.moved[some, :2].T)
        panels[0].quiver(*arrows, angles="xy", width=0.004, color="#CC0000", zorder=4)
    return sheet


def _draw(
    sheet: Sheet, panel: Axes, places: Array, values: Array, scale: tuple[str, Normalize], many: bool
) -> None:
    """Values (n,) at places (n, 2) in km by color: one mark each, or medians of cells."""
    colors, norm = scale
    drawn: ScalarMappable
    if many:
        box = np.concatenate([places.min(axis=0), places.max(axis=0)])
        _, (cells,) = cell_medians(box, places, values)
        drawn = panel.imshow(
            np.ma.masked_invalid(cells), origin="lower", cmap=colors, norm=norm, interpolation="nearest",
            extent=(box[0], box[2], box[1], box[3]), aspect=panel.get_aspect(),
        )  # fmt: skip
    else:
        drawn = panel.scatter(
            places[:, 0], places[:, 1], c=values, s=12.0, cmap=colors, norm=norm, edgecolors="#55555580",
            linewidths=0.3, zorder=3,
        )
    ratio = isinstance(norm, LogNorm)
    ticks = FixedLocator(np.geomspace(norm.vmin or 1.0, norm.vmax or 1.0, 5).tolist()) if ratio else MaxNLocator(5)
    bar = sheet.figure.colorbar(drawn, ax=panel, extend="both", ticks=ticks, pad=0.015, aspect=22,
                                format="%.3g" if ratio else None)  # fmt: skip
    bar.ax.minorticks_off()


def _caption(points: CommonPoints, labels: tuple[str, str], many: bool) -> str:
    """What one sees, with figures."""
    horizontal = np.hypot(points.moved[:, 0], points.moved[:, 1])
    known = points.ratio[np.isfinite(points.ratio)]
    ratio = f"{number(float(np.median(known)))} (median)" if known.size else "not defined: the points are fixed"
    half, most = number(float(np.median(horizontal))), number(float(horizontal.max()))
    drawn = "medians of cells" if many else "one mark for each point"
    return (
        f"{points.solution.name}: {labels[1]} minus {labels[0]}, {len(horizontal)} common points, {drawn}. Half of "
        f"them moved by at most {half} m horizontally; the largest movement is {most} m. The ratio of the 3-D sigmas "
        f"is {ratio}, below 1 where a point is better known. Colors end at the 2 % and 98 % quantiles."
    )
