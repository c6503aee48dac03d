"""Layers of the studio's map that lie under the points: shaded relief, sigmas of new points, residuals of an image."""

from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from mgsgraph.analysis.overlap_sigmas import SigmaGrid, sigma_grid
from mgsgraph.analysis.statistics import span
from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import digits
from mgsgraph.geometry.body import east_north_up, from_planetocentric, places_at, planetocentric
from mgsgraph.geometry.records import Array, Index, thinned
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Opened

_MOST_PIXELS = 700
"""Pixels of a relief picture along its longer side; the browser enlarges it."""
_SUN = np.array([-0.5, 0.5, np.sqrt(0.5)])
"""Direction to the sun: from the north-west, 45 degrees high."""
_MOST_IMAGES = 12
"""Images up to which sigmas of new points are mapped: each cell is projected into every one."""
_MOST_VECTORS = 2000
_STEP = 1.0
"""m, of the difference quotient of an image's places by the ground."""


def relief_png(opened: Opened, box: Array, size: tuple[float, float]) -> bytes:
    """`shaded_relief` as a picture, transparent where the model says nothing."""
    light = shaded_relief(opened, box, size)
    known = np.isfinite(light)
    grey = np.where(known, 40.0 + 200.0 * np.nan_to_num(light), 0.0).astype(np.uint8)
    file = BytesIO()
    Image.merge("LA", [Image.fromarray(grey), Image.fromarray(known.astype(np.uint8) * 255)]).save(file, "png")
    return file.getvalue()


def shaded_relief(opened: Opened, box: Array, size: tuple[float, float]) -> Array:
    """Light (rows, columns), 0 to 1, on the terrain model in a box (4,) of x and y, low and high, in m on the map, from
    the north downwards; NaN where the model says nothing.

    Raises
    ------
    InputError
        A block without a terrain model.
    """
    terrain = opened.block().terrain
    if terrain is None:
        raise InputError(str(opened.path), "no terrain model", "a block whose case names one")
    columns, rows = _pixels(size)
    x = box[0] + (np.arange(columns) + 0.5) * (box[2] - box[0]) / columns
    y = box[3] - (np.arange(rows) + 0.5) * (box[3] - box[1]) / rows
    plane = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    heights = terrain.at(places_at(plane, opened.centre)).reshape(rows, columns)
    down, right = np.gradient(heights, (box[3] - box[1]) / rows, (box[2] - box[0]) / columns)
    normal = np.stack([-right, down, np.ones_like(right)], axis=-1)  # rows go southward
    return np.asarray(np.clip(normal @ _SUN / np.linalg.norm(normal, axis=-1), 0.0, 1.0))


def _pixels(size: tuple[float, float]) -> tuple[int, int]:
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
    at = projected(block, j, places, measured[:, 0])
    slopes = np.stack(
        [(projected(block, j, places + _STEP * frames[:, k], measured[:, 0]) - at) / _STEP for k in range(2)], axis=-1
    )
    residuals = measured - at
    good = np.flatnonzero(np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(residuals).all(axis=1))
    good = good[np.abs(np.linalg.det(slopes[good])) > 1e-12]
    moves = np.linalg.solve(slopes[good], residuals[good][..., None])[..., 0]
    return {
        "image": image, "places": np.round(opened.map_places(places[good]), 2).tolist(),
        "vectors": np.round(moves, 4).tolist(), "residuals": np.round(residuals[good], 4).tolist(),
        "median_px": float(np.median(np.linalg.norm(residuals[good], axis=1))) if good.size else None,
    }  # fmt: skip


def longitude_latitude(opened: Opened, plane: Array) -> Array:
    """(n, 2) rad, longitude and planetocentric latitude of places (n, 2) in m on the map."""
    return planetocentric(places_at(plane, opened.centre))[:, :2]
