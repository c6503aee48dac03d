"""How far each measure controls itself: its share H of its own adjusted value, and what an error in it does.

With A the whitened rows and Q the covariance of all unknowns, the adjusted measures have the covariance H = A Q A' and
the residuals 1 - H (Baarda 1968; Foerstner & Wrobel 2016, section 4.6). Per point, with P = B L^-T, Y = W L^-T and S
the covariance of the sights' states, all that is needed of Q is U_i = sum_j S_ij Y_j and M = 1 + sum_i Y_i' U_i:
H_i = P_i M P_i' - P_i (J_i U_i)' - (J_i U_i) P_i' + J_i S_ii J_i'; an error e in the rows moves the point by
-L^-T (M P_i' - (J_i U_i)') e.
"""

import numpy as np

from mgsgraph.factors.covariance import MIDDLE, state_covariance
from mgsgraph.factors.elimination import ROW, couple_all, sight_columns
from mgsgraph.factors.lanes import (
    BY_POINT,
    BY_STATE,
    CENTRE,
    COUPLING,
    LANES,
    NORMAL,
    PAIR,
    RESIDUAL,
    RIGHT,
    STATE,
    STATE_WIDTH,
    lane,
)
from mgsgraph.factors.rows import OUT, WEAK
from mgsgraph.factors.tile import row_count, sights_of

NUMBERS = 7
"""Per row: the whitened residual, its row of H (3), the effect on the point (3, m) of an error of one sigma in it."""
CARRIED = CENTRE
"""Registers of a sight, whose constants have served: U (7, 3)."""
OWN = RIGHT
"""Registers of a sight: upper triangle (3, 3) of J S J'."""
THROUGH = PAIR
"""Registers of the tile, once all pairs are done: J U (3, 3), then P (3, 3), then M P' - (J U)' (3, 3)."""


@lane
def add_carried(width_i, width_j, turned, n, w, s, t):
    """Add PAIR Y_j to U_i, or its transpose if `turned` (then PAIR is that of j and i)."""
    for a in range(width_i):
        for b in range(width_j):
            k = PAIR + (STATE_WIDTH * b + a if turned else STATE_WIDTH * a + b) * LANES
            u, y = s + CARRIED + 3 * a * LANES, t + COUPLING + 3 * b * LANES
            for l in range(n):
                w[u + l] += w[k + l] * w[y + l]
                w[u + LANES + l] += w[k + l] * w[y + LANES + l]
                w[u + 2 * LANES + l] += w[k + l] * w[y + 2 * LANES + l]


@lane
def own_share(count, width, n, w, s):
    """OWN: J PAIR J' of a sight with itself."""
    place = 0
    for row in range(count):
        for other in range(row, count):
            sink = s + OWN + place * LANES
            for l in range(n):
                w[sink + l] = 0.0
            for a in range(width):
                for b in range(width):
                    k, left = PAIR + (STATE_WIDTH * a + b) * LANES, s + BY_STATE + row * ROW + a * LANES
                    right = s + BY_STATE + other * ROW + b * LANES
                    for l in range(n):
                        w[sink + l] += w[left + l] * w[k + l] * w[right + l]
            place += 1


@lane
def add_middle(width, n, w, s):
    """Add Y' U of a sight to MIDDLE."""
    place = 0
    for b in range(3):
        for c in range(b, 3):
            for a in range(width):
                y, u = s + COUPLING + (3 * a + b) * LANES, s + CARRIED + (3 * a + c) * LANES
                for l in range(n):
                    w[MIDDLE + place * LANES + l] += w[y + l] * w[u + l]
            place += 1


@lane
def middle(b, c):
    """First register of an element of MIDDLE."""
    low, high = min(b, c), max(b, c)
    return MIDDLE + (3 * low - low * (low - 1) // 2 + high - low) * LANES


@lane
def through_point(count, width, felt, n, w, s):
    """THROUGH: J U, P = B L^-T, and M P' - (J U)', row by row of a sight."""
    for row in range(count):
        ju, p, e = THROUGH + 3 * row * LANES, THROUGH + (9 + 3 * row) * LANES, THROUGH + (18 + 3 * row) * LANES
        b = s + BY_POINT + 3 * row * LANES
        for l in range(n):
            p0 = w[b + l] * w[NORMAL + l]
            p1 = (w[b + LANES + l] - w[NORMAL + LANES + l] * p0) * w[NORMAL + 2 * LANES + l]
            p2 = w[b + 2 * LANES + l] - w[NORMAL + 3 * LANES + l] * p0 - w[NORMAL + 4 * LANES + l] * p1
            w[p + l], w[p + LANES + l], w[p + 2 * LANES + l] = p0, p1, p2 * w[NORMAL + 5 * LANES + l]
        for c in range(3):
            for l in range(n):
                w[ju + c * LANES + l] = 0.0
            for a in range(width if felt else 0):
                state, u = s + BY_STATE + row * ROW + a * LANES, s + CARRIED + (3 * a + c) * LANES
                for l in range(n):
                    w[ju + c * LANES + l] += w[state + l] * w[u + l]
        for c in range(3):
            m0, m1, m2 = middle(c, 0), middle(c, 1), middle(c, 2)
            for l in range(n):
                mp = w[m0 + l] * w[p + l] + w[m1 + l] * w[p + LANES + l] + w[m2 + l] * w[p + 2 * LANES + l]
                w[e + c * LANES + l] = mp - w[ju + c * LANES + l]


@lane
def share(row, other, l, w):
    """Element of H without J S J': P_row (M P' - (J U)')_other - (J U)_row P_other'."""
    total = 0.0
    for c in range(3):
        total += w[THROUGH + (9 + 3 * row + c) * LANES + l] * w[THROUGH + (18 + 3 * other + c) * LANES + l]
        total -= w[THROUGH + (3 * row + c) * LANES + l] * w[THROUGH + (9 + 3 * other + c) * LANES + l]
    return total


@lane
def store_sight(rows, count, felt, at, point, n, w, s, values):
    """`NUMBERS` of each row of a sight; NaN where the point is out or weak."""
    for l in range(n):
        known = (rows.kind[point + l] != OUT) & (w[STATE + l] != WEAK)
        place = 0
        for row in range(count):
            values[at + l, row, 0] = w[s + RESIDUAL + row * LANES + l] if known else np.nan
            for other in range(row, count):
                value = share(row, other, l, w) + (w[s + OWN + place * LANES + l] if felt else 0.0)
                value = value if known else np.nan
                values[at + l, row, 1 + other] = value
                values[at + l, other, 1 + row] = value
                place += 1
            e = THROUGH + (18 + 3 * row) * LANES
            z2 = w[e + 2 * LANES + l] * w[NORMAL + 5 * LANES + l]
            z1 = (w[e + LANES + l] - w[NORMAL + 4 * LANES + l] * z2) * w[NORMAL + 2 * LANES + l]
            z0 = (w[e + l] - w[NORMAL + LANES + l] * z1 - w[NORMAL + 3 * LANES + l] * z2) * w[NORMAL + l]
            values[at + l, row, 4] = -z0 if known else np.nan
            values[at + l, row, 5] = -z1 if known else np.nan
            values[at + l, row, 6] = -z2 if known else np.nan


@lane
def reliability_tile(rows, groups, target, piece, first, joint, n, w, base, depth, values):
    """`NUMBERS` of all rows of a tile's points, whose rows and L are there; `joint` as for covariances."""
    pattern, count = rows.piece[piece, 0], rows.piece[piece, 2]
    couple_all(rows, pattern, n, w, base, depth)
    begin, end = sights_of(rows, pattern)
    for l in range(n):
        for place in range(6):
            w[MIDDLE + place * LANES + l] = 0.0
        w[MIDDLE + l], w[MIDDLE + 3 * LANES + l], w[MIDDLE + 5 * LANES + l] = 1.0, 1.0, 1.0
    for i in range(begin, end):
        u = base + (i - begin) * depth + CARRIED
        for a in range(3 * STATE_WIDTH):
            for l in range(n):
                w[u + a * LANES + l] = 0.0
    for i in range(begin, end):
        s, width_i = base + (i - begin) * depth, rows.sight_width[i]
        for j in range(i, end):
            if sight_columns(rows, i)[1] > 0 and sight_columns(rows, j)[1] > 0:
                t, width_j = base + (j - begin) * depth, rows.sight_width[j]
                state_covariance(rows, groups, target, rows.pattern_group[pattern], joint, i, j, n, w, s, t)
                add_carried(width_i, width_j, False, n, w, s, t)
                if i == j:
                    own_share(row_count(rows.sight_kind[i]), width_i, n, w, s)
                else:
                    add_carried(width_j, width_i, True, n, w, t, s)
    for i in range(begin, end):
        if sight_columns(rows, i)[1] > 0:
            add_middle(rows.sight_width[i], n, w, base + (i - begin) * depth)
    for i in range(begin, end):
        s, felt = base + (i - begin) * depth, sight_columns(rows, i)[1] > 0
        rows_of = row_count(rows.sight_kind[i])
        through_point(rows_of, rows.sight_width[i], felt, n, w, s)
        at = rows.piece[piece, 4] + (i - begin) * count + first
        store_sight(rows, rows_of, felt, at, rows.piece[piece, 1] + first, n, w, s, values)
