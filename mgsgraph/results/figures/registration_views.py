"""Registrations as the studio shows them, from the tables of results: shots in an image, search by relief, heights."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.relief import draw_ellipse
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, SOFT, Sheet, new_sheet, number, plain_style, short
from mgsgraph.text import many
from mgsgraph.units import KM

_STATES = ("before", "after")
_LEAST_TOP = 5.0
"""sigmas, upper end of the colours of a cost surface at least."""
_EMPTY = "#DDDDDD"


def known(values: Any) -> Array:
    """Numbers, of any shape, in which None stands for what is not known; NaN for these."""
    return np.array(values, dtype=object).astype(np.float64)


@plain_style()
def footprints_sheet(record: Mapping[str, Any]) -> Sheet:
    """Laser shots in an image before and after the adjustment; the image lies on its side."""
    caption = f"{record['sentence']} The image lies on its side, lines to the right."
    sheet = new_sheet("footprints", 9.4, 2.9, f"Laser shots in {short(record['image'], 60)}", caption)
    panel: Axes = sheet.panels()[0, 0]
    for profile in record["profiles"]:
        pairs = zip(profile["before"], profile["after"], strict=True)
        ends = np.array([[one or (np.nan, np.nan) for one in pair] for pair in pairs], dtype=np.float64)
        panel.plot(ends[:, :, 0].T, ends[:, :, 1].T, color=SOFT, lw=0.6, zorder=2)
        panel.plot(ends[:, 0, 0], ends[:, 0, 1], ls="", marker="o", ms=4.0, mfc="none", mec=BEFORE, mew=0.9, zorder=3)
        panel.plot(ends[:, 1, 0], ends[:, 1, 1], ls="", marker="o", ms=2.8, mew=0.0, color=AFTER, zorder=4)
    panel.set(xlim=(0, record["lines"]), ylim=(0, record["samples"]), xlabel="line (px)", ylabel="sample (px)")
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=5, mfc="none", mec=BEFORE, label="before: archived, nominal orientation"),
        Line2D([], [], ls="", marker="o", ms=4, color=AFTER, label="after: both adjusted"),
    ])  # fmt: skip
    return sheet


@plain_style()
def relief_sheet(profile: Mapping[str, Any]) -> Sheet:
    """Misfit over shifts of one profile before and after, and its heights against the surface that images show."""
    sheet = new_sheet("relief", 9.4, 6.6, f"Search by relief: {short(profile['name'], 50)}", _relief_caption(profile))
    parts: Any = sheet.figure.subfigures(2, 1, height_ratios=[1.25, 1.0])
    upper, lower = parts
    panels = upper.subplots(1, 2)
    shown = None
    for panel, state in zip(panels, _STATES, strict=True):
        shown = _draw_cost(panel, profile["costs"].get(state)) or shown
        panel.set(xlabel="shift east (m)", ylabel="shift north (m)", title=f"{state} the adjustment with relief")
    if shown is not None:
        bar = upper.colorbar(shown, ax=list(panels), extend="max")
        bar.set_label("root of the misfit above the best")
    if profile["shots"] is not None:
        heights, off = lower.subplots(2, 1, sharex=True)
        _draw_shots(heights, off, profile["shots"])
    sheet.legend([
        Line2D([], [], ls="", marker="+", ms=8, color=INK, label="where the profile is"),
        Line2D([], [], ls="", marker="X", ms=7, mfc="white", mec=INK, label="best shift"),
        Line2D([], [], ls="", marker="o", ms=4, mfc="none", mec=INK, label="shot"),
        Line2D([], [], color=BEFORE, label="before"),
        Line2D([], [], color=AFTER, label="after"),
    ])  # fmt: skip
    return sheet


def _draw_cost(panel: Axes, cost: Mapping[str, Any] | None) -> AxesImage | None:
    panel.grid(visible=False)
    panel.set_facecolor(_EMPTY)
    panel.set_aspect("equal")
    if not cost or cost["best_misfit"] is None:
        panel.text(0.5, 0.5, "too few shots\non the surface", ha="center", va="center", transform=panel.transAxes)
        return None
    shifts = np.array(cost["shifts_m"])
    above = np.sqrt(np.maximum(known(cost["misfit"]) - cost["best_misfit"], 0.0))
    reach = float(shifts[-1] + 0.5 * (shifts[1] - shifts[0]))
    top = max(_LEAST_TOP, float(np.nanquantile(above, 0.9)))
    shown = panel.imshow(
        np.ma.masked_invalid(above.T), extent=(-reach, reach, -reach, reach), origin="lower", cmap="viridis_r",
        vmin=0.0, vmax=top, interpolation="nearest",
    )  # fmt: skip
    panel.plot(0.0, 0.0, "+", ms=9, mew=1.3, color=INK, zorder=4)
    for one in cost["minima"][:1]:
        panel.plot(*one["shift_m"], "X", ms=7, mfc="white", mec=INK, mew=0.8, zorder=5)
        draw_ellipse(panel, np.array(one["shift_m"]), np.array(one["covariance_m2"]), "-")
    return shown


def _draw_shots(heights: Axes, off: Axes, shots: Mapping[str, Any]) -> None:
    along, height, sigma = np.array(shots["along_m"]) / KM, known(shots["height_m"]), known(shots["sigma_m"])
    for state, colour in zip(_STATES, (BEFORE, AFTER), strict=True):
        above = known(shots[f"above_surface_{state}_m"])
        heights.plot(along, height - above, color=colour, lw=1.0, zorder=2)
        off.plot(along, above, ls="", marker="o", ms=2.8, mfc="none", mec=colour, mew=0.8, zorder=3)
    heights.plot(along, height, ls="", marker="o", ms=2.8, mfc="none", mec=INK, mew=0.6, zorder=3)
    off.fill_between(along, -sigma, sigma, color=SOFT, alpha=0.35, lw=0.0, zorder=1)
    heights.set_ylabel("height above the\nellipsoid (m)")
    off.set(xlabel="along the track (km)", ylabel="shot minus\nsurface (m)")


def _relief_caption(profile: Mapping[str, Any]) -> str:
    text = f"{profile['name']}: misfit over shifts of the profile, and its shots against the surface of the images"
    cost = profile["costs"].get("before")
    if cost and cost["minima"]:
        east, north = cost["minima"][0]["shift_m"]
        text += f"; before, it fits best where it is shifted by {number(east)} m east and {number(north)} m north"
    tied = "at one place only" if profile["clear"] else "at several places" if profile["tied"] else "nowhere clearly"
    return (
        f"{text}; after, relief ties it {tied}; ellipses are one sigma, the grey band is the a-priori sigma of a "
        "difference."
    )


@plain_style()
def heights_sheet(record: Mapping[str, Any]) -> Sheet:
    """Root mean square and mean of heights above the terrain model by cell, before and after both steps."""
    longitude = np.degrees(np.unwrap(np.radians(np.array(record["longitude_deg"]))))
    latitude, points = np.array(record["latitude_deg"]), np.array(record["points"])
    rms, mean = known(record["rms_m"]), known(record["mean_m"])
    total = np.sqrt(np.nansum(rms**2 * points, axis=1) / max(points.sum(), 1.0))
    caption = (
        f"Heights of {number(float(points.sum()), 6)} points above the terrain model in {many(points.size, 'cell')} of "
        f"the map, grey where there are none: {number(float(total[0]))} m rms before, {number(float(total[-1]))} m "
        "after step 2."
    )
    sheet = new_sheet("heights", 9.4, 6.4, "Heights above the terrain model", caption, band=0.0)
    grid = sheet.panels(2, 2)
    high = _step(latitude, 0.05)
    size = _step(longitude, high / float(np.cos(np.radians(latitude.mean())))), high
    kinds = ((rms, "viridis", 0.0, "rms height (m)"), (mean, "RdBu_r", -1.0, "mean height (m)"))
    for row, (values, colours, sign, what) in zip(grid, kinds, strict=True):
        most = max(float(np.nanquantile(np.abs(values[[0, -1]]), 0.98)), 1e-9)
        for panel, stage, title in zip(row, (0, -1), ("before", "after step 2"), strict=True):
            shown = _draw_cells(panel, np.column_stack([longitude, latitude]), size, values[stage])
            shown.set(cmap=colours, clim=(sign * most, most))
            panel.set(xlabel="east longitude (°)", ylabel="latitude (°)", title=title)
        bar = sheet.figure.colorbar(shown, ax=list(row), extend="max" if sign == 0.0 else "both")
        bar.set_label(what)
    return sheet


def _step(values: Array, otherwise: float) -> float:
    """Width of the cells whose middles these are."""
    apart = np.diff(np.unique(values))
    apart = apart[apart > 1e-9]
    return float(apart.min()) if apart.size else otherwise


def _draw_cells(panel: Axes, middles: Array, size: tuple[float, float], values: Array) -> PatchCollection:
    """Cells of the map about their middles (n, 2) in degrees, coloured by values (n,)."""
    corners = middles - 0.5 * np.array(size)
    shown = PatchCollection([Rectangle((x, y), *size) for x, y in corners.tolist()], lw=0.0)
    shown.set_array(np.ma.masked_invalid(values))
    panel.add_collection(shown)
    panel.grid(visible=False)
    panel.set_facecolor(_EMPTY)
    panel.autoscale_view()
    panel.set_aspect(1.0 / float(np.cos(np.radians(middles[:, 1].mean()))), adjustable="datalim")
    panel.xaxis.set_major_locator(MaxNLocator(4))
    panel.xaxis.set_major_formatter(lambda value, _: f"{value % 360.0:g}")
    return shown
