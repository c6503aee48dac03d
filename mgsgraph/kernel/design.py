"""The rows themselves: residuals and derivatives of every sight, whitened, for whoever wants to ask more of them."""

from mgsgraph.kernel.elimination import carry_basis
from mgsgraph.kernel.lanes import BASIS, BY_POINT, BY_STATE, LANES, RESIDUAL, RESULT, ROW, TILE, WIDTH, inlined, lane
from mgsgraph.kernel.measurements import row_count
from mgsgraph.kernel.rows import PREDICTED, Rows
from mgsgraph.kernel.tile import BEGIN, END, pose_components, sight_place, sights_of

OWN_NUMBERS = 4
"""Numbers of a row before its columns: the residual, and the derivatives by the point (3)."""


@lane
def design_tile(rows, model, segments, count, w, depth, values):
    """Of each row of a tile's sights `OWN_NUMBERS`, then its derivatives: six columns per basis term, then the single
    ones.
    """
    begin, end = sights_of(rows, segments)
    for i in range(begin, end):
        if model.line == PREDICTED:
            carry_basis(rows, i, w, TILE + (i - begin) * depth)
        for k in range(count):
            first, last = segments[k, BEGIN], segments[k, END]
            at = sight_place(rows, segments, k, i - begin)
            store_design(rows, i, at, first, last, w, TILE + (i - begin) * depth, values)


@inlined
def store_design(rows, i, at, first, last, w, s, values):
    """The same of one sight, lanes first .. last."""
    terms, width = rows.sight_terms[i], rows.sight_width[i]
    for row in range(row_count(rows.sight_kind[i])):
        point, state = s + RESULT + BY_POINT + row * ROW, s + RESULT + BY_STATE + row * ROW
        for l in range(first, last):
            values[at + l, row, 0] = w[s + RESULT + RESIDUAL + row * ROW + l]
            for c in range(3):
                values[at + l, row, 1 + c] = w[point + c * LANES + l]
            for t in range(terms):
                for a in range(pose_components(width)):
                    by_state = w[state + a * LANES + l]
                    values[at + l, row, OWN_NUMBERS + 6 * t + a] = by_state * w[s + BASIS + t * LANES + l]
            for e in range(rows.sight_shared[i]):
                direction, total = s + BASIS + 2 * terms * LANES + e * WIDTH, 0.0
                for a in range(width):
                    total += w[state + a * LANES + l] * w[direction + a * LANES + l]
                values[at + l, row, OWN_NUMBERS + 6 * terms + e] = total


def most_columns(rows: Rows) -> int:
    """Room for a row of any sight."""
    return OWN_NUMBERS + int((6 * rows.sight_terms + rows.sight_shared).max(initial=0))
