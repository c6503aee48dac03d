"""What finished measures must stand: rays that meet, heights like their neighbours', and an even spread."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.pairs import by_pair
from mgsgraph.matching.relative import consensus, displacements, robust_sigma, units_between
from mgsgraph.matching.scene import Scene

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
"""m, unit of a position of which nothing is known beforehand."""
_FEWEST = 12
"""Matches of a pair that have to be coplanar under one correction."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasureChecks:
    """Whether n measures are consistent with one another."""

    coplanar: Mask
    """(n,) the rays meet, under one correction of the picture's orientation."""
    steady: Mask
    """(n,) the height is like the neighbours'."""
    misfit: Array
    """(n,) m on the ground, the coplanarity residual that remains; NaN where it wasn't asked."""


def checked_measures(scene: Scene, found: Measured, step: float, seed: int) -> MeasureChecks:
    """Check measures, pair of pictures by pair; `step` is the pixel of the ground grid in m."""
    n = found.track.size
    coplanar, steady, misfit = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), np.full(n, np.nan)
    for _, _, mine in by_pair(found.first, found.other):
        coplanar[mine], steady[mine], misfit[mine] = _of_pair(scene, found.some(mine), step, seed)
    return MeasureChecks(coplanar, steady, misfit)


def _of_pair(scene: Scene, found: Measured, step: float, seed: int) -> tuple[Mask, Mask, Array]:
    first, second = (scene.pictures[int(j[0])] for j in (found.first, found.other))
    sigmas = units_between(first, second, _DEGREE, _UNKNOWN)
    apart = displacements(first, second, (found.anchors, found.pixels), scene.ground, sigmas)
    rng = np.random.default_rng(seed)
    taken, fits = consensus(apart, _ROUGH * step, scene.ground.height_sigma, rng)
    across, along = apart.residuals(taken).T
    limit = max(_LIMIT * robust_sigma(across[fits]), _LEAST_LIMIT * step)
    coplanar = np.abs(across - _middle(across[fits])) <= limit
    if np.count_nonzero(coplanar) < _FEWEST:  # so few agree with any orientation
        coplanar[:] = False
    steady = np.zeros(coplanar.size, dtype=bool)
    steady[coplanar] = _like_neighbours(first.on_chart(scene.ground, found.anchors[coplanar]), along[coplanar], step)
    return coplanar, steady, across


def _middle(values: Array) -> float:
    return float(np.median(values)) if values.size else 0.0


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
    kept = np.zeros(order.size, dtype=bool)
    kept[order] = np.arange(order.size) - begin < most
    return kept
