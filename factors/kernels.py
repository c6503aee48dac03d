"""The numeric kernel: normal equations of a point, its inner solve, its elimination, and its covariance.

The rows come from `equations`; ground priors (Yoon & Shan 2005, Eq. 4) are added here. Compiled by numba on first use
and cached on disk.
"""

import math

import numpy as np
from numba import njit, prange

from mgsgraph.factors.equations import image_row, range_row, robust, surface_row
from mgsgraph.factors.rows import FIXED, NO_LOSS, OUT, PRIOR, Model

GOOD, BEHIND, WEAK = 0, 1, 2
"""State of a point after its inner solve: solved, behind a camera, not determined by its rows."""

_INNER_STEPS = 500
"""Quadratic rows need three or four; far from its optimum a Cauchy or Tukey loss converges slowly."""
_INNER_TOLERANCE = 1e-7
"""Whitened length of the last inner step: the cost is then right to 1e-14, and a function of orientation alone."""
_SINGULAR = 1e-13
"""Pivot relative to its diagonal below which a point counts as not determined."""


@njit(cache=True)
def cholesky3(v):
    """Lower factor of a symmetric 3x3 in place; False when a pivot has lost (nearly) all of its diagonal."""
    for j in range(3):
        diagonal = v[j, j]
        pivot = diagonal
        for i in range(j):
            pivot -= v[j, i] * v[j, i]
        if not pivot > _SINGULAR * diagonal:
            return False
        root = math.sqrt(pivot)
        v[j, j] = root
        for i in range(j + 1, 3):
            below = v[i, j]
            for m in range(j):
                below -= v[i, m] * v[j, m]
            v[i, j] = below / root
    return True


@njit(cache=True)
def forward3(lower, b):
    """Solve L y = b in place."""
    b[0] /= lower[0, 0]
    b[1] = (b[1] - lower[1, 0] * b[0]) / lower[1, 1]
    b[2] = (b[2] - lower[2, 0] * b[0] - lower[2, 1] * b[1]) / lower[2, 2]


@njit(cache=True)
def backward3(lower, y):
    """Solve L' x = y in place."""
    y[2] /= lower[2, 2]
    y[1] = (y[1] - lower[2, 1] * y[2]) / lower[1, 1]
    y[0] = (y[0] - lower[1, 0] * y[1] - lower[2, 0] * y[2]) / lower[0, 0]


@njit(cache=True)
def prior_residual(rows, i, x, point, row):
    """One whitened component of P - P0 - shift, the shift being the shared unknowns along their directions."""
    residual = 0.0
    for j in range(row, 3):
        offset = point[j] - rows.point_start[i, j]
        for q in range(rows.shift_first[i], rows.shift_first[i + 1]):
            offset -= rows.shift_direction[q, j] * x[rows.shift_column[q]]
        residual += rows.point_root[i, row, j] * offset
    return residual


@njit(cache=True)
def add_prior(rows, i, x, point, normal, gradient):
    """Add the a-priori place of point i to its normal equations; its cost is returned."""
    cost = 0.0
    for row in range(3):
        residual = prior_residual(rows, i, x, point, row)
        cost += 0.5 * residual * residual
        for j in range(row, 3):
            gradient[j] += rows.point_root[i, row, j] * residual
            for m in range(row, 3):
                normal[j, m] += rows.point_root[i, row, j] * rows.point_root[i, row, m]
    return cost


@njit(cache=True)
def add_surface(rows, i, x, point, by_point, normal, gradient):
    """Add the height of point i above the terrain to its normal equations; its cost is returned."""
    height, there = surface_row(rows, i, x, point, by_point[0])
    if not there:
        return 0.0
    weight = rows.surface_weight[i] ** 2
    for j in range(3):
        gradient[j] += weight * by_point[0, j] * height
        for m in range(3):
            normal[j, m] += weight * by_point[0, j] * by_point[0, m]
    return 0.5 * weight * height * height


@njit(cache=True)
def point_normal(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient):
    """Normal matrix (3, 3) and gradient (3) of point i at `point` with orientation x; cost, and False when behind."""
    normal[:, :] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    for k in range(rows.ray_first[i], rows.ray_first[i + 1]):
        if rows.weight[k, 0] == 0.0:
            continue
        _, front = image_row(rows, k, model, x, point, scratch, residual, by_pose, by_point)
        if not front:
            return np.inf, False
        part, weight = robust(model, residual[0] * residual[0] + residual[1] * residual[1])
        cost += part
        for row in range(2):
            for a in range(3):
                gradient[a] += weight * by_point[row, a] * residual[row]
                for b in range(3):
                    normal[a, b] += weight * by_point[row, a] * by_point[row, b]
    for q in range(rows.range_first[i], rows.range_first[i + 1]):
        if rows.range_weight[q] == 0.0:
            continue
        value = range_row(rows, q, x, point, by_point[0])
        part, weight = robust(model, value * value)
        cost += part
        for a in range(3):
            gradient[a] += weight * by_point[0, a] * value
            for b in range(3):
                normal[a, b] += weight * by_point[0, a] * by_point[0, b]
    if rows.point_kind[i] == PRIOR:
        cost += add_prior(rows, i, x, point, normal, gradient)
    if rows.surface_weight[i] > 0.0:
        cost += add_surface(rows, i, x, point, by_point, normal, gradient)
    return cost, True


@njit(cache=True)
def descend(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient):
    """Gauss-Newton from the place where `point` is; cost and state as in `solve_point`."""
    cost = 0.0
    for _ in range(_INNER_STEPS):
        cost, front = point_normal(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient)
        if not front:
            return np.inf, BEHIND
        if not cholesky3(normal):
            return cost, WEAK
        forward3(normal, gradient)
        square = gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2]
        if square < _INNER_TOLERANCE * _INNER_TOLERANCE:
            break
        backward3(normal, gradient)
        for j in range(3):
            point[j] -= gradient[j]
    return cost, GOOD


@njit(cache=True)
def solve_point(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient):
    """Best place of point i with the orientation held (Gauss-Newton to a fixed tolerance); its cost and state.

    Afterwards `normal` holds the lower Cholesky factor L of the normal matrix at the solution, and `gradient` what is
    left of the gradient, as L^-1 g.
    """
    for j in range(3):
        point[j] = rows.point_start[i, j]
    if rows.point_kind[i] == FIXED:
        cost, front = point_normal(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient)
        return cost, GOOD if front else BEHIND
    if model.loss != NO_LOSS:  # where a robust loss is flat it leads nowhere: begin where plain squares end
        plain = Model(model.line, model.angles, NO_LOSS, model.width)
        _, state = descend(rows, i, plain, x, point, scratch, residual, by_pose, by_point, normal, gradient)
        if state != GOOD:
            return np.inf, state
    return descend(rows, i, model, x, point, scratch, residual, by_pose, by_point, normal, gradient)


@njit(cache=True)
def eliminate_shift(rows, i, x, point, coupling, block, right):
    """Add what point i's a-priori place says of the shared unknowns that move it to coupling, block and right."""
    first, last = rows.shift_first[i], rows.shift_first[i + 1]
    for row in range(3 if last > first else 0):
        residual = prior_residual(rows, i, x, point, row)
        for p in range(first, last):
            slope = 0.0
            for j in range(row, 3):
                slope -= rows.point_root[i, row, j] * rows.shift_direction[p, j]
            a = rows.shift_local[p]
            right[a] += slope * residual
            for j in range(row, 3):
                coupling[a, j] += slope * rows.point_root[i, row, j]
            for q in range(first, last):
                other = 0.0
                for j in range(row, 3):
                    other -= rows.point_root[i, row, j] * rows.shift_direction[q, j]
                block[a, rows.shift_local[q]] += slope * other


@njit(cache=True)
def eliminate_surface(rows, i, x, point, by_point, coupling, block, right):
    """Add what point i's height above the terrain says of the model's own shift to coupling, block and right."""
    height, there = surface_row(rows, i, x, point, by_point[0])
    if not there:
        return
    weight, first = rows.surface_weight[i] ** 2, rows.surface_local[i]
    for p in range(2):
        slope = 0.0
        for j in range(3):
            slope -= by_point[0, j] * rows.surface_direction[i, p, j]
        right[first + p] += weight * slope * height
        for j in range(3):
            coupling[first + p, j] += weight * slope * by_point[0, j]
        for q in range(2):
            other = 0.0
            for j in range(3):
                other -= by_point[0, j] * rows.surface_direction[i, q, j]
            block[first + p, first + q] += weight * slope * other


@njit(cache=True)
def eliminate(
    rows, i, model, x, point, lower, rest, free, scratch, residual, by_pose, by_point, coupling, block, right
):
    """Add point i's reduced system to block (d, d; upper triangle) and right (d): J'J - W V^-1 W' and J'r - W V^-1 g.

    `rest` (3) is L^-1 g, what the inner solve left of the point's gradient: tiny, but the orientation's weak directions
    would feel it. `coupling` (d, 3) is left as W L^-T (L L' = V), from which the point's covariance follows. A known
    point (`free` False) has no V: its rows go to the orientation as they are.
    """
    d = right.size
    coupling[:d, :] = 0.0
    for k in range(rows.ray_first[i], rows.ray_first[i + 1]):
        if rows.weight[k, 0] == 0.0:
            continue
        carry, _ = image_row(rows, k, model, x, point, scratch, residual, by_pose, by_point)
        _, weight = robust(model, residual[0] * residual[0] + residual[1] * residual[1])
        for p in range(rows.pair_first[k], rows.pair_first[k + 1]):
            row0 = rows.pair_local[p]
            value = weight * (rows.pair_value[p, 0] + carry * rows.pair_value[p, 1])
            for a in range(6):
                j0, j1 = value * by_pose[0, a], value * by_pose[1, a]
                right[row0 + a] += j0 * residual[0] + j1 * residual[1]
                for b in range(3):
                    coupling[row0 + a, b] += j0 * by_point[0, b] + j1 * by_point[1, b]
                for q in range(rows.pair_first[k], rows.pair_first[k + 1]):
                    column0 = rows.pair_local[q]
                    other = rows.pair_value[q, 0] + carry * rows.pair_value[q, 1]
                    for b in range(6):
                        block[row0 + a, column0 + b] += other * (j0 * by_pose[0, b] + j1 * by_pose[1, b])
    for r in range(rows.range_first[i], rows.range_first[i + 1]):
        if rows.range_weight[r] == 0.0:
            continue
        value = range_row(rows, r, x, point, by_point[0])
        _, weight = robust(model, value * value)
        for p in range(rows.range_pair_first[r], rows.range_pair_first[r + 1]):
            row0 = rows.range_pair_local[p]
            for a in range(3):
                slope = -weight * rows.range_pair_value[p] * by_point[0, a]
                right[row0 + a] += slope * value
                for b in range(3):
                    coupling[row0 + a, b] += slope * by_point[0, b]
                for q in range(rows.range_pair_first[r], rows.range_pair_first[r + 1]):
                    column0 = rows.range_pair_local[q]
                    for b in range(3):
                        block[row0 + a, column0 + b] -= slope * rows.range_pair_value[q] * by_point[0, b]
    if rows.point_kind[i] == PRIOR:
        eliminate_shift(rows, i, x, point, coupling, block, right)
    if rows.surface_weight[i] > 0.0 and rows.surface_column[i] >= 0:
        eliminate_surface(rows, i, x, point, by_point, coupling, block, right)
    if not free:
        return
    for a in range(d):
        forward3(lower, coupling[a])
        right[a] -= coupling[a, 0] * rest[0] + coupling[a, 1] * rest[1] + coupling[a, 2] * rest[2]
    for a in range(d):
        for b in range(a, d):
            block[a, b] -= (
                coupling[a, 0] * coupling[b, 0] + coupling[a, 1] * coupling[b, 1] + coupling[a, 2] * coupling[b, 2]
            )


@njit(cache=True, parallel=True)
def reduce_points(rows, groups, model, x, want_system, points, states, costs, blocks, rights):
    """Solve every point and, if wanted, eliminate it: one pass over all rows.

    Fills points (n, 3), states (n,), and per chunk of work: costs (c,), blocks (c, D, D) and rights (c, D), of which
    the first `groups.dimension` rows and columns of the chunk's group count (upper triangle).
    """
    for c in prange(groups.chunk.shape[0]):
        d = groups.dimension[groups.chunk[c, 0]]
        scratch, residual = np.empty((5, 9)), np.empty(2)
        by_pose, by_point = np.empty((2, 6)), np.empty((2, 3))
        normal, gradient = np.empty((3, 3)), np.empty(3)
        coupling = np.empty((max(d, 1), 3))
        block, right = blocks[c, :d, :d], rights[c, :d]
        if want_system:
            block[:, :] = 0.0
            right[:] = 0.0
        total = 0.0
        for i in range(groups.chunk[c, 1], groups.chunk[c, 2]):
            if rows.point_kind[i] == OUT:
                states[i] = GOOD
                continue
            cost, state = solve_point(
                rows, i, model, x, points[i], scratch, residual, by_pose, by_point, normal, gradient
            )
            states[i] = state
            total += cost
            if want_system and state == GOOD and d > 0:
                free = rows.point_kind[i] != FIXED
                eliminate(
                    rows,
                    i,
                    model,
                    x,
                    points[i],
                    normal,
                    gradient,
                    free,
                    scratch,
                    residual,
                    by_pose,
                    by_point,
                    coupling,
                    block,
                    right,
                )
        costs[c] = total


@njit(cache=True, parallel=True)
def point_covariances(rows, groups, model, x, joint, points, covariances):
    """Covariance (n, 3, 3) of every point: V^-1 + V^-1 W' S W V^-1, S that of its orientation variables together.

    `joint` is flat, with the (d, d) block of each group at groups.offset. Points that are fixed or out get zero.
    """
    for c in prange(groups.chunk.shape[0]):
        group = groups.chunk[c, 0]
        d = groups.dimension[group]
        scratch, residual = np.empty((5, 9)), np.empty(2)
        by_pose, by_point = np.empty((2, 6)), np.empty((2, 3))
        normal, gradient = np.empty((3, 3)), np.empty(3)
        coupling, spread = np.empty((max(d, 1), 3)), np.empty((max(d, 1), 3))
        block, right = np.zeros((d, d)), np.zeros(d)
        start = groups.offset[group]
        for i in range(groups.chunk[c, 1], groups.chunk[c, 2]):
            covariances[i, :, :] = 0.0
            if rows.point_kind[i] == OUT or rows.point_kind[i] == FIXED:
                continue
            point_normal(rows, i, model, x, points[i], scratch, residual, by_pose, by_point, normal, gradient)
            if not cholesky3(normal):
                covariances[i, :, :] = np.nan
                continue
            eliminate(
                rows,
                i,
                model,
                x,
                points[i],
                normal,
                gradient,
                True,
                scratch,
                residual,
                by_pose,
                by_point,
                coupling,
                block,
                right,
            )
            for a in range(d):
                for b in range(3):
                    spread[a, b] = 0.0
                    for m in range(d):
                        spread[a, b] += joint[start + a * d + m] * coupling[m, b]
            middle = scratch[:3, :3]  # I + Y' S Y with Y = W L^-T
            for a in range(3):
                for b in range(3):
                    middle[a, b] = 1.0 if a == b else 0.0
                    for m in range(d):
                        middle[a, b] += coupling[m, a] * spread[m, b]
            for a in range(3):  # L^-T middle L^-1: two passes of back-substitution
                backward3(normal, middle[a])
            for a in range(3):
                for b in range(3):
                    gradient[b] = middle[b, a]
                backward3(normal, gradient)
                for b in range(3):
                    covariances[i, b, a] = gradient[b]
