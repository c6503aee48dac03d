"""How far the measures control each other: redundancy numbers, tests, and the blunders that would go unnoticed.

Of every scalar measure that takes part: its redundancy number r (what of an error in it shows in its own residual), the
w-test of its residual, the minimal detectable blunder, and what a blunder of that size, unnoticed, does to its point
and to any result (Baarda 1968; Foerstner & Wrobel 2016, section 4.6). Rejected rows don't take part. With a robust loss
a row of weight p keeps its own sigma in its test, while the others keep their weights: the test is that of the
residual against what the others predict. One without weight doesn't take part.

Measures that may be blunders, and those that can't be separated from them.

Tests of the same point are correlated. Where the modulus of a correlation is above 0.99, a blunder of one minimal
detectable blunder (4.13 sigmas of its test) shifts the two tests by amounts that differ by 0.3 sigmas of their
difference: the wrong one is the larger in four cases of ten, so both are named (Foerstner 1983 on separability). The
four coordinates of a tie with two rays share a single redundancy, and always are one group. Measures of different
points are not grouped, nor are a-priori values of the orientation with what they could be mistaken for.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.blunders import INSEPARABLE, pair_tests, residual_covariance, swept
from mgsgraph.adjustment.covariances import Linearised, PointRows
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph.forms import BETWEEN, EFFECT, MISFIT, SHARE
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import PriorRows, at_solution, prior_rows
from mgsgraph.analysis.measures import (
    Indices,
    Levels,
    MeasureKind,
    ScalarMeasures,
    Small,
    empty_measures,
    judge_ground_priors,
    judge_scalars,
    names_of,
    units_of,
)
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.kernel.rows import GROUND, NO_LOSS, OUT, PRIOR
from mgsgraph.record import Record

_BOTH = np.arange(2, dtype=np.int8)
_EXACT = 1e-12
"""Residual in sigmas below which its robust weight is taken as one."""


class _Roots(NamedTuple):
    """Roots of robust weights."""

    rays: Array
    """(k,) network order."""
    ranges: Array
    """(r,) network order."""
    stereo: Array
    """(q,) of heights above stereo surfaces, in the order of the layout's `StereoRows.points`."""


@dataclass(frozen=True, slots=True, eq=False)
class Reliability(Record):
    """Reliability of an adjustment: `measures`, in the order of kinds, and within these of the network's rows."""

    at: Linearised
    """The linearised network."""
    levels: Levels
    """Significance and power of the tests."""
    measures: ScalarMeasures
    """All measures that take part."""
    critical: float
    """Modulus that a good measure's test exceeds with probability alpha."""
    sigma0: float
    """A-posteriori standard deviation of unit weight; tests are for 1, as the a-priori sigmas imply."""
    degrees_of_freedom: float
    """Sum of the redundancy numbers."""

    def __len__(self) -> int:
        return self.measures.test.size

    @property
    def uncontrolled(self) -> Index:
        """(u,) measures that nothing controls: a blunder of any size goes unnoticed."""
        return np.flatnonzero(np.isinf(self.measures.detectable))

    @property
    def suspected(self) -> Index:
        """(s,) measures whose test exceeds the critical value, largest first."""
        return self.order(int(np.count_nonzero(np.abs(self.measures.test) > self.critical)))

    def order(self, most: int) -> Index:
        """The `most` measures of the largest |w|, largest first; equal ones, as of a ray, in their own order."""
        size = np.nan_to_num(np.abs(self.measures.test), nan=-1.0)
        return np.argsort(-size.round(6), kind="stable")[:most]

    def unit(self, measure: int) -> str:
        """Unit of a measure: px, m, rad or s."""
        return self.units(np.array([measure]))[0]

    def name(self, measure: int) -> str:
        """What a measure is, in words."""
        return self.names(np.array([measure]))[0]

    def units(self, measures: Index) -> list[str]:
        """Units of many measures (k,)."""
        return units_of(self.at.layout, self.measures, measures)

    def names(self, measures: Index) -> list[str]:
        """Names of many measures (k,)."""
        return names_of(self.at.layout, self.measures, measures)

    def __repr__(self) -> str:
        return (
            f"Reliability({len(self)} measures, {self.degrees_of_freedom:.1f} degrees of freedom, "
            f"{self.suspected.size} tests over {self.critical:.3g}, {self.uncontrolled.size} measures uncontrolled)"
        )


def reliability(of: Linearised | Solution, levels: Levels | None = None) -> Reliability:
    """Reliability of all measures that take part.

    Parameters
    ----------
    of : Solution or Linearised
        At its solution.
    levels : Levels, optional
        Sizes of the tests; Baarda's customary ones when absent: significance 0.001, power 0.80.

    Returns
    -------
    Reliability
        `measures` has arrays (m,): redundancy numbers, w-tests, minimal detectable blunders (px, m, rad or s) ...

    Examples
    --------
    >>> found = mgsgraph.reliability(solution)
    >>> print(found)
    Reliability(180 measures, 60.0 degrees of freedom, 0 tests over 3.29, 12 measures uncontrolled)
    >>> worst = np.argsort(-np.abs(found.measures.test))[:2]
    >>> print(found.names(worst), found.measures.test[worst].round(1))
    ['sample of point SHOT00004 in image SIM/B', 'a-priori x of point SHOT00008'] [-3.1  3. ]
    """
    at, levels = (of if isinstance(of, Linearised) else at_solution(of)).of_estimator(), levels or Levels()
    points = np.flatnonzero(at.layout.network_order(at.rows.kind) == PRIOR)
    places = _ground_indices(at, points)
    numbers, ground = swept(at, places)
    roots = _robust_roots(at, numbers)
    used, shots, heights, stereo = _taking_part(at, roots)
    priors_of_unknowns = prior_rows(at)
    counts = shots.size, 3 * points.size, heights.size, stereo.size, priors_of_unknowns.about.size
    ends = np.cumsum([0, 2 * int(np.count_nonzero(used)), *counts]).tolist()
    out = empty_measures(ends[-1])
    rays, ranges, apriori, surface, on_stereo, priors = (out.part(a, b) for a, b in pairwise(ends))
    squares = _rays(rays, at, numbers, used, roots, levels)
    network, index = at.network, at.layout.observation_rows
    root = None if roots is None else roots.ranges[shots]
    squares += _singles(
        ranges, MeasureKind.RANGE, numbers, network.ranges.sigmas[shots], root, levels,
        shots, network.ranges.point[shots], network.ranges.image[shots], index.ranges[shots],
    )  # fmt: skip
    thrice = np.repeat(points, 3)
    apriori.say(MeasureKind.GROUND, np.tile(np.arange(3), points.size), thrice, thrice, -1, np.repeat(places, 3))
    squares += judge_ground_priors(apriori, at.network.points.covariances[points], ground, levels)
    if network.surface is not None:
        point = index.on_terrain[heights]
        sigmas, where = network.surface.sigmas[point], (point, point, -1, index.heights[heights])
        squares += _singles(surface, MeasureKind.HEIGHT, numbers, sigmas, None, levels, *where)
    squares += _priors(priors, at, priors_of_unknowns, levels)
    if network.stereo is not None and at.layout.stereo is not None:
        point, root = at.layout.stereo.points[stereo], None if roots is None else roots.stereo[stereo]
        sigmas, where = network.stereo.sigmas[point], (point, point, -1, index.stereo[stereo])
        squares += _singles(on_stereo, MeasureKind.STEREO, numbers, sigmas, root, levels, *where)
    degrees = float(out.redundancy.sum())
    sigma0 = float(np.sqrt(squares / degrees)) if degrees > 0.0 else float("nan")
    return Reliability(at, levels, out, levels.critical, sigma0, degrees)


def _taking_part(at: Linearised, roots: _Roots | None) -> tuple[Mask, Index, Index, Index]:
    """Which rays (k,) take part; ranges, heights above the terrain and above stereo surfaces by their place among the
    network's.
    """
    network, places = at.network, at.layout.observation_rows
    used = _used(at, places.rays, network.rays.point, None if roots is None else roots.rays)
    shots = np.flatnonzero(_used(at, places.ranges, network.ranges.point, None if roots is None else roots.ranges))
    stereo = no_rows()
    if at.layout.stereo is not None:
        of_stereo = None if roots is None else roots.stereo
        stereo = np.flatnonzero(_used(at, places.stereo, at.layout.stereo.points, of_stereo))
    if network.surface is None:
        return used, shots, stereo[:0], stereo
    return used, shots, np.flatnonzero(_used(at, places.heights, places.on_terrain, None)), stereo


def _ground_indices(at: Linearised, points: Index) -> Index:
    """(g,) places among all observations of the a-priori places of network points."""
    rows, index_of = at.rows, at.layout.patterns.point_index
    of_pattern = np.full(rows.pattern_group.size, -1)
    of_ground = np.flatnonzero(rows.observation_kind == GROUND)
    pattern = np.searchsorted(rows.pattern_observation, of_ground, side="right") - 1
    of_pattern[pattern] = of_ground - rows.pattern_observation[pattern]
    inside = index_of[points]
    pattern, first, count, _, observation = rows.piece[at.layout.patterns.piece_of(inside)].T
    return np.asarray(observation + of_pattern[pattern] * count + inside - first, dtype=np.int64)


def _robust_roots(at: Linearised, numbers: Array) -> _Roots | None:
    """Roots of the robust weights; None without a loss."""
    if at.layout.model.loss == NO_LOSS:
        return None
    network, places = at.network, at.layout.observation_rows
    raw = residuals(at.layout, at.orientation, at.points)
    on, sigmas = no_rows(), np.zeros(0)
    if at.layout.stereo is not None and network.stereo is not None:
        on, sigmas = at.layout.stereo.points, network.stereo.sigmas
    plain = (
        np.linalg.norm(raw.image / network.rays.sigmas, axis=1), np.abs(raw.ranges / network.ranges.sigmas),
        np.abs(raw.stereo[on] / sigmas[on]),
    )  # fmt: skip
    scaled = (
        np.linalg.norm(numbers[places.rays, MISFIT], axis=1), np.abs(numbers[places.ranges, 0]),
        np.abs(numbers[places.stereo, 0]),
    )  # fmt: skip
    return _Roots(*(
        np.where(unweighted > _EXACT, part / np.maximum(unweighted, _EXACT), 1.0)
        for part, unweighted in zip(scaled, plain, strict=True)
    ))  # fmt: skip


def _rays(
    out: ScalarMeasures, at: Linearised, numbers: Array, used: Mask, roots: _Roots | None, levels: Levels
) -> float:
    """Fill in the rays; their sum of squares."""
    rays, chosen = at.network.rays, np.flatnonzero(used)
    index, root = at.layout.observation_rows.rays[chosen], None if roots is None else roots.rays[chosen]
    of_rays, point, image = numbers[index], np.repeat(rays.point[chosen], 2), np.repeat(rays.image[chosen], 2)
    out.say(MeasureKind.RAY, np.tile(_BOTH, chosen.size), np.repeat(chosen, 2), point, image, np.repeat(index, 2))
    misfit, share, effect = (of_rays[:, columns].ravel() for columns in (MISFIT, SHARE, EFFECT))
    twice = None if root is None else np.repeat(root, 2)
    judge_scalars(out, rays.sigmas[chosen].ravel(), misfit, share, effect, twice, levels)
    joint, dimensions = pair_tests(of_rays[:, MISFIT], of_rays[:, SHARE], of_rays[:, BETWEEN], root)
    out.joint[:], out.dimensions[:] = np.repeat(joint, 2), np.repeat(dimensions, 2)
    return float(misfit @ misfit)


def _singles(
    out: ScalarMeasures, kind: MeasureKind, numbers: Array, sigmas: Array, root: Array | None, levels: Levels,
    row: Index, point: Index, image: Index | int, index: Index,
) -> float:  # fmt: skip
    """Fill in observations of one row with a-priori `sigmas`; their sum of squares."""
    out.say(kind, _zeros(row), row, point, image, index)
    misfit, share, effect = numbers[index][:, [0, 2, 4]].T
    # the kernel's heights are those of the points above the model: predicted, where 0 is measured
    sign = 1.0 if kind == MeasureKind.RANGE else -1.0
    judge_scalars(out, sigmas, sign * misfit, share, effect, root, levels)
    return float(misfit @ misfit)


def _priors(out: ScalarMeasures, at: Linearised, priors: PriorRows, levels: Levels) -> float:
    """Fill in a-priori values of the shared unknowns, all of them zero, and crossovers; their sum of squares."""
    about = priors.about
    variables = at.layout.variables
    adjusted = np.array(variables.adjusted(), dtype=np.int64)
    variable = np.repeat(adjusted, variables.width[adjusted])[about]
    image = np.where(variable < variables.images, variable, -1)
    out.say(MeasureKind.PRIOR, about - variables.first[variable], about, -1, image, -1)
    last = out.part(about.size - priors.crossovers, about.size)
    last.say(MeasureKind.CROSSOVER, _zeros(about)[: priors.crossovers], np.arange(priors.crossovers), -1, -1, -1)
    judge_scalars(out, priors.sigma, priors.misfit, priors.share, np.full(about.size, np.nan), None, levels)
    return float(priors.misfit @ priors.misfit)


def _used(at: Linearised, places: Index | Indices, points: Index, root: Array | None) -> Mask:
    """Which observations take part, by their places and points."""
    used = (at.rows.weight[0, places] > 0.0) & (at.layout.network_order(at.rows.kind)[points] != OUT)
    return np.asarray(used if root is None else used & (root > 0.0))


def _zeros(like: Index) -> Small:
    return np.zeros(like.size, dtype=np.int8)


_NOTHING = 1e-12
"""Redundancy that is rounding: it has no direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A measure with a large test, and those that can't be separated from it."""

    measures: Index
    """(k,) in `Reliability.measures`: the one with the largest test, then the others, by the size of theirs."""
    point: int
    """Network point; -1 for an a-priori value of what points share."""
    test: float
    """Largest test, with its sign."""
    over: bool
    """Whether it exceeds the critical value."""


def suspects(tested: Reliability, most: int = 20) -> tuple[Suspect, ...]:
    """The `most` suspicious measures, or groups of such as can't be separated, worst first."""
    groups, listed = list[Suspect](), set[int]()
    index = PointIndex(tested.measures.point, len(tested.at.network.points))
    correlations: dict[int, tuple[Index, Array]] = {}
    for k in map(int, tested.order(len(tested))):
        if len(groups) == most or np.isnan(tested.measures.test[k]):
            break
        if k in listed:
            continue
        point, group = int(tested.measures.point[k]), np.array([k])
        if point >= 0:
            if point not in correlations:
                correlations[point] = correlations_of_tests(tested, index, point)
            rows, matrix = correlations[point]
            row = np.abs(matrix[np.flatnonzero(rows == k)[0]])
            confused = rows[(row > INSEPARABLE) & (rows != k)]
            size = np.nan_to_num(np.abs(tested.measures.test[confused]), nan=-1.0)
            group = np.append(group, confused[np.argsort(-size, kind="stable")])
        listed.update(group.tolist())
        test = float(tested.measures.test[k])
        groups.append(Suspect(group, point, test, abs(test) > tested.critical))
    return tuple(groups)


class PointIndex:
    """Which rows each point has.

    Parameters
    ----------
    points : (m,)
        Point of each row; -1 for rows of none.
    count : int
        Number of points.
    """

    def __init__(self, points: Index | Indices, count: int) -> None:
        self._order = np.argsort(points, kind="stable")
        self._first = np.searchsorted(points[self._order], np.arange(count + 1))

    def of(self, point: int) -> Index:
        """(q,) rows of a point, ascending."""
        return self._order[self._first[point] : self._first[point + 1]]


def correlations_of_tests(tested: Reliability, index: PointIndex, point: int) -> tuple[Index, Array]:
    """Measures (q,) of a network point, and the correlations (q, q) of their tests; NaN where they have no test."""
    measures = index.of(point)
    rows = tested.at.rows_of(point)
    chosen = combinations(tested, measures, rows)
    covariance = chosen.T @ residual_covariance(tested.at, rows)[0][0] @ chosen
    variance, size = np.diagonal(covariance), np.einsum("rq,rq->q", chosen, chosen)
    sigma = np.sqrt(np.where(variance > _NOTHING * size, variance, np.nan))
    return measures, np.asarray(covariance / sigma[:, None] / sigma)


def combinations(tested: Reliability, measures: Index, rows: PointRows) -> Array:
    """(r, q) whitened rows of a point that an error of one sigma in each of its measures goes into.

    A ray's coordinates are rows; errors of an a-priori place go through the square root of its information.
    """
    table, at = tested.measures, tested.at
    point = int(table.point[measures[0]])
    index = int(at.layout.patterns.point_index[point])
    _, first, count, _, observation = at.rows.piece[at.layout.patterns.piece_of(index)].tolist()
    slot = (table.observation[measures] - observation - (index - first)) // count
    chosen = np.zeros((rows.row.size, measures.size))
    for q, k in enumerate(measures.tolist()):
        of_slot = np.flatnonzero(rows.observation == slot[q])
        if table.kind[k] == MeasureKind.GROUND:
            chosen[of_slot, q] = _root(at.network.points.covariances[point])[:, table.component[k]] * table.sigma[k]
        else:
            chosen[of_slot[table.component[k]], q] = 1.0
    return chosen


def _root(covariance: Array) -> Array:
    """Upper triangular U with U'U the inverse."""
    information = np.linalg.inv(covariance)
    return np.asarray(np.linalg.cholesky(0.5 * (information + information.T)).T)
