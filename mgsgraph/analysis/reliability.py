"""How far the measures control each other: redundancy numbers, tests, and the blunders that would go unnoticed.

Of every scalar measure that takes part: its redundancy number r (what of an error in it shows in its own residual), the
w-test of its residual, the minimal detectable blunder, and what a blunder of that size, unnoticed, does to its point
and to any result (Baarda 1968; Foerstner & Wrobel 2016, section 4.6). Rejected rows don't take part. With a robust loss
a row of weight p keeps its own sigma in its test, while the others keep their weights: the test is that of the
residual against what the others predict. One without weight doesn't take part.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.bundle import BETWEEN, EFFECT, MISFIT, SHARE
from mgsgraph.adjustment.linearised import Linearised
from mgsgraph.adjustment.redundancy import pair_tests, swept
from mgsgraph.adjustment.residuals import residuals
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
from mgsgraph.compiled import in_threads
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import GROUND, NO_LOSS, OUT, PRIOR
from mgsgraph.record import Record

_RAYS = 1 << 18
"""Rays: large pages of memory, which arrays of 4 MB and more get, cost least."""
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
    """A-posteriori standard deviation of unit weight; tests are divided by it where `levels.scaled` says so."""
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

    @property
    def severity(self) -> Array:
        """(m,) root of the joint test over its critical value: above 1, the ray, range or a-priori place is suspected.

        By the B-method, so that tests of one, two and three dimensions compare.
        """
        limits = np.array([np.inf, *(self.critical_joint(k) for k in (1, 2, 3))])
        return np.asarray(np.sqrt(self.measures.joint / limits[self.measures.dimensions]))

    def critical_joint(self, dimensions: int) -> float:
        """Critical value of a joint test of so many dimensions."""
        return self.critical**2 if dimensions == 1 else self.levels.critical_squares(dimensions)

    def order(self, most: int) -> Index:
        """The `most` measures of the largest |w|, largest first."""
        size = np.nan_to_num(np.abs(self.measures.test), nan=-1.0)
        most = min(most, size.size)
        if most == 0:
            return np.zeros(0, dtype=np.int64)
        chosen = np.argpartition(size, size.size - most)[size.size - most :]
        return np.asarray(chosen[np.lexsort((chosen, -size[chosen]))])

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
    of : Linearised or Solution
        At its solution.
    levels : Levels, optional
        Sizes of the tests; Baarda's customary ones when absent.

    Examples
    --------
    >>> from mgsgraph.analysis.reliability import reliability
    >>> found = reliability(solution)
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
    known = prior_rows(at)
    counts = shots.size, 3 * points.size, heights.size, stereo.size, known.about.size
    ends = np.cumsum([0, 2 * int(np.count_nonzero(used)), *counts]).tolist()
    out = empty_measures(ends[-1])
    rays, ranges, apriori, surface, on_stereo, priors = (out.part(a, b) for a, b in pairwise(ends))
    squares = sum(_rays(rays, at, numbers, used, roots, levels))
    squares += _ranges(ranges, at, numbers, shots, roots, levels)
    thrice = np.repeat(points, 3)
    apriori.say(MeasureKind.GROUND, np.tile(np.arange(3), points.size), thrice, thrice, -1, np.repeat(places, 3))
    squares += judge_ground_priors(apriori, at.network.points.covariances[points], ground, levels)
    squares += _heights(surface, at, numbers, heights, levels) + _priors(priors, at, known, levels)
    squares += _stereo(on_stereo, at, numbers, stereo, roots, levels)
    degrees = float(out.redundancy.sum())
    sigma0 = float(np.sqrt(squares / degrees)) if degrees > 0.0 else float("nan")
    if levels.scaled:
        for values, scale in ((out.test, sigma0), (out.joint, sigma0**2)):
            values /= scale
        for values in (out.detectable, out.effect, out.external):
            values *= sigma0
    critical = levels.critical_tau(degrees) if levels.scaled else levels.critical
    return Reliability(at, levels, out, critical, sigma0, degrees)


def _taking_part(at: Linearised, roots: _Roots | None) -> tuple[Mask, Index, Index, Index]:
    """Which rays (k,) take part; ranges, heights above the terrain and above stereo surfaces by their place among the
    network's.
    """
    network, places = at.network, at.layout.observation_rows
    used = _used(at, places.rays, network.rays.point, None if roots is None else roots.rays)
    shots = np.flatnonzero(_used(at, places.ranges, network.ranges.point, None if roots is None else roots.ranges))
    stereo = np.zeros(0, dtype=np.int64)
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
    own = np.flatnonzero(rows.observation_kind == GROUND)
    pattern = np.searchsorted(rows.pattern_observation, own, side="right") - 1
    of_pattern[pattern] = own - rows.pattern_observation[pattern]
    inside = index_of[points]
    pattern, first, count, _, observation = rows.piece[at.layout.patterns.piece_of(inside)].T
    return np.asarray(observation + of_pattern[pattern] * count + inside - first, dtype=np.int64)


def _robust_roots(at: Linearised, numbers: Array) -> _Roots | None:
    """Roots of the robust weights; None without a loss."""
    if at.layout.model.loss == NO_LOSS:
        return None
    network, places = at.network, at.layout.observation_rows
    found = residuals(at.layout, at.orientation, at.points)
    on, sigmas = np.zeros(0, dtype=np.int64), np.zeros(0)
    if at.layout.stereo is not None and network.stereo is not None:
        on, sigmas = at.layout.stereo.points, network.stereo.sigmas
    plain = (
        np.linalg.norm(found.image / network.rays.sigmas, axis=1), np.abs(found.ranges / network.ranges.sigmas),
        np.abs(found.stereo[on] / sigmas[on]),
    )  # fmt: skip
    scaled = (
        np.linalg.norm(numbers[places.rays, MISFIT], axis=1), np.abs(numbers[places.ranges, 0]),
        np.abs(numbers[places.stereo, 0]),
    )  # fmt: skip
    return _Roots(*(
        np.where(whole > _EXACT, part / np.maximum(whole, _EXACT), 1.0)
        for part, whole in zip(scaled, plain, strict=True)
    ))  # fmt: skip


def _rays(
    out: ScalarMeasures, at: Linearised, numbers: Array, used: Mask, roots: _Roots | None, levels: Levels
) -> list[float]:
    """Fill in the rays; their sums of squares, part by part."""
    rays, places = at.network.rays, at.layout.observation_rows.rays
    edges = [*range(0, used.size, _RAYS), used.size]
    counts = [int(np.count_nonzero(used[a:b])) for a, b in pairwise(edges)]
    begins = dict(zip(edges, 2 * np.cumsum([0, *counts]), strict=True))

    def part(ends: tuple[int, int]) -> float:
        first, last = ends
        number = np.arange(first, last, dtype=np.int32)
        chosen: slice | Index = slice(first, last)
        if begins[last] - begins[first] < 2 * number.size:
            number, chosen = number[used[first:last]], np.flatnonzero(used[first:last]) + first
        index, root = places[chosen], None if roots is None else roots.rays[chosen]
        found, mine = numbers[index], out.part(begins[first], begins[last])
        point, image = np.repeat(rays.point[chosen], 2), np.repeat(rays.image[chosen], 2)
        mine.say(MeasureKind.RAY, np.tile(_BOTH, number.size), np.repeat(number, 2), point, image, np.repeat(index, 2))
        misfit, share, effect = (found[:, columns].ravel() for columns in (MISFIT, SHARE, EFFECT))
        twice = None if root is None else np.repeat(root, 2)
        judge_scalars(mine, rays.sigmas[chosen].ravel(), misfit, share, effect, twice, levels)
        joint, dimensions = pair_tests(found[:, MISFIT], found[:, SHARE], found[:, BETWEEN], root)
        mine.joint[:], mine.dimensions[:] = np.repeat(joint, 2), np.repeat(dimensions, 2)
        return float(misfit @ misfit)

    return in_threads(part, pairwise(edges))


def _ranges(
    out: ScalarMeasures, at: Linearised, numbers: Array, shots: Index, roots: _Roots | None, levels: Levels
) -> float:
    """Fill in the ranges; their sum of squares."""
    ranges, index = at.network.ranges, at.layout.observation_rows.ranges[shots]
    out.say(MeasureKind.RANGE, _zeros(shots), shots, ranges.point[shots], ranges.image[shots], index)
    root = None if roots is None else roots.ranges[shots]
    misfit, share, effect = numbers[index][:, [0, 2, 4]].T
    judge_scalars(out, ranges.sigmas[shots], misfit, share, effect, root, levels)
    return float(misfit @ misfit)


def _heights(out: ScalarMeasures, at: Linearised, numbers: Array, chosen: Index, levels: Levels) -> float:
    """Fill in the heights above the terrain; their sum of squares."""
    if at.network.surface is None:
        return 0.0
    point, index = at.layout.observation_rows.on_terrain[chosen], at.layout.observation_rows.heights[chosen]
    out.say(MeasureKind.HEIGHT, _zeros(point), point, point, -1, index)
    misfit, share, effect = numbers[index][:, [0, 2, 4]].T
    # the kernel's are heights of the points above the terrain: predicted, where 0 is measured
    judge_scalars(out, at.network.surface.sigmas[point], -misfit, share, effect, None, levels)
    return float(misfit @ misfit)


def _stereo(
    out: ScalarMeasures, at: Linearised, numbers: Array, chosen: Index, roots: _Roots | None, levels: Levels
) -> float:
    """Fill in the heights above stereo surfaces; their sum of squares."""
    if at.network.stereo is None or at.layout.stereo is None:
        return 0.0
    point, index = at.layout.stereo.points[chosen], at.layout.observation_rows.stereo[chosen]
    out.say(MeasureKind.STEREO, _zeros(point), point, point, -1, index)
    misfit, share, effect = numbers[index][:, [0, 2, 4]].T
    # as of the terrain, the kernel's are heights: predicted, where 0 is measured
    root = None if roots is None else roots.stereo[chosen]
    judge_scalars(out, at.network.stereo.sigmas[point], -misfit, share, effect, root, levels)
    return float(misfit @ misfit)


def _priors(out: ScalarMeasures, at: Linearised, known: PriorRows, levels: Levels) -> float:
    """Fill in a-priori values of the shared unknowns, all of them zero, and crossovers; their sum of squares."""
    about = known.about
    variables = at.layout.variables
    adjusted = np.array(variables.adjusted(), dtype=np.int64)
    variable = np.repeat(adjusted, variables.width[adjusted])[about]
    image = np.where(variable < variables.images, variable, -1)
    out.say(MeasureKind.PRIOR, about - variables.first[variable], about, -1, image, -1)
    last = out.part(about.size - known.crossovers, about.size)
    last.say(MeasureKind.CROSSOVER, _zeros(about)[: known.crossovers], np.arange(known.crossovers), -1, -1, -1)
    judge_scalars(out, known.sigma, known.misfit, known.share, np.full(about.size, np.nan), None, levels)
    return float(known.misfit @ known.misfit)


def _used(at: Linearised, places: Index | Indices, points: Index, root: Array | None) -> Mask:
    """Which observations take part, by their places and points."""
    used = (at.rows.weight[0, places] > 0.0) & (at.layout.network_order(at.rows.kind)[points] != OUT)
    return np.asarray(used if root is None else used & (root > 0.0))


def _zeros(like: Index) -> Small:
    return np.zeros(like.size, dtype=np.int8)
