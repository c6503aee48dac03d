"""Image coordinates of a ground point as a GTSAM factor (Yoon & Shan 2005, Eq. 1 and 2; equations: `collinearity`)."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.factors.algebra import subtract, transform
from mgsgraph.factors.collinearity import (
    NEWTON_STEPS,
    NEWTON_TOLERANCE,
    image_motion,
    pixels,
    ray_motion,
    ray_rows,
    to_lines_and_samples,
)
from mgsgraph.factors.effects import STATE, Effect, orientation_polynomial
from mgsgraph.factors.measurement import Linear, StateAt, measurement_factor, noise_model, point_names
from mgsgraph.factors.pose import ATTITUDES
from mgsgraph.factors.records import Array, PushbroomImage

if TYPE_CHECKING:
    import gtsam

_FAR = 1000.0
"""Pixels: a point that is more than an image's length and this outside isn't seen."""
Line = Literal["predicted", "measured"]
Angles = Literal["camera", "opk-paper", "opk-peer"]


class ImageRay:
    """One image ray; called, its rows for a GTSAM factor (`measurement.measurement_factor`).

    In the strict form the pose is that of the predicted line, found by Newton's method from the measured one: the rows
    are functions of the unknowns and the point alone.
    """

    def __init__(
        self, image: PushbroomImage, measured: tuple[float, float], line: Line, angles: str, near: Array | None
    ) -> None:
        self._image, (self._line, self._sample), self._strict = image, measured, line == "predicted"
        place, slope = image.interior.focal_plane(np.array([self._sample]))
        self._detector = np.array([*place[0], *slope[0], image.interior.focal_length])
        self._begin = self._kept = self._line, self._nominal(self._line)
        if self._strict and angles == "camera":
            from mgsgraph.factors.compiled_rows import ray_at  # compiled: not before it is needed

            self._rows: Callable[..., float] = ray_at
        else:
            self._rows = partial(_ray_at, ATTITUDES[angles], None if self._strict else self._scale(angles, near))

    def _nominal(self, line: float) -> tuple[Array, ...]:
        pose = self._image.pose(np.array([line]))
        return pose.position, pose.matrix, pose.velocity, pose.angular_rate

    def _scale(self, angles: str, near: Array | None) -> Any:
        """S of the measured-line form."""
        slope = tuple(self._detector[2:4].tolist())
        if angles == "opk-peer":
            return tuple(pixels(slope))
        if near is None:
            where = f"pushbroom projection, image {self._image.name}"
            raise InputError(where, "the measured line without `near`", "about where the point is (3,), m")
        centre, matrix, velocity, angular_rate = _tuples(self._begin[1])
        ray = transform(matrix, subtract(tuple(near.tolist()), centre))
        motion = image_motion(ray, ray_motion(matrix, ray, velocity, angular_rate), float(self._detector[4]))
        return to_lines_and_samples(motion, slope)

    def __call__(self, state_at: StateAt, point: Array) -> Linear | None:
        """Rows (lines, samples), measured minus predicted, at a state (13) and a point."""
        (line, nominal), rows = self._begin, np.empty((2, 4 + STATE))
        for _ in range(NEWTON_STEPS):
            if not self._rows(*nominal, self._detector, point, *state_at(line), rows) > 0.0:
                return None
            step = float(rows[0, 0])
            if not self._strict or abs(step) < NEWTON_TOLERANCE:
                break
            line -= step
            if line != self._kept[0]:
                self._kept = line, self._nominal(line)
            nominal = self._kept[1]
        rows[0, 0] += self._line - line
        size, measured = (self._image.lines, self._image.samples), (self._line, self._sample)
        for total, at, missed in zip(size, measured, rows[:, 0].tolist(), strict=True):
            if not -total - _FAR < at - missed < 2 * total + _FAR:
                return None
        return Linear(rows[:, 0], rows[:, 1:4], rows[:, 4:], (line,))


def _tuples(nominal: Sequence[Array]) -> tuple[Any, ...]:
    """Position, matrix, velocity and angular rate of one line, of arrays (1, ...)."""
    centre, matrix, velocity, rate = (array[0].tolist() for array in nominal)
    return tuple(centre), tuple(map(tuple, matrix)), tuple(velocity), tuple(rate)


def _ray_at(attitude_of: Any, frozen: Any, *arrays: Array) -> float:
    """As `compiled_rows.ray_at`, for any angles and either form, in Python."""
    *nominal, detector, point, state, rate, rows = arrays
    x, y, along, across, focal = detector.tolist()
    ahead, values, *derivatives = ray_rows(
        _tuples(nominal), ((x, y), (along, across), focal), tuple(point.tolist()), tuple(state.tolist()),
        tuple(rate.tolist()), attitude_of, frozen,
    )  # fmt: skip
    for k, (of_point, of_rotation, of_interior) in enumerate(derivatives):
        rows[k] = (values[k], *of_point, *(-d for d in of_point), *of_rotation, *of_interior, 0.0, 0.0, 0.0, 0.0)
    return float(ahead)


def pushbroom_projection(
    image_key: int | None,
    point: int | Array,
    image: PushbroomImage,
    measured: tuple[float, float],
    sigma: float | Array = 1.0,
    degree: int = 2,
    *,
    shared: Sequence[Effect] = (),
    line: Line = "predicted",
    angles: Angles = "camera",
    near: Array | None = None,
    robust: tuple[str, float] | None = None,
    label: str = "",
) -> "gtsam.CustomFactor":
    """Image coordinates of a ground point in a pushbroom image whose EO correction is a polynomial of the line
    (Yoon & Shan 2005, Eq. 1 and 2).

    Parameters
    ----------
    image_key : int or None
        GTSAM key of the image's 6 (degree + 1) EO coefficients (Vector; m, rad about the camera's axes; six of u^0
        first, u from -1 at the first line to 1 at the last). None for an image without such unknowns.
    point : int or (3,)
        GTSAM key of the ground point (Point3, m, body-fixed), or a known one.
    image : PushbroomImage
        Camera and nominal trajectory.
    measured : (line, sample)
        Pixels; the first one's center is (0.5, 0.5).
    sigma : float or (2,)
        Pixels, of line and sample.
    degree : int
        Of the polynomials.
    shared : sequence of Effect
        What other unknowns do to this ray (`effects.Effect`).
    line : str
        "predicted": pose of the predicted line, the strict form; "measured": of the measured one, the papers' form.
    angles : str
        What the rotation part is: "camera", about its axes; added to omega, phi, kappa of the papers ("opk-paper") or
        of the C++ peer ("opk-peer").
    near : (3,), optional
        m, about where the point is; for the scale of the measured line's residuals, which stays as it is.
    robust : (name, width), optional
        "huber", "cauchy" or "tukey", on the norm of both whitened rows, and its width in sigmas.
    label : str
        What messages call the measurement; the point's key, image and pixel when empty.

    Returns
    -------
    gtsam.CustomFactor
        Rows (line, sample), measured minus predicted.

    Raises
    ------
    InputError
        For a measured line without `near`, a pixel outside the image, sigmas that are not positive.
    PointBehindCamera
        On linearization at a point that the image doesn't see: behind the camera, or more than an image's size outside.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L, X
    >>> factor = mgsgraph.factors.pushbroom_projection(X(0), L(17), network.images[0], (2500.2, 511.7))
    """
    if np.shape(measured) != (2,):
        raise InputError(label or f"image {image.name}", f"measured: {measured}", "line and sample, pixels")
    at = f"measured at line {measured[0]:g}, sample {measured[1]:g}"
    where = label or ", ".join([*point_names(point), f"image {image.name}", at])
    if not (0.0 <= measured[0] <= image.lines and 0.0 <= measured[1] <= image.samples):
        size = f"0 .. {image.lines} lines, 0 .. {image.samples} samples"
        raise InputError(where, f"pixel {measured[0]:g}, {measured[1]:g}", size, "check line and sample")
    orientation = [] if image_key is None else [orientation_polynomial(image_key, degree, float(image.lines))]
    ray = ImageRay(image, (float(measured[0]), float(measured[1])), line, angles, near)
    return measurement_factor([[*orientation, *shared]], point, ray, noise_model(sigma, robust, 2, where), where)
