"""CSM image support data (JSON) of a line scanner, as ALE and ISIS write them, to a PushbroomImage.

Kilometres and millimetres become metres here; ISIS lines (top edge of the first line at 0.5) become lines from 0.0.
Formulas of the detector: ISIS CameraDetectorMap, CameraFocalPlaneMap; quaternions: scalar first, NAIF q2m.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import (
    Distortion,
    InteriorOrientation,
    LrocNacDistortion,
    NoDistortion,
    RadialDistortion,
)
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.io.aberration import geometric
from mgsgraph.io.files import read_json
from mgsgraph.io.json_fields import Fields
from mgsgraph.units import ISIS_OFFSET, KM, MM

Observer = Literal["body", "spacecraft"]
_LONGEST = 1e5
"""s, longer than any image takes."""


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
    isd = Fields(read_json(path), str(path))
    if "instrument_position" not in isd and "sensor_position" in isd:
        raise InputError(
            str(path), "the older usgscsm layout (sensor_position, sensor_orientation)",
            "ALE's layout (instrument_position, instrument_pointing, body_rotation)",
            "write it with ale.loads/isd_generate",
        )
    model = isd.text("name_model")
    if model != "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL":
        raise InputError(f"{path}, name_model", repr(model), "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL (a line scanner)")
    with errors_from(str(path)):
        trajectory = _trajectory(isd, aberration)
        image = PushbroomImage(
            name=name,
            lines=isd.count("image_lines"),
            samples=isd.count("image_samples"),
            interior=_interior(isd),
            timing=_timing(isd),
            trajectory=trajectory,
            body=_body(isd),
        )
    _require_outside(trajectory, image.body, path)
    return image


def _require_outside(trajectory: Trajectory, body: Ellipsoid, path: Path) -> None:
    """A camera inside the body betrays metres that were called kilometres."""
    distance = np.linalg.norm(trajectory.position.positions, axis=1).min()
    if distance <= body.polar:
        raise InputError(
            f"{path}, instrument_position", f"a camera {distance / KM:.3f} km from the body's centre",
            f"more than its radius, {body.polar / KM:.3f} km", "check the units of positions and radii",
        )


def _body(isd: Fields) -> Ellipsoid:
    radii = isd.section("radii")
    unit = _length_unit(radii, default="km")
    return Ellipsoid(radii.positive("semimajor") * unit, radii.positive("semiminor") * unit)


def _length_unit(fields: Fields, default: str) -> float:
    unit = fields.text("unit") if "unit" in fields else default
    units = {"m": 1.0, "km": KM}
    if unit not in units:
        raise InputError(f"{fields.where}, unit", repr(unit), "'m' or 'km'")
    return units[unit]


def _timing(isd: Fields) -> LineTiming:
    table = np.array(isd.numbers("line_scan_rate", None, 3), dtype=np.float64)
    if np.any(table[:, 2] <= 0.0):
        raise InputError(f"{isd.where}, line_scan_rate", f"{table[:, 2].min()} s per line", "positive line periods")
    centre = isd.number("center_ephemeris_time")
    if np.any(np.abs(table[:, 1]) > _LONGEST) and np.all(np.abs(table[:, 1] - centre) < _LONGEST):
        raise InputError(
            f"{isd.where}, line_scan_rate", f"times from {table[0, 1]:.3f} s on, since J2000",
            "seconds from center_ephemeris_time", "take center_ephemeris_time off them",
        )  # fmt: skip
    return LineTiming(table[:, 0] - ISIS_OFFSET, table[:, 1], table[:, 2])


def _interior(isd: Fields) -> InteriorOrientation:
    centre = isd.section("detector_center")
    to_pixel = np.array([isd.numbers("focal2pixel_lines", 3), isd.numbers("focal2pixel_samples", 3)], dtype=np.float64)
    to_pixel[:, 1:] /= MM  # pixels per mm of the file to pixels per m
    return InteriorOrientation(
        focal_length=isd.section("focal_length_model").positive("focal_length") * MM,
        to_pixel=to_pixel,
        centre=np.array([centre.number("line"), centre.number("sample")]),
        first=np.array([isd.number("starting_detector_line"), isd.number("starting_detector_sample")]),
        sample_summing=isd.positive("detector_sample_summing"),
        distortion=_distortion(isd),
    )


def _distortion(isd: Fields) -> Distortion:
    models = isd.mapping("optical_distortion")
    if not models:
        return NoDistortion()
    if len(models) > 1:
        raise InputError(f"{isd.where}, optical_distortion", f"{len(models)} models: {', '.join(models)}", "one")
    kind = next(iter(models)).lower()
    fields = Fields({key.lower(): value for key, value in models.items()}, f"{isd.where}, optical_distortion")
    if kind == "lrolrocnac":
        (k,) = fields.section(kind).numbers("coefficients", 1)
        return LrocNacDistortion(float(k) / MM**2)
    if kind == "radial":
        k0, k1, k2 = fields.section(kind).numbers("coefficients", 3)
        return RadialDistortion(float(k0), float(k1) / MM**2, float(k2) / MM**4)
    raise InputError(fields.where, f"the model {kind!r}", "lrolrocnac, radial, or none at all")


def _times(table: Fields, epoch: float) -> Array:
    return np.array(table.numbers("ephemeris_times", None), dtype=np.float64) - epoch


def _attitude(table: Fields, epoch: float) -> AttitudeTable:
    times = _times(table, epoch)
    frames = table.numbers("constant_frames", None) if "constant_frames" in table else []
    if "constant_rotation" not in table and len(frames) > 1:
        found = f"constant_frames {frames} without constant_rotation"
        raise InputError(table.where, found, "the rotation between them")
    constant = np.array(table.numbers("constant_rotation", 9)) if "constant_rotation" in table else np.eye(3)
    quaternions = np.array(table.numbers("quaternions", times.size, 4), dtype=np.float64)
    with errors_from(table.where):
        return AttitudeTable(times, quaternions, constant.reshape(3, 3))


def _require_j2000(table: Fields) -> None:
    if "reference_frame" in table and table.number("reference_frame") != 1.0:
        raise InputError(f"{table.where}, reference_frame", f"{table.number('reference_frame'):g}", "1 (J2000)")


def _trajectory(isd: Fields, aberration: Aberration | None) -> Trajectory:
    table = isd.section("instrument_position")
    unit = _length_unit(table, default="km")
    epoch = isd.number("center_ephemeris_time")
    times = _times(table, epoch)
    positions = np.array(table.numbers("positions", times.size, 3), dtype=np.float64) * unit
    if "velocities" not in table:
        raise InputError(table.where, "no velocities", "one per position", "write the support data with velocities")
    velocities = np.array(table.numbers("velocities", times.size, 3), dtype=np.float64) * unit
    with errors_from(table.where):
        position = PositionTable(times, positions, velocities)
    pointing, rotation = isd.section("instrument_pointing"), isd.section("body_rotation")
    for part in (table, pointing, rotation):
        _require_j2000(part)
    chosen = aberration or _stated_aberration(isd)
    if chosen.correction == "LT+S":
        position = geometric(position, _body_velocity(isd, epoch), chosen.observer == "body")
    return Trajectory(epoch, position, _attitude(pointing, epoch), _attitude(rotation, epoch))


def _stated_aberration(isd: Fields) -> Aberration:
    """What the ISIS keywords in the file say of its position table; never a guess."""
    keywords = isd.mapping("naif_keywords") if "naif_keywords" in isd else {}
    corrections = [value for key, value in keywords.items() if key.endswith("_LIGHTTIME_CORRECTION")]
    swaps = [value for key, value in keywords.items() if key.endswith("_SWAP_OBSERVER_TARGET")]
    if not corrections:
        raise InputError(
            f"{isd.where}, naif_keywords", "no INS..._LIGHTTIME_CORRECTION",
            "a statement whether the positions are geometric or apparent",
            "set aberration = 'NONE' or 'LT+S' (and observer = 'body' or 'spacecraft') for this image in the case file",
        )
    for values in (corrections, swaps):
        if any(value != values[0] for value in values):
            found = f"keywords of several instruments that differ: {values}"
            raise InputError(f"{isd.where}, naif_keywords", found, "those of the instrument that took the image")
    correction, swap = corrections[0], swaps[0] if swaps else False
    if not isinstance(correction, str) or correction.upper() not in ("NONE", "LT+S"):
        raise InputError(f"{isd.where}, INS..._LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    if str(swap).upper() not in ("TRUE", "FALSE"):
        raise InputError(f"{isd.where}, INS..._SWAP_OBSERVER_TARGET", repr(swap), "true or false")
    observer: Observer = "body" if str(swap).upper() == "TRUE" else "spacecraft"
    return Aberration("NONE", observer) if correction.upper() == "NONE" else Aberration("LT+S", observer)


def _body_velocity(isd: Fields, epoch: float) -> Array:
    """m/s, (3,), of the body about the Sun at the image's middle: minus the Sun's about the body."""
    sun = isd.section("sun_position")
    if "velocities" not in sun:
        raise InputError(sun.where, "no velocities", "the Sun's velocity, to undo the stellar aberration of positions")
    _require_j2000(sun)
    sun_times = _times(sun, epoch)
    if np.any(np.diff(sun_times) <= 0.0):
        raise InputError(f"{sun.where}, ephemeris_times", "times that stand still or go back", "increasing times")
    velocities = np.array(sun.numbers("velocities", sun_times.size, 3)) * _length_unit(sun, default="km")
    return np.array([-np.interp(0.0, sun_times, velocities[:, axis]) for axis in range(3)])
