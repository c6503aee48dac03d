"""Terrain models: a grid of radii over longitude and latitude.

Values are read between the posts by bilinear interpolation. The surface row of an adjustment is the height of a point
above the cubic B-spline of the posts (`factors.surface.cubic`), along its normal: with F = r - R(lon, lat), the
distance F / |grad F|, which is exact to first order in the height (its error is the square of the height times the
curvature, and it vanishes with the residual).

Bilinear interpolation between the nodes of a regular grid.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.factors.surface import bilinear, cubic, height_above, post_coordinates
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import from_planetocentric, in_turn, planetocentric
from mgsgraph.geometry.records import Array, Index, Mask, assign, finite_rows, read_only
from mgsgraph.record import Record


def between_nodes(nodes: NDArray[Any], at: Array) -> Array:
    """Values (n, ...) of nodes (rows, columns, ...) at fractional rows and columns `at` (n, 2).

    Outside the grid the outermost cells are extrapolated; NaN beside nodes that are NaN.
    """
    i, j = np.clip(np.floor(at), 0, np.maximum(np.array(nodes.shape[:2]) - 2, 0)).astype(np.int64).T
    shape = (-1,) + (1,) * (nodes.ndim - 2)
    down, across = (part.reshape(shape) for part in (at[:, 0] - i, at[:, 1] - j))
    below, right = np.minimum(i + 1, nodes.shape[0] - 1), np.minimum(j + 1, nodes.shape[1] - 1)
    upper = (1.0 - across) * nodes[i, j] + across * nodes[i, right]
    lower = (1.0 - across) * nodes[below, j] + across * nodes[below, right]
    return np.asarray((1.0 - down) * upper + down * lower)


def refined(nodes: NDArray[Any], step: int) -> NDArray[Any]:
    """Nodes (rows, columns) and `step` - 1 values between neighbours: ((rows - 1) step + 1, (columns - 1) step + 1)."""
    part = (np.arange(step) / step).astype(nodes.dtype)
    across = nodes[:, :-1, None] + np.diff(nodes, axis=1)[:, :, None] * part
    full = np.column_stack([across.reshape(nodes.shape[0], -1), nodes[:, -1]])
    down = full[:-1, None, :] + np.diff(full, axis=0)[:, None, :] * part[:, None]
    return np.concatenate([down.reshape(-1, full.shape[1]), full[-1:]])


@dataclass(frozen=True, slots=True, eq=False)
class Gaps(Record):
    """Errors of a terrain model's posts by interpolation between tracks."""

    sigmas: Array
    """(rows, columns) m, of each post's height; 0 for a post that shots made."""
    reaches: Array
    """(rows, columns) m, within which these errors are one: half the distance between the tracks."""

    def __iter__(self) -> Iterator[Array]:
        """Sigmas, then reaches."""
        yield from (self.sigmas, self.reaches)


# --- terrain models

TerrainKind = Literal["radius", "topography", "areoid", "counts"]
"""What the posts hold: distance from the body's centre, height above the areoid, radius of the areoid; shots."""
_BEYOND = 3
"""Posts by which a grid is continued: so many make the surface level where it ends."""
_SAME_PLACE = 1e-9
"""rad, by which the outermost posts of two grids with the same posts may differ."""
_EDGE = 1e-9
"""cells by which a place may lie beyond the outermost posts and still be taken for one on them (rounding)."""


class _Patch(NamedTuple):
    """Bilinear patches at places (`factors.surface.bilinear`); NaN outside the grid."""

    value: Array
    eastward: Array
    """per cell."""
    southward: Array
    """per cell."""


class SplineSurface(NamedTuple):
    """The cubic B-spline with a grid's posts as coefficients, continued beyond its edges and over holes, there as the
    nearest post: smooth, and level over half a cell, so that the posts' noise makes no slopes of its own.
    """

    coefficients: Array
    """(rows, columns) m."""
    first: tuple[float, float]
    """rad, longitude and latitude of coefficient [0, 0]."""
    step: tuple[float, float]
    """rad, between columns and rows."""

    def height_above(self, points: Array) -> tuple[Array, Array]:
        """Heights (n,) in m of points (n, 3) in m along the normal, and their derivatives (n, 3)."""
        components = rotation.components(points)
        row, column = post_coordinates(components, self.first, self.step, self.coefficients.shape)
        i, j = (
            np.minimum(np.nan_to_num(axis, nan=1.0).astype(np.int64), size - 3)
            for axis, size in zip((row, column), self.coefficients.shape, strict=True)
        )
        around = tuple(tuple(self.coefficients[i + k, j + m] for m in range(-1, 3)) for k in range(-1, 3))
        height, slope = height_above(components, cubic(column - j, row - i, around), self.step)
        return np.asarray(height), rotation.stacked(slope)


@dataclass(frozen=True, slots=True, eq=False)
class PostLattice(Record):
    """Posts in rows and columns of whatever projection, of a model whose horizontal place as a whole is unknown."""

    source: str
    """File they come from, for messages."""
    values: NDArray[np.float32] | Array
    """(rows, columns) m, radii or heights, as `located` takes them; NaN where a post is missing."""
    located: Callable[[Array, Array, Array], Array]
    """Points (n, 3) in m, body-fixed, of rows and columns (n,), which may lie between posts, and values (n,)."""
    vertical_sigma: float | None = None
    """m, of a post; None where unknown."""
    planimetric_sigma: float | None = None
    """m, of the posts' common horizontal place; None where unknown."""
    gaps: Gaps | None = None
    """What interpolation between tracks adds to that of each post; None where posts are measured."""


def window(
    at: Array, shape: tuple[int, int], margin: int, turn: float | None = None, wraps: bool = False
) -> tuple[slice, Index] | None:
    """The part of a raster around places.

    Parameters
    ----------
    at : (n, 2)
        Fractional rows and columns of the places; NaN where unknown.
    shape : (rows, columns)
        Of the raster.
    margin : int
        Rows and columns beyond the places.
    turn : float, optional
        Columns in a full turn of longitude, where columns are meridians.
    wraps : bool
        Whether the first column follows the last one.

    Returns
    -------
    rows : slice
    columns : (k,)
        In their order eastward, which may lead across the seam of a raster that wraps.

    None in place of both where the raster has less than two rows or columns there.
    """
    row, column = at[finite_rows(at)].T
    if not row.size:
        return None
    rows, columns = shape
    if turn is not None:
        unit = 2.0 * np.pi / turn
        middle = float(np.angle(np.mean(np.exp(1j * unit * column)))) if wraps else 0.5 * columns * unit
        column = in_turn(unit * column, middle) / unit
    top, west = (int(np.floor(axis.min())) - margin for axis in (row, column))
    bottom, east = (int(np.floor(axis.max())) + margin + 2 for axis in (row, column))
    around = turn is not None and 2.0 * (east - west) > turn  # a pole lies between the places
    if around and top < bottom - top:
        top = 0
    if around and rows - bottom < bottom - top:
        bottom = rows
    if not wraps:
        west, east = max(west, 0), min(east, columns)
    elif around:
        west, east = 0, columns
    top, bottom = max(top, 0), min(bottom, rows)
    if min(bottom - top, east - west) < 2:
        return None
    return slice(top, bottom), np.arange(west, east) % columns


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid(Record):
    """Posts at equal steps of longitude and planetocentric latitude; rows go south, columns go east.

    Examples
    --------
    >>> from mgsgraph.geometry.terrain import TerrainGrid
    >>> step = np.radians(0.5)
    >>> plain = TerrainGrid("a plain", np.full((4, 4), 3_390_000.0), 0.0, np.radians(2.0), step, step)
    >>> plain.at(np.array([[3.4e6, 3e4, 6e4]]))
    array([3390000.])
    """

    source: str
    """File it comes from, for messages."""
    radii: NDArray[np.float32] | Array
    """(rows, columns) m, float32 or float64; what they are says `kind`; NaN where a post is missing."""
    first_longitude: float
    """rad, east, of post [0, 0]."""
    first_latitude: float
    """rad, planetocentric, of post [0, 0], the northernmost row."""
    longitude_step: float
    """rad between columns, positive."""
    latitude_step: float
    """rad between rows, positive."""
    wraps: bool = False
    """True where the first column follows the last one."""
    kind: TerrainKind = "radius"
    """What the posts hold."""
    vertical_sigma: float | None = None
    """m, of a post; None where unknown."""
    planimetric_sigma: float | None = None
    """m, of the grid's common horizontal place; None where unknown."""
    gaps: Gaps | None = None
    """What interpolation between tracks adds to that of each post; None where posts are measured."""

    def __post_init__(self) -> None:
        where = f"terrain {self.source}"
        radii = np.array(self.radii, dtype=np.float32 if np.asarray(self.radii).dtype == np.float32 else np.float64)
        require(radii.ndim == 2 and min(radii.shape) >= 2, where, f"posts of shape {radii.shape}", "at least 2 x 2")
        if self.kind not in get_args(TerrainKind):
            raise InputError(f"{where}, kind", repr(self.kind), f"one of {', '.join(get_args(TerrainKind))}")
        require(not np.any(np.isinf(radii)), where, "an infinite post", "metres, or NaN where a post is missing")
        if self.kind in ("radius", "areoid") and np.nanmin(radii, initial=np.inf) <= 0.0:
            raise InputError(where, f"a {self.kind} of {np.nanmin(radii):g} m", "positive numbers")
        for name in ("longitude_step", "latitude_step"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{where}, {name}", f"{getattr(self, name)} rad", "a positive number")
        rows, columns = radii.shape
        last = self.first_latitude - (rows - 1) * self.latitude_step
        if not (self.first_latitude <= np.pi / 2 + 1e-9 and last >= -np.pi / 2 - 1e-9):
            raise InputError(where, f"latitudes {last:.6f} .. {self.first_latitude:.6f} rad", "-pi/2 .. pi/2")
        full = columns * self.longitude_step / (2.0 * np.pi)
        if not np.isfinite(self.first_longitude) or full > 1.0 + 1.5 / columns:
            raise InputError(where, f"{columns} columns that span {full:.4f} turns", "at most one")
        if self.wraps and abs(full - 1.0) > 1e-6:
            raise InputError(where, f"columns that wrap and span {full:.6f} turns", "exactly one")
        for name in ("vertical_sigma", "planimetric_sigma"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{where}, {name}", f"{value} m", "a positive number")
        if self.gaps is not None:
            gaps = Gaps(*(np.array(gap, dtype=np.float64) for gap in self.gaps))
            for gap in gaps:
                if gap.shape != radii.shape or not np.all(gap[np.isfinite(radii)] >= 0.0):
                    found, expected = f"an array of shape {gap.shape}", f"a number >= 0 for each of {radii.shape}"
                    raise InputError(f"{where}, gaps between tracks", found, expected)
                gap.flags.writeable = False
            assign(self, gaps=gaps)
        assign(self, radii=read_only(radii))

    def _cell(self, longitudes: Array, latitudes: Array) -> tuple[Index, Index, Index, Array, Array, Mask]:
        """Row and columns (left, right) of the cells of places (n,), fractions southward and eastward, and which of the
        places lie in the grid.
        """
        rows, columns = self.radii.shape
        slack = _EDGE * self.longitude_step
        east = (np.mod(longitudes - self.first_longitude + slack, 2.0 * np.pi) - slack) / self.longitude_step
        south = (self.first_latitude - latitudes) / self.latitude_step
        last = columns if self.wraps else columns - 1
        inside = (south >= -_EDGE) & (south <= rows - 1 + _EDGE) & (east <= last + _EDGE)
        column = np.clip(np.floor(np.where(inside, east, 0.0)), 0, last - 1).astype(np.int64)
        row = np.clip(np.floor(np.where(inside, south, 0.0)), 0, rows - 2).astype(np.int64)
        return row, column, (column + 1) % columns, south - row, east - column, inside

    def _patch(self, longitudes: Array, latitudes: Array) -> _Patch:
        row, left, right, s, e, inside = self._cell(longitudes, latitudes)
        posts = (self.radii[i, j].astype(np.float64) for i in (row, row + 1) for j in (left, right))
        return _Patch(*bilinear(e, s, tuple(np.where(inside, post, np.nan) for post in posts)))

    def radius(self, longitudes: Array, latitudes: Array) -> tuple[Array, Array, Array]:
        """Posts' values between the posts.

        Parameters
        ----------
        longitudes, latitudes : (n,)
            rad, east and planetocentric; longitudes of any turn.

        Returns
        -------
        values : (n,)
            m, bilinear; NaN outside the grid and beside missing posts.
        by_longitude, by_latitude : (n,)
            m per rad.
        """
        patch = self._patch(longitudes, latitudes)
        return patch.value, patch.eastward / self.longitude_step, -patch.southward / self.latitude_step

    def at(self, points: Array) -> Array:
        """Posts' values (n,) in m under points (n, 3) in m, body-fixed; NaN outside."""
        longitudes, latitudes, _ = planetocentric(points).T
        return self._patch(longitudes, latitudes).value

    def height_sigmas(self, points: Array) -> Array:
        """Sigma (n,) in m of the model's height under points (n, 3) in m, without that of its horizontal position,
        which is common to all. NaN outside the grid and beside missing posts, infinite where the grid knows no sigma.
        """
        longitudes, latitudes, _ = planetocentric(points).T
        between, _ = self._gaps(longitudes, latitudes)
        finite = np.isfinite(self._patch(longitudes, latitudes).value)
        return np.where(finite, np.hypot(self.vertical_sigma or np.inf, between), np.nan)

    def _gaps(self, longitudes: Array, latitudes: Array) -> tuple[Array, Array]:
        """`gaps` at places (n,), m: zero where there are none."""
        if self.gaps is None:
            return np.zeros(longitudes.size), np.zeros(longitudes.size)
        sigmas, reaches = (
            replace(self, radii=gap, kind="topography", gaps=None)._patch(longitudes, latitudes).value
            for gap in self.gaps
        )
        return sigmas, reaches

    def parts_of_sigmas(self, points: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Sigmas (n,), in m, of the heights at points (n, 3) in m by the posts' own errors and by interpolation between
        tracks, and how far each is common, in m: a circle as large as a cell, half the distance between the tracks.
        """
        longitudes, latitudes, radii = planetocentric(points).T
        circle = np.sqrt(self.latitude_step * self.longitude_step * np.cos(latitudes) / np.pi) * radii
        return (np.full(len(points), self.vertical_sigma or 0.0), circle), self._gaps(longitudes, latitudes)

    @property
    def box(self) -> Array:
        """(2, 2) rad, longitude and latitude of its south-western and its north-eastern post."""
        rows, columns = self.radii.shape
        extent = np.array([(columns - 1) * self.longitude_step, (rows - 1) * self.latitude_step])
        corner = np.array([self.first_longitude, self.first_latitude - extent[1]])
        return np.stack([corner, corner + extent])

    def holds(self, points: Array) -> Mask:
        """(n,) whether points (n, 3) in m lie within the grid, over posts or over missing ones."""
        longitudes, latitudes, _ = planetocentric(points).T
        return self._cell(longitudes, latitudes)[5]

    def height_above(self, points: Array) -> tuple[Array, Array]:
        """Distance of points from the B-spline of the posts, along its normal.

        Parameters
        ----------
        points : (n, 3)
            m, body-fixed.

        Returns
        -------
        height : (n,)
            m, positive above the terrain; NaN outside the grid and beside missing posts.
        jacobian : (n, 3)
            d(height) / d(point); a unit vector along the normal where the height is zero.
        """
        self._require("radius", "heights above the terrain")
        height, slope = self.spline().height_above(points)
        inside = np.isfinite(self.at(points))
        return np.where(inside, height, np.nan), np.where(inside[:, None], slope, np.nan)

    def spline(self) -> SplineSurface:
        """The cubic B-spline of its posts."""
        from scipy.ndimage import distance_transform_edt  # slow to import

        radii, missing = np.asarray(self.radii, dtype=np.float64), np.isnan(self.radii)
        if np.any(missing) and not np.all(missing):
            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            radii = radii[tuple(nearest)]
        radii = np.pad(radii, ((_BEYOND, _BEYOND), (0, 0)), "edge")
        radii = np.pad(radii, ((0, 0), (_BEYOND, _BEYOND)), "wrap" if self.wraps else "edge")
        first = self.first_longitude - _BEYOND * self.longitude_step, self.first_latitude + _BEYOND * self.latitude_step
        return SplineSurface(np.ascontiguousarray(radii), first, (self.longitude_step, self.latitude_step))

    def around(self, points: Array, margin: int = 8) -> "TerrainGrid":
        """The part of the grid under points (n, 3) in m, body-fixed, and `margin` posts beyond.

        The whole of it where no point lies over it.
        """
        longitudes, latitudes, _ = planetocentric(points).T
        at = np.column_stack([self.first_latitude - latitudes, longitudes - self.first_longitude])
        at /= [self.latitude_step, self.longitude_step]
        part = window(at, self.radii.shape, margin, 2.0 * np.pi / self.longitude_step, self.wraps)
        if part is None:
            return self
        rows, columns = part
        return replace(
            self,
            radii=self.radii[rows][:, columns],
            gaps=None if self.gaps is None else Gaps(*(gap[rows][:, columns] for gap in self.gaps)),
            first_longitude=self.first_longitude + int(columns[0]) * self.longitude_step,
            first_latitude=self.first_latitude - rows.start * self.latitude_step,
            wraps=self.wraps and columns.size == self.radii.shape[1],
        )

    def points(self, rows: Array, columns: Array, radii: Array) -> Array:
        """Points (n, 3) in m, body-fixed, at rows and columns (n,), fractional ones too, with radii (n,) in m."""
        longitudes = self.first_longitude + self.longitude_step * columns
        return from_planetocentric(
            np.column_stack([longitudes, self.first_latitude - self.latitude_step * rows, radii])
        )

    def lattice(self) -> PostLattice:
        """Its posts as those of any projection."""
        self._require("radius", "posts")
        return PostLattice(
            self.source, self.radii, self.points, self.vertical_sigma, self.planimetric_sigma, self.gaps
        )

    def same_posts(self, other: "TerrainGrid") -> bool:
        """Whether another grid has its posts at the same places."""
        difference = np.abs(self.box - other.box).max()
        return self.radii.shape == other.radii.shape and bool(difference < _SAME_PLACE)

    def _require(self, kind: TerrainKind, what: str) -> None:
        require(self.kind == kind, f"terrain {self.source}", f"a grid of {self.kind}", f"a grid of {kind} for {what}")

    def __repr__(self) -> str:
        rows, columns = self.radii.shape
        return f"TerrainGrid({self.kind}, {rows} x {columns} posts, from {self.source})"


def areoid_grid(radius: TerrainGrid, topography: TerrainGrid) -> TerrainGrid:
    """Radius of the areoid at the posts: planetary radius minus topography, of two grids with the same posts."""
    if radius.kind != "radius" or topography.kind != "topography":
        found = f"grids of {radius.kind} and {topography.kind}"
        raise InputError(f"areoid of {radius.source} and {topography.source}", found, "radius and topography")
    if not radius.same_posts(topography):
        raise InputError(
            f"areoid of {radius.source} and {topography.source}", "grids with different posts", "the same posts"
        )
    return TerrainGrid(
        f"{radius.source} - {topography.source}", radius.radii - topography.radii, radius.first_longitude,
        radius.first_latitude, radius.longitude_step, radius.latitude_step, radius.wraps, "areoid",
    )


def areoid_heights(points: Array, areoid: TerrainGrid) -> Array:
    """Heights (n,) in m above the areoid of points (n, 3), as PEDR's topography: radius minus areoid; NaN outside."""
    if areoid.kind != "areoid":
        raise InputError(f"terrain {areoid.source}", f"a grid of {areoid.kind}", "a grid of the areoid's radius")
    return np.asarray(np.linalg.norm(points, axis=1) - areoid.at(points))
