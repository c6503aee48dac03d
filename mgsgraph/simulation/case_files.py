"""The case files (case.toml) of what is simulated: which files there are, and the sigmas that an adjustment assumes."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mgsgraph.case.case_file import Tables, Value, case_text, toml_lines
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import LidarMeasure, LidarShot, lidar_coordinates, lidar_text
from mgsgraph.files.networks.pvl import network_text
from mgsgraph.files.networks.tie_points import PointKind, TiePoints, control_network
from mgsgraph.files.support_data.isd_layout import (
    J2000,
    SunTable,
    rotation_table,
    state_table,
    support_fields,
)
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.mgs_files import grid_file, moc_file, pedr_file
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.site import BRIDGE_PRIOR, SimulatedSite, SimulatedThreeSites
from mgsgraph.simulation.sites import SHIFT_SIGMA, SiteSettings
from mgsgraph.units import ARCMIN, DEG, ISIS_OFFSET, KM, MRAD

_WRITTEN = "2000-01-01T00:00:00"
"""Date in the network; fixed, so that the same pair gives the same bytes."""
_SUN_DISTANCE, _SUN_SPEED = 2.28e11, 2.41e4
"""m and m/s, of Mars about the Sun; sensor models ask for the Sun, the geometry does not."""


def json_text(value: dict[str, Any]) -> str:
    """JSON in the layout of all these files."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def image_file(image: PushbroomImage) -> str:
    """Name of an image's support data."""
    return f"image_{image.name.rsplit('/', 1)[-1]}.isd"


def support_data(image: PushbroomImage) -> dict[str, Any]:
    """CSM image support data as ALE lays them out, of an image without distortion; km, mm and ISIS lines."""
    return {
        "isis_camera_version": 2,
        "name_platform": "MARS GLOBAL SURVEYOR",
        "name_sensor": "SIMULATED LINE CAMERA",
        "reference_height": {"maxheight": 1000, "minheight": -1000, "unit": "m"},
        "naif_keywords": {"BODY_CODE": 499, "INS-94031_LIGHTTIME_CORRECTION": "NONE"},
        "detector_line_summing": 1,
        **sampled_fields(image, _sun),
        "optical_distortion": {},
    }


def sampled_fields(image: PushbroomImage, sun: Callable[[Trajectory], SunTable | None] = lambda _: None) -> Any:
    """Support data common to all images: camera, times, and its sampled trajectory, with the Sun where wanted."""
    trajectory = image.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.name}", "an orientation in polynomials", "sampled tables, as support data have")
    epoch, state = trajectory.epoch, trajectory.position
    camera, body = (
        rotation_table(epoch + table.times, table.quaternions, table.constant)
        for table in (trajectory.camera, trajectory.body)
    )
    states = state_table(epoch + state.times, state.positions, state.velocities)
    return support_fields(image, epoch, states, camera, body, sun(trajectory))


def _sun(trajectory: Trajectory) -> SunTable:
    """The Sun relative to the body, inertial, in km: 35 degrees or so from the zenith of the image's middle."""
    position, flight = trajectory.position.at(np.zeros(1))
    zenith, along = position[0] / np.linalg.norm(position[0]), flight[0] / np.linalg.norm(flight[0])
    sideways = np.cross(along, zenith)
    direction = np.cos(35.0 * DEG) * zenith + np.sin(35.0 * DEG) * sideways
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
    return network_text(control_network(free, name, "MARS", description, created=_WRITTEN))


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



_PAPERS_SIGMAS: dict[str, float] = {"range_sigma_m": 10.0, "ground_sigma_m": 10.0}
"""m, a-priori sigmas of ranges and footprints that Yoon & Shan (2005) take: ten times what is drawn."""
_IMAGE_SIGMA: dict[str, float] = {"eos": 40.0, "gusev": 22.0, "isidis": 30.0}
"""pixels, sigma of back-projected footprints with which the papers' Table 5 balances their residuals of ties
(`scripts/papers_balance.py`, which at Eos gives each image and coordinate its own); the text has "approximately 30"."""
_TREND, _EOS_TREND = (1.0, 0.02, 0.002), (1.0, 1.0, 1.0)
"""Factors of the orientation's sigmas for each power of u, which the papers leave open. RMSE of the refined positions
about their mean (Table 2) times sqrt(3), over 100 or 200 m: 0.007 to 0.04 at Gusev and Isidis, 3.8 in the right
image of Eos."""



def campaign_case(name: str, images: Sequence[PushbroomImage], noise: NoiseSettings) -> str:
    """Case of simulated images beside network.pvl and lidar.json, with the sigmas of the simulation."""
    lines = [line for image in images for line in toml_lines("[[images]]", name=image.name, isd=image_file(image))]
    lines += sigma_lines(noise)
    lines += toml_lines(
        "[laser]", file="lidar.json", image_sigma_px=float(noise.shot_image), range_sigma_m=float(noise.range),
        ground_sigma_m=float(noise.ground),
    )  # fmt: skip
    return case_text(name, lines)


def sigma_lines(noise: NoiseSettings, network: str = "network.pvl") -> Tables:
    """Sigmas of all orientations, and of the ties in a network's file."""
    return toml_lines("[orientation]", degree=noise.prior.degree, **_orientation(noise)) + _ties(noise.tie, network)


def site_case(simulated: SimulatedSite) -> str:
    """The rigorous case: footprints with their profile's unknown shift, ties on the terrain model. All sigmas are those
    of which the errors are drawn.
    """
    settings, grid = simulated.settings, simulated.grid
    lines = _images(simulated, settings) + _ties(simulated.options.tie_noise)
    lines += _profiles(simulated, "", **_drawn_sigmas(simulated))
    radius, topography = (f"{grid_file(simulated, kind)}.lbl" for kind in ("r", "t"))
    sigmas = {"vertical_sigma_m": grid.vertical_sigma or 0.0, "planimetric_sigma_m": grid.planimetric_sigma or 0.0}
    lines += toml_lines("[terrain]", radius=radius, topography=topography, **sigmas)
    return case_text(settings.title, lines)


def papers_case(simulated: SimulatedSite) -> str:
    """The observations and weights of Yoon & Shan (2005), for reproduction: back-projected footprints, no shifts."""
    settings = simulated.settings
    trend = _EOS_TREND if settings.name == "eos" else _TREND
    lines = _images(simulated, replace(settings, angle_sigmas=(ARCMIN,) * 3, trend=trend))
    lines += _ties(simulated.options.tie_noise)
    sigmas = {**_PAPERS_SIGMAS, "image_sigma_px": _IMAGE_SIGMA[settings.name]}
    lines += _profiles(simulated, "", image_rows="back-projected", **sigmas)
    return case_text(f"{settings.title}, papers", lines + toml_lines("[solver]", line="measured", angles="opk-paper"))


def three_sites_case(simulated: SimulatedThreeSites) -> str:
    """Case over all three sites, whose files lie in folders of their names, and the bridge image."""
    lines, bridge = Tables(), simulated.bridge
    for site in simulated.sites:
        lines += _images(site, site.settings, f"{site.settings.name}/")
    lines += toml_lines("[[images]]", name=bridge.name, isd=image_file(bridge), orientation=_orientation(BRIDGE_PRIOR))
    lines += toml_lines("[ties]", network="network.pvl")
    for site in simulated.sites:
        lines += _profiles(site, f"{site.settings.name}/", **_drawn_sigmas(site))
    return case_text("Eos, Gusev, Isidis and a bridge", lines)


def _images(simulated: SimulatedSite, settings: SiteSettings, folder: str = "") -> Tables:
    """The site's images with the a-priori sigmas of `settings`; their files lie in `folder` ("x/") beside the case."""
    lines, kernels = Tables(), [f"{folder}mgs.tm"]
    for image in simulated.images:
        label, orientation = folder + moc_file(image), _site_orientation(settings.prior(image.settings), settings.trend)
        name = image.settings.name
        lines += toml_lines("[[images]]", name=name, label=label, kernels=kernels, orientation=orientation)
    return lines


def _ties(sigma: float, network: str = "network.pvl") -> Tables:
    return toml_lines("[ties]", network=network, sigma_px=float(sigma))


def _profiles(simulated: SimulatedSite, folder: str, **sigmas: Value) -> Tables:
    """The site's profiles, with further keys of each; their files lie in `folder` ("x/") beside the case."""
    exact: dict[str, Value] = {"beam_sigma_mrad": 0.0, "pulse_share": 0.0}  # of the instrument nothing is drawn
    lines = Tables()
    for image in simulated.images:
        name = image.settings.name
        lines += toml_lines("[[shots]]", file=folder + pedr_file(image), image=name, **exact, **sigmas)
    return lines


def _drawn_sigmas(simulated: SimulatedSite) -> dict[str, Value]:
    """Sigmas of a profile from which its errors are drawn."""
    drawn = simulated.options
    return {
        "range_sigma_m": drawn.range_noise, "ground_sigma_m": drawn.footprint_noise,
        "height_sigma_m": drawn.height_noise, "shift_sigma_m": SHIFT_SIGMA,
    }  # fmt: skip


def _orientation(noise: NoiseSettings) -> dict[str, Value]:
    """A-priori sigmas of an image's orientation, as drawn from."""
    return {
        "position_sigma_m": float(noise.position), "angle_sigma_mrad": float(noise.angle / MRAD),
        "trend": [float(factor) for factor in noise.trend],
    }  # fmt: skip


def _site_orientation(prior: OrientationPrior, trend: tuple[float, ...]) -> dict[str, Value]:
    """Polynomials of order 2 as nominal orientation, and a-priori sigmas."""
    return {
        "nominal": "polynomial", "position_sigma_m": float(prior.sigmas[0, 0]),
        "angle_sigma_mrad": [round(angle / MRAD, 4) for angle in prior.sigmas[0, 3:].tolist()], "trend": list(trend),
    }  # fmt: skip
