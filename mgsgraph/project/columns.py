"""Packed columns (table `packed`) of the points, rays, ranges and stereo heights of bundles: writing and reading.

A cell holds a column of one bundle: its numbers one after another, little-endian, or a single number where all numbers
are equal to the bit. Points are numbered from 0 on within their bundle, images by their position in it.
"""

import hashlib
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array, Index, concatenated
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, Network
from mgsgraph.network.records import StereoControl
from mgsgraph.results.archive import pack, unpack

COLUMNS: dict[str, dict[str, tuple[str, tuple[int, ...]]]] = {
    "points": {
        "class": ("i1", ()), "kind": ("i1", ()), "profile": ("<i4", ()), "surface_sigma": ("<f8", ()),
        "place": ("<f8", (3,)), "covariance": ("<f8", (3, 3)),
    },
    "adjusted": {"place": ("<f8", (3,)), "covariance": ("<f8", (3, 3))},
    "rays": {
        "point": ("<i4", ()), "image": ("<i4", ()), "place": ("<f8", (2,)), "sigma": ("<f8", (2,)),
        "back_projected": ("i1", ()), "rejected": ("i1", ()),
    },
    "ranges": {
        "point": ("<i4", ()), "image": ("<i4", ()), "time": ("<f8", ()), "value": ("<f8", ()), "sigma": ("<f8", ()),
        "rejected": ("i1", ()),
    },
    "heights": {
        "point": ("<i4", ()), "surface": ("<i4", ()), "sigma": ("<f8", ()), "rejected": ("i1", ()), "level": ("i1", ()),
    },
}  # fmt: skip
"""For each kind of rows: the columns, with type and shape of one row's value. Their meaning: `schema`."""


def packed(values: NDArray[Any], kind: str) -> bytes:
    """Bytes of a cell: `values` as numbers of type `kind`, or a single number where all are equal to the bit."""
    column = np.ascontiguousarray(values, dtype=kind)
    bits = column.reshape(-1).view(f"u{column.itemsize}")
    is_constant = bits.size > 1 and bits[0] == bits[-1] and bool(np.all(bits == bits[0]))
    return (bits[:1] if is_constant else bits).tobytes()


def unpacked(cell: bytes, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """The column (*shape) in a cell, read-only; ValueError for another size."""
    numbers = np.frombuffer(cell, kind)
    if numbers.size == 1:
        return np.broadcast_to(numbers[0], shape)
    return numbers.reshape(shape)


class Cells:
    """The table of packed columns on an open connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def write(self, bundle: int, kind: str, *values: NDArray[Any] | None) -> None:
        """Write the columns of a bundle's rows of a kind, in the order of `COLUMNS`; None for zeros."""
        size = next(len(column) for column in values if column is not None)
        columns = zip(COLUMNS[kind].items(), values, strict=True)
        cells = {name: packed(column, dtype) for (name, (dtype, _)), column in columns if column is not None and size}
        self._insert(bundle, kind, size, cells)

    def write_names(self, bundle: int, names: Names) -> None:
        """Write the names of a bundle's points."""
        cells = {"text": names.data.tobytes(), "ends": names.offsets[1:].astype("<i4").tobytes()}
        self._insert(bundle, "names", len(names), cells)

    def _insert(self, bundle: int, kind: str, size: int, cells: Mapping[str, bytes]) -> None:
        rows = [(bundle, kind, name, size, cell) for name, cell in cells.items()]
        self._connection.executemany("INSERT OR REPLACE INTO packed VALUES (?, ?, ?, ?, ?)", rows)

    def delete(self, bundle: int) -> None:
        """Delete all columns of a bundle."""
        self._connection.execute("DELETE FROM packed WHERE bundle = ?", (bundle,))

    def _read(self, kind: str, bundle: int | None) -> Iterator[tuple[int, int, dict[str, bytes]]]:
        """Number, size and cells of one bundle, or of each bundle that has such rows."""
        where, values = ("", (kind,)) if bundle is None else ("AND bundle = ?", (kind, bundle))
        statement = f"SELECT bundle, size, name, cell FROM packed WHERE kind = ? {where} ORDER BY bundle"
        for (number, size), rows in groupby(self._connection.execute(statement, values), key=lambda row: row[:2]):
            yield number, size, {name: cell for _, _, name, cell in rows}

    def read(self, kind: str, bundle: int | None) -> Iterator[tuple[int, int, list[Any]]]:
        """Number, size and columns of one bundle, or of each bundle; zeros for a column that is not stored."""
        for number, size, cells in self._read(kind, bundle):
            yield number, size, [
                unpacked(cells.get(name, bytes(np.dtype(dtype).itemsize)), dtype, (size, *shape))
                for name, (dtype, shape) in COLUMNS[kind].items()
            ]

    def names(self, bundle: int | None = None) -> tuple[Names, Index, Index]:
        """Names of the points of one bundle, or of all; of these bundles the numbers (b,) and counts of points (b,)."""
        rows = [(number, size, cells["text"], cells["ends"]) for number, size, cells in self._read("names", bundle)]
        numbers, sizes = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(2))
        if any(len(text) != int.from_bytes(end[-4:], "little") or len(end) != 4 * size for _, size, text, end in rows):
            raise ValueError("names of points that are longer or shorter than their text")
        starts = np.repeat(np.cumsum([0, *(len(row[2]) for row in rows)])[:-1], sizes)
        ends = np.frombuffer(b"".join(row[3] for row in rows), "<i4") + starts
        data = np.frombuffer(b"".join(row[2] for row in rows), np.uint8)
        return Names(data, np.concatenate([np.zeros(1, dtype=np.int64), ends])), numbers, sizes

    def points(self, bundle: int | None) -> "StoredPoints":
        """Points of one bundle, or of all."""
        names, bundles, sizes = self.names(bundle)
        rows = np.stack([bundles, np.cumsum(sizes) - sizes, sizes], axis=1).tolist()
        runs = {number: Run(first, size) for number, first, size in rows}
        class_, kind, profile, sigma, place, covariance = self._of_points("points", bundle, runs)
        points = GroundPoints(names, class_.astype(np.int64), kind.astype(np.int64), place, covariance)
        place, covariance = self._of_points("adjusted", bundle, runs)
        return StoredPoints(points, profile.astype(np.int64), sigma, place, covariance, runs)

    def _of_points(self, kind: str, bundle: int | None, runs: "Mapping[int, Run]") -> list[NDArray[Any]]:
        """Columns of the points, bundle by bundle; ValueError where they are not those with names."""
        stored = list(self.read(kind, bundle))
        if [(number, size) for number, size, _ in stored] != [(number, run.size) for number, run in runs.items()]:
            raise ValueError(f"other {kind} than have names")
        return _joined([columns for _, _, columns in stored], kind)

    def rows(
        self, kind: str, bundle: int | None, runs: "Mapping[int, Run]", images: Mapping[int, Index] | None = None
    ) -> list[NDArray[Any]]:
        """Columns of rays, ranges or heights, bundle by bundle. Points are numbered as in `runs`, images by `images`:
        for each bundle the numbers (m,) of its images.
        """
        parts = list[list[NDArray[Any]]]()
        for number, size, (point, image_or_surface, *rest) in self.read(kind, bundle):
            run = runs[number]
            if size > 1 and not any(column.strides[0] for column in (point, image_or_surface, *rest)):
                raise ValueError(f"{kind} that are all the same")
            if point.min() < 0 or point.max() >= run.size or image_or_surface.min() < 0:
                raise ValueError(f"one of the {kind} belongs to no point")
            image_or_surface = image_or_surface.astype(np.int64) if images is None else images[number][image_or_surface]
            parts.append([point.astype(np.int64) + run.first, image_or_surface, *rest])
        typed_columns = (column.astype(bool) if column.dtype == np.int8 else column for column in _joined(parts, kind))
        return [column.astype(np.int64) if column.dtype == np.int32 else column for column in typed_columns]


def _joined(parts: Sequence[Sequence[NDArray[Any]]], kind: str) -> list[NDArray[Any]]:
    empty_columns = [np.zeros((0, *shape), dtype=dtype) for dtype, shape in COLUMNS[kind].values()]
    return [concatenated(column) for column in zip(*(parts or [empty_columns]), strict=True)]


class StoredPoints(NamedTuple):
    """Points as the file stores them."""

    points: GroundPoints
    """Names, classes, kinds and a-priori positions."""
    profiles: Index
    """(n,) number of each point's profile in its table; 0 for none."""
    surface_sigmas: Array
    """(n,) m; infinite for points that lie on no terrain model."""
    places: Array
    """(n, 3) m, adjusted, NaN where undetermined or not adjusted yet."""
    covariances: Array
    """(n, 3, 3) m^2, the same."""
    runs: "dict[int, Run]"
    """The points of each bundle."""


class Run(NamedTuple):
    """Consecutive points: those of one bundle among all that were read."""

    first: int
    """Index of the first point."""
    size: int
    """Number of points."""


def index_among(numbers: Index, known: Index) -> Index:
    """Indices (...) of numbers (...) in `known` (n,), which need not be sorted; KeyError for a number not in it."""
    order = np.argsort(known)
    rank = np.minimum(np.searchsorted(known, numbers, sorter=order), known.size - 1)
    indices = np.asarray(order[rank])
    if not np.array_equal(known[indices], numbers):
        raise KeyError("a number that nothing has")
    return indices


_Kind = TypeVar("_Kind", bound=TerrainGrid | StereoSurface)


class StoredGrids:
    """The table of terrain grids and stereo surfaces on an open connection, and the heights above these surfaces."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._cells, self._where = connection, Cells(connection), where
        self._records: dict[int, Any] = {}
        self._numbers: dict[int, tuple[Any, int]] = {}

    def record(self, number: int, kind: type[_Kind]) -> _Kind:
        """A record by its number; ValueError where there is none."""
        if number not in self._records:
            ((content,),) = self._connection.execute("SELECT record FROM grid WHERE id = ?", (number,)).fetchall()
            unpacked_record = unpack(content, kind, f"{self._where}, grid {number}")
            self._records[number], self._numbers[id(unpacked_record)] = unpacked_record, (unpacked_record, number)
        record: _Kind = self._records[number]
        return record

    def number(self, record: TerrainGrid | StereoSurface, first: int | None = None, second: int | None = None) -> int:
        """Number of a record (a stereo surface: with its two images) in the table; written if it is new."""
        if id(record) not in self._numbers:
            content = pack(record)
            digest = _digest(content, first, second)
            self._connection.execute(
                "INSERT INTO grid (sha256, first, second, record) VALUES (?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
                (digest, first, second, content),
            )
            ((number,),) = self._with_digest(digest)
            self._numbers[id(record)] = record, number  # the reference keeps id(record) unique
            self._records.setdefault(number, record)
        return self._numbers[id(record)][1]

    def stored_grid(self, record: TerrainGrid) -> TerrainGrid:
        """The stored grid with the same content, or the given one where there is none; writes nothing."""
        if id(record) in self._numbers:
            return record
        matching_rows = self._with_digest(_digest(pack(record)))
        return self.record(matching_rows[0][0], TerrainGrid) if matching_rows else record

    def _with_digest(self, digest: str) -> list[tuple[int]]:
        return self._connection.execute("SELECT id FROM grid WHERE sha256 = ?", (digest,)).fetchall()

    def stereo_control(
        self, bundle: int | None, runs: Mapping[int, Run], images: Index, starts: Array
    ) -> StereoControl | None:
        """Heights of the points of one bundle, or of all, above stereo surfaces; None without any.

        Parameters
        ----------
        runs : mapping
            The points of each bundle in the network.
        images : (m,)
            Numbers that the network's indices stand for.
        starts : (n, 3)
            m, positions of the points.
        """
        points, surface, sigma, is_rejected, is_level = self._cells.rows("heights", bundle, runs)
        if points.size == 0:
            return None
        surface_numbers, index = np.unique(surface, return_inverse=True)
        image_pairs = [
            self._connection.execute("SELECT first, second FROM grid WHERE id = ?", (number,)).fetchone()
            for number in surface_numbers.tolist()
        ]
        surface_of, sigmas = np.full(len(starts), -1), np.full(len(starts), np.inf)
        rejected, level = np.zeros((2, len(starts)), dtype=bool)
        surface_of[points], sigmas[points], rejected[points], level[points] = index, sigma, is_rejected, is_level
        surfaces = tuple(self.record(number, StereoSurface) for number in surface_numbers.tolist())
        image_indices = index_among(np.array(image_pairs), images)
        return StereoControl(surfaces, image_indices, surface_of, sigmas, starts, rejected, level)

    def write_heights(self, bundle: int, network: Network, images: Index) -> None:
        """Write the heights of a bundle above stereo surfaces; `images` as for `stereo_control`."""
        control = network.stereo
        if control is None:
            return
        points = np.flatnonzero(control.surface >= 0)
        pairs = zip(control.surfaces, control.images, strict=True)
        numbers = np.array([self.number(surface, *images[pair].tolist()) for surface, pair in pairs], dtype=np.int64)
        marks = [None if mark is None else mark[points] for mark in (control.rejected, control.level)]
        self._cells.write(bundle, "heights", points, numbers[control.surface[points]], control.sigmas[points], *marks)

    def delete_unused(self) -> None:
        """Delete the stereo surfaces on which no point lies."""
        unused = {number for (number,) in self._connection.execute("SELECT id FROM grid WHERE first IS NOT NULL")}
        if unused:
            heights = self._cells.read("heights", None)
            unused.difference_update(*(np.unique(surface).tolist() for _, _, (_, surface, *_) in heights))
        self._connection.executemany("DELETE FROM grid WHERE id = ?", [(number,) for number in unused])
        self._records = {number: record for number, record in self._records.items() if number not in unused}
        self._numbers = {key: entry for key, entry in self._numbers.items() if entry[1] not in unused}


def _digest(content: bytes, *images: int | None) -> str:
    return hashlib.sha256(content + " ".join(str(image) for image in images if image is not None).encode()).hexdigest()
