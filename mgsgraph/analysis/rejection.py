"""What data snooping takes out of a network: marks of it, the network without it, and what may come back."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.predicted_lines import exactly
from mgsgraph.adjustment.redundancy import closure, prediction
from mgsgraph.adjustment.rounds import Selection, everything
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.suspects import PointIndex
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Mask
from mgsgraph.kernel.rows import GROUND, OUT, STEREO, SURFACE
from mgsgraph.kernel.sweep import COSTS
from mgsgraph.network import Network
from mgsgraph.record import Record

ObservationKey = tuple[MeasureKind, int]
"""A whole ray, range, a-priori place or height, and its row in the network (of places and heights, the point)."""


@dataclass(frozen=True, slots=True)
class Removal(Record):
    """Observations rejected together: one, and those that can't be separated from it."""

    observations: tuple[ObservationKey, ...]
    """The one with the largest test first."""
    names: tuple[str, ...]
    """Names of these observations, for reports."""
    point: int
    """Network point of the observations."""
    test: float
    """Joint test of the first when it went, chi-square (divided by sigma0 squared where `Levels.scaled` says so)."""
    dimensions: int
    """Dimensions of the test."""
    critical: float
    """Critical value of the test."""
    adjustment: int
    """Number of the adjustment after which it went, from 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Taken(Record):
    """Marks of rejected observations, in network order."""

    rays: Mask
    """(k,) as `ImageRays.rejected`."""
    ranges: Mask
    """(r,) as `Ranges.rejected`."""
    places: Mask
    """(n,) points whose a-priori place is out."""
    heights: Mask
    """(n,) points whose height above the terrain is out."""
    stereo: Mask
    """(n,) points whose height above a stereo surface is out, as `StereoControl.rejected`."""

    @property
    def _masks(self) -> dict[MeasureKind, Mask]:
        """By kind, in the order of the fields."""
        every = self.rays, self.ranges, self.places, self.heights, self.stereo
        return dict(zip(MeasureKind, every, strict=False))

    def changed(self, observations: Iterable[ObservationKey], out: bool) -> "Taken":
        """Marks with some observations taken out or put back."""
        masks = {kind: mask.copy() for kind, mask in self._masks.items()}
        for kind, row in observations:
            masks[kind][row] = out
        return Taken(*masks.values())

    def marked(self, network: Network) -> Network:
        """A network whose rays, ranges and stereo heights carry the marks, and whose points lack what else is out."""
        return without(network, self).with_rejected(self.rays, self.ranges, self.stereo)

    def holds(self, observation: ObservationKey) -> bool:
        """Whether an observation is rejected."""
        kind, row = observation
        return bool(self._masks[kind][row])


def nothing_rejected(network: Network) -> Taken:
    """Marks of a network of which nothing is rejected."""
    sizes = network.rays.point.size, network.ranges.point.size, *[len(network.points)] * 3
    return Taken(*(np.zeros(size, dtype=np.bool_) for size in sizes))


def without(network: Network, taken: Taken) -> Network:
    """A network without some a-priori places and heights above the terrain; a `selection` leaves out the rest."""
    points, out = network.points, taken.places
    if np.any(out):
        covariances = np.where(out[:, None, None], 0.0, points.covariances)
        points = replace(points, kinds=np.where(out, PointKind.FREE, points.kinds), covariances=covariances)
    shifts, surface, stereo = network.shifts, network.surface, network.stereo
    if shifts is not None:
        shifts = replace(shifts, profile=np.where(out, -1, shifts.profile))
    if surface is not None:
        surface = replace(surface, sigmas=np.where(taken.heights, np.inf, surface.sigmas))
    if stereo is not None:  # on which a point stands by its a-priori position alone
        stereo = replace(stereo, surface=np.where(out, -1, stereo.surface))
    crossing = None if network.crossovers is None else network.crossovers.without(out)
    return replace(network, points=points, shifts=shifts, surface=surface, stereo=stereo, crossovers=crossing)


def selection(network: Network, taken: Taken) -> Selection:
    """Rays, ranges and heights above stereo surfaces of a network that take part."""
    return Selection(~taken.rays, ~taken.ranges, everything(network).out, ~taken.stereo)


class ObservationIndex:
    """Which observations each point of a linearised network has."""

    def __init__(self, at: Linearised) -> None:
        network, places, self._at = at.network, at.layout.observation_rows, at
        self._measured = tuple(
            (kind, PointIndex(points, len(network.points)), among)
            for kind, points, among in (
                (MeasureKind.RAY, network.rays.point, places.rays),
                (MeasureKind.RANGE, network.ranges.point, places.ranges),
            )
        )

    def of(self, point: int) -> dict[ObservationKey, int]:
        """Observations of a network point, and the index of each in those of its pattern (`PointRows.observation`)."""
        rows, patterns = self._at.rows, self._at.layout.patterns
        number = int(patterns.point_index[point])
        pattern, first, count, _, observation = rows.piece[patterns.piece_of(number)].tolist()
        found: dict[ObservationKey, int] = {}
        for kind, index, places in self._measured:
            for k in index.of(point).tolist():
                found[kind, k] = (int(places[k]) - observation - (number - first)) // count
        for slot, k in enumerate(range(rows.pattern_observation[pattern], rows.pattern_observation[pattern + 1])):
            if rows.observation_kind[k] == GROUND:
                found[MeasureKind.GROUND, point] = slot
            elif rows.observation_kind[k] == SURFACE:
                found[MeasureKind.HEIGHT, point] = slot
            elif rows.observation_kind[k] == STEREO:
                found[MeasureKind.STEREO, point] = slot
        return found


def readmissible(
    network: Network,
    at: Linearised,
    solution: Solution,
    taken: Taken,
    removals: Sequence[Removal],
    critical: Callable[[int], float],
) -> list[Removal]:
    """Removals that agree with what is left: whose error of prediction is below its critical value.

    Parameters
    ----------
    network : Network
        With all that has been taken out.
    at, solution
        The adjustment of what is left.
    taken, removals
        What is out.
    critical : callable
        Critical value of a test of so many dimensions, for sigma0 = 1.
    """
    if not removals:
        return []
    layout = lay_out(network, solution.settings, solution.places)
    determined = solution.determined[layout.point_order]
    by_all = BundleGraph(layout, layout.rows).reduction(at.orientation, COSTS).points
    points = np.where(determined[:, None], solution.places[layout.point_order], by_all)
    layout, points = exactly(layout, at.orientation, points)
    whole = Linearised(layout, at.settings, layout.rows, at.orientation, points, at.joint)
    index = ObservationIndex(whole)
    return [
        one for one in removals if _agrees(whole, index, one, taken, bool(solution.determined[one.point]), critical)
    ]


def _agrees(
    whole: Linearised,
    index: ObservationIndex,
    removal: Removal,
    taken: Taken,
    determined: bool,
    critical: Callable[[int], float],
) -> bool:
    """Whether a removal's rows agree with the others."""
    if whole.rows.kind[whole.layout.patterns.point_index[removal.point]] == OUT:
        return False
    rows, observations = whole.rows_of(removal.point), index.of(removal.point)
    back = np.isin(rows.observation, [observations[one] for one in removal.observations])
    used = np.isin(rows.observation, [slot for one, slot in observations.items() if not taken.holds(one)])
    shared = whole.joint.of(rows.variables)
    if determined:
        test, dimensions = prediction(rows, back, used[None], shared), np.count_nonzero(back)
    else:
        test, (dimensions,) = closure(rows, (back | used)[None], shared)
    return bool(dimensions > 0 and test[0] <= critical(int(dimensions)))
