"""Normal quantile plots of the normalised residuals, group by group: are the sigmas honest, are the errors normal?"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.analysis.residual_tests import ResidualStatistics
from mgsgraph.results.figures.sheet import AFTER, INK, SOFT, Sheet, new_sheet, number, plain_style, short

_ACROSS = 4
"""Panels in a row."""
_SIDE = 2.75
"""inch, of a panel with its labels."""


@plain_style()
def quantile_sheet(statistics: Sequence[ResidualStatistics], name: str) -> Sheet:
    """A panel for each group that has residuals which other rows control."""
    shown = [one for one in statistics if one.values.size]
    across = min(max(len(shown), 1), _ACROSS)
    down = -(-max(len(shown), 1) // across)
    title = f"Normalised residuals against the normal law: {short(name)}"
    sheet = new_sheet("quantiles", max(6.0, _SIDE * across + 0.6), _SIDE * down, title, _caption(shown))
    drawn = sheet.panels(down, across).ravel().tolist()
    for k, (panel, one) in enumerate(zip(drawn, shown, strict=False)):
        _draw(panel, one)
        panel.set_title(short(one.name, 38))
        panel.set_xlabel("promised by a normal law (sigmas)" if k + across >= len(shown) else "")
        panel.set_ylabel("found (sigmas)" if k % across == 0 else "")
    for panel in drawn[len(shown) :]:
        panel.set_axis_off()
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=3.5, mew=0.0, color=AFTER, label="normalised residuals"),
        Line2D([], [], color=INK, lw=1.0, label="honest sigmas, normal errors"),
        Patch(color=SOFT, alpha=0.3, lw=0.0, label="pointwise 95% band"),
    ])  # fmt: skip
    return sheet


def _draw(panel: Axes, one: ResidualStatistics) -> None:
    plot = one.quantiles()
    ends = np.array([min(-2.5, plot.promised[0]), max(2.5, plot.promised[-1])])
    panel.fill_between(plot.promised, plot.low, plot.high, color=SOFT, alpha=0.3, lw=0.0)
    panel.plot(ends, ends, color=INK, lw=1.0)
    panel.plot(plot.promised, plot.found, ls="", marker="o", ms=2.6, mew=0.0, color=AFTER)
    panel.locator_params(nbins=6)
    panel.text(
        0.05, 0.95, f"rms {number(one.rms)}\n{one.values.size} residuals\nworth {number(one.effective)}",
        transform=panel.transAxes, va="top", size=7.5, linespacing=1.35,
    )  # fmt: skip


def _caption(shown: Sequence[ResidualStatistics]) -> str:
    """What one sees, with figures."""
    if not shown:
        return "No residual is controlled by other rows."
    off = [one.name for one in shown if one.as_promised is False]
    return (
        "Residuals over their own sigmas should lie on the line: steeper means sigmas that are too small, flatter too "
        f"large ones, bent ends long tails; law or rms not as promised (1% tests): {', '.join(off) or 'no group'}; "
        "bands count correlated residuals as the number of independent ones that they are worth."
    )
