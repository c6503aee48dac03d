"""Covariances of the points by back-substitution, S that of the shared unknowns.

Per observation pair S is first taken to the observations' states (pose covariance at their lines), then to their rows.
With J, L and P as in `mgsgraph.kernel.elimination`, (J U)_i = sum_j J_i S_ij J_j' P_j and M = 1 + sum_i P_i' (J U)_i, a
point's covariance is L^-T M L^-1.

And the reliability of measures: how much each determines its own adjusted value, and what an error in it does to the
point. With A the whitened rows and Q the covariance of all unknowns, the adjusted measures have the covariance
H = A Q A' and the residuals I - H (Baarda 1968; Foerstner & Wrobel 2016, section 4.6). The diagonal of H is the
measures' leverage, that of I - H their redundancy numbers:
H_i = P_i M P_i' - P_i (J U)_i' - (J U)_i P_i' + J_i S_ii J_i'. An error e in the rows moves the point by
-L^-T (M P_i' - (J U)_i') e.
"""

import numpy as np

from mgsgraph.kernel.elimination import couple_all
from mgsgraph.kernel.lanes import (
    B_L,
    BASIS,
    BETWEEN,
    BETWEEN_STATES,
    BY_STATE,
    ERROR,
    FACTOR,
    J_U,
    LANES,
    MIDDLE,
    MIXED,
    PRODUCT,
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
from mgsgraph.kernel.tile import (
    BEGIN,
    END,
    PATTERN,
    block_index,
    copy_block,
    observation_columns,
    observation_index,
    observations_of,
    point_of,
    pose_components,
)


@inlined
def entry_columns(rows, i, e):
    """Columns of an observation's e-th entry: the components of a basis term, or a single one."""
    return pose_components(rows.observation_width[i]) if e < rows.observation_terms[i] else 1


@inlined
def lift(rows, i, e, a, s):
    """How column a of an observation's e-th entry acts on its state: first register, its step, and the components it
    moves.
    """
    terms = rows.observation_terms[i]
    if e < terms:
        return s + BASIS + e * LANES, 0, a, a + 1
    return s + BASIS + 2 * terms * LANES + (e - terms) * WIDTH, LANES, 0, rows.observation_width[i]


@inlined
def state_covariance(rows, groups, target, segments, count, joint, i, j, begin, w, s, t, pair):
    """Covariance S_ij (9, 9) between the states of two observations."""
    for r in range(BETWEEN_STATES):
        pair[r] = 0.0
    components_i, components_j = observation_columns(rows, i)[0], observation_columns(rows, j)[0]
    for p in range(rows.observation_terms[i]):
        for q in range(rows.observation_terms[j]):
            first, second = s + BASIS + p * LANES, t + BASIS + q * LANES
            for l in range(LANES):
                w[PRODUCT + l] = w[first + l] * w[second + l]
            for k in range(count):
                pattern = segments[k, PATTERN]
                entry_i = rows.observation_entry[rows.pattern_observation[pattern] + i - begin]
                entry_j = rows.observation_entry[rows.pattern_observation[pattern] + j - begin]
                group = rows.pattern_group[pattern]
                start, down, across, _ = block_index(rows, groups, target, group, entry_i + p, entry_j + q)
                for a in range(components_i):
                    for b in range(components_j):
                        value = joint[start + a * down + b * across]
                        m = a * WIDTH + b * LANES
                        for l in range(segments[k, BEGIN], segments[k, END]):
                            pair[m + l] += value * w[PRODUCT + l]
    if rows.observation_shared[i] + rows.observation_shared[j] > 0:
        for k in range(count):
            singles_covariance(rows, groups, target, segments, k, joint, i, j, begin, w, s, t, pair)


@inlined
def singles_covariance(rows, groups, target, segments, k, joint, i, j, begin, w, s, t, pair):
    """Add, in a segment, the share of pairs of entries of which one at least is a single column."""
    pattern = segments[k, PATTERN]
    first, group = rows.pattern_observation[pattern] - begin, rows.pattern_group[pattern]
    entry_i, entry_j = rows.observation_entry[first + i], rows.observation_entry[first + j]
    terms_i, terms_j = rows.observation_terms[i], rows.observation_terms[j]
    for e in range(terms_i + rows.observation_shared[i]):
        for f in range(0 if e >= terms_i else terms_j, terms_j + rows.observation_shared[j]):
            start, down, across, _ = block_index(rows, groups, target, group, entry_i + e, entry_j + f)
            for a in range(entry_columns(rows, i, e)):
                left = lift(rows, i, e, a, s)
                for b in range(entry_columns(rows, j, f)):
                    value = joint[start + a * down + b * across]
                    add_lifted(value, left, lift(rows, j, f, b, t), segments[k, BEGIN], segments[k, END], w, pair)


@lane
def add_lifted(value, left, right, first, last, w, pair):
    """Add to S_ij the covariance of two columns, each as it acts on its observation's state (`lift`)."""
    from_left, left_step, left_begin, left_end = left
    from_right, right_step, right_begin, right_end = right
    for a in range(left_begin, left_end):
        for b in range(right_begin, right_end):
            k = a * WIDTH + b * LANES
            for l in range(first, last):
                pair[k + l] += value * w[from_left + a * left_step + l] * w[from_right + b * right_step + l]


@lane
def state_to_rows(count_i, count_j, width_i, width_j, w, s, t, pair):
    """BETWEEN: J_i S_ij J_j', between the rows of two observations."""
    f, g = s + RESULT + BY_STATE, t + RESULT + BY_STATE
    for row in range(count_i):
        for r in range(width_j * LANES):
            w[MIXED + r] = 0.0
        for b in range(width_j):
            for a in range(width_i):
                for l in range(LANES):
                    w[MIXED + b * LANES + l] += w[f + row * ROW + a * LANES + l] * pair[a * WIDTH + b * LANES + l]
        for column in range(count_j):
            k = BETWEEN + (3 * row + column) * LANES
            for l in range(LANES):
                w[k + l] = 0.0
            for b in range(width_j):
                for l in range(LANES):
                    w[k + l] += w[MIXED + b * LANES + l] * w[g + column * ROW + b * LANES + l]


@lane
def add_covaried(count_i, count_j, down, across, w, s, t):
    """Add BETWEEN P_j to (J U)_i; its rows are `down` apart, its columns `across`."""
    for row in range(count_i):
        for column in range(count_j):
            k = BETWEEN + (row * down + column * across) * LANES
            for c in range(3):
                u, p = s + J_U + (3 * row + c) * LANES, t + B_L + (3 * column + c) * LANES
                for l in range(LANES):
                    w[u + l] += w[k + l] * w[p + l]


@lane
def add_middle(count, w, s):
    """Add P' J U of an observation to MIDDLE."""
    for row in range(count):
        index = MIDDLE
        for b in range(3):
            for c in range(b, 3):
                p, u = s + B_L + (3 * row + b) * LANES, s + J_U + (3 * row + c) * LANES
                for l in range(LANES):
                    w[index + l] += w[p + l] * w[u + l]
                index += LANES


@lane
def covary(rows, groups, target, model, segments, count, joint, w, depth, pair):
    """J_U and SHARED_PART of a tile's observations, whose rows and L are there, and MIDDLE."""
    couple_all(rows, model, segments, w, depth)
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        s = TILE + (i - begin) * depth
        for r in range(9 * LANES):
            w[s + J_U + r] = 0.0
            w[s + SHARED_PART + r] = 0.0
    for i in range(begin, end):
        s, count_i = TILE + (i - begin) * depth, row_count(rows.observation_kind[i])
        for j in range(i, end):
            if observation_columns(rows, i)[1] > 0 and observation_columns(rows, j)[1] > 0:
                t, count_j = TILE + (j - begin) * depth, row_count(rows.observation_kind[j])
                state_covariance(rows, groups, target, segments, count, joint, i, j, begin, w, s, t, pair)
                state_to_rows(count_i, count_j, rows.observation_width[i], rows.observation_width[j], w, s, t, pair)
                add_covaried(count_i, count_j, 3, 1, w, s, t)
                if i == j:
                    copy_block(w, BETWEEN, s + SHARED_PART, 9 * LANES)
                else:
                    add_covaried(count_j, count_i, 1, 3, w, t, s)
    begin_middle(w)
    for i in range(begin, end):
        add_middle(row_count(rows.observation_kind[i]), w, TILE + (i - begin) * depth)


@lane
def begin_middle(w):
    """MIDDLE: the unit matrix."""
    for r in range(6 * LANES):
        w[MIDDLE + r] = 0.0
    for l in range(LANES):
        w[MIDDLE + l], w[MIDDLE + 3 * LANES + l], w[MIDDLE + 5 * LANES + l] = 1.0, 1.0, 1.0


@inlined
def store(rows, point, first, last, w, covariances):
    """Covariances (n, 3, 3): L^-T MIDDLE L^-1; NaN for weak points, zero for those that are left out."""
    for l in range(first, last):
        i00, l10, i11 = w[FACTOR + l], w[FACTOR + LANES + l], w[FACTOR + 2 * LANES + l]
        l20, l21, i22 = w[FACTOR + 3 * LANES + l], w[FACTOR + 4 * LANES + l], w[FACTOR + 5 * LANES + l]
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
        elif w[STATUS + l] == WEAK:
            c[:, :] = np.nan


@lane
def covariance_tile(rows, groups, target, model, segments, count, joint, w, depth, pair, covariances):
    """Covariances (n, 3, 3) in m^2 of a tile's points, whose rows and L are there; zero for known ones.

    `joint` holds the covariance of the shared unknowns in the blocks that `target` describes.
    """
    covary(rows, groups, target, model, segments, count, joint, w, depth, pair)
    for k in range(count):
        store(rows, point_of(rows, segments, k), segments[k, BEGIN], segments[k, END], w, covariances)



NUMBERS = 7
"""Per row: the whitened residual, its row of H (3), the effect on the point (3, m) of an error of one sigma in it."""


@lane
def middle(b, c):
    """First register of an element of MIDDLE."""
    low, high = min(b, c), max(b, c)
    return MIDDLE + (3 * low - low * (low - 1) // 2 + high - low) * LANES


@lane
def find_errors(count, w, s):
    """ERROR of an observation, row by row: M P' - (J U)'."""
    for row in range(count):
        p, u, e = s + B_L + 3 * row * LANES, s + J_U + 3 * row * LANES, ERROR + 3 * row * LANES
        for c in range(3):
            m0, m1, m2 = middle(c, 0), middle(c, 1), middle(c, 2)
            for l in range(LANES):
                mp = w[m0 + l] * w[p + l] + w[m1 + l] * w[p + LANES + l] + w[m2 + l] * w[p + 2 * LANES + l]
                w[e + c * LANES + l] = mp - w[u + c * LANES + l]


@lane
def share(row, column, l, w, s):
    """Element of H without J S J': P_row (M P' - (J U)')_other - (J U)_row P_other'."""
    total = 0.0
    for c in range(3):
        total += w[s + B_L + (3 * row + c) * LANES + l] * w[ERROR + (3 * column + c) * LANES + l]
        total -= w[s + J_U + (3 * row + c) * LANES + l] * w[s + B_L + (3 * column + c) * LANES + l]
    return total


@inlined
def store_observation(rows, count, at, point, first, last, w, s, values):
    """`NUMBERS` of each row of an observation, lanes first .. last; NaN where the point is out or weak."""
    for l in range(first, last):
        valid = (rows.kind[point + l] != OUT) & (w[STATUS + l] != WEAK)
        for row in range(count):
            values[at + l, row, 0] = w[s + RESULT + RESIDUAL + row * ROW + l] if valid else np.nan
            for column in range(row, count):
                value = share(row, column, l, w, s) + w[s + SHARED_PART + (3 * row + column) * LANES + l]
                value = value if valid else np.nan
                values[at + l, row, 1 + column] = value
                values[at + l, column, 1 + row] = value
            e = ERROR + 3 * row * LANES
            z2 = w[e + 2 * LANES + l] * w[FACTOR + 5 * LANES + l]
            z1 = (w[e + LANES + l] - w[FACTOR + 4 * LANES + l] * z2) * w[FACTOR + 2 * LANES + l]
            z0 = (w[e + l] - w[FACTOR + LANES + l] * z1 - w[FACTOR + 3 * LANES + l] * z2) * w[FACTOR + l]
            values[at + l, row, 4] = -z0 if valid else np.nan
            values[at + l, row, 5] = -z1 if valid else np.nan
            values[at + l, row, 6] = -z2 if valid else np.nan


@lane
def reliability_tile(rows, groups, target, model, segments, count, joint, w, depth, pair, values):
    """`NUMBERS` of all rows of a tile's points, whose rows and L are there; `joint` as for covariances."""
    covary(rows, groups, target, model, segments, count, joint, w, depth, pair)
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        s, rows_of = TILE + (i - begin) * depth, row_count(rows.observation_kind[i])
        find_errors(rows_of, w, s)
        for k in range(count):
            at, point = observation_index(rows, segments, k, i - begin), point_of(rows, segments, k)
            store_observation(rows, rows_of, at, point, segments[k, BEGIN], segments[k, END], w, s, values)
