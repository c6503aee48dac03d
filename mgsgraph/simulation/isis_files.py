"""Files in the formats of ISIS and ALE: support data (.isd), a control network (PVL), laser shots (lidar JSON)."""

import json
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import planetocentric, planetocentric_jacobian
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.io.control import pvl_writing
from mgsgraph.io.control.ties import control_network
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import DEG, ISIS_OFFSET, KM, MM

_WRITTEN = "2000-01-01T00:00:00"
"""Date in the network; fixed, so that the same pair gives the same bytes."""
_SUN_DISTANCE, _SUN_SPEED = 2.28e11, 2.41e4
"""m and m/s, of Mars about the Sun; sensor models ask for the Sun, the geometry does not."""


def json_text(value: dict[str, Any]) -> str:
    """JSON as all these files have it."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def image_file(image: PushbroomImage) -> str:
    """Name of an image's support data."""
    return f"image_{image.name.rsplit('/', 1)[-1]}.isd"


def support_data(image: PushbroomImage) -> dict[str, Any]:
    """CSM image support data as ALE lays them out, of an image without distortion; km, mm and ISIS lines."""
    trajectory, timing, interior = image.trajectory, image.timing, image.interior
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.name}", "an orientation in polynomials", "sampled tables, as support data have")
    edges, _ = timing.at(np.array([0.0]))
    segments = np.column_stack([timing.first_lines + ISIS_OFFSET, timing.start_times, timing.periods])
    to_pixel = interior.to_pixel.copy()
    to_pixel[:, 1:] *= MM
    return {
        "isis_camera_version": 2,
        "image_lines": image.lines,
        "image_samples": image.samples,
        "name_platform": "MARS GLOBAL SURVEYOR",
        "name_sensor": "SIMULATED LINE CAMERA",
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "reference_height": {"maxheight": 1000, "minheight": -1000, "unit": "m"},
        "interpolation_method": "lagrange",
        "line_scan_rate": segments.tolist(),
        "starting_ephemeris_time": trajectory.epoch + float(edges[0]),
        "center_ephemeris_time": trajectory.epoch,
        "radii": {"semimajor": image.body.equatorial / KM, "semiminor": image.body.polar / KM, "unit": "km"},
        "body_rotation": _attitude(trajectory.body, trajectory.epoch),
        "instrument_pointing": _attitude(trajectory.camera, trajectory.epoch),
        "naif_keywords": {"BODY_CODE": 499, "INS-94031_LIGHTTIME_CORRECTION": "NONE"},
        "detector_sample_summing": interior.sample_summing,
        "detector_line_summing": 1,
        "focal_length_model": {"focal_length": interior.focal_length / MM},
        "detector_center": {"line": float(interior.centre[0]), "sample": float(interior.centre[1])},
        "starting_detector_line": float(interior.first[0]),
        "starting_detector_sample": float(interior.first[1]),
        "focal2pixel_lines": to_pixel[0].tolist(),
        "focal2pixel_samples": to_pixel[1].tolist(),
        "optical_distortion": {},
        "instrument_position": {
            "ephemeris_times": (trajectory.epoch + trajectory.position.times).tolist(),
            "positions": (trajectory.position.positions / KM).tolist(),
            "velocities": (trajectory.position.velocities / KM).tolist(),
            "reference_frame": 1,
        },
        "sun_position": _sun(trajectory),
    }


def _attitude(table: AttitudeTable, epoch: float) -> dict[str, Any]:
    return {
        "ephemeris_times": (epoch + table.times).tolist(),
        "quaternions": table.quaternions.tolist(),
        "constant_rotation": table.constant.ravel().tolist(),
        "reference_frame": 1,
    }


def _sun(trajectory: Trajectory) -> dict[str, Any]:
    """The Sun relative to the body, inertial, in km: 35 degrees or so from the zenith of the image's middle."""
    position, flight = trajectory.position.at(np.zeros(1))
    zenith, along = position[0] / np.linalg.norm(position[0]), flight[0] / np.linalg.norm(flight[0])
    aside = np.cross(along, zenith)
    direction = np.cos(35.0 * DEG) * zenith + np.sin(35.0 * DEG) * aside
    velocity = _SUN_SPEED * np.cross(along, direction)
    times = trajectory.position.times[[0, -1]]
    return {
        "ephemeris_times": (trajectory.epoch + times).tolist(),
        "positions": ((_SUN_DISTANCE * direction + times[:, None] * velocity) / KM).tolist(),
        "velocities": np.tile(velocity / KM, (2, 1)).tolist(),
        "reference_frame": 1,
    }


def tie_network_text(ties: TiePoints, name: str = "simulated_pair", description: str = "Simulated stereo pair") -> str:
    """ISIS control network, version 5, as PVL text; free points without coordinates."""
    n = len(ties.ids)
    free = replace(
        ties, kinds=np.full(n, PointKind.FREE), places=np.full((n, 3), np.nan), covariances=np.zeros((n, 3, 3))
    )
    return pvl_writing.network_text(control_network(free, name, "MARS", description, created=_WRITTEN))


def laser_text(lasers: Iterable[LaserProfile]) -> str:
    """ISIS lidar data of some profiles, as JSON."""
    return json_text({"points": [shot for laser in lasers for shot in _shots(laser)]})


def _shots(laser: LaserProfile) -> list[dict[str, Any]]:
    """Points of an ISIS lidar file: degrees, km, pixels counted from 1, sigmas in m."""
    footprints = planetocentric(laser.footprints)
    measures: list[list[dict[str, Any]]] = [[] for _ in laser.ids]
    for shot, name, pixel in zip(laser.measure_shot, laser.measure_image, laser.measures + ISIS_OFFSET, strict=True):
        measures[shot].append({"line": float(pixel[0]), "sample": float(pixel[1]), "serialNumber": name})
    return [
        {
            "aprioriMatrix": _apriori(footprints[i], laser.covariances[i]),
            "id": name,
            "latitude": float(footprints[i, 1] / DEG),
            "longitude": float(footprints[i, 0] / DEG),
            "measures": measures[i],
            "radius": float(footprints[i, 2] / KM),
            "range": float(laser.ranges[i] / KM),
            "sigmaRange": float(laser.range_sigmas[i]),
            "simultaneousImages": list(laser.simultaneous[i]),
            "time": float(laser.times[i]),
        }
        for i, name in enumerate(laser.ids)
    ]


def _apriori(footprint: Array, covariance: Array) -> list[float]:
    """Upper triangle of the covariance of latitude, longitude (rad) and radius (m); `covariance` (3, 3) is in m^2."""
    inverse = np.linalg.inv(planetocentric_jacobian(footprint))[[1, 0, 2]]  # ISIS has the latitude first
    matrix = inverse @ covariance @ inverse.T
    return [float(value) for value in matrix[np.triu_indices(3)]]
