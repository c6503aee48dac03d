"""How well each spacing of orientation images predicts rays held out."""


import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullLocator

from mgsgraph.analysis.spacing import Choice
from mgsgraph.results.figures.sheet import (
    AFTER,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    short,
)

_GREEN = "#009E73"


@plain_style()
def spacing_sheet(choice: Choice, name: str) -> Sheet:
    """Left: misfit of rays held out over the spacing; right: how much worse than the best one."""
    good = [k for k, one in enumerate(choice.candidates) if not one.refused]
    chosen, best = choice.candidates[choice.chosen], choice.candidates[choice.best]
    refused = [f"{one.spacing:g} s" for one in choice.candidates if one.refused]
    caption = (
        f"{chosen.squares.size} rays held out, predicted with nodes at each spacing: misfit in sigmas that it has when "
        f"orientation is known; noise alone is 1. Best: {best.spacing:g} s (rms "
        f"{number(best.rms, 4)}). Chosen: {chosen.spacing:g} s (rms {number(chosen.rms, 4)}), "
        "the coarsest not worse by more than one standard error; "
        "bars are standard errors, on the right of differences ray by ray"
        + (f"; refused, as rays don't support them: {', '.join(refused)}." if refused else ".")
    )
    sheet = new_sheet("spacings", 8.6, 3.6, f"Spacing of orientation images: {short(name, 50)}", caption)
    left, right = sheet.panels(1, 2)[0]
    spacings = np.array([choice.candidates[k].spacing for k in good])
    rms = np.array([choice.candidates[k].rms for k in good])
    left.errorbar(spacings, rms, choice.rms_errors[good], color=AFTER, marker="o", ms=4.0, capsize=2.5)
    left.axhline(1.0, color=SOFT, lw=0.9)
    left.set(xlabel="spacing (s)", ylabel="misfit held out (sigma)")
    shown = np.maximum(choice.worse[good], 0.0)
    right.errorbar(spacings, shown, choice.worse_errors[good], color=AFTER, marker="o", ms=4.0, capsize=2.5)
    right.axhline(0.0, color=SOFT, lw=0.9)
    positive = shown[shown > 0.0]
    if positive.size and positive.max() > 30.0 * positive.min():
        linear = max(float(np.median(choice.worse_errors[good])), 1e-4)
        right.set_yscale("symlog", linthresh=linear)
        right.yaxis.set_major_formatter("{x:g}")
        right.set_ylim(bottom=-0.5 * linear)
    right.set(xlabel="spacing (s)", ylabel="mean square less the best one's")
    for panel in (left, right):
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(spacings.tolist()))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:g}")
        panel.axvline(chosen.spacing, color=_GREEN, lw=5.0, alpha=0.3, zorder=0)
    sheet.legend([
        Line2D([], [], color=AFTER, marker="o", ms=4.0, label="rms"),
        Line2D([], [], color=SOFT, label="noise alone"),
        Patch(color=_GREEN, alpha=0.3, lw=0.0, label="chosen"),
    ])  # fmt: skip
    return sheet
