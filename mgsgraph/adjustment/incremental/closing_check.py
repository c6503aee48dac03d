"""The closing check: how far an incremental adjustment lies from batch, in sigmas."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.shared import shared_of
from mgsgraph.geometry.records import Array
from mgsgraph.network.parts import Unknown
from mgsgraph.record import Record

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

CLOSE = 1e-2
"""Sigmas within which incremental and batch results count as the same."""
EXACT = 1e-4
"""Sigmas beyond which the closing check takes over what batch has found."""


@dataclass(frozen=True, slots=True, eq=False)
class Closing(Record):
    """Largest differences between the incremental result and batch, in sigmas of batch."""

    unknown: Unknown
    """Unknown with the largest difference."""
    orientation: float
    """Largest difference of a coefficient or shift, in its sigma."""
    point: str
    """Point with the largest difference."""
    points: float
    """Largest difference of a coordinate, in its sigma."""
    adopted: bool
    """Whether batch's result is to be taken over: it converged, and something is farther off than `EXACT`."""
    converged: bool
    """Whether batch converged; else the comparison says nothing."""

    @property
    def worst(self) -> float:
        """Largest difference of all, in sigmas; infinite where one of the two has a place and the other has none."""
        return max(self.orientation, self.points)

    @property
    def close(self) -> bool:
        """Whether all differences are within `CLOSE`."""
        return self.worst <= CLOSE

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.converged:
            return "Closing check against batch: batch did not converge; the incremental result was kept."
        verdict = "the same" if self.close else f"farther apart than {CLOSE:g} sigmas"
        kept = "batch's result was taken over" if self.adopted else "the incremental result was kept"
        return (
            f"Closing check against batch: {verdict}; largest difference {self.orientation:.2g} sigmas for the "
            f"{self.unknown}, {self.points:.2g} sigmas for point {self.point}; {kept}."
        )


def closing(solution: "Solution", values: Mapping[Unknown, Array], places: Array) -> Closing:
    """Compare values of the unknowns and places (n, 3) of the points with a batch solution of the same network."""
    worst, which = 0.0, next(iter(values), Unknown("image", "-"))
    for unknown, batch in shared_of(solution).items():
        off = float(np.max(np.abs(values[unknown] - batch.value) / batch.sigmas))
        if off > worst:
            worst, which = off, unknown
    k, off = _farthest(solution, places)
    converged = solution.converged
    adopted = converged and max(worst, off) > EXACT
    return Closing(which, worst, solution.network.points.ids[k], off, adopted, converged)


def _farthest(solution: "Solution", places: Array) -> tuple[int, float]:
    """The point that lies farthest off, and its largest difference of a coordinate in its sigma."""
    known = np.isfinite(places[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.max(np.abs(places - solution.places) / solution.sigmas, axis=1)
    off[~known & ~solution.determined] = 0.0
    off[known != solution.determined] = np.inf
    off[known & solution.determined & np.isnan(off)] = 0.0  # a fixed point has no sigma, and stays where it is
    k = int(np.argmax(off))
    return k, float(off[k])
