"""Heights above a terrain model by cell of a map."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.units import DEG

_STEPS = tuple(digit * 10.0**power for power in (-4, -3, -2, -1, 0) for digit in (1.0, 2.0, 5.0))
"""deg, sizes of cells to choose from."""
_ENOUGH = 6.0
"""Points that cells which have any should hold on the average: the rms of so few is known to a third."""
_MOST = 60
"""Cells along the longer side of a map."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightCells:
    """Count, root mean square and mean of heights by cell; rows go north, columns go east."""

    west: float
    """rad, east longitude of the western edge, of any turn."""
    south: float
    """rad, planetocentric latitude of the southern edge."""
    steps: tuple[float, float]
    """rad, width and height of a cell."""
    count: Index
    """(rows, columns) points."""
    rms: Array
    """(stages, rows, columns) m; NaN for a cell without points."""
    mean: Array
    """(stages, rows, columns) m; NaN for a cell without points."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """deg, west, east, south and north."""
        rows, columns = self.count.shape
        return (
            self.west / DEG,
            (self.west + columns * self.steps[0]) / DEG,
            self.south / DEG,
            (self.south + rows * self.steps[1]) / DEG,
        )

    @property
    def total(self) -> Array:
        """(stages,) m, root mean square over all points."""
        squares = np.nansum(self.rms**2 * self.count, axis=(1, 2))
        return np.asarray(np.sqrt(squares / max(int(self.count.sum()), 1)))


def height_cells(places: Array, heights: Array, step: float | None = None) -> HeightCells:
    """Sort heights into cells.

    Parameters
    ----------
    places : (n, 3)
        m, body-fixed: where each point lies at all stages, so that a cell always has the same points. At least one.
    heights : (stages, n)
        m.
    step : float, optional
        rad, height of a cell, whose width is about the same on the ground; one that leaves some points in a cell
        when absent.
    """
    east, north = turned(places)
    ratio = _round(1.0 / max(float(np.cos(np.median(north))), 0.05))
    chosen = _step(east, north, ratio) if step is None else step
    steps = (chosen * ratio, chosen)
    west, column, columns = _sorted(east, steps[0])
    south, row, rows = _sorted(north, steps[1])
    cell = row * columns + column
    count = np.bincount(cell, minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        means, squares = (
            np.stack([np.bincount(cell, values, rows * columns) for values in stack]) / count
            for stack in (heights, heights**2)
        )
    shape = len(heights), rows, columns
    return HeightCells(
        west, south, steps, count.reshape(rows, columns), np.sqrt(squares).reshape(shape), means.reshape(shape)
    )


def turned(places: Array, middle: float | None = None) -> tuple[Array, Array]:
    """Longitudes (n,), in the turn of their mean direction or of a `middle`, and latitudes (n,), rad, of places (n, 3)
    in m, body-fixed.
    """
    longitudes, latitudes, _ = planetocentric(places).T
    if middle is None:
        middle = float(np.arctan2(np.sin(longitudes).mean(), np.cos(longitudes).mean())) % (2.0 * np.pi)
    return in_turn(longitudes, middle), latitudes


def _round(ratio: float) -> float:
    """The nearest of 1, 2, 5, 10, 20."""
    choices = np.array([1.0, 2.0, 5.0, 10.0, 20.0])
    return float(choices[np.argmin(np.abs(np.log(choices / ratio)))])


def _sorted(values: Array, step: float) -> tuple[float, Index, int]:
    """First edge, cell of each value, and number of cells; edges are multiples of the step."""
    low = int(np.floor(values.min() / step + 1e-9))
    index = np.maximum(np.floor(values / step + 1e-9).astype(np.int64) - low, 0)
    return low * step, index, int(index.max()) + 1


def _step(east: Array, north: Array, ratio: float) -> float:
    """rad, the smallest of the round sizes whose cells hold enough points and are not too many."""
    for step in _STEPS:
        _, column, columns = _sorted(east, step * DEG * ratio)
        _, row, rows = _sorted(north, step * DEG)
        if max(rows, columns) <= _MOST and east.size >= _ENOUGH * np.unique(row * columns + column).size:
            return step * DEG
    return _STEPS[-1] * DEG
