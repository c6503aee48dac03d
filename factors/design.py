"""The rows themselves: residuals and derivatives of every sight, whitened, for whoever wants to ask more of them."""

from mgsgraph.factors.elimination import ROW, carry_basis
from mgsgraph.factors.lanes import BASIS, BY_POINT, BY_STATE, LANES, RESIDUAL, lane
from mgsgraph.factors.pose import pose_components
from mgsgraph.factors.rows import Rows
from mgsgraph.factors.tile import row_count, sights_of

OWN = 4
"""Numbers of a row before its columns: the residual, and the derivatives by the point (3)."""


@lane
def design_tile(rows, piece, first, n, w, base, depth, values):
    """Of each row of a tile's sights `OWN`, then its derivatives: six columns per basis term, then the single ones."""
    begin, end = sights_of(rows, rows.piece[piece, 0])
    count = rows.piece[piece, 2]
    for i in range(begin, end):
        s, at = base + (i - begin) * depth, rows.piece[piece, 4] + (i - begin) * count + first
        terms, shared, width = rows.sight_terms[i], rows.sight_shared[i], rows.sight_width[i]
        carry_basis(rows, i, n, w, s)
        for row in range(row_count(rows.sight_kind[i])):
            point, state = s + BY_POINT + 3 * row * LANES, s + BY_STATE + row * ROW
            for l in range(n):
                values[at + l, row, 0] = w[s + RESIDUAL + row * LANES + l]
                for c in range(3):
                    values[at + l, row, 1 + c] = w[point + c * LANES + l]
                for t in range(terms):
                    for a in range(pose_components(width)):
                        by_state = w[state + a * LANES + l]
                        values[at + l, row, OWN + 6 * t + a] = by_state * w[s + BASIS + t * LANES + l]
                for e in range(shared):
                    direction, total = s + BASIS + 2 * terms * LANES + e * ROW, 0.0
                    for a in range(width):
                        total += w[state + a * LANES + l] * w[direction + a * LANES + l]
                    values[at + l, row, OWN + 6 * terms + e] = total


def most_columns(rows: Rows) -> int:
    """Room for a row of any sight."""
    return OWN + int((6 * rows.sight_terms + rows.sight_shared).max(initial=0))
