"""Sweeps of bundles that stay laid out for the kernel between two changes."""

from collections import OrderedDict

from mgsgraph.adjustment.incremental.sweep import Sweep
from mgsgraph.network.parts import Members

MOST_KEPT = 150_000
"""Points that stay laid out (about 1 kB each)."""


class KeptSweeps:
    """Sweeps that were laid out last, up to a total of points; what was asked for longest ago goes first."""

    def __init__(self, most: int) -> None:
        self._most, self._size = most, 0
        self._all: OrderedDict[Members, Sweep] = OrderedDict()

    def get(self, members: Members) -> Sweep | None:
        """The sweep of a bundle; None where there is none."""
        if members not in self._all:
            return None
        self._all.move_to_end(members)
        return self._all[members]

    def put(self, members: Members, sweep: Sweep) -> None:
        """Keep the sweep of a bundle."""
        self.drop(members)
        self._all[members] = sweep
        self._size += len(sweep.network.points)
        while self._size > self._most and len(self._all) > 1:
            _, oldest = self._all.popitem(last=False)
            self._size -= len(oldest.network.points)

    def drop(self, members: Members) -> None:
        """Remove the sweep of a bundle."""
        if members in self._all:
            self._size -= len(self._all.pop(members).network.points)
