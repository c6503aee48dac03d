"""Ground points to a regular grid of heights with sigmas (`surface` has the mathematics).

The map of a terrain model: Lambert's equal-area plane about its middle, north up, and regular posts on it.

It is PROJ's `+proj=laea` on the sphere of the body's equatorial radius with planetocentric latitudes, as
`matching.chart` lays out (Snyder 1987, p. 182): no zones, poles like any other point, metres true to 1e-4 within a
hundred kilometres.

Dense matches intersected: ground points, and the two parts of their covariance.

A match says where a pixel of the first image lies in the second, and all its error is between the two. So the point is
on the pixel's own ray P = O + t u, where the ray (X, D) of the pixel found passes it: with n = u x D and m = D x n

    t = (X - O) m / u m,        dt/d(line, sample) = m dX/d(line, sample) / u m,

dX being how the second ray moves at the point. The matching error, a covariance C of two numbers, is then a length
along u of variance (dt) C (dt)': a covariance of rank one, and a height error at a map position that is level only
where the ground is.

The orientation's part is the same for neighbours and changes slowly along the images: it is taken from the posterior
at nodes, of rays of which the second alone is uncertain, alike on the ground, and is bilinear between them (which keeps
a covariance one).
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError, require
from mgsgraph.files.rasters.raster_file import equal_area_crs, wkt2
from mgsgraph.geometry.body import Ellipsoid, east_north_up, from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array, Index, all_pairs
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import between_nodes
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene
from mgsgraph.network import ImageRays
from mgsgraph.record import Record
from mgsgraph.units import DEG
from mgsgraph.workers import Progress, no_progress

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_AT_ONCE = 1 << 16
"""Matches that are intersected at a time."""
_LEAST_ANGLE = 1e-3
"""rad between two rays below which a position along them means nothing."""
_LINES_PER_NODE, _LEAST_NODES, _NODES_ACROSS = 128, 9, 5
"""Of the orientation's covariance: lines between nodes, nodes along an image at least, and across it."""
_SURE, _UNSURE = 1e-5, 1e-2
"""m on the ground, sigmas of the two rays at nodes: far below what orientation does, for that is all that counts."""


@dataclass(frozen=True, slots=True, eq=False)
class DensePoints:
    """Ground points of dense matches, body-fixed."""

    positions: Array
    """(n, 3) m."""
    matching: Array
    """(n, 3) m, one sigma of matching along the first image's ray: its covariance is the outer product of this."""
    orientation: Array
    """(n, 3, 3) m^2, covariance by the adjusted orientation alone, for sigma0 = 1; common to neighbours."""
    pair: Index
    """(n,) which pair of images each comes from, by its number among those matched."""
    misses: Array
    """(n,) m by which the two rays pass each other."""
    miss_sigmas: Array
    """(n,) m, of that by matching alone: where misses are larger, orientation is not what was adjusted."""

    @property
    def covariances(self) -> Array:
        """(n, 3, 3) m^2, of both parts."""
        return self.matching[:, :, None] * self.matching[:, None, :] + self.orientation

    def __len__(self) -> int:
        return int(self.pair.size)


class _Crossed(NamedTuple):
    """Rays of n matches where they meet."""

    positions: Array
    """(n, 3) m."""
    along: Array
    """(n, 3) unit, of the first ray."""
    by_pixel: Array
    """(n, 2) m along it per pixel of the second's line and sample."""
    misses: Array
    """(n,) m."""
    miss_by_pixel: Array
    """(n, 2) m of them per pixel of the second's line and sample."""
    good: Array
    """(n,) whether they meet, before both cameras."""


def intersected(posterior: Posterior, scene: Scene, matches: Sequence["DenseMatches"]) -> DensePoints:
    """Intersect dense matches of pairs of a scene's pictures, which are the posterior's images as adjusted
    (`production.adjusted_scene`). Those whose rays don't meet are left out; InputError where none is left.
    """
    parts = [
        _of_pair(posterior, scene, matched, k, slice(begin, begin + _AT_ONCE), nodes)
        for k, matched in enumerate(matches)
        if len(matched.anchors)
        for nodes in [orientation_nodes(posterior, scene, matched)]
        for begin in range(0, len(matched.anchors), _AT_ONCE)
    ]
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
    if not joined or not len(joined[0]):
        found = "no matches, or rays that are all but parallel" if joined else "no matches"
        raise InputError(
            scene.where, f"{found}: nothing to make a terrain model from",
            "images that overlap and look from different sides",
        )  # fmt: skip
    return DensePoints(*joined)


def _of_pair(
    posterior: Posterior, scene: Scene, matched: "DenseMatches", number: int, some: slice, nodes: "OrientationNodes"
) -> tuple[Array, Array, Array, Index, Array, Array]:
    """The record's arrays for some matches of a pair."""
    first, second = (scene.pictures[j] for j in (matched.first, matched.second))
    met = _crossed(first, second, matched.anchors[some], matched.pixels[some])
    variance, of_miss = (
        np.einsum("ni,nij,nj->n", rows, matched.covariances[some], rows) for rows in (met.by_pixel, met.miss_by_pixel)
    )
    good = met.good & np.isfinite(variance) & (variance > 0.0)
    orientation = nodes.at(matched.anchors[some][good])
    matching = met.along[good] * np.sqrt(variance[good])[:, None]
    pair = np.full(int(good.sum()), number)
    return met.positions[good], matching, orientation, pair, met.misses[good], np.sqrt(of_miss[good])


def _crossed(first: Picture, second: Picture, anchors: Array, pixels: Array) -> _Crossed:
    origin, along = first.image.sightlines(anchors[:, 0], anchors[:, 1], first.correction)
    along = unit_vectors(along)
    other, direction, d_other, d_direction = second.image.rays(pixels[:, 0], pixels[:, 1], second.correction)
    common = np.cross(along, direction)
    across = np.cross(direction, common)
    slant = np.einsum("ni,ni->n", along, across)
    length = np.linalg.norm(direction, axis=1)
    sine = np.linalg.norm(common, axis=1) / length
    with np.errstate(invalid="ignore", divide="ignore"):  # parallel rays
        distance = np.einsum("ni,ni->n", other - origin, across) / slant
        point = origin + distance[:, None] * along
        second_distance = np.einsum("ni,ni->n", point - other, direction) / length**2
        moves = d_other + second_distance[:, None, None] * d_direction
        by_pixel = np.einsum("ni,nij->nj", across, moves) / slant[:, None]
        unit = common / (sine * length)[:, None]
        misses = np.einsum("ni,ni->n", point - other, unit)
        miss_by_pixel = -np.einsum("ni,nij->nj", unit, moves)
    good = (sine > np.sin(_LEAST_ANGLE)) & (distance > 0.0) & (second_distance > 0.0)
    return _Crossed(point, along, by_pixel, misses, miss_by_pixel, good)


class OrientationNodes(NamedTuple):
    """The orientation's covariance of points at nodes of the first image."""

    lines: Array
    """(k,) evenly spaced, increasing."""
    samples: Array
    """(l,) evenly spaced, increasing."""
    covariances: Array
    """(k, l, 3, 3) m^2."""

    def at(self, pixels: Array) -> Array:
        """(n, 3, 3) m^2, bilinear at lines and samples (n, 2) of the first image."""
        axes = zip((self.lines, self.samples), pixels.T, strict=True)
        at = np.column_stack([np.interp(values, nodes, np.arange(nodes.size)) for nodes, values in axes])
        return between_nodes(self.covariances, at)


def orientation_nodes(posterior: Posterior, scene: Scene, matched: "DenseMatches") -> OrientationNodes:
    """Over the part of the first image that is matched."""
    first, second = (scene.pictures[j] for j in (matched.first, matched.second))
    low, high = matched.anchors.min(axis=0) - 1.0, matched.anchors.max(axis=0) + 1.0
    lines = np.linspace(low[0], high[0], max(_LEAST_NODES, int((high[0] - low[0]) / _LINES_PER_NODE) + 1))
    samples = np.linspace(low[1], high[1], _NODES_ACROSS)
    down, across = np.meshgrid(lines, samples, indexing="ij")
    anchors = np.column_stack([down.ravel(), across.ravel()])
    points = scene.ground.meet(*first.image.sightlines(anchors[:, 0], anchors[:, 1], first.correction))
    rays = [
        (anchors, _SURE / _pixel_sizes(first, scene.ground, anchors)),
        ((pixels := second.project(points)), _UNSURE / _pixel_sizes(second, scene.ground, pixels)),
    ]
    number, count = [posterior.network.image_number(picture.image.name) for picture in (first, second)], len(anchors)
    both = [np.stack(part, axis=1).reshape(-1, 2) for part in zip(*rays, strict=True)]
    lattice = ImageRays(np.repeat(np.arange(count), 2), np.tile(number, count), *both)
    covariances = posterior.intersections(lattice)[1].reshape(lines.size, samples.size, 3, 3)
    names, found = f"images {first.image.name} and {second.image.name}", "rays that don't meet as they were adjusted"
    require(np.all(np.isfinite(covariances)), names, found, "images of common ground")
    return OrientationNodes(lines, samples, covariances)


def _pixel_sizes(picture: Picture, ground: Ground, pixels: Array) -> Array:
    """(n, 2) m on the ground of a step of one line and of one sample from lines and samples (n, 2)."""
    base = picture.on_chart(ground, pixels)
    sizes = [np.linalg.norm(picture.on_chart(ground, pixels + step) - base, axis=1) for step in np.eye(2)]
    return np.stack(sizes, axis=1)


MOST_POSTS = 50_000_000
"""Posts of a terrain model: 0.2 GB for each band."""
MOST_PIXELS = 1_000_000_000
"""Pixels of an ortho image."""
_DIGITS = 6
"""Of the middle's longitude and latitude, degrees, so that the coordinate system is written as it is."""


@dataclass(frozen=True, slots=True)
class MapGrid(Record):
    """Posts of a map; rows go south, columns go east, and a post is the middle of its cell."""

    longitude: float
    """deg, east, of the middle of the projection."""
    latitude: float
    """deg, planetocentric."""
    radius: float
    """m, of the sphere, above which heights count."""
    west: float
    """m, x of the western edge of the first column."""
    north: float
    """m, y of the northern edge of the first row."""
    post: float
    """m between posts."""
    rows: int
    """Number of rows."""
    columns: int
    """Number of columns."""

    @classmethod
    def around(cls, points: Array, body: Ellipsoid, post: float) -> "MapGrid":
        """The map of points (n, 3) in m, body-fixed, with posts at whole multiples of `post` in m.

        Raises
        ------
        InputError
            Where it would have too many posts.
        """
        longitude, latitude = (round(float(angle) / DEG, _DIGITS) for angle in planetocentric(points.mean(axis=0))[:2])
        bare = cls(longitude, latitude, body.equatorial, 0.0, 0.0, post, 1, 1)
        plane = bare.chart.plane(points)
        low, high = np.round(plane.min(axis=0) / post), np.round(plane.max(axis=0) / post)
        columns, rows = (int(count) + 1 for count in high - low)
        _require_few(rows, columns, post, MOST_POSTS, "terrain model", "--post")
        west, north = (low[0] - 0.5) * post, (high[1] + 0.5) * post
        return cls(longitude, latitude, body.equatorial, float(west), float(north), post, rows, columns)

    @property
    def chart(self) -> GroundChart:
        """The plane, x eastward and y northward in its middle."""
        middle = from_planetocentric(np.array([[self.longitude * DEG, self.latitude * DEG, 1.0]]))
        return GroundChart(east_north_up(middle)[0], self.radius)

    @property
    def system(self) -> dict[str, Any]:
        """The coordinate system as PROJJSON."""
        return equal_area_crs(Ellipsoid(self.radius, self.radius), self.longitude, self.latitude)

    @property
    def crs(self) -> str:
        """The coordinate system as WKT2 (ISO 19162:2019)."""
        return wkt2(self.system)

    def resampled(self, post: float) -> "MapGrid":
        """Other posts on the same ground; InputError where there would be too many."""
        rows, columns = (max(1, round(count * self.post / post)) for count in (self.rows, self.columns))
        _require_few(rows, columns, post, MOST_PIXELS, "ortho image", "--ortho-pixel")
        return MapGrid(
            self.longitude, self.latitude, self.radius, self.west, self.north, post, int(rows), int(columns)
        )

    def posts(self) -> Array:
        """(rows * columns, 2) m, x and y of all posts, row after row."""
        x = self.west + (np.arange(self.columns) + 0.5) * self.post
        y = self.north - (np.arange(self.rows) + 0.5) * self.post
        return all_pairs(x, y)

    def pixels(self, plane: Array) -> Array:
        """(n, 2) row and column of positions (n, 2) in m, the first post at (0, 0)."""
        return np.column_stack([(self.north - plane[:, 1]) / self.post, (plane[:, 0] - self.west) / self.post]) - 0.5

    def points(self, plane: Array, heights: Array) -> Array:
        """(n, 3) m, body-fixed, at heights (n,) in m above the sphere over positions (n, 2)."""
        return np.asarray(self.chart.directions(plane) * (self.radius + heights)[:, None])

    def frames(self, points: Array) -> Array:
        """(n, 3, 3) unit vectors along x, along y and upward at points (n, 3) in m, body-fixed."""
        up = unit_vectors(points)
        x = unit_vectors(self.chart.axes[0] - (up @ self.chart.axes[0])[:, None] * up)
        return np.stack([x, np.cross(up, x), up], axis=1)


def _require_few(rows: int, columns: int, post: float, most: int, what: str, option: str) -> None:
    found = f"{rows} x {columns} posts every {post:g} m"
    require(rows * columns <= most, what, found, f"{most} at most", f"give a larger {option}")


def bilinear(values: Array, pixels: Array) -> Array:
    """(n, ...) values (rows, columns, ...) of posts read between them at pixels (n, 2), row and column; NaN outside and
    beside posts that are NaN.
    """
    inside = np.all((pixels >= 0.0) & (pixels <= np.array(values.shape[:2]) - 1.0), axis=1)
    result = between_nodes(values, np.where(inside[:, None], pixels, 0.0))
    result[~inside] = np.nan
    return result


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
        gradients = np.full((*self.heights.shape, 2), np.nan)
        gradients[:, 1:-1, 0] = (self.heights[:, 2:] - self.heights[:, :-2]) / (2.0 * self.map.post)
        gradients[1:-1, :, 1] = (self.heights[:-2] - self.heights[2:]) / (2.0 * self.map.post)
        return gradients


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
    parts = 1 + 2 * max(round((grid.post / spacing - 1.0) / 2.0), 0)  # odd, so that posts stay in the middle
    finer = replace(grid, post=grid.post / parts, rows=parts * grid.rows, columns=parts * grid.columns)
    posts = _fitted(points, finer, spacing, window, workers, progress)
    height, variance, orientation, count, excess, freedom, squares = np.moveaxis(posts, 2, 0)
    relief = np.where(count < _MANY, _pooled(excess) / _pooled(freedom), excess / freedom)
    matching = np.sqrt(variance + np.maximum(relief, 0.0) * (1.0 + squares))
    bands = [height, matching, orientation, np.nan_to_num(count).astype(np.int32)]
    middle = slice(parts // 2, None, parts)
    height, matching, orientation, count = (np.ascontiguousarray(band[middle, middle]) for band in bands)
    few = f"{len(points)} points, nowhere several around a post"
    where = f"terrain model with posts every {grid.post:g} m"
    require(np.any(count), where, few, "points on all sides", "give a smaller --post, or images that match better")
    return HeightGrid(grid, height, matching, orientation, count)


def _fitted(
    points: DensePoints, grid: MapGrid, spacing: float, window: float, workers: int | None,
    progress: Progress,
) -> Array:
    """(rows, columns, COLUMNS) of the kernel, which works with the post as its unit of length."""
    from mgsgraph.registration.dem.surface import COLUMNS, surface  # numba takes its time to load

    posts = np.full((grid.rows, grid.columns, COLUMNS), np.nan)
    kernel_input = _by_cell(points, grid)

    def fit(first: int) -> None:
        last = min(first + _ROWS_AT_ONCE, grid.rows)
        surface(
            first, last, grid.columns, *kernel_input, _REACH * spacing / grid.post, window / grid.post, posts
        )

    blocks = range(0, grid.rows, _ROWS_AT_ONCE)
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        for done, _ in enumerate(pool.map(fit, blocks), start=1):
            progress("gridding", min(done * _ROWS_AT_ONCE, grid.rows), grid.rows)
    return posts


def _by_cell(points: DensePoints, grid: MapGrid) -> tuple[Index, Array, Array, Array, Index]:
    """Input of the kernel: first point of each cell, positions, covariances along the map's axes in posts, pairs."""
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
    orientation = frame @ points.orientation[order] @ frame.mT
    heights = np.linalg.norm(positions, axis=1) - grid.radius
    return first, np.column_stack([pixels[order], heights]), spread, orientation, points.pair[order]


def _pooled(values: Array) -> Array:
    """(rows, columns) sums over the neighbourhood of each post, NaN counting for nothing; NaN where it was."""
    from scipy.ndimage import convolve1d  # takes half a second

    whole, ones = np.nan_to_num(values), np.ones(2 * _POOL + 1)
    for axis in (0, 1):
        whole = convolve1d(whole, ones, axis, mode="constant")
    return np.where(np.isfinite(values), whole, np.nan)
