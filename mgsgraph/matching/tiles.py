"""The ground grid in tiles, and the work on one of them: features of every picture, and the links between them.
Work that is done is kept, so that an interrupted run goes on.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.features import Features, Window, detect, pair_up
from mgsgraph.matching.patches import Tile, ortho_patch
from mgsgraph.matching.scene import Scene

_SIZE = 1024
"""pixels of a tile either way, without its margin."""


class Links(NamedTuple):
    """Positions on the chart at which two pictures show the same ground."""

    plane: Array
    """(n, 2) m of the chart."""
    picture: Index
    """(n,) picture in which each position was found."""
    links: Index
    """(k, 2) numbers of two positions."""
    likeness: Array
    """(k,) the greater, the surer."""


def together(parts: Sequence[Links]) -> Links:
    """Links of several tiles, their positions numbered through."""
    first = np.cumsum([0, *(len(part.plane) for part in parts)])[:-1]
    return Links(
        np.concatenate([np.zeros((0, 2)), *(part.plane for part in parts)]),
        np.concatenate([np.zeros(0, dtype=np.int64), *(part.picture for part in parts)]),
        np.concatenate([np.zeros((0, 2), dtype=np.int64), *(p.links + k for p, k in zip(parts, first, strict=True))]),
        np.concatenate([np.zeros(0), *(part.likeness for part in parts)]),
    )


def tiling(boxes: Sequence[Array], step: float, margin: float) -> list[Tile]:
    """Tiles that cover boxes (2, 2) in m, least and largest x and y of each picture on the chart, and meet two of them
    at least; pixels lie `step` m apart, and neighbouring tiles share `margin` m on every side of their common edge.
    """
    corners = np.array(boxes)
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    extra = int(np.ceil(margin / step))
    counts = np.maximum(np.ceil((high - low) / (_SIZE * step)), 1).astype(int)
    sizes = np.ceil((high - low) / step / counts).astype(int) + 1
    tiles = list[Tile]()
    for row in range(counts[1]):
        for column in range(counts[0]):
            corner = low + np.array([column, row]) * sizes * step
            edges = corner - 0.5 * step, corner + (sizes - 0.5) * step  # of pixels, not of their middles
            meets = np.all((corners[:, 0] <= edges[1]) & (corners[:, 1] >= edges[0]), axis=1)
            if np.count_nonzero(meets) > 1:
                west, south = corner - extra * step
                rows, columns = sizes[1] + 2 * extra, sizes[0] + 2 * extra
                tiles.append(Tile(len(tiles), float(west), float(south), step, int(rows), int(columns), extra))
    return tiles


def features_on(scene: Scene, tile: Tile, wanted: Sequence[int], most: int) -> dict[int, Features]:
    """Features of the wanted pictures that show something of a tile, by number."""
    found = dict[int, Features]()
    for j in wanted:
        patch = ortho_patch(scene.pictures[j], scene.ground, tile)
        if patch is not None:
            features = detect(patch, tile, most)
            if len(features.plane):
                found[j] = features
    return found


def links_on(
    found: Mapping[int, Features], tile: Tile, windows: Mapping[tuple[int, int], Window], ratio: float
) -> Links:
    """Links between the features of each pair that has a window, first features within the tile itself."""
    numbers, begin = dict[int, int](), 0
    for j, features in found.items():
        numbers[j], begin = begin, begin + len(features.plane)
    links, likeness = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)]
    for (i, j), window in windows.items():
        if i in found and j in found:
            first, second, score = pair_up(found[i], found[j], window, tile.step, ratio)
            links.append(np.column_stack([first + numbers[i], second + numbers[j]]))
            likeness.append(score)
    if not numbers:
        return together([])
    plane = np.concatenate([features.plane for features in found.values()])
    picture = np.concatenate([np.full(len(features.plane), j) for j, features in found.items()])
    return owned(Links(plane, picture, np.concatenate(links), np.concatenate(likeness)), tile)


def owned(links: Links, tile: Tile) -> Links:
    """Links whose first position lies in the tile without its margin, and no position without a link."""
    mine = tile.owns(links.plane)[links.links[:, 0]]
    kept = links.links[mine]
    used, numbered = np.unique(kept, return_inverse=True)
    return Links(links.plane[used], links.picture[used], numbered.reshape(-1, 2), links.likeness[mine])


class TileStore(Protocol):
    """Arrays by name, kept from one run to the next with the same inputs and choices."""

    def load(self, name: str) -> dict[str, NDArray[Any]] | None:
        """Arrays that were kept under a name; None where there are none."""
        ...

    def keep(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Keep arrays under a name."""
        ...


def kept_links(store: TileStore | None, name: str, find: Callable[[], Links]) -> Links:
    """Links that an earlier run kept under a name; else those that are found now, and kept."""
    kept = store.load(name) if store else None
    if kept is not None and kept.keys() == set(Links._fields):
        return Links(**kept)
    links = find()
    if store:
        store.keep(name, links._asdict())
    return links
