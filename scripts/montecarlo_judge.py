"""Coverage, NEES and bias of one kind of question over many seeds, and what they would be if the posterior were honest.

Items of one seed share its orientation and are not independent; seeds are. So coverage is judged twice: by one item of
each seed, drawn by lot, whose number inside is binomial; and by all items, whose scatter from seed to seed says how
well their mean is known. The second sees smaller faults.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from montecarlo_draw import KINDS, Drawn
from scipy.stats import binom
from study import chi_square_band, student

from mgsgraph.analysis.estimates import chi_square_radius
from mgsgraph.geometry.records import Array, Index

LEVELS = (0.68, 0.95, 0.99)
"""Probabilities of the ellipsoids."""
CHANCE = 0.01
"""Of an honest posterior outside any one limit."""
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
        found = []
        for k, level in enumerate(LEVELS):
            low, high = self.limits[k]
            if not low <= self.inside[k] <= high:
                found.append(f"{level:.0%} ellipsoid too {'small' if self.inside[k] < low else 'large'} (by lot)")
            if abs(self.share[k] - level) > self.band[k]:
                found.append(f"{level:.0%} ellipsoid too {'small' if self.share[k] < level else 'large'} (all items)")
        mean, low, high = self.lot_nees
        if not low <= mean <= high:
            found.append(f"sigmas too {'small' if mean > high else 'large'} (NEES by lot)")
        if abs(self.nees - 1.0) > self.nees_band:
            found.append(f"sigmas too {'small' if self.nees > 1.0 else 'large'} (NEES of all items)")
        if abs(self.bias[self.worst]) > self.bias_limit * self.error[self.worst]:
            found.append(f"biased ({self.components[self.worst]})")
        return found

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
        return f"Outside: {'; '.join(self.outside)}." if self.outside else "Honest, all within limits."


def astray(drawn: Drawn) -> bool:
    """Whether some item's error has a chance below ASTRAY: of 200 honest seeds hardly ever one."""
    return any(
        bool(np.any(squares > chi_square_radius(1.0 - ASTRAY, len(KINDS[kind])) ** 2))
        for kind, squares in drawn.squares.items()
    )


def breaking_strain(seeds: int) -> float:
    """Standard errors that no check of a whole case goes beyond by chance: CHANCE for all of them together.

    The checks of a row that break a limit come in company: only this tells a fault from an unlucky set of draws.
    """
    of_bias = sum(len(components) for components in KINDS.values())
    return student(CHANCE / (len(KINDS) * (len(LEVELS) + 2) + of_bias), seeds - 1)


def judged(case: str, kind: str, draws: Sequence[Drawn]) -> Judged:
    """One kind of question over all draws, two or more, of one case."""
    seeds, dimension = len(draws), len(KINDS[kind])
    squares = np.array([one.squares[kind] for one in draws])
    lots = [np.random.default_rng([one.order.seed, 1]).integers(squares.shape[1]) for one in draws]
    lot = squares[np.arange(seeds), lots]
    limit = np.array([chi_square_radius(level, dimension) ** 2 for level in LEVELS])
    shares = np.mean(squares[:, :, None] < limit, axis=1)
    levels = np.array(LEVELS)
    errors = np.array([one.errors[kind].mean(axis=0) for one in draws])
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
