"""An exported network against the solution: by ids and names, and with image coordinates computed anew."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.networks.binary import read_network
from mgsgraph.geometry.records import Array

FIRST_CENTER = 0.5
"""The first pixel's center, (1, 1) in the file, is (0.5, 0.5) in the solution."""


class NetworkDifferences(NamedTuple):
    """A row for each of the solution's measures of determined points."""

    measured: Array
    """(k,) px, of the measure."""
    predicted: Array
    """(k,) px, of the measure less its residual from where the adjusted orientation sees the point."""
    points: Array
    """(k,) m, of the adjusted point."""


def network_differences(folder: Path, solution: Solution) -> NetworkDifferences:
    """Compare network.net; KeyError for a measure that it lacks."""
    found = {
        (point.id, measure.serial_number): (
            measure.line, measure.sample, measure.line_residual, measure.sample_residual, *(point.adjusted or ()),
        )
        for point in read_network(folder / "network.net").points
        for measure in point.measures
    }  # fmt: skip
    net, rays = solution.network, solution.network.rays
    kept = np.flatnonzero(solution.determined[rays.point])
    of = list(zip(rays.point[kept].tolist(), rays.image[kept].tolist(), strict=True))
    rows = np.array([found[net.points.ids[i], net.images[j].name] for i, j in of], dtype=np.float64)
    points, seen = solution.places[rays.point[kept]], np.empty((kept.size, 2))
    for j in range(len(net.images)):
        mine = np.flatnonzero(rays.image[kept] == j)
        start = rays.places[kept[mine], 0]
        seen[mine], _ = solution.image(j).ground_to_image(points[mine], solution.correction(j), start)
    measured = rows[:, :2] - FIRST_CENTER
    return NetworkDifferences(
        np.linalg.norm(measured - rays.places[kept], axis=1),
        np.linalg.norm(measured - rows[:, 2:4] - seen, axis=1),
        np.linalg.norm(rows[:, 4:] - points, axis=1),
    )
