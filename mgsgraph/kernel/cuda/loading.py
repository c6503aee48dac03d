"""What a thread takes from the tables: where an observation's constants are, what the unknowns do to it, and where its
columns meet another's in the normal matrix.
"""

from mgsgraph.kernel.cuda.device import on_device
from mgsgraph.kernel.cuda.tables import (
    ACROSS,
    BASIS,
    BEFORE,
    COLUMN,
    COMPONENTS,
    COUNT,
    DATA,
    DIRECTIONS,
    ENTRY,
    INSIDE,
    KIND,
    LEFT,
    MEMBER,
    MEMBERS,
    OBSERVATION,
    PAIRS,
    PART,
    POWERS,
    SCRATCH,
    SHARED,
    TERMS,
    WIDTH,
)
from mgsgraph.kernel.rows import GROUND, IMAGE


@on_device
def constants(tables, piece, i, lane):
    """Where constants of observation i of a piece's point `lane` begin in `data`, and the step to the next one."""
    stride = tables.piece[piece, COUNT]
    return tables.piece[piece, DATA] + tables.observation[i, BEFORE] * stride + lane, stride


@on_device
def place_among(tables, piece, inside, lane):
    """Index among all observations of a point's `inside`-th one."""
    return tables.piece[piece, OBSERVATION] + inside * tables.piece[piece, COUNT] + lane


@on_device
def vector(data, at, stride, component):
    """Three constants."""
    k = at + component * stride
    return data[k], data[k + stride], data[k + 2 * stride]


@on_device
def add_single(data, k, stride, width, c, d):
    """A state (9) plus c times the direction that begins at k."""
    d0, d1, d2, d3, d4, d5, d6, d7, d8 = d
    d0 += data[k] * c
    if width > 1:
        d1 += data[k + stride] * c
        d2 += data[k + 2 * stride] * c
    if width > 3:
        d3 += data[k + 3 * stride] * c
    if width > 4:
        d4 += data[k + 4 * stride] * c
        d5 += data[k + 5 * stride] * c
    if width > 6:
        d6 += data[k + 6 * stride] * c
        d7 += data[k + 7 * stride] * c
        d8 += data[k + 8 * stride] * c
    return d0, d1, d2, d3, d4, d5, d6, d7, d8


@on_device
def along(data, k, stride, width, s):
    """Derivative by a single column: that by the state (9), taken along the direction that begins at k."""
    value = s[0] * data[k]
    if width > 1:
        value += s[1] * data[k + stride] + s[2] * data[k + 2 * stride]
    if width > 3:
        value += s[3] * data[k + 3 * stride]
    if width > 4:
        value += s[4] * data[k + 4 * stride] + s[5] * data[k + 5 * stride]
    if width > 6:
        value += s[6] * data[k + 6 * stride] + s[7] * data[k + 7 * stride] + s[8] * data[k + 8 * stride]
    return value


@on_device
def basis_value(tables, data, i, at, stride, t, rates, before):
    """Value of basis term t, and its rate per line; `before` is the value of the term before it."""
    first = at + tables.observation[i, BASIS] * stride
    if tables.observation[i, POWERS] > 0:
        if t == 0:
            return 1.0, 0.0
        return before * data[first], t * tables.optics[i, 1] * before
    value = data[first + t * stride]
    if rates:
        return value, data[first + (tables.observation[i, TERMS] + t) * stride]
    return value, 0.0


@on_device
def correction(tables, data, x, i, at, stride, rates):
    """State (9) that the unknowns x give observation i at its reference line, and (6) its rate per line."""
    d0 = d1 = d2 = d3 = d4 = d5 = 0.0
    r0 = r1 = r2 = r3 = r4 = r5 = 0.0
    entry, value = tables.observation[i, ENTRY], 1.0
    whole = tables.observation[i, COMPONENTS] == PART
    for t in range(tables.observation[i, TERMS]):
        value, rate = basis_value(tables, data, i, at, stride, t, rates, value)
        c = tables.entry[entry + t, COLUMN]
        d0 += value * x[c]
        d1 += value * x[c + 1]
        d2 += value * x[c + 2]
        r0 += rate * x[c]
        r1 += rate * x[c + 1]
        r2 += rate * x[c + 2]
        if whole:
            d3 += value * x[c + 3]
            d4 += value * x[c + 4]
            d5 += value * x[c + 5]
            r3 += rate * x[c + 3]
            r4 += rate * x[c + 4]
            r5 += rate * x[c + 5]
    state, width = (d0, d1, d2, d3, d4, d5, 0.0, 0.0, 0.0), tables.observation[i, WIDTH]
    first = at + tables.observation[i, DIRECTIONS] * stride
    for e in range(tables.observation[i, SHARED]):
        c = x[tables.entry[entry + tables.observation[i, TERMS] + e, COLUMN]]
        state = add_single(data, first + e * width * stride, stride, width, c, state)
    return state, (r0, r1, r2, r3, r4, r5)


@on_device
def row_count(kind):
    """Rows of an observation."""
    return 2 if kind == IMAGE else 3 if kind == GROUND else 1


@on_device
def columns_of(tables, i):
    """Columns of an observation as `coupling` counts them."""
    return tables.observation[i, COMPONENTS] + tables.observation[i, SHARED]


@on_device
def parts_of(tables, i):
    """Parts of an observation's columns."""
    singles = (tables.observation[i, SHARED] + PART - 1) // PART
    return singles + (1 if tables.observation[i, TERMS] > 0 else 0)


@on_device
def part(tables, i, number):
    """First column of a part, how many it has, its terms (0: the value one), and its first entry."""
    terms, entry = tables.observation[i, TERMS], tables.observation[i, ENTRY]
    single = number - (1 if terms > 0 else 0)
    if single < 0:
        return 0, tables.observation[i, COMPONENTS], terms, entry
    first = single * PART
    count = min(PART, tables.observation[i, SHARED] - first)
    return tables.observation[i, COMPONENTS] + first, count, 0, entry + terms + first


@on_device
def left_at(tables, piece, i, lane):
    """Where what `coupling` leaves of observation i of a piece's point `lane` begins: the coupling of its columns (3
    numbers each), their rows, their right sides, basis values; and the step to the next number.
    """
    stride = tables.piece[piece, COUNT]
    return tables.piece[piece, SCRATCH] + tables.observation[i, LEFT] * stride + lane, stride


@on_device
def rows_at(tables, i):
    """Numbers left of observation i before its rows by its columns, before their right sides, and before its basis."""
    columns = columns_of(tables, i)
    right = columns * (3 + row_count(tables.observation[i, KIND]))
    return 3 * columns, right, right + columns


@on_device
def block_of(tables, pattern, one, other):
    """Where two entries' variables meet: index of the first number, steps from row to row and from column to column,
    and whether it is one variable's block with itself, which holds both triangles.
    """
    first, second = tables.entry[one, MEMBER], tables.entry[other, MEMBER]
    low, high = min(first, second), max(first, second)
    start = tables.pair[tables.pattern[pattern, PAIRS] + low * tables.pattern[pattern, MEMBERS] + high]
    width = tables.entry[other if second >= first else one, ACROSS]
    down, across = (1, width) if first > second else (width, 1)
    start += tables.entry[one, INSIDE] * down + tables.entry[other, INSIDE] * across
    return start, down, across, first == second
