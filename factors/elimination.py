"""Exact elimination of the points (Schur complement) and the sum of what is left over all of them.

With J the rows by the unknowns, B by the point and V = B'B = L L', a point leaves J'J - W V^-1 W' with W = J'B. A
sight feels the unknowns through its state (pose correction at its line): J = G' J_state with G its basis values and
directions. So the small matrices K_ij between states are formed per point, and only their sums over points, weighted
with products of basis values, reach the size of the unknowns: 36 x 9 products for two polynomials of degree two.
"""

import numpy as np

from mgsgraph.factors.lanes import (
    BASIS,
    BY_POINT,
    BY_STATE,
    CARRY,
    COUPLING,
    DELTA,
    GRADIENT,
    LANES,
    NORMAL,
    PAIR,
    PRODUCT,
    RESIDUAL,
    RIGHT,
    STATE,
    STATE_WIDTH,
    lane,
    summing,
)
from mgsgraph.factors.pose import pose_components
from mgsgraph.factors.rows import BEHIND, GOOD, WEAK, Rows
from mgsgraph.factors.tile import any_state, row_count, sights_of

ROW = STATE_WIDTH * LANES
"""From one row of BY_STATE, or one direction, to the next."""
SPARE = DELTA
"""Registers of the tile that are free once its rows are made: up to PAIR."""


@lane
def sight_columns(rows, i):
    """Columns of the unknowns that a sight feels: components per basis term, and their number altogether."""
    components = pose_components(rows.sight_width[i])
    return components, components * rows.sight_terms[i] + rows.sight_shared[i]


@lane
def carry_basis(rows, i, n, w, s):
    """Basis values at the line whose pose was used."""
    terms = rows.sight_terms[i]
    for t in range(terms):
        basis = s + BASIS + t * LANES
        for l in range(n):
            w[basis + l] += w[s + CARRY + l] * w[basis + terms * LANES + l]


@lane
def silence(count, n, w, s):
    """Take points that aren't solved out of the system."""
    for row in range(count):
        for a in range(STATE_WIDTH):
            for l in range(n):
                if w[STATE + l] != GOOD:
                    w[s + BY_STATE + row * ROW + a * LANES + l] = 0.0


@lane
def multiply_add(n, w, a, b, out, add):
    """Product of two registers, or add it."""
    if add:
        for l in range(n):
            w[out + l] += w[a + l] * w[b + l]
    else:
        for l in range(n):
            w[out + l] = w[a + l] * w[b + l]


@lane
def couple(count, width, n, w, s):
    """COUPLING Y = W L^-T and RIGHT J'r - Y L^-1 g of a sight, W = J_state' B."""
    for a in range(width):
        y, right, state = s + COUPLING + 3 * a * LANES, s + RIGHT + a * LANES, s + BY_STATE + a * LANES
        if count == 2:
            for l in range(n):
                f, g = w[state + l], w[state + ROW + l]
                w[y + l] = f * w[s + BY_POINT + l] + g * w[s + BY_POINT + 3 * LANES + l]
                w[y + LANES + l] = f * w[s + BY_POINT + LANES + l] + g * w[s + BY_POINT + 4 * LANES + l]
                w[y + 2 * LANES + l] = f * w[s + BY_POINT + 2 * LANES + l] + g * w[s + BY_POINT + 5 * LANES + l]
                w[right + l] = f * w[s + RESIDUAL + l] + g * w[s + RESIDUAL + LANES + l]
        else:
            for row in range(count):
                point = s + BY_POINT + 3 * row * LANES
                for c in range(3):
                    multiply_add(n, w, state + row * ROW, point + c * LANES, y + c * LANES, row > 0)
                multiply_add(n, w, state + row * ROW, s + RESIDUAL + row * LANES, right, row > 0)
        for l in range(n):
            y0 = w[y + l] * w[NORMAL + l]
            y1 = (w[y + LANES + l] - w[NORMAL + LANES + l] * y0) * w[NORMAL + 2 * LANES + l]
            y2 = w[y + 2 * LANES + l] - w[NORMAL + 3 * LANES + l] * y0 - w[NORMAL + 4 * LANES + l] * y1
            y2 *= w[NORMAL + 5 * LANES + l]
            w[y + l], w[y + LANES + l], w[y + 2 * LANES + l] = y0, y1, y2
            w[right + l] -= y0 * w[GRADIENT + l] + y1 * w[GRADIENT + LANES + l] + y2 * w[GRADIENT + 2 * LANES + l]


@lane
def couple_all(rows, pattern, n, w, base, depth):
    """COUPLING and RIGHT of all sights that feel an unknown."""
    begin, end = sights_of(rows, pattern)
    lost = any_state(n, w, WEAK) or any_state(n, w, BEHIND)
    if rows.pattern_fixed[pattern]:  # known points have nothing to eliminate: an endless L
        for r in range(9):
            for l in range(n):
                w[NORMAL + r * LANES + l] = 0.0
    for i in range(begin, end):
        s = base + (i - begin) * depth
        if sight_columns(rows, i)[1] > 0:
            if lost:
                silence(row_count(rows.sight_kind[i]), n, w, s)
            carry_basis(rows, i, n, w, s)
            couple(row_count(rows.sight_kind[i]), rows.sight_width[i], n, w, s)


@lane
def state_pair(count, first_width, second_width, same, n, w, s, t):
    """PAIR: K_ij = (J_i'J_i, if the same) - Y_i Y_j' between the states of two sights; a <= b alone, if the same."""
    for a in range(first_width):
        y = s + COUPLING + 3 * a * LANES
        for b in range(a if same else 0, second_width):
            z, k = t + COUPLING + 3 * b * LANES, PAIR + (STATE_WIDTH * a + b) * LANES
            for l in range(n):
                w[k + l] = -(
                    w[y + l] * w[z + l]
                    + w[y + LANES + l] * w[z + LANES + l]
                    + w[y + 2 * LANES + l] * w[z + 2 * LANES + l]
                )
            for row in range(count if same else 0):
                first, second = s + BY_STATE + row * ROW + a * LANES, s + BY_STATE + row * ROW + b * LANES
                for l in range(n):
                    w[k + l] += w[first + l] * w[second + l]


@summing
def dot(n, w, a, b):
    """Sum over lanes of the product of two registers."""
    total = 0.0
    for l in range(n):
        total += w[a + l] * w[b + l]
    return total


@summing
def dots(n, w, a, b):
    """The same with three registers in a row, read at once."""
    first, second, third = 0.0, 0.0, 0.0
    for l in range(n):
        value = w[a + l]
        first += value * w[b + l]
        second += value * w[b + LANES + l]
        third += value * w[b + 2 * LANES + l]
    return first, second, third


@lane
def products(first_terms, second_terms, same, n, w, s, t):
    """PRODUCT: products of two sights' basis values, p <= q alone if the same; their number."""
    count = 0
    for p in range(first_terms):
        for q in range(p if same else 0, second_terms):
            multiply_add(n, w, s + BASIS + p * LANES, t + BASIS + q * LANES, PRODUCT + count * LANES, False)
            count += 1
    return count


@lane
def sum_products(n, w, register, first, count, sums, at):
    """Add to `sums` from `at` the sums over lanes of a register times each of `count` registers from the `first`."""
    k = 0
    while k + 3 <= count:
        h0, h1, h2 = dots(n, w, register, first + k * LANES)
        sums[at + k] += h0
        sums[at + k + 1] += h1
        sums[at + k + 2] += h2
        k += 3
    while k < count:
        sums[at + k] += dot(n, w, register, first + k * LANES)
        k += 1


@lane
def sum_terms(rows, i, j, n, w, s, t, sums, at):
    """Add K_ij, weighted with the products of basis values, to `sums`: component by component, product by product."""
    count = products(rows.sight_terms[i], rows.sight_terms[j], i == j, n, w, s, t)
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    for a in range(components_i if count > 0 else 0):
        for b in range(a if i == j else 0, components_j):
            k = PAIR + (STATE_WIDTH * a + b) * LANES
            sum_products(n, w, k, PRODUCT, count, sums, at + (a * components_j + b) * count)


@lane
def times_direction(first_width, second_width, same, n, w, direction, out):
    """Registers `out`, ...: K_ij times a direction in the second sight's state."""
    for a in range(first_width):
        for l in range(n):
            w[out + a * LANES + l] = 0.0
        for b in range(second_width):
            low, high = (b, a) if same and b < a else (a, b)
            for l in range(n):
                w[out + a * LANES + l] += (
                    w[PAIR + (STATE_WIDTH * low + high) * LANES + l] * w[direction + b * LANES + l]
                )


@lane
def direction_times(first_width, second_width, n, w, direction, out):
    """Registers `out`, ...: a direction in the first sight's state times K_ij, i != j."""
    for b in range(second_width):
        for l in range(n):
            w[out + b * LANES + l] = 0.0
        for a in range(first_width):
            for l in range(n):
                w[out + b * LANES + l] += w[PAIR + (STATE_WIDTH * a + b) * LANES + l] * w[direction + a * LANES + l]


@lane
def term_sums(rows, i, j):
    """Room for the sums over products of basis values."""
    return sight_columns(rows, i)[0] * rows.sight_terms[i] * sight_columns(rows, j)[0] * rows.sight_terms[j]


@lane
def sum_shared(rows, i, j, n, w, s, t, sums, at):
    """The same for single columns, from `at`: those of j with everything of i, then those of i with the terms of j."""
    width_i, width_j = rows.sight_width[i], rows.sight_width[j]
    components_i, components_j = pose_components(width_i), pose_components(width_j)
    terms_i, terms_j = rows.sight_terms[i], rows.sight_terms[j]
    shared_i, shared_j = s + BASIS + 2 * terms_i * LANES, t + BASIS + 2 * terms_j * LANES
    for f in range(rows.sight_shared[j]):
        times_direction(width_i, width_j, i == j, n, w, shared_j + f * ROW, SPARE)
        for a in range(components_i if terms_i > 0 else 0):
            sum_products(n, w, SPARE + a * LANES, s + BASIS, terms_i, sums, at)
            at += terms_i
        for e in range(rows.sight_shared[i]):
            for a in range(width_i):
                sums[at] += dot(n, w, SPARE + a * LANES, shared_i + e * ROW + a * LANES)
            at += 1
    for e in range(rows.sight_shared[i] if i != j and terms_j > 0 else 0):
        direction_times(width_i, width_j, n, w, shared_i + e * ROW, SPARE)
        for b in range(components_j):
            sum_products(n, w, SPARE + b * LANES, t + BASIS, terms_j, sums, at)
            at += terms_j


@lane
def sum_right(rows, groups, target, group, i, n, w, s, gradient):
    """Add a sight's RIGHT to the gradient."""
    terms, entry, width = rows.sight_terms[i], rows.sight_entry[i], rows.sight_width[i]
    first = groups.member_first[group]
    for t in range(terms):
        place = target.right[first + rows.entry_member[entry + t]] + rows.entry_inside[entry + t]
        for a in range(pose_components(width)):
            gradient[place + a] += dot(n, w, s + RIGHT + a * LANES, s + BASIS + t * LANES)
    direction = s + BASIS + 2 * terms * LANES
    for e in range(entry + terms, entry + terms + rows.sight_shared[i]):
        place = target.right[first + rows.entry_member[e]] + rows.entry_inside[e]
        for a in range(width):
            gradient[place] += dot(n, w, s + RIGHT + a * LANES, direction + a * LANES)
        direction += ROW


@lane
def pair_sums(rows, i, j):
    """Room for all sums of a pair of sights."""
    return sight_columns(rows, i)[1] * sight_columns(rows, j)[1]


@lane
def paired(rows, pattern, i, j):
    """Whether two sights of a pattern meet in the normal matrix: both feel unknowns, and a free point joins them."""
    felt = sight_columns(rows, i)[1] > 0 and sight_columns(rows, j)[1] > 0
    return felt and (i == j or not rows.pattern_fixed[pattern])


@lane
def eliminate_tile(rows, groups, target, pattern, n, w, base, depth, sums, gradient):
    """Add n solved points to the sums over this pattern's pairs of sights, and to the gradient."""
    couple_all(rows, pattern, n, w, base, depth)
    begin, end = sights_of(rows, pattern)
    at = 0
    for i in range(begin, end):
        s = base + (i - begin) * depth
        if sight_columns(rows, i)[1] > 0:
            sum_right(rows, groups, target, rows.pattern_group[pattern], i, n, w, s, gradient)
        for j in range(i, end):
            if not paired(rows, pattern, i, j):
                continue
            t = base + (j - begin) * depth
            state_pair(row_count(rows.sight_kind[i]), rows.sight_width[i], rows.sight_width[j], i == j, n, w, s, t)
            sum_terms(rows, i, j, n, w, s, t, sums, at)
            if rows.sight_shared[i] > 0 or rows.sight_shared[j] > 0:
                sum_shared(rows, i, j, n, w, s, t, sums, at + term_sums(rows, i, j))
            at += pair_sums(rows, i, j)


@lane
def block_place(rows, groups, target, group, i, j):
    """Where the entries of two entries' variables meet (`Rows.entry_member`, ...): the first place, steps from row to
    row and from column to column, and whether it is one variable's block with itself, which holds both triangles.
    """
    first, second = rows.entry_member[i], rows.entry_member[j]
    begin = groups.member_first[group]
    size, low, high = groups.member_first[group + 1] - begin, min(first, second), max(first, second)
    start, width = target.pair[groups.pair_first[group] + low * size + high], groups.member_width[begin + high]
    down, across = (1, width) if first > second else (width, 1)
    return start + rows.entry_inside[i] * down + rows.entry_inside[j] * across, down, across, first == second


@lane
def spread_terms(rows, groups, target, group, i, j, sums, at, blocks):
    """Add a pair's sums over products of basis values to the blocks."""
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    entry_i, entry_j, terms = rows.sight_entry[i], rows.sight_entry[j], rows.sight_terms[j]
    count = terms * (terms + 1) // 2 if i == j else rows.sight_terms[i] * terms
    for p in range(rows.sight_terms[i]):
        for q in range(p if i == j else 0, terms):
            start, down, across, own = block_place(rows, groups, target, group, entry_i + p, entry_j + q)
            turned, _, _, _ = block_place(rows, groups, target, group, entry_j + q, entry_i + p)
            for a in range(components_i):
                for b in range(components_j):
                    low, high = (min(a, b), max(a, b)) if i == j else (a, b)  # K_ii is symmetric: one half is there
                    value = sums[at + (low * components_j + high) * count]
                    blocks[start + a * down + b * across] += value
                    if own and not (i == j and p == q):
                        blocks[turned + b * down + a * across] += value
            at += 1


@lane
def add_entry(rows, groups, target, group, i, a, j, value, blocks):
    """Add an entry (component a of entry i, single column j), and its mirror image, to the blocks."""
    start, down, across, own = block_place(rows, groups, target, group, i, j)
    blocks[start + a * down] += value
    if own and i != j:
        turned, down, across, _ = block_place(rows, groups, target, group, j, i)
        blocks[turned + a * across] += value


@lane
def spread_shared(rows, groups, target, group, i, j, sums, at, blocks):
    """The same for single columns, in the order of `sum_shared`."""
    terms_i, terms_j = rows.sight_terms[i], rows.sight_terms[j]
    entry_i, entry_j = rows.sight_entry[i], rows.sight_entry[j]
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    for f in range(rows.sight_shared[j]):
        own = entry_j + terms_j + f
        for a in range(components_i if terms_i > 0 else 0):
            for p in range(terms_i):
                add_entry(rows, groups, target, group, entry_i + p, a, own, sums[at], blocks)
                at += 1
        for e in range(rows.sight_shared[i]):
            if i != j or e <= f:
                add_entry(rows, groups, target, group, entry_i + terms_i + e, 0, own, sums[at], blocks)
            at += 1
    for e in range(rows.sight_shared[i] if i != j and terms_j > 0 else 0):
        for b in range(components_j):
            for q in range(terms_j):
                add_entry(rows, groups, target, group, entry_j + q, b, entry_i + terms_i + e, sums[at], blocks)
                at += 1


@lane
def spread(rows, groups, target, pattern, sums, blocks):
    """Add the sums over a pattern's points to the blocks of variable pairs, and clear them."""
    begin, end = sights_of(rows, pattern)
    group, at = rows.pattern_group[pattern], 0
    for i in range(begin, end):
        for j in range(i, end):
            if paired(rows, pattern, i, j):
                spread_terms(rows, groups, target, group, i, j, sums, at, blocks)
                spread_shared(rows, groups, target, group, i, j, sums, at + term_sums(rows, i, j), blocks)
                at += pair_sums(rows, i, j)
    sums[:at] = 0.0


def most_sums(rows: Rows) -> int:
    """Room for the sums of any pattern."""
    columns = np.where(rows.sight_width < 6, 3, 6) * rows.sight_terms + rows.sight_shared
    ends = np.concatenate([[0], np.cumsum(columns)])[rows.pattern_sight]
    return int(np.diff(ends).max(initial=0)) ** 2
