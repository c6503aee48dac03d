"""Stereo surfaces and heights above them in a project's file; a surface is read once and kept."""

import hashlib
import sqlite3
from collections.abc import Mapping

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.network import Network
from mgsgraph.network.stereo_control import StereoControl
from mgsgraph.project.columns import HEIGHTS, Cells, Run, index_among, rows_of
from mgsgraph.results.archive_arrays import pack, unpack


class StoredStereo:
    """The tables of stereo surfaces and of heights above them, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._where, self._cells = connection, where, Cells(connection)
        self._surfaces = dict[int, StereoSurface]()
        self._numbers = dict[int, tuple[StereoSurface, int]]()

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
        shown = tuple(self._surface(number) for number in used.tolist())
        sides = index_among(np.array(pairs), images)
        return StereoControl(shown, sides, of_point, sigmas, starts, rejected, level)

    def put(self, bundle: int, network: Network, images: Index) -> None:
        """Write the heights of a bundle; `images` are numbers as for `control`."""
        control = network.stereo
        if control is None:
            return
        on = np.flatnonzero(control.surface >= 0)
        numbers = np.array([
            self._number(one, images[pair]) for one, pair in zip(control.surfaces, control.images, strict=True)
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
        for (number,) in gone:
            self._surfaces.pop(number, None)
        self._numbers = {key: one for key, one in self._numbers.items() if (one[1],) not in gone}

    def _surface(self, number: int) -> StereoSurface:
        if number not in self._surfaces:
            (record,) = self._connection.execute(
                "SELECT record FROM stereo_surface WHERE id = ?", (number,)
            ).fetchone()
            surface = unpack(record, StereoSurface, f"{self._where}, stereo surface {number}")
            self._surfaces[number], self._numbers[id(surface)] = surface, (surface, number)
        return self._surfaces[number]

    def _number(self, surface: StereoSurface, images: Index) -> int:
        """Number of a surface in its table, where it is written unless it is there."""
        if id(surface) not in self._numbers:
            record, (first, second) = pack(surface), images.tolist()
            digest = hashlib.sha256(record + f"{first} {second}".encode()).hexdigest()
            self._connection.execute(
                "INSERT INTO stereo_surface (sha256, first, second, record) VALUES (?, ?, ?, ?) "
                "ON CONFLICT (sha256) DO NOTHING",
                (digest, first, second, record),
            )
            (number,) = self._connection.execute(
                "SELECT id FROM stereo_surface WHERE sha256 = ?", (digest,)
            ).fetchone()
            self._numbers[id(surface)] = surface, number  # held, so that its id stays its own
            self._surfaces.setdefault(number, surface)
        return self._numbers[id(surface)][1]
