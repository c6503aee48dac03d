"""What sigma0 says of the fit, of all observations and group by group: a table and sentences with what to do."""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from mgsgraph.adjustment.fit import ABSURD
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import grouping as groups
from mgsgraph.analysis.residual_tests import ODDS, GroupFit, group_fits
from mgsgraph.files.output.table import Column, Table
from mgsgraph.results.section import Section
from mgsgraph.text import listed

_KEYS = {
    "tie image points": "sigma_factor in [ties]",
    "laser image points": "image_sigma_px",
    "control image points": "those in the file of ground control",
    groups.RANGES: "range_sigma_m",
    groups.GROUND_PRIORS: "ground_sigma_m, or those of ground control",
    groups.HEIGHTS: "vertical_sigma_m in [terrain]",
    groups.STEREO_HEIGHTS: "sigma_m in [[altimetry]] or vertical_sigma_m in [terrain]",
    groups.POSITION: "position_sigma_m in [orientation]",
    groups.POINTING: "angle_sigma_mrad in [orientation]",
    groups.SHIFTS: "shift_sigma_m",
}
"""Where a case states the sigmas of a group."""


def group_fits_table(fits: Sequence[GroupFit] | None) -> Table:
    """One row per group of observations: how it fits its stated sigmas; none where nobody has looked."""
    shown = fits or ()
    numbers = np.array([(one.redundancy, one.sigma0, one.low, one.high) for one in shown]).reshape(-1, 4)
    return Table("fits", "Fit of each group of observations", (
        Column("group", [one.name for one in shown], page="s", text="<38"),
        Column("rows", np.array([one.rows for one in shown], dtype=np.int64), page="s", text=">7"),
        Column("redundancy", numbers[:, 0], meaning="sum of the rows' redundancy numbers", page=".1f", text=">10.1f"),
        Column("sigma0", numbers[:, 1], meaning="root of squares over redundancy", page=".3f", text=">8.3f"),
        Column("by_chance_{}", numbers[:, 2:], meaning="within which it is expected; none of groups that little checks",
               parts=("low", "high"), head="by chance, {}", page=".3f", label="by chance", text=">7.3f", gap=2),
        Column("state", [_state(one) for one in shown], page="s", label="", text="<", gap=2),
    ), "Squares of whitened residuals over redundancy; 1 where sigmas are as stated.")  # fmt: skip


def _state(one: GroupFit) -> str:
    if not one.judged:
        return "not judged"
    return "WORSE than stated" if one.worse else "better than stated" if one.better else ""


def fits_section(solution: Solution) -> Section:
    """What sigma0 says, and each group's; numbers are None where nobody has looked."""
    fits = group_fits(solution)
    table = group_fits_table(fits)
    return Section("fits", sentences=weight_unit(solution), tables=[table],
                   numbers=None if fits is None else table.records())  # fmt: skip


def weight_unit(solution: Solution) -> list[str]:
    """What sigma0 says of the stated sigmas, and which groups of observations contradict it."""
    sigma0, freedom, fits = solution.sigma0, solution.fit.degrees_of_freedom, group_fits(solution) or ()
    if math.isnan(sigma0):
        why = "residuals are not finite" if freedom > 0 else "nothing checks the observations"
        return [f"sigma0 is not defined, with {freedom} degrees of freedom: {why}."]
    head = f"sigma0 is {sigma0:.3g} with {freedom} degrees of freedom"
    worse, better = [one for one in fits if one.worse], [one for one in fits if one.better]
    words = _words(worse, better) if worse or better else ""
    mixed = f"{head}, but it is a mean of observations that do not fit alike: {words}" if words else ""
    if solution.converged and solution.strained:
        return [
            f"{mixed or head}. No sigma holds while orientations are far beyond their a-priori sigmas: look at the "
            "inputs first."
        ]
    if worse and sigma0 <= ABSURD and (better or len(worse) < sum(one.judged for one in fits)):
        return [f"{mixed}.", _advice(worse)]
    if better and len(better) < sum(one.judged for one in fits):
        return [
            f"{mixed}. All sigmas are quoted for sigma0 = 1 and are cautious where they rest on these; don't multiply "
            "them by sigma0. `analyze --components` says by what factors stated sigmas are too large."
        ]
    return [_of_all(head, sigma0, freedom)]


def _of_all(head: str, sigma0: float, freedom: int) -> str:
    # the chi-square law: sigma0 scatters by 1 / sqrt(2 f) about 1 when the stated sigmas are right
    if abs(sigma0 - 1.0) <= NormalDist().inv_cdf(1.0 - 0.5 * ODDS) / math.sqrt(2.0 * freedom):
        return f"{head}: the observations fit as well as their stated sigmas say, and the quoted sigmas hold."
    if sigma0 < 1.0:
        better = f"{times(1.0 / sigma0)} times better than" if sigma0 > 0.0 else "without any error, against"
        return (
            f"{head}: the observations fit {better} their stated sigmas. All sigmas are quoted for sigma0 = 1 and "
            f"are cautious; multiply them by {sigma0:.3g} if you trust the fit."
        )
    return (
        f"{head}: the observations fit {times(sigma0)} times worse than their stated sigmas. All sigmas are quoted "
        "for sigma0 = 1 and are too small by that factor, unless blunders are to blame: look at the largest residuals."
    )


def _words(worse: Sequence[GroupFit], better: Sequence[GroupFit]) -> str:
    def one(fit: GroupFit) -> str:
        factor = times(fit.sigma0) if fit.worse else times(1.0 / fit.sigma0) if fit.sigma0 > 0.0 else "infinitely many"
        band = f"sigma0 {fit.sigma0:.3g}, by chance {fit.low:.3g} to {fit.high:.3g}"
        return f"{fit.name} fit {factor} times {'WORSE' if fit.worse else 'better'} than stated ({band})"

    return listed([one(fit) for fit in sorted(worse, key=lambda fit: -fit.sigma0) + list(better)])


def _advice(worse: Sequence[GroupFit]) -> str:
    names = list(dict.fromkeys(one.name.split(",")[0] for one in worse))
    steps = []
    for name in names:
        mine = [one for one in worse if one.name.split(",")[0] == name]
        factor = math.sqrt(sum(one.squares for one in mine) / sum(one.redundancy for one in mine))
        key = f" ({_KEYS[name]})" if name in _KEYS else ""
        steps.append(f"the stated sigmas of {name}{key} by {times(factor)}")
    return (
        f"Don't multiply the quoted sigmas by sigma0: they are too small wherever they rest on {listed(names)}. "
        f"Look for blunders there first (--reject 4); if there are none, multiply {listed(steps)} and adjust again. "
        "`analyze --components --iterate` finds the factors of all groups."
    )


def times(factor: float) -> str:
    """A factor over one in two digits, near one in three: "1 times better" says nothing."""
    return f"{factor:.2g}" if factor >= 2.0 else f"{factor:.3g}"
