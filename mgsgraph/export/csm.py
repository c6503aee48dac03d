"""CSM: refined image support data as ALE lays them out, and beside each the line-scanner model state of usgscsm.

Both hold geometric positions (no light time, no stellar aberration), and every correction once: time biases too.
Support data name an inertial frame, which an adjustment needs not know: it is that of the image's own support data
where there are any, or else the body's axes as they are in the image's middle.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, require
from mgsgraph.export.refined_tables import RefinedTables, Turning, body_table, refined_tables
from mgsgraph.files.labels.aberration import Aberration
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
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, finite_rows
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, KM, MM

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


def _elevations(heights: dict[str, Any]) -> dict[str, float]:
    unit = KM if heights.get("unit") == "km" else 1.0
    return {"m_minElevation": float(heights["minheight"]) * unit, "m_maxElevation": float(heights["maxheight"]) * unit}


def _sun(stated: dict[str, Any], tables: RefinedTables, body: Turning) -> dict[str, list[float]]:
    """The Sun in m and m/s, body-fixed, at the image's middle, from which getSunPosition goes on evenly."""
    times = np.asarray(stated["ephemeris_times"], dtype=np.float64) - tables.epoch
    vectors = [np.asarray(stated.get(key, np.zeros((times.size, 3))), dtype=np.float64) * KM
               for key in ("positions", "velocities")]  # fmt: skip
    place, motion = (np.array([np.interp(0.0, times, vector[:, axis]) for axis in range(3)]) for vector in vectors)
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
    radial = unit_vectors(places)
    across = unit_vectors(np.cross(places, motion))
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
    names = set(solution.network.image_names)
    for name in sorted((originals.keys() | (files or {}).keys()) - names):
        raise InputError(f"file of {name}", "no image of the solution", f"one that was adjusted ({min(names)}, ...)")
    stems = file_stems(solution, files)
    texts = dict[str, str | bytes]()
    for j, stem in enumerate(stems):
        image = solution.image(j)
        original = _original(image, originals.get(image.name), _heights(solution))
        tables = refined_tables(image, solution.correction(j))
        body = body_table(tables, _body_rotation(image, originals.get(image.name)))
        provenance = _provenance(solution) + _inertial_words(image, image.name in originals)
        data = _support_data(image, tables, body, original) | {"mgsgraph": provenance}
        if support:
            _require_timing(image)
            texts[stem + SUPPORT_DATA] = _text(data)
        state = model_state(solution, j, tables, data, body.at) | {"m_mgsgraph": _provenance(solution)}
        texts[stem + STATE] = f"{MODEL}\n{_text(state)}"
    return write_files(folder, texts)


def file_stems(solution: Solution, files: Mapping[str, str] | None = None) -> list[str]:
    """A file name for each image, without its end: that of its file, or else its own name."""
    names = solution.network.image_names
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
    return (
        f"Adjusted by mgsgraph {version}, solution {solution.name!r}, {solution.ending}. Positions are geometric: no "
        "light time and no stellar aberration. Time biases are applied: do not apply them again."
    )


def _inertial_words(image: PushbroomImage, original: bool) -> str:
    """reference_frame of an image whose body's rotation in J2000 is unknown."""
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
    places = solution.places[finite_rows(solution.places)]
    if places.size == 0:
        return {"maxheight": 1000, "minheight": -1000, "unit": "m"}
    heights = ellipsoidal_heights(places, solution.network.body)
    least, largest = np.floor(heights.min() - _AROUND), np.ceil(heights.max() + _AROUND)
    return {"maxheight": float(largest), "minheight": float(least), "unit": "m"}


def _original(image: PushbroomImage, path: Path | None, heights: dict[str, Any]) -> dict[str, Any]:
    """What support data say that the adjustment doesn't know; with ALE's own words for what is missing."""
    unknown = {
        "isis_camera_version": 2, "name_platform": "UNKNOWN", "name_sensor": "UNKNOWN", "detector_line_summing": 1,
        "reference_height": heights, "naif_keywords": {},
    }  # fmt: skip
    if path is None:
        return unknown
    content = read_json(path)
    if (content.get("image_lines"), content.get("image_samples")) != (image.lines, image.samples):
        found = f"{content.get('image_lines')} x {content.get('image_samples')} lines x samples"
        raise InputError(str(path), found, f"those of image {image.name}, {image.lines} x {image.samples}")
    keys = (*unknown, "sun_position", "body_rotation", "instrument_pointing")
    return unknown | {key: content[key] for key in keys if key in content}


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
    extrapolated = timing.start_times[k] + (late - timing.first_lines[k]) * timing.periods[k]
    true = timing.start_times[k + 1] + (late - timing.first_lines[k + 1]) * timing.periods[k + 1]
    off = np.abs(extrapolated - true) / timing.periods[k + 1]
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
    where = f"image {image.name}, detector_sample_summing"
    require(summing == image.interior.sample_summing, where, f"{image.interior.sample_summing:g}", "a whole number")
    carried = {k: v for k, v in original.items() if k not in ("sun_position", "body_rotation", "instrument_pointing")}
    fields = support_fields(
        image, tables.epoch, _position_table(tables, body), _pointing_table(tables, body, original),
        _rotation_table(tables.epoch + body.times, *body.at(body.times), original.get("body_rotation")),
        _no_sun(tables),
    )  # fmt: skip
    return carried | fields | {
        "detector_sample_summing": summing,
        "naif_keywords": _naif_keywords(original["naif_keywords"], image.interior.focal_length),
        "sun_position": original.get("sun_position", fields["sun_position"]),
    }


def _naif_keywords(stated: Mapping[str, Any], focal_length: float) -> dict[str, Any]:
    """ISIS's keywords: positions are geometric whatever they were, and the focal length may have been adjusted."""
    renewed: dict[str, Any] = {"_LIGHTTIME_CORRECTION": "NONE", "_FOCAL_LENGTH": focal_length / MM}
    ends = {key: end for key in stated for end in renewed if key.endswith(end)}
    keywords = dict(stated) | {key: renewed[end] for key, end in ends.items()}
    if "_LIGHTTIME_CORRECTION" not in ends.values():
        keywords["INS0_LIGHTTIME_CORRECTION"] = "NONE"
    return keywords


def _pointing_table(tables: RefinedTables, body: AttitudeTable, original: Mapping[str, Any]) -> RotationTable:
    times = tables.attitude_times
    to_camera = rotation.to_matrix(tables.quaternions)
    to_body, body_rate = body.at(times)
    rate = tables.angular_rates + np.einsum("nij,nj->ni", to_camera, body_rate)
    return _rotation_table(tables.epoch + times, to_camera @ to_body, rate, original.get("instrument_pointing"))


def _rotation_table(times: Array, matrices: Array, rates: Array, stated: Any) -> RotationTable:
    """Rotation table of attitudes (n, 3, 3), inertial to the frame, with angular rates (n, 3), rad/s about the frame's
    axes; those of ALE and NAIF are about inertial ones.
    """
    frames = stated.get("constant_frames") if isinstance(stated, dict) else None
    return msgspec.structs.replace(
        rotation_table(times, rotation.continuous(rotation.from_matrix(matrices)), np.eye(3)),
        time_dependent_frames=[frames[0], J2000] if frames else None,
        constant_frames=[frames[0]] if frames else None,
        **described_times("ck", times),
        angular_velocities=np.einsum("nji,nj->ni", matrices, rates).tolist(),
    )


def _position_table(tables: RefinedTables, body: AttitudeTable) -> StateTable:
    to_body, rate = body.at(tables.position_times)
    times = tables.epoch + tables.position_times
    motion = tables.velocities + np.cross(rate, tables.positions)
    inertial = [np.einsum("nji,nj->ni", to_body, vectors) for vectors in (tables.positions, motion)]
    return msgspec.structs.replace(state_table(times, *inertial), **described_times("spk", times))


def described_times(kind: str, times: Array) -> dict[str, Any]:
    """Times (n,) of a table of support data, and what it says of them; `kind` is ck or spk."""
    said = {"start_time": float(times[0]), "end_time": float(times[-1]), "original_size": times.size}
    return {"ephemeris_times": times.tolist(), **{f"{kind}_table_{key}": value for key, value in said.items()}}


def _no_sun(tables: RefinedTables) -> SunTable:
    """Zeros, as in a model state without a Sun (reset() of usgscsm): the key has to be there, and with three times."""
    times = tables.epoch + tables.position_times[[0, tables.position_times.size // 2, -1]]
    zeros = [(0.0, 0.0, 0.0)] * 3
    return SunTable(ephemeris_times=times.tolist(), positions=zeros, velocities=zeros, reference_frame=J2000)
