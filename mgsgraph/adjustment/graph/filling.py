"""Constants of image rays put where the kernel reads them, and where points' nominal rays cross; compiled."""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled, make_equations_compilable
from mgsgraph.factors.algebra import add, dot, scale, subtract, transform, transpose
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.factors.rotation import matrix_quaternion, opk_angles
from mgsgraph.geometry.compiled_pose import vector
from mgsgraph.kernel.rows import CAMERA, OPK_PAPER

make_equations_compilable()


@compiled
def destination(point, slot, point_index, piece_of, piece, before):
    """Where an observation's constants begin in the data, the step to the next one, and its index among all
    observations.
    """
    index = point_index[point]
    p = piece_of[index]
    inside, stride = index - piece[p, 1], piece[p, 2]
    return piece[p, 3] + stride * before[piece[p, 0], slot] + inside, stride, piece[p, 4] + slot * stride + inside


@compiled
def put(data, at, stride, values):
    """Store the components of a tuple; where the next one goes."""
    for value in values:
        data[at] = value
        at += stride
    return at


@compiled
def rows_of(matrix):
    """A matrix (3, 3) as rows."""
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


@compiled
def origin_of(point, slot, store):
    """Origin (m) of a nominal ray that `put_rays` has put there."""
    point_index, piece_of, piece, before, data = store
    at, s, _ = destination(point, slot, point_index, piece_of, piece, before)
    return data[at], data[at + s], data[at + 2 * s]


@cached_kernel
def put_rays(
    mine,
    point,
    slot,
    sigmas,
    store,
    angles,
    predicted,
    pose,
    detector,
    focal,
    slope,
    scales,
    offset,
    u,
    basis,
    effects,
    among,
    weight,
    units,
):
    """Constants of one image's rays `mine` (m,), in the order in which `kernel.tile.load_observation` takes them.

    `store` is (point_index, piece_of, piece, before, data), `pose` (positions, matrices, velocities, angular rates or
    rates of the angles), `scales` (m, 4 or 0) where S of the measured-line form is known already, `offset` (m,)
    lines from the measured line, `u` (m, 1 or 0) the line of a polynomial, `basis` (m, b) values and rates of
    nodes. What is filled beside the constants: the ray's index among all observations, weights, and unit
    directions.
    """
    point_index, piece_of, piece, before, data = store
    position, matrix, velocity, angular_rate = pose
    for r in range(mine.size):
        k = mine[r]
        at, stride, index = destination(point[k], slot[k], point_index, piece_of, piece, before)
        among[k] = index
        weight[0, index], weight[1, index] = 1.0 / sigmas[k, 0], 1.0 / sigmas[k, 1]
        at = put(data, at, stride, vector(position, r))
        attitude = rows_of(matrix[r])
        if angles == CAMERA:
            at = put(data, at, stride, matrix_quaternion(attitude))
        else:
            at = put(data, at, stride, opk_angles(transpose(attitude) if angles == OPK_PAPER else attitude))
        at = put(data, at, stride, (detector[r, 0], detector[r, 1]))
        look = transform(transpose(attitude), (detector[r, 0], detector[r, 1], focal))
        units[k, 0], units[k, 1], units[k, 2] = scale(1.0 / np.sqrt(dot(look, look)), look)
        if predicted:
            at = put(data, at, stride, vector(velocity, r))
            at = put(data, at, stride, vector(angular_rate, r))
            at = put(data, at, stride, (slope[r, 0], slope[r, 1], offset[r]))
        else:
            for c in range(scales.shape[1]):
                data[at + c * stride] = scales[r, c]
            at += 4 * stride
        for values in (u, basis, effects):
            for c in range(values.shape[1]):
                data[at] = values[r, c]
                at += stride


@cached_kernel
def put_scale(mine, point, slot, store, first, values):
    """The scale (m, 4) of the measured-line form, component `first` of each ray."""
    point_index, piece_of, piece, before, data = store
    for r in range(mine.size):
        at, stride, _ = destination(point[mine[r]], slot[mine[r]], point_index, piece_of, piece, before)
        for c in range(4):
            data[at + (first + c) * stride] = values[r, c]


@cached_kernel
def crossings(point_order, begin, order, slot, store, units, wanted, positions, apart):
    """Where the nominal rays of points cross, and how far apart they point.

    Parameters
    ----------
    point_order : (n,)
        Network point at each index of the layout.
    begin, order : (n + 1,), (k,)
        Rays of each point (`sorting.by_point`).
    slot : (k,)
    store
        As of `put_rays`.
    units : (k, 3)
        Directions of the rays, body-fixed.
    wanted : (n,)
        Points whose position is asked for.
    places : (n, 3)
        m: filled for these, unless the rays are closer to parallel than 2e-7 rad or meet behind a camera.
    apart : (n,)
        rad between the outermost rays, about: filled for all; zero for fewer than two.
    """
    for i in point_order:  # as the constants lie
        count, origin = begin[i + 1] - begin[i], (0.0, 0.0, 0.0)
        normal, right = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for r in range(begin[i], begin[i + 1]):
            centre = origin_of(i, slot[order[r]], store)
            origin = centre if r == begin[i] else origin
            normal, right = add_ray(normal, right, subtract(centre, origin), vector(units, order[r]))
        weakest = least_eigenvalue(normal) / count if count >= 2 else 0.0
        apart[i] = 2.0 * np.arcsin(np.sqrt(min(max(weakest, 0.0), 1.0)))
        if wanted[i]:
            found = solve_symmetric(normal, right)
            usable = weakest > 1e-14
            for r in range(begin[i], begin[i + 1] if usable else 0):  # rays that part meet behind their cameras
                ahead = subtract(add(found, origin), origin_of(i, slot[order[r]], store))
                usable &= dot(ahead, vector(units, order[r])) > 0.0
            for j in range(3):
                positions[i, j] = found[j] + origin[j] if usable else positions[i, j]
