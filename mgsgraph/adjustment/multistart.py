"""Several minima: starts over a terrain model's unknown shift, and the mixture of what they find.

A tie's height above a coarse terrain model says where the model lies by the ground's slope, which differs from post to
post: over the hundreds of metres of its a-priori shift the cost may have several minima. Starts lie on a disc of 2.5
a-priori sigmas about zero (Vogel's sunflower, which fills it evenly). There the shift is held while all other unknowns
settle, then let go: begun with these where the first optimum has them, or its covariance, half as many starts end in
another minimum. Two ends less than a joint sigma apart are the same minimum. Its weight is its share
of the posterior probability by Laplace's approximation,

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
"""Where none is said: some 220 m apart for an a-priori sigma of 200 m, half of MEGDR's spacing."""
_WIDER = 1.1
"""Times that minima besides the lowest one make a variance of the shift larger, from which on they count."""
WORTH = 0.01
"""Weight from which a second minimum is worth a warning."""
_REACH = 2.5
"""A-priori sigmas up to which starts lie."""
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
_SAME = 1.0
"""Joint sigmas up to which two ends are of one minimum."""
_STEPS = 4
"""In which other unknowns settle, and after which it is seen whether a start ends in a known minimum."""
_ROUGH = SolverSettings(cost_tolerance=1e-7, step_tolerance=1e-2, max_iterations=_STEPS)
"""How exactly starts are followed until they are seen to end in a new minimum."""
_TURNS = 25
"""Times so many steps, within which a start is to end."""
_ROUNDS = 3
"""Times that blunders are sought anew about a lower minimum."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Record):
    """One place at which the terrain model fits."""

    weight: float
    """Probability."""
    cost: float
    """There."""
    shift: Array
    """(w,) m and rad, of the terrain model's unknowns (`Surface.terms`)."""
    spread: Array
    """(w, w) m and rad squared, their covariance about it, for sigma0 = 1."""
    starts: int
    """Starts that ended there, the first one among them."""


@dataclass(frozen=True, slots=True, eq=False)
class Minima(Record):
    """What starts over a terrain model's shift have found."""

    starts: int
    """Starts besides the first one."""
    lost: int
    """Of these, how many came to no end."""
    each: tuple[Minimum, ...]
    """Minima, the solution first, then by their weight."""

    @property
    def several(self) -> bool:
        """Whether there is another that is worth a word: by its probability, or by what it does to the sigmas."""
        first = self.each[0]
        wider = np.diag(self.spread(first.shift))[:2] > _WIDER * np.diag(first.spread)[:2]
        return bool(np.any(wider)) or any(one.weight > WORTH for one in self.each[1:])

    @property
    def mean(self) -> Array:
        """(w,) m and rad, mean of the terrain model's unknowns over the mixture."""
        return np.asarray(sum(one.weight * one.shift for one in self.each))

    @property
    def covariance(self) -> Array:
        """(w, w) of these about it."""
        return self.spread(self.mean)

    def spread(self, about: Array) -> Array:
        """(w, w) mean squares of the terrain model's unknowns about some values (w,)."""
        apart = [one.shift - about for one in self.each]
        parts = (one.weight * (one.spread + np.outer(d, d)) for one, d in zip(self.each, apart, strict=True))
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
        apart = state - self.solved.orientation
        near = float(apart @ np.linalg.solve(self.covariance, apart)) < _SAME**2 * self.unit
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
        Where blunders are sought, they are sought anew about a lower minimum.
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
        ends, lost = _ends(solved, settings, before, count, sweeper)
        best = min(ends, key=lambda one: one.solved.outcome.cost_final)
        if best.solved is solved or settings.reject == 0.0 or turn == _ROUNDS - 1:
            break
        begin, history = best.solved.orientation, best.solved.history
        solved = solve_in_rounds(best.solved.layout, settings, solved.selection, before, no_progress, sweeper, begin)
        solved = replace(solved, history=history + solved.history)
    found = _weighted(ends, best)
    minima = Minima(count, lost, tuple(_record(end, weight) for end, weight in found))
    lowest = replace(
        best.solved, cost_initial=initial, rounds=solved.rounds, circling=solved.circling,
        dimensions=solved.dimensions,
    )  # fmt: skip
    return lowest, minima, _mixture(found) if minima.several else None


def _ends(
    solved: Solved, settings: SolverSettings, before: Reduction, count: int, sweeper: Sweeper
) -> tuple[list[_End], int]:
    """Minima to which starts lead, the first one first; and how many starts came to no end."""
    ends, lost = [_end(solved, sweeper)], 0
    for begin in _begins(ends[0], count, sweeper):
        try:
            state, cost = _descended(ends, begin, sweeper)
            home, one = _home(ends, state, cost), solved
            if home is None:
                one = solve_in_rounds(
                    solved.layout, replace(settings, reject=0.0), solved.selection, before, no_progress, sweeper, state
                )
                home = _home(ends, one.orientation, one.outcome.cost_final)
            if home is not None:
                ends[home] = replace(ends[home], starts=ends[home].starts + 1)
            elif one.outcome.converged and math.isfinite((end := _end(one, sweeper)).logarithm):
                ends.append(replace(end, solved=replace(one, history=solved.history + one.history)))
            else:
                lost += 1
        except MgsgraphError:  # no finite cost there, or a network that is too weak there
            lost += 1
    return ends, lost


def _descended(ends: Sequence[_End], begin: Array, sweeper: Sweeper) -> tuple[Array, float]:
    """Where a start leads, roughly, until it is seen to be in a known minimum: shared unknowns, and cost."""
    first = ends[0].solved
    problem = BundleProblem(BundleGraph(first.layout, first.rows, sweeper))
    rough = replace(_ROUGH, step_tolerance=min(_ROUGH.step_tolerance * math.sqrt(ends[0].unit), 0.5))
    for _ in range(_TURNS):
        found = levenberg_marquardt(problem, begin, rough, no_progress)
        begin = found.state
        if found.converged or _home(ends, begin, found.cost_final) is not None:
            break
    return begin, found.cost_final


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
    mine = slice(_terrain(layout).start, _terrain(layout).start + 2)
    follows = np.linalg.solve(end.covariance[mine, mine], end.covariance[mine])
    graph, held = BundleGraph(layout, solved.rows, sweeper), np.eye(layout.columns)[:, mine]
    for move in (wanted - solved.orientation[mine]) @ follows:
        known = graph.reduction(solved.orientation + move, SYSTEM, solved.points)
        begin = known.orientation
        if math.isfinite(known.cost):
            # what can't be settled so begins where it is
            with suppress(MgsgraphError):
                begin = levenberg_marquardt(HeldProblem(graph, held, known), begin, _ROUGH, no_progress).state
        yield begin


def _end(solved: Solved, sweeper: Sweeper) -> _End:
    layout, rows = solved.layout, solved.rows
    graph = BundleGraph(layout, rows, sweeper)
    covariance = orientation_covariance(graph, solved.reduction).dense()
    nothing = np.zeros(layout.blocks.target.size)
    own = sweeper.covariances(layout, rows, solved.orientation, nothing, solved.points)
    free = (rows.kind != FIXED) & (rows.kind != OUT)
    scaled = covariance / layout.scales / layout.scales[:, None]
    logarithm = np.linalg.slogdet(scaled)[1] + np.sum(np.linalg.slogdet(own[free])[1])
    return _End(solved, covariance, 0.5 * float(logarithm) - solved.outcome.cost_final, _unit(solved, sweeper))


def _unit(solved: Solved, sweeper: Sweeper) -> float:
    """Squared sigma of the fit, 1 or more: where blunders are in, minima are as much wider."""
    found = residuals(solved.layout, solved.orientation, solved.points, sweeper)
    return max(1.0, fit(solved.layout, solved.rows, solved.orientation, solved.points, found).sigma0 ** 2)


def _weighted(ends: Sequence[_End], best: _End) -> list[tuple[_End, float]]:
    """Minima with their probabilities, the lowest first, then by these."""
    logarithms = np.array([end.logarithm for end in ends])
    weights = np.exp(logarithms - logarithms.max())
    every = zip(ends, (weights / weights.sum()).tolist(), strict=True)
    return sorted(every, key=lambda one: (one[0] is not best, -one[1]))


def _record(end: _End, weight: float) -> Minimum:
    mine = _terrain(end.solved.layout)
    shift, spread = end.solved.orientation[mine].copy(), end.covariance[mine, mine].copy()
    return Minimum(weight, end.solved.outcome.cost_final, shift, spread, end.starts)


def _mixture(found: Sequence[tuple[_End, float]]) -> JointCovariance:
    """Mean squares of the shared unknowns about the first one."""
    best = found[0][0].solved
    apart = [end.solved.orientation - best.orientation for end, _ in found]
    parts = (weight * (end.covariance + np.outer(d, d)) for (end, weight), d in zip(found, apart, strict=True))
    variables, scales = best.layout.variables, best.layout.scales
    members = variables.adjusted()
    columns = np.concatenate([np.arange(*variables.columns_of(v).indices(scales.size)) for v in members])
    whole = np.asarray(sum(parts))[np.ix_(columns, columns)] / scales[columns] / scales[columns][:, None]
    root = np.linalg.cholesky(np.linalg.inv(whole)).T / scales[columns]
    return joint_covariance(in_cliques(variables.first, variables.width, [members], [root]))
