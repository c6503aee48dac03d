"""Points of a block on the studio's map: what is known of each, in arrays; those in a window, or cells of many."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.statistics import counts, medians, span
from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import digits, plain
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import PointClass
from mgsgraph.studio.block import Block
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Opened

MOST_POINTS = 4000
"""Points in a window that are sent one by one; of more, cells."""
_CELL = 7.0
"""CSS pixels, side of a cell."""
_MOST_CELLS = 60_000
MOST_SELECTED = 500
"""Names of a selection that are sent; of more, those that lead its order."""
VALUES = {
    "sigma": ("3-D sigma", "m"), "sigma_horizontal": ("horizontal sigma", "m"), "sigma_up": ("sigma upward", "m"),
    "moved_horizontal": ("horizontal correction", "m"), "moved_up": ("correction upward", "m"),
    "residual": ("largest residual", "px"), "rays": ("rays", "of a point"), "wtest": ("largest w-test", "sigmas"),
}  # fmt: skip
"""What points are coloured by: title and unit."""
CLASSES = [kind.name.lower() for kind in PointClass]


@dataclass(frozen=True, eq=False)
class MapPoints:
    """n points of a block."""

    opened: Opened
    """Whose."""
    block: Block
    """In which state."""
    before: Array | None
    """(n, 3) m, where they were before the adjustment; a-priori places when absent."""

    @cached_property
    def plane(self) -> Array:
        """(n, 2) m on the map; NaN for points without a place."""
        return self.opened.map_places(self.block.places)

    @cached_property
    def classes(self) -> Index:
        """(n,) values of `PointClass`."""
        return self.block.network.points.classes

    @cached_property
    def local(self) -> Array:
        """(n, 3, 3) m^2, covariances east, north, up; NaN before any adjustment."""
        n = len(self.classes)
        if self.block.covariances is None:
            return np.full((n, 3, 3), np.nan)
        frames = self.frames()
        return np.asarray(frames @ self.block.covariances @ np.swapaxes(frames, 1, 2))

    def frames(self, mine: Index | None = None) -> Array:
        """(n, 3, 3) rows east, north and up at the points, or at some (m,) of them."""
        places = self.block.places if mine is None else self.block.places[mine]
        return east_north_up(np.where(np.isfinite(places), places, 1.0))

    @cached_property
    def moved(self) -> Array:
        """(n, 3) m east, north and up, adjusted minus before; NaN where nothing was before."""
        before = self.block.network.points.places if self.before is None else self.before
        return np.asarray(np.einsum("nij,nj->ni", self.frames(), self.block.places - before))

    def value(self, name: str) -> Array:
        """(n,) what points are coloured by, one of `VALUES`; NaN where nothing is known."""
        if name not in VALUES:
            raise InputError("request, value", repr(name)[:60], f"one of {', '.join(VALUES)}")
        return self.opened.once(f"value {name}", lambda: getattr(self, f"_{name}")())

    def _sigma(self) -> Array:
        return np.asarray(np.sqrt(np.trace(self.local, axis1=1, axis2=2)))

    def _sigma_horizontal(self) -> Array:
        return np.sqrt(self.local[:, 0, 0] + self.local[:, 1, 1])

    def _sigma_up(self) -> Array:
        return np.sqrt(self.local[:, 2, 2])

    def _moved_horizontal(self) -> Array:
        return np.hypot(self.moved[:, 0], self.moved[:, 1])

    def _moved_up(self) -> Array:
        return self.moved[:, 2]

    def _residual(self) -> Array:
        """Of the largest image residual of each point."""
        block, rays = self.block, self.block.network.rays
        predicted = np.full((rays.point.size, 2), np.nan)
        for j, mine in enumerate(block.rays_by_image):
            points = rays.point[mine]
            predicted[mine] = projected(block, j, block.places[points], rays.places[mine, 0])
        size = np.linalg.norm(rays.places - predicted, axis=1)
        return _largest(size, rays.point, len(self.classes))

    def _rays(self) -> Array:
        return np.bincount(self.block.network.rays.point[self.block.used], minlength=len(self.classes)).astype(float)

    def _wtest(self) -> Array:
        """Largest |w| of the image measures of each point."""
        found = reliability(self.opened.posterior().linearised).measures
        mine = np.flatnonzero((found.kind == MeasureKind.RAY) & (found.point >= 0))
        return _largest(np.abs(found.test[mine]), found.point[mine].astype(np.int64), len(self.classes))

    # --- windows

    def inside(self, box: Array, kinds: Mask | None = None) -> Index:
        """(k,) points with a place in a box (4,) of x and y, low and high, of some classes."""
        x, y = self.plane.T
        with np.errstate(invalid="ignore"):
            mine = (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])
        return np.flatnonzero(mine if kinds is None else mine & kinds[self.classes])

    def window(self, box: Array, size: tuple[float, float], value: str, kinds: Mask) -> dict[str, Any]:
        """Points in a box, one by one or as medians of cells, as JSON; `size`: of the window, CSS pixels."""
        values, mine = self.value(value), self.inside(box, kinds)
        low, high = self._scale(value, kinds)
        title, unit = VALUES[value]
        record: dict[str, Any] = {
            "value": value, "title": title, "unit": unit, "low": low, "high": high, "count": int(mine.size),
            "revision": self.opened.revision,
        }  # fmt: skip
        if mine.size <= MOST_POINTS:
            return record | self._one_by_one(mine, values)
        return record | self._cells(mine, values, box, size)

    def _scale(self, value: str, kinds: Mask) -> tuple[float, float]:
        """Ends of the colour scale, 2 % and 98 % of all points of these classes: the same in every window."""
        key = f"scale {value} {kinds.tolist()}"
        return self.opened.once(key, lambda: span(self.value(value)[kinds[self.classes]]))

    def _one_by_one(self, mine: Index, values: Array) -> dict[str, Any]:
        ids = self.block.network.points.ids
        return {
            "form": "points", "names": [ids[i] for i in mine.tolist()], "classes": self.classes[mine].tolist(),
            "x": plain(np.round(self.plane[mine, 0], 3)), "y": plain(np.round(self.plane[mine, 1], 3)),
            "values": digits(values[mine]),
            "moved": plain(np.round(self.moved[mine].T, 4)),
            "covariance": [digits(self.local[mine, i, j]) for i, j in ((0, 0), (0, 1), (1, 1))],
        }  # fmt: skip

    def _cells(self, mine: Index, values: Array, box: Array, size: tuple[float, float]) -> dict[str, Any]:
        shape = np.maximum(np.ceil(np.array(size) / _CELL), 1.0)
        shape *= min(1.0, float(np.sqrt(_MOST_CELLS / shape.prod())))
        columns, rows = (int(max(k, 1.0)) for k in shape)
        side = np.array([(box[2] - box[0]) / columns, (box[3] - box[1]) / rows])
        place = np.minimum(((self.plane[mine] - box[:2]) / side).astype(np.int64), [columns - 1, rows - 1])
        cell, total = place[:, 1] * columns + place[:, 0], columns * rows
        number, middle = counts(cell, total), medians(values[mine], cell, total)
        arrows = [medians(self.moved[mine, k], cell, total) for k in range(2)]
        some = np.flatnonzero(number)
        return {
            "form": "cells", "columns": columns, "rows": rows, "box": box.tolist(), "cells": some.tolist(),
            "numbers": number[some].tolist(), "values": digits(middle[some]),
            "moved": [digits(arrow[some]) for arrow in arrows],
        }  # fmt: skip

    # --- selections

    def selection(self, mine: Index, order: str) -> dict[str, Any]:
        """Names of some points, those of the largest value first; places (k, 2) m on the map."""
        values = self.value(order)[mine]
        first = mine[np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")][:MOST_SELECTED]
        ids = self.block.network.points.ids
        return {
            "count": int(mine.size), "names": [ids[i] for i in first.tolist()], "order": VALUES[order][0],
            "unit": VALUES[order][1], "values": digits(self.value(order)[first]),
            "places": self.plane[first].tolist(),
        }  # fmt: skip


def map_points(opened: Opened) -> MapPoints:
    """The points as they are now."""
    return opened.once("map points", lambda: MapPoints(opened, opened.block(), opened.before))


def _largest(values: Array, groups: Index, number: int) -> Array:
    """(number,) largest finite value of each group; NaN where there is none."""
    found = np.full(number, -np.inf)
    known = np.isfinite(values)
    np.maximum.at(found, groups[known], values[known])
    return np.where(np.isfinite(found), found, np.nan)
