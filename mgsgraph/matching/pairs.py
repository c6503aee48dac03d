"""Which pictures share ground, in what order their orientations are brought together, and matches of pairs joined over
images: no track has two pixels in one image.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.footprint import Footprint, footprint, overlaps
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.scene import Scene


class Pair(NamedTuple):
    """Two pictures that share ground."""

    first: int
    second: int
    area: float
    """m^2 that they share."""


def pairs_of(scene: Scene) -> list[Pair]:
    """Pairs that share ground by their nominal orientation.

    Raises
    ------
    InputError
        Where there is none.
    """
    found = overlaps(footprints(scene))
    if not len(found.pairs):
        raise InputError(
            scene.where, "no two of them overlap (by their nominal orientation)", "images of common ground",
            "check the images and their kernels",
        )
    return [Pair(int(i), int(j), float(area)) for (i, j), area in zip(found.pairs, found.areas, strict=True)]


def by_pair(first: Index, other: Index) -> Iterator[tuple[int, int, Index]]:
    """Each pair of pictures among `first` and `other` (k,), with its rows (m,)."""
    both = np.column_stack([first, other])
    for i, j in np.unique(both, axis=0).tolist():
        yield i, j, np.flatnonzero((first == i) & (other == j))


def footprints(scene: Scene) -> list[Footprint]:
    """Footprints of all pictures, at the height of the ground.

    Raises
    ------
    InputError
        Where a picture has none.
    """
    found = [footprint(picture.image, scene.ground.height, picture.correction) for picture in scene.pictures]
    for one in found:
        if one.outline.shape[0] == 0:
            seen = "it sees nothing of the body, or a quarter of the way around it"
            raise InputError(f"image {one.name}", seen, "an image of the ground", "leave the image out, or cut it")
    return found


def boxes(scene: Scene) -> list[Array]:
    """(2, 2) m, least and largest x and y of each picture's footprint on the chart."""
    planes = [scene.ground.chart.plane(one.outline) for one in footprints(scene)]
    return [np.stack([plane.min(axis=0), plane.max(axis=0)]) for plane in planes]


def first_picture(pairs: Sequence[Pair], left: Collection[int]) -> int:
    """Of the pictures that are left, the one that shares most ground."""
    return max(left, key=lambda j: (sum(pair.area for pair in pairs if j in pair[:2]), -j))


def next_pair(
    pairs: Sequence[Pair], there: Collection[int], left: Collection[int], tried: Collection[Pair]
) -> Pair | None:
    """The largest overlap of a picture that is there already (first) with one that is left (second), but for pairs that
    were tried (Prim 1957); None where there is none.
    """
    turned = (Pair(j, i, area) if i in left else Pair(i, j, area) for i, j, area in pairs)
    open_pairs = [pair for pair in turned if pair.first in there and pair.second in left and pair not in tried]
    return max(open_pairs, key=lambda pair: pair.area) if open_pairs else None


def joined(links: Index, likeness: Array, picture_of: Index) -> list[list[int]]:
    """Features joined by links (k, 2), the surest first; a link that would bring two features of one picture together,
    or contradicts a surer one, is left out: so a contradictory track falls apart at its weakest link.

    `likeness` (k,) says how sure each link is, `picture_of` (n,) the picture of each feature. Returns the features of
    each track, at least two, by picture.
    """
    track_of = dict[int, int]()
    tracks = dict[int, list[int]]()
    for k in np.argsort(-likeness, kind="stable").tolist():
        one, other = int(links[k, 0]), int(links[k, 1])
        ours, theirs = (_track(feature, track_of, tracks) for feature in (one, other))
        if ours == theirs:
            continue
        if {int(picture_of[f]) for f in tracks[ours]} & {int(picture_of[f]) for f in tracks[theirs]}:
            continue
        for feature in tracks[theirs]:
            track_of[feature] = ours
        tracks[ours] += tracks.pop(theirs)
    return [sorted(track, key=lambda f: int(picture_of[f])) for track in tracks.values() if len(track) > 1]


def _track(feature: int, track_of: dict[int, int], tracks: dict[int, list[int]]) -> int:
    if feature not in track_of:
        track_of[feature] = feature
        tracks[feature] = [feature]
    return track_of[feature]


def star(tracks: Iterable[list[int]]) -> tuple[Index, Index, Index]:
    """Tracks as links from a first feature to each other one: number of the track, first and other feature (k,)."""
    rows = [(t, track[0], other) for t, track in enumerate(tracks) for other in track[1:]]
    numbers = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return numbers[:, 0], numbers[:, 1], numbers[:, 2]
