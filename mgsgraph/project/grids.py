"""Terrain grids in a project's file; each is read once and kept, and written once."""

import hashlib
import sqlite3

from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.results.archive_arrays import pack, unpack


class StoredGrids:
    """The table of grids of the terrain model and of the areoid, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._where = connection, where
        self._grids = dict[int, TerrainGrid]()
        self._numbers = dict[int, tuple[TerrainGrid, int]]()

    def grid(self, number: int) -> TerrainGrid:
        """A grid by its number; LookupError where there is none."""
        if number not in self._grids:
            rows = self._connection.execute("SELECT source, record FROM terrain WHERE id = ?", (number,)).fetchall()
            ((source, record),) = rows
            grid = unpack(record, TerrainGrid, f"{self._where}, terrain {source}")
            self._grids[number], self._numbers[id(grid)] = grid, (grid, number)
        return self._grids[number]

    def number(self, grid: TerrainGrid) -> int:
        """Number of a grid in its table, where it is written unless an equal one is there."""
        if id(grid) not in self._numbers:
            record = pack(grid)
            digest = hashlib.sha256(record).hexdigest()
            self._connection.execute(
                "INSERT INTO terrain (sha256, source, record) VALUES (?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
                (digest, grid.source, record),
            )
            (number,) = self._connection.execute("SELECT id FROM terrain WHERE sha256 = ?", (digest,)).fetchone()
            self._numbers[id(grid)] = grid, number  # held, so that its id stays its own
            self._grids.setdefault(number, grid)
        return self._numbers[id(grid)][1]

    def equal(self, grid: TerrainGrid) -> TerrainGrid:
        """The grid that is there with the same content, or the one given where there is none; nothing is written."""
        if id(grid) in self._numbers:
            return grid
        digest = hashlib.sha256(pack(grid)).hexdigest()
        found = self._connection.execute("SELECT id FROM terrain WHERE sha256 = ?", (digest,)).fetchone()
        return self.grid(found[0]) if found else grid
