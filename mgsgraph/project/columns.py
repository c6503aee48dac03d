"""Points, rays, ranges and stereo heights of bundles as packed columns of the tables, and arrays of them again.

A cell holds a column of one bundle: its numbers one after another, little-endian, or a single number where all of them
are the same to the bit. Points are numbered from 0 on within their bundle, images by their position in it.
"""

import hashlib
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array, Index, Mask, concatenated
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, Ranges
from mgsgraph.network.records import StereoControl
from mgsgraph.results.archive_arrays import pack, unpack

_Columns = dict[str, tuple[str, tuple[int, ...]]]

POINTS: _Columns = {
    "class": ("i1", ()), "kind": ("i1", ()), "profile": ("<i4", ()), "surface_sigma": ("<f8", ()),
    "place": ("<f8", (3,)), "covariance": ("<f8", (3, 3)),
}  # fmt: skip
"""Type and shape of a point's part of each column of a table; in the order of the table."""
ADJUSTED: _Columns = {"place": ("<f8", (3,)), "covariance": ("<f8", (3, 3))}
RAYS: _Columns = {
    "point": ("<i4", ()), "image": ("<i4", ()), "place": ("<f8", (2,)), "sigma": ("<f8", (2,)),
    "back_projected": ("i1", ()), "rejected": ("i1", ()),
}  # fmt: skip
RANGES: _Columns = {
    "point": ("<i4", ()), "image": ("<i4", ()), "time": ("<f8", ()), "value": ("<f8", ()), "sigma": ("<f8", ()),
    "rejected": ("i1", ()),
}  # fmt: skip
HEIGHTS: _Columns = {
    "point": ("<i4", ()), "surface": ("<i4", ()), "sigma": ("<f8", ()), "rejected": ("i1", ()), "level": ("i1", ()),
}  # fmt: skip


def packed(values: NDArray[Any], kind: str) -> bytes:
    """A column's cell: `values` as numbers of a kind, or one of them where all are the same to the bit."""
    column = np.ascontiguousarray(values, dtype=kind)
    bits = column.reshape(-1).view(f"u{column.itemsize}")
    alike = bits.size > 1 and bits[0] == bits[-1] and bool(np.all(bits == bits[0]))
    return (bits[:1] if alike else bits).tobytes()


def unpacked(cell: bytes, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """The column (*shape) of a cell, read-only; ValueError where it has another size."""
    numbers = np.frombuffer(cell, kind)
    if numbers.size == 1:
        return np.broadcast_to(numbers[0], shape)
    return numbers.reshape(shape)


class Cells:
    """Tables with packed columns of bundles, on an open connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def put(
        self, table: str, bundle: int, count: int, columns: _Columns, values: Iterable[NDArray[Any] | None]
    ) -> None:
        """Write the columns of a bundle."""
        cells = [
            None if one is None else packed(one, kind) for one, (kind, _) in zip(values, columns.values(), strict=True)
        ]
        names, marks = ", ".join(columns), ", ".join("?" * (2 + len(cells)))
        statement = f"INSERT OR REPLACE INTO {table} (bundle, size, {names}) VALUES ({marks})"
        self._connection.execute(statement, (bundle, count, *cells))

    def read(self, table: str, columns: _Columns, bundle: int | None) -> Iterator[tuple[int, int, list[Any]]]:
        """Number, size and columns of one bundle, or of each bundle; zeros for a column that it has not."""
        where, values = ("", ()) if bundle is None else ("WHERE bundle = ?", (bundle,))
        statement = f"SELECT bundle, size, {', '.join(columns)} FROM {table} {where} ORDER BY bundle"
        for number, size, *cells in self._connection.execute(statement, values):
            yield number, size, [
                unpacked(bytes(np.dtype(kind).itemsize) if cell is None else cell, kind, (size, *shape))
                for cell, (kind, shape) in zip(cells, columns.values(), strict=True)
            ]

    def drop(self, tables: Sequence[str], bundle: int) -> None:
        """Take out the columns of a bundle."""
        for table in tables:
            self._connection.execute(f"DELETE FROM {table} WHERE bundle = ?", (bundle,))

    def put_names(self, bundle: int, names: Names) -> None:
        """Write the names of a bundle's points."""
        cells = names.data.tobytes(), names.offsets[1:].astype("<i4").tobytes()
        self._connection.execute("INSERT INTO point_names VALUES (?, ?, ?, ?)", (bundle, len(names), *cells))

    def names(self, bundle: int | None = None) -> tuple[Names, Index, Index]:
        """Names of the points of one bundle, or of all; numbers (b,) of these bundles and how many points each has."""
        where, values = ("", ()) if bundle is None else ("WHERE bundle = ?", (bundle,))
        statement = f"SELECT bundle, size, text, ends FROM point_names {where} ORDER BY bundle"
        rows = self._connection.execute(statement, values).fetchall()
        numbers, sizes = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(2))
        if any(len(text) != int.from_bytes(ends[-4:], "little") or len(ends) != 4 * n for _, n, text, ends in rows):
            raise ValueError("names of points that are longer or shorter than their text")
        before = np.repeat(np.cumsum([0, *(len(row[2]) for row in rows)])[:-1], sizes)
        ends = np.frombuffer(b"".join(row[3] for row in rows), "<i4") + before
        data = np.frombuffer(b"".join(row[2] for row in rows), np.uint8)
        return Names(data, np.concatenate([np.zeros(1, dtype=np.int64), ends])), numbers, sizes


class StoredPoints(NamedTuple):
    """Points as they are stored."""

    points: GroundPoints
    """The points."""
    profiles: Index
    """(n,) number of each point's profile in its table; 0 for none."""
    surface_sigmas: Array
    """(n,) m; infinite for points that lie on no terrain model."""
    places: Array
    """(n, 3) m, adjusted, NaN where undetermined or not adjusted yet."""
    covariances: Array
    """(n, 3, 3) m^2, the same."""
    runs: "dict[int, Run]"
    """Of each bundle, which of them are its points."""


class Run(NamedTuple):
    """The points of a bundle among those that were read."""

    first: int
    """The first of them."""
    size: int
    """How many."""


def put_points(
    cells: Cells, bundle: int, points: GroundPoints, profiles: Index | None, surface_sigmas: Array | None
) -> None:
    """Write the points of a bundle; `profiles` (n,) are the numbers of their profiles in their table, 0 for none."""
    cells.put_names(bundle, points.ids)
    sigmas = np.full(len(points), np.inf) if surface_sigmas is None else surface_sigmas
    values = points.classes, points.kinds, profiles, sigmas, points.places, points.covariances
    cells.put("point_columns", bundle, len(points), POINTS, values)


def put_adjusted(cells: Cells, bundle: int, places: Array, covariances: Array) -> None:
    """Write where the points of a bundle are, (n, 3) m, and their covariances, (n, 3, 3) m^2."""
    cells.put("adjusted_columns", bundle, len(places), ADJUSTED, (places, covariances))


def put_rays(cells: Cells, bundle: int, rays: ImageRays) -> None:
    """Write the rays of a bundle, if it has any."""
    if rays.point.size:
        values = rays.point, rays.image, rays.places, rays.sigmas, _marks(rays.back_projected), _marks(rays.rejected)
        cells.put("ray_columns", bundle, rays.point.size, RAYS, values)


def put_ranges(cells: Cells, bundle: int, ranges: Ranges) -> None:
    """Write the ranges of a bundle, if it has any."""
    if ranges.point.size:
        values = ranges.point, ranges.image, ranges.times, ranges.values, ranges.sigmas, _marks(ranges.rejected)
        cells.put("range_columns", bundle, ranges.point.size, RANGES, values)


def _marks(marks: Mask | None) -> Mask | None:
    return marks if marks is not None and np.any(marks) else None


def points_of(cells: Cells, bundle: int | None) -> StoredPoints:
    """Points of a bundle, or all points."""
    names, bundles, sizes = cells.names(bundle)
    rows = np.stack([bundles, np.cumsum(sizes) - sizes, sizes], axis=1).tolist()
    runs = {number: Run(first, size) for number, first, size in rows}
    class_, kind, profile, sigma, place, covariance = _of_points(cells, "point_columns", POINTS, bundle, runs)
    points = GroundPoints(names, class_.astype(np.int64), kind.astype(np.int64), place, covariance)
    place, covariance = _of_points(cells, "adjusted_columns", ADJUSTED, bundle, runs)
    return StoredPoints(points, profile.astype(np.int64), sigma, place, covariance, runs)


def _of_points(
    cells: Cells, table: str, columns: _Columns, bundle: int | None, runs: Mapping[int, Run]
) -> list[NDArray[Any]]:
    """Columns of points, those of bundles one after another."""
    read = list(cells.read(table, columns, bundle))
    if [(number, size) for number, size, _ in read] != [(number, run.size) for number, run in runs.items()]:
        raise ValueError(f"other points in {table} than have names")
    return _joined([one for _, _, one in read], columns)


def _joined(parts: Sequence[Sequence[NDArray[Any]]], columns: _Columns) -> list[NDArray[Any]]:
    nothing = [np.zeros((0, *shape), dtype=kind) for kind, shape in columns.values()]
    return [concatenated(column) for column in zip(*(parts or [nothing]), strict=True)]


def rays_of(cells: Cells, bundle: int | None, runs: Mapping[int, Run], images: Mapping[int, Index]) -> ImageRays:
    """Rays of a bundle, or all; `runs` are the points of the bundles, `images` (m,) the numbers of their images."""
    point, image, place, sigma, *marks = rows_of(cells, "ray_columns", RAYS, bundle, runs, images)
    return ImageRays(point, image, place, sigma, *(one.astype(bool) for one in marks))


def ranges_of(cells: Cells, bundle: int | None, runs: Mapping[int, Run], images: Mapping[int, Index]) -> Ranges:
    """Ranges of a bundle, or all."""
    point, image, time, value, sigma, mark = rows_of(cells, "range_columns", RANGES, bundle, runs, images)
    return Ranges(point, image, time, value, sigma, mark.astype(bool))


def rows_of(
    cells: Cells,
    table: str,
    columns: _Columns,
    bundle: int | None,
    runs: Mapping[int, Run],
    images: Mapping[int, Index] | None = None,
) -> list[NDArray[Any]]:
    """Columns of rows of points, those of bundles one after another; their points numbered as those of `runs` are, and
    the images by the numbers (m,) given.
    """
    parts = list[list[NDArray[Any]]]()
    for number, size, (point, second, *rest) in cells.read(table, columns, bundle):
        run = runs[number]
        if size > 1 and not any(one.strides[0] for one in (point, second, *rest)):
            raise ValueError(f"rows of {table} that are all the same")
        if point.min() < 0 or point.max() >= run.size or second.min() < 0:
            raise ValueError(f"a row of {table} that belongs to no point")
        parts.append([point.astype(np.int64) + run.first, second if images is None else images[number][second], *rest])
    return _joined(parts, columns) if parts else [
        np.zeros((0, *shape), dtype=np.int64 if kind == "<i4" else kind) for kind, shape in columns.values()
    ]


def index_among(numbers: Index, known: Index) -> Index:
    """Places (...) of numbers (...) among the known ones (n,), in whatever order these are; KeyError for another."""
    order = np.argsort(known)
    place = np.minimum(np.searchsorted(known, numbers, sorter=order), known.size - 1)
    found = np.asarray(order[place])
    if not np.array_equal(known[found], numbers):
        raise KeyError("a number that nothing has")
    return found


_Kind = TypeVar("_Kind", bound=TerrainGrid | StereoSurface)


class StoredRecords(Generic[_Kind]):
    """A table of records of a kind, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str, table: str, kind: type[_Kind]) -> None:
        self._connection, self._where, self._table, self._kind = connection, where, table, kind
        self._records: dict[int, _Kind] = {}
        self._numbers: dict[int, tuple[_Kind, int]] = {}

    def record(self, number: int) -> _Kind:
        """A record by its number; ValueError where there is none."""
        if number not in self._records:
            query = f"SELECT record FROM {self._table} WHERE id = ?"
            ((content,),) = self._connection.execute(query, (number,)).fetchall()
            found = unpack(content, self._kind, f"{self._where}, {self._table.replace('_', ' ')} {number}")
            self._records[number], self._numbers[id(found)] = found, (found, number)
        return self._records[number]

    def number(self, record: _Kind, salt: str = "", **columns: Any) -> int:
        """Number of a record in its table, where it is written, with further columns, unless an equal one of the same
        salt is there.
        """
        if id(record) not in self._numbers:
            content = pack(record)
            digest = hashlib.sha256(content + salt.encode()).hexdigest()
            self._connection.execute(
                f"INSERT INTO {self._table} (sha256, record, {', '.join(columns)}) "
                f"VALUES (?, ?{', ?' * len(columns)}) ON CONFLICT (sha256) DO NOTHING",
                (digest, content, *columns.values()),
            )
            ((number,),) = self._of(digest)
            self._numbers[id(record)] = record, number  # held, so that its id stays its own
            self._records.setdefault(number, record)
        return self._numbers[id(record)][1]

    def equal(self, record: _Kind) -> _Kind:
        """The record that is there with the same content, or the one given where there is none; nothing is written."""
        if id(record) in self._numbers:
            return record
        found = self._of(hashlib.sha256(pack(record)).hexdigest())
        return self.record(found[0][0]) if found else record

    def forget(self, numbers: set[int]) -> None:
        """Records of these numbers are no longer in the table."""
        self._records = {number: one for number, one in self._records.items() if number not in numbers}
        self._numbers = {key: one for key, one in self._numbers.items() if one[1] not in numbers}

    def _of(self, digest: str) -> list[tuple[int]]:
        return self._connection.execute(f"SELECT id FROM {self._table} WHERE sha256 = ?", (digest,)).fetchall()


class StoredStereo:
    """The tables of stereo surfaces and of heights above them, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._cells = connection, Cells(connection)
        self._surfaces = StoredRecords(connection, where, "stereo_surface", StereoSurface)

    def control(
        self, bundle: int | None, runs: Mapping[int, Run], images: Index, starts: Array
    ) -> StereoControl | None:
        """Heights of the points of a bundle, or of all; None without any.

        Parameters
        ----------
        runs : mapping
            Of each bundle, which of the network's points are its.
        images : (m,)
            Numbers that the network's indices stand for.
        starts : (n, 3)
            m, where the points lie.
        """
        mine, surface, sigma, rejected_, level_ = rows_of(self._cells, "height_columns", HEIGHTS, bundle, runs)
        if mine.size == 0:
            return None
        used, inside = np.unique(surface, return_inverse=True)
        pairs = [
            self._connection.execute("SELECT first, second FROM stereo_surface WHERE id = ?", (number,)).fetchone()
            for number in used.tolist()
        ]
        of_point, sigmas = np.full(len(starts), -1), np.full(len(starts), np.inf)
        rejected, level = np.zeros((2, len(starts)), dtype=bool)
        of_point[mine], sigmas[mine], rejected[mine], level[mine] = inside, sigma, rejected_ != 0, level_ != 0
        shown = tuple(self._surfaces.record(number) for number in used.tolist())
        sides = index_among(np.array(pairs), images)
        return StereoControl(shown, sides, of_point, sigmas, starts, rejected, level)

    def put(self, bundle: int, network: Network, images: Index) -> None:
        """Write the heights of a bundle; `images` are numbers as for `control`."""
        control = network.stereo
        if control is None:
            return
        on = np.flatnonzero(control.surface >= 0)
        numbers = np.array([
            self._number(one, *images[pair].tolist())
            for one, pair in zip(control.surfaces, control.images, strict=True)
        ], dtype=np.int64)  # fmt: skip
        marks = [None if one is None else one[on] for one in (control.rejected, control.level)]
        surface = numbers[control.surface[on]]
        self._cells.put("height_columns", bundle, on.size, HEIGHTS, (on, surface, control.sigmas[on], *marks))
        self._connection.executemany(
            "INSERT INTO bundle_surface VALUES (?, ?)", [(bundle, number) for number in np.unique(surface).tolist()]
        )

    def sweep(self) -> None:
        """Take out surfaces on which no point lies any longer."""
        gone = self._connection.execute(
            "SELECT id FROM stereo_surface WHERE id NOT IN (SELECT surface FROM bundle_surface)"
        ).fetchall()
        self._connection.executemany("DELETE FROM stereo_surface WHERE id = ?", gone)
        self._surfaces.forget({number for (number,) in gone})

    def _number(self, surface: StereoSurface, first: int, second: int) -> int:
        return self._surfaces.number(surface, f"{first} {second}", first=first, second=second)
