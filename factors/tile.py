"""A tile of points: loading its sights, their rows, its normal equations, and the inner solve.

With the orientation held, each point is solved by Gauss-Newton to a fixed tolerance, all lanes together.
"""

import math

import numpy as np

from mgsgraph.factors.lanes import (
    ACTIVE,
    ATTITUDE,
    BASIS,
    BY_POINT,
    BY_STATE,
    CARRY,
    CENTRE,
    COST,
    DETECTOR,
    DISTANCE,
    GRADIENT,
    LANES,
    NORMAL,
    PLACE,
    PRODUCT,
    RESIDUAL,
    ROOT,
    SCALE,
    SLOPE,
    SQUARE,
    STATE,
    STATE_WIDTH,
    TURNING,
    VELOCITY,
    WEIGHT,
    lane,
    registers,
    summing,
)
from mgsgraph.factors.priors import ground_rows
from mgsgraph.factors.projection import image_rows
from mgsgraph.factors.range import range_rows
from mgsgraph.factors.rows import (
    CAMERA,
    CAUCHY,
    GOOD,
    GROUND,
    HUBER,
    IMAGE,
    NO_LOSS,
    OUT,
    PREDICTED,
    RANGE,
    SURFACE,
    WEAK,
    Model,
    Rows,
)
from mgsgraph.factors.surface import surface_rows

_INNER_STEPS = 250
"""Quadratic rows need one to three; far from its optimum a Cauchy or Tukey loss converges slowly."""
_PLAIN_TOLERANCE = 1e-3
"""Sigmas: after a shorter step the next would be some 1e-7 long (rows are linear to 1e-4 over a sigma), and what it
would gain is known from the linear model to 1e-14: no second look is needed."""
_ROBUST_TOLERANCE = 1e-7
"""Sigmas, where a robust loss makes the convergence linear."""
_SINGULAR = 1e-13
"""Pivot relative to its diagonal below which a point counts as not determined."""


def workspace(rows: Rows) -> tuple[int, int, int]:
    """Numbers that a tile of these rows needs, where its first sight begins, and numbers per sight."""
    most = int(np.diff(rows.pattern_sight).max(initial=1))
    base = PRODUCT + int(rows.sight_terms.max(initial=1)) ** 2 * LANES
    own = 2 * rows.sight_terms + STATE_WIDTH * rows.sight_shared
    depth = BASIS + int(own.max(initial=0)) * LANES
    return base + most * depth, base, depth


@lane
def sights_of(rows, pattern):
    """First sight of a pattern and the one after its last."""
    return rows.pattern_sight[pattern], rows.pattern_sight[pattern + 1]


@lane
def copied(data, start, stride, n, w, register, components):
    """Copy components of n points, `stride` numbers apart, to consecutive registers; where the next one starts."""
    for c in range(components):
        source, sink = start + c * stride, register + c * LANES
        for l in range(n):
            w[sink + l] = data[source + l]
    return start + components * stride


@lane
def load(rows, model, piece, first, n, w, base, depth):
    """Load n points from the `first` of a piece: which take part, and the constants of their sights."""
    point, count = rows.piece[piece, 1] + first, rows.piece[piece, 2]
    for l in range(n):
        w[ACTIVE + l] = 0.0 if rows.kind[point + l] == OUT else 1.0
        w[STATE + l] = GOOD
    at, place = rows.piece[piece, 3] + first, rows.piece[piece, 4] + first
    begin, end = sights_of(rows, rows.piece[piece, 0])
    for i in range(begin, end):
        s = base + (i - begin) * depth
        at = load_constants(rows, model, i, at, count, n, w, s)
        copied(registers(rows.weight), place, rows.weight.shape[1], n, w, s + WEIGHT, 2)
        for l in range(n):
            w[s + CARRY + l] = 0.0
        place += count


@lane
def load_constants(rows, model, sight, at, stride, n, w, s):
    """Constants of one sight in the order of `Rows.data`: its own, then basis values, then directions."""
    data, kind, rates = registers(rows.data), rows.sight_kind[sight], False
    if kind != SURFACE:
        at = copied(data, at, stride, n, w, s + CENTRE, 3)
    if kind == IMAGE:
        at = copied(data, at, stride, n, w, s + ATTITUDE, 4 if model.angles == CAMERA else 3)
        at = copied(data, at, stride, n, w, s + DETECTOR, 2)
        rates = model.line == PREDICTED
        if rates:
            at = copied(data, at, stride, n, w, s + VELOCITY, 3)
            at = copied(data, at, stride, n, w, s + TURNING, 3)
            at = copied(data, at, stride, n, w, s + SLOPE, 2)
        else:
            at = copied(data, at, stride, n, w, s + SCALE, 4)
    elif kind == RANGE:
        at = copied(data, at, stride, n, w, s + DISTANCE, 1)
    elif kind == GROUND:
        at = copied(data, at, stride, n, w, s + ROOT, 6)
    terms = rows.sight_terms[sight]
    at = copied(data, at, stride, n, w, s + BASIS, 2 * terms if rates else terms)
    shared = s + BASIS + 2 * terms * LANES
    for e in range(rows.sight_shared[sight]):
        at = copied(data, at, stride, n, w, shared + e * STATE_WIDTH * LANES, rows.sight_width[sight])
    return at


@lane
def row_count(kind):
    """Rows of a sight."""
    return 2 if kind == IMAGE else 3 if kind == GROUND else 1


@lane
def sight_rows(rows, model, piece, i, x, first, n, w, s):
    """Rows of one sight at PLACE, robust loss applied; its cost is added to COST."""
    kind, width = rows.sight_kind[i], rows.sight_width[i]
    if kind == IMAGE:
        image_rows(rows, model, i, x, n, w, s, width)
    elif kind == RANGE:
        range_rows(rows, i, x, n, w, s, width)
    elif kind == GROUND:
        ground_rows(rows, i, x, n, w, s)
    else:
        surface_rows(rows, i, x, rows.piece[piece, 1] + first, n, w, s)
    if kind == IMAGE or kind == RANGE:
        apply_loss(model, row_count(kind), width, n, w, s)
    else:
        add_squares(row_count(kind), n, w, s)


@lane
def all_rows(rows, model, piece, x, first, n, w, base, depth):
    """Rows of all sights at PLACE, robust losses applied, and their COST."""
    for l in range(n):
        w[COST + l] = 0.0
    begin, end = sights_of(rows, rows.piece[piece, 0])
    for i in range(begin, end):
        sight_rows(rows, model, piece, i, x, first, n, w, base + (i - begin) * depth)


@lane
def add_squares(count, n, w, s):
    """Add half the squares of a sight's rows to COST."""
    for row in range(count):
        for l in range(n):
            w[COST + l] += 0.5 * w[s + RESIDUAL + row * LANES + l] * w[s + RESIDUAL + row * LANES + l]


@lane
def apply_loss(model, count, width, n, w, s):
    """Add a sight's loss to COST and scale its rows by the root of the loss's weight."""
    if model.loss == NO_LOSS:
        add_squares(count, n, w, s)
        return
    for l in range(n):
        square = 0.0
        for row in range(count):
            square += w[s + RESIDUAL + row * LANES + l] * w[s + RESIDUAL + row * LANES + l]
        cost, weight = robust(model, square)
        w[COST + l] += cost
        root = math.sqrt(weight)
        for row in range(count):
            w[s + RESIDUAL + row * LANES + l] *= root
            for j in range(3):
                w[s + BY_POINT + (3 * row + j) * LANES + l] *= root
            for j in range(width):
                w[s + BY_STATE + (STATE_WIDTH * row + j) * LANES + l] *= root


@lane
def robust(model, square):
    """Cost contribution and weight of a residual whose squared norm is `square` (gtsam's mEstimator definitions)."""
    width = model.width
    if model.loss == HUBER:
        norm = math.sqrt(square)
        if norm <= width:
            return 0.5 * square, 1.0
        return width * (norm - 0.5 * width), width / norm
    ratio = square / (width * width)
    if model.loss == CAUCHY:
        return 0.5 * width * width * math.log1p(ratio), 1.0 / (1.0 + ratio)
    if ratio >= 1.0:  # Tukey
        return width * width / 6.0, 0.0
    rest = 1.0 - ratio
    return width * width / 6.0 * (1.0 - rest**3), rest * rest


@lane
def normal_equations(rows, pattern, n, w, base, depth):
    """NORMAL (lower triangle: 00, 10, 11, 20, 21, 22) and GRADIENT of the points from the rows of their sights."""
    for r in range(9):
        for l in range(n):
            w[NORMAL + r * LANES + l] = 0.0
    begin, end = sights_of(rows, pattern)
    for i in range(begin, end):
        s = base + (i - begin) * depth
        for row in range(row_count(rows.sight_kind[i])):
            p, r = s + BY_POINT + 3 * row * LANES, s + RESIDUAL + row * LANES
            for l in range(n):
                p0, p1, p2, residual = w[p + l], w[p + LANES + l], w[p + 2 * LANES + l], w[r + l]
                w[NORMAL + l] += p0 * p0
                w[NORMAL + LANES + l] += p1 * p0
                w[NORMAL + 2 * LANES + l] += p1 * p1
                w[NORMAL + 3 * LANES + l] += p2 * p0
                w[NORMAL + 4 * LANES + l] += p2 * p1
                w[NORMAL + 5 * LANES + l] += p2 * p2
                w[GRADIENT + l] += p0 * residual
                w[GRADIENT + LANES + l] += p1 * residual
                w[GRADIENT + 2 * LANES + l] += p2 * residual


@lane
def factorise(n, w):
    """NORMAL = L L' in place, GRADIENT to L^-1 g, SQUARE its squared length; STATE WEAK where a pivot is lost.

    Weak points and those that don't take part get an endless L: they neither move nor couple.
    """
    for l in range(n):
        v00, v10, v11 = w[NORMAL + l], w[NORMAL + LANES + l], w[NORMAL + 2 * LANES + l]
        v20, v21, v22 = w[NORMAL + 3 * LANES + l], w[NORMAL + 4 * LANES + l], w[NORMAL + 5 * LANES + l]
        d0 = v00
        i00 = 1.0 / math.sqrt(d0)
        l10, l20 = v10 * i00, v20 * i00
        d1 = v11 - l10 * l10
        i11 = 1.0 / math.sqrt(d1)
        l21 = (v21 - l20 * l10) * i11
        d2 = v22 - l20 * l20 - l21 * l21
        i22 = 1.0 / math.sqrt(d2)
        strong = (d0 > 0.0) & (d1 > _SINGULAR * v11) & (d2 > _SINGULAR * v22)
        weak = (not strong) & (w[ACTIVE + l] > 0.0) & (w[STATE + l] == GOOD)
        w[STATE + l] = WEAK if weak else w[STATE + l]
        i00, i11, i22 = (i00 if strong else 0.0), (i11 if strong else 0.0), (i22 if strong else 0.0)
        l10, l20, l21 = (l10 if strong else 0.0), (l20 if strong else 0.0), (l21 if strong else 0.0)
        y0 = w[GRADIENT + l] * i00
        y1 = (w[GRADIENT + LANES + l] - l10 * y0) * i11
        y2 = (w[GRADIENT + 2 * LANES + l] - l20 * y0 - l21 * y1) * i22
        w[NORMAL + l], w[NORMAL + LANES + l], w[NORMAL + 2 * LANES + l] = i00, l10, i11
        w[NORMAL + 3 * LANES + l], w[NORMAL + 4 * LANES + l], w[NORMAL + 5 * LANES + l] = l20, l21, i22
        w[GRADIENT + l], w[GRADIENT + LANES + l], w[GRADIENT + 2 * LANES + l] = y0, y1, y2
        w[SQUARE + l] = y0 * y0 + y1 * y1 + y2 * y2


@lane
def step_points(n, w):
    """Move the points by -L^-T L^-1 g, and take what that gains, by the linear model, off the cost."""
    for l in range(n):
        y2 = w[GRADIENT + 2 * LANES + l] * w[NORMAL + 5 * LANES + l]
        y1 = (w[GRADIENT + LANES + l] - w[NORMAL + 4 * LANES + l] * y2) * w[NORMAL + 2 * LANES + l]
        y0 = w[GRADIENT + l] - w[NORMAL + LANES + l] * y1 - w[NORMAL + 3 * LANES + l] * y2
        w[PLACE + l] -= y0 * w[NORMAL + l]
        w[PLACE + LANES + l] -= y1
        w[PLACE + 2 * LANES + l] -= y2
        w[COST + l] -= 0.5 * w[SQUARE + l]


@summing
def largest(n, w, register):
    """Largest of n lanes."""
    value = 0.0
    for l in range(n):
        value = max(value, w[register + l])
    return value


@lane
def place_points(places, first, n, w):
    """PLACE from places (n, 3)."""
    for l in range(n):
        for j in range(3):
            w[PLACE + j * LANES + l] = places[first + l, j]


@lane
def solve_tile(rows, model, piece, x, first, n, places, move, w, base, depth):
    """Best places of n points with the orientation held: PLACE, COST and STATE, and rows, L and L^-1 g there.

    Begins at `places` (n, 3); rows, L and L^-1 g stay those of the place before the last, short step. Unless `move`,
    the points stay where they are. With a robust loss the way is begun anew, at `rows.start` and with plain squares,
    for where such a loss is flat it leads nowhere; so earlier calls don't count.
    """
    point, fixed = rows.piece[piece, 1] + first, rows.pattern_fixed[rows.piece[piece, 0]] > 0
    robustly = model.loss != NO_LOSS
    place_points(rows.start if move and (robustly or fixed) else places, point, n, w)
    plainly = move and robustly and not fixed
    for _ in range(2 * _INNER_STEPS):
        now = Model(model.line, model.angles, NO_LOSS if plainly else model.loss, model.width)
        all_rows(rows, now, piece, x, first, n, w, base, depth)
        if fixed:
            break
        normal_equations(rows, rows.piece[piece, 0], n, w, base, depth)
        factorise(n, w)
        if not move:
            break
        step_points(n, w)
        tolerance = _ROBUST_TOLERANCE if robustly and not plainly else _PLAIN_TOLERANCE
        if largest(n, w, SQUARE) < tolerance * tolerance:
            if not plainly:
                break
            plainly = False
    if move and not fixed:
        take_back(n, w)


@lane
def take_back(n, w):
    """Where the steps ran out before they were short, the linear model's promise of the last one doesn't count."""
    for l in range(n):
        w[COST + l] += 0.5 * w[SQUARE + l] if w[SQUARE + l] > _PLAIN_TOLERANCE * _PLAIN_TOLERANCE else 0.0


@lane
def any_state(n, w, state):
    """Whether a lane is in a state."""
    for l in range(n):
        if w[STATE + l] == state:
            return True
    return False
