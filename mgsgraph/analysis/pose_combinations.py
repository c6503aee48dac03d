"""Positions and rotations of a pass that the measures can't tell apart, and what they determine of them."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.datum.frames import FLIGHT
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import strip_turns
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.record import Record

INSEPARABLE = 0.95
"""Correlation beyond which two things are not separable."""


@dataclass(frozen=True, slots=True, eq=False)
class Combination(Record):
    """What the measures determine of a position and a rotation that they can't tell apart."""

    of_pass: str
    """Name of the pass."""
    position: str
    """Along the track, across it, or radial."""
    rotation: str
    """Roll, pitch or yaw."""
    correlation: float
    """Median over nodes, of the corrections' errors."""
    lever: float
    """m per rad: position + lever times rotation is determined."""
    sigma: float
    """m, of that combination; median over nodes."""
    alone: float
    """m, of the position alone."""

    @property
    def sentence(self) -> str:
        """The pair, and the combination that is determined, as one line of a report."""
        return (
            f"pass {self.of_pass}: {self.position} and {self.rotation} are not separable (correlation "
            f"{self.correlation:.3f} at the nodes): determined is {self.position} {self.lever / 1e3:+.4g} km x "
            f"{self.rotation}, to {self.sigma:.3g} m, {self.position} alone to {self.alone:.3g} m"
        )


def combinations(solution: Solution, number: int) -> tuple[Combination, ...]:
    """Positions and rotations of a pass, along the axes of its flight, that the measures can't tell apart, and what
    they determine of them.
    """
    one = solution.network.passes[number]
    inner = np.flatnonzero(np.isin(one.nodes.times, one.nodes.inner))
    first, joint = int(solution.network.first_of_passes[number]), at_solution(solution).of_estimator().joint
    turns = strip_turns(solution.network, number, one.nodes.inner + one.nodes.epoch, solution.settings.angles)
    blocks = turns @ np.stack([joint.of([first + k]) for k in inner.tolist()]) @ np.swapaxes(turns, 1, 2)
    scale = np.sqrt(np.diagonal(blocks, axis1=1, axis2=2))
    correlation = np.median(blocks / scale[:, :, None] / scale[:, None, :], axis=0)[:3, 3:]
    found = list[Combination]()
    for p, r in np.argwhere(np.abs(correlation) > INSEPARABLE).tolist():
        lever = -np.median(blocks[:, p, 3 + r] / blocks[:, 3 + r, 3 + r])
        both = blocks[:, p, p] + 2.0 * lever * blocks[:, p, 3 + r] + lever**2 * blocks[:, 3 + r, 3 + r]
        sigma, alone = float(np.sqrt(np.median(both))), float(np.median(scale[:, p]))
        names = FLIGHT[p], FLIGHT[3 + r]
        found.append(Combination(one.name, *names, float(correlation[p, r]), float(lever), sigma, alone))
    return tuple(found)
