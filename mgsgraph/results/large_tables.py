"""Tables of points and residuals, which grow with the network: CSV, or above a size Parquet (points: GeoParquet)."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import write_parquet
from mgsgraph.results.geoparquet import with_points, write_geoparquet
from mgsgraph.results.tables import points_table, residual_points, residual_rows, residuals_table

TableForm = Literal["csv", "parquet"]
"""Form of the tables of points and residuals."""
MOST_CSV_ROWS = 200_000
"""Rows of the longer table up to which both are CSV, unless another form is asked for."""
_PIECE = 1 << 20
"""Rows written at a time, one group of a Parquet file: 0.2 GB of columns in memory."""


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
    write_points(solution, folder / names[0])
    residuals = (residuals_table(solution, rows) for rows in _pieces(residual_rows(solution)))
    write_parquet(folder / names[1], residuals)
    return names


def _pieces(rows: int) -> Iterator[slice]:
    """Rows that are written at a time; once where there is none."""
    return (slice(first, min(first + _PIECE, rows)) for first in range(0, max(rows, 1), _PIECE))


def write_points(solution: Solution, path: Path) -> None:
    """Write the table of points as GeoParquet, with the columns of points.csv and their places as shapes."""
    places = solution.places
    points = (with_points(points_table(solution, rows), places[rows]) for rows in _pieces(len(places)))
    write_geoparquet(path, points, solution.network.images[0].body)


def write_residuals(solution: Solution, path: Path) -> None:
    """Write the table of residuals as GeoParquet, with the columns of residuals.csv and the places of their points as
    shapes.
    """
    found = (
        with_points(residuals_table(solution, rows), solution.places[residual_points(solution, rows)])
        for rows in _pieces(residual_rows(solution))
    )
    write_geoparquet(path, found, solution.network.images[0].body)
