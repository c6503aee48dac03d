"""Ground points to a regular grid of heights with sigmas (`surface` has the mathematics)."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record
from mgsgraph.registration.dem.map import MapGrid
from mgsgraph.registration.dem.points import DensePoints
from mgsgraph.workers import Progress, no_progress

_REACH = 1.5
"""Distances between points up to which they count for a post."""
_POOL = 2
"""posts to each side over which relief is pooled: seven points know it to a third, those of 25 posts to a tenth."""
_MANY = 25
"""Points of one post that know it well enough by themselves."""
_ROWS_AT_ONCE = 64
"""Rows that a thread fits before it takes others."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid(Record):
    """A terrain model on the posts of a map; NaN where there is none."""

    map: MapGrid
    """Where its posts are."""
    heights: Array
    """(rows, columns) m above the map's sphere."""
    matching: Array
    """(rows, columns) m, sigma by matching and by relief between the points: independent beyond a matching window."""
    orientation: Array
    """(rows, columns) m, sigma by the adjusted orientation, for sigma0 = 1: common to neighbours."""
    counts: NDArray[np.int32]
    """(rows, columns) points that each height is of; 0 where there is none."""

    @property
    def sigmas(self) -> Array:
        """(rows, columns) m, of the heights, both parts."""
        return np.hypot(self.matching, self.orientation)

    @property
    def slopes(self) -> Array:
        """(rows, columns, 2) m per m, eastward and northward, between the neighbours of each post; NaN at the edges."""
        found = np.full((*self.heights.shape, 2), np.nan)
        found[:, 1:-1, 0] = (self.heights[:, 2:] - self.heights[:, :-2]) / (2.0 * self.map.post)
        found[1:-1, :, 1] = (self.heights[:-2] - self.heights[2:]) / (2.0 * self.map.post)
        return found


def gridded(
    points: DensePoints, grid: MapGrid, spacing: float, window: float, workers: int | None = None,
    progress: Progress = no_progress,
) -> HeightGrid:
    """Heights at the posts of a map, from points that are about `spacing` m apart.

    Matching errors of points that are nearer than `window` m, the width of the windows that were matched, are
    correlated. Posts far apart are chosen from a finer grid, which has those of the points around each: a wider plane
    would be that of the ground in between, and what scatters about it says little of its height at the post. `workers`
    is the number of threads, one per processor when None.

    InputError where no post has points on all sides.
    """
    if not (np.isfinite(spacing) and spacing > 0.0 and np.isfinite(window) and window > 0.0):
        raise InputError("terrain model", f"points every {spacing} m, windows of {window} m", "positive numbers")
    parts = _parts(grid.post / spacing)
    finer = replace(grid, post=grid.post / parts, rows=parts * grid.rows, columns=parts * grid.columns)
    found = _fitted(points, finer, spacing, window, workers, progress)
    height, variance, orientation, count, excess, freedom, squares = np.moveaxis(found, 2, 0)
    relief = np.where(count < _MANY, _pooled(excess) / _pooled(freedom), excess / freedom)
    matching = np.sqrt(variance + np.maximum(relief, 0.0) * (1.0 + squares))
    bands = [height, matching, orientation, np.nan_to_num(count).astype(np.int32)]
    middle = slice(parts // 2, None, parts)
    height, matching, orientation, count = (np.ascontiguousarray(band[middle, middle]) for band in bands)
    if not np.any(count):
        few = f"{len(points)} points, nowhere several around a post"
        where = f"terrain model with posts every {grid.post:g} m"
        raise InputError(where, few, "points on all sides", "give a smaller --post, or images that match better")
    return HeightGrid(grid, height, matching, orientation, count)


def _parts(ratio: float) -> int:
    """Into how many posts, an odd number, one that is `ratio` as wide as points are apart is divided."""
    return 1 + 2 * max(round((ratio - 1.0) / 2.0), 0)


def _fitted(
    points: DensePoints, grid: MapGrid, spacing: float, window: float, workers: int | None,
    progress: Progress,
) -> Array:
    """(rows, columns, COLUMNS) of the kernel, which works with the post as its unit of length."""
    from mgsgraph.registration.dem.surface import COLUMNS, surface  # numba takes its time to load

    found = np.full((grid.rows, grid.columns, COLUMNS), np.nan)
    kernel_input = _by_cell(points, grid)

    def fit(first: int) -> None:
        last = min(first + _ROWS_AT_ONCE, grid.rows)
        surface(
            first, last, grid.columns, *kernel_input, _REACH * spacing / grid.post, window / grid.post, found
        )

    blocks = range(0, grid.rows, _ROWS_AT_ONCE)
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        for done, _ in enumerate(pool.map(fit, blocks), start=1):
            progress("gridding", min(done * _ROWS_AT_ONCE, grid.rows), grid.rows)
    return found


def _by_cell(points: DensePoints, grid: MapGrid) -> tuple[NDArray[np.int64], Array, Array, Array, NDArray[np.int64]]:
    """What the kernel takes: first point of each cell, positions, covariances along the map's axes in posts, pairs."""
    pixels = grid.pixels(grid.chart.plane(points.positions))
    nearest = np.rint(pixels).astype(np.int64)
    inside = np.all((nearest >= 0) & (nearest < [grid.rows, grid.columns]), axis=1)
    cell = nearest[inside, 0] * grid.columns + nearest[inside, 1]
    order = np.flatnonzero(inside)[np.argsort(cell, kind="stable")]
    first = np.zeros(grid.rows * grid.columns + 1, dtype=np.int64)
    np.cumsum(np.bincount(cell, minlength=grid.rows * grid.columns), out=first[1:])
    positions = points.positions[order]
    frame = grid.frames(positions) / np.array([grid.post, grid.post, 1.0])[:, None]
    spread = np.einsum("nij,nj->ni", frame, points.matching[order])
    orientation = frame @ points.orientation[order] @ np.swapaxes(frame, 1, 2)
    heights = np.linalg.norm(positions, axis=1) - grid.radius
    return first, np.column_stack([pixels[order], heights]), spread, orientation, points.pair[order]


def _pooled(values: Array) -> Array:
    """(rows, columns) sums over the neighbourhood of each post, NaN counting for nothing; NaN where it was."""
    from scipy.ndimage import convolve1d  # takes half a second

    whole, ones = np.nan_to_num(values), np.ones(2 * _POOL + 1)
    for axis in (0, 1):
        whole = convolve1d(whole, ones, axis, mode="constant")
    return np.where(np.isfinite(values), whole, np.nan)
