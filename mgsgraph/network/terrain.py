"""Terrain models: which points lie on one, with what sigma, and which don't, those beside it and those over its holes;
and posts as points of a network: what a laser shot is, ground that is known but for what all posts of
the model are off in common.

A post stands for the mean height of its cell. Where cells are smaller than what images can show, posts are averaged to
cells as large as that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.altimetry import SPOT_WIDTHS, footprint_covariances
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import PostLattice, TerrainGrid, common_variances
from mgsgraph.names import Names
from mgsgraph.network.footprints import nominal_ground
from mgsgraph.network.network import Network
from mgsgraph.network.records import GroundPoints, ImageRays, PointClass, ProfileShifts
from mgsgraph.network.shared import SharedUnknown
from mgsgraph.record import Record
from mgsgraph.units import DEG

_STEPS = 3
"""Times that a ray's ground is looked up at the height of the terrain under its last place: some metres are left."""


class Coverage(NamedTuple):
    """How a terrain model covers points."""

    on: int
    """Points whose four posts are there."""
    beside: int
    """Points outside the model."""
    over_holes: int
    """Points within it of whose four posts some are missing."""
    points: Array
    """(2, 2) rad, least and largest longitude and latitude of the points; NaN without any."""
    model: Array
    """(2, 2) rad, the same of the model's posts."""

    @property
    def total(self) -> int:
        """All points that were asked about."""
        return self.on + self.beside + self.over_holes

    @property
    def words(self) -> str:
        """Points that the model doesn't cover, and why; empty where it covers all."""
        parts = []
        if self.beside:
            parts.append(
                f"{self.beside} outside the model (points {in_degrees(self.points)}; model {in_degrees(self.model)})"
            )
        if self.over_holes:
            parts.append(f"{self.over_holes} over missing posts")
        return " and ".join(parts)


def coverage(grid: TerrainGrid, places: Array) -> Coverage:
    """How a terrain model covers places (n, 3) in m, body-fixed; those that are NaN count as outside it."""
    known = np.all(np.isfinite(places), axis=1)
    inside = np.zeros(known.size, dtype=bool)
    inside[known] = grid.holds(places[known])
    on = int(np.count_nonzero(np.isfinite(grid.at(places[inside]))))
    within = int(np.count_nonzero(inside))
    return Coverage(on, known.size - within, within - on, box_of(places[known], float(grid.box[:, 0].mean())), grid.box)


def terrain_ground(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> Array:
    """(k, 3) m, where rays meet the terrain model with the nominal orientation, or the ellipsoid where there is none;
    NaN for those that miss the body.
    """
    heights = np.zeros(rays.point.size)
    places = nominal_ground(images, rays, heights)
    for _ in range(_STEPS):
        above = np.linalg.norm(places, axis=1) - grid.at(places)
        heights -= np.where(np.isfinite(above), above, 0.0)
        places = nominal_ground(images, rays, heights)
    return places


def over_terrain(images: Sequence[PushbroomImage], rays: ImageRays, grid: TerrainGrid) -> tuple[Index, Array]:
    """Points with rays (p,), and places (p, 3) in m where the first ray of each meets the ground (`terrain_ground`)."""
    points, first = np.unique(rays.point, return_index=True)
    return points, terrain_ground(images, rays.chosen(first), grid)


def box_of(places: Array, middle: float) -> Array:
    """(2, 2) rad, least and largest longitude, in the turn about a middle, and latitude of places (n, 3) in m; NaN
    without any.
    """
    if places.shape[0] == 0:
        return np.full((2, 2), np.nan)
    longitudes, latitudes, _ = planetocentric(places).T
    longitudes = in_turn(longitudes, middle)
    corners = np.stack([longitudes, latitudes], axis=1)
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def in_degrees(box: Array) -> str:
    """A box (2, 2) of longitude and latitude in rad, in words."""
    (west, south), (east, north) = box / DEG
    return f"{west:.3f} .. {east:.3f} E, {south:+.3f} .. {north:+.3f} N"


PLACE_SIGMA = 0.1
"""m, a-priori, east and north of each post by itself: files round longitudes and latitudes so."""
_WIDTH = SPOT_WIDTHS / np.sqrt(12.0)
"""Diameter of the Gaussian footprint (four standard deviations) that is as wide as a square cell, in sides of it."""
_LEAST_SHARE = 0.5
"""Of a cell's posts that have to be there."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainModel(Record):
    """A terrain model whose place as a whole is unknown."""

    name: str
    """What reports call it."""
    lattice: PostLattice
    """Posts, with their sigma and that of their common horizontal place."""
    height_sigma: float | None = None
    """m, a-priori, of its height as a whole, which is an unknown; None where that is known."""

    def __post_init__(self) -> None:
        if self.lattice.planimetric_sigma is None:
            raise InputError(f"terrain {self.lattice.source}", "no sigma of its horizontal place", "metres, above zero")


class Posts(NamedTuple):
    """Posts of one terrain model, or means of some of them."""

    ids: Names
    """(n) names: that of the model, row and column."""
    points: Array
    """(n, 3) m, body-fixed."""
    sigmas: Array
    """(n,) m, of the heights."""
    footprint: float
    """m, diameter of the Gaussian footprint that stands for a cell."""

    def chosen(self, which: Index) -> "Posts":
        """Some of them."""
        return Posts(self.ids[which], self.points[which], self.sigmas[which], self.footprint)


def posts_of(model: TerrainModel, least: float) -> Posts:
    """Posts of a terrain model by rows from its first one; m by n of them averaged to one where a cell would be smaller
    than `least`, m. The posts' own errors count as independent, and so a mean's sigma is theirs by the root of m n;
    those of interpolation between tracks are common within half the distance between these (`common_variances`).

    Raises
    ------
    InputError
        Where a post's sigma is unknown, or there is no post.
    """
    lattice = model.lattice
    known = np.isfinite(lattice.values)
    if not np.any(known):
        raise InputError(f"terrain {lattice.source}", "no post", "a model of the images' ground")
    sides = _sides(lattice)
    wanted = max(least, *sides.tolist())
    high, wide = np.maximum(np.rint(wanted / sides), 1.0).astype(int).tolist()
    blocks = _blocks(known, high, wide)
    there = blocks.sum(axis=(1, 3)) > _LEAST_SHARE * high * wide
    count = blocks.sum(axis=(1, 3))[there]
    first = np.argwhere(there) * [high, wide]
    row = first[:, 0] + (blocks.sum(axis=3) * np.arange(high)[:, None]).sum(axis=1)[there] / count
    column = first[:, 1] + (blocks.sum(axis=1) * np.arange(wide)).sum(axis=2)[there] / count

    def mean(values: NDArray[Any]) -> Array:
        """(k,) of values (rows, columns) at posts, over the posts of each block that are there."""
        posts = _blocks(np.where(known, values, 0.0), high, wide)
        return np.asarray(posts.sum(axis=(1, 3), dtype=np.float64)[there] / count)

    if not lattice.vertical_sigma:
        raise InputError(f"terrain {lattice.source}", "no sigma of its heights", "metres, above zero")
    spread, points = lattice.vertical_sigma**2 / count, lattice.located(row, column, mean(lattice.values))
    if lattice.gaps is not None:
        spread += common_variances(np.nan_to_num(points), *(mean(one) for one in lattice.gaps))
    names = Names.joined(*(first + 1).T).prefixed(f"{model.name}:")
    posts = Posts(names, points, np.sqrt(spread), _WIDTH * float(np.sqrt(np.prod(sides * [high, wide]))))
    return posts.chosen(np.flatnonzero(np.all(np.isfinite(points), axis=1)))


def _sides(lattice: PostLattice) -> Array:
    """(2,) m from the middle post to the one below it and to the one beside it."""
    row, column = (np.array(lattice.values.shape) - 1) // 2
    places = lattice.located(
        row + np.array([0.0, 1.0, 0.0]), column + np.array([0.0, 0.0, 1.0]), np.full(3, np.nanmean(lattice.values))
    )
    return np.asarray(np.linalg.norm(places[1:] - places[0], axis=1))


def _blocks(values: NDArray[Any], high: int, wide: int) -> NDArray[Any]:
    """(r, high, c, wide) values (rows, columns) of posts in blocks; zero beyond the last post."""
    rows, columns = values.shape
    whole = np.pad(values, ((0, -rows % high), (0, -columns % wide)))
    return whole.reshape(whole.shape[0] // high, high, whole.shape[1] // wide, wide)


def with_posts(network: Network, models: Sequence[tuple[TerrainModel, Posts]]) -> Network:
    """A network with posts of terrain models as constrained points: each model is a profile with a shift of its own,
    and with a height where that is unknown.
    """
    shifts = network.shifts or ProfileShifts((), np.full(len(network.points), -1), np.zeros(0))
    points, shared = network.points, list(network.shared)
    for model, posts in models:
        n, first = len(posts.ids), len(shifts.names)
        points = GroundPoints(
            Names.concatenated([points.ids, posts.ids]),
            np.append(points.classes, np.full(n, PointClass.POST)),
            np.append(points.kinds, np.full(n, PointKind.CONSTRAINED)),
            np.concatenate([points.places, posts.points]),
            np.concatenate([points.covariances, footprint_covariances(posts.points, PLACE_SIGMA, posts.sigmas)]),
        )
        shifts = ProfileShifts(
            (*shifts.names, model.name),
            np.append(shifts.profile, np.full(n, first)),
            np.append(shifts.sigmas, model.lattice.planimetric_sigma or np.nan),
        )
        if model.height_sigma is not None:
            shared.append(SharedUnknown.of_height(model.name, model.height_sigma))
    surface = network.surface
    if surface is not None:
        surface = replace(surface, sigmas=np.append(surface.sigmas, np.full(len(points) - surface.sigmas.size, np.inf)))
    return replace(network, points=points, shifts=shifts, shared=tuple(shared), surface=surface)
