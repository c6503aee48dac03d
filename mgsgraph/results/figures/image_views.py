"""Images side by side over the same ground, as the studio shows them: pictures with ties, shots and ellipses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import BEFORE, INK, LIGHT, Sheet, new_sheet, number, plain_style, short
from mgsgraph.text import listed, many

_TIE, _OUT, _ELLIPSE = "#F0E442", "#FF7A45", "#FFFFFF"
_BLANK = "#6B6B6B"
_SIDE = 3.4
"""inch, width and height of a panel."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageView:
    """A part of an image and what lies on it."""

    name: str
    """Of the image."""
    grey: NDArray[Any] | None
    """(lines, samples) of its picture, perhaps reduced; None where there is none."""
    extent: tuple[float, float, float, float]
    """px, sample and line where `grey` begins and ends: left, right, bottom, top."""
    window: tuple[float, float, float, float]
    """px, what is shown: line from and to, sample from and to."""
    contrast: tuple[float, float]
    """Grey values that are black and white."""
    ties: Mapping[str, Any]
    """As the studio's page has them: measured, residuals, used."""
    shots: Mapping[str, Any]
    """The same: profiles with before and after."""
    predicted: tuple[Array, Array, Array] | None = None
    """Place (2,) of the ground in the first image's middle; semi-axes (2,) px and angle (1,) deg of its ellipse."""


@plain_style()
def images_sheet(views: Sequence[ImageView], factor: float, adjusted: bool) -> Sheet:
    """Parts of images that show the same ground.

    Parameters
    ----------
    views : sequence of ImageView
        The first one is the one that the others follow.
    factor : float
        By which residuals are drawn longer than they are; 0 for none.
    adjusted : bool
        Whether the block is: else there are neither residuals nor places after.
    """
    columns = min(len(views), 2)
    rows = -(-len(views) // columns)
    names = [short(one.name, 24) for one in views]
    title = f"The same ground in {listed(names)}" if len(views) > 1 else f"Image {names[0]}"
    sheet = new_sheet(
        "images", columns * (_SIDE + 0.75) + 0.3, rows * (_SIDE + 0.55), short(title, 90),
        _caption(views, factor, adjusted),
    )  # fmt: skip
    panels = sheet.panels(rows, columns).ravel()
    for panel, view in zip(panels, views, strict=False):
        _draw(panel, view, factor)
    for panel in panels[len(views) :]:
        panel.set_axis_off()
    sheet.legend(_handles(views, factor, adjusted))
    return sheet


def _draw(panel: Axes, view: ImageView, factor: float) -> None:
    line0, line1, sample0, sample1 = view.window
    panel.grid(visible=False)
    panel.set_facecolor("#2B2B2B")
    if view.grey is None:
        left, right, bottom, top = view.extent
        panel.fill_between([left, right], bottom, top, color=_BLANK, lw=0.0, zorder=0)
    else:
        panel.imshow(
            np.ma.masked_invalid(view.grey), cmap="gray", vmin=view.contrast[0], vmax=view.contrast[1],
            extent=view.extent, interpolation="nearest", zorder=0,
        )  # fmt: skip
    _draw_shots(panel, view)
    _draw_ties(panel, view, factor)
    if view.predicted is not None:
        place, axes, angle = view.predicted
        panel.plot(place[1], place[0], ls="", marker=".", ms=3.0, color=_ELLIPSE, zorder=7)
        panel.add_patch(Ellipse(
            (place[1], place[0]), 2.0 * axes[0], 2.0 * axes[1], angle=float(angle[0]), fill=False, ec=_ELLIPSE, lw=1.2,
            zorder=7,
        ))  # fmt: skip
    panel.set(xlim=(sample0, sample1), ylim=(line1, line0), aspect="equal", xlabel="sample (px)", ylabel="line (px)")
    panel.set_title(short(view.name, 40))


def _draw_shots(panel: Axes, view: ImageView) -> None:
    for profile in view.shots["profiles"]:
        before, after = (_places(profile[key]) for key in ("before", "after"))
        ends = np.stack([before, after], axis=1)
        panel.plot(ends[:, :, 1].T, ends[:, :, 0].T, color="white", alpha=0.4, lw=0.6, zorder=3)
        panel.plot(before[:, 1], before[:, 0], ls="", marker="o", ms=4.0, mfc="none", mec=BEFORE, mew=1.0, zorder=4)
        panel.plot(after[:, 1], after[:, 0], ls="", marker="^", ms=4.0, mfc="none", mec=LIGHT, mew=1.0, zorder=5)


def _draw_ties(panel: Axes, view: ImageView, factor: float) -> None:
    measured, residuals = _places(view.ties["measured"]), _places(view.ties["residuals"])
    used = np.array(view.ties["used"], dtype=bool)
    if factor:
        ends = np.stack([measured, measured + factor * residuals], axis=1)
        panel.plot(ends[:, :, 1].T, ends[:, :, 0].T, color=_TIE, lw=0.8, zorder=5)
    panel.plot(measured[used, 1], measured[used, 0], ls="", marker="+", ms=5.0, color=_TIE, zorder=6)
    panel.plot(measured[~used, 1], measured[~used, 0], ls="", marker="x", ms=5.0, color=_OUT, zorder=6)


def _places(pairs: Sequence[Sequence[float] | None]) -> Array:
    """(n, 2) line and sample, NaN where there are none."""
    return np.array([(np.nan, np.nan) if pair is None else pair for pair in pairs], dtype=np.float64).reshape(-1, 2)


def _handles(views: Sequence[ImageView], factor: float, adjusted: bool) -> list[Line2D]:
    found = list[Line2D]()
    if any(one.ties["measured"] for one in views):
        found.append(Line2D([], [], ls="", marker="+", ms=6, color="#9A8F00", label="tie"))
        if factor and adjusted:
            found.append(Line2D([], [], color="#9A8F00", lw=1.0, label=f"residual × {number(factor)}"))
    if any(one.shots["profiles"] for one in views):
        before = Line2D([], [], ls="", marker="o", ms=5, mfc="none", mec=BEFORE, label="shot before")
        found += [before, Line2D([], [], ls="", marker="^", ms=5, mfc="none", mec=LIGHT, label="shot after")]
    if any(one.predicted is not None for one in views):
        found.append(Line2D([], [], ls="", marker="o", ms=7, mfc="none", mec=INK, label="predicted place"))
    return found


def _caption(views: Sequence[ImageView], factor: float, adjusted: bool) -> str:
    first = views[0]
    line0, line1, sample0, sample1 = (number(one, 6) for one in first.window)
    shots = sum(len(profile["names"]) for profile in first.shots["profiles"])
    text = (
        f"Lines {line0} to {line1} and samples {sample0} to {sample1} of {first.name} (first pixel's centre at 0.5), "
        f"{many(len(first.ties['measured']), 'tie')} and {many(shots, 'laser shot')} in it, and the same ground in "
        f"{many(len(views) - 1, 'other image')}"
    )
    if factor and adjusted:
        text += f"; residuals, measured minus predicted, are drawn {number(factor)} times as long"
    if any(one.predicted is not None for one in views):
        text += "; ellipses hold the place of the first image's middle with a probability of 95 %"
    return text + ("." if adjusted else "; the block has not been adjusted.")

