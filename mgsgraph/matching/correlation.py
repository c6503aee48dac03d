"""Matches at the nodes of a regular grid, by correlation of windows of two ortho patches, forth and back.

For ground without distinct features, and where an even density matters more than the best points.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.compiled import cached_kernel
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.features import Window
from mgsgraph.matching.patches import Patch, Tile, ortho_patch
from mgsgraph.matching.scene import Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.matching.tiles import Links, owned, together

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
