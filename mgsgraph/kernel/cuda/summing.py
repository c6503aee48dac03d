"""Sums over points: gradient and normal matrix of the shared unknowns, a block of threads a pair of parts of a piece.

Of each pair of columns a point leaves one number; what reaches the size of the unknowns is its sum over points, times
products of basis values. Points go through shared memory, as many as there are threads at a time; then each thread sums
FOUR numbers with NINE products over its share of the points, in registers, so that of seventeen numbers it loads it
makes 36 multiplications.
"""

import numpy as np

from mgsgraph.kernel.cuda.device import THREADS, cuda, kernel, on_device
from mgsgraph.kernel.cuda.loading import block_of, left_at, part, row_count, rows_at
from mgsgraph.kernel.cuda.tables import (
    COUNT,
    KIND,
    NONE,
    ONE,
    ONE_PART,
    OTHER,
    OTHER_PART,
    PART,
    PATTERN,
    PIECE_OF,
    RIGHT,
)

FOUR, NINE = 4, 9
SUMS = FOUR * NINE
"""A thread's."""
PADDED = THREADS + 1
"""Room per number: threads that take different numbers of one point take them from different banks."""
_ROOM, _PRODUCTS = PART * PART * PADDED, NINE * PADDED
"""Shared memory: the numbers of a pair of parts, or all threads' sums; products. The compiler wants names for both."""


@on_device
def put_pair(numbers, t, result, stride, one, other, columns, others, rows, one_rows, other_rows):
    """Numbers of a point's pair of parts: -Y Y', and J J' of an observation with itself; its columns begin at `one` and
    `other`, their rows at `one_rows` and `other_rows` (none where `rows` is 0).
    """
    y = cuda.local.array(18, np.float64)
    for b in range(18):
        y[b] = result[other + b * stride] if b < 3 * others else 0.0
    for a in range(6):
        if a < columns:
            k = one + 3 * a * stride
            y0, y1, y2 = result[k], result[k + stride], result[k + 2 * stride]
            for b in range(6):
                if b < others:
                    value = -(y0 * y[3 * b] + y1 * y[3 * b + 1] + y2 * y[3 * b + 2])
                    for row in range(rows):
                        left = result[one_rows + (a * rows + row) * stride]
                        value += left * result[other_rows + (b * rows + row) * stride]
                    numbers[(a * others + b) * PADDED + t] = value


@on_device
def basis_of(result, at, stride, basis, terms, p):
    """Value of a part's p-th term; one of single columns."""
    return result[at + (basis + p) * stride] if terms > 0 else 1.0


@on_device
def accumulate(numbers, products, slice_of, slices, quad, total):
    """Sums over a share of the points of four numbers times nine products."""
    for l in range(slice_of, THREADS, slices):
        k = FOUR * quad * PADDED + l
        n0, n1, n2, n3 = numbers[k], numbers[k + PADDED], numbers[k + 2 * PADDED], numbers[k + 3 * PADDED]
        for v in range(NINE):
            weight = products[v * PADDED + l]
            total[v] += n0 * weight
            total[NINE + v] += n1 * weight
            total[2 * NINE + v] += n2 * weight
            total[3 * NINE + v] += n3 * weight


@on_device
def add_number(tables, pattern, same, one, a, other, b, value, mirrored, blocks):
    """Add a sum to the block of two columns (entries and columns within them); if `mirrored`, its mirror image alone,
    where one variable's block holds both triangles. Of a part with itself either is among the sums.
    """
    start, down, across, own = block_of(tables, pattern, one, other)
    if mirrored:
        if own and not same:
            start, down, across, _ = block_of(tables, pattern, other, one)
            cuda.atomic.add(blocks, start + b * down + a * across, value)
    elif own or (not same) or one < other:
        cuda.atomic.add(blocks, start + a * down + b * across, value)


@kernel
def clear(values):
    """Zeros."""
    k = cuda.grid(1)
    if k < values.size:
        values[k] = 0.0


@kernel
def add_up(tables, table, edges, result, gradient, blocks):
    """Add the sums of a partition's jobs to the gradient and to the blocks of pairs of variables."""
    numbers = cuda.shared.array(_ROOM, np.float64)
    products = cuda.shared.array(_PRODUCTS, np.float64)
    t = cuda.threadIdx.x
    total = cuda.local.array(SUMS, np.float64)
    for job in range(edges[cuda.blockIdx.x], edges[cuda.blockIdx.x + 1]):
        piece, i, j = table[job, PIECE_OF], table[job, ONE], table[job, OTHER]
        pattern, points = tables.piece[piece, PATTERN], tables.piece[piece, COUNT]
        first, columns, terms, entry = part(tables, i, table[job, ONE_PART])
        rows_i, right_i, basis_i = rows_at(tables, i)
        alone = j == NONE
        other, others, terms_j, entry_j, basis_j, rows_j = 0, 1, 0, 0, 0, 0
        if not alone:
            other, others, terms_j, entry_j = part(tables, j, table[job, OTHER_PART])
            rows_j, _, basis_j = rows_at(tables, j)
        rows = row_count(tables.observation[i, KIND])
        same = i == j and table[job, ONE_PART] == table[job, OTHER_PART]
        count, width = columns * others, max(terms_j, 1)
        quads = (count + FOUR - 1) // FOUR
        slices = THREADS // quads
        for begin in range(0, max(terms, 1) * width, NINE):
            pairs = min(NINE, max(terms, 1) * width - begin)
            for e in range(SUMS):
                total[e] = 0.0
            for chunk in range(0, points, THREADS):
                cuda.syncthreads()
                if chunk + t < points:
                    at, stride = left_at(tables, piece, i, chunk + t)
                    there = at
                    if alone:
                        for a in range(columns):
                            numbers[a * PADDED + t] = result[at + (right_i + first + a) * stride]
                    else:
                        there, _ = left_at(tables, piece, j, chunk + t)
                        put_pair(
                            numbers, t, result, stride, at + 3 * first * stride, there + 3 * other * stride, columns,
                            others, rows if i == j else 0, at + (rows_i + first * rows) * stride,
                            there + (rows_j + other * rows) * stride,
                        )  # fmt: skip
                    for v in range(NINE):
                        value = 0.0
                        if v < pairs:
                            value = basis_of(result, at, stride, basis_i, terms, (begin + v) // width)
                            value *= basis_of(result, there, stride, basis_j, terms_j, (begin + v) % width)
                        products[v * PADDED + t] = value
                else:
                    for a in range(count):
                        numbers[a * PADDED + t] = 0.0
                    for v in range(NINE):
                        products[v * PADDED + t] = 0.0
                for a in range(count, FOUR * quads):
                    numbers[a * PADDED + t] = 0.0
                cuda.syncthreads()
                if t < quads * slices:
                    accumulate(numbers, products, t // quads, slices, t % quads, total)
            cuda.syncthreads()
            if t < quads * slices:
                for e in range(SUMS):
                    numbers[t * SUMS + e] = total[e]
            cuda.syncthreads()
            for mirrored in range(1 if alone else 2):
                for o in range(t, count * pairs, THREADS):
                    c, v = o // pairs, o % pairs
                    value, k = 0.0, c // FOUR * SUMS + c % FOUR * NINE + v
                    for s in range(slices):
                        value += numbers[k + s * quads * SUMS]
                    a, b, p, q = c // others, c % others, (begin + v) // width, (begin + v) % width
                    one = entry + (p if terms > 0 else a)
                    a = a if terms > 0 else 0
                    if alone:
                        cuda.atomic.add(gradient, tables.entry[one, RIGHT] + a, value)
                    else:
                        two = entry_j + (q if terms_j > 0 else b)
                        add_number(
                            tables, pattern, same, one, a, two, b if terms_j > 0 else 0, value, mirrored > 0, blocks
                        )
                cuda.syncthreads()
