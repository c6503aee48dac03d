"""Residuals of all rows, taking part or not, at given places: for reports, and for the search for blunders."""

import numpy as np
from numba import njit, prange

from mgsgraph.factors.equations import image_row, range_row, surface_row


@njit(cache=True, parallel=True)
def all_residuals(rows, model, x, points, image_residuals, range_residuals):
    """Residuals in pixels (k, 2) and metres (r,), measured minus predicted, of rows in and out alike; NaN behind."""
    for i in prange(points.shape[0]):
        scratch, residual = np.empty((5, 9)), np.empty(2)
        by_pose, by_point = np.empty((2, 6)), np.empty((2, 3))
        for k in range(rows.ray_first[i], rows.ray_first[i + 1]):
            _, front = image_row(rows, k, model, x, points[i], scratch, residual, by_pose, by_point)
            for j in range(2):
                image_residuals[k, j] = residual[j] / rows.weight[k, j] if front else np.nan
        for q in range(rows.range_first[i], rows.range_first[i + 1]):
            range_residuals[q] = range_row(rows, q, x, points[i], by_point[0]) / rows.range_weight[q]


@njit(cache=True)
def all_heights(rows, x, points, heights):
    """Heights (n,) in m above the terrain model of points that have a surface row; NaN for the others."""
    by_point = np.empty(3)
    for i in range(points.shape[0]):
        height, there = surface_row(rows, i, x, points[i], by_point)
        heights[i] = height if there and rows.surface_weight[i] > 0.0 else np.nan
