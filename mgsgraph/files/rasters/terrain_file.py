"""Terrain models as GeoTIFF, or another raster that stands alone, in any projection that PROJ knows.

Degrees, projected units and kilometres end here. A raster whose rows are parallels of a sphere, and whose columns are
meridians, is a TerrainGrid as it is; of any other each post is where its projection has it (`TerrainRaster`). Of a
large file only what lies around the images is read.

Where the posts of a raster lie on a body: its map projection, as PROJ knows it.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.datum import ellipsoid_of, require_surface, vertical_of
from mgsgraph.files.rasters.raster_file import open_raster, raster_understood, read_band, require_in_file
from mgsgraph.geometry.body import (
    Ellipsoid,
    ellipsoidal_heights,
    from_geodetic,
    from_planetocentric,
    geodetic,
    in_turn,
    planetocentric,
)
from mgsgraph.geometry.records import Array, Index, all_pairs
from mgsgraph.geometry.terrain import PostLattice, TerrainGrid, TerrainKind, between_nodes, window
from mgsgraph.units import DEG, KM

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_FLAT = 1e-6
"""Flattening below which an ellipsoid is a sphere."""
_OTHER_BODY = 0.02
"""Share by which the radius that a projection is made for may differ from the body's: polar ones may have its polar
radius (0.6 % less on Mars), and no two bodies are closer (Earth and Venus, 5 %).
"""
_GRIDS = re.compile(r"\b(?:nadgrids|geoidgrids|grids|init)\s*=", re.IGNORECASE)
"""By which PROJ opens files."""
_CYLINDRICAL = ("longlat", "eqc", "merc", "mill", "cea")
"""PROJ's names of projections whose columns are meridians at equal steps."""


class MapProjection(NamedTuple):
    """Where the pixels of a file are."""

    source: str
    """The file."""
    wkt: str
    """Its coordinate reference system."""
    terms: dict[str, Any]
    """The same as PROJ has it: proj, lat_ts, ..."""
    ellipsoid: Ellipsoid
    """Of its latitudes, which are planetographic, or planetocentric where it is a sphere."""
    affine: Array
    """(2, 3) x and y in the system's unit of (column, row, 1), at the centres of the pixels."""
    unit: float
    """m, of x and y where they are lengths."""

    @property
    def name(self) -> str:
        """What PROJ calls it."""
        return str(self.terms.get("proj", "unknown"))

    @property
    def sphere(self) -> bool:
        """Whether latitudes are planetocentric."""
        return abs(self.ellipsoid.equatorial / self.ellipsoid.polar - 1.0) < _FLAT

    @property
    def upright(self) -> bool:
        """Whether rows go along x and columns against y."""
        return bool(np.all(self.affine[[0, 1], [1, 0]] == 0.0) and self.affine[0, 0] > 0.0 > self.affine[1, 1])

    @property
    def by_meridians(self) -> bool:
        """Whether pixels lie at equal steps of longitude and planetocentric latitude, to the south and to the east."""
        plain = self.name == "longlat" or (self.name == "eqc" and self.terms.get("lat_0", 0.0) == 0.0)
        return plain and self.upright and self.sphere and "pm" not in self.terms

    def places(self, rows: Array, columns: Array) -> Array:
        """(n, 2) rad, longitudes (eastward) and latitudes of pixels (n,), fractional ones too."""
        return self._transformed(self.wkt, self._degrees, *self.affine @ [columns, rows, np.ones(rows.size)]) * DEG

    def pixels(self, longitudes: Array, latitudes: Array) -> Array:
        """(n, 2) fractional rows and columns of places (n,) in rad."""
        plane = self._transformed(self._degrees, self.wkt, longitudes / DEG, latitudes / DEG) - self.affine[:, 2]
        return np.asarray(np.linalg.solve(self.affine[:, :2], plane.T)[::-1].T)

    def pixels_of(self, points: Array) -> Array:
        """(n, 2) fractional rows and columns of points (n, 3) in m, body-fixed."""
        return self.pixels(*(planetocentric(points) if self.sphere else geodetic(points, self.ellipsoid)).T[:2])

    def points(self, longitudes: Array, latitudes: Array, upward: Array) -> Array:
        """(n, 3) m, body-fixed, at places (n,) in rad and heights (n,) in m above the ellipsoid."""
        if not self.sphere:
            return from_geodetic(np.column_stack([longitudes, latitudes, upward]), self.ellipsoid)
        return from_planetocentric(np.column_stack([longitudes, latitudes, self.ellipsoid.equatorial + upward]))

    def turn(self) -> float | None:
        """Columns in a full turn of longitude, where they are meridians."""
        if self.name not in _CYLINDRICAL or not self.upright:
            return None
        middle = float(self.terms.get("lon_0", 0.0)) * DEG
        columns = self.pixels(middle + np.array([0.0, DEG]), np.zeros(2))[:, 1]
        return 360.0 * float(columns[1] - columns[0]) if np.all(np.isfinite(columns)) else None

    def cut(self, row: int, column: int) -> "MapProjection":
        """With another first pixel."""
        return self._replace(affine=np.column_stack([self.affine[:, :2], self.affine @ [column, row, 1.0]]))

    @property
    def _degrees(self) -> str:
        return f"+proj=longlat +a={self.ellipsoid.equatorial!r} +b={self.ellipsoid.polar!r} +no_defs"

    def _transformed(self, source: str, target: str, x: Array, y: Array) -> Array:
        from rasterio.warp import transform

        with raster_understood(self.source, f"a model of the images' ground in its projection {self.name!r}"):
            return np.column_stack(transform(source, target, x, y)).reshape(-1, 2)


def map_projection(file: "DatasetReader", path: Path, body: Ellipsoid | None) -> MapProjection:
    """Of an open raster, which has to be of a body; InputError where it has none, or is of another body."""
    require_in_file(path, ("SRS", "GeoTransform", "GCPList", "GeodataXform"))
    with raster_understood(path, "a raster in a map projection"):
        return _of_crs(file, file.crs, path, body)


def _of_crs(file: "DatasetReader", crs: Any, path: Path, body: Ellipsoid | None) -> MapProjection:
    if not crs or file.transform.is_identity:
        found = "no coordinate reference system" if not crs else "no place of its pixels"
        raise InputError(str(path), found, "a raster in a map projection", "state it with gdal_edit.py -a_srs, -a_ullr")
    ellipsoid = ellipsoid_of(crs, str(path))
    radii = np.array([ellipsoid.equatorial, ellipsoid.polar])
    if body is not None and not np.all(  # of flat ones there are maps on spheres between
        (radii > body.polar * (1.0 - _OTHER_BODY)) & (radii < body.equatorial * (1.0 + _OTHER_BODY))
    ):
        size = f"{radii[0] / KM:.0f}" + (f" x {radii[1] / KM:.0f}" if round(radii[1] / radii[0], 1) != 1.0 else "")
        raise InputError(
            str(path), f"coordinates on a body of {size} km",
            f"those of the images' body of {body.equatorial / KM:.0f} km", "if they are, state so: gdal_edit.py -a_srs",
        )  # fmt: skip
    if grids := _GRIDS.search(wkt := crs.to_wkt()):
        raise InputError(str(path), f"a coordinate system by other files ({grids[0]})", "one by its own numbers")
    corners: Array = np.array(file.transform[:6]).reshape(2, 3)
    centres = np.column_stack([corners[:, :2], corners @ [0.5, 0.5, 1.0]])
    unit = 1.0 if crs.is_geographic or not crs.is_projected else float(crs.linear_units_factor[1])
    return MapProjection(str(path), wkt, crs.to_dict(), ellipsoid, centres, unit)


# --- terrain models

Reference = float | Ellipsoid | TerrainGrid
"""What a file's heights are above: a sphere by its radius (m; zero: they are radii), an ellipsoid, along its normal, or
the areoid.
"""
_UNITS = {"": 1.0, "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0} | dict.fromkeys(
    ("km", "kilometre", "kilometer", "kilometres", "kilometers"), KM
)
"""m, by what a file calls the unit of its heights; metres where it says nothing."""
_MARGIN = 4
"""Posts kept beyond the points around which a file is read."""
_STEPS = 3
"""Of the search for the point at a place and height: each leaves 1e-5 of the error of the one before."""
_MOST = 1 << 24
"""Posts of a grid of the raster's extent."""
_EDGE = 1e-6
"""Pixels by which a place may lie beyond the outermost posts and still be taken for one on them (rounding)."""
_NULL = 1e30
"""What is beyond is no height: special values of ISIS, and of programs that don't say which they write."""
_RELIEF, _SMALL_BODY, _ANOTHER = 0.009, 0.3, 0.05
"""Shares of a body's equatorial radius that heights on it reach at most, flattening included: Mars's poles lie 20 km
below the equator's level, and -32768 m is no height; those of a body of less than `_ROUND` (Vesta's south pole lies
70 km below its equator's 285 km, Phobos's 3.9 km below 13.0 km); and from which on all posts are another body's.
"""
_ROUND = 1e6
"""m, radius from which on bodies are round."""
_CHUNK = 1 << 20
"""Of these at once."""
_SEVERAL, _TAG_GAP, _LEAST_GAP = 3, 0.5, 500.0
"""Posts of one value, and the gap to all others (share of their range, and m), that are no terrain."""
_OUTLINE = 65
"""Rows and columns by which the extent of a raster is found."""
_NEAR_POLE = 75.0 * DEG
"""Latitude, rad, beyond which a raster may hold a pole."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainRaster:
    """Heights or radii in rows and columns of a projection, not along meridians and parallels of a sphere."""

    source: str
    """File it comes from, for messages."""
    values: NDArray[np.float32] | Array
    """(rows, columns) m, above `reference`; NaN where a post is missing."""
    projection: MapProjection
    reference: Reference
    vertical_sigma: float | None = None
    """m, of a post; None where unknown."""
    planimetric_sigma: float | None = None
    """m, of the posts' common horizontal place; None where unknown."""

    def points(self, rows: Array, columns: Array, values: Array) -> Array:
        """Points (n, 3) in m, body-fixed, at rows and columns (n,), fractional ones too, with values (n,) in m."""
        longitudes, latitudes = self.projection.places(rows, columns).T
        upward = np.zeros(rows.size)
        for _ in range(_STEPS):
            upward += values - self._height(self.projection.points(longitudes, latitudes, upward))
        return self.projection.points(longitudes, latitudes, upward)

    def lattice(self) -> PostLattice:
        """Its posts."""
        return PostLattice(self.source, self.values, self.points, self.vertical_sigma, self.planimetric_sigma)

    def grid(self, kind: TerrainKind = "radius") -> TerrainGrid:
        """Radii at equal steps of longitude and planetocentric latitude, as far apart as its posts, bilinear between
        these; missing ones where one of the four is.

        Raises
        ------
        InputError
            Where that is too many posts.
        """
        low, high, step = self._extent()
        if not (np.all(step > 0.0) and np.all(np.isfinite([low, high, step]))):
            found = f"posts whose places don't tell where they lie, in the projection {self.projection.name!r}"
            raise InputError(self.source, found, "places on the body", "look at them: gdalinfo")
        columns, rows = (np.ceil((high - low) / step).astype(int) + 1).tolist()
        if rows * columns > _MOST:
            raise InputError(
                self.source, f"{rows} x {columns} posts under the images, in the projection {self.projection.name!r}",
                f"{_MOST} at most, for tie points on it", "average it (gdalwarp -tr), or name it after the first",
            )  # fmt: skip
        step = (high - low) / [columns - 1, rows - 1]
        wraps = bool(high[0] - low[0] == 2.0 * np.pi)
        columns -= wraps
        longitudes, latitudes = np.meshgrid(
            low[0] + step[0] * np.arange(columns), np.linspace(high[1], low[1], rows)
        )
        parts = np.array_split(np.arange(rows), -(-rows * columns // _CHUNK))
        radii = [self._radii(longitudes[part].ravel(), latitudes[part].ravel()) for part in parts]
        return TerrainGrid(
            self.source, np.concatenate(radii).reshape(rows, columns), float(low[0]), float(high[1]), float(step[0]),
            float(step[1]), wraps, kind, self.vertical_sigma, self.planimetric_sigma,
        )  # fmt: skip

    def at(self, points: Array) -> Array:
        """Radii (n,) in m under points (n, 3) in m, body-fixed; NaN beside the posts and at missing ones."""
        return self._radii(*planetocentric(points).T[:2])

    def _height(self, points: Array) -> Array:
        """(n,) m, of points (n, 3) above the reference."""
        if isinstance(self.reference, Ellipsoid):
            return np.asarray(ellipsoidal_heights(points, self.reference))
        level = self.reference.at(points) if isinstance(self.reference, TerrainGrid) else self.reference
        return np.asarray(np.linalg.norm(points, axis=1) - level)

    def _extent(self) -> tuple[Array, Array, Array]:
        """Least and largest longitude and latitude of its posts, and steps as wide as those between them; (2,) rad."""
        last, level = np.array(self.values.shape) - 1.0, float(np.nanmean(self.values))
        row, column = all_pairs(*(np.linspace(0.0, end, _OUTLINE) for end in last)).T
        longitudes, latitudes, radii = planetocentric(self.points(row, column, np.full(row.size, level))).T
        longitudes = in_turn(longitudes, float(np.angle(np.mean(np.exp(1j * longitudes)))))
        low, high = (np.array([cut(longitudes), cut(latitudes)]) for cut in (np.nanmin, np.nanmax))
        for side in (-1.0, 1.0):
            if side * low[1] < _NEAR_POLE and side * high[1] < _NEAR_POLE:
                continue
            at = self.projection.pixels(np.zeros(1), np.array([0.5 * side * np.pi]))[0]
            if np.all(np.abs(at - 0.5 * last) <= 0.5 * last):
                low[0], high[0] = -np.pi, np.pi
                (low if side < 0.0 else high)[1] = 0.5 * side * np.pi
        middle = 0.5 * last + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        places = self.points(middle[:, 0], middle[:, 1], np.full(3, level))
        side = float(np.linalg.norm(places[1:] - places[0], axis=1).min() / np.nanmean(radii))
        nearest = 0.0 if low[1] < 0.0 < high[1] else min(abs(low[1]), abs(high[1]))
        return low, high, np.array([side / np.cos(nearest), side])

    def _radii(self, longitudes: Array, latitudes: Array) -> Array:
        """(n,) m at planetocentric places (n,) in rad; NaN beside the posts and at missing ones."""
        last = np.array(self.values.shape) - 1.0
        all_radii, indices = np.full(longitudes.size, np.nan), np.arange(longitudes.size)
        radii = np.full(longitudes.size, self.projection.ellipsoid.equatorial)
        values = np.zeros(0)
        for step in range(_STEPS):
            points = from_planetocentric(np.column_stack([longitudes[indices], latitudes[indices], radii]))
            if step == 0 or not self.projection.sphere:  # on an ellipsoid latitudes depend on the height a little
                at = self.projection.pixels_of(points)
                inside = np.all((at > -_EDGE) & (at < last + _EDGE), axis=1)
                at[~inside] = 0.0
                values = between_nodes(self.values, np.clip(at, 0.0, last))
                inside &= np.isfinite(values)
                indices, radii, values, points = indices[inside], radii[inside], values[inside], points[inside]
            radii += values - self._height(points)
        all_radii[indices] = radii
        return all_radii


def read_terrain(
    path: Path,
    reference: Reference = 0.0,
    kind: TerrainKind = "radius",
    vertical_sigma: float | None = None,
    planimetric_sigma: float | None = None,
    near: Array | None = None,
    body: Ellipsoid | None = None,
) -> TerrainGrid | TerrainRaster | None:
    """Read a terrain model, or the part of it around points; None where it has nothing there.

    Parameters
    ----------
    path : Path
        GeoTIFF or another raster, first band: scale, offset and unit are applied, missing posts are NaN. Its coordinate
        reference system says whether latitudes are planetocentric (a sphere) or planetographic (an ellipsoid).
    reference : float, Ellipsoid or TerrainGrid
        What the file's heights are above: the radius of a sphere (m), an ellipsoid, or the areoid's radii. Zero: values
        are radii.
    kind : str
        What the values are without a reference: "radius", "topography" (above the areoid) or "areoid".
    vertical_sigma, planimetric_sigma : float, optional
        m, handed on.
    near : (n, 3), optional
        m, body-fixed; all of the file is read when absent.
    body : Ellipsoid, optional
        Whose terrain it has to be.

    Returns
    -------
    TerrainGrid
        Where posts lie at equal steps of longitude and planetocentric latitude.
    TerrainRaster
        Anywhere else.

    Raises
    ------
    InputError
        Where the file can't be read, is of another body, has no place, or holds heights although radii are asked for.
    """
    with open_raster(path, "a terrain model") as file:
        projection, turn = map_projection(file, path, body), None
        require_surface(*vertical_of(file.crs), _surface(reference, kind), str(path))
        rows, columns = slice(0, file.height), np.arange(file.width)
        if near is not None or projection.by_meridians:
            turn = projection.turn()
        wraps = turn is not None and abs(turn - file.width) < 0.5
        if near is not None:
            around = window(projection.pixels_of(near), file.shape, _MARGIN, file.width if wraps else turn, wraps)
            if around is None:
                return None
            rows, columns = around
        values = _values(file, rows, columns, path)
    require(
        kind != "topography" or projection.by_meridians, str(path), f"topography in the projection {projection.name!r}",
        "geographic or simple cylindrical coordinates on a sphere", "give areoid, and heights above it as radius",
    )  # fmt: skip
    _require_plausible(values, reference, kind, path, body)
    raster = TerrainRaster(
        str(path), values, projection.cut(rows.start, int(columns[0])), reference, vertical_sigma, planimetric_sigma
    )
    return _by_meridians(raster, kind, turn if wraps else None) if projection.by_meridians else raster


def _surface(reference: Reference, kind: TerrainKind) -> str:
    """Reference surface of heights, as the case states it; empty for counts."""
    if kind == "counts":
        return ""
    if isinstance(reference, float):
        return "areoid" if kind == "topography" else "sphere" if reference else "radius"
    return "ellipsoid" if isinstance(reference, Ellipsoid) else "areoid"


def _values(file: "DatasetReader", rows: slice, columns: Index, path: Path) -> NDArray[Any]:
    """(rows, columns) m; NaN where a post is missing."""
    from rasterio.windows import Window

    require_in_file(path, ("Scale", "Offset", "UnitType"))
    unit = (file.units[0] or "").strip().lower()
    if unit not in _UNITS:
        raise InputError(str(path), f"heights in {unit!r}", "metres or kilometres", "state it: gdal_edit.py -units m")
    if not file.dtypes[0].startswith(("int", "uint", "float")):
        raise InputError(str(path), f"posts of type {file.dtypes[0]}", "heights")
    scale, offset = file.scales[0] * _UNITS[unit], file.offsets[0] * _UNITS[unit]
    if not (0.0 < abs(scale) < _NULL and abs(offset) < _NULL):
        raise InputError(str(path), f"a scale of {scale:g} and an offset of {offset:g}", "a scale of heights")
    high = rows.stop - rows.start
    runs = [
        read_band(file, path, Window(int(run[0]), rows.start, run.size, high), masked=True)
        for run in np.split(columns, np.flatnonzero(np.diff(columns) != 1) + 1)
    ]
    posts = runs[0] if len(runs) == 1 else np.ma.hstack(runs)
    exact = posts.dtype in (np.float32, np.int16, np.uint16, np.uint8) and (scale, offset) == (1.0, 0.0)
    values = np.ma.filled(posts.astype(np.float32 if exact else np.float64), np.nan)
    values[~(np.abs(values) < _NULL)] = np.nan
    return values if exact else values * scale + offset


def _by_meridians(raster: TerrainRaster, kind: TerrainKind, turn: float | None) -> TerrainGrid:
    """A raster whose posts lie at equal steps of longitude and planetocentric latitude, `turn` columns all around."""
    projection, (rows, columns) = raster.projection, raster.values.shape
    terms, affine = projection.terms, projection.affine
    scale, origin = np.array([DEG, DEG]), np.zeros(2)
    if projection.name != "longlat":
        radius = projection.ellipsoid.equatorial
        scale = 1.0 / (radius * np.array([np.cos(float(terms.get("lat_ts", 0.0)) * DEG), 1.0]))
        false = np.array([float(terms.get("x_0", 0.0)), float(terms.get("y_0", 0.0))])
        origin, scale = np.array([float(terms.get("lon_0", 0.0)) * DEG, 0.0]) - false * scale, scale * projection.unit
    (longitude, latitude), step = origin + scale * affine[:, 2], scale * [affine[0, 0], -affine[1, 1]]
    wraps = turn is not None and columns == round(turn)
    if wraps:  # metres on a rounded radius don't come out as a whole turn
        step[0] = 2.0 * np.pi / columns
    if isinstance(raster.reference, float):
        radii = raster.values + raster.reference if raster.reference else raster.values
    else:
        i, j = (index.ravel() for index in np.indices((rows, columns), dtype=np.float64))
        radii = np.linalg.norm(raster.points(i, j, raster.values.ravel().astype(np.float64)), axis=1)
    return TerrainGrid(
        raster.source, radii.reshape(rows, columns), float(longitude), float(latitude), float(step[0]), float(step[1]),
        wraps, kind, raster.vertical_sigma, raster.planimetric_sigma,
    )  # fmt: skip


def _require_plausible(
    values: NDArray[Any], reference: Reference, kind: TerrainKind, path: Path, body: Ellipsoid | None
) -> None:
    require(np.any(np.isfinite(values)), str(path), "no valid value", "a terrain model")
    extremes = np.array([np.nanmin(values), np.nanmax(values)], dtype=np.float64)
    if reference == 0.0 and kind != "topography" and extremes[0] < 1e5:
        raise InputError(
            str(path), f"values from {extremes[0]:g} m on", "radii",
            "say above what they are: reference_radius_m = 3396190.0, reference_ellipsoid_m or areoid",
        )
    if kind == "counts":
        return
    _require_tagged(values, path)
    if body is None:
        return
    level = 0.0 if kind == "topography" or not isinstance(reference, float) else body.equatorial - reference
    near, off = sorted(extremes, key=lambda post: abs(post - level))
    share = _RELIEF if body.equatorial > _ROUND else _SMALL_BODY
    most = share * body.equatorial
    if abs(off - level) > most and abs(near - level) < max(share, _ANOTHER) * body.equatorial:
        raise InputError(
            str(path), f"a post of {off:g} m", f"posts within {most / KM:.0f} km of {level / KM:g} km",
            "say above what they are and in which unit; state the value of missing ones: gdal_edit.py -a_nodata",
        )  # fmt: skip


def _require_tagged(values: NDArray[Any], path: Path) -> None:
    """Raise InputError where many posts have one value far from all others, as those that stand for missing ones do."""
    finite = values[np.isfinite(values)]
    for value, side in ((finite.min(), 1.0), (finite.max(), -1.0)):
        rest = finite[finite != value]
        if min(rest.size, finite.size - rest.size) < _SEVERAL:
            continue
        gap = float(np.min(side * (rest - value)))
        if gap > max(_TAG_GAP * float(np.ptp(rest)), _LEAST_GAP):
            found = f"{finite.size - rest.size} posts of {value:g} m, {gap:.0f} m from all others"
            remedy = "state the value of missing posts: gdal_edit.py -a_nodata"
            raise InputError(str(path), found, "terrain", remedy)
