"""Projects up to format 6, whose points and measures had a row each: their rows become packed columns."""

import sqlite3
from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Ranges
from mgsgraph.project.columns import HEIGHTS, Cells, index_among, put_adjusted, put_points, put_ranges, put_rays

LAST_WITH_ROWS = 6
"""The last format with a row for each point and measure."""
_POINT = (
    "name, class, kind, profile, surface_sigma, x, y, z, covariance, adjusted_x, adjusted_y, adjusted_z, "
    "adjusted_covariance"
)
_RAY = "point, image, line, sample, sigma_line, sigma_sample, back_projected, rejected"
_RANGE = "point, image, time, value, sigma, rejected"
_HEIGHT = "point, surface, sigma, rejected, level"
_DONE_WITH = ("VIEW measures", "TABLE stereo_height", "TABLE range", "TABLE ray", "TABLE point")
_RUNS = ("first_point", "first_ray", "first_range")
_ZERO, _NAN = np.zeros(9).tobytes(), np.full(9, np.nan).tobytes()


def pack_rows(connection: sqlite3.Connection) -> None:
    """Pack the rows of all bundles into the tables of columns, which are empty, and take the tables of rows out."""
    cells = Cells(connection)
    for number, *runs in connection.execute(
        "SELECT id, first_point, points, first_ray, rays, first_range, ranges FROM bundle ORDER BY id"
    ).fetchall():
        images = [row[0] for row in connection.execute(
            "SELECT image FROM bundle_image WHERE bundle = ? ORDER BY position", (number,)
        )]  # fmt: skip
        _pack_bundle(cells, connection, number, runs, np.array(images, dtype=np.int64))
    for done in _DONE_WITH:
        connection.execute(f"DROP {done}")
    for column in _RUNS:
        connection.execute(f"ALTER TABLE bundle DROP COLUMN {column}")


def _pack_bundle(
    cells: Cells, connection: sqlite3.Connection, number: int, runs: Sequence[int], images: Index
) -> None:
    first = runs[0]
    name, class_, kind, profile, sigma, *rest = _columns(connection, _POINT, "point", "id", *runs[:2])
    places, adjusted = (np.stack([_floats(column) for column in rest[k : k + 3]], axis=1) for k in (0, 4))
    classes, kinds = (np.array(column, dtype=np.int64) for column in (class_, kind))
    points = GroundPoints(Names.of(name), classes, kinds, places, _matrices(rest[3], _ZERO))
    profiles = np.array([p or 0 for p in profile], dtype=np.int64)
    put_points(cells, number, points, profiles, np.array([np.inf if s is None else s for s in sigma], dtype=float))
    put_adjusted(cells, number, adjusted, _matrices(rest[7], _NAN))
    point, image, *ray = map(_floats, _columns(connection, _RAY, "ray", "id", *runs[2:4]))
    marks = (mark.astype(bool) for mark in ray[4:])
    put_rays(cells, number, ImageRays(
        _numbers(point) - first, index_among(_numbers(image), images), np.stack(ray[:2], axis=1),
        np.stack(ray[2:4], axis=1), *marks,
    ))  # fmt: skip
    ranges = map(_floats, _columns(connection, _RANGE, "range", "id", *runs[4:]))
    point, image, time, value, range_sigma, rejected = ranges
    if point.size:
        indices = _numbers(point) - first, index_among(_numbers(image), images)
        put_ranges(cells, number, Ranges(*indices, time, value, range_sigma, rejected.astype(bool)))
    point, surface, *height = map(_floats, _columns(connection, _HEIGHT, "stereo_height", "point", *runs[:2]))
    if point.size:
        cells.put("height_columns", number, point.size, HEIGHTS, (_numbers(point) - first, surface, *height))
        rows = [(number, one) for one in np.unique(_numbers(surface)).tolist()]
        connection.executemany("INSERT INTO bundle_surface VALUES (?, ?)", rows)


def _columns(
    connection: sqlite3.Connection, names: str, table: str, by: str, first: int, count: int
) -> list[tuple[Any, ...]]:
    """Columns of rows whose numbers have no gap."""
    rows = connection.execute(
        f"SELECT {names} FROM {table} WHERE {by} BETWEEN ? AND ? ORDER BY {by}", (first, first + count - 1)
    ).fetchall()
    return list(zip(*rows, strict=True)) if rows else [()] * len(names.split(","))


def _floats(column: Sequence[float | None]) -> Array:
    """NULL becomes NaN."""
    return np.array(column, dtype=np.float64)


def _numbers(column: Array) -> Index:
    return column.astype(np.int64)


def _matrices(column: Sequence[bytes | None], usual: bytes) -> Array:
    """(n, 3, 3), the usual one for NULL."""
    return np.frombuffer(b"".join(usual if blob is None else blob for blob in column), "<f8").reshape(-1, 3, 3)
