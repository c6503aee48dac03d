"""Points sorted by pattern: which sights they have, in pieces that the kernel takes one after the other."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.terms import Terms
from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.factors.rows import GROUND, IMAGE, PIECE, RANGE, SURFACE, Groups, Target
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network, SharedKind
from mgsgraph.ties import PointKind


class Sight(NamedTuple):
    """One sight of a pattern."""

    kind: int
    """IMAGE, RANGE, GROUND or SURFACE."""
    image: int
    """Image that carries it; -1 for none."""
    terms: tuple[tuple[int, int], ...] = ()
    """Variable of each basis term that it feels, and its first column within it: six columns each."""
    moved: int = -1
    """Variable of the shift that it feels; -1 for none."""
    felt: tuple[int, ...] = ()
    """Variables of the shared unknowns that it feels, ascending."""
    columns: int = 0
    """Columns of these together."""
    wide: bool = False
    """Whether its state has one component more: the focal length of an image, the bias of a range."""
    steps: int = 2
    """Single columns of a shift: eastward and northward, of the terrain model as many as it has."""

    @property
    def width(self) -> int:
        """Components of its state."""
        return (6 if self.kind == IMAGE else 3) + self.wide

    @property
    def shift(self) -> int:
        """Single columns of the shift that it feels."""
        return self.steps if self.moved >= 0 else 0

    @property
    def shared(self) -> int:
        """Single columns that it feels: a shift's, then those of shared unknowns."""
        return self.shift + self.columns

    @property
    def variables(self) -> tuple[int, ...]:
        """All variables that it feels, each once."""
        moved = (self.moved,) if self.moved >= 0 else ()
        return tuple(dict.fromkeys((*(v for v, _ in self.terms), *moved, *self.felt)))


@dataclass(frozen=True, slots=True, eq=False)
class Patterns:
    """Points sorted by pattern; n points, q patterns, m pieces."""

    sights: tuple[tuple[Sight, ...], ...]
    """Sights of each pattern: rays by image, ranges by image, a-priori place, terrain."""
    fixed: Mask
    """(q,) whether the points are known."""
    group: Index
    """(q,) group of each pattern, ascending."""
    group_variables: tuple[tuple[int, ...], ...]
    """Variables of each group, ascending."""
    point_order: Index
    """(n,) network point at each place of the layout."""
    point_place: Index
    """(n,) the way back: place of each network point."""
    piece_pattern: Index
    """(m,) pattern of each piece."""
    piece_first: Index
    """(m + 1,) first point of each piece."""

    def piece_of(self, places: Index | int) -> Index:
        """Piece of each place of the layout."""
        return np.asarray(np.searchsorted(self.piece_first, places, side="right") - 1)


def sort_points(network: Network, variables: Variables, terms: Terms) -> Patterns:
    """Find the patterns of a network's points.

    Patterns are told apart by sums of 64-bit random numbers, one per sight: one pass, no Python per point.
    """
    signature = _signatures(network, terms, len(variables.first))
    _, example, pattern = np.unique(signature, return_index=True, return_inverse=True)
    sights = _sights(network, variables, terms, example)
    sets = [tuple(sorted({v for sight in mine for v in sight.variables})) for mine in sights]
    group_variables = tuple(sorted(set(sets)))
    number = {members: g for g, members in enumerate(group_variables)}
    group = np.array([number[members] for members in sets], dtype=np.int64)
    order = np.argsort(group, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size)
    pattern = rank[pattern.reshape(-1)]
    point_order = np.argsort(pattern, kind="stable")
    point_place = np.empty_like(point_order)
    point_place[point_order] = np.arange(point_order.size)
    count = np.bincount(pattern, minlength=order.size)
    pieces = -(-count // PIECE)
    inside = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = np.repeat(np.cumsum(count) - count, pieces) + inside * PIECE
    return Patterns(
        tuple(sights[q] for q in order),
        network.points.kinds[example[order]] == PointKind.FIXED,
        group[order],
        group_variables,
        point_order,
        point_place,
        np.repeat(np.arange(order.size), pieces),
        np.append(first, pattern.size),
    )


def _signatures(network: Network, terms: Terms, variables: int) -> Index:
    """(n,) a number per point that two points share if, and only if, they have the same sights."""
    marks = np.random.default_rng(0).integers(0, 2**64, (3, variables), dtype=np.uint64)
    plain = np.random.default_rng(1).integers(0, 2**64, 3, dtype=np.uint64)
    signature = np.zeros(len(network.points), dtype=np.uint64)
    for mark, table, node in ((marks[0], network.rays, terms.of_rays), (marks[1], network.ranges, terms.of_ranges)):
        mine = mark[table.image]
        at_node = np.flatnonzero(node >= 0)
        mine[at_node] ^= marks[2, terms.variable(table.image[at_node], node[at_node])]
        np.add.at(signature, table.point, mine)
    signature += plain[0] * (network.points.kinds == PointKind.FIXED)
    signature += plain[1] * (network.points.kinds == PointKind.CONSTRAINED)
    if network.shifts is not None:
        moved = network.shifts.profile >= 0
        signature[moved] += marks[2, len(network.images) + network.shifts.profile[moved]]
    if network.surface is not None:
        signature += plain[2] * np.isfinite(network.surface.sigmas)
    return signature.view(np.int64)


def _sights(network: Network, variables: Variables, terms: Terms, example: Index) -> list[tuple[Sight, ...]]:
    """Sights of the example points, one per pattern."""
    position = np.full(len(network.points), -1, dtype=np.int64)
    position[example] = np.arange(example.size)
    sights: list[list[Sight]] = [[] for _ in range(example.size)]
    felt = {kind: [_columns_of(network, mine) for mine in felt_by(network, kind)] for kind in (IMAGE, RANGE)}
    for kind, table, node in ((IMAGE, network.rays, terms.of_rays), (RANGE, network.ranges, terms.of_ranges)):
        mine = np.flatnonzero(position[table.point] >= 0)
        for k in mine[np.lexsort((node[mine], table.image[mine]))]:
            image = int(table.image[k])
            sight = Sight(kind, image, terms.of(image, int(node[k])), -1, *felt[kind][image])
            sights[position[table.point[k]]].append(sight)
    surface, shifts = network.surface, network.shifts
    terrain = network.first_shared - 1 if network.terrain_moves else -1
    moved = beams_felt(network, example)
    for q, i in enumerate(example):
        if network.points.kinds[i] == PointKind.CONSTRAINED:
            profile = -1 if shifts is None else int(shifts.profile[i])
            variable = profile + variables.images if profile >= 0 else -1
            sights[q].append(Sight(GROUND, -1, (), variable, *_columns_of(network, moved[q])))
        if surface is not None and np.isfinite(surface.sigmas[i]):
            sights[q].append(Sight(SURFACE, -1, (), terrain, steps=len(surface.terms)))
    return [tuple(mine) for mine in sights]


def felt_by(network: Network, kind: int) -> list[list[int]]:
    """Of each image the shared unknowns that its rays (IMAGE) or its ranges (RANGE) feel, ascending."""
    felt: list[list[int]] = [[] for _ in network.images]
    for k, shared in enumerate(network.shared):
        if shared.kind.felt_by_rays if kind == IMAGE else shared.kind.felt_by_ranges:
            for j in shared.images.tolist():
                felt[j].append(k)
    return felt


def beams_felt(network: Network, points: Index) -> list[list[int]]:
    """Of each of some points the altimeters' boresights that move its a-priori place, ascending."""
    felt: list[list[int]] = [[] for _ in range(points.size)]
    for k, shared in enumerate(network.shared):
        if shared.kind is SharedKind.ALTIMETER_BORESIGHT:
            for q in np.flatnonzero(np.isin(points, network.beams(shared)[0])).tolist():
                felt[q].append(k)
    return felt


def _columns_of(network: Network, felt: list[int]) -> tuple[tuple[int, ...], int, bool]:
    """Variables of some shared unknowns, their columns together, and whether they need a wider state."""
    first, kinds = network.first_shared, [network.shared[k].kind for k in felt]
    wide = any(kind in (SharedKind.FOCAL_LENGTH, SharedKind.RANGE_BIAS) for kind in kinds)
    return tuple(first + k for k in felt), sum(kind.width for kind in kinds), wide


def make_groups(variables: Variables, group_variables: tuple[tuple[int, ...], ...]) -> Groups:
    """The kernel's record of the groups."""
    sizes = np.array([len(members) for members in group_variables], dtype=np.int64)
    member = np.array([v for members in group_variables for v in members], dtype=np.int64)
    ends = np.concatenate([[0], np.cumsum(sizes)])
    return Groups(
        ends.astype(np.int64),
        member,
        variables.width[member],
        np.concatenate([[0], np.cumsum(sizes**2)]).astype(np.int64),
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
    target: Target
    """The same, as the kernel wants it."""

    def filled(self, joint: JointCovariance) -> Array:
        """A covariance of all variables in these blocks, flat, as the kernel wants it."""
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
    place, member = groups.pair_first, groups.member_variable
    pairs = [v * count + v for v in variables.adjusted()] + [v * count + w for v, w in more]
    table = np.zeros(int(place[-1]), dtype=np.int64)
    for g in range(place.size - 1):
        mine = member[groups.member_first[g] : groups.member_first[g + 1]]
        table[place[g] : place[g + 1]] = (np.minimum.outer(mine, mine) * count + np.maximum.outer(mine, mine)).ravel()
    unique = np.unique(np.concatenate([table, np.array(pairs, dtype=np.int64)]))
    first, second = unique // count, unique % count
    sizes = variables.width[first] * variables.width[second]
    offset = np.cumsum(sizes) - sizes
    target = Target(
        offset[np.searchsorted(unique, table)], variables.first[member], int(sizes.sum()), int(variables.sigmas.size)
    )
    return PairBlocks(first, second, offset, target)


def group_blocks(groups: Groups) -> Target:
    """Blocks of each group by itself, not shared with others: what a bundle factor of its own needs."""
    pair = np.zeros(int(groups.pair_first[-1]), dtype=np.int64)
    at = 0
    for g in range(groups.pair_first.size - 1):
        width = groups.member_width[groups.member_first[g] : groups.member_first[g + 1]]
        sizes = np.multiply.outer(width, width).ravel()
        pair[groups.pair_first[g] : groups.pair_first[g + 1]] = at + np.cumsum(sizes) - sizes
        at += int(sizes.sum())
    right = np.cumsum(groups.member_width) - groups.member_width
    return Target(pair, right.astype(np.int64), at, int(groups.member_width.sum()))
