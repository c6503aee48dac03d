"""CSM image support data (JSON) of a line scanner, as ALE and ISIS write them, to a PushbroomImage.

Kilometres and millimetres become metres here; ISIS lines (top edge of the first line at 0.5) become lines from 0.0.
Formulas of the detector: ISIS CameraDetectorMap, CameraFocalPlaneMap; quaternions: scalar first, NAIF q2m.
"""

from pathlib import Path

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.decoding import validated
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.labels.isis_cube import is_cube_json
from mgsgraph.files.opening import read_json
from mgsgraph.files.support_data.isd_keywords import require_own_constants
from mgsgraph.files.support_data.isd_layout import MODEL, UNITS, RotationTable, SupportData
from mgsgraph.files.support_data.isd_positions import positions, require_j2000
from mgsgraph.files.support_data.isd_repairs import repaired
from mgsgraph.files.support_data.optics import distortion_of_support
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, MM


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
