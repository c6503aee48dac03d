"""What a control network must say again when it is read back: measures and adjusted points of a solution.

`round_trip.Reprojection` doesn't name points, by which measures are found again in a network.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array


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
    rays, names = solution.network.rays, [image.name for image in solution.network.images]
    kept = np.flatnonzero(solution.determined[rays.point])
    point, image, points = rays.point[kept], rays.image[kept], solution.places[rays.point[kept]]
    predicted = np.full((kept.size, 2), np.nan)
    for j in np.unique(image).tolist():
        mine = image == j
        start = rays.places[kept[mine], 0]
        predicted[mine], _ = solution.image(j).ground_to_image(points[mine], solution.correction(j), start)
    ids = tuple(solution.network.points.ids[i] for i in point.tolist())
    return MeasuredPlaces(ids, tuple(names[j] for j in image.tolist()), rays.places[kept], predicted, points)
