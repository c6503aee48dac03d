"""Where sums over points go: the blocks of pairs of variables."""

from mgsgraph.kernel.lanes import four, inlined, multiply_add, put_four
from mgsgraph.kernel.tile import pose_components


@inlined
def sight_columns(rows, i):
    """Columns of the unknowns that a sight feels: components per basis term, and their number altogether."""
    components = pose_components(rows.sight_width[i])
    return components, components * rows.sight_terms[i] + rows.sight_shared[i]


@inlined
def paired(rows, fixed, i, j):
    """Whether two sights meet in the normal matrix: both feel unknowns, and a free point joins them."""
    felt = sight_columns(rows, i)[1] > 0 and sight_columns(rows, j)[1] > 0
    return felt and (i == j or not fixed)


@inlined
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


@inlined
def add_sums(blocks, start, down, across, sums, at, components_i, components_j):
    """Add sums (components_i, components_j) to a block."""
    for a in range(components_i):
        row, k = start + a * down, at + a * components_j
        if across == 1 and components_j == 6:
            put_four(blocks, row, multiply_add(1.0, four(sums, k), four(blocks, row)))
            blocks[row + 4] += sums[k + 4]
            blocks[row + 5] += sums[k + 5]
        else:
            for b in range(components_j):
                blocks[row + b * across] += sums[k + b]


@inlined
def add_entry(rows, groups, target, group, i, a, j, value, blocks):
    """Add an entry (component a of entry i, single column j), and its mirror image, to the blocks."""
    start, down, across, own = block_place(rows, groups, target, group, i, j)
    blocks[start + a * down] += value
    if own and i != j:
        turned, down, across, _ = block_place(rows, groups, target, group, j, i)
        blocks[turned + a * across] += value
