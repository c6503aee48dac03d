"""Layout of CSM image support data (JSON) of a line scanner: the keys that are read and written of those of ALE
(ale/formatters/formatter.py, to_isd) and ISIS (isd_generate, "isis_camera_version" 1 and 2). Units are the file's.

Models of distortion as usgscsm and ALE name, number and write them, in mm, and as records in m.

Names and layouts of support data: ALE (ale/base/type_distortion.py; C++ src/Util.cpp, getDistortionModel,
getDistortionCoeffs); numbers and orders of coefficients of model states: usgscsm (include/usgscsm/Distortion.h,
src/Distortion.cpp). ISIS writes a single coefficient as a number, ALE as a list of one.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.decoding import Count, Number, Positive
from mgsgraph.geometry.camera import (
    CahvorDistortion,
    DawnDistortion,
    Distortion,
    KaguyaDistortion,
    LrocNacDistortion,
    NoDistortion,
    RadialDistortion,
    RadtanDistortion,
    ShadowCamDistortion,
    ThemisIrDistortion,
    TransverseDistortion,
)
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import ISIS_OFFSET, KM, MM

_CUBIC = (1, 0, 0, -1, -1, -1, -2, -2, -2, -2)
_KAGUYA = (1, 1, 0, -1, -2)
_FRAMING = {"lunarorbiter": 6, "cassis": 9}
"""Models of cameras that are no line scanners."""


@dataclass(frozen=True, slots=True)
class _Model:
    """One model: its coefficients in the order of model states."""

    kind: type[Distortion]
    number: int
    """DistortionType of usgscsm."""
    powers: tuple[int, ...]
    """Of mm, the coefficients' units."""
    made: Callable[[list[float], float], Distortion]
    """From coefficients in m and the focal length in m."""
    axes: bool = False
    """Whether x and y have coefficients of their own, under their names."""


_MODELS = {
    "radial": _Model(RadialDistortion, 0, (0, -2, -4), lambda c, _: RadialDistortion(*c)),
    "transverse": _Model(
        TransverseDistortion, 1, _CUBIC * 2, lambda c, _: TransverseDistortion(_ten(c[:10]), _ten(c[10:])), axes=True
    ),
    "kaguyalism": _Model(KaguyaDistortion, 2, _KAGUYA * 2, lambda c, _: _kaguya(c), axes=True),
    "dawnfc": _Model(DawnDistortion, 3, (-2,), lambda c, _: DawnDistortion(*c)),
    "lrolrocnac": _Model(LrocNacDistortion, 4, (-2,), lambda c, _: LrocNacDistortion(*c)),
    "cahvor": _Model(
        CahvorDistortion, 5, (0, -2, -4, 1, 1), lambda c, _: CahvorDistortion(RadialDistortion(*c[:3]), *c[3:])
    ),
    "radtan": _Model(RadtanDistortion, 7, (0,) * 5, lambda c, f: RadtanDistortion(c[0], c[1], c[2], c[3], c[4], f)),
    "kplo_shadowcam": _Model(ShadowCamDistortion, 8, (-2,), lambda c, _: ShadowCamDistortion(*c)),
}
NUMBERS = {name: model.number for name, model in _MODELS.items()}
"""DistortionType of usgscsm by the name in support data."""
KNOWN = ", ".join(_MODELS)
"""Names, for messages."""


def _ten(c: list[float]) -> Any:
    return tuple(c)


def _kaguya(c: list[float]) -> KaguyaDistortion:
    """The boresight, which comes first of each axis, belongs to the constant term."""
    x, y = ((axis[0] + axis[1], axis[2], axis[3], axis[4]) for axis in (c[:5], c[5:]))
    return KaguyaDistortion(x, y)


# --- reading


def distortion_of_support(models: Mapping[str, Mapping[str, Any]], focal_length: float, where: str) -> Distortion:
    """Of ``optical_distortion`` of support data; the focal length in m.

    Raises
    ------
    InputError
        For several models, an unknown one or one of a framing camera, and for coefficients that are not as many
        finite numbers as the model has.
    """
    if not models:
        return NoDistortion()
    require(len(models) <= 1, where, f"{len(models)} models: {', '.join(models)}", "one")
    ((stated, values),) = models.items()
    name = stated.lower()
    model = _model_named(name, f"the model {stated!r}", where)
    if not model.axes:
        coefficients = _numbers(values.get("coefficients", []), f"{where}.{stated}.coefficients", len(model.powers))
        return _distortion(model, coefficients, focal_length)
    size = len(model.powers) // 2
    both = []
    for axis in ("x", "y"):
        ahead = [f"boresight_{axis}"] if name == "kaguyalism" else []
        own = _listed(values.get(axis, []))
        filled = [*own, *[0.0] * (size - len(ahead) - len(own))] if own else own  # ALE fills up with zeros, too
        both += [_numbers(values.get(key, 0.0), f"{where}.{stated}.{key}", 1)[0] for key in ahead]
        both += _numbers(filled, f"{where}.{stated}.{axis}", size - len(ahead))
    return _distortion(model, both, focal_length)


def distortion_of_state(number: int, coefficients: list[float], focal_length: float, where: str) -> Distortion:
    """Of ``m_distortionType`` and ``m_opticalDistCoeffs`` of a model state; the focal length in m."""
    names = {value: name for name, value in [*NUMBERS.items(), *_FRAMING.items()]}
    model = _model_named(names.get(number, ""), f"the type {number}", f"{where}, m_distortionType")
    return _distortion(model, _numbers(coefficients, f"{where}, m_opticalDistCoeffs", len(model.powers)), focal_length)


def _model_named(name: str, found: str, where: str) -> _Model:
    require(name not in _FRAMING, where, f"{found}, of a framing camera", f"a line scanner's: {KNOWN}")
    require(name in _MODELS, where, found, f"{KNOWN}, or none at all")
    return _MODELS[name]


def _listed(values: Any) -> list[Any]:
    return values if isinstance(values, list) else [values]


def _numbers(values: Any, where: str, size: int) -> list[float]:
    listed = _listed(values)
    good = all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e300 for v in listed)
    require(good and len(listed) == size, where, f"{listed}"[:60], f"{size} finite numbers")
    return [float(value) for value in listed]


def _distortion(model: _Model, coefficients: list[float], focal_length: float) -> Distortion:
    metres = np.array(coefficients) * _scales(model)
    return NoDistortion() if not metres.any() and model.number == 0 else model.made(metres.tolist(), focal_length)


def _scales(model: _Model) -> Array:
    return np.array([MM**power for power in model.powers])


# --- writing


def state_optics(distortion: Distortion, where: str) -> tuple[str, list[float]]:
    """Name of a model, and its coefficients for mm in the order of model states; InputError for one that usgscsm does
    not have. THEMIS's is a transverse one.

    Without distortion it is a radial one of zeros: ALE refuses support data that name none (src/Isd.cpp,
    getDistortionModel).
    """
    if isinstance(distortion, NoDistortion):
        return "radial", [0.0, 0.0, 0.0]
    if isinstance(distortion, ThemisIrDistortion):
        distortion = _transverse(distortion)
    for name, model in _MODELS.items():
        if isinstance(distortion, model.kind):
            return name, (_flat(distortion) / _scales(model)).tolist()
    found = f"the model {type(distortion).__name__}"
    raise InputError(f"{where}, optical_distortion", found, f"one that usgscsm knows: {KNOWN}, or none")


def support_optics(distortion: Distortion, where: str) -> dict[str, dict[str, Any]]:
    """``optical_distortion`` of support data; InputError for a model that usgscsm does not have."""
    name, coefficients = state_optics(distortion, where)
    if not _MODELS[name].axes:
        return {name: {"coefficients": coefficients}}
    size = len(coefficients) // 2
    both = {"x": coefficients[:size], "y": coefficients[size:]}
    if name == "kaguyalism":
        return {name: {axis: own[1:] for axis, own in both.items()} | {"boresight_x": 0.0, "boresight_y": 0.0}}
    return {name: dict(both)}


def _transverse(themis: ThemisIrDistortion) -> TransverseDistortion:
    """x_d = k x, y_d = (1 + a1) y + a2 y^2."""
    x, y = np.zeros(10), np.zeros(10)
    x[1], y[2], y[5] = themis.k, 1.0 + themis.a1, themis.a2
    return TransverseDistortion(_ten(x.tolist()), _ten(y.tolist()))


def _flat(distortion: Any) -> Array:
    if isinstance(distortion, KaguyaDistortion):
        return np.array([0.0, *distortion.x, 0.0, *distortion.y])
    values = np.hstack([np.ravel(field) for field in astuple(distortion)])
    return np.asarray(values[:-1] if isinstance(distortion, RadtanDistortion) else values)


MODEL = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
"""What usgscsm calls a line scanner."""
J2000 = 1
"""NAIF's code of the inertial frame."""
UNITS = {"m": 1.0, "km": KM}
"""m, by the names of units."""
_Vector = tuple[Number, Number, Number]
_Quaternion = tuple[Number, Number, Number, Number]
_Matrix = Annotated[list[Number], msgspec.Meta(min_length=9, max_length=9)]
_Times = Annotated[list[Number], msgspec.Meta(min_length=1)]


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


class Radii(msgspec.Struct):
    """Of the ellipsoid, km unless `unit` says m."""

    semimajor: Positive
    semiminor: Positive
    unit: Literal["m", "km"] = "km"


class FocalLength(msgspec.Struct):
    """Under a key of its own."""

    focal_length: Positive
    """mm."""


class DetectorPixel(msgspec.Struct):
    """A place on the detector."""

    line: Number
    sample: Number


class SupportData(msgspec.Struct, omit_defaults=True, kw_only=True):
    """What is read and written of the support data of an image; they may hold more."""

    image_lines: Count
    image_samples: Count
    image_identifier: str | None = None
    name_platform: str | None = None
    name_sensor: str | None = None
    name_model: str
    interpolation_method: str = "lagrange"
    line_scan_rate: Annotated[list[_Vector], msgspec.Meta(min_length=1)]
    """Line (top edge of the first one 0.5), s past center_ephemeris_time and s per line from there on."""
    starting_ephemeris_time: Number | None = None
    center_ephemeris_time: Number
    """s TDB past J2000."""
    radii: Radii
    naif_keywords: dict[str, Any] = {}
    detector_sample_summing: Annotated[float, msgspec.Meta(ge=1.0, le=1e6)]
    detector_line_summing: Positive = 1.0
    focal_length_model: FocalLength
    detector_center: DetectorPixel
    starting_detector_line: Number
    starting_detector_sample: Number
    focal2pixel_lines: _Vector
    """Pixels, and pixels per mm along x and y of the focal plane."""
    focal2pixel_samples: _Vector
    optical_distortion: dict[str, dict[str, Any]]
    """Coefficients of powers of mm by the model's name, in its own layout (`files.support_data.isd_layout`)."""
    body_rotation: RotationTable
    instrument_pointing: RotationTable
    instrument_position: StateTable
    sun_position: SunTable | None = None


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
    first = epoch + float(timing.start_times[0]) - shift
    keys: dict[str, Any] = msgspec.to_builtins(SupportData(
        image_lines=image.lines, image_samples=image.samples, image_identifier=image.name, name_model=MODEL,
        line_scan_rate=np.column_stack(
            [timing.first_lines + ISIS_OFFSET, timing.start_times - shift, timing.periods]
        ).tolist(),
        starting_ephemeris_time=first, center_ephemeris_time=epoch,
        radii=Radii(image.body.equatorial / KM, image.body.polar / KM),
        detector_sample_summing=interior.sample_summing,
        focal_length_model=FocalLength(interior.focal_length / MM),
        detector_center=DetectorPixel(*interior.centre.tolist()),
        starting_detector_line=float(interior.first[0]), starting_detector_sample=float(interior.first[1]),
        focal2pixel_lines=to_pixel[0].tolist(), focal2pixel_samples=to_pixel[1].tolist(),
        optical_distortion=support_optics(interior.distortion, f"image {image.name}"),
        body_rotation=body_rotation, instrument_pointing=pointing, instrument_position=position,
        sun_position=sun_position,
    ))  # fmt: skip
    return keys | {"interpolation_method": "lagrange"}


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
