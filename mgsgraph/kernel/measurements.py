"""Rows of all measurements of a tile: one loop over lanes around the equations of each (`mgsgraph.factors`).

Each loop reads the registers of the measurement that is worked on and the coordinates of the points, and leaves
RESIDUAL, BY_POINT and BY_STATE at ROWS, whitened; zero where a row takes no part. Each is compiled by itself, and only
where a network has such measurements: the kernel calls it where it lies (`Loops`).
"""

from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.compiled import address_of, cached_kernel
from mgsgraph.factors.algebra import add, subtract, transform
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
from mgsgraph.factors.loss import cauchy, huber, tukey
from mgsgraph.factors.pose import about_axes, opk_paper, opk_peer, perspective_centre
from mgsgraph.factors.ranging import range_residual
from mgsgraph.factors.stereo_surface import linear_height
from mgsgraph.factors.surface import cubic, height_above, post_coordinates
from mgsgraph.kernel.lanes import (
    ACTIVE,
    ANGULAR_RATE,
    BY_POINT,
    BY_STATE,
    CONSTANTS,
    COST,
    DELTA,
    DETECTOR,
    DISTANCE,
    FOCAL,
    FRONT,
    GRADIENT,
    LANES,
    LINE_OFFSET,
    NEWTON_STEP,
    NOMINAL,
    NORMAL,
    OF_ANY,
    OF_MEASURED,
    OF_PREDICTED,
    OF_ROWS,
    POINT,
    POSITION,
    RATE,
    REFERENCE_OFFSET,
    RESIDUAL,
    RESULT,
    ROOT,
    ROW,
    ROWS,
    ROWS_SQUARED,
    SCALE,
    SLOPE,
    STATE_WIDTH,
    STATUS,
    TILE,
    VELOCITY,
    WEIGHT,
    call,
    inlined,
    lane,
    place_of,
    registers_at,
)
from mgsgraph.kernel.rows import (
    BEHIND,
    CAMERA,
    CAUCHY,
    GROUND,
    HUBER,
    IMAGE,
    MEASURED,
    NO_LOSS,
    OPK_PAPER,
    OPK_PEER,
    PREDICTED,
    RANGE,
    STEREO,
    SURFACE,
    TUKEY,
    Model,
    Rows,
)
from mgsgraph.kernel.tile import copy_block, correct, observations_of

kernel = partial(cached_kernel, fastmath={"contract", "nsz"}, _nrt=False)
"""Compile a part of the sweep by itself: it makes no array."""

_C = CONSTANTS
_FIRST_ROW, _SECOND_ROW, _BY_STATE = ROWS + BY_POINT, ROWS + BY_POINT + ROW, ROWS + BY_STATE


@inlined
def vector(w, register, l):
    """Three registers of a lane."""
    return w[register + l], w[register + LANES + l], w[register + 2 * LANES + l]


@inlined
def put(w, register, l, values, used):
    """Three registers of a lane, zero where they aren't used."""
    w[register + l] = values[0] if used else 0.0
    w[register + LANES + l] = values[1] if used else 0.0
    w[register + 2 * LANES + l] = values[2] if used else 0.0


def _image_loop(attitude_of, predicted, interior):
    """The loop over image rays of one form of the model: `attitude_of` is one of `factors.pose`, `interior` whether the
    interior orientation is unknown.
    """

    @kernel
    def image_loop(place):
        """Rows of an image observation with the pose of LINE_OFFSET; NEWTON_STEP is left how far the predicted line is
        from there. `place` is that of the registers.
        """
        w = registers_at(place)
        for l in range(LANES):
            line_offset = w[ROWS + LINE_OFFSET + l] if predicted else 0.0
            velocity = vector(w, _C + VELOCITY, l) if predicted else (0.0, 0.0, 0.0)
            angular_rate = vector(w, _C + ANGULAR_RATE, l) if predicted else (0.0, 0.0, 0.0)
            nominal = (*vector(w, _C + NOMINAL, l), w[_C + NOMINAL + 3 * LANES + l])
            rate = vector(w, RATE + 3 * LANES, l) if predicted else (0.0, 0.0, 0.0)
            theta = vector(w, DELTA + 3 * LANES, l)
            attitude, axes, camera_rate = attitude_of(nominal, angular_rate, line_offset, theta, rate)
            centre = perspective_centre(vector(w, _C + POSITION, l), velocity, line_offset, vector(w, DELTA, l))
            ray = transform(attitude, subtract(vector(w, POINT, l), centre))
            x, y, longer = vector(w, DELTA + 6 * LANES, l) if interior else (0.0, 0.0, 0.0)
            focal, detector = w[_C + FOCAL + l] + longer, (w[_C + DETECTOR + l] + x, w[_C + DETECTOR + LANES + l] + y)
            image = focal_plane(ray, focal)
            if predicted:
                motion = ray_motion(attitude, ray, add(velocity, vector(w, RATE, l)), camera_rate)
                slope = w[_C + SLOPE + l], w[_C + SLOPE + LANES + l]
                scale = to_lines_and_samples(image_motion(ray, motion, focal), slope)
            else:
                scale = (
                    (w[_C + SCALE + l], w[_C + SCALE + LANES + l]),
                    (w[_C + SCALE + 2 * LANES + l], w[_C + SCALE + 3 * LANES + l]),
                )
            beyond = w[_C + REFERENCE_OFFSET + l] + line_offset if predicted else 0.0
            line, sample = residual(scale, image, detector, beyond)
            of_line, of_sample = by_ray(scale, ray, focal)
            weight_line, weight_sample = w[_C + WEIGHT + l] * w[ACTIVE + l], w[_C + WEIGHT + LANES + l] * w[ACTIVE + l]
            front, wanted = ray[2] > 0.0, weight_line > 0.0
            used = front & wanted
            w[ROWS + FRONT + l] = 1.0 if front else 0.0
            w[STATUS + l] = w[STATUS + l] if front | (not wanted) else BEHIND
            w[NEWTON_STEP + l] = line + beyond if used else 0.0
            w[ROWS + RESIDUAL + l] = weight_line * line if used else 0.0
            w[ROWS + RESIDUAL + ROW + l] = weight_sample * sample if used else 0.0
            of_line = weight_line * of_line[0], weight_line * of_line[1], weight_line * of_line[2]
            of_sample = weight_sample * of_sample[0], weight_sample * of_sample[1], weight_sample * of_sample[2]
            put(w, _FIRST_ROW, l, by_point(of_line, attitude), used)
            put(w, _SECOND_ROW, l, by_point(of_sample, attitude), used)
            put(w, _BY_STATE + 3 * LANES, l, by_rotation(of_line, ray, axes), used)
            put(w, _BY_STATE + ROW + 3 * LANES, l, by_rotation(of_sample, ray, axes), used)
            if interior:
                in_line = weight_line * scale[0][0], weight_line * scale[0][1]
                in_sample = weight_sample * scale[1][0], weight_sample * scale[1][1]
                put(w, _BY_STATE + 6 * LANES, l, by_interior(in_line, ray), used)
                put(w, _BY_STATE + ROW + 6 * LANES, l, by_interior(in_sample, ray), used)
        for row in range(2):  # by position: minus by point
            for r in range(3 * LANES):
                w[_BY_STATE + row * ROW + r] = -w[_FIRST_ROW + row * ROW + r]

    return image_loop


@lane
def next_line(w):
    """Move LINE_OFFSET on to the predicted line, lane by lane, unless it is near; whether any lane has moved."""
    moved = False
    for l in range(LANES):
        far = abs(w[NEWTON_STEP + l]) >= NEWTON_TOLERANCE
        w[ROWS + LINE_OFFSET + l] -= w[NEWTON_STEP + l] if far else 0.0
        moved |= far
    return moved


@inlined
def image_rows(rows, model, segments, count, i, x, w, s, loops):
    """Rows of image observation i: at the predicted line by Newton's method, or at the measured one."""
    predicted, loop = model.line == PREDICTED, loops.image_interior if rows.observation_width[i] > 6 else loops.image
    copy_block(w, s, _C, OF_PREDICTED if predicted else OF_MEASURED)
    for l in range(LANES):
        w[ROWS + LINE_OFFSET + l] = 0.0
    for step in range(NEWTON_STEPS if predicted else 1):
        correct(rows, segments, count, i, x, w, s, predicted)
        call(loop, (place_of(w),))
        if predicted and (step == NEWTON_STEPS - 1 or not next_line(w)):
            break


@kernel
def range_rows(place):
    """Row of a range; its state is the instrument's position, and the range bias."""
    w = registers_at(place)
    for l in range(LANES):
        weight = w[_C + WEIGHT + l] * w[ACTIVE + l]
        used = weight > 0.0
        centre, bias = add(vector(w, _C + POSITION, l), vector(w, DELTA, l)), w[DELTA + 3 * LANES + l]
        shares, measured = vector(w, _C + ROOT, l), w[_C + DISTANCE + l]
        value, of_point, of_centre = range_residual(measured, vector(w, POINT, l), centre, bias, shares)
        w[ROWS + RESIDUAL + l] = weight * value if used else 0.0
        put(w, _FIRST_ROW, l, (weight * of_point[0], weight * of_point[1], weight * of_point[2]), used)
        put(w, _BY_STATE, l, (weight * of_centre[0], weight * of_centre[1], weight * of_centre[2]), used)
        w[_BY_STATE + 3 * LANES + l] = -weight


@kernel
def ground_rows(place):
    """Rows of an a-priori position; its state is the shift."""
    w = registers_at(place)
    for l in range(LANES):
        used = w[ACTIVE + l] > 0.0
        root = upper_triangle((*vector(w, _C + ROOT, l), *vector(w, _C + ROOT + 3 * LANES, l)))
        values = ground_residual(root, vector(w, POINT, l), vector(w, _C + POSITION, l), vector(w, DELTA, l))
        for row in range(3):
            w[ROWS + RESIDUAL + row * ROW + l] = values[row] if used else 0.0
            of_point = root[row]
            put(w, _FIRST_ROW + row * ROW, l, of_point, used)
            put(w, _BY_STATE + row * ROW, l, (-of_point[0], -of_point[1], -of_point[2]), used)


@kernel
def surface_rows(place, terrain_frame, terrain):
    """Row of a height above the terrain model; its state is where the model is."""
    w, frame, spline = registers_at(place), terrain_frame, terrain
    first, step, last = (frame[0], frame[1]), (frame[2], frame[3]), (spline.shape[0] - 3, spline.shape[1] - 3)
    for r in range(LANES):
        w[ROWS + RESIDUAL + r] = 0.0
    for r in range(3 * LANES):
        w[_FIRST_ROW + r] = 0.0
    for l in range(LANES):
        weight = w[_C + WEIGHT + l] * w[ACTIVE + l]
        if weight > 0.0:
            moved = subtract(vector(w, POINT, l), vector(w, DELTA, l))
            row, column = post_coordinates(moved, first, step, spline.shape)
            i, j = min(int(row), last[0]), min(int(column), last[1])
            around = (
                (spline[i - 1, j - 1], spline[i - 1, j], spline[i - 1, j + 1], spline[i - 1, j + 2]),
                (spline[i, j - 1], spline[i, j], spline[i, j + 1], spline[i, j + 2]),
                (spline[i + 1, j - 1], spline[i + 1, j], spline[i + 1, j + 1], spline[i + 1, j + 2]),
                (spline[i + 2, j - 1], spline[i + 2, j], spline[i + 2, j + 1], spline[i + 2, j + 2]),
            )
            height, slope = height_above(moved, cubic(column - j, row - i, around), step)
            w[ROWS + RESIDUAL + l] = weight * height
            put(w, _FIRST_ROW, l, (weight * slope[0], weight * slope[1], weight * slope[2]), True)
    for r in range(3 * LANES):
        w[_BY_STATE + r] = -w[_FIRST_ROW + r]


@kernel
def stereo_rows(place):
    """Row of a height above a stereo surface; its state is what both images' corrections add."""
    w = registers_at(place)
    for l in range(LANES):
        weight = w[_C + WEIGHT + l] * w[ACTIVE + l]
        used, normal = weight > 0.0, vector(w, _C + ROOT, l)
        point, reference = vector(w, POINT, l), vector(w, _C + POSITION, l)
        value = linear_height(w[_C + DISTANCE + l], normal, point, reference, w[DELTA + l])
        w[ROWS + RESIDUAL + l] = weight * value if used else 0.0
        put(w, _FIRST_ROW, l, (weight * normal[0], weight * normal[1], weight * normal[2]), used)
        w[_BY_STATE + l] = weight


@inlined
def row_count(kind):
    """Rows of an observation."""
    return 2 if kind == IMAGE else 3 if kind == GROUND else 1


@lane
def sum_squares(count, w):
    """Squared norm of the rows, in ROWS_SQUARED."""
    for l in range(LANES):
        w[ROWS_SQUARED + l] = w[ROWS + RESIDUAL + l] * w[ROWS + RESIDUAL + l]
    for row in range(1, count):
        for l in range(LANES):
            w[ROWS_SQUARED + l] += w[ROWS + RESIDUAL + row * ROW + l] * w[ROWS + RESIDUAL + row * ROW + l]


def _loss_loop(loss):
    """The loop of one loss, of `factors.loss`."""

    @kernel
    def loss_loop(place, width, count, components):
        """Add an observation's loss to COST and scale its rows by the root of the loss's weight."""
        w = registers_at(place)
        for l in range(LANES):
            cost, weight = loss(w[ROWS_SQUARED + l], width)
            w[COST + l] += cost
            w[ROWS_SQUARED + l] = np.sqrt(weight)
        for row in range(count):
            for c in range(1 + 3 + components):
                for l in range(LANES):
                    w[ROWS + RESIDUAL + row * ROW + c * LANES + l] *= w[ROWS_SQUARED + l]

    return loss_loop


_ATTITUDES = {CAMERA: about_axes, OPK_PAPER: opk_paper, OPK_PEER: opk_peer}
_IMAGE_LOOPS = {
    (angles, line, interior): _image_loop(attitude_of, line == PREDICTED, interior)
    for angles, attitude_of in _ATTITUDES.items()
    for line in (PREDICTED, MEASURED)
    for interior in (False, True)
}
_LOSS_LOOPS = {HUBER: _loss_loop(huber), CAUCHY: _loss_loop(cauchy), TUKEY: _loss_loop(tukey)}


class Loops(NamedTuple):
    """Where the loops over lanes lie; 0 for one that no observation needs."""

    image: int
    image_interior: int
    """Of rays whose image's interior orientation is unknown."""
    range: int
    ground: int
    surface: int
    stereo: int
    huber: int
    loss: int
    """Of the model's loss."""


def loops_of(rows: Rows, model: Model) -> Loops:
    """The loops that observations (s,) of rows need, compiled or loaded."""
    kinds, widths = rows.observation_kind, rows.observation_width
    image, interior = (_IMAGE_LOOPS[model.angles, model.line, interior] for interior in (False, True))
    used = {
        image: (kinds == IMAGE) & (widths <= 6), interior: (kinds == IMAGE) & (widths > 6), range_rows: kinds == RANGE,
        ground_rows: kinds == GROUND, surface_rows: kinds == SURFACE, stereo_rows: kinds == STEREO,
    }  # fmt: skip
    needed = [loop if wanted.any() else None for loop, wanted in used.items()]
    needed += [_LOSS_LOOPS[HUBER], _LOSS_LOOPS[model.loss]] if model.loss != NO_LOSS else [None, None]
    return Loops(*(0 if loop is None else place_of_loop(loop) for loop in needed))


@cache
def place_of_loop(loop: Any) -> Any:
    """Where a loop lies, compiled or loaded."""
    terrain = np.zeros((0, 0))
    terrain.flags.writeable = False
    numbers = {"place": 0, "width": 0.0, "count": 0, "components": 0}
    return address_of(loop, numbers | {"terrain": terrain, "terrain_frame": np.zeros(0)})


@lane
def add_rows(model, robust, kind, width, w, loops):
    """Add an observation's rows to COST, with the loss if `robust`, and to NORMAL (00, 10, 11, 20, 21, 22) and
    GRADIENT.
    """
    count = row_count(kind)
    sum_squares(count, w)
    if not robust:
        for l in range(LANES):
            w[COST + l] += 0.5 * w[ROWS_SQUARED + l]
    else:
        call(loops.huber if model.loss == HUBER else loops.loss, (place_of(w), model.width, count, width))
    for row in range(count):
        p, r = _FIRST_ROW + row * ROW, ROWS + RESIDUAL + row * ROW
        for l in range(LANES):
            (a, b, c), value = vector(w, p, l), w[r + l]
            w[NORMAL + l] += a * a
            w[NORMAL + LANES + l] += b * a
            w[NORMAL + 2 * LANES + l] += b * b
            w[NORMAL + 3 * LANES + l] += c * a
            w[NORMAL + 4 * LANES + l] += c * b
            w[NORMAL + 5 * LANES + l] += c * c
            w[GRADIENT + l] += a * value
            w[GRADIENT + LANES + l] += b * value
            w[GRADIENT + 2 * LANES + l] += c * value


@inlined
def all_rows(rows, model, robust, segments, count, x, w, depth, store_rows, loops):
    """Rows of all observations at POINT, their COST and normal equations; if `store_rows` the rows go to the
    observations' own registers.
    """
    for l in range(LANES):
        w[COST + l] = 0.0
    for r in range(9 * LANES):
        w[NORMAL + r] = 0.0
    begin, end = observations_of(rows, segments)
    for i in range(begin, end):
        s, kind = TILE + (i - begin) * depth, rows.observation_kind[i]
        if kind == IMAGE:
            image_rows(rows, model, segments, count, i, x, w, s, loops)
        else:
            copy_block(w, s, _C, OF_ANY)
            correct(rows, segments, count, i, x, w, s, False)
            if kind == SURFACE:
                call(loops.surface, (place_of(w), rows.terrain_frame, rows.terrain))
            else:
                loop = loops.range if kind == RANGE else loops.ground if kind == GROUND else loops.stereo
                call(loop, (place_of(w),))
        measured = kind == IMAGE or kind == RANGE or kind == STEREO
        add_rows(model, robust and measured, kind, rows.observation_width[i], w, loops)
        if store_rows:
            unused = STATE_WIDTH - rows.observation_width[i]  # of the last row
            copy_block(w, ROWS, s + RESULT, OF_ROWS[row_count(kind)] - unused * LANES)
