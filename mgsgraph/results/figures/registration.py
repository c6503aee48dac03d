"""How well the laser profile lies in the images: where its points fall, against their measured places."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.registration.measured import (
    MeasuredDiscrepancy,
    MeasuredFootprints,
    registration_discrepancy,
    registration_offsets,
)
from mgsgraph.results.figures.aggregate import LARGE_BLOCK
from mgsgraph.results.figures.content import mean, rms
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    INK,
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

_PER_SHEET, _OF_LARGE = 2, 2
"""Images on a sheet, and sheets of a large block, all of whose laser points are on the overview of residuals."""
MOST_SHOTS = 1000
"""Laser points in an image; each is drawn up to ten times."""
_LABELS = ("sample (px)", "line, measured\nminus projected (px)", "sample, measured\nminus projected (px)")


def registration_sheets(solution: Solution) -> Iterator[Sheet]:
    """Sheets of up to two images that see laser points; nothing without laser points.

    Of a large block, the images with most measured shots and ranges, because projecting every shot onto every image
    would take longer than the adjustment.
    """
    if not solution.members(PointClass.LASER).size:
        return
    large = len(solution.network.images) > LARGE_BLOCK
    chosen = _richest(solution, _PER_SHEET * (_OF_LARGE if large else MOST_SHEETS))
    omitted = left_out(len(solution.network.images), len(chosen), f"{len(chosen)} with most laser measures")
    found = {j: registration_offsets(solution, j, MOST_SHOTS) for j in chosen}
    seeing = [j for j in chosen if found[j].points.size]
    sheets = in_sheets(seeing, _PER_SHEET)
    for n, images in enumerate(sheets):
        name = sheet_name("registration", n + 1, len(sheets))
        yield _sheet(solution, [found[j] for j in images], name, omitted)


def _richest(solution: Solution, most: int) -> list[int]:
    """The `most` images with most laser measures and ranges, in their own order."""
    network = solution.network
    laser = network.points.classes[network.rays.point] == PointClass.LASER
    counts = np.bincount(network.rays.image[laser], minlength=len(network.images))
    counts = counts + np.bincount(network.ranges.image, minlength=len(network.images))
    return sorted(np.argsort(-counts, kind="stable")[:most].tolist())


@plain_style()
def _sheet(solution: Solution, registrations: Sequence[MeasuredFootprints], name: str, omitted: str) -> Sheet:
    pair = _pair(solution, registrations)
    caption = _caption(solution, registrations, pair) + omitted + "."
    height = 6.4 if pair is None else 8.8
    width = 11.0 if len(registrations) > 1 else 7.6
    sheet = new_sheet(name, width, height, "Registration of the laser profile with the images", caption)
    ratios = [1.25, 1.0, 1.0] if pair is None else [1.25, 1.0, 1.0, 1.0]
    grid = sheet.panels(len(ratios), len(registrations), heights=ratios)
    factor = min(magnification(one) for one in registrations)
    for column, registration in zip(grid.T, registrations, strict=True):
        _frame(column[0], solution, registration, factor)
        for k, panel in enumerate(column[1:3]):
            panel.sharex(column[0])
            panel.sharey(grid[1 + k, 0])
            _along(panel, registration.lines, registration.offset_before[:, k], registration.offset_after[:, k])
        for panel, label in zip(column, _LABELS, strict=False):
            panel.set(xlabel="line (px)" if panel is column[2] else "", ylabel=label)
            panel.tick_params(labelbottom=panel is column[2])
    if pair is not None:
        _contradiction(grid[3], pair)
    marks = (
        ("measured", "+", INK, INK),
        ("before: a-priori footprint, nominal orientation", "o", BEFORE, "white"),
        ("after: both adjusted", "o", AFTER, AFTER),
    )
    sheet.legend([
        Line2D([], [], ls="", marker=marker, ms=5, mec=colour, mfc=face, mew=1.2, label=label)
        for label, marker, colour, face in marks
    ])
    return sheet


def _pair(solution: Solution, registrations: Sequence[MeasuredFootprints]) -> MeasuredDiscrepancy | None:
    """The discrepancy of two images that have measures of the same laser points."""
    if len(registrations) != 2:
        return None
    pair = registration_discrepancy(solution, *registrations)
    return pair if pair.lines.size else None


def magnification(registration: MeasuredFootprints) -> float:
    """Factor by which offsets are drawn enlarged: a round figure that leaves marks nearer to their place than the next
    one is; 1 where nothing is measured.
    """
    offsets = np.concatenate([registration.offset_before, registration.offset_after])
    sizes = np.abs(offsets[np.isfinite(offsets)])
    gaps = np.diff(registration.lines[np.isfinite(registration.lines)])
    if not sizes.size or not gaps.size:
        return 1.0
    return max(1.0, round_figure(0.75 * float(np.mean(gaps)) / max(float(np.quantile(sizes, 0.95)), 1e-9)))


def _frame(panel: Axes, solution: Solution, one: MeasuredFootprints, factor: float) -> None:
    """The image lying on its side, so that the profile has its offsets right below it."""
    picture = solution.network.images[one.image]
    lines, samples = picture.lines, picture.samples
    panel.plot([0, lines, lines, 0, 0], [0, 0, samples, samples, 0], color=SOFT, lw=1.0, zorder=1)
    panel.set(xlim=(-0.02 * lines, 1.02 * lines), ylim=(1.12 * samples, -0.12 * samples))
    seen = np.isnan(one.measured[:, 0])
    for projected, colour, face, size, order in (
        (one.before, BEFORE, "white", 4.2, 3), (one.after, AFTER, AFTER, 3.0, 4)
    ):
        shown = np.where(seen[:, None], projected, one.measured + factor * (projected - one.measured))
        panel.plot(
            shown[:, 0], shown[:, 1], ls="", marker="o", ms=size, mec=colour, mfc=face, mew=0.9, zorder=order,
            clip_on=True,
        )
    panel.plot(one.measured[:, 0], one.measured[:, 1], ls="", marker="+", ms=4.5, mew=0.8, color=INK, zorder=5)
    enlarged = f", displacements {number(factor)} times enlarged" if factor > 1.0 else ""
    panel.set_title(f"{short(picture.name, 34)}{enlarged}")


def _along(panel: Axes, lines: Array, before: Array, after: Array) -> None:
    panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
    panel.plot(lines, before, color=BEFORE, lw=0.8, marker="o", ms=3.2, mfc="white", mew=0.9)
    panel.plot(lines, after, color=AFTER, lw=0.8, marker="o", ms=2.6, mew=0.0)
    panel.margins(y=0.12)
    panel.locator_params(axis="y", nbins=6)


def _contradiction(row: Iterable[Axes], pair: MeasuredDiscrepancy) -> None:
    """Offsets in the first image minus those in the second, along the first."""
    for k, (panel, what) in enumerate(zip(row, ("line", "sample"), strict=True)):
        _along(panel, pair.lines, pair.before[:, k], pair.after[:, k])
        panel.set_title(f"Discrepancy between the images: {what}s, in pixels of the left one")
        panel.set(xlabel="line of the left image (px)", ylabel=f"{what}, left\nminus right (px)")


def _caption(solution: Solution, registrations: Sequence[MeasuredFootprints], pair: MeasuredDiscrepancy | None) -> str:
    """What one sees, with figures."""
    sides = ("",) if len(registrations) == 1 else (" left", " right")
    parts = [_offsets(one, side) for one, side in zip(registrations, sides, strict=True)]
    text = "Laser points, measured minus projected (mean ± scatter): " + "; ".join(parts)
    if pair is not None:
        text += (
            f"; the two images contradict each other by {number(mean(pair.before[:, 0]))} lines on the average before "
            f"and {number(mean(pair.after[:, 0]))} lines after"
        )
    total = solution.members(PointClass.LASER).size
    return text + (f"; {MOST_SHOTS} of {total} shots are drawn" if total > MOST_SHOTS else "")


def _offsets(one: MeasuredFootprints, where: str) -> str:
    """The offsets of one image in words."""
    if not np.any(np.isfinite(one.offset_after)):
        return f"none is measured in the{where} image, which sees {one.points.size} of them"
    before, after = [
        " and ".join(f"{_spread(offset[:, k])} {what}" for k, what in enumerate(("lines", "samples")))
        for offset in (one.offset_before, one.offset_after)
    ]
    return f"in the{where} image {before} before the adjustment, {after} after it"


def _spread(values: Array) -> str:
    middle = mean(values)
    return f"{number(middle)} ± {number(rms(values - middle), 2)}"
