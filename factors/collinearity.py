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

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, cross, dot, subtract, transform, transpose
from mgsgraph.factors.explicit import Linear, StateAt, Vector
from mgsgraph.factors.pose import perspective_centre

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


class ImageRay(NamedTuple):
    """One image ray, laid out about a line; called, its rows for a GTSAM factor (`explicit.measurement_factor`)."""

    attitude: Callable[..., Any]
    """`pose.about_axes`, `opk_paper` or `opk_peer`."""
    centre: Vector
    """(3,) m, C0."""
    nominal: Vector
    """M0, as `attitude` takes it."""
    velocity: Vector
    """(3,) m per line."""
    angular_rate: Vector
    """(3,) rad per line."""
    detector: Vector
    """(2,) m, focal-plane coordinates of the measured sample."""
    slope: Vector
    """(2,) m per sample."""
    scale: tuple[Vector, Vector] | None
    """S of the measured-line form; None for the predicted line."""
    offset: float
    """Lines from the measured line to the one about which the ray is laid out."""
    focal: float
    """m, nominal."""

    def __call__(self, state_at: StateAt, position: Vector) -> Linear | None:
        """Rows (lines, samples) at a state: correction of position, rotation, and of x0, y0 and focal length."""
        line_offset, velocity, angular_rate = 0.0, self.velocity, self.angular_rate
        for step in range(NEWTON_STEPS):
            state, rate = state_at(line_offset)
            x, y, longer = state[6:9] if len(state) > 6 else (0.0, 0.0, 0.0)
            focal, detector = self.focal + longer, (self.detector[0] + x, self.detector[1] + y)
            centre = perspective_centre(self.centre, velocity, line_offset, state[:3])
            attitude, axes, camera_rate = self.attitude(self.nominal, angular_rate, line_offset, state[3:6], rate[3:6])
            ray = transform(attitude, subtract(position, centre))
            if ray[2] <= 0.0:
                return None
            image, scale = focal_plane(ray, focal), self.scale
            if scale is not None:
                break
            motion = ray_motion(attitude, ray, add(velocity, rate[:3]), camera_rate)
            scale = to_lines_and_samples(image_motion(ray, motion, focal), self.slope)
            step_back = residual(scale, image, detector, 0.0)[0]
            if abs(step_back) < NEWTON_TOLERANCE or step == NEWTON_STEPS - 1:
                break
            line_offset -= step_back
        assert scale is not None  # of the last step
        of_ray = by_ray(scale, ray, focal)
        by_points = np.array([by_point(row, attitude) for row in of_ray])
        state_rows: list[Any] = [-by_points, [by_rotation(row, ray, axes) for row in of_ray]]
        if len(state) > 6:
            state_rows.append([by_interior(row, ray) for row in scale])
        values = residual(scale, image, detector, self.offset + line_offset)
        return Linear(np.array(values), by_points, np.hstack(state_rows), line_offset)
