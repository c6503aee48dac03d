"""Covariances of the points by back-substitution: S_p = V^-1 + V^-1 W' S W V^-1, S that of the shared unknowns.

Per sight pair S is first taken to the sights' states (pose covariance at their lines), then through Y = W L^-T:
S_p = L^-T (1 + sum_ij Y_i' S_ij Y_j) L^-1.
"""

import numpy as np

from mgsgraph.factors.elimination import ROW, SPARE, block_place, couple_all, multiply_add, sight_columns
from mgsgraph.factors.lanes import BASIS, COUPLING, LANES, NORMAL, PAIR, PRODUCT, STATE, STATE_WIDTH, lane
from mgsgraph.factors.pose import pose_components
from mgsgraph.factors.rows import OUT, WEAK
from mgsgraph.factors.tile import sights_of

MIDDLE = SPARE + 3 * STATE_WIDTH * LANES
"""Registers for the upper triangle of 1 + sum_ij Y_i' S_ij Y_j."""


@lane
def entry_columns(rows, i, e):
    """Columns of a sight's e-th entry: the components of a basis term, or a single one."""
    return pose_components(rows.sight_width[i]) if e < rows.sight_terms[i] else 1


@lane
def lift(rows, i, e, a, s):
    """How column a of a sight's e-th entry acts on its state: first register, its step, and the components it moves."""
    terms = rows.sight_terms[i]
    if e < terms:
        return s + BASIS + e * LANES, 0, a, a + 1
    return s + BASIS + 2 * terms * LANES + (e - terms) * ROW, LANES, 0, rows.sight_width[i]


@lane
def state_covariance(rows, groups, target, group, joint, i, j, n, w, s, t):
    """PAIR: covariance (7, 7) between the states of two sights."""
    for k in range(STATE_WIDTH * STATE_WIDTH):
        for l in range(n):
            w[PAIR + k * LANES + l] = 0.0
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    entry_i, entry_j = rows.sight_entry[i], rows.sight_entry[j]
    for p in range(rows.sight_terms[i]):
        for q in range(rows.sight_terms[j]):
            multiply_add(n, w, s + BASIS + p * LANES, t + BASIS + q * LANES, PRODUCT, False)
            start, down, across, _ = block_place(rows, groups, target, group, entry_i + p, entry_j + q)
            for a in range(components_i):
                for b in range(components_j):
                    value = joint[start + a * down + b * across]
                    k = PAIR + (STATE_WIDTH * a + b) * LANES
                    for l in range(n):
                        w[k + l] += value * w[PRODUCT + l]
    if rows.sight_shared[i] + rows.sight_shared[j] > 0:
        shared_state_covariance(rows, groups, target, group, joint, i, j, n, w, s, t)


@lane
def shared_state_covariance(rows, groups, target, group, joint, i, j, n, w, s, t):
    """Add the share of pairs of entries of which one at least is a single column."""
    terms_i, terms_j = rows.sight_terms[i], rows.sight_terms[j]
    entry_i, entry_j = rows.sight_entry[i], rows.sight_entry[j]
    for e in range(terms_i + rows.sight_shared[i]):
        for f in range(0 if e >= terms_i else terms_j, terms_j + rows.sight_shared[j]):
            start, down, across, _ = block_place(rows, groups, target, group, entry_i + e, entry_j + f)
            for a in range(entry_columns(rows, i, e)):
                left = lift(rows, i, e, a, s)
                for b in range(entry_columns(rows, j, f)):
                    add_lifted(joint[start + a * down + b * across], left, lift(rows, j, f, b, t), n, w)


@lane
def add_lifted(value, left, right, n, w):
    """Add to PAIR the covariance of two columns, each as it acts on its sight's state (`lift`)."""
    from_left, left_step, left_begin, left_end = left
    from_right, right_step, right_begin, right_end = right
    for a in range(left_begin, left_end):
        for b in range(right_begin, right_end):
            k = PAIR + (STATE_WIDTH * a + b) * LANES
            for l in range(n):
                w[k + l] += value * w[from_left + a * left_step + l] * w[from_right + b * right_step + l]


@lane
def through_coupling(width_i, width_j, twice, n, w, s, t):
    """Add Y_i' PAIR Y_j to MIDDLE, and its transpose if `twice`."""
    for a in range(width_i):
        for c in range(3):
            u = SPARE + (3 * a + c) * LANES
            for l in range(n):
                w[u + l] = 0.0
            for b in range(width_j):
                k, y = PAIR + (STATE_WIDTH * a + b) * LANES, t + COUPLING + (3 * b + c) * LANES
                for l in range(n):
                    w[u + l] += w[k + l] * w[y + l]
    place = 0
    for b in range(3):
        for c in range(b, 3):
            for a in range(width_i):
                y, u = s + COUPLING + 3 * a * LANES, SPARE + 3 * a * LANES
                for l in range(n):
                    w[MIDDLE + place * LANES + l] += w[y + b * LANES + l] * w[u + c * LANES + l]
                    if twice:
                        w[MIDDLE + place * LANES + l] += w[y + c * LANES + l] * w[u + b * LANES + l]
            place += 1


@lane
def store(rows, point, n, w, covariances):
    """Covariances (n, 3, 3): L^-T MIDDLE L^-1; NaN for weak points, zero for those that are left out."""
    for l in range(n):
        i00, l10, i11 = w[NORMAL + l], w[NORMAL + LANES + l], w[NORMAL + 2 * LANES + l]
        l20, l21, i22 = w[NORMAL + 3 * LANES + l], w[NORMAL + 4 * LANES + l], w[NORMAL + 5 * LANES + l]
        i10 = -l10 * i00 * i11
        i21 = -l21 * i11 * i22
        i20 = -(l20 * i00 + l21 * i10) * i22
        m00, m01, m02 = w[MIDDLE + l], w[MIDDLE + LANES + l], w[MIDDLE + 2 * LANES + l]
        m11, m12, m22 = w[MIDDLE + 3 * LANES + l], w[MIDDLE + 4 * LANES + l], w[MIDDLE + 5 * LANES + l]
        # columns of MIDDLE L^-1
        a00, a10, a20 = (
            m00 * i00 + m01 * i10 + m02 * i20,
            m01 * i00 + m11 * i10 + m12 * i20,
            m02 * i00 + m12 * i10 + m22 * i20,
        )
        a01, a11, a21 = m01 * i11 + m02 * i21, m11 * i11 + m12 * i21, m12 * i11 + m22 * i21
        a12, a22 = m12 * i22, m22 * i22
        c = covariances[point + l]
        c[0, 0] = i00 * a00 + i10 * a10 + i20 * a20
        c[0, 1] = c[1, 0] = i00 * a01 + i10 * a11 + i20 * a21
        c[0, 2] = c[2, 0] = i00 * m02 * i22 + i10 * a12 + i20 * a22
        c[1, 1] = i11 * a11 + i21 * a21
        c[1, 2] = c[2, 1] = i11 * a12 + i21 * a22
        c[2, 2] = i22 * a22
        if rows.kind[point + l] == OUT:
            c[:, :] = 0.0
        elif w[STATE + l] == WEAK:
            c[:, :] = np.nan


@lane
def covariance_tile(rows, groups, target, pattern, joint, point, n, w, base, depth, covariances):
    """Covariances (n, 3, 3) in m^2 of a tile's points, whose rows and L are there; zero for known ones.

    `joint` holds the covariance of the shared unknowns in the blocks that `target` describes.
    """
    couple_all(rows, pattern, n, w, base, depth)
    for l in range(n):
        for place in range(6):
            w[MIDDLE + place * LANES + l] = 0.0
        w[MIDDLE + l], w[MIDDLE + 3 * LANES + l], w[MIDDLE + 5 * LANES + l] = 1.0, 1.0, 1.0
    begin, end = sights_of(rows, pattern)
    for i in range(begin, end):
        s = base + (i - begin) * depth
        for j in range(i, end):
            if sight_columns(rows, i)[1] > 0 and sight_columns(rows, j)[1] > 0:
                t = base + (j - begin) * depth
                state_covariance(rows, groups, target, rows.pattern_group[pattern], joint, i, j, n, w, s, t)
                through_coupling(rows.sight_width[i], rows.sight_width[j], i != j, n, w, s, t)
    store(rows, point, n, w, covariances)
