"""Heights of the ground between adjusted points, by ordinary kriging of those about them."""

import numpy as np

from mgsgraph.geometry.records import Array, finite_rows

_NEIGHBORS = 16
"""Points by which a height is predicted."""
_BATCH = 4096
"""Places predicted at a time."""
_GROWTH = 1.5
"""Power of distance with which the mean square of height differences grows."""
_MEDIAN = 0.455
"""Median of the square of a standard normal number."""
_SLOPE = 0.1
"""Rise per meter that counts as one pair of neighbors: few of them, or even ones, don't say that ground is level."""


def predicted_heights(points: Array, heights: Array, sigmas: Array, places: Array) -> tuple[Array, Array]:
    """Heights at places by those of the nearest points: ordinary kriging.

    The mean square of height differences is taken to grow with the power 1.5 of distance, as relief's does, by a factor
    from the neighbors' own differences. Errors of their heights are taken to be common, for orientation makes them:
    they do not average out.

    Parameters
    ----------
    points : (p, 3)
        m.
    heights, sigmas : (p,)
        m, of the points; what a sigma has beyond the middle one of the neighbors makes its point count less.
    places : (n, 3)
        m; distances are those between directions.

    Returns
    -------
    heights, sigmas : (n,)
        m, within the neighbors' span; NaN where a place is.
    """
    from scipy.spatial import cKDTree  # takes half a second

    radius = float(np.median(np.linalg.norm(points, axis=1)))
    directions, asked = (radius * p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, places))
    located, count = np.flatnonzero(finite_rows(asked)), min(_NEIGHBORS, len(points))
    tree, predicted = cKDTree(directions), np.full((2, len(places)), np.nan)
    for start in range(0, located.size, _BATCH):
        some = located[start : start + _BATCH]
        distances, nearest = (part.reshape(len(some), count) for part in tree.query(asked[some], count))
        predicted[:, some] = _kriged(directions[nearest], heights[nearest], sigmas[nearest], distances)
    return predicted[0], predicted[1]


def _kriged(points: Array, heights: Array, sigmas: Array, distances: Array) -> tuple[Array, Array]:
    """Heights and sigmas (m,) in m, by neighbors (m, k, 3) of each place, their heights, sigmas and distances."""
    count, scale = heights.shape[1], np.maximum(distances.mean(axis=1), 1.0)  # distances in this unit: no number is odd
    first, second = np.triu_indices(count, 1)
    between = (np.linalg.norm(points[:, :, None] - points[:, None], axis=3) / scale[:, None, None]) ** _GROWTH
    aside = (distances / scale[:, None]) ** _GROWTH
    pairs = 0.5 * (heights[:, first] - heights[:, second]) ** 2 / np.maximum(between[:, first, second], 1e-6)
    middle = np.median(pairs, axis=1) / _MEDIAN if first.size else np.zeros(len(heights))
    growth = (middle * first.size + 0.5 * (_SLOPE * scale) ** 2) / (first.size + 1)
    matrix = np.ones((len(heights), count + 1, count + 1))
    matrix[:, -1, -1] = 0.0
    excess = np.maximum(sigmas**2 - np.median(sigmas, axis=1, keepdims=True) ** 2, 0.0) / growth[:, None] + 1e-6
    matrix[:, :-1, :-1] = between - excess[:, :, None] * np.eye(count)
    right = np.concatenate([aside, np.ones((len(heights), 1))], axis=1)
    weights = np.linalg.solve(matrix, right[:, :, None])[:, :-1, 0]
    relief = 2.0 * np.einsum("nk,nk->n", weights, aside) - np.einsum("nk,nkl,nl->n", weights, between, weights)
    common = np.einsum("nk,nk->n", np.abs(weights), sigmas)
    level = np.clip(np.einsum("nk,nk->n", weights, heights), heights.min(axis=1), heights.max(axis=1))
    return level, np.sqrt(growth * np.maximum(relief, 0.0) + common**2)
