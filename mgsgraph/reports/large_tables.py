"""Tables of points and residuals, which grow with the network: CSV, or above a size Parquet (points: GeoParquet)."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.output.table import Column, Table
from mgsgraph.reports.tables import points_table, residuals_table
from mgsgraph.units import DEG

TableForm = Literal["csv", "parquet"]
"""Form of the tables of points and residuals."""
MOST_CSV_ROWS = 200_000
"""Rows of the longer table up to which both are CSV, unless another form is asked for."""
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
    points, head = _with_geometry(points_table(solution), solution)
    points.write_parquet(folder / names[0], head)
    residuals_table(solution).write_parquet(folder / names[1])
    return names


def _with_geometry(table: Table, solution: Solution) -> tuple[Table, dict[str, str]]:
    """The table with a column of places, longitude and latitude in degrees, and what GeoParquet 1.1 says of it."""
    body = solution.network.images[0].body
    places = planetocentric(solution.places)[:, :2] / DEG
    geometry = np.empty(len(places), dtype=_POINT)
    geometry["order"], geometry["kind"] = 1, 1
    geometry["place"][:, 0], geometry["place"][:, 1] = (places[:, 0] + 180.0) % 360.0 - 180.0, places[:, 1]
    missing = np.packbits(np.isfinite(places[:, 0]), bitorder="little")
    buffers = [pa.py_buffer(missing), pa.py_buffer(geometry)]
    column = pa.Array.from_buffers(pa.binary(_POINT.itemsize), len(places), buffers).cast(pa.large_binary())
    about: dict[str, Any] = {
        "encoding": "WKB", "geometry_types": ["Point"], "crs": projjson(body), "edges": "planar",
    }  # fmt: skip
    head = {"geo": json.dumps({"version": _GEOPARQUET, "primary_column": "geometry", "columns": {"geometry": about}})}
    return replace(table, columns=(*table.columns, Column("geometry", column, meaning="WKB, degrees"))), head


def projjson(body: Ellipsoid) -> dict[str, Any]:
    """Planetocentric longitude and latitude in degrees on a sphere of the body's equatorial radius, as PROJJSON."""
    name = f"Planetocentric, sphere of {body.equatorial:.3f} m"
    ellipsoid = {"name": name, "radius": body.equatorial}
    axes = [
        {"name": f"Planetocentric {word}", "abbreviation": short, "direction": way, "unit": "degree"}
        for word, short, way in (("longitude", "Lon", "east"), ("latitude", "Lat", "north"))
    ]
    return {
        "$schema": "https://proj.org/schemas/v0.7/projjson.schema.json",
        "type": "GeographicCRS",
        "name": name,
        "datum": {
            "type": "GeodeticReferenceFrame", "name": name, "ellipsoid": ellipsoid,
            "prime_meridian": {"name": "Reference meridian", "longitude": 0},
        },
        "coordinate_system": {"subtype": "ellipsoidal", "axis": axes},
    }  # fmt: skip
