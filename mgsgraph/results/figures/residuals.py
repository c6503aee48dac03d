"""Residuals of image coordinates: medians along the lines of every image, all images on one sheet; of many images some
share a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import medians, used_rays
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.results.figures.sheet import AFTER, CLASS_NAME, Rows, Sheet, limit, means, new_sheet, number, plain_style
from mgsgraph.text import many

_PER_BIN = 25
"""Measures of an image in a bin of lines, of the image in the middle."""
_BINS = 6, 60
"""Least and most bins of lines."""
_SHOWN = (PointClass.TIE, PointClass.LASER, PointClass.CONTROL)
_EMPTY = "#D9D9D9"


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


def residual_sheets(solution: Solution) -> list[Sheet]:
    """The sheet of the residuals."""
    return [residual_sheet(solution)]


@plain_style()
def residual_sheet(solution: Solution) -> Sheet:
    """Medians of the residuals of all images along their lines, and rms beside robust sigma of each image."""
    rows = Rows.of(solution)
    found = [one for c in _SHOWN if (one := residual_matrix(solution, rows, c)) is not None]
    spreads = _spreads(solution, rows)
    widths = [1.25] * (2 * len(found)) + [1.0]
    sheet = new_sheet(
        "residuals", max(7.2, 1.6 + 1.9 * len(widths)), min(2.0 + 0.35 * rows.number, 7.0), "Image residuals",
        _residual_caption(solution, found, spreads),
    )  # fmt: skip
    panels = sheet.panels(1, len(widths), widths=widths, sharey="all")[0]
    for n, one in enumerate(found):
        pair = panels[2 * n : 2 * n + 2]
        _draw_matrix(sheet, list(pair), one)
    panels[-1].barh(np.arange(rows.number), spreads, height=0.7, color=AFTER, lw=0.0)
    panels[-1].set(xlabel="px", title="rms of an image")
    panels[0].set_ylabel(rows.words)
    panels[0].set_ylim(rows.number - 0.5, -0.5)
    rows.name(panels[0])
    for panel in panels[1:]:
        panel.tick_params(labelleft=False)
    sheet.legend([Patch(color=_EMPTY, lw=0.0, label="no measurement")])
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
    """(rows,) px, rms of the residuals of line and sample together, of tie points where there are any."""
    rays, used = solution.network.rays, used_rays(solution)
    ties = used & (solution.network.points.classes[rays.point] == PointClass.TIE)
    mine = np.flatnonzero(ties if np.any(ties) else used)
    return np.sqrt(means(np.mean(solution.residuals[mine] ** 2, axis=1), rows.row[rays.image[mine]], rows.number))


def _residual_caption(solution: Solution, found: Sequence[ResidualMatrix], spreads: Array) -> str:
    """What one sees, with figures."""
    parts = []
    for one in found:
        line, sample = (limit(values) for values in one.medians)
        parts.append(f"{number(line)} and {number(sample)} px for {CLASS_NAME[one.point_class]}")
    worst = int(np.nanargmax(spreads)) if np.any(np.isfinite(spreads)) else 0
    middle, largest = float(np.nanmedian(spreads)), float(spreads[worst])
    rejected = int(np.count_nonzero(~solution.rays_used & np.all(np.isfinite(solution.residuals), axis=1)))
    return (
        f"Median residual (measured minus predicted) along the lines of {many(len(solution.network.images), 'image')}. "
        f"98 % of the medians are below {'; '.join(parts) or 'nothing'} (line and sample), where the colors end. "
        f"The rms of an image is {number(middle)} px (median); the largest, {number(largest)} px, is in row "
        f"{worst + 1}. Rejected measurements: {rejected}. Stripes over many images come from the camera, single rows "
        "from an image's orientation."
    )
