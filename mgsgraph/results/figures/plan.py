"""A plan drawn: the targets' sigma step by step, what each candidate would do by itself, and the information gained."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mgsgraph.planning.plan import Evaluation, Plan
from mgsgraph.results.figures.sheet import AFTER, BEFORE, INK, SOFT, Sheet, new_sheet, number, plain_style, short

_MOST = 20
"""Candidates that are drawn."""
_ROW = 0.27
"""inch, height of a bar with its gap."""
_LETTERS = 24
"""Letters of a candidate's name."""


@plain_style()
def plan_sheet(plan: Plan) -> Sheet:
    """Left: sigma after each step of the choice; right: drop of each candidate by itself, and its bits."""
    shown = [one for one in plan.ranking if not one.reason][:_MOST]
    tall = max(len(shown), len(plan.chosen) + 1, 4)
    title = f"What to observe next: {plan.name}"
    sheet = new_sheet("plan", 11.2, 1.15 + _ROW * tall, title, _caption(plan, len(shown)))
    steps, drops, bits = sheet.panels(1, 3, widths=[1.0, 1.0, 0.55])[0]
    _draw_steps(steps, plan)
    chosen = {one.name for one in plan.chosen}
    _bars(drops, shown, [100.0 * one.drop for one in shown], chosen)
    drops.set(xlabel="drop of the sigma (%)", title="each by itself")
    _bars(bits, shown, [one.bits for one in shown], chosen)
    bits.set_yticklabels([])
    bits.set_xlabel("information gained (bits)")
    sheet.legend([
        Patch(color=AFTER, label="chosen"),
        Patch(color=SOFT, label="not chosen"),
        Patch(color=BEFORE, label="as it stands"),
        Line2D([], [], color=INK, ls="--", label="first of the ranking together"),
    ])  # fmt: skip
    return sheet


def _draw_steps(panel: Axes, plan: Plan) -> None:
    """Sigma in m as it stands and after each step."""
    names = ["now", *(f"+ {short(one.name, _LETTERS - 2)}" for one in plan.chosen)]
    sigmas = [plan.now.total, *(one.after.total for one in plan.chosen)]
    bars = panel.barh(np.arange(len(names)), sigmas, color=[BEFORE, *[AFTER] * len(plan.chosen)], height=0.68)
    drops = ["", *(f" (\N{MINUS SIGN}{number(100.0 * one.drop)}%)" for one in plan.chosen)]
    labels = [f"{number(value, 4)}{drop}" for value, drop in zip(sigmas, drops, strict=True)]
    panel.bar_label(bars, labels, padding=2.0, size=8.0)
    if plan.plain is not None:
        panel.axvline(plan.plain.after.total, color=INK, ls="--", lw=1.0)
    panel.set_xlim(0.0, 1.9 * max(*sigmas, 1e-12))
    _names(panel, names)
    what = "mean" if plan.criterion == "mean" else "largest"
    panel.set(xlabel=f"{what} sigma of the targets (m)", title="one after the other")


def _bars(panel: Axes, shown: Sequence[Evaluation], values: Sequence[float], chosen: set[str]) -> None:
    colours = [AFTER if one.name in chosen else SOFT for one in shown]
    panel.barh(np.arange(len(shown)), values, color=colours, height=0.68)
    panel.set_xlim(left=0.0)
    _names(panel, [short(one.name, _LETTERS) for one in shown])


def _names(panel: Axes, names: Sequence[str]) -> None:
    panel.set_yticks(np.arange(len(names)))
    panel.set_yticklabels(names)
    panel.set_ylim(max(len(names), 1) - 0.4, -0.6)
    panel.grid(False, axis="y")
    panel.tick_params(axis="y", length=0.0)
    panel.locator_params(axis="x", nbins=5)


def _caption(plan: Plan, shown: int) -> str:
    what = "mean" if plan.criterion == "mean" else "largest"
    useful = sum(1 for one in plan.ranking if not one.reason)
    omitted = f"; of {useful} candidates the first {shown} are drawn" if useful > shown else ""
    worthless = len(plan.ranking) - useful
    omitted += f"; {worthless} worthless ones are not drawn" if worthless else ""
    if not plan.chosen:
        return f"None of the candidates lowers the {what} sigma of the targets ({plan.targets.words}){omitted}."
    return (
        f"The {what} sigma (root of the covariance's trace) of the targets ({short(plan.targets.words, 60)}) falls "
        f"from {number(plan.now.total)} to {number(plan.after.total)} m with "
        f"{len(plan.chosen)} of the candidates, by {number(100.0 * plan.drop)}%; together they gain "
        f"{number(plan.bits)} bits on the unknowns that exist already{omitted}."
    )
