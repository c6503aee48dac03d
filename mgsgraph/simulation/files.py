"""A simulated pair as files, each in the format in which real data come: support data, network, shots, and the case."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
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
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import SimulatedPair
from mgsgraph.simulation.strip import SimulatedStrip
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import DEG, KM, MM, MRAD

_WRITTEN = "2000-01-01T00:00:00"
"""Date in the network; fixed, so that the same pair gives the same bytes."""
_SUN_DISTANCE, _SUN_SPEED = 2.28e11, 2.41e4
"""m and m/s, of Mars about the Sun; sensor models ask for the Sun, the geometry does not."""


def write_pair(pair: SimulatedPair, folder: Path) -> Path:
    """Write a simulated pair, its case file and its truth; returns the path of ``case.toml``.

    Parameters
    ----------
    pair : SimulatedPair
        As simulated.
    folder : Path
        Made when absent; files of the same names in it are replaced.

    Raises
    ------
    InputError
        If the folder can't be written.
    """
    write_texts(folder, {
        **{image_file(image): json_text(support_data(image)) for image in pair.images},
        "network.pvl": network_text(pair.ties),
        "lidar.json": lidar_text((pair.laser,)),
        "truth.json": truth_text(pair, (pair.laser,), (pair.true_footprints,)),
        "case.toml": case_text("simulated pair", pair.images, pair.settings.noise),
    })
    return folder / "case.toml"


def write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    """Write texts by their paths in a folder; raise InputError where that can't be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(str(folder), f"can't be written ({error.strerror})", "a folder that may be written") from None


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
    segments = np.column_stack([timing.first_lines + 0.5, timing.start_times, timing.periods])
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
    place, flight = trajectory.position.at(np.zeros(1))
    zenith, along = place[0] / np.linalg.norm(place[0]), flight[0] / np.linalg.norm(flight[0])
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


def network_text(ties: TiePoints, name: str = "simulated_pair", description: str = "Simulated stereo pair") -> str:
    """ISIS control network, version 5, as PVL text; free points without places."""
    n = len(ties.ids)
    free = replace(
        ties, kinds=np.full(n, PointKind.FREE), places=np.full((n, 3), np.nan), covariances=np.zeros((n, 3, 3))
    )
    return pvl_writing.network_text(control_network(free, name, "MARS", description, created=_WRITTEN))


def lidar_text(lasers: Iterable[LaserProfile]) -> str:
    """ISIS lidar data of some profiles, as JSON."""
    return json_text({"points": [shot for laser in lasers for shot in _shots(laser)]})


def _shots(laser: LaserProfile) -> list[dict[str, Any]]:
    """Points of an ISIS lidar file: degrees, km, pixels counted from 1, sigmas in m."""
    places = planetocentric(laser.footprints)
    measures: list[list[dict[str, Any]]] = [[] for _ in laser.ids]
    for shot, name, place in zip(laser.measure_shot, laser.measure_image, laser.measures + 0.5, strict=True):
        measures[shot].append({"line": float(place[0]), "sample": float(place[1]), "serialNumber": name})
    return [
        {
            "aprioriMatrix": _apriori(places[i], laser.covariances[i]),
            "id": name,
            "latitude": float(places[i, 1] / DEG),
            "longitude": float(places[i, 0] / DEG),
            "measures": measures[i],
            "radius": float(places[i, 2] / KM),
            "range": float(laser.ranges[i] / KM),
            "sigmaRange": float(laser.range_sigmas[i]),
            "simultaneousImages": list(laser.simultaneous[i]),
            "time": float(laser.times[i]),
        }
        for i, name in enumerate(laser.ids)
    ]


def _apriori(place: Array, covariance: Array) -> list[float]:
    """Upper triangle of the covariance of latitude, longitude (rad) and radius (m) of a footprint's (3, 3) in m^2."""
    inverse = np.linalg.inv(planetocentric_jacobian(place))[[1, 0, 2]]  # ISIS has the latitude first
    matrix = inverse @ covariance @ inverse.T
    return [float(value) for value in matrix[np.triu_indices(3)]]


def truth_text(
    made: SimulatedPair | SimulatedStrip, lasers: Sequence[LaserProfile], footprints: Sequence[Array]
) -> str:
    """What an adjustment should find: m and rad, body-fixed; `footprints` are the true ones (m, 3) of each profile."""
    return json_text({
        "seed": made.seed,
        "coefficients": {
            image.name: true.coefficients.tolist()
            for image, true in zip(made.images, made.true_corrections, strict=True)
        },
        "ties": dict(zip(made.ties.ids, made.true_ties.tolist(), strict=True)),
        "footprints": {
            name: place
            for laser, places in zip(lasers, footprints, strict=True)
            for name, place in zip(laser.ids, places.tolist(), strict=True)
        },
    })


def case_text(name: str, images: tuple[PushbroomImage, ...], noise: NoiseSettings) -> str:
    """Case file of simulated images beside network.pvl and lidar.json, with the sigmas of the simulation."""
    text = ["format = 1", f'name = "{name}"']
    for image in images:
        text += ["", "[[images]]", f'name = "{image.name}"', f'isd = "{image_file(image)}"']
    text += [
        "",
        "[orientation]",
        f"degree = {noise.prior.degree}",
        f"position_sigma_m = {float(noise.position)!r}",
        f"angle_sigma_mrad = {float(noise.angle / MRAD)!r}",
        f"trend = {[float(factor) for factor in noise.trend]}",
        "",
        "[ties]",
        'network = "network.pvl"',
        f"sigma_px = {float(noise.tie)!r}",
        "",
        "[laser]",
        'file = "lidar.json"',
        f"image_sigma_px = {float(noise.shot_image)!r}",
        f"range_sigma_m = {float(noise.range)!r}",
        f"ground_sigma_m = {float(noise.ground)!r}",
    ]
    return "\n".join([*text, ""])
