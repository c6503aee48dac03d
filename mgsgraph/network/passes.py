"""Images of one pass: whether they can share a trajectory's correction, and which of them stands for it."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Pose

LONGEST_PAUSE = 1800.0
"""s between the images of a pass: a quarter of the shortest revolution about Mars and Moon, and so another pass."""
_APART = 1e3
"""m by which nominal positions at one time may differ: trajectories from other kernels do, another spacecraft's more.
"""
_TURNED = 1e-2
"""rad by which nominal attitudes at one time may differ: a correction about the axes of the one is one about those of
the other to 1 %."""


def seconds(image: PushbroomImage) -> tuple[float, float]:
    """First and last time of an image's lines, s TDB past J2000."""
    start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0] + image.trajectory.epoch
    return float(start), float(stop)


def straightest(images: Sequence[PushbroomImage]) -> int:
    """The image that looks nearest along the optical axis, of several alike the first: HRSC's nadir line."""
    off = []
    for image in images:
        place, _ = image.interior.focal_plane(np.array([0.5 * image.samples]))
        off.append(round(float(np.linalg.norm(place)) / image.interior.focal_length, 6))
    return int(np.argmin(off))


def nominal_poses(images: Sequence[PushbroomImage], times: Array) -> Pose:
    """Nominal poses of a pass at times (n,) in s TDB past J2000, rates per second: each by an image whose lines cover
    it, or come nearest; for images may have tables of their own, which end with their lines.
    """
    edges = np.array([seconds(image) for image in images])
    beyond = np.maximum(edges[:, :1] - times, times - edges[:, 1:])
    owner = np.maximum(beyond, 0.0).argmin(axis=0)
    parts = [np.empty((times.size, *shape)) for shape in ((3,), (3,), (3, 3), (3,))]
    for j in np.unique(owner).tolist():
        mine = np.flatnonzero(owner == j)
        trajectory = images[j].trajectory
        pose = trajectory.pose(np.clip(times[mine] - trajectory.epoch, *trajectory.coverage))
        for whole, part in zip(parts, (pose.position, pose.velocity, pose.matrix, pose.angular_rate), strict=True):
            whole[mine] = part
    return Pose(*parts)


def require_one_pass(images: Sequence[PushbroomImage], where: str) -> None:
    """Raise InputError, naming `where`, unless images follow upon each other and agree on where the camera was.

    Agreement is looked at in the middle of the time that two of them have in common; images that have none are not
    compared.
    """
    order = sorted(images, key=lambda image: seconds(image)[0])
    last = order[0]
    for image in order[1:]:
        start, stop = seconds(last)[1], seconds(image)[0]
        if stop - start > LONGEST_PAUSE:
            raise InputError(
                where, f"images {last.name} and {image.name}, {(stop - start) / 60.0:.0f} minutes apart",
                f"images of one pass, at most {LONGEST_PAUSE / 60.0:.0f} minutes apart", "make them two strips",
            )  # fmt: skip
        if stop < start:
            _require_alike(last, image, 0.5 * (stop + min(start, seconds(image)[1])), where)
        last = max(last, image, key=lambda one: seconds(one)[1])


def _require_alike(one: PushbroomImage, other: PushbroomImage, time: float, where: str) -> None:
    first, second = (image.trajectory.pose(np.array([time - image.trajectory.epoch])) for image in (one, other))
    apart = float(np.linalg.norm(first.position - second.position))
    turned = float(np.linalg.norm(rotation.logarithm(first.matrix @ np.swapaxes(second.matrix, 1, 2))))
    if apart > _APART or turned > _TURNED:
        raise InputError(
            where, f"images {one.name} and {other.name}, whose cameras at one time are {apart:.0f} m apart and turned "
            f"by {turned:.3f} rad", "images of one camera on one trajectory", "make them two strips",
        )  # fmt: skip
