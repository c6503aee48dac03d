"""A terrain model as an item of a SpatioTemporal Asset Catalog."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from mgsgraph.files.output.folders import DEM
from mgsgraph.files.rasters.raster_file import MEDIA_TYPE
from mgsgraph.geometry.body import Ellipsoid, naif_id, target_name
from mgsgraph.geometry.footprint import geojson, map_bounds, map_polygon
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.registration.dem.gridding import MapGrid
from mgsgraph.registration.dem.model import Dem
from mgsgraph.units import DEG

STAC = "1.1.0"
"""Version of the specification of a STAC item."""
_EXTENSIONS = {
    "proj": "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "ssys": "https://stac-extensions.github.io/ssys/v1.1.0/schema.json",
}  # fmt: skip
_EARLIEST = datetime(1972, 1, 1, tzinfo=UTC)
"""Start of UTC."""
BANDS = ("height", "sigma", "sigma by matching", "sigma by orientation", "number of points")
ORTHO_BANDS = ("sigma east", "sigma north", "correlation of east and north")
"""Bands of dem.tif and ortho_sigma.tif, in m; the last one of either has no unit."""


def stac_item(dem: Dem, ortho: MapGrid, images: Iterable[PushbroomImage], files: Sequence[str]) -> dict[str, Any]:
    """A terrain model as an item of a SpatioTemporal Asset Catalog (STAC 1.1), as the USGS lists analysis-ready data; a
    mapping, as GeoJSON has features.

    Extensions: `projection` 2.0 (the coordinate systems have no code, but WKT2 and PROJJSON) and `ssys` 1.1, which says
    of which body the coordinates are. `geometry` and `bbox` are planetocentric degrees on that body.

    Parameters
    ----------
    dem : Dem
        The terrain model with its map.
    ortho : MapGrid
        Pixels of the ortho image.
    images : iterable of PushbroomImage
        Images from which the model was made; they give the dates.
    files : sequence of str
        Names of the other files in the folder.
    """
    grid, body = dem.model.map, Ellipsoid(dem.model.map.radius, dem.model.map.radius)
    outline = grid.points(_hull(dem), np.zeros(1))
    shape, targets = map_polygon(outline), _targets(body)
    spans = np.array([image.span for image in images])
    height = dem.reference
    described, of_ortho = (
        [{"name": name.replace(" ", "_"), "description": f"{name} above {height}" if name == BANDS[0] else name,
          "unit": "m" if name != names[-1] else "1", "data_type": "float32", "nodata": "nan"} for name in names]
        for names in (BANDS, ORTHO_BANDS)
    )  # fmt: skip
    assets: dict[str, dict[str, Any]] = {
        "dem": {
            "href": "./dem.tif", "type": MEDIA_TYPE, "title": f"Heights above {height}, sigmas and counts",
            "roles": ["data", "uncertainty"], "gsd": grid.post, "bands": described, **_raster_position(grid),
        },
        "ortho": {
            "href": "./ortho.tif", "type": MEDIA_TYPE, "title": f"Ortho image of {dem.images[dem.ortho]}",
            "roles": ["data", "visual"], "gsd": ortho.post, **_raster_position(ortho),
            "bands": [{"name": dem.images[dem.ortho], "data_type": "uint8", "nodata": 0}],
        },
        "ortho_sigma": {
            "href": "./ortho_sigma.tif", "type": MEDIA_TYPE, "title": "Sigmas of positions in the ortho image",
            "roles": ["data", "uncertainty"], "gsd": grid.post, "bands": of_ortho, **_raster_position(grid),
        },
        "record": {
            "href": f"./{DEM}", "type": "application/json", "title": "Settings, figures and sentences",
            "roles": ["metadata"],
        },
    }  # fmt: skip
    if (name := Path(DEM).with_suffix(".png").name) in files:
        assets["overview"] = {"href": f"./{name}", "type": "image/png", "title": "Relief, sigmas and checks",
                              "roles": ["overview"]}  # fmt: skip
    return {
        "type": "Feature", "stac_version": STAC,
        "stac_extensions": [_EXTENSIONS["proj"], *([_EXTENSIONS["ssys"]] if targets else [])], "id": f"{dem.name}_dem",
        "geometry": geojson(shape), "bbox": list(map_bounds(shape)),
        "properties": {
            "title": f"Terrain model {dem.name}",
            "description": f"Heights above {height} with sigmas (for sigma0 = 1), of the images "
            f"{', '.join(dem.images)}, with their adjusted orientation", "datetime": None,
            "start_datetime": _utc(float(spans[:, 0].min())), "end_datetime": _utc(float(spans[:, 1].max())),
            "gsd": grid.post, **targets, "proj:code": None, "proj:wkt2": grid.crs, "proj:projjson": grid.system,
            "proj:centroid": _centroid(outline),
        },
        "links": [], "assets": assets,
    }


def _targets(body: Ellipsoid) -> dict[str, Any]:
    """Name and class of the body in terms of EPN-TAP; empty if the body is unknown."""
    name = target_name(body)
    number = naif_id(name)
    if number is None:
        return {}
    kind = "satellite" if number % 100 != 99 else "dwarf_planet" if name == "PLUTO" else "planet"
    return {"ssys:targets": [name.title()], "ssys:target_class": kind}


def _raster_position(grid: MapGrid) -> dict[str, Any]:
    """Where the pixels of a raster are, in its coordinate system."""
    east, south = grid.west + grid.columns * grid.post, grid.north - grid.rows * grid.post
    return {
        "proj:shape": [grid.rows, grid.columns],
        "proj:transform": [grid.post, 0.0, grid.west, 0.0, -grid.post, grid.north],
        "proj:bbox": [grid.west, south, east, grid.north],
    }


def _hull(dem: Dem) -> Array:
    """(k, 2) m, closed outline around the cells that have a height."""
    grid = dem.model.map
    posts = grid.posts()[np.isfinite(dem.heights).ravel()]
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * grid.post
    cells = (posts[:, None] + corners).reshape(-1, 2)
    ring: Array = cells[ConvexHull(cells).vertices]
    return np.concatenate([ring, ring[:1]])


def _centroid(outline: Array) -> dict[str, float]:
    x, y, z = outline[:-1].mean(axis=0)
    return {"lat": float(np.arctan2(z, np.hypot(x, y)) / DEG), "lon": float(np.arctan2(y, x) / DEG)}


def _utc(time: float) -> str:
    return max(utc_of_tdb(time), _EARLIEST).isoformat(timespec="milliseconds").replace("+00:00", "Z")
