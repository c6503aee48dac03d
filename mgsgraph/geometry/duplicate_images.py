"""Images that are one and the same: taken at the same times from the same places in the same directions."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import LineTiming, PushbroomImage

_LINES = 0.5
"""Lines by which the times of their first and last edges may differ."""
_PIXELS = 1.0
"""By which what they see may differ: one image read by two roads differs by thousandths."""


class ImageTimes(NamedTuple):
    """When the lines of an image were taken."""

    epoch: float
    """s TDB past J2000, that of the image's trajectory."""
    timing: LineTiming
    """Times of the lines past it."""

    @classmethod
    def of(cls, image: PushbroomImage) -> "ImageTimes":
        """Of an image."""
        return cls(image.trajectory.epoch, image.timing)

    @property
    def start(self) -> float:
        """Time of the first line's first edge, s TDB past J2000."""
        return self.epoch + float(self.timing.at(np.zeros(1))[0][0])


def begun_together(times: Sequence[ImageTimes]) -> list[tuple[int, int]]:
    """Pairs of images, by their numbers, whose first lines were taken at the same time; they alone can be twins."""
    starts = [one.start for one in times]
    order, found = np.argsort(starts, kind="stable").tolist(), []
    for k, first in enumerate(order):
        for second in order[k + 1 :]:
            if starts[second] - starts[first] > _LINES * float(times[first].timing.periods.max()):
                break
            found.append((first, second))
    return found


def twins(images: Sequence[PushbroomImage]) -> list[tuple[int, int]]:
    """Pairs of images, by their numbers, that are the same image under two names.

    Cameras that take images at the same time (LROC's left and right one, the channels of HRSC) look elsewhere, and are
    told apart by that: the ground on the ellipsoid under a grid of pixels is compared.
    """
    near = begun_together([ImageTimes.of(image) for image in images])
    return sorted((min(pair), max(pair)) for pair in near if _same(images[pair[0]], images[pair[1]]))


def require_distinct(images: Sequence[PushbroomImage], where: str) -> None:
    """Raise InputError for one image under two names; `where` they stand."""
    for first, second in twins(images)[:1]:
        both = f"{images[first].name} and {images[second].name}"
        found = f"{both}, which are one image: the same times, the same trajectory"
        raise InputError(where, found, "each image once", "take one of the two out")


def _same(one: PushbroomImage, other: PushbroomImage) -> bool:
    if (one.lines, one.samples, one.body.equatorial) != (other.lines, other.samples, other.body.equatorial):
        return False
    end = np.array([float(one.lines)])
    stops = [image.trajectory.epoch + image.timing.at(end)[0][0] for image in (one, other)]
    if abs(stops[0] - stops[1]) > _LINES * one.timing.periods.max():
        return False
    lines, samples = (axis.ravel() for axis in np.meshgrid(
        np.linspace(0.0, one.lines, 3), np.linspace(0.0, one.samples, 3)
    ))  # fmt: skip
    ground, slopes = one.image_to_ground(lines, samples)
    apart = np.linalg.norm(other.image_to_ground(lines, samples)[0] - ground, axis=1)
    pixel = np.linalg.norm(slopes, axis=1).max(axis=1)
    seen = np.isfinite(apart)
    return bool(np.any(seen) and np.all(apart[seen] < _PIXELS * pixel[seen]))
