"""A tile: up to 64 points of one shape, of one piece or of several, their constants loaded into lanes.

Points have the same *shape* when their sights are of the same kinds, in the same order, with as many terms and single
columns; which unknowns these are may differ from *segment* to segment of a tile, the lanes of one piece.
"""

import numpy as np

from mgsgraph.kernel.lanes import (
    ACTIVE,
    BASIS,
    CARRY,
    CENTRE,
    DELTA,
    DETECTOR,
    DISTANCE,
    FOCAL,
    LANES,
    NOMINAL,
    OFFSET,
    PLACE,
    RATE,
    ROOT,
    ROWS,
    SCALE,
    SLOPE,
    STATE,
    STATE_WIDTH,
    TILE,
    TURNING,
    VELOCITY,
    WEIGHT,
    WIDTH,
    inlined,
    lane,
    registers,
)
from mgsgraph.kernel.rows import CAMERA, GOOD, GROUND, IMAGE, OUT, PREDICTED, RANGE, SURFACE, Rows

PIECE_OF, FIRST, BEGIN, END, PATTERN = 0, 1, 2, 3, 4
"""Columns of the table of segments: piece, first point counted in it, lanes from BEGIN up to END, pattern."""


def workspace(rows: Rows) -> tuple[int, int]:
    """Numbers that a tile of these rows needs, and numbers per sight."""
    most = int(np.diff(rows.pattern_sight).max(initial=1))
    own = 2 * rows.sight_terms + STATE_WIDTH * rows.sight_shared
    depth = BASIS + int(own.max(initial=0)) * LANES
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
def sights_of(rows, segments):
    """First sight of the tile's first pattern, which stands for its shape, and the one after its last."""
    pattern = segments[0, PATTERN]
    return rows.pattern_sight[pattern], rows.pattern_sight[pattern + 1]


@inlined
def point_of(rows, segments, k):
    """Point of the lane before a segment's first, were they counted on: point + l is that of lane l."""
    return rows.piece[segments[k, PIECE_OF], 1] + segments[k, FIRST] - segments[k, BEGIN]


@inlined
def sight_place(rows, segments, k, sight):
    """The same place of a sight, counted within its point, among all sights."""
    piece = segments[k, PIECE_OF]
    return rows.piece[piece, 4] + sight * rows.piece[piece, 2] + segments[k, FIRST] - segments[k, BEGIN]


@inlined
def load(rows, model, segments, count, w, depth, places):
    """Load a tile: which points take part, where they are, and their sights' constants; spare lanes do nothing."""
    for l in range(LANES):
        w[ACTIVE + l] = 0.0
    for k in range(count):
        point = point_of(rows, segments, k)
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[ACTIVE + l] = 0.0 if rows.kind[point + l] == OUT else 1.0
            w[STATE + l] = GOOD
            for j in range(3):
                w[PLACE + j * LANES + l] = places[point + l, j]
    begin, end = sights_of(rows, segments)
    at = 0
    for i in range(begin, end):
        at = load_sight(rows, model, segments, count, begin, i, at, w, TILE + (i - begin) * depth)


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
def powers(rows, segments, count, sight, terms, w, basis, rates):
    """Values 1, u, u^2, .. of a polynomial and, if `rates`, theirs per line, of the line u in the second register."""
    for t in range(2, terms):
        for l in range(LANES):
            w[basis + t * LANES + l] = w[basis + (t - 1) * LANES + l] * w[basis + LANES + l]
    for l in range(LANES):
        w[basis + l] = 1.0
    for k in range(count if rates else 0):
        rate = rows.sight_rate[rows.pattern_sight[segments[k, PATTERN]] + sight]
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[basis + terms * LANES + l] = 0.0
        for t in range(1, terms):
            for l in range(segments[k, BEGIN], segments[k, END]):
                w[basis + (terms + t) * LANES + l] = t * rate * w[basis + (t - 1) * LANES + l]


@inlined
def load_sight(rows, model, segments, count, begin, i, at, w, s):
    """Constants of sight i in the order of `Rows.data`: its own, then basis values, then directions."""
    kind, rates = rows.sight_kind[i], False
    if kind != SURFACE:
        at = copied(rows, segments, count, at, w, s + CENTRE, 3)
    if kind == IMAGE:
        at = copied(rows, segments, count, at, w, s + NOMINAL, 4 if model.angles == CAMERA else 3)
        at = copied(rows, segments, count, at, w, s + DETECTOR, 2)
        rates = model.line == PREDICTED
        if rates:
            at = copied(rows, segments, count, at, w, s + VELOCITY, 3)
            at = copied(rows, segments, count, at, w, s + TURNING, 3)
            at = copied(rows, segments, count, at, w, s + SLOPE, 2)
            at = copied(rows, segments, count, at, w, s + OFFSET, 1)
        else:
            at = copied(rows, segments, count, at, w, s + SCALE, 4)
    elif kind == RANGE:
        at = copied(rows, segments, count, at, w, s + DISTANCE, 1)
    elif kind == GROUND:
        at = copied(rows, segments, count, at, w, s + ROOT, 6)
    terms = rows.sight_terms[i]
    if rows.sight_rate[i] != 0.0 and terms > 0:
        at = copied(rows, segments, count, at, w, s + BASIS + LANES, 1)
        powers(rows, segments, count, i - begin, terms, w, s + BASIS, rates)
    else:
        at = copied(rows, segments, count, at, w, s + BASIS, 2 * terms if rates else terms)
    for e in range(rows.sight_shared[i]):
        at = copied(rows, segments, count, at, w, s + BASIS + 2 * terms * LANES + e * WIDTH, rows.sight_width[i])
    weight = registers(rows.weight)
    for l in range(LANES):
        w[s + WEIGHT + l] = 0.0
    for k in range(count):
        place = sight_place(rows, segments, k, i - begin)
        focal = rows.sight_focal[rows.pattern_sight[segments[k, PATTERN]] + i - begin]
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[s + FOCAL + l] = focal
            w[s + WEIGHT + l] = weight[place + l]
            w[s + WEIGHT + LANES + l] = weight[rows.weight.shape[1] + place + l]
    return at


@lane
def copy_block(w, source, sink, size):
    """Copy registers."""
    for r in range(size):
        w[sink + r] = w[source + r]


@inlined
def pose_components(width):
    """Components of a state that a basis term moves: place and rotation, or the place alone; never focal length or
    range bias, which are single columns.
    """
    return 6 if width >= 6 else 3


@inlined
def correct(rows, segments, count, i, x, w, s, rates):
    """DELTA and, if `rates`, RATE: what the unknowns x do to sight i, CARRY lines from the line of its constants."""
    for r in range(STATE_WIDTH * LANES):
        w[DELTA + r] = 0.0
    for r in range(6 * LANES if rates else 0):
        w[RATE + r] = 0.0
    terms, width, begin = rows.sight_terms[i], rows.sight_width[i], sights_of(rows, segments)[0]
    components = pose_components(width)
    for k in range(count):
        first, last = segments[k, BEGIN], segments[k, END]
        entry = rows.sight_entry[rows.pattern_sight[segments[k, PATTERN]] + i - begin]
        for t in range(terms):
            value, slope = s + BASIS + t * LANES, s + BASIS + (terms + t) * LANES
            column = rows.entry_column[entry + t]
            for a in range(components):
                c = x[column + a]
                if rates:
                    for l in range(first, last):
                        w[DELTA + a * LANES + l] += (w[value + l] + w[ROWS + CARRY + l] * w[slope + l]) * c
                        w[RATE + a * LANES + l] += w[slope + l] * c
                else:
                    for l in range(first, last):
                        w[DELTA + a * LANES + l] += w[value + l] * c
        for e in range(rows.sight_shared[i]):
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
        lost = max(lost, w[ACTIVE + l] * abs(w[STATE + l] - GOOD))
    return lost == 0.0
