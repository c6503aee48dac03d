"""Files in the formats of ISIS and ALE: support data (.isd), a control network (PVL), laser shots (lidar JSON)."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import LidarMeasure, LidarShot, lidar_coordinates, lidar_text
from mgsgraph.files.networks import pvl_writing
from mgsgraph.files.networks.tie_points import control_network
from mgsgraph.files.support_data.isd_layout import (
    J2000,
    RotationTable,
    SunTable,
    rotation_table,
    state_table,
    support_fields,
)
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.units import DEG, ISIS_OFFSET, KM

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
    trajectory = image.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.name}", "an orientation in polynomials", "sampled tables, as support data have")
    epoch, state = trajectory.epoch, trajectory.position
    return {
        "isis_camera_version": 2,
        "name_platform": "MARS GLOBAL SURVEYOR",
        "name_sensor": "SIMULATED LINE CAMERA",
        "reference_height": {"maxheight": 1000, "minheight": -1000, "unit": "m"},
        "naif_keywords": {"BODY_CODE": 499, "INS-94031_LIGHTTIME_CORRECTION": "NONE"},
        "detector_line_summing": 1,
        **support_fields(
            image, epoch, state_table(epoch + state.times, state.positions, state.velocities),
            _attitude(trajectory.camera, epoch), _attitude(trajectory.body, epoch), _sun(trajectory),
        ),
        "optical_distortion": {},
    }  # fmt: skip


def _attitude(table: AttitudeTable, epoch: float) -> RotationTable:
    return rotation_table(epoch + table.times, table.quaternions, table.constant)


def _sun(trajectory: Trajectory) -> SunTable:
    """The Sun relative to the body, inertial, in km: 35 degrees or so from the zenith of the image's middle."""
    position, flight = trajectory.position.at(np.zeros(1))
    zenith, along = position[0] / np.linalg.norm(position[0]), flight[0] / np.linalg.norm(flight[0])
    aside = np.cross(along, zenith)
    direction = np.cos(35.0 * DEG) * zenith + np.sin(35.0 * DEG) * aside
    velocity = _SUN_SPEED * np.cross(along, direction)
    times = trajectory.position.times[[0, -1]]
    return SunTable(
        ephemeris_times=(trajectory.epoch + times).tolist(),
        positions=((_SUN_DISTANCE * direction + times[:, None] * velocity) / KM).tolist(),
        velocities=np.tile(velocity / KM, (2, 1)).tolist(),
        reference_frame=J2000,
    )


def tie_network_text(ties: TiePoints, name: str = "simulated_pair", description: str = "Simulated stereo pair") -> str:
    """ISIS control network, version 5, as PVL text; free points without coordinates."""
    n = len(ties.ids)
    free = replace(
        ties, kinds=np.full(n, PointKind.FREE), places=np.full((n, 3), np.nan), covariances=np.zeros((n, 3, 3))
    )
    return pvl_writing.network_text(control_network(free, name, "MARS", description, created=_WRITTEN))


def laser_text(lasers: Iterable[LaserProfile]) -> str:
    """ISIS lidar data of some profiles, as JSON."""
    return lidar_text(shot for laser in lasers for shot in _shots(laser))


def _shots(laser: LaserProfile) -> Iterator[LidarShot]:
    coordinates, matrices = lidar_coordinates(laser.footprints, laser.covariances)
    measures = list[list[LidarMeasure]]([] for _ in laser.ids)
    pixels = (laser.measures + ISIS_OFFSET).tolist()
    for shot, name, (line, sample) in zip(laser.measure_shot.tolist(), laser.measure_image, pixels, strict=True):
        measures[shot].append(LidarMeasure(line, sample, name))
    along = list[list[str]]([] for _ in laser.ids)
    for shot, name in zip(laser.simultaneous_shot.tolist(), laser.simultaneous_image, strict=True):
        along[shot].append(name)
    for i, name in enumerate(laser.ids):
        latitude, longitude, radius = coordinates[i].tolist()
        yield LidarShot(
            id=name, range=float(laser.ranges[i] / KM), sigma_range=float(laser.range_sigmas[i]),
            time=float(laser.times[i]), latitude=latitude, longitude=longitude, radius=radius,
            apriori_matrix=matrices[i], simultaneous_images=along[i], measures=measures[i],
        )  # fmt: skip
