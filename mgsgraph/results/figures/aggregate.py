"""Many values made few before they are drawn: means of groups, robust limits of a colour scale, and the
images of a large block by the rows of a picture. No loop runs over values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import SHARE, counts
from mgsgraph.geometry.records import Array, Index
from mgsgraph.results.figures.sheet import short

LARGE_BLOCK = 16
"""Images up to which all are drawn, one by one; a larger block has overviews, and a choice of its images."""
MOST_ROWS = 500
"""Rows of a picture; a block of more images has several in a row."""
_NAMED = 12
"""Rows that have their image's name beside them."""


def means(values: Array, groups: Index, number: int) -> Array:
    """(number,) mean of the finite values (n,) of each group (n,), counted from 0; NaN where there are none."""
    sound = np.isfinite(values)
    values, groups = values[sound], groups[sound]
    of = counts(groups, number)
    total = np.bincount(groups, weights=values, minlength=number)
    return np.where(of > 0, total / np.maximum(of, 1), np.nan)


def cell_means(
    places: Array, values: Array, size: tuple[float, float], cells: tuple[int, int], fewest: int
) -> tuple[Array, Array]:
    """Middles (m, 2) of the cells of a rectangle from zero to `size`, and the means (m, 2) of the values (n, 2) whose
    places (n, 2) lie in each; cells of fewer than `fewest` values are left out, places outside belong to the nearest.
    """
    widths = np.array(size, dtype=np.float64) / cells
    cell, number = cell_numbers(places, size, cells), cells[0] * cells[1]
    some = np.flatnonzero(counts(cell, number) >= fewest)
    middles = (np.stack(np.divmod(some, cells[1]), axis=1) + 0.5) * widths
    return middles, np.stack([means(values[:, k], cell, number)[some] for k in range(2)], axis=1)


def cell_numbers(places: Array, size: Array | tuple[float, float], cells: tuple[int, int]) -> Index:
    """(n,) number of the cell, row by row, in which each place (n, 2) of a rectangle from zero to `size` lies; places
    outside belong to the nearest.
    """
    along, across = np.clip(places * (np.array(cells) / size), 0.0, np.array(cells) - 1.0).astype(np.int64).T
    return np.asarray(along * cells[1] + across)


def limit(values: Array) -> float:
    """Half the width of a colour scale about zero that covers 98 % of the values; 1 where nothing is finite."""
    sound = np.abs(values[np.isfinite(values)])
    return (float(np.quantile(sound, SHARE)) if sound.size else 0.0) or 1.0


def image_rows(images: int, most: int = MOST_ROWS) -> Index:
    """(images,) row of each of so many images in a picture of at most `most` rows, from 0, none of them empty."""
    return np.arange(images) * min(images, most) // max(images, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Images of a block by the rows of a picture, in their own order."""

    images: Sequence[int]
    """Which images of the network."""
    names: Sequence[str]
    """Of those that are first in a row, (number,)."""
    row: Index
    """(images of the network,) row of each; -1 for one that is in none."""

    @staticmethod
    def of(solution: Solution, images: Sequence[int] | None = None) -> "Rows":
        """Rows of some images, of all by default."""
        every = solution.network.images
        images = range(len(every)) if images is None else images
        row, mine = np.full(len(every), -1, dtype=np.int64), image_rows(len(images))
        row[np.asarray(images, dtype=np.int64)] = mine
        first = np.searchsorted(mine, np.arange(min(len(images), MOST_ROWS)))
        return Rows(images, [every[images[k]].name for k in first], row)

    @property
    def number(self) -> int:
        """How many rows there are."""
        return len(self.names)

    @property
    def words(self) -> str:
        """For an axis: what a row is."""
        several = -(-len(self.images) // max(self.number, 1))
        return "image" if several == 1 else f"images, up to {several} in a row"

    def name(self, panel: Axes) -> None:
        """Write some of the names beside a panel's rows."""
        ticks = np.unique(np.linspace(0, self.number - 1, min(self.number, _NAMED)).round().astype(int)).tolist()
        panel.set_yticks(ticks, [short(self.names[k], 20) for k in ticks], size=7.0)
