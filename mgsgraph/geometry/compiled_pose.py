"""Nominal poses by compiled code: sampled tables interpolated as ISIS and SPICE do, and polynomials of the papers."""

from functools import partial

from mgsgraph.compiled import cached_kernel, equation
from mgsgraph.factors.algebra import add, cross, product, scale, subtract, transform, transpose
from mgsgraph.factors.interpolation import hermite
from mgsgraph.factors.pose import about_axes
from mgsgraph.factors.rotation import (
    matrix_quaternion,
    opk_paper_axes,
    opk_peer_axes,
    opk_rotation,
    quaternion_matrix,
    rotation,
)

kernel = partial(cached_kernel, plain=True)


@equation
def interval(times, at):
    """Interval k of the samples times[k] .. times[k + 1] that serves a time; the outer ones extrapolate.

    Without `np.searchsorted`, with which a kernel from the cache would load numba's array functions and SciPy.
    """
    end, last = 1, times.size - 1
    while end < last:
        middle = (end + last) // 2
        end, last = (end, middle) if at < times[middle] else (middle + 1, last)
    return end - 1


@equation
def vector(values, k):
    """Row k of an array (n, 3)."""
    return values[k, 0], values[k, 1], values[k, 2]


@equation
def rows_of(matrix):
    """A matrix (3, 3) as rows."""
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


@equation
def set_vector(values, k, vector):
    """Set row k of an array (n, 3)."""
    values[k, 0], values[k, 1], values[k, 2] = vector


@equation
def place_at(time, table):
    """Position and velocity of a table (times, positions, velocities) at a time."""
    times, positions, velocities = table
    k = interval(times, time)
    ends = vector(positions, k), vector(positions, k + 1)
    return hermite(
        (time - times[k]) / (times[k + 1] - times[k]),
        times[k + 1] - times[k],
        *ends,
        vector(velocities, k),
        vector(velocities, k + 1),
    )


@equation
def attitude_at(time, table):
    """Matrix of a table (times, quaternions, turns, constant) at a time, and angular velocity, in the wanted frame.

    Between two samples the frame turns uniformly (the great arc, as SPICE CK type 3 and ISIS).
    """
    times, quaternions, turns, constant = table
    k = interval(times, time)
    step = times[k + 1] - times[k]
    fixed = rows_of(constant)
    turn, q = vector(turns, k), quaternions[k]
    sampled = product(rotation(scale((time - times[k]) / step, turn)), quaternion_matrix((q[0], q[1], q[2], q[3])))
    return product(fixed, sampled), transform(fixed, scale(1.0 / step, turn))


@equation
def polynomial_at(coefficients, s):
    """Value and derivative by s of a polynomial with coefficients (d, 3)."""
    value, slope = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(coefficients.shape[0] - 1, -1, -1):
        slope = add(scale(s, slope), value)
        value = add(scale(s, value), vector(coefficients, k))
    return value, slope


@kernel
def places(times, table, position, velocity):
    """Positions (n, 3) and velocities (n, 3) of a table at times (n,)."""
    for i in range(times.size):
        place, motion = place_at(times[i], table)
        set_vector(position, i, place)
        set_vector(velocity, i, motion)


@kernel
def quaternions(matrix, result):
    """Unit quaternions (n, 4) of rotation matrices (n, 3, 3)."""
    for i in range(matrix.shape[0]):
        result[i, 0], result[i, 1], result[i, 2], result[i, 3] = matrix_quaternion(rows_of(matrix[i]))


@kernel
def attitudes(times, table, matrix, angular_rate):
    """Matrices (n, 3, 3) and angular velocities (n, 3) of a table at times (n,)."""
    for i in range(times.size):
        attitude, turn = attitude_at(times[i], table)
        for j in range(3):
            set_vector(matrix[i], j, attitude[j])
        set_vector(angular_rate, i, turn)


@kernel
def sampled_poses(times, position_table, camera_table, body_table, position, velocity, matrix, angular_rate):
    """Poses at times (n,): body-fixed position and attitude of the camera, and their rates per second."""
    for i in range(times.size):
        place, motion = place_at(times[i], position_table)
        to_camera, camera_turning = attitude_at(times[i], camera_table)
        to_body, body_turning = attitude_at(times[i], body_table)
        fixed = transform(to_body, place)
        attitude = product(to_camera, transpose(to_body))
        set_vector(position, i, fixed)
        set_vector(velocity, i, subtract(transform(to_body, motion), cross(body_turning, fixed)))
        set_vector(angular_rate, i, subtract(camera_turning, transform(attitude, body_turning)))
        for j in range(3):
            set_vector(matrix[i], j, attitude[j])


@kernel
def polynomial_poses(s, rate, paper, places, angles, position, velocity, matrix, angular_rate):
    """Poses of polynomials in X, Y, Z and in omega, phi, kappa at s (n,); `rate` is ds/dt. The product R3 R2 R1 takes
    camera to body where `paper`, else body to camera.
    """
    for i in range(s.size):
        place, motion = polynomial_at(places, s[i])
        opk, opk_rate = polynomial_at(angles, s[i])
        turned, axes = opk_rotation(opk), opk_paper_axes(opk) if paper else opk_peer_axes(opk)
        attitude = transpose(turned) if paper else turned
        set_vector(position, i, place)
        set_vector(velocity, i, scale(rate, motion))
        set_vector(angular_rate, i, scale(rate, transform(axes, opk_rate)))
        for j in range(3):
            set_vector(matrix[i], j, attitude[j])


@kernel
def turned_attitudes(nominal, angular_rate, turn, turn_rate, matrix, result):
    """Matrices (n, 3, 3) and angular rates (n, 3) of nominal quaternions (n, 4), corrected by turns (n, 3) about
    the axes of the camera.
    """
    for i in range(turn.shape[0]):
        q = nominal[i]
        attitude, _, rate = about_axes(
            (q[0], q[1], q[2], q[3]), vector(angular_rate, i), 0.0, vector(turn, i), vector(turn_rate, i)
        )
        set_vector(result, i, rate)
        for j in range(3):
            set_vector(matrix[i], j, attitude[j])
