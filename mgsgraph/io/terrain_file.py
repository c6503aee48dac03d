"""Terrain models as GeoTIFF (or whatever else GDAL opens) to a TerrainGrid: geographic or simple cylindrical.

Degrees and projected metres end here.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid, TerrainKind
from mgsgraph.io.pictures import open_raster
from mgsgraph.units import DEG

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_FLAT = 1e-6
"""Flattening below which an ellipsoid is a sphere."""
_PROJECTIONS = ("eqc",)
"""PROJ names of simple cylindrical (equirectangular) projections."""


def read_terrain(
    path: Path,
    reference_radius: float | None = None,
    kind: TerrainKind = "radius",
    vertical_sigma: float | None = None,
    planimetric_sigma: float | None = None,
) -> TerrainGrid:
    """Read a terrain model whose rows are parallels and whose columns are meridians.

    Parameters
    ----------
    path : Path
        GeoTIFF, first band (scale and offset are applied, missing posts are NaN), in geographic or simple cylindrical
        coordinates on a sphere (latitudes planetocentric).
    reference_radius : float, optional
        m, added to every value: the sphere above which the file has heights (3396190 for most of Mars). Without it
        values must be radii.
    kind : str
        What the values are then: "radius", "topography" (above the areoid) or "areoid".
    vertical_sigma, planimetric_sigma : float, optional
        m, handed on to the grid.

    Raises
    ------
    InputError
        Where the file can't be read, is turned or in another projection, has no place, or holds heights although
        radii are asked for.
    """
    with open_raster(path, "a GeoTIFF") as file:
        posts = file.read(1, masked=True)
        longitude, latitude, longitude_step, latitude_step = _first_post_and_steps(file, path)
        scale, offset = file.scales[0], file.offsets[0]
    values = np.ma.filled(posts.astype(np.float64), np.nan)
    values[~np.isfinite(values)] = np.nan
    values = values * scale + offset
    values += reference_radius or 0.0
    _require_plausible(values, kind, path)
    wraps = abs(values.shape[1] * longitude_step - 2.0 * np.pi) < 0.5 * longitude_step
    if wraps:  # metres on a rounded radius don't come out as a whole turn
        longitude_step = 2.0 * np.pi / values.shape[1]
    return TerrainGrid(
        str(path), values, longitude, latitude, longitude_step, latitude_step, wraps=wraps, kind=kind,
        vertical_sigma=vertical_sigma, planimetric_sigma=planimetric_sigma,
    )


def _first_post_and_steps(file: "DatasetReader", path: Path) -> tuple[float, float, float, float]:
    """Longitude and latitude of the first post, and the steps, rad."""
    crs: Any = file.crs
    if not crs:
        raise InputError(str(path), "no coordinate reference system", "geographic or simple cylindrical coordinates")
    t = file.transform
    if t.b or t.d or t.a <= 0.0 or t.e >= 0.0:
        raise InputError(str(path), "a raster that is turned or mirrored", "rows that go south, columns that go east")
    _require_sphere(crs.to_dict(), path)
    origin = np.array([0.0, 0.0])
    if crs.is_geographic:
        scale = np.array([DEG, DEG])
    else:
        terms = crs.to_dict()
        if terms.get("proj") not in _PROJECTIONS or terms.get("lat_0", 0.0) != 0.0:
            found = f"the projection {terms.get('proj', 'unknown')!r}"
            raise InputError(str(path), found, "geographic or simple cylindrical coordinates", "warp it with gdalwarp")
        radius = _radius(terms, path)
        scale = 1.0 / (radius * np.array([np.cos(float(terms.get("lat_ts", 0.0)) * DEG), 1.0]))
        false = np.array([float(terms.get("x_0", 0.0)), float(terms.get("y_0", 0.0))])
        origin = np.array([float(terms.get("lon_0", 0.0)) * DEG, 0.0]) - false * scale
    corner: Array = origin + scale * np.array([t.c + 0.5 * t.a, t.f + 0.5 * t.e])
    step: Array = scale * np.array([t.a, -t.e])
    return float(corner[0]), float(corner[1]), float(step[0]), float(step[1])


def _require_sphere(terms: dict[str, Any], path: Path) -> None:
    """Latitudes on an ellipsoid are planetographic: on Mars up to 0.34 degrees, 20 km, from planetocentric ones."""
    a, b = float(terms.get("a", 1.0)), float(terms.get("b", terms.get("a", 1.0)))
    if abs(a / b - 1.0) > _FLAT or any(key in terms for key in ("rf", "f", "ellps", "datum")):
        raise InputError(
            str(path), "coordinates on an ellipsoid", "on a sphere (planetocentric latitudes)", "warp it with gdalwarp"
        )


def _radius(terms: dict[str, Any], path: Path) -> float:
    """m, of the projection's sphere; on an ellipsoid PROJ's simple cylindrical takes the equatorial radius."""
    for key in ("R", "a"):
        if key in terms:
            return float(terms[key])
    raise InputError(str(path), "a projection on a named ellipsoid", "one that states its radius (+R or +a)")


def _require_plausible(values: Array, kind: TerrainKind, path: Path) -> None:
    if not np.any(np.isfinite(values)):
        raise InputError(str(path), "no valid value", "a terrain model")
    if kind != "topography" and np.nanmin(values) < 1e5:
        raise InputError(
            str(path), f"values from {np.nanmin(values):g} m on", "radii",
            "say above which sphere they are: reference_radius_m = 3396190.0",
        )
