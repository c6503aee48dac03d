"""Posts of terrain models as points of a network: what a laser shot is, ground that is known but for what all posts of
the model are off in common.

A post stands for the mean height of its cell. Where cells are smaller than what images can show, posts are averaged to
cells as large as that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import SPOT_WIDTHS, footprint_covariances
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.network import Network
from mgsgraph.network.records import GroundPoints, PointClass, ProfileShifts
from mgsgraph.network.shared import SharedUnknown
from mgsgraph.ties import PointKind

PLACE_SIGMA = 0.1
"""m, a-priori, east and north of each post by itself: files round longitudes and latitudes so."""
_WIDTH = SPOT_WIDTHS / np.sqrt(12.0)
"""Diameter of the Gaussian footprint (four standard deviations) that is as wide as a square cell, in sides of it."""
_LEAST_SHARE = 0.5
"""Of a cell's posts that have to be there."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainModel:
    """A terrain model whose place as a whole is unknown."""

    name: str
    """What reports call it."""
    grid: TerrainGrid
    """Radii, with their sigma and that of their common horizontal place."""
    height_sigma: float | None = None
    """m, a-priori, of its height as a whole, which is an unknown; None where that is known."""

    def __post_init__(self) -> None:
        if self.grid.planimetric_sigma is None:
            raise InputError(f"terrain {self.grid.source}", "no sigma of its horizontal place", "metres, above zero")


class Posts(NamedTuple):
    """Posts of one terrain model, or means of some of them."""

    ids: tuple[str, ...]
    """(n) names: that of the model, row and column."""
    points: Array
    """(n, 3) m, body-fixed."""
    sigmas: Array
    """(n,) m, of the heights."""
    footprint: float
    """m, diameter of the Gaussian footprint that stands for a cell."""

    def chosen(self, which: Index) -> "Posts":
        """Some of them."""
        ids = tuple(self.ids[i] for i in which.tolist())
        return Posts(ids, self.points[which], self.sigmas[which], self.footprint)


def posts_of(model: TerrainModel, least: float) -> Posts:
    """Posts of a terrain model by rows from the north; m by n of them averaged to one where a cell would be smaller
    than `least`, m. The posts' errors count as independent, and so a mean's sigma is theirs by the root of m n.

    Raises
    ------
    InputError
        Where a post's sigma is unknown.
    """
    grid = model.grid
    rows, columns = grid.radii.shape
    narrower = np.cos(grid.first_latitude - 0.5 * (rows - 1) * grid.latitude_step)
    sides = float(np.nanmean(grid.radii)) * np.array([grid.latitude_step, grid.longitude_step * narrower])
    wanted = max(least, *sides.tolist())
    high, wide = np.maximum(np.rint(wanted / sides), 1.0).astype(int).tolist()
    radii = np.asarray(grid.radii, dtype=np.float64)
    known = np.isfinite(_blocks(radii, high, wide))
    there = known.sum(axis=2) > _LEAST_SHARE * high * wide
    known = known[there]
    count = known.sum(axis=1)

    def mean(values: Array) -> Array:
        """(k,) of values (rows, columns) at posts, over the posts of each block that are there."""
        return np.asarray(np.where(known, _blocks(values, high, wide)[there], 0.0).sum(axis=1) / count)

    row, column = (mean(one) for one in np.indices((rows, columns), dtype=np.float64))
    sigmas = np.full((rows, columns), grid.vertical_sigma or np.nan)
    if grid.post_sigmas is not None:
        sigmas[:] = grid.post_sigmas
    spread = mean(sigmas**2) / count
    if not np.all(spread > 0.0):
        raise InputError(f"terrain {grid.source}", "no sigma of its heights", "metres, above zero")
    longitude = grid.first_longitude + grid.longitude_step * column
    latitude = grid.first_latitude - grid.latitude_step * row
    points = from_planetocentric(np.column_stack([longitude, latitude, mean(radii)]))
    first = np.argwhere(there) * [high, wide] + 1
    names = tuple(f"{model.name}:{i}:{j}" for i, j in first.tolist())
    return Posts(names, points, np.sqrt(spread), _WIDTH * float(np.sqrt(np.prod(sides * [high, wide]))))


def _blocks(values: Array, high: int, wide: int) -> Array:
    """(r, c, high * wide) values of blocks of posts (rows, columns); NaN beyond the last post."""
    rows, columns = -(-values.shape[0] // high), -(-values.shape[1] // wide)
    whole = np.full((rows * high, columns * wide), np.nan)
    whole[: values.shape[0], : values.shape[1]] = values
    return whole.reshape(rows, high, columns, wide).swapaxes(1, 2).reshape(rows, columns, high * wide)


def with_posts(network: Network, models: Sequence[tuple[TerrainModel, Posts]]) -> Network:
    """A network with posts of terrain models as constrained points: each model is a profile with a shift of its own,
    and with a height where that is unknown.
    """
    shifts = network.shifts or ProfileShifts((), np.full(len(network.points), -1), np.zeros(0))
    points, shared = network.points, list(network.shared)
    for model, posts in models:
        n, first = len(posts.ids), len(shifts.names)
        points = GroundPoints(
            points.ids + posts.ids,
            np.append(points.classes, np.full(n, PointClass.POST)),
            np.append(points.kinds, np.full(n, PointKind.CONSTRAINED)),
            np.concatenate([points.places, posts.points]),
            np.concatenate([points.covariances, footprint_covariances(posts.points, PLACE_SIGMA, posts.sigmas)]),
        )
        shifts = ProfileShifts(
            (*shifts.names, model.name),
            np.append(shifts.profile, np.full(n, first)),
            np.append(shifts.sigmas, model.grid.planimetric_sigma or np.nan),
        )
        if model.height_sigma is not None:
            shared.append(SharedUnknown.of_height(model.name, model.height_sigma))
    surface = network.surface
    if surface is not None:
        surface = replace(surface, sigmas=np.append(surface.sigmas, np.full(len(points) - surface.sigmas.size, np.inf)))
    return replace(network, points=points, shifts=shifts, shared=tuple(shared), surface=surface)
