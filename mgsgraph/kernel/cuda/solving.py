"""The inner solve, a thread a point: with the orientation held, Gauss-Newton to a fixed tolerance.

As `kernel.points` does it; what a thread does depends on its own point alone.
"""

import math

import numpy as np

from mgsgraph.kernel.cuda.device import THREADS, cuda, kernel, on_device
from mgsgraph.kernel.cuda.loading import place_among
from mgsgraph.kernel.cuda.measurements import loss_of, observation_rows
from mgsgraph.kernel.cuda.tables import BEGIN, COUNT, END, FIRST, HEIGHTS, KIND, KNOWN, PATTERN
from mgsgraph.kernel.points import INNER_STEPS, PLAIN_TOLERANCE, SINGULAR, SLOW_TOLERANCE
from mgsgraph.kernel.rows import BEHIND, GOOD, NO_LOSS, OUT, WEAK

AT, FACTOR, FORWARD, NUMBERS = 0, 3, 9, 12
"""Rows of what a solve leaves of each point: coordinates at which its rows are taken; L of V = L L', with 1 / L_jj for
L_jj; L^-1 times the gradient."""


@on_device
def weights_of(weight, k, active):
    """Both weights of the k-th observation; zero of a point that takes no part."""
    return (weight[0, k], weight[1, k]) if active else (0.0, 0.0)


@on_device
def normal_equations(tables, model, data, weight, x, piece, lane, point, active, robust, status):
    """Cost, normal matrix (00, 10, 11, 20, 21, 22) and gradient of a point, and its status."""
    v00 = v10 = v11 = v20 = v21 = v22 = g0 = g1 = g2 = cost = 0.0
    pattern = tables.piece[piece, PATTERN]
    begin = tables.pattern[pattern, BEGIN]
    for i in range(begin, tables.pattern[pattern, END]):
        weights = weights_of(weight, place_among(tables, piece, i - begin, lane), active)
        r, b, _, front, _ = observation_rows(tables, model, data, x, piece, i, lane, point, active, weights)
        if (not front) and weights[0] > 0.0:
            status = BEHIND
        more, w = loss_of(model, robust, tables.observation[i, KIND], r)
        cost += more
        (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = b
        v00 += w * (a0 * a0 + b0 * b0 + c0 * c0)
        v10 += w * (a1 * a0 + b1 * b0 + c1 * c0)
        v11 += w * (a1 * a1 + b1 * b1 + c1 * c1)
        v20 += w * (a2 * a0 + b2 * b0 + c2 * c0)
        v21 += w * (a2 * a1 + b2 * b1 + c2 * c1)
        v22 += w * (a2 * a2 + b2 * b2 + c2 * c2)
        g0 += w * (a0 * r[0] + b0 * r[1] + c0 * r[2])
        g1 += w * (a1 * r[0] + b1 * r[1] + c1 * r[2])
        g2 += w * (a2 * r[0] + b2 * r[1] + c2 * r[2])
    return cost, (v00, v10, v11, v20, v21, v22), (g0, g1, g2), status


@on_device
def factorise(normal, gradient):
    """L of the normal matrix, with 1 / L_jj for L_jj, L^-1 times the gradient, and whether no pivot is lost; else L is
    endless: the point neither moves nor couples.
    """
    v00, v10, v11, v20, v21, v22 = normal
    zero = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not v00 > 0.0:
        return zero, (0.0, 0.0, 0.0), False
    i00 = 1.0 / math.sqrt(v00)
    l10, l20 = v10 * i00, v20 * i00
    d1 = v11 - l10 * l10
    if not d1 > SINGULAR * v11:
        return zero, (0.0, 0.0, 0.0), False
    i11 = 1.0 / math.sqrt(d1)
    l21 = (v21 - l20 * l10) * i11
    d2 = v22 - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * v22:
        return zero, (0.0, 0.0, 0.0), False
    i22 = 1.0 / math.sqrt(d2)
    y0 = gradient[0] * i00
    y1 = (gradient[1] - l10 * y0) * i11
    y2 = (gradient[2] - l20 * y0 - l21 * y1) * i22
    return (i00, l10, i11, l20, l21, i22), (y0, y1, y2), True


@on_device
def back(factor, forward):
    """L^-T times a vector."""
    x2 = forward[2] * factor[5]
    x1 = (forward[1] - factor[4] * x2) * factor[2]
    return (forward[0] - factor[1] * x1 - factor[3] * x2) * factor[0], x1, x2


@on_device
def solved(tables, model, data, weight, x, piece, lane, point, active, move):
    """Coordinates of a point's least cost, those at which its rows are taken, L, L^-1 g, status and cost."""
    pattern = tables.piece[piece, PATTERN]
    fixed = tables.pattern[pattern, KNOWN] > 0
    robust = model.loss != NO_LOSS
    plainly = bool(move and robust and not fixed)
    slow = robust or tables.pattern[pattern, HEIGHTS] > 0
    status, cost, squared, before = GOOD, 0.0, 0.0, point
    factor, forward = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for _ in range(2 * INNER_STEPS):
        before = point
        cost, normal, gradient, status = normal_equations(
            tables, model, data, weight, x, piece, lane, point, active, robust and not plainly, status
        )
        if fixed:
            break
        factor, forward, strong = factorise(normal, gradient)
        if active and (not strong) and status == GOOD:
            status = WEAK
        if not move:
            break
        step = back(factor, forward)
        point = (point[0] - step[0], point[1] - step[1], point[2] - step[2])
        squared = forward[0] * forward[0] + forward[1] * forward[1] + forward[2] * forward[2]
        cost -= 0.5 * squared
        tolerance = SLOW_TOLERANCE if slow and not plainly else PLAIN_TOLERANCE
        if not squared >= tolerance * tolerance:
            if not plainly:
                break
            plainly = False
    if move and (not fixed) and squared > PLAIN_TOLERANCE * PLAIN_TOLERANCE:
        cost += 0.5 * squared  # the steps ran out: what the last one promised doesn't count
    return point, before, factor, forward, status, cost


@kernel
def solve(tables, model, data, weight, kind, x, begin, start, move, points, states, costs, left):
    """Solve all points of a partition from `begin` (n, 3), or from `start` (n, 3) where the loss or the point wants it.

    `points` (n, 3), states (n,) and costs (n,) are where they end, the cost infinite behind a camera; `left`
    (NUMBERS, n) is what a solve leaves. Unless `move` the points stay at `begin`; states are those there, costs and
    `points` stay as they are.
    """
    p = cuda.grid(1)
    if p >= kind.size:
        return
    piece = tables.piece_of_point[p]
    lane = p - tables.piece[piece, FIRST]
    active = kind[p] != OUT
    anew = move and (model.loss != NO_LOSS or tables.pattern[tables.piece[piece, PATTERN], KNOWN] > 0)
    point = (start[p, 0], start[p, 1], start[p, 2]) if anew else (begin[p, 0], begin[p, 1], begin[p, 2])
    point, before, factor, forward, status, cost = solved(
        tables, model, data, weight, x, piece, lane, point, active, move
    )
    if move:
        for j in range(3):
            points[p, j] = point[j]
        costs[p] = math.inf if status == BEHIND else cost
    states[p] = status
    for j in range(3):
        left[AT + j, p] = before[j]
        left[FORWARD + j, p] = forward[j]
    for j in range(6):
        left[FACTOR + j, p] = factor[j]


@on_device
def left_of(left, p):
    """Coordinates, L and L^-1 g that a solve has left of a point."""
    factor = left[3, p], left[4, p], left[5, p], left[6, p], left[7, p], left[8, p]
    return (left[0, p], left[1, p], left[2, p]), factor, (left[9, p], left[10, p], left[11, p])


@kernel
def sum_costs(tables, costs, sums):
    """Costs (m,) of a partition's pieces, a block of threads a piece; always in the same order."""
    of_thread = cuda.shared.array(THREADS, np.float64)
    piece, t = cuda.blockIdx.x, cuda.threadIdx.x
    first, total = tables.piece[piece, FIRST], 0.0
    for p in range(first + t, first + tables.piece[piece, COUNT], THREADS):
        total += costs[p]
    of_thread[t] = total
    cuda.syncthreads()
    if t == 0:
        total = 0.0
        for k in range(THREADS):
            total += of_thread[k]
        sums[piece] = total
