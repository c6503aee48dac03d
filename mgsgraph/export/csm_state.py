"""The line-scanner model state of usgscsm, which ASP's jitter_solve and bundle_adjust read and write as JSON.

Keys, units and meanings: usgscsm src/UsgsAstroLsSensorModel.cpp, constructStateFromIsd (how a state follows from
support data), replaceModelState and populateModel (what is read), updateState (reference point and scales); the file
begins with the model's name as getModelState has it. Positions and attitudes are body-fixed (ECEF); lines and samples
count from 0 at the first pixel's corner, as ours do. Newer versions tell whole numbers from others: so does this.

A state's trajectory is in even steps, as dense as the interpolations need that will be used on it. usgscsm interpolates
body-fixed positions and quaternions by Lagrange's polynomials through the eight nearest of evenly spaced nodes
(src/Utilities.cpp, lagrangeInterp; fewer near the ends, which therefore lie outside of the image). ALE, ISIS and our
own reader interpolate positions by Hermite's cubic between two nodes and turn evenly from one attitude to the next (ALE
src/States.cpp, getState; src/Orientations.cpp, interpolate). Steps are halved until both are met.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.support_data.optics import NUMBERS, state_optics
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import Moments, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, PositionTable
from mgsgraph.units import KM

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
    found: dict[str, tuple[Array, Pose]] = {}
    for intervals in _LADDER:
        times = _even_times(epoch, float(start) - shift, float(stop) - shift, intervals)
        off = _interpolation_errors(image, correction, times + shift)
        near = {
            "m_positions": off[0] <= POSITION_TOLERANCE * pixel,
            "m_quaternions": off[1] <= ATTITUDE_TOLERANCE * pixel / distance,
        }
        for field in (field for field, held in near.items() if held and field not in found):
            found[field] = times, pose_at(image, correction, times + shift)
        if len(found) == len(near):
            break
    for field, px in {"m_positions": off[0] / pixel, "m_quaternions": off[1] * distance / pixel}.items():
        if field not in found and px > _LOSS:
            raise InputError(
                f"image {image.name}, {field}", f"a path that {_LADDER[-1]} even intervals over the image hold to "
                f"{px:.2g} pixels", f"{_LOSS:g} or less", "export spice, whose kernels follow any path",
            )  # fmt: skip
        if field not in found:
            found[field] = times, pose_at(image, correction, times + shift)
    (position_times, place), (attitude_times, attitude) = found["m_positions"], found["m_quaternions"]
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
        turn = rotation.logarithm(matrices[stride::stride] @ np.swapaxes(first, 1, 2))
        between = rotation.exponential(turn[:, None] * (np.arange(stride) / stride)[:, None]) @ first[:, None]
        if np.abs(between.reshape(-1, 3, 3) - matrices[:-1]).max() * lever <= _BODY_TOLERANCE:
            break
    return AttitudeTable(times[::stride], rotation.continuous(rotation.from_matrix(matrices[::stride])), np.eye(3))


def _middle_pixel(image: PushbroomImage, correction: OrientationCorrection) -> tuple[float, float]:
    """The smaller side in m on the ground of the pixel in the image's middle, and the camera's distance from there."""
    line, sample = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
    ground, by_place = image.image_to_ground(line, sample, 0.0, correction)
    if not np.isfinite(ground).all():
        found, expected = "a middle that looks past the body", "one that sees the ellipsoid"
        raise InputError(f"image {image.name}, m_referencePointXyz", found, expected)
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
        lagrange = _windows(quaternions) @ weights
        lagrange /= np.linalg.norm(lagrange, axis=1)[:, None]
        for matrix in (rotation.to_matrix(lagrange), uniform.at(between)[0]):
            attitude = max(attitude, _largest(rotation.logarithm(matrix @ np.swapaxes(true.matrix, 1, 2))))
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


PARAMETERS = 16
"""Of the model: in-track, cross-track and radial position, bias and rate; three angles, bias, rate and acceleration,
scaled to m; focal length."""
_REAL = 2
"""csm::param::REAL."""
_PLACES = 31
"""Lines at which the model's parameters are fitted to the corrections, at least."""


def model_state(
    solution: Solution, image: int, tables: RefinedTables, support: dict[str, Any], body: Turning
) -> dict[str, Any]:
    """State of one image.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    image : int
        Which.
    tables : RefinedTables
        Its orientation.
    support : dict
        Its support data: camera constants, names and the Sun are taken from there.
    body : callable
        The body's rotation, for the Sun.

    Returns
    -------
    dict
        All keys of a state, in m, mm of the focal plane, s past ``m_centerEphemerisTime``. ``m_covariance`` is the
        adjustment's (for sigma0 = 1) as far as the model's parameters can hold it; zero of the focal length.
    """
    picture, correction = solution.image(image), solution.correction(image)
    scales = _scales(picture, correction)
    return {
        "m_modelName": support["name_model"],
        "m_imageIdentifier": picture.name,
        "m_sensorName": support["name_sensor"],
        "m_platformName": support["name_platform"],
        "m_platformIdentifier": support["name_platform"],
        "m_sensorIdentifier": support["name_sensor"],
        "m_nLines": picture.lines,
        "m_nSamples": picture.samples,
        "m_platformFlag": 1,
        **_camera(picture, support),
        **_times(picture.timing, tables, support),
        **_tables(tables),
        "m_majorAxis": picture.body.equatorial,
        "m_minorAxis": picture.body.polar,
        **_elevations(support["reference_height"]),
        **_sun(support["sun_position"], tables, body),
        "m_currentParameterValue": [0.0] * PARAMETERS,
        "m_parameterType": [_REAL] * PARAMETERS,
        **scales,
        "m_covariance": _covariance(solution, image, tables, scales).ravel().tolist(),
        "m_logFile": "",
    }


def _camera(image: PushbroomImage, support: dict[str, Any]) -> dict[str, Any]:
    model, coefficients = state_optics(image.interior.distortion, f"image {image.name}")
    return {
        "m_ikCode": 0,
        "m_zDirection": 1.0,
        "m_focalLength": support["focal_length_model"]["focal_length"],
        "m_distortionType": NUMBERS[model],
        "m_opticalDistCoeffs": coefficients,
        "m_iTransS": support["focal2pixel_samples"],
        "m_iTransL": support["focal2pixel_lines"],
        "m_detectorSampleOrigin": support["detector_center"]["sample"],
        "m_detectorLineOrigin": support["detector_center"]["line"],
        "m_detectorSampleSumming": float(support["detector_sample_summing"]),
        "m_detectorLineSumming": float(support["detector_line_summing"]),
        "m_startingDetectorSample": support["starting_detector_sample"],
        "m_startingDetectorLine": support["starting_detector_line"],
    }


def _times(timing: LineTiming, tables: RefinedTables, support: dict[str, Any]) -> dict[str, Any]:
    """Line times; getImageTime adds half a line to what it counts from m_intTimeLines, which are lines from 0 to it: so
    the segments change at the very line, unlike those of support data.
    """
    return {
        "m_startingEphemerisTime": support["starting_ephemeris_time"],
        "m_centerEphemerisTime": tables.epoch,
        "m_intTimeLines": timing.first_lines.tolist(),
        "m_intTimeStartTimes": (timing.start_times - tables.shift - 0.5 * timing.periods).tolist(),
        "m_intTimes": timing.periods.tolist(),
    }


def _tables(tables: RefinedTables) -> dict[str, Any]:
    to_body = tables.quaternions * np.array([1.0, -1.0, -1.0, -1.0])
    positions, attitudes = tables.position_times, tables.attitude_times
    return {
        "m_t0Ephem": float(positions[0]),
        "m_dtEphem": float(positions[1] - positions[0]),
        "m_numPositions": tables.positions.size,
        "m_positions": tables.positions.ravel().tolist(),
        "m_velocities": tables.velocities.ravel().tolist(),
        "m_t0Quat": float(attitudes[0]),
        "m_dtQuat": float(attitudes[1] - attitudes[0]),
        "m_numQuaternions": to_body.size,
        "m_quaternions": to_body[:, [1, 2, 3, 0]].ravel().tolist(),  # scalar last
    }


def _elevations(said: dict[str, Any]) -> dict[str, float]:
    unit = KM if said.get("unit") == "km" else 1.0
    return {"m_minElevation": float(said["minheight"]) * unit, "m_maxElevation": float(said["maxheight"]) * unit}


def _sun(said: dict[str, Any], tables: RefinedTables, body: Turning) -> dict[str, list[float]]:
    """The Sun in m and m/s, body-fixed, at the image's middle, from which getSunPosition goes on evenly."""
    times = np.asarray(said["ephemeris_times"], dtype=np.float64) - tables.epoch
    vectors = [np.asarray(said.get(key, np.zeros((times.size, 3))), dtype=np.float64) * KM
               for key in ("positions", "velocities")]  # fmt: skip
    place, motion = (np.array([np.interp(0.0, times, one[:, axis]) for axis in range(3)]) for one in vectors)
    ((matrix,), (angular_rate,)) = body(np.zeros(1))
    fixed = matrix @ place
    velocity = matrix @ motion - np.cross(angular_rate, fixed)
    return {"m_sunPosition": fixed.tolist(), "m_sunVelocity": velocity.tolist()}


def _scales(image: PushbroomImage, correction: OrientationCorrection) -> dict[str, Any]:
    """Reference point and scales as updateState computes them: of the image's middle on the ellipsoid."""
    line, sample = 0.5 * image.lines, 0.5 * image.samples
    places = np.array([[line, sample], [line + 1.0, sample + 1.0]])
    ground, _ = image.image_to_ground(places[:, 0], places[:, 1], 0.0, correction)
    camera = image.pose(places[:1, 0], correction).position[0]
    size = float(np.linalg.norm(ground[1] - ground[0])) / np.sqrt(2.0)
    timing = image.timing
    rest = timing.periods[-1] * (image.lines - timing.first_lines[-1])
    return {
        "m_referencePointXyz": ground[0].tolist(),
        "m_gsd": float(size),
        "m_flyingHeight": float(np.linalg.norm(camera - ground[0])),
        "m_halfSwath": float(size) * image.samples / 2.0,
        "m_halfTime": 0.5 * float(timing.start_times[-1] - timing.start_times[0] + rest),
    }


def _covariance(solution: Solution, image: int, tables: RefinedTables, scales: dict[str, Any]) -> Array:
    """(16, 16) of the model's parameters: those that fit the corrections best, in the sense of least squares over the
    image, by the law of error propagation. Its position has no acceleration; what we know of one is lost.
    """
    picture, correction = solution.image(image), solution.correction(image)
    count = max(_PLACES, 4 * correction.coefficients.shape[0])
    lines = np.linspace(0.0, float(picture.lines), count)
    moments = picture.moments(lines)
    effects = np.einsum("nd,ck->ncdk", correction.basis(moments), np.eye(6)).reshape(count, 6, -1)
    effects[:, 3:] = correction.axes(picture.pose(lines), moments) @ effects[:, 3:]
    design = _parameter_design(picture.pose(lines, correction).position, moments.times - tables.shift, tables, scales)
    fitted = np.linalg.lstsq(design.reshape(6 * count, -1), effects.reshape(6 * count, -1))[0]
    result = np.zeros((PARAMETERS, PARAMETERS))
    result[:-1, :-1] = fitted @ solution.correction_covariance(image) @ fitted.T
    return np.asarray(0.5 * (result + result.T))


def _parameter_design(places: Array, times: Array, tables: RefinedTables, scales: dict[str, Any]) -> Array:
    """(n, 6, 15) m and rad per m: what the parameters do to position and attitude (getAdjSensorPosVel,
    calculateAttitudeCorrection) at places (n, 3) and times (n,).
    """
    motion = np.column_stack([np.interp(times, tables.position_times, axis) for axis in tables.velocities.T])
    radial = places / np.linalg.norm(places, axis=1)[:, None]
    across = np.cross(places, motion)
    across /= np.linalg.norm(across, axis=1)[:, None]
    axes = np.stack([np.cross(across, radial), across, radial], axis=2)
    since = (times - tables.position_times[0]) / scales["m_halfTime"]
    turned = (times - tables.attitude_times[0]) / scales["m_halfTime"]
    per_metre = np.diag(1.0 / np.array([scales["m_flyingHeight"], scales["m_flyingHeight"], scales["m_halfSwath"]]))
    design = np.zeros((times.size, 6, PARAMETERS - 1))
    for k in range(2):
        design[:, :3, 3 * k : 3 * k + 3] = axes * (since**k)[:, None, None]
    for k in range(3):
        design[:, 3:, 6 + 3 * k : 9 + 3 * k] = per_metre * (turned**k)[:, None, None]
    return design
