"""What couples an observation's columns to its point, a thread an observation: Y = W L^-T with W = J'B, and the right
side J'r - Y L^-1 g (`kernel.elimination`), with rows by single columns taken along their directions.
"""

import math

from mgsgraph.kernel.cuda.device import cuda, kernel, on_device
from mgsgraph.kernel.cuda.loading import (
    along,
    basis_value,
    columns_of,
    constants,
    left_at,
    row_count,
    rows_at,
)
from mgsgraph.kernel.cuda.measurements import loss_of, observation_rows
from mgsgraph.kernel.cuda.solving import left_of, weights_of
from mgsgraph.kernel.cuda.tables import (
    BEGIN,
    COMPONENTS,
    COUNT,
    DIRECTIONS,
    FIRST,
    KIND,
    OBSERVATION,
    PATTERN,
    SHARED,
    TERMS,
    WIDTH,
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
    `kernel.reduction.all_residuals` has them.
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
