"""Places at which a terrain model fits, over its shift."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.adjustment.multistart import Minima
from mgsgraph.adjustment.solution import Solution
from mgsgraph.results.figures.relief import draw_ellipse
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, SOFT, Sheet, new_sheet, plain_style

_SHOWN = 0.001
"""Weight from which a minimum is drawn."""


def minima_sheets(solution: Solution) -> Iterator[Sheet]:
    """One sheet where a second minimum is worth a word; else none."""
    if solution.minima is not None and solution.minima.several:
        yield _sheet(solution, solution.minima)


@plain_style()
def _sheet(solution: Solution, found: Minima) -> Sheet:
    surface = solution.network.surface
    assert surface is not None
    shown = [one for one in found.each if one.weight >= _SHOWN]
    caption = (
        f"Where the terrain model lies by {found.starts} starts over its shift: minima of the cost with one sigma and "
        "their probability, the mixture's mean and sigma, and one a-priori sigma about zero."
    )
    sheet = new_sheet("minima", 6.4, 5.6, f"Several minima: {solution.name}", caption)
    panel: Axes = sheet.panels()[0, 0]
    draw_ellipse(panel, np.zeros(2), np.eye(2) * surface.shift_sigma**2, ":", SOFT)
    for k, one in enumerate(shown):
        draw_ellipse(panel, one.shift[:2], one.spread[:2, :2], "-", AFTER if k == 0 else BEFORE)
        panel.plot(*one.shift[:2], "X" if k == 0 else "o", ms=7, mfc="white", mec=INK, mew=0.9, zorder=8)
        place = float(one.shift[0]), float(one.shift[1])
        panel.annotate(f"{one.weight:.0%}", place, (7, 5), textcoords="offset points", size=9.0, zorder=9)
    draw_ellipse(panel, found.mean[:2], found.covariance[:2, :2], "--", INK)
    panel.plot(*found.mean[:2], "+", ms=9, color=INK, zorder=8)
    panel.set(aspect="equal", xlabel="shift east (m)", ylabel="shift north (m)")
    panel.autoscale_view()
    reach = np.abs([panel.get_xlim(), panel.get_ylim()]).max()
    panel.set(xlim=(-reach, reach), ylim=(-reach, reach))
    sheet.legend([
        Line2D([], [], color=AFTER, marker="X", mfc="white", mec=INK, label="solution"),
        Line2D([], [], color=BEFORE, marker="o", mfc="white", mec=INK, label="other minima"),
        Line2D([], [], color=INK, ls="--", marker="+", label="mixture"),
        Line2D([], [], color=SOFT, ls=":", label="a priori"),
    ])  # fmt: skip
    return sheet
