"""How the images of a network are connected: by common points, by overlapping footprints, and where that is weak."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.network.network import Network
from mgsgraph.network.records import PointClass
from mgsgraph.text import NAMED, many, some, span
from mgsgraph.units import KM

if TYPE_CHECKING:
    from scipy.sparse import coo_array

    from mgsgraph.geometry.footprint import Footprint


def _graph(nodes: int, edges: Index, weights: Array) -> "coo_array":
    """Edges (p, 2) with weights (p,)."""
    from scipy.sparse import coo_array  # slow to import

    # older versions of csgraph take no other indices than of 32 bits
    return coo_array((weights, tuple(np.asarray(edges, dtype=np.int32).reshape(-1, 2).T)), (nodes, nodes))


def groups(images: int, pairs: Index) -> list[tuple[int, ...]]:
    """Images that pairs (p, 2) join, largest group first, then by their first image."""
    from scipy.sparse.csgraph import connected_components  # slow to import

    number = connected_components(_graph(images, pairs, np.ones(len(pairs))), directed=False)[1]
    parts = np.split(np.argsort(number, kind="stable"), np.flatnonzero(np.diff(np.sort(number))) + 1)
    return sorted(map(tuple, map(np.ndarray.tolist, sorted(parts, key=lambda group: group[0]))), key=len, reverse=True)


def spine(images: int, pairs: Index, points: Index) -> Index:
    """Rows of the maximum spanning tree of each island by common points, weakest first."""
    from scipy.sparse.csgraph import minimum_spanning_tree  # slow to import

    rows = np.argsort(-points, kind="stable")
    rows = rows[points[rows] > 0]
    ranks = _graph(images, pairs[rows], np.arange(1.0, rows.size + 1.0))
    return rows[np.sort(minimum_spanning_tree(ranks).data).astype(np.int64)[::-1] - 1]


def bridges(images: int, pairs: Index, linked: Mask, tree: Index) -> Mask:
    """(p,) links whose loss splits an island: rows of its spanning `tree` that no other link goes around.

    Every other link marks both its images with one random number. The exclusive or of all marks in a branch of the tree
    is that of the links that lead out of it: zero where there are none.
    """
    from scipy.sparse.csgraph import breadth_first_order  # slow to import

    marks = np.where(linked, np.random.default_rng(0).integers(1, 2**63, len(pairs)), 0)
    marks[tree] = 0
    branch = np.zeros(images + 1, dtype=np.int64)
    for side in pairs.T:
        np.bitwise_xor.at(branch, side, marks)
    roots = [(group[0], images) for group in groups(images, pairs[tree])]  # of all islands in one tree
    edges = np.concatenate([pairs[tree], roots])
    order, parent = breadth_first_order(_graph(images + 1, edges, np.ones(len(edges))), images, directed=False)
    for image in order[:0:-1].tolist():
        branch[parent[image]] ^= branch[image]
    splitting = np.zeros(len(pairs), dtype=bool)
    first, second = pairs[tree].T
    splitting[tree] = branch[np.where(parent[first] == second, first, second)] == 0
    return splitting


@dataclass(frozen=True, slots=True, eq=False)
class Connectivity:
    """Which images share points, which overlap, and which links the block can't do without."""

    footprints: tuple["Footprint", ...]
    """Of all images."""
    seen: Index
    """(images,) number of points that each image measures."""
    pairs: Index
    """(p, 2) images that share points or overlap, the smaller index first, in order."""
    common: Index
    """(p, classes) number of points they share, by PointClass."""
    areas: Array
    """(p,) m^2, by which they overlap."""
    shares: Array
    """(p,) of the smaller footprint, 0 .. 1."""
    gaps: Array
    """(p,) m between footprints that don't meet; zero where they do, NaN for an image that sees nothing of it."""
    islands: tuple[tuple[int, ...], ...]
    """Images that are connected by common points, largest island first."""
    bridges: Mask
    """(p,) True for a pair whose common points alone join two parts of the block."""
    spine: Index
    """Rows of `pairs`: for each island the links that hold it together best (maximum spanning tree), weakest first.
    Two parts that one of them joins have no pair with more points in common."""

    @property
    def names(self) -> tuple[str, ...]:
        """(images) their names."""
        return tuple(footprint.name for footprint in self.footprints)

    @property
    def points(self) -> Index:
        """(p,) number of points each pair shares."""
        return np.asarray(self.common.sum(axis=1))

    @property
    def links(self) -> Index:
        """Rows of pairs that share points."""
        return np.flatnonzero(self.points > 0)

    @property
    def untied(self) -> Index:
        """Rows of pairs that overlap and share nothing: ties could be measured there. Largest area first."""
        rows = np.flatnonzero((self.points == 0) & (self.areas > 0.0))
        return rows[np.argsort(-self.areas[rows], kind="stable")]

    @property
    def disjoint(self) -> Index:
        """Rows of pairs that share points though their footprints don't meet: a blunder, perhaps. Widest gap first."""
        rows = np.flatnonzero((self.points > 0) & (self.gaps > 0.0))
        return rows[np.argsort(-self.gaps[rows], kind="stable")]

    @property
    def unconnected(self) -> Index:
        """Images that share no point with any other."""
        joined = np.zeros(len(self.footprints), dtype=bool)
        joined[self.pairs[self.links]] = True
        return np.flatnonzero(~joined)

    def cut_off(self, row: int) -> tuple[int, ...]:
        """Images of the smaller part that falls off when a bridge, one of the pairs, goes; none for another pair."""
        if not self.bridges[row]:
            return ()
        links = self.links[self.links != row]
        parts = groups(len(self.footprints), self.pairs[links])
        return min((part for part in parts if np.isin(self.pairs[row], part).any()), key=len)

    def __repr__(self) -> str:
        return (
            f"Connectivity({len(self.footprints)} images, {self.links.size} links, {len(self.islands)} islands, "
            f"{np.count_nonzero(self.bridges)} bridges, {self.untied.size} overlaps without common points)"
        )


def connectivity(network: Network, footprints: Sequence["Footprint"], used: Mask | None = None) -> Connectivity:
    """How the images of a network are connected.

    Parameters
    ----------
    network : Network
        Who sees what.
    footprints : sequence of Footprint
        Of all images, in their order.
    used : (rays,), optional
        False for rays that don't count (rejected ones).
    """
    if tuple(footprint.name for footprint in footprints) != tuple(network.image_names):
        raise InputError("connectivity", f"footprints of {len(footprints)} images", "one of each image, in order")
    m = len(footprints)
    linked, shared = _common_by_class(network, used)
    from mgsgraph.geometry.footprint import gaps, overlaps  # shapely takes its time

    overlapping = overlaps(footprints)
    meet = (overlapping.pairs[:, 0] < overlapping.pairs[:, 1]) & (overlapping.areas > 0.0)
    different = linked[:, 0] < linked[:, 1]
    codes, meeting = linked @ [m, 1], overlapping.pairs[meet] @ [m, 1]
    union = np.unique(np.concatenate([codes[different], meeting]))
    pairs = np.stack(np.divmod(union, m), axis=1)
    areas, share, common = np.zeros(union.size), np.zeros(union.size), np.zeros((union.size, len(PointClass)), int)
    at = np.searchsorted(union, meeting)
    areas[at], share[at] = overlapping.areas[meet], overlapping.shares[meet]
    common[np.searchsorted(union, codes[different])] = shared[different]
    distances = np.zeros(len(pairs))
    distances[areas == 0.0] = gaps(footprints, pairs[areas == 0.0])
    points, seen = common.sum(axis=1), np.zeros(m, dtype=np.int64)
    seen[linked[~different, 0]] = shared[~different].sum(axis=1)
    tree = spine(m, pairs, points)
    return Connectivity(
        footprints=tuple(footprints),
        seen=seen,
        pairs=pairs,
        common=common,
        areas=areas,
        shares=share,
        gaps=distances,
        islands=tuple(groups(m, pairs[points > 0])),
        bridges=bridges(m, pairs, points > 0, tree),
        spine=tree,
    )


def network_footprints(
    network: Network, places: Array, correction: Callable[[int], OrientationCorrection | None] | None = None
) -> tuple["Footprint", ...]:
    """Footprints of all images, each at the middle height of the points that it measures.

    Parameters
    ----------
    network : Network
        Whose images.
    places : (n, 3)
        m, of its ground points; NaN where unknown.
    correction : callable, optional
        The orientation correction of an image, None for none; nominal when absent.
    """
    from mgsgraph.geometry.footprint import footprint  # shapely takes its time

    heights = ellipsoidal_heights(places, network.body)
    finite = np.isfinite(heights)
    everywhere = float(np.median(heights[finite])) if np.any(finite) else 0.0
    footprints, order = [], np.argsort(network.rays.image, kind="stable")
    ends = np.cumsum(np.bincount(network.rays.image, minlength=len(network.images)))
    of_images = np.split(heights[network.rays.point[order]], ends[:-1])
    for j, (image, of_image) in enumerate(zip(network.images, of_images, strict=True)):
        of_image = of_image[np.isfinite(of_image)]
        height = float(np.median(of_image)) if of_image.size else everywhere
        footprints.append(footprint(image, height, correction(j) if correction else None))
    return tuple(footprints)


def _common_by_class(network: Network, used: Mask | None) -> tuple[Index, Index]:
    """(p, 2) pairs of images that see common points, the smaller number first, and each image with itself; and (p,
    classes) how many of each class.
    """
    m, rays, classes = len(network.images), network.rays, len(PointClass)
    counted = slice(None) if used is None else used
    # a table of points x images, or of images x images, would outgrow the memory: go through the pairs of each point
    code = np.sort(rays.point[counted] * m + rays.image[counted])
    point, image = np.divmod(code[np.append(True, code[1:] != code[:-1])[: code.size]], m)
    of_class = network.points.classes[point]
    codes, counts = [no_rows()], [no_rows()]
    for lag in range(m):
        first, second = slice(0, point.size - lag), slice(lag, None)
        same = point[first] == point[second]
        if not np.any(same):
            break
        pair = ((image[first] * m + image[second]) * classes + of_class[first])[same]
        unique, count = np.unique(pair, return_counts=True)
        codes.append(unique)
        counts.append(count)
    union = np.concatenate(codes)
    pairs, row = np.unique(union // classes, return_inverse=True)
    common = np.zeros((pairs.size, classes), dtype=np.int64)
    np.add.at(common, (row, union % classes), np.concatenate(counts))
    return np.stack(np.divmod(pairs, m), axis=1), common


WEAKEST = 5
"""Joints named as the weakest."""
SLIVER = 0.02
"""Share of the smaller footprint below which an overlap is not worth ties."""


def connectivity_json(connected: Connectivity) -> dict[str, Any]:
    """What the block can't do without, and where it could be tied, as plain values; the pairs are in the table."""
    names = connected.names
    return {
        "links": int(connected.links.size),
        "weakest_joints": [_pair(connected, row) for row in connected.spine[:WEAKEST].tolist()],
        "bridges": [_pair(connected, row) for row in np.flatnonzero(connected.bridges).tolist()],
        "unconnected_images": [names[j] for j in connected.unconnected] if len(names) > 1 else [],
        "overlaps_without_common_points": [_pair(connected, row) for row in lacking_ties(connected).tolist()],
        "common_points_without_overlap": [_pair(connected, row) for row in connected.disjoint.tolist()],
    }


def _pair(connected: Connectivity, row: int) -> dict[str, Any]:
    i, j = connected.pairs[row].tolist()
    return {
        "images": [connected.names[i], connected.names[j]],
        "common_points": int(connected.points[row]),
        "overlap_km2": float(connected.areas[row]) / KM**2,
        "overlap_share": float(connected.shares[row]),
        "gap_km": float(connected.gaps[row]) / KM,
    }


def lacking_ties(connected: Connectivity) -> Index:
    """Rows of pairs that share no points but ground, slivers left out; largest area first."""
    return connected.untied[connected.shares[connected.untied] >= SLIVER]


def connectivity_statements(connected: Connectivity) -> list[str]:
    """Sentences: how many links, the weakest one, islands, overlaps without ties, ties without overlap."""
    if len(connected.names) < 2:
        return []
    return [*link_statement(connected), *connectivity_warnings(connected)]


def connectivity_warnings(connected: Connectivity) -> list[str]:
    """Sentences about islands, and pairs of images whose points and footprints disagree."""
    warnings, names = list[str](), connected.names
    if len(connected.islands) > 1:
        parts = [f"({some([names[j] for j in island[:NAMED]], len(island))})" for island in connected.islands[:NAMED]]
        warnings.append(
            f"The block is split into {len(connected.islands)} parts without common points: "
            f"{some(parts, len(connected.islands))}. Measure tie points between them."
        )
    if (rows := lacking_ties(connected)).size:
        overlap = [_overlap(connected, row).replace(" and overlap", "") for row in rows[:NAMED]]
        verb = "overlaps" if rows.size == 1 else "overlap"
        warnings.append(
            f"{many(rows.size, 'pair')} of images {verb} without any common point: "
            f"{_named(connected, rows, overlap)}. Measure ties there."
        )
    if (rows := connected.disjoint).size:
        gaps_of = [
            f" ({many(int(connected.points[row]), 'point')}, {connected.gaps[row] / KM:.3g} km apart)"
            for row in rows[:NAMED]
        ]
        warnings.append(
            f"{many(rows.size, 'pair')} of images {'has' if rows.size == 1 else 'have'} common points, but separate "
            f"footprints: {_named(connected, rows, gaps_of)}. Check these points and the orientation."
        )
    return warnings


def link_statement(connected: Connectivity) -> list[str]:
    """Sentences about all links and the weakest joint; none without links."""
    points, links = connected.points, connected.links
    if links.size == 0:
        return []
    if links.size == 1:
        row = int(links[0])
        return [f"{_both(connected, row)} have {many(int(points[row]), 'point')} in common{_overlap(connected, row)}."]
    what = "the block" if len(connected.islands) == 1 else "an island"
    row = int(connected.spine[0])
    return [
        f"{len(connected.names)} images, {links.size} pairs with {span(points[links])} common points (median "
        f"{np.median(points[links]):.0f}).",
        f"Every split of {what} is bridged by at least {many(int(points[row]), 'point')}; weakest link: "
        f"{_weak(connected, row)}.",
    ]


def _weak(connected: Connectivity, row: int) -> str:
    text = f"{_both(connected, row)}, {many(int(connected.points[row]), 'point')}"
    lost = connected.cut_off(row)
    if not lost or len(connected.names) == 2:
        return text
    whose = connected.names[lost[0]] if len(lost) == 1 else f"{len(lost)} images"
    return f"{text}, the only link of {whose} to the rest"


def _both(connected: Connectivity, row: int) -> str:
    return " and ".join(connected.names[j] for j in connected.pairs[row])


def _named(connected: Connectivity, rows: Index, notes: Sequence[str]) -> str:
    """The first pairs of images, each with what is said of it."""
    named = "; ".join(f"{_both(connected, row)}{more}" for row, more in zip(rows.tolist(), notes, strict=False))
    return named + (f" and {rows.size - NAMED} more" if rows.size > NAMED else "")


def _overlap(connected: Connectivity, row: int) -> str:
    area, share = float(connected.areas[row]) / KM**2, float(connected.shares[row])
    return f" and overlap by {area:.4g} km^2, {100.0 * share:.0f} % of the smaller one" if area > 0.0 else ""
