"""Variance components: by what factor the sigmas of each group of rows are wrong, and how sure
one can be of it.

print(mgsgraph.components(solution))
found = iterated_components(network, settings)  # scaled and adjusted again, until all factors are one

A pass solves Helmert's equations S s = q (see `helmert`) for the variance factors s. They are unbiased, and repeated
until s = 1 they give what Foerstner's simpler v'v / r leads to as well, in fewer passes; for normal errors that is the
restricted maximum likelihood (Foerstner 1979, 1985). There the covariance of the factors is 2 S^-1.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.grouping import (
    CORRELATED,
    Grouping,
    Redundancy,
    group_redundancy,
    group_rows,
    most_correlated,
    nearest,
    scaled,
)
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, sigmas_of
from mgsgraph.network import Network
from mgsgraph.record import Record

LEAST = 1.0
"""Redundancy, and degrees of freedom of the estimate, below which a group can't be judged."""
SURE = 0.99
"""Probability that a verdict goes by: sigmas are called wrong when this interval leaves out 1."""
_VAGUE = 0.15
"""Relative sigma of a factor from which on a verdict says that little can be said."""
_FAR = 0.25
"""Logarithm of a factor from which on a single pass is but a first look."""
_STEP = 4.0
"""Largest factor of a sigma in one pass."""
_FLOOR, _CEILING = 0.02, 500.0
"""Factors in total at which a group is held: its sigma can't be distinguished from zero, or from infinity."""
_UNDAMPED = 8
"""Passes after which only half the step is taken (in logarithms), should they go to and fro."""


class Judgement(StrEnum):
    """Whether a group has a factor, and if not, why."""

    JUDGED = "judged"
    FEW = "too little redundancy"
    """Redundancy below `LEAST`."""
    INSEPARABLE = "inseparable from another group"
    """The factor of another group takes up what its own has."""
    ENTANGLED = "known together with another group's only"
    """Vague, and correlated with another factor by more than `CORRELATED`: the residuals fit both, and what is the
    one's may have been booked under the other; a sigma at the estimate doesn't hold far from it."""
    LOST = "runs away to where nothing can be said"
    """Judged with the stated sigmas, not with those that were found; kept as stated. Corrections that fit priors of any
    small sigma end like this: the smaller it is, the less redundancy the priors have."""
    ZERO = "goes to zero"
    """Residuals so small that others' sigmas explain them; held."""
    UNBOUNDED = "goes to infinity"
    """Factor held at its upper limit."""


@dataclass(frozen=True, slots=True)
class Component(Record):
    """What the residuals say of the sigmas of one group."""

    name: str
    """Name of the group."""
    judgement: Judgement
    """Whether what follows means anything."""
    rows: int
    """Number of rows, priors among them."""
    redundancy: float
    """Sum of their redundancy numbers."""
    sum_of_squares: float
    """Sum of their squared whitened residuals."""
    factor: float
    """By which the stated sigmas have to be multiplied; NaN where it can't be judged, the factor held otherwise."""
    degrees: float
    """Degrees of freedom of its square, chi-square with which it is distributed like, nearly; NaN where not judged."""
    beside: str = ""
    """The group that it is most correlated with."""
    correlation: float = math.nan
    """Of the two groups' squared factors."""
    negative: bool = False
    """Whether Helmert's equations gave its square as negative: the factor is Foerstner's in its place."""

    @property
    def sigma(self) -> float:
        """Standard deviation of `factor`."""
        return self.factor / math.sqrt(2.0 * self.degrees) if self.degrees > 0.0 else math.nan

    @property
    def foerstner(self) -> float:
        """Square root of the sum of squares over redundancy: the factor if all other groups' sigmas are right."""
        return math.sqrt(self.sum_of_squares / self.redundancy) if self.redundancy > 0.0 else math.nan

    def interval(self, probability: float = SURE) -> tuple[float, float]:
        """Within which the factor lies, by the chi-square distribution; NaN where it can't be judged."""
        from scipy.special import gammaincinv  # slow to import

        if self.judgement is not Judgement.JUDGED:
            return math.nan, math.nan
        sides = [0.5 - 0.5 * probability, 0.5 + 0.5 * probability]
        low, high = 2.0 * gammaincinv(0.5 * self.degrees, sides)
        return self.factor * math.sqrt(self.degrees / high), self.factor * math.sqrt(self.degrees / low)

    @property
    def consistent(self) -> bool | None:
        """Whether the sigmas may be right; None where it can't be judged."""
        if self.judgement is not Judgement.JUDGED:
            return None
        low, high = self.interval()
        return low <= 1.0 <= high

    @property
    def sentence(self) -> str:
        """Verdict on the sigmas of the group, in one sentence."""
        text = _SENTENCES[self.judgement].format(one=self) if self.judgement in _SENTENCES else _judged(self)
        return f"{self.name}: {text}"


def _judged(component: Component) -> str:
    notes = list[str]()
    if abs(component.correlation) > CORRELATED:
        notes.append(f"correlated with {component.beside}, correlation {component.correlation:.2f}")
    if component.negative:
        notes.insert(0, "Foerstner's estimate, as if all others were right: Helmert's is negative")
    return "; ".join([_plainly(component), *notes])


def _plainly(component: Component) -> str:
    low, high = component.interval()
    if component.consistent and component.sigma > _VAGUE * component.factor:
        return (
            f"no inconsistency found, but the test is weak (factor {component.factor:.2g}, "
            f"{low:.2g} to {high:.2g} with {100 * SURE:.0f}%)"
        )
    if component.consistent:
        return f"consistent (factor {_with_sigma(component.factor, component.sigma)})"
    if component.factor > 1.0:
        return f"too optimistic, sigmas too small by a factor of {_with_sigma(component.factor, component.sigma)}"
    inverse = 1.0 / component.factor
    return f"too pessimistic, sigmas too large by a factor of {_with_sigma(inverse, component.sigma * inverse**2)}"


_SENTENCES = {
    Judgement.FEW: "can't be judged ({one.redundancy:.1g} redundancy)",
    Judgement.INSEPARABLE: "inseparable from {one.beside} (correlation {one.correlation:.2f}); "
    "{one.redundancy:.2g} redundancy",
    Judgement.ENTANGLED: "factor {one.factor:.2g}, confounded with {one.beside} (correlation {one.correlation:.2f})",
    Judgement.LOST: "can't be judged: the estimate diverges; kept as stated",
    Judgement.ZERO: "residuals too small for any sigma, the errors of other groups explain them; held at factor "
    "{one.factor:.2g}",
    Judgement.UNBOUNDED: "residuals too large for any sigma; held at factor {one.factor:.3g}",
}


def _with_sigma(value: float, sigma: float) -> str:
    """1.03 +- 0.08, the sigma with two digits."""
    digits = max(0, 1 - math.floor(math.log10(sigma))) if 0.0 < sigma < 10.0 else 0
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


@dataclass(frozen=True, slots=True, eq=False)
class Components(Record):
    """Variance components of all groups."""

    groups: tuple[Component, ...]
    """g of them."""
    correlation: Array
    """(g, g) of the squared factors; NaN for groups that aren't judged."""
    helmert: Array
    """(g, g) Helmert's matrix; its rows add up to the redundancies."""
    exact: bool
    """False where one term of it is an estimate with random signs, as for very many images."""
    rough: bool = False
    """True of a single pass that found factors far from one: they and their sigmas are a first look."""

    def __getitem__(self, name: str) -> Component:
        """One group by its name."""
        for component in self.groups:
            if component.name == name:
                return component
        names = ", ".join(component.name for component in self.groups)
        raise InputError(f"variance component {name!r}", "no such group", f"one of {names}")

    @property
    def factors(self) -> Array:
        """(g,) factors, 1 where there is none."""
        values = np.array([component.factor for component in self.groups])
        return np.where(np.isfinite(values), values, 1.0)

    @property
    def sentences(self) -> list[str]:
        """One for each group, and one on how it was done."""
        how = "exact" if self.exact else "one term estimated with random signs, for there are many unknowns"
        lines = [*(component.sentence for component in self.groups), f"Helmert's matrix: {how}."]
        if self.rough:
            lines.append("First estimates (some factors are far from 1): --iterate repeats them until they converge.")
        return lines


@dataclass(frozen=True, slots=True, eq=False)
class IteratedComponents(Record):
    """A network whose sigmas agree with its residuals."""

    network: Network
    """The network with the new sigmas."""
    solution: Solution
    """Adjustment with the new sigmas."""
    components: Components
    """Factors in total, new sigmas over stated ones."""
    converged: bool
    """Whether the last pass found all factors to be one."""
    history: Array
    """(passes, g) factors in total with which each pass was adjusted."""

    @property
    def sentences(self) -> list[str]:
        """Verdicts of all groups, and whether the factors converged."""
        passes = len(self.history)
        end = f"Converged after {passes} passes." if self.converged else f"NOT CONVERGED after {passes} passes."
        return [*self.components.sentences, end]


def components(solution: Solution | Linearised, grouping: Grouping | None = None) -> Components:
    """Variance components from one adjustment.

    With factors far from one they are rough, and their sigmas too small where other groups' sigmas are too small:
    `iterated_components` repeats them. After a robust loss or a blunder pass the largest residuals are missing, and
    factors are too small.

    Parameters
    ----------
    solution : Solution or Linearised
        The adjustment whose residuals are judged.
    grouping : Grouping, optional
        `group_rows` when absent.

    Returns
    -------
    Components
        Of each group the factor by which its stated sigmas have to be multiplied, with its own sigma.

    Examples
    --------
    >>> print(mgsgraph.components(solution).sentences[0])
    tie image points: no inconsistency found, but the test is weak (factor 1.2, 0.86 to 2.1 with 99%)
    """
    at = (solution if isinstance(solution, Linearised) else at_solution(solution)).of_estimator()
    by_group = group_redundancy(at, grouping or group_rows(at.network))
    judgements = judge_groups(by_group, {})
    squared = _squared_factors(by_group, judgements)
    plain = by_group.sums_of_squares / np.maximum(by_group.redundancy, 1e-300)
    first = components_from_redundancy(by_group, judgements, np.sqrt(np.where(squared > 0.0, squared, plain)))
    groups = tuple(replace(entry, negative=bool(s <= 0.0)) for entry, s in zip(first.groups, squared, strict=True))
    far = [abs(math.log(entry.factor)) > _FAR for entry in first.groups if entry.judgement is Judgement.JUDGED]
    return replace(first, groups=groups, rough=any(far))


def iterated_components(
    network: Network,
    settings: SolverSettings,
    grouping: Grouping | None = None,
    most: int = 25,
    tolerance: float = 0.01,
) -> IteratedComponents:
    """Scale the sigmas of each group, adjust again, and so on until all factors are one.

    Rays and ranges that the network marks as rejected stay out, unless `settings.reject` judges all of them anew.
    Groups that can't be judged, or not any more with the sigmas found for them, keep their sigmas; those whose factor
    goes to zero or infinity are held near it.

    Parameters
    ----------
    grouping : Grouping, optional
        `group_rows` when absent.
    most : int
        Passes.
    tolerance : float
        By which factors of the last pass may differ from one.

    Raises what `adjust_network` raises.

    Examples
    --------
    >>> print(mgsgraph.iterated_components(network, mgsgraph.SolverSettings()).sentences[0])
    tie image points: no inconsistency found, but the test is weak (factor 1.2, 0.86 to 2.1 with 99%)
    """
    if most < 1 or not tolerance > 0.0:
        raise InputError("variance components", f"{most} passes, tolerance {tolerance}", "at least 1, above zero")
    grouping = grouping or group_rows(network)
    total, held, history = np.ones(len(grouping.names)), dict[int, Judgement](), list[Array]()
    left_in = unmarked(network) if settings.reject == 0.0 else None
    while True:
        present = scaled(network, grouping, total)
        solution = adjust_network(present, settings, left_in=left_in)
        history.append(total.copy())
        by_group = group_redundancy(at_solution(solution).of_estimator(), grouping)
        judgements = judge_groups(by_group, held)
        free = np.array([judgement is Judgement.JUDGED for judgement in judgements], dtype=bool)
        step = np.where(free, np.sqrt(np.clip(_squared_factors(by_group, judgements), _STEP**-2, _STEP**2)), 1.0)
        unjudged = [g for g in np.flatnonzero(~free & (total != 1.0)).tolist() if g not in held]
        converged = bool(np.all(np.abs(step - 1.0) <= tolerance)) and not unjudged and solution.converged
        if converged or len(history) == most:
            break
        total = total * (step if len(history) < _UNDAMPED else np.sqrt(step))
        for g in np.flatnonzero(free & ((total <= _FLOOR) | (total >= _CEILING))).tolist():
            held[g] = Judgement.ZERO if total[g] <= _FLOOR else Judgement.UNBOUNDED
        total = np.clip(total, _FLOOR, _CEILING)
        for g in unjudged:  # the new sigmas neither confirm nor contradict the stated ones
            held[g], total[g] = Judgement.LOST, 1.0
    components = components_from_redundancy(by_group, judgements, total)
    return IteratedComponents(present, solution, components, converged, np.array(history))


def judge_groups(by_group: Redundancy, held: dict[int, Judgement]) -> list[Judgement]:
    """Of each group; those held are as they were."""
    judgements = [Judgement.FEW if r < LEAST else Judgement.JUDGED for r in by_group.redundancy]
    for g, judgement in held.items():
        judgements[g] = judgement
    while True:
        judged = _judged_groups(judgements)
        degrees = _degrees(by_group.helmert[np.ix_(judged, judged)])
        if not degrees.size or degrees.min() >= LEAST:
            return judgements
        judgements[int(judged[np.argmin(degrees)])] = Judgement.INSEPARABLE


def _judged_groups(judgements: list[Judgement]) -> Index:
    return np.flatnonzero([judgement is Judgement.JUDGED for judgement in judgements])


def _degrees(helmert: Array) -> Array:
    """Degrees of freedom of each squared factor, 2 over its variance; 0 where Helmert's matrix is singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(helmert), 1e-300))
    values, vectors = np.linalg.eigh(helmert * scale[:, None] * scale)
    inverse = (vectors**2) @ (1.0 / np.maximum(values, 1e-12))
    return np.asarray(1.0 / (inverse * scale**2))


def _squared_factors(by_group: Redundancy, judgements: list[Judgement]) -> Array:
    """(g,) solution of Helmert's equations for the groups that are judged, the others' factors being one; NaN there."""
    judged, squared = _judged_groups(judgements), np.full(len(judgements), np.nan)
    excess = (by_group.sums_of_squares - by_group.redundancy)[judged]
    squared[judged] = 1.0 + np.linalg.solve(by_group.helmert[np.ix_(judged, judged)], excess)
    return squared


def components_from_redundancy(by_group: Redundancy, judgements: list[Judgement], factors: Array) -> Components:
    """Factors (g,) of the groups, with their covariances from Helmert's matrix of the judged groups."""
    size, judged = len(judgements), _judged_groups(judgements)
    part = by_group.helmert[np.ix_(judged, judged)]
    covariance, degrees = 2.0 * np.linalg.inv(part), np.full(size, np.nan)
    degrees[judged] = _degrees(part)
    correlation, scale = np.full((size, size), np.nan), 1.0 / sigmas_of(covariance)
    correlation[np.ix_(judged, judged)] = covariance * scale[:, None] * scale
    groups = []
    for g, judgement in enumerate(judgements):
        numbers = int(by_group.counts[g]), float(by_group.redundancy[g]), float(by_group.sums_of_squares[g])
        inseparable = judgement in (Judgement.INSEPARABLE, Judgement.LOST)
        beside, shared = nearest(by_group, g) if inseparable else most_correlated(by_group, judged, g)
        freedom = float(degrees[g])
        if judgement is Judgement.JUDGED and abs(shared) > CORRELATED and 2.0 * _VAGUE**2 * freedom < 1.0:
            judgement, freedom = Judgement.ENTANGLED, math.nan
        has = judgement in (Judgement.JUDGED, Judgement.ENTANGLED, Judgement.ZERO, Judgement.UNBOUNDED)
        factor = float(factors[g]) if has else math.nan
        groups.append(Component(by_group.names[g], judgement, *numbers, factor, freedom, beside, shared))
    return Components(tuple(groups), correlation, by_group.helmert, by_group.exact)
