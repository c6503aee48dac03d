"""Tables of points and residuals, which grow with the network: CSV, or above a size Parquet (points: GeoParquet).

GeoParquet 1.1: WKB on a sphere of the body, the system as PROJJSON. Longitudes of shapes are -180 .. 180, as in every
GIS; the column lon_deg counts from 0 to 360. The one is made from the other without rounding: differences of 360
degrees are exact for doubles between 180 and 360.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import Column, Table, write_parquet
from mgsgraph.files.rasters.coordinate_systems import geographic_crs
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.results.tables import points_table, residual_rows, residuals_table
from mgsgraph.units import DEG

TableForm = Literal["csv", "parquet"]
"""Form of the tables of points and residuals."""
MOST_CSV_ROWS = 200_000
"""Rows of the longer table up to which both are CSV, unless another form is asked for."""
_PIECE = 1 << 20
"""Rows written at a time, one group of a Parquet file: 0.2 GB of columns in memory."""
GEOMETRY = "geometry"
"""Name of the column."""
_VERSION = "1.1.0"
_POINT = np.dtype([("order", "u1"), ("kind", "<u4"), ("place", "<f8", 2)])
"""A point in the plane as OGC's well-known binary."""


def form_of(solution: Solution, wanted: TableForm | None = None) -> TableForm:
    """The form that is asked for, or else the one for tables of this length."""
    network = solution.network
    rows = max(len(network.points), network.rays.point.size + network.ranges.point.size)
    return wanted or ("csv" if rows <= MOST_CSV_ROWS else "parquet")


def write_large_tables(solution: Solution, folder: Path, wanted: TableForm | None = None) -> list[str]:
    """Write points and residuals into a folder; the names of the two files."""
    form = form_of(solution, wanted)
    names = [f"points.{form}", f"residuals.{form}"]
    if form == "csv":
        points_table(solution).write_csv(folder / names[0])
        residuals_table(solution).write_csv(folder / names[1])
        return names
    places, body = solution.places, solution.network.images[0].body
    points = (with_points(points_table(solution, rows), places[rows]) for rows in _pieces(len(places)))
    write_geoparquet(folder / names[0], points, body)
    residuals = (residuals_table(solution, rows) for rows in _pieces(residual_rows(solution)))
    write_parquet(folder / names[1], residuals)
    return names


def _pieces(rows: int) -> Iterator[slice]:
    """Rows that are written at a time; once where there is none."""
    return (slice(first, min(first + _PIECE, rows)) for first in range(0, max(rows, 1), _PIECE))


# --- rows with a place


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


def write_geoparquet(path: Path, pieces: Iterable[Table], body: Ellipsoid) -> None:
    """Write tables that `with_points` made, one after another, as one GeoParquet file of points on a body."""
    about: dict[str, Any] = {
        "encoding": "WKB", "geometry_types": ["Point"], "crs": geographic_crs(body), "edges": "planar",
    }  # fmt: skip
    geo = {"version": _VERSION, "primary_column": GEOMETRY, "columns": {GEOMETRY: about}}
    write_parquet(path, pieces, {"geo": json.dumps(geo)})
