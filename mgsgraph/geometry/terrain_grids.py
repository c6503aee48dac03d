"""Terrain grids made of others: mosaics of tiles, and sums of the areoid and heights above it.

Errors of a terrain model between the tracks that made it: MEGDR interpolates posts in whose cells no shot fell.

How much linear interpolation misses is seen where there are shots: of posts at equal distances d along a track, in a
row or column of the grid, z(0) - (z(-d) + z(d)) / 2, robustly (Cressie & Hawkins 1980), at d of 1, 2, 4, ... posts. It
grows as a power of the distance, V(d) = a d^p, with p = 2 H of a surface with Hurst's exponent H (p = 4 where it is
smooth). A post between two tracks d1 and d2 away, m = (d1 + d2) / 2, has

    sigma^2 = a m^p (d1 d2 / m^2)^min(p, 2),

which is V in the middle, the Brownian bridge's for p = 1, and within 2 % of what a power law's variogram gives for
linear interpolation at p = 1.4. In terms of its structure function D(d) = E (z(0) - z(d))^2, V(d) = D(d) (1 - 2^p / 4):
a half of it for p = 1, a third for p = 1.4. The tracks are looked for along rows, columns and diagonals, and the best
of the four counts. Beyond the last track a post counts as the middle of a gap twice as wide: D(d) is about that.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.terrain import Gaps, TerrainGrid

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
    require(heights.kind == "topography", where, f"a grid of {heights.kind}", "heights above the areoid")
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


# --- errors between the tracks that made a model

_LEAST = 24
"""Posts between two others from which a distance tells something."""
_STEEPEST = 4.0
"""Power of the distance by which a smooth surface leaves its chords."""
_FLATTEST = 0.2
"""Least power that is believed."""


def track_gaps(grid: TerrainGrid, counts: TerrainGrid) -> Gaps:
    """Errors of a grid's posts by interpolation between tracks, from the number of shots in each cell.

    Raises
    ------
    InputError
        Where the two grids have different posts, or too few posts with shots lie in line.
    """
    if not grid.same_posts(counts):
        raise InputError(f"terrain {counts.source}", "other posts", f"those of {grid.source}", "give its counts")
    shots = (np.nan_to_num(np.asarray(counts.radii, dtype=np.float64)) > 0.0) & np.isfinite(grid.radii)
    if np.all(shots | np.isnan(grid.radii)):
        return Gaps(np.zeros(shots.shape), np.zeros(shots.shape))
    radius = float(np.nanmean(grid.radii))
    latitudes = grid.first_latitude - np.arange(shots.shape[0]) * grid.latitude_step
    east, south = grid.longitude_step * np.cos(latitudes) * radius, grid.latitude_step * radius
    size, power = _misfit(np.asarray(grid.radii, dtype=np.float64), shots, (south, float(np.mean(east))), counts.source)
    farthest = float(np.hypot(shots.shape[0] * south, shots.shape[1] * east.max()))
    least, reaches = np.full(shots.shape, np.inf), np.zeros(shots.shape)
    for before, after, step in _tracks(shots, east, south):
        farther, nearest = np.maximum(before, after) * step, np.minimum(np.minimum(before, after) * step, farthest)
        one_sided = np.isinf(farther)
        half = np.where(one_sided, 2.0 * nearest, 0.5 * (nearest + farther))
        middle = np.where(one_sided, 1.0, nearest * np.where(one_sided, 1.0, farther) / np.maximum(half, 1.0) ** 2)
        variance = size * half**power * middle ** min(power, 2.0)
        better = variance < least
        least[better], reaches[better] = variance[better], half[better]
    least[shots], reaches[shots] = 0.0, 0.0
    return Gaps(np.sqrt(least), reaches)


def _misfit(radii: Array, shots: Mask, steps: tuple[float, float], source: str) -> tuple[float, float]:
    """A in m^(2 - p) and p of what linear interpolation over a half distance misses, by posts with shots in line."""
    sampled = np.where(shots, radii, np.nan)
    distances, variances, numbers = list[float](), list[float](), list[int]()
    for axis, step in enumerate(steps):
        values, lag = np.moveaxis(sampled, axis, 0), 1
        while 2 * lag < values.shape[0]:
            missed = values[lag:-lag] - 0.5 * (values[: -2 * lag] + values[2 * lag :])
            missed = np.abs(missed[np.isfinite(missed)])
            if missed.size >= _LEAST:
                fourth = np.mean(np.sqrt(missed)) ** 4
                distances.append(lag * step)
                variances.append(max(float(fourth / (0.457 + 0.494 / missed.size)), 1e-6))
                numbers.append(missed.size)
            lag *= 2
    if len(set(distances)) < 2:
        raise InputError(
            source, "hardly any posts with shots in line", "tracks that make posts beside each other",
            "say counts = false, and a vertical_sigma_m that holds between the tracks",
        )  # fmt: skip
    distance, variance = np.log(np.stack([distances, variances]))
    power = float(np.polyfit(distance, variance, 1, w=np.sqrt(numbers))[0])
    power = min(max(power, _FLATTEST), _STEEPEST)
    return float(np.exp(np.average(variance - power * distance, weights=numbers))), power


def _tracks(shots: Mask, east: Array, south: float) -> Iterator[tuple[Array, Array, Array]]:
    """Along rows, columns and both diagonals: (rows, columns) posts to the next one with shots on either side, infinite
    where there is none, and (rows, 1) m between posts.
    """
    steps = np.stack([east, np.full(east.size, south), np.hypot(east, south), np.hypot(east, south)])[:, :, None]
    for way, step in zip(((0, 1), (1, 0), (1, 1), (1, -1)), steps, strict=True):
        yield _next(shots, way), _next(shots[::-1, ::-1], way)[::-1, ::-1], step


def _next(shots: Mask, way: tuple[int, int]) -> Array:
    """(rows, columns) posts back along a way, 0 or 1 rows and -1 to 1 columns a step, to one with shots."""
    rows, along = (shots, way[1]) if way[0] else (shots.T, 0)
    steps = np.where(rows, 0.0, np.inf)
    for i in range(1, len(steps)):
        before = np.pad(steps[i - 1], 1, constant_values=np.inf)[1 - along :][: steps.shape[1]]
        steps[i] = np.minimum(steps[i], before + 1.0)
    return steps if way[0] else steps.T
