"""Exact elimination of the points (Schur complement) and the sum of what is left over all of them.

With J the rows by the unknowns, B by the point and V = B'B = L L', a point leaves J'J - W V^-1 W' with W = J'B. A
sight feels the unknowns through its state (pose correction at its line): J = G' J_state with G its basis values and
directions. So the small matrices K_ij between states are formed per point, and only their sums over points, weighted
with products of basis values, reach the size of the unknowns: 36 x 9 products for two polynomials of degree two.

The sums go point by point, each adding K_ij times the row of its products: no sum over lanes has to be ended, so that a
segment of five points costs per point what one of a thousand does.
"""

import numpy as np

from mgsgraph.factors.algebra import add, dot, scale
from mgsgraph.kernel.blocks import fours, pair_sums, paired, sight_columns, spread_pair, term_sums
from mgsgraph.kernel.lanes import (
    BASIS,
    BY_POINT,
    BY_STATE,
    CARRY,
    COLUMN,
    COUPLED,
    FACTOR,
    FORWARD,
    FOUR,
    LANES,
    PAIR,
    RESIDUAL,
    RESULT,
    RIGHT,
    ROW,
    STATE,
    STATE_WIDTH,
    TILE,
    WIDTH,
    four,
    inlined,
    lane,
    multiply_add,
    put_four,
    summing,
    times,
)
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.rows import GOOD, IMAGE, PREDICTED, Rows
from mgsgraph.kernel.tile import BEGIN, END, PATTERN, all_good, pose_components, sights_of


@lane
def carry_basis(rows, i, w, s):
    """Basis values at the line whose pose was used."""
    terms = rows.sight_terms[i]
    for t in range(terms if rows.sight_kind[i] == IMAGE else 0):
        basis = s + BASIS + t * LANES
        for l in range(LANES):
            w[basis + l] += w[s + RESULT + CARRY + l] * w[basis + terms * LANES + l]


@lane
def silence(count, w, s):
    """Take points that aren't solved out of the system."""
    for row in range(count):
        for a in range(STATE_WIDTH):
            state = s + RESULT + BY_STATE + row * ROW + a * LANES
            for l in range(LANES):
                w[state + l] = w[state + l] if w[STATE + l] == GOOD else 0.0


@inlined
def three(registers, first, l):
    """Three registers of a lane."""
    return registers[first + l], registers[first + LANES + l], registers[first + 2 * LANES + l]


@inlined
def put_coupling(w, y, mine, right, l, a, r):
    """Y = a L^-T of a row a of W, and right side r - Y L^-1 g, lane l."""
    y0 = a[0] * w[FACTOR + l]
    y1 = (a[1] - w[FACTOR + LANES + l] * y0) * w[FACTOR + 2 * LANES + l]
    y2 = a[2] - w[FACTOR + 3 * LANES + l] * y0 - w[FACTOR + 4 * LANES + l] * y1
    y2 *= w[FACTOR + 5 * LANES + l]
    y[mine + l], y[mine + LANES + l], y[mine + 2 * LANES + l] = y0, y1, y2
    w[right + l] = r - dot((y0, y1, y2), three(w, FORWARD, l))


@lane
def couple(count, width, w, s, y, c):
    """Y = W L^-T from register c of the coupling on, and RIGHT J'r - Y L^-1 g, of a sight, W = J_state' B."""
    b, r = s + RESULT + BY_POINT, s + RESULT + RESIDUAL
    for a in range(width):
        f, right, mine = s + RESULT + BY_STATE + a * LANES, s + RIGHT + a * LANES, c + 3 * a * LANES
        if count == 1:
            for l in range(LANES):
                put_coupling(w, y, mine, right, l, scale(w[f + l], three(w, b, l)), w[f + l] * w[r + l])
        elif count == 2:
            for l in range(LANES):
                u, v = w[f + l], w[f + ROW + l]
                row = add(scale(u, three(w, b, l)), scale(v, three(w, b + ROW, l)))
                put_coupling(w, y, mine, right, l, row, u * w[r + l] + v * w[r + ROW + l])
        else:
            for l in range(LANES):
                u, v, z = w[f + l], w[f + ROW + l], w[f + 2 * ROW + l]
                row = add(scale(u, three(w, b, l)), scale(v, three(w, b + ROW, l)))
                row = add(row, scale(z, three(w, b + 2 * ROW, l)))
                rest = u * w[r + l] + v * w[r + ROW + l] + z * w[r + 2 * ROW + l]
                put_coupling(w, y, mine, right, l, row, rest)


@lane
def couple_all(rows, model, segments, w, depth, y):
    """Coupling and RIGHT of all sights that feel an unknown."""
    begin, end = sights_of(rows, segments)
    lost = not all_good(w)
    if rows.pattern_fixed[segments[0, PATTERN]]:  # known points have nothing to eliminate: an endless L
        for r in range(6 * LANES):
            w[FACTOR + r] = 0.0
        for r in range(3 * LANES):
            w[FORWARD + r] = 0.0
    for i in range(begin, end):
        s = TILE + (i - begin) * depth
        if sight_columns(rows, i)[1] > 0:
            if lost:
                silence(row_count(rows.sight_kind[i]), w, s)
            if model.line == PREDICTED:
                carry_basis(rows, i, w, s)
            couple(row_count(rows.sight_kind[i]), rows.sight_width[i], w, s, y, (i - begin) * COUPLED)


@inlined
def put_products(w, k, y, z0, z1, z2, z3, z4, z5):
    """A row of -Y_i Y_j', six registers."""
    w[k], w[k + LANES], w[k + 2 * LANES] = -dot(y, z0), -dot(y, z1), -dot(y, z2)
    w[k + 3 * LANES], w[k + 4 * LANES], w[k + 5 * LANES] = -dot(y, z3), -dot(y, z4), -dot(y, z5)


@lane
def pose_pair(w, y, c, d):
    """PAIR: -Y_i Y_j' between the poses of two sights, whose coupling begins at c and d; each number is read once."""
    for l in range(LANES):
        z0, z1, z2 = three(y, d, l), three(y, d + 3 * LANES, l), three(y, d + 6 * LANES, l)
        z3, z4, z5 = three(y, d + 9 * LANES, l), three(y, d + 12 * LANES, l), three(y, d + 15 * LANES, l)
        put_products(w, PAIR + l, three(y, c, l), z0, z1, z2, z3, z4, z5)
        put_products(w, PAIR + WIDTH + l, three(y, c + 3 * LANES, l), z0, z1, z2, z3, z4, z5)
        put_products(w, PAIR + 2 * WIDTH + l, three(y, c + 6 * LANES, l), z0, z1, z2, z3, z4, z5)
        put_products(w, PAIR + 3 * WIDTH + l, three(y, c + 9 * LANES, l), z0, z1, z2, z3, z4, z5)
        put_products(w, PAIR + 4 * WIDTH + l, three(y, c + 12 * LANES, l), z0, z1, z2, z3, z4, z5)
        put_products(w, PAIR + 5 * WIDTH + l, three(y, c + 15 * LANES, l), z0, z1, z2, z3, z4, z5)


@lane
def state_pair(count, first_width, second_width, same, w, s, y, c, d):
    """PAIR: K_ij = (J_i'J_i, if the same) - Y_i Y_j' between the states of two sights; a <= b alone, if the same."""
    if first_width == 6 and second_width == 6:
        pose_pair(w, y, c, d)
    for a in range(first_width):
        mine = c + 3 * a * LANES
        for b in range(a if same else 0, second_width):
            z, k = d + 3 * b * LANES, PAIR + a * WIDTH + b * LANES
            if first_width != 6 or second_width != 6:
                for l in range(LANES):
                    w[k + l] = -dot(three(y, mine, l), three(y, z, l))
            f, g = s + RESULT + BY_STATE + a * LANES, s + RESULT + BY_STATE + b * LANES
            for row in range(count if same else 0):
                for l in range(LANES):
                    w[k + l] += w[f + row * ROW + l] * w[g + row * ROW + l]


@lane
def lane_values(rows, i, w, s, products, at):
    """A sight's basis values, lane by lane, in fours from `at` on."""
    terms, room = rows.sight_terms[i], fours(rows.sight_terms[i])
    for q in range(room):
        value = s + BASIS + q * LANES
        for l in range(LANES):
            products[at + q + l * room] = w[value + l] if q < terms else 0.0


@lane
def lane_products(rows, i, w, s, products, values, room):
    """Products of sight i's basis values with another's (`lane_values`), lane by lane from 0 on; numbers of a lane."""
    stride = rows.sight_terms[i] * room
    for p in range(rows.sight_terms[i]):
        first = s + BASIS + p * LANES
        for q in range(0, room, FOUR):
            for l in range(LANES):
                value = four(products, values + l * room + q)
                put_four(products, l * stride + p * room + q, times(w[first + l], value))
    return stride


@lane
def add_weighted(first, last, w, one, other, products, values, stride, sums, at, beside):
    """Add a register of lanes first .. last times the numbers of each lane, from `values` on, to `stride` sums from
    `at` on, and another register's to those from `beside` on.
    """
    k = 0
    while k + 3 * FOUR <= stride:  # six sums at once: each waits for its last addition
        a, b, c = four(sums, at + k), four(sums, at + k + FOUR), four(sums, at + k + 2 * FOUR)
        d, e, f = four(sums, beside + k), four(sums, beside + k + FOUR), four(sums, beside + k + 2 * FOUR)
        p = values + first * stride + k
        for l in range(first, last):
            u, v, x = w[one + l], w[other + l], four(products, p)
            y, z = four(products, p + FOUR), four(products, p + 2 * FOUR)
            a, b, c = multiply_add(u, x, a), multiply_add(u, y, b), multiply_add(u, z, c)
            d, e, f = multiply_add(v, x, d), multiply_add(v, y, e), multiply_add(v, z, f)
            p += stride
        put_four(sums, at + k, a)
        put_four(sums, at + k + FOUR, b)
        put_four(sums, at + k + 2 * FOUR, c)
        put_four(sums, beside + k, d)
        put_four(sums, beside + k + FOUR, e)
        put_four(sums, beside + k + 2 * FOUR, f)
        k += 3 * FOUR
    while k < stride:
        a, d, p = four(sums, at + k), four(sums, beside + k), values + first * stride + k
        for l in range(first, last):
            x = four(products, p)
            a, d = multiply_add(w[one + l], x, a), multiply_add(w[other + l], x, d)
            p += stride
        put_four(sums, at + k, a)
        put_four(sums, beside + k, d)
        k += FOUR


@summing
def lane_dot(first, last, w, a, b):
    """Sum over lanes of the product of two registers."""
    total = 0.0
    for l in range(first, last):
        total += w[a + l] * w[b + l]
    return total


@lane
def times_direction(first_width, second_width, same, w, direction):
    """COLUMN: K_ij times a direction in the second sight's state."""
    for a in range(first_width):
        for l in range(LANES):
            w[COLUMN + a * LANES + l] = 0.0
        for b in range(second_width):
            k = PAIR + (STATE_WIDTH * (b if same and b < a else a) + (a if same and b < a else b)) * LANES
            for l in range(LANES):
                w[COLUMN + a * LANES + l] += w[k + l] * w[direction + b * LANES + l]


@lane
def direction_times(first_width, second_width, w, direction):
    """COLUMN: a direction in the first sight's state times K_ij, i != j."""
    for b in range(second_width):
        for l in range(LANES):
            w[COLUMN + b * LANES + l] = 0.0
        for a in range(first_width):
            k = PAIR + (STATE_WIDTH * a + b) * LANES
            for l in range(LANES):
                w[COLUMN + b * LANES + l] += w[k + l] * w[direction + a * LANES + l]


@lane
def sum_pair(rows, i, j, first, last, w, products, stride, sums, at, spare):
    """Add K_ij of lanes first .. last, weighted with the products of basis values, to `sums` from `at` on."""
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    for a in range(components_i if stride > 0 else 0):
        b = a if i == j else 0
        while b < components_j:
            k, sink = PAIR + (STATE_WIDTH * a + b) * LANES, at + (a * components_j + b) * stride
            beside = sink + stride if b + 1 < components_j else spare
            add_weighted(first, last, w, k, k + LANES, products, 0, stride, sums, sink, beside)
            b += 2


@lane
def sum_singles(rows, i, j, first, last, w, s, t, sums, at):
    """The same for single columns: those of j with everything of i, then those of i with the terms of j."""
    width_i, width_j = rows.sight_width[i], rows.sight_width[j]
    terms_i, terms_j = rows.sight_terms[i], rows.sight_terms[j]
    singles_i, singles_j = s + BASIS + 2 * terms_i * LANES, t + BASIS + 2 * terms_j * LANES
    for f in range(rows.sight_shared[j]):
        times_direction(width_i, width_j, i == j, w, singles_j + f * WIDTH)
        for a in range(pose_components(width_i) if terms_i > 0 else 0):
            for p in range(terms_i):
                sums[at] += lane_dot(first, last, w, COLUMN + a * LANES, s + BASIS + p * LANES)
                at += 1
        for e in range(rows.sight_shared[i]):
            for a in range(width_i):
                sums[at] += lane_dot(first, last, w, COLUMN + a * LANES, singles_i + e * WIDTH + a * LANES)
            at += 1
    for e in range(rows.sight_shared[i] if i != j and terms_j > 0 else 0):
        direction_times(width_i, width_j, w, singles_i + e * WIDTH)
        for b in range(pose_components(width_j)):
            for q in range(terms_j):
                sums[at] += lane_dot(first, last, w, COLUMN + b * LANES, t + BASIS + q * LANES)
                at += 1


@lane
def sum_right(rows, groups, target, segments, count, i, begin, w, s, products, values, sums, at, gradient):
    """Add a sight's RIGHT to the gradient; uses the sums from `at` on."""
    components, width, room = sight_columns(rows, i)[0], rows.sight_width[i], fours(rows.sight_terms[i])
    for k in range(count):
        first, last, pattern = segments[k, BEGIN], segments[k, END], segments[k, PATTERN]
        entry = rows.sight_entry[rows.pattern_sight[pattern] + i - begin]
        member = groups.member_first[rows.pattern_group[pattern]]
        for a in range(0, components if room > 0 else 0, 3):  # three at a time: places, then rotations
            for c in range(0, 3, 2):
                register, sink = s + RIGHT + (a + c) * LANES, at + c * room
                add_weighted(
                    first, last, w, register, register + LANES, products, values, room, sums, sink, sink + room
                )
            for q in range(rows.sight_terms[i]):
                place = target.right[member + rows.entry_member[entry + q]] + rows.entry_inside[entry + q] + a
                for c in range(3):
                    gradient[place + c] += sums[at + c * room + q]
            for q in range(4 * room):
                sums[at + q] = 0.0
        for e in range(rows.sight_terms[i], rows.sight_terms[i] + rows.sight_shared[i]):
            place = target.right[member + rows.entry_member[entry + e]] + rows.entry_inside[entry + e]
            direction = s + BASIS + 2 * rows.sight_terms[i] * LANES + (e - rows.sight_terms[i]) * WIDTH
            for a in range(width):
                gradient[place] += lane_dot(first, last, w, s + RIGHT + a * LANES, direction + a * LANES)


@lane
def eliminate_tile(
    rows,
    groups,
    target,
    model,
    segments,
    count,
    w,
    depth,
    y,
    products,
    values,
    room,
    sums,
    aside,
    spare,
    blocks,
    gradient,
):
    """Add a tile's solved points to the blocks of pairs of variables, and to the gradient.

    A tile of one segment leaves its sums for the next tile of its pattern, or for `spread`; those of
    others begin `aside`, and `spare` is room for what nobody wants.
    """
    couple_all(rows, model, segments, w, depth, y)
    begin, end = sights_of(rows, segments)
    fixed, at = rows.pattern_fixed[segments[0, PATTERN]] > 0, 0
    for i in range(begin, end):
        lane_values(rows, i, w, TILE + (i - begin) * depth, products, values + (i - begin) * room)
    for i in range(begin, end):
        s = TILE + (i - begin) * depth
        if sight_columns(rows, i)[1] > 0:
            of_sight = values + (i - begin) * room
            sum_right(rows, groups, target, segments, count, i, begin, w, s, products, of_sight, sums, aside, gradient)
        for j in range(i, end):
            if not paired(rows, fixed, i, j):
                continue
            t = TILE + (j - begin) * depth
            widths, own = (rows.sight_width[i], rows.sight_width[j]), (i - begin) * COUPLED
            state_pair(row_count(rows.sight_kind[i]), *widths, i == j, w, s, y, own, (j - begin) * COUPLED)
            stride = lane_products(rows, i, w, s, products, values + (j - begin) * room, fours(rows.sight_terms[j]))
            for k in range(count):
                first, last, place = segments[k, BEGIN], segments[k, END], at if count == 1 else aside
                sum_pair(rows, i, j, first, last, w, products, stride, sums, place, spare)
                if rows.sight_shared[i] > 0 or rows.sight_shared[j] > 0:
                    sum_singles(rows, i, j, first, last, w, s, t, sums, place + term_sums(rows, i, j))
                if count > 1:
                    pattern = segments[k, PATTERN]
                    spread_pair(rows, groups, target, pattern, i - begin, j - begin, sums, place, blocks)
            at += pair_sums(rows, i, j)


def room_for_sums(rows: Rows) -> tuple[int, int, int, int]:
    """Numbers of all sums of any pattern, of those of any pair, of a tile's products of two sights' basis values, and
    of the values of one.
    """
    terms, columns = rows.sight_terms, np.where(rows.sight_width < 6, 3, 6)
    fourfold = FOUR * ((terms + FOUR - 1) // FOUR)
    widest = columns * fourfold + rows.sight_shared
    ends = np.concatenate([[0], np.cumsum(widest)])[rows.pattern_sight]
    pair = max(int(widest.max(initial=0)) ** 2, 4 * FOUR * int(fourfold.max(initial=0)))
    products = LANES * int((terms * fourfold).max(initial=0)), LANES * int(fourfold.max(initial=0))
    return int(np.diff(ends).max(initial=0)) ** 2, pair, *products
