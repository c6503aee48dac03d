"""CSM image support data (JSON) of a line scanner, as ALE and ISIS write them, to a PushbroomImage.

Kilometres and millimetres become metres here; ISIS lines (top edge of the first line at 0.5) become lines from 0.0.
Formulas of the detector: ISIS CameraDetectorMap, CameraFocalPlaneMap; quaternions: scalar first, NAIF q2m.

Known errors of programs in support data are corrected where the file itself shows them, and reported.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.cameras.camera import NaifKeywords
from mgsgraph.files.cameras.line_scanners import ATTITUDE_BIAS, CORRECTIONS, MI, PITCH, corrected, themis_of_line
from mgsgraph.files.cameras.other_sensors import model_words
from mgsgraph.files.decoding import fields_of, validated
from mgsgraph.files.geometric_keys import SUPPORT_DATA, require_usual, unread
from mgsgraph.files.labels.aberration import (
    Aberration,
    Spacecraft,
    aberration_of,
    geometric,
    remarks_on,
    spacecraft_named,
    spacecraft_of,
)
from mgsgraph.files.labels.isis_cube import is_cube_json
from mgsgraph.files.opening import read_json
from mgsgraph.files.support_data.isd_layout import (
    J2000,
    MODEL,
    UNITS,
    RotationTable,
    StateTable,
    SupportData,
    distortion_of_support,
    support_optics,
)
from mgsgraph.files.support_data.second_statements import (
    contradictions_of_constants,
    contradictions_of_times,
    keywords_of_camera,
    lopsided,
    odd_pixels,
    odd_rows,
)
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, KaguyaDistortion, KaguyaMiDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.plausibility import require_flight
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, KM, MM

_LIKENESS = 0.8
"""Likeness (difflib) from which on an unknown key is a slip in one that is known and missing."""


def read_isd(path: Path, name: str, aberration: Aberration | None = None) -> PushbroomImage:
    """Read image support data.

    Parameters
    ----------
    path : Path
        JSON file.
    name : str
        By which control networks and shots call the image.
    aberration : Aberration, optional
        Overrules what the file says of its position table.

    Raises
    ------
    InputError
        Missing or malformed file, key missing or of the wrong kind, another sensor model than a line scanner,
        positions that may be geometric or not, or a known error that can't be corrected.
    """
    content, source = read_json(path), str(path)
    if (model := content.get("name_model", MODEL)) != MODEL:
        raise InputError(f"{source}, name_model", model_words(model), f"{MODEL} (a line scanner)")
    if "instrument_position" not in content and "sensor_position" in content:
        raise InputError(
            source, "the older usgscsm layout (sensor_position, sensor_orientation)",
            "ALE's layout (instrument_position, instrument_pointing, body_rotation)",
            "write it with ale.loads/isd_generate",
        )
    require(
        not is_cube_json(content), source, "the tables of an ISIS cube, without its camera", "support data of an image",
        "name it as image = ..., with the cube's label beside it",
    )  # fmt: skip
    require_usual(content, SUPPORT_DATA, source)
    support = validated(content, SupportData, source)
    _require_no_slips(content, SupportData, source)
    keywords, remarks = keywords_of_camera(support, source)
    remarks += contradictions_of_times(support, keywords, source)
    isd, repairs = repaired(support, source)
    remarks += lopsided(isd) if isd.line_scan_rate is support.line_scan_rate else ()
    unit = UNITS[isd.radii.unit]
    body = Ellipsoid(isd.radii.semimajor * unit, isd.radii.semiminor * unit)
    with errors_from(source):
        interior = _interior(isd, source)
        if isinstance(interior.distortion, KaguyaMiDistortion):
            repairs.append("kaguyalism of MI by the signed place along the detector (ISIS), not by the radius")
        remarks += [*repairs, *contradictions_of_constants(isd, body, keywords, source)]
        remarks += [*odd_rows(isd), *_unread(content)]
        trajectory, words = _trajectory(isd, body, aberration, source)
        image = PushbroomImage(
            name=name, lines=isd.image_lines, samples=isd.image_samples, interior=interior,
            timing=_timing(isd, source), trajectory=trajectory, body=body,
            mission=spacecraft.names[-1] if (spacecraft := _spacecraft(isd)) else "",
        )  # fmt: skip
        return replace(image, remarks=(*remarks, *words, *odd_pixels(image)))


def _unread(content: dict[str, Any]) -> list[str]:
    names = [f"{key}.{inner}" for key, value in content.items() if isinstance(value, dict) for inner in value]
    names += [key for key, value in content.items() if not isinstance(value, dict)]
    keys = unread([name for name in names if not name.startswith("naif_keywords")], SUPPORT_DATA)
    return [f"nothing reads the key {', '.join(keys)}"] if keys else []


def _timing(isd: SupportData, source: str) -> LineTiming:
    table = np.array(isd.line_scan_rate)
    if np.any(table[:, 2] <= 0.0):
        raise InputError(f"{source}, line_scan_rate", f"{table[:, 2].min()} s per line", "positive line periods")
    return LineTiming(table[:, 0] - ISIS_OFFSET, table[:, 1], table[:, 2])


def _interior(isd: SupportData, source: str) -> InteriorOrientation:
    to_pixel = np.array([isd.focal2pixel_lines, isd.focal2pixel_samples])
    to_pixel[:, 1:] /= MM  # pixels per mm of the file to pixels per m
    focal_length = isd.focal_length_model.focal_length * MM
    distortion = distortion_of_support(isd.optical_distortion, focal_length, f"{source}, optical_distortion")
    if isinstance(distortion, KaguyaDistortion) and any(_has_code(isd, camera.instrument) for camera in MI):
        distortion = KaguyaMiDistortion(distortion.x, distortion.y)
    return InteriorOrientation(
        focal_length=focal_length,
        to_pixel=to_pixel,
        centre=np.array([isd.detector_center.line, isd.detector_center.sample]),
        first=np.array([isd.starting_detector_line, isd.starting_detector_sample]),
        sample_summing=isd.detector_sample_summing,
        distortion=distortion,
    )


def _has_code(isd: SupportData, code: int) -> bool:
    """Whether keywords are of an instrument."""
    return any(key.startswith(f"INS{code}_") for key in isd.naif_keywords)


def _attitude(table: RotationTable, epoch: float, where: str) -> AttitudeTable:
    stated = table.constant_rotation is not msgspec.UNSET
    if not stated and len(table.constant_frames or ()) > 1:
        found = f"constant_frames {table.constant_frames} without constant_rotation"
        raise InputError(where, found, "the rotation between them")
    constant = np.array(table.constant_rotation).reshape(3, 3) if stated else np.eye(3)
    with errors_from(where):
        return AttitudeTable(np.array(table.ephemeris_times) - epoch, np.array(table.quaternions), constant)


def _trajectory(
    isd: SupportData, body: Ellipsoid, aberration: Aberration | None, source: str
) -> tuple[Trajectory, list[str]]:
    epoch = isd.center_ephemeris_time
    for key in ("instrument_position", "instrument_pointing", "body_rotation"):
        require_j2000(getattr(isd, key), f"{source}, {key}")
    with errors_from(f"{source}, instrument_position"):
        position, words = positions(isd, body, aberration, source)
    pointing = _attitude(isd.instrument_pointing, epoch, f"{source}, instrument_pointing")
    turning = _attitude(isd.body_rotation, epoch, f"{source}, body_rotation")
    return Trajectory(epoch, position, pointing, turning), words


# --- geometric positions


def _require_no_slips(table: dict[str, Any], kind: type[msgspec.Struct], where: str) -> None:
    """Raise InputError for a misspelled key, in whose place a default would be taken."""
    fields = {field.encode_name: field.type for field in fields_of(kind)}
    missing = [name for name in fields if name not in table]
    for key, value in table.items():
        if key not in fields and (close := get_close_matches(key, missing, n=1, cutoff=_LIKENESS)):
            raise InputError(where, f"the unknown key {key!r}", remedy=f"did you mean {close[0]!r}?")
        if isinstance(value, dict) and (inner := _record(fields.get(key))) is not None:
            _require_no_slips(value, inner, f"{where}, {key}")


def _record(kind: Any) -> type[msgspec.Struct] | None:
    """The record that a field holds, which may be optional."""
    choices: Sequence[Any] = (kind, *getattr(kind, "__args__", ()))
    return next((choice for choice in choices if isinstance(choice, type) and issubclass(choice, msgspec.Struct)), None)


def positions(
    isd: SupportData, body: Ellipsoid, given: Aberration | None, source: str
) -> tuple[PositionTable, list[str]]:
    """Geometric positions at times past ``center_ephemeris_time``, and how they were computed, in sentences.

    Parameters
    ----------
    isd : SupportData
        What the file says.
    body : Ellipsoid
        For light time to the surface.
    given : Aberration, optional
        Overrules file and sensor.
    source : str
        The file, for messages.
    """
    table, where = isd.instrument_position, f"{source}, instrument_position"
    if table.velocities is None:
        raise InputError(where, "no velocities", "one per position", "write the support data with velocities")
    unit = UNITS[table.unit]
    apparent = PositionTable(
        np.array(table.ephemeris_times) - isd.center_ephemeris_time,
        np.array(table.positions).reshape(-1, 3) * unit, np.array(table.velocities).reshape(-1, 3) * unit,
    )  # fmt: skip
    require_flight(apparent, where)
    stated, why = (given, "as the case says") if given else _stated(isd, source)
    if stated.correction == "NONE":
        return apparent, list(remarks_on(stated, why))
    radius = 0.5 * (body.equatorial + body.polar)
    true = geometric(apparent, _body_velocity(isd, f"{source}, sun_position"), stated, radius)
    return true, list(remarks_on(stated, why))


def require_j2000(table: StateTable | RotationTable, where: str) -> None:
    """Raise InputError for a table in another frame than J2000."""
    if table.reference_frame not in (msgspec.UNSET, J2000):
        raise InputError(f"{where}, reference_frame", f"{table.reference_frame:g}", "1 (J2000)")


def _stated(isd: SupportData, source: str) -> tuple[Aberration, str]:
    """By the keywords in the file, or else by the platform; no guess. The reason, where it was not the keywords."""
    if (stated := aberration_of(isd.naif_keywords, source)) is not None:
        return stated, ""
    spacecraft = _spacecraft(isd)
    if spacecraft is None:
        raise InputError(
            f"{source}, naif_keywords", f"no INS..._LIGHTTIME_CORRECTION, and the platform {isd.name_platform!r}",
            "a statement whether the positions are geometric or apparent",
            "set aberration = 'NONE' or 'LT+S' (and observer = 'body' or 'spacecraft') for this image in the case file",
        )  # fmt: skip
    return spacecraft.stated, spacecraft.source


def _spacecraft(isd: SupportData) -> Spacecraft | None:
    """By name_platform, or by the one whose instruments the keywords are of."""
    named = spacecraft_named(isd.name_platform or "")
    codes = {int(key[3:].partition("_")[0]) // -1000 for key in isd.naif_keywords if re.match(r"INS-\d{5,6}_", key)}
    return named or (spacecraft_of(-codes.pop()) if len(codes) == 1 else None)


def _body_velocity(isd: SupportData, where: str) -> Array:
    """m/s, (3,), of the body about the Sun at the image's middle: minus the Sun's about the body."""
    sun = isd.sun_position
    if sun is None or sun.velocities is None:
        found, expected = "no velocities", "the Sun's velocity, to undo the stellar aberration of positions"
        raise InputError(where, found, expected)
    require_j2000(sun, where)
    times, velocities = np.array(sun.ephemeris_times), np.array(sun.velocities).reshape(-1, 3) * UNITS[sun.unit]
    if np.any(np.diff(times) <= 0.0) or len(velocities) != times.size:
        found = f"{times.size} times and {len(velocities)} velocities"
        raise InputError(f"{where}, ephemeris_times", found, "increasing times, and a velocity for each")
    if len(sun.positions) == times.size > 1:
        places = np.array(sun.positions).reshape(-1, 3) * UNITS[sun.unit]
        require_flight(PositionTable(times - isd.center_ephemeris_time, places, velocities), where)
    return np.array([-np.interp(isd.center_ephemeris_time, times, axis) for axis in velocities.T])


# --- repairs

_LONGEST = 1e5
"""s, longer than any image takes."""
_FASTEST = 1e5
"""m/s, faster than anything that takes images."""
_SAME = 1e-3
_MOC = "MGS_MOC_"
_HRSC = ("MEX_HRSC", "HIGH RESOLUTION STEREO CAMERA")
_CTX, _CTX_LONGEST = "CONTEXT CAMERA", 2.8e-3
"""s, longer than one line time of CTX (1.877 ms) and shorter than two."""
_MOC_CENTRE, _MOC_STATED = 1024.0, (1023.5, 1024.0, 1024.5)
"""Principal point of the narrow angle, pixels from the detector's edge, and how files have it: from the first pixel's
centre as 0 (ALE: CENTER of the instrument kernel) or 1 (ISIS), and right.
"""
_THEMIS, _THEMIS_FOCAL_LENGTH = -53031, (202.059, 203.9213)
"""mm: ALE's, and ISIS's."""
_HRSC_PITCH = 142.857
"""Pixels of 7 micrometres per mm."""
_HRSC_SIZES = {2584: 2, 1288: 4, 640: 8}
"""Macropixels of archived images by their number of samples."""
Corrected = tuple[SupportData, list[str]]
"""Support data, and what was corrected, in sentences."""
_ANOTHER_ROAD = "read its cube after spiceinit, or its label and kernels"


def repaired(isd: SupportData, source: str) -> Corrected:
    """Support data as they were meant, and what was corrected, in sentences.

    Raises
    ------
    InputError
        Where something is known to be wrong, but not what would be right.
    """
    _require_units(isd, source)
    remarks = list[str]()
    for repair in (_line_times_past_epoch, _line_times_of_lroc, _boresight_by_isis, _moc, _hrsc, _ctx, _themis):
        isd, words = repair(isd, source)
        remarks += words
    return isd, remarks


def _require_units(isd: SupportData, source: str) -> None:
    """Refuse metres that are called kilometres, and the other way round."""
    table, where = isd.instrument_position, f"{source}, instrument_position"
    if table.velocities:
        speed = np.abs(np.array(table.velocities)).max() * UNITS[table.unit]
        if speed > _FASTEST:
            found = f"a camera that moves at {speed / KM:g} km/s"
            raise InputError(where, found, "kilometres", "divide positions and velocities by 1000, or write unit 'm'")


def _line_times_past_epoch(isd: SupportData, _: str) -> Corrected:
    """Older ALE wrote HRSC's line times as ephemeris times; those of all programs count from the centre time."""
    table = np.array(isd.line_scan_rate)
    late = np.abs(table[:, 1] - isd.center_ephemeris_time) < _LONGEST
    if not (np.any(np.abs(table[:, 1]) > _LONGEST) and np.all(late)):
        return isd, []
    table[:, 1] -= isd.center_ephemeris_time
    return _with_rates(isd, table), ["line times past J2000 counted from center_ephemeris_time"]


def _line_times_of_lroc(isd: SupportData, source: str) -> Corrected:
    """Line times with the corrections that ISIS's camera of LROC-NAC makes, where the file lacks them.

    ISIS's own support data have the times of the label, while its keywords state a preroll in lines and an error of
    the line period (ISIS LroNarrowAngleCamera). Its tables begin with the corrected first line, and so show that the
    correction is still to be made; ALE's times hold it.
    """
    code_of = re.compile(rf"INS(-?\d{{1,9}})_{CORRECTIONS[1]}", re.ASCII)
    codes = {int(match[1]) for key in isd.naif_keywords if (match := code_of.fullmatch(key))}
    if len(isd.line_scan_rate) != 1 or len(codes) != 1:
        return isd, []
    keywords, code = NaifKeywords(source, isd.naif_keywords), codes.pop()
    line, label_start, label_period = isd.line_scan_rate[0]
    start, period = corrected(keywords, code, label_start, label_period)
    first = isd.instrument_pointing.ephemeris_times[0] - isd.center_ephemeris_time
    if abs(first - start) >= period:
        return isd, []
    words = f"line times of the label corrected as ISIS does: first line {start - label_start:+.6f} s, period x " \
        f"{period / label_period:g}"
    return _with_rates(isd, np.array([[line, start, period]])), [words]


def _boresight_by_isis(isd: SupportData, _: str) -> Corrected:
    """ISIS counts the centre of the detector's first pixel as 1. Older ALE gave its keyword for the centre as it
    stands, present drivers take the half pixel off. Only with it off do ISIS's own adjusted cameras of NAC-L and NAC-R
    see the points that they were fixed to (docs/evidence_real.md).
    """
    stated = [value for key, value in isd.naif_keywords.items() if key.endswith("_BORESIGHT_SAMPLE")]
    if stated != [isd.detector_center.sample] or isd.starting_detector_sample % 1.0 == ISIS_OFFSET:
        return isd, []  # ALE's files of Kaguya count the first pixel's edge as 0.5, as ISIS does
    centre = structs.replace(isd.detector_center, sample=isd.detector_center.sample - ISIS_OFFSET)
    words = f"detector_center {stated[0]:g} is ISIS's BORESIGHT_SAMPLE, half a pixel too much, which is taken off"
    return structs.replace(isd, detector_center=centre), [words]


def _moc(isd: SupportData, source: str) -> Corrected:
    """What ALE's mgs_drivers write of MOC: line periods without the summing, a pixel pitch as distortion, FORTRAN's
    counting of the first sample and the centre, and attitudes whose labels it moves by 1.15 s.
    """
    if not (isd.name_sensor or "").startswith(_MOC):
        return isd, []
    isd, of_lines = _moc_line_period(isd)
    isd, of_optics = _moc_optics(isd, source)
    _require_moc_attitude(isd, source)
    return isd, of_lines + of_optics


def _moc_line_period(isd: SupportData) -> Corrected:
    (line, start, period), *others = isd.line_scan_rate
    summing, lasts = isd.detector_line_summing, -2.0 * start  # center_ephemeris_time is the middle
    for times, unit in ((summing, ""), (summing / 1000.0, ", and milliseconds were called seconds")):
        if not others and abs(times - 1.0) > _SAME and abs(isd.image_lines * period * times / lasts - 1.0) < _SAME:
            words = f"line period multiplied by the summing of {summing:g} (ALE leaves it out{unit})"
            return _with_rates(isd, np.array([[line, start, period * times]])), [words]
    return isd, []


def _moc_optics(isd: SupportData, source: str) -> Corrected:
    coefficients = isd.optical_distortion.get("radial", {}).get("coefficients")
    if not isinstance(coefficients, list) or len(coefficients) != 3 or not any(coefficients):
        return isd, []
    pitches = all(isinstance(value, int | float) and abs(value - PITCH) <= 1e-9 for value in coefficients[1:])
    if isd.name_sensor != f"{_MOC}NA" or not pitches:
        raise InputError(
            f"{source}, optical_distortion", f"a radial one of {coefficients} for {isd.name_sensor}",
            "that of ISIS's camera: these are pixel sizes, given for coefficients by ALE's mgs_drivers", _ANOTHER_ROAD,
        )  # fmt: skip
    if isd.detector_center.sample not in _MOC_STATED:
        found = f"{isd.detector_center.sample:g}"
        raise InputError(f"{source}, detector_center.sample", found, f"1024.5, as ISIS has it; {_ANOTHER_ROAD}")
    centre = structs.replace(isd.detector_center, sample=_MOC_CENTRE)
    isd = structs.replace(
        isd, optical_distortion={}, detector_center=centre, starting_detector_sample=isd.starting_detector_sample - 1.0
    )
    words = "no distortion (ALE gives the pixel pitch for coefficients); first sample and centre counted from 0, not 1"
    return isd, [words]


def _require_moc_attitude(isd: SupportData, source: str) -> None:
    """ISIS's attitude at time t is the C-kernel's of t - 1.15 s. Where ALE has sampled the C-kernel at the times of
    lines, it lacks either that (older versions) or the first 1.15 s (newer ones, which move the labels only).
    """
    table, where = np.array(isd.instrument_pointing.ephemeris_times), f"{source}, instrument_pointing"
    first = isd.center_ephemeris_time + isd.line_scan_rate[0][1]
    after, dense = table[0] - first, table.size > 2 and (table[-1] - table[0]) / (table.size - 1) < 0.1
    if dense and abs(after + ATTITUDE_BIAS) < _SAME:
        found = f"attitudes from {-ATTITUDE_BIAS} s after the first line on (labels moved by MOC's bias, not times)"
        raise InputError(where, found, "attitudes for every line", _ANOTHER_ROAD)
    if dense and abs(after) < _SAME:
        found = "attitudes of the C-kernel at the lines' own times"
        raise InputError(where, found, f"those of {-ATTITUDE_BIAS} s before, as ISIS takes them for MOC", _ANOTHER_ROAD)


def _hrsc(isd: SupportData, source: str) -> Corrected:
    """What ALE's mex_drivers write of HRSC: no summing where the image has macropixels, and the pixels of the SRC."""
    if not (isd.name_sensor or "").startswith(_HRSC):
        return isd, []
    per_mm = float(np.linalg.norm(isd.focal2pixel_samples[1:]))
    if abs(per_mm / _HRSC_PITCH - 1.0) > _SAME:
        found = f"{per_mm:.6g} pixels per mm"
        expected = f"HRSC's {_HRSC_PITCH}, of 7 micrometres"
        raise InputError(f"{source}, focal2pixel_samples", found, expected, _ANOTHER_ROAD)
    summing = _HRSC_SIZES.get(isd.image_samples, 1)
    if isd.detector_sample_summing != 1.0 or summing == 1:
        return isd, []
    words = f"macropixels of {summing}, as {isd.image_samples} samples of HRSC are (ALE says 1)"
    return structs.replace(isd, detector_sample_summing=float(summing)), [words]


def _ctx(isd: SupportData, source: str) -> Corrected:
    """Lines of CTX summed 2 x 2 take two line times (ISIS CTXCamera), of which ALE's mro_drivers write one; by labels,
    its tables end with these, in the image's middle.
    """
    line, start, period = isd.line_scan_rate[0]
    summing = isd.detector_sample_summing
    if isd.name_sensor != _CTX or summing == 1.0 or period > _CTX_LONGEST or len(isd.line_scan_rate) > 1:
        return isd, []
    end = isd.center_ephemeris_time + start + isd.image_lines * period * summing
    if isd.instrument_position.ephemeris_times[-1] < end - _SAME:
        found, expected = f"lines of {period:g} s, summed {summing:g}", f"{period * summing:g} s, and tables as long"
        raise InputError(f"{source}, line_scan_rate", found, f"{expected} (ALE leaves the summing out)", _ANOTHER_ROAD)
    words = f"line period multiplied by the summing of {summing:g} (ALE leaves it out)"
    return _with_rates(isd, np.array([[line, start, period * summing]])), [words]


def _themis(isd: SupportData, source: str) -> Corrected:
    """What ALE's ody_drivers write of THEMIS-IR: another focal length, no distortion, and half a detector line less
    ahead at a time half a line later. Of cubes with tables the line tells the band; of those without neither line nor
    time is the band's.
    """
    stated, right = _THEMIS_FOCAL_LENGTH
    plain = not any(np.any(model.get("coefficients", [1.0])) for model in isd.optical_distortion.values())
    if not (_has_code(isd, _THEMIS) and plain):
        return isd, []
    distortion = themis_of_line(isd.starting_detector_line)
    if isd.focal_length_model.focal_length not in (stated, right) or distortion is None:
        found = f"no distortion, {isd.focal_length_model.focal_length:g} mm, line {isd.starting_detector_line:g}"
        raise InputError(f"{source}, optical_distortion", found, "that of a band of THEMIS-IR", _ANOTHER_ROAD)
    isd = structs.replace(
        isd, focal_length_model=structs.replace(isd.focal_length_model, focal_length=right),
        optical_distortion=support_optics(distortion, source), starting_detector_line=isd.starting_detector_line + 0.5,
    )  # fmt: skip
    table = np.array(isd.line_scan_rate)
    table[:, 1] -= 0.5 * table[:, 2] / isd.detector_sample_summing
    words = f"focal length {right} mm, distortion and line of THEMIS-IR's band by ISIS (ALE: {stated} mm, none)"
    return _with_rates(isd, table), [words]


def _with_rates(isd: SupportData, table: Array) -> SupportData:
    rows = [(float(line), float(start), float(period)) for line, start, period in table]
    return structs.replace(isd, line_scan_rate=rows)
