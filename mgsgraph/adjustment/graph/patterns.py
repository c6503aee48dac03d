"""Points sorted by pattern: which observations they have, by which basis terms the orientation acts on these, in pieces
that the kernel takes one after the other. The loops are compiled: no Python for each point or image set.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.graph.stereo import StereoRows, columns, combinations
from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import SUPPORT, Moments
from mgsgraph.geometry.records import Array, Index, Mask, read_only, repeats
from mgsgraph.kernel.rows import GROUND, IMAGE, PIECE, RANGE, STEREO, SURFACE, Groups, NormalBlocks, shapes
from mgsgraph.network import Network
from mgsgraph.network.effects import common_slopes

_Rows = tuple[Index, NDArray[np.int32], NDArray[np.int32]]
"""Rows of each point, as `by_point` gives them."""


@dataclass(frozen=True, eq=False)
class Patterns:
    """Points sorted by pattern, patterns by shape and then by the unknowns that they depend on.

    n points, q patterns, m pieces, g groups, s observations of patterns, e entries of observations.
    """

    first: Index
    """(q + 1,) first observation of each pattern: rays by image, ranges by image, a-priori position, terrain, stereo
    surface."""
    fixed: Mask
    """(q,) whether the points are known."""
    shape: Index
    """(q,) shape of each pattern, ascending."""
    group: Index
    """(q,) group of each pattern."""
    group_first: Index
    """(g + 1,) first member of each group."""
    group_member: Index
    """Variables of the groups, ascending within each."""
    kind: Index
    """(s,) IMAGE, RANGE, GROUND, SURFACE or STEREO."""
    image: Index
    """(s,) image that carries it; -1 for none."""
    node: Index
    """(s,) first of the four nodes that it depends on; -1 for an image without a pass, and for none."""
    width: Index
    """(s,) components of its state."""
    terms: Index
    """(s,) number of basis terms."""
    shared: Index
    """(s,) number of single columns: a shift's, then those of shared unknowns."""
    entry: Index
    """(s + 1,) first entry of each observation."""
    entry_variable: Index
    """(e,) variable of each basis term and of each single column."""
    entry_inside: Index
    """(e,) first of the term's six columns, or the single one, within that variable."""
    entry_member: Index
    """(e,) index of the variable among those of the group."""
    point_order: Index
    """(n,) network point at each index of the layout."""
    point_index: Index
    """(n,) the inverse: index in the layout of each network point."""
    piece_pattern: Index
    """(m,) pattern of each piece."""
    piece_first: Index
    """(m + 1,) first point of each piece."""
    range_slot: NDArray[np.int32]
    """(r,) the same of each network range."""
    slopes: Array
    """(images + 1, 2) as of `common_slopes`; zeros for what is in no image."""

    def piece_of(self, indices: Index | int) -> Index:
        """Piece of each index of the layout."""
        return np.asarray(np.searchsorted(self.piece_first, indices, side="right") - 1)

    @cached_property
    def group_variables(self) -> tuple[tuple[int, ...], ...]:
        """Variables of each group, ascending; for small networks."""
        return tuple(tuple(part.tolist()) for part in np.split(self.group_member, self.group_first[1:-1]))


class Terms:
    """Terms of each ray and each range of a network: of its image's own polynomial, or of the four orientation images
    of its pass around it. A term is six columns, one of each component.

    `lines` (k,) are those about which rays are laid out.
    """

    def __init__(self, network: Network, variables: Variables, lines: Array) -> None:
        self._network, self._pass = network, network.pass_of
        terms = [prior.degree + 1 for prior in network.priors]
        self.counts = np.where(self._pass >= 0, SUPPORT, np.where(variables.first[: len(terms)] < 0, 0, terms))
        """(images,) number of terms of each image's rays and ranges; none for one that is held."""
        self._first_of_passes = network.first_of_passes
        rays, ranges = network.rays, network.ranges
        self.lines = lines
        """(k,) line about which each ray is laid out."""
        self.of_rays = np.full(rays.point.size, -1, dtype=np.int32)
        """(k,) of each ray the first of its four nodes, counted in its pass; -1 for an image without a pass. int32,
        since there are many."""
        self.of_ranges = np.full(ranges.point.size, -1, dtype=np.int32)
        """(r,) the same of each range."""
        if not network.passes:
            return
        order, _, sizes = counted(rays.image, np.arange(len(network.images)))
        ends = np.cumsum(sizes)
        for pass_ in network.passes:
            for j in pass_.images.tolist():
                image, in_image = network.images[j], order[ends[j] - sizes[j] : ends[j]]
                times, _ = image.timing.at(self.lines[in_image])
                self.of_rays[in_image] = pass_.nodes.first_of_four(times, image.trajectory.epoch)
                in_image = np.flatnonzero(ranges.image == j)
                self.of_ranges[in_image] = pass_.nodes.first_of_four(ranges.times[in_image], 0.0)

    def first_node(self, images: Index) -> Index:
        """(n,) variable of the first node of each image's pass; without meaning for one without a pass."""
        return self._first_of_passes[self._pass[images]]

    def basis(self, image: int, moments: Moments, node: NDArray[np.int32], rates: bool) -> tuple[Array, Array]:
        """Stored values of the basis at n moments: u (n, 1) of a polynomial, or values (n, terms) of nodes and, if
        `rates`, their derivatives per line; the other one has no columns. `node` (n,) is `of_rays` or `of_ranges`.
        """
        empty = np.empty((moments.u.size, 0))
        if self._pass[image] < 0:
            return (moments.u[:, None] if self.counts[image] else empty), empty
        nodes = self._network.passes[self._pass[image]].nodes
        values, slopes = nodes.around(node.astype(np.int64), moments.times, moments.epoch)
        return empty, np.hstack([values, slopes * moments.periods[:, None]]) if rates else values


@cached_kernel
def by_point(point, image, node, points):
    """Rows (k,) of each of n points, in the order of image and first node (then as given).

    Returns
    -------
    begin : (n + 1,)
        Where each point's rows begin in `order`.
    order : (k,)
        Rows, point after point.
    slot : (k,)
        Place of each row among its point's.
    """
    begin = np.zeros(points + 1, dtype=np.int32)
    for k in range(point.size):
        begin[point[k] + 1] += 1
    for i in range(points):
        begin[i + 1] += begin[i]
    order, filled = np.empty(point.size, dtype=np.int32), np.zeros(points, dtype=np.int32)
    for k in range(point.size):
        i = point[k]
        at, first = begin[i] + filled[i], begin[i]
        while at > first:
            before = order[at - 1]
            if image[before] < image[k] or (image[before] == image[k] and node[before] <= node[k]):
                break
            order[at] = before
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
    """Mix the rows of points into their signatures (n,)."""
    for i in range(signature.size):
        mixture = mixed(signature[i], np.uint64(mark))
        for at in range(begin[i], begin[i + 1]):
            k = order[at]
            mixture = mixed(mixed(mixture, np.uint64(image[k] + 1)), np.uint64(node[k] + 2))
        signature[i] = mixture


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
def counted(number, rank):
    """Points in the order of the ranks (count,) of their numbers (n,): that order, its inverse, and how many of each
    rank.
    """
    sizes, at = np.zeros(rank.size, dtype=np.int64), np.zeros(rank.size, dtype=np.int64)
    for i in range(number.size):
        sizes[rank[number[i]]] += 1
    for k in range(1, rank.size):  # `np.cumsum` would load SciPy with a kernel from the cache
        at[k] = at[k - 1] + sizes[k - 1]
    order, index = np.empty(number.size, dtype=np.int64), np.empty(number.size, dtype=np.int64)
    for i in range(number.size):
        k = at[rank[number[i]]]
        order[k], index[i] = i, k
        at[rank[number[i]]] = k + 1
    return order, index, sizes


def sort_points(
    network: Network, terms: Terms, stereo: StereoRows | None
) -> tuple[Patterns, NDArray[np.int32]]:
    """Find the patterns of a network's points, distinguished by 64-bit signatures of what they see; and (k,) the index
    of each ray among its point's observations.
    """
    rays, ranges, n = network.rays, network.ranges, len(network.points)
    of_rays = by_point(rays.point, rays.image, terms.of_rays, n)
    of_ranges = by_point(ranges.point, ranges.image, terms.of_ranges, n)
    moved, footprints = _moved(network), _footprints(network)
    signature = np.zeros(n, dtype=np.uint64)
    mix_rows(signature, of_rays[0], of_rays[1], rays.image, terms.of_rays, 1)
    mix_rows(signature, of_ranges[0], of_ranges[1], ranges.image, terms.of_ranges, 2)
    on_surface = np.broadcast_to(0, n)
    if network.surface is not None:
        on_surface = np.isfinite(network.surface.sigmas).astype(np.int64)
    on_stereo, sides = _on_stereo(n, stereo)
    common = network.common_variables
    for values in (network.points.kinds, moved, on_surface, on_stereo, *(variable for variable, *_ in footprints)):
        if not repeats(values):
            mix_values(signature, read_only(values))
    if network.common:
        mix_rows(signature, of_rays[0], of_rays[1], read_only(common[0]), terms.of_rays, 3)
        mix_values(signature, read_only(common[1]))
    example, number = distinct(signature)
    of_example = _PatternObservations(
        network, terms, example, of_rays, of_ranges, moved, on_surface, (on_stereo, sides), footprints, common
    )
    member, group_first, group_member, group = _groups(of_example.pattern_of_entry, of_example.variable, example.size)
    fixed = network.points.kinds[example] == PointKind.FIXED
    polynomial = (of_example.image >= 0) & (of_example.node < 0)
    slopes = np.vstack([common_slopes(network), np.zeros(2)])
    own_slope = np.isnan(slopes[of_example.image, 0])
    properties = of_example.kind, of_example.width, of_example.terms, of_example.shared, 2 * own_slope + polynomial
    shape = shapes(of_example.first, fixed.astype(np.int64), *properties)
    order = np.lexsort([np.arange(example.size), group, shape])
    point_order, point_index, count = counted(read_only(number), np.argsort(order))
    pieces = -(-count // PIECE)
    inside = within(pieces)
    of_order, first = _runs(of_example.first, order)
    entries, entry = _runs(of_example.entry, of_order)
    range_slot = (of_ranges[2] + network.ray_counts[ranges.point]).astype(np.int32)
    patterns = Patterns(
        first, fixed[order], shape[order], group[order], group_first, group_member, of_example.kind[of_order],
        of_example.image[of_order], of_example.node[of_order], of_example.width[of_order], of_example.terms[of_order],
        of_example.shared[of_order], entry, of_example.variable[entries], of_example.inside[entries], member[entries],
        point_order, point_index, np.repeat(np.arange(order.size), pieces),
        np.append(np.repeat(np.cumsum(count) - count, pieces) + inside * PIECE, number.size), range_slot, slopes,
    )  # fmt: skip
    return patterns, of_rays[2]


def _runs(first: Index, order: Index) -> tuple[Index, Index]:
    """Runs first[k] .. first[k + 1] in another order: their elements one after another, and where each run begins."""
    sizes = np.diff(first)[order]
    begin = np.concatenate([[0], np.cumsum(sizes)])
    return np.repeat(first[:-1][order] - begin[:-1], sizes) + np.arange(begin[-1]), begin


def _on_stereo(n: int, stereo: StereoRows | None) -> tuple[Index, Index]:
    """(n,) which of the combinations of images and nodes (c, 4) the stereo row of each point has; -1 for none."""
    if stereo is None:
        return np.broadcast_to(-1, n), np.zeros((0, 4), dtype=np.int64)
    combination = np.full(n, -1, dtype=np.int64)
    sides, combination[stereo.points] = combinations(stereo.sides)
    return combination, sides


def _moved(network: Network) -> Index:
    """(n,) variable of the shift that moves each point's a-priori position; -1 for none."""
    if network.shifts is None:
        return np.broadcast_to(-1, len(network.points))
    profile = network.shifts.profile
    return np.where(profile >= 0, len(network.images) + profile, -1)


def _footprints(network: Network) -> list[tuple[Index, int, bool]]:
    """Of each shared unknown that moves footprints: (n,) its variable, -1 elsewhere; its width; acts on ranges, too."""
    footprints = []
    for k, shared in enumerate(network.shared):
        if shared.kind.moves_footprints:
            affected = np.full(len(network.points), -1, dtype=np.int64)
            affected[network.footprints_moved(shared)] = network.first_shared + k
            footprints.append((affected, shared.kind.width, shared.kind.acts_on_ranges))
    return footprints


class _PatternObservations:
    """Observations of the patterns' example points, and the unknowns that they depend on."""

    def __init__(
        self, network: Network, terms: Terms, example: Index, of_rays: _Rows, of_ranges: _Rows, moved: Index,
        on_surface: Index, on_stereo: tuple[Index, Index], footprints: list[tuple[Index, int, bool]],
        common: tuple[Index, Index],
    ) -> None:  # fmt: skip
        with_prior = network.points.kinds[example] == PointKind.CONSTRAINED
        surfaces, of_stereo = on_surface[example] > 0, on_stereo[0][example]
        counts = [begin[example + 1] - begin[example] for begin, _, _ in (of_rays, of_ranges)]
        each = np.stack([*counts, with_prior, surfaces, of_stereo >= 0], axis=1, dtype=np.int64)
        self.first = np.concatenate([[0], np.cumsum(each.sum(axis=1))])
        begin = (np.cumsum(each.ravel()) - each.ravel()).reshape(each.shape)
        size = int(self.first[-1])
        self.kind, self.image, self.node = np.empty(size, np.int64), np.full(size, -1), np.full(size, -1)
        self._common = np.full(size, -1)
        for column, (kind, table, node, rows) in enumerate(
            (
                (IMAGE, network.rays.image, terms.of_rays, of_rays),
                (RANGE, network.ranges.image, terms.of_ranges, of_ranges),
            )
        ):
            source, _ = _runs(rows[0], example)
            at = np.repeat(begin[:, column], each[:, column]) + within(each[:, column])
            self.kind[at], self.image[at], self.node[at] = kind, table[rows[1][source]], node[rows[1][source]]
            if kind == IMAGE:
                self._common[at] = common[0][rows[1][source]]
        ground, surface = begin[with_prior, 2], begin[surfaces, 3]
        stereo = begin[of_stereo >= 0, 4]
        self.kind[ground], self.kind[surface], self.kind[stereo] = GROUND, SURFACE, STEREO
        self._common[surface] = common[1][example[surfaces]]
        self._on_stereo = [columns(network, tuple(side)) for side in on_stereo[1].tolist()]
        self._stereo, self._combination = stereo, of_stereo[of_stereo >= 0]
        ranges = np.flatnonzero((self.kind == RANGE) & (network.ranges.shares is not None))
        point = example[np.searchsorted(self.first, ranges, side="right") - 1]
        moving = ((moved, 2, False), *footprints)
        moves = [(ground, variable[example[with_prior]], width) for variable, width, _ in moving]
        moves += [(ranges, variable[point], width) for variable, width, on_ranges in moving if not on_ranges]
        if network.terrain_moves and network.surface is not None:
            moves.append((surface, np.full(surface.size, network.first_shared - 1), len(network.surface.terms)))
        self._add_unknowns(network, terms, moves)

    def _add_unknowns(self, network: Network, terms: Terms, moved: list[tuple[Index, Index, int]]) -> None:
        """Numbers of terms and single columns, widths, and the entries."""
        carried = self.image >= 0
        self.terms = np.where(carried, terms.counts[self.image], 0)
        of_range = 3 if network.ranges.shares is None else 4
        self.width = np.array([6, of_range, 3, 3, 1])[self.kind]
        size = self.kind.size
        observation, variable, inside = [], [], []
        rows = np.repeat(np.flatnonzero(carried), self.terms[carried])
        step, node = within(self.terms[carried]), self.node[rows]
        first_node = terms.first_node(self.image[rows])
        observation.append(rows)
        variable.append(np.where(node >= 0, first_node + node + step, self.image[rows]))
        inside.append(np.where(node >= 0, 0, 6 * step))
        for k, shared in enumerate(network.shared):
            of_image = np.zeros(len(network.images) + 1, dtype=bool)  # the last one is that of no image
            of_image[shared.images] = True
            kinds = [IMAGE] * shared.kind.acts_on_rays + [RANGE] * shared.kind.acts_on_ranges
            rows = np.flatnonzero(of_image[self.image] & np.isin(self.kind, kinds))
            number = np.full(rows.size, network.first_shared + k)
            _add_singles(observation, variable, inside, rows, number, shared.kind.width)
            if not shared.kind.moves_instrument:
                self.width[rows] = np.where(self.kind[rows] == IMAGE, 9, 4)
        for at, affected, width in moved:
            _add_singles(observation, variable, inside, at[affected >= 0], affected[affected >= 0], width)
        rows = np.flatnonzero(self._common >= 0)
        widths = np.array(network.widths)[self._common[rows]]
        observation.append(np.repeat(rows, widths))
        variable.append(np.repeat(self._common[rows], widths))
        inside.append(within(widths))
        self.width[rows[self.kind[rows] == IMAGE]] = 9
        for at, k in zip(self._stereo.tolist(), self._combination.tolist(), strict=True):
            observation.append(np.full(self._on_stereo[k][0].size, at))
            variable.append(self._on_stereo[k][0])
            inside.append(self._on_stereo[k][1])
        observations = np.concatenate(observation)
        order = np.argsort(observations, kind="stable")
        counts = np.bincount(observations, minlength=size)
        self.entry = np.concatenate([[0], np.cumsum(counts)])
        self.shared = counts - self.terms
        self.variable = np.concatenate(variable)[order].astype(np.int64)
        self.inside = np.concatenate(inside)[order].astype(np.int64)
        self.pattern_of_entry = np.repeat(np.arange(self.first.size - 1), np.diff(self.first))[observations[order]]


def within(counts: Index) -> Index:
    """0, 1, .. within each run of `counts`."""
    return np.asarray(np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts))


def _add_singles(
    observation: list[Index], variable: list[Index], inside: list[Index], rows: Index, affected: Index, columns: int
) -> None:
    """Entries of observations that depend on all columns of a variable."""
    observation.append(np.repeat(rows, columns))
    variable.append(np.repeat(affected, columns))
    inside.append(np.tile(np.arange(columns), rows.size))


def _groups(pattern: Index, variable: Index, patterns: int) -> tuple[Index, Index, Index, Index]:
    """Sets of variables that patterns depend on: index of each entry among those of its group; first member of each
    group, and members; group of each pattern. Groups are in the order of their members.
    """
    many = int(variable.max(initial=0)) + 1
    unique, back = np.unique(pattern * many + variable, return_inverse=True)
    owner, affected = unique // many, unique % many
    count = np.bincount(owner, minlength=patterns)
    begin = np.cumsum(count) - count
    table = np.full((patterns, int(count.max(initial=0)) + 1), -1, dtype=np.int64)
    table[owner, np.arange(unique.size) - begin[owner]] = affected
    sets, group = np.unique(table, axis=0, return_inverse=True)
    present = sets >= 0
    first = np.concatenate([[0], np.cumsum(present.sum(axis=1))])
    return (np.arange(unique.size) - begin[owner])[back.reshape(-1)], first, sets[present], group.reshape(-1)


def make_groups(variables: Variables, first: Index, member: Index) -> Groups:
    """The kernel's record of the groups: first member of each (g + 1,), and the members' variables."""
    squares = np.concatenate([[0], np.cumsum(np.diff(first) ** 2)])
    return Groups(
        first.astype(np.int64), member.astype(np.int64), variables.width[member], squares.astype(np.int64)
    )


@dataclass(frozen=True, slots=True, eq=False)
class PairBlocks:
    """The sparse normal matrix: dense blocks of variable pairs that share points, in one flat array; p pairs."""

    first: Index
    """(p,) first variable of each pair."""
    second: Index
    """(p,) second variable, not before the first."""
    offset: Index
    """(p,) where its block begins, first variable's columns down, second's across."""
    target: NormalBlocks
    """The same, in the kernel's form."""

    def filled(self, joint: JointCovariance) -> Array:
        """A covariance of all variables in these blocks, flat, in the kernel's form."""
        flat = joint.pairs(self.first, self.second, self.offset)
        return np.pad(flat, (0, self.target.size - flat.size))

    def each(self, flat: Array, width: Index) -> Iterator[tuple[int, int, Array]]:
        """Each pair's variables, v and w, and its block (width[v], width[w]) in a flat array."""
        widths = width.tolist()
        for v, w, at in zip(self.first.tolist(), self.second.tolist(), self.offset.tolist(), strict=True):
            yield v, w, flat[at : at + widths[v] * widths[w]].reshape(widths[v], widths[w])


def pair_blocks(variables: Variables, groups: Groups, more: Sequence[tuple[int, int]] = ()) -> PairBlocks:
    """Blocks of all pairs of variables that some group holds, of each adjusted variable with itself, and of `more`
    pairs (first variable <= second).
    """
    count = variables.first.size
    member = groups.member_variable
    pairs = [v * count + v for v in variables.adjusted()] + [v * count + w for v, w in more]
    ends = member[np.stack(_member_pairs(groups))]
    table = ends.min(axis=0) * count + ends.max(axis=0)
    unique = np.unique(np.concatenate([table, np.array(pairs, dtype=np.int64)]))
    first, second = unique // count, unique % count
    sizes = variables.width[first] * variables.width[second]
    offset = np.cumsum(sizes) - sizes
    target = NormalBlocks(
        offset[np.searchsorted(unique, table)], variables.first[member], int(sizes.sum()), int(variables.sigmas.size)
    )
    return PairBlocks(first, second, offset, target)


def group_blocks(groups: Groups) -> NormalBlocks:
    """Blocks of each group by itself, not shared with others: for a reduced system of its own."""
    first, second = _member_pairs(groups)
    sizes = groups.member_width[first] * groups.member_width[second]
    pair, at = np.cumsum(sizes) - sizes, int(sizes.sum())
    right = np.cumsum(groups.member_width) - groups.member_width
    return NormalBlocks(pair, right.astype(np.int64), at, int(groups.member_width.sum()))


def _member_pairs(groups: Groups) -> tuple[Index, Index]:
    """Of all pairs of the groups' members, group by group and row by row, the first and the second."""
    size = np.diff(groups.member_first)
    first = np.repeat(np.arange(groups.member_variable.size), np.repeat(size, size))
    group = np.repeat(np.arange(size.size), size**2)
    inside = (np.arange(group.size) - groups.pair_first[group]) % np.maximum(size[group], 1)
    return first, groups.member_first[group] + inside
