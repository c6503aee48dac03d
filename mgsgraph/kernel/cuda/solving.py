"""Rows of an observation at a point (the equations of `factors`, as a thread calls them), and the inner solve, a thread
a point: with the orientation held, Gauss-Newton to a fixed tolerance.

As `kernel.elimination` does it; what a thread does depends on its own point alone.
"""

import math

import numpy as np

from mgsgraph.factors.algebra import add, scale, subtract, transform
from mgsgraph.factors.collinearity import (
    NEWTON_STEPS,
    NEWTON_TOLERANCE,
    by_interior,
    by_point,
    by_ray,
    by_rotation,
    focal_plane,
    image_motion,
    peer_pixels,
    ray_motion,
    residual,
    to_lines_and_samples,
)
from mgsgraph.factors.ground import ground_residual, upper_triangle
from mgsgraph.factors.loss import HUBER_WIDTH, cauchy, huber, tukey
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer, perspective_centre
from mgsgraph.factors.ranging import range_residual
from mgsgraph.factors.stereo_surface import linear_height
from mgsgraph.factors.surface import cubic, height_above, post_coordinates
from mgsgraph.kernel.cuda.device import THREADS, cuda, kernel, on_device
from mgsgraph.kernel.cuda.tables import (
    BEGIN,
    COUNT,
    END,
    FIRST,
    HEIGHTS,
    KIND,
    KNOWN,
    PATTERN,
    constants,
    correction,
    place_among,
    vector,
)
from mgsgraph.kernel.elimination import BEGINNING, INNER_STEPS, PLAIN_TOLERANCE, SINGULAR, SLOW_TOLERANCE
from mgsgraph.kernel.rows import (
    BEHIND,
    CAMERA,
    CAUCHY,
    GOOD,
    GROUND,
    HUBER,
    IMAGE,
    NO_LOSS,
    OPK_PAPER,
    OPK_PEER,
    OUT,
    PREDICTED,
    RANGE,
    STEREO,
    TUKEY,
    WEAK,
    Model,
)


@on_device
def nothing():
    """No derivatives by the point, in three rows."""
    zero = (0.0, 0.0, 0.0)
    return zero, zero, zero


@on_device
def no_state():
    """No derivatives by the state, in three rows."""
    zero = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return zero, zero, zero


@on_device
def attitude(angles, nominal, angular_rate, line_offset, theta, rate):
    """Attitude M, axes A and camera rate, whichever way attitude is counted."""
    if angles == CAMERA:
        return about_axes(nominal, angular_rate, line_offset, theta, rate)
    if angles == OPK_PAPER:
        return opk_paper((nominal[0], nominal[1], nominal[2]), angular_rate, line_offset, theta, rate)
    return opk_peer((nominal[0], nominal[1], nominal[2]), angular_rate, line_offset, theta, rate)


@on_device
def by_state_of_ray(of_point, of_rotation, of_interior):
    """Derivative by the state of an image ray; by position it is minus that by the point."""
    return (
        -of_point[0], -of_point[1], -of_point[2], of_rotation[0], of_rotation[1], of_rotation[2],
        of_interior[0], of_interior[1], of_interior[2],
    )  # fmt: skip


@on_device
def image_rows(tables, model, data, i, at, stride, state, rate, point, weights):
    """Rows of an image ray at the predicted line, found by Newton's method, or at the measured one; whether the point
    is before the camera; and lines from the reference line to the one whose pose is used.
    """
    predicted, four = model.line == PREDICTED, model.angles == CAMERA
    position, nominal = vector(data, at, stride, 0), vector(data, at, stride, 3)
    last = data[at + 6 * stride] if four else 0.0
    k = at + (7 if four else 6) * stride
    places = data[k] + state[6], data[k + stride] + state[7]
    focal = tables.optics[i, 0] + state[8]
    velocity, turning, slope, to_reference = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0), 0.0
    frozen = (0.0, 0.0), (0.0, 0.0)
    if predicted:
        velocity, turning, to_reference = vector(data, k, stride, 2), vector(data, k, stride, 5), data[k + 8 * stride]
    if predicted or model.angles == OPK_PEER:
        own = k + (9 if predicted else 2) * stride
        slope = tables.optics[i, 2], tables.optics[i, 3]
        slope = slope if slope[0] == slope[0] else (data[own], data[own + stride])
        frozen = peer_pixels(slope)
    else:
        frozen = (data[k + 2 * stride], data[k + 3 * stride]), (data[k + 4 * stride], data[k + 5 * stride])
    of_theta, speed = (rate[3], rate[4], rate[5]), add(velocity, (rate[0], rate[1], rate[2]))
    offset, step = 0.0, 0
    while True:
        moved = add((state[0], state[1], state[2]), scale(offset, (rate[0], rate[1], rate[2])))
        theta = add((state[3], state[4], state[5]), scale(offset, of_theta))
        matrix, axes, camera_rate = attitude(
            model.angles, (nominal[0], nominal[1], nominal[2], last), turning, offset, theta, of_theta
        )
        ray = transform(matrix, subtract(point, perspective_centre(position, velocity, offset, moved)))
        image, to_pixels, beyond = focal_plane(ray, focal), frozen, 0.0
        if predicted:
            motion = ray_motion(matrix, ray, speed, camera_rate)
            to_pixels = to_lines_and_samples(image_motion(ray, motion, focal), slope)
            beyond = to_reference + offset
        line, sample = residual(to_pixels, image, places, beyond)
        used = (ray[2] > 0.0) & (weights[0] > 0.0)
        newton = line + beyond if used else 0.0
        step += 1
        if (not predicted) or step == NEWTON_STEPS or not abs(newton) >= NEWTON_TOLERANCE:
            break
        offset -= newton
    front = ray[2] > 0.0
    if not used:
        return (0.0, 0.0, 0.0), nothing(), no_state(), front, offset
    of_line, of_sample = by_ray(to_pixels, ray, focal)
    of_line, of_sample = scale(weights[0], of_line), scale(weights[1], of_sample)
    in_line = weights[0] * to_pixels[0][0], weights[0] * to_pixels[0][1]
    in_sample = weights[1] * to_pixels[1][0], weights[1] * to_pixels[1][1]
    first, second = by_point(of_line, matrix), by_point(of_sample, matrix)
    states = (
        by_state_of_ray(first, by_rotation(of_line, ray, axes), by_interior(in_line, ray)),
        by_state_of_ray(second, by_rotation(of_sample, ray, axes), by_interior(in_sample, ray)),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )
    residuals = weights[0] * line, weights[1] * sample, 0.0
    return residuals, (first, second, (0.0, 0.0, 0.0)), states, front, offset


@on_device
def by_shift(of_point, last):
    """Derivative by a state that begins with a shift: minus that by the point; `last` is the one by what follows."""
    return -of_point[0], -of_point[1], -of_point[2], last, 0.0, 0.0, 0.0, 0.0, 0.0


@on_device
def one_row(value, of_point, state):
    """A single row."""
    zero, none = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return (value, 0.0, 0.0), (of_point, zero, zero), (state, none, none)


@on_device
def range_rows(data, at, stride, state, point, weight):
    """Row of a range; its state is the instrument's position, and the range bias."""
    centre = add(vector(data, at, stride, 0), (state[0], state[1], state[2]))
    shares, measured = vector(data, at, stride, 3), data[at + 6 * stride]
    value, of_point, of_centre = range_residual(measured, point, centre, state[3], shares)
    return one_row(weight * value, scale(weight, of_point), by_shift(scale(-weight, of_centre), -weight))


@on_device
def ground_rows(data, at, stride, state, point):
    """Rows of an a-priori position; its state is the shift."""
    first, second = vector(data, at, stride, 3), vector(data, at, stride, 6)
    root = upper_triangle((first[0], first[1], first[2], second[0], second[1], second[2]))
    values = ground_residual(root, point, vector(data, at, stride, 0), (state[0], state[1], state[2]))
    return values, root, (by_shift(root[0], 0.0), by_shift(root[1], 0.0), by_shift(root[2], 0.0))


@on_device
def surface_rows(tables, state, point, weight):
    """Row of a height above the terrain model; its state is where the model is."""
    frame, spline = tables.terrain_frame, tables.terrain
    step = frame[2], frame[3]
    moved = subtract(point, (state[0], state[1], state[2]))
    size = float(spline.shape[0]), float(spline.shape[1])
    row, column = post_coordinates(moved, (frame[0], frame[1]), step, size)
    i, j = min(int(row), spline.shape[0] - 3), min(int(column), spline.shape[1] - 3)
    around = (
        (spline[i - 1, j - 1], spline[i - 1, j], spline[i - 1, j + 1], spline[i - 1, j + 2]),
        (spline[i, j - 1], spline[i, j], spline[i, j + 1], spline[i, j + 2]),
        (spline[i + 1, j - 1], spline[i + 1, j], spline[i + 1, j + 1], spline[i + 1, j + 2]),
        (spline[i + 2, j - 1], spline[i + 2, j], spline[i + 2, j + 1], spline[i + 2, j + 2]),
    )
    height, slope = height_above(moved, cubic(column - j, row - i, around), step)
    slope = scale(weight, slope)
    return one_row(weight * height, slope, by_shift(slope, 0.0))


@on_device
def stereo_rows(data, at, stride, state, point, weight):
    """Row of a height above a stereo surface; its state is what both images' corrections add."""
    normal = vector(data, at, stride, 3)
    value = linear_height(data[at + 6 * stride], normal, point, vector(data, at, stride, 0), state[0])
    none = (weight, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return one_row(weight * value, scale(weight, normal), none)


@on_device
def observation_rows(tables, model, data, x, piece, i, lane, point, active, weights):
    """Rows of observation i of a piece's point `lane`: residuals (3), by the point (3 x 3), by the state (3 x 9);
    whether the point is before its camera; and lines from the reference line to the one whose pose is used.
    """
    kind = tables.observation[i, KIND]
    at, stride = constants(tables, piece, i, lane)
    state, rate = correction(tables, data, x, i, at, stride, (kind == IMAGE) & (model.line == PREDICTED))
    if kind == IMAGE:
        return image_rows(tables, model, data, i, at, stride, state, rate, point, weights)
    residuals, of_point, of_state = (0.0, 0.0, 0.0), nothing(), no_state()
    if kind == GROUND:
        if active:
            residuals, of_point, of_state = ground_rows(data, at, stride, state, point)
    elif weights[0] > 0.0:
        if kind == RANGE:
            residuals, of_point, of_state = range_rows(data, at, stride, state, point, weights[0])
        elif kind == STEREO:
            residuals, of_point, of_state = stereo_rows(data, at, stride, state, point, weights[0])
        else:
            residuals, of_point, of_state = surface_rows(tables, state, point, weights[0])
    return residuals, of_point, of_state, True, 0.0


@on_device
def loss_of(model, robust, kind, residuals):
    """Cost of an observation's rows, and the weight that its squares have with a robust loss."""
    square = residuals[0] * residuals[0] + residuals[1] * residuals[1] + residuals[2] * residuals[2]
    measured = (kind == IMAGE) | (kind == RANGE) | (kind == STEREO)
    if model.loss == NO_LOSS or not (robust and measured):
        return 0.5 * square, 1.0
    if model.loss == HUBER:
        return huber(square, model.width)
    if model.loss == CAUCHY:
        return cauchy(square, model.width)
    return tukey(square, model.width)



AT, FACTOR, FORWARD, NUMBERS = 0, 3, 9, 12
"""Rows of what a solve leaves of each point: coordinates at which its rows are taken; L of V = L L', with 1 / L_jj for
L_jj; L^-1 times the gradient."""


@on_device
def weights_of(weight, k, active):
    """Both weights of the k-th observation; zero of a point that takes no part."""
    return (weight[0, k], weight[1, k]) if active else (0.0, 0.0)


@on_device
def normal_equations(tables, model, data, weight, x, piece, lane, point, active, robust, status):
    """Cost, normal matrix (00, 10, 11, 20, 21, 22) and gradient of a point, and its status."""
    v00 = v10 = v11 = v20 = v21 = v22 = g0 = g1 = g2 = cost = 0.0
    pattern = tables.piece[piece, PATTERN]
    begin = tables.pattern[pattern, BEGIN]
    for i in range(begin, tables.pattern[pattern, END]):
        weights = weights_of(weight, place_among(tables, piece, i - begin, lane), active)
        r, b, _, front, _ = observation_rows(tables, model, data, x, piece, i, lane, point, active, weights)
        if (not front) and weights[0] > 0.0:
            status = BEHIND
        more, w = loss_of(model, robust, tables.observation[i, KIND], r)
        cost += more
        (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = b
        v00 += w * (a0 * a0 + b0 * b0 + c0 * c0)
        v10 += w * (a1 * a0 + b1 * b0 + c1 * c0)
        v11 += w * (a1 * a1 + b1 * b1 + c1 * c1)
        v20 += w * (a2 * a0 + b2 * b0 + c2 * c0)
        v21 += w * (a2 * a1 + b2 * b1 + c2 * c1)
        v22 += w * (a2 * a2 + b2 * b2 + c2 * c2)
        g0 += w * (a0 * r[0] + b0 * r[1] + c0 * r[2])
        g1 += w * (a1 * r[0] + b1 * r[1] + c1 * r[2])
        g2 += w * (a2 * r[0] + b2 * r[1] + c2 * r[2])
    return cost, (v00, v10, v11, v20, v21, v22), (g0, g1, g2), status


@on_device
def factorise(normal, gradient):
    """L of the normal matrix, with 1 / L_jj for L_jj, L^-1 times the gradient, and whether no pivot is lost; else L is
    endless: the point neither moves nor couples.
    """
    v00, v10, v11, v20, v21, v22 = normal
    zero = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not v00 > 0.0:
        return zero, (0.0, 0.0, 0.0), False
    i00 = 1.0 / math.sqrt(v00)
    l10, l20 = v10 * i00, v20 * i00
    d1 = v11 - l10 * l10
    if not d1 > SINGULAR * v11:
        return zero, (0.0, 0.0, 0.0), False
    i11 = 1.0 / math.sqrt(d1)
    l21 = (v21 - l20 * l10) * i11
    d2 = v22 - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * v22:
        return zero, (0.0, 0.0, 0.0), False
    i22 = 1.0 / math.sqrt(d2)
    y0 = gradient[0] * i00
    y1 = (gradient[1] - l10 * y0) * i11
    y2 = (gradient[2] - l20 * y0 - l21 * y1) * i22
    return (i00, l10, i11, l20, l21, i22), (y0, y1, y2), True


@on_device
def back(factor, forward):
    """L^-T times a vector."""
    x2 = forward[2] * factor[5]
    x1 = (forward[1] - factor[4] * x2) * factor[2]
    return (forward[0] - factor[1] * x1 - factor[3] * x2) * factor[0], x1, x2


@on_device
def solved(tables, model, data, weight, x, piece, lane, point, active, move):
    """Coordinates of a point's least cost, those at which its rows are taken, L, L^-1 g, status and cost."""
    pattern = tables.piece[piece, PATTERN]
    fixed = tables.pattern[pattern, KNOWN] > 0
    robust = model.loss != NO_LOSS
    plainly = bool(move and robust and not fixed)
    convexly = plainly and model.loss == TUKEY
    convex = Model(model.line, model.angles, HUBER, HUBER_WIDTH)
    slow = robust or tables.pattern[pattern, HEIGHTS] > 0
    status, cost, squared, before, steps = GOOD, 0.0, 0.0, point, 0
    factor, forward = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for _ in range(2 * INNER_STEPS):
        before = point
        cost, normal, gradient, status = normal_equations(
            tables, convex if convexly else model, data, weight, x, piece, lane, point, active,
            robust and not plainly, status,
        )
        if fixed:
            break
        factor, forward, strong = factorise(normal, gradient)
        if active and (not strong) and status == GOOD:
            status = WEAK
        if not move:
            break
        step = back(factor, forward)
        point = (point[0] - step[0], point[1] - step[1], point[2] - step[2])
        squared = forward[0] * forward[0] + forward[1] * forward[1] + forward[2] * forward[2]
        cost -= 0.5 * squared
        last, steps = not (plainly or convexly), steps + 1
        tolerance = SLOW_TOLERANCE if slow and last else PLAIN_TOLERANCE
        if (not squared >= tolerance * tolerance) or (steps == BEGINNING and not last):
            if last:
                break
            plainly, convexly, steps = False, plainly and convexly, 0
    if move and (not fixed) and squared > PLAIN_TOLERANCE * PLAIN_TOLERANCE:
        cost += 0.5 * squared  # the steps ran out: what the last one predicted doesn't count
    return point, before, factor, forward, status, cost


@kernel
def solve(tables, model, data, weight, kind, x, begin, start, move, points, states, costs, left):
    """Solve all points of a partition from `begin` (n, 3), or from `start` (n, 3) where the loss or the point wants it.

    `points` (n, 3), states (n,) and costs (n,) are where they end, the cost infinite behind a camera; `left`
    (NUMBERS, n) is what a solve leaves. Unless `move` the points stay at `begin`; states are those there, costs and
    `points` stay as they are.
    """
    p = cuda.grid(1)
    if p >= kind.size:
        return
    piece = tables.piece_of_point[p]
    lane = p - tables.piece[piece, FIRST]
    active = kind[p] != OUT
    anew = move and (model.loss != NO_LOSS or tables.pattern[tables.piece[piece, PATTERN], KNOWN] > 0)
    point = (start[p, 0], start[p, 1], start[p, 2]) if anew else (begin[p, 0], begin[p, 1], begin[p, 2])
    point, before, factor, forward, status, cost = solved(
        tables, model, data, weight, x, piece, lane, point, active, move
    )
    if move:
        for j in range(3):
            points[p, j] = point[j]
        costs[p] = math.inf if status == BEHIND else cost
    states[p] = status
    for j in range(3):
        left[AT + j, p] = before[j]
        left[FORWARD + j, p] = forward[j]
    for j in range(6):
        left[FACTOR + j, p] = factor[j]


@on_device
def left_of(left, p):
    """Coordinates, L and L^-1 g that a solve has left of a point."""
    factor = left[3, p], left[4, p], left[5, p], left[6, p], left[7, p], left[8, p]
    return (left[0, p], left[1, p], left[2, p]), factor, (left[9, p], left[10, p], left[11, p])


@kernel
def sum_costs(tables, costs, sums):
    """Costs (m,) of a partition's pieces, a block of threads a piece; always in the same order."""
    of_thread = cuda.shared.array(THREADS, np.float64)
    piece, t = cuda.blockIdx.x, cuda.threadIdx.x
    first, total = tables.piece[piece, FIRST], 0.0
    for p in range(first + t, first + tables.piece[piece, COUNT], THREADS):
        total += costs[p]
    of_thread[t] = total
    cuda.syncthreads()
    if t == 0:
        total = 0.0
        for k in range(THREADS):
            total += of_thread[k]
        sums[piece] = total
