"""Spectra of residuals: amplitude of pitch, roll and yaw of each image over frequency, with the level of confidence."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from mgsgraph.analysis.residual_spectrum import FALSE_ALARMS, TURNS
from mgsgraph.analysis.vibrations import ImageSpectrum, ResidualVibrations
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, SOFT, Sheet, new_sheet, number, plain_style, short
from mgsgraph.text import many

_MOST_IMAGES = 4
"""That are drawn: those with the clearest vibrations first."""
_ABOVE = 1.3
"""Times its amplitude, where a vibration's mark stands."""


@plain_style()
def vibrations_sheet(found: ResidualVibrations, name: str) -> Sheet:
    """A row of panels per image, a column per turn."""
    named = [one.image for one in found.vibrations]
    images = list(dict.fromkeys([*named, *(one.image for one in found.spectra)]))
    drawn = images[:_MOST_IMAGES]
    sheet = new_sheet(
        "vibrations", 9.6, 1.4 + 1.9 * len(drawn), f"Vibrations in residuals: {short(name, 50)}",
        _caption(found, len(images) - len(drawn)),
    )  # fmt: skip
    grid = sheet.panels(len(drawn), len(TURNS), sharex="col")
    for row, image in enumerate(drawn):
        for column, turn in enumerate(TURNS):
            panel: Axes = grid[row, column]
            one = next(each for each in found.spectra if (each.image, each.turn) == (image, turn))
            _draw(panel, one)
            if row == 0:
                panel.set_title(turn)
            panel.set(
                xlabel="frequency (Hz)" if row == len(drawn) - 1 else "",
                ylabel=f"{short(image, 18)} (px)" if column == 0 else "",
            )
    sheet.legend([
        Line2D([], [], color=AFTER, label="amplitude"),
        Patch(color=SOFT, alpha=0.45, lw=0.0, label="noise floor (rms)"),
        Line2D([], [], color=INK, ls="--", lw=1.0, label=f"{100.0 - 100.0 * FALSE_ALARMS:g} % level, all frequencies"),
        Line2D([], [], color=BEFORE, marker="v", ls="", ms=6.0, label="vibration"),
    ])  # fmt: skip
    return sheet


def _draw(panel: Axes, one: ImageSpectrum) -> None:
    panel.set_xscale("log")
    panel.set_xlim(one.frequencies[0], one.frequencies[-1])
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())
    if one.blind:
        panel.set_yticks([])
        panel.text(
            0.5, 0.5, f"not seen: residuals show\n{_percent(one.share)} of it", transform=panel.transAxes,
            ha="center", va="center", color=INK,
        )  # fmt: skip
        return
    bottom = 0.1 * float(np.median(one.floor))
    panel.fill_between(one.frequencies, bottom, one.floor, color=SOFT, alpha=0.45, lw=0.0)
    panel.plot(one.frequencies, one.level, color=INK, ls="--", lw=0.7)
    panel.plot(one.frequencies, np.maximum(one.amplitudes, bottom), color=AFTER, lw=0.8)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter(NullFormatter())
    top = max(float(one.amplitudes.max()), float(np.quantile(one.level, 0.9)))
    for peak in one.peaks:
        height = _ABOVE * peak.amplitude
        panel.plot([peak.frequency], [height], color=BEFORE, marker="v", ms=6.0)
        panel.annotate(f"   {number(peak.frequency)} Hz, {number(peak.amplitude, 2)} px", (peak.frequency, height),
                       va="center", size=8.0)  # fmt: skip
        top = max(top, height)
    panel.set_ylim(bottom, 3.0 * top)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1g} %" if share > 1e-4 else "less than 0.01 %"


def _caption(found: ResidualVibrations, left_out: int) -> str:
    return (
        f"{many(len(found.vibrations), 'vibration')} above the noise, which crosses the dashed level somewhere in "
        f"{100.0 * FALSE_ALARMS:g} % of such panels; marks say Hz and px. Panels without a curve: points take such "
        f"turns up as heights. {many(left_out, 'more image')} not drawn."
    )
