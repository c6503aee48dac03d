"""Residuals of image coordinates: medians along the lines of every image, all images on one sheet; of many images some
share a row.
"""


import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import medians, used_rays
from mgsgraph.geometry.records import Array, Index, finite_rows
from mgsgraph.network import PointClass
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    CLASS_NAME,
    Sheet,
    image_rows,
    limit,
    means,
    new_sheet,
    number,
    plain_style,
)
from mgsgraph.text import many, short

_PER_BIN = 25
"""Measures of an image in a bin of lines, of the image in the middle."""
_BINS = 6, 60
"""Least and most bins of lines."""
_SHOWN = (PointClass.TIE, PointClass.LASER, PointClass.CONTROL)
_NAMED = 12
"""Rows that have their image's name beside them."""
_EMPTY = "#D9D9D9"
_PALE = 0.05
"""Share of the scale below which all looks white."""


def residual_matrix(solution: Solution, point_class: PointClass) -> Array | None:
    """(2, rows, bins) px, medians of the line and the sample residuals of the rays to one class of points that took
    part, by row of images and bin of lines; NaN where nothing was measured. None where there are none.
    """
    rays, images = solution.network.rays, solution.network.images
    rows_used = np.flatnonzero(used_rays(solution) & (solution.network.points.classes[rays.point] == point_class))
    if not rows_used.size:
        return None
    image, row = rays.image[rows_used], image_rows(len(images))
    middle = float(np.median(np.bincount(image)[np.unique(image)]))
    bins, rows = int(np.clip(middle / _PER_BIN, *_BINS)), int(row[-1]) + 1
    lengths = np.array([picture.lines for picture in images], dtype=np.float64)
    along = np.clip(rays.places[rows_used, 0] / lengths[image] * bins, 0.0, bins - 1.0).astype(np.int64)
    cells = row[image] * bins + along
    matrices = [medians(solution.residuals[rows_used, k], cells, rows * bins).reshape(rows, bins) for k in range(2)]
    return np.stack(matrices)


@plain_style()
def residual_sheets(solution: Solution) -> list[Sheet]:
    """Medians of the residuals of all images along their lines, and the rms and largest residual of each image."""
    names, row = solution.network.image_names, image_rows(len(solution.network.images))
    matrices = [(point_class, matrix) for point_class in _SHOWN
                if (matrix := residual_matrix(solution, point_class)) is not None]
    spreads, largest = _spreads(solution, row)
    count, per_row = spreads.size, -(-len(names) // spreads.size)
    widths = [1.25] * (2 * len(matrices)) + [1.0]
    sheet = new_sheet(
        "residuals", max(7.2, 1.6 + 1.9 * len(widths)), min(2.0 + 0.35 * count, 7.0), "Image residuals",
        _residual_caption(solution, spreads, largest),
    )  # fmt: skip
    panels = sheet.panels(1, len(widths), widths=widths, sharey="all")[0]
    for n, (point_class, matrix) in enumerate(matrices):
        _draw_matrix(sheet, panels[2 * n : 2 * n + 2].tolist(), point_class, matrix)
    panels[-1].barh(np.arange(count), spreads, height=0.7, color=AFTER, lw=0.0)
    panels[-1].plot(largest, np.arange(count), ls="", marker="o", ms=3.0, color=BEFORE)
    panels[-1].set(xlabel="px", xlim=(0.0, None), title="rms and largest")
    ticks = np.unique(np.linspace(0, count - 1, min(count, _NAMED)).round().astype(int)).tolist()
    panels[0].set_yticks(ticks, [short(names[int(np.searchsorted(row, k))], 20) for k in ticks], size=7.0)
    panels[0].set(ylabel="image" if per_row == 1 else f"images, up to {per_row} in a row", ylim=(count - 0.5, -0.5))
    for panel in panels[1:]:
        panel.tick_params(labelleft=False)
    sheet.legend([
        Patch(color=_EMPTY, lw=0.0, label="no measurement"), Patch(color=AFTER, lw=0.0, label="rms of an image"),
        Line2D([], [], ls="", marker="o", ms=4.0, color=BEFORE, label="largest residual of an image"),
    ])  # fmt: skip
    return [sheet]


def _draw_matrix(sheet: Sheet, panels: list[Axes], point_class: PointClass, matrix: Array) -> None:
    """Line and sample residuals side by side, on one scale."""
    scale, largest = limit(matrix), float(np.nanmax(np.abs(matrix)))
    shown: ScalarMappable
    for panel, values, direction in zip(panels, matrix, ("line", "sample"), strict=True):
        panel.set_facecolor(_EMPTY)
        panel.grid(visible=False)
        rows, peak = values.shape[0], float(np.nanmax(np.abs(values)))
        shown = panel.imshow(
            np.ma.masked_invalid(values), cmap="RdBu_r", vmin=-scale, vmax=scale, aspect="auto",
            interpolation="nearest", extent=(0.0, 100.0, rows - 0.5, -0.5),
        )  # fmt: skip
        panel.set(xlabel="% of the lines", title=direction + f" (below {number(peak, 1)} px)" * (peak < _PALE * scale))
    label = f"{CLASS_NAME[point_class]}: median residual, up to {number(largest)} px"
    sheet.colour_bar(shown, panels, label, MaxNLocator(4), extend="both")


def _spreads(solution: Solution, row: Index) -> tuple[Array, Array]:
    """(rows,) px, rms of the residuals of line and sample together, and the largest of either."""
    used = np.flatnonzero(used_rays(solution))
    squared, rows = solution.residuals[used] ** 2, row[solution.network.rays.image[used]]
    largest = np.full(int(row[-1]) + 1, np.nan)
    np.fmax.at(largest, rows, squared.max(axis=1))
    return np.sqrt(means(squared.mean(axis=1), rows, largest.size)), np.sqrt(largest)


def _residual_caption(solution: Solution, spreads: Array, largest: Array) -> str:
    """Caption with the main numbers."""
    rejected = int(np.count_nonzero(~solution.rays_used & finite_rows(solution.residuals)))
    figures = np.nanmedian(spreads), np.nanmax(spreads), np.nanmax(largest)
    middle, most, worst = (number(float(value)) for value in figures)
    return (
        f"The rms of an image is {middle} px (median), {most} px at most; the largest residual is {worst} px. Rejected "
        f"measurements: {rejected}. Colors: median residual (measured minus predicted) along the lines of "
        f"{many(len(solution.network.images), 'image')}; stripes over many images come from the camera, single rows "
        "from the orientation of an image."
    )
