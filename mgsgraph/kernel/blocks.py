"""Where sums over points go: the blocks of pairs of variables, and how many sums there are."""

from mgsgraph.kernel.lanes import FOUR, lane
from mgsgraph.kernel.tile import pose_components


@lane
def sight_columns(rows, i):
    """Columns of the unknowns that a sight feels: components per basis term, and their number altogether."""
    components = pose_components(rows.sight_width[i])
    return components, components * rows.sight_terms[i] + rows.sight_shared[i]


@lane
def fours(terms):
    """Room for as many numbers, in fours."""
    return FOUR * ((terms + FOUR - 1) // FOUR)


@lane
def term_sums(rows, i, j):
    """Room for the sums over products of basis values."""
    columns = sight_columns(rows, i)[0] * rows.sight_terms[i] * sight_columns(rows, j)[0]
    return columns * fours(rows.sight_terms[j])


@lane
def pair_sums(rows, i, j):
    """Room for all sums of a pair of sights."""
    singles_i, singles_j = rows.sight_shared[i], rows.sight_shared[j]
    columns_i, columns_j = sight_columns(rows, i)[1], sight_columns(rows, j)[1]
    return term_sums(rows, i, j) + singles_j * columns_i + singles_i * (columns_j - singles_j)


@lane
def paired(rows, fixed, i, j):
    """Whether two sights meet in the normal matrix: both feel unknowns, and a free point joins them."""
    felt = sight_columns(rows, i)[1] > 0 and sight_columns(rows, j)[1] > 0
    return felt and (i == j or not fixed)


@lane
def block_place(rows, groups, target, group, i, j):
    """Where the entries of two entries' variables meet (`Rows.entry_member`, ...): the first place, steps from row to
    row and from column to column, and whether it is one variable's block with itself, which holds both triangles.
    """
    first, second = rows.entry_member[i], rows.entry_member[j]
    begin = groups.member_first[group]
    size, low, high = groups.member_first[group + 1] - begin, min(first, second), max(first, second)
    start, width = target.pair[groups.pair_first[group] + low * size + high], groups.member_width[begin + high]
    down, across = (1, width) if first > second else (width, 1)
    return start + rows.entry_inside[i] * down + rows.entry_inside[j] * across, down, across, first == second


@lane
def add_block(blocks, start, down, across, sums, at, stride, components_i, components_j):
    """Add components_i x components_j sums, `stride` apart, to a block."""
    for a in range(components_i):
        for b in range(components_j):
            blocks[start + a * down + b * across] += sums[at + (a * components_j + b) * stride]


@lane
def add_symmetric(blocks, start, down, across, sums, at, stride, components):
    """The same of a symmetric matrix whose upper triangle is there."""
    for a in range(components):
        for b in range(a, components):
            value = sums[at + (a * components + b) * stride]
            blocks[start + a * down + b * across] += value
            if b > a:
                blocks[start + b * down + a * across] += value


@lane
def spread_terms(rows, groups, target, group, i, j, sums, at, blocks):
    """Add a pair's sums over products of basis values to the blocks."""
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    entry_i, entry_j, room = rows.sight_entry[i], rows.sight_entry[j], fours(rows.sight_terms[j])
    stride, polynomials = rows.sight_terms[i] * room, rows.sight_rate[i] * rows.sight_rate[j] != 0.0
    if stride == 0:
        return
    begin, down, across, own = block_place(rows, groups, target, group, entry_i, entry_j)
    for p in range(rows.sight_terms[i]):
        for q in range(p if i == j else 0, rows.sight_terms[j]):
            start, turned = begin + 6 * (p * down + q * across), begin + 6 * (q * down + p * across)
            if not polynomials:  # each term has a variable of its own
                start, down, across, own = block_place(rows, groups, target, group, entry_i + p, entry_j + q)
                turned = block_place(rows, groups, target, group, entry_j + q, entry_i + p)[0]
            first = at + p * room + q
            if i == j:
                add_symmetric(blocks, start, down, across, sums, first, stride, components_i)
            else:
                add_block(blocks, start, down, across, sums, first, stride, components_i, components_j)
            if own and not (i == j and p == q):  # a variable's block with itself holds both triangles
                if i == j:
                    add_symmetric(blocks, turned, across, down, sums, first, stride, components_i)
                else:
                    add_block(blocks, turned, across, down, sums, first, stride, components_i, components_j)


@lane
def add_entry(rows, groups, target, group, i, a, j, value, blocks):
    """Add an entry (component a of entry i, single column j), and its mirror image, to the blocks."""
    start, down, across, own = block_place(rows, groups, target, group, i, j)
    blocks[start + a * down] += value
    if own and i != j:
        turned, down, across, _ = block_place(rows, groups, target, group, j, i)
        blocks[turned + a * across] += value


@lane
def spread_singles(rows, groups, target, group, i, j, sums, at, blocks):
    """The same for single columns, in the order of `sum_singles`."""
    terms_i, terms_j = rows.sight_terms[i], rows.sight_terms[j]
    entry_i, entry_j = rows.sight_entry[i], rows.sight_entry[j]
    components_i, components_j = sight_columns(rows, i)[0], sight_columns(rows, j)[0]
    for f in range(rows.sight_shared[j]):
        own = entry_j + terms_j + f
        for a in range(components_i if terms_i > 0 else 0):
            for p in range(terms_i):
                add_entry(rows, groups, target, group, entry_i + p, a, own, sums[at], blocks)
                at += 1
        for e in range(rows.sight_shared[i]):
            if i != j or e <= f:
                add_entry(rows, groups, target, group, entry_i + terms_i + e, 0, own, sums[at], blocks)
            at += 1
    for e in range(rows.sight_shared[i] if i != j and terms_j > 0 else 0):
        for b in range(components_j):
            for q in range(terms_j):
                add_entry(rows, groups, target, group, entry_j + q, b, entry_i + terms_i + e, sums[at], blocks)
                at += 1


@lane
def spread_pair(rows, groups, target, pattern, i, j, sums, at, blocks):
    """Add the sums of a pair of sights (counted within the pattern) to the blocks of its variables, and clear them."""
    group, first = rows.pattern_group[pattern], rows.pattern_sight[pattern]
    i, j = first + i, first + j
    spread_terms(rows, groups, target, group, i, j, sums, at, blocks)
    spread_singles(rows, groups, target, group, i, j, sums, at + term_sums(rows, i, j), blocks)
    for k in range(pair_sums(rows, i, j)):
        sums[at + k] = 0.0


@lane
def spread(rows, groups, target, pattern, sums, blocks):
    """The same for all pairs of a pattern's sights."""
    begin, end = rows.pattern_sight[pattern], rows.pattern_sight[pattern + 1]
    at = 0
    for i in range(begin, end):
        for j in range(i, end):
            if paired(rows, rows.pattern_fixed[pattern] > 0, i, j):
                spread_pair(rows, groups, target, pattern, i - begin, j - begin, sums, at, blocks)
                at += pair_sums(rows, i, j)
