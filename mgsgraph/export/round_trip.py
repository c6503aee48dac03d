"""What a product must say again when it is read back: where the solution itself sees its points.

A reader-back gets a `Reprojection` and the product's folder, projects the points by the product's files alone, and
returns how far its image places are from the solution's. A `Reprojection` doesn't name points, by which measures are
found again in a control network: that gets `MeasuredPlaces`.
"""

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
    places, points = _predicted(solution), solution.places[rays.point]
    times = np.full(rays.point.size, np.nan)
    for j, image in enumerate(images):
        mine = rays.image == j
        times[mine] = image.timing.at(places[mine, 0])[0] + image.trajectory.epoch
    seen = np.flatnonzero(np.isfinite(places).all(axis=1) & np.isfinite(points).all(axis=1))
    names = [images[j].name for j in rays.image[seen].tolist()]
    return Reprojection(tuple(names), points[seen], places[seen], times[seen])


def _predicted(solution: Solution) -> Array:
    """(k, 2) line and sample where the adjusted orientation sees each measure's adjusted point; NaN where the point is
    not determined, or not seen near the image.
    """
    rays, predicted = solution.network.rays, np.full((solution.network.rays.point.size, 2), np.nan)
    for j in np.unique(rays.image).tolist():
        mine = np.flatnonzero((rays.image == j) & solution.determined[rays.point])
        points, start = solution.places[rays.point[mine]], rays.places[mine, 0]
        predicted[mine], _ = solution.image(j).ground_to_image(points, solution.correction(j), start)
    return predicted


def images_of(wanted: Reprojection) -> dict[str, Index]:
    """Which measures, ascending, each image has."""
    names = np.array(wanted.image)
    return {name: np.flatnonzero(names == name) for name in dict.fromkeys(wanted.image)}


class MeasuredPlaces(NamedTuple):
    """Measures of determined points, rejected ones too, one row each."""

    point: tuple[str, ...]
    """(k,) id of the point."""
    image: tuple[str, ...]
    """(k,) name of the image."""
    measured: Array
    """(k, 2) line and sample, first pixel's centre at (0.5, 0.5)."""
    predicted: Array
    """(k, 2) where the adjusted orientation sees the adjusted point; NaN where it doesn't near the image."""
    points: Array
    """(k, 3) m, body-fixed, adjusted."""


def measured_places(solution: Solution) -> MeasuredPlaces:
    """Measures of a solution; where their points are seen is computed anew, not from residuals."""
    rays, points = solution.network.rays, solution.network.points
    kept = np.flatnonzero(solution.determined[rays.point])
    ids = tuple(points.ids[i] for i in rays.point[kept].tolist())
    names = tuple(solution.network.images[j].name for j in rays.image[kept].tolist())
    return MeasuredPlaces(ids, names, rays.places[kept], _predicted(solution)[kept], solution.places[rays.point[kept]])
