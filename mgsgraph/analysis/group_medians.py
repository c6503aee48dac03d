"""Medians of groups of many values, without a loop, and robust ends of scales; by them, how well each image fits."""

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index, Mask

SHARE = 0.98
"""Share of the values that a colour scale covers, on either side."""


def counts(groups: Index, number: int) -> Index:
    """(number,) how many of `groups` (n,), from 0 on, are each one."""
    return np.bincount(groups, minlength=number)


def medians(values: Array, groups: Index, number: int) -> Array:
    """(number,) median of the finite values (n,) of each group (n,), counted from 0; NaN where there are none.

    Values are rounded to float32, enough for any picture: group and value then fit into one integer of 64 bits, which
    is sorted at once, some ten times faster than by two keys.
    """
    sound = np.isfinite(values)
    values, groups = values[sound], groups[sound]
    bits = values.astype(np.float32).view(np.uint32)
    rising = np.where(bits >> 31 == 1, ~bits, bits | np.uint32(1 << 31))  # in the order of the values they stand for
    packed = np.sort(groups.astype(np.uint64) << np.uint64(32) | rising)
    of = counts(groups, number)
    first = np.cumsum(of) - of
    some = of > 0
    found = np.full(number, np.nan)
    middle = [_unpacked(packed[(first + shift)[some]]) for shift in ((of - 1) // 2, of // 2)]
    found[some] = 0.5 * (middle[0] + middle[1])
    return found


def _unpacked(packed: np.ndarray) -> Array:
    rising = (packed & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    bits = np.where(rising >> 31 == 1, rising & np.uint32(0x7FFFFFFF), ~rising)
    return np.asarray(bits.view(np.float32), dtype=np.float64)


def used_rays(solution: Solution) -> Mask:
    """(k,) rays that took part and whose point is determined."""
    return np.asarray(
        solution.rays_used & np.isfinite(solution.residuals[:, 0]) & np.isfinite(solution.residuals[:, 1])
    )


def median_residuals(solution: Solution) -> Array:
    """(images,) median residual of each image's rays that took part, in units of their sigmas, of a ray the larger one
    of line and sample; NaN where there are none. Blunders hardly change it.
    """
    rays = solution.network.rays
    mine = np.flatnonzero(used_rays(solution))
    size = np.max(np.abs(solution.residuals[mine]) / rays.sigmas[mine], axis=1)
    return medians(size, rays.image[mine], len(solution.network.images))


def worst_first(solution: Solution) -> Index:
    """(images,) images by their median residuals, largest first; those without any come last."""
    return np.argsort(-np.nan_to_num(median_residuals(solution), nan=-1.0), kind="stable")


def span(values: Array) -> tuple[float, float]:
    """Ends of a colour scale from the 2 % to the 98 % quantile of the finite values; 0 and 1 where there are none."""
    sound = values[np.isfinite(values)]
    if not sound.size:
        return 0.0, 1.0
    low, high = np.quantile(sound, [1.0 - SHARE, SHARE]).tolist()
    return low, max(high, low + 1e-12 + 1e-6 * abs(low))
