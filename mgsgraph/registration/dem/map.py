"""The map of a terrain model: Lambert's equal-area plane about its middle, north up, and regular posts on it.

It is PROJ's `+proj=laea` on the sphere of the body's equatorial radius with planetocentric latitudes, as
`matching.chart` lays out (Snyder 1987, p. 182): no zones, poles like any other point, metres true to 1e-4 within a
hundred kilometres.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.coordinate_systems import equal_area_crs, wkt2
from mgsgraph.geometry.body import Ellipsoid, east_north_up, from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import between_nodes
from mgsgraph.matching.scene import GroundChart
from mgsgraph.record import Record
from mgsgraph.units import DEG

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
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def pixels(self, plane: Array) -> Array:
        """(n, 2) row and column of positions (n, 2) in m, the first post at (0, 0)."""
        return np.column_stack([(self.north - plane[:, 1]) / self.post, (plane[:, 0] - self.west) / self.post]) - 0.5

    def points(self, plane: Array, heights: Array) -> Array:
        """(n, 3) m, body-fixed, at heights (n,) in m above the sphere over positions (n, 2)."""
        return np.asarray(self.chart.directions(plane) * (self.radius + heights)[:, None])

    def frames(self, points: Array) -> Array:
        """(n, 3, 3) unit vectors along x, along y and upward at points (n, 3) in m, body-fixed."""
        up = points / np.linalg.norm(points, axis=1, keepdims=True)
        x = self.chart.axes[0] - (up @ self.chart.axes[0])[:, None] * up
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        return np.stack([x, np.cross(up, x), up], axis=1)


def _require_few(rows: int, columns: int, post: float, most: int, what: str, option: str) -> None:
    if rows * columns > most:
        found = f"{rows} x {columns} posts every {post:g} m"
        raise InputError(what, found, f"{most} at most", f"give a larger {option}")


def bilinear(values: Array, pixels: Array) -> Array:
    """(n, ...) values (rows, columns, ...) of posts read between them at pixels (n, 2), row and column; NaN outside and
    beside posts that are NaN.
    """
    inside = np.all((pixels >= 0.0) & (pixels <= np.array(values.shape[:2]) - 1.0), axis=1)
    found = between_nodes(values, np.where(inside[:, None], pixels, 0.0))
    found[~inside] = np.nan
    return found
