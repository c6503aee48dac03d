"""Tables of points and residuals, which grow with the network: CSV, or above a size Parquet (points: GeoParquet)."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.io.coordinate_systems import geographic_crs
from mgsgraph.output.table import Column, Table, write_parquet
from mgsgraph.reports.tables import points_table, residual_rows, residuals_table
from mgsgraph.units import DEG

TableForm = Literal["csv", "parquet"]
"""Form of the tables of points and residuals."""
MOST_CSV_ROWS = 200_000
"""Rows of the longer table up to which both are CSV, unless another form is asked for."""
_PIECE = 1 << 20
"""Rows written at a time, one group of a Parquet file: 0.2 GB of columns in memory."""
_GEOPARQUET = "1.1.0"
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
    places = solution.places
    points = (_with_geometry(points_table(solution, rows), places[rows]) for rows in _pieces(len(places)))
    write_parquet(folder / names[0], points, _geoparquet(solution.network.images[0].body))
    residuals = (residuals_table(solution, rows) for rows in _pieces(residual_rows(solution)))
    write_parquet(folder / names[1], residuals)
    return names


def _pieces(rows: int) -> Iterator[slice]:
    """Rows that are written at a time; once where there is none."""
    return (slice(first, min(first + _PIECE, rows)) for first in range(0, max(rows, 1), _PIECE))


def _with_geometry(table: Table, places: Array) -> Table:
    """The table with a column of places (n, 3) in m, as longitude and latitude in degrees."""
    angles = planetocentric(places)[:, :2] / DEG
    geometry = np.empty(len(angles), dtype=_POINT)
    geometry["order"], geometry["kind"] = 1, 1
    geometry["place"][:, 0], geometry["place"][:, 1] = (angles[:, 0] + 180.0) % 360.0 - 180.0, angles[:, 1]
    known = np.packbits(np.isfinite(angles[:, 0]), bitorder="little")
    buffers = [pa.py_buffer(known), pa.py_buffer(geometry)]
    column = pa.Array.from_buffers(pa.binary(_POINT.itemsize), len(angles), buffers).cast(pa.large_binary())
    return replace(table, columns=(*table.columns, Column("geometry", column, meaning="WKB, degrees")))


def _geoparquet(body: Ellipsoid) -> dict[str, str]:
    """What GeoParquet 1.1 says of the places, as metadata of the file."""
    about: dict[str, Any] = {
        "encoding": "WKB", "geometry_types": ["Point"], "crs": geographic_crs(body), "edges": "planar",
    }  # fmt: skip
    return {"geo": json.dumps({"version": _GEOPARQUET, "primary_column": "geometry", "columns": {"geometry": about}})}
