"""Checks of finished measures: rays that meet, heights like their neighbors', and an even spread.

Whether what was matched between two pictures is one ground: four signs, none of which decides alone.

False matches stand every check of single matches: among thousands of windows some agree, the way back ends where it
began, and a correction with eighteen coefficients makes the rays of a dozen meet. Together they can be detected:
few of the surest features end as a match, few agreed on an orientation, they lie in few cells, and their rays miss each
other by far more than their sigmas say, from one match to the next. Good pairs show one of these signs: noise costs
matches, jitter of the spacecraft moves rays. So two signs refuse a pair, and one is said. The limits lie between what
good and false pairs have shown (docs/evidence_terrain.md); `chance_agreements` is theory.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.coarse import Agreement, consensus, displacements, robust_sigma, units_between
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.scene import Pair, Scene, by_pair
from mgsgraph.text import listed

_DEGREE = 2
"""Of the correction that two pictures' finished measures are allowed."""
_ROUGH = 0.75
"""pixels of the ground grid, sigma of a match in the first look."""
_LIMIT = 4.0
"""Robust standard deviations of coplanarity residuals within which a match is kept."""
_LEAST_LIMIT = 0.3
"""pixels of the ground grid, within which it is kept in any case."""
_HEIGHT_LIMIT = 6.0
"""Robust standard deviations of heights against neighbours' within which a match is kept."""
_LEAST_HEIGHT_LIMIT = 1.5
"""pixels of displacement by height, within which it is kept in any case."""
_NEIGHBOURS = 8
_UNKNOWN = 1e4
"""m, unit of a position without a prior."""
_FEWEST = 12
"""Matches of a pair that have to be coplanar under one correction."""


class MeasureChecks(NamedTuple):
    """Whether n measures are consistent with one another."""

    coplanar: Mask
    """(n,) the rays meet, under one correction of the picture's orientation."""
    steady: Mask
    """(n,) the height is like the neighbours'."""
    misfit: Array
    """(n,) m on the ground, the coplanarity residual that remains; NaN where it wasn't asked."""


def checked_measures(scene: Scene, measures: Measured, step: float, seed: int) -> MeasureChecks:
    """Check measures, pair of pictures by pair; `step` is the pixel of the ground grid in m."""
    n = measures.track.size
    coplanar, steady, misfit = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), np.full(n, np.nan)
    for _, _, rows in by_pair(measures.first, measures.other):
        coplanar[rows], steady[rows], misfit[rows] = _of_pair(scene, measures.some(rows), step, seed)
    return MeasureChecks(coplanar, steady, misfit)


def _of_pair(scene: Scene, measures: Measured, step: float, seed: int) -> tuple[Mask, Mask, Array]:
    first, second = (scene.pictures[int(j[0])] for j in (measures.first, measures.other))
    sigmas = units_between(first, second, _DEGREE, _UNKNOWN)
    displaced = displacements(first, second, (measures.anchors, measures.pixels), scene.ground, sigmas)
    rng = np.random.default_rng(seed)
    correction, fits = consensus(displaced, _ROUGH * step, scene.ground.height_sigma, rng)
    across, along = displaced.residuals(correction).T
    limit = max(_LIMIT * robust_sigma(across[fits]), _LEAST_LIMIT * step)
    coplanar = np.abs(across - (np.median(across[fits]) if np.any(fits) else 0.0)) <= limit
    if np.count_nonzero(coplanar) < _FEWEST:  # so few agree with any orientation
        coplanar[:] = False
    steady = np.zeros(coplanar.size, dtype=bool)
    steady[coplanar] = _like_neighbours(first.on_chart(scene.ground, measures.anchors[coplanar]), along[coplanar], step)
    return coplanar, steady, across


def _like_neighbours(plane: Array, along: Array, step: float) -> Mask:
    """(n,) displacements by height (m) that are like the median of the nearest eight's."""
    from scipy.spatial import cKDTree

    if along.size <= _NEIGHBOURS:
        return np.ones(along.size, dtype=bool)
    _, near = cKDTree(plane).query(plane, _NEIGHBOURS + 1)
    off = along - np.median(along[near[:, 1:]], axis=1)
    return np.asarray(np.abs(off) <= max(_HEIGHT_LIMIT * robust_sigma(off), _LEAST_HEIGHT_LIMIT * step))


def cell_numbers(plane: Array, cell: float) -> Index:
    """(n,) one number for the square cell of `cell` m in which each position (n, 2) of the chart lies."""
    row, column = np.floor(plane / cell).astype(np.int64).T
    return np.asarray(row * np.int64(1 << 31) + column)


def spread(cells: Index, pairs: Index, quality: Array, most: int) -> Mask:
    """(n,) which are the best `most` of their cell and pair (n,): those whose `quality` (n,) is smallest."""
    order = np.lexsort([quality, pairs, cells])
    new = np.ones(order.size, dtype=bool)
    new[1:] = (np.diff(cells[order]) != 0) | (np.diff(pairs[order]) != 0)
    begin = np.maximum.accumulate(np.where(new, np.arange(order.size), 0))
    chosen = np.zeros(order.size, dtype=bool)
    chosen[order] = np.arange(order.size) - begin < most
    return chosen


# --- pairs of pictures


_AGREED = 0.3
"""Share of the coarse matches below which too few agree on an orientation."""
_YIELD = 0.1
"""Share of the features tried below which too few are found again both ways."""
_FILLED = 0.02
"""Share of the cells of common ground below which too few have a match."""
_SCATTER = 2.5
"""Times the stated sigma by which rays may miss each other from one match to the next."""
_BESIDE = 4
"""Matches before and after one, by line, against whose median it is held: jitter is common to them."""
_ENOUGH = 4
"""Matches from which on they scatter."""


class PairSigns(NamedTuple):
    """Evidence for and against the matches of two pictures."""

    first: str
    """Name of the reference picture."""
    other: str
    """Name of the other one."""
    agreed: float
    """Share of the coarse matches that agreed; NaN of a pair that was aligned by way of others."""
    found: float
    """Share of the features tried that were found again both ways."""
    filled: float
    """Share of the cells of common ground that have a match."""
    scatter: float
    """Coplanarity residuals from one match to the next over their stated sigma; NaN of few matches."""

    @property
    def signs(self) -> tuple[str, ...]:
        """Signs against it, in words with figures."""
        return tuple(
            words
            for bad, words in (
                (self.agreed < _AGREED, f"{self.agreed:.0%} of the coarse matches agree"),
                (self.found < _YIELD, f"{self.found:.1%} of the surest features are found again both ways"),
                (self.filled < _FILLED, f"{self.filled:.1%} of the cells of common ground have a match"),
                (self.scatter > _SCATTER, f"their rays miss each other by {self.scatter:.1f} times the stated sigma"),
            )
            if bad
        )

    @property
    def refused(self) -> bool:
        """Whether these are no matches of one ground."""
        return len(self.signs) > 1

    @property
    def words(self) -> str:
        """The signs against it, in a sentence without its end."""
        return f"{self.first} and {self.other}: {listed(list(self.signs))}"


def pair_signs(
    scene: Scene, agreements: Sequence[Agreement], pairs: Sequence[Pair], cell: float, tried: Measured, returned: Mask,
    matched: Measured, misfit: Array,
) -> list[PairSigns]:  # fmt: skip
    """Signs of each pair of pictures with matches.

    `cell` is the side of the cells in m; `returned` (k,) says which of the measures tried stood all checks of single
    matches, `misfit` (m,) is the coplanarity residual of those kept, m on the ground.
    """
    agreed = {frozenset(agreement[:2]): agreement.agreed / max(agreement.candidates, 1) for agreement in agreements}
    cells = {frozenset(pair[:2]): pair.area / cell**2 for pair in pairs}
    rows, signs = {pair[:2]: pair[2] for pair in by_pair(tried.first, tried.other)}, list[PairSigns]()
    for first, other, of_pair in by_pair(matched.first, matched.other):
        both, some = frozenset((first, other)), matched.some(of_pair)
        first_name, second = (scene.pictures[j].image.name for j in (first, other))
        plane = scene.pictures[first].on_chart(scene.ground, some.anchors)
        filled = np.unique(cell_numbers(plane, cell)).size / max(cells.get(both, 1.0), 1.0)
        share = float(np.mean(returned[rows[first, other]]))
        stated = float(np.median(some.sigmas)) * float(scene.pixel_sizes[other])
        scatter = robust_sigma(_from_neighbours(some.anchors[:, 0], misfit[of_pair])) / stated
        scatter = scatter if of_pair.size >= _ENOUGH else math.nan
        signs.append(PairSigns(first_name, second, agreed.get(both, math.nan), share, min(filled, 1.0), scatter))
    return signs


def _from_neighbours(lines: Array, values: Array) -> Array:
    """(n,) values less the median of those of the matches before and after by line; as they are where there are few."""
    size = 2 * _BESIDE + 1
    if values.size <= size:
        return values
    order = np.argsort(lines, kind="stable")
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values[order], _BESIDE, mode="reflect"), size)
    return np.asarray(values[order] - np.median(np.delete(windows, _BESIDE, axis=1), axis=1))
