"""The error for points that lie behind a camera which has seen them."""

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.errors import PointBehindCamera
from mgsgraph.geometry.records import Array, Index


def behind_camera(layout: Layout, behind: Index, point: Array) -> PointBehindCamera:
    """The error for points (indices in the layout) that lie behind a camera, the first of which is at a place (3,) m:
    names that point and its image, and the image that sees the most of them.
    """
    network, i = layout.network, int(layout.point_order[behind[0]])
    for k in np.flatnonzero(network.rays.point == i):
        image = network.images[network.rays.image[k]]
        pose = image.pose(network.rays.places[[k], 0])
        if (pose.matrix[0] @ (point - pose.position[0]))[2] <= 0.0:
            break
    more = ""
    if behind.size > 1:
        seen = network.rays.image[np.isin(network.rays.point, layout.point_order[behind])]
        number = np.bincount(seen, minlength=len(network.images))
        most, whole = int(number.argmax()), np.bincount(network.rays.image, minlength=number.size)
        most = max(np.flatnonzero(number == number[most]).tolist(), key=lambda j: number[j] / whole[j])
        more = f", as do {behind.size - 1} others; image {network.images[most].name} sees {number[most]} of them all"
    return PointBehindCamera(
        f"point {network.points.ids[i]}, image {image.name}",
        f"the point lies behind the camera{more}",
        "a point before it",
        "check the point's a-priori place, the measure and the image's orientation",
    )
