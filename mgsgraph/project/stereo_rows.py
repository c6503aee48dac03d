"""Stereo surfaces and heights above them in a project's file; a surface is read once and kept."""

import hashlib
import sqlite3

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.stereo_surface import StereoSurface
from mgsgraph.network import Network
from mgsgraph.network.stereo_control import StereoControl
from mgsgraph.project.rows import Run, index_among
from mgsgraph.reports.archive_arrays import pack, unpack

_HEIGHTS = "SELECT point, surface, sigma, rejected, level FROM stereo_height"


class StoredStereo:
    """The tables of stereo surfaces and of heights above them, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._where = connection, where
        self._surfaces = dict[int, StereoSurface]()
        self._numbers = dict[int, tuple[StereoSurface, int]]()

    @property
    def there(self) -> bool:
        """Whether any point lies on a stereo surface."""
        return self._connection.execute("SELECT 1 FROM stereo_height LIMIT 1").fetchone() is not None

    def control(self, run: Run | None, points: Index, images: Index, starts: Array) -> StereoControl | None:
        """Heights of a run of points, or of all points; None without any.

        Parameters
        ----------
        run : Run, optional
            Of the points' table.
        points, images : (n,), (m,)
            Numbers that the network's indices stand for.
        starts : (n, 3)
            m, where the points lie.
        """
        chosen = (_HEIGHTS, ()) if run is None else (f"{_HEIGHTS} WHERE point BETWEEN ? AND ?", run.limits)
        rows = self._connection.execute(*chosen).fetchall()
        if not rows:
            return None
        point, surface, sigma, *marks = (np.array(column) for column in zip(*rows, strict=True))
        used, inside = np.unique(surface, return_inverse=True)
        pairs = [
            self._connection.execute("SELECT first, second FROM stereo_surface WHERE id = ?", (number,)).fetchone()
            for number in used.tolist()
        ]
        of_point, sigmas = np.full(points.size, -1), np.full(points.size, np.inf)
        mine, (rejected, level) = index_among(point, points), np.zeros((2, points.size), dtype=bool)
        of_point[mine], sigmas[mine], rejected[mine], level[mine] = inside, sigma, *(one != 0 for one in marks)
        shown = tuple(self._surface(number) for number in used.tolist())
        sides = index_among(np.array(pairs), images)
        return StereoControl(shown, sides, of_point, sigmas, starts, rejected, level)

    def put(self, network: Network, first_point: int, images: Index) -> None:
        """Write the heights of a bundle whose points are written; `images` are numbers as for `control`."""
        control = network.stereo
        if control is None:
            return
        on = np.flatnonzero(control.surface >= 0)
        numbers = [
            self._number(one, images[pair]) for one, pair in zip(control.surfaces, control.images, strict=True)
        ]
        marks = [np.zeros(on.size) if one is None else one[on] for one in (control.rejected, control.level)]
        self._connection.executemany(
            "INSERT INTO stereo_height VALUES (?, ?, ?, ?, ?)",
            zip(
                (on + first_point).tolist(), (numbers[s] for s in control.surface[on].tolist()),
                control.sigmas[on].tolist(), *(one.astype(int).tolist() for one in marks), strict=True,
            ),
        )  # fmt: skip

    def drop(self, run: Run) -> None:
        """Take out the heights of a run of points."""
        self._connection.execute("DELETE FROM stereo_height WHERE point BETWEEN ? AND ?", run.limits)

    def sweep(self) -> None:
        """Take out surfaces on which no point lies any longer."""
        gone = self._connection.execute(
            "SELECT id FROM stereo_surface WHERE id NOT IN (SELECT surface FROM stereo_height)"
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
