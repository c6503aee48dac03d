"""The inner solve: with the orientation held, each point of a tile is solved by Gauss-Newton to a fixed tolerance."""

import numpy as np

from mgsgraph.kernel.lanes import (
    ACTIVE,
    COST,
    FACTOR,
    FORWARD,
    GRADIENT,
    LANES,
    NORMAL,
    POINT,
    STATUS,
    STEP_SQUARED,
    inlined,
    lane,
    summing,
)
from mgsgraph.kernel.measurements import all_rows
from mgsgraph.kernel.rows import GOOD, NO_LOSS, SURFACE, WEAK
from mgsgraph.kernel.tile import BEGIN, END, PATTERN, load, observations_of

INNER_STEPS = 250
"""Quadratic rows need one to three; far from its optimum a Cauchy or Tukey loss converges slowly."""
PLAIN_TOLERANCE = 1e-3
"""Sigmas: after a shorter step the next would be some 1e-7 long (rows are linear to 1e-4 over a sigma), and what it
would gain is known from the linear model to 1e-14: no second look is needed."""
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
def solve_tile(rows, model, segments, count, x, points, move, everything, w, depth, kept):
    """Coordinates of a tile's points of least cost with the orientation held: POINT, COST and STATUS, and, if `kept`,
    rows there.

    Begins at `points` (n, 3); rows, FACTOR and FORWARD stay those of the coordinates before the last, short step.
    Unless `move`, the points stay where they are, and take part all if `everything`. With a robust loss the way is
    begun anew, at `rows.start` and with plain squares, for where such a loss is flat it leads nowhere; so earlier calls
    don't count.
    """
    fixed = rows.pattern_fixed[segments[0, PATTERN]] > 0
    robust = model.loss != NO_LOSS
    load(rows, model, segments, count, w, depth, rows.start if move and (robust or fixed) else points)
    for k in range(count if everything else 0):
        for l in range(segments[k, BEGIN], segments[k, END]):
            w[ACTIVE + l] = 1.0
    plainly = move and robust and not fixed
    slow = robust or on_terrain(rows, segments)
    for _ in range(2 * INNER_STEPS):
        all_rows(rows, model, robust and not plainly, segments, count, x, w, depth, kept)
        if fixed:
            break
        factorise(w)
        if not move:
            break
        step_points(w)
        tolerance = SLOW_TOLERANCE if slow and not plainly else PLAIN_TOLERANCE
        if largest_step(w) < tolerance * tolerance:
            if not plainly:
                break
            plainly = False
    if move and not fixed:
        take_back(w)


@inlined
def on_terrain(rows, segments):
    """Whether a tile's points have heights above the terrain model."""
    begin, end = observations_of(rows, segments)
    found = False
    for i in range(begin, end):
        found = found or rows.observation_kind[i] == SURFACE
    return found


@lane
def take_back(w):
    """Where the steps ran out before they were short, the linear model's promise of the last one doesn't count."""
    for l in range(LANES):
        w[COST + l] += 0.5 * w[STEP_SQUARED + l] if w[STEP_SQUARED + l] > PLAIN_TOLERANCE * PLAIN_TOLERANCE else 0.0
