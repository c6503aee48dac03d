"""Data snooping: an adjustment without its blunders (`adjustment.blunders`), and what the others say of what is out.

The search is that of `SolverSettings.reject`, at Baarda's critical value and by plain least squares: rays, ranges and
heights above stereo surfaces. A-priori positions, heights above terrain models and priors are tested
(`analysis.reliability`), and stay.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.blunders import Judged, critical_value, judged, pieces_of
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.predicted_lines import exactly
from mgsgraph.adjustment.redundancy import closure, prediction
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.measures import Levels
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Mask
from mgsgraph.kernel.rows import OUT
from mgsgraph.kernel.sweep import COSTS
from mgsgraph.network import Network
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True)
class Removal(Record):
    """Observations of a point that are out."""

    point: int
    """Network point."""
    names: tuple[str, ...]
    """Of the observations, for reports."""
    test: float
    """How far they are from what the others predict for them, chi-square; of a point that nothing else determines, how
    badly all that it has meets. NaN where it has no position."""
    dimensions: int
    """Degrees of freedom of the test."""
    critical: float
    """Critical value of the test."""


@dataclass(frozen=True, slots=True, eq=False)
class Snooping(Record):
    """What data snooping took out, and what is left."""

    solution: Solution
    """The last adjustment, with `rays_rejected`, `ranges_rejected` and `stereo_rejected`."""
    removals: tuple[Removal, ...]
    """What is out, point by point, the largest test over its critical value first."""


def snoop(
    network: Network, settings: SolverSettings | None = None, levels: Levels | None = None, name: str = "adjustment"
) -> Snooping:
    """Adjust a network without its blunders.

    Parameters
    ----------
    settings : SolverSettings, optional
        Its loss and its own limit of blunders are not used: tests presume plain least squares.
    levels : Levels, optional
        Sizes of the tests.
    name : str
        What to call the adjustment in reports.

    Examples
    --------
    >>> from mgsgraph.analysis.snooping import snoop
    >>> found = snoop(network)
    >>> len(found.removals)
    0
    """
    limit = (levels or Levels()).critical
    if limit < 2.0:
        raise InputError("data snooping, alpha", f"critical value {limit:.3g}", "2 or more", "alpha of 0.045 or less")
    solution = adjust_network(network, replace(settings or SolverSettings(), loss="none", reject=limit), name)
    return Snooping(solution, removals(solution, limit))


def removals(solution: Solution, limit: float) -> tuple[Removal, ...]:
    """What an adjustment rejected, judged by what it left in; `limit` in standard deviations of a normal error."""
    masks = (solution.rays_rejected, solution.ranges_rejected, solution.stereo_rejected)
    out = np.concatenate([mask for mask in masks if mask is not None])
    if not np.any(out):
        return ()
    whole = _with_all_rows(solution)
    found = _judged(solution, whole, judged(whole.layout), out, limit)
    return tuple(sorted(found, key=lambda one: -np.nan_to_num(one.test / one.critical, nan=np.inf)))


def _with_all_rows(solution: Solution) -> Linearised:
    """The network at a solution, the rows that this rejected with the others."""
    at = at_solution(solution).of_estimator()
    layout = lay_out(solution.network, at.settings, solution.places)
    by_all = BundleGraph(layout, layout.rows).reduction(at.orientation, COSTS).points
    determined = solution.determined[layout.point_order]
    points = np.where(determined[:, None], solution.places[layout.point_order], by_all)
    layout, points = exactly(layout, at.orientation, points)
    return Linearised(layout, at.settings, layout.rows, at.orientation, points, at.joint)


def _judged(solution: Solution, whole: Linearised, mine: Judged, out: Mask, limit: float) -> Iterator[Removal]:
    lost = whole.layout.network_order(whole.rows.kind) == OUT
    points = np.unique(mine.point[out & (mine.place >= 0)])
    for point in points[lost[points]].tolist():
        gone = np.flatnonzero(out & (mine.point == point) & (mine.place >= 0))
        yield Removal(point, tuple(_name(solution.network, k) for k in gone.tolist()), np.nan, 0, np.inf)
    for rows, table in pieces_of(whole, mine, points[~lost[points]]):
        shared = whole.joint.of(rows.variables)
        for k, numbers in enumerate(table):
            slots = np.flatnonzero((numbers >= 0) & out[numbers])
            back, point = np.isin(rows.observation, slots), int(mine.point[numbers[slots[0]]])
            if solution.determined[point]:
                test, dimensions = prediction(rows.of(k), back, ~back[None], shared), np.count_nonzero(back)
            else:
                test, (dimensions,) = closure(rows.of(k), np.ones((1, back.size), dtype=np.bool_), shared)
            names = tuple(_name(solution.network, number) for number in numbers[slots].tolist())
            yield Removal(point, names, float(test[0]), int(dimensions), critical_value(limit, int(dimensions)))


def _name(network: Network, number: int) -> str:
    """Name of an observation, counted as in `Judged`."""
    for what, measured in (("ray", network.rays), ("range", network.ranges)):
        if number < measured.point.size:
            image = network.images[measured.image[number]].name
            return f"{what} of point {network.points.ids[measured.point[number]]} in image {image}"
        number -= measured.point.size
    return f"height above the stereo surface of point {network.points.ids[number]}"
