"""Rows of an observation at a point: the equations of `factors`, as a thread calls them.

Rows are whitened: three residuals, their derivatives by the point (3 x 3) and by the observation's state (3 x 9); what
an observation hasn't, or what takes no part, is zero.
"""

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
    ray_motion,
    residual,
    to_lines_and_samples,
)
from mgsgraph.factors.ground import ground_residual, upper_triangle
from mgsgraph.factors.laser_range import range_residual
from mgsgraph.factors.loss import cauchy, huber, tukey
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer, perspective_centre
from mgsgraph.factors.stereo_surface import stereo_height
from mgsgraph.factors.surface import cubic, height_above, post_coordinates
from mgsgraph.kernel.cuda.device import on_device
from mgsgraph.kernel.cuda.loading import constants, correction, vector
from mgsgraph.kernel.cuda.tables import KIND
from mgsgraph.kernel.rows import (
    CAMERA,
    CAUCHY,
    GROUND,
    HUBER,
    IMAGE,
    NO_LOSS,
    OPK_PAPER,
    PREDICTED,
    RANGE,
    STEREO,
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
        velocity, turning = vector(data, k, stride, 2), vector(data, k, stride, 5)
        slope, to_reference = (data[k + 8 * stride], data[k + 9 * stride]), data[k + 10 * stride]
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
    value, of_point = range_residual(data[at + 3 * stride], point, centre, state[3])
    of_point = scale(weight, of_point)
    return one_row(weight * value, of_point, by_shift(of_point, -weight))


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
    value = stereo_height(data[at + 6 * stride], normal, point, vector(data, at, stride, 0), state[0])
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
