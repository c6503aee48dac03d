"""The last steps to a stationary point, where the cost is too rough to tell one step from another.

Relief on which points lie curves: near the optimum Gauss-Newton steps become shorter by about the same share each, or
even longer, in the few directions that rest on the relief, and what they gain is less than the cost's rounding. Points
whose rays are nearly parallel do the same: their distance has a curvature of which the linear model sees a part.
What the last few steps have shown of the true curvature corrects the linear model's: the method of Broyden, Fletcher,
Goldfarb and Shanno with a limited memory (Nocedal 1980), from the inverse of the normal matrix, whose factor is kept.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from mgsgraph.adjustment.batch import (
    EARLY,
    LEAST_DAMPING,
    Iteration,
    Outcome,
    Problem,
    levenberg_marquardt,
    step_length,
)
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import GRADIENT, SYSTEM

_DEPTH = 10
"""Steps whose curvature is remembered."""
_MOST = 60
"""Steps after which it counts as not at rest."""
_ROUNDING = 1e-14
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
    """Minimise a problem's cost and settle (`settled`): from where the cost hardly falls any more, or should steps not
    settle from there, from where it doesn't.
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
    rounding = math.sqrt(2.0 * _ROUNDING * problem.cost(state, SYSTEM))
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
