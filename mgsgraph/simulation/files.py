"""Everything that is simulated as files in the formats in which real data come, with a case file and the truth.

Pair and strip are written as support data, network and laser shots (`isis_files`), study sites as MGS' archives have
them: kernels (`spice_files`), images (`mgs_files`), PEDR and MEGDR (`mola_files`). ``case.toml`` (`case_files`) is what
an adjustment takes, ``truth.json`` what it should find: m, rad and s, body-fixed.

Every writer makes its folder when absent, replaces files of the same names in it, and raises InputError if the folder
can't be written.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mgsgraph.errors import require
from mgsgraph.files.writing import writing_to
from mgsgraph.geometry import rotation
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.case_files import (
    campaign_case,
    image_file,
    json_text,
    laser_text,
    papers_case,
    site_case,
    support_data,
    three_sites_case,
    tie_network_text,
)
from mgsgraph.simulation.mgs_files import (
    kernel_segment,
    moc_file,
    pedr_file,
    shot_names,
    write_grids,
    write_moc_image,
)
from mgsgraph.simulation.mola_files import WRITABLE, write_pedr
from mgsgraph.simulation.pair import SimulatedPair
from mgsgraph.simulation.site import SimulatedImage, SimulatedSite, SimulatedThreeSites
from mgsgraph.simulation.spice_files import write_kernels
from mgsgraph.simulation.strip import SimulatedStrip

Weighting = Literal["rigorous", "papers"]
"""Which observations and sigmas a site's case has: this project's, or Yoon & Shan's (2005) for comparison."""
CASE_FILES: dict[Weighting, str] = {"rigorous": "case.toml", "papers": "case_papers.toml"}

_POSES = 31
"""Poses in a site's truth, evenly over the image, as the papers sample it."""
_STRIP_NETWORK = ("simulated_strip", "Simulated strip of stereo pairs")
"""Name and description of a strip's network."""


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Make a folder when absent, for files that are written within; raise InputError where that can't be."""
    with writing_to(folder, WRITABLE):
        folder.mkdir(parents=True, exist_ok=True)
        yield


def write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    """Write texts by their paths in a folder; raise InputError where that can't be."""
    with writing(folder):
        for name, text in texts.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8", newline="\n")


def write_pair(pair: SimulatedPair, folder: Path) -> Path:
    """Write a simulated pair, its case file and its truth; returns the path of ``case.toml``.

    Examples
    --------
    >>> from mgsgraph.simulation import write_pair
    >>> print(write_pair(pair, Path("another")))
    another/case.toml
    """
    texts = _campaign(pair, "simulated pair", (pair.laser,), (pair.true_footprints,))
    write_texts(folder, texts | {"network.pvl": tie_network_text(pair.ties)})
    return folder / "case.toml"


def write_strip(strip: SimulatedStrip, folder: Path, steps: bool = False) -> Path:
    """Write a simulated strip, its case file and its truth; returns the path of ``case.toml``.

    With `steps`, write for each image k, in ``step_007`` and the like, the ``ties.pvl`` and ``lidar.json`` that it
    brings. They are the whole network and all shots once more, but for known shots, which stand there again with the
    measure in the new image and without a simultaneous one. A network of a hundred thousand points takes seconds to
    write and to read, one of a million some minutes.
    """
    texts = _campaign(strip, "simulated strip", strip.lasers, strip.true_footprints)
    texts["network.pvl"] = tie_network_text(strip.ties, *_STRIP_NETWORK)
    for k in range(len(strip.images)) if steps else ():
        _, ties, laser = strip.addition(k)
        texts |= {f"step_{k:03d}/ties.pvl": tie_network_text(ties, *_STRIP_NETWORK)} if ties.ids else {}
        texts |= {f"step_{k:03d}/lidar.json": laser_text((laser,))} if laser else {}
    write_texts(folder, texts)
    return folder / "case.toml"


def write_three_sites(simulated: SimulatedThreeSites, folder: Path) -> Path:
    """Write the three-site campaign, its case file and its truth; returns the path of ``case.toml``.

    In ``eos``, ``gusev`` and ``isidis`` are the sites' files with cases of their own, which serve alone, too. The case
    over all leaves their terrain models out: it can have one grid, and no grid holds three sites.
    """
    for site in simulated.sites:
        write_site(site, folder / site.settings.name)
    truth = {
        "seed": simulated.seed,
        "sites": {site.settings.name: f"{site.settings.name}/truth.json" for site in simulated.sites},
        "coefficients": {simulated.bridge.name: simulated.true_bridge.coefficients.tolist()},
        "ties": dict(zip(simulated.ties.ids, simulated.true_ties.tolist(), strict=True)),
    }
    write_texts(folder, {
        image_file(simulated.bridge): json_text(support_data(simulated.bridge)),
        "network.pvl": tie_network_text(simulated.ties, "three_sites", "Simulated sites and a bridge image"),
        "truth.json": json_text(truth),
        "case.toml": three_sites_case(simulated),
    })
    return folder / "case.toml"


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

    Examples
    --------
    >>> from mgsgraph.simulation import write_site
    >>> write_site(site, Path("gusev-as-published"), weighting="papers").name
    'case_papers.toml'
    """
    require(weighting in get_args(Weighting), "simulated site, weighting", repr(weighting), " or ".join(CASE_FILES))
    write_texts(folder, {
        "network.pvl": tie_network_text(simulated.ties, "simulated_site"),
        "truth.json": json_text(_site_truth(simulated)),
        CASE_FILES["rigorous"]: site_case(simulated),
        CASE_FILES["papers"]: papers_case(simulated),
    })
    with writing(folder):
        write_grids(simulated, folder)
        write_kernels([kernel_segment(image) for image in simulated.images], folder)
        for image in simulated.images:
            rationale = f"Simulated image of {simulated.settings.title}"
            write_moc_image(folder / moc_file(image), image.settings, image.clock_start, rationale, image.pixels)
            write_pedr(folder / pedr_file(image), image.profile)
    return folder / CASE_FILES[weighting]


# --- pair and strip


def _campaign(
    simulated: SimulatedPair | SimulatedStrip,
    name: str,
    lasers: Sequence[LaserProfile],
    footprints: Sequence[Array],
) -> dict[str, str]:
    """Files but for the network; `footprints` are the true ones (m, 3) of each profile."""
    truth = {
        "seed": simulated.seed,
        "coefficients": {
            image.name: true.coefficients.tolist()
            for image, true in zip(simulated.images, simulated.true_corrections, strict=True)
        },
        "ties": dict(zip(simulated.ties.ids, simulated.true_ties.tolist(), strict=True)),
        "footprints": {
            name: point
            for laser, points in zip(lasers, footprints, strict=True)
            for name, point in zip(laser.ids, points.tolist(), strict=True)
        },
    }
    return {image_file(image): json_text(support_data(image)) for image in simulated.images} | {
        "lidar.json": laser_text(lasers),
        "truth.json": json_text(truth),
        "case.toml": campaign_case(name, simulated.images, simulated.settings.noise),
    }


# --- truth of a site


def _site_truth(simulated: SimulatedSite) -> dict[str, Any]:
    """True values that an adjustment should find, and the injected errors."""
    images = simulated.images
    footprints, pixels, ground = [], [], []
    for image in images:
        footprints += image.profile.true_footprints.tolist()
        pixels += [[None if np.isnan(p[0]) else p.tolist() for p in shot] for shot in image.profile.true_pixels]
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
                "places": {image.true.name: pixel for image, pixel in zip(images, pixels_of_shot, strict=True)},
            }
            for name, point, returned, pixels_of_shot in zip(names, footprints, ground, pixels, strict=True)
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
            **dict(zip(("roll_rad", "pitch_rad", "yaw_rad"), errors.rotation.T.tolist(), strict=True)),
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
    lines = np.linspace(0.0, image.lines, _POSES)
    pose = image.pose(lines)
    return {
        "lines": lines.tolist(),
        "positions": pose.position.tolist(),
        "matrices": pose.matrix.tolist(),
        "omega_phi_kappa": rotation.omega_phi_kappa(pose.matrix).tolist(),
    }
