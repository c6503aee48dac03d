"""Interior orientation of a line camera: from a sample on the detector to the undistorted focal plane."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.distortion import Distortion
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class InteriorOrientation(Record):
    """Focal length, the detector line in the focal plane, and the optics.

    Detector pixel = image sample * summing + first; focal-plane place = affine map of (detector line, detector sample)
    relative to the principal point; then the distortion is taken off.

    Examples
    --------
    >>> interior = network.images[0].interior
    >>> place, _ = interior.focal_plane(np.array([0.5, 512.0]))
    >>> interior.focal_length, (1e3 * place).round(3)
    (3.5, array([[  0.   , -13.299],
           [  0.   ,   0.   ]]))
    """

    focal_length: float
    """m."""
    to_pixel: Array
    """(2, 3) pixels and pixels/m: detector (line, sample) minus `centre` = to_pixel[:, 0] + to_pixel[:, 1:] (x, y)."""
    centre: Array
    """(2,) detector (line, sample) of the principal point, pixels, pixel centres at half-integers."""
    first: Array
    """(2,) detector (line, sample) at which the image begins (edit mode), pixels."""
    sample_summing: float
    """detector pixels per image sample."""
    distortion: Distortion
    """From the measured to the ideal focal-plane place."""

    def __post_init__(self) -> None:
        for name in ("focal_length", "sample_summing"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"interior orientation, {name}", f"{value}", "a positive number")
        to_pixel = frozen(self.to_pixel, "interior orientation, focal plane to pixels", (2, 3))
        if np.linalg.matrix_rank(to_pixel[:, 1:]) < 2:
            raise InputError("interior orientation, focal plane to pixels", "a singular map", "an invertible one")
        assign(
            self,
            to_pixel=to_pixel,
            centre=frozen(self.centre, "interior orientation, detector centre", (2,)),
            first=frozen(self.first, "interior orientation, first detector pixel", (2,)),
        )

    def focal_plane(self, samples: Array) -> tuple[Array, Array]:
        """Ideal focal-plane place of samples on the detector line, and how it moves along the detector.

        Parameters
        ----------
        samples : (n,)
            image samples, first pixel's centre at 0.5.

        Returns
        -------
        place : (n, 2)
            m, camera x and y, so that the ray is (x, y, focal length).
        slope : (n, 2)
            m per sample.
        """
        pixel = np.empty((samples.size, 2))
        pixel[:, 0] = self.first[0] - self.centre[0]
        pixel[:, 1] = samples * self.sample_summing + self.first[1] - self.centre[1]
        from_pixel: Array = np.linalg.inv(self.to_pixel[:, 1:]).astype(np.float64)
        place, jacobian = self.distortion.undistort((pixel - self.to_pixel[:, 0]) @ from_pixel.T)
        along, across = from_pixel[:, 1] * self.sample_summing
        return place, jacobian[:, :, 0] * along + jacobian[:, :, 1] * across


    def looks(self, samples: Array) -> tuple[Array, Array]:
        """What samples (n,) look along in camera components, (n, 3) m with the focal length along the axis, and how it
        changes per sample, (n, 3) m.
        """
        place, slope = self.focal_plane(samples)
        length = np.full((samples.size, 1), self.focal_length)
        return np.hstack([place, length]), np.hstack([slope, np.zeros_like(length)])


class Detector(NamedTuple):
    """A line of pixels in the focal plane of a camera, in axes that the camera may be mounted against."""

    place: Array
    """(n, 2) m, x and y of each pixel, so that its ray is (x, y, focal length)."""
    slope: Array
    """(n, 2) m per sample."""

    def in_axes(self, axes: Array | None, focal_length: float) -> "Detector":
        """The same pixels in the focal plane, at the same focal length, of other axes that turn with the camera.

        Parameters
        ----------
        axes : (3, 3) or None
            From these axes to the camera's (`network.passes`); None: they are the camera's.
        focal_length : float
            m.

        Raises
        ------
        InputError
            Where a pixel looks 90 degrees or more away from the third axis: no focal plane holds it.
        """
        if axes is None:
            return self
        ray = np.hstack([self.place, np.full((len(self.place), 1), focal_length)]) @ axes
        if ray.size and ray[:, 2].min() <= 0.0:
            expected = "cameras of one pass within 90 degrees of its axes"
            raise InputError("mounting", "a camera that looks away from the pass's axes", expected)
        along = np.hstack([self.slope, np.zeros((len(self.slope), 1))]) @ axes
        scale = focal_length / ray[:, 2:]
        place = ray[:, :2] * scale
        return Detector(place, (along[:, :2] - place / focal_length * along[:, 2:]) * scale)
