"""How much each measure determines its own adjusted value, and what an error in it does to the point.

With A the whitened rows and Q the covariance of all unknowns, the adjusted measures have the covariance H = A Q A' and
the residuals I - H (Baarda 1968; Foerstner & Wrobel 2016, section 4.6). The diagonal of H is the measures' leverage,
that of I - H their redundancy numbers. Per point, with B, W, L and J as in `mgsgraph.kernel.elimination`, P = B L^-T,
Y = W L^-T and S the covariance of the observations' states, all that is needed of Q is U_i = sum_j S_ij Y_j and
M = 1 + sum_i Y_i' U_i: H_i = P_i M P_i' - P_i (J_i U_i)' - (J_i U_i) P_i' + J_i S_ii J_i'. An error e in the rows
moves the point by -L^-T (M P_i' - (J_i U_i)') e.
"""

import numpy as np

from mgsgraph.kernel.covariance import begin_middle, state_covariance
from mgsgraph.kernel.elimination import couple_all
from mgsgraph.kernel.lanes import (
    B_L,
    BY_POINT,
    BY_STATE,
    COUPLED,
    COVARIED,
    ERROR,
    FACTOR,
    J_U,
    LANES,
    MIDDLE,
    PAIR,
    RESIDUAL,
    RESULT,
    ROW,
    SHARED_PART,
    STATUS,
    TILE,
    WIDTH,
    inlined,
    lane,
)
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.rows import OUT, WEAK
from mgsgraph.kernel.tile import BEGIN, END, observation_columns, observation_index, observations_of, point_of

NUMBERS = 7
"""Per row: the whitened residual, its row of H (3), the effect on the point (3, m) of an error of one sigma in it."""


@lane
def add_covaried(width_i, width_j, transposed, w, s, y, d):
    """Add PAIR Y_j, whose coupling begins at d, to U_i, or PAIR' Y_j if `transposed` (then PAIR is that of j and i)."""
    for a in range(width_i):
        for b in range(width_j):
            k = PAIR + (b * WIDTH + a * LANES if transposed else a * WIDTH + b * LANES)
            u, z = s + COVARIED + 3 * a * LANES, d + 3 * b * LANES
            for l in range(LANES):
                w[u + l] += w[k + l] * y[z + l]
                w[u + LANES + l] += w[k + l] * y[z + LANES + l]
                w[u + 2 * LANES + l] += w[k + l] * y[z + 2 * LANES + l]


@lane
def own_share(count, width, w, s):
    """SHARED_PART: J PAIR J' of an observation with itself."""
    index = 0
    for row in range(count):
        for other in range(row, count):
            sink = s + SHARED_PART + index * LANES
            for l in range(LANES):
                w[sink + l] = 0.0
            for a in range(width):
                for b in range(width):
                    k, left = PAIR + a * WIDTH + b * LANES, s + RESULT + BY_STATE + row * ROW + a * LANES
                    right = s + RESULT + BY_STATE + other * ROW + b * LANES
                    for l in range(LANES):
                        w[sink + l] += w[left + l] * w[k + l] * w[right + l]
            index += 1


@lane
def add_middle(width, w, s, y, d):
    """Add Y' U of an observation to MIDDLE."""
    index = 0
    for b in range(3):
        for c in range(b, 3):
            for a in range(width):
                z, u = d + (3 * a + b) * LANES, s + COVARIED + (3 * a + c) * LANES
                for l in range(LANES):
                    w[MIDDLE + index * LANES + l] += y[z + l] * w[u + l]
            index += 1


@lane
def middle(b, c):
    """First register of an element of MIDDLE."""
    low, high = min(b, c), max(b, c)
    return MIDDLE + (3 * low - low * (low - 1) // 2 + high - low) * LANES


@lane
def through_point(count, width, linked, w, s):
    """J_U, B_L and ERROR, row by row of an observation: J U, P = B L^-T, and M P' - (J U)'."""
    for row in range(count):
        ju, p, e = J_U + 3 * row * LANES, B_L + 3 * row * LANES, ERROR + 3 * row * LANES
        b = s + RESULT + BY_POINT + row * ROW
        for l in range(LANES):
            p0 = w[b + l] * w[FACTOR + l]
            p1 = (w[b + LANES + l] - w[FACTOR + LANES + l] * p0) * w[FACTOR + 2 * LANES + l]
            p2 = w[b + 2 * LANES + l] - w[FACTOR + 3 * LANES + l] * p0 - w[FACTOR + 4 * LANES + l] * p1
            w[p + l], w[p + LANES + l], w[p + 2 * LANES + l] = p0, p1, p2 * w[FACTOR + 5 * LANES + l]
        for c in range(3):
            for l in range(LANES):
                w[ju + c * LANES + l] = 0.0
            for a in range(width if linked else 0):
                state, u = s + RESULT + BY_STATE + row * ROW + a * LANES, s + COVARIED + (3 * a + c) * LANES
                for l in range(LANES):
                    w[ju + c * LANES + l] += w[state + l] * w[u + l]
        for c in range(3):
            m0, m1, m2 = middle(c, 0), middle(c, 1), middle(c, 2)
            for l in range(LANES):
                mp = w[m0 + l] * w[p + l] + w[m1 + l] * w[p + LANES + l] + w[m2 + l] * w[p + 2 * LANES + l]
                w[e + c * LANES + l] = mp - w[ju + c * LANES + l]


@lane
def share(row, other, l, w):
    """Element of H without J S J': P_row (M P' - (J U)')_other - (J U)_row P_other'."""
    total = 0.0
    for c in range(3):
        total += w[B_L + (3 * row + c) * LANES + l] * w[ERROR + (3 * other + c) * LANES + l]
        total -= w[J_U + (3 * row + c) * LANES + l] * w[B_L + (3 * other + c) * LANES + l]
    return total


@inlined
def store_observation(rows, count, linked, at, point, first, last, w, s, values):
    """`NUMBERS` of each row of an observation, lanes first .. last; NaN where the point is out or weak."""
    for l in range(first, last):
        known = (rows.kind[point + l] != OUT) & (w[STATUS + l] != WEAK)
        index = 0
        for row in range(count):
            values[at + l, row, 0] = w[s + RESULT + RESIDUAL + row * ROW + l] if known else np.nan
            for other in range(row, count):
                value = share(row, other, l, w) + (w[s + SHARED_PART + index * LANES + l] if linked else 0.0)
                value = value if known else np.nan
                values[at + l, row, 1 + other] = value
                values[at + l, other, 1 + row] = value
                index += 1
            e = ERROR + 3 * row * LANES
            z2 = w[e + 2 * LANES + l] * w[FACTOR + 5 * LANES + l]
            z1 = (w[e + LANES + l] - w[FACTOR + 4 * LANES + l] * z2) * w[FACTOR + 2 * LANES + l]
            z0 = (w[e + l] - w[FACTOR + LANES + l] * z1 - w[FACTOR + 3 * LANES + l] * z2) * w[FACTOR + l]
            values[at + l, row, 4] = -z0 if known else np.nan
            values[at + l, row, 5] = -z1 if known else np.nan
            values[at + l, row, 6] = -z2 if known else np.nan


@lane
def reliability_tile(rows, groups, target, model, segments, count, joint, w, depth, y, values):
    """`NUMBERS` of all rows of a tile's points, whose rows and L are there; `joint` as for covariances."""
    couple_all(rows, model, segments, w, depth, y)
    begin_middle(w)
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        u = TILE + (i - begin) * depth + COVARIED
        for r in range(3 * WIDTH):
            w[u + r] = 0.0
    for i in range(begin, end):
        s, width_i = TILE + (i - begin) * depth, rows.observation_width[i]
        for j in range(i, end):
            if observation_columns(rows, i)[1] > 0 and observation_columns(rows, j)[1] > 0:
                t, width_j = TILE + (j - begin) * depth, rows.observation_width[j]
                state_covariance(rows, groups, target, segments, count, joint, i, j, begin, w, s, t)
                add_covaried(width_i, width_j, False, w, s, y, (j - begin) * COUPLED)
                if i == j:
                    own_share(row_count(rows.observation_kind[i]), width_i, w, s)
                else:
                    add_covaried(width_j, width_i, True, w, t, y, (i - begin) * COUPLED)
    for i in range(begin, end):
        if observation_columns(rows, i)[1] > 0:
            add_middle(rows.observation_width[i], w, TILE + (i - begin) * depth, y, (i - begin) * COUPLED)
    for i in range(begin, end):
        s, linked = TILE + (i - begin) * depth, observation_columns(rows, i)[1] > 0
        rows_of = row_count(rows.observation_kind[i])
        through_point(rows_of, rows.observation_width[i], linked, w, s)
        for k in range(count):
            at, point = observation_index(rows, segments, k, i - begin), point_of(rows, segments, k)
            store_observation(rows, rows_of, linked, at, point, segments[k, BEGIN], segments[k, END], w, s, values)
