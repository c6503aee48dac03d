"""The last steps to a stationary point, where the cost is too rough to tell one step from another.

Relief on which points lie curves: near the optimum Gauss-Newton steps become shorter by about the same share each, or
even longer, in the few directions that rest on the relief, and what they gain is less than the cost's rounding. The
acceleration of Anderson (1965) takes the last few steps together: x + f - sum_j g_j (dx_j + df_j) with g that minimises
|f - sum_j g_j df_j|, for steps f at states x and their differences; with one column that is the secant method.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.batch import LEAST_DAMPING, Iteration, Outcome, Problem, levenberg_marquardt, step_length
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.sweep import SYSTEM

_EARLY = 1e-7
"""Share of the cost: a step that gains less is some thousandths of a sigma long, near enough to settle."""
_DEPTH = 5
"""Differences of steps that are taken together."""
_MOST = 60
"""Steps after which it counts as not at rest."""
_FARTHEST = 30.0
"""Times the first step's length, or posterior sigmas where that is less than one, that a later one may be."""


def settled_minimum(
    problem: Problem[Array],
    start: Array,
    scales: Array,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
) -> Outcome[Array]:
    """Minimise a problem's cost and settle (`settled`): from where the cost hardly falls any more, or should steps not
    settle from there, from where it doesn't.
    """
    early = replace(settings, cost_tolerance=max(settings.cost_tolerance, _EARLY))
    found = levenberg_marquardt(problem, start, early, progress)
    outcome = settled(problem, found, scales, settings, progress)
    if outcome.converged or not found.converged:
        return outcome
    tried = levenberg_marquardt(problem, found.state, settings, progress)
    later = tuple(replace(one, number=one.number + len(found.history)) for one in tried.history)
    tried = replace(tried, cost_initial=found.cost_initial, history=found.history + later)
    return settled(problem, tried, scales, settings, progress)


def settled(
    problem: Problem[Array],
    found: Outcome[Array],
    scales: Array,
    settings: SolverSettings,
    progress: Callable[[Iteration], None],
) -> Outcome[Array]:
    """An outcome that is converged by its cost, brought to where a step is shorter than the step tolerance.

    Parameters
    ----------
    problem : Problem
        Whose state is a vector (columns,).
    found : Outcome
    scales : (columns,)
        In which steps are measured against each other.
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
    states, steps, farthest = list[Array](), list[Array](), math.inf
    for _ in range(_MOST):
        linear = problem.linear(state)
        step: Array | None = linear.step(LEAST_DAMPING)
        length = math.inf if step is None else step_length(linear, step)
        if step is None or not length <= farthest:
            break
        farthest = min(farthest, _FARTHEST * max(length, settings.step_tolerance))
        now = Iteration(len(history) + 1, cost, 0.0, linear.gain(step), length, LEAST_DAMPING, True)
        history.append(now)
        progress(now)
        if length < settings.step_tolerance:
            if cost > found.cost_final * (1.0 + _EARLY):  # another stationary point than the minimum
                break
            message = f"Converged: the last step was {length:.1e} posterior sigmas long."
            return replace(found, state=state, cost_final=cost, message=message, history=tuple(history))
        states, steps = [*states[-_DEPTH:], state], [*steps[-_DEPTH:], step]
        state = accelerated(states, steps, scales)
        cost = problem.cost(state, SYSTEM)
        if not math.isfinite(cost):
            break
    message = "Stopped: near the optimum steps do not become short enough; look for blunders (reject)."
    return replace(found, converged=False, message=message, history=tuple(history))


def accelerated(states: list[Array], steps: list[Array], scales: Array) -> Array:
    """Next state (columns,) by the last states and the Gauss-Newton steps at them."""
    state, step = states[-1], steps[-1]
    if len(states) == 1:
        return state + step
    by_state, by_step = (np.diff(np.array(values), axis=0) for values in (states, steps))
    shares = np.linalg.lstsq((by_step / scales).T, step / scales, rcond=1e-10)[0]
    return np.asarray(state + step - shares @ (by_state + by_step))
