"""Which of some images were taken on one pass of one spacecraft, found from their times and nominal orientations."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network.joining import LONGEST_PAUSE, mountings, same_camera, seconds

_SAME_PLANE = 0.02
"""rad by which the planes of an orbit may differ between two images: spacecraft about one body fly in other planes, or
over other ground; that of one precesses by less in a revolution."""


def found_passes(images: Sequence[PushbroomImage]) -> list[list[int]]:
    """Images of each pass, by their numbers, in the order of time.

    Two images are of one pass if they show the same body, and either have a time in common at which they are at the
    same place, mounted against each other without change (`mountings`), or are of one camera, at most `LONGEST_PAUSE`
    apart and flown in the same plane. All that are connected so are a pass; one that hangs with no other is its own.
    """
    order = sorted(range(len(images)), key=lambda j: seconds(images[j]))
    passes = list[list[int]]()
    for j in order:
        mine = [one for one in passes if any(_together(images[k], images[j]) for k in one)]
        joined = sorted([*(k for one in mine for k in one), j], key=order.index)
        if not _mountable([images[k] for k in joined]):
            joined, mine = [j], []
        passes = [*(one for one in passes if one not in mine), joined]
    return sorted(passes, key=lambda one: order.index(one[0]))


def _together(one: PushbroomImage, other: PushbroomImage) -> bool:
    """Whether two images are connected, as `found_passes` has it."""
    if one.body != other.body:
        return False
    (start, stop), (its_start, its_stop) = seconds(one), seconds(other)
    if min(stop, its_stop) > max(start, its_start):
        return _mountable([one, other])
    pause = max(start, its_start) - min(stop, its_stop)
    return pause <= LONGEST_PAUSE and same_camera(one, other) and _same_plane(one, other)


def _mountable(images: Sequence[PushbroomImage]) -> bool:
    try:
        mountings(images, "")
    except InputError:
        return False
    return True


def _same_plane(one: PushbroomImage, other: PushbroomImage) -> bool:
    """Whether two images were flown in one plane of inertial space; True where nobody knows how the body turns."""
    normals = []
    for image in (one, other):
        time, spin = np.mean(seconds(image)), image.trajectory.spin
        if spin is None:
            return True
        pose = image.trajectory.pose(np.array([time - image.trajectory.epoch]))
        normal = np.cross(pose.position[0], pose.velocity[0] + np.cross(spin, pose.position[0]))
        since = time - np.mean(seconds(one))
        normals.append(rotation.exponential(spin * since) @ normal / np.linalg.norm(normal))
    return bool(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0)) < _SAME_PLANE)


def mounting_angles(axes: Array) -> Array:
    """(m, 3) rad: rotation vectors, about x, y, z, by which each camera is turned against the axes of its pass."""
    return rotation.logarithm(np.swapaxes(axes, 1, 2))
