"""The line-scanner model state of usgscsm, which ASP's jitter_solve and bundle_adjust read and write as JSON.

Keys, units and meanings: usgscsm src/UsgsAstroLsSensorModel.cpp, constructStateFromIsd (how a state follows from
support data), replaceModelState and populateModel (what is read), updateState (reference point and scales); the file
begins with the model's name as getModelState has it. Positions and attitudes are body-fixed (ECEF); lines and samples
count from 0 at the first pixel's corner, as ours do. Newer versions tell whole numbers from others: so does this.
"""

from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.export.csm_tables import RefinedTables, Turning
from mgsgraph.files.support_data.optics import NUMBERS, state_optics
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.units import KM

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
