"""The search for the lines that see ground points, by compiled code (`geometry.line_search`)."""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.factors.algebra import scale, subtract, transform
from mgsgraph.factors.collinearity import (
    by_point,
    by_ray,
    focal_plane,
    image_motion,
    ray_motion,
    residual,
    to_lines_and_samples,
)
from mgsgraph.geometry.compiled_pose import place_at, rows_of, set_vector, vector

NEAR = 0.05
"""By how much w may miss zero where its parabola is nearest to it, in shares of its slope over the interval."""


@compiled
def ray_at(point, planes, k, part):
    """A number of a point at line k of the grid (`line_search._planes`)."""
    x, y, z = point
    return planes[k, part, 0] * x + planes[k, part, 1] * y + planes[k, part, 2] * z - planes[k, part, 3]


@compiled
def curved_side(w, depth, along, table):
    """The same of a curved detector, which goes on straight beyond its table."""
    end = min(max(along / depth, table[0][0]), table[0][-1])
    place, slope = place_at(end, table)
    return w - depth * place[1] - (along - depth * end) * slope[1]


@compiled
def root(first, last, slope):
    """Where from 0 to 1 the parabola with these values at 0 and 1, of unlike sign, and this slope at 0 is zero."""
    curvature = last - first - slope
    root = np.sqrt(max(slope * slope - 4.0 * curvature * first, 0.0))
    for denominator in (-slope - root, -slope + root):
        share = 2.0 * first / denominator
        if 0.0 <= share <= 1.0:
            return share
    return first / (first - last)


@compiled
def nearest(before, after, slope):
    """Where from 0 to 1 w has its zero, or is nearest to it and may reach it, and which of the two (0, 1); else -1."""
    if (before >= 0.0) != (after >= 0.0):
        return root(before, after, slope), 0
    curvature = after - before - slope
    if not slope * before <= 0.0 or not curvature * before > 0.0:
        return -1.0, 1
    share = -0.5 * slope / curvature
    if share > 1.1 or (before + 0.5 * share * slope) / before > NEAR * abs(slope / before):
        return -1.0, 1
    return min(share, 1.0), 1


@cached_kernel
def scan_grid(points, lines, planes, blocks, table, widths, which, values):
    """Write down the brackets of points (n, 3), as many as there is room for; how many there are."""
    count, slack, (ends, margins) = 0, 0.01 * (table[0][-1] - table[0][0]) + widths[1], blocks
    for i in range(points.shape[0]):
        point = vector(points, i)
        off = np.sqrt(point[0] ** 2 + point[1] ** 2 + point[2] ** 2)
        w = ray_at(point, planes, 0, 0)
        for block in range(margins.shape[0]):
            w, previous = ray_at(point, planes, ends[block + 1], 0), w
            if min(abs(w), abs(previous)) > margins[block, 0] + off * margins[block, 1] and w * previous > 0.0:
                continue
            before = after = 0.0
            for k in range(ends[block] - 1, ends[block + 1]):
                before, after = after, ray_at(point, planes, k + 1, 0)
                if widths[0] > 0.0 and abs(after) <= widths[0] * abs(ray_at(point, planes, k + 1, 2)):
                    after = curved_side(after, ray_at(point, planes, k + 1, 2), ray_at(point, planes, k + 1, 1), table)
                if k < ends[block]:
                    continue
                share, dip = nearest(before, after, ray_at(point, planes, k, 3))
                if not share >= 0.0:
                    continue
                first, last = ray_at(point, planes, k, 2), ray_at(point, planes, k + 1, 2)
                depth = first + share * (last - first)
                first, last = ray_at(point, planes, k, 1), ray_at(point, planes, k + 1, 1)
                along = (first + share * (last - first)) / depth
                if not depth > 0.0 or not table[0][0] - slack <= along <= table[0][-1] + slack:
                    continue
                if count < which.shape[0]:
                    which[count, 0], which[count, 1] = i, dip
                    values[count, 0], values[count, 1], values[count, 4] = lines[k], lines[k + 1], before
                    values[count, 2] = lines[k] + share * (lines[k + 1] - lines[k])
                    values[count, 3] = place_at(along, table)[0][0]
                count += 1
    return count


@cached_kernel
def newton_steps(points, pose, detector, focal, step, derivative, across):
    """Newton's step (n, 2) in lines and samples, the places' derivatives by the points (n, 2, 3), and on which side of
    the detector a point is and to which side it moves (n, 2); NaN behind the camera.
    """
    position, velocity, matrix, rate = pose
    place, slope = detector
    for i in range(points.shape[0]):
        attitude = rows_of(matrix[i])
        ray = transform(attitude, subtract(vector(points, i), vector(position, i)))
        ray = ray[0], ray[1], ray[2] if ray[2] > 0.0 else np.nan
        motion = image_motion(ray, ray_motion(attitude, ray, vector(velocity, i), vector(rate, i)), focal)
        projected, along = focal_plane(ray, focal), (slope[i, 0], slope[i, 1])
        by = to_lines_and_samples(motion, along)
        off = residual(by, projected, (place[i, 0], place[i, 1]), 0.0)
        step[i, 0], step[i, 1] = -off[0], -off[1]
        across[i, 0] = (projected[1] - place[i, 1]) * along[0] - (projected[0] - place[i, 0]) * along[1]
        across[i, 1] = motion[1] * along[0] - motion[0] * along[1]
        rows = by_ray(by, ray, focal)
        for k in range(2):
            set_vector(derivative[i], k, scale(-1.0, by_point(rows[k], attitude)))
