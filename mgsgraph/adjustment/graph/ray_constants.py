"""Constants of image rays put where the kernel reads them, and where points' nominal rays cross; compiled.

All of it goes over the rays of some neighbouring pieces, observation by observation as they lie in the data: of each
of these r rays there is its number in the network, where its constants begin, the step to the next one, and its place
among all observations.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled, make_equations_compilable
from mgsgraph.factors.algebra import add, cross, dot, product, scale, subtract, transform, transpose
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.factors.rotation import matrix_quaternion, opk_angles
from mgsgraph.geometry.compiled_pose import attitude_at, place_at, vector
from mgsgraph.kernel.rows import CAMERA, OPK_PAPER

make_equations_compilable()


@cached_kernel
def places_of_rays(point, slot, point_index, piece_of, piece, among, ray):
    """Place (k,) of each network ray among all t observations, and the way back: `ray` (t,), -1 for other ones."""
    ray[:] = -1
    for k in range(point.size):
        index = point_index[point[k]]
        p = piece_of[index]
        among[k] = piece[p, 4] + slot[k] * piece[p, 2] + index - piece[p, 1]
        ray[among[k]] = k


@cached_kernel
def rays_inside(first, last, piece, before, observation, rays, image, ray, found, at, stride, place, of_image):
    """The rays of the pieces first .. last - 1, their number returned.

    `observation` (q + 1,) is each pattern's first one, `rays` (q,) how many of them, the first ones, are image rays,
    `image` (s,) whose they are, `ray` (t,) as of `places_of_rays`. Filled are (r,) arrays: network ray, where its
    constants begin, step, place among all observations, image.
    """
    count = 0
    for p in range(first, last):
        pattern, size = piece[p, 0], piece[p, 2]
        for s in range(rays[pattern]):
            for inside in range(size):
                index = piece[p, 4] + s * size + inside
                found[count], place[count] = ray[index], index
                at[count], stride[count] = piece[p, 3] + size * before[pattern, s] + inside, size
                of_image[count] = image[observation[pattern] + s]
                count += 1
    return count


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
def put_look(attitude, data, at, stride, focal, units, c):
    """The unit direction of a ray whose detector pixel is at `at` in the data."""
    look = transform(transpose(attitude), (data[at], data[at + stride], focal))
    units[c, 0], units[c, 1], units[c, 2] = scale(1.0 / np.sqrt(dot(look, look)), look)


@cached_kernel
def put_detectors(mine, ray, at, stride, place, sigmas, first, predicted, detector, slope, data, weight):
    """Detector pixels (m, 2) of the rays `mine` (m,), component `first` of each, their slopes in the strict form, and
    the weights.
    """
    for r in range(mine.size):
        c = mine[r]
        k, index = ray[c], place[c]
        weight[0, index], weight[1, index] = 1.0 / sigmas[k, 0], 1.0 / sigmas[k, 1]
        there = at[c] + first * stride[c]
        there = put(data, there, stride[c], (detector[r, 0], detector[r, 1]))
        if predicted:
            put(data, there + 6 * stride[c], stride[c], (slope[r, 0], slope[r, 1]))


@compiled
def tables_of(tables, image):
    """Timing, table of positions and tables of attitude of one image."""
    a, b = tables.timing_first[image], tables.timing_first[image + 1]
    timing = tables.lines[a:b], tables.starts[a:b], tables.periods[a:b]
    a, b = tables.position_first[image], tables.position_first[image + 1]
    position = tables.times[a:b], tables.positions[a:b], tables.velocities[a:b]
    return timing, position, attitude_table(tables.camera, image), attitude_table(tables.body, image)


@compiled
def attitude_table(tables, image):
    """Table of attitude of one image (`geometry.compiled_pose.attitude_at`)."""
    a, b = tables.first[image], tables.first[image + 1]
    return tables.times[a:b], tables.quaternions[a:b], tables.turns[a : b - 1], tables.constants[image]


@compiled
def pose_at(line, timing, position_table, camera_table, body_table):
    """Body-fixed position and attitude of the camera at a line, and their rates per line: as `PushbroomImage.pose`."""
    lines, starts, periods = timing
    k = max(np.searchsorted(lines, line, side="right") - 1, 0)
    time, period = starts[k] + (line - lines[k]) * periods[k], periods[k]
    place, motion = place_at(time, position_table)
    to_camera, camera_turning = attitude_at(time, camera_table)
    to_body, body_turning = attitude_at(time, body_table)
    fixed = transform(to_body, place)
    attitude = product(to_camera, transpose(to_body))
    velocity = subtract(transform(to_body, motion), cross(body_turning, fixed))
    turning = subtract(camera_turning, transform(attitude, body_turning))
    return fixed, scale(period, velocity), attitude, scale(period, turning)


@cached_kernel
def put_sampled(ray, at, stride, image, tables, focal, size, polynomial, measured, lines, data, units):
    """Nominal poses of the rays whose images have `tables` (`poses.PoseTables`), about lines (k,), in the strict form,
    angles about the camera's axes.

    `size` (m,) are the images' lines, `polynomial` (m,) says of which u is stored, `measured` (k, 2) are the measured
    places. `units` (r, 3) are filled with unit directions where there is room for them.
    """
    before, own = np.int64(-1), tables_of(tables, 0)
    for c in range(ray.size):
        j, k, step = image[c], ray[c], stride[c]
        if not tables.sampled[j]:
            continue
        if j != before:
            before, own = j, tables_of(tables, j)
        line = lines[k]
        position, velocity, attitude, turning = pose_at(line, *own)
        there = put(data, at[c], step, position)
        there = put(data, there, step, matrix_quaternion(attitude))
        if units.shape[0] > 0:
            put_look(attitude, data, there, step, focal[j], units, c)
        there = put(data, there + 2 * step, step, velocity)
        there = put(data, there, step, turning) + 2 * step
        data[there] = line - measured[k, 0]
        if polynomial[j]:
            data[there + step] = 2.0 * line / size[j] - 1.0


@cached_kernel
def put_poses(mine, at, stride, angles, predicted, pose, focal, scales, slope, offset, tail, data, units):
    """Constants of one image's rays `mine` (m,) that follow from their lines, in the order in which
    `kernel.tile.load_observation` takes them.

    `pose` is (positions, matrices, velocities, angular rates or rates of the angles), `scales` (m, 4 or 0) S of the
    measured-line form where it is known already, `slope` (m, 2 or 0) that of the detector line where it isn't there
    yet, `offset` (m,) lines from the measured line, `tail` (m, c) what comes last: the line u of a polynomial, or
    values and rates of nodes, then directions. `units` (r, 3) are filled with unit directions where there is room.
    """
    position, matrix, velocity, angular_rate = pose
    for r in range(mine.size):
        c = mine[r]
        step = stride[c]
        there = put(data, at[c], step, vector(position, r))
        attitude = rows_of(matrix[r])
        if angles == CAMERA:
            there = put(data, there, step, matrix_quaternion(attitude))
        else:
            there = put(data, there, step, opk_angles(transpose(attitude) if angles == OPK_PAPER else attitude))
        if units.shape[0] > 0:
            put_look(attitude, data, there, step, focal, units, c)
        there += 2 * step
        if predicted:
            there = put(data, there, step, vector(velocity, r))
            there = put(data, there, step, vector(angular_rate, r))
            for a in range(slope.shape[1]):
                data[there + a * step] = slope[r, a]
            data[there + 2 * step] = offset[r]
            there += 3 * step
        else:
            for a in range(scales.shape[1]):
                data[there + a * step] = scales[r, a]
            there += 4 * step
        for a in range(tail.shape[1]):
            data[there] = tail[r, a]
            there += step


@cached_kernel
def put_scale(mine, at, stride, first, values, data):
    """The scale (m, 4) of the measured-line form, component `first` of each of the rays `mine` (m,)."""
    for r in range(mine.size):
        for a in range(4):
            data[at[mine[r]] + (first + a) * stride[mine[r]]] = values[r, a]


@compiled
def origin_of(data, at, stride):
    """Origin (m) of a nominal ray."""
    return data[at], data[at + stride], data[at + 2 * stride]


@cached_kernel
def crossings(first, last, piece, before, rays, point_order, data, units, wanted, positions, apart):
    """Where the nominal rays of points cross, and how far apart they point.

    Parameters
    ----------
    first, last
        Pieces first .. last - 1.
    piece, before, rays
        As of `rays_inside`.
    point_order : (n,)
        Network point at each index of the layout.
    data
        With the origins of the rays.
    units : (r, 3)
        Directions of the rays, body-fixed.
    wanted : (n,)
        Points whose position is asked for.
    positions : (n, 3)
        m: filled for these, unless the rays are closer to parallel than 2e-7 rad or meet behind a camera.
    apart : (n,)
        rad between the outermost rays, about: filled for all; zero for fewer than two.
    """
    begin = 0
    for p in range(first, last):
        pattern, size = piece[p, 0], piece[p, 2]
        count = rays[pattern]
        for inside in range(size):
            i, start, origin = point_order[piece[p, 1] + inside], piece[p, 3] + inside, (0.0, 0.0, 0.0)
            normal, right = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for s in range(count):
                centre = origin_of(data, start + size * before[pattern, s], size)
                origin = centre if s == 0 else origin
                look = vector(units, begin + s * size + inside)
                normal, right = add_ray(normal, right, subtract(centre, origin), look)
            weakest = least_eigenvalue(normal) / count if count >= 2 else 0.0
            apart[i] = 2.0 * np.arcsin(np.sqrt(min(max(weakest, 0.0), 1.0)))
            if wanted[i]:
                found = solve_symmetric(normal, right)
                usable = weakest > 1e-14
                for s in range(count if usable else 0):  # rays that part meet behind their cameras
                    ahead = subtract(add(found, origin), origin_of(data, start + size * before[pattern, s], size))
                    usable &= dot(ahead, vector(units, begin + s * size + inside)) > 0.0
                for a in range(3):
                    positions[i, a] = found[a] + origin[a] if usable else positions[i, a]
        begin += count * size
