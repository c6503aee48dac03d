"""Points of a block on the studio's map: arrays of what is known of each; points of a window, or cells of many."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.places import SigmaGrid, sigma_grid
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.statistics import medians, span
from mgsgraph.errors import InputError, require
from mgsgraph.files.output.table import digits, plain
from mgsgraph.geometry.body import east_north_up, from_planetocentric, places_at, planetocentric
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs, finite_rows, thinned
from mgsgraph.network import PointClass
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Block, Opened

MOST_POINTS = 4000
"""Most points of a window that are sent singly; above that, cells."""
_CELL = 7.0
"""CSS pixels, side of a cell."""
_MOST_CELLS = 60_000
_ARROWS = 5
"""Of so many columns and rows of cells one has its correction."""
_MAP_WORDS = "m east and north of the block's middle, azimuthal equidistant on the sphere through it"
_MOST_OUTLINES, _FEW_PLACES = 3000, 5
"""Most images with full outlines; above that, vertices of each outline."""
MOST_SELECTED = 500
"""Most names of a selection that are sent, the first of its order."""
VALUES = {
    "sigma": ("3-D sigma", "m"), "sigma_horizontal": ("horizontal sigma", "m"), "sigma_up": ("sigma upward", "m"),
    "moved_horizontal": ("horizontal correction", "m"), "moved_up": ("correction upward", "m"),
    "residual": ("largest residual", "px"), "rays": ("rays", "of a point"), "wtest": ("largest w-test", "sigmas"),
}  # fmt: skip
"""Values that color the points: title and unit."""
CLASSES = [kind.name.lower() for kind in PointClass]


@dataclass(frozen=True, eq=False)
class MapPoints:
    """n points of a block."""

    opened: Opened
    """What is open."""
    block: Block
    """Its state."""

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
        count = len(self.classes)
        if self.block.covariances is None:
            return np.full((count, 3, 3), np.nan)
        frames = self.every_frame
        return np.asarray(frames @ self.block.covariances @ frames.mT)

    def frames(self, chosen: Index | slice = slice(None)) -> Array:
        """(n, 3, 3) rows east, north and up at the points, or at some (m,) of them."""
        places = self.block.places[chosen]
        return east_north_up(np.where(np.isfinite(places), places, 1.0))

    @cached_property
    def every_frame(self) -> Array:
        """(n, 3, 3) `frames` of all points."""
        return self.frames()

    @cached_property
    def moved(self) -> Array:
        """(n, 3) m east, north and up, adjusted minus before; NaN without a place before."""
        return self.moved_of(slice(None))

    def moved_of(self, chosen: Index | slice) -> Array:
        """(m, 3) the same of some points (m,)."""
        stored = self.opened.now.before
        before = self.block.network.points.places if stored is None else stored
        frames = self.every_frame if isinstance(chosen, slice) else self.frames(chosen)
        return np.asarray(np.einsum("nij,nj->ni", frames, self.block.places[chosen] - before[chosen]))

    def value(self, name: str) -> Array:
        """(n,) a value of the points, one of `VALUES`; NaN where unknown."""
        require(name in VALUES, "request, value", repr(name)[:60], f"one of {', '.join(VALUES)}")
        rays, count = self.block.network.rays, len(self.classes)
        makers: dict[str, Callable[[], Array]] = {
            "sigma": lambda: np.sqrt(np.trace(self.local, axis1=1, axis2=2)),
            "sigma_horizontal": lambda: np.sqrt(self.local[:, 0, 0] + self.local[:, 1, 1]),
            "sigma_up": lambda: np.sqrt(self.local[:, 2, 2]),
            "moved_horizontal": lambda: np.hypot(self.moved[:, 0], self.moved[:, 1]),
            "moved_up": lambda: self.moved[:, 2],
            "residual": lambda: largest(np.linalg.norm(ray_residuals(self.opened), axis=1), rays.point, count),
            "rays": lambda: np.bincount(rays.point[self.block.used], minlength=count).astype(float),
            "wtest": lambda: largest(ray_tests(self.opened)[0], rays.point, count),
        }
        return self.opened.once(f"value {name}", makers[name])

    # --- windows

    def inside(self, box: Array, kinds: Mask | None = None) -> Index:
        """(k,) points with a place in a box (4,) of x and y, low and high, of some classes."""
        x, y = self.plane.T
        with np.errstate(invalid="ignore"):
            is_inside = (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])
        return np.flatnonzero(is_inside if kinds is None else is_inside & kinds[self.classes])

    def window(self, box: Array, size: tuple[float, float], value: str, kinds: Mask) -> dict[str, Any]:
        """Points in a box, singly or as medians of cells, as JSON; `size`: of the window, CSS pixels."""
        values, chosen = self.value(value), self.inside(box, kinds)
        low, high = self._scale(value, kinds)
        title, unit = VALUES[value]
        record: dict[str, Any] = {
            "value": value, "title": title, "unit": unit, "low": low, "high": high, "count": int(chosen.size),
            "revision": self.opened.revision,
        }  # fmt: skip
        if chosen.size <= MOST_POINTS:
            return record | self._points(chosen, values)
        return record | self._cells(chosen, values, box, size)

    def _scale(self, value: str, kinds: Mask) -> tuple[float, float]:
        """Ends of the color scale, by all points of these classes: the same in every window."""
        key = f"scale {value} {kinds.tolist()}"
        return self.opened.once(key, lambda: span(self.value(value)[kinds[self.classes]]))

    def _points(self, chosen: Index, values: Array) -> dict[str, Any]:
        ids = self.block.network.points.ids
        return {
            "form": "points", "names": [ids[i] for i in chosen.tolist()], "classes": self.classes[chosen].tolist(),
            "x": plain(np.round(self.plane[chosen, 0], 3)), "y": plain(np.round(self.plane[chosen, 1], 3)),
            "values": digits(values[chosen]),
            "moved": plain(np.round(self.moved[chosen].T, 4)),
            "covariance": [digits(self.local[chosen, i, j]) for i, j in ((0, 0), (0, 1), (1, 1))],
        }  # fmt: skip

    def _cells(self, chosen: Index, values: Array, box: Array, size: tuple[float, float]) -> dict[str, Any]:
        shape = np.maximum(np.ceil(np.array(size) / _CELL), 1.0)
        shape *= min(1.0, float(np.sqrt(_MOST_CELLS / shape.prod())))
        columns, rows = (int(max(k, 1.0)) for k in shape)
        cell_size = np.array([(box[2] - box[0]) / columns, (box[3] - box[1]) / rows])
        place = np.minimum(((self.plane[chosen] - box[:2]) / cell_size).astype(np.int64), [columns - 1, rows - 1])
        cell, total = place[:, 1] * columns + place[:, 0], columns * rows
        point_counts, cell_medians = np.bincount(cell, minlength=total), medians(values[chosen], cell, total)
        filled, has_arrow = np.flatnonzero(point_counts), np.all(place % _ARROWS == _ARROWS // 2, axis=1)
        moved = self.moved_of(chosen[has_arrow])
        arrows = np.array([medians(moved[:, k], cell[has_arrow], total) for k in range(2)])
        arrowed = np.flatnonzero(np.all(np.isfinite(arrows), axis=0))
        middles = box[:2] + (np.column_stack([arrowed % columns, arrowed // columns]) + 0.5) * cell_size
        return {
            "form": "cells", "columns": columns, "rows": rows, "box": box.tolist(), "cells": filled.tolist(),
            "numbers": point_counts[filled].tolist(), "values": digits(cell_medians[filled]),
            "places": middles.tolist(), "moved": arrows[:, arrowed].tolist(),
        }  # fmt: skip

    # --- selections

    def selection(self, chosen: Index, order: str) -> dict[str, Any]:
        """Names of points, largest value first; places (k, 2) m on the map."""
        values = self.value(order)[chosen]
        shown = chosen[np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")][:MOST_SELECTED]
        ids = self.block.network.points.ids
        return {
            "count": int(chosen.size), "names": [ids[i] for i in shown.tolist()], "order": VALUES[order][0],
            "unit": VALUES[order][1], "values": digits(self.value(order)[shown]),
            "places": self.plane[shown].tolist(),
        }  # fmt: skip


def map_points(opened: Opened) -> MapPoints:
    """The points as they are now."""
    return opened.once("map points", lambda: MapPoints(opened, opened.block()))


def ray_residuals(opened: Opened) -> Array:
    """(k, 2) px, line and sample, measured minus predicted, of all image measurements; NaN where unknown."""

    def make() -> Array:
        block, rays = opened.block(), opened.block().network.rays
        if opened.now.solution is not None:
            return np.asarray(opened.now.solution.residuals)
        predicted = np.full((rays.point.size, 2), np.nan)
        for j, of_image in enumerate(block.rays_by_image):
            points = block.places[rays.point[of_image]]
            predicted[of_image] = projected(block, j, points, rays.places[of_image, 0])
        return np.asarray(rays.places - predicted)

    return opened.once("ray residuals", make)


def ray_tests(opened: Opened) -> tuple[Array, Array]:
    """Of all image measurements (k,) the larger |w| of line and sample, and the redundancy number of the same one; NaN
    where they have none.
    """

    def make() -> tuple[Array, Array]:
        measures = reliability(opened.posterior().linearised).measures
        rays = np.flatnonzero(measures.kind == MeasureKind.RAY)
        test, found = np.abs(measures.test[rays]), np.full((2, opened.block().network.rays.point.size), np.nan)
        rays, test = rays[order := np.argsort(np.nan_to_num(test, nan=-1.0))], test[order]
        found[:, measures.row[rays].astype(np.int64)] = test, measures.redundancy[rays]  # the last one stays
        return found[0], found[1]

    return opened.once("ray tests", make)


def largest(values: Array, groups: Index, number: int) -> Array:
    """(number,) largest finite value of each group; NaN where there is none."""
    largest = np.full(number, -np.inf)
    finite = np.isfinite(values)
    np.maximum.at(largest, groups[finite], values[finite])
    return np.where(np.isfinite(largest), largest, np.nan)



_MOST_PIXELS = 700
"""Pixels of a relief picture along its longer side; the browser enlarges it."""
_SUN = np.array([-0.5, 0.5, np.sqrt(0.5)])
"""Direction to the sun: from the north-west, 45 degrees high."""
_MOST_IMAGES = 12
"""Most images for a map of new points' sigmas: each cell is projected into all."""
_MOST_VECTORS = 2000
_STEP = 1.0
"""m, of the difference quotient of an image's places by the ground."""


def shaded_relief(opened: Opened, box: Array, size: tuple[float, float]) -> Array:
    """Light (rows, columns), 0 to 1, on the terrain model in a box (4,) of x and y, low and high, in m on the map, from
    the north downwards; NaN outside the model.

    Raises
    ------
    InputError
        A block without a terrain model.
    """
    terrain = opened.block().terrain
    if terrain is None:
        raise InputError(str(opened.path), "no terrain model", "a block whose case names one")
    columns, rows = pixels_of(size)
    x = box[0] + (np.arange(columns) + 0.5) * (box[2] - box[0]) / columns
    y = box[3] - (np.arange(rows) + 0.5) * (box[3] - box[1]) / rows
    plane = all_pairs(x, y)
    heights = terrain.at(places_at(plane, opened.centre)).reshape(rows, columns)
    down, right = np.gradient(heights, (box[3] - box[1]) / rows, (box[2] - box[0]) / columns)
    normal = np.stack([-right, down, np.ones_like(right)], axis=-1)  # rows go southward
    return np.asarray(np.clip(normal @ _SUN / np.linalg.norm(normal, axis=-1), 0.0, 1.0))


def pixels_of(size: tuple[float, float]) -> tuple[int, int]:
    """Columns and rows of a picture for a window of so many CSS pixels."""
    share = min(1.0, _MOST_PIXELS / max(*size, 1.0))
    return max(int(size[0] * share), 2), max(int(size[1] * share), 2)


def sigma_cells(opened: Opened) -> dict[str, Any]:
    """Sigmas of newly measured points over the images' overlap, cell by cell, as JSON: corners on the map (m), m.

    Raises
    ------
    InputError
        More images than are mapped; no overlap; nothing adjusted.
    """
    number = len(opened.block().images)
    if number > _MOST_IMAGES:
        remedy = "mgsgraph analyze RESULT --raster --image A --image B --out FOLDER"
        raise InputError(str(opened.path), f"{number} images", f"{_MOST_IMAGES} at the most for this layer", remedy)
    grid = opened.once("sigma grid", lambda: sigma_grid(opened.posterior()))
    rows, columns = np.nonzero(np.isfinite(grid.values[3]))
    corners = [_corner(opened, grid, rows + down, columns + right) for down, right in ((0, 0), (0, 1), (1, 1), (1, 0))]
    values = grid.values[3][rows, columns]
    low, high = span(values)
    outline = np.round(np.stack(corners, axis=1), 2)
    return {
        "title": "3-D sigma of a new point", "unit": "m", "low": low, "high": high, "sentence": grid.sentence,
        "corners": outline.reshape(-1, 8).tolist(), "values": digits(values),
    }  # fmt: skip


def _corner(opened: Opened, grid: SigmaGrid, rows: Index, columns: Index) -> Array:
    longitudes, latitudes = grid.west + columns * grid.steps[0], grid.north - rows * grid.steps[1]
    radius = float(np.linalg.norm(opened.centre))
    places = np.stack([longitudes, latitudes, np.full(rows.size, radius)], axis=1)
    return opened.map_places(from_planetocentric(places))


def residual_vectors(opened: Opened, image: str) -> dict[str, Any]:
    """Residuals of an image's rays on the ground, as JSON: places (n, 2) in m on the map, vectors (n, 2) in m by which
    a point would have to move east and north for its residual to vanish, and the residuals (n, 2) in px.
    """
    block = opened.block()
    j = block.network.image_number(image)
    rays = block.rays_by_image[j]
    rays = rays[block.used[rays]]
    rays = rays[thinned(rays.size, _MOST_VECTORS)]
    points, measured = block.network.rays.point[rays], block.network.rays.places[rays]
    places = block.places[points]
    frames = east_north_up(np.where(np.isfinite(places), places, 1.0))
    base = projected(block, j, places, measured[:, 0])
    slopes = np.stack(
        [(projected(block, j, places + _STEP * frames[:, k], measured[:, 0]) - base) / _STEP for k in range(2)], axis=-1
    )
    residuals = measured - base
    solvable = np.flatnonzero(np.isfinite(slopes).all(axis=(1, 2)) & finite_rows(residuals))
    solvable = solvable[np.abs(np.linalg.det(slopes[solvable])) > 1e-12]
    moves = np.linalg.solve(slopes[solvable], residuals[solvable][..., None])[..., 0]
    return {
        "image": image, "places": np.round(opened.map_places(places[solvable]), 2).tolist(),
        "vectors": np.round(moves, 4).tolist(), "residuals": np.round(residuals[solvable], 4).tolist(),
        "median_px": float(np.median(np.linalg.norm(residuals[solvable], axis=1))) if solvable.size else None,
    }  # fmt: skip


def longitude_latitude(opened: Opened, plane: Array) -> Array:
    """(n, 2) rad, longitude and planetocentric latitude of places (n, 2) in m on the map."""
    return planetocentric(places_at(plane, opened.centre))[:, :2]


# --- what is open


def scene_record(opened: Opened) -> dict[str, Any]:
    """What is open: images, classes of points, what can be drawn, as JSON."""
    block = opened.block()
    number = np.bincount(block.network.points.classes, minlength=len(PointClass))
    places = map_points(opened).plane
    located = places[finite_rows(places)]
    corners = located if len(located) else np.concatenate([outline for outline in opened.footprints() if len(outline)])
    return {
        "kind": opened.kind, "name": opened.now.name, "path": str(opened.path), "revision": opened.revision,
        "adjusted": block.adjusted, "warning": opened.warning,
        "images": [
            {"name": image.name, "lines": image.lines, "samples": image.samples,
             "picture": opened.pictures.get(image.name) is not None}
            for image in block.images
        ],
        "map": {"frame": _MAP_WORDS, "bounds_m": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]},
        "classes": [{"name": name, "count": int(count)} for name, count in zip(CLASSES, number, strict=True)],
        "values": [{"name": name, "title": title, "unit": unit} for name, (title, unit) in VALUES.items()],
        "terrain": block.terrain is not None,
        "verdicts": None if opened.judging is None else str(opened.judging.path),
    }  # fmt: skip


def outlines_record(opened: Opened) -> dict[str, Any]:
    """Outline (k, 2) of each image in m on the map, empty where it sees nothing of the body, as JSON."""
    outlines = opened.footprints()
    most = None if len(outlines) <= _MOST_OUTLINES else _FEW_PLACES
    return {"outlines_m": [np.round(outline[thinned(len(outline), most)], 1).tolist() for outline in outlines]}


def selected(opened: Opened, value: str, least: float | None, box: Array | None, kinds: Mask) -> dict[str, Any]:
    """Points of some classes in a box, and of a value (`VALUES`) of at least so much, as JSON."""
    points = map_points(opened)
    chosen = np.flatnonzero(kinds[points.classes]) if box is None else points.inside(box, kinds)
    if least is not None:
        with np.errstate(invalid="ignore"):
            chosen = chosen[points.value(value)[chosen] >= least]
    return points.selection(chosen, value)
