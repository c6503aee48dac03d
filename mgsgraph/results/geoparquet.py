"""Tables whose rows have a place, as GeoParquet 1.1: WKB on a sphere of the body, the system as PROJJSON.

Longitudes of shapes are -180 .. 180, as in every GIS; the column lon_deg counts from 0 to 360. The one is made from the
other without rounding: differences of 360 degrees are exact for doubles between 180 and 360.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mgsgraph.files.output.table import Column, Table, write_parquet
from mgsgraph.files.rasters.coordinate_systems import geographic_crs
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG

GEOMETRY = "geometry"
"""Name of the column."""
_VERSION = "1.1.0"
_POINT = np.dtype([("order", "u1"), ("kind", "<u4"), ("place", "<f8", 2)])
"""A point in the plane as OGC's well-known binary."""


def with_points(table: Table, places: Array) -> Table:
    """The table with a column of places (n, 3) in m, as longitude and planetocentric latitude; null where NaN."""
    longitude, latitude, _ = planetocentric(places).T
    east = longitude / DEG % 360.0
    geometry = np.empty(len(places), dtype=_POINT)
    geometry["order"], geometry["kind"] = 1, 1
    geometry["place"][:, 0] = np.where(east > 180.0, east - 360.0, east)
    geometry["place"][:, 1] = latitude / DEG
    known = np.packbits(np.isfinite(longitude), bitorder="little")
    buffers = [pa.py_buffer(known), pa.py_buffer(geometry)]
    return with_shapes(table, pa.Array.from_buffers(pa.binary(_POINT.itemsize), len(places), buffers))


def with_shapes(table: Table, shapes: Sequence[bytes | None] | pa.Array) -> Table:
    """The table with a column of shapes (n,), in degrees, as well-known binary; null for None."""
    column = shapes.cast(pa.large_binary()) if isinstance(shapes, pa.Array) else pa.array(shapes, pa.large_binary())
    return replace(table, columns=(*table.columns, Column(GEOMETRY, column, meaning="WKB, degrees")))


def write_geoparquet(path: Path, pieces: Iterable[Table], body: Ellipsoid, kinds: Sequence[str] = ("Point",)) -> None:
    """Write tables that `with_points` or `with_shapes` made, one after another, as one GeoParquet file.

    Parameters
    ----------
    path : Path
        Of the file.
    pieces : iterable of Table
        The rows.
    body : Ellipsoid
        On which they lie.
    kinds : sequence of str
        Kinds of shapes that there are, in GeoJSON's words.
    """
    about: dict[str, Any] = {
        "encoding": "WKB", "geometry_types": sorted(kinds), "crs": geographic_crs(body), "edges": "planar",
    }  # fmt: skip
    geo = {"version": _VERSION, "primary_column": GEOMETRY, "columns": {GEOMETRY: about}}
    write_parquet(path, pieces, {"geo": json.dumps(geo)})
