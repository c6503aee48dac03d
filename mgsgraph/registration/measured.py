"""Laser points whose places in images were measured, beside where the orientation projects them, before and after."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFootprints:
    """Laser points in one image, in the order of its lines: where they fall, and where they were measured."""

    image: int
    """Which image."""
    points: Index
    """(m,) ground points."""
    measured: Array
    """(m, 2) line, sample; NaN where the point was not measured in this image."""
    before: Array
    """(m, 2) line, sample of the a-priori footprint with the nominal orientation; NaN where it is not seen."""
    after: Array
    """(m, 2) line, sample of the adjusted place with the adjusted orientation; NaN where it is not seen."""

    @property
    def offset_before(self) -> Array:
        """(m, 2) pixels, measured minus projected, before; NaN without a measure."""
        return self.measured - self.before

    @property
    def offset_after(self) -> Array:
        """(m, 2) pixels, measured minus projected, after: the sign of `Solution.residuals`."""
        return self.measured - self.after

    @property
    def lines(self) -> Array:
        """(m,) where the points lie along the image: the measured line, or the projected one."""
        return np.where(np.isnan(self.measured[:, 0]), self.after[:, 0], self.measured[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDiscrepancy:
    """By how much two images contradict each other about the same laser points."""

    lines: Array
    """(m,) measured line in the first image."""
    before: Array
    """(m, 2) pixels of the first image, line and sample: its offset minus the second one's, nominal."""
    after: Array
    """(m, 2) the same, adjusted."""


def registration_offsets(solution: Solution, image: str | int, most: int | None = None) -> MeasuredFootprints:
    """Laser points projected onto an image, before and after the adjustment, beside their measured places.

    Before: a-priori footprint, nominal orientation; after: adjusted place, adjusted orientation. Points that are not
    measured in the image are there when they fall on it.

    Parameters
    ----------
    solution : Solution
        What an adjustment found.
    image : str or int
        Which image, by name or number.
    most : int, optional
        Take no more than about this many laser points, evenly spread over all; the same ones in every image.
    """
    network = solution.network
    image = network.image_number(image)
    rays, picture = network.rays, network.images[image]
    laser = solution.members(PointClass.LASER)
    laser = laser[np.all(np.isfinite(network.points.places[laser]), axis=1)]
    laser = laser[thinned(laser.size, most)]
    of_point = np.full((len(network.points), 2), np.nan)
    mine = np.flatnonzero(rays.image == image)
    of_point[rays.point[mine]] = rays.places[mine]
    measured = of_point[laser]
    start = np.where(np.isnan(measured[:, 0]), 0.5 * picture.lines, measured[:, 0])
    before, _ = picture.ground_to_image(network.points.places[laser], start=start)
    after, _ = solution.image(image).ground_to_image(solution.places[laser], solution.correction(image), start)
    with np.errstate(invalid="ignore"):
        inside = np.all((after >= 0.0) & (after <= [picture.lines, picture.samples]), axis=1)
    kept = np.flatnonzero(inside | ~np.isnan(measured[:, 0]))
    kept = kept[np.argsort(np.where(np.isnan(measured[:, 0]), after[:, 0], measured[:, 0])[kept], kind="stable")]
    return MeasuredFootprints(image, laser[kept], measured[kept], before[kept], after[kept])


def registration_discrepancy(
    solution: Solution, first: MeasuredFootprints, second: MeasuredFootprints
) -> MeasuredDiscrepancy:
    """Offsets of laser points in one image minus those in another, carried over to the first image's pixels.

    They are carried along the ground, at the points' heights, because images may differ in scale, skew and direction
    of flight. What a horizontal displacement of the footprints does to both images cancels.
    """
    shared, i, j = np.intersect1d(first.points, second.points, return_indices=True)
    both = np.all(np.isfinite(first.offset_after[i] + second.offset_after[j]), axis=1)
    shared, i, j = shared[both], i[both], j[both]
    order = np.argsort(first.lines[i], kind="stable")
    shared, i, j = shared[order], i[order], j[order]
    one, two = solution.image(first.image), solution.image(second.image)
    places = solution.places[shared]
    height = geodetic(places, two.body)[:, 2]
    _, to_ground = two.image_to_ground(
        second.after[j, 0], second.after[j, 1], height, solution.correction(second.image)
    )
    _, to_image = one.ground_to_image(places, solution.correction(first.image), first.after[i, 0])
    carried = to_image @ to_ground
    return MeasuredDiscrepancy(
        first.lines[i],
        first.offset_before[i] - np.einsum("nij,nj->ni", carried, second.offset_before[j]),
        first.offset_after[i] - np.einsum("nij,nj->ni", carried, second.offset_after[j]),
    )


def thinned(size: int, most: int | None) -> Index:
    """All of `size` indices, or `most` of them, evenly spread from the first to the last."""
    if most is None or size <= most:
        return np.arange(size)
    return np.linspace(0, size - 1, most).astype(np.int64)
