"""Ground control read from a map: positions in an orthoimage become ground coordinates with covariances.

A table of measurements (`files.networks.table`) has, in place of X, Y, Z, where each point lies in the orthoimage:
map_line, map_sample (the first pixel's centre is (0.5, 0.5)), map_x, map_y (in the unit of its coordinate reference
system), or longitude_deg, latitude_deg (planetographic where that system has an ellipsoid). The height is that of a
terrain model there.

A horizontal error d of the reading moves the point along the ground: with the slope g of the terrain it also lifts it
by g d. With the height's own variance, and u upward,

    C = M D M' + sigma^2 u u',  M = 1 + u g',  D = s^2 (a a' + b b') + m^2 (e e' + n n'),

a and b the sides of a pixel on the ground, east e and north n, s the reading's sigma in pixels, m the map's own sigma.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from mgsgraph.errors import InputError, require
from mgsgraph.files.csv_columns import CARTESIAN, MATRIX, OF_POINT, Columns, measured, whole
from mgsgraph.files.rasters.raster_file import open_raster
from mgsgraph.files.rasters.terrain_file import MapProjection, map_projection
from mgsgraph.geometry.body import Ellipsoid, east_north_up
from mgsgraph.geometry.records import Array, Mask, finite_rows
from mgsgraph.units import DEG

_PIXELS, _PLANE, _DEGREES = ("map_line", "map_sample"), ("map_x", "map_y"), ("longitude_deg", "latitude_deg")
_STEPS = 4
"""Of the search for the height of the terrain at a place; on a sphere the first one finds it."""


@dataclass(frozen=True, slots=True)
class ControlMap:
    """Where ground coordinates are read."""

    orthoimage: Path
    """GeoTIFF or another raster, in any projection."""
    radii: Callable[[Array], Array]
    """(n,) m, radius of the terrain under points (n, 3) in m, body-fixed; NaN where the model has none."""
    height_sigma: float
    """m, of these."""
    pixel_sigma: float
    """Pixels of the orthoimage, of a position read there, along lines and along samples alike."""
    own_sigma: float
    """m, of the orthoimage itself, east and north alike, independent at each point; may be zero."""
    body: Ellipsoid
    """Which the orthoimage has to show."""

    def ground_columns(self, table: Columns) -> Columns:
        """A table with X, Y, Z and their covariances in place of the positions in the map; its points are constrained.

        Raises
        ------
        InputError
            An orthoimage that can't be read, has no map projection, or is of another body; a table without positions
            in it, or with other statements on the points; a position that is no number, or beyond the orthoimage or
            the terrain.
        """
        table = replace(table, values={name.strip().lower(): column for name, column in table.values.items()})
        names, where = tuple(table.values), f"{table.path}, {table.header}"
        positions = whole(names, (_PIXELS, _PLANE, _DEGREES), where)
        if not positions:
            expected = "map_line and map_sample, map_x and map_y, or longitude_deg and latitude_deg"
            raise InputError(where, "no columns of positions in the orthoimage", expected)
        for name in [name for name in names if name in OF_POINT and name not in positions][:1]:
            remedy = "take it out: position and sigmas follow from orthoimage and terrain"
            raise InputError(where, f"the column {name!r}", "positions in the orthoimage alone", remedy)
        rows = np.flatnonzero(table.filled(positions[0]) | table.filled(positions[1]))
        require(rows.size > 0, where, "no position in the orthoimage in any row", f"{' and '.join(positions)}")
        read = table.chosen(rows)
        values = np.column_stack([measured(read.values[name], read.where) for name in positions])
        _require(finite_rows(values), read, "half a position", f"both {' and '.join(positions)}")
        ids, first = read.values.get("id", read.values[positions[0]]), dict[str, list[float]]()  # none: refused later
        same = [first.setdefault(ids[k].as_py(), row) == row for k, row in enumerate(values.tolist())]
        _require(np.array(same), read, f"{' and '.join(positions)} other than in an earlier row", "one position")
        points, covariances = self._ground(positions, values, read)
        numbers = np.hstack([points, covariances[:, *np.triu_indices(3)]])
        texts = np.full((table.numbers.size, 1 + numbers.shape[1]), "", dtype=object)
        texts[rows] = [["constrained", *map(repr, row)] for row in numbers.tolist()]
        kept = {name: table.values[name] for name in names if name not in positions}
        placed = zip(("type", *CARTESIAN, *MATRIX), texts.T.tolist(), strict=True)
        return replace(table, values=kept | {name: pa.array(column, pa.large_string()) for name, column in placed})

    def _ground(self, positions: tuple[str, ...], values: Array, table: Columns) -> tuple[Array, Array]:
        """Points (n, 3) in m and covariances (n, 3, 3) in m^2 of positions (n, 2), whose rows errors name."""
        with open_raster(self.orthoimage, "an orthoimage") as file:
            projection, size = map_projection(file, self.orthoimage, self.body), np.array(file.shape)
        if positions == _PIXELS:
            pixels = values - 0.5
        elif positions == _PLANE:
            plane = values - projection.affine[:, 2]
            pixels = np.asarray(np.linalg.solve(projection.affine[:, :2], plane.T)[::-1].T, dtype=np.float64)
        else:
            pixels = projection.pixels(*values.T * DEG)
        _require(np.all((pixels >= -0.5) & (pixels <= size - 0.5), axis=1), table, "a position beyond the orthoimage",
                 f"one in its {size[0]} lines and {size[1]} samples")  # fmt: skip
        points, heights = self._on_terrain(projection, pixels)
        frames = east_north_up(np.nan_to_num(points, nan=1.0))
        level = frames[:, :2]
        plane = level.mT @ level  # sides of pixels lie in that of the ellipsoid, slopes are of radii
        sides = np.stack([_at(projection, pixels + step, heights) - points for step in np.eye(2)], axis=1) @ plane
        horizontal = self.pixel_sigma**2 * sides.mT @ sides + self.own_sigma**2 * plane
        reach = np.sqrt(0.5 * np.trace(horizontal, axis1=1, axis2=2))[:, None]
        slopes = [(self.radii(points + reach * way) - self.radii(points - reach * way)) / (2.0 * reach[:, 0])
                  for way in (level[:, 0], level[:, 1])]  # fmt: skip
        _require(np.all(np.isfinite([*slopes, *points.T]), axis=0), table, "no height of the terrain model",
                 "a position over its posts, one sigma around too")  # fmt: skip
        up, gradient = frames[:, 2], np.einsum("wn,nwj->nj", slopes, level)
        lifted = np.eye(3) + up[:, :, None] * gradient[:, None]
        covariances = lifted @ horizontal @ lifted.mT
        return points, covariances + self.height_sigma**2 * up[:, :, None] * up[:, None]

    def _on_terrain(self, projection: MapProjection, pixels: Array) -> tuple[Array, Array]:
        """Points (n, 3) in m of the terrain at rows and columns (n, 2), and their heights (n,) in m above the
        projection's ellipsoid; NaN where there is none.
        """
        heights = np.zeros(pixels.shape[0])
        for _ in range(_STEPS):
            points = _at(projection, pixels, heights)
            heights = heights + self.radii(points) - np.linalg.norm(points, axis=1)
        return _at(projection, pixels, heights), heights


def _at(projection: MapProjection, pixels: Array, heights: Array) -> Array:
    """Points (n, 3) in m, body-fixed, at rows and columns (n, 2) and heights (n,) in m above the ellipsoid."""
    longitudes, latitudes = projection.places(*pixels.T).T
    return projection.points(longitudes, latitudes, heights)


def _require(good: Mask, table: Columns, found: str, expected: str) -> None:
    """Raise InputError for the first row (n,) that is not good."""
    for k in np.flatnonzero(~good)[:1].tolist():
        where = f"{table.where(k)}, point {table.values['id'][k].as_py()}" if "id" in table.values else table.where(k)
        raise InputError(where, found, expected, "fix it, or take the point out")
