"""CSM: refined image support data as ALE lays them out, and beside each the line-scanner model state of usgscsm.

Both hold geometric positions (no light time, no stellar aberration), and every correction once: time biases too.
Support data name an inertial frame, which an adjustment needs not know: it is that of the image's own support data
where there are any, or else the body's axes as they are in the image's middle.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.files.labels.isis_cube import Aberration
from mgsgraph.files.opening import read_json
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.isd_layout import (
    J2000,
    MODEL,
    NUMBERS,
    RotationTable,
    StateTable,
    SunTable,
    rotation_table,
    state_optics,
    state_table,
    support_fields,
)
from mgsgraph.files.writing import file_stem, write_files
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import Moments, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, PositionTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, KM, MM

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



_AROUND = 100.0
"""m, by which the ground may be higher or lower than the points on it."""
SUPPORT_DATA, STATE = ".json", ".adjusted_state.json"
"""How the files of an image end. usgscsm's plugin opens support data as the image's file with its ending replaced by
.json (src/UsgsAstroPlugin.cpp, loadImageSupportData); the state's ending is that of ASP's bundle_adjust."""
_TIMING_TOLERANCE = 1e-2
"""Lines by which usgscsm may misread a line_scan_rate of several segments."""


def write_csm(
    solution: Solution, folder: Path, originals: Mapping[str, Path] | None = None, support: bool = True,
    files: Mapping[str, str] | None = None,
) -> list[Path]:  # fmt: skip
    """Write ``<image>.json`` and ``<image>.adjusted_state.json`` of every image into an existing folder.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to.
    originals : mapping, optional
        Support data from which an image was read, by its name: what the adjustment doesn't know is taken over from
        there (names of platform and sensor, NAIF keywords and frame codes, the Sun, the body's J2000 rotation).
    support : bool
        Whether support data are written; False leaves the states alone, which can hold more.
    files : mapping, optional
        File of an image by the image's name: what belongs to it is called like it, as usgscsm's plugin looks for
        support data beside the image; by the image's own name where there is none.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        If a file can't be written, support data are of no image of the solution, or the format can't hold what an image
        has: which field is said.
    """
    originals = originals or {}
    known = {image.name for image in solution.network.images}
    for name in sorted((originals.keys() | (files or {}).keys()) - known):
        raise InputError(f"file of {name}", "no image of the solution", f"one that was adjusted ({min(known)}, ...)")
    stems = file_stems(solution, files)
    texts = dict[str, str | bytes]()
    for j, stem in enumerate(stems):
        image = solution.image(j)
        original = _original(image, originals.get(image.name), _heights(solution))
        tables = refined_tables(image, solution.correction(j))
        body = body_table(tables, _body_rotation(image, originals.get(image.name)))
        said = _provenance(solution) + _inertial_words(image, image.name in originals)
        data = _support_data(image, tables, body, original) | {"mgsgraph": said}
        if support:
            _require_timing(image)
            texts[stem + SUPPORT_DATA] = _text(data)
        state = model_state(solution, j, tables, data, body.at) | {"m_mgsgraph": _provenance(solution)}
        texts[stem + STATE] = f"{MODEL}\n{_text(state)}"
    return write_files(folder, texts)


def file_stems(solution: Solution, files: Mapping[str, str] | None = None) -> list[str]:
    """A file name for each image, without its end: that of its file, or else its own name."""
    names = [image.name for image in solution.network.images]
    own = {name: Path(file).stem for name, file in (files or {}).items()}
    stems = [file_stem(own.get(name, name)).lstrip(".") or "_" for name in names]
    folded = [stem.casefold() for stem in stems]
    for j, stem in enumerate(folded):
        if stem in folded[:j]:
            found = f"{names[folded.index(stem)]!r} and {names[j]!r}, whose files would be called {stems[j]}"
            raise InputError("image names", found, "names that differ as file names, too", "rename one of the images")
    return stems


def _provenance(solution: Solution) -> str:
    version = solution.versions.get("mgsgraph", "unknown")
    state = "converged" if solution.converged else "NOT converged"
    return (
        f"Adjusted by mgsgraph {version}, solution {solution.name!r}, {state}. Positions are geometric: no light time "
        "and no stellar aberration. Time biases are applied: do not apply them again."
    )


def _inertial_words(image: PushbroomImage, original: bool) -> str:
    """What reference_frame doesn't say where nobody knows how the body turns in J2000."""
    if isinstance(image.trajectory, Trajectory) or original:
        return ""
    return " Inertial axes are not J2000's but the body's own at center_ephemeris_time."


def _text(value: dict[str, Any]) -> str:
    """JSON with one key of the outermost object to a line: tables may be long."""
    rows = (f"{json.dumps(key)}: {json.dumps(entry, allow_nan=False)}" for key, entry in value.items())
    return "{\n" + ",\n".join(rows) + "\n}\n"


def _heights(solution: Solution) -> dict[str, Any]:
    """Between which heights (m above the ellipsoid) the adjusted points lie, and a hundred metres more; ALE's words for
    a solution without any.
    """
    places = solution.places[np.all(np.isfinite(solution.places), axis=1)]
    if places.size == 0:
        return {"maxheight": 1000, "minheight": -1000, "unit": "m"}
    heights = geodetic(places, solution.network.images[0].body)[:, 2]
    least, largest = np.floor(heights.min() - _AROUND), np.ceil(heights.max() + _AROUND)
    return {"maxheight": float(largest), "minheight": float(least), "unit": "m"}


def _original(image: PushbroomImage, path: Path | None, heights: dict[str, Any]) -> dict[str, Any]:
    """What support data say that the adjustment doesn't know; with ALE's own words for what nobody said."""
    unknown = {
        "isis_camera_version": 2, "name_platform": "UNKNOWN", "name_sensor": "UNKNOWN", "detector_line_summing": 1,
        "reference_height": heights, "naif_keywords": {},
    }  # fmt: skip
    if path is None:
        return unknown
    said = read_json(path)
    if (said.get("image_lines"), said.get("image_samples")) != (image.lines, image.samples):
        found = f"{said.get('image_lines')} x {said.get('image_samples')} lines x samples"
        raise InputError(str(path), found, f"those of image {image.name}, {image.lines} x {image.samples}")
    known = (*unknown, "sun_position", "body_rotation", "instrument_pointing")
    return unknown | {key: said[key] for key in known if key in said}


def _body_rotation(image: PushbroomImage, path: Path | None) -> Turning:
    """How the body turns in inertial space; times count from the tables' epoch, the image's middle."""
    trajectory, epoch = image.trajectory, image.trajectory.epoch
    edges, _ = image.timing.at(np.array([0.0, float(image.lines)]))
    middle = epoch + 0.5 * float(edges.sum())
    if not isinstance(trajectory, Trajectory) and path is not None:
        # where its positions were apparent, its rotation stands all the same
        other = read_isd(path, image.name, Aberration("NONE")).trajectory
        trajectory, epoch = other, other.epoch
    if isinstance(trajectory, Trajectory):
        table, since = trajectory.body, middle - epoch
        return lambda times: table.at(times + since)
    spin = np.zeros(3) if trajectory.spin is None else trajectory.spin
    return lambda times: (rotation.exponential(-spin * times[:, None]), np.broadcast_to(spin, (times.size, 3)))


def _require_timing(image: PushbroomImage) -> None:
    """Raise InputError where usgscsm would misread the line times: it changes segments half a line late
    (src/UsgsAstroLsSensorModel.cpp, getImageTime, compares its lines from 0 with ISIS's from 0.5).
    """
    timing = image.timing
    if timing.first_lines.size < 2:
        return
    late = np.concatenate([timing.first_lines[1:], timing.first_lines[1:] + 0.5])
    k = np.tile(np.arange(timing.first_lines.size - 1), 2)
    gone_on = timing.start_times[k] + (late - timing.first_lines[k]) * timing.periods[k]
    true = timing.start_times[k + 1] + (late - timing.first_lines[k + 1]) * timing.periods[k + 1]
    off = np.abs(gone_on - true) / timing.periods[k + 1]
    if off.max() > _TIMING_TOLERANCE:
        line = timing.first_lines[k[off.argmax()] + 1]
        raise InputError(
            f"image {image.name}, line_scan_rate", f"{timing.first_lines.size} segments; after the change at line "
            f"{line + ISIS_OFFSET:g} usgscsm would be {off.max():.3g} lines off", "one segment, or smaller changes",
            "write the model states alone (support=False), which hold them",
        )  # fmt: skip


def _support_data(
    image: PushbroomImage, tables: RefinedTables, body: AttitudeTable, original: dict[str, Any]
) -> dict[str, Any]:
    """Support data in the layout that ALE writes and `files.support_data.isd` reads."""
    summing = int(image.interior.sample_summing)
    if summing != image.interior.sample_summing:
        where = f"image {image.name}, detector_sample_summing"
        raise InputError(where, f"{image.interior.sample_summing:g}", "a whole number")
    kept = {k: v for k, v in original.items() if k not in ("sun_position", "body_rotation", "instrument_pointing")}
    found = support_fields(
        image, tables.epoch, _position_table(tables, body), _pointing_table(tables, body, original),
        _body_table(tables.epoch, body, original), _no_sun(tables),
    )  # fmt: skip
    return kept | found | {
        "detector_sample_summing": summing,
        "naif_keywords": _naif_keywords(original["naif_keywords"], image.interior.focal_length),
        "sun_position": original.get("sun_position", found["sun_position"]),
    }


def _naif_keywords(said: Mapping[str, Any], focal_length: float) -> dict[str, Any]:
    """ISIS's keywords: positions are geometric whatever they were, and the focal length may have been adjusted."""
    renewed: dict[str, Any] = {"_LIGHTTIME_CORRECTION": "NONE", "_FOCAL_LENGTH": focal_length / MM}
    ends = {key: end for key in said for end in renewed if key.endswith(end)}
    keywords = dict(said) | {key: renewed[end] for key, end in ends.items()}
    if "_LIGHTTIME_CORRECTION" not in ends.values():
        keywords["INS0_LIGHTTIME_CORRECTION"] = "NONE"
    return keywords


def _pointing_table(tables: RefinedTables, body: AttitudeTable, original: Mapping[str, Any]) -> RotationTable:
    times = tables.attitude_times
    to_camera = rotation.to_matrix(tables.quaternions)
    to_body, body_rate = body.at(times)
    rate = tables.angular_rates + np.einsum("nij,nj->ni", to_camera, body_rate)
    return _rotation_table(tables.epoch + times, to_camera @ to_body, rate, original.get("instrument_pointing"))


def _body_table(epoch: float, body: AttitudeTable, original: Mapping[str, Any]) -> RotationTable:
    return _rotation_table(epoch + body.times, *body.at(body.times), original.get("body_rotation"))


def _rotation_table(times: Array, matrices: Array, rates: Array, said: Any) -> RotationTable:
    """Rotation table of attitudes (n, 3, 3), inertial to the frame, with angular rates (n, 3), rad/s about the frame's
    axes; those of ALE and NAIF are about inertial ones.
    """
    frames = said.get("constant_frames") if isinstance(said, dict) else None
    return msgspec.structs.replace(
        rotation_table(times, rotation.continuous(rotation.from_matrix(matrices)), np.eye(3)),
        time_dependent_frames=[frames[0], J2000] if frames else None,
        constant_frames=[frames[0]] if frames else None,
        ck_table_start_time=float(times[0]),
        ck_table_end_time=float(times[-1]),
        ck_table_original_size=times.size,
        angular_velocities=np.einsum("nji,nj->ni", matrices, rates).tolist(),
    )


def _position_table(tables: RefinedTables, body: AttitudeTable) -> StateTable:
    to_body, rate = body.at(tables.position_times)
    times = tables.epoch + tables.position_times
    motion = tables.velocities + np.cross(rate, tables.positions)
    inertial = [np.einsum("nji,nj->ni", to_body, vectors) for vectors in (tables.positions, motion)]
    return msgspec.structs.replace(
        state_table(times, *inertial), spk_table_start_time=float(times[0]), spk_table_end_time=float(times[-1]),
        spk_table_original_size=times.size,
    )  # fmt: skip


def _no_sun(tables: RefinedTables) -> SunTable:
    """Zeros, as in a model state without a Sun (reset() of usgscsm): the key has to be there, and with three times."""
    times = tables.epoch + tables.position_times[[0, tables.position_times.size // 2, -1]]
    zeros = [(0.0, 0.0, 0.0)] * 3
    return SunTable(ephemeris_times=times.tolist(), positions=zeros, velocities=zeros, reference_frame=J2000)
