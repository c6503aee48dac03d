"""Layout of CSM image support data (JSON) of a line scanner: the keys that are read and written of those of ALE
(ale/formatters/formatter.py, to_isd) and ISIS (isd_generate, "isis_camera_version" 1 and 2). Units are the file's.
"""

from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from mgsgraph.files.decoding import Count, Number, Positive
from mgsgraph.files.support_data.optics import support_optics
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import ISIS_OFFSET, KM, MM

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
    detector_sample_summing: Positive
    detector_line_summing: Positive = 1.0
    focal_length_model: FocalLength
    detector_center: DetectorPixel
    starting_detector_line: Number
    starting_detector_sample: Number
    focal2pixel_lines: _Vector
    """Pixels, and pixels per mm along x and y of the focal plane."""
    focal2pixel_samples: _Vector
    optical_distortion: dict[str, dict[str, Any]]
    """Coefficients of powers of mm by the model's name, in its own layout (`files.support_data.optics`)."""
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
    found: dict[str, Any] = msgspec.to_builtins(SupportData(
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
