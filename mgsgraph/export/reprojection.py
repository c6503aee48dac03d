"""Where a solution sees its points: what kernels have to cover, and what they must say again."""

from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index


class Reprojection(NamedTuple):
    """Adjusted points and where the solution sees them, one row for each measure."""

    image: tuple[str, ...]
    """(k,) name of the image."""
    points: Array
    """(k, 3) m, body-fixed."""
    places: Array
    """(k, 2) line and sample predicted by the solution, first pixel's centre at (0.5, 0.5)."""
    times: Array
    """(k,) s TDB past J2000, of these lines."""


def reprojection(solution: Solution) -> Reprojection:
    """Where the solution sees the points of all measures, rejected ones too.

    Those of undetermined points are left out, and those which the adjusted orientation no longer sees near its image
    (`PushbroomImage.ground_to_image` gives NaN).
    """
    rays, images = solution.network.rays, solution.network.images
    places, times = np.full((rays.point.size, 2), np.nan), np.full(rays.point.size, np.nan)
    points = solution.places[rays.point]
    for j, image in enumerate(images):
        mine = np.flatnonzero((rays.image == j) & solution.determined[rays.point])
        seen, _ = solution.image(j).ground_to_image(points[mine], solution.correction(j), rays.places[mine, 0])
        places[mine], times[mine] = seen, image.timing.at(seen[:, 0])[0] + image.trajectory.epoch
    known = np.flatnonzero(np.isfinite(places).all(axis=1) & np.isfinite(points).all(axis=1))
    names = [images[j].name for j in rays.image[known].tolist()]
    return Reprojection(tuple(names), points[known], places[known], times[known])


def images_of(wanted: Reprojection) -> dict[str, Index]:
    """Which measures, ascending, each image has."""
    names = np.array(wanted.image)
    return {name: np.flatnonzero(names == name) for name in dict.fromkeys(wanted.image)}
