"""Heights of points above the terrain model by cell, before and after, side by side (the figure of Spiegel et al.)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mgsgraph.analysis.two_step_statistics import HeightCells, TwoStepStatistics, owners, turned
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.footprint import footprint
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import INK, Sheet, new_sheet, number, plain_style
from mgsgraph.text import many
from mgsgraph.units import DEG

_BEFORE, _AFTER = 0, -1
_EMPTY = "#DDDDDD"
"""Of cells without points."""
_MOST_OUTLINES = 60


@plain_style()
def height_map_sheet(statistics: TwoStepStatistics, found: HeightCells) -> Sheet:
    """Root mean square and mean of the heights by cell, with the nominal orientation and after both steps."""
    west, east, south, north = found.extent
    tall = (north - south) > (east - west) * np.cos(0.5 * (south + north) * DEG)
    shape = (north - south) / max((east - west) * np.cos(0.5 * (south + north) * DEG), 1e-9)
    each = 1.62 if tall else 3.75  # inch, width of a panel
    height = float(np.clip(each * shape, 1.5, 5.2))
    rows = 1 if tall else 2
    sheet = new_sheet(
        "height_map", 9.4, rows * (height + 1.0) + 0.4, "Points above the terrain model",
        _caption(statistics, found, ("Left", "right") if tall else ("Above", "below")),
    )  # fmt: skip
    grid = sheet.panels(rows, 4 // rows).ravel()
    outlines = _outlines(statistics, found)
    low = np.nanquantile(found.rms[[_BEFORE, _AFTER]], 0.98)
    spread = np.nanquantile(np.abs(found.mean[[_BEFORE, _AFTER]]), 0.98)
    kinds = (
        (found.rms, "viridis", 0.0, low, "rms height (m)", "max"),
        (found.mean, "RdBu_r", -spread, spread, "mean height, positive above the terrain (m)", "both"),
    )
    for k, (values, colours, least, most, what, extend) in enumerate(kinds):
        pair = grid[2 * k : 2 * k + 2].tolist()
        most = max(float(most), float(least) + 1e-9)
        for panel, stage, title in zip(pair, (_BEFORE, _AFTER), ("before", "after step 2"), strict=True):
            shown = _draw(panel, values[stage], found, outlines, (colours, float(least), most))
            first = panel is pair[0] and (k == 0 or not tall)
            x = "east longitude (°)" if tall or k == 1 else ""
            panel.set(xlabel=x, ylabel="planetocentric latitude (°)" if first else "", title=title)
        sheet.colour_bar(shown, pair, what, MaxNLocator(6), extend)
    handles = [
        Line2D([], [], color=INK, lw=0.9, label="outlines of the strips' middle images"
               if statistics.steps.network.passes else "outlines of the images"),
        Patch(facecolor=_EMPTY, edgecolor="#BBBBBB", label="cells without points"),
    ]  # fmt: skip
    sheet.legend(handles)
    return sheet


def _draw(
    panel: Axes, values: Array, found: HeightCells, outlines: list[Array], scale: tuple[str, float, float]
) -> AxesImage:
    west, east, south, north = found.extent
    colours, least, most = scale
    shown = panel.imshow(
        np.ma.masked_invalid(values), extent=(west, east, south, north), origin="lower", aspect="auto", cmap=colours,
        vmin=least, vmax=most, interpolation="nearest", zorder=1,
    )  # fmt: skip
    panel.set_facecolor(_EMPTY)
    for outline in outlines:
        panel.plot(*outline.T, color=INK, lw=0.7, zorder=3)
    slack = 0.02 * max(east - west, north - south)
    panel.set(xlim=(west - slack, east + slack), ylim=(south - slack, north + slack))
    panel.grid(visible=False)
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    panel.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    panel.xaxis.set_major_formatter(lambda value, _: f"{value % 360.0:g}")
    return shown


def _outlines(statistics: TwoStepStatistics, found: HeightCells) -> list[Array]:
    """(k, 2) deg, of each strip's middle image, or of each image, adjusted; at the middle height of the points."""
    steps = statistics.steps
    places = steps.fitted.places[statistics.points]
    height = float(np.median(geodetic(places, steps.network.images[0].body)[:, 2]))
    middle = found.west + 0.5 * found.count.shape[1] * found.steps[0]
    result = []
    for _, images in owners(steps.network)[:_MOST_OUTLINES]:
        image = int(images[images.size // 2])
        outline = footprint(steps.fitted.image(image), height, steps.fitted.correction(image)).outline
        if outline.shape[0]:
            result.append(np.stack(turned(outline, middle), axis=1) / DEG)
    return result


def _caption(statistics: TwoStepStatistics, found: HeightCells, sides: tuple[str, str]) -> str:
    heights = statistics.whole.heights
    width, height = (number(step / DEG) for step in found.steps)
    before, free, fitted = (number(value) for value in found.total)
    text = (
        f"Heights of {many(heights.count, 'tie point')} above the terrain model, where the rays alone put them, by "
        f"cell of {width}° x {height}°. {sides[0]}: rms {before} m with the nominal orientation, {free} m after step 1 "
        f"(not drawn), and {fitted} m after step 2, {number(heights.factors[2], 2)} times less; {sides[1]}: mean, "
        f"{number(heights.mean[0])} m and {number(heights.mean[2])} m. One colour scale for before and after"
    )
    if statistics.steps.network.terrain_moves:
        text += "; after step 2 the model is where that puts it"
    left = int(np.count_nonzero(~statistics.used))
    text += f"; {many(left, 'point')} judged to be off the terrain left out" if left else ""
    missing = statistics.without_row + statistics.left_out
    text += f"; {missing} without a place, beside the model or over missing posts left out" if missing else ""
    return f"{text}."
