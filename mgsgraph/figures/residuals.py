"""Residuals of image coordinates as arrows in the frame of each image."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver

from mgsgraph.adjustment.solution import Solution
from mgsgraph.figures.content import ImageResiduals, image_residuals, rms
from mgsgraph.figures.sheet import (
    CLASS_COLOUR,
    CLASS_MARKER,
    CLASS_NAME,
    INK,
    MOST_MARKS,
    MOST_SHEETS,
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
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.registration.measured import thinned

_PER_SHEET = 4
_LONGEST = {PointClass.TIE: 0.4, PointClass.LASER: 0.18, PointClass.CONTROL: 0.4, PointClass.POST: 0.18}
"""inch, of the longest arrow; laser points lie in rows so dense that long arrows would hide each other."""
_SHARE = 0.98
"""Share of the residuals that are drawn in full; the others' arrows are cut off at the longest of these."""


def residual_sheets(solution: Solution) -> Iterator[Sheet]:
    """Sheets of up to four images; of a large block, the images with the largest residuals."""
    every = [image_residuals(solution, j) for j in range(len(solution.network.images))]
    chosen = _worst([rms(one.residuals[one.used]) for one in every], _PER_SHEET * MOST_SHEETS)
    sheets = in_sheets(chosen, _PER_SHEET)
    omitted = left_out(len(every), len(chosen), f"{len(chosen)} with the largest residuals")
    for n, images in enumerate(sheets):
        yield _sheet(solution, images, [every[j] for j in images], sheet_name("residuals", n + 1, len(sheets)), omitted)


def _worst(sizes: Sequence[float], most: int) -> list[int]:
    """Indices of the `most` largest, NaN last, in their own order."""
    order = np.argsort(-np.nan_to_num(np.array(sizes), nan=-1.0), kind="stable")
    return sorted(order[:most].tolist())


@plain_style()
def _sheet(
    solution: Solution, images: Sequence[int], residuals: Sequence[ImageResiduals], name: str, omitted: str
) -> Sheet:
    scales = {point_class: _scale(residuals, point_class) for point_class in PointClass}
    present = [point_class for point_class in PointClass if any(one.of(point_class).size for one in residuals)]
    caption = _caption(residuals, present, scales) + omitted + "."
    sheet = new_sheet(name, max(7.2, 0.6 + 3.0 * len(images)), 6.6, "Image residuals after the adjustment", caption)
    row = sheet.panels(1, len(images))[0]
    keys: dict[PointClass, Quiver] = {}
    for panel, j, one in zip(row, images, residuals, strict=True):
        picture = solution.network.images[j]
        _frame(panel, picture.lines, picture.samples)
        panel.set(xlabel="sample (px)", ylabel="line (px)" if panel is row[0] else "", title=short(picture.name, 34))
        for point_class in present:
            arrows = _draw(panel, one, point_class, scales[point_class])
            if arrows is not None:
                keys.setdefault(point_class, arrows)
        _cross_out(panel, one)
    handles = [
        Line2D([], [], ls="", marker=CLASS_MARKER[c], ms=4, color=CLASS_COLOUR[c], label=CLASS_NAME[c]) for c in present
    ]
    if any(np.any(~one.used) for one in residuals):
        handles.append(Line2D([], [], ls="", marker="x", ms=6, mew=1.4, color=INK, label="rejected (no arrow)"))
    sheet.legend(handles)
    width = float(sheet.figure.get_figwidth())
    for n, (point_class, arrows) in enumerate(reversed(keys.items())):
        key = round_figure(scales[point_class])
        row[0].quiverkey(
            arrows, 1.0 - (0.85 + 1.0 * n) / width, sheet.band_height(), key, f"{number(key)} px",
            coordinates="figure", labelpos="E", labelsep=0.06, color=CLASS_COLOUR[point_class],
        )
    return sheet


def _scale(residuals: Sequence[ImageResiduals], point_class: PointClass) -> float:
    """Pixels of the longest arrow of a class."""
    lengths = np.concatenate([np.hypot(*one.residuals[one.of(point_class)].T) for one in residuals])
    return (float(np.quantile(lengths, _SHARE)) if lengths.size else 0.0) or 1.0


def _frame(panel: Axes, lines: int, samples: int) -> None:
    """The image's frame, line downward; the axes are not to the same scale."""
    panel.set(xlim=(-0.08 * samples, 1.08 * samples), ylim=(1.08 * lines, -0.08 * lines))
    panel.plot(
        [0, samples, samples, 0, 0], [0, 0, lines, lines, 0], color=SOFT, lw=1.0, zorder=1, solid_joinstyle="miter"
    )
    panel.locator_params(axis="x", nbins=5)


def _draw(panel: Axes, one: ImageResiduals, point_class: PointClass, longest: float) -> Quiver | None:
    """Dots at the measured places and arrows from them; None when the image has none of the class."""
    mine = one.of(point_class)
    if not mine.size:
        return None
    mine = mine[thinned(mine.size, MOST_MARKS)]
    colour, (lines, samples) = CLASS_COLOUR[point_class], one.places[mine].T
    down, right = cut(one.residuals[mine], longest).T
    panel.plot(samples, lines, ls="", marker=CLASS_MARKER[point_class], ms=2.2, mew=0.0, color=colour, alpha=0.8)
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
    residuals: Sequence[ImageResiduals], present: Sequence[PointClass], scales: dict[PointClass, float]
) -> str:
    """What one sees, with figures."""
    parts, longer, fewer = [], 0, False
    for point_class in present:
        rows = [(one, one.of(point_class)) for one in residuals]
        before = np.concatenate([one.residuals_before[mine] for one, mine in rows])
        after = np.concatenate([one.residuals[mine] for one, mine in rows])
        longer += int(np.count_nonzero(np.hypot(*after.T) > scales[point_class] * (1.0 + 1e-9)))
        fewer = fewer or any(mine.size > MOST_MARKS for _, mine in rows)
        parts.append(
            f"{len(after)} measures of {CLASS_NAME[point_class]} from {number(rms(before[:, 0]))} and "
            f"{number(rms(before[:, 1]))} to {number(rms(after[:, 0]))} and {number(rms(after[:, 1]))} px"
        )
    crossed = sum(int(np.count_nonzero(~one.used)) for one in residuals)
    text = "The adjustment brought the RMS residual (line and sample, measured minus predicted) of "
    text = text + "; of ".join(parts) if parts else "No measure of these images took part in the adjustment"
    text += "; arrows go from the measured place along the residual, and line and sample axes differ in scale"
    limits = " and ".join(f"{number(scales[point_class])}" for point_class in present)
    text += f"; arrows longer than {limits} px are cut off ({longer})" if longer else ""
    text += f"; rejected measures: {crossed}" if crossed else ""
    return text + (f"; at most {MOST_MARKS} arrows of a kind are drawn in a panel" if fewer else "")
