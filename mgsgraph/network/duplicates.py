"""Observations that a network holds twice under different names: the adjustment takes them for independent, and sigmas
shrink by up to the square root of two.

Values are compared to within their rounding. What is only near (another feature half a pixel away, the five spots of a
LOLA shot, two tracks that cross) is another observation.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mgsgraph.geometry.plausibility import duplicate_images
from mgsgraph.geometry.records import Array, Index, finite_rows
from mgsgraph.network.network import Network
from mgsgraph.network.records import PointClass
from mgsgraph.record import Record
from mgsgraph.text import NAMED, many, some

_PIXELS = 0.02
"""By which pixels of one measurement differ, in line and in sample: twice what rounding to two decimals does."""
_SECONDS = 5e-3
"""By which times of one shot differ: LOLA's next one follows after 36 ms, MOLA's after 100 ms."""
_METERS = 0.1
"""By which ranges of one shot differ: rounding to decimeters."""
_ROUNDED = 0.01
"""By which a-priori places of one shot differ, in distances between shots: five decimals of a degree are 0.4 m at most,
0.2 m on the Moon, and MOLA's shots are 300 m apart, LOLA's spots 25 m."""
_PROCESSED = 0.3
"""The same where time and range agree: the places may be those of two processings. Spots of one LOLA shot, which have
its time and on level ground the same range, are 0.7 apart."""
_CHANCE = 4e-4
"""Share of shots, three times that of neighbors which are so near by chance where tracks lie across each other: fewer
pairs without times say nothing, but for those at one and the same place."""
_SPARSE = 300.0
"""m, distance between shots at the most, that of MOLA's: few shots far from each other say nothing of rounding."""
_CONTROL = 0.5
"""m, by which places of one control point differ at the most: five decimals of a degree."""
_SLANT = np.array([1.0, 0.5 * (np.sqrt(5.0) - 1.0)])
"""Direction along which pixels are sorted. Along lines, or samples, those of ties on an even grid would coincide."""
_SAMPLE = 1000
"""Places from which the usual distance to neighbors is taken."""
_NEIGHBORS = 8
"""Of a place, itself among them, with which it is compared."""


class DuplicateKind(StrEnum):
    """What is given twice."""

    TIE = "tie point"
    SHOT = "laser shot"
    CONTROL = "control point"
    IMAGE = "image"


@dataclass(frozen=True, slots=True, eq=False)
class Duplicates(Record):
    """Observations of one kind that are given more than once."""

    kind: DuplicateKind
    """Of which kind."""
    first: Index
    """(p,) ground point, or image, that stands first of those that are one."""
    again: Index
    """(p,) the same under another name: each stands here once, so that p are superfluous."""
    names: tuple[tuple[str, str], ...]
    """Of some of them: the first, and again."""
    total: int
    """Of how many: points of the class, or images."""

    @property
    def count(self) -> int:
        """How many are superfluous."""
        return self.again.size

    @property
    def sentence(self) -> str:
        """What was found, and what to do."""
        verb = "is" if self.count == 1 else "are"
        named = some([f"{again} is {first}" for first, again in self.names], self.count)
        return (
            f"{many(self.count, self.kind)} of {self.total} {verb} given a second time under another name ({named}): "
            "give each observation once, the sigmas shrink as if they were independent"
        )


def duplicates(network: Network, since: int = 0) -> tuple[Duplicates, ...]:
    """What a network holds twice: a record for each kind that occurs.

    Parameters
    ----------
    network : Network
    since : int
        First ground point that is new; of the earlier ones, which were looked at before, nothing is said.
    """
    points, records = network.points, list[Duplicates]()
    for kind, of_class, pairs in (
        (DuplicateKind.TIE, PointClass.TIE, _ties(network)), (DuplicateKind.SHOT, PointClass.LASER, _shots(network)),
        (DuplicateKind.CONTROL, PointClass.CONTROL, _control(network)),
    ):  # fmt: skip
        first, again = joined_pairs(pairs)
        first, again = first[again >= since], again[again >= since]
        names = tuple(zip(points.ids[first[:NAMED]], points.ids[again[:NAMED]], strict=True))
        records.append(Duplicates(kind, first, again, names, int(np.count_nonzero(points.classes == of_class))))
    images = network.image_names
    first, again = joined_pairs(np.array(duplicate_images(network.images), dtype=np.int64).reshape(-1, 2))
    names = tuple((images[j], images[k]) for j, k in zip(first[:NAMED].tolist(), again[:NAMED].tolist(), strict=True))
    records.append(Duplicates(DuplicateKind.IMAGE, first, again, names, len(images)))
    return tuple(record for record in records if record.count)


def joined_pairs(pairs: Index) -> tuple[Index, Index]:
    """Of pairs (p, 2) that are one: the first of all that they join (q,), and (q,) each other one, ascending."""
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    members, number = np.unique(pairs, return_inverse=True)
    edges = tuple(number.reshape(-1, 2).T.astype(np.int32))
    label = connected_components(coo_array((np.ones(len(pairs)), edges), (members.size,) * 2), directed=False)[1]
    first = members[np.unique(label, return_index=True)[1]][label]
    return first[members > first], members[members > first]


def _ties(network: Network) -> Index:
    """Pairs of points, one of them a tie point, that are measured at the same pixels."""
    classes, rays = network.points.classes, network.rays
    measured = np.isin(classes, (PointClass.TIE, PointClass.CONTROL))[rays.point]
    pairs = measured_twice(rays.point[measured], rays.image[measured], rays.places[measured])
    return np.asarray(pairs[np.any(classes[pairs] == PointClass.TIE, axis=1)])


def measured_twice(point: Index, image: Index, places: Array) -> Index:
    """Pairs of points (p, 2), ascending, with the same pixels in two images, or in all images of one of the two.

    One pixel in common is none: ties of the pairs A, B and A, C may begin at one feature of A.

    Parameters
    ----------
    point, image : (k,)
        Of each measurement.
    places : (k, 2)
        Line and sample.
    """
    along = places @ _SLANT
    along += image * (np.ptp(along) + 1.0 if along.size else 1.0)  # images one after the other
    order = np.argsort(along)
    along, pairs = along[order], list[Index]()
    size, images = int(point.max(initial=0)) + 1, int(image.max(initial=0)) + 1
    ahead, step = np.arange(order.size), 1
    while ahead.size:
        ahead = ahead[: np.searchsorted(ahead, order.size - step)]
        ahead = ahead[along[ahead + step] - along[ahead] <= _PIXELS * _SLANT.sum()]
        first, second = order[ahead], order[ahead + step]
        same = np.all(np.abs(places[first] - places[second]) <= _PIXELS, axis=1) & (point[first] != point[second])
        ends = np.sort(np.stack([point[first[same]], point[second[same]]]), axis=0)
        pairs.append((ends[0] * size + ends[1]) * images + image[first[same]])
        step += 1
    pair, common = np.unique(np.unique(np.concatenate(pairs or [point])) // images, return_counts=True)
    ends = np.stack(np.divmod(pair, size), axis=1)
    measured = np.bincount(point, minlength=size)[ends].min(axis=1)
    return np.asarray(ends[common >= np.minimum(2, measured)])


def _shots(network: Network) -> Index:
    """Pairs of laser shots with the same time, range and about the same place; without times with the same place."""
    ranges, n = network.ranges, len(network.points)
    time, distance = np.full((2, n), np.nan)
    time[ranges.point], distance[ranges.point] = ranges.times, ranges.values
    pairs, ratios = _neighbors(network, PointClass.LASER, _PROCESSED, _SPARSE)
    later, farther = (np.abs(values[pairs[:, 0]] - values[pairs[:, 1]]) for values in (time, distance))
    placed = np.isnan(later) & (ratios <= _ROUNDED / _PROCESSED)
    if np.count_nonzero(placed) <= _CHANCE * np.count_nonzero(network.points.classes == PointClass.LASER):
        placed &= ratios == 0.0
    return np.asarray(pairs[placed | ((later <= _SECONDS) & (farther <= _METERS))])


def _control(network: Network) -> Index:
    """Pairs of control points at the same place."""
    return _neighbors(network, PointClass.CONTROL, _ROUNDED, _CONTROL / _ROUNDED)[0]


def _neighbors(network: Network, of_class: PointClass, share: float, most: float) -> tuple[Index, Array]:
    """Pairs (p, 2) of points of a class that are closer than a share of the distance between neighbors, which is taken
    for `most` m at the most; and (p,) by how much of that.
    """
    from scipy.spatial import cKDTree  # slow to import

    places = network.points.places
    members = np.flatnonzero((network.points.classes == of_class) & finite_rows(places))
    if not members.size:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    tree = cKDTree(places[members])
    # to the third neighbor: where all are given twice, or three times, that is still another one
    third = tree.query(places[members[:: -(-members.size // _SAMPLE)]], 4)[0][:, 3]
    reach = share * min(float(np.median(third)), most)
    distances, neighbor = tree.query(places[members], _NEIGHBORS, distance_upper_bound=np.nextafter(reach, np.inf))
    row, column = np.nonzero((neighbor < members.size) & (neighbor > np.arange(members.size)[:, None]))
    return np.stack([members[row], members[neighbor[row, column]]], axis=1), distances[row, column] / max(reach, 1e-300)
