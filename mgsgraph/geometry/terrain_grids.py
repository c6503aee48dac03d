"""Terrain grids made of others: tiles put together, heights above the areoid put on top of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid

_ALIGNED = 1e-3
"""Steps within which the posts of two tiles lie on one lattice."""
_ROUNDING = 1e-6
"""Share within which two steps are the same, and a turn is a whole number of them."""


def mosaic(tiles: Sequence[TerrainGrid]) -> TerrainGrid:
    """Tiles with the same steps on one lattice of posts as one grid; NaN where none has a post, the first where two do.

    Raises
    ------
    InputError
        Where tiles have other steps, kinds or sigmas, or posts beside the first tile's lattice.
    """
    if len(tiles) == 1:
        return tiles[0]
    first = tiles[0]
    places = np.array([_place(tile, first) for tile in tiles])
    sizes = np.array([tile.radii.shape for tile in tiles])
    turn = round(2.0 * np.pi / first.longitude_step)
    # the western edge after which all tiles reach least far eastward
    reach = [int(np.max((places[:, 1] - west) % turn + sizes[:, 1])) for west in places[:, 1]]
    west, north = places[int(np.argmin(reach)), 1], int(places[:, 0].min())
    columns, rows = min(min(reach), turn), int((places[:, 0] + sizes[:, 0]).max()) - north
    radii = np.full((rows, columns), np.nan, dtype=np.result_type(*(tile.radii for tile in tiles)))
    for tile, (row, column) in zip(tiles, places.tolist(), strict=True):
        where = slice(row - north, row - north + tile.radii.shape[0])
        across = (column - west + np.arange(tile.radii.shape[1])) % turn
        radii[where, across] = np.where(np.isnan(radii[where, across]), tile.radii, radii[where, across])
    return replace(
        first,
        source=", ".join(dict.fromkeys(tile.source for tile in tiles)),
        radii=radii,
        first_longitude=first.first_longitude + int(west) * first.longitude_step,
        first_latitude=first.first_latitude - north * first.latitude_step,
        wraps=columns == turn and abs(turn * first.longitude_step / (2.0 * np.pi) - 1.0) < _ROUNDING,
    )


def _place(tile: TerrainGrid, first: TerrainGrid) -> tuple[int, int]:
    """Row and column of a tile's first post, counted from the first tile's."""
    where = f"terrain {tile.source}"
    steps = np.array([[grid.longitude_step, grid.latitude_step] for grid in (tile, first)])
    if not np.allclose(steps[0], steps[1], rtol=_ROUNDING, atol=0.0):
        raise InputError(where, "posts at other steps", f"those of {first.source}", "give tiles of one grid")
    if tile.kind != first.kind or tile.gaps is not None:
        raise InputError(where, f"a grid of {tile.kind}", f"one of {first.kind}, as {first.source}")
    shift = np.array([first.first_latitude - tile.first_latitude, tile.first_longitude - first.first_longitude])
    place = shift / steps[1, ::-1]
    if np.any(np.abs(place - np.rint(place)) > _ALIGNED):
        raise InputError(where, "posts between those of the first tile", f"the lattice of {first.source}")
    row, column = np.rint(place).astype(int).tolist()
    return row, column


def above_areoid(heights: TerrainGrid, areoid: TerrainGrid) -> TerrainGrid:
    """Radii of posts whose heights above the areoid a grid has: height plus the areoid's radius at each post.

    Posts beside the areoid's grid become missing ones.
    """
    where = f"terrain {heights.source}"
    if heights.kind != "topography":
        raise InputError(where, f"a grid of {heights.kind}", "heights above the areoid")
    if areoid.kind != "areoid":
        raise InputError(f"terrain {areoid.source}", f"a grid of {areoid.kind}", "a grid of the areoid's radius")
    rows, columns = heights.radii.shape
    longitudes = np.asarray(heights.first_longitude + np.arange(columns) * heights.longitude_step, dtype=np.float64)
    radii = np.empty((rows, columns))
    for i in range(rows):  # a row at a time: the temporaries of a whole grid are ten times as large as it
        latitude = heights.first_latitude - i * heights.latitude_step
        radii[i] = heights.radii[i] + _radius(areoid, longitudes, latitude)
    return replace(heights, source=f"{heights.source} + {areoid.source}", radii=radii, kind="radius")


def _radius(areoid: TerrainGrid, longitudes: Array, latitude: float) -> Array:
    values, _, _ = areoid.radius(longitudes, np.full(longitudes.size, latitude))
    return values
