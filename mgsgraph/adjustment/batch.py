"""Levenberg-Marquardt over a factor graph of either form, and the last steps to a stationary point.

The damping is Levenberg's in whitened units: a weak extra prior on the step, in the variables' own scales (a-priori
sigmas), so that metres and radians are treated alike. A trial step costs one sweep of the kernel, which brings the
next linear system with it; after a rejected step the cost alone. Near the optimum, where the normal matrix hardly
changes, its factor is kept and only the gradient is renewed (simplified Newton method; Ortega & Rheinboldt 1970, ch. 7)
as long as steps become shorter by a factor of ten. The loop is Python, the work is in the kernel, in LAPACK and in
GTSAM.

Relief on which points lie curves: near the optimum Gauss-Newton steps become shorter by about the same share each, or
even longer, in the few directions that rest on the relief, and what they gain is less than the cost's rounding. Points
whose rays are nearly parallel do the same: their distance has a curvature of which the linear model sees a part.
What the last few steps have shown of the true curvature corrects the linear model's: the method of Broyden, Fletcher,
Goldfarb and Shanno with a limited memory (Nocedal 1980), from the inverse of the normal matrix, whose factor is kept.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import Unsolvable
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import COSTS, GRADIENT, SYSTEM
from mgsgraph.record import Record

State = TypeVar("State")
Step = TypeVar("Step")

_FIRST_DAMPING = 1e-8
LEAST_DAMPING = 1e-12
_MOST_DAMPING = 1e8
_EASE, _TIGHTEN = 0.1, 10.0
_ROUNDING = 1e-11
"""Share of the cost by which it may seem to rise: body-fixed metres leave that much rounding in the residuals."""
_NEAR = 1e-8
"""Share up to which a rise may come from where the inner solves began, and is looked at again."""
_KEEP = 1e-5
"""Share of the cost that a step promises to gain, up to which the matrix counts as the same after it: rows then change
by less than some thousandths of their sigma on average."""
_SHORTER = 0.1
"""Of the step before, the most that a step may be long for its matrix to be kept: where convergence is slower, or steps
are damped, keeping it would cost more sweeps than it saves."""
_SLOWER = 0.5
"""Of the step before, the least that a step is long where convergence counts as slow."""
_SLOW_STEPS = 3
"""So many of them, one after the other."""
EARLY = 1e-7
"""Share of the cost: a step that gains less is some thousandths of a sigma long, near enough to settle."""
_REMEDY = "look for blunders (reject), or try another loss"
_SLOW = f"Converged to where a step promises to lower the cost by no more than {EARLY:.0e} of it, slowly."
_STUCK = f"Stopped: no step lowers the cost although the linear model promises it; {_REMEDY}."


@dataclass(frozen=True, slots=True)
class Iteration(Record):
    """One step that was tried.

    Examples
    --------
    >>> first = solution.history[0]
    >>> first.number, first.accepted, round(first.cost, 1)
    (1, True, 44.9)
    """

    number: int
    """Counted from 1."""
    cost: float
    """Half the weighted sum of squares (or of the loss) after the step."""
    decrease: float
    """Cost before minus cost after."""
    predicted: float
    """Decrease that the linear model promised."""
    step: float
    """Length of the step in posterior sigmas: the square root of minus gradient times step."""
    damping: float
    """Levenberg-Marquardt damping, in inverse squared scales."""
    accepted: bool
    """Whether the step was taken."""


@dataclass(frozen=True, eq=False)
class Outcome(Generic[State]):
    """How an optimisation ended."""

    state: State
    """The optimum."""
    cost_initial: float
    """Cost of the start."""
    cost_final: float
    """Cost of the optimum."""
    converged: bool
    """Whether it stopped because nothing more was to be gained."""
    message: str
    """Why it stopped, and what to do where that is not well."""
    history: tuple[Iteration, ...]
    """Every step tried."""
    slow: bool = False
    """Whether near the optimum steps became shorter by small shares alone."""


class LinearSystem(Protocol[Step]):
    """Normal equations at a state."""

    kept: bool
    """Whether their matrix is that of another state."""
    gradient: Any
    """Of the cost; of a state that is a vector (columns,)."""

    def step(self, damping: float) -> Step | None:
        """Solution of the damped equations; None when they are not positive definite."""
        ...

    def slope(self, step: Step) -> float:
        """Minus gradient times step."""
        ...

    def gain(self, step: Step) -> float:
        """Decrease of the cost that the linear model promises of a step."""
        ...


class Problem(Protocol[State]):
    """What is minimised: a cost, and a linear system at a state."""

    adjusts: bool
    """Whether there is anything to adjust."""

    def cost(self, state: State, task: int) -> float:
        """Full cost; `task` (kernel.sweep.COSTS, GRADIENT or SYSTEM) says what will probably be wanted next."""
        ...

    def exact_cost(self, state: State) -> float:
        """The same without any help from earlier calls."""
        ...

    def linear(self, state: State, kept: Any = None) -> LinearSystem[Any]:
        """Linear system at a state whose cost is known; its matrix may be that of the system `kept`."""
        ...

    def moved(self, state: State, step: Any) -> State:
        """The state after a step."""
        ...


def levenberg_marquardt(
    problem: Problem[State],
    start: State,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
    unless_slow: bool = False,
) -> Outcome[State]:
    """Minimise a problem's cost.

    Parameters
    ----------
    problem : Problem
    start
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
        said = "the starting values have no finite cost; check that all points lie before their cameras"
        raise Unsolvable(said, start)
    if not problem.adjusts:
        return Outcome(state, cost, cost, True, "Nothing to adjust: every image is held.", ())
    damping, rejected, before = _FIRST_DAMPING, 0, math.inf
    linear = problem.linear(state)
    for number in range(1, settings.max_iterations + 1):
        linear, step, damping = _solved(problem, state, linear, damping, _SHORTER * before)
        predicted, length = linear.gain(step), step_length(linear, step)
        keep = rejected == 0 and damping <= _FIRST_DAMPING and length <= _SHORTER * before
        keep = keep and _near(predicted, length, cost, settings)
        trial = problem.moved(state, step)
        new = problem.cost(trial, COSTS if rejected else GRADIENT if keep else SYSTEM)
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
    problem: Problem[State], state: State, linear: LinearSystem[Any], damping: float, longest: float
) -> tuple[LinearSystem[Any], Any, float]:
    """A step, the linear system that it solves, and the least damping from `damping` on at which that can be solved.

    A kept matrix is renewed where its step is longer than `longest` (posterior sigmas).
    """
    while (step := linear.step(damping)) is None or (linear.kept and step_length(linear, step) > longest):
        if step is not None:
            linear = problem.linear(state)
        elif (damping := damping * _TIGHTEN**2) > _MOST_DAMPING:
            raise Unsolvable("the normal equations can't be solved at any damping; the network is too weak", state)
    return linear, step, damping


def step_length(linear: LinearSystem[Any], step: Any) -> float:
    """Length of a step in posterior sigmas."""
    return math.sqrt(max(linear.slope(step), 0.0))


def _near(predicted: float, length: float, cost: float, settings: SolverSettings) -> bool:
    """Whether a step will hardly change the matrix, and is not the last one: the posterior wants its own matrix."""
    last = predicted <= settings.cost_tolerance * cost or length < settings.step_tolerance
    return predicted <= _KEEP * cost and not last


def _slow(history: list[Iteration]) -> bool:
    """Whether the last steps, near the optimum, became shorter by small shares alone: some direction has a curvature
    that the linear model overestimates.
    """
    last = history[-_SLOW_STEPS - 1 :]
    near = all(one.accepted and one.predicted <= EARLY * one.cost and one.damping <= _FIRST_DAMPING for one in last)
    return len(last) > _SLOW_STEPS and near and all(b.step > _SLOWER * a.step for a, b in pairwise(last))


def _lower(problem: Problem[State], state: State, trial: State, cost: float, new: float, predicted: float) -> bool:
    """Whether a trial's cost is no higher, or can't be told from it: a near miss is looked at again, exactly."""
    if not math.isfinite(new) or new > cost * (1.0 + _NEAR):
        return False
    if new <= cost * (1.0 + _ROUNDING) or predicted <= _ROUNDING * cost:
        return True
    return problem.exact_cost(trial) <= problem.exact_cost(state) * (1.0 + _ROUNDING)


def _converged(last: Iteration, settings: SolverSettings) -> str:
    if last.step < settings.step_tolerance:
        return f"Converged: the last step was {last.step:.1e} posterior sigmas long."
    return f"Converged: the last step promised to lower the cost by no more than {settings.cost_tolerance:.0e} of it."


_DEPTH = 10
"""Steps whose curvature is remembered."""
_MOST = 60
"""Steps after which it counts as not at rest."""
_GRADIENT_ROUNDING = 1e-14
"""Share of the cost below which gradients of many points are rounding."""
_FARTHEST = 30.0
"""Times the first step's length, or posterior sigmas where that is less than one, that a later one may be."""


class _Pair(NamedTuple):
    """What a step has shown of the curvature; all (columns,)."""

    step: Array
    """That was taken."""
    slope: Array
    """By which it changed the gradient."""
    solved: Array
    """The same, the normal equations solved for it."""


def settled_minimum(
    problem: Problem[Array],
    start: Array,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
) -> Outcome[Array]:
    """Minimise a problem's cost, too rough near the optimum to tell one step from another, and settle (`settled`): from
    where it hardly falls any more, or should steps not settle from there, from where it doesn't.
    """
    early = replace(settings, cost_tolerance=max(settings.cost_tolerance, EARLY))
    found = levenberg_marquardt(problem, start, early, progress)
    outcome = settled(problem, found, settings, progress)
    if outcome.converged or not found.converged:
        return outcome
    return settled(problem, _further(problem, found, settings, progress), settings, progress)


def minimum(
    problem: Problem[Array],
    start: Array,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
    slow: bool,
) -> Outcome[Array]:
    """Minimise a problem's cost; settle where steps become shorter by small shares alone, as (`slow`) they are known to
    do. Where they don't settle, they are taken one by one.
    """
    if slow:
        return replace(settled_minimum(problem, start, _at_rest(problem, start, settings), progress), slow=True)
    found = levenberg_marquardt(problem, start, settings, progress, unless_slow=True)
    if not found.slow:
        return found
    outcome = settled(problem, found, _at_rest(problem, found.state, settings), progress)
    return outcome if outcome.converged else replace(_further(problem, found, settings, progress), slow=True)


def _further(
    problem: Problem[Array], found: Outcome[Array], settings: SolverSettings, progress: Callable[[Iteration], None]
) -> Outcome[Array]:
    """An outcome from where another one ended."""
    tried = levenberg_marquardt(problem, found.state, settings, progress)
    later = tuple(replace(one, number=one.number + len(found.history)) for one in tried.history)
    return replace(tried, cost_initial=found.cost_initial, history=found.history + later)


def _at_rest(problem: Problem[Array], state: Array, settings: SolverSettings) -> SolverSettings:
    """Settings with steps so long that what they gain can't be told from a cost's rounding, where those are longer."""
    rounding = math.sqrt(2.0 * _GRADIENT_ROUNDING * problem.cost(state, SYSTEM))
    return replace(settings, step_tolerance=max(settings.step_tolerance, min(rounding, 0.1)))


def settled(
    problem: Problem[Array],
    found: Outcome[Array],
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
) -> Outcome[Array]:
    """An outcome that is converged by its cost, brought to where a step is shorter than the step tolerance.

    Parameters
    ----------
    problem : Problem
        Whose state is a vector (columns,).
    found : Outcome
    settings : SolverSettings
    progress : callable
        Called after every step.

    Returns
    -------
    Outcome
        Not converged where steps don't become short enough; then the state is that found.
    """
    if not found.converged or not problem.adjusts:
        return found
    state, cost, history = found.state, found.cost_final, list(found.history)
    matrix = linear = problem.linear(state)
    plain, pairs, farthest = linear.step(LEAST_DAMPING), list[_Pair](), math.inf
    for _ in range(_MOST):
        step = None if plain is None else _corrected(linear.gradient, plain, pairs)
        length = math.inf if step is None else step_length(linear, step)
        if step is None or not length <= farthest:
            break
        farthest = min(farthest, _FARTHEST * max(length, settings.step_tolerance))
        now = Iteration(len(history) + 1, cost, 0.0, 0.5 * length**2, length, LEAST_DAMPING, True)
        history.append(now)
        progress(now)
        if length < settings.step_tolerance:
            if cost > found.cost_final * (1.0 + EARLY):  # another stationary point than the minimum
                break
            message = f"Converged: the last step was {length:.1e} posterior sigmas long."
            return replace(found, state=state, cost_final=cost, message=message, history=tuple(history))
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
    return replace(found, converged=False, message=message, history=tuple(history))


def _corrected(gradient: Array, plain: Array, pairs: Sequence[_Pair]) -> Array:
    """The step (columns,) that a linear model's step becomes by the curvature that steps before it have shown."""
    useful = [one for one in pairs if one.step @ one.slope > 0.0]  # elsewhere the cost bends downward
    left, shares = gradient, list[float]()
    for one in reversed(useful):
        shares.append(float(one.step @ left) / float(one.step @ one.slope))
        left = left - shares[-1] * one.slope
    found = plain + sum(share * one.solved for share, one in zip(shares, reversed(useful), strict=True))
    for share, one in zip(reversed(shares), useful, strict=True):
        found = found - (share + float(one.slope @ found) / float(one.step @ one.slope)) * one.step
    return found
