"""Features of ortho patches (SIFT; Lowe 2004), and which of two pictures' features belong together.

On a common ground grid the same feature has the same size and direction in every picture, and lies where the geometry
says, but for what is not known of orientation and height: candidates are sought along that short path alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.body import in_turn
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.patches import Patch, Tile, opencv

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
