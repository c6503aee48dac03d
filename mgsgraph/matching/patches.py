"""Pictures resampled onto tiles of the ground grid: one scale, one direction, and hardly any displacement left; and the
disparities that are left, where rows run along the parallax, by semi-global matching.

Features of the patches (SIFT; Lowe 2004), and links between those of two pictures: on a common ground grid the same
feature has the same size and direction in every picture, and lies where the geometry says, but for what is not known of
orientation and height. Candidates are sought along that short path alone.

Hirschmueller, H. (2008): Stereo processing by semiglobal matching and mutual information, IEEE PAMI 30(2); OpenCV's,
with Birchfield & Tomasi's cost of horizontal gradients, to which other brightness and contrast don't matter.
"""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import library
from mgsgraph.geometry.body import in_turn
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs, finite_rows, joined_rows
from mgsgraph.geometry.terrain import refined
from mgsgraph.matching.scene import Ground, Picture, Scene

NODE = 16
"""pixels of the ground grid between the nodes that are projected; between nodes, lines and samples are bilinear."""
_SKIPS = 2.0
"""A picture's pixels in one of the ground grid from which on a cubic skips some."""
_BLUR, _UNBLURRED = 0.5, 1e-3
"""Sigma of the filter then, in pixels of the ground grid, and in pixels of one that does nothing."""
_REMAP_LIMIT = 30_000
"""pixels; OpenCV's remap takes pictures of less than 32,768 lines and samples."""


def has_opencv() -> bool:
    """Whether OpenCV is installed, the extra "match"."""
    return find_spec("cv2") is not None


def opencv() -> ModuleType:
    """OpenCV, which only matching needs; InputError where it is not installed, or cannot be loaded."""
    return library("cv2", "match", "matching", "OpenCV")


class Tile(NamedTuple):
    """A rectangle of the ground grid, with a margin in which neighbouring tiles' features are found too."""

    number: int
    west: float
    """m, x of the first column's pixels."""
    south: float
    """m, y of the first row's; rows go along the flight."""
    step: float
    """m between pixels."""
    rows: int
    columns: int
    margin: int
    """pixels on every side that belong to the tile's neighbours."""

    def plane(self, columns: Array, rows: Array) -> Array:
        """(n, 2) m of the chart, of pixel centres counted from zero."""
        return np.column_stack([self.west + columns * self.step, self.south + rows * self.step])

    def nodes(self, spacing: float) -> tuple[Index, Index]:
        """Rows and columns (m,) and (k,) of the pixels next to the lines of a grid that all tiles share."""
        axes = []
        for start, count in ((self.south, self.rows), (self.west, self.columns)):
            lines = np.arange(np.ceil(start / spacing), (start + (count - 1) * self.step) / spacing) * spacing
            axes.append(np.rint((lines - start) / self.step).astype(np.int64))
        return axes[0], axes[1]

    def owns(self, plane: Array) -> Mask:
        """(n,) which positions (n, 2) of the chart lie in the tile without its margin."""
        column, row = (plane[:, 0] - self.west) / self.step, (plane[:, 1] - self.south) / self.step
        inside = (column >= self.margin - 0.5) & (column < self.columns - self.margin - 0.5)
        return np.asarray(inside & (row >= self.margin - 0.5) & (row < self.rows - self.margin - 0.5))


class Patch(NamedTuple):
    """A picture on a tile."""

    grey: NDArray[np.uint8]
    """(rows, columns), stretched between the picture's levels."""
    valid: NDArray[np.uint8]
    """(rows, columns), 255 where the picture has pixels."""


def ortho_patch(picture: Picture, ground: Ground, tile: Tile) -> Patch | None:
    """A picture on a tile; None where it shows nothing of it."""
    cv2 = opencv()
    nodes, levels = node_pixels(picture, ground, tile), picture.levels
    size = np.array([picture.image.lines, picture.image.samples], dtype=np.float64)
    touched = np.all((nodes > -2.0 * NODE) & (nodes < size + 2.0 * NODE), axis=2)
    if not touched.any():
        return None
    lines, samples = (refined(nodes[:, :, k], NODE)[: tile.rows, : tile.columns] for k in (0, 1))
    inside = (lines > 0.5) & (lines < size[0] - 0.5) & (samples > 0.5) & (samples < size[1] - 0.5)
    if not inside.any():
        return None
    first = int(max(np.floor(lines[inside].min()) - 4, 0))
    last = min(int(np.ceil(lines[inside].max())) + 4, first + _REMAP_LIMIT)
    inside &= lines < last - 0.5
    part = picture.pixels[first:last].astype(np.float32)
    hollow = ~np.isfinite(part)
    if hollow.any():
        part[hollow] = levels[0]
    blur = blur_sigmas(nodes)
    if any(blur):
        part = cv2.GaussianBlur(part, (0, 0), sigmaX=max(blur[1], _UNBLURRED), sigmaY=max(blur[0], _UNBLURRED))
    down, across = (lines - 0.5 - first).astype(np.float32), (samples - 0.5).astype(np.float32)
    grey = cv2.remap(part, across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    if hollow.any():
        reach = [3 + 2 * int(np.ceil(2.0 * sigma)) for sigma in blur]  # a cubic's one pixel, and the filter's
        wide = cv2.dilate(hollow.astype(np.float32), np.ones(reach, np.uint8))
        dead = cv2.remap(wide, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        inside &= dead == 0
    stretched = np.clip((grey - levels[0]) * (255.0 / (levels[1] - levels[0])), 0.0, 255.0).astype(np.uint8)
    return Patch(np.where(inside, stretched, 0).astype(np.uint8), np.where(inside, 255, 0).astype(np.uint8))


def node_pixels(picture: Picture, ground: Ground, tile: Tile) -> Array:
    """(rows', columns', 2) line and sample of every sixteenth pixel, beyond the tile's last one; NaN where unseen."""
    columns, rows = (np.arange(-(-count // NODE) + 1) * float(NODE) for count in (tile.columns, tile.rows))
    points = ground.points(tile.plane(*all_pairs(columns, rows).T))
    return picture.project(points).reshape(rows.size, columns.size, 2)


def blur_sigmas(nodes: Array) -> tuple[float, float]:
    """Sigmas in lines and samples of the filter of a picture much finer than the ground grid: unfiltered, the grid's
    pixels would skip most of the picture's, and show their noise and aliases instead. Zero where none is needed.
    """
    steps = [np.abs(np.diff(nodes, axis=k)).reshape(-1, 2) / NODE for k in (0, 1)]
    finite = [step[finite_rows(step)] for step in steps]
    if not (len(finite[0]) and len(finite[1])):
        return 0.0, 0.0
    lines, samples = np.hypot(*(np.median(step, axis=0) for step in finite)).tolist()
    sigmas = [_BLUR * float(np.sqrt(size**2 - 1.0)) if size > _SKIPS else 0.0 for size in (lines, samples)]
    return sigmas[0], sigmas[1]


# --- disparities

MOST = 128
"""pixels, disparities either way that are tried at once."""
_BLOCK = 7
"""pixels of a window's side."""
_SMALL, _LARGE = 8, 32
"""Penalties of a disparity that changes by one pixel or by more, per pixel of a window."""
_UNIQUE = 5
"""per cent by which the best cost has to be better than any other."""
_SPECKLE, _SPECKLE_RANGE = 200, 2
"""pixels: a patch of fewer, that its neighbours differ from by more, is a mismatch."""
_SIXTEENTHS = 16.0
"""OpenCV counts disparities in sixteenths of a pixel."""


def disparities(left: Patch, right: Patch, reach: int) -> Array:
    """(rows, columns) d, pixels: what `left` shows in a column lies in `right`, in the same row, d columns before.

    NaN where nothing is alike enough, or a patch has no picture. `reach` is the most that d may be either way, pixels.
    """
    cv2 = opencv()
    most = min(int(reach), MOST)
    count = -(-2 * most // 16) * 16
    matcher = cv2.StereoSGBM_create(
        minDisparity=-count // 2, numDisparities=count, blockSize=_BLOCK, P1=_SMALL * _BLOCK**2, P2=_LARGE * _BLOCK**2,
        disp12MaxDiff=1, preFilterCap=31, uniquenessRatio=_UNIQUE, speckleWindowSize=_SPECKLE,
        speckleRange=_SPECKLE_RANGE, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    shifts = cv2.medianBlur(matcher.compute(left.grey, right.grey), 5).astype(np.float64) / _SIXTEENTHS
    valid = (shifts >= -count / 2) & (left.valid > 0)
    return np.where(valid, shifts, np.nan)


# --- features and links
_SIZE = 1024
"""pixels of a tile either way, without its margin."""
_CONTRAST = 0.015
"""SIFT's threshold on contrast: half of Lowe's, for evenly lit plains."""
_BORDER = 9
"""pixels which features keep from where a picture ends."""
_AT_ONCE = 256
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


def concatenated(parts: Sequence[Links]) -> Links:
    """Links of several tiles, their positions numbered through."""
    first = np.cumsum([0, *(len(part.plane) for part in parts)])[:-1]
    return Links(
        np.concatenate([np.zeros((0, 2)), *(part.plane for part in parts)]),
        joined_rows(part.picture for part in parts),
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


def features_on(scene: Scene, tile: Tile, pictures: Sequence[int], most: int) -> dict[int, Features]:
    """Features of the wanted pictures that show something of a tile, by number."""
    by_picture = dict[int, Features]()
    for j in pictures:
        patch = ortho_patch(scene.pictures[j], scene.ground, tile)
        if patch is not None:
            features = detect(patch, tile, most)
            if len(features.plane):
                by_picture[j] = features
    return by_picture


def links_on(
    by_picture: Mapping[int, Features], tile: Tile, windows: Mapping[tuple[int, int], Window], ratio: float
) -> Links:
    """Links between the features of each pair that has a window, first features within the tile itself."""
    numbers, begin = dict[int, int](), 0
    for j, features in by_picture.items():
        numbers[j], begin = begin, begin + len(features.plane)
    links, likeness = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)]
    for (i, j), window in windows.items():
        if i in by_picture and j in by_picture:
            first, second, score = pair_up(by_picture[i], by_picture[j], window, tile.step, ratio)
            links.append(np.column_stack([first + numbers[i], second + numbers[j]]))
            likeness.append(score)
    if not numbers:
        return concatenated([])
    plane = np.concatenate([features.plane for features in by_picture.values()])
    picture = np.concatenate([np.full(len(features.plane), j) for j, features in by_picture.items()])
    return owned(Links(plane, picture, np.concatenate(links), np.concatenate(likeness)), tile)


def owned(links: Links, tile: Tile) -> Links:
    """Links whose first position lies in the tile without its margin, and no position without a link."""
    inside = tile.owns(links.plane)[links.links[:, 0]]
    pairs = links.links[inside]
    used, numbered = np.unique(pairs, return_inverse=True)
    return Links(links.plane[used], links.picture[used], numbered.reshape(-1, 2), links.likeness[inside])


# --- features


def detect(patch: Patch, tile: Tile, most: int) -> Features:
    """The strongest features of a patch, in order of y."""
    cv2 = opencv()
    block = np.ones((2 * _BORDER + 1,) * 2, np.uint8)
    inner = cv2.erode(patch.valid, block, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=_CONTRAST)
    keypoints, descriptors = sift.detectAndCompute(patch.grey, inner)
    if not keypoints:
        nothing = np.zeros(0, dtype=np.float32)
        return Features(np.zeros((0, 2)), nothing, nothing, nothing, np.zeros((0, 128), dtype=np.float32))
    rows = np.array([(*keypoint.pt, keypoint.response, keypoint.size, keypoint.angle) for keypoint in keypoints])
    order = np.argsort(rows[:, 1], kind="stable")
    rows, descriptors = rows[order], descriptors[order]
    unit = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))
    thin = rows.astype(np.float32)
    return Features(tile.plane(rows[:, 0], rows[:, 1]), thin[:, 2], thin[:, 3], np.radians(thin[:, 4]), unit)


def pair_up(left: Features, right: Features, window: Window, step: float, ratio: float) -> tuple[Index, Index, Array]:
    """Numbers (k,) of features of both pictures that choose each other, each against its second choice, and the cosines
    (k,) of their descriptors.

    The window says where the other's may lie, seen from the first; `step` is the ground grid's pixel in m, and `ratio`
    the most that the distance of the best may be of the second best's.
    """
    forth, likeness = _best(left, right, window, step, ratio)
    back, _ = _best(right, left, window, step, ratio)
    first = np.flatnonzero(forth >= 0)
    first = first[back[forth[first]] == first]
    return first, forth[first], likeness[first]


def _best(left: Features, right: Features, window: Window, step: float, ratio: float) -> tuple[Index, Array]:
    """For each feature the one that is most like it in its window, -1 where there is none or not a clear one."""
    best, likeness = np.full(len(left.plane), -1, dtype=np.int64), np.zeros(len(left.plane))
    if len(right.plane) == 0:
        return best, likeness
    reach = abs(window.direction[1]) * window.along + abs(window.direction[0]) * window.across
    for begin in range(0, len(left.plane), _AT_ONCE):
        some = slice(begin, min(begin + _AT_ONCE, len(left.plane)))
        y = left.plane[some, 1]
        low, high = np.searchsorted(right.plane[:, 1], [y[0] - reach, y[-1] + reach])
        if low == high:
            continue
        near = slice(int(low), int(high))
        cosines = left.descriptors[some] @ right.descriptors[near].T
        cosines[~_candidates(left, right, some, near, window)] = -1.0
        top = np.argmax(cosines, axis=1)
        rows = np.arange(top.size)
        score = cosines[rows, top].copy()
        distinct = np.linalg.norm(right.plane[near][None] - right.plane[near][top][:, None], axis=2) > _SAME * step
        second = np.where(distinct, cosines, -1.0).max(axis=1)
        # distances of unit vectors: d^2 = 2 - 2 cos
        clear = (score > 0.0) & ((1.0 - score) <= ratio**2 * (1.0 - second))
        best[begin + rows[clear]] = low + top[clear]
        likeness[begin + rows[clear]] = score[clear]
    return best, likeness


def _candidates(left: Features, right: Features, some: slice, near: slice, window: Window) -> Mask:
    away = right.plane[near][None] - left.plane[some][:, None]
    along = away @ window.direction
    across = away @ np.array([-window.direction[1], window.direction[0]])
    turn = np.abs(in_turn((right.direction[near][None] - left.direction[some][:, None]).astype(np.float64)))
    scale = np.abs(np.log(right.size[near][None] / left.size[some][:, None]))
    inside = (np.abs(along) <= window.along) & (np.abs(across) <= window.across)
    return np.asarray(inside & (turn <= _TURN) & (scale <= np.log(_SCALE)))
