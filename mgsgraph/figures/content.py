"""The numbers that figures show, as arrays: residuals by image, places on a map."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import PointClass
from mgsgraph.wording import root_mean_square


@dataclass(frozen=True, slots=True, eq=False)
class ImageResiduals:
    """Residuals of one image's rays to determined points."""

    places: Array
    """(k, 2) line, sample, measured."""
    residuals: Array
    """(k, 2) pixels, line and sample, measured minus predicted, adjusted."""
    residuals_before: Array
    """(k, 2) pixels, the same with the nominal orientation."""
    classes: Index
    """(k,) PointClass of the point."""
    used: Mask
    """(k,) False for rejected rays."""

    def of(self, point_class: PointClass) -> Index:
        """Rays of one class that took part."""
        return np.flatnonzero((self.classes == point_class) & self.used)


def image_residuals(solution: Solution, image: int) -> ImageResiduals:
    """Residuals of one image; rays to undetermined points have none and are left out."""
    rays = solution.network.rays
    mine = np.flatnonzero(rays.image == image)
    mine = mine[np.all(np.isfinite(solution.residuals[mine]), axis=1)]
    return ImageResiduals(
        places=rays.places[mine],
        residuals=solution.residuals[mine],
        residuals_before=solution.residuals_before[mine],
        classes=solution.network.points.classes[rays.point[mine]],
        used=solution.rays_used[mine],
    )


def centre_of(points: Array) -> Array:
    """Middle (3,) in m of points (n, 3): the mean of their directions, at their mean distance from the origin."""
    sound = points[np.all(np.isfinite(points), axis=1)]
    radii = np.linalg.norm(sound, axis=1)
    mean = np.mean(sound / radii[:, None], axis=0)
    return np.asarray(mean / np.linalg.norm(mean) * radii.mean())


def east_north(points: Array, centre: Array) -> Array:
    """East and north (n, 2) in m of points (n, 3) around a centre (3,), azimuthal equidistant on the sphere through it.

    Distances and directions from the centre are true however large the block is (Snyder 1987, p. 191).
    """
    radius = float(np.linalg.norm(centre))
    up = centre / radius
    planar = float(np.hypot(up[0], up[1]))
    east = np.array([-up[1], up[0], 0.0]) / planar if planar > 0.0 else np.array([0.0, 1.0, 0.0])
    flat = points @ np.stack([east, np.cross(up, east)], axis=1)
    length = np.linalg.norm(flat, axis=1)
    angle = np.arctan2(length, points @ up)
    return np.asarray(flat * np.where(length > 0.0, radius * angle / np.where(length > 0.0, length, 1.0), 0.0)[:, None])


def places_at(plane: Array, centre: Array) -> Array:
    """(n, 3) m, body-fixed, on the sphere through a centre (3,), of east and north (n, 2) in m around it: the inverse
    of `east_north`.
    """
    radius = float(np.linalg.norm(centre))
    up = centre / radius
    planar = float(np.hypot(up[0], up[1]))
    east = np.array([-up[1], up[0], 0.0]) / planar if planar > 0.0 else np.array([0.0, 1.0, 0.0])
    length = np.linalg.norm(plane, axis=1)
    angle = length / radius
    flat = plane * np.where(length > 0.0, np.sin(angle) / np.where(length > 0.0, length, 1.0), 0.0)[:, None]
    return np.asarray(radius * (np.cos(angle)[:, None] * up + flat @ np.stack([east, np.cross(up, east)])))


def rms(values: Array) -> float:
    """Root mean square of what is finite; NaN when nothing is."""
    return root_mean_square(values[np.isfinite(values)])


def mean(values: Array) -> float:
    """Mean of what is finite; NaN when nothing is."""
    sound = values[np.isfinite(values)]
    return float(sound.mean()) if sound.size else float("nan")
