"""Errors that neighbours have in common, as rows that count as independent.

Where errors with the covariance C, none of it negative, are given the variances D_i = sum_j C_ij and count as
independent, no stated sigma of what is estimated from them is too small: D - C is diagonally dominant, and so
D >= C. The sigma of their mean is right where all have as many neighbours; one without neighbours keeps its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.record import Record

_CHUNK = 1024
"""Places whose neighbours are looked for at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Gaps(Record):
    """What a terrain model's interpolation between tracks adds to the errors of its posts."""

    sigmas: Array
    """(rows, columns) m, of each post's height; 0 for a post that shots made."""
    reaches: Array
    """(rows, columns) m, within which these errors are one: half the distance between the tracks."""

    def __iter__(self) -> Iterator[Array]:
        """Sigmas, then reaches."""
        yield from (self.sigmas, self.reaches)


def common_variances(places: Array, sigmas: Array, reaches: Array) -> Array:
    """Variances (n,) with which errors count as independent that places (n, d) have in common where both of two are
    within the other's reach (n,), with sigmas (n,): each is its sigma times the sum of its own and its neighbours'.
    """
    from scipy.spatial import cKDTree  # slow to import

    found = sigmas**2
    some = np.flatnonzero((sigmas > 0.0) & (reaches > 0.0))
    if not some.size:
        return np.asarray(found)
    tree, farthest = cKDTree(places[some]), float(reaches[some].max())
    for first in range(0, some.size, _CHUNK):
        mine = some[first : first + _CHUNK]
        pairs = cKDTree(places[mine]).sparse_distance_matrix(tree, farthest, output_type="ndarray")
        one, other = mine[pairs["i"]], some[pairs["j"]]
        near = (pairs["v"] <= np.minimum(reaches[one], reaches[other])) & (one != other)
        found += sigmas * np.bincount(one[near], sigmas[other[near]], sigmas.size)
    return np.asarray(found)


def overlap_variances(places: Array, sigmas: Array, side: float) -> Array:
    """Variances (n, c) with which errors of sigmas (n, c) count as independent at places (n, 2) that are the middles of
    square windows, whose overlap is how far two of them are correlated.
    """
    from scipy.spatial import cKDTree  # slow to import

    first, second = cKDTree(places).query_pairs(side, p=np.inf, output_type="ndarray").T
    shares = np.prod(1.0 - np.abs(places[first] - places[second]) / side, axis=1)
    found = sigmas**2
    for one, other in ((first, second), (second, first)):
        np.add.at(found, one, sigmas[one] * sigmas[other] * shares[:, None])
    return np.asarray(found)
