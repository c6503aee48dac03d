"""The optimiser on problems made up: what a rejected step costs, kept matrices, the last steps to a stationary point;
and that the kernel is compiled for one signature.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from numba import int64

from mgsgraph.adjustment import batch
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import (
    KEEPING,
    KEEPING_LONGER,
    BundleProblem,
    Outcome,
    levenberg_marquardt,
    settled_minimum,
    with_final_steps,
)
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import Iteration, SolverSettings
from mgsgraph.kernel.sweep import COSTS, GRADIENT, place_of_part, sweep


@dataclass
class Equations:
    """Normal equations, whose matrix need not quite be the cost's."""

    gradient: np.ndarray
    matrix: np.ndarray
    kept: bool = False

    def step(self, damping: float) -> np.ndarray:
        return -np.linalg.solve(self.matrix + damping * np.eye(len(self.matrix)), self.gradient)

    def slope(self, step: np.ndarray) -> float:
        return float(-self.gradient @ step)

    def gain(self, step: np.ndarray) -> float:
        return self.slope(step) - 0.5 * float(step @ self.matrix @ step)


class Problem:
    """By its cost, its gradient and what is taken for its matrix; its cost may lie, as asked, by a share of it."""

    adjusts = True
    keeping = KEEPING

    def __init__(
        self,
        cost: Callable[[np.ndarray], float],
        gradient: Callable[[np.ndarray], np.ndarray],
        matrix: Callable[[np.ndarray], np.ndarray],
        lies: Iterator[float] | None = None,
    ) -> None:
        self._cost, self._gradient, self._matrix, self._lies = cost, gradient, matrix, lies
        self.asked, self.exactly, self.kept, self.rough = list[int](), 0, list[bool](), list[bool]()

    def cost(self, state: np.ndarray, task: int = 0, rough: bool = False) -> float:
        self.asked.append(task)
        self.rough.append(rough)
        return self._cost(state) * (1.0 + (next(self._lies) if self._lies else 0.0))

    def exact_cost(self, state: np.ndarray) -> float:
        self.exactly += 1
        return self._cost(state)

    def linear(self, state: np.ndarray, kept: Equations | None = None) -> Equations:
        self.kept.append(kept is not None)
        return Equations(self._gradient(state), kept.matrix if kept else self._matrix(state), kept is not None)


def quiet(_: Iteration) -> None:
    """No progress shown."""


def parabola(lies: Iterator[float]) -> Problem:
    return Problem(lambda x: 1.0 + 0.5 * float((x[0] - 3.0) ** 2), lambda x: x - 3.0, lambda _: np.eye(1), lies)


def quartic(bend: float) -> Problem:
    return Problem(
        lambda x: 1000.0 + float(0.5 * x[0] ** 2 + 0.25 * bend * x[0] ** 4),
        lambda x: x + bend * x**3, lambda x: np.diag(1.0 + 3.0 * bend * x**2),
    )  # fmt: skip


def test_a_near_miss_is_looked_at_again_exactly() -> None:
    """At the optimum already, a rise of 1e-9 that the exact costs don't confirm is no reason to reject."""
    settings = SolverSettings(max_iterations=8)
    problem, confirmed = parabola(iter([0.0, 1e-9, 0.0, 0.0])), parabola(iter([0.0, 0.0, 0.0]))
    assert levenberg_marquardt(problem, np.array([3.0 - 1e-5]), settings, quiet).history[0].accepted
    assert problem.exactly == 2
    assert levenberg_marquardt(confirmed, np.array([1.0]), settings, quiet).history[0].accepted
    assert confirmed.exactly == 0


@pytest.mark.parametrize("bend", [1.0, 300.0, 1e5])
def test_a_kept_matrix_is_renewed_where_it_no_longer_fits(bend: float) -> None:
    """Whether the curvature changes hardly or a thousandfold: the optimum is found, and with one that hardly changes
    only the gradient is asked for.
    """
    problem = quartic(bend)
    outcome = levenberg_marquardt(problem, np.array([0.1]), SolverSettings(cost_tolerance=1e-15), quiet)
    assert outcome.converged
    assert abs(outcome.state[0]) < 1e-5
    assert len(outcome.history) < 20
    assert GRADIENT in problem.asked
    assert any(problem.kept)
    if bend > 1.0:
        assert sum(not kept for kept in problem.kept) > 1


def test_a_matrix_whose_factor_takes_long_is_made_more_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same optimum from fewer matrices; a real block takes the rule by its factor's operations."""
    costs, matrices = list[float](), list[int]()
    for keeping in (KEEPING, KEEPING_LONGER):
        problem = quartic(1.0)
        problem.keeping = keeping
        outcome = levenberg_marquardt(problem, np.array([2.0]), SolverSettings(cost_tolerance=1e-15), quiet)
        costs.append(outcome.cost_final)
        matrices.append(sum(not kept for kept in problem.kept))
    assert costs[0] == pytest.approx(costs[1], rel=1e-14)
    assert matrices[1] < matrices[0]
    block = BundleProblem(BundleGraph(lay_out(network(pair()), SolverSettings())))
    assert block.keeping is KEEPING
    monkeypatch.setattr(batch, "_LONG", 0.0)
    assert block.keeping is KEEPING_LONGER


def test_points_are_solved_roughly_only_where_a_step_gains_much() -> None:
    """The cost of a block far from its optimum changes by less than 1e-5 of it then, and its optimum not at all."""
    problem = quartic(1.0)
    outcome = levenberg_marquardt(problem, np.array([20.0]), SolverSettings(cost_tolerance=1e-15), quiet)
    gains = [now.predicted / (now.cost + now.decrease) for now in outcome.history if now.accepted]
    assert problem.rough == [False, *(gain > 0.1 for gain in gains)]
    assert True in problem.rough
    graph = BundleGraph(lay_out(network(pair()), SolverSettings()))
    moves = graph.layout.scales * np.geomspace(1e-5, 1.0, 11)[:, None]
    begin = graph.reduction(0.0 * moves[0]).points
    rough, exact = ([graph.reduction(move, COSTS, begin, one).cost for move in moves] for one in (True, False))
    assert rough != exact
    assert rough == pytest.approx(exact, rel=1e-5)


def test_damping_is_eased_near_the_optimum_too() -> None:
    """10 atan x, on which the first steps go too far, and a weak y / 3, beside a cost that nothing changes. Steps that
    damping holds back promise little: it must go before they count as the last ones.
    """
    problem = Problem(
        lambda x: 1e7 + 50.0 * float(np.arctan(x[0]) ** 2) + 0.045 * float((x[1] - 5.0) ** 2),
        lambda x: np.array([100.0 * np.arctan(x[0]) / (1.0 + x[0] ** 2), 0.09 * (x[1] - 5.0)]),
        lambda x: np.diag([(10.0 / (1.0 + x[0] ** 2)) ** 2, 0.09]),
    )
    outcome = levenberg_marquardt(problem, np.array([30.0, 0.0]), SolverSettings(), quiet)
    assert outcome.history[-1].damping > 1e-12
    assert outcome.converged
    assert sum(not now.accepted for now in outcome.history) > 2
    np.testing.assert_allclose(outcome.state, [0.0, 5.0], rtol=0.0, atol=0.05)


# --- the last steps


def relief(factors: list[float], noise: float = 0.0) -> tuple[Problem, np.ndarray]:
    """A quadratic cost with a small cubic part, whose Gauss-Newton matrix is too small by some factors, and which is
    known to some digits alone; its gradient may have noise of its own. And its Hessian.
    """
    hessian = np.diag(np.geomspace(1.0, 1e4, len(factors)))

    def gradient(x: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(int(1e12 * abs(x[0])) % 1000)
        return hessian @ x + 3e-3 * x**2 + noise * rng.standard_normal(x.size)

    return Problem(
        lambda x: float(np.round((100.0 + 0.5 * x @ hessian @ x + 1e-3 * np.sum(x**3)) * 1e9) / 1e9),
        gradient, lambda _: hessian / np.array(factors),
    ), hessian  # fmt: skip


def finished(problem: Problem, start: np.ndarray) -> Outcome:
    begun = Outcome(start, 200.0, problem.cost(start), True, "Converged.", ())
    return with_final_steps(problem, begun, SolverSettings(), quiet)


@pytest.mark.parametrize("factors", [[1.0, 1.0, 1.0], [1.5, 1.0, 0.6], [2.2, 1.9, 1.0, 0.4], [0.2, 2.5, 1.1]])
def test_steps_that_shrink_slowly_or_grow_are_taken_together(factors: list[float]) -> None:
    """Above a factor of two Gauss-Newton steps alone become longer and longer."""
    problem, hessian = relief(factors)
    found = finished(problem, 1e-3 * np.ones(len(factors)))
    whole = settled_minimum(problem, 0.3 * np.ones(len(factors)), SolverSettings(), quiet)
    for one in (found, whole):
        assert one.converged
        assert np.abs(one.state * np.sqrt(np.diag(hessian))).max() < 3e-6
    assert found.history[-1].step < 1e-6
    assert [one.number for one in found.history] == list(range(1, len(found.history) + 1))
    assert len(found.history) < 25


def test_steps_that_do_not_settle_are_said() -> None:
    start = 1e-3 * np.ones(2)
    found = finished(relief([1.0, 1.0], 1e-2)[0], start)
    assert not found.converged
    np.testing.assert_array_equal(found.state, start)


def test_a_saddle_is_not_taken_for_the_minimum() -> None:
    """Gauss-Newton's matrix is positive there, too."""
    problem = Problem(
        lambda x: float(100.0 + 0.5 * x[0] ** 2 - 0.5 * x[1] ** 2 + 0.25 * x[1] ** 4),
        lambda x: np.array([x[0], x[1] ** 3 - x[1]]), lambda _: np.eye(2),
    )  # fmt: skip
    start = np.array([0.01, 0.2])
    found = finished(problem, start)
    assert not found.converged or abs(found.state[1]) > 0.9
    assert found.cost_final <= problem.cost(start)


def test_the_kernel_is_compiled_for_one_signature() -> None:
    """Beforehand, and with terrain or none, held images, blunder passes, a whole width, arrays that are read-only or
    in another order: it is compiled for no other signature, with which it would call its parts wrongly.
    """
    place_of_part(sweep)
    for net in (network(pair()), with_shift_and_surface(network(pair())), network(pair(), (True, False))):
        adjust_network(net, SolverSettings(reject=6.0, loss="cauchy", loss_width=2))
        layout = lay_out(net, SolverSettings())
        still = np.zeros(layout.columns)
        still.flags.writeable = False
        BundleGraph(layout).reduction(still)
        turned = layout.rows._replace(weight=np.asfortranarray(layout.rows.weight))
        BundleGraph(replace(layout, rows=turned)).reduction(still)
    assert len(sweep.signatures) == 1
    with pytest.raises(RuntimeError):
        sweep.compile((int64,))
