"""A simulated site as files, each in the format in which MGS data come: kernels, images, PEDR, MEGDR, network, case."""

import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.io.megdr import REFERENCE_RADIUS
from mgsgraph.simulation.files import network_text
from mgsgraph.simulation.megdr_file import MegdrLayout, write_megdr
from mgsgraph.simulation.moc_file import MocImageLabel, write_moc_image
from mgsgraph.simulation.pedr_file import PedrFrames, write_pedr
from mgsgraph.simulation.site import SHOTS_PER_FRAME, SimulatedImage, SimulatedSite
from mgsgraph.simulation.spice_files import KernelSegment, write_kernels
from mgsgraph.simulation.terrain import areoid_under
from mgsgraph.units import ARCMIN, MRAD

PLACES = 31
"""Places of the pose in the truth, evenly over the image, as the papers sample it."""
_MOLA_ORBIT = 10_000
"""What MOLA adds to MGS's mapping orbit."""
_RANGE_SIGMA, _GROUND_SIGMA, _SHIFT_SIGMA = 10.0, 10.0, 100.0
"""m, a-priori sigmas of ranges, of footprints, and of a profile's common shift (Yoon & Shan; Kirk et al. 2002)."""
SHIFT = f"shift_sigma_m = {_SHIFT_SIGMA!r}"
"""What a case says of a profile whose common shift is unknown."""
_IMAGE_SIGMA, _TREND = 30.0, (1.0, 0.1, 0.01)
"""pixels, the papers' sigma of back-projected footprints; factors of the orientation's sigmas for each power of u."""

Weighting = Literal["rigorous", "papers"]
"""Which observations and sigmas a case has: this project's, or Yoon & Shan's (2005) for comparison."""
CASE_FILES: dict[Weighting, str] = {"rigorous": "case.toml", "papers": "case_papers.toml"}
_EOS_TREND, _EOS_IMAGE_SIGMA = (1.0, 1.0, 1.0), 125.0
"""What Table 4 of the papers takes at Eos, where the stated 30 px and slow trends cannot give its sigmas."""


def write_site(simulated: SimulatedSite, folder: Path, weighting: Weighting = "rigorous") -> Path:
    """Write a simulated site, its case files and its truth; returns the path of the case with the weighting asked for.

    Parameters
    ----------
    simulated : SimulatedSite
        As simulated.
    folder : Path
        Made when absent; files of the same names in it are replaced.
    weighting : str
        ``rigorous`` (``case.toml``) or ``papers`` (``case_papers.toml``); both are written.

    Raises
    ------
    InputError
        If the folder can't be written, or there is no such weighting.
    """
    if weighting not in get_args(Weighting):
        raise InputError("simulated site, weighting", repr(weighting), " or ".join(CASE_FILES))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        texts = {
            "network.pvl": network_text(simulated.ties, "simulated_site"),
            "truth.json": json.dumps(_truth(simulated), indent=1, allow_nan=False) + "\n",
            CASE_FILES["rigorous"]: _case(simulated),
            CASE_FILES["papers"]: papers_case(simulated),
        }
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8", newline="\n")
        _write_grids(simulated, folder)
        write_kernels([kernel_segment(image) for image in simulated.images], folder)
    except OSError as error:
        raise InputError(str(folder), f"can't be written ({error.strerror})", "a folder that may be written") from None
    for image in simulated.images:
        write_moc_image(folder / _image_file(image), image_label(image, simulated.settings.title), image.pixels)
        write_pedr(folder / pedr_file(image), pedr_frames(image))
    return folder / CASE_FILES[weighting]


def shot_names(image: SimulatedImage) -> tuple[str, ...]:
    """Names of an image's shots as the PEDR's reader gives them: orbit, frame and shot."""
    orbit = image.settings.orbit + _MOLA_ORBIT
    numbers = range(image.profile.times.size)
    return tuple(f"{orbit}:{k // SHOTS_PER_FRAME + 1}:{k % SHOTS_PER_FRAME + 1}" for k in numbers)


def _image_file(image: SimulatedImage) -> str:
    return image.settings.name.replace("-", "") + ".img"


def pedr_file(image: SimulatedImage) -> str:
    """Name of the PEDR file along with an image."""
    return image.settings.profile + ".b"


def kernel_segment(image: SimulatedImage) -> KernelSegment:
    """What the kernels are to say of an image."""
    return KernelSegment(image.settings.name, image.settings.phase, _tables(image.nominal))


def _tables(image: PushbroomImage) -> Trajectory:
    if not isinstance(image.trajectory, Trajectory):
        raise InputError(f"image {image.name}", "an orientation in polynomials", "sampled tables, as kernels have")
    return image.trajectory


def image_label(image: SimulatedImage, title: str) -> MocImageLabel:
    """What the label of an image says; `title` is the site's."""
    settings = image.settings
    start = datetime.fromisoformat(settings.start)
    stop = start + timedelta(seconds=settings.duration)
    return MocImageLabel(
        product_id=settings.name.replace("-", "/"),
        start_time=label_time(start),
        stop_time=label_time(stop),
        clock_start=image.clock_start,
        exposure=settings.exposure,
        crosstrack_summing=settings.crosstrack_summing,
        downtrack_summing=settings.downtrack_summing,
        edit_mode=settings.edit_mode,
        orbit=settings.orbit,
        rationale=f"Simulated image of {title}",
    )


def label_time(time: datetime) -> str:
    """ISO to hundredths of a second, as labels have it."""
    return time.strftime("%Y-%m-%dT%H:%M:%S") + f".{time.microsecond // 10_000:02d}"


def pedr_frames(image: SimulatedImage) -> PedrFrames:
    """The profile along with an image, as its PEDR file has it."""
    profile = image.profile
    places, craft = planetocentric(profile.footprints), planetocentric(profile.spacecraft)
    return PedrFrames(
        orbit=image.settings.orbit + _MOLA_ORBIT,
        times=profile.times,
        longitudes=places[:, 0],
        latitudes=places[:, 1],
        radii=places[:, 2],
        ranges=profile.ranges,
        areoid_radii=profile.areoid_radii,
        spacecraft_longitudes=craft[:, 0],
        spacecraft_latitudes=craft[:, 1],
        spacecraft_radii=craft[:, 2],
        off_nadir=profile.off_nadir,
        ground=profile.ground,
    )


# --- terrain


def _write_grids(simulated: SimulatedSite, folder: Path) -> None:
    """Planetary radius and topography as a pair of MEGDR products with labels."""
    grid = simulated.grid
    radii = np.asarray(grid.radii, dtype=np.float64)
    heights = radii - areoid_under(simulated.terrain, grid)
    for letter, offset, posts in (("r", REFERENCE_RADIUS, radii), ("t", 0.0, heights)):
        layout = MegdrLayout(posts.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step, offset)
        write_megdr(folder, _grid_file(simulated, letter), layout, [posts])


def _grid_file(simulated: SimulatedSite, letter: str) -> str:
    return f"meg{letter}_{simulated.settings.name}"


# --- truth


def _truth(simulated: SimulatedSite) -> dict[str, Any]:
    """What an adjustment should find, m, rad and s, body-fixed; and what was put in."""
    images = simulated.images
    footprints, places, ground = [], [], []
    for image in images:
        footprints += image.profile.true_footprints.tolist()
        places += [[None if np.isnan(one[0]) else one.tolist() for one in shot] for shot in image.profile.true_places]
        ground += image.profile.ground.tolist()
    names = [name for image in images for name in shot_names(image)]
    return {
        "site": simulated.settings.name,
        "seed": simulated.seed,
        "images": {image.true.name: _image_truth(image) for image in images},
        "ties": dict(zip(simulated.ties.ids, simulated.true_ties.tolist(), strict=True)),
        "footprints": {
            name: {
                "point": point,
                "ground": returned,
                "places": {image.true.name: place for image, place in zip(images, seen, strict=True)},
            }
            for name, point, returned, seen in zip(names, footprints, ground, places, strict=True)
        },
    }


def _image_truth(image: SimulatedImage) -> dict[str, Any]:
    errors, profile = image.errors, image.profile
    return {
        "epoch": image.true.trajectory.epoch,
        "poses": {"true": _poses(image.true), "nominal": _poses(image.nominal)},
        "errors": {
            "position_radial_along_across_m": errors.position.tolist(),
            "attitude_time_bias_s": errors.attitude_time_bias,
            "pitch_rad": list(errors.pitch),
            "roll_rad": list(errors.roll),
            "yaw_rad": list(errors.yaw),
            "attitude_noise_rad": errors.noise,
        },
        "profile": {
            "pedr": pedr_file(image),
            "shift_east_north_m": profile.shift.tolist(),
            "ground_shots_inside": image.settings.shots,
        },
        "sun": image.sun.tolist(),
    }


def _poses(image: PushbroomImage) -> dict[str, Any]:
    """Position and attitude at evenly spaced lines, from the first line's upper edge to the last one's lower edge."""
    lines = np.linspace(0.0, image.lines, PLACES)
    pose = image.pose(lines)
    return {
        "lines": lines.tolist(),
        "positions": pose.position.tolist(),
        "matrices": pose.matrix.tolist(),
        "omega_phi_kappa": rotation.omega_phi_kappa(pose.matrix).tolist(),
    }


# --- the cases


def _case(simulated: SimulatedSite) -> str:
    """The rigorous case: footprints with their profile's unknown shift, ties on the terrain model."""
    settings = simulated.settings
    text = _images_and_ties(simulated, settings.title, settings.angle_sigmas, settings.trend)
    text += profile_tables(simulated, SHIFT)
    text += [
        "",
        "[terrain]",
        f'radius = "{_grid_file(simulated, "r")}.lbl"',
        f'topography = "{_grid_file(simulated, "t")}.lbl"',
        f"vertical_sigma_m = {simulated.grid.vertical_sigma!r}",
        f"planimetric_sigma_m = {simulated.grid.planimetric_sigma!r}",
    ]
    return "\n".join([*text, ""])


def papers_case(simulated: SimulatedSite, stated: bool = False) -> str:
    """The observations and weights of Yoon & Shan (2005), for reproduction: back-projected footprints, no shifts.

    Parameters
    ----------
    simulated : SimulatedSite
        As simulated.
    stated : bool
        True for the weights that the papers state at Eos too, in place of those which its Table 4 takes.
    """
    settings = simulated.settings
    eos = settings.name == "eos" and not stated
    trend, image_sigma = (_EOS_TREND, _EOS_IMAGE_SIGMA) if eos else (_TREND, _IMAGE_SIGMA)
    text = _images_and_ties(simulated, f"{settings.title}, papers", (ARCMIN, ARCMIN, ARCMIN), trend)
    text += profile_tables(simulated, 'image_rows = "back-projected"', f"image_sigma_px = {image_sigma!r}")
    text += ["", "[solver]", 'line = "measured"', 'angles = "opk-paper"']
    return "\n".join([*text, ""])


def _images_and_ties(
    simulated: SimulatedSite, title: str, angles: tuple[float, float, float], trend: tuple[float, ...]
) -> list[str]:
    text = ["format = 1", f'name = "{title}"', *image_tables(simulated, angles, trend)]
    text += ["", "[ties]", 'network = "network.pvl"', f"sigma_px = {simulated.options.tie_noise!r}"]
    return text


def image_tables(
    simulated: SimulatedSite, angles: tuple[float, float, float], trend: tuple[float, ...], folder: str = ""
) -> list[str]:
    """Lines of a case with the site's images, whose files lie in `folder` ("x/") beside it."""
    text = []
    for image in simulated.images:
        text += [
            "",
            "[[images]]",
            f'name = "{image.settings.name}"',
            f'label = "{folder}{_image_file(image)}"',
            f'kernels = ["{folder}mgs.tm"]',
            f"orientation = {_prior(image, angles, trend)}",
        ]
    return text


def profile_tables(simulated: SimulatedSite, *more: str, folder: str = "") -> list[str]:
    """Lines of a case with the site's profiles, `more` said of each, whose files lie in `folder` ("x/") beside it."""
    text = []
    for image in simulated.images:
        text += [
            "",
            "[[mola]]",
            f'pedr = "{folder}{pedr_file(image)}"',
            f'image = "{image.settings.name}"',
            f"range_sigma_m = {_RANGE_SIGMA!r}",
            f"ground_sigma_m = {_GROUND_SIGMA!r}",
            *more,
        ]
    return text


def _prior(image: SimulatedImage, angles: tuple[float, float, float], trend: tuple[float, ...]) -> str:
    """Polynomials of order 2 as nominal orientation, and a-priori sigmas, twice as large for a held image (Yoon & Shan:
    100 and 200 m, and the angles that match).
    """
    factor = 2.0 if image.settings.held else 1.0
    milli = [round(factor * angle / MRAD, 4) for angle in angles]
    return (
        f'{{ nominal = "polynomial", position_sigma_m = {100.0 * factor!r}, angle_sigma_mrad = {milli}, '
        f"trend = {list(trend)} }}"
    )
