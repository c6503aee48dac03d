"""Levenberg-Marquardt over a factor graph of either form; GTSAM holds the factors and does the elimination.

The damping is Levenberg's in whitened units: a weak extra prior on the step, in the variables' own scales (a-priori
sigmas), so that metres and radians are treated alike. A trial step costs one evaluation of the error; the loop is
Python, the work is in the kernel and in GTSAM.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array

_FIRST_DAMPING = 1e-8
_LEAST_DAMPING = 1e-12
_MOST_DAMPING = 1e8
_EASE, _TIGHTEN = 0.1, 10.0
_ROUNDING = 1e-11
"""Share of the cost by which it may seem to rise: body-fixed metres leave that much rounding in the residuals."""
_REMEDY = "look for blunders (reject), or try another loss"
_STUCK = f"Stopped: no step lowers the cost although the linear model promises it; {_REMEDY}."


@dataclass(frozen=True, slots=True)
class Iteration:
    """One step that was tried."""

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


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """How an optimisation ended."""

    values: gtsam.Values
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


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    scales: Mapping[int, Array],
    settings: SolverSettings,
    progress: Callable[[Iteration], None] = lambda _: None,
    constant: float = 0.0,
) -> Outcome:
    """Minimise a graph's error.

    Parameters
    ----------
    graph, start
        Factors and first values.
    scales : mapping of int to (d,)
        Scale of each variable's components, by key.
    settings : SolverSettings
        Tolerances and the most iterations.
    progress : callable
        Called after every step tried.
    constant : float
        Cost that belongs to the problem but to no factor.

    Raises
    ------
    SolverError
        When the start has no finite cost or the linear system can't be solved at any damping.
    """
    values, cost = start, graph.error(start) + constant
    initial, history = cost, list[Iteration]()
    if not math.isfinite(cost):
        raise SolverError("the starting values have no finite cost; check that all points lie before their cameras")
    if start.size() == 0:
        return Outcome(values, cost, cost, True, "Nothing to adjust: every image is held.", ())
    damping, rejected = _FIRST_DAMPING, 0
    linear = graph.linearize(values)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    while len(history) < settings.max_iterations:
        step = _damped_step(linear, ordering, damping, scales)
        if step is None:
            damping *= _TIGHTEN**2
            if damping > _MOST_DAMPING:
                raise SolverError("the normal equations can't be solved at any damping; the network is too weak")
            continue
        trial = values.retract(step)
        new = graph.error(trial) + constant
        predicted = linear.error(gtsam.VectorValues.Zero(step)) - linear.error(step)
        length = math.sqrt(max(-linear.gradientAtZero().dot(step), 0.0))
        accepted = math.isfinite(new) and new <= cost * (1.0 + _ROUNDING)
        now = Iteration(len(history) + 1, new, cost - new, predicted, length, damping, accepted)
        history.append(now)
        progress(now)
        last = length < settings.step_tolerance or min(predicted, abs(cost - new)) <= settings.cost_tolerance * cost
        if accepted:
            values, cost, rejected = trial, new, 0
        if last:
            return Outcome(values, initial, cost, True, _converged(now, settings), tuple(history))
        if accepted:
            damping = max(damping * _EASE, _LEAST_DAMPING)
            linear = graph.linearize(values)
        else:
            rejected += 1
            damping *= _TIGHTEN**rejected
            if damping > _MOST_DAMPING:
                return Outcome(values, initial, cost, False, _STUCK, tuple(history))
    limit = settings.max_iterations
    message = f"Stopped after {limit} iterations without converging; raise max_iterations or {_REMEDY}."
    return Outcome(values, initial, cost, False, message, tuple(history))


def _converged(last: Iteration, settings: SolverSettings) -> str:
    if last.step < settings.step_tolerance:
        return f"Converged: the last step was {last.step:.1e} posterior sigmas long."
    return f"Converged: the last step promised to lower the cost by no more than {settings.cost_tolerance:.0e} of it."


def _damped_step(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, damping: float, scales: Mapping[int, Array]
) -> gtsam.VectorValues | None:
    """Solution of the damped normal equations; None when they are not positive definite."""
    damped = linear.clone()
    for key, scale in scales.items():
        root = np.diag(math.sqrt(damping) / scale)
        damped.add(gtsam.JacobianFactor(key, root, np.zeros(scale.size), gtsam.noiseModel.Unit.Create(scale.size)))
    try:
        return damped.optimize(ordering)
    except RuntimeError as error:
        if "Indeterminate" in str(error):
            return None
        raise
