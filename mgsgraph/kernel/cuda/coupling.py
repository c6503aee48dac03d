"""What couples an observation's columns to its point, a thread an observation: Y = W L^-T with W = J'B, and the right
side J'r - Y L^-1 g (`kernel.elimination`), with rows by single columns taken along their directions.

And the sums over points: gradient and normal matrix of the shared unknowns, a block of threads a pair of parts of a
piece. Of each pair of columns a point leaves one number; what reaches the size of the unknowns is its sum over points,
times products of basis values. Points go through shared memory, as many as there are threads at a time; then each
thread sums FOUR numbers with NINE products over its share of the points, in registers, so that of seventeen numbers it
loads it makes 36 multiplications.
"""

import math

import numpy as np

from mgsgraph.kernel.cuda.device import THREADS, cuda, kernel, on_device
from mgsgraph.kernel.cuda.solving import left_of, loss_of, observation_rows, weights_of
from mgsgraph.kernel.cuda.tables import (
    BEGIN,
    COMPONENTS,
    COUNT,
    DIRECTIONS,
    FIRST,
    KIND,
    NONE,
    OBSERVATION,
    ONE,
    ONE_PART,
    OTHER,
    OTHER_PART,
    PART,
    PATTERN,
    PIECE_OF,
    RIGHT,
    SHARED,
    TERMS,
    WIDTH,
    along,
    basis_value,
    block_of,
    columns_of,
    constants,
    left_at,
    part,
    row_count,
    rows_at,
)
from mgsgraph.kernel.rows import GOOD, GROUND, IMAGE, NO_LOSS, OUT, PREDICTED


@on_device
def whose(tables, k):
    """Piece of the k-th of all observations, its index among the tables, and the point counted in the piece."""
    piece = tables.piece_of_observation[k]
    inside, count = k - tables.piece[piece, OBSERVATION], tables.piece[piece, COUNT]
    return piece, tables.pattern[tables.piece[piece, PATTERN], BEGIN] + inside // count, inside % count


@on_device
def scaled_rows(tables, model, data, weight, kind, x, k, point):
    """Rows of the k-th observation with its point there, scaled by the root of a robust loss's weight."""
    piece, i, lane = whose(tables, k)
    active = kind[tables.piece[piece, FIRST] + lane] != OUT
    weights = weights_of(weight, k, active)
    r, b, s, _, offset = observation_rows(tables, model, data, x, piece, i, lane, point, active, weights)
    if model.loss == NO_LOSS:
        return r, b, s, offset, 1.0
    return r, b, s, offset, math.sqrt(loss_of(model, True, tables.observation[i, KIND], r)[1])


@on_device
def put_column(result, at, stride, tables, i, column, by_column, r, b, factor, forward):
    """Leave a column's coupling, its rows and its right side."""
    first, right, _ = rows_at(tables, i)
    j0, j1, j2 = by_column
    w0 = j0 * b[0][0] + j1 * b[1][0] + j2 * b[2][0]
    w1 = j0 * b[0][1] + j1 * b[1][1] + j2 * b[2][1]
    w2 = j0 * b[0][2] + j1 * b[1][2] + j2 * b[2][2]
    y0 = w0 * factor[0]
    y1 = (w1 - factor[1] * y0) * factor[2]
    y2 = (w2 - factor[3] * y0 - factor[4] * y1) * factor[5]
    k = at + 3 * column * stride
    result[k], result[k + stride], result[k + 2 * stride] = y0, y1, y2
    rows = row_count(tables.observation[i, KIND])
    k = at + (first + column * rows) * stride
    result[k] = j0
    if rows > 1:
        result[k + stride] = j1
    if rows > 2:
        result[k + 2 * stride] = j2
    rest = j0 * r[0] + j1 * r[1] + j2 * r[2]
    result[at + (right + column) * stride] = rest - (y0 * forward[0] + y1 * forward[1] + y2 * forward[2])


@kernel
def couple(tables, model, data, weight, kind, x, states, left, result):
    """Leave in `result` what couples all observations of a partition that depend on an unknown: a thread each."""
    k = cuda.grid(1)
    if k >= weight.shape[1]:
        return
    piece, i, lane = whose(tables, k)
    if columns_of(tables, i) == 0:
        return
    p = tables.piece[piece, FIRST] + lane
    point, factor, forward = left_of(left, p)
    r, b, s, offset, root = scaled_rows(tables, model, data, weight, kind, x, k, point)
    solved = root if states[p] == GOOD else 0.0
    at, stride = left_at(tables, piece, i, lane)
    r, (first, second, third) = (root * r[0], root * r[1], root * r[2]), b
    b = (
        (root * first[0], root * first[1], root * first[2]),
        (root * second[0], root * second[1], root * second[2]),
        (root * third[0], root * third[1], root * third[2]),
    )
    components = tables.observation[i, COMPONENTS]
    for a in range(6):
        if a < components:
            column = solved * s[0][a], solved * s[1][a], solved * s[2][a]
            put_column(result, at, stride, tables, i, a, column, r, b, factor, forward)
    origin, step = constants(tables, piece, i, lane)
    width = tables.observation[i, WIDTH]
    for e in range(tables.observation[i, SHARED]):
        d = origin + (tables.observation[i, DIRECTIONS] + e * width) * step
        column = (
            solved * along(data, d, step, width, s[0]),
            solved * along(data, d, step, width, s[1]),
            solved * along(data, d, step, width, s[2]),
        )
        put_column(result, at, stride, tables, i, components + e, column, r, b, factor, forward)
    rates, value = (tables.observation[i, KIND] == IMAGE) & (model.line == PREDICTED), 1.0
    _, _, basis = rows_at(tables, i)
    for t in range(tables.observation[i, TERMS]):
        value, rate = basis_value(tables, data, i, origin, step, t, rates, value)
        result[at + (basis + t) * stride] = value + offset * rate


@kernel
def residuals(tables, model, data, weight, kind, x, points, values):
    """Residuals (t, 2) of all observations with points at (n, 3), whether they take part or not, a thread each: as
    `kernel.sweep.all_residuals` has them.
    """
    k = cuda.grid(1)
    if k >= weight.shape[1]:
        return
    piece, i, lane = whose(tables, k)
    p = tables.piece[piece, FIRST] + lane
    point, weights = (points[p, 0], points[p, 1], points[p, 2]), (weight[0, k], weight[1, k])
    r, _, _, front, _ = observation_rows(tables, model, data, x, piece, i, lane, point, True, weights)
    what = tables.observation[i, KIND]
    for row in range(2):
        value = 0.0
        if (what == IMAGE) or (row == 0 and what != GROUND):
            value = r[row] / weights[row] if weights[row] > 0.0 else math.nan
        if what == IMAGE and not front:
            value = math.nan
        values[k, row] = value



FOUR, NINE = 4, 9
SUMS = FOUR * NINE
"""A thread's."""
PADDED = THREADS + 1
"""Room per number: threads that take different numbers of one point take them from different banks."""
_ROOM, _PRODUCTS = PART * PART * PADDED, NINE * PADDED
"""Shared memory: the numbers of a pair of parts, or all threads' sums; products. The compiler wants names for both."""


@on_device
def put_pair(numbers, t, result, stride, begin_i, begin_j, columns, columns_j, rows, one_rows, other_rows):
    """Numbers of a point's pair of parts: -Y Y', and J J' of an observation with itself; its columns begin at `begin_i`
    and `begin_j`, their rows at `one_rows` and `other_rows` (none where `rows` is 0).
    """
    y = cuda.local.array(18, np.float64)
    for b in range(18):
        y[b] = result[begin_j + b * stride] if b < 3 * columns_j else 0.0
    for a in range(6):
        if a < columns:
            k = begin_i + 3 * a * stride
            y0, y1, y2 = result[k], result[k + stride], result[k + 2 * stride]
            for b in range(6):
                if b < columns_j:
                    value = -(y0 * y[3 * b] + y1 * y[3 * b + 1] + y2 * y[3 * b + 2])
                    for row in range(rows):
                        left = result[one_rows + (a * rows + row) * stride]
                        value += left * result[other_rows + (b * rows + row) * stride]
                    numbers[(a * columns_j + b) * PADDED + t] = value


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
def add_number(tables, pattern, same, entry_i, a, entry_j, b, value, mirrored, blocks):
    """Add a sum to the block of two columns (entries and columns within them); if `mirrored`, its mirror image alone,
    where one variable's block holds both triangles. Of a part with itself either is among the sums.
    """
    start, down, across, one_variable = block_of(tables, pattern, entry_i, entry_j)
    if mirrored:
        if one_variable and not same:
            start, down, across, _ = block_of(tables, pattern, entry_j, entry_i)
            cuda.atomic.add(blocks, start + b * down + a * across, value)
    elif one_variable or (not same) or entry_i < entry_j:
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
        first_j, columns_j, terms_j, entry_j, basis_j, rows_j = 0, 1, 0, 0, 0, 0
        if not alone:
            first_j, columns_j, terms_j, entry_j = part(tables, j, table[job, OTHER_PART])
            rows_j, _, basis_j = rows_at(tables, j)
        rows = row_count(tables.observation[i, KIND])
        same = i == j and table[job, ONE_PART] == table[job, OTHER_PART]
        count, width = columns * columns_j, max(terms_j, 1)
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
                    at_j = at
                    if alone:
                        for a in range(columns):
                            numbers[a * PADDED + t] = result[at + (right_i + first + a) * stride]
                    else:
                        at_j, _ = left_at(tables, piece, j, chunk + t)
                        put_pair(
                            numbers, t, result, stride, at + 3 * first * stride, at_j + 3 * first_j * stride, columns,
                            columns_j, rows if i == j else 0, at + (rows_i + first * rows) * stride,
                            at_j + (rows_j + first_j * rows) * stride,
                        )  # fmt: skip
                    for v in range(NINE):
                        value = 0.0
                        if v < pairs:
                            value = basis_of(result, at, stride, basis_i, terms, (begin + v) // width)
                            value *= basis_of(result, at_j, stride, basis_j, terms_j, (begin + v) % width)
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
                    a, b, p, q = c // columns_j, c % columns_j, (begin + v) // width, (begin + v) % width
                    row = entry + (p if terms > 0 else a)
                    a = a if terms > 0 else 0
                    if alone:
                        cuda.atomic.add(gradient, tables.entry[row, RIGHT] + a, value)
                    else:
                        column = entry_j + (q if terms_j > 0 else b)
                        add_number(
                            tables, pattern, same, row, a, column, b if terms_j > 0 else 0, value, mirrored > 0, blocks
                        )
                cuda.syncthreads()
