"""CSM image support data (JSON) of a line scanner, as ALE and ISIS write them, to a PushbroomImage.

Kilometres and millimetres become metres here; ISIS lines (top edge of the first line at 0.5) become lines from 0.0.
Formulas of the detector: ISIS CameraDetectorMap, CameraFocalPlaneMap; quaternions: scalar first, NAIF q2m.
"""

import re
from pathlib import Path

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.cameras.camera import NaifKeywords, number
from mgsgraph.files.decoding import validated
from mgsgraph.files.labels.aberration import SPACECRAFT, Aberration, Spacecraft, aberration_of, geometric, remarks_on
from mgsgraph.files.labels.isis_cube import is_cube_json
from mgsgraph.files.opening import read_json
from mgsgraph.files.support_data.isd_layout import J2000, MODEL, UNITS, RotationTable, StateTable, SupportData
from mgsgraph.files.support_data.isd_repairs import repaired
from mgsgraph.files.support_data.optics import distortion_of_support
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.plausibility import require_flight
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, KM, MM

_SAME_RADII = 1e-3
"""Share by which radii may differ from those of the keywords: a sphere does so from Mars by six times that."""
_SAME_FOCAL_LENGTH = 0.01
"""Share by which a focal length may: a calibration changes it by less."""


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
        positions of which nobody says whether they are geometric, or what is known to be wrong and can't be put right.
    """
    content, source = read_json(path), str(path)
    if "instrument_position" not in content and "sensor_position" in content:
        raise InputError(
            source, "the older usgscsm layout (sensor_position, sensor_orientation)",
            "ALE's layout (instrument_position, instrument_pointing, body_rotation)",
            "write it with ale.loads/isd_generate",
        )
    if is_cube_json(content):
        raise InputError(
            source, "the tables of an ISIS cube, without its camera", "support data of an image",
            "name it as image = ..., with the cube's label beside it",
        )  # fmt: skip
    if (model := content.get("name_model", MODEL)) != MODEL:
        raise InputError(f"{source}, name_model", repr(model)[:60], f"{MODEL} (a line scanner)")
    isd, remarks = repaired(validated(content, SupportData, source), source)
    unit = UNITS[isd.radii.unit]
    body = Ellipsoid(isd.radii.semimajor * unit, isd.radii.semiminor * unit)
    require_own_constants(isd, body, source)
    with errors_from(source):
        trajectory, words = _trajectory(isd, body, aberration, source)
        return PushbroomImage(
            name=name, lines=isd.image_lines, samples=isd.image_samples, interior=_interior(isd, source),
            timing=_timing(isd, source), trajectory=trajectory, body=body, remarks=(*remarks, *words),
        )  # fmt: skip


def _timing(isd: SupportData, source: str) -> LineTiming:
    table = np.array(isd.line_scan_rate)
    if np.any(table[:, 2] <= 0.0):
        raise InputError(f"{source}, line_scan_rate", f"{table[:, 2].min()} s per line", "positive line periods")
    return LineTiming(table[:, 0] - ISIS_OFFSET, table[:, 1], table[:, 2])


def _interior(isd: SupportData, source: str) -> InteriorOrientation:
    to_pixel = np.array([isd.focal2pixel_lines, isd.focal2pixel_samples])
    to_pixel[:, 1:] /= MM  # pixels per mm of the file to pixels per m
    focal_length = isd.focal_length_model.focal_length * MM
    return InteriorOrientation(
        focal_length=focal_length,
        to_pixel=to_pixel,
        centre=np.array([isd.detector_center.line, isd.detector_center.sample]),
        first=np.array([isd.starting_detector_line, isd.starting_detector_sample]),
        sample_summing=isd.detector_sample_summing,
        distortion=distortion_of_support(isd.optical_distortion, focal_length, f"{source}, optical_distortion"),
    )


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


# --- support data against what they say a second time, in `naif_keywords`


def require_own_constants(isd: SupportData, body: Ellipsoid, source: str) -> None:
    """Raise InputError where radii, focal length or the detector's width contradict the file's own keywords.

    Parameters
    ----------
    isd : SupportData
        What the file says.
    body : Ellipsoid
        By its radii.
    source : str
        The file, for messages.
    """
    keywords = NaifKeywords(source, isd.naif_keywords)
    _require_radii(keywords, body, f"{source}, radii")
    if key := _only(keywords, "INS", "_FOCAL_LENGTH"):
        stated, found = number(keywords, key), isd.focal_length_model.focal_length
        if abs(found - stated) > _SAME_FOCAL_LENGTH * abs(stated):
            where, said = f"{source}, focal_length_model", f"{found:g} mm, where {key} says {stated:g}"
            raise InputError(where, said, "one focal length", "mend the wrong one")
    if key := _only(keywords, "INS", "_PIXEL_SAMPLES"):
        pixels, summing = number(keywords, key), isd.detector_sample_summing
        if isd.image_samples * summing > pixels + summing:
            where, said = f"{source}, detector_sample_summing", f"{isd.image_samples} samples of {summing:g} pixels"
            raise InputError(where, said, f"no more than the {pixels:g} pixels that {key} says", "mend one of them")


def _require_radii(keywords: NaifKeywords, body: Ellipsoid, where: str) -> None:
    code = int(number(keywords, "BODY_CODE")) if "BODY_CODE" in keywords else None
    key = f"BODY{code}_RADII" if code is not None else _only(keywords, "BODY", "_RADII")
    require_possible(body, body_name(code) if code is not None else "", where)
    if key not in keywords:
        return
    stated = keywords.numbers(key, 3) * KM
    for name, found, said in (("semimajor", body.equatorial, stated[0]), ("semiminor", body.polar, stated[2])):
        if abs(found - said) > _SAME_RADII * abs(said):
            both = f"{found / KM:.9g} km, where {key} says {said / KM:.9g} km"
            raise InputError(f"{where}.{name}", both, "one radius", f"mend radii, their unit or {key}")


def _only(keywords: NaifKeywords, begin: str, end: str) -> str:
    """The only keyword with such a beginning and end; empty where there are none, or several."""
    names = [key for key in keywords.values if key.startswith(begin) and key.endswith(end)]
    return names[0] if len(names) == 1 else ""


# --- geometric positions


def positions(
    isd: SupportData, body: Ellipsoid, given: Aberration | None, source: str
) -> tuple[PositionTable, list[str]]:
    """Geometric positions at times past ``center_ephemeris_time``, and how they were come by, in sentences.

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
    stated, why = (given, "as the case says") if given else _stated(isd, source)
    if stated.correction == "NONE":
        return apparent, list(remarks_on(stated, why))
    require_flight(apparent, where)
    radius = 0.5 * (body.equatorial + body.polar)
    found = geometric(apparent, _body_velocity(isd, f"{source}, sun_position"), stated, radius)
    return found, list(remarks_on(stated, why))


def require_j2000(table: StateTable | RotationTable, where: str) -> None:
    """Raise InputError for a table in another frame than J2000."""
    if table.reference_frame not in (msgspec.UNSET, J2000):
        raise InputError(f"{where}, reference_frame", f"{table.reference_frame:g}", "1 (J2000)")


def _stated(isd: SupportData, source: str) -> tuple[Aberration, str]:
    """By the keywords in the file, or else by the platform; never a guess. Why, where it was not the keywords."""
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
    name = " ".join(re.split(r"[^A-Z0-9]+", (isd.name_platform or "").upper())).strip()
    codes = {int(key[3:].partition("_")[0]) // -1000 for key in isd.naif_keywords if re.match(r"INS-\d{5,6}_", key)}
    found = [one for one in SPACECRAFT if name in one.names]
    if not found and len(codes) == 1:
        found = [one for one in SPACECRAFT if -one.code in codes]
    return found[0] if found else None


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
    return np.array([-np.interp(isd.center_ephemeris_time, times, axis) for axis in velocities.T])
