"""Interior orientation of a line camera: from a sample on the detector to the undistorted focal plane."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen


class Distortion(Protocol):
    """How the optics bend: measured (distorted) focal-plane place to the ideal one."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        ...


@dataclass(frozen=True, slots=True)
class NoDistortion:
    """Ideal optics."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2): the same places."""
        return place, np.broadcast_to(np.eye(2), (place.shape[0], 2, 2))


@dataclass(frozen=True, slots=True)
class LrocNacDistortion:
    """LROC narrow angle: y = y_d / (1 + k y_d^2) along the detector (ISIS LroNarrowAngleDistortionMap)."""

    k: float
    """1/m^2."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        y = place[:, 1]
        denominator = 1.0 + self.k * y * y
        jacobian = np.zeros((place.shape[0], 2, 2))
        jacobian[:, 0, 0] = 1.0
        jacobian[:, 1, 1] = (1.0 - self.k * y * y) / denominator**2
        return np.stack([place[:, 0], y / denominator], axis=1), jacobian


@dataclass(frozen=True, slots=True)
class RadialDistortion:
    """Radial polynomial (x, y) = (x_d, y_d) (1 - k0 - k1 r^2 - k2 r^4), r the distorted radius (usgscsm RADIAL)."""

    k0: float
    """no unit."""
    k1: float
    """1/m^2."""
    k2: float
    """1/m^4."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        square = np.einsum("ni,ni->n", place, place)
        scale = 1.0 - self.k0 - square * (self.k1 + square * self.k2)
        slope = -2.0 * (self.k1 + 2.0 * square * self.k2)
        jacobian = scale[:, None, None] * np.eye(2) + slope[:, None, None] * place[:, :, None] * place[:, None, :]
        return place * scale[:, None], jacobian


@dataclass(frozen=True, slots=True, eq=False)
class InteriorOrientation:
    """Focal length, the detector line in the focal plane, and the optics.

    Detector pixel = image sample * summing + first; focal-plane place = affine map of (detector line, detector sample)
    relative to the principal point; then the distortion is taken off.
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
