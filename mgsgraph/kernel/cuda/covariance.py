"""Covariances of the points by back-substitution, and the reliability of observations, from what `coupling` leaves.

As `kernel.covariance` and `kernel.covariance` say; S_ij, the covariance between two observations' columns, is worked
out by each thread part by part.
"""

import math

import numpy as np

from mgsgraph.kernel.covariance import NUMBERS
from mgsgraph.kernel.cuda.coupling import basis_of, scaled_rows, whose
from mgsgraph.kernel.cuda.device import cuda, kernel, on_device
from mgsgraph.kernel.cuda.solving import back, left_of
from mgsgraph.kernel.cuda.tables import (
    BEGIN,
    END,
    FIRST,
    KIND,
    PATTERN,
    block_of,
    left_at,
    part,
    parts_of,
    row_count,
    rows_at,
)
from mgsgraph.kernel.rows import OUT, WEAK


@on_device
def joint_part(tables, pattern, result, joint, i, at, part_i, j, at_j, part_j, stride, pair):
    """S_ij between two parts, to `pair` (6 x 6)."""
    _, columns, terms, entry = part_i
    _, columns_j, terms_j, entry_j = part_j
    _, _, basis_i = rows_at(tables, i)
    _, _, basis_j = rows_at(tables, j)
    for a in range(36):
        pair[a] = 0.0
    for p in range(max(terms, 1)):
        for q in range(max(terms_j, 1)):
            weight = basis_of(result, at, stride, basis_i, terms, p)
            weight *= basis_of(result, at_j, stride, basis_j, terms_j, q)
            if terms > 0 and terms_j > 0:
                start, down, across, _ = block_of(tables, pattern, entry + p, entry_j + q)
                for a in range(columns):
                    for b in range(columns_j):
                        pair[6 * a + b] += weight * joint[start + a * down + b * across]
            else:
                for a in range(columns):
                    for b in range(columns_j):
                        entry_a = entry + (p if terms > 0 else a)
                        entry_b = entry_j + (q if terms_j > 0 else b)
                        start, down, across, _ = block_of(tables, pattern, entry_a, entry_b)
                        inside = (a * down if terms > 0 else 0) + (b * across if terms_j > 0 else 0)
                        pair[6 * a + b] += weight * joint[start + inside]


@on_device
def coupling_of(result, at, stride, column):
    """Y of a column."""
    k = at + 3 * column * stride
    return result[k], result[k + stride], result[k + 2 * stride]


@on_device
def add_through(result, at, part_i, at_j, part_j, stride, pair, g):
    """A matrix g (3 x 3) plus Y_i' S_ij Y_j of two parts."""
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = g
    first, columns, _, _ = part_i
    second, columns_j, _, _ = part_j
    for a in range(columns):
        u0 = u1 = u2 = 0.0
        for b in range(columns_j):
            z0, z1, z2 = coupling_of(result, at_j, stride, second + b)
            u0 += pair[6 * a + b] * z0
            u1 += pair[6 * a + b] * z1
            u2 += pair[6 * a + b] * z2
        y0, y1, y2 = coupling_of(result, at, stride, first + a)
        g00 += y0 * u0
        g01 += y0 * u1
        g02 += y0 * u2
        g10 += y1 * u0
        g11 += y1 * u1
        g12 += y1 * u2
        g20 += y2 * u0
        g21 += y2 * u1
        g22 += y2 * u2
    return g00, g01, g02, g10, g11, g12, g20, g21, g22


@on_device
def through_shared(tables, result, joint, piece, lane):
    """sum_ij Y_i' S_ij Y_j of a point, its upper triangle."""
    pair = cuda.local.array(36, np.float64)
    m = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    pattern = tables.piece[piece, PATTERN]
    end = tables.pattern[pattern, END]
    for i in range(tables.pattern[pattern, BEGIN], end):
        at, stride = left_at(tables, piece, i, lane)
        for j in range(i, end):
            at_j, _ = left_at(tables, piece, j, lane)
            g = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            for first in range(parts_of(tables, i)):
                part_i = part(tables, i, first)
                for second in range(parts_of(tables, j)):
                    part_j = part(tables, j, second)
                    joint_part(tables, pattern, result, joint, i, at, part_i, j, at_j, part_j, stride, pair)
                    g = add_through(result, at, part_i, at_j, part_j, stride, pair, g)
            twice = 0.5 if i == j else 1.0
            m = (
                m[0] + twice * (g[0] + g[0]), m[1] + twice * (g[1] + g[3]), m[2] + twice * (g[2] + g[6]),
                m[3] + twice * (g[4] + g[4]), m[4] + twice * (g[5] + g[7]), m[5] + twice * (g[8] + g[8]),
            )  # fmt: skip
    return m


@kernel
def cover(tables, kind, states, left, result, joint, middle, values):
    """M = 1 + sum_ij Y_i' S_ij Y_j of all points of a partition, `middle` (6, n), upper triangles; and, where `values`
    (n, 3, 3) has room, their covariances L^-T M L^-1, NaN for weak points, zero for those that are left out. `joint`
    holds the covariance of the shared unknowns, as the blocks of pairs of variables.
    """
    p = cuda.grid(1)
    if p >= kind.size:
        return
    piece = tables.piece_of_point[p]
    m00, m01, m02, m11, m12, m22 = through_shared(tables, result, joint, piece, p - tables.piece[piece, FIRST])
    m00, m11, m22 = m00 + 1.0, m11 + 1.0, m22 + 1.0
    middle[0, p], middle[1, p], middle[2, p] = m00, m01, m02
    middle[3, p], middle[4, p], middle[5, p] = m11, m12, m22
    if values.shape[0] == 0:
        return
    _, factor, _ = left_of(left, p)
    columns = back(factor, (m00, m01, m02)), back(factor, (m01, m11, m12)), back(factor, (m02, m12, m22))
    for a in range(3):
        row = back(factor, (columns[0][a], columns[1][a], columns[2][a]))
        for b in range(3):
            value = row[b]
            if kind[p] == OUT:
                value = 0.0
            elif states[p] == WEAK:
                value = math.nan
            values[p, a, b] = value


@on_device
def rows_of_column(result, at, stride, first, rows, column):
    """Rows of a column, zero beyond what there are."""
    k = at + (first + column * rows) * stride
    second = result[k + stride] if rows > 1 else 0.0
    return result[k], second, result[k + 2 * stride] if rows > 2 else 0.0


@on_device
def forward_rows(factor, b):
    """P = B L^-T of a row."""
    p0 = b[0] * factor[0]
    p1 = (b[1] - factor[1] * p0) * factor[2]
    return p0, p1, (b[2] - factor[3] * p0 - factor[4] * p1) * factor[5]


@on_device
def shares(tables, result, joint, piece, i, lane, ju, own):
    """J_i U_i with U_i = sum_j S_ij Y_j, to `ju` (3 x 3), and J_i S_ii J_i', to `own` (3 x 3)."""
    pair = cuda.local.array(36, np.float64)
    pattern = tables.piece[piece, PATTERN]
    at, stride = left_at(tables, piece, i, lane)
    rows, (first_row, _, _) = row_count(tables.observation[i, KIND]), rows_at(tables, i)
    for e in range(9):
        ju[e] = 0.0
        own[e] = 0.0
    for j in range(tables.pattern[pattern, BEGIN], tables.pattern[pattern, END]):
        at_j, _ = left_at(tables, piece, j, lane)
        for one_part in range(parts_of(tables, i)):
            part_i = part(tables, i, one_part)
            for other_part in range(parts_of(tables, j)):
                part_j = part(tables, j, other_part)
                joint_part(tables, pattern, result, joint, i, at, part_i, j, at_j, part_j, stride, pair)
                for b in range(part_j[1]):
                    s0 = s1 = s2 = 0.0  # J S, a column of it
                    for a in range(part_i[1]):
                        j0, j1, j2 = rows_of_column(result, at, stride, first_row, rows, part_i[0] + a)
                        s0 += j0 * pair[6 * a + b]
                        s1 += j1 * pair[6 * a + b]
                        s2 += j2 * pair[6 * a + b]
                    y = coupling_of(result, at_j, stride, part_j[0] + b)
                    for e in range(3):
                        ju[e] += s0 * y[e]
                        ju[3 + e] += s1 * y[e]
                        ju[6 + e] += s2 * y[e]
                    if i == j:
                        z = rows_of_column(result, at, stride, first_row, rows, part_j[0] + b)
                        for e in range(3):
                            own[e] += s0 * z[e]
                            own[3 + e] += s1 * z[e]
                            own[6 + e] += s2 * z[e]


@kernel
def judge(tables, model, data, weight, kind, x, states, left, result, joint, middle, values):
    """`reliability.NUMBERS` of each row of all observations of a partition (t, 3, 7), a thread an observation; `middle`
    (6, n) as `cover` has it.
    """
    k = cuda.grid(1)
    if k >= weight.shape[1]:
        return
    piece, i, lane = whose(tables, k)
    p = tables.piece[piece, FIRST] + lane
    point, factor, _ = left_of(left, p)
    r, b, _, _, root = scaled_rows(tables, model, data, weight, kind, x, k, point)
    ju, own = cuda.local.array(9, np.float64), cuda.local.array(9, np.float64)
    errors, through = cuda.local.array(9, np.float64), cuda.local.array(9, np.float64)
    shares(tables, result, joint, piece, i, lane, ju, own)
    valid = (kind[p] != OUT) & (states[p] != WEAK)
    m00, m01, m02 = middle[0, p], middle[1, p], middle[2, p]
    m11, m12, m22 = middle[3, p], middle[4, p], middle[5, p]
    rows = row_count(tables.observation[i, KIND])
    for row in range(rows):
        p0, p1, p2 = forward_rows(factor, (root * b[row][0], root * b[row][1], root * b[row][2]))
        through[3 * row], through[3 * row + 1], through[3 * row + 2] = p0, p1, p2
        errors[3 * row] = m00 * p0 + m01 * p1 + m02 * p2 - ju[3 * row]
        errors[3 * row + 1] = m01 * p0 + m11 * p1 + m12 * p2 - ju[3 * row + 1]
        errors[3 * row + 2] = m02 * p0 + m12 * p1 + m22 * p2 - ju[3 * row + 2]
    for row in range(rows, 3):
        for c in range(NUMBERS):
            values[k, row, c] = 0.0
    for row in range(rows):
        for c in range(rows, 3):
            values[k, row, 1 + c] = 0.0
        values[k, row, 0] = root * r[row] if valid else math.nan
        for column in range(row, rows):
            value = own[3 * row + column]
            for c in range(3):
                value += through[3 * row + c] * errors[3 * column + c] - ju[3 * row + c] * through[3 * column + c]
            value = value if valid else math.nan
            values[k, row, 1 + column] = value
            values[k, column, 1 + row] = value
        moved = back(factor, (errors[3 * row], errors[3 * row + 1], errors[3 * row + 2]))
        for c in range(3):
            values[k, row, 4 + c] = -moved[c] if valid else math.nan
