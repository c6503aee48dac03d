"""Records in a project's file, each read once and kept, and written once: terrain grids, stereo surfaces, and the
heights of points above these.
"""

import hashlib
import sqlite3
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import Network
from mgsgraph.network.control import StereoControl
from mgsgraph.project.columns import HEIGHTS, Cells, Run, index_among, rows_of
from mgsgraph.results.archive_arrays import pack, unpack

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

    @property
    def there(self) -> bool:
        """Whether any point lies on a stereo surface."""
        return self._connection.execute("SELECT 1 FROM height_columns LIMIT 1").fetchone() is not None

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
