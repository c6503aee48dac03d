"""How the images of a network are connected: by common points, by overlapping footprints, and where that is weak."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.footprint import Footprint, footprint, gaps, overlaps
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network.links import bridges_and_cuts, groups, spine
from mgsgraph.network.network import Network
from mgsgraph.network.records import PointClass


@dataclass(frozen=True, slots=True, eq=False)
class Connectivity:
    """Which images share points, which overlap, and which links the block can't do without."""

    footprints: tuple[Footprint, ...]
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
    cut_images: Index
    """Images without which their island falls apart."""
    spine: Index
    """Rows of `pairs`: for each island the links that hold it together best (maximum spanning tree), weakest first.
    Two parts that one of them joins have no pair with more points in common."""

    @property
    def names(self) -> tuple[str, ...]:
        """(images) their names."""
        return tuple(one.name for one in self.footprints)

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
    def apart(self) -> Index:
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


def connectivity(network: Network, footprints: Sequence[Footprint], used: Mask | None = None) -> Connectivity:
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
    if tuple(one.name for one in footprints) != tuple(image.name for image in network.images):
        raise InputError("connectivity", f"footprints of {len(footprints)} images", "one of each image, in order")
    m = len(footprints)
    linked, shared = _common_by_class(network, used)
    found = overlaps(footprints)
    meet = (found.pairs[:, 0] < found.pairs[:, 1]) & (found.areas > 0.0)
    apart = linked[:, 0] < linked[:, 1]
    codes, meeting = linked @ [m, 1], found.pairs[meet] @ [m, 1]
    every = np.unique(np.concatenate([codes[apart], meeting]))
    pairs = np.stack(np.divmod(every, m), axis=1)
    areas, share, common = np.zeros(every.size), np.zeros(every.size), np.zeros((every.size, len(PointClass)), int)
    at = np.searchsorted(every, meeting)
    areas[at], share[at] = found.areas[meet], found.shares[meet]
    common[np.searchsorted(every, codes[apart])] = shared[apart]
    distances = np.zeros(len(pairs))
    distances[areas == 0.0] = gaps(footprints, pairs[areas == 0.0])
    points, seen = common.sum(axis=1), np.zeros(m, dtype=np.int64)
    seen[linked[~apart, 0]] = shared[~apart].sum(axis=1)
    bridges, cut_images = bridges_and_cuts(m, pairs, points > 0)
    return Connectivity(
        footprints=tuple(footprints),
        seen=seen,
        pairs=pairs,
        common=common,
        areas=areas,
        shares=share,
        gaps=distances,
        islands=tuple(groups(m, pairs[points > 0])),
        bridges=bridges,
        cut_images=cut_images,
        spine=spine(m, pairs, points),
    )


def network_footprints(
    network: Network, places: Array, correction: Callable[[int], OrientationCorrection | None] | None = None
) -> tuple[Footprint, ...]:
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
    heights = geodetic(places, network.images[0].body)[:, 2]
    known = np.isfinite(heights)
    everywhere = float(np.median(heights[known])) if np.any(known) else 0.0
    found, order = [], np.argsort(network.rays.image, kind="stable")
    ends = np.cumsum(np.bincount(network.rays.image, minlength=len(network.images)))
    of_images = np.split(heights[network.rays.point[order]], ends[:-1])
    for j, (image, mine) in enumerate(zip(network.images, of_images, strict=True)):
        mine = mine[np.isfinite(mine)]
        height = float(np.median(mine)) if mine.size else everywhere
        found.append(footprint(image, height, correction(j) if correction else None))
    return tuple(found)


def common_points(network: Network, used: Mask | None = None) -> Index:
    """(images, images) number of points seen by both; on the diagonal, seen by the image. `used` as above."""
    pairs, shared = _common_by_class(network, used)
    common = np.zeros((len(network.images),) * 2, dtype=np.int64)
    common[tuple(pairs.T)] = shared.sum(axis=1)
    return np.asarray(common + np.triu(common, 1).T)


def islands(network: Network, used: Mask | None = None) -> list[list[int]]:
    """Groups of images that are connected by common points, largest first; more than one means a broken block."""
    pairs = _common_by_class(network, used)[0]
    return [list(group) for group in groups(len(network.images), pairs[pairs[:, 0] < pairs[:, 1]])]


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
    codes, counts = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for lag in range(m):
        first, second = slice(0, point.size - lag), slice(lag, None)
        same = point[first] == point[second]
        if not np.any(same):
            break
        pair = ((image[first] * m + image[second]) * classes + of_class[first])[same]
        found, count = np.unique(pair, return_counts=True)
        codes.append(found)
        counts.append(count)
    every = np.concatenate(codes)
    pairs, row = np.unique(every // classes, return_inverse=True)
    common = np.zeros((pairs.size, classes), dtype=np.int64)
    np.add.at(common, (row, every % classes), np.concatenate(counts))
    return np.stack(np.divmod(pairs, m), axis=1), common
