"""Where the posts of a raster lie on a body: its map projection, as PROJ knows it."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.raster_file import raster_understood, require_in_file
from mgsgraph.geometry.body import Ellipsoid, from_geodetic, from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.records import Array
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
    ellipsoid = _ellipsoid(crs, path)
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


def _ellipsoid(crs: Any, path: Path) -> Ellipsoid:
    """Of a system's latitudes, which are planetographic unless it is a sphere."""
    system, axes = crs.to_dict(projjson=True), list[dict[str, Any]]()
    while True:
        axes += system.get("coordinate_system", {}).get("axis", ())
        inner = system.get("base_crs") or system.get("source_crs") or next(iter(system.get("components", ())), None)
        if inner is None:
            break
        system = inner
    shape = system.get("datum", system.get("datum_ensemble", {})).get("ellipsoid", {})
    a = _metres(shape.get("radius", shape.get("semi_major_axis")))
    flattening = shape.get("inverse_flattening")
    b = _metres(shape.get("semi_minor_axis")) or (a * (1.0 - 1.0 / flattening) if a and flattening else a)
    said = " ".join(f"{axis.get('name')} {axis.get('direction')}" for axis in axes).lower()
    found = "coordinates of no known body"
    if a and b and "west" not in said:
        spherical = system.get("coordinate_system", {}).get("subtype") == "spherical" or "planetocentric" in said
        if a == b or not spherical:
            return Ellipsoid(a, b)
        found = "planetocentric latitudes on an ellipsoid"
    elif a and b:
        found = "longitudes positive to the west"
    raise InputError(
        str(path), found, "longitudes positive to the east, latitudes on a sphere or planetographic",
        "state its projection by gdal_edit.py -a_srs '+proj=...', with +R for planetocentric latitudes",
    )  # fmt: skip


def _metres(length: Any) -> float | None:
    """Of a number in m, or with its unit, as PROJJSON has lengths."""
    if isinstance(length, dict):
        unit = length.get("unit", "metre")
        return float(length["value"]) * (float(unit["conversion_factor"]) if isinstance(unit, dict) else 1.0)
    return None if length is None else float(length)
