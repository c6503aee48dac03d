"""Points, rays, ranges and stereo heights of bundles as packed columns (table `packed`), and arrays of them again.

A cell holds a column of one bundle: its numbers one after another, little-endian, or a single number where all of them
are the same to the bit. Points are numbered from 0 on within their bundle, images by their position in it.
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
"""Of each kind of rows: type and shape of a row's part of each column. What they mean: `schema`."""


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
    """The table of packed columns, on an open connection."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def put(self, bundle: int, kind: str, *values: NDArray[Any] | None) -> None:
        """Write the columns of a bundle's rows of a kind, in their order, None for zeros; nothing without a row."""
        size = next(len(one) for one in values if one is not None)
        columns = zip(COLUMNS[kind].items(), values, strict=True)
        cells = {name: packed(one, of) for (name, (of, _)), one in columns if one is not None and size}
        self._insert(bundle, kind, size, cells)

    def put_names(self, bundle: int, names: Names) -> None:
        """Write the names of a bundle's points."""
        cells = {"text": names.data.tobytes(), "ends": names.offsets[1:].astype("<i4").tobytes()}
        self._insert(bundle, "names", len(names), cells)

    def _insert(self, bundle: int, kind: str, size: int, cells: Mapping[str, bytes]) -> None:
        rows = [(bundle, kind, name, size, cell) for name, cell in cells.items()]
        self._connection.executemany("INSERT OR REPLACE INTO packed VALUES (?, ?, ?, ?, ?)", rows)

    def drop(self, bundle: int) -> None:
        """Take out all columns of a bundle."""
        self._connection.execute("DELETE FROM packed WHERE bundle = ?", (bundle,))

    def _read(self, kind: str, bundle: int | None) -> Iterator[tuple[int, int, dict[str, bytes]]]:
        """Number, size and cells of one bundle, or of each bundle that has such rows."""
        where, values = ("", (kind,)) if bundle is None else ("AND bundle = ?", (kind, bundle))
        statement = f"SELECT bundle, size, name, cell FROM packed WHERE kind = ? {where} ORDER BY bundle"
        for (number, size), rows in groupby(self._connection.execute(statement, values), key=lambda row: row[:2]):
            yield number, size, {name: cell for _, _, name, cell in rows}

    def read(self, kind: str, bundle: int | None) -> Iterator[tuple[int, int, list[Any]]]:
        """Number, size and columns of one bundle, or of each bundle; zeros for a column that it has not."""
        for number, size, cells in self._read(kind, bundle):
            yield number, size, [
                unpacked(cells.get(name, bytes(np.dtype(of).itemsize)), of, (size, *shape))
                for name, (of, shape) in COLUMNS[kind].items()
            ]

    def names(self, bundle: int | None = None) -> tuple[Names, Index, Index]:
        """Names of the points of one bundle, or of all; numbers (b,) of these bundles and how many points each has."""
        rows = [(number, size, cells["text"], cells["ends"]) for number, size, cells in self._read("names", bundle)]
        numbers, sizes = (np.array([row[k] for row in rows], dtype=np.int64) for k in range(2))
        if any(len(text) != int.from_bytes(ends[-4:], "little") or len(ends) != 4 * n for _, n, text, ends in rows):
            raise ValueError("names of points that are longer or shorter than their text")
        before = np.repeat(np.cumsum([0, *(len(row[2]) for row in rows)])[:-1], sizes)
        ends = np.frombuffer(b"".join(row[3] for row in rows), "<i4") + before
        data = np.frombuffer(b"".join(row[2] for row in rows), np.uint8)
        return Names(data, np.concatenate([np.zeros(1, dtype=np.int64), ends])), numbers, sizes

    def points(self, bundle: int | None) -> "StoredPoints":
        """Points of a bundle, or all points."""
        names, bundles, sizes = self.names(bundle)
        rows = np.stack([bundles, np.cumsum(sizes) - sizes, sizes], axis=1).tolist()
        runs = {number: Run(first, size) for number, first, size in rows}
        class_, kind, profile, sigma, place, covariance = self._of_points("points", bundle, runs)
        points = GroundPoints(names, class_.astype(np.int64), kind.astype(np.int64), place, covariance)
        place, covariance = self._of_points("adjusted", bundle, runs)
        return StoredPoints(points, profile.astype(np.int64), sigma, place, covariance, runs)

    def _of_points(self, kind: str, bundle: int | None, runs: "Mapping[int, Run]") -> list[NDArray[Any]]:
        """Columns of points, those of bundles one after another."""
        read = list(self.read(kind, bundle))
        if [(number, size) for number, size, _ in read] != [(number, run.size) for number, run in runs.items()]:
            raise ValueError(f"other {kind} than have names")
        return _joined([one for _, _, one in read], kind)

    def rows(
        self, kind: str, bundle: int | None, runs: "Mapping[int, Run]", images: Mapping[int, Index] | None = None
    ) -> list[NDArray[Any]]:
        """Columns of rows of points, those of bundles one after another; their points numbered as those of `runs` are,
        and the images by the numbers (m,) given.
        """
        parts = list[list[NDArray[Any]]]()
        for number, size, (point, second, *rest) in self.read(kind, bundle):
            run = runs[number]
            if size > 1 and not any(one.strides[0] for one in (point, second, *rest)):
                raise ValueError(f"{kind} that are all the same")
            if point.min() < 0 or point.max() >= run.size or second.min() < 0:
                raise ValueError(f"one of the {kind} belongs to no point")
            second = second.astype(np.int64) if images is None else images[number][second]
            parts.append([point.astype(np.int64) + run.first, second, *rest])
        marks = (one.astype(bool) if one.dtype == np.int8 else one for one in _joined(parts, kind))
        return [one.astype(np.int64) if one.dtype == np.int32 else one for one in marks]


def _joined(parts: Sequence[Sequence[NDArray[Any]]], kind: str) -> list[NDArray[Any]]:
    nothing = [np.zeros((0, *shape), dtype=of) for of, shape in COLUMNS[kind].values()]
    return [concatenated(column) for column in zip(*(parts or [nothing]), strict=True)]


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


def index_among(numbers: Index, known: Index) -> Index:
    """Places (...) of numbers (...) among the known ones (n,), in whatever order these are; KeyError for another."""
    order = np.argsort(known)
    place = np.minimum(np.searchsorted(known, numbers, sorter=order), known.size - 1)
    found = np.asarray(order[place])
    if not np.array_equal(known[found], numbers):
        raise KeyError("a number that nothing has")
    return found


_Kind = TypeVar("_Kind", bound=TerrainGrid | StereoSurface)


class StoredGrids:
    """The table of terrain grids and stereo surfaces, on an open connection, and the heights above these."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._cells, self._where = connection, Cells(connection), where
        self._records: dict[int, Any] = {}
        self._numbers: dict[int, tuple[Any, int]] = {}

    def record(self, number: int, kind: type[_Kind]) -> _Kind:
        """A record by its number; ValueError where there is none."""
        if number not in self._records:
            ((content,),) = self._connection.execute("SELECT record FROM grid WHERE id = ?", (number,)).fetchall()
            found = unpack(content, kind, f"{self._where}, grid {number}")
            self._records[number], self._numbers[id(found)] = found, (found, number)
        known: _Kind = self._records[number]
        return known

    def number(self, record: TerrainGrid | StereoSurface, first: int | None = None, second: int | None = None) -> int:
        """Number of a record (a stereo surface of two images) in the table, where it is written unless it is there."""
        if id(record) not in self._numbers:
            content = pack(record)
            digest = _digest(content, first, second)
            self._connection.execute(
                "INSERT INTO grid (sha256, first, second, record) VALUES (?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
                (digest, first, second, content),
            )
            ((number,),) = self._of(digest)
            self._numbers[id(record)] = record, number  # held, so that its id stays its own
            self._records.setdefault(number, record)
        return self._numbers[id(record)][1]

    def equal(self, record: TerrainGrid) -> TerrainGrid:
        """The grid that is there with the same content, or the one given where there is none; nothing is written."""
        if id(record) in self._numbers:
            return record
        found = self._of(_digest(pack(record)))
        return self.record(found[0][0], TerrainGrid) if found else record

    def _of(self, digest: str) -> list[tuple[int]]:
        return self._connection.execute("SELECT id FROM grid WHERE sha256 = ?", (digest,)).fetchall()

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
        mine, surface, sigma, rejected_, level_ = self._cells.rows("heights", bundle, runs)
        if mine.size == 0:
            return None
        used, inside = np.unique(surface, return_inverse=True)
        pairs = [
            self._connection.execute("SELECT first, second FROM grid WHERE id = ?", (number,)).fetchone()
            for number in used.tolist()
        ]
        of_point, sigmas = np.full(len(starts), -1), np.full(len(starts), np.inf)
        rejected, level = np.zeros((2, len(starts)), dtype=bool)
        of_point[mine], sigmas[mine], rejected[mine], level[mine] = inside, sigma, rejected_, level_
        shown = tuple(self.record(number, StereoSurface) for number in used.tolist())
        sides = index_among(np.array(pairs), images)
        return StereoControl(shown, sides, of_point, sigmas, starts, rejected, level)

    def put_heights(self, bundle: int, network: Network, images: Index) -> None:
        """Write the heights of a bundle; `images` are numbers as for `control`."""
        control = network.stereo
        if control is None:
            return
        on = np.flatnonzero(control.surface >= 0)
        pairs = zip(control.surfaces, control.images, strict=True)
        numbers = np.array([self.number(one, *images[pair].tolist()) for one, pair in pairs], dtype=np.int64)
        marks = [None if one is None else one[on] for one in (control.rejected, control.level)]
        self._cells.put(bundle, "heights", on, numbers[control.surface[on]], control.sigmas[on], *marks)

    def sweep(self) -> None:
        """Take out surfaces on which no point lies any longer."""
        surfaces = {number for (number,) in self._connection.execute("SELECT id FROM grid WHERE first IS NOT NULL")}
        if surfaces:
            heights = self._cells.read("heights", None)
            surfaces.difference_update(*(np.unique(surface).tolist() for _, _, (_, surface, *_) in heights))
        self._connection.executemany("DELETE FROM grid WHERE id = ?", [(number,) for number in surfaces])
        self._records = {number: one for number, one in self._records.items() if number not in surfaces}
        self._numbers = {key: one for key, one in self._numbers.items() if one[1] not in surfaces}


def _digest(content: bytes, *images: int | None) -> str:
    return hashlib.sha256(content + " ".join(str(one) for one in images if one is not None).encode()).hexdigest()
