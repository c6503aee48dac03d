"""Points, rays and ranges of a network as rows of the tables, and arrays of such rows again, many at a time."""

import sqlite3
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, Ranges

_CHUNK = 20_000
"""Rows at a time: Python's objects for them take ten times the room of the arrays."""
_SIZE = 72
"""bytes of a 3 x 3 matrix."""
_ZERO, _NAN = np.zeros(9).tobytes(), np.full(9, np.nan).tobytes()
_RENEW_POINT = (
    "UPDATE point SET adjusted_x = ?, adjusted_y = ?, adjusted_z = ?, sigma_x = ?, sigma_y = ?, sigma_z = ?, "
    "adjusted_covariance = ? WHERE id = ?"
)
_POINT = "id, name, class, kind, x, y, z, covariance, profile, surface_sigma"
_ADJUSTED = "adjusted_x, adjusted_y, adjusted_z, adjusted_covariance"


class Run(NamedTuple):
    """Rows without a gap in their numbers."""

    first: int
    """Number of the first row."""
    size: int
    """Number of rows."""

    @property
    def limits(self) -> tuple[int, int]:
        """First and last number."""
        return self.first, self.first + self.size - 1


def put_points(
    connection: sqlite3.Connection,
    bundle: int,
    network: Network,
    profiles: Sequence[int],
    adjusted: tuple[Array, Array],
) -> Run:
    """Write the points of a bundle; `profiles` are the numbers of the network's profiles in their table, `adjusted` the
    places and covariances.
    """
    points, (places, covariances) = network.points, adjusted
    count = len(points)
    profile: list[int | None] = [None] * count
    if network.shifts is not None:
        known = (*profiles, None)  # -1, no profile, is the last one
        profile = [known[p] for p in network.shifts.profile.tolist()]
    surface: list[float | None] = [None] * count
    if network.surface is not None:
        surface = network.surface.sigmas.tolist()
    return _put(
        connection, "point", points.ids, [bundle] * count, points.classes.tolist(), points.kinds.tolist(),
        *points.places.T.tolist(), _blobs(points.covariances, _ZERO), profile, surface,
        *_adjusted_columns(places, covariances),
    )  # fmt: skip


def put_rays(connection: sqlite3.Connection, network: Network, first_point: int, images: Index) -> Run:
    """Write the rays of a bundle; `images` are the numbers of the network's images in their table."""
    rays = network.rays
    return _put(
        connection, "ray", (rays.point + first_point).tolist(), images[rays.image].tolist(), *rays.places.T.tolist(),
        *rays.sigmas.T.tolist(), _marks(rays.back_projected, rays.point), _marks(rays.rejected, rays.point),
    )  # fmt: skip


def put_ranges(connection: sqlite3.Connection, network: Network, first_point: int, images: Index) -> Run:
    """Write the ranges of a bundle."""
    ranges = network.ranges
    return _put(
        connection, "range", (ranges.point + first_point).tolist(), images[ranges.image].tolist(),
        ranges.times.tolist(), ranges.values.tolist(), ranges.sigmas.tolist(), _marks(ranges.rejected, ranges.point),
    )  # fmt: skip


def _put(connection: sqlite3.Connection, table: str, *columns: Sequence[object]) -> Run:
    """Write rows with the next numbers of a table; `columns` in its order, without the number."""
    first = int(connection.execute(f"SELECT coalesce(max(id), 0) + 1 FROM {table}").fetchone()[0])
    run = Run(first, len(columns[0]))
    rows = zip(range(run.first, run.first + run.size), *columns, strict=True)
    connection.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * (1 + len(columns)))})", rows)
    return run


def _adjusted_columns(places: Array, covariances: Array) -> list[list[Any]]:
    """Adjusted position, its sigmas, and its covariance: seven columns of points."""
    sigmas = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    return [*places.T.tolist(), *sigmas.T.tolist(), _blobs(covariances, _NAN)]


def _marks(marks: Mask | None, like: Index) -> list[int]:
    return [0] * like.size if marks is None else marks.astype(int).tolist()


def _blobs(matrices: Array, usual: bytes) -> list[bytes | None]:
    """Bytes of matrices (n, 3, 3); None for the usual one."""
    data = np.ascontiguousarray(matrices).tobytes()
    parts = (data[k : k + _SIZE] for k in range(0, len(data), _SIZE))
    return [None if part == usual else part for part in parts]


def renew_points(connection: sqlite3.Connection, run: Run, places: Array, covariances: Array) -> None:
    """Write where the points of a run are now."""
    rows = zip(*_adjusted_columns(places, covariances), range(run.first, run.first + run.size), strict=True)
    connection.executemany(_RENEW_POINT, rows)


class StoredPoints(NamedTuple):
    """Points as they are stored."""

    numbers: Index
    """(n,) in their table."""
    points: GroundPoints
    """The points."""
    profiles: Index
    """(n,) number of each point's profile in its table; 0 for none."""
    surface_sigmas: Array
    """(n,) m; NaN where the bundle has no terrain model."""
    places: Array
    """(n, 3) m, adjusted; a-priori unless those were asked for."""
    covariances: Array
    """(n, 3, 3) m^2, the same."""


def points_of(connection: sqlite3.Connection, run: Run | None, adjusted: bool = True) -> StoredPoints:
    """Points of a run, or all points."""
    names = list[str]()
    parts = list[tuple[NDArray[Any], ...]]()
    for columns in _chunks(connection, f"{_POINT}, {_ADJUSTED}" if adjusted else _POINT, "point", run):
        number, name, point_class, kind, *rest = columns
        names += name
        matrices = [_matrices(rest[3], _ZERO)] + ([_matrices(rest[9], _NAN)] if adjusted else [])
        place = [_numbers(rest[:3])] + ([_numbers(rest[6:9])] if adjusted else [])
        profile = np.array([p or 0 for p in rest[4]], dtype=np.int64)
        parts.append(
            (*(np.array(column, dtype=np.int64) for column in (number, point_class, kind)), profile,
             _floats(rest[5]), *place, *matrices)
        )  # fmt: skip
    if not parts:
        nothing, none = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        blank = GroundPoints(Names.of(()), nothing, nothing, none, np.zeros((0, 3, 3)))
        return StoredPoints(nothing, blank, nothing, np.zeros(0), none, np.zeros((0, 3, 3)))
    number_, class_, kind_, profile_, surface, *others = (np.concatenate(column) for column in zip(*parts, strict=True))
    half = len(others) // 2
    points = GroundPoints(Names.of(names), class_, kind_, others[0], others[half])
    return StoredPoints(number_, points, profile_, surface, others[half - 1], others[-1])


def rays_of(connection: sqlite3.Connection, run: Run | None, points: Index, images: Index) -> ImageRays:
    """Rays of a run, or all; `points` and `images` are the numbers that their indices stand for."""
    names = "point, image, line, sample, sigma_line, sigma_sample, back_projected, rejected"
    point, image, line, sample, sigma_line, sigma_sample, projected, rejected = _all(connection, names, "ray", run)
    return ImageRays(
        index_among(point, points), index_among(image, images), np.stack([line, sample], axis=1),
        np.stack([sigma_line, sigma_sample], axis=1), projected.astype(bool), rejected.astype(bool),
    )  # fmt: skip


def ranges_of(connection: sqlite3.Connection, run: Run | None, points: Index, images: Index) -> Ranges:
    """Ranges of a run, or all."""
    names = "point, image, time, value, sigma, rejected"
    point, image, time, value, sigma, rejected = _all(connection, names, "range", run)
    return Ranges(index_among(point, points), index_among(image, images), time, value, sigma, rejected.astype(bool))


def index_among(numbers: NDArray[Any], known: Index) -> Index:
    """Places (...) of numbers (...) among the known ones (n,), in whatever order these are."""
    order = np.argsort(known)
    return np.asarray(order[np.searchsorted(known, numbers.astype(np.int64), sorter=order)])


def _chunks(connection: sqlite3.Connection, names: str, table: str, run: Run | None) -> Iterator[list[tuple[Any, ...]]]:
    """Columns of a table's rows, by their numbers, a chunk at a time."""
    if run is None:
        cursor = connection.execute(f"SELECT {names} FROM {table} ORDER BY id")
    else:
        cursor = connection.execute(f"SELECT {names} FROM {table} WHERE id BETWEEN ? AND ? ORDER BY id", run.limits)
    while rows := cursor.fetchmany(_CHUNK):
        yield list(zip(*rows, strict=True))


def _all(connection: sqlite3.Connection, names: str, table: str, run: Run | None) -> list[Array]:
    """Columns of numbers."""
    parts = [[_floats(column) for column in columns] for columns in _chunks(connection, names, table, run)]
    if not parts:
        return [np.zeros(0) for _ in names.split(",")]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _floats(column: ArrayLike) -> Array:
    """NULL becomes NaN."""
    return np.array(column, dtype=np.float64)


def _numbers(columns: Sequence[ArrayLike]) -> Array:
    return np.stack([_floats(column) for column in columns], axis=1)


def _matrices(column: Sequence[bytes | None], usual: bytes) -> Array:
    """(n, 3, 3), the usual one for NULL."""
    return np.frombuffer(b"".join(usual if blob is None else blob for blob in column), "<f8").reshape(-1, 3, 3)
