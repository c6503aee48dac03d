"""The first image over the terrain model: every pixel where the model says its ground is seen."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array
from mgsgraph.matching.patches import Tile, ortho_patch
from mgsgraph.matching.scene import Ground, Picture
from mgsgraph.registration.dem.gridding import HeightGrid
from mgsgraph.registration.dem.map import MapGrid, bilinear
from mgsgraph.workers import Progress, no_progress

_SIDE = 1024
"""pixels of a tile."""
_REACH = 64
"""posts over which holes and the model's rim are filled to project a picture's pixels between them; they stay empty."""


@dataclass(frozen=True, slots=True, eq=False)
class _ModelGround(Ground):
    """The ground as a terrain model has it, over its map."""

    map: MapGrid = field(kw_only=True)
    """Where its posts are."""
    filled: Array = field(kw_only=True)
    """(rows, columns) m above the map's sphere, without holes."""

    def points(self, plane: Array) -> Array:
        """(n, 3) m, body-fixed, at positions (n, 2) of the map."""
        size = np.array(self.filled.shape) - 1.0
        return self.map.points(plane, bilinear(self.filled, np.clip(self.map.pixels(plane), 0.0, size)))


def ortho_tiles(
    picture: Picture, model: HeightGrid, ground: Ground, grid: MapGrid,
    progress: Progress = no_progress,
) -> Iterator[tuple[int, int, NDArray[np.uint8]]]:
    """A picture, with its adjusted orientation, on the pixels of a map, tile after tile.

    `ground` is that known beforehand, of the same body, and `grid` of the same projection as the model's map. Yields
    the first row and column of a tile and its grey values (rows, columns): 1 .. 255 between the picture's levels, 0
    where the model has no height or the picture no pixel.
    """
    over = _ModelGround(
        grid.chart, ground.body, ground.height, ground.height_sigma, map=model.map, filled=_filled(model.heights)
    )
    there = np.isfinite(model.heights)
    corners = [(row, column) for row in range(0, grid.rows, _SIDE) for column in range(0, grid.columns, _SIDE)]
    for k, (row, column) in enumerate(corners):
        rows, columns = min(_SIDE, grid.rows - row), min(_SIDE, grid.columns - column)
        part = MapGrid(
            grid.longitude, grid.latitude, grid.radius, grid.west + column * grid.post, grid.north - row * grid.post,
            grid.post, rows, columns,
        )  # fmt: skip
        inside = _nearest(there, model.map, part)
        west, south = part.west + 0.5 * grid.post, part.north - (rows - 0.5) * grid.post
        patch = ortho_patch(picture, over, Tile(k, west, south, grid.post, rows, columns, 0))
        progress("ortho image", k + 1, len(corners))
        if patch is not None and np.any(inside):
            shown = (patch.valid[::-1] > 0) & inside
            yield row, column, np.where(shown, np.maximum(patch.grey[::-1], 1), 0).astype(np.uint8)


def _nearest(there: NDArray[np.bool_], model: MapGrid, part: MapGrid) -> NDArray[np.bool_]:
    """(rows, columns) whether the post of the model in whose cell each pixel of `part` lies has a height."""
    y = part.north - (np.arange(part.rows) + 0.5) * part.post
    x = part.west + (np.arange(part.columns) + 0.5) * part.post
    rows = np.clip(((model.north - y) / model.post).astype(np.int64), 0, model.rows - 1)
    columns = np.clip(((x - model.west) / model.post).astype(np.int64), 0, model.columns - 1)
    return np.asarray(there[np.ix_(rows, columns)])


def _filled(heights: Array) -> Array:
    """(rows, columns) m without NaN: holes and the rim take the mean of what is next to them, ring by ring; what is
    far away takes the mean of all.
    """
    found = heights.copy()
    for _ in range(_REACH):
        holes = np.isnan(found)
        if not holes.any():
            return found
        padded = np.pad(found, 1, constant_values=np.nan)
        near = [padded[i : i + found.shape[0], j : j + found.shape[1]][holes] for i in range(3) for j in range(3)]
        known = np.isfinite(near)
        count = known.sum(axis=0)
        found[holes] = np.where(count > 0, np.where(known, near, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    return np.where(np.isnan(found), np.nanmean(heights), found)
