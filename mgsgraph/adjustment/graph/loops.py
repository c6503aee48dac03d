"""Loops over points and image rays, compiled: points sorted by what they see, constants of rays put where the kernel
reads them, and where points' nominal rays cross. No Python per point, per pattern or per image set.

Loops over rays take those of some neighbouring pieces, observation by observation as they lie in the data: of each of
these r rays there is its number in the network, where its constants begin, the step to the next one, and its place
among all observations.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled, make_equations_compilable
from mgsgraph.factors.algebra import add, dot, scale, subtract, transform, transpose
from mgsgraph.factors.intersection import add_ray, least_eigenvalue, solve_symmetric
from mgsgraph.factors.rotation import matrix_quaternion, opk_angles
from mgsgraph.geometry.compiled_pose import vector
from mgsgraph.kernel.rows import CAMERA, OPK_PAPER

make_equations_compilable()


@cached_kernel
def by_point(point, image, node, points):
    """Rows of each point, in the order of image and first node (then as given).

    Parameters
    ----------
    point, image, node : (k,)
    points : int
        Number of points n.

    Returns
    -------
    begin : (n + 1,)
        Where each point's rows begin in `order`.
    order : (k,)
        Rows, point after point.
    slot : (k,)
        Place of each row among its point's.
    """
    begin = np.zeros(points + 1, dtype=np.int64)
    for k in range(point.size):
        begin[point[k] + 1] += 1
    for i in range(points):
        begin[i + 1] += begin[i]
    order, filled = np.empty(point.size, dtype=np.int32), np.zeros(points, dtype=np.int32)
    for k in range(point.size):
        i = point[k]
        at, first = begin[i] + filled[i], begin[i]
        while at > first:
            other = order[at - 1]
            if image[other] < image[k] or (image[other] == image[k] and node[other] <= node[k]):
                break
            order[at] = other
            at -= 1
        order[at] = k
        filled[i] += 1
    slot = np.empty(point.size, dtype=np.int32)
    for i in range(points):
        for at in range(begin[i], begin[i + 1]):
            slot[order[at]] = at - begin[i]
    return begin, order, slot


@compiled
def mixed(signature, value):
    """A signature with one more number in it (splitmix64)."""
    z = (signature ^ np.uint64(value)) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@cached_kernel
def mix_rows(signature, begin, order, image, node, mark):
    """Let the signatures (n,) of points know their rows."""
    for i in range(signature.size):
        one = mixed(signature[i], np.uint64(mark))
        for at in range(begin[i], begin[i + 1]):
            k = order[at]
            one = mixed(mixed(one, np.uint64(image[k] + 1)), np.uint64(node[k] + 2))
        signature[i] = one


@cached_kernel
def mix_values(signature, values):
    """Let signatures (n,) know a number (n,) of each point, not below -1."""
    for i in range(signature.size):
        signature[i] = mixed(signature[i], np.uint64(values[i] + 2))


@cached_kernel
def distinct(signature):
    """Number each distinct signature in the order of appearance: example of each, and the number of all (n,)."""
    size = 1024
    table, number = np.full(size, -1, dtype=np.int64), np.empty(signature.size, dtype=np.int64)
    example, count = np.empty(signature.size, dtype=np.int64), 0
    for i in range(signature.size):
        if 2 * count >= size:
            size *= 4
            table = np.full(size, -1, dtype=np.int64)
            for q in range(count):
                at = np.int64(signature[example[q]] & np.uint64(size - 1))
                while table[at] >= 0:
                    at = (at + 1) & (size - 1)
                table[at] = q
        at = np.int64(signature[i] & np.uint64(size - 1))
        while table[at] >= 0 and signature[example[table[at]]] != signature[i]:
            at = (at + 1) & (size - 1)
        if table[at] < 0:
            table[at], example[count] = count, i
            count += 1
        number[i] = table[at]
    return example[:count].copy(), number


@cached_kernel
def counted(number, count):
    """Points in the order of their numbers (n,), each below `count`: that order, the way back, and how many of each."""
    sizes = np.zeros(count, dtype=np.int64)
    for i in range(number.size):
        sizes[number[i]] += 1
    at = np.cumsum(sizes) - sizes
    order, index = np.empty(number.size, dtype=np.int64), np.empty(number.size, dtype=np.int64)
    for i in range(number.size):
        k = at[number[i]]
        order[k], index[i] = i, k
        at[number[i]] = k + 1
    return order, index, sizes


@cached_kernel
def followed(lines, measured, residuals, among, kind, point, point_index, image, size, beyond, out, found):
    """Predicted lines (k,) of rays, as residuals (t, 2) about `lines` (k,) have them, but for points that are `out` and
    those that lie nowhere; at most a share `beyond` of an image's lines (`size` (m,)) before it or after it. How far
    the farthest moves.
    """
    farthest = 0.0
    for k in range(lines.size):
        line = measured[k, 0] - residuals[among[k], 0]
        if kind[point_index[point[k]]] == out or not np.isfinite(line):
            line = lines[k]
        most = size[image[k]]
        found[k] = min(max(line, -beyond * most), (1.0 + beyond) * most)
        farthest = max(farthest, abs(found[k] - lines[k]))
    return farthest


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
