"""The measurement equations: residuals and Jacobians of image rows and range rows, and the robust losses.

Equations (design.md section 3): image rows are Eq. 1 of Yoon & Shan 2005 with the camera's +Z out of the lens; the
predicted-line form carries pose and basis by their rates to the line that Newton's method finds; range rows are Eq. 3.

Residuals are whitened, measured minus predicted; Jacobians are theirs. All is scalar code on preallocated scratch,
compiled by numba on first use and cached on disk.
"""

import math

from numba import njit

from mgsgraph.factors.rows import CAMERA, CAUCHY, HUBER, MEASURED, NO_LOSS, OPK_PAPER

_NEWTON_STEPS = 5
_NEWTON_TOLERANCE = 1e-4
"""Lines; the last step is taken linearly, in the residual itself. One step does it unless the misfit is of tens of
lines. The Jacobian is that of the implicit function, wrong by this over the image's length in lines."""


@njit(cache=True, inline="always")
def cross(a0, a1, a2, b0, b1, b2):
    """Vector product."""
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(cache=True)
def turned_back(t0, t1, t2, v0, v1, v2):
    """Exp([t]x)' v: components of v in a frame turned by the rotation vector t (Rodrigues)."""
    square = t0 * t0 + t1 * t1 + t2 * t2
    if square < 1e-8:
        sine, half = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        sine, half = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    c0, c1, c2 = cross(t0, t1, t2, v0, v1, v2)
    d0, d1, d2 = cross(t0, t1, t2, c0, c1, c2)
    return v0 - sine * c0 + half * d0, v1 - sine * c1 + half * d1, v2 - sine * c2 + half * d2


@njit(cache=True)
def angle_chain(mode, a0, a1, a2, chain):
    """3x3 chain T of the rotation parameters: d(M d) = [M d]x T da. Rotation vector: right Jacobian of SO(3);
    omega, phi, kappa: columns are the axes about which each angle turns the camera.
    """
    if mode == CAMERA:
        square = a0 * a0 + a1 * a1 + a2 * a2
        if square < 1e-8:
            half, third = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        else:
            angle = math.sqrt(square)
            half, third = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (angle * square)
        chain[0, 0], chain[0, 1], chain[0, 2] = third * (a0 * a0 - square), third * a0 * a1, third * a0 * a2
        chain[1, 0], chain[1, 1], chain[1, 2] = third * a1 * a0, third * (a1 * a1 - square), third * a1 * a2
        chain[2, 0], chain[2, 1], chain[2, 2] = third * a2 * a0, third * a2 * a1, third * (a2 * a2 - square)
        chain[0, 0] += 1.0
        chain[1, 1] += 1.0
        chain[2, 2] += 1.0
        chain[0, 1] += half * a2
        chain[0, 2] -= half * a1
        chain[1, 0] -= half * a2
        chain[1, 2] += half * a0
        chain[2, 0] += half * a1
        chain[2, 1] -= half * a0
        return
    so, co, sp, cp, sk, ck = math.sin(a0), math.cos(a0), math.sin(a1), math.cos(a1), math.sin(a2), math.cos(a2)
    if mode == OPK_PAPER:  # M = R1(omega)' R2(phi)' R3(kappa)', camera to body being R3 R2 R1
        chain[0, 0], chain[1, 0], chain[2, 0] = -1.0, 0.0, 0.0
        chain[0, 1], chain[1, 1], chain[2, 1] = 0.0, -co, -so
        chain[0, 2], chain[1, 2], chain[2, 2] = -sp, so * cp, -co * cp
    else:  # M = R3(kappa) R2(phi) R1(omega)
        chain[0, 0], chain[1, 0], chain[2, 0] = cp * ck, -cp * sk, sp
        chain[0, 1], chain[1, 1], chain[2, 1] = sk, ck, 0.0
        chain[0, 2], chain[1, 2], chain[2, 2] = 0.0, 0.0, 1.0


@njit(cache=True)
def angle_matrix(mode, o, p, k, matrix):
    """Body-fixed to camera matrix of omega, phi, kappa in either convention."""
    so, co, sp, cp, sk, ck = math.sin(o), math.cos(o), math.sin(p), math.cos(p), math.sin(k), math.cos(k)
    r00, r01, r02 = cp * ck, co * sk + so * sp * ck, so * sk - co * sp * ck
    r10, r11, r12 = -cp * sk, co * ck - so * sp * sk, so * ck + co * sp * sk
    r20, r21, r22 = sp, -so * cp, co * cp
    if mode == OPK_PAPER:
        r01, r10, r02, r20, r12, r21 = r10, r01, r20, r02, r21, r12
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = r00, r01, r02
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = r10, r11, r12
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = r20, r21, r22


@njit(cache=True)
def correction(x, column, value, first, last, carry, delta, rate):
    """Pose correction (6) and its rate per line of the pairs first .. last, `carry` lines from the measured one."""
    for i in range(6):
        delta[i] = 0.0
        rate[i] = 0.0
    for q in range(first, last):
        basis, slope = value[q, 0] + carry * value[q, 1], value[q, 1]
        for i in range(6):
            delta[i] += basis * x[column[q] + i]
            rate[i] += slope * x[column[q] + i]


@njit(cache=True)
def camera_ray(rows, k, angles, point, carry, delta, rate, matrix, chain, out):
    """The ray to a point in camera axes and its rate per line, `carry` lines from the measured one.

    Fills matrix (3, 3) with M, chain (3, 3) with T and out (6) with (a, b, c) and their rates.
    """
    d0 = point[0] - rows.centre[k, 0, 0] - carry * rows.centre[k, 1, 0] - delta[0]
    d1 = point[1] - rows.centre[k, 0, 1] - carry * rows.centre[k, 1, 1] - delta[1]
    d2 = point[2] - rows.centre[k, 0, 2] - carry * rows.centre[k, 1, 2] - delta[2]
    s0, s1, s2 = rows.centre[k, 1, 0] + rate[0], rows.centre[k, 1, 1] + rate[1], rows.centre[k, 1, 2] + rate[2]
    if angles == CAMERA:
        w0, w1, w2 = rows.turning[k, 0], rows.turning[k, 1], rows.turning[k, 2]
        for j in range(3):  # column by column: turn M by the nominal rates, then by the correction
            m0, m1, m2 = turned_back(
                carry * w0, carry * w1, carry * w2, rows.matrix[k, 0, j], rows.matrix[k, 1, j], rows.matrix[k, 2, j]
            )
            matrix[0, j], matrix[1, j], matrix[2, j] = turned_back(delta[3], delta[4], delta[5], m0, m1, m2)
        angle_chain(CAMERA, delta[3], delta[4], delta[5], chain)
        w0, w1, w2 = turned_back(delta[3], delta[4], delta[5], w0, w1, w2)
        r0, r1, r2 = rate[3], rate[4], rate[5]
    else:
        o = rows.angles[k, 0, 0] + carry * rows.angles[k, 1, 0] + delta[3]
        p = rows.angles[k, 0, 1] + carry * rows.angles[k, 1, 1] + delta[4]
        q = rows.angles[k, 0, 2] + carry * rows.angles[k, 1, 2] + delta[5]
        angle_matrix(angles, o, p, q, matrix)
        angle_chain(angles, o, p, q, chain)
        w0, w1, w2 = 0.0, 0.0, 0.0
        r0, r1, r2 = rows.angles[k, 1, 0] + rate[3], rows.angles[k, 1, 1] + rate[4], rows.angles[k, 1, 2] + rate[5]
    w0 += chain[0, 0] * r0 + chain[0, 1] * r1 + chain[0, 2] * r2
    w1 += chain[1, 0] * r0 + chain[1, 1] * r1 + chain[1, 2] * r2
    w2 += chain[2, 0] * r0 + chain[2, 1] * r1 + chain[2, 2] * r2
    a = matrix[0, 0] * d0 + matrix[0, 1] * d1 + matrix[0, 2] * d2
    b = matrix[1, 0] * d0 + matrix[1, 1] * d1 + matrix[1, 2] * d2
    c = matrix[2, 0] * d0 + matrix[2, 1] * d1 + matrix[2, 2] * d2
    c0, c1, c2 = cross(a, b, c, w0, w1, w2)
    out[0], out[1], out[2] = a, b, c
    out[3] = c0 - matrix[0, 0] * s0 - matrix[0, 1] * s1 - matrix[0, 2] * s2
    out[4] = c1 - matrix[1, 0] * s0 - matrix[1, 1] * s1 - matrix[1, 2] * s2
    out[5] = c2 - matrix[2, 0] * s0 - matrix[2, 1] * s1 - matrix[2, 2] * s2


@njit(cache=True)
def misplacement(rows, k, out):
    """Focal-plane distance (m) of the point's image from the measured place, and its motion per line."""
    scale = rows.focal[k] / out[2]
    x, y = scale * out[0], scale * out[1]
    motion_x = scale * out[3] - x * out[5] / out[2]
    motion_y = scale * out[4] - y * out[5] / out[2]
    return x - rows.detector[k, 0, 0], y - rows.detector[k, 0, 1], motion_x, motion_y


@njit(cache=True)
def image_row(rows, k, model, x, point, scratch, residual, by_pose, by_point):
    """Whitened residual (2), its derivatives by the pose correction (2, 6) and by the point (2, 3).

    Returns the number of lines from the measured line to the one whose pose was used, and whether the point is in
    front of the camera.
    """
    delta, rate, out = scratch[0, :6], scratch[1, :6], scratch[2, :6]
    matrix, chain = scratch[3].reshape(3, 3), scratch[4].reshape(3, 3)
    first, last = rows.pair_first[k], rows.pair_first[k + 1]
    slope_x, slope_y = rows.detector[k, 1, 0], rows.detector[k, 1, 1]
    carry = 0.0
    for _ in range(_NEWTON_STEPS):
        correction(x, rows.pair_column, rows.pair_value, first, last, carry, delta, rate)
        camera_ray(rows, k, model.angles, point, carry, delta, rate, matrix, chain, out)
        if not out[2] > 0.0:
            return carry, False
        ex, ey, mx, my = misplacement(rows, k, out)
        determinant = mx * slope_y - my * slope_x
        step = (ex * slope_y - ey * slope_x) / determinant
        if model.line == MEASURED or abs(step) < _NEWTON_TOLERANCE:
            break
        carry -= step
    if model.line == MEASURED:
        p00, p01 = rows.to_pixels[k, 0, 0], rows.to_pixels[k, 0, 1]
        p10, p11 = rows.to_pixels[k, 1, 0], rows.to_pixels[k, 1, 1]
    else:
        p00, p01, p10, p11 = slope_y / determinant, -slope_x / determinant, -my / determinant, mx / determinant
    weight_line, weight_sample = rows.weight[k, 0], rows.weight[k, 1]
    residual[0] = weight_line * (p00 * ex + p01 * ey - carry)
    residual[1] = -weight_sample * (p10 * ex + p11 * ey)
    scale = rows.focal[k] / out[2]
    u, v = out[0] / out[2], out[1] / out[2]
    for row in range(2):
        if row == 0:
            gx, gy = weight_line * scale * p00, weight_line * scale * p01
        else:
            gx, gy = -weight_sample * scale * p10, -weight_sample * scale * p11
        gz = -(gx * u + gy * v)  # row vector g: d residual / d(a, b, c)
        for j in range(3):
            slope = gx * matrix[0, j] + gy * matrix[1, j] + gz * matrix[2, j]
            by_point[row, j] = slope
            by_pose[row, j] = -slope
        h0, h1, h2 = cross(gx, gy, gz, out[0], out[1], out[2])
        for j in range(3):
            by_pose[row, 3 + j] = h0 * chain[0, j] + h1 * chain[1, j] + h2 * chain[2, j]
    return carry, True


@njit(cache=True)
def range_row(rows, q, x, point, by_point):
    """Whitened range residual and its derivative by the point (3); by the instrument's place it is the opposite."""
    d0 = point[0] - rows.range_centre[q, 0]
    d1 = point[1] - rows.range_centre[q, 1]
    d2 = point[2] - rows.range_centre[q, 2]
    for pair in range(rows.range_pair_first[q], rows.range_pair_first[q + 1]):
        column, value = rows.range_pair_column[pair], rows.range_pair_value[pair]
        d0 -= value * x[column]
        d1 -= value * x[column + 1]
        d2 -= value * x[column + 2]
    length = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    weight = rows.range_weight[q]
    by_point[0], by_point[1], by_point[2] = -weight * d0 / length, -weight * d1 / length, -weight * d2 / length
    return weight * (rows.range_value[q] - length)


@njit(cache=True)
def surface_row(rows, i, x, point, by_point):
    """Height (m) of point i above the bilinear patch of its four posts, along its normal, and its derivative.

    The patch lies where the terrain model's shift puts it; the derivative by the shift is the opposite along its axes.

    F / |grad F| with F = r - R(lon, lat): `geometry.terrain.TerrainGrid.height_above` says the same for arrays. False
    where the point has no patch: off the terrain model, or beside missing posts (Ebner et al. 2004).
    """
    row, column, right = rows.terrain_cell[i, 0], rows.terrain_cell[i, 1], rows.terrain_cell[i, 2]
    if row < 0:
        return 0.0, False
    x0, y, z = point[0], point[1], point[2]
    if rows.surface_column[i] >= 0:
        for k in range(2):
            moved = x[rows.surface_column[i] + k]
            x0 -= moved * rows.surface_direction[i, k, 0]
            y -= moved * rows.surface_direction[i, k, 1]
            z -= moved * rows.surface_direction[i, k, 2]
    planar = math.sqrt(x0 * x0 + y * y)
    radius = math.sqrt(planar * planar + z * z)
    posts, frame = rows.terrain, rows.terrain_frame
    turn = math.atan2(y, x0) - frame[0] - column * frame[2]
    e = (turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)) / frame[2]
    s = (frame[1] - math.atan2(z, planar)) / frame[3] - row
    corner = posts[row, column]
    to_east, to_south = posts[row, right] - corner, posts[row + 1, column] - corner
    twist = posts[row + 1, right] - posts[row + 1, column] - to_east
    value = corner + e * to_east + s * to_south + e * s * twist
    by_longitude, by_latitude = (to_east + s * twist) / frame[2], -(to_south + e * twist) / frame[3]
    twist = -twist / (frame[2] * frame[3])
    a, b = by_longitude / planar, by_latitude / radius
    norm = math.sqrt(1.0 + a * a + b * b)
    share = (radius - value) / norm**3
    turn_longitude, turn_latitude = b * twist / radius, a * (twist / planar + a * z / planar)
    along_east = (-by_longitude / norm - share * turn_longitude) / planar
    along_north = (-by_latitude / norm - share * turn_latitude) / radius
    up = (1.0 / norm + share * (a * a + b * b) / radius) / radius
    sine, cosine = z / radius, planar / radius
    by_point[0] = -along_east * y / planar - along_north * sine * x0 / planar + up * x0
    by_point[1] = along_east * x0 / planar - along_north * sine * y / planar + up * y
    by_point[2] = along_north * cosine + up * z
    return (radius - value) / norm, True


@njit(cache=True)
def robust(model, square):
    """Cost contribution and weight of a residual whose squared norm is `square` (gtsam's mEstimator definitions)."""
    if model.loss == NO_LOSS:
        return 0.5 * square, 1.0
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
