"""Variance components: by what factor the sigmas of each group of rows are wrong, and how sure
one can be of it.

components = mgsgraph.analysis.components.components_of(solution)
print(components)
found = iterated_components(network, settings)  # scaled and adjusted again, until all factors are one

A pass solves Helmert's equations S s = q (see `helmert`) for the variance factors s. They are unbiased, and repeated
until s = 1 they give what Foerstner's simpler v'v / r leads to as well, in fewer passes; for normal errors that is the
restricted maximum likelihood (Foerstner 1979, 1985). There the covariance of the factors is 2 S^-1.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.linearised import Linearised, PointRows
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.square_root import product
from mgsgraph.analysis.grouping import Grouping, group_rows, scaled
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import OUT
from mgsgraph.network import Network
from mgsgraph.record import Record

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DENSE = 2000
"""Shared unknowns up to which the last term is exact; beyond, it is estimated with random signs (Hutchinson 1990)."""
_PROBES = 64
CORRELATED = 0.5
"""Correlation of two groups' squared factors from which on a verdict names the other group."""
_HALF = 0.75
"""By how much a variance factor changes when sigmas change by half."""


@dataclass(frozen=True, slots=True, eq=False)
class Redundancy:
    """What the residuals of g groups of rows say of their sigmas."""

    names: tuple[str, ...]
    """(g,) groups."""
    counts: Index
    """(g,) rows that take part."""
    squares: Array
    """(g,) sum of the squares of the whitened residuals."""
    redundancy: Array
    """(g,) sum of the redundancy numbers, expected value of `squares`."""
    helmert: Array
    """(g, g) Helmert's matrix; its rows add up to `redundancy`."""
    exact: bool
    """False where the matrix is an estimate with random signs."""


def group_redundancy(at: Linearised, grouping: Grouping, dense: int = DENSE) -> Redundancy:
    """Redundancy of groups of rows at a solution; `dense` as `DENSE`."""
    sums = _Sums(at, len(grouping.names))
    for rows, groups in _alike(at, grouping):
        sums.add(rows, groups)
    sums.close()
    known, size = prior_rows(at), len(grouping.names)
    of_row = grouping.of_priors(at.layout)
    counts = sums.counts + np.bincount(of_row, minlength=size)
    squares = sums.squares + np.bincount(of_row, known.misfit**2, size)
    shares = sums.shares + np.bincount(of_row, known.share, size)
    normals = sums.normals(of_row)
    redundancy, exact = counts - shares, at.layout.columns <= dense
    if exact:
        helmert = sums.cross + _traces(normals, at.joint.dense())
        helmert[np.diag_indices(size)] += counts - 2.0 * shares
    else:
        helmert = sums.cross + _estimated_traces(normals, at.joint)
        # between groups the estimate is good; within one the rows' sum is known, which leaves no need for it
        np.fill_diagonal(helmert, 0.0)
        helmert[np.diag_indices(size)] = redundancy - helmert.sum(axis=1)
    return Redundancy(grouping.names, counts, squares, redundancy, helmert, exact)


def _alike(at: Linearised, grouping: Grouping) -> Iterator[tuple[PointRows, Index]]:
    """Rows of points that take part and whose rows belong to the same groups (r,)."""
    of_observation, rows = grouping.of_observations(at.layout), at.rows
    for piece, (pattern, first, count, _, among) in enumerate(rows.piece.tolist()):
        inside = np.flatnonzero(rows.kind[first : first + count] != OUT)
        observations = int(rows.pattern_observation[pattern + 1] - rows.pattern_observation[pattern])
        if not inside.size or not observations:
            continue
        whole = at.rows_of_piece(piece)
        groups = of_observation[among : among + observations * count].reshape(observations, count)[:, inside]
        sets, which = np.unique(groups, axis=1, return_inverse=True)
        for k, of_set in enumerate(sets.T):
            mine = inside[which.reshape(-1) == k]
            part = replace(
                whole, residuals=whole.residuals[mine], by_point=whole.by_point[mine], by_shared=whole.by_shared[mine]
            )
            yield part, of_set[part.observation]


class _Sums:
    """What is summed over the points; the blocks of N of one set of unknowns are gathered before they are put away."""

    def __init__(self, at: Linearised, groups: int) -> None:
        self._at, self._blocks = at, at.layout.blocks
        self.counts = np.zeros(groups, dtype=np.int64)
        self.squares, self.shares, self.cross = np.zeros(groups), np.zeros(groups), np.zeros((groups, groups))
        self._flat = np.zeros((groups, self._blocks.target.size))
        self._variables: tuple[int, ...] | None = None
        self._normal, self._covariance = np.zeros((groups, 0, 0)), np.zeros((0, 0))

    def add(self, rows: PointRows, groups: Index) -> None:
        """Rows of some points, each row (r,) of one group for all of them."""
        self._open(rows.variables)
        through, rest = rows.following()
        # rows that were rejected are zero
        present = np.any(rows.by_point != 0.0, axis=2) | np.any(rows.by_shared != 0.0, axis=2) | (rows.residuals != 0.0)
        inner, outer, carried = dict[int, Array](), dict[int, Array](), dict[int, Array]()
        found = np.unique(groups).tolist()
        for g in found:
            mine = groups == g
            own, left = through[:, mine], rest[:, mine]
            turned = np.swapaxes(own, 1, 2)
            inner[g], outer[g] = (turned @ own).reshape(-1), _stacked(turned @ left)
            flat = _stacked(left)
            normal = product(flat.T, flat)
            carried[g] = product(outer[g], self._covariance)
            self._normal[g] += normal
            self.counts[g] += np.count_nonzero(present[:, mine])
            self.squares[g] += np.sum(rows.residuals[:, mine] ** 2)
            self.shares[g] += np.sum(own**2) + np.sum(normal * self._covariance)
        for g in found:
            for k in found:
                self.cross[g, k] += inner[g] @ inner[k] + 2.0 * np.vdot(carried[g], outer[k])

    def close(self) -> None:
        """Add the gathered blocks to the sums."""
        if self._variables is None:
            return
        layout = self._at.layout
        group = layout.group_variables.index(self._variables)
        width = layout.variables.width[list(self._variables)].tolist()
        ends, start = np.concatenate([[0], np.cumsum(width)]).tolist(), int(layout.groups.pair_first[group])
        for i, a in enumerate(width):
            for j, b in enumerate(width[i:], i):
                at = int(self._blocks.target.pair[start + i * len(width) + j])
                part = self._normal[:, ends[i] : ends[i] + a, ends[j] : ends[j] + b]
                self._flat[:, at : at + a * b] += part.reshape(part.shape[0], -1)
        self._variables = None

    def normals(self, of_row: Index) -> "list[csr_array]":
        """N of each group, with its priors' own rows, whose groups are `of_row`."""
        from scipy.sparse import coo_array  # slow to import

        layout, found = self._at.layout, []
        variables = layout.variables
        links = list[tuple[Index, Index, Index]]()
        """Row, column, and place in the flat arrays, of the numbers of each block."""
        for v, w, at in zip(self._blocks.first, self._blocks.second, self._blocks.offset, strict=True):
            a, b = np.arange(variables.width[v]), np.arange(variables.width[w])
            where = at + np.arange(a.size * b.size)
            one = np.repeat(variables.first[v] + a, b.size)
            other = np.tile(variables.first[w] + b, a.size)
            links += [(one, other, where)] if v == w else [(one, other, where), (other, one, where)]
        links.append((np.zeros(0, dtype=np.int64),) * 3)
        row, column, place = (np.concatenate(part) for part in zip(*links, strict=True))
        for g, flat in enumerate(self._flat):
            values, prior = flat[place], layout.prior.every[np.flatnonzero(of_row == g)]
            taken = values != 0.0
            made = coo_array((values[taken], (row[taken], column[taken])), shape=(layout.columns, layout.columns))
            found.append(made.tocsr() + (prior.T @ prior).tocsr())
        return found

    def _open(self, variables: tuple[int, ...]) -> None:
        if variables != self._variables:
            self.close()
            self._variables = variables
            self._covariance = self._at.joint.of(variables) if variables else np.zeros((0, 0))
            self._normal = np.zeros((self.counts.size, *self._covariance.shape))


def _stacked(matrices: Array) -> Array:
    """(m r, c) rows of matrices (m, r, c), of which c may be none: that is, of points that held images alone see."""
    m, r, c = matrices.shape
    return matrices.reshape(m * r, c)


def _traces(normals: "list[csr_array]", covariance: Array) -> Array:
    """(g, g) tr(N_g S N_k S)."""
    half = [normal @ covariance for normal in normals]
    found = np.zeros((len(half), len(half)))
    for g, one in enumerate(half):
        for k, other in enumerate(half[: g + 1]):
            found[g, k] = found[k, g] = np.sum(one * other.T)
    return found


def _estimated_traces(normals: "list[csr_array]", joint: JointCovariance) -> Array:
    """(g, g) estimates of tr(N_g S N_k S): with S = U U' and random signs z it is E (U'N_g U z)'(U'N_k U z)."""
    signs, root = np.random.default_rng(0).choice([-1.0, 1.0], (joint.columns, _PROBES)), joint.square_root
    spread = root.back(signs)
    projected = [root.forward(normal @ spread) for normal in normals]
    return np.array([[np.sum(one * other) for other in projected] for one in projected]) / _PROBES


def nearest(found: Redundancy, group: int) -> tuple[str, float]:
    """The group whose residuals have most in common with those of a group that can't be judged, and minus the cosine
    between the two in Helmert's matrix: -1 where all redundancy of the one is the other's.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(found.helmert), 1e-300))
    alike = (found.helmert * scale[:, None] * scale)[group]
    alike[group] = -1.0
    k = int(np.argmax(alike))
    return found.names[k], -float(alike[k])


def most_correlated(found: Redundancy, judged: Index, group: int) -> tuple[str, float]:
    """The judged group whose squared factor is most correlated with that of a group, were they estimated together."""
    others = judged[judged != group]
    if not others.size or found.helmert[group, group] <= 0.0:
        return "", math.nan
    own = np.concatenate([[group], others])
    scale = 1.0 / np.sqrt(np.diag(found.helmert)[own])
    inverse = np.linalg.pinv(found.helmert[np.ix_(own, own)] * scale[:, None] * scale, hermitian=True)
    shared = inverse[0, 1:] / np.sqrt(np.maximum(inverse[0, 0] * np.diag(inverse)[1:], np.finfo(np.float64).tiny))
    k = int(np.argmax(np.abs(shared)))
    return found.names[int(others[k])], float(shared[k])


def given(found: Redundancy, judged: Index, group: int, degrees: float) -> str:
    """The group that isn't judged on whose sigmas the factor of a judged one depends most, where that is much."""
    others = np.setdiff1d(np.arange(len(found.names)), judged)
    if group not in judged or not others.size:
        return ""
    for other in others:
        beside, shared = most_correlated(found, judged, int(other))
        if beside == found.names[group] and abs(shared) > CORRELATED:
            return found.names[int(other)]
    effects = np.linalg.solve(found.helmert[np.ix_(judged, judged)], found.helmert[np.ix_(judged, others)])
    mine = np.abs(effects[judged == group][0])
    worst = int(np.argmax(mine))
    return found.names[int(others[worst])] if _HALF * mine[worst] > 0.5 * math.sqrt(2.0 / degrees) else ""



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
    INSEPARABLE = "can't be told apart from another group"
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
    squares: float
    """Sum of their squared whitened residuals."""
    factor: float
    """By which the stated sigmas have to be multiplied; NaN where it can't be judged, the factor held otherwise."""
    degrees: float
    """Degrees of freedom of its square, chi-square with which it is distributed like, nearly; NaN where not judged."""
    beside: str = ""
    """The group that it is most correlated with."""
    correlation: float = math.nan
    """Of the two groups' squared factors."""
    given: str = ""
    """Group that can't be judged for this one's sake, or whose sigmas, wrong by half, matter by half of `sigma`."""
    negative: bool = False
    """Whether Helmert's equations gave its square as negative: the factor is Foerstner's in its place."""

    @property
    def sigma(self) -> float:
        """Standard deviation of `factor`."""
        return self.factor / math.sqrt(2.0 * self.degrees) if self.degrees > 0.0 else math.nan

    @property
    def foerstner(self) -> float:
        """Square root of squares over redundancy: the factor if all other groups' sigmas are right."""
        return math.sqrt(self.squares / self.redundancy) if self.redundancy > 0.0 else math.nan

    def interval(self, probability: float = SURE) -> tuple[float, float]:
        """Within which the factor lies, by the chi-square distribution; NaN where it can't be judged."""
        from scipy.stats import chi2  # slow to import

        if self.judgement is not Judgement.JUDGED:
            return math.nan, math.nan
        low, high = chi2.ppf([0.5 - 0.5 * probability, 0.5 + 0.5 * probability], self.degrees)
        return self.factor * math.sqrt(self.degrees / high), self.factor * math.sqrt(self.degrees / low)

    def deviation(self, truth: float) -> float:
        """How far from a true factor it is, as a standard normal deviate (Wilson & Hilferty 1931)."""
        spread = 2.0 / (9.0 * self.degrees)
        return (math.pow(self.factor / truth, 2.0 / 3.0) - 1.0 + spread) / math.sqrt(spread)

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
        return f"{self.name}: {_VERDICTS[self.judgement](self)}"


def _judged(one: Component) -> str:
    notes = [f"if the stated sigmas of {one.given} are right"] if one.given else []
    if abs(one.correlation) > CORRELATED:
        notes.insert(0, f"correlated with {one.beside}, correlation {one.correlation:.2f}")
    if one.negative:
        notes.insert(0, "Helmert's equations gave a negative square: this is Foerstner's, as if all others were right")
    return "; ".join([_plainly(one), *notes])


def _plainly(one: Component) -> str:
    low, high = one.interval()
    if one.consistent and one.sigma > _VAGUE * one.factor:
        return (
            f"nothing wrong to be seen, with little to see it by (factor {one.factor:.2g}, "
            f"{low:.2g} to {high:.2g} with {100 * SURE:.0f}%)"
        )
    if one.consistent:
        return f"honest (factor {_with_sigma(one.factor, one.sigma)})"
    if one.factor > 1.0:
        return f"too optimistic, sigmas too small by a factor of {_with_sigma(one.factor, one.sigma)}"
    inverse = 1.0 / one.factor
    return f"too pessimistic, sigmas too large by a factor of {_with_sigma(inverse, one.sigma * inverse**2)}"


def _entangled(one: Component) -> str:
    return (
        f"factor {one.factor:.2g}, known together with that of {one.beside} only (correlation {one.correlation:.2f}): "
        "errors of the one may be booked under the other"
    )


def _inseparable(one: Component) -> str:
    if not abs(one.correlation) > CORRELATED:
        return f"too little of its {one.redundancy:.2g} redundancy is its own (most of it is shared with {one.beside})"
    return f"can't be told apart from {one.beside} (correlation {one.correlation:.2f}); {one.redundancy:.2g} redundancy"


_VERDICTS: dict[Judgement, Callable[[Component], str]] = {
    Judgement.JUDGED: _judged,
    Judgement.FEW: lambda one: f"can't be judged ({max(one.redundancy, 0.0):.1g} redundancy)",
    Judgement.INSEPARABLE: _inseparable,
    Judgement.ENTANGLED: _entangled,
    Judgement.LOST: lambda one: (
        "can't be judged, the estimate runs away to sigmas of which nothing can be said; kept as stated"
    ),
    Judgement.ZERO: lambda one: (
        f"residuals too small for any sigma, the errors of other groups explain them; held at factor {one.factor:.2g}"
    ),
    Judgement.UNBOUNDED: lambda one: f"residuals too large for any sigma; held at factor {one.factor:.3g}",
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
        for one in self.groups:
            if one.name == name:
                return one
        names = ", ".join(one.name for one in self.groups)
        raise InputError(f"variance component {name!r}", "no such group", f"one of {names}")

    @property
    def factors(self) -> Array:
        """(g,) factors, 1 where there is none."""
        found = np.array([one.factor for one in self.groups])
        return np.where(np.isfinite(found), found, 1.0)

    @property
    def sentences(self) -> list[str]:
        """One for each group, and one on how it was done."""
        how = "exact" if self.exact else "one term estimated with random signs, for there are many unknowns"
        lines = [*(one.sentence for one in self.groups), f"Helmert's matrix: {how}."]
        if self.rough:
            lines.append("A first look: some factors are so far from 1 that only repeating it makes all of them right.")
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
        end = f"Came to rest after {passes} passes." if self.converged else f"NOT at rest after {passes} passes."
        return [*self.components.sentences, end]


def components_of(solution: Solution | Linearised, grouping: Grouping | None = None) -> Components:
    """Variance components from one adjustment.

    With factors far from one they are rough, and their sigmas too small where other groups' sigmas are too small:
    `iterated_components` repeats them. After a robust loss or a blunder pass the largest residuals are missing, and
    factors are too small.

    Parameters
    ----------
    grouping : Grouping, optional
        `group_rows` when absent.

    Examples
    --------
    >>> from mgsgraph.analysis.components import components_of
    >>> print(components_of(solution).sentences[0])
    tie image points: nothing wrong to be seen, with little to see it by (factor 1.2, 0.86 to 2.1 with 99%)
    """
    at = (solution if isinstance(solution, Linearised) else at_solution(solution)).of_estimator()
    found = group_redundancy(at, grouping or group_rows(at.network))
    judgements = judge_groups(found, {})
    squared = _squared_factors(found, judgements)
    plain = found.squares / np.maximum(found.redundancy, 1e-300)
    components = components_from_redundancy(found, judgements, np.sqrt(np.where(squared > 0.0, squared, plain)))
    groups = tuple(replace(one, negative=bool(s <= 0.0)) for one, s in zip(components.groups, squared, strict=True))
    far = [abs(math.log(one.factor)) > _FAR for one in components.groups if one.judgement is Judgement.JUDGED]
    return replace(components, groups=groups, rough=any(far))


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
    >>> from mgsgraph.analysis.components import iterated_components
    >>> print(iterated_components(network, mgsgraph.SolverSettings()).sentences[0])
    tie image points: nothing wrong to be seen, with little to see it by (factor 1.2, 0.86 to 2.1 with 99%)
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
        found = group_redundancy(at_solution(solution).of_estimator(), grouping)
        judgements = judge_groups(found, held)
        free = np.array([one is Judgement.JUDGED for one in judgements], dtype=bool)
        step = np.where(free, np.sqrt(np.clip(_squared_factors(found, judgements), _STEP**-2, _STEP**2)), 1.0)
        lost = [g for g in np.flatnonzero(~free & (total != 1.0)).tolist() if g not in held]
        converged = bool(np.all(np.abs(step - 1.0) <= tolerance)) and not lost and solution.converged
        if converged or len(history) == most:
            break
        total = total * (step if len(history) < _UNDAMPED else np.sqrt(step))
        for g in np.flatnonzero(free & ((total <= _FLOOR) | (total >= _CEILING))).tolist():
            held[g] = Judgement.ZERO if total[g] <= _FLOOR else Judgement.UNBOUNDED
        total = np.clip(total, _FLOOR, _CEILING)
        for g in lost:  # with its new sigmas nothing can be said of them: neither for them nor against the stated ones
            held[g], total[g] = Judgement.LOST, 1.0
    components = components_from_redundancy(found, judgements, total)
    return IteratedComponents(present, solution, components, converged, np.array(history))


def judge_groups(found: Redundancy, held: dict[int, Judgement]) -> list[Judgement]:
    """Of each group; those held are as they were."""
    judgements = [Judgement.FEW if r < LEAST else Judgement.JUDGED for r in found.redundancy]
    for g, judgement in held.items():
        judgements[g] = judgement
    while True:
        judged = _judged_groups(judgements)
        degrees = _degrees(found.helmert[np.ix_(judged, judged)])
        if not degrees.size or degrees.min() >= LEAST:
            return judgements
        judgements[int(judged[np.argmin(degrees)])] = Judgement.INSEPARABLE


def _judged_groups(judgements: list[Judgement]) -> Index:
    return np.flatnonzero([one is Judgement.JUDGED for one in judgements])


def _degrees(helmert: Array) -> Array:
    """Degrees of freedom of each squared factor, 2 over its variance; 0 where Helmert's matrix is singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(helmert), 1e-300))
    values, vectors = np.linalg.eigh(helmert * scale[:, None] * scale)
    inverse = (vectors**2) @ (1.0 / np.maximum(values, 1e-12))
    return np.asarray(1.0 / (inverse * scale**2))


def _squared_factors(found: Redundancy, judgements: list[Judgement]) -> Array:
    """(g,) solution of Helmert's equations for the groups that are judged, the others' factors being one; NaN there."""
    judged, squared = _judged_groups(judgements), np.full(len(judgements), np.nan)
    excess = (found.squares - found.redundancy)[judged]
    squared[judged] = 1.0 + np.linalg.solve(found.helmert[np.ix_(judged, judged)], excess)
    return squared


def components_from_redundancy(found: Redundancy, judgements: list[Judgement], factors: Array) -> Components:
    """Factors (g,) of the groups, with their covariances from Helmert's matrix of those that can be judged."""
    size, judged = len(judgements), _judged_groups(judgements)
    part = found.helmert[np.ix_(judged, judged)]
    covariance, degrees = 2.0 * np.linalg.inv(part), np.full(size, np.nan)
    degrees[judged] = _degrees(part)
    correlation, scale = np.full((size, size), np.nan), 1.0 / np.sqrt(np.diag(covariance))
    correlation[np.ix_(judged, judged)] = covariance * scale[:, None] * scale
    groups = []
    for g, judgement in enumerate(judgements):
        numbers = int(found.counts[g]), float(found.redundancy[g]), float(found.squares[g])
        lost = judgement in (Judgement.INSEPARABLE, Judgement.LOST)
        beside, shared = nearest(found, g) if lost else most_correlated(found, judged, g)
        depends, known = given(found, judged, g, degrees[g]), float(degrees[g])
        if judgement is Judgement.JUDGED and abs(shared) > CORRELATED and 2.0 * _VAGUE**2 * known < 1.0:
            judgement, known = Judgement.ENTANGLED, math.nan
        has = judgement in (Judgement.JUDGED, Judgement.ENTANGLED, Judgement.ZERO, Judgement.UNBOUNDED)
        factor = float(factors[g]) if has else math.nan
        groups.append(Component(found.names[g], judgement, *numbers, factor, known, beside, shared, depends))
    return Components(tuple(groups), correlation, found.helmert, found.exact)
