"""The page of the Monte-Carlo proof in Markdown, and its figure: coverage, NEES and bias."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from montecarlo_draw import BLOCK, CASES, KINDS, LINES, NEW, PIXELS, POINTS, Drawn
from montecarlo_judge import ASTRAY, CHANCE, CHECKS, LEVELS, Judged, astray, binomial_limits, breaking_strain, judged
from scipy.stats import chi2
from study import made_with, table

HEAD = f"""# Is the posterior right? A Monte-Carlo proof

Each seed draws a truth (every orientation coefficient, profile shift, footprint and height above the terrain), then
every measure, from the sigmas that the adjustment assumes; adjusts; and asks `mgsgraph.Posterior`. Its answers are held
against the truth. Made by `scripts/montecarlo.py`; no seed is left out.

* *tie point*, *footprint*: {POINTS} of each, evenly spread. *position*, *pointing*: each image's pose at {LINES} lines;
  truth is the nominal orientation (+) the true corrections. *height difference*: {POINTS} pairs of points.
  *projection*: where {PIXELS} points fall in an image (without the noise of a measure). *new place*: {NEW} places that
  were not in the adjustment, measured afterwards with noise of their own and intersected. d: dimension.
* *by lot*: one item of each kind and seed, drawn by lot: seeds are independent, so the number with the truth inside its
  ellipsoid is binomial. Limits hold {1 - CHANCE:.0%}.
* *all*: mean share, in %, of all items with the truth inside. Items of a seed share its orientation; the limits follow
  from the scatter between seeds (Student's {1 - CHANCE:.0%} quantile): the more sensitive figure.
* *NEES*: mean of error' C^-1 error per dimension, 1 if C is right: of the items drawn by lot (limits: chi-square), and
  of all (limits: scatter between seeds).
* *bias*: mean error in sigmas with its standard error, of the component that has most (east, north, up; along, across,
  radial; roll, pitch, yaw; line, sample). Limit: {1 - CHANCE:.0%} for all components together.
* A value outside its limits is set in **bold**. Of the {CHECKS} checks of a row, {CHANCE:.0%} fall outside by chance
  alone, and they come in company: the checks of a row look at the same draws, and so do the rows of a case. So a case
  is judged by its worst figure (coverage and NEES of all items, NEES by lot, bias of each component), in standard
  errors, against a limit that holds {1 - CHANCE:.0%} for all of them together.
* *astray*: seeds with an item whose error has a chance below {ASTRAY:g}. They are counted in everywhere.
"""
_DIMENSION = 3
"""Of the kinds whose NEES the histogram shows."""
_MOST = 20.0
"""NEES at which the histogram ends; what lies beyond is in its last bin."""
_MARKERS = "osD^vPX*<"
TITLES = {
    "block": f"Block: a strip of {BLOCK.images} images, {BLOCK.ties} ties with each, shots along the nadir ones",
    **{name: f"{name.capitalize()}, ties and footprints, no terrain model" for name in ("eos", "gusev", "isidis")},
    "eos, half priors": "Eos again, orientation drawn from half the a-priori sigmas, and adjusted with these",
    **{f"{name}, terrain": f"{name.capitalize()}, tie points on the terrain model as well"
       for name in ("eos", "gusev", "isidis")},
    "block, planted": "Block, planted fault: image places and ranges stated 10 % better than they are",
}  # fmt: skip


def page(drawn: Mapping[str, Sequence[Drawn]]) -> str:
    """The whole page."""
    found = {case: [judged(case, kind, draws) for kind in KINDS] for case, draws in drawn.items()}
    seeds = [one.order.seed for draws in drawn.values() for one in draws]
    parts = [
        HEAD, f"Seeds {min(seeds)} to {max(seeds)}.\n", *summary(found, drawn), "",
        "![coverage, NEES and bias](montecarlo.png)", "", reading(found),
    ]  # fmt: skip
    for case, rows in found.items():
        parts += [f"## {TITLES[case]}", "", *case_table(rows), ""]
    return "\n".join([*parts, made_with(), ""])


def summary(found: Mapping[str, Sequence[Judged]], drawn: Mapping[str, Sequence[Drawn]]) -> list[str]:
    """One line for each case."""
    rows = []
    for case, kinds in found.items():
        count, outside = CHECKS * len(kinds), sum(len(one.outside) for one in kinds)
        shares = [sum(one.share[k] for one in kinds) / len(kinds) for k in range(len(LEVELS))]
        coverage = ", ".join(f"{100.0 * share:.1f}" for share in shares)
        away = sum(not one.converged for one in drawn[case])
        lot = sum(not low <= n <= high for one in kinds for n, (low, high) in zip(one.inside, one.limits, strict=True))
        rows.append((
            case, str(len(drawn[case])), str(away), str(sum(map(astray, drawn[case]))), coverage,
            f"{lot} of {len(LEVELS) * len(kinds)}",
            f"{outside} of {count}", f"{CHANCE * count:.1f}",
            f"{max(one.strain for one in kinds):.1f} ({breaking_strain(len(drawn[case])):.1f})", verdict(case, kinds),
        ))  # fmt: skip
    levels = ", ".join(f"{level:.0%}" for level in LEVELS)
    return table(
        ("case", "N", "not converged", "astray", f"inside {levels}: mean of kinds, %", "binomial limits broken",
         "all checks outside", "by chance", "worst, in standard errors (limit)", "verdict"), rows,
    )  # fmt: skip


def verdict(case: str, kinds: Sequence[Judged]) -> str:
    """Sentence for a case, by the limit for all its checks together."""
    sound = max(one.strain for one in kinds) <= breaking_strain(kinds[0].seeds)
    if CASES[case].stated != 1.0:
        return "The planted fault is not seen." if sound else "The planted fault is seen."
    return "The posterior is honest." if sound else "The posterior is not honest here; see below."


def case_table(rows: Sequence[Judged]) -> list[str]:
    """One line for each kind."""
    seeds = rows[0].seeds
    by_lot = [f"{level:.0%} by lot ({'..'.join(map(str, binomial_limits(seeds, level)))})" for level in LEVELS]
    head = ("kind", "d", "items", *by_lot, *(f"{level:.0%} all" for level in LEVELS), "NEES by lot", "NEES all", "bias")
    return table((*head, "verdict"), [cells(row) for row in rows])


def cells(row: Judged) -> tuple[str, ...]:
    """One line of a table."""
    by_lot = [
        bold(str(count), not low <= count <= high) for count, (low, high) in zip(row.inside, row.limits, strict=True)
    ]
    everything = [
        bold(f"{100.0 * share:.1f}", abs(share - level) > band) + f" ({level:.0%} ± {100.0 * band:.1f})"
        for share, level, band in zip(row.share, LEVELS, row.band, strict=True)
    ]
    mean, low, high = row.lot_nees
    worst, most = row.worst, row.bias_limit * row.error[row.worst]
    return (
        row.kind, str(len(row.components)), str(row.items), *by_lot, *everything,
        bold(f"{mean:.2f}", not low <= mean <= high) + f" ({low:.2f}..{high:.2f})",
        bold(f"{row.nees:.3f}", abs(row.nees - 1.0) > row.nees_band) + f" (1 ± {row.nees_band:.3f})",
        f"{row.components[worst]} " + bold(f"{row.bias[worst]:+.3f}", abs(row.bias[worst]) > most)
        + f" ± {row.error[worst]:.3f} (limit {most:.3f})",
        row.sentence,
    )  # fmt: skip


def bold(text: str, outside: bool) -> str:
    """Outside its limits."""
    return f"**{text}**" if outside else text


def reading(found: Mapping[str, Sequence[Judged]]) -> str:
    """What to make of it, of those cases that are there."""
    return "\n".join(text for cases, text in READING if cases & found.keys())


READING = (
    (
        frozenset(CASES),
        """## Reading it

*What is drawn.* Only what has a stated sigma, and from that sigma; tie points, which have none, stay where the
nominal rays meet. The papers' weighting is left out: its back-projected image rows are no measures (see
[nees.md](nees.md)). A new place lies half-way between two tie points and takes part in no surface row.
Projections and new places are asked for where points were measured within their images, ten pixels from the edges: by
the orientation drawn, others lie beside them, at Eos above all.
""",
    ),
    (
        frozenset({"eos", "eos, half priors"}),
        """*Eos.* [nees.md](nees.md) has its orientation out of band: NEES 1.33 of all 36 coefficients jointly. Taken
apart along the covariance's own axes (60 seeds, once), the excess sits in two directions of the 36, those that are
known to 0.0003 and 0.0007 of their a-priori sigma: 8.8 and 5.5 there, 1.0 in the mean of the others. Over 10'
of prior the cost is not quite a parabola, and such directions see its curvature; with half the priors they come
down to 1.7 and 1.3, and the joint figure to 1.02. No pose, point or pixel asked for here rests on these two
alone, which is why they are well covered; a joint statement on all coefficients of Eos at once is not.
""",
    ),
    (
        frozenset(name for name, case in CASES.items() if case.surface),
        """*Terrain models.* Tie points lie on the cubic B-spline of a model's posts: one continuous function,
whatever the tie's place. Its relief can still fit nearly as well in several places; a draw that ends in a wrong one is
*astray*. Truth is drawn here on that very spline, with independent heights of the ties; what a model's posts are off
together, and what they leave out of the ground, [cells.md](cells.md) and [world.md](world.md) have.
""",
    ),
    (
        frozenset(name for name, case in CASES.items() if case.stated != 1.0),
        """*Planted fault.* Were image places and ranges stated with sigmas 10% too small, this is what the page would
look like. One item by lot hardly tells at N = 200; the mean of all items does: tie points, height differences and
projections, which rest on measures, are far outside; poses, which rest on their priors as well, are not.
""",
    ),
)


# --- the figure


def figure(drawn: Mapping[str, Sequence[Drawn]]) -> Any:
    """Three panels."""
    from matplotlib.figure import Figure

    found = {case: [judged(case, kind, draws) for kind in KINDS] for case, draws in drawn.items()}
    whole = Figure(figsize=(15.0, 7.2), layout="constrained")
    rows: list[Any] = [[f"{level:.0%}", "nees", "bias"] for level in reversed(LEVELS)]
    panels = whole.subplot_mosaic(rows, width_ratios=(1.25, 1.0, 1.25))
    for k, level in enumerate(LEVELS):
        draw_coverage(panels[f"{level:.0%}"], found, k)
    draw_histogram(panels["nees"], found)
    draw_bias(panels["bias"], found)
    top, bottom = (panels[f"{level:.0%}"] for level in (LEVELS[-1], LEVELS[0]))
    top.set_title("coverage; grey: binomial limits, 99 %", fontsize=9)
    bottom.set_xlabel("question (one item of each seed, by lot)")
    bottom.set_xticks(range(len(KINDS)), KINDS, rotation=30, ha="right", fontsize=8)
    handles, labels = top.get_legend_handles_labels()
    whole.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    whole.suptitle(
        "An honest posterior has the truth in its ellipsoids as often as they say (left: grey limits), NEES like "
        "chi-square (middle), and no bias (right).", fontsize=10,
    )  # fmt: skip
    return whole


def style(case: str, number: int) -> dict[str, Any]:
    """Colour and marker of a case: hollow for what is not expected to be honest."""
    plain = CASES[case].stated == 1.0 and not CASES[case].surface
    colour = "k" if CASES[case].stated != 1.0 else f"C{number}"
    return {"color": colour, "marker": _MARKERS[number % len(_MARKERS)], "markerfacecolor": colour if plain else "none"}


def across(row: int, rows: int) -> float:
    """Where a case's mark stands beside the others of its kind."""
    return 0.7 * ((row + 0.5) / rows - 0.5)


def draw_coverage(axes: Any, found: Mapping[str, Sequence[Judged]], k: int) -> None:
    """Per cent of the seeds whose item by lot has the truth inside the ellipsoid of a level, by kind."""
    for seeds in {rows[0].seeds for rows in found.values()}:
        low, high = (100.0 * limit / seeds for limit in binomial_limits(seeds, LEVELS[k]))
        axes.axhspan(low, high, color="0.87", zorder=0)
    axes.axhline(100.0 * LEVELS[k], color="0.5", linewidth=0.8, zorder=0)
    for number, (case, rows) in enumerate(found.items()):
        at = np.arange(len(rows)) + across(number, len(found))
        percent = [100.0 * row.inside[k] / row.seeds for row in rows]
        axes.plot(at, percent, linestyle="", markersize=4.5, label=case, **style(case, number))
    axes.set_ylabel(f"truth inside the\n{LEVELS[k]:.0%} ellipsoid, % of seeds", fontsize=9)
    axes.set_xticks(range(len(KINDS)), [""] * len(KINDS))


def draw_histogram(axes: Any, found: Mapping[str, Sequence[Judged]]) -> None:
    """NEES of the items by lot of all three-dimensional kinds, and the density it should have."""
    bins = np.linspace(0.0, _MOST, 41)
    at = np.linspace(0.0, _MOST, 400)
    expected = chi2.pdf(at, _DIMENSION)
    axes.plot(at, expected, color="0.75", linewidth=4.0, label="chi-square, 3 degrees of freedom", zorder=0)
    for label, colour, cases in (
        ("without terrain models", "C0", [c for c in found if CASES[c].stated == 1.0 and not CASES[c].surface]),
        ("on terrain models", "C3", [c for c in found if CASES[c].stated == 1.0 and CASES[c].surface]),
        ("planted fault", "k", [c for c in found if CASES[c].stated != 1.0]),
    ):
        lots = [row.lot for case in cases for row in found[case] if len(row.components) == _DIMENSION]
        if lots:
            values = np.minimum(np.concatenate(lots), 0.999 * _MOST)
            axes.hist(
                values, bins, density=True, histtype="step", color=colour, linewidth=1.2,
                label=f"{label}: {values.size} items",
            )  # fmt: skip
    axes.set(xlabel="NEES of places, positions and pointings (last bin: 20 and more)", ylabel="density", yscale="log")
    axes.set(ylim=(1e-4, 0.5), xlim=(0.0, _MOST))
    axes.legend(fontsize=8)
    axes.set_title("NEES, one item of each kind and seed", fontsize=9)


def draw_bias(axes: Any, found: Mapping[str, Sequence[Judged]]) -> None:
    """Mean errors in sigmas of every component, with their standard errors."""
    names = [(kind, component) for kind, components in KINDS.items() for component in components]
    for number, (case, rows) in enumerate(found.items()):
        at = np.arange(len(names)) + across(number, len(found))
        mean, error = (np.concatenate([getattr(row, what) for row in rows]) for what in ("bias", "error"))
        axes.errorbar(mean, at, xerr=error, linestyle="", markersize=3, linewidth=0.7, **style(case, number))
    axes.axvline(0.0, color="0.5", linewidth=0.8, zorder=0)
    labels = [f"{kind}, {component}" for kind, component in names]
    axes.set_yticks(range(len(names)), labels, fontsize=7)
    axes.set(xlabel="mean error of all items, in sigmas; bars: its standard error", ylim=(len(names) - 0.4, -0.6))
    axes.set_title("bias", fontsize=9)
