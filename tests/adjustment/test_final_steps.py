"""The last steps to a stationary point."""

from dataclasses import dataclass

import numpy as np
import pytest

from mgsgraph.adjustment.batch import Iteration, Outcome, settled_minimum, with_final_steps
from mgsgraph.adjustment.settings import SolverSettings


@dataclass
class Equations:
    """Normal equations whose matrix is not quite the cost's."""

    gradient: np.ndarray
    matrix: np.ndarray
    kept: bool = False

    def step(self, damping: float) -> np.ndarray:
        return -np.linalg.solve(self.matrix + damping * np.eye(len(self.matrix)), self.gradient)

    def slope(self, step: np.ndarray) -> float:
        return float(-self.gradient @ step)

    def gain(self, step: np.ndarray) -> float:
        return float(-self.gradient @ step - 0.5 * step @ self.matrix @ step)


class Relief:
    """A quadratic cost with a small cubic part, whose Gauss-Newton matrix is too small by some factors, and which is
    known to some digits alone.
    """

    adjusts = True

    def __init__(self, factors: list[float], digits: float = 1e-9) -> None:
        self.hessian = np.diag(np.geomspace(1.0, 1e4, len(factors)))
        self.matrix, self.digits = self.hessian / np.array(factors), digits

    def cost(self, state: np.ndarray, task: int = 0) -> float:
        exact = 100.0 + 0.5 * state @ self.hessian @ state + 1e-3 * np.sum(state**3)
        return float(np.round(exact / self.digits) * self.digits)

    def exact_cost(self, state: np.ndarray) -> float:
        return self.cost(state)

    def linear(self, state: np.ndarray, kept: object = None) -> Equations:
        return Equations(self.hessian @ state + 3e-3 * state**2, self.matrix)


def quiet(_: Iteration) -> None:
    """No progress shown."""


def at(problem: Relief, state: np.ndarray) -> Outcome:
    return Outcome(state, 200.0, problem.cost(state), True, "Converged.", ())


@pytest.mark.parametrize("factors", [[1.0, 1.0, 1.0], [1.5, 1.0, 0.6], [2.2, 1.9, 1.0, 0.4], [0.2, 2.5, 1.1]])
def test_steps_that_shrink_slowly_or_grow_are_taken_together(factors: list[float]) -> None:
    """Above a factor of two Gauss-Newton steps alone become longer and longer."""
    problem, start = Relief(factors), 1e-3 * np.ones(len(factors))
    found = with_final_steps(problem, at(problem, start), SolverSettings(), quiet)
    assert found.converged
    assert np.abs(found.state * np.sqrt(np.diag(problem.hessian))).max() < 3e-6
    assert found.history[-1].step < 1e-6
    assert len(found.history) < 25
    whole = settled_minimum(problem, 0.3 * np.ones(len(factors)), SolverSettings(), quiet)
    assert whole.converged
    assert np.abs(whole.state * np.sqrt(np.diag(problem.hessian))).max() < 3e-6
    assert [one.number for one in found.history] == list(range(1, len(found.history) + 1))


def test_steps_that_do_not_settle_are_said() -> None:
    """A gradient with noise of its own."""

    class Noisy(Relief):
        def linear(self, state: np.ndarray, kept: object = None) -> Equations:
            rng = np.random.default_rng(int(1e12 * abs(state[0])) % 1000)
            return Equations(self.hessian @ state + 1e-2 * rng.standard_normal(state.size), self.matrix)

    problem = Noisy([1.0, 1.0])
    start = 1e-3 * np.ones(2)
    found = with_final_steps(problem, at(problem, start), SolverSettings(), quiet)
    assert not found.converged
    np.testing.assert_array_equal(found.state, start)


def test_a_saddle_is_not_taken_for_the_minimum() -> None:
    """Gauss-Newton's matrix is positive there, too."""

    class Saddle(Relief):
        def cost(self, state: np.ndarray, task: int = 0) -> float:
            x, y = state
            return float(100.0 + 0.5 * x**2 - 0.5 * y**2 + 0.25 * y**4)

        def linear(self, state: np.ndarray, kept: object = None) -> Equations:
            x, y = state
            return Equations(np.array([x, y**3 - y]), np.eye(2))

    problem, start = Saddle([1.0, 1.0]), np.array([0.01, 0.2])
    found = with_final_steps(problem, at(problem, start), SolverSettings(), quiet)
    assert not found.converged or abs(found.state[1]) > 0.9
    assert found.cost_final <= problem.cost(start)
