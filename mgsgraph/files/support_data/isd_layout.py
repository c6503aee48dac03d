"""Layout of CSM image support data (JSON) of a line scanner: the keys that are read and written of those of ALE
(ale/formatters/formatter.py, to_isd) and ISIS (isd_generate, "isis_camera_version" 1 and 2). Units are the file's.
"""

from typing import Annotated, Any, Literal

import msgspec

from mgsgraph.files.decoding import Count, Number, Positive
from mgsgraph.units import KM

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
