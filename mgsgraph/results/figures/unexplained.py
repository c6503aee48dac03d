"""What an adjustment cannot explain: the clearest test of each place, and the residuals of what is named as they go."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.analysis.systematic import EffectKind
from mgsgraph.analysis.unexplained import Pattern, Unexplained
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, SOFT, Sheet, new_sheet, number, plain_style, short

_MOST_PANELS = 3
"""Named effects that are drawn."""
_BINS = 24
_FEWEST_IN_BIN = 5
_LEAST = 1e-30
"""p-value at which the scale ends."""
_WIDTH = 3.1
"""inch, of a panel with its labels."""


@plain_style()
def unexplained_sheet(found: Unexplained, name: str) -> Sheet:
    """All tests, and up to three panels of what is named."""
    drawn = found.patterns[:_MOST_PANELS]
    title = f"What the adjustment cannot explain: {short(name)}"
    sheet = new_sheet("unexplained", 1.2 + _WIDTH * (1 + max(len(drawn), 1)), 3.4, title, _caption(found, len(drawn)))
    overview, *panels = sheet.panels(1, 1 + len(drawn), widths=[1.35, *[1.0] * len(drawn)])[0].tolist()
    _draw_tests(overview, found)
    for panel, one in zip(panels, drawn, strict=True):
        _draw_pattern(panel, one)
    tests = [
        Line2D([], [], ls="", marker="o", ms=5.5, mew=0.0, color=BEFORE, label="named"),
        Line2D([], [], ls="", marker="o", ms=4, mew=0.0, color=SOFT, label="not named"),
        Line2D([], [], ls="--", lw=1.0, color=INK, label="level of the run"),
    ]
    residuals = [
        Line2D([], [], ls="", marker="o", ms=4, mew=0.0, color=AFTER, label="residuals, medians"),
        Patch(color=AFTER, alpha=0.2, lw=0.0, label="middle half of them"),
        Line2D([], [], color=INK, lw=1.2, label="as the effect has it"),
    ]
    sheet.legend([*tests, *(residuals if drawn else ())])
    return sheet


def _draw_tests(panel: Axes, found: Unexplained) -> None:
    """p-values of all places, a row for each kind of effect."""
    every = [(one, True) for one in found.effects] + [(one, False) for one in found.others]
    kinds = [kind for kind in EffectKind if any(one.kind is kind for one, _ in every)]
    for named in (False, True):
        mine = [one for one, is_named in every if is_named is named]
        panel.plot(
            [_power(one.p_value) for one in mine], [kinds.index(one.kind) for one in mine], ls="", marker="o",
            ms=5.5 if named else 4.0, mew=0.0, color=BEFORE if named else SOFT, alpha=0.9 if named else 0.6,
        )  # fmt: skip
    panel.axvline(_power(found.level), color=INK, lw=1.0, ls="--")
    most = max((_power(one.p_value) for one, _ in every), default=0.0)
    panel.set(xlim=(-0.3, max(1.1 * most, 1.5 * _power(found.level))), ylim=(len(kinds) - 0.5, -0.5))
    panel.set_yticks(range(len(kinds)), [str(kind) for kind in kinds])
    panel.set_xlabel("p of the whole run, ten to the minus")
    panel.set_title("Clearest test of each place")


def _power(p_value: float) -> float:
    return -math.log10(max(p_value, _LEAST))


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
    if not found.effects:
        least = min((one.p_value for one in found.others), default=1.0)
        return (
            f"None of {found.tests} tests of the residuals is clearer than a run on good data has it once in "
            f"{number(1.0 / found.level)}: the least p-value for the whole run is {number(least, 2)}."
        )
    first = found.effects[0]
    text = f"{len(found.effects)} effects are named by {found.tests} tests; clearest: {first.sentence}"
    more = len(found.effects) - drawn
    return text + (f"; of {more} more the table has the rest" if more > 0 else "") + (
        ". Residuals show of an effect what the adjustment did not absorb."
    )
