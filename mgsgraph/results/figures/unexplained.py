"""What an adjustment cannot explain: residuals of the effects that tests name."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.analysis.systematic import EffectKind
from mgsgraph.analysis.unexplained import Pattern, Unexplained
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import AFTER, INK, SOFT, Sheet, new_sheet, number, plain_style, short

_MOST_PANELS = 4
"""Named effects that are drawn."""
_BINS = 24
_FEWEST_IN_BIN = 5
_WIDTH = 3.1
"""inch, of a panel with its labels."""


def unexplained_sheets(found: Unexplained, name: str) -> Iterator[Sheet]:
    """Up to four panels of what is named; no sheet where nothing is."""
    if found.patterns:
        yield _sheet(found, name)


@plain_style()
def _sheet(found: Unexplained, name: str) -> Sheet:
    drawn = found.patterns[:_MOST_PANELS]
    title = f"What the adjustment cannot explain: {short(name)}"
    sheet = new_sheet("unexplained", 1.0 + _WIDTH * max(len(drawn), 2), 3.4, title, _caption(found, len(drawn)))
    for panel, one in zip(sheet.panels(1, len(drawn))[0], drawn, strict=True):
        _draw_pattern(panel, one)
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=4, mew=0.0, color=AFTER, label="residuals, medians"),
        Patch(color=AFTER, alpha=0.2, lw=0.0, label="middle half of them"),
        Line2D([], [], color=INK, lw=1.2, label="as the effect has it"),
    ])  # fmt: skip
    return sheet


def _draw_pattern(panel: Axes, one: Pattern) -> None:
    effect = one.effect
    unit = "m" if effect.kind is not EffectKind.CORRELATION and effect.unit != "px" else effect.unit
    panel.axhline(0.0, color=SOFT, lw=0.8)
    if effect.kind is EffectKind.CORRELATION:
        panel.errorbar(one.along, one.residuals, 2.0 * one.shown, color=AFTER, ls="", marker="o", ms=4, capsize=2)
        panel.set(xlabel=f"points within ({unit})", ylabel="correlation and 2 sigma")
    else:
        middles, quartiles, shown = binned(one)
        panel.fill_between(middles, quartiles[:, 0], quartiles[:, 2], color=AFTER, alpha=0.2, lw=0.0)
        panel.plot(middles, quartiles[:, 1], ls="", marker="o", ms=4, mew=0.0, color=AFTER)
        panel.plot(middles, shown, color=INK, lw=1.2)
        timed = effect.kind in (EffectKind.JITTER, EffectKind.TREND)
        phase = f"time within {number(effect.period, 2)} s (s)" if np.isfinite(effect.period) else "time (s)"
        panel.set(xlabel=phase if timed else f"effect ({unit})", ylabel=f"residual ({unit})")
    panel.set_title(f"{effect.kind}: {short(effect.where, 30)}")


def binned(one: Pattern) -> tuple[Array, Array, Array]:
    """(b,) medians of what residuals vary with, (b, 3) their quartiles, and (b,) means of the effect, in bins of equal
    numbers.
    """
    order = np.argsort(one.along, kind="stable")
    bins = np.array_split(order, max(1, min(_BINS, order.size // _FEWEST_IN_BIN)))
    quartiles = np.array([np.quantile(one.residuals[mine], [0.25, 0.5, 0.75]) for mine in bins])
    middles, shown = (np.array([function(values[mine]) for mine in bins])
                      for function, values in ((np.median, one.along), (np.mean, one.shown)))  # fmt: skip
    return middles, quartiles, shown


def _caption(found: Unexplained, drawn: int) -> str:
    """What one sees, with figures."""
    return (
        f"{len(found.effects)} effects are named by {found.tests} tests, {drawn} are drawn; clearest: "
        f"{found.effects[0].sentence}. Residuals show of an effect what the adjustment did not absorb."
    )
