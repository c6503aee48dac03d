"""The kernel of least-squares matching: one window after the other, compiled.

The template t about an anchor is explained by the search picture s: t(d) = gain s(position + A d) + offset + noise,
with d in lines and samples. Eight unknowns: position (2), A (4), gain, offset; and three more where the direction e is
known in which height displaces: A d + e (a l^2 + b l s + c s^2), since relief is never flat over a window.

The estimate is where instruments z are orthogonal to the residuals, sum w z r = 0, with z from the template's gradient
and weights w about the anchor. In the classic normal equations z is the search picture's own gradient, interpolated at
the same position as its noise, whose variance depends on the part of a pixel: least squares then moves to where
interpolation smooths most. The template's gradient, by the spline at the pixel's centre, is antisymmetric about the
pixel and knows neither its noise nor that of the search picture. For the gain, the mean of both grey values serves:
noise in one alone makes a gain too small.

The covariance of the position is that of the influences of all pixels on it, u r with u = M^-1 w z and M = sum w z j':
noise in gradients makes z'z larger than it is, M not. See `equations.fill_covariance` for correlated residuals, and
for relief.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.matching.equations import (
    CORRELATION,
    EXTREME,
    MISSING,
    NO_CONTRAST,
    PLAIN,
    RELIEF,
    WEIGHT,
    WIDTH,
    Reals,
    Room,
    S,
    T,
    derivatives,
    fill_covariance,
    inside,
    read_template,
    resample,
    seen,
)

CONVERGED, LEFT, UNFINISHED, WANDERED, FLAT, SATURATED = 0, 1, 2, 3, 4, 5
"""How a match may end."""
_SINGULAR = 1e-9
"""Pivot relative to its diagonal below which a normal matrix counts as singular: gradients carry 1e-6 of rounding."""
_FAR, _TURN = 1.0, 4.0
"""pixels that the window's positions may move in one step; factor by which A may change in scale."""


@compiled
def _step(pixels: Reals, x: Reals, e: Reals, room: Room) -> bool:
    """Gauss-Newton step to where z is orthogonal to the residuals; False where the normal matrix is singular.

    Its matrix is that of the mean of z and j, which far from the solution is better than either (Malis 2004).
    """
    z, j, normal, step = room.z, room.j, room.system, room.step
    for k in range(x.size):
        step[k] = 0.0
        for m in range(k + 1):
            normal[k, m] = 0.0
    for i in range(pixels.shape[0]):
        derivatives(pixels, i, x, e, z, j)
        residue = pixels[i, T] - x[6] * pixels[i, S] - x[7]
        for k in range(x.size):
            step[k] += pixels[i, WEIGHT] * z[k] * residue
            j[k] = 0.5 * (z[k] + j[k])
            for m in range(k + 1):
                normal[k, m] += pixels[i, WEIGHT] * j[k] * j[m]
    return _cholesky_solve(normal, step)


@compiled
def _cholesky_solve(a: Reals, b: Reals) -> bool:
    """Solve a x = b in place from a's lower triangle; False where a is singular."""
    unknowns = b.size
    for k in range(unknowns):
        pivot = a[k, k]
        for m in range(k):
            pivot -= a[k, m] * a[k, m]
        if not pivot > _SINGULAR * a[k, k]:
            return False
        a[k, k] = math.sqrt(pivot)
        for i in range(k + 1, unknowns):
            for m in range(k):
                a[i, k] -= a[i, m] * a[k, m]
            a[i, k] /= a[k, k]
    for k in range(unknowns):
        for m in range(k):
            b[k] -= a[k, m] * b[m]
        b[k] /= a[k, k]
    for k in range(unknowns - 1, -1, -1):
        for m in range(k + 1, unknowns):
            b[k] -= a[m, k] * b[m]
        b[k] /= a[k, k]
    return True


@compiled
def _move(x: Reals, step: Reals, half: tuple[int, int]) -> tuple[float, float]:
    """Add a step to the unknowns, shortened where the window would move too far; pixels that its position has moved,
    and that its corners have moved about it.
    """
    turn = 0.0
    for k in range(2):
        turn = max(turn, abs(step[2 + 2 * k]) + abs(step[3 + 2 * k]))
    for k in range(PLAIN, x.size):
        turn += abs(step[k])
    move = math.hypot(step[0], step[1])
    part = min(1.0, _FAR / max(move + turn, 1e-300))
    for k in range(2):
        x[k] += part * step[k]
        x[2 + 2 * k] += part * step[2 + 2 * k] / half[0]
        x[3 + 2 * k] += part * step[3 + 2 * k] / half[1]
        x[6 + k] += part * step[6 + k]
    for k in range(PLAIN, x.size):
        x[k] += part * step[k]
    return part * move, part * turn


@compiled
def _radiometry(pixels: Reals, x: Reals) -> bool:
    """Gain and offset that make the two windows' means and scatters equal; False where the search has no contrast."""
    mean_t, mean_s, square_t, square_s, _ = _moments(pixels)
    if not math.sqrt(square_s / pixels.shape[0]) > NO_CONTRAST * abs(mean_s):
        return False
    x[6] = math.sqrt(square_t / square_s)
    x[7] = mean_t - x[6] * mean_s
    return True


@compiled
def _moments(pixels: Reals) -> tuple[float, float, float, float, float]:
    """Of grey values of the template and of the search picture: both means; sums of both squares about them, and of the
    products.
    """
    n = pixels.shape[0]
    mean_t, mean_s, square_t, square_s, product = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        mean_t += pixels[i, T] / n
        mean_s += pixels[i, S] / n
    for i in range(n):
        t, s = pixels[i, T] - mean_t, pixels[i, S] - mean_s
        square_t, square_s, product = square_t + t * t, square_s + s * s, product + t * s
    return mean_t, mean_s, square_t, square_s, product


@compiled
def out_of_shape(x: Reals, e: Reals, half: tuple[int, int], scale: float) -> bool:
    """Whether gain or A, anywhere in the window, are impossible for a view of the same ground."""
    determinant, change = x[2] * x[5] - x[3] * x[4], 0.0
    if x.size == RELIEF:  # of A + e times the slope of the curved part, which is steepest in a corner
        down = (x[5] * e[0] - x[3] * e[1]) / half[0]
        across = (x[2] * e[1] - x[4] * e[0]) / half[1]
        change = abs(2.0 * x[8] * down + x[9] * across) + abs(x[9] * down + 2.0 * x[10] * across)
        change = math.copysign(change, scale)
    return not (x[6] > 0.0 and (determinant - change) / scale > 1.0 / _TURN and (determinant + change) / scale < _TURN)


@compiled
def _marked(marks: NDArray[np.uint8], x: Reals, e: Reals, half: tuple[int, int]) -> tuple[int, int]:
    """How many of a window's pixels are saturated, and how many missing."""
    saturated, missing = 0, 0
    for down in range(-half[0], half[0] + 1):
        for across in range(-half[1], half[1] + 1):
            line, sample = seen(x, e, half, down / half[0], across / half[1])
            mark = marks[int(line), int(sample)]
            saturated += mark == EXTREME
            missing += mark == MISSING
    return saturated, missing


@compiled
def _iterate(
    c: NDArray[np.float32], x: Reals, e: Reals, half: tuple[int, int], most: int, tolerance: float, reach: float,
    pixels: Reals, room: Room,
) -> int:
    """Iterate the unknowns to the solution; the final state."""
    lines, samples = c.shape[0] - 3, c.shape[1] - 3
    first_line, first_sample, scale = x[0], x[1], x[2] * x[5] - x[3] * x[4]
    settled = False
    for iteration in range(most + 1):
        if not inside(x, e, half, lines, samples):
            return LEFT
        resample(c, x, e, half, pixels)
        if iteration == 0 and not _radiometry(pixels, x):
            return FLAT
        if not _step(pixels, x, e, room):
            return FLAT
        moved, turned = _move(x, room.step, half)
        if math.hypot(x[0] - first_line, x[1] - first_sample) > reach or out_of_shape(x, e, half, scale):
            return WANDERED
        if settled and inside(x, e, half, lines, samples):  # one step more, which without noise is exact
            resample(c, x, e, half, pixels)
            return CONVERGED
        settled = moved < tolerance and turned < 10.0 * tolerance
    return UNFINISHED


@cached_kernel
def match_windows(
    template: NDArray[np.float32],
    template_marks: NDArray[np.uint8],
    search: NDArray[np.float32],
    search_marks: NDArray[np.uint8],
    anchors: Reals,
    starts: Reals,
    half: tuple[int, int],
    weights: Reals,
    most: int,
    tolerance: float,
    reach: float,
    most_saturated: float,
    rows: Reals,
    states: NDArray[np.int64],
) -> None:
    """Match windows about anchors (n, 2) from starts (n, 8), position, A, direction of relief, or (n, 6) without that;
    fills rows (n, NUMBERS) and states (n,).
    """
    size = weights.shape[0]
    relief = starts.shape[1] == PLAIN
    unknowns = RELIEF if relief else PLAIN
    pixels, x, own, e = np.empty((size, WIDTH)), np.empty(unknowns), np.empty(PLAIN), np.empty(2)
    system = np.empty((unknowns, 2 * unknowns + 4))
    room = Room(np.empty(unknowns), np.empty(unknowns), np.empty(unknowns), system)
    for n in range(anchors.shape[0]):
        for k in range(unknowns):
            x[k] = starts[n, k] if k < 6 else (1.0 if k == 6 else 0.0)
        for k in range(PLAIN):
            own[k] = anchors[n, k] if k < 2 else (1.0 if k == 2 or k == 5 else 0.0)
        for k in range(2):
            e[k] = starts[n, 6 + k] if relief else 0.0
        states[n] = LEFT
        if not inside(own, e, half, template_marks.shape[0], template_marks.shape[1]):
            continue
        saturated, missing = _marked(template_marks, own, e, half)
        if missing > 0 or saturated > most_saturated * size:
            states[n] = SATURATED if missing == 0 else LEFT
            continue
        if not read_template(template, anchors[n], half, weights, pixels):
            states[n] = FLAT
            continue
        begins_inside = inside(x, e, half, search_marks.shape[0], search_marks.shape[1])
        if begins_inside and _marked(search_marks, x, e, half)[0] > most_saturated * size:
            states[n] = SATURATED
            continue
        states[n] = _iterate(search, x, e, half, most, tolerance, reach, pixels, room)
        if states[n] != CONVERGED:
            continue
        saturated, missing = _marked(search_marks, x, e, half)
        if missing > 0 or saturated > most_saturated * size:
            states[n] = SATURATED if missing == 0 else LEFT
        elif fill_covariance(pixels, x, e, half, room, rows[n]):
            for k in range(PLAIN):
                rows[n, k] = x[k]
            _, _, square_t, square_s, product = _moments(pixels)
            rows[n, CORRELATION] = product / math.sqrt(square_t * square_s)
        else:
            states[n] = FLAT
