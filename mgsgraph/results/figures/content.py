"""The numbers that figures show, as arrays: residuals by image, places on a map."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import PointClass
from mgsgraph.text import root_mean_square


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


def rms(values: Array) -> float:
    """Root mean square of what is finite; NaN when nothing is."""
    return root_mean_square(values[np.isfinite(values)])


def mean(values: Array) -> float:
    """Mean of what is finite; NaN when nothing is."""
    sound = values[np.isfinite(values)]
    return float(sound.mean()) if sound.size else float("nan")
