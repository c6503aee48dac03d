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

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, cross, dot, subtract, transform, transpose

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
def peer_pixels(slope):
    """S of the peer's form: pixels of the detector's size along and across its line, whose slope is in m per sample."""
    square = slope[0] * slope[0] + slope[1] * slope[1]
    return (slope[1] / square, -slope[0] / square), (-slope[0] / square, -slope[1] / square)


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
