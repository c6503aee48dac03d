"""Points at one orientation: each is solved by Gauss-Newton to a fixed tolerance, then eliminated exactly (Schur
complement), and what is left is summed over all of them.

With J the rows by the unknowns, B by the point, B'B = L L' and P = B L^-T, a point leaves J' (1 - P P') J. An
observation feels the unknowns through its state (pose correction at its line): J = J_state G' with G its basis values
and directions. So the small matrices K_ij = J_i' (1 - P P')_ij J_j between states are formed per point, and only their
sums over points, weighted with products of basis values, reach the size of the unknowns: 36 x 9 products for two
polynomials of degree two.

For the sums the numbers of K_ij are laid side by side, lane by lane: no sum over lanes has to be ended, and a segment's
sums lie as their block does, so that one of five points costs per point hardly more than one of a thousand.
"""

import numpy as np

from mgsgraph.factors.algebra import dot
from mgsgraph.factors.loss import HUBER_WIDTH
from mgsgraph.kernel.lanes import (
    ACTIVE,
    B_L,
    BASIS,
    BETWEEN,
    BY_POINT,
    BY_STATE,
    COLUMN,
    COST,
    FACTOR,
    FORWARD,
    FOUR,
    GRADIENT,
    HALF,
    LANES,
    LINE_OFFSET,
    MIXED,
    MOST_SUMS,
    NORMAL,
    POINT,
    RESIDUAL,
    RESULT,
    RIGHT,
    ROW,
    STATUS,
    STEP_SQUARED,
    TILE,
    WIDTH,
    accumulate_nine,
    accumulate_one,
    accumulate_one_twice,
    accumulate_two,
    accumulate_two_twice,
    blocks_of,
    call,
    inlined,
    lane,
    pair_of,
    registers,
    summing,
    transpose_lanes,
    transposed_of,
)
from mgsgraph.kernel.measurements import all_rows, row_count, vector
from mgsgraph.kernel.rows import GOOD, HUBER, IMAGE, NO_LOSS, PREDICTED, SURFACE, TUKEY, WEAK, Model
from mgsgraph.kernel.tile import (
    BEGIN,
    END,
    PATTERN,
    add_entry,
    add_sums,
    all_good,
    block_index,
    load,
    observation_columns,
    observations_of,
    paired,
    pose_components,
)


@inlined
def move_basis(rows, i, w, s):
    """Basis values at the line whose pose was used."""
    terms = rows.observation_terms[i]
    for t in range(terms if rows.observation_kind[i] == IMAGE else 0):
        basis = s + BASIS + t * LANES
        for l in range(LANES):
            w[basis + l] += w[s + RESULT + LINE_OFFSET + l] * w[basis + terms * LANES + l]


@lane
def leave_out_unsolved(count, width, w, s):
    """Take points that aren't solved out of the system."""
    for row in range(count):
        for a in range(width):
            state = s + RESULT + BY_STATE + row * ROW + a * LANES
            for l in range(LANES):
                w[state + l] = w[state + l] if w[STATUS + l] == GOOD else 0.0


@lane
def couple(count, width, w, s):
    """P = B L^-T of an observation's rows, and RIGHT J'(r - P L^-1 g)."""
    for row in range(count):
        b, p, r = s + RESULT + BY_POINT + row * ROW, s + B_L + 3 * row * LANES, s + RESULT + RESIDUAL + row * ROW
        for l in range(LANES):
            p0 = w[b + l] * w[FACTOR + l]
            p1 = (w[b + LANES + l] - w[FACTOR + LANES + l] * p0) * w[FACTOR + 2 * LANES + l]
            p2 = w[b + 2 * LANES + l] - w[FACTOR + 3 * LANES + l] * p0 - w[FACTOR + 4 * LANES + l] * p1
            p2 *= w[FACTOR + 5 * LANES + l]
            w[p + l], w[p + LANES + l], w[p + 2 * LANES + l] = p0, p1, p2
            w[MIXED + l] = w[r + l] - dot((p0, p1, p2), vector(w, FORWARD, l))
        for a in range(width):
            state, right = s + RESULT + BY_STATE + row * ROW + a * LANES, s + RIGHT + a * LANES
            for l in range(LANES):
                value = w[state + l] * w[MIXED + l]
                w[right + l] = value if row == 0 else w[right + l] + value


@lane
def couple_all(rows, model, segments, w, depth):
    """P and RIGHT of all observations."""
    begin, end = observations_of(rows, segments)
    lost = not all_good(w)
    if rows.pattern_fixed[segments[0, PATTERN]]:  # known points have nothing to eliminate: an endless L
        for r in range(6 * LANES):
            w[FACTOR + r] = 0.0
        for r in range(3 * LANES):
            w[FORWARD + r] = 0.0
    for i in range(begin, end):
        s, count, width = TILE + (i - begin) * depth, row_count(rows.observation_kind[i]), rows.observation_width[i]
        if lost:
            leave_out_unsolved(count, width, w, s)
        if model.line == PREDICTED:
            move_basis(rows, i, w, s)
        couple(count, width, w, s)


@inlined
def mixed(w, j, l, m0, m1):
    """Three numbers of a row times m0, and of the next row times m1."""
    first, second = vector(w, j, l), vector(w, j + ROW, l)
    return m0 * first[0] + m1 * second[0], m0 * first[1] + m1 * second[1], m0 * first[2] + m1 * second[2]


@inlined
def put_products(w, f, l, pair, k, first, second):
    """Three numbers of a row of `pair`: one of each row of J_i times three of either row of M J_j."""
    u, v = w[f + l], w[f + ROW + l]
    pair[k + l] = u * first[0] + v * second[0]
    pair[k + LANES + l] = u * first[1] + v * second[1]
    pair[k + 2 * LANES + l] = u * first[2] + v * second[2]


@lane
def pose_pair(own, w, s, t, pair):
    """J_i' M J_j between the poses of two rays, M = 1 - P_i P_j' of a ray with itself (`own` 1.0), else -P_i P_j'.

    Twelve numbers are kept in a processor's sixteen registers.
    """
    f, g = s + RESULT + BY_STATE, t + RESULT + BY_STATE
    for l in range(LANES):
        p0, p1 = vector(w, s + B_L, l), vector(w, s + B_L + 3 * LANES, l)
        q0, q1 = vector(w, t + B_L, l), vector(w, t + B_L + 3 * LANES, l)
        m00, m01, m10, m11 = own - dot(p0, q0), -dot(p0, q1), -dot(p1, q0), own - dot(p1, q1)
        first, second = mixed(w, g, l, m00, m01), mixed(w, g, l, m10, m11)
        third, fourth = mixed(w, g + 3 * LANES, l, m00, m01), mixed(w, g + 3 * LANES, l, m10, m11)
        for a in range(6):
            put_products(w, f + a * LANES, l, pair, a * WIDTH, first, second)
            put_products(w, f + a * LANES, l, pair, a * WIDTH + 3 * LANES, third, fourth)


@lane
def state_pair(count_i, count_j, width_i, width_j, own, w, s, t, pair):
    """K_ij = J_i' M J_j between two observations' states, M = 1 - P_i P_j' of one with itself (`own` 1.0), else
    -P_i P_j'.
    """
    if count_i == 2 and count_j == 2 and width_i == 6 and width_j == 6:
        pose_pair(own, w, s, t, pair)
        return
    f, g = s + RESULT + BY_STATE, t + RESULT + BY_STATE
    for row in range(count_i):
        for r in range(width_j * LANES):
            w[MIXED + r] = 0.0
        for column in range(count_j):
            p, q, unit = s + B_L + 3 * row * LANES, t + B_L + 3 * column * LANES, own if row == column else 0.0
            for l in range(LANES):
                w[BETWEEN + l] = unit - dot(vector(w, p, l), vector(w, q, l))
            for b in range(width_j):
                for l in range(LANES):
                    w[MIXED + b * LANES + l] += w[BETWEEN + l] * w[g + column * ROW + b * LANES + l]
        for a in range(width_i):
            for b in range(width_j):
                k = a * WIDTH + b * LANES
                for l in range(LANES):
                    value = w[f + row * ROW + a * LANES + l] * w[MIXED + b * LANES + l]
                    pair[k + l] = value if row == 0 else pair[k + l] + value


@lane
def weighted_sums(first, last, weights, weight, in_pairs, transposed, stride, sums, to):
    """Sums from `to` on, over lanes first .. last, of a register times the `stride` numbers of each lane; if
    `in_pairs`, with the next register from MOST_SUMS beyond.
    """
    if stride == MOST_SUMS:
        for k in range(2 if in_pairs else 1):
            accumulate_nine(weights, weight + k * LANES, first, last, transposed, 0, stride, sums, to + k * MOST_SUMS)
        return
    k = 0
    while k + 2 * FOUR <= stride:
        if in_pairs:
            accumulate_two_twice(weights, weight, first, last, transposed, k, stride, sums, to + k)
        else:
            accumulate_two(weights, weight, first, last, transposed, k, stride, sums, to + k)
        k += 2 * FOUR
    if k < stride:
        if in_pairs:
            accumulate_one_twice(weights, weight, first, last, transposed, k, stride, sums, to + k)
        else:
            accumulate_one(weights, weight, first, last, transposed, k, stride, sums, to + k)


@summing
def lane_dot(first, last, w, a, b):
    """Sum over lanes of the product of two registers."""
    total = 0.0
    for l in range(first, last):
        total += w[a + l] * w[b + l]
    return total


@lane
def times_direction(first_width, second_width, w, direction, pair):
    """COLUMN: K_ij times a direction in the second observation's state."""
    for a in range(first_width):
        for l in range(LANES):
            w[COLUMN + a * LANES + l] = 0.0
        for b in range(second_width):
            for l in range(LANES):
                w[COLUMN + a * LANES + l] += pair[a * WIDTH + b * LANES + l] * w[direction + b * LANES + l]


@lane
def direction_times(first_width, second_width, w, direction, pair):
    """COLUMN: a direction in the first observation's state times K_ij, i != j."""
    for b in range(second_width):
        for l in range(LANES):
            w[COLUMN + b * LANES + l] = 0.0
        for a in range(first_width):
            for l in range(LANES):
                w[COLUMN + b * LANES + l] += pair[a * WIDTH + b * LANES + l] * w[direction + a * LANES + l]


@inlined
def sum_terms(rows, groups, target, segments, count, i, j, begin, w, s, t, pair, buffers, blocks):
    """Add K_ij, weighted with products of basis values, to the blocks of the variables of each pair of terms."""
    transposed, weights, sums = buffers
    terms_i, terms_j, same = rows.observation_terms[i], rows.observation_terms[j], i == j
    components_i, components_j = observation_columns(rows, i)[0], observation_columns(rows, j)[0]
    symmetric = same and components_i == 6
    columns, pairs = HALF if symmetric else components_j, 0
    stride = transpose_lanes(components_i * columns, columns, WIDTH, 0, pair, transposed, symmetric)
    for p in range(terms_i):
        for q in range(p if same else 0, terms_j):
            for l in range(LANES):
                weights[pairs * LANES + l] = w[s + BASIS + p * LANES + l] * w[t + BASIS + q * LANES + l]
            pairs += 1
    for k in range(count):
        for n in range(0, pairs, 2):
            first, last, in_pairs = segments[k, BEGIN], segments[k, END], n + 1 < pairs
            weighted_sums(first, last, weights, n * LANES, in_pairs, transposed, stride, sums, n * MOST_SUMS)
        (group, first), at = segment_observations(rows, segments, k, begin), 0
        for p in range(terms_i):
            for q in range(p if same else 0, terms_j):
                entry_i, entry_j = rows.observation_entry[first + i] + p, rows.observation_entry[first + j] + q
                start, down, across, one_variable = block_index(rows, groups, target, group, entry_i, entry_j)
                add_sums(blocks, start, down, across, sums, at, components_i, columns, symmetric)
                if one_variable and entry_i != entry_j:  # a variable's block with itself holds both triangles
                    start, down, across, _ = block_index(rows, groups, target, group, entry_j, entry_i)
                    down, across = (down, across) if same else (across, down)
                    add_sums(blocks, start, down, across, sums, at, components_i, columns, symmetric)
                at += MOST_SUMS


@inlined
def segment_observations(rows, segments, k, begin):
    """Group of a segment, and what brings an observation of the tile's first pattern to that of the segment's."""
    pattern = segments[k, PATTERN]
    return rows.pattern_group[pattern], rows.pattern_observation[pattern] - begin


@inlined
def add_dots(rows, groups, target, segments, count, i, e, a, j, f, begin, w, begin_i, begin_j, components, blocks):
    """Add, to the block of column a of entry e of observation i and entry f (a single column) of observation j, the
    product of `components` registers each, from `begin_i` and `begin_j` on, summed over them and over lanes.
    """
    for k in range(count):
        group, first = segment_observations(rows, segments, k, begin)
        value = 0.0
        for c in range(components):
            value += lane_dot(segments[k, BEGIN], segments[k, END], w, begin_i + c * LANES, begin_j + c * LANES)
        entry_i, entry_j = rows.observation_entry[first + i] + e, rows.observation_entry[first + j] + f
        add_entry(rows, groups, target, group, entry_i, a, entry_j, value, blocks)


@inlined
def sum_singles(rows, groups, target, scratch, count, i, j, begin, blocks):
    """Add K_ij of single columns to the blocks: of those of j with all of i, then of those of i with the terms of j."""
    w, pair, segments = registers(scratch.work), pair_of(scratch.pair), scratch.segments
    s, t = TILE + (i - begin) * scratch.depth, TILE + (j - begin) * scratch.depth
    width_i, width_j = rows.observation_width[i], rows.observation_width[j]
    terms_i, terms_j = rows.observation_terms[i], rows.observation_terms[j]
    singles_i, singles_j = s + BASIS + 2 * terms_i * LANES, t + BASIS + 2 * terms_j * LANES
    tile = rows, groups, target, segments, count
    for f in range(rows.observation_shared[j]):
        times_direction(width_i, width_j, w, singles_j + f * WIDTH, pair)
        for a in range(pose_components(width_i) if terms_i > 0 else 0):
            for p in range(terms_i):
                register, value = COLUMN + a * LANES, s + BASIS + p * LANES
                add_dots(*tile, i, p, a, j, terms_j + f, begin, w, register, value, 1, blocks)
        for e in range(rows.observation_shared[i] if i != j else f + 1):
            direction = singles_i + e * WIDTH
            add_dots(*tile, i, terms_i + e, 0, j, terms_j + f, begin, w, COLUMN, direction, width_i, blocks)
    for e in range(rows.observation_shared[i] if i != j and terms_j > 0 else 0):
        direction_times(width_i, width_j, w, singles_i + e * WIDTH, pair)
        for b in range(pose_components(width_j)):
            for q in range(terms_j):
                register, value = COLUMN + b * LANES, t + BASIS + q * LANES
                add_dots(*tile, j, q, b, i, terms_i + e, begin, w, register, value, 1, blocks)


@inlined
def sum_right(rows, groups, target, segments, count, i, begin, w, s, buffers, gradient):
    """Add an observation's RIGHT to the gradient."""
    transposed, _, sums = buffers
    components, width, terms = observation_columns(rows, i)[0], rows.observation_width[i], rows.observation_terms[i]
    stride = transpose_lanes(components, components, 0, s + RIGHT, w, transposed, False)
    for k in range(count):
        first, last, pattern = segments[k, BEGIN], segments[k, END], segments[k, PATTERN]
        entry = rows.observation_entry[rows.pattern_observation[pattern] + i - begin]
        member = groups.member_first[rows.pattern_group[pattern]]
        for p in range(0, terms, 2):
            weighted_sums(first, last, w, s + BASIS + p * LANES, p + 1 < terms, transposed, stride, sums, 0)
            for r in range(min(2, terms - p)):
                term = entry + p + r
                register = target.right[member + rows.entry_member[term]] + rows.entry_inside[term]
                for a in range(components):
                    gradient[register + a] += sums[r * MOST_SUMS + a]
        for e in range(terms, terms + rows.observation_shared[i]):
            register = target.right[member + rows.entry_member[entry + e]] + rows.entry_inside[entry + e]
            direction = s + BASIS + 2 * terms * LANES + (e - terms) * WIDTH
            for a in range(width):
                gradient[register] += lane_dot(first, last, w, s + RIGHT + a * LANES, direction + a * LANES)


@inlined
def eliminate_tile(rows, groups, target, model, scratch, count, with_matrix, singles, to_blocks, gradient):
    """Add a tile's solved points to the gradient and, if `with_matrix`, to the blocks of pairs of variables; `singles`
    is where `sum_singles` lies.
    """
    w, depth, segments = registers(scratch.work), scratch.depth, scratch.segments
    buffers = transposed_of(scratch.transposed), transposed_of(scratch.weights), transposed_of(scratch.sums)
    pair, blocks = pair_of(scratch.pair), blocks_of(to_blocks)
    couple_all(rows, model, segments, w, depth)
    begin, end = observations_of(rows, segments)
    fixed, tile = rows.pattern_fixed[segments[0, PATTERN]] > 0, (rows, groups, target, segments, count)
    for i in range(begin, end):
        s = TILE + (i - begin) * depth
        if observation_columns(rows, i)[1] > 0:
            sum_right(*tile, i, begin, w, s, buffers, gradient)
        for j in range(i, end if with_matrix else i):
            if not paired(rows, fixed, i, j):
                continue
            t, own = TILE + (j - begin) * depth, 1.0 if i == j else 0.0
            counts = row_count(rows.observation_kind[i]), row_count(rows.observation_kind[j])
            state_pair(*counts, rows.observation_width[i], rows.observation_width[j], own, w, s, t, pair)
            if rows.observation_terms[i] * rows.observation_terms[j] > 0:
                sum_terms(*tile, i, j, begin, w, s, t, pair, buffers, blocks)
            if rows.observation_shared[i] + rows.observation_shared[j] > 0:
                call(singles, (rows, groups, target, i, j, begin, count, scratch, to_blocks))


INNER_STEPS = 250
"""Quadratic rows need one to three; far from its optimum a Cauchy or Tukey loss converges slowly."""
BEGINNING = 30
"""Steps at most with plain squares, and with Huber's loss, before the loss that is asked for."""
PLAIN_TOLERANCE = 1e-2
"""Sigmas: after a shorter step the next would be some 1e-6 long (rows are linear to 1e-4 over a sigma), and what it
would gain is known from the linear model to 1e-12: no second look is needed."""
ROUGH_TOLERANCE = 0.5
"""Sigmas, where the orientation is far from its optimum: what a point gains is known to some 1e-5 then."""
SLOW_TOLERANCE = 1e-7
"""Sigmas, where a robust loss or the curvature of a terrain model makes the convergence linear."""
SINGULAR = 1e-13
"""Pivot relative to its diagonal below which a point counts as not determined."""


@lane
def factorise(w):
    """FACTOR L of NORMAL = L L', FORWARD L^-1 g, STEP_SQUARED its squared length; STATUS WEAK where a pivot is lost.

    Weak points and those that don't take part get an endless L: they neither move nor couple.
    """
    for l in range(LANES):
        v00, v10, v11 = w[NORMAL + l], w[NORMAL + LANES + l], w[NORMAL + 2 * LANES + l]
        v20, v21, v22 = w[NORMAL + 3 * LANES + l], w[NORMAL + 4 * LANES + l], w[NORMAL + 5 * LANES + l]
        d0 = v00
        i00 = 1.0 / np.sqrt(d0)
        l10, l20 = v10 * i00, v20 * i00
        d1 = v11 - l10 * l10
        i11 = 1.0 / np.sqrt(d1)
        l21 = (v21 - l20 * l10) * i11
        d2 = v22 - l20 * l20 - l21 * l21
        i22 = 1.0 / np.sqrt(d2)
        strong = (d0 > 0.0) & (d1 > SINGULAR * v11) & (d2 > SINGULAR * v22)
        weak = (not strong) & (w[ACTIVE + l] > 0.0) & (w[STATUS + l] == GOOD)
        w[STATUS + l] = WEAK if weak else w[STATUS + l]
        i00, i11, i22 = (i00 if strong else 0.0), (i11 if strong else 0.0), (i22 if strong else 0.0)
        l10, l20, l21 = (l10 if strong else 0.0), (l20 if strong else 0.0), (l21 if strong else 0.0)
        y0 = w[GRADIENT + l] * i00
        y1 = (w[GRADIENT + LANES + l] - l10 * y0) * i11
        y2 = (w[GRADIENT + 2 * LANES + l] - l20 * y0 - l21 * y1) * i22
        w[FACTOR + l], w[FACTOR + LANES + l], w[FACTOR + 2 * LANES + l] = i00, l10, i11
        w[FACTOR + 3 * LANES + l], w[FACTOR + 4 * LANES + l], w[FACTOR + 5 * LANES + l] = l20, l21, i22
        w[FORWARD + l], w[FORWARD + LANES + l], w[FORWARD + 2 * LANES + l] = y0, y1, y2
        w[STEP_SQUARED + l] = y0 * y0 + y1 * y1 + y2 * y2


@lane
def step_points(w):
    """Move the points by -L^-T L^-1 g, and take what that gains, by the linear model, off the cost."""
    for l in range(LANES):
        x2 = w[FORWARD + 2 * LANES + l] * w[FACTOR + 5 * LANES + l]
        x1 = (w[FORWARD + LANES + l] - w[FACTOR + 4 * LANES + l] * x2) * w[FACTOR + 2 * LANES + l]
        x0 = (w[FORWARD + l] - w[FACTOR + LANES + l] * x1 - w[FACTOR + 3 * LANES + l] * x2) * w[FACTOR + l]
        w[POINT + l] -= x0
        w[POINT + LANES + l] -= x1
        w[POINT + 2 * LANES + l] -= x2
        w[COST + l] -= 0.5 * w[STEP_SQUARED + l]


@summing
def largest_step(w):
    """Largest squared step of the lanes that take part."""
    value = 0.0
    for l in range(LANES):
        value = max(value, w[STEP_SQUARED + l] * w[ACTIVE + l])
    return value


@inlined
def solve_tile(rows, model, segments, count, x, points, move, everything, tolerance, w, depth, store_rows, loops):
    """Coordinates of a tile's points of least cost with the orientation held: POINT, COST and STATUS, and rows
    there if `store_rows`.

    Begins at `points` (n, 3), ends where a step is shorter than `tolerance` (sigmas); rows, FACTOR and FORWARD are of
    the place before it. Unless `move`, the points stay where they are, and take part all if `everything`. With a robust
    loss the way is begun anew, at `rows.start` and with plain squares, for where such a loss is flat it leads nowhere;
    so earlier calls don't count. Tukey's loss follows Huber's, which has one minimum: plain squares alone would put a
    point between a blunder and its good rays, where Tukey's is flat.
    """
    fixed = rows.pattern_fixed[segments[0, PATTERN]] > 0
    robust = model.loss != NO_LOSS
    load(rows, model, segments, count, w, depth, rows.start if move and (robust or fixed) else points)
    for k in range(count if everything else 0):
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[ACTIVE + l] = 1.0
    plainly = move and robust and not fixed
    convexly, convex = plainly and model.loss == TUKEY, Model(model.line, model.angles, HUBER, HUBER_WIDTH)
    slow, steps = robust or on_terrain(rows, segments), 0
    for _ in range(2 * INNER_STEPS):
        now = convex if convexly else model
        all_rows(rows, now, robust and not plainly, segments, count, x, w, depth, store_rows, loops)
        if fixed:
            break
        factorise(w)
        if not move:
            break
        step_points(w)
        last, steps = not (plainly or convexly), steps + 1
        shortest = SLOW_TOLERANCE if slow and last else tolerance
        if largest_step(w) < shortest * shortest or (steps == BEGINNING and not last):
            if last:
                break
            plainly, convexly, steps = False, plainly and convexly, 0
    if move and not fixed:
        take_back(tolerance, w)


@inlined
def on_terrain(rows, segments):
    """Whether a tile's points have heights above the terrain model."""
    begin, end = observations_of(rows, segments)
    present = False
    for i in range(begin, end):
        present = present or rows.observation_kind[i] == SURFACE
    return present


@lane
def take_back(tolerance, w):
    """Where the steps ran out before they were short, the linear model's promise of the last one doesn't count."""
    for l in range(LANES):
        w[COST + l] += 0.5 * w[STEP_SQUARED + l] if w[STEP_SQUARED + l] > tolerance * tolerance else 0.0
