"""Height of a ground point above the surface that two images show (`mgsgraph.geometry.stereo_surface`).

Dense matches, averaged over a footprint, say where a pixel x of the first image lies in the second: D(x). With x1 and
x2, where a point P is seen in the two images, and e, the direction in which x2 moves when the ground comes towards the
first camera,

    F(P) = e' (x2 - D(x1)),    h = F / |grad F|                 m, along the surface's normal grad F / |grad F|

The derivative by P is the normal; by an image's state it is that of F, e and |grad F| held.

The kernel takes h as linear about a state: h = h0 + n'(P - P0) + g, where h0 is the height at P0, n the normal, and g
what the orientation corrections of the two images have moved the surface since.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import dot, subtract
from mgsgraph.factors.effects import Effect
from mgsgraph.factors.measurement import Linear, StateAt, measurement_factor, noise_model
from mgsgraph.factors.projection import ImageRay
from mgsgraph.factors.records import Array, PushbroomImage

if TYPE_CHECKING:
    import gtsam

_TURNS = 8
"""Times that the pixel of a point is looked for, each by Newton's method on the line."""
_NEAR = 1e-6
"""Pixels: about a pixel as near as this to that of the point, the detector line is straight."""


@equation
def linear_height(height, normal, point, reference, moved):
    """Residual r in m, about a state."""
    return height + dot(normal, subtract(point, reference)) + moved


class Disparity(Protocol):
    """Where pixels of one image are in another; `mgsgraph.geometry.stereo_surface.StereoSurface` has it."""

    def disparity(self, places: Array) -> tuple[Array, Array]:
        """Line and sample (n, 2) in the second image of pixels (n, 2) of the first, and derivatives (n, 2, 2)."""
        ...


class _Sighting:
    """Where a ground point is in an image."""

    def __init__(self, image: PushbroomImage, angles: str, near: tuple[float, float] | None) -> None:
        self._image, self._angles = image, angles
        self._begin = near or (0.5 * image.lines, 0.5 * image.samples)
        self._at, self._ray = self._begin, self._from(self._begin)

    def _from(self, pixel: tuple[float, float]) -> ImageRay:
        return ImageRay(self._image, pixel, "predicted", self._angles, None)

    def __call__(self, state_at: StateAt, point: Array) -> Linear | None:
        """Pixel, and its derivatives; looked for from where the point was last, or else from where it began."""
        sighted = self._followed(state_at, point)
        if sighted is None and self._at != self._begin:
            self._at, self._ray = self._begin, self._from(self._begin)
            sighted = self._followed(state_at, point)
        return sighted

    def _followed(self, state_at: StateAt, point: Array) -> Linear | None:
        for _ in range(_TURNS):
            rows = self._ray(state_at, point)
            if rows is None:
                return None
            if np.abs(rows.residual).max() < _NEAR:
                return Linear(self._at - rows.residual, -rows.by_point, -rows.by_state, rows.lines)
            self._at = (self._at[0] - float(rows.residual[0]), self._at[1] - float(rows.residual[1]))
            self._ray = self._from(self._at)
        return None

    def towards(self, state_at: StateAt, line: float, point: Array) -> Array:
        """(3,) from the point to the camera, of unit length."""
        way = self._image.pose(np.array([line])).position[0] + state_at(line)[0][:3] - point
        return np.asarray(way / np.linalg.norm(way))


class StereoHeight:
    """One height; called, its row for a GTSAM factor (`measurement.measurement_factor`)."""

    def __init__(self, surface: Disparity, first: _Sighting, second: _Sighting, level: Array | None) -> None:
        self._surface, self._first, self._second, self._level = surface, first, second, level

    def __call__(self, first_state: StateAt, second_state: StateAt, point: Array) -> Linear | None:
        """Row (m) at the states of both images and a point."""
        first, second = self._first(first_state, point), self._second(second_state, point)
        if first is None or second is None:
            return None
        matched, slopes = (values[0] for values in self._surface.disparity(first.residual[None]))
        if self._level is not None:
            slopes = np.linalg.solve((first.by_point @ self._level).T, (second.by_point @ self._level).T).T
        epipolar = second.by_point @ self._first.towards(first_state, first.lines[0], point)
        epipolar /= np.linalg.norm(epipolar)
        back = -epipolar @ slopes
        gradient = epipolar @ second.by_point + back @ first.by_point
        size = np.linalg.norm(gradient)
        by_state = np.concatenate([back @ first.by_state, epipolar @ second.by_state]) / size
        height = np.array([epipolar @ (second.residual - matched) / size])
        return Linear(height, gradient[None] / size, by_state[None], (*first.lines, *second.lines))


def stereo_height(
    point: int | Array,
    surface: Disparity,
    images: Sequence[PushbroomImage],
    effects: Sequence[Sequence[Effect]],
    sigma: float,
    *,
    angles: str = "camera",
    near: Sequence[tuple[float, float]] | None = None,
    level: Array | None = None,
    robust: tuple[str, float] | None = None,
    label: str = "",
) -> "gtsam.CustomFactor":
    """Height of a ground point above the surface that two images show: zero within sigma.

    Parameters
    ----------
    point : int or (3,)
        GTSAM key of a Point3, m, body-fixed, or a known one.
    surface : Disparity
        Where pixels of the first image are in the second.
    images : sequence of PushbroomImage
        First and second image.
    effects : sequence of sequences of Effect
        What unknowns do to either: `effects.orientation_polynomial` of its EO coefficients, for one.
    sigma : float
        m, along the surface's normal.
    angles : str
        As of `pushbroom_projection`.
    near : ((line, sample), (line, sample)), optional
        Pixels of the two images from which the point is looked for; the images' middles when absent.
    level : (3, 2), optional
        Unit vectors eastward and northward, for a height whose derivatives are those of level ground.
    robust : (name, width), optional
        As of `pushbroom_projection`.
    label : str
        What messages call the measurement.

    Returns
    -------
    gtsam.CustomFactor
        One row (m), the height, positive upward.

    Raises
    ------
    InputError
        For a sigma that is not positive.
    PointBehindCamera
        On linearization at a point behind a camera.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L, X
    >>> images = registration.solution.network.images[:2]
    >>> surface = registration.solution.network.stereo.surfaces[0]
    >>> effects = [[mgsgraph.factors.orientation_polynomial(X(k), 2, one.lines)] for k, one in enumerate(images)]
    >>> factor = mgsgraph.factors.stereo_height(L(17), surface, images, effects, 2.0)
    """
    where = label or f"height above the surface of images {images[0].name} and {images[1].name}"
    first, second = (_Sighting(image, angles, at) for image, at in zip(images, near or (None, None), strict=True))
    row = StereoHeight(surface, first, second, level)
    return measurement_factor(effects, point, row, noise_model(sigma, robust, 1, where), where)
