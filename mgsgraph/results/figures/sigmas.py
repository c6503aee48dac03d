"""Sigmas along an image, and over the overlap of images."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.analysis.estimates import PoseEstimate
from mgsgraph.analysis.places import SigmaGrid
from mgsgraph.results.figures.sheet import Sheet, new_sheet, number, plain_style, short
from mgsgraph.units import DEG, MRAD

_POSITION = FLIGHT_NAMES[:3]
_POINTING = ("roll", "pitch", "yaw")
_COLOURS = ("#0072B2", "#D55E00", "#009E73")
_LINES = ("-", "--", ":")


@plain_style()
def curve_sheet(poses: Sequence[PoseEstimate], name: str) -> Sheet:
    """Sigmas of position and pointing of one image along its lines."""
    lines, sigmas = np.array([pose.line for pose in poses]), np.array([pose.sigmas for pose in poses])
    middle, ends = sigmas[len(poses) // 2], np.maximum(sigmas[0], sigmas[-1])
    caption = (
        f"Adjusted orientation of image {poses[0].image} along its lines, for sigma0 = 1: at the middle line position "
        f"is known to {', '.join(number(value) for value in middle[:3])} m (along, across, radial) and pointing to "
        f"{', '.join(number(value / MRAD) for value in middle[3:])} mrad (roll, pitch, yaw); at its worse end to "
        f"{', '.join(number(value) for value in ends[:3])} m and "
        f"{', '.join(number(value / MRAD) for value in ends[3:])} mrad."
    )
    sheet = new_sheet(name, 7.2, 5.0, "Sigmas along the image", caption, band=0.0)
    grid = sheet.panels(2, 1, sharex="col")
    for row, (columns, unit, labels) in enumerate(((slice(0, 3), 1.0, _POSITION), (slice(3, 6), MRAD, _POINTING))):
        panel: Axes = grid[row, 0]
        for values, colour, style in zip((sigmas[:, columns] / unit).T, _COLOURS, _LINES, strict=True):
            panel.plot(lines, values, color=colour, ls=style)
        panel.set_xlim(lines[0], lines[-1])
        panel.set_ylim(0.0, 1.25 * float(sigmas[:, columns].max() / unit) or 1.0)
        panel.set_ylabel(("position, sigma (m)", "pointing, sigma (mrad)")[row])
        panel.legend(
            handles=[Line2D([], [], color=c, ls=s, label=t) for c, s, t in zip(_COLOURS, _LINES, labels, strict=True)],
            loc="upper right", ncols=3,
        )  # fmt: skip
    grid[0, 0].set_title(short(poses[0].image, 60))
    grid[1, 0].set_xlabel("line (px)")
    return sheet


@plain_style()
def raster_sheet(grid: SigmaGrid, name: str) -> Sheet:
    """Maps of the sigmas that new points would have."""
    _, rows, columns = grid.values.shape
    ratio = rows / columns  # cells are square on the ground
    height = float(np.clip(2.4 * ratio, 1.6, 6.0)) + 1.2
    statement = grid.sentence[0].upper() + grid.sentence[1:]
    sheet = new_sheet(name, 9.4, height, "Sigmas of new points over the overlap", f"{statement}.")
    west, north = grid.west / DEG, grid.north / DEG
    extent = (west, west + columns * grid.steps[0] / DEG, north - rows * grid.steps[1] / DEG, north)
    for k, (panel, what) in enumerate(zip(sheet.panels(1, 3)[0], ("east", "north", "up"), strict=True)):
        band = np.ma.masked_invalid(grid.values[k])
        low, high = float(band.min()), float(band.max())
        norm = LogNorm(low, high) if high > 5.0 * low else None
        shown = panel.imshow(band, extent=extent, aspect="auto", cmap="viridis", norm=norm, interpolation="nearest")
        ticks = LogLocator(subs=(1.0, 2.0, 5.0)) if norm is not None else MaxNLocator(4)
        sheet.colour_bar(shown, panel, f"sigma {what} (m)", ticks)
        panel.grid(visible=False)
        panel.locator_params(axis="both", nbins=4)
        panel.set(xlabel="east longitude (deg)", ylabel="latitude (deg)" if k == 0 else "")
    return sheet
