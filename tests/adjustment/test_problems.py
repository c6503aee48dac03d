"""The optimiser: what a rejected step costs, kept matrices, and the kernel's signature."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration, levenberg_marquardt
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.kernel.sweep import GRADIENT, sweep


class Parabola:
    """Half (x - 3)^2 with a cost that lies, as asked, by a share of it."""

    def __init__(self, lies: Iterator[float]) -> None:
        self.adjusts = True
        self.lies, self.asked, self.exactly = lies, list[int](), 0

    def cost(self, state: np.ndarray, task: int) -> float:
        self.asked.append(task)
        return (1.0 + 0.5 * float((state[0] - 3.0) ** 2)) * (1.0 + next(self.lies))

    def exact_cost(self, state: np.ndarray) -> float:
        self.exactly += 1
        return 1.0 + 0.5 * float((state[0] - 3.0) ** 2)

    def linear(self, state: np.ndarray, kept: "Curvature | None" = None) -> "Curvature":
        return Curvature(state - 3.0, np.ones(1))


def minimise(problem: Parabola, start: float) -> list[Iteration]:
    outcome = levenberg_marquardt(problem, np.array([start]), SolverSettings(max_iterations=8), lambda _: None)
    return list(outcome.history)


def test_a_near_miss_is_looked_at_again_exactly() -> None:
    """At the optimum already, a rise of 1e-9 that the exact costs don't confirm is no reason to reject."""
    problem = Parabola(iter([0.0, 1e-9, 0.0, 0.0]))
    history = minimise(problem, 3.0 - 1e-5)
    assert problem.exactly == 2
    assert history[0].accepted
    confirmed = Parabola(iter([0.0, 0.0, 0.0]))
    assert minimise(confirmed, 1.0)[0].accepted
    assert confirmed.exactly == 0


class Bent:
    """A cost of 1000 plus x^2 / 2 + bend x^4 / 4, whose curvature is 1 + 3 bend x^2 and changes as one likes."""

    def __init__(self, bend: float) -> None:
        self.adjusts, self.bend = True, bend
        self.asked, self.kept = list[int](), list[bool]()

    def cost(self, state: float, task: int) -> float:
        self.asked.append(task)
        return self.exact_cost(state)

    def exact_cost(self, state: float) -> float:
        return 1000.0 + 0.5 * state**2 + 0.25 * self.bend * state**4

    def linear(self, state: float, kept: "Curvature | None" = None) -> "Curvature":
        self.kept.append(kept is not None)
        curvature = kept.curvature if kept else 1.0 + 3.0 * self.bend * state**2
        return Curvature(state + self.bend * state**3, curvature, kept is not None)


class Curvature(NamedTuple):
    """Normal equations of unknowns that have nothing to do with each other."""

    gradient: np.ndarray
    curvature: np.ndarray
    kept: bool = False

    def step(self, damping: float) -> np.ndarray:
        return -self.gradient / (self.curvature + damping)

    def slope(self, step: np.ndarray) -> float:
        return -float(np.vdot(self.gradient, step))

    def gain(self, step: np.ndarray) -> float:
        return self.slope(step) - 0.5 * float(np.vdot(step, self.curvature * step))


@pytest.mark.parametrize("bend", [1.0, 300.0, 1e5])
def test_a_kept_matrix_is_renewed_where_it_no_longer_fits(bend: float) -> None:
    """Whether the curvature changes hardly or a thousandfold: the optimum is found, and with one that hardly changes
    only the gradient is asked for.
    """
    problem = Bent(bend)
    settings = SolverSettings(cost_tolerance=1e-15)
    outcome = levenberg_marquardt(problem, 0.1, settings, lambda _: None)
    assert outcome.converged
    assert abs(outcome.state) < 1e-5
    assert len(outcome.history) < 20
    assert GRADIENT in problem.asked
    assert any(problem.kept)
    if bend > 1.0:
        assert sum(not kept for kept in problem.kept) > 1


class Flattening:
    """10 atan x, on which the first steps go too far, and a weak y / 3, beside a cost that nothing changes."""

    def __init__(self) -> None:
        self.adjusts = True

    def cost(self, state: np.ndarray, task: int) -> float:
        return self.exact_cost(state)

    def exact_cost(self, state: np.ndarray) -> float:
        return 1e7 + 50.0 * float(np.arctan(state[0]) ** 2) + 0.045 * float((state[1] - 5.0) ** 2)

    def linear(self, state: np.ndarray, kept: Curvature | None = None) -> Curvature:
        slope = np.array([10.0 / (1.0 + state[0] ** 2), 0.3])
        residual = np.array([10.0 * np.arctan(state[0]), 0.3 * (state[1] - 5.0)])
        return Curvature(slope * residual, slope**2, kept is not None)


def test_damping_is_eased_near_the_optimum_too() -> None:
    """Steps that damping holds back promise little: it must go before they count as the last ones."""
    outcome = levenberg_marquardt(Flattening(), np.array([30.0, 0.0]), SolverSettings(), lambda _: None)
    assert outcome.history[-1].damping > 1e-12
    assert outcome.converged
    assert sum(not now.accepted for now in outcome.history) > 2
    np.testing.assert_allclose(outcome.state, [0.0, 5.0], rtol=0.0, atol=0.05)


def test_the_kernel_is_compiled_for_one_signature() -> None:
    """Terrain or none, held images, blunder passes, a whole width, read-only arrays: another signature,
    another minute.
    """
    before = len(sweep.signatures)
    assert before <= 1
    for net in (network(pair()), with_shift_and_surface(network(pair())), network(pair(), (True, False))):
        adjust_network(net, SolverSettings(reject=6.0, loss="cauchy", loss_width=2))
        layout = lay_out(net, SolverSettings())
        still = np.zeros(layout.columns)
        still.flags.writeable = False
        BundleGraph(layout).reduction(still)
    assert len(sweep.signatures) == 1
