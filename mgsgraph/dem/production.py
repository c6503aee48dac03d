"""`mgsgraph dem`: from an adjustment and its images to a terrain model with sigmas, an ortho image and their check."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.case_file import decode
from mgsgraph.case.scene import read_scene
from mgsgraph.case.schema import CaseInput
from mgsgraph.dem.checking import check_profiles
from mgsgraph.dem.files import write_dem
from mgsgraph.dem.model import Dem, DemSettings, dem_of, require_reference
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import geodetic
from mgsgraph.matching.scene import Scene
from mgsgraph.output.folders import DEM, fresh_folder, require_replaceable
from mgsgraph.stages import Progress, no_progress
from mgsgraph.wording import some

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_LEAST_SIGMA = 100.0
"""m, by how much the ground may leave the mean height of the adjusted points, at least."""


def make_dem(
    adjusted: Solution | Posterior,
    case: str | Path,
    out: str | Path,
    settings: DemSettings | None = None,
    workers: int | None = None,
    figures: bool = True,
    progress: Progress = no_progress,
) -> Dem:
    """Match the images of a case densely with their adjusted orientation, and write a terrain model.

    Parameters
    ----------
    adjusted : Solution or Posterior
        Of the adjustment of the case; images are known by their names.
    case : path
        Case file, for the pixels, the ground beforehand, and the laser profiles.
    out : path
        Folder with dem.tif, ortho.tif, dem.json, dem.stac.json, shots.csv and the figure; appears whole or not at all.
    settings : DemSettings, optional
        Choices.
    workers : int, optional
        Threads; one per processor when None.
    figures : bool
        Whether the figure is drawn.
    progress : callable
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        As `read_scene`; images that were not adjusted; no overlap or no parallax to make a terrain model from; heights
        above an areoid that the case doesn't have; a folder that can't be written or holds something else.

    Examples
    --------
    >>> case = mgsgraph.read_case("gusev/case.toml", ties=Path("matches/network.pvl"))
    >>> settings = mgsgraph.DemSettings(post=50.0, spacing=30.0)
    >>> dem = mgsgraph.make_dem(mgsgraph.adjust(case), "gusev/case.toml", "dem", settings, figures=False)
    >>> print(dem)
    Dem('Gusev Crater': 24 x 61 posts every 50 m, 2.938 km^2 with heights, 0 check shots)
    """
    settings, path = settings or DemSettings(), Path(case)
    require_replaceable(out, DEM)
    posterior = adjusted if isinstance(adjusted, Posterior) else Posterior.of(adjusted)
    require_reference(posterior, settings)
    wanted = decode(path)
    adjusted_names([image.name for image in wanted.images], posterior, settings.images, str(path))
    profiles = check_profiles(posterior, wanted, path, settings.mola)
    name, scene = read_scene(path, *expected_ground(posterior, wanted))
    scene = adjusted_scene(scene, posterior, settings.images)
    matches, window = densely_matched(scene, settings.spacing, workers, progress)
    dem = dem_of(name, posterior, scene, matches, window, settings, profiles, workers, progress)
    with fresh_folder(out, DEM) as folder:
        write_dem(dem, scene, settings, folder, figures, progress)
    return dem


def expected_ground(posterior: Posterior, wanted: CaseInput) -> tuple[float | None, float | None]:
    """Height of the ground above the ellipsoid in m, and by how much it may leave that: of the adjusted points, where
    the case has no terrain model that says more.
    """
    points = posterior.linearised.points
    points = points[np.linalg.norm(points, axis=1) > 0.0]
    if wanted.terrain_models or not len(points):
        return None, None
    heights = geodetic(points, posterior.network.images[0].body)[:, 2]
    return float(np.median(heights)), max(_LEAST_SIGMA, 2.0 * float(heights.std()))


def densely_matched(
    scene: Scene, spacing: float | None, workers: int | None, progress: Progress
) -> tuple[tuple["DenseMatches", ...], float]:
    """Dense matches, and the width of the windows in m."""
    from mgsgraph.matching.dense import dense_matches  # OpenCV and numba take their time to load
    from mgsgraph.matching.posts import DenseSettings

    choices = DenseSettings(spacing=spacing)
    return dense_matches(scene, choices, workers, progress), (2 * choices.half_window + 1) * scene.step


def adjusted_names(
    there: Sequence[str], posterior: Posterior, chosen: Sequence[str] = (), where: str = "the case"
) -> list[str]:
    """Of the images `there`, those `chosen` (all when empty); `where` names their case in errors.

    Raises
    ------
    InputError
        Where one was not adjusted, isn't there, or there are fewer than two.
    """
    for name in chosen:
        if name not in there:
            raise InputError(where, f"no image {name}", f"one of {some(list(there), len(there))}")
    names = list(dict.fromkeys(chosen)) or list(there)
    if len(names) < 2:
        raise InputError(where, f"one image for a terrain model ({names[0]})", "two different ones, at least")
    adjusted = [image.name for image in posterior.network.images]
    if missing := [name for name in names if name not in adjusted]:
        both = sum(name in adjusted for name in there) > 1
        raise InputError(
            where, f"images that the solution doesn't have: {some(missing, len(missing))}",
            f"those that were adjusted ({some(adjusted, len(adjusted))})",
            "adjust this case, or give --pair" if both else "give the case that was adjusted",
        )  # fmt: skip
    return names


def adjusted_scene(scene: Scene, posterior: Posterior, chosen: Sequence[str] = ()) -> Scene:
    """A scene whose pictures, those of the names `chosen` (all when empty), have the images and corrections that an
    adjustment found, by name.

    Raises
    ------
    InputError
        As `adjusted_names`.
    """
    there = {picture.image.name: picture for picture in scene.pictures}
    pictures = [
        replace(there[name], image=posterior.image(j), correction=posterior.correction(j))
        for name in adjusted_names(list(there), posterior, chosen)
        for j in [posterior.network.image_number(name)]
    ]
    return replace(scene, pictures=tuple(pictures))
