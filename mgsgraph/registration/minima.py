"""Minima of a profile's misfit over shifts, and the probability of each.

What is stated of a shot's height is mostly its profile's, which has gone with the level, so the scale of its sigma is
hardly known: marginalised over that scale, whose prior counts as ten shots that are as stated, twice the logarithm of
the likelihood of a shift against another is -D,

    D = ((m + 6) ln((chi^2_1 + 10) / (chi^2_2 + 10)) + sum_i ln(sigma_i1^2 / sigma_i2^2)) / k,  k = (1 + r) / (1 - r),

k being the number of shots that count as one, by the correlation r of successive heights at the best shift. The weight
of a minimum is exp(-D / 2) times the root of its covariance's determinant: the probability that its neighbourhood is
the right one when all shifts are alike beforehand. Where more is known beforehand, its chi^2 is added to D.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.records import Array, Index

_AS_STATED = 10.0
"""Shots by whose weight stated sigmas are believed beforehand: the papers state ten times too much for MOLA."""
_MOST_CORRELATED = 0.9
"""Correlation of successive heights that is taken at its word."""
_ALIKE = 5.0
"""m, up to which two fits are the same."""
FITTED = 4
"""Level, slope and two shifts, which misfits have lost."""
_NONE = np.zeros(2)


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """One shift at which a profile fits."""

    shift: Array
    """(2,) m east and north, to be added to the footprints."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, of the shift."""
    change: Array
    """(2,) m east and north, from the middle of the profile to its end, of the shift."""
    weight: float
    """Probability."""


class Bowl(NamedTuple):
    """A minimum of the misfit by itself."""

    shift: Array
    """(2,) m east and north."""
    misfit: float
    """chi^2."""
    covariance: Array
    """(2, 2) m^2, by the sigmas that are stated."""
    change: Array = _NONE
    """(2,) m, of the shift from the middle of the profile to its end."""


def local_minima(shifts: Array, misfits: Array) -> list[Bowl]:
    """Local minima of a misfit (k, k) over shifts (k,), refined by a paraboloid through neighbours; lowest first."""
    filled = np.where(np.isfinite(misfits), misfits, np.inf)
    inner = filled[1:-1, 1:-1]
    around = [filled[1 + i : filled.shape[0] - 1 + i, 1 + j : filled.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    lowest = np.isfinite(inner) & np.all([inner <= one for one in around], axis=0)
    found = [_refined(shifts, filled, row + 1, column + 1) for row, column in np.argwhere(lowest)]
    return sorted(found, key=lambda one: one.misfit)


def weighted(
    bowls: Sequence[Bowl],
    misfits: Array,
    lowest: Array,
    shots: Index,
    variances: Array,
    alike: float,
    known: Array,
) -> tuple[Minimum, ...]:
    """Minima with their weights, the likeliest first.

    Parameters
    ----------
    bowls : sequence of n
        In any order.
    misfits, lowest : (n,)
        chi^2 of each, and of the one that fits best, over the shots of both.
    shots : (n,)
        Those of both.
    variances : (n,)
        Sum of the logarithms of their variances, less that at the best.
    alike : float
        Shots that count as one.
    known : (n,)
        chi^2 of their shifts by what is known beforehand.
    """
    freedom = np.maximum(shots - FITTED, 1) + _AS_STATED
    misfits, lowest = misfits + _AS_STATED, lowest + _AS_STATED
    scale = float(np.min(lowest / freedom)) * alike
    logs = -0.5 * (freedom * np.log(misfits / lowest) + variances) / alike - 0.5 * known
    logs += np.array([0.5 * np.linalg.slogdet(one.covariance)[1] for one in bowls])
    weights = np.exp(logs - logs.max())
    every = [
        Minimum(one.shift, one.misfit, scale * one.covariance, one.change, float(weight / weights.sum()))
        for one, weight in zip(bowls, weights, strict=True)
    ]
    return tuple(sorted(every, key=lambda one: -one.weight))


def merged(shifts: Array, covariances: Array, misfits: Array, owner: Index, scale: float) -> Array:
    """(s, 2, 2) m^2, covariances of minima; of each that stands for others its mean square over the mixture of them.

    Parameters
    ----------
    shifts : (s, 2)
        m.
    covariances : (s, 2, 2)
        m^2, by the sigmas that are stated.
    misfits : (s,)
        chi^2 over as many shots each.
    owner : (s,)
        Number of the minimum that stands for each, -1 for none.
    scale : float
        By which chi^2 is too large.
    """
    found = covariances.copy()
    for k in np.unique(owner[owner >= 0]).tolist():
        mine = [k]
        for other in np.flatnonzero(owner == k).tolist():  # fits that ended at the same place count once
            if np.linalg.norm(shifts[other] - shifts[mine], axis=1).min() > _ALIKE:
                mine.append(other)
        logs = 0.5 * np.linalg.slogdet(covariances[mine])[1] - 0.5 * (misfits[mine] - misfits[k]) / scale
        weights, off = np.exp(logs - logs.max()), shifts[mine] - shifts[k]
        every = covariances[mine] + off[:, :, None] * off[:, None] / scale
        found[k] = np.einsum("k,kij->ij", weights / weights.sum(), every)
    return found


def shots_alike(left: Array) -> float:
    """Number of successive shots that count as one, by the correlation of what is left of their heights (n,)."""
    if left.size <= FITTED:
        return 1.0
    correlation = float(np.sum(left[1:] * left[:-1]) / max(np.sum(left**2), 1e-12))
    correlation = min(max(correlation, 0.0), _MOST_CORRELATED)
    return (1.0 + correlation) / (1.0 - correlation)


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _refined(shifts: Array, misfits: Array, row: int, column: int) -> Bowl:
    """The paraboloid through a minimum and its eight neighbours."""
    step = shifts[1] - shifts[0]
    i, j = (part.ravel() for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    values = misfits[row - 1 : row + 2, column - 1 : column + 2].ravel()
    here, at = misfits[row, column], np.array([shifts[row], shifts[column]])
    if not np.all(np.isfinite(values)):
        return Bowl(at, float(here), np.eye(2) * step**2)
    terms = np.stack([np.ones(9), i, j, 0.5 * i * i, i * j, 0.5 * j * j], axis=1)
    c, gi, gj, hii, hij, hjj = np.linalg.lstsq(terms, values, rcond=None)[0]
    hessian = np.array([[hii, hij], [hij, hjj]])
    if not (hii > 0.0 and np.linalg.det(hessian) > 1e-6 * hii * hjj):
        return Bowl(at, float(here), np.eye(2) * step**2)
    move = -np.linalg.solve(hessian, [gi, gj])
    if np.abs(move).max() > 1.0:
        return Bowl(at, float(here), 2.0 * np.linalg.inv(hessian) * step**2)
    misfit = min(float(here), float(c + 0.5 * np.array([gi, gj]) @ move))
    return Bowl(at + step * move, misfit, 2.0 * np.linalg.inv(hessian) * step**2)
