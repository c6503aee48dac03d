"""Pushbroom projection: the image row pair of a point. Yoon & Shan 2005, Eq. 1 and 2, with +Z out of the lens.

Residual [measured - predicted line, measured - predicted sample], whitened. In the strict form the predicted line is
found by Newton's method, with pose and basis carried there by their rates; in the papers' form the pose is taken at the
measured line and the misplacement is divided by the nominal image motion.
"""

from mgsgraph.factors.lanes import (
    ACTIVE,
    BY_POINT,
    BY_STATE,
    CARRY,
    CENTRE,
    CHAIN,
    DELTA,
    DETECTOR,
    FRONT,
    LANES,
    MATRIX,
    PLACE,
    RATE,
    RAY,
    RESIDUAL,
    SCALE,
    SLOPE,
    STATE,
    TURNING,
    VELOCITY,
    WEIGHT,
    lane,
)
from mgsgraph.factors.pose import angle_attitude, camera_attitude, correct
from mgsgraph.factors.rows import BEHIND, CAMERA, MEASURED

_NEWTON_STEPS = 5
_NEWTON_TOLERANCE = 1e-4
"""Lines; the last step is taken linearly, in the residual itself. One step does it unless the misfit is of tens of
lines. The Jacobian is that of the implicit function, wrong by this over the image's length in lines."""


@lane
def image_rows(rows, model, sight, x, n, w, s, width):
    """RESIDUAL, BY_POINT and BY_STATE (`width` 6, or 7 with the focal length) of an image sight of n points."""
    predicted = model.line != MEASURED
    focal = rows.sight_focal[sight]
    for step in range(_NEWTON_STEPS):
        camera_ray(rows, model, sight, x, n, w, s, width, predicted)
        if not predicted or line_step(focal, n, w, s, step < _NEWTON_STEPS - 1) < _NEWTON_TOLERANCE:
            break
    residuals(focal, n, w, s, width, predicted)
    by_state(n, w, s)


@lane
def camera_ray(rows, model, sight, x, n, w, s, width, rates):
    """RAY: the point in camera axes (a, b, c), CARRY lines from the measured one, and if `rates` its rate per line."""
    correct(rows, sight, x, n, w, s, width, rates)
    if model.angles == CAMERA:
        camera_attitude(n, w, s, rates)
    else:
        angle_attitude(n, w, s, model.angles)
    for l in range(n):
        w[RAY + 3 * LANES + l] = w[PLACE + l] - w[s + CENTRE + l] - w[DELTA + l]
        w[RAY + 4 * LANES + l] = w[PLACE + LANES + l] - w[s + CENTRE + LANES + l] - w[DELTA + LANES + l]
        w[RAY + 5 * LANES + l] = w[PLACE + 2 * LANES + l] - w[s + CENTRE + 2 * LANES + l] - w[DELTA + 2 * LANES + l]
    for j in range(3 if rates else 0):
        for l in range(n):
            w[RAY + (3 + j) * LANES + l] -= w[s + CARRY + l] * w[s + VELOCITY + j * LANES + l]
    for l in range(n):
        d0, d1, d2 = w[RAY + 3 * LANES + l], w[RAY + 4 * LANES + l], w[RAY + 5 * LANES + l]
        a = w[MATRIX + l] * d0 + w[MATRIX + LANES + l] * d1 + w[MATRIX + 2 * LANES + l] * d2
        b = w[MATRIX + 3 * LANES + l] * d0 + w[MATRIX + 4 * LANES + l] * d1 + w[MATRIX + 5 * LANES + l] * d2
        c = w[MATRIX + 6 * LANES + l] * d0 + w[MATRIX + 7 * LANES + l] * d1 + w[MATRIX + 8 * LANES + l] * d2
        w[RAY + l], w[RAY + LANES + l], w[RAY + 2 * LANES + l] = a, b, c
    if rates:
        ray_rates(n, w, s, model.angles == CAMERA)


@lane
def ray_rates(n, w, s, camera):
    """Rate of RAY per line: the camera moves and turns, nominally and by the correction."""
    for l in range(n):
        r0, r1, r2 = w[RATE + 3 * LANES + l], w[RATE + 4 * LANES + l], w[RATE + 5 * LANES + l]
        w0, w1, w2 = 0.0, 0.0, 0.0
        if camera:
            # the nominal turning, in axes turned by the correction: (1 - [theta]x CHAIN) is Exp([theta]x)'
            t0, t1, t2 = w[s + TURNING + l], w[s + TURNING + LANES + l], w[s + TURNING + 2 * LANES + l]
            u0 = w[CHAIN + l] * t0 + w[CHAIN + LANES + l] * t1 + w[CHAIN + 2 * LANES + l] * t2
            u1 = w[CHAIN + 3 * LANES + l] * t0 + w[CHAIN + 4 * LANES + l] * t1 + w[CHAIN + 5 * LANES + l] * t2
            u2 = w[CHAIN + 6 * LANES + l] * t0 + w[CHAIN + 7 * LANES + l] * t1 + w[CHAIN + 8 * LANES + l] * t2
            a0, a1, a2 = w[DELTA + 3 * LANES + l], w[DELTA + 4 * LANES + l], w[DELTA + 5 * LANES + l]
            w0, w1, w2 = t0 - (a1 * u2 - a2 * u1), t1 - (a2 * u0 - a0 * u2), t2 - (a0 * u1 - a1 * u0)
        else:
            r0 += w[s + TURNING + l]
            r1 += w[s + TURNING + LANES + l]
            r2 += w[s + TURNING + 2 * LANES + l]
        w0 += w[CHAIN + l] * r0 + w[CHAIN + LANES + l] * r1 + w[CHAIN + 2 * LANES + l] * r2
        w1 += w[CHAIN + 3 * LANES + l] * r0 + w[CHAIN + 4 * LANES + l] * r1 + w[CHAIN + 5 * LANES + l] * r2
        w2 += w[CHAIN + 6 * LANES + l] * r0 + w[CHAIN + 7 * LANES + l] * r1 + w[CHAIN + 8 * LANES + l] * r2
        s0 = w[s + VELOCITY + l] + w[RATE + l]
        s1 = w[s + VELOCITY + LANES + l] + w[RATE + LANES + l]
        s2 = w[s + VELOCITY + 2 * LANES + l] + w[RATE + 2 * LANES + l]
        a, b, c = w[RAY + l], w[RAY + LANES + l], w[RAY + 2 * LANES + l]
        m0 = w[MATRIX + l] * s0 + w[MATRIX + LANES + l] * s1 + w[MATRIX + 2 * LANES + l] * s2
        m1 = w[MATRIX + 3 * LANES + l] * s0 + w[MATRIX + 4 * LANES + l] * s1 + w[MATRIX + 5 * LANES + l] * s2
        m2 = w[MATRIX + 6 * LANES + l] * s0 + w[MATRIX + 7 * LANES + l] * s1 + w[MATRIX + 8 * LANES + l] * s2
        w[RAY + 3 * LANES + l] = b * w2 - c * w1 - m0
        w[RAY + 4 * LANES + l] = c * w0 - a * w2 - m1
        w[RAY + 5 * LANES + l] = a * w1 - b * w0 - m2


@lane
def line_step(focal, n, w, s, move):
    """One step of Newton's method on the line where the point's image falls on the detector; its largest size.

    CARRY moves on, if `move`, unless the step is small in all lanes. The image's motion per line is left in RAY.
    """
    largest = 0.0
    for l in range(n):
        c = w[RAY + 2 * LANES + l]
        scale = (focal + w[DELTA + 6 * LANES + l]) / c
        px, py = scale * w[RAY + l], scale * w[RAY + LANES + l]
        mx = scale * w[RAY + 3 * LANES + l] - px * w[RAY + 5 * LANES + l] / c
        my = scale * w[RAY + 4 * LANES + l] - py * w[RAY + 5 * LANES + l] / c
        ex, ey = px - w[s + DETECTOR + l], py - w[s + DETECTOR + LANES + l]
        slope_x, slope_y = w[s + SLOPE + l], w[s + SLOPE + LANES + l]
        step = (ex * slope_y - ey * slope_x) / (mx * slope_y - my * slope_x)
        step = step if (c > 0.0) & (w[ACTIVE + l] * w[s + WEIGHT + l] > 0.0) else 0.0
        w[RAY + 3 * LANES + l] = mx
        w[RAY + 4 * LANES + l] = my
        w[RAY + 5 * LANES + l] = step
        largest = max(largest, abs(step))
    if move and largest >= _NEWTON_TOLERANCE:
        for l in range(n):
            w[s + CARRY + l] -= w[RAY + 5 * LANES + l]
    return largest


@lane
def residuals(focal, n, w, s, width, predicted):
    """RESIDUAL and BY_POINT; the derivatives of the rows by (a, b, c) are left in RATE, for BY_STATE."""
    for l in range(n):
        a, b, c = w[RAY + l], w[RAY + LANES + l], w[RAY + 2 * LANES + l]
        weight_line, weight_sample = w[s + WEIGHT + l] * w[ACTIVE + l], w[s + WEIGHT + LANES + l] * w[ACTIVE + l]
        front, used = c > 0.0, weight_line > 0.0
        w[s + FRONT + l] = 1.0 if front else 0.0
        w[STATE + l] = w[STATE + l] if front | (not used) else BEHIND
        good = front & used
        scale = (focal + w[DELTA + 6 * LANES + l]) / c
        u, v = a / c, b / c
        px, py = scale * a, scale * b
        ex, ey = px - w[s + DETECTOR + l], py - w[s + DETECTOR + LANES + l]
        if predicted:
            mx, my = w[RAY + 3 * LANES + l], w[RAY + 4 * LANES + l]
            slope_x, slope_y = w[s + SLOPE + l], w[s + SLOPE + LANES + l]
            determinant = mx * slope_y - my * slope_x
            p00, p01, p10, p11 = slope_y / determinant, -slope_x / determinant, -my / determinant, mx / determinant
        else:
            p00, p01 = w[s + SCALE + l], w[s + SCALE + LANES + l]
            p10, p11 = w[s + SCALE + 2 * LANES + l], w[s + SCALE + 3 * LANES + l]
        line = weight_line * (p00 * ex + p01 * ey - w[s + CARRY + l])
        sample = -weight_sample * (p10 * ex + p11 * ey)
        w[s + RESIDUAL + l] = line if good else 0.0
        w[s + RESIDUAL + LANES + l] = sample if good else 0.0
        gx0, gy0 = weight_line * scale * p00, weight_line * scale * p01
        gx1, gy1 = -weight_sample * scale * p10, -weight_sample * scale * p11
        gx0, gy0 = (gx0 if good else 0.0), (gy0 if good else 0.0)
        gx1, gy1 = (gx1 if good else 0.0), (gy1 if good else 0.0)
        u, v = (u if good else 0.0), (v if good else 0.0)
        w[RATE + l], w[RATE + LANES + l], w[RATE + 2 * LANES + l] = gx0, gy0, -(gx0 * u + gy0 * v)
        w[RATE + 3 * LANES + l], w[RATE + 4 * LANES + l], w[RATE + 5 * LANES + l] = gx1, gy1, -(gx1 * u + gy1 * v)
    if width == 7:  # the focal length moves the image outward
        for row in range(2):
            for l in range(n):
                outward = (
                    w[RATE + 3 * row * LANES + l] * w[RAY + l]
                    + w[RATE + (3 * row + 1) * LANES + l] * w[RAY + LANES + l]
                )
                w[s + BY_STATE + (7 * row + 6) * LANES + l] = outward / (focal + w[DELTA + 6 * LANES + l])


@lane
def by_state(n, w, s):
    """BY_POINT and the first six columns of BY_STATE: position and rotation of the camera."""
    for row in range(2):
        g, point, state = RATE + 3 * row * LANES, s + BY_POINT + 3 * row * LANES, s + BY_STATE + 7 * row * LANES
        for l in range(n):
            g0, g1, g2 = w[g + l], w[g + LANES + l], w[g + 2 * LANES + l]
            a, b, c = w[RAY + l], w[RAY + LANES + l], w[RAY + 2 * LANES + l]
            p0 = g0 * w[MATRIX + l] + g1 * w[MATRIX + 3 * LANES + l] + g2 * w[MATRIX + 6 * LANES + l]
            p1 = g0 * w[MATRIX + LANES + l] + g1 * w[MATRIX + 4 * LANES + l] + g2 * w[MATRIX + 7 * LANES + l]
            p2 = g0 * w[MATRIX + 2 * LANES + l] + g1 * w[MATRIX + 5 * LANES + l] + g2 * w[MATRIX + 8 * LANES + l]
            h0, h1, h2 = g1 * c - g2 * b, g2 * a - g0 * c, g0 * b - g1 * a
            w[point + l], w[point + LANES + l], w[point + 2 * LANES + l] = p0, p1, p2
            w[state + l], w[state + LANES + l], w[state + 2 * LANES + l] = -p0, -p1, -p2
            w[state + 3 * LANES + l] = h0 * w[CHAIN + l] + h1 * w[CHAIN + 3 * LANES + l] + h2 * w[CHAIN + 6 * LANES + l]
            w[state + 4 * LANES + l] = (
                h0 * w[CHAIN + LANES + l] + h1 * w[CHAIN + 4 * LANES + l] + h2 * w[CHAIN + 7 * LANES + l]
            )
            w[state + 5 * LANES + l] = (
                h0 * w[CHAIN + 2 * LANES + l] + h1 * w[CHAIN + 5 * LANES + l] + h2 * w[CHAIN + 8 * LANES + l]
            )
