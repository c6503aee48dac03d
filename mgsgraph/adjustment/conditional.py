"""The bundle form with some of its directions held: what is left to be minimised when they have given values.

With A (columns, m) the directions and N dx = -g the normal equations, the step that leaves A' x as it is, is

    dx = -N^-1 (g + A k),    A' dx = 0:    dx = s - N^-1 A (A' N^-1 A)^-1 A' s,    s = -N^-1 g.
"""

import numpy as np

from mgsgraph.adjustment.graph import BundleGraph
from mgsgraph.adjustment.graph.bundle import Solving
from mgsgraph.adjustment.problems import BundleProblem, ReducedEquations
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.sweep import GRADIENT, SYSTEM


class HeldEquations(ReducedEquations):
    """Normal equations whose steps leave directions (columns, m) as they are."""

    def __init__(
        self, graph: BundleGraph, reduction: Reduction, directions: Array, kept: "HeldEquations | None" = None
    ) -> None:
        super().__init__(graph, reduction, kept)
        self._directions = directions
        self._through: tuple[Solving, Array] | None = None if kept is None else kept._through

    def step(self, damping: float) -> Array | None:
        """Solution of the damped equations; None when they are not positive definite."""
        free, held = super().step(damping), self._directions
        if free is None:
            return None
        assert self._factor is not None
        if self._through is None or self._through[0] is not self._factor:
            self._through = self._factor, np.stack([self._factor.solve(one) for one in held.T], axis=1)
        through = self._through[1]
        return np.asarray(free - through @ np.linalg.solve(held.T @ through, held.T @ free))


class HeldProblem(BundleProblem):
    """The bundle form with directions (columns, m) of its state held."""

    def __init__(self, graph: BundleGraph, directions: Array, known: Reduction) -> None:
        super().__init__(graph, known)
        self._directions = directions

    def linear(self, state: Array, kept: ReducedEquations | None = None) -> HeldEquations:
        """Normal equations at a state (columns,), with the factor of `kept` where it is given."""
        assert kept is None or isinstance(kept, HeldEquations)
        reduction = self.at(state, SYSTEM if kept is None else GRADIENT)
        return HeldEquations(self.graph, reduction, self._directions, kept)
