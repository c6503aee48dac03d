"""Levenberg-Marquardt over the reduced equations of the bundle form, and the last steps to a stationary point.

The damping is Levenberg's in whitened units: a weak extra prior on the step, in the variables' own scales (a-priori
sigmas), so that meters and radians count the same. A trial step costs one sweep of the kernel, which also returns the
next linear system; after a rejected step the cost alone. Near the optimum, where the normal matrix hardly changes, its
factor is kept and only the gradient is recomputed (simplified Newton method; Ortega & Rheinboldt 1970, ch. 7) as long
as steps become shorter by a factor of ten, or of three where the factor takes longer than a sweep. The loop is Python,
the work is in the kernel and in LAPACK.

Surfaces on which points lie are curved: near the optimum Gauss-Newton steps become shorter by about the same share
each, or even longer, in the few directions that depend on the relief, and they gain less than the cost's rounding. The
same holds for points with nearly parallel rays: the linear model has only a part of the curvature of their distance.
The curvature seen in the last few steps corrects the linear model: the limited-memory method of Broyden, Fletcher,
Goldfarb and Shanno (Nocedal 1980), from the inverse of the normal matrix, whose factor is kept.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.forms import BundleGraph, Solving
from mgsgraph.adjustment.settings import Iteration, Progress, SolverSettings
from mgsgraph.adjustment.sparse_cholesky import NotDefinite
from mgsgraph.errors import Unsolvable
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM, Reduction

_FIRST_DAMPING = 1e-8
LEAST_DAMPING = 1e-12
_MOST_DAMPING = 1e8
_EASE, _TIGHTEN = 0.1, 10.0
_ROUNDING = 1e-11
"""Share of the cost by which it may seem to rise: the rounding of body-fixed meters in the residuals."""
_NEAR = 1e-8
"""Share up to which a rise may come from the starts of the inner solves, and is computed again."""
_LONG = 2e4
"""Multiplications of a factor for each observation from which on it takes longer than a sweep."""
_SLOWER = 0.5
"""Least length of a step, in lengths of the step before, of slow convergence."""
_SLOW_STEPS = 3
"""Number of such steps, one after the other."""
_FAR = 0.1
"""Share of the cost: where a step gains more, points need not be solved to their last digits."""
EARLY = 1e-7
"""Share of the cost: a step that gains less is some thousandths of a sigma long, near enough for the final steps."""
_REMEDY = "look for blunders (reject), or try another loss"
_SLOW = f"Converged to where a step promises to lower the cost by no more than {EARLY:.0e} of it, slowly."
_STUCK = f"Stopped: no step lowers the cost although the linear model promises it; {_REMEDY}."


class Keeping(NamedTuple):
    """Steps that leave the normal matrix as it is."""

    gain: float
    """Largest predicted gain, as a share of the cost."""
    length: float
    """Largest length, in lengths of the step before: where convergence is slower, or steps are damped, keeping the
    matrix would cost more sweeps than it saves."""


KEEPING = Keeping(1e-5, 0.1)
"""Rows then change by less than some thousandths of their sigma on average."""
KEEPING_LONGER = Keeping(1e-2, 0.3)
"""Where the factor takes longer than a sweep: steps with a matrix that is nearly the same are a few more, and cheap."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """End of an optimization."""

    state: Array
    """(columns,) m and rad, the optimum."""
    cost_initial: float
    """Cost of the start."""
    cost_final: float
    """Cost of the optimum."""
    converged: bool
    """Whether it converged."""
    message: str
    """Why it stopped, and what to do if it did not converge."""
    history: tuple[Iteration, ...]
    """Every step tried."""
    slow: bool = False
    """Whether near the optimum steps became shorter by small shares alone."""


class ReducedEquations:
    """Normal equations of the shared unknowns, damped in units of their scales.

    With the factor of `factored`, the matrix is that of another state; the gradient is that of the reduction.
    """

    def __init__(self, graph: BundleGraph, reduction: Reduction, factored: "ReducedEquations | None" = None) -> None:
        self._graph, self._reduction, self.gradient = graph, reduction, graph.gradient(reduction)
        self._damping, self._inverse_squares = 0.0, graph.layout.scales**-2.0
        self._factor: Solving | None = None
        self.kept = factored is not None
        if factored is not None:
            self._factor, self._damping = factored._factor, factored._damping

    def step(self, damping: float) -> Array | None:
        """Solution of the damped equations; None when they are not positive definite."""
        if self._factor is None or damping != self._damping:
            assert self._reduction.task == SYSTEM, "a kept factor has the damping that it was made with"
            try:
                self._factor = self._graph.sweeper.factor(self._graph.layout, self._reduction, damping)
                self._damping = damping
            except NotDefinite:
                return None
        return self._factor.solve(-self.gradient)

    def slope(self, step: Array) -> float:
        """Minus gradient times step."""
        return -float(self.gradient @ step)

    def gain(self, step: Array) -> float:
        """Of a step that solves the equations with the damping asked for last: (N + damping) step = -gradient."""
        return 0.5 * (self.slope(step) + self._damping * float(step @ (self._inverse_squares * step)))


class BundleProblem:
    """The bundle form; its state is the orientation vector (columns,). Each sweep begins where the last one ended."""

    def __init__(self, graph: BundleGraph, reduction: Reduction | None = None) -> None:
        self.graph, self.adjusts = graph, graph.layout.columns > 0
        self._last = reduction

    @property
    def keeping(self) -> Keeping:
        """Steps after which the matrix is kept."""
        long = self.graph.layout.cholesky.operations > _LONG * self.graph.rows.weight.shape[1]
        return KEEPING_LONGER if long else KEEPING

    def at(self, state: Array, task: int, rough: bool = False) -> Reduction:
        """All points solved (and eliminated) at a state."""
        last = self._last
        if last is None or not last.serves(state, task):
            begin = last if last is not None and np.isfinite(last.cost) else None
            self._last = last = self.graph.reduction(state, task, begin, rough)
        return last

    def cost(self, state: Array, task: int, rough: bool = False) -> float:
        """Cost of all points and of the priors at a state (columns,); the sweep of `task` is kept for `linear`."""
        return self.graph.cost(self.at(state, task, rough))

    def exact_cost(self, state: Array) -> float:
        """Full cost, all points solved from their first places."""
        return self.graph.cost(self.graph.reduction(state, COSTS))

    def linear(self, state: Array, factored: ReducedEquations | None = None) -> ReducedEquations:
        """Normal equations at a state (columns,), with the factor of `factored` where it is given."""
        return ReducedEquations(self.graph, self.at(state, SYSTEM if factored is None else GRADIENT), factored)


class HeldEquations(ReducedEquations):
    """Normal equations whose steps leave directions A (columns, m) as they are: with N dx = -g the step is

    dx = -N^-1 (g + A k),    A' dx = 0:    dx = s - N^-1 A (A' N^-1 A)^-1 A' s,    s = -N^-1 g.
    """

    def __init__(
        self, graph: BundleGraph, reduction: Reduction, directions: Array, factored: "HeldEquations | None" = None
    ) -> None:
        super().__init__(graph, reduction, factored)
        self._directions = directions
        self._through: tuple[Solving, Array] | None = None if factored is None else factored._through

    def step(self, damping: float) -> Array | None:
        """Solution of the damped equations; None when they are not positive definite."""
        free, held = super().step(damping), self._directions
        if free is None:
            return None
        assert self._factor is not None
        if self._through is None or self._through[0] is not self._factor:
            self._through = self._factor, np.stack([self._factor.solve(direction) for direction in held.T], axis=1)
        through = self._through[1]
        return np.asarray(free - through @ np.linalg.solve(held.T @ through, held.T @ free))


class HeldProblem(BundleProblem):
    """The bundle form with directions (columns, m) of its state held."""

    def __init__(self, graph: BundleGraph, directions: Array, reduction: Reduction) -> None:
        super().__init__(graph, reduction)
        self._directions = directions

    def linear(self, state: Array, factored: ReducedEquations | None = None) -> HeldEquations:
        """Normal equations at a state (columns,), with the factor of `factored` where it is given."""
        assert factored is None or isinstance(factored, HeldEquations)
        reduction = self.at(state, SYSTEM if factored is None else GRADIENT)
        return HeldEquations(self.graph, reduction, self._directions, factored)


def levenberg_marquardt(
    problem: BundleProblem,
    start: Array,
    settings: SolverSettings,
    progress: Progress,
    unless_slow: bool = False,
) -> Outcome:
    """Minimise a problem's cost.

    Parameters
    ----------
    problem : BundleProblem
    start : (columns,)
        Where to begin.
    settings : SolverSettings
        Tolerances and the most iterations.
    progress : callable
        Called after every step tried.
    unless_slow : bool
        Whether to stop near the optimum where steps become shorter by small shares alone (`Outcome.slow`).

    Raises
    ------
    Unsolvable
        When the start has no finite cost or the linear system can't be solved at any damping.
    """
    state, cost = start, problem.cost(start, SYSTEM)
    initial, history = cost, list[Iteration]()
    if not math.isfinite(cost):
        message = "the starting values have no finite cost; check that all points lie before their cameras"
        raise Unsolvable(message, start)
    if not problem.adjusts:
        return Outcome(state, cost, cost, True, "Nothing to adjust: every image is held.", ())
    damping, rejected, before = _FIRST_DAMPING, 0, math.inf
    linear, keeping = problem.linear(state), problem.keeping
    for number in range(1, settings.max_iterations + 1):
        linear, step, damping = _solved(problem, state, linear, damping, keeping.length * before)
        predicted, length = linear.gain(step), step_length(linear, step)
        keep = rejected == 0 and damping <= _FIRST_DAMPING and length <= keeping.length * before
        keep = keep and predicted <= keeping.gain * cost and not _last(predicted, length, cost, settings)
        trial = state + step
        rough = rejected == 0 and predicted > _FAR * cost
        new = problem.cost(trial, COSTS if rejected else GRADIENT if keep else SYSTEM, rough)
        accepted = _lower(problem, state, trial, cost, new, predicted)
        now = Iteration(number, new, cost - new, predicted, length, damping, accepted)
        history.append(now)
        progress(now)
        last = length < settings.step_tolerance or min(predicted, abs(cost - new)) <= settings.cost_tolerance * cost
        if accepted:
            state, cost, before = trial, new, length
        if last:
            return Outcome(state, initial, cost, True, _converged(now, settings), tuple(history))
        if unless_slow and _slow(history):
            return Outcome(state, initial, cost, True, _SLOW, tuple(history), slow=True)
        if accepted and keep:
            linear = problem.linear(state, linear)
        elif accepted:
            damping, rejected = max(damping * _EASE, LEAST_DAMPING), 0
            linear = problem.linear(state)
        elif linear.kept:  # the fault may be the matrix's
            linear = problem.linear(state)
        else:
            rejected += 1
            damping *= _TIGHTEN**rejected
            if damping > _MOST_DAMPING:
                return Outcome(state, initial, cost, False, _STUCK, tuple(history))
    limit = settings.max_iterations
    message = f"Stopped after {limit} iterations without converging; raise max_iterations or {_REMEDY}."
    return Outcome(state, initial, cost, False, message, tuple(history))


def _solved(
    problem: BundleProblem, state: Array, linear: ReducedEquations, damping: float, longest: float
) -> tuple[ReducedEquations, Array, float]:
    """A step, the linear system that it solves, and the least damping from `damping` on at which that can be solved.

    A kept matrix is recomputed where its step is longer than `longest` (posterior sigmas).
    """
    while (step := linear.step(damping)) is None or (linear.kept and step_length(linear, step) > longest):
        if step is not None:
            linear = problem.linear(state)
        elif (damping := damping * _TIGHTEN**2) > _MOST_DAMPING:
            raise Unsolvable("normal equations that no damping makes solvable; the network is underdetermined", state)
    return linear, step, damping


def step_length(linear: ReducedEquations, step: Array) -> float:
    """Length of a step in posterior sigmas."""
    return math.sqrt(max(linear.slope(step), 0.0))


def _last(predicted: float, length: float, cost: float, settings: SolverSettings) -> bool:
    """Whether a step will be the last one: the posterior needs its own matrix."""
    return predicted <= settings.cost_tolerance * cost or length < settings.step_tolerance


def _slow(history: list[Iteration]) -> bool:
    """Whether the last steps, near the optimum, became shorter by small shares alone: some direction has a curvature
    that the linear model overestimates.
    """
    last = history[-_SLOW_STEPS - 1 :]
    near = all(s.accepted and s.predicted <= EARLY * s.cost and s.damping <= _FIRST_DAMPING for s in last)
    return len(last) > _SLOW_STEPS and near and all(b.step > _SLOWER * a.step for a, b in pairwise(last))


def _lower(problem: BundleProblem, state: Array, trial: Array, cost: float, new: float, predicted: float) -> bool:
    """Whether a trial's cost is lower or equal up to rounding; a slightly higher one is computed again, exactly."""
    if not math.isfinite(new) or new > cost * (1.0 + _NEAR):
        return False
    if new <= cost * (1.0 + _ROUNDING) or predicted <= _ROUNDING * cost:
        return True
    return problem.exact_cost(trial) <= problem.exact_cost(state) * (1.0 + _ROUNDING)


def _converged(last: Iteration, settings: SolverSettings) -> str:
    if last.step < settings.step_tolerance:
        return f"Converged: the last step was {last.step:.1e} posterior sigmas long."
    return f"Converged: the last step would lower the cost by no more than {settings.cost_tolerance:.0e} of it."


_DEPTH = 10
"""Number of steps whose curvature is used."""
_MOST = 60
"""Most final steps."""
_GRADIENT_ROUNDING = 1e-14
"""Share of the cost below which gradients of many points are rounding."""
_FARTHEST = 30.0
"""Largest length of a later step, in lengths of the first one, or in posterior sigmas where that is below one."""


class _Pair(NamedTuple):
    """The curvature along a step; all (columns,)."""

    step: Array
    """The step."""
    slope: Array
    """Change of the gradient by it."""
    solved: Array
    """The same, the normal equations solved for it."""


def settled_minimum(
    problem: BundleProblem,
    start: Array,
    settings: SolverSettings,
    progress: Progress,
) -> Outcome:
    """Minimize a cost whose rounding hides the last steps, and take the final steps (`with_final_steps`): from the
    state where the cost hardly falls any more or, if they do not converge from there, from the one where it does not.
    """
    early = replace(settings, cost_tolerance=max(settings.cost_tolerance, EARLY))
    outcome_early = levenberg_marquardt(problem, start, early, progress)
    outcome = with_final_steps(problem, outcome_early, settings, progress)
    if outcome.converged or not outcome_early.converged:
        return outcome
    return with_final_steps(problem, _further(problem, outcome_early, settings, progress), settings, progress)


def minimum(
    problem: BundleProblem,
    start: Array,
    settings: SolverSettings,
    progress: Progress,
    slow: bool,
) -> Outcome:
    """Minimize a problem's cost; take the final steps where steps become shorter by small shares only (`slow`: known to
    be so). Where the final steps do not converge, continue without them.
    """
    if slow:
        return replace(settled_minimum(problem, start, _in_rounding(problem, start, settings), progress), slow=True)
    outcome_plain = levenberg_marquardt(problem, start, settings, progress, unless_slow=True)
    if not outcome_plain.slow:
        return outcome_plain
    outcome = with_final_steps(problem, outcome_plain, _in_rounding(problem, outcome_plain.state, settings), progress)
    return outcome if outcome.converged else replace(_further(problem, outcome_plain, settings, progress), slow=True)


def _further(
    problem: BundleProblem, before: Outcome, settings: SolverSettings, progress: Progress
) -> Outcome:
    """An outcome from where another one ended."""
    tried = levenberg_marquardt(problem, before.state, settings, progress)
    later = tuple(replace(step, number=step.number + len(before.history)) for step in tried.history)
    return replace(tried, cost_initial=before.cost_initial, history=before.history + later)


def _in_rounding(problem: BundleProblem, state: Array, settings: SolverSettings) -> SolverSettings:
    """Settings with a step tolerance whose gain is a cost's rounding, where that is longer."""
    rounding = math.sqrt(2.0 * _GRADIENT_ROUNDING * problem.cost(state, SYSTEM))
    return replace(settings, step_tolerance=max(settings.step_tolerance, min(rounding, 0.1)))


def with_final_steps(
    problem: BundleProblem,
    outcome: Outcome,
    settings: SolverSettings,
    progress: Progress,
) -> Outcome:
    """An outcome that has converged by its cost, continued until a step is shorter than the step tolerance.

    Parameters
    ----------
    problem : BundleProblem
    outcome : Outcome
    settings : SolverSettings
    progress : callable
        Called after every step.

    Returns
    -------
    Outcome
        Not converged where steps don't become short enough; then the state is that found.
    """
    if not outcome.converged or not problem.adjusts:
        return outcome
    state, cost, history = outcome.state, outcome.cost_final, list(outcome.history)
    matrix = linear = problem.linear(state)
    plain, pairs, farthest = linear.step(LEAST_DAMPING), list[_Pair](), math.inf
    for _ in range(_MOST):
        if plain is None:
            break
        step = _corrected(linear.gradient, plain, pairs)
        length = step_length(linear, step)
        if not length <= farthest:
            break
        farthest = min(farthest, _FARTHEST * max(length, settings.step_tolerance))
        now = Iteration(len(history) + 1, cost, 0.0, 0.5 * length**2, length, LEAST_DAMPING, True)
        history.append(now)
        progress(now)
        if length < settings.step_tolerance:
            if cost > outcome.cost_final * (1.0 + EARLY):  # another stationary point than the minimum
                break
            message = f"Converged: the last step was {length:.1e} posterior sigmas long."
            return replace(outcome, state=state, cost_final=cost, message=message, history=tuple(history))
        state = state + step
        cost = problem.cost(state, GRADIENT)
        if not math.isfinite(cost):
            break
        before, longer = linear.gradient, plain
        linear = problem.linear(state, matrix)
        plain = linear.step(LEAST_DAMPING)
        if plain is not None:
            pairs = [*pairs, _Pair(step, linear.gradient - before, longer - plain)][-_DEPTH:]
    message = "Stopped: near the optimum steps do not become short enough; look for blunders (reject)."
    return replace(outcome, converged=False, message=message, history=tuple(history))


def _corrected(gradient: Array, plain: Array, pairs: Sequence[_Pair]) -> Array:
    """A linear model's step (columns,), corrected by the curvature along earlier steps."""
    useful = [pair for pair in pairs if pair.step @ pair.slope > 0.0]  # elsewhere the cost bends downward
    remainder, shares = gradient, list[float]()
    for pair in reversed(useful):
        shares.append(float(pair.step @ remainder) / float(pair.step @ pair.slope))
        remainder = remainder - shares[-1] * pair.slope
    corrected = plain + sum(share * pair.solved for share, pair in zip(shares, reversed(useful), strict=True))
    for share, pair in zip(reversed(shares), useful, strict=True):
        corrected = corrected - (share + float(pair.slope @ corrected) / float(pair.step @ pair.slope)) * pair.step
    return corrected


def solve_bundle(
    graph: BundleGraph,
    start: Array,
    reduction: Reduction | None,
    settings: SolverSettings,
    progress: Progress,
    slow: bool = False,
) -> tuple[Outcome, Reduction]:
    """Solve from an orientation vector (columns,); the reduction at the optimum comes with it. `slow` says that an
    earlier pass converged slowly.
    """
    problem = BundleProblem(graph, reduction)
    if graph.layout.network.on_relief:
        outcome = settled_minimum(problem, start, settings, progress)
    else:
        outcome = minimum(problem, start, settings, progress, slow)
    return outcome, problem.at(outcome.state, SYSTEM)
