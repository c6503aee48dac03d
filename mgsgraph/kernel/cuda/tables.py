"""A partition's rows as a device takes them: small tables of whole numbers, who sums what, and what a thread takes from
the tables.

An observation's columns are counted in *parts* of up to six: the components of a pose (or of a position), which every
basis term takes with its value; then its single columns, six at a time, with the value one. Rows by single columns are
taken together with their directions (`coupling`), so that all parts are summed in the same way.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.kernel.cuda.device import on_device
from mgsgraph.kernel.rows import GROUND, IMAGE, PREDICTED, SURFACE, Groups, Model, NormalBlocks, Rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Short = NDArray[np.int32]

PATTERN, FIRST, COUNT, DATA, OBSERVATION, SCRATCH = 0, 1, 2, 3, 4, 5
"""Columns of the table of pieces: pattern; first point, number of points; where constants, observations and what
`coupling` leaves begin."""

BEGIN, END, KNOWN, MEMBERS, PAIRS, HEIGHTS = 0, 1, 2, 3, 4, 5
"""Columns of the table of patterns: first observation, and the one after the last; 1 where points are known; number of
the group's variables, and where its table of pairs begins; 1 where the terrain model has a say."""

KIND, WIDTH, TERMS, SHARED, ENTRY, BEFORE, BASIS, DIRECTIONS, COMPONENTS, LEFT, POWERS = range(11)
"""Columns of the table of observations: as in `Rows`; numbers per point that lie in `data` before its first one, before
its basis values and before its directions; components that a term moves (0 without terms); numbers per point that lie
in what `coupling` leaves before its first one; 1 where basis values are powers of the line."""

COLUMN, MEMBER, INSIDE, RIGHT, ACROSS = range(5)
"""Columns of the table of entries: as in `Rows`; where its gradient is; columns of its variable."""

PIECE_OF, ONE, ONE_PART, OTHER, OTHER_PART = range(5)
"""Columns of the table of jobs: piece; observation and part whose columns are summed against those of another; NONE
for the gradient."""
NONE = -1

PART = 6
"""Most columns of a part."""


class Tables(NamedTuple):
    """What every kernel is given of a partition of n points and t observations."""

    piece: Index
    """(m, 6)"""
    pattern: Index
    """(q, 6)"""
    observation: Short
    """(s, 11)"""
    optics: Array
    """(s, 4) focal length (m), du/dline, and the slope of the detector line (m per sample) as in `Rows`."""
    entry: Short
    """(e, 5)"""
    pair: Index
    """As in `NormalBlocks`."""
    piece_of_point: Short
    """(n,)"""
    piece_of_observation: Short
    """(t,)"""
    terrain: Array
    """As in `Rows`."""
    terrain_frame: Array
    """As in `Rows`."""


class Jobs(NamedTuple):
    """Who sums what: `table` (j, 5); a block of threads does the jobs edges[b] .. edges[b + 1] - 1 one by one."""

    table: Short
    edges: Index


def rows_of_kind(kind: Index) -> Index:
    """Rows of observations of some kinds."""
    return np.where(kind == IMAGE, 2, np.where(kind == GROUND, 3, 1))


def columns_left(rows: Rows) -> tuple[Index, Index]:
    """(s,) components that a term of each observation moves, and all its columns as `coupling` counts them."""
    components = np.where(rows.observation_terms > 0, np.where(rows.observation_width >= PART, PART, 3), 0)
    return components, components + rows.observation_shared


def numbers_left(rows: Rows) -> Index:
    """(s,) numbers per point that `coupling` leaves of observations: per column its coupling (3), its rows, its right
    side; then basis values.
    """
    _, columns = columns_left(rows)
    return columns * (4 + rows_of_kind(rows.observation_kind)) + rows.observation_terms


def make_tables(rows: Rows, groups: Groups, target: NormalBlocks, model: Model) -> tuple[Tables, int]:
    """Tables of a partition, and the length of what `coupling` leaves of it."""
    count, left = np.diff(rows.pattern_observation), numbers_left(rows)
    pattern_of, sizes = rows.piece[:, 0], rows.piece[:, 2]
    owner = np.repeat(np.arange(count.size), count)
    scratch = np.bincount(owner, left, count.size).astype(np.int64)[pattern_of] * sizes
    numbers = np.arange(sizes.size, dtype=np.int32)
    tables = Tables(
        piece=np.column_stack([rows.piece, np.cumsum(scratch) - scratch]),
        pattern=_patterns(rows, groups, owner),
        observation=_observations(rows, model, left),
        optics=np.column_stack([rows.observation_focal, rows.observation_rate, rows.observation_slope]),
        entry=_entries(rows, groups, target, owner),
        pair=target.pair,
        piece_of_point=np.repeat(numbers, sizes),
        piece_of_observation=np.repeat(numbers, sizes * count[pattern_of]),
        terrain=rows.terrain,
        terrain_frame=rows.terrain_frame,
    )
    return tables, int(scratch.sum())


def _patterns(rows: Rows, groups: Groups, owner: Index) -> Index:
    first, group = rows.pattern_observation, rows.pattern_group
    on_terrain = np.bincount(owner, rows.observation_kind == SURFACE, first.size - 1) > 0
    members = np.diff(groups.member_first)[group]
    columns = [first[:-1], first[1:], rows.pattern_fixed, members, groups.pair_first[group], on_terrain]
    return np.stack(columns, axis=1).astype(np.int64)


def _observations(rows: Rows, model: Model, left: Index) -> Short:
    kind, terms, shared = rows.observation_kind, rows.observation_terms, rows.observation_shared
    powers = (rows.observation_rate != 0.0) & (terms > 0)
    directions = rows.observation_numbers - rows.observation_width * shared
    with_rates = (kind == IMAGE) & (model.line == PREDICTED)
    basis = directions - np.where(powers, 1, np.where(with_rates, 2 * terms, terms))
    first = rows.pattern_observation
    columns = [
        kind, rows.observation_width, terms, shared, rows.observation_entry, _before(rows.observation_numbers, first),
        basis, directions, columns_left(rows)[0], _before(left, first), powers,
    ]  # fmt: skip
    return np.stack(columns, axis=1).astype(np.int32)


def _before(numbers: Index, first: Index) -> Index:
    """(s,) sum of the numbers of a pattern's observations before each."""
    ends = np.cumsum(numbers)
    starts = np.concatenate([[0], ends])[first[:-1]]
    return np.asarray(ends - numbers - np.repeat(starts, np.diff(first)))


def _entries(rows: Rows, groups: Groups, target: NormalBlocks, owner: Index) -> Short:
    entries = rows.observation_terms + rows.observation_shared
    place = np.repeat(rows.observation_entry - np.cumsum(entries) + entries, entries) + np.arange(entries.sum())
    member = groups.member_first[rows.pattern_group[np.repeat(owner, entries)]] + rows.entry_member[place]
    table = np.zeros((rows.entry_column.size, 5), dtype=np.int32)
    table[:, COLUMN], table[:, MEMBER], table[:, INSIDE] = rows.entry_column, rows.entry_member, rows.entry_inside
    table[place, RIGHT] = target.right[member] + rows.entry_inside[place]
    table[place, ACROSS] = groups.member_width[member]
    return table


def parts(rows: Rows) -> Index:
    """(s,) parts of each observation's columns."""
    return (rows.observation_terms > 0) + -(-rows.observation_shared // PART)


def make_jobs(rows: Rows, groups: Groups, target: NormalBlocks, with_matrix: bool, deterministic: bool) -> Jobs:
    """Who sums a partition's gradient and, if `with_matrix`, its normal matrix.

    If `deterministic`, whatever is added to the same numbers is one block's task, and so has an order.
    """
    of_pattern = _pattern_jobs(rows, with_matrix)
    pattern_of = rows.piece[:, 0]
    first = np.searchsorted(of_pattern[:, 0], np.arange(rows.pattern_group.size + 1))
    count = np.diff(first)[pattern_of]
    piece = np.repeat(np.arange(pattern_of.size), count)
    inside = np.arange(piece.size) - np.repeat(np.cumsum(count) - count, count)
    table = of_pattern[first[pattern_of[piece]] + inside]
    table[:, PIECE_OF] = piece
    edges = np.arange(table.shape[0] + 1)
    if deterministic and table.size:
        owner = _job_sets(rows, groups, target, table)
        order = np.argsort(owner, kind="stable")
        table, owner = table[order], owner[order]
        edges = np.append(np.flatnonzero(np.append(True, owner[1:] != owner[:-1])), owner.size)
    return Jobs(np.ascontiguousarray(table, dtype=np.int32), edges.astype(np.int64))


def _pattern_jobs(rows: Rows, with_matrix: bool) -> Index:
    """Jobs of each pattern, which stands in place of the piece, in the order of patterns."""
    count, each = np.diff(rows.pattern_observation), parts(rows)
    observation = np.repeat(np.arange(each.size), each)
    part = np.arange(observation.size) - np.repeat(np.cumsum(each) - each, each)
    owner = np.repeat(np.arange(count.size), count)[observation]
    none = np.full(observation.size, NONE)
    jobs = [np.stack([owner, observation, part, none, none], axis=1)]
    if with_matrix and observation.size:
        ends = np.searchsorted(owner, np.arange(count.size), side="right")[owner]
        more = ends - np.arange(observation.size)  # parts of the pattern from this one on
        left = np.repeat(np.arange(observation.size), more)
        right = left + np.arange(left.size) - np.repeat(np.cumsum(more) - more, more)
        meet = (rows.pattern_fixed[owner[left]] == 0) | (observation[left] == observation[right])
        left, right = left[meet], right[meet]
        jobs.append(np.stack([owner[left], observation[left], part[left], observation[right], part[right]], axis=1))
    table = np.concatenate(jobs)
    return table[np.argsort(table[:, 0], kind="stable")]


def entries_of_part(rows: Rows, observation: Index, part: Index) -> tuple[Index, Index]:
    """(j,) first entry and number of entries of some parts."""
    terms, shared = rows.observation_terms[observation], rows.observation_shared[observation]
    single = part - (terms > 0)
    before = np.where(single < 0, 0, terms + PART * single)
    count = np.where(single < 0, terms, np.minimum(PART, shared - PART * single))
    return rows.observation_entry[observation] + before, count


def _job_sets(rows: Rows, groups: Groups, target: NormalBlocks, table: Index) -> Index:
    """(j,) a number that jobs share which add, or whose companions add, to the same block or the same gradient."""
    group = rows.pattern_group[rows.piece[table[:, PIECE_OF], 0]]
    alone, second = table[:, OTHER] == NONE, np.maximum(table[:, OTHER:], 0)
    first, count = entries_of_part(rows, table[:, ONE], table[:, ONE_PART])
    first_j, count_j = entries_of_part(rows, second[:, 0], second[:, 1])
    count_j = np.where(alone, 1, count_j)
    job = np.repeat(np.arange(count.size), count * count_j)
    inside = np.arange(job.size) - np.repeat(np.cumsum(count * count_j) - count * count_j, count * count_j)
    row = rows.entry_member[first[job] + inside // count_j[job]]
    column = np.where(alone[job], row, rows.entry_member[first_j[job] + inside % count_j[job]])
    begin, members = groups.member_first[group[job]], np.diff(groups.member_first)[group[job]]
    pair = target.pair[groups.pair_first[group[job]] + np.minimum(row, column) * members + np.maximum(row, column)]
    place = np.where(alone[job], target.size + target.right[begin + row], pair)
    _, block = np.unique(place, return_inverse=True)
    return _companions(job, block.reshape(-1), count.size)


def _companions(job: Index, block: Index, jobs: int) -> Index:
    """(jobs,) smallest job that each is joined to by the blocks that jobs add to, pair by pair (job, block)."""
    owner, size = np.arange(jobs), int(block.max(initial=-1)) + 1
    while True:
        of_block = np.full(size, jobs)
        np.minimum.at(of_block, block, owner[job])
        new = owner.copy()
        np.minimum.at(new, job, of_block[block])
        new = new[new]
        if np.array_equal(new, owner):
            return owner
        owner = new




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
    of_pose = tables.observation[i, COMPONENTS] == PART
    for t in range(tables.observation[i, TERMS]):
        value, rate = basis_value(tables, data, i, at, stride, t, rates, value)
        c = tables.entry[entry + t, COLUMN]
        d0 += value * x[c]
        d1 += value * x[c + 1]
        d2 += value * x[c + 2]
        r0 += rate * x[c]
        r1 += rate * x[c + 1]
        r2 += rate * x[c + 2]
        if of_pose:
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
def block_of(tables, pattern, entry_i, entry_j):
    """Where two entries' variables meet: index of the first number, steps from row to row and from column to column,
    and whether it is one variable's block with itself, which holds both triangles.
    """
    first, second = tables.entry[entry_i, MEMBER], tables.entry[entry_j, MEMBER]
    low, high = min(first, second), max(first, second)
    start = tables.pair[tables.pattern[pattern, PAIRS] + low * tables.pattern[pattern, MEMBERS] + high]
    width = tables.entry[entry_j if second >= first else entry_i, ACROSS]
    down, across = (1, width) if first > second else (width, 1)
    start += tables.entry[entry_i, INSIDE] * down + tables.entry[entry_j, INSIDE] * across
    return start, down, across, first == second
