"""Several minima: starts over a terrain model's unknown shift, and the mixture of the minima.

A tie's height above a coarse terrain model says where the model lies by the ground's slope, which differs from post to
post: over the hundreds of meters of its a-priori shift the cost may have several minima. Starts lie on a disc of 2.5
a-priori sigmas about zero (Vogel's sunflower, which fills it evenly). There the shift is held while all other unknowns
converge, then released: with the other unknowns of the first optimum, or predicted by its covariance, half as many
starts end in another minimum. Two ends less than a joint sigma apart are the same minimum. Its weight is its share of
the posterior probability by Laplace's approximation,

    w ~ exp(-E) |S|^1/2 prod_i |V_i|^-1/2 ,

with the covariance S of the shared unknowns and the points' V_i. The lowest one is the solution x; what its stated
covariance leaves out are the others, and so the mean square error about x is stated, sum w_k (S_k + d_k d_k'), with
d_k = x_k - x.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.batch import BundleProblem, HeldProblem, levenberg_marquardt
from mgsgraph.adjustment.covariances import MOST_POINTS, MOST_UNKNOWNS, orientation_covariance
from mgsgraph.adjustment.fit import fit, residuals
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.graph.forms import Sweeper
from mgsgraph.adjustment.marginals import JointCovariance, in_cliques, joint_covariance
from mgsgraph.adjustment.rounds import Solved, solve_in_rounds
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import MgsgraphError
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import FIXED, NO_LOSS, OUT
from mgsgraph.kernel.sweep import SYSTEM, Reduction
from mgsgraph.network import TERRAIN, Network
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

STARTS = 16
"""Default: some 220 m apart for an a-priori sigma of 200 m, half of MEGDR's spacing."""
_WIDER = 1.1
"""Factor by which other minima increase a variance of the shift, from which on they count."""
WORTH = 0.01
"""Weight from which a second minimum is worth a warning."""
_REACH = 2.5
"""A-priori sigmas up to which starts lie."""
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
_SAME = 1.0
"""Joint sigmas up to which two ends are of one minimum."""
_STEPS = 4
"""Settings in which other unknowns converge, before a start is compared with known minima."""
_ROUGH = SolverSettings(cost_tolerance=1e-7, step_tolerance=1e-2, max_iterations=_STEPS)
"""Accuracy of starts until they are known to end in a new minimum."""
_TURNS = 25
"""Repetitions of these steps, within which a start must end."""
_ROUNDS = 3
"""Searches for blunders about lower minima."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Record):
    """One place at which the terrain model fits."""

    weight: float
    """Probability."""
    cost: float
    """Cost at the minimum."""
    shift: Array
    """(w,) m and rad, of the terrain model's unknowns (`Surface.terms`)."""
    spread: Array
    """(w, w) m and rad squared, their covariance about it, for sigma0 = 1."""
    starts: int
    """Starts that ended there, the first one among them."""


@dataclass(frozen=True, slots=True, eq=False)
class Minima(Record):
    """Minima that starts over a terrain model's shift have found."""

    starts: int
    """Starts besides the first one."""
    lost: int
    """Of these, how many did not converge."""
    each: tuple[Minimum, ...]
    """Minima, the solution first, then by their weight."""

    @property
    def several(self) -> bool:
        """Whether there is another one of note: by its probability, or by its effect on the sigmas."""
        first = self.each[0]
        wider = np.diag(self.spread(first.shift))[:2] > _WIDER * np.diag(first.spread)[:2]
        return bool(np.any(wider)) or any(minimum.weight > WORTH for minimum in self.each[1:])

    @property
    def mean(self) -> Array:
        """(w,) m and rad, mean of the terrain model's unknowns over the mixture."""
        return np.asarray(sum(minimum.weight * minimum.shift for minimum in self.each))

    @property
    def covariance(self) -> Array:
        """(w, w) of these about it."""
        return self.spread(self.mean)

    def spread(self, about: Array) -> Array:
        """(w, w) mean squares of the terrain model's unknowns about some values (w,)."""
        offsets = [minimum.shift - about for minimum in self.each]
        parts = (m.weight * (m.spread + np.outer(d, d)) for m, d in zip(self.each, offsets, strict=True))
        return np.asarray(sum(parts))


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """A minimum while others are sought."""

    solved: Solved
    covariance: Array
    """(columns, columns)"""
    logarithm: float
    """Of its weight, with some constant."""
    unit: float
    """Squared sigma that the fit has, 1 or more."""
    starts: int = 1

    def holds(self, state: Array, cost: float) -> bool:
        """Whether shared unknowns (columns,) are in the same minimum: not far, and not much lower or higher."""
        offset = state - self.solved.orientation
        near = float(offset @ np.linalg.solve(self.covariance, offset)) < _SAME**2 * self.unit
        return near and abs(cost - self.solved.outcome.cost_final) < _SAME**2 * self.unit


def starts_wanted(network: Network, settings: SolverSettings, layout: Layout) -> int:
    """Starts over the terrain model's shift: as many as asked for; else `STARTS` where the network is small and its
    cost a sum of squares. None where no such shift is estimated.
    """
    if not network.surface_shifts or TERRAIN in network.considered:
        return 0
    if settings.starts is not None:
        return settings.starts
    small = len(network.points) <= MOST_POINTS and layout.columns <= MOST_UNKNOWNS
    return STARTS if small and layout.model.loss == NO_LOSS else 0


def best_of_starts(
    solved: Solved, settings: SolverSettings, before: Reduction, count: int, sweeper: Sweeper
) -> tuple[Solved, Minima, JointCovariance | None]:
    """The lowest minimum that starts over the terrain model's shift lead to.

    Parameters
    ----------
    solved : Solved
        The first one.
    settings : SolverSettings
        Where blunders are sought, they are sought again about a lower minimum.
    before : Reduction
        Of the nominal orientation.
    count : int
        Starts.
    sweeper : Sweeper

    Returns
    -------
    tuple
        The lowest, all of them, and the joint covariance of the shared unknowns about the lowest; None where there is
        one minimum alone.
    """
    initial = solved.cost_initial
    for turn in range(_ROUNDS):
        ends, failed = _ends(solved, settings, before, count, sweeper)
        best = min(ends, key=lambda result: result.solved.outcome.cost_final)
        if best.solved is solved or settings.reject == 0.0 or turn == _ROUNDS - 1:
            break
        begin, history = best.solved.orientation, best.solved.history
        solved = solve_in_rounds(best.solved.layout, settings, solved.selection, before, no_progress, sweeper, begin)
        solved = replace(solved, history=history + solved.history)
    weighted = _weighted(ends, best)
    minima = Minima(count, failed, tuple(_record(end, weight) for end, weight in weighted))
    lowest = replace(
        best.solved, cost_initial=initial, rounds=solved.rounds, circling=solved.circling,
        dimensions=solved.dimensions,
    )  # fmt: skip
    return lowest, minima, _mixture(weighted) if minima.several else None


def _ends(
    solved: Solved, settings: SolverSettings, before: Reduction, count: int, sweeper: Sweeper
) -> tuple[list[_End], int]:
    """Minima to which starts lead, the first one first; and how many starts did not converge."""
    ends, failed = [_end(solved, sweeper)], 0
    for begin in _begins(ends[0], count, sweeper):
        try:
            state, cost = _descended(ends, begin, sweeper)
            home, result = _home(ends, state, cost), solved
            if home is None:
                result = solve_in_rounds(
                    solved.layout, replace(settings, reject=0.0), solved.selection, before, no_progress, sweeper, state
                )
                home = _home(ends, result.orientation, result.outcome.cost_final)
            if home is not None:
                ends[home] = replace(ends[home], starts=ends[home].starts + 1)
            elif result.outcome.converged and math.isfinite((end := _end(result, sweeper)).logarithm):
                ends.append(replace(end, solved=replace(result, history=solved.history + result.history)))
            else:
                failed += 1
        except MgsgraphError:  # no finite cost there, or a network that is too weak there
            failed += 1
    return ends, failed


def _descended(ends: Sequence[_End], begin: Array, sweeper: Sweeper) -> tuple[Array, float]:
    """Shared unknowns and cost to which a start leads, roughly, until it is in a known minimum."""
    first = ends[0].solved
    problem = BundleProblem(BundleGraph(first.layout, first.rows, sweeper))
    rough = replace(_ROUGH, step_tolerance=min(_ROUGH.step_tolerance * math.sqrt(ends[0].unit), 0.5))
    for _ in range(_TURNS):
        outcome = levenberg_marquardt(problem, begin, rough, no_progress)
        begin = outcome.state
        if outcome.converged or _home(ends, begin, outcome.cost_final) is not None:
            break
    return begin, outcome.cost_final


def _home(ends: Sequence[_End], state: Array, cost: float) -> int | None:
    """Number of the minimum that a state is in; None where it is in none that is known."""
    return next((k for k, end in enumerate(ends) if end.holds(state, cost)), None)


def _terrain(layout: Layout) -> slice:
    """Columns of the terrain model's unknowns: the last of the shifts."""
    network = layout.network
    return layout.columns_of(len(network.images) + len(network.shift_names) - 1)


def _begins(end: _End, count: int, sweeper: Sweeper) -> Iterator[Array]:
    """Shared unknowns (columns,) at each start."""
    solved, layout, surface = end.solved, end.solved.layout, end.solved.layout.network.surface
    assert surface is not None
    k = np.arange(count)
    radius, angle = _REACH * surface.shift_sigma * np.sqrt((k + 0.5) / max(count, 1)), k * _GOLDEN
    wanted = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    shift = slice(_terrain(layout).start, _terrain(layout).start + 2)
    follows = np.linalg.solve(end.covariance[shift, shift], end.covariance[shift])
    graph, held = BundleGraph(layout, solved.rows, sweeper), np.eye(layout.columns)[:, shift]
    for move in (wanted - solved.orientation[shift]) @ follows:
        reduction = graph.reduction(solved.orientation + move, SYSTEM, solved.points)
        begin = reduction.orientation
        if math.isfinite(reduction.cost):
            # a start that fails here begins unchanged
            with suppress(MgsgraphError):
                begin = levenberg_marquardt(HeldProblem(graph, held, reduction), begin, _ROUGH, no_progress).state
        yield begin


def _end(solved: Solved, sweeper: Sweeper) -> _End:
    layout, rows = solved.layout, solved.rows
    graph = BundleGraph(layout, rows, sweeper)
    covariance = orientation_covariance(graph, solved.reduction).dense()
    zeros = np.zeros(layout.blocks.target.size)
    by_points = sweeper.covariances(layout, rows, solved.orientation, zeros, solved.points)
    free = (rows.kind != FIXED) & (rows.kind != OUT)
    scaled = covariance / layout.scales / layout.scales[:, None]
    logarithm = np.linalg.slogdet(scaled)[1] + np.sum(np.linalg.slogdet(by_points[free])[1])
    return _End(solved, covariance, 0.5 * float(logarithm) - solved.outcome.cost_final, _unit(solved, sweeper))


def _unit(solved: Solved, sweeper: Sweeper) -> float:
    """Squared sigma of the fit, 1 or more: blunders make minima wider by as much."""
    residuals_ = residuals(solved.layout, solved.orientation, solved.points, sweeper)
    return max(1.0, fit(solved.layout, solved.rows, solved.orientation, solved.points, residuals_).sigma0 ** 2)


def _weighted(ends: Sequence[_End], best: _End) -> list[tuple[_End, float]]:
    """Minima with their probabilities, the lowest first, then by these."""
    logarithms = np.array([end.logarithm for end in ends])
    weights = np.exp(logarithms - logarithms.max())
    pairs = zip(ends, (weights / weights.sum()).tolist(), strict=True)
    return sorted(pairs, key=lambda pair: (pair[0] is not best, -pair[1]))


def _record(end: _End, weight: float) -> Minimum:
    shift_columns = _terrain(end.solved.layout)
    shift, spread = end.solved.orientation[shift_columns].copy(), end.covariance[shift_columns, shift_columns].copy()
    return Minimum(weight, end.solved.outcome.cost_final, shift, spread, end.starts)


def _mixture(weighted: Sequence[tuple[_End, float]]) -> JointCovariance:
    """Mean squares of the shared unknowns about the first one."""
    best = weighted[0][0].solved
    offsets = [end.solved.orientation - best.orientation for end, _ in weighted]
    parts = (weight * (end.covariance + np.outer(d, d)) for (end, weight), d in zip(weighted, offsets, strict=True))
    variables, scales = best.layout.variables, best.layout.scales
    members = variables.adjusted()
    columns = variables.columns_of_all(members)
    covariance = np.asarray(sum(parts))[np.ix_(columns, columns)] / scales[columns] / scales[columns][:, None]
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T / scales[columns]
    return joint_covariance(in_cliques(variables.first, variables.width, [members], [root]))
