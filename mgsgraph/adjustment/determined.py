"""Which points their rows determine, and the errors for those that make no sense."""

from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.passes import Selection
from mgsgraph.errors import PointBehindCamera
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.reduction import Reduction
from mgsgraph.kernel.rows import BEHIND, WEAK


def without_weak(layout: Layout, reduction: Reduction, selection: Selection) -> Selection:
    """Leave out points whose rays determine no place; refuse points behind a camera."""
    behind = np.flatnonzero(reduction.states == BEHIND)
    if behind.size:
        raise _behind(layout, int(behind[0]), reduction.points[behind[0]])
    out = selection.out.copy()
    out[layout.point_order[reduction.states == WEAK]] = True
    return replace(selection, out=out)


def _behind(layout: Layout, place: int, point: Array) -> PointBehindCamera:
    """The error for a point (place in the layout) that lies behind a camera: names point and image."""
    network, i = layout.network, int(layout.point_order[place])
    for k in np.flatnonzero(network.rays.point == i):
        image = network.images[network.rays.image[k]]
        pose = image.pose(network.rays.places[[k], 0])
        if (pose.matrix[0] @ (point - pose.position[0]))[2] <= 0.0:
            break
    return PointBehindCamera(
        f"point {network.points.ids[i]}, image {image.name}",
        "the point lies behind the camera",
        "a point before it",
        "check the point's a-priori place, the measure and the image's orientation",
    )
