"""Points sorted by what they see, by compiled code: no Python per point, per pattern or per image set."""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled


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
