"""CSM image support data (JSON) of a line scanner, as ALE and ISIS write them: to a PushbroomImage, and of one.

Kilometres and millimetres become metres here; ISIS lines (top edge of the first line at 0.5) become lines from 0.0.
Formulas of the detector: ISIS CameraDetectorMap, CameraFocalPlaneMap; quaternions: scalar first, NAIF q2m. Keys: ALE,
ale/formatters/formatter.py (to_isd).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import Distortion, LrocNacDistortion, NoDistortion, RadialDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.io.aberration import geometric
from mgsgraph.io.decoding import Count, Number, Positive, validated
from mgsgraph.io.files import read_json
from mgsgraph.units import ISIS_OFFSET, KM, MM

MODEL = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
"""What usgscsm calls a line scanner."""
Observer = Literal["body", "spacecraft"]
J2000 = 1
"""NAIF's code of the inertial frame."""
_LONGEST = 1e5
"""s, longer than any image takes."""
_UNITS = {"m": 1.0, "km": KM}
_Vector = tuple[Number, Number, Number]
_Quaternion = tuple[Number, Number, Number, Number]
_Matrix = Annotated[list[Number], msgspec.Meta(min_length=9, max_length=9)]
_Times = Annotated[list[Number], msgspec.Meta(min_length=1)]


# --- the layout


class StateTable(msgspec.Struct, omit_defaults=True, kw_only=True):
    """Positions and velocities of one body about another; km and km/s unless `unit` says m."""

    spk_table_start_time: float | None = None
    spk_table_end_time: float | None = None
    spk_table_original_size: int | None = None
    ephemeris_times: _Times
    """s TDB past J2000."""
    positions: list[_Vector]
    velocities: list[_Vector] | None = None
    unit: Literal["m", "km"] = "km"
    reference_frame: Number | msgspec.UnsetType = msgspec.UNSET
    """NAIF's code; J2000 is 1."""


class SunTable(StateTable):
    """The Sun relative to the body; of it only the velocity is needed."""

    positions: list[_Vector] = []


class RotationTable(msgspec.Struct, omit_defaults=True, kw_only=True):
    """Rotations from an inertial to another frame, the last step of which may be constant."""

    time_dependent_frames: list[int] | None = None
    constant_frames: list[int] | None = None
    ck_table_start_time: float | None = None
    ck_table_end_time: float | None = None
    ck_table_original_size: int | None = None
    ephemeris_times: _Times
    """s TDB past J2000."""
    quaternions: list[_Quaternion]
    angular_velocities: list[_Vector] | None = None
    """rad/s, about inertial axes."""
    constant_rotation: _Matrix | msgspec.UnsetType = msgspec.UNSET
    """Row by row."""
    reference_frame: Number | msgspec.UnsetType = msgspec.UNSET
    """NAIF's code; J2000 is 1."""


class _Radii(msgspec.Struct):
    semimajor: Positive
    semiminor: Positive
    unit: Literal["m", "km"] = "km"


class _FocalLength(msgspec.Struct):
    focal_length: Positive
    """mm."""


class _DetectorPixel(msgspec.Struct):
    line: Number
    sample: Number


class _Coefficients(msgspec.Struct):
    coefficients: float | list[Number] = []
    """Of powers of mm; ISIS writes a single one as a number."""


class SupportData(msgspec.Struct, omit_defaults=True, kw_only=True):
    """What is read and written of the support data of an image; they may hold more."""

    image_lines: Count
    image_samples: Count
    image_identifier: str | None = None
    name_model: str
    interpolation_method: str = "lagrange"
    line_scan_rate: Annotated[list[_Vector], msgspec.Meta(min_length=1)]
    """Line (top edge of the first one 0.5), s past center_ephemeris_time and s per line from there on."""
    starting_ephemeris_time: Number | None = None
    center_ephemeris_time: Number
    """s TDB past J2000."""
    radii: _Radii
    naif_keywords: dict[str, Any] = {}
    detector_sample_summing: Positive
    focal_length_model: _FocalLength
    detector_center: _DetectorPixel
    starting_detector_line: Number
    starting_detector_sample: Number
    focal2pixel_lines: _Vector
    """Pixels, and pixels per mm along x and y of the focal plane."""
    focal2pixel_samples: _Vector
    optical_distortion: dict[str, _Coefficients]
    body_rotation: RotationTable
    instrument_pointing: RotationTable
    instrument_position: StateTable
    sun_position: SunTable | None = None


# --- reading


@dataclass(frozen=True, slots=True)
class Aberration:
    """How the position table of an image was asked from SPICE."""

    correction: Literal["NONE", "LT+S"]
    """Aberration correction."""
    observer: Observer = "body"
    """Who observed whom; without meaning for "NONE"."""


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
        or positions of which nobody says whether they are geometric.
    """
    content, source = read_json(path), str(path)
    if "instrument_position" not in content and "sensor_position" in content:
        raise InputError(
            source, "the older usgscsm layout (sensor_position, sensor_orientation)",
            "ALE's layout (instrument_position, instrument_pointing, body_rotation)",
            "write it with ale.loads/isd_generate",
        )
    if (model := content.get("name_model", MODEL)) != MODEL:
        raise InputError(f"{source}, name_model", repr(model)[:60], f"{MODEL} (a line scanner)")
    isd = validated(content, SupportData, source, strict=True)
    unit = _UNITS[isd.radii.unit]
    body = Ellipsoid(isd.radii.semimajor * unit, isd.radii.semiminor * unit)
    with errors_from(source):
        trajectory = _trajectory(isd, aberration, source)
        image = PushbroomImage(
            name=name, lines=isd.image_lines, samples=isd.image_samples, interior=_interior(isd, source),
            timing=_timing(isd, source), trajectory=trajectory, body=body,
        )  # fmt: skip
    _require_outside(trajectory, body, source)
    return image


def _require_outside(trajectory: Trajectory, body: Ellipsoid, source: str) -> None:
    """A camera inside the body betrays metres that were called kilometres."""
    distance = np.linalg.norm(trajectory.position.positions, axis=1).min()
    if distance <= body.polar:
        raise InputError(
            f"{source}, instrument_position", f"a camera {distance / KM:.3f} km from the body's centre",
            f"more than its radius, {body.polar / KM:.3f} km", "check the units of positions and radii",
        )


def _timing(isd: SupportData, source: str) -> LineTiming:
    table = np.array(isd.line_scan_rate)
    if np.any(table[:, 2] <= 0.0):
        raise InputError(f"{source}, line_scan_rate", f"{table[:, 2].min()} s per line", "positive line periods")
    late = np.abs(table[:, 1] - isd.center_ephemeris_time) < _LONGEST
    if np.any(np.abs(table[:, 1]) > _LONGEST) and np.all(late):
        raise InputError(
            f"{source}, line_scan_rate", f"times from {table[0, 1]:.3f} s on, since J2000",
            "seconds from center_ephemeris_time", "take center_ephemeris_time off them",
        )  # fmt: skip
    table = _isis_line_times(table, isd)
    return LineTiming(table[:, 0] - ISIS_OFFSET, table[:, 1], table[:, 2])


def _isis_line_times(table: Array, isd: SupportData) -> Array:
    """line_scan_rate (n, 3) with the corrections that ISIS's camera of LROC-NAC makes, where the file lacks them.

    ISIS's own support data have the times of the label, while its keywords state a preroll in lines and an error of
    the line period (ISIS LroNarrowAngleCamera). Its tables begin with the corrected first line, and so betray that the
    correction is still to be made; ALE's times hold it.
    """
    stated = [
        [value for key, value in isd.naif_keywords.items() if key.endswith(name) and isinstance(value, int | float)]
        for name in ("_ADDITIONAL_PREROLL", "_MULTIPLI_LINE_ERROR", "_ADDITIVE_LINE_ERROR")
    ]
    if len(table) != 1 or any(len(values) != 1 for values in stated):
        return table
    (preroll,), (factor,), (addend,) = stated
    line, start, period = table[0]
    period = period * (1.0 + factor) + addend
    start += preroll * period
    first = isd.instrument_pointing.ephemeris_times[0] - isd.center_ephemeris_time
    return np.array([[line, start, period]]) if abs(first - start) < period else table


def _interior(isd: SupportData, source: str) -> InteriorOrientation:
    to_pixel = np.array([isd.focal2pixel_lines, isd.focal2pixel_samples])
    to_pixel[:, 1:] /= MM  # pixels per mm of the file to pixels per m
    return InteriorOrientation(
        focal_length=isd.focal_length_model.focal_length * MM,
        to_pixel=to_pixel,
        centre=np.array([isd.detector_center.line, isd.detector_center.sample]),
        first=np.array([isd.starting_detector_line, isd.starting_detector_sample]),
        sample_summing=isd.detector_sample_summing,
        distortion=_distortion(isd.optical_distortion, f"{source}, optical_distortion"),
    )


def _distortion(models: dict[str, _Coefficients], where: str) -> Distortion:
    if not models:
        return NoDistortion()
    if len(models) > 1:
        raise InputError(where, f"{len(models)} models: {', '.join(models)}", "one")
    ((name, model),) = models.items()
    wanted = {"lrolrocnac": 1, "radial": 3}.get(name.lower())
    if wanted is None:
        raise InputError(where, f"the model {name!r}", "lrolrocnac, radial, or none at all")
    coefficients = model.coefficients if isinstance(model.coefficients, list) else [model.coefficients]
    if len(coefficients) != wanted or not np.all(np.isfinite(coefficients)):
        raise InputError(f"{where}.{name}.coefficients", f"{coefficients}"[:60], f"{wanted} finite numbers")
    if wanted == 1:
        return LrocNacDistortion(coefficients[0] / MM**2)
    k0, k1, k2 = coefficients
    return RadialDistortion(k0, k1 / MM**2, k2 / MM**4)


def _attitude(table: RotationTable, epoch: float, where: str) -> AttitudeTable:
    stated = table.constant_rotation is not msgspec.UNSET
    if not stated and len(table.constant_frames or ()) > 1:
        found = f"constant_frames {table.constant_frames} without constant_rotation"
        raise InputError(where, found, "the rotation between them")
    constant = np.array(table.constant_rotation).reshape(3, 3) if stated else np.eye(3)
    with errors_from(where):
        return AttitudeTable(np.array(table.ephemeris_times) - epoch, np.array(table.quaternions), constant)


def _trajectory(isd: SupportData, aberration: Aberration | None, source: str) -> Trajectory:
    epoch, table, where = isd.center_ephemeris_time, isd.instrument_position, f"{source}, instrument_position"
    if table.velocities is None:
        raise InputError(where, "no velocities", "one per position", "write the support data with velocities")
    unit = _UNITS[table.unit]
    with errors_from(where):
        position = PositionTable(
            np.array(table.ephemeris_times) - epoch, np.array(table.positions).reshape(-1, 3) * unit,
            np.array(table.velocities).reshape(-1, 3) * unit,
        )  # fmt: skip
    for key in ("instrument_position", "instrument_pointing", "body_rotation"):
        _require_j2000(getattr(isd, key), f"{source}, {key}")
    stated = aberration or _stated_aberration(isd.naif_keywords, source)
    if stated.correction == "LT+S":
        position = geometric(position, _body_velocity(isd, f"{source}, sun_position"), stated.observer == "body")
    pointing = _attitude(isd.instrument_pointing, epoch, f"{source}, instrument_pointing")
    return Trajectory(epoch, position, pointing, _attitude(isd.body_rotation, epoch, f"{source}, body_rotation"))


def _require_j2000(table: StateTable | RotationTable, where: str) -> None:
    if table.reference_frame not in (msgspec.UNSET, J2000):
        raise InputError(f"{where}, reference_frame", f"{table.reference_frame:g}", "1 (J2000)")


def _stated_aberration(keywords: dict[str, Any], source: str) -> Aberration:
    """What the ISIS keywords in the file say of its position table; never a guess."""
    corrections = [value for key, value in keywords.items() if key.endswith("_LIGHTTIME_CORRECTION")]
    swaps = [value for key, value in keywords.items() if key.endswith("_SWAP_OBSERVER_TARGET")]
    if not corrections:
        raise InputError(
            f"{source}, naif_keywords", "no INS..._LIGHTTIME_CORRECTION",
            "a statement whether the positions are geometric or apparent",
            "set aberration = 'NONE' or 'LT+S' (and observer = 'body' or 'spacecraft') for this image in the case file",
        )
    for values in (corrections, swaps):
        if any(value != values[0] for value in values):
            found = f"keywords of several instruments that differ: {values}"
            raise InputError(f"{source}, naif_keywords", found, "those of the instrument that took the image")
    correction, swap = corrections[0], swaps[0] if swaps else False
    if not isinstance(correction, str) or correction.upper() not in ("NONE", "LT+S"):
        raise InputError(f"{source}, INS..._LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    if str(swap).upper() not in ("TRUE", "FALSE"):
        raise InputError(f"{source}, INS..._SWAP_OBSERVER_TARGET", repr(swap), "true or false")
    observer: Observer = "body" if str(swap).upper() == "TRUE" else "spacecraft"
    return Aberration("NONE", observer) if correction.upper() == "NONE" else Aberration("LT+S", observer)


def _body_velocity(isd: SupportData, where: str) -> Array:
    """m/s, (3,), of the body about the Sun at the image's middle: minus the Sun's about the body."""
    sun = isd.sun_position
    if sun is None or sun.velocities is None:
        found, expected = "no velocities", "the Sun's velocity, to undo the stellar aberration of positions"
        raise InputError(where, found, expected)
    _require_j2000(sun, where)
    times, velocities = np.array(sun.ephemeris_times), np.array(sun.velocities).reshape(-1, 3) * _UNITS[sun.unit]
    if np.any(np.diff(times) <= 0.0) or len(velocities) != times.size:
        found = f"{times.size} times and {len(velocities)} velocities"
        raise InputError(f"{where}, ephemeris_times", found, "increasing times, and a velocity for each")
    return np.array([-np.interp(isd.center_ephemeris_time, times, axis) for axis in velocities.T])


# --- writing


def support_fields(
    image: PushbroomImage,
    epoch: float,
    position: StateTable,
    pointing: RotationTable,
    body_rotation: RotationTable,
    sun_position: SunTable | None = None,
) -> dict[str, Any]:
    """Keys of support data, but for names of platform and sensor, NAIF keywords and whatever else a file may say.

    Parameters
    ----------
    image : PushbroomImage
        Whose camera constants and line times these are.
    epoch : float
        s TDB past J2000, the image's centre time.
    position, pointing, body_rotation, sun_position
        The trajectory: of the camera, inertial to camera axes, inertial to body-fixed axes, of the Sun.

    Raises
    ------
    InputError
        For a distortion that support data have no name for.
    """
    interior, timing, shift = image.interior, image.timing, epoch - image.trajectory.epoch
    to_pixel = interior.to_pixel.copy()
    to_pixel[:, 1:] *= MM
    model, coefficients = distortion_fields(interior.distortion, f"image {image.name}")
    first = epoch + float(timing.start_times[0]) - shift
    found: dict[str, Any] = msgspec.to_builtins(SupportData(
        image_lines=image.lines, image_samples=image.samples, image_identifier=image.name, name_model=MODEL,
        line_scan_rate=np.column_stack(
            [timing.first_lines + ISIS_OFFSET, timing.start_times - shift, timing.periods]
        ).tolist(),
        starting_ephemeris_time=first, center_ephemeris_time=epoch,
        radii=_Radii(image.body.equatorial / KM, image.body.polar / KM),
        detector_sample_summing=interior.sample_summing,
        focal_length_model=_FocalLength(interior.focal_length / MM),
        detector_center=_DetectorPixel(*interior.centre.tolist()),
        starting_detector_line=float(interior.first[0]), starting_detector_sample=float(interior.first[1]),
        focal2pixel_lines=to_pixel[0].tolist(), focal2pixel_samples=to_pixel[1].tolist(),
        optical_distortion={model: _Coefficients(coefficients)},
        body_rotation=body_rotation, instrument_pointing=pointing, instrument_position=position,
        sun_position=sun_position,
    ))  # fmt: skip
    return found | {"interpolation_method": "lagrange"}


def state_table(times: Array, positions: Array, velocities: Array) -> StateTable:
    """Positions (n, 3) in m and velocities in m/s against J2000 at times (n,) in s TDB past J2000."""
    return StateTable(
        ephemeris_times=times.tolist(), positions=(positions / KM).tolist(), velocities=(velocities / KM).tolist(),
        reference_frame=J2000,
    )  # fmt: skip


def rotation_table(times: Array, quaternions: Array, constant: Array) -> RotationTable:
    """Rotations (n, 4) from J2000 at times (n,) in s TDB past J2000, then a constant one (3, 3)."""
    return RotationTable(
        ephemeris_times=times.tolist(), quaternions=quaternions.tolist(), constant_rotation=constant.ravel().tolist(),
        reference_frame=J2000,
    )  # fmt: skip


def distortion_fields(distortion: Distortion, where: str) -> tuple[str, list[float]]:
    """Name of a distortion model in support data, and its coefficients for mm; raises InputError for a foreign one.

    Without distortion it is a radial one of zeros: ALE refuses support data that name none (src/Isd.cpp,
    getDistortionModel).
    """
    if isinstance(distortion, NoDistortion):
        return "radial", [0.0, 0.0, 0.0]
    if isinstance(distortion, RadialDistortion):
        return "radial", [distortion.k0, distortion.k1 * MM**2, distortion.k2 * MM**4]
    if isinstance(distortion, LrocNacDistortion):
        return "lrolrocnac", [distortion.k * MM**2]
    found = f"the model {type(distortion).__name__}"
    raise InputError(f"{where}, optical_distortion", found, "none, radial, or that of LROC NAC")
