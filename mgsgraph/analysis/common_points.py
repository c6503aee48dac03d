"""Ground points that two solutions have in common: how far they are apart, and how well each solution knows them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names


@dataclass(frozen=True)
class CommonPoints:
    """Determined ground points that two solutions have under the same name."""

    solution: Solution
    """The later one."""
    earlier: Solution
    """The earlier one."""

    @cached_property
    def _pairs(self) -> Index:
        """(n, 2) numbers of every common name in the later and in the earlier solution."""
        found = Names.of(self.earlier.network.points.ids).find(self.solution.network.points.ids)
        here = np.flatnonzero(found >= 0)
        return np.stack([here, found[here]], axis=1)

    @property
    def shared(self) -> int:
        """Points of the same name, determined or not."""
        return len(self._pairs)

    @cached_property
    def rows(self) -> tuple[Index, Index]:
        """(n,) numbers in the later and in the earlier solution, of those that both determine."""
        here, there = self._pairs.T
        sound = self.solution.determined[here] & self.earlier.determined[there]
        return here[sound], there[sound]

    @cached_property
    def places(self) -> Array:
        """(n, 3) m, body-fixed, of the later solution."""
        return np.asarray(self.solution.places[self.rows[0]])

    @cached_property
    def moved(self) -> Array:
        """(n, 3) m east, north and up, later minus earlier."""
        there = self.earlier.places[self.rows[1]]
        return np.asarray(np.einsum("nij,nj->ni", east_north_up(self.places), self.places - there))

    @cached_property
    def sigmas(self) -> tuple[Array, Array]:
        """(n,) m, 3-D sigmas of the earlier and of the later solution."""
        here, there = self.rows
        one, other = (np.trace(solution.covariances[k], axis1=1, axis2=2)
                      for solution, k in ((self.earlier, there), (self.solution, here)))  # fmt: skip
        return np.sqrt(np.maximum(one, 0.0)), np.sqrt(np.maximum(other, 0.0))

    @property
    def in_sigmas(self) -> Array:
        """(n,) distance over the larger of both 3-D sigmas; NaN for points without any."""
        sigma = np.maximum(*self.sigmas)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(sigma > 0.0, np.linalg.norm(self.moved, axis=1) / sigma, np.nan)

    @property
    def ratio(self) -> Array:
        """(n,) later 3-D sigma over the earlier one; NaN where a point has none in either."""
        earlier, later = self.sigmas
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where((earlier > 0.0) & (later > 0.0), later / earlier, np.nan)
