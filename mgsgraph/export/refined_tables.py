"""Positions and attitudes of an adjusted image at even times, closely enough to interpolate between."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Moments, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, PositionTable

POSITION_TOLERANCE, ATTITUDE_TOLERANCE = 2e-4, 7e-4
"""Pixels by which interpolation may be off, of positions and of attitudes."""
_LOSS = 0.01
"""Pixels by which a path that no even steps hold better may be off; what is read back says it."""
_LADDER = tuple(step << k for k in range(12) for step in (32, 48))
"""Intervals over the image that are tried in turn; with fewer than 25 nodes usgscsm would make its own."""
_BEYOND = 4
"""Nodes before and after the image, so that every line of it has four on either side."""
_BETWEEN = (0.25, 0.5, 0.75)
_EIGHT = np.arange(-3.0, 5.0)
_BODY_TOLERANCE = 1e-3
"""Pixels that the camera may be off in inertial space, for the few nodes that the body's rotation is given at."""

Turning = Callable[[Array], tuple[Array, Array]]
"""Matrices (n, 3, 3) inertial to body-fixed and the body's angular velocity (n, 3) in rad/s in body-fixed axes, at
times (n,) in s past the tables' epoch."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedTables:
    """One image's adjusted orientation in even steps, body-fixed."""

    epoch: float
    """s TDB past J2000, the image's middle, from which the times count; epoch + time is exact in one float64."""
    shift: float
    """s from the trajectory's epoch to this one."""
    position_times: Array
    """(p,) s past the epoch, even steps."""
    positions: Array
    """(p, 3) m, perspective centre."""
    velocities: Array
    """(p, 3) m/s, the frame's turning included."""
    attitude_times: Array
    """(q,) s past the epoch, even steps."""
    quaternions: Array
    """(q, 4) body-fixed to camera axes, scalar first (NAIF q2m), without jumps of sign."""
    angular_rates: Array
    """(q, 3) rad/s, angular velocity of the camera against the body-fixed frame, in camera axes."""
    pixel: float
    """m, the smaller side of the middle pixel on the ground."""
    distance: float
    """m, from the camera to there."""


def pose_at(image: PushbroomImage, correction: OrientationCorrection, times: Array) -> Pose:
    """Adjusted pose at times (n,) in s past the trajectory's epoch, which may lie before the first and after the last
    line or in a pause between lines; rates per second.
    """
    _, periods = image.timing.at(image.timing.lines(times))
    moments = Moments(
        image.normalised(image.timing.lines(times)), image.normalised_rate, times, periods, image.trajectory.epoch
    )
    return correction.apply(image.trajectory.pose(times).scaled(periods), moments).scaled(1.0 / periods)


def refined_tables(image: PushbroomImage, correction: OrientationCorrection) -> RefinedTables:
    """Tables of an image with its correction.

    Raises
    ------
    InputError
        If the image's middle does not see the body, or no table up to 98,304 intervals holds the path to a hundredth of
        a pixel. One that holds it to that and no better (attitude whose rate jumps at the records of its CK) is taken.
    """
    (start, stop), _ = image.timing.at(np.array([0.0, float(image.lines)]))
    epoch = image.trajectory.epoch + 0.5 * float(start + stop)
    shift = epoch - image.trajectory.epoch
    pixel, distance = _middle_pixel(image, correction)
    poses: dict[str, tuple[Array, Pose]] = {}
    for intervals in _LADDER:
        times = _even_times(epoch, float(start) - shift, float(stop) - shift, intervals)
        off = _interpolation_errors(image, correction, times + shift)
        near = {
            "m_positions": off[0] <= POSITION_TOLERANCE * pixel,
            "m_quaternions": off[1] <= ATTITUDE_TOLERANCE * pixel / distance,
        }
        for field in (field for field, held in near.items() if held and field not in poses):
            poses[field] = times, pose_at(image, correction, times + shift)
        if len(poses) == len(near):
            break
    for field, px in {"m_positions": off[0] / pixel, "m_quaternions": off[1] * distance / pixel}.items():
        if field not in poses and px > _LOSS:
            raise InputError(
                f"image {image.name}, {field}", f"a path that {_LADDER[-1]} even intervals over the image hold to "
                f"{px:.2g} pixels", f"{_LOSS:g} or less", "export spice, whose kernels follow any path",
            )  # fmt: skip
        if field not in poses:
            poses[field] = times, pose_at(image, correction, times + shift)
    (position_times, place), (attitude_times, attitude) = poses["m_positions"], poses["m_quaternions"]
    return RefinedTables(
        epoch, shift, position_times, place.position, place.velocity,
        attitude_times, rotation.continuous(rotation.from_matrix(attitude.matrix)), attitude.angular_rate,
        pixel, distance,
    )  # fmt: skip


def body_table(tables: RefinedTables, angular_rate: Turning) -> AttitudeTable:
    """The body's rotation at as few of the attitude's times as do, evenly chosen and the outer two among them.

    Inertial positions and attitudes have to be made with this one, between its nodes too, so that whoever turns them
    back with it finds the body-fixed ones again.
    """
    times = tables.attitude_times
    lever = float(np.linalg.norm(tables.positions, axis=1).max()) / tables.pixel
    count, matrices = times.size - 1, angular_rate(times)[0]
    for stride in (k for k in range(count, 0, -1) if count % k == 0):
        first = matrices[:-1:stride]
        turn = rotation.logarithm(matrices[stride::stride] @ first.mT)
        between = rotation.exponential(turn[:, None] * (np.arange(stride) / stride)[:, None]) @ first[:, None]
        if np.abs(between.reshape(-1, 3, 3) - matrices[:-1]).max() * lever <= _BODY_TOLERANCE:
            break
    return AttitudeTable(times[::stride], rotation.continuous(rotation.from_matrix(matrices[::stride])), np.eye(3))


def _middle_pixel(image: PushbroomImage, correction: OrientationCorrection) -> tuple[float, float]:
    """The smaller side in m on the ground of the pixel in the image's middle, and the camera's distance from there."""
    line, sample = image.middle
    ground, by_place = image.image_to_ground(line, sample, 0.0, correction)
    found, expected = "a middle that looks past the body", "one that sees the ellipsoid"
    require(np.isfinite(ground).all(), f"image {image.name}, m_referencePointXyz", found, expected)
    distance = np.linalg.norm(image.pose(line, correction).position - ground)
    return float(np.linalg.norm(by_place[0], axis=0).min()), float(distance)


def _even_times(epoch: float, start: float, stop: float, intervals: int) -> Array:
    """Times in s past the epoch, `intervals` or a few more steps from start to stop and some beyond; whole multiples of
    what one float64 of ephemeris time resolves, so that they are even there, too.
    """
    grain = float(np.spacing(abs(epoch) + abs(stop)))
    step = np.ceil((stop - start) / intervals / grain) * grain
    first = np.floor((start - _BEYOND * step) / grain) * grain
    return np.asarray(first + step * np.arange(intervals + 2 * _BEYOND + 1))


def _interpolation_errors(
    image: PushbroomImage, correction: OrientationCorrection, times: Array
) -> tuple[float, float]:
    """Largest error between evenly spaced nodes at times (n,), s past the trajectory's epoch, of positions in m and
    attitudes in rad.
    """
    nodes = pose_at(image, correction, times)
    quaternions, step = rotation.continuous(rotation.from_matrix(nodes.matrix)), float(times[1] - times[0])
    cubic = PositionTable(times, nodes.position, nodes.velocity)
    uniform = AttitudeTable(times, quaternions, np.eye(3))
    position = attitude = 0.0
    inner = slice(_BEYOND - 1, times.size - _BEYOND)
    for share in _BETWEEN:
        between, weights = times[inner] + share * step, _eight_weights(share)
        true = pose_at(image, correction, between)
        for place in (_windows(nodes.position) @ weights, cubic.at(between)[0]):
            position = max(position, _largest(place - true.position))
        lagrange = rotation.unit_vectors(_windows(quaternions) @ weights)
        for matrix in (rotation.to_matrix(lagrange), uniform.at(between)[0]):
            attitude = max(attitude, _largest(rotation.logarithm(matrix @ true.matrix.mT)))
    return position, attitude


def _eight_weights(share: float) -> Array:
    """(8,) of Lagrange's polynomials through nodes -3 .. 4 at a share of the step from node 0 to node 1."""
    factors = (share - _EIGHT) / (_EIGHT[:, None] - _EIGHT + np.eye(8))
    return np.asarray(np.prod(factors + np.diag(1.0 - np.diag(factors)), axis=1))


def _windows(values: Array) -> Array:
    """(n - 7, c, 8) of values (n, c)."""
    return np.lib.stride_tricks.sliding_window_view(values, 8, axis=0)


def _largest(vectors: Array) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
