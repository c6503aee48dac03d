"""Which pictures share ground, and in what order their orientations are brought together."""

from collections.abc import Collection, Iterator, Sequence
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
    prints = footprints(scene)
    found = overlaps(prints)
    if not len(found.pairs):
        names = ", ".join(picture.image.name for picture in scene.pictures[:4])
        raise InputError(
            f"images {names}", "no two of them overlap (by their nominal orientation)", "images of common ground",
            "check the images and their kernels",
        )
    return [Pair(int(i), int(j), float(area)) for (i, j), area in zip(found.pairs, found.areas, strict=True)]


def by_pair(first: Index, other: Index) -> Iterator[tuple[int, int, Index]]:
    """Of pictures (k,) and (k,) each pair that there is, and where."""
    both = np.column_stack([first, other])
    for i, j in np.unique(both, axis=0).tolist():
        yield i, j, np.flatnonzero((first == i) & (other == j))


def footprints(scene: Scene) -> list[Footprint]:
    """Of all pictures, at the height of the ground.

    Raises
    ------
    InputError
        Where a picture has none.
    """
    found = [footprint(picture.image, scene.ground.height, picture.correction) for picture in scene.pictures]
    for one in found:
        if one.outline.shape[0] == 0:
            told = "it sees nothing of the body, or a quarter of the way around it"
            raise InputError(f"image {one.name}", told, "an image of the ground", "leave the image out, or cut it")
    return found


def box(scene: Scene, outline: Array) -> Array:
    """(2, 2) m, least and largest x and y of an outline (k, 3) on the chart."""
    plane = scene.ground.chart.plane(outline)
    return np.stack([plane.min(axis=0), plane.max(axis=0)])


def first_picture(pairs: Sequence[Pair], left: Collection[int]) -> int:
    """Of those that are left the picture that shares most ground."""
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
