"""A tile: up to 64 points of one shape, of one piece or of several, their constants loaded into lanes.

Points have the same *shape* when their observations are of the same kinds, in the same order, with as many terms and
single columns; which unknowns these are may differ from *segment* to segment of a tile, the lanes of one piece.
"""

import numpy as np

from mgsgraph.factors.collinearity import peer_pixels
from mgsgraph.kernel.lanes import (
    ACTIVE,
    ANGULAR_RATE,
    BASIS,
    COST,
    DELTA,
    DETECTOR,
    DISTANCE,
    FOCAL,
    FRONT,
    HALF,
    LANES,
    LINE_OFFSET,
    NOMINAL,
    POINT,
    POSITION,
    RATE,
    REFERENCE_OFFSET,
    RESIDUAL,
    RESULT,
    ROOT,
    ROW,
    ROWS,
    SCALE,
    SLOPE,
    STATE_WIDTH,
    STATUS,
    TILE,
    VELOCITY,
    WEIGHT,
    WIDTH,
    four,
    inlined,
    lane,
    multiply_add,
    put_four,
    registers,
)
from mgsgraph.kernel.rows import (
    BEHIND,
    CAMERA,
    GOOD,
    GROUND,
    IMAGE,
    OPK_PEER,
    OUT,
    PREDICTED,
    RANGE,
    STEREO,
    SURFACE,
    Rows,
)

PIECE_OF, FIRST, BEGIN, END, PATTERN = 0, 1, 2, 3, 4
"""Columns of the table of segments: piece, first point counted in it, lanes from BEGIN up to END, pattern."""


def workspace(rows: Rows) -> tuple[int, int]:
    """Numbers that a tile of these rows needs, and numbers per observation."""
    most = int(np.diff(rows.pattern_observation).max(initial=1))
    constants = 2 * rows.observation_terms + STATE_WIDTH * rows.observation_shared
    depth = BASIS + int(constants.max(initial=0)) * LANES
    return TILE + most * depth, depth


@inlined
def fill(rows, piece, first, last_piece, segments):
    """Segments of the next tile, from a point of a piece on; their number, and piece and point at which it ends."""
    shape, count, n = rows.pattern_shape[rows.piece[piece, 0]], 0, 0
    while piece < last_piece and n < LANES and rows.pattern_shape[rows.piece[piece, 0]] == shape:
        taken = min(LANES - n, rows.piece[piece, 2] - first)
        segments[count, PIECE_OF], segments[count, FIRST] = piece, first
        segments[count, BEGIN], segments[count, END] = n, n + taken
        segments[count, PATTERN] = rows.piece[piece, 0]
        count, n, first = count + 1, n + taken, first + taken
        if first == rows.piece[piece, 2]:
            piece, first = piece + 1, 0
    return count, piece, first


@inlined
def observations_of(rows, segments):
    """First observation of the tile's first pattern, which stands for its shape, and the one after its last."""
    pattern = segments[0, PATTERN]
    return rows.pattern_observation[pattern], rows.pattern_observation[pattern + 1]


@inlined
def point_of(rows, segments, k):
    """Point of the lane before a segment's first, were they counted on: point + l is that of lane l."""
    return rows.piece[segments[k, PIECE_OF], 1] + segments[k, FIRST] - segments[k, BEGIN]


@inlined
def observation_index(rows, segments, k, observation):
    """Index among all observations of one counted within its point: index + l is that of lane l."""
    piece = segments[k, PIECE_OF]
    return rows.piece[piece, 4] + observation * rows.piece[piece, 2] + segments[k, FIRST] - segments[k, BEGIN]


@inlined
def load(rows, model, segments, count, w, depth, points):
    """Load a tile: which points take part, their coordinates, and their observations' constants; spare lanes idle."""
    for l in range(LANES):
        w[ACTIVE + l] = 0.0
    for k in range(count):
        point = point_of(rows, segments, k)
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[ACTIVE + l] = 0.0 if rows.kind[point + l] == OUT else 1.0
            w[STATUS + l] = GOOD
            for j in range(3):
                w[POINT + j * LANES + l] = points[point + l, j]
    begin, end = observations_of(rows, segments)
    at = 0
    for i in range(begin, end):
        at = load_observation(rows, model, segments, count, begin, i, at, w, TILE + (i - begin) * depth)


@inlined
def copied(rows, segments, count, at, w, register, components):
    """Copy components `at` .. of all points' constants to consecutive registers; which component comes next."""
    data = registers(rows.data)
    for k in range(count):
        piece, begin, end = segments[k, PIECE_OF], segments[k, BEGIN], segments[k, END]
        stride = rows.piece[piece, 2]
        source = rows.piece[piece, 3] + segments[k, FIRST] - begin + at * stride
        for c in range(components):
            for l in range(begin, end):
                w[register + c * LANES + l] = data[source + c * stride + l]
    return at + components


@inlined
def powers(rows, segments, count, observation, terms, w, basis, rates):
    """Values 1, u, u^2, .. of a polynomial and, if `rates`, theirs per line, of the line u in the second register."""
    for t in range(2, terms):
        for l in range(LANES):
            w[basis + t * LANES + l] = w[basis + (t - 1) * LANES + l] * w[basis + LANES + l]
    for l in range(LANES):
        w[basis + l] = 1.0
    for k in range(count if rates else 0):
        rate = rows.observation_rate[rows.pattern_observation[segments[k, PATTERN]] + observation]
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[basis + terms * LANES + l] = 0.0
        for t in range(1, terms):
            for l in range(segments[k, BEGIN], segments[k, END]):
                w[basis + (terms + t) * LANES + l] = t * rate * w[basis + (t - 1) * LANES + l]


@inlined
def slopes(rows, segments, count, i, begin, at, w, s):
    """Slopes of the detector line: the observation's, or each ray's own; which component comes next."""
    if np.isnan(rows.observation_slope[i, 0]):
        return copied(rows, segments, count, at, w, s + SLOPE, 2)
    for k in range(count):
        slope = rows.observation_slope[rows.pattern_observation[segments[k, PATTERN]] + i - begin]
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[s + SLOPE + l], w[s + SLOPE + LANES + l] = slope[0], slope[1]
    return at


@lane
def peer_scales(w, s):
    """SCALE from SLOPE."""
    for l in range(LANES):
        lines, samples = peer_pixels((w[s + SLOPE + l], w[s + SLOPE + LANES + l]))
        w[s + SCALE + l], w[s + SCALE + LANES + l] = lines
        w[s + SCALE + 2 * LANES + l], w[s + SCALE + 3 * LANES + l] = samples


@inlined
def load_observation(rows, model, segments, count, begin, i, at, w, s):
    """Constants of observation i in the order of `Rows.data`: those of its kind, then basis values, then directions."""
    kind, rates = rows.observation_kind[i], False
    if kind != SURFACE:
        at = copied(rows, segments, count, at, w, s + POSITION, 3)
    if kind == IMAGE:
        at = copied(rows, segments, count, at, w, s + NOMINAL, 4 if model.angles == CAMERA else 3)
        at = copied(rows, segments, count, at, w, s + DETECTOR, 2)
        rates = model.line == PREDICTED
        if rates:
            at = copied(rows, segments, count, at, w, s + VELOCITY, 3)
            at = copied(rows, segments, count, at, w, s + ANGULAR_RATE, 3)
            at = copied(rows, segments, count, at, w, s + REFERENCE_OFFSET, 1)
        if rates or model.angles == OPK_PEER:
            at = slopes(rows, segments, count, i, begin, at, w, s)
        if not rates and model.angles == OPK_PEER:
            peer_scales(w, s)
        elif not rates:
            at = copied(rows, segments, count, at, w, s + SCALE, 4)
    elif kind == GROUND:
        at = copied(rows, segments, count, at, w, s + ROOT, 6)
    elif kind == RANGE or kind == STEREO:
        at = copied(rows, segments, count, at, w, s + ROOT, 3)
        at = copied(rows, segments, count, at, w, s + DISTANCE, 1)
    terms = rows.observation_terms[i]
    if rows.observation_rate[i] != 0.0 and terms > 0:
        at = copied(rows, segments, count, at, w, s + BASIS + LANES, 1)
        powers(rows, segments, count, i - begin, terms, w, s + BASIS, rates)
    else:
        at = copied(rows, segments, count, at, w, s + BASIS, 2 * terms if rates else terms)
    for e in range(rows.observation_shared[i]):
        at = copied(rows, segments, count, at, w, s + BASIS + 2 * terms * LANES + e * WIDTH, rows.observation_width[i])
    weight = registers(rows.weight)
    for l in range(LANES):
        w[s + WEIGHT + l] = 0.0
    for k in range(count):
        index = observation_index(rows, segments, k, i - begin)
        focal = rows.observation_focal[rows.pattern_observation[segments[k, PATTERN]] + i - begin]
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[s + FOCAL + l] = focal
            w[s + WEIGHT + l] = weight[index + l]
            w[s + WEIGHT + LANES + l] = weight[rows.weight.shape[1] + index + l]
    return at


@lane
def copy_block(w, source, sink, size):
    """Copy `size` registers from register `source` on to those from `sink` on."""
    for r in range(size):
        w[sink + r] = w[source + r]


@inlined
def pose_components(width):
    """Components of a state that a basis term moves: position and rotation, or the position alone; never the
    interior orientation or range bias, which are single columns.
    """
    return 6 if width >= 6 else 3


@inlined
def correct(rows, segments, count, i, x, w, s, rates):
    """DELTA and, if `rates`, RATE: what the unknowns x do to observation i, LINE_OFFSET lines from its reference."""
    for r in range(max(rows.observation_width[i], 4) * LANES):
        w[DELTA + r] = 0.0
    for r in range(6 * LANES if rates else 0):
        w[RATE + r] = 0.0
    terms, width, begin = rows.observation_terms[i], rows.observation_width[i], observations_of(rows, segments)[0]
    components = pose_components(width)
    for k in range(count):
        first, last = segments[k, BEGIN], segments[k, END]
        entry = rows.observation_entry[rows.pattern_observation[segments[k, PATTERN]] + i - begin]
        for t in range(terms):
            value, rate = s + BASIS + t * LANES, s + BASIS + (terms + t) * LANES
            column = rows.entry_column[entry + t]
            for a in range(components):
                c = x[column + a]
                if rates:
                    for l in range(first, last):
                        w[DELTA + a * LANES + l] += (w[value + l] + w[ROWS + LINE_OFFSET + l] * w[rate + l]) * c
                        w[RATE + a * LANES + l] += w[rate + l] * c
                else:
                    for l in range(first, last):
                        w[DELTA + a * LANES + l] += w[value + l] * c
        for e in range(rows.observation_shared[i]):
            c = x[rows.entry_column[entry + terms + e]]
            for a in range(width):
                direction = s + BASIS + 2 * terms * LANES + e * WIDTH + a * LANES
                for l in range(first, last):
                    w[DELTA + a * LANES + l] += w[direction + l] * c


@lane
def all_good(w):
    """Whether every lane that takes part is GOOD."""
    lost = 0.0
    for l in range(LANES):
        lost = max(lost, w[ACTIVE + l] * abs(w[STATUS + l] - GOOD))
    return lost == 0.0


@inlined
def store_points(rows, segments, count, w, points, states, costs):
    """Places (n, 3) and states (n,) of a tile; its costs are added to those of its pieces, infinite where a point is
    behind a camera.
    """
    for k in range(count):
        point, cost = point_of(rows, segments, k), 0.0
        for l in range(segments[k, BEGIN], segments[k, END]):
            for j in range(3):
                points[point + l, j] = w[POINT + j * LANES + l]
            states[point + l] = w[STATUS + l]
            cost += np.inf if w[STATUS + l] == BEHIND else w[COST + l]
        costs[segments[k, PIECE_OF]] += cost


@lane
def store_residuals(rows, segments, count, w, depth, values):
    """Residuals (t, 2) of a tile's observations, measured minus predicted: of an image ray in pixels, of a range in m,
    of a surface row its height in m; NaN for a ray whose point is behind the camera.
    """
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        s, kind = TILE + (i - begin) * depth, rows.observation_kind[i]
        for k in range(count):
            at = observation_index(rows, segments, k, i - begin)
            for row in range(2 if kind == IMAGE else 0 if kind == GROUND else 1):
                for l in range(segments[k, BEGIN], segments[k, END]):
                    value = w[s + RESULT + RESIDUAL + row * ROW + l] / rows.weight[row, at + l]
                    if kind == IMAGE and w[s + RESULT + FRONT + l] == 0.0:
                        value = np.nan
                    values[at + l, row] = value


# ---- where sums over points go: the blocks of pairs of variables


@inlined
def observation_columns(rows, i):
    """Columns of the unknowns that an observation depends on: components per basis term, and their total number."""
    components = pose_components(rows.observation_width[i])
    return components, components * rows.observation_terms[i] + rows.observation_shared[i]


@inlined
def paired(rows, fixed, i, j):
    """Whether two observations meet in the normal matrix: both depend on unknowns, and a free point joins them."""
    linked = observation_columns(rows, i)[1] > 0 and observation_columns(rows, j)[1] > 0
    return linked and (i == j or not fixed)


@inlined
def block_index(rows, groups, target, group, i, j):
    """Where the entries of two entries' variables meet (`Rows.entry_member`, ...): index of the first, steps from row
    to row and from column to column, and whether it is one variable's block with itself, which holds both triangles.
    """
    first, second = rows.entry_member[i], rows.entry_member[j]
    begin = groups.member_first[group]
    size, low, high = groups.member_first[group + 1] - begin, min(first, second), max(first, second)
    start, width = target.pair[groups.pair_first[group] + low * size + high], groups.member_width[begin + high]
    down, across = (1, width) if first > second else (width, 1)
    return start + rows.entry_inside[i] * down + rows.entry_inside[j] * across, down, across, first == second


@inlined
def add_sums(blocks, start, down, across, sums, at, components_i, components_j, symmetric):
    """Add sums (components_i, components_j) to a block; of a `symmetric` matrix those that `lanes.HALF` says."""
    for a in range(components_i if symmetric else 0):
        for d in range(HALF):
            b, value = (a + d) % 6, sums[at + a * HALF + d]
            blocks[start + a * down + b * across] += value
            if 0 < d < 3:  # what is opposite comes of both rows
                blocks[start + b * down + a * across] += value
    for a in range(0 if symmetric else components_i):
        row, k = start + a * down, at + a * components_j
        if across == 1 and components_j == 6:
            put_four(blocks, row, multiply_add(1.0, four(sums, k), four(blocks, row)))
            blocks[row + 4] += sums[k + 4]
            blocks[row + 5] += sums[k + 5]
        else:
            for b in range(components_j):
                blocks[row + b * across] += sums[k + b]


@inlined
def add_entry(rows, groups, target, group, i, a, j, value, blocks):
    """Add an entry (component a of entry i, single column j), and its mirror image, to the blocks."""
    start, down, across, same = block_index(rows, groups, target, group, i, j)
    blocks[start + a * down] += value
    if same and i != j:
        mirrored, down, across, _ = block_index(rows, groups, target, group, j, i)
        blocks[mirrored + a * across] += value
