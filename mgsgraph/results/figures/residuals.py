"""Residuals of image coordinates as arrows in the frame of each image."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import median_residuals, worst_first
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.registration.measured import thinned
from mgsgraph.results.figures.aggregate import LARGE_BLOCK, cell_means
from mgsgraph.results.figures.content import ImageResiduals, image_residuals, rms
from mgsgraph.results.figures.overview import residual_overview
from mgsgraph.results.figures.sheet import (
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    SOFT,
    Sheet,
    in_sheets,
    left_out,
    new_sheet,
    number,
    plain_style,
    round_figure,
    sheet_name,
    short,
)

_PER_SHEET = 4
_WORST, _TYPICAL = 6, 2
"""Images of a large block that are drawn one by one: those that fit worst, and those in the middle."""
_SINGLE = 600
"""Measures of a class in an image from which on means of cells are drawn in place of each one."""
_CELLS = 24, 8
"""Cells of an image along its lines and samples."""
_FEWEST = 5
"""Measures in a cell that has an arrow."""
_MOST_LONGER = 300
"""Marks of long residuals in an image."""
_LONGER = "#CC0000"
_BEYOND = 4.0
"""Times the median length of an image's residuals: longer ones are marked where they are, for a mean hides them."""
_LONGEST = {PointClass.TIE: 0.4, PointClass.LASER: 0.18, PointClass.CONTROL: 0.4, PointClass.POST: 0.18}
"""inch, of the longest arrow; laser points lie in rows so dense that long arrows would hide each other."""
_SHARE = 0.98
"""Share of the residuals that are drawn in full; the others' arrows are cut off at the longest of these."""


def residual_sheets(solution: Solution) -> Iterator[Sheet]:
    """Sheets of up to four images; of a large block all images on one sheet, and a choice of them on two."""
    every = len(solution.network.images)
    chosen, which = list(range(every)), ""
    if every > LARGE_BLOCK:
        yield residual_overview(solution)
        chosen = _worst_and_typical(solution)
        which = f"{_WORST} with the largest median residuals and {_TYPICAL} from their middle"
    sheets = in_sheets(chosen, _PER_SHEET)
    omitted = left_out(every, len(chosen), which)
    for n, images in enumerate(sheets):
        found = [image_residuals(solution, j) for j in images]
        yield _sheet(solution, images, found, sheet_name("residuals", n + 1, len(sheets)), omitted)


def _worst_and_typical(solution: Solution) -> list[int]:
    """Images whose median residual, in units of its sigma, is largest, and those whose one is in the middle; sorted."""
    order = worst_first(solution)
    known = int(np.count_nonzero(np.isfinite(median_residuals(solution))))
    middle = (max(known, order.size // 2) - _TYPICAL) // 2
    return sorted({*order[:_WORST].tolist(), *order[max(middle, _WORST):][:_TYPICAL].tolist()})


@dataclass(frozen=True, slots=True, eq=False)
class _Arrows:
    """Arrows of one class in one image."""

    places: Array
    """(n, 2) line, sample."""
    residuals: Array
    """(n, 2) px, of measures or means of cells."""
    averaged: bool
    """Whether they are means of cells."""
    longer: Array
    """(m, 2) line, sample of measures whose residuals the means hide."""


@plain_style()
def _sheet(
    solution: Solution, images: Sequence[int], residuals: Sequence[ImageResiduals], name: str, omitted: str
) -> Sheet:
    pictures = [solution.network.images[j] for j in images]
    present = [point_class for point_class in PointClass if any(one.of(point_class).size for one in residuals)]
    sizes = [(picture.lines, picture.samples) for picture in pictures]
    arrows = {c: [_arrows(one, c, size) for one, size in zip(residuals, sizes, strict=True)] for c in present}
    scales = {point_class: _scale(some) for point_class, some in arrows.items()}
    caption = _caption(residuals, arrows, scales) + omitted + "."
    sheet = new_sheet(name, max(7.2, 0.6 + 3.0 * len(images)), 6.6, "Image residuals after the adjustment", caption)
    row = sheet.panels(1, len(images))[0]
    keys: dict[PointClass, Quiver] = {}
    for k, (panel, picture, one) in enumerate(zip(row, pictures, residuals, strict=True)):
        _frame(panel, picture.lines, picture.samples)
        panel.set(xlabel="sample (px)", ylabel="line (px)" if panel is row[0] else "", title=short(picture.name, 34))
        for point_class in present:
            drawn = _draw(panel, arrows[point_class][k], point_class, scales[point_class])
            if drawn is not None:
                keys.setdefault(point_class, drawn)
        _cross_out(panel, one)
    sheet.legend(_handles(residuals, arrows))
    width = float(sheet.figure.get_figwidth())
    for n, (point_class, shown) in enumerate(reversed(keys.items())):
        key = round_figure(scales[point_class])
        row[0].quiverkey(
            shown, 1.0 - (0.85 + 1.0 * n) / width, sheet.band_height(), key, f"{number(key)} px",
            coordinates="figure", labelpos="E", labelsep=0.06, color=CLASS_COLOUR[point_class],
        )
    return sheet


def _handles(residuals: Sequence[ImageResiduals], arrows: dict[PointClass, list[_Arrows]]) -> list[Line2D]:
    handles = [
        Line2D([], [], ls="", marker=CLASS_MARKER[c], ms=4, color=CLASS_COLOUR[c],
               label=CLASS_NAME[c] + ", means of cells" * any(one.averaged for one in some))
        for c, some in arrows.items()
    ]  # fmt: skip
    if any(one.longer.size for some in arrows.values() for one in some):
        handles.append(
            Line2D([], [], ls="", label="long residual", marker="o", ms=4.5, mfc="none", mew=0.9, color=_LONGER)
        )
    if any(np.any(~one.used) for one in residuals):
        handles.append(Line2D([], [], ls="", marker="x", ms=6, mew=1.4, color=INK, label="rejected (no arrow)"))
    return handles


def _arrows(one: ImageResiduals, point_class: PointClass, size: tuple[int, int]) -> _Arrows:
    """Each measure of a class, or the means of cells where there are many, and then the measures that are long."""
    mine = one.of(point_class)
    places, residuals = one.places[mine], one.residuals[mine]
    if mine.size <= _SINGLE:
        return _Arrows(places, residuals, False, np.empty((0, 2)))
    length = np.hypot(*residuals.T)
    longer = places[length > _BEYOND * float(np.median(length))]
    return _Arrows(*cell_means(places, residuals, size, _CELLS, _FEWEST), True, longer)


def _scale(arrows: Sequence[_Arrows]) -> float:
    """Pixels of the longest arrow of a class."""
    lengths = np.concatenate([np.hypot(*one.residuals.T) for one in arrows])
    return (float(np.quantile(lengths, _SHARE)) if lengths.size else 0.0) or 1.0


def _frame(panel: Axes, lines: int, samples: int) -> None:
    """The image's frame, line downward; the axes are not to the same scale."""
    panel.set(xlim=(-0.08 * samples, 1.08 * samples), ylim=(1.08 * lines, -0.08 * lines))
    panel.plot(
        [0, samples, samples, 0, 0], [0, 0, lines, lines, 0], color=SOFT, lw=1.0, zorder=1, solid_joinstyle="miter"
    )
    panel.locator_params(axis="x", nbins=5)


def _draw(panel: Axes, arrows: _Arrows, point_class: PointClass, longest: float) -> Quiver | None:
    """Dots at the places and arrows from them; None when the image has none of the class."""
    if not arrows.places.size:
        return None
    colour, (lines, samples) = CLASS_COLOUR[point_class], arrows.places.T
    down, right = cut(arrows.residuals, longest).T
    panel.plot(samples, lines, ls="", marker=CLASS_MARKER[point_class], ms=2.2, mew=0.0, color=colour, alpha=0.8)
    longer = arrows.longer[thinned(len(arrows.longer), _MOST_LONGER)]
    panel.plot(longer[:, 1], longer[:, 0], ls="", marker="o", ms=4.5, mfc="none", mew=0.9, color=_LONGER, zorder=4)
    return panel.quiver(
        samples, lines, right, -down, color=colour,
        angles="uv", units="inches", scale_units="inches", scale=longest / _LONGEST[point_class],
        width=0.011, headwidth=4.5, headlength=5.0, headaxislength=4.5, minlength=0.2, minshaft=1.5,
        zorder=3, clip_on=False,
    )


def _cross_out(panel: Axes, one: ImageResiduals) -> None:
    """Crosses at rejected rays."""
    rejected = np.flatnonzero(~one.used)
    rejected = rejected[thinned(rejected.size, MOST_MARKS)]
    lines, samples = one.places[rejected].T
    panel.plot(samples, lines, ls="", marker="x", ms=6.0, mew=1.4, color=INK, zorder=4)


def cut(residuals: Array, longest: float) -> Array:
    """Residuals (n, 2) shortened to at most `longest`, direction kept."""
    length = np.hypot(*residuals.T)
    return np.asarray(residuals * np.minimum(1.0, longest / np.maximum(length, longest * 1e-9))[:, None])


def _caption(
    residuals: Sequence[ImageResiduals], arrows: dict[PointClass, list[_Arrows]], scales: dict[PointClass, float]
) -> str:
    """What one sees, with figures."""
    parts = []
    for point_class in arrows:
        rows = [(one, one.of(point_class)) for one in residuals]
        before = np.concatenate([one.residuals_before[mine] for one, mine in rows])
        after = np.concatenate([one.residuals[mine] for one, mine in rows])
        parts.append(
            f"{len(after)} measures of {CLASS_NAME[point_class]} from {number(rms(before[:, 0]))} and "
            f"{number(rms(before[:, 1]))} to {number(rms(after[:, 0]))} and {number(rms(after[:, 1]))} px"
        )
    text = "The adjustment brought the RMS residual (line and sample, measured minus predicted) of "
    text = text + "; of ".join(parts) if parts else "No measure of these images took part in the adjustment"
    return text + _arrow_words(residuals, arrows, scales)


def _arrow_words(
    residuals: Sequence[ImageResiduals], arrows: dict[PointClass, list[_Arrows]], scales: dict[PointClass, float]
) -> str:
    """What arrows and marks are."""
    text = "; arrows go from the measured place along the residual, and line and sample axes differ in scale"
    if any(one.averaged for some in arrows.values() for one in some):
        lost = sum(len(one.longer) for some in arrows.values() for one in some)
        text += (
            f"; of a kind with more than {_SINGLE} measures in an image the mean residuals of "
            f"{_CELLS[0]} x {_CELLS[1]} cells are drawn (of at least {_FEWEST} measures), and apart from them "
            f"residuals of more than {_BEYOND:g} times the median length are marked ({lost})"
        )
    longer = sum(
        int(np.count_nonzero(np.hypot(*one.residuals.T) > scales[c] * (1.0 + 1e-9)))
        for c, some in arrows.items() for one in some
    )
    limits = " and ".join(f"{number(scales[point_class])}" for point_class in arrows)
    text += f"; arrows longer than {limits} px are cut off ({longer})" if longer else ""
    crossed = sum(int(np.count_nonzero(~one.used)) for one in residuals)
    return text + (f"; rejected measures: {crossed}" if crossed else "")
