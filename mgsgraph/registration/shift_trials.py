"""Loops of the search over shifts: misfits of a profile after thousands of them, and fits of a line to its heights."""

import math

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.geometry.records import Array, Index, Mask

_HUBER = 2.0
"""Sigmas from which on a shot counts linearly."""
_ROUNDS = 3
"""Of reweighting."""


@cached_kernel
def misfits_of_shifts(
    shifts: Array, places: Array, others: Array, place_by_shift: Array, other_by_shift: Array, epipolar: Array,
    pixels_per_metre: Array, variances: Array, along: Array, first: Array, step: Array, finer: int, fine: Array,
    covered: Mask, noise: Array,
) -> tuple[Array, Index]:  # fmt: skip
    """Sums of the losses (s,) of heights about a line along the track, and (s,) how many shots are on the surface.

    Parameters
    ----------
    shifts : (s, 2)
        m east and north.
    places, others, place_by_shift, other_by_shift, epipolar, pixels_per_metre, along
        Of n shots, as in `search`.
    variances : (n,)
        m^2, of the heights of shots.
    first, step : (2,)
        First node of the surface, and pixels between nodes.
    finer : int
        Nodes of `fine` (2, ., .), the surface's disparities, that make one of the surface's.
    covered, noise : (r, c)
        Of the surface's nodes: whether it is known there, and its variance in pixels^2.
    """
    count, n = len(shifts), len(places)
    result, shots = np.empty(count), np.empty(count, dtype=np.int64)
    heights, weights, left = np.empty(n), np.empty(n), np.empty(n)
    rows, columns = covered.shape
    for k in range(count):
        east, north = shifts[k, 0], shifts[k, 1]
        shots[k] = 0
        for i in range(n):
            heights[i] = weights[i] = 0.0
            line = places[i, 0] + place_by_shift[i, 0, 0] * east + place_by_shift[i, 0, 1] * north
            sample = places[i, 1] + place_by_shift[i, 1, 0] * east + place_by_shift[i, 1, 1] * north
            row, column = (line - first[0]) / step[0], (sample - first[1]) / step[1]
            if not (0.0 <= row <= rows - 1.0 and 0.0 <= column <= columns - 1.0):
                continue
            r, c = min(int(row), rows - 2), min(int(column), columns - 2)
            if not (covered[r, c] and covered[r + 1, c] and covered[r, c + 1] and covered[r + 1, c + 1]):
                continue
            parallax = 0.0
            for j in range(2):
                other = others[i, j] + other_by_shift[i, j, 0] * east + other_by_shift[i, j, 1] * north
                parallax += epipolar[i, j] * (other - _between(fine[j], row * finer, column * finer))
            scale = pixels_per_metre[i]
            heights[i] = parallax / scale
            weights[i] = 1.0 / (variances[i] + noise[int(row + 0.5), int(column + 0.5)] / scale**2)
            shots[k] += 1
        result[k] = _left_of_line(heights, weights, along, left)
    return result, shots


@cached_kernel
def left_of_lines(heights: Array, weights: Array, along: Array) -> tuple[Array, Array]:
    """Of heights (s, n) in m with weights (s, n) in 1/m^2 about a line along the track: (s,) sums of the losses, and
    (s, n) what is left of each, in sigmas.
    """
    losses, left = np.empty(len(heights)), np.empty(heights.shape)
    for k in range(len(heights)):
        losses[k] = _left_of_line(heights[k], weights[k], along, left[k])
    return losses, left


@compiled
def _between(values: Array, row: float, column: float) -> float:
    """Linear between four nodes."""
    r, c = min(int(row), values.shape[0] - 2), min(int(column), values.shape[1] - 2)
    v, u = row - r, column - c
    upper = (1.0 - u) * values[r, c] + u * values[r, c + 1]
    lower = (1.0 - u) * values[r + 1, c] + u * values[r + 1, c + 1]
    return float((1.0 - v) * upper + v * lower)


@compiled
def _left_of_line(heights: Array, weights: Array, along: Array, left: Array) -> float:
    """Sum of Huber's losses about the robust line; fills what is `left` (n,), in sigmas."""
    for k in range(heights.size):
        left[k] = 0.0
    for _ in range(_ROUNDS):
        n0 = n1 = n2 = right0 = right1 = 0.0
        for k in range(heights.size):
            ratio = abs(left[k])
            weight = weights[k] if ratio <= _HUBER else weights[k] * _HUBER / ratio
            n0 += weight
            n1 += weight * along[k]
            n2 += weight * along[k] ** 2
            right0 += weight * heights[k]
            right1 += weight * along[k] * heights[k]
        n0, n2 = n0 + 1e-12, n2 + 1e-12
        determinant = n0 * n2 - n1 * n1
        level = (n2 * right0 - n1 * right1) / determinant
        slope = (n0 * right1 - n1 * right0) / determinant
        for k in range(heights.size):
            left[k] = (heights[k] - level - slope * along[k]) * math.sqrt(weights[k])
    loss = 0.0
    for k in range(heights.size):
        ratio = abs(left[k])
        loss += 2.0 * _HUBER * ratio - _HUBER**2 if ratio > _HUBER else ratio**2
    return loss


def robust_weights(left: Array) -> Array:
    """Factors (...) of the weights of what is left of heights (...), in sigmas, by Huber's loss."""
    return np.asarray(_HUBER / np.maximum(np.abs(left), _HUBER))
