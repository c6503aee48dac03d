"""Rows of one image ray by compiled code: what `projection.ImageRay` calls, a hundred times as fast as in Python."""

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.factors.collinearity import ray_rows
from mgsgraph.factors.pose import turned_about_axes


@compiled
def three(values, first):
    """Three numbers of an array, one after the other."""
    return values[first], values[first + 1], values[first + 2]


@cached_kernel
def ray_at(position, matrix, velocity, angular_rate, detector, point, state, rate, rows):
    """How far along the optical axis a point is, and `rows` (2, 17): residual, then derivatives by point (3) and state
    (13) of line and sample, at the nominal pose of one line (arrays (1, ...) as `Pose` has them) and a state and its
    rate (13,). `detector` has place, slope and focal length (5,).
    """
    m = matrix[0]
    nominal = three(position[0], 0), (three(m[0], 0), three(m[1], 0), three(m[2], 0))
    motion = three(velocity[0], 0), three(angular_rate[0], 0)
    pixel = (detector[0], detector[1]), (detector[2], detector[3]), detector[4]
    moved = (
        state[0], state[1], state[2], state[3], state[4], state[5], state[6], state[7], state[8], state[9],
        state[10], state[11], state[12],
    )  # fmt: skip
    slope = rate[0], rate[1], rate[2], rate[3], rate[4], rate[5]
    ahead, residuals, line, sample = ray_rows(
        (*nominal, *motion), pixel, three(point, 0), moved, slope, turned_about_axes, None
    )
    for k in range(2):
        of_point, of_rotation, of_interior = line if k == 0 else sample
        rows[k, 0] = residuals[k]
        rows[k, 13:] = 0.0
        for c in range(3):
            rows[k, 1 + c], rows[k, 4 + c] = of_point[c], -of_point[c]
            rows[k, 7 + c], rows[k, 10 + c] = of_rotation[c], of_interior[c]
    return ahead
