"""The scene of a terrain model: images with their adjusted orientation, the expected ground, dense matches."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.schema import CaseInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import geodetic
from mgsgraph.matching.scene import Scene
from mgsgraph.text import some
from mgsgraph.workers import Progress

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_LEAST_SIGMA = 100.0
"""m, by how much the ground may leave the mean height of the adjusted points, at least."""


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
    from mgsgraph.matching.dense import HALF_WINDOW, dense_matches  # OpenCV and numba take their time to load

    return dense_matches(scene, spacing, workers, progress), (2 * HALF_WINDOW + 1) * scene.step


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
