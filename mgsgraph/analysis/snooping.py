"""Data snooping: adjust, take out what has the largest test over its critical value, adjust again (Baarda 1968).

What is taken out is a whole ray, range, a-priori place or height, by the joint test of its rows; what can't be told
apart from it goes with it: the rays of a tie that only two images see, that is, the whole point. Several go at a time
where they don't influence each other: different points, whose tests would exceed their critical values whatever the
larger blunders have done to them. In the end each is judged by what the others predict for it, and taken back where it
agrees. A-priori values of the orientation, shifts and biases are tested, but stay.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import INSEPARABLE, closure, direction, independent, prediction, residual_covariance
from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.rounds import Selection, everything, exactly
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.measures import Levels, MeasureKind
from mgsgraph.analysis.reliability import PointIndex, Reliability, reliability
from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.records import Array, Mask
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
    """Joint test of the first when it went, chi-square."""
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


_MOST_CANDIDATES = 2000
"""Points that are compared at a time."""
_OF_POINT = {
    MeasureKind.GROUND: "a-priori place",
    MeasureKind.HEIGHT: "height above the terrain",
    MeasureKind.STEREO: "height above the stereo surface",
}

Progress = Callable[[Removal], None]


@dataclass(frozen=True, slots=True, eq=False)
class Snooping(Record):
    """What data snooping took out, and what is left."""

    solution: Solution
    """The last adjustment; its network lacks the a-priori places and heights that were taken out, and marks the rays
    and ranges, as `rays_rejected` and `ranges_rejected` do."""
    reliability: Reliability
    """Reliability of the measures that are left."""
    removals: tuple[Removal, ...]
    """What stays out, in the order in which it went."""
    readmitted: tuple[Removal, ...]
    """What was taken back in the end: the others agree with it, once the rest is out."""
    taken: Taken
    """Marks of what stays out; `taken.marked(network)` is the network with its rays and ranges marked as rejected."""
    adjustments: int
    """Number of adjustments."""
    complete: bool
    """False where more tests exceed their critical value than might be taken out (`most`)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """The most suspicious observation of a point, and those that can't be separated from it."""

    removal: Removal
    variables: tuple[int, ...]
    pull: Array
    """(columns,) how the shared unknowns enter its test, before that is divided by its sigma."""
    size: float
    """Root of the joint test, for sigma0 = 1: what its best direction's test is, of unit variance."""

    @property
    def severity(self) -> float:
        """Test over critical value."""
        return float(np.sqrt(self.removal.test / self.removal.critical))


def snoop(
    network: Network,
    settings: SolverSettings | None = None,
    levels: Levels | None = None,
    most: int = 1000,
    name: str = "adjustment",
    progress: Progress = lambda _: None,
) -> Snooping:
    """Adjust a network without its blunders.

    Parameters
    ----------
    settings : SolverSettings, optional
        Without a robust loss and a limit of its own for blunders: tests presume plain least squares.
    levels : Levels, optional
        Sizes of the tests.
    most : int
        Removals after which to stop.
    name : str
        What to call the adjustment in reports.
    progress : callable
        Called with every removal.

    Examples
    --------
    >>> from mgsgraph.analysis.snooping import snoop
    >>> found = snoop(network)
    >>> len(found.removals), found.complete
    (0, True)
    """
    settings, levels = settings or SolverSettings(), levels or Levels()
    if settings.loss != "none":
        raise InputError("data snooping", f"loss {settings.loss!r}", "'none'", "tests presume plain least squares")
    if settings.reject > 0.0:
        raise InputError("data snooping", f"reject = {settings.reject:g}", "0", "choose one way of seeking blunders")
    if most < 0:
        raise InputError("data snooping, most", f"{most}", "0 or more")
    run = _Search(network, settings, levels, most, name, progress)
    run.take_out()
    back = readmissible(network, run.at, run.solution, run.taken, run.removals, run.found.critical_joint)
    if back:
        run.removals = [one for one in run.removals if one not in back]
        run.taken = run.taken.changed([observation for one in back for observation in one.observations], False)
        run.adjust()
        run.take_out()
        again = {observation for one in run.removals for observation in one.observations}
        back = [one for one in back if not again.issuperset(one.observations)]
    return Snooping(
        run.solution,
        run.found,
        tuple(run.removals),
        tuple(back),
        run.taken,
        run.adjustments,
        run.complete,
    )


class _Search:
    """One search for blunders and its state."""

    def __init__(
        self, network: Network, settings: SolverSettings, levels: Levels, most: int, name: str, progress: Progress
    ) -> None:
        self._network, self._settings, self._levels, self._name = network, settings, levels, name
        self._most, self._progress = most, progress
        self.taken, self.removals = nothing_rejected(network), list[Removal]()
        self.adjustments, self.complete = 0, True
        self.adjust()

    def take_out(self) -> None:
        """Until no test exceeds its critical value."""
        while candidates := _candidates(self.found, self.adjustments):
            allowed = self._most - len(self.removals)
            if allowed <= 0:
                self.complete = False
                return
            sizes, critical = np.array([(one.size, one.removal.critical) for one in candidates]).T
            pulls = [(one.variables, one.pull) for one in candidates]
            for k in independent(pulls, sizes, np.sqrt(critical), self.at)[:allowed]:
                one = candidates[k]
                self.removals.append(one.removal)
                self.taken = self.taken.changed(one.removal.observations, True)
                self._progress(one.removal)
            self.adjust()

    def adjust(self) -> None:
        """Adjust the observations that are left."""
        left = self.taken.marked(self._network)
        self.solution = adjust_network(left, self._settings, self._name, left_in=selection(left, self.taken))
        self.at = at_solution(self.solution).of_estimator()
        self.found = reliability(self.at, self._levels)
        self.adjustments += 1


def _candidates(found: Reliability, number: int) -> list[_Candidate]:
    """One for each point that has an observation over its critical value, worst first."""
    over = (found.severity > 1.0) & (found.measures.kind < MeasureKind.PRIOR)
    worst = np.flatnonzero(over)[np.argsort(-found.severity[over], kind="stable")]
    points, first = np.unique(found.measures.point[worst], return_index=True)
    chosen = points[np.argsort(first)][:_MOST_CANDIDATES]
    if not chosen.size:
        return []
    index = ObservationIndex(found.at)
    candidates = [_candidate(found, index, int(point), number) for point in chosen]
    return sorted((one for one in candidates if one.severity > 1.0), key=lambda one: -one.severity)


def _candidate(found: Reliability, index: ObservationIndex, point: int, number: int) -> _Candidate:
    """The worst observation of a point, by its direction of the largest test."""
    at = found.at
    rows, observations = at.rows_of(point), index.of(point)
    (covariance,), (through,) = residual_covariance(at, rows)
    tests = list[tuple[ObservationKey, Array, float, int]]()
    for observation, slot in observations.items():
        (combination,), (test,), (dimensions,) = direction(covariance[None], rows.residuals, rows.observation == slot)
        if dimensions and test > 0.0:
            tests.append((observation, combination, float(test), int(dimensions)))
    worst = max(tests, key=lambda one: one[2] / found.critical_joint(one[3]))
    _, combination, test, dimensions = worst
    shadow = covariance @ combination
    alike = [
        one[0] for one in tests if abs(one[1] @ shadow) > INSEPARABLE * np.sqrt(one[2] * test) and one is not worst
    ]
    together = (worst[0], *alike)
    names = tuple(_name(at, *observation) for observation in together)
    critical = found.critical_joint(dimensions)
    removal = Removal(together, names, point, test, dimensions, critical, number)
    return _Candidate(removal, rows.variables, through.T @ combination, float(np.sqrt(test)))


def _name(at: Linearised, kind: MeasureKind, row: int) -> str:
    """Name of a whole observation."""
    network = at.network
    if kind is MeasureKind.RAY:
        of, image = network.points.ids[network.rays.point[row]], network.images[network.rays.image[row]].name
        return f"ray of point {of} in image {image}"
    if kind is MeasureKind.RANGE:
        of, image = network.points.ids[network.ranges.point[row]], network.images[network.ranges.image[row]].name
        return f"range of point {of} in image {image}"
    return f"{_OF_POINT[kind]} of point {network.points.ids[row]}"
