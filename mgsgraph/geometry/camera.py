"""Interior orientation of a line camera: from a sample on the detector to the undistorted focal plane.

How the optics of line scanners bend: from the measured place in the focal plane to the ideal one.

The models are those of usgscsm (src/Distortion.cpp, removeDistortion) and of ISIS's distortion maps. Places and
coefficients are in metres; the files' are in millimetres, and so are the sources' formulas. Where a source defines the
way from ideal to measured alone, the other way is found by Newton's method. NaN stands where there is no ideal place.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.record import Record

Undistorted = tuple[Array, Array]
"""Places (n, 2) in m and their Jacobians (n, 2, 2)."""
Four = tuple[float, float, float, float]
Ten = tuple[float, float, float, float, float, float, float, float, float, float]

_STEPS = 20
_CONVERGED = 1e-13
"""m, 1e-8 of a pixel."""


class Distortion(Protocol):
    """How the optics bend: measured (distorted) focal-plane place to the ideal one."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        ...


@dataclass(frozen=True, slots=True)
class NoDistortion:
    """A lens without distortion: measured places are the ideal ones."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2): the same places."""
        return place, np.broadcast_to(np.eye(2), (place.shape[0], 2, 2))


@dataclass(frozen=True, slots=True)
class LrocNacDistortion:
    """LROC narrow angle: y = y_d / (1 + k y_d^2) along the detector (ISIS LroNarrowAngleDistortionMap)."""

    k: float
    """1/m^2."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        y = place[:, 1]
        denominator = 1.0 + self.k * y * y
        return _along_y(place, y / denominator, (1.0 - self.k * y * y) / denominator**2)


@dataclass(frozen=True, slots=True)
class ShadowCamDistortion:
    """KPLO ShadowCam: y = y_d (1 + k y_d^2) along the detector (ISIS ShadowCamDistortionMap)."""

    k: float
    """1/m^2."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        square = self.k * place[:, 1] ** 2
        return _along_y(place, place[:, 1] * (1.0 + square), 1.0 + 3.0 * square)


@dataclass(frozen=True, slots=True)
class RadialDistortion:
    """Radial polynomial (x, y) = (x_d, y_d) (1 - k0 - k1 r^2 - k2 r^4), r the distorted radius (usgscsm RADIAL, ISIS
    CameraDistortionMap: CTX, HiRISE).
    """

    k0: float
    """no unit."""
    k1: float
    """1/m^2."""
    k2: float
    """1/m^4."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        square = np.einsum("ni,ni->n", place, place)
        scale = 1.0 - self.k0 - square * (self.k1 + square * self.k2)
        slope = -2.0 * (self.k1 + 2.0 * square * self.k2)
        return _outward(place, scale, slope)


@dataclass(frozen=True, slots=True)
class CahvorDistortion:
    """Radial polynomial about a centre of its own (usgscsm CAHVOR)."""

    radial: RadialDistortion
    """Of the place relative to the centre."""
    x: float
    """m, centre."""
    y: float
    """m, centre."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        centre = np.array([self.x, self.y])
        ideal, jacobian = self.radial.undistort(place - centre)
        return ideal + centre, jacobian


@dataclass(frozen=True, slots=True)
class KaguyaDistortion:
    """Kaguya TC: both coordinates have a polynomial of the distorted radius added (usgscsm KAGUYALISM, ISIS
    KaguyaTcCameraDistortionMap). The radius has no sign in either, while it has one in the instrument kernel
    (SEL_TC_V01.TI: r = -(n - CENTER) PIXEL_SIZE).
    """

    x: Four
    """Coefficients of powers 0 to 3, m to 1/m^2, the boresight's x in the first."""
    y: Four
    """The same for y."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        radius, outward = _polar(place)
        added, slope = _polynomials(self.x, self.y, radius)
        return place + added, np.eye(2) + slope[:, :, None] * outward[:, None, :]


@dataclass(frozen=True, slots=True)
class KaguyaMiDistortion:
    """Kaguya MI: both coordinates have a polynomial of y_d, with its sign, added (ISIS KaguyaMiCameraDistortionMap;
    support data of MI that ALE writes say ``kaguyalism`` all the same).
    """

    x: Four
    """Coefficients of powers 0 to 3, m to 1/m^2, the boresight's x in the first; the last zero for the visible."""
    y: Four
    """The same for y."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        added, slope = _polynomials(self.x, self.y, place[:, 1])
        return place + added, np.eye(2) + slope[:, :, None] * np.array([0.0, 1.0])


@dataclass(frozen=True, slots=True)
class MocWideAngleDistortion:
    """MOC wide angle: the angle off the axis is an odd polynomial of the distorted one (ISIS
    MocWideAngleDistortionMap::SetFocalPlane; y is divided by a scale before).
    """

    coefficients: tuple[float, float, float, float, float, float]
    """Of the odd powers 1 to 11 of the angle in rad."""
    scale: float
    """Of y, no unit."""
    focal_length: float
    """m."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        scaled = place / np.array([1.0, self.scale])
        radius, outward = _polar(scaled)
        angle = np.arctan2(radius, self.focal_length)
        odd = np.zeros(12)
        odd[1::2] = self.coefficients
        ideal = np.polynomial.polynomial.polyval(angle, odd)
        by_angle = np.polynomial.polynomial.polyval(angle, np.polynomial.polynomial.polyder(odd))
        tangent = np.tan(ideal)
        stretch = np.where(radius > 0.0, self.focal_length * tangent / np.where(radius > 0.0, radius, 1.0), odd[1])
        slope = (1.0 + tangent**2) * by_angle / (1.0 + (radius / self.focal_length) ** 2)
        along = (slope - stretch)[:, None, None] * outward[:, :, None] * outward[:, None, :]
        jacobian = (stretch[:, None, None] * np.eye(2) + along) / np.array([1.0, self.scale])
        return scaled * stretch[:, None], jacobian


@dataclass(frozen=True, slots=True)
class ThemisIrDistortion:
    """THEMIS infrared: x = x_d / k, and y with y (1 + a1) + a2 y^2 = y_d (ISIS ThemisIrDistortionMap)."""

    k: float
    """no unit, of the band."""
    a1: float
    """no unit."""
    a2: float
    """1/m."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        square = (1.0 + self.a1) ** 2 + 4.0 * self.a2 * place[:, 1]
        root = np.sqrt(np.where(square > 0.0, square, np.nan))
        jacobian = np.zeros((place.shape[0], 2, 2))
        jacobian[:, 0, 0], jacobian[:, 1, 1] = 1.0 / self.k, 1.0 / root
        return np.stack([place[:, 0] / self.k, 2.0 * place[:, 1] / (1.0 + self.a1 + root)], axis=1), jacobian


@dataclass(frozen=True, slots=True)
class TransverseDistortion:
    """Polynomials of third degree from ideal to distorted place (usgscsm TRANSVERSE, computeTransverseDistortion)."""

    x: Ten
    """Coefficients of 1, x, y, x^2, x y, y^2, x^3, x^2 y, x y^2, y^3: m to 1/m^2."""
    y: Ten
    """The same for y_d."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        return _inverted(self._distorted, place)

    def _distorted(self, place: Array) -> Undistorted:
        x, y = place.T
        zero, one = np.zeros_like(x), np.ones_like(x)
        of = np.array([self.x, self.y])
        powers = np.array([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
        by_x = np.array([zero, one, zero, 2.0 * x, y, zero, 3.0 * x * x, 2.0 * x * y, y * y, zero])
        by_y = np.array([zero, zero, one, zero, x, 2.0 * y, zero, x * x, 2.0 * x * y, 3.0 * y * y])
        return (of @ powers).T, np.stack([(of @ by_x).T, (of @ by_y).T], axis=2)


@dataclass(frozen=True, slots=True)
class DawnDistortion:
    """(x_d, y_d) = (x, y) (1 + k r^2), r the ideal radius (usgscsm DAWNFC)."""

    k: float
    """1/m^2."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        return _inverted(RadialDistortion(0.0, -self.k, 0.0).undistort, place)  # the same polynomial, the other way


@dataclass(frozen=True, slots=True)
class RadtanDistortion:
    """Radial and tangential, of OpenCV, from ideal to distorted place in units of the focal length (usgscsm RADTAN,
    computeRadTanDistortion).
    """

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    focal_length: float
    """m."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        ideal, jacobian = _inverted(self._distorted, place / self.focal_length)
        return ideal * self.focal_length, jacobian

    def _distorted(self, place: Array) -> Undistorted:
        square = np.einsum("ni,ni->n", place, place)[:, None]
        radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3))
        slope = 2.0 * (self.k1 + square * (2.0 * self.k2 + square * 3.0 * self.k3))
        decentred = np.array([self.p2, self.p1])
        across = 2.0 * (place @ decentred)[:, None]
        jacobian = (radial + across)[:, :, None] * np.eye(2) + slope[:, :, None] * place[:, :, None] * place[:, None, :]
        jacobian += 2.0 * (decentred[:, None] * place[:, None, :] + place[:, :, None] * decentred)
        return place * (radial + across) + square * decentred, jacobian


@dataclass(frozen=True, slots=True)
class CorrectedDistortion:
    """A model with what an adjustment adds to it: (x, y) (1 + c1 r^2 + c2 r^4 + c3 r^6) - (xp, yp), x, y and r being
    the model's ideal place and its radius.
    """

    nominal: Distortion
    """The model."""
    point: tuple[float, float]
    """m, (xp, yp): principal point."""
    radial: tuple[float, float, float]
    """1/m^2, 1/m^4 and 1/m^6: c1, c2, c3."""

    def undistort(self, place: Array) -> Undistorted:
        """Ideal places (n, 2) in m and their Jacobians (n, 2, 2) of distorted places (n, 2) in m."""
        ideal, jacobian = self.nominal.undistort(place)
        square, (c1, c2, c3) = np.einsum("ni,ni->n", ideal, ideal), self.radial
        scale = 1.0 + square * (c1 + square * (c2 + square * c3))
        slope = 2.0 * (c1 + square * (2.0 * c2 + square * 3.0 * c3))
        scaled, outward = _outward(ideal, scale, slope)
        return scaled - np.array(self.point), outward @ jacobian


def _outward(place: Array, scale: Array, slope: Array) -> Undistorted:
    """Places times scales (n,), with their Jacobians: a scale changes by the slope (n,) times its place."""
    jacobian = scale[:, None, None] * np.eye(2) + slope[:, None, None] * place[:, :, None] * place[:, None, :]
    return place * scale[:, None], jacobian


def _along_y(place: Array, y: Array, slope: Array) -> Undistorted:
    """Places whose x stays, with their Jacobians: the slope (n,) of y (n,)."""
    jacobian = np.zeros((place.shape[0], 2, 2))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = 1.0, slope
    return np.stack([place[:, 0], y], axis=1), jacobian


def _polar(place: Array) -> tuple[Array, Array]:
    """Radii (n,) of places (n, 2), and unit vectors (n, 2) outward; zero in the centre."""
    radius = np.hypot(*place.T)
    return radius, place / np.where(radius > 0.0, radius, 1.0)[:, None]


def _polynomials(x: Four, y: Four, of: Array) -> tuple[Array, Array]:
    """Values (n, 2) of two polynomials of (n,), and their slopes (n, 2)."""
    both = np.array([x, y]).T
    values, slopes = (
        np.asarray(np.polynomial.polynomial.polyval(of, powers).T, dtype=np.float64)
        for powers in (both, np.polynomial.polynomial.polyder(both))
    )
    return values, slopes


def _inverted(distort: Callable[[Array], Undistorted], place: Array) -> Undistorted:
    """Ideal places of distorted ones (n, 2) by Newton's method, and their Jacobians; NaN where it does not converge."""
    ideal = place
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_STEPS):
            distorted, forward = distort(ideal)
            step = solved(forward, (place - distorted)[:, :, None])[:, :, 0]
            ideal = ideal + step
            if not np.any(np.abs(step) > _CONVERGED):  # NaN has converged, too
                break
        settled = np.all(np.abs(step) <= _CONVERGED, axis=1)
        jacobian = solved(distort(ideal)[1], np.eye(2))
    return np.where(settled[:, None], ideal, np.nan), np.where(settled[:, None, None], jacobian, np.nan)


def solved(matrices: Array, right: Array) -> Array:
    """Solutions (n, 2, k) of equations with matrices (n, 2, 2) and right sides (n, 2, k); NaN where singular."""
    (a, b), (c, d) = np.moveaxis(matrices, 0, -1)
    determinant = a * d - b * c
    adjugate = np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0)
    return np.asarray(adjugate @ right / np.where(determinant == 0.0, np.nan, determinant)[:, None, None])


MODELS: tuple[type[Distortion], ...] = (
    NoDistortion, RadialDistortion, CahvorDistortion, TransverseDistortion, RadtanDistortion, DawnDistortion,
    LrocNacDistortion, ShadowCamDistortion, KaguyaDistortion, KaguyaMiDistortion, MocWideAngleDistortion,
    ThemisIrDistortion,
)  # fmt: skip
"""All of them."""


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
    distortion: Distortion = NoDistortion()
    """From the measured to the ideal focal-plane place; none when absent."""

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
        """Viewing directions of samples (n,) in camera components, (n, 3) m with the focal length along the axis, and
        their changes per sample, (n, 3) m.
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
