"""All images of a large block on one sheet: residuals against the line, and corrections of the orientation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import medians, used_rays
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.results.figures.aggregate import Rows, limit, means
from mgsgraph.results.figures.sheet import AFTER, BEFORE, CLASS_NAME, SOFT, Sheet, new_sheet, number, plain_style
from mgsgraph.units import ARCSEC

_PER_BIN = 25
"""Measures of an image in a bin of lines, of the image in the middle."""
_BINS = 6, 60
"""Least and most bins of lines."""
_SHOWN = (PointClass.TIE, PointClass.LASER, PointClass.CONTROL)
_NORMAL = 1.4826
"""Median of absolute values times this is the sigma of a normal distribution."""
_EMPTY = "#D9D9D9"
_ROWS = ("X (m)", "Y (m)", "Z (m)", "about x\n(arcsec)", "about y\n(arcsec)", "about z\n(arcsec)")


@dataclass(frozen=True, slots=True, eq=False)
class ResidualMatrix:
    """Residuals of one class of points by image and line."""

    point_class: PointClass
    """Of the points."""
    medians: Array
    """(2, rows, bins) px, of the line residuals and of the sample residuals; NaN where nothing was measured."""


def residual_matrix(solution: Solution, rows: Rows, point_class: PointClass) -> ResidualMatrix | None:
    """Medians of the residuals of the rays that took part, by row and bin of lines; None where there are none."""
    rays = solution.network.rays
    mine = np.flatnonzero(used_rays(solution) & (solution.network.points.classes[rays.point] == point_class))
    mine = mine[rows.row[rays.image[mine]] >= 0]
    if not mine.size:
        return None
    image = rays.image[mine]
    middle = float(np.median(np.bincount(image)[np.unique(image)]))
    bins = int(np.clip(middle / _PER_BIN, *_BINS))
    lengths = np.array([one.lines for one in solution.network.images], dtype=np.float64)
    along = np.clip(rays.places[mine, 0] / lengths[image] * bins, 0.0, bins - 1.0).astype(np.int64)
    cells, size = rows.row[image] * bins + along, rows.number * bins
    found = [medians(solution.residuals[mine, k], cells, size).reshape(rows.number, bins) for k in range(2)]
    return ResidualMatrix(point_class, np.stack(found))


@plain_style()
def residual_overview(solution: Solution) -> Sheet:
    """Medians of the residuals of all images along their lines, and rms beside robust sigma of each image."""
    rows = Rows.of(solution)
    found = [one for c in _SHOWN if (one := residual_matrix(solution, rows, c)) is not None]
    measures = _spreads(solution, rows)
    widths = [1.25] * (2 * len(found)) + [1.0]
    sheet = new_sheet(
        "overview_residuals", max(7.2, 1.6 + 1.9 * len(widths)), 7.0, "Image residuals of all images",
        _residual_caption(solution, found, measures), vector=False,
    )  # fmt: skip
    panels = sheet.panels(1, len(widths), widths=widths, sharey="all")[0]
    for n, one in enumerate(found):
        pair = panels[2 * n : 2 * n + 2]
        _draw_matrix(sheet, list(pair), one)
    _draw_spreads(panels[-1], rows, measures)
    panels[0].set_ylabel(rows.words)
    panels[0].set_ylim(rows.number - 0.5, -0.5)
    rows.name(panels[0])
    for panel in panels[1:]:
        panel.tick_params(labelleft=False)
    handles = [
        Line2D([], [], color=BEFORE, lw=1.0, label="rms"),
        Line2D([], [], color=AFTER, lw=1.0, label="robust sigma (1.4826 x median of the absolute values)"),
    ]
    sheet.legend([*handles, Patch(color=_EMPTY, lw=0.0, label="no measure")])
    return sheet


def _draw_matrix(sheet: Sheet, panels: list[Axes], one: ResidualMatrix) -> None:
    """Line and sample residuals side by side, on one scale."""
    most = limit(one.medians)
    shown: ScalarMappable
    for panel, values, what in zip(panels, one.medians, ("line", "sample"), strict=True):
        panel.set_facecolor(_EMPTY)
        panel.grid(visible=False)
        rows = values.shape[0]
        shown = panel.imshow(
            np.ma.masked_invalid(values), cmap="RdBu_r", vmin=-most, vmax=most, aspect="auto",
            interpolation="nearest", extent=(0.0, 100.0, rows - 0.5, -0.5),
        )  # fmt: skip
        panel.set(xlabel="% of the lines", title=what)
    name = CLASS_NAME[one.point_class]
    sheet.colour_bar(shown, panels, f"{name}: median residual (px)", MaxNLocator(4), extend="both")


def _spreads(solution: Solution, rows: Rows) -> Array:
    """(2, rows) px: rms and robust sigma of the residuals' coordinates, of tie points where there are any."""
    rays = solution.network.rays
    classes = solution.network.points.classes[rays.point]
    used = used_rays(solution)
    ties = used & (classes == PointClass.TIE)
    mine = np.flatnonzero(ties if np.any(ties) else used)
    row = np.repeat(rows.row[rays.image[mine]], 2)
    values = solution.residuals[mine].ravel()
    return np.stack([np.sqrt(means(values**2, row, rows.number)), _NORMAL * medians(np.abs(values), row, rows.number)])


def _draw_spreads(panel: Axes, rows: Rows, measures: Array) -> None:
    for values, colour in zip(measures, (BEFORE, AFTER), strict=True):
        panel.step(values, np.arange(rows.number), color=colour, lw=1.0, where="mid")
    most = 1.6 * limit(measures[1])
    beyond = np.flatnonzero(measures[0] > most)
    panel.plot(np.full(beyond.size, 0.985 * most), beyond, ls="", marker=">", ms=4.0, mew=0.0, color=BEFORE)
    panel.set(xlim=(0.0, most), xlabel="px", title="of an image")


def _residual_caption(solution: Solution, found: Sequence[ResidualMatrix], measures: Array) -> str:
    """What one sees, with figures."""
    parts = []
    for one in found:
        line, sample = (limit(values) for values in one.medians)
        parts.append(f"{number(line)} and {number(sample)} px for {CLASS_NAME[one.point_class]}")
    worst = int(np.nanargmax(measures[1])) if np.any(np.isfinite(measures[1])) else 0
    sigma, rms = float(np.nanmedian(measures[1])), float(np.nanmedian(measures[0]))
    return (
        f"{len(solution.network.images)} images: median residual (measured minus predicted) of each part of an image; "
        f"98 % of them are below {'; '.join(parts) or 'nothing'} (line and sample), where the colours end. Of the "
        f"image in the middle the rms is {number(rms)} px and the robust sigma {number(sigma)} px; the largest robust "
        f"sigma, {number(float(measures[1][worst]))} px, is in row {worst + 1}; an rms beyond the panel has a mark at "
        "its edge. Stripes over many images come from the camera, single rows from an image's own orientation."
    )


# --- orientation


@dataclass(frozen=True, slots=True, eq=False)
class MiddleCorrections:
    """Corrections of images with an orientation of their own, in the middle of each."""

    images: Index
    """(m,) which images."""
    values: Array
    """(m, 6) m of X, Y, Z and arcsec about the camera's x, y, z: constant coefficients."""
    sigmas: Array
    """(m, 6) their sigmas, for sigma0 = 1; zero when held."""


def middle_corrections(solution: Solution, images: Sequence[int]) -> MiddleCorrections:
    """Constant coefficients of the orientation of images, and their sigmas."""
    unit = np.array([1.0, 1.0, 1.0, ARCSEC, ARCSEC, ARCSEC])
    values = np.array([solution.coefficients[j][0] for j in images]).reshape(-1, 6)
    each = [np.diagonal(solution.image_covariance(j))[:6] for j in images]
    sigmas = np.sqrt(np.maximum(np.array(each).reshape(-1, 6), 0.0))
    return MiddleCorrections(np.array(images, dtype=np.int64), values / unit, sigmas / unit)


def strangeness(found: MiddleCorrections) -> Array:
    """(m,) how far an image's corrections are from the block's medians: the largest of six, in robust sigmas."""
    off = np.abs(found.values - np.median(found.values, axis=0))
    spread = _NORMAL * np.median(off, axis=0)
    return np.asarray(np.max(off / np.where(spread > 0.0, spread, 1.0), axis=1))


@plain_style()
def orientation_overview(found: MiddleCorrections) -> Sheet:
    """Corrections in the middle of each image with their sigmas, over the images in their order."""
    sheet = new_sheet(
        "overview_orientation", 11.0, 8.4, "Corrections of the exterior orientation of all images",
        _orientation_caption(found), vector=False,
    )  # fmt: skip
    grid = sheet.panels(6, 1, sharex="col")[:, 0]
    order = np.arange(found.images.size)
    for n, panel in enumerate(grid):
        value, sigma = found.values[:, n], found.sigmas[:, n]
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        panel.fill_between(order, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0, rasterized=True)
        panel.plot(order, value, color=AFTER, ls="", marker="o", ms=2.0, mew=0.0, rasterized=True)
        low, high = np.quantile(np.concatenate([value - sigma, value + sigma]), [0.01, 0.99]).tolist()
        room = 0.12 * max(high - low, 1e-9)
        panel.set(ylabel=_ROWS[n], ylim=(low - room, high + room), xlim=(-0.01 * order.size, 1.01 * order.size))
        panel.locator_params(axis="y", nbins=5)
    grid[-1].set_xlabel("image, in the order of the case (from 0)")
    sheet.legend([
        Line2D([], [], color=AFTER, ls="", marker="o", ms=3.0, label="adjusted minus nominal, middle of the image"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma (sigma0 = 1)"),
    ])  # fmt: skip
    return sheet


def _orientation_caption(found: MiddleCorrections) -> str:
    size, sigma = np.abs(found.values), np.median(found.sigmas, axis=0)
    middle = np.median(size, axis=0)
    return (
        f"{found.images.size} images with an orientation of their own: half of them moved by less than "
        f"{', '.join(number(float(v)) for v in middle[:3])} m in body-fixed X, Y, Z and turned by less than "
        f"{', '.join(number(float(v)) for v in middle[3:])} arcsec about the camera's x, y, z, at most by "
        f"{number(float(size[:, :3].max()))} m and {number(float(size[:, 3:].max()))} arcsec; sigmas in the middle "
        f"(median of the images) are {', '.join(number(float(v)) for v in sigma[:3])} m and "
        f"{', '.join(number(float(v)) for v in sigma[3:])} arcsec. The outermost per cent may lie beyond a panel."
    )
