"""Images that are one and the same: taken at the same times from the same places in the same directions."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage

_LINES = 0.5
"""Lines by which the times of their first and last edges may differ."""
_PIXELS = 1.0
"""By which what they see may differ: one image read by two roads differs by thousandths."""


def twins(images: Sequence[PushbroomImage]) -> list[tuple[int, int]]:
    """Pairs of images, by their numbers, that are the same image under two names.

    Cameras that take images at the same time (LROC's left and right one, the channels of HRSC) look elsewhere, and are
    told apart by that: the ground on the ellipsoid under a grid of pixels is compared.
    """
    starts = [image.trajectory.epoch + float(image.timing.at(np.zeros(1))[0][0]) for image in images]
    order, found = np.argsort(starts, kind="stable").tolist(), []
    for k, first in enumerate(order):
        for second in order[k + 1 :]:
            period = float(images[first].timing.periods.max())
            if starts[second] - starts[first] > _LINES * period:
                break
            if _same(images[first], images[second]):
                found.append((min(first, second), max(first, second)))
    return sorted(found)


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
