"""The ground grid in tiles, and the work on one of them: features of every picture, and the links between them.

Features of ortho patches (SIFT; Lowe 2004), and which of two pictures' features belong together.

On a common ground grid the same feature has the same size and direction in every picture, and lies where the geometry
says, but for what is not known of orientation and height: candidates are sought along that short path alone.

Matches at the nodes of a regular grid, by correlation of windows of two ortho patches, forth and back.

For ground without distinct features, and where an even density matters more than the best points.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import cached_kernel
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import in_turn
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.patches import Patch, Tile, opencv, ortho_patch
from mgsgraph.matching.scene import Scene
from mgsgraph.matching.settings import MatchSettings

_SIZE = 1024
"""pixels of a tile either way, without its margin."""
_CONTRAST = 0.015
"""SIFT's threshold on contrast: half of Lowe's, for evenly lit plains."""
_BORDER = 9
"""pixels which features keep from where a picture ends."""
_BLOCK = 256
"""Features that are compared at a time."""
_SAME = 4.0
"""pixels within which a second-best candidate is the best one over again."""
_TURN, _SCALE = 0.5, 1.6
"""rad and ratio by which direction and size of two features may differ."""


class Features(NamedTuple):
    """Features of one picture on one tile."""

    plane: Array
    """(n, 2) m of the chart."""
    response: NDArray[np.float32]
    """(n,) strength."""
    size: NDArray[np.float32]
    """(n,) pixels of the ground grid."""
    direction: NDArray[np.float32]
    """(n,) rad."""
    descriptors: NDArray[np.float32]
    """(n, 128) of length one (square roots of SIFT's; Arandjelovic & Zisserman 2012)."""


class Window(NamedTuple):
    """Where the counterpart of a feature may lie: about the same position of the chart, farther along one direction."""

    direction: Array
    """(2,) unit, of the displacement by height."""
    along: float
    """m either way."""
    across: float
    """m either way."""


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


# --- features


def detect(patch: Patch, tile: Tile, most: int) -> Features:
    """The strongest features of a patch, in order of y."""
    cv2 = opencv()
    block = np.ones((2 * _BORDER + 1,) * 2, np.uint8)
    inner = cv2.erode(patch.valid, block, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=_CONTRAST)
    found, descriptors = sift.detectAndCompute(patch.grey, inner)
    if not found:
        nothing = np.zeros(0, dtype=np.float32)
        return Features(np.zeros((0, 2)), nothing, nothing, nothing, np.zeros((0, 128), dtype=np.float32))
    rows = np.array([(*one.pt, one.response, one.size, one.angle) for one in found])
    order = np.argsort(rows[:, 1], kind="stable")
    rows, descriptors = rows[order], descriptors[order]
    unit = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))
    thin = rows.astype(np.float32)
    return Features(tile.plane(rows[:, 0], rows[:, 1]), thin[:, 2], thin[:, 3], np.radians(thin[:, 4]), unit)


def pair_up(one: Features, other: Features, window: Window, step: float, ratio: float) -> tuple[Index, Index, Array]:
    """Numbers (k,) of features of both pictures that choose each other, each against its second choice, and the cosines
    (k,) of their descriptors.

    The window says where the other's may lie, seen from the first; `step` is the ground grid's pixel in m, and `ratio`
    the most that the distance of the best may be of the second best's.
    """
    forth, likeness = _best(one, other, window, step, ratio)
    back, _ = _best(other, one, window, step, ratio)
    first = np.flatnonzero(forth >= 0)
    first = first[back[forth[first]] == first]
    return first, forth[first], likeness[first]


def _best(one: Features, other: Features, window: Window, step: float, ratio: float) -> tuple[Index, Array]:
    """For each feature the one that is most like it in its window, -1 where there is none or not a clear one."""
    best, likeness = np.full(len(one.plane), -1, dtype=np.int64), np.zeros(len(one.plane))
    if len(other.plane) == 0:
        return best, likeness
    reach = abs(window.direction[1]) * window.along + abs(window.direction[0]) * window.across
    for begin in range(0, len(one.plane), _BLOCK):
        some = slice(begin, min(begin + _BLOCK, len(one.plane)))
        y = one.plane[some, 1]
        low, high = np.searchsorted(other.plane[:, 1], [y[0] - reach, y[-1] + reach])
        if low == high:
            continue
        near = slice(int(low), int(high))
        alike = one.descriptors[some] @ other.descriptors[near].T
        alike[~_candidates(one, other, some, near, window)] = -1.0
        top = np.argmax(alike, axis=1)
        rows = np.arange(top.size)
        score = alike[rows, top].copy()
        apart = np.linalg.norm(other.plane[near][None] - other.plane[near][top][:, None], axis=2) > _SAME * step
        second = np.where(apart, alike, -1.0).max(axis=1)
        # distances of unit vectors: d^2 = 2 - 2 cos
        clear = (score > 0.0) & ((1.0 - score) <= ratio**2 * (1.0 - second))
        best[begin + rows[clear]] = low + top[clear]
        likeness[begin + rows[clear]] = score[clear]
    return best, likeness


def _candidates(one: Features, other: Features, some: slice, near: slice, window: Window) -> NDArray[np.bool_]:
    away = other.plane[near][None] - one.plane[some][:, None]
    along = away @ window.direction
    across = away @ np.array([-window.direction[1], window.direction[0]])
    turn = np.abs(in_turn((other.direction[near][None] - one.direction[some][:, None]).astype(np.float64)))
    scale = np.abs(np.log(other.size[near][None] / one.size[some][:, None]))
    inside = (np.abs(along) <= window.along) & (np.abs(across) <= window.across)
    return np.asarray(inside & (turn <= _TURN) & (scale <= np.log(_SCALE)))


# --- on a regular grid


_Grey = NDArray[np.uint8]

_BESIDE = 2
"""pixels about the best shift that count as the same."""
_BACK = 1.0
"""pixels by which the way back may miss."""


class _Peaks(NamedTuple):
    """Best shifts of windows."""

    shifts: Index
    """(n, 2) rows and columns."""
    best: Array
    """(n,) correlation there; -1 where no shift could be tried."""
    second: Array
    """(n,) the best correlation elsewhere."""


def links_on_grid(
    scene: Scene, tile: Tile, near: Sequence[int], windows: Mapping[tuple[int, int], Window], settings: MatchSettings
) -> Links:
    """Links from the nodes of a grid on the ground in each pair's first picture to where the other is most alike."""
    patches = {j: p for j in near if (p := ortho_patch(scene.pictures[j], scene.ground, tile)) is not None}
    spacing = settings.spacing or 2.0 * settings.half_window * tile.step
    if spacing < tile.step:
        stated = f"{spacing:g} m between nodes on a ground grid of {tile.step:.3g} m"
        raise InputError("matching, spacing", stated, "at least a pixel of the ground grid")
    rows, columns = (axis.ravel() for axis in np.meshgrid(*tile.nodes(spacing), indexing="ij"))
    nodes = {j: k for k, j in enumerate(patches)}
    plane = [np.tile(tile.plane(columns.astype(float), rows.astype(float)), (len(patches), 1))]
    picture = [np.repeat(list(patches), rows.size).astype(np.int64)]
    links, likeness = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)]
    count = rows.size * len(patches)
    for (i, j), window in windows.items():
        if i not in patches or j not in patches:
            continue
        reach = _reach(window, tile.step)
        chosen, shifts, score = matched_nodes(patches[i], patches[j], rows, columns, reach, settings)
        found = np.column_stack([columns[chosen] + shifts[:, 1], rows[chosen] + shifts[:, 0]]).astype(float)
        plane.append(tile.plane(*found.T))
        picture.append(np.full(chosen.size, j))
        links.append(np.column_stack([nodes[i] * rows.size + chosen, count + np.arange(chosen.size)]))
        likeness.append(score)
        count += chosen.size
    if not patches:
        return together([])
    return owned(
        Links(np.concatenate(plane), np.concatenate(picture), np.concatenate(links), np.concatenate(likeness)), tile
    )


def _reach(window: Window, step: float) -> tuple[int, int]:
    """Rows and columns either way of the box around a window."""
    x, y = np.abs(window.direction)
    columns, rows = window.along * x + window.across * y, window.along * y + window.across * x
    return int(np.ceil(rows / step)), int(np.ceil(columns / step))


def matched_nodes(
    one: Patch, other: Patch, rows: Index, columns: Index, reach: tuple[int, int], settings: MatchSettings
) -> tuple[Index, Index, Array]:
    """Nodes whose best shift is good, clearly better than any other, and the same on the way back; shifts, scores."""
    half = settings.half_window
    there = _Peaks(*correlation_peaks(one.grey, one.valid, other.grey, other.valid, rows, columns, half, *reach))
    good = there.best >= settings.least_correlation
    good &= (1.0 - there.best) <= settings.ratio * (1.0 - there.second)
    chosen = np.flatnonzero(good)
    shifts = there.shifts[chosen]
    back = _Peaks(*correlation_peaks(
        other.grey, other.valid, one.grey, one.valid, rows[chosen] + shifts[:, 0], columns[chosen] + shifts[:, 1], half,
        *reach,
    ))  # fmt: skip
    same = np.all(np.abs(back.shifts + shifts) <= _BACK, axis=1) & (back.best >= settings.least_correlation)
    return chosen[same], shifts[same], there.best[chosen][same]


@cached_kernel
def correlation_peaks(
    grey: _Grey, valid: _Grey, other: _Grey, other_valid: _Grey, rows: Index, columns: Index, half: int,
    reach_rows: int, reach_columns: int,
) -> tuple[Index, Array, Array]:  # fmt: skip
    """Of windows about n nodes: the shift of best correlation (n, 2) in pixels, its score and the next best one's."""
    n = rows.size
    shifts = np.zeros((n, 2), dtype=np.int64)
    best, second = np.full(n, -1.0), np.full(n, -1.0)
    scores = np.empty((2 * reach_rows + 1, 2 * reach_columns + 1))
    for k in range(n):
        r, c = rows[k], columns[k]
        mean, spread = _moments(grey, valid, r, c, half)
        if spread <= 0.0:
            continue
        for i in range(-reach_rows, reach_rows + 1):
            for j in range(-reach_columns, reach_columns + 1):
                score = _alike(grey, other, other_valid, r, c, i, j, half, mean, spread)
                scores[i + reach_rows, j + reach_columns] = score
                if score > best[k]:
                    best[k], shifts[k, 0], shifts[k, 1] = score, i, j
        for i in range(-reach_rows, reach_rows + 1):
            for j in range(-reach_columns, reach_columns + 1):
                if abs(i - shifts[k, 0]) > _BESIDE or abs(j - shifts[k, 1]) > _BESIDE:
                    second[k] = max(second[k], scores[i + reach_rows, j + reach_columns])
    return shifts, best, second


@cached_kernel
def _moments(grey: _Grey, valid: _Grey, r: int, c: int, half: int) -> tuple[float, float]:
    """Mean and root of the sum of squares about it of a window; (0, -1) where it leaves the picture."""
    if r < half or c < half or r + half >= grey.shape[0] or c + half >= grey.shape[1]:
        return 0.0, -1.0
    total, square = 0.0, 0.0
    for i in range(r - half, r + half + 1):
        for j in range(c - half, c + half + 1):
            if valid[i, j] == 0:
                return 0.0, -1.0
            total += grey[i, j]
            square += float(grey[i, j]) * grey[i, j]
    count = (2 * half + 1) ** 2
    return total / count, math.sqrt(max(square - total * total / count, 0.0))


@cached_kernel
def _alike(
    grey: _Grey, other: _Grey, valid: _Grey, r: int, c: int, i: int, j: int, half: int, mean: float, spread: float
) -> float:
    """Correlation of a window with the other patch's, shifted by (i, j); -1 where that leaves its picture."""
    _, their_spread = _moments(other, valid, r + i, c + j, half)
    if their_spread <= 0.0:
        return -1.0
    product = 0.0
    for a in range(-half, half + 1):
        for b in range(-half, half + 1):
            product += (grey[r + a, c + b] - mean) * other[r + i + a, c + j + b]
    return product / (spread * their_spread)
