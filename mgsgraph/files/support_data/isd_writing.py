"""CSM image support data of an image, in the layout that ALE writes and usgscsm reads."""

from typing import Any

import msgspec
import numpy as np

from mgsgraph.files.support_data.isd_layout import (
    J2000,
    MODEL,
    DetectorPixel,
    FocalLength,
    Radii,
    RotationTable,
    StateTable,
    SunTable,
    SupportData,
)
from mgsgraph.files.support_data.optics import support_optics
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import ISIS_OFFSET, KM, MM


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
