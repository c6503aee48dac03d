"""The figure of the Monte-Carlo proof: coverage, NEES and bias."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from montecarlo_draw import CASES, KINDS, Drawn
from montecarlo_judge import LEVELS, Judged, binomial_limits, judged

from mgsgraph.geometry.records import Array

_DIMENSION = 3
"""Of the kinds whose NEES the histogram shows."""
_MOST = 20.0
"""NEES at which the histogram ends; what lies beyond is in its last bin."""
_MARKERS = "osD^vPX*<"


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
    axes.plot(at, density(at), color="0.75", linewidth=4.0, label="chi-square, 3 degrees of freedom", zorder=0)
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


def density(squares: Array) -> Array:
    """Chi-square of three degrees of freedom."""
    return np.asarray(np.sqrt(squares / (2.0 * math.pi)) * np.exp(-0.5 * squares))


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
