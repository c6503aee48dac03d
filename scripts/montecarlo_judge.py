"""Coverage, NEES and bias of one kind of question over many seeds, and what a consistent posterior would give.

Items of one seed share its orientation and are not independent; seeds are. So coverage is judged twice: by one item of
each seed, drawn by lot, whose number inside is binomial; and by all items, whose scatter from seed to seed says how
well their mean is known. The second sees smaller faults.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom
from study import Blocks, Draw, cases, chi_square_band, names_of, student, table

from mgsgraph.analysis.estimates import chi_square_radius
from mgsgraph.geometry.records import Array, Index

_PLACE, _FLIGHT, _TURN = ("east", "north", "up"), ("along", "across", "radial"), ("roll", "pitch", "yaw")
KINDS: dict[str, tuple[str, ...]] = {
    "tie point": _PLACE,
    "footprint": _PLACE,
    "position": _FLIGHT,
    "pointing": _TURN,
    "height difference": ("height",),
    "projection": ("line", "sample"),
    "new place": _PLACE,
}
"""Kinds of queries to the posterior, and the components of their errors."""
LEVELS = (0.68, 0.95, 0.99)
"""Probabilities of the ellipsoids."""
CHANCE = 0.01
"""That a consistent posterior is outside any one limit."""
ASTRAY = 1e-8
"""Chance of an error that can only come from another minimum of the cost, or from a fault."""
CHECKS = 2 * len(LEVELS) + 3
"""Per kind: coverage by lot and of all at each level, NEES by lot and of all, bias."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One kind of question in one case."""

    case: str
    kind: str
    seeds: int
    items: int
    """In one seed."""
    inside: Index
    """(levels,) number of seeds whose item drawn by lot has the truth inside its ellipsoid."""
    limits: Index
    """(levels, 2) least and most, binomial."""
    share: Array
    """(levels,) mean share of all items with the truth inside."""
    band: Array
    """(levels,) half-width of the limits about the level: what the scatter from seed to seed allows."""
    lot: Array
    """(seeds,) NEES of the items drawn by lot, chi-square of the kind's dimension."""
    nees: float
    """Mean over all items, per dimension."""
    nees_band: float
    """Half-width of its limits about 1."""
    bias: Array
    """(d,) mean error in sigmas."""
    error: Array
    """(d,) its standard error."""

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components."""
        return KINDS[self.kind]

    @property
    def lot_nees(self) -> tuple[float, float, float]:
        """Mean NEES per dimension of the items drawn by lot, and its chi-square limits."""
        low, high = chi_square_band(self.seeds * len(self.components))
        return float(self.lot.mean()) / len(self.components), low, high

    @property
    def bias_limit(self) -> float:
        """Standard errors that the worst component's bias may have."""
        return student(CHANCE / len(self.components), self.seeds - 1)

    @property
    def worst(self) -> int:
        """Component whose bias is largest in standard errors."""
        return int(np.argmax(np.abs(self.bias) / self.error))

    @property
    def outside(self) -> list[str]:
        """Which checks fail, in words."""
        failed = []
        for k, level in enumerate(LEVELS):
            low, high = self.limits[k]
            if not low <= self.inside[k] <= high:
                failed.append(f"{level:.0%} ellipsoid too {'small' if self.inside[k] < low else 'large'} (by lot)")
            if abs(self.share[k] - level) > self.band[k]:
                failed.append(f"{level:.0%} ellipsoid too {'small' if self.share[k] < level else 'large'} (all items)")
        mean, low, high = self.lot_nees
        if not low <= mean <= high:
            failed.append(f"sigmas too {'small' if mean > high else 'large'} (NEES by lot)")
        if abs(self.nees - 1.0) > self.nees_band:
            failed.append(f"sigmas too {'small' if self.nees > 1.0 else 'large'} (NEES of all items)")
        if abs(self.bias[self.worst]) > self.bias_limit * self.error[self.worst]:
            failed.append(f"biased ({self.components[self.worst]})")
        return failed

    @property
    def strain(self) -> float:
        """How far coverage and NEES of all items, NEES by lot, and bias are off at most, in standard errors."""
        ratios = [*(np.abs(self.share - LEVELS) / self.band), abs(self.nees - 1.0) / self.nees_band]
        of_bias = float(np.max(np.abs(self.bias) / self.error))
        return max(float(max(ratios)) * student(CHANCE, self.seeds - 1), of_bias, self._strain_of_lot)

    @property
    def _strain_of_lot(self) -> float:
        """Of the NEES by lot, chi-square (Wilson & Hilferty 1931); few seeds far off widen the limits of all others."""
        spread = 2.0 / (9.0 * self.seeds * len(self.components))
        return abs(math.cbrt(self.lot_nees[0]) - 1.0 + spread) / math.sqrt(spread)

    @property
    def sentence(self) -> str:
        """The verdict."""
        return f"Outside: {'; '.join(self.outside)}." if self.outside else "Consistent, all within limits."


def astray(draw: Draw) -> bool:
    """Whether some item's error has a chance below ASTRAY: hardly ever in 200 seeds."""
    return any(
        bool(np.any(np.array(squares) > chi_square_radius(1.0 - ASTRAY, len(KINDS[kind])) ** 2))
        for kind, squares in draw["squares"].items()
    )


def breaking_strain(seeds: int) -> float:
    """Standard errors that a check of a case exceeds by chance only with the probability CHANCE for all checks.

    Checks of a row are correlated: only this limit separates a fault from an unlucky set of draws.
    """
    of_bias = sum(len(components) for components in KINDS.values())
    return student(CHANCE / (len(KINDS) * (len(LEVELS) + 2) + of_bias), seeds - 1)


def judged(case: str, kind: str, draws: Sequence[Draw]) -> Judged:
    """One kind of question over all draws, two or more, of one case."""
    seeds, dimension = len(draws), len(KINDS[kind])
    squares = np.array([draw["squares"][kind] for draw in draws])
    lots = [np.random.default_rng([draw["seed"], 1]).integers(squares.shape[1]) for draw in draws]
    lot = squares[np.arange(seeds), lots]
    limit = np.array([chi_square_radius(level, dimension) ** 2 for level in LEVELS])
    shares = np.mean(squares[:, :, None] < limit, axis=1)
    levels = np.array(LEVELS)
    errors = np.array([np.mean(draw["errors"][kind], axis=0) for draw in draws])
    # few seeds may all have all items inside: the scatter is never below that of items which share nothing
    scatter = np.maximum(shares.std(axis=0, ddof=1), np.sqrt(levels * (1.0 - levels) / squares.shape[1]))
    wide = student(CHANCE, seeds - 1) / math.sqrt(seeds)
    mean = squares.mean(axis=1) / dimension
    return Judged(
        case=case,
        kind=kind,
        seeds=seeds,
        items=squares.shape[1],
        inside=np.count_nonzero(lot[:, None] < limit, axis=0),
        limits=np.array([binomial_limits(seeds, level) for level in LEVELS]),
        share=shares.mean(axis=0),
        band=wide * scatter,
        lot=lot,
        nees=float(mean.mean()),
        nees_band=wide * float(mean.std(ddof=1)),
        bias=errors.mean(axis=0),
        error=errors.std(axis=0, ddof=1) / math.sqrt(seeds),
    )


def binomial_limits(seeds: int, level: float, chance: float = CHANCE) -> tuple[int, int]:
    """Least and most successes of so many trials: beyond either lies no more than half the chance."""
    return int(binom.ppf(0.5 * chance, seeds, level)), int(binom.isf(0.5 * chance, seeds, level))


# --- tables


def judge(draws: list[Draw]) -> Blocks:
    """Made parts of the page."""
    by_case = {case: [judged(case, kind, cases(draws, case)) for kind in KINDS] for case in names_of(draws)}
    heads = {case: f"### {case.capitalize()}" for case in by_case}
    lines = [line for case, rows in by_case.items() for line in (heads[case], "", *case_table(rows), "")]
    return {"summary": summary(by_case, draws), "cases": lines}


def summary(by_case: Mapping[str, Sequence[Judged]], draws: Sequence[Draw]) -> list[str]:
    """One line for each case."""
    rows = []
    for case, kinds in by_case.items():
        count, outside = CHECKS * len(kinds), sum(len(kind.outside) for kind in kinds)
        shares = [sum(kind.share[k] for kind in kinds) / len(kinds) for k in range(len(LEVELS))]
        coverage = ", ".join(f"{100.0 * share:.1f}" for share in shares)
        of_case = cases(draws, case)
        away = sum(not draw["converged"] for draw in of_case)
        broken = sum(not low <= n <= high for k in kinds for n, (low, high) in zip(k.inside, k.limits, strict=True))
        rows.append((
            case, str(len(of_case)), str(away), str(sum(map(astray, of_case))), coverage,
            f"{broken} of {len(LEVELS) * len(kinds)}",
            f"{outside} of {count}", f"{CHANCE * count:.1f}",
            f"{max(kind.strain for kind in kinds):.1f} ({breaking_strain(len(of_case)):.1f})", verdict(case, kinds),
        ))  # fmt: skip
    levels = ", ".join(f"{level:.0%}" for level in LEVELS)
    return table(
        ("case", "N", "not converged", "astray", f"inside {levels}: mean of kinds, %", "binomial limits broken",
         "all checks outside", "by chance", "worst, in standard errors (limit)", "verdict"), rows,
    )  # fmt: skip


def verdict(case: str, kinds: Sequence[Judged]) -> str:
    """Sentence for a case, by the joint limit of all its checks."""
    sound = max(kind.strain for kind in kinds) <= breaking_strain(kinds[0].seeds)
    if case.endswith("planted"):
        return "The planted fault is not seen." if sound else "The planted fault is seen."
    return "The posterior is consistent." if sound else "The posterior is inconsistent here; see below."


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
