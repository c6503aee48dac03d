"""Collinearity: where a ground point falls in a pushbroom image (Yoon & Shan 2005, Eq. 1; pose: Eq. 2, `factors.pose`).

    d = (a, b, c) = M (P - C)                  the ray, in camera components; +Z out of the lens
    x = f a / c,    y = f b / c                its image in the focal plane, m

The papers' -f belongs to axes turned by diag(1, -1, -1). A detector line sees the point in the line where (x, y) lies
on it. With e = (x - x0, y - y0) the misplacement from the detector pixel of the measured sample, and S the 2x2 matrix
that takes metres to (lines, samples), the residuals, measured minus predicted, are

    r = S e - (beyond, 0)                      `beyond`: lines from the measured line to the line of the pose

*Predicted line* (the strict form): the pose is that of the line where S e has no line left, found by Newton's method,
and S follows from the image's motion per line there. *Measured line* (the papers'): beyond is 0, S constants of the
ray. Derivatives by the chain rule: by the ray, then by point, position (minus that by the point), rotation, and by the
interior orientation, which is what the pixel looks along in camera components: (x0, y0, f).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.errors import InputError
from mgsgraph.factors.algebra import add, cross, dot, subtract, transform, transpose
from mgsgraph.factors.effects import STATE, Array, Effect, orientation_polynomial
from mgsgraph.factors.measurement import Linear, StateAt, Vector, measurement_factor, noise_model
from mgsgraph.factors.pose import ATTITUDES

if TYPE_CHECKING:
    import gtsam

NEWTON_STEPS = 5
NEWTON_TOLERANCE = 1e-4
"""Lines; the last step is taken linearly, in the residual itself. One step does it unless the misfit is of tens of
lines. The Jacobian is that of the implicit function, wrong by this over the image's length in lines."""


@equation
def focal_plane(ray, focal):
    """Image (x, y) of a ray, m: Eq. 1."""
    return focal * ray[0] / ray[2], focal * ray[1] / ray[2]


@equation
def image_by_ray(ray, focal):
    """Derivatives of x and of y by (a, b, c)."""
    per_metre = focal / ray[2]
    return (per_metre, 0.0, -per_metre * ray[0] / ray[2]), (0.0, per_metre, -per_metre * ray[1] / ray[2])


@equation
def ray_motion(attitude, ray, velocity, angular_rate):
    """Rate of the ray per line: the camera turns (rad per line, in its axes) and flies (m per line, body-fixed)."""
    return subtract(cross(ray, angular_rate), transform(attitude, velocity))


@equation
def image_motion(ray, motion, focal):
    """Rate of the image (x, y) per line, m."""
    by_ray = image_by_ray(ray, focal)
    return dot(by_ray[0], motion), dot(by_ray[1], motion)


@equation
def to_lines_and_samples(motion, slope):
    """S: a misplacement in lines and samples, from the image's motion per line and the detector's slope, m per sample.

    e + motion dl = slope ds; the residuals are -dl and -ds.
    """
    determinant = motion[0] * slope[1] - motion[1] * slope[0]
    return (
        (slope[1] / determinant, -slope[0] / determinant),
        (motion[1] / determinant, -motion[0] / determinant),
    )


@equation
def residual(scale, image, detector, beyond):
    """Residuals r = S e - (beyond, 0): lines, samples."""
    x, y = image[0] - detector[0], image[1] - detector[1]
    return scale[0][0] * x + scale[0][1] * y - beyond, scale[1][0] * x + scale[1][1] * y


@equation
def by_ray(scale, ray, focal):
    """Derivatives of line and sample by (a, b, c), S held."""
    (xa, _, xc), (_, yb, yc) = image_by_ray(ray, focal)
    return (
        (scale[0][0] * xa, scale[0][1] * yb, scale[0][0] * xc + scale[0][1] * yc),
        (scale[1][0] * xa, scale[1][1] * yb, scale[1][0] * xc + scale[1][1] * yc),
    )


@equation
def by_point(of_ray, attitude):
    """Derivative by P of a row whose derivative by the ray is known: dd = M dP. By C it is minus this."""
    return transform(transpose(attitude), of_ray)


@equation
def by_rotation(of_ray, ray, axes):
    """Derivative by the rotation parameters: dd = [d]x A dtheta."""
    return transform(transpose(axes), cross(of_ray, ray))


@equation
def by_interior(of_image, ray):
    """Derivative of a row by x0, y0 and f: de = (a/c, b/c) df - (dx0, dy0); `of_image` is the row's line of S."""
    return -of_image[0], -of_image[1], (of_image[0] * ray[0] + of_image[1] * ray[1]) / ray[2]


@equation
def ray_rows(pose, detector, point, state, rate, attitude_of, frozen):
    """Rows about one line: how far along the optical axis the point is; residuals of line and sample; their derivatives
    by point, rotation and interior orientation. By position they are minus those by point.

    Parameters: nominal pose there (position, matrix, velocity and angular rate per line); detector (place, slope, focal
    length); state (13) and its rate per line; `attitude_of` as `pose.turned_about_axes`; S of the measured-line form,
    None for that of the predicted line.
    """
    centre, matrix, velocity, angular_rate = pose
    place, slope, focal = detector
    focal, place = focal + state[8], (place[0] + state[6], place[1] + state[7])
    turned = state[12] / focal
    slope = slope[0] + state[10] - turned * place[0], slope[1] + state[11] - turned * place[1]
    attitude, axes, camera_rate = attitude_of(matrix, angular_rate, state[3:6], rate[3:6])
    ray = transform(attitude, subtract(point, add(centre, state[:3])))
    scale = frozen
    if scale is None:
        motion = ray_motion(attitude, ray, add(velocity, rate[:3]), camera_rate)
        scale = to_lines_and_samples(image_motion(ray, motion, focal), slope)
    line, sample = by_ray(scale, ray, focal)
    return (
        ray[2],
        residual(scale, focal_plane(ray, focal), place, 0.0),
        (by_point(line, attitude), by_rotation(line, ray, axes), by_interior(scale[0], ray)),
        (by_point(sample, attitude), by_rotation(sample, ray, axes), by_interior(scale[1], ray)),
    )


def pixels(slope):
    """S of the peer's program: pixels of the detector's size along and across it."""
    square = slope[0] ** 2 + slope[1] ** 2
    return (slope[1] / square, -slope[0] / square), (-slope[0] / square, -slope[1] / square)


Line = Literal["predicted", "measured"]
Angles = Literal["camera", "opk-paper", "opk-peer"]


class Pose(Protocol):
    """Of a camera at n lines, rates per line."""

    @property
    def position(self) -> Array:
        """(n, 3) m, body-fixed."""
        ...

    @property
    def matrix(self) -> Array:
        """(n, 3, 3) body-fixed to camera, +Z out of the lens."""
        ...

    @property
    def velocity(self) -> Array:
        """(n, 3) m per line, body-fixed."""
        ...

    @property
    def angular_rate(self) -> Array:
        """(n, 3) rad per line, in camera axes."""
        ...


class Interior(Protocol):
    """Interior orientation of a camera."""

    @property
    def focal_length(self) -> float:
        """In m."""
        ...

    def focal_plane(self, samples: Array) -> tuple[Array, Array]:
        """(n, 2) m, ideal places of image samples, and (n, 2) m per sample, how the detector goes on there."""
        ...


class PushbroomImage(Protocol):
    """What a factor asks of an image; `mgsgraph.geometry.image.PushbroomImage` has it."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def lines(self) -> int:
        """Number of lines."""
        ...

    @property
    def samples(self) -> int:
        """Number of samples."""
        ...

    @property
    def interior(self) -> Interior:
        """Camera constants."""
        ...

    def pose(self, lines: Array) -> Pose:
        """Nominal pose at lines (n,)."""
        ...


class ImageRay:
    """One image ray; called, its rows for a GTSAM factor (`measurement.measurement_factor`).

    In the strict form the pose is that of the predicted line, found by Newton's method from the measured one: the rows
    are functions of the unknowns and the point alone.
    """

    def __init__(
        self, image: PushbroomImage, measured: tuple[float, float], line: Line, angles: str, near: Array | None
    ) -> None:
        self._image, (self._line, sample), self._strict = image, measured, line == "predicted"
        place, slope = image.interior.focal_plane(np.array([sample]))
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
        return Linear(rows[:, 0], rows[:, 1:4], rows[:, 4:], (line,))


def _tuples(nominal: Sequence[Array]) -> tuple[Any, ...]:
    """Position, matrix, velocity and angular rate of one line, of arrays (1, ...)."""
    centre, matrix, velocity, rate = (one[0].tolist() for one in nominal)
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
        rows[k] = (values[k], *of_point, *(-one for one in of_point), *of_rotation, *of_interior, 0.0, 0.0, 0.0, 0.0)
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
        What messages call the measurement; image and pixel when empty.

    Returns
    -------
    gtsam.CustomFactor
        Rows (line, sample), measured minus predicted.

    Raises
    ------
    InputError
        For a measured line without `near`, a pixel outside the image, sigmas that are not positive.
    PointBehindCamera
        On linearization at a point behind the camera.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L, X
    >>> factor = mgsgraph.factors.pushbroom_projection(X(0), L(17), network.images[0], (2500.2, 511.7))
    """
    where = label or f"image {image.name}, measured at line {measured[0]:g}, sample {measured[1]:g}"
    if not (0.0 <= measured[0] <= image.lines and 0.0 <= measured[1] <= image.samples):
        size = f"0 .. {image.lines} lines, 0 .. {image.samples} samples"
        raise InputError(where, f"pixel {measured[0]:g}, {measured[1]:g}", size, "check line and sample")
    own = [] if image_key is None else [orientation_polynomial(image_key, degree, float(image.lines))]
    ray = ImageRay(image, (float(measured[0]), float(measured[1])), line, angles, near)
    return measurement_factor([[*own, *shared]], point, ray, noise_model(sigma, robust, 2, where), where)
