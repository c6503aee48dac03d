"""The ground under the map: orthorectified images, and relief where there are none, as tiles of the map's plane.

A tile of level n has 256 x 256 pixels of 2^n m; columns and rows count from the map's zero, eastward and northward.
Nodes of a grid are projected into the image exactly, with its adjusted orientation, pixels between them bilinearly.
"""

from collections.abc import Collection
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import Image

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import places_at, surface_radii
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import between_nodes
from mgsgraph.studio.map_points import shaded_relief
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.tiles import SIDE, Tiles, png

_LEVELS = range(-12, 25)
_STEP = 8.0
"""Pixels of a tile from one exact projection to the next; fewer where an image is narrower than twice that."""
_MARGIN = 0.05
"""By which an image's outline, as a share of its size, may be off: it is drawn for another height of the ground."""
_MOST_KEPT = 2000
"""Tiles that are kept, up to 64 kB each."""


def ground_at(opened: Opened, plane: Array) -> Array:
    """(n, 3) m, the ground under places (n, 2) in m on the map: the terrain model as the adjustment has moved it; where
    there is none, the ellipsoid, raised by the median height of the points.
    """
    block = opened.block()
    points = places_at(plane, opened.centre)
    directions = unit_vectors(points)
    ground = directions * (surface_radii(points, block.images[0].body) + block.median_height)[:, None]
    if block.terrain is None:
        return ground
    posts = directions * block.terrain.at(points)[:, None]
    moved = block.terrain_motion(np.where(np.isfinite(posts), posts, ground))
    radii = block.terrain.at(posts - moved) + np.einsum("ni,ni->n", moved, directions)
    return np.where(np.isfinite(radii)[:, None], directions * radii[:, None], ground)


class MapImages:
    """Images of a block in one state, on its map; may be asked by several threads.

    Parameters
    ----------
    opened : Opened
    tiles : Tiles
        Of the images' pictures.
    """

    def __init__(self, opened: Opened, tiles: Tiles) -> None:
        self.opened, self._tiles, self._block = opened, tiles, opened.block()
        self._sizes = [_pixel_size(*both) for both in zip(opened.footprints(), self._block.images, strict=True)]
        self._unreadable, self._kept = dict[str, str](), lru_cache(_MOST_KEPT)(self._encoded)

    def record(self) -> dict[str, Any]:
        """Images with pixels, the finest first, number of all, and why some could not be read, as JSON."""
        names = [self._block.images[j].name for j in self._order("")]
        return {"names": names, "count": len(self._block.images), "unreadable": list(self._unreadable.values())}

    def tile(self, place: tuple[int, int, int], layers: Collection[str], top: str) -> bytes:
        """A tile of a level, row and column as PNG, transparent where nothing is shown; otherwise as `picture`.

        Raises
        ------
        InputError
            No such level.
        """
        require(place[0] in _LEVELS, "tile of the map", f"level {place[0]}", f"{_LEVELS[0]} to {_LEVELS[-1]}")
        return self._kept(place, tuple(layer for layer in ("images", "relief") if layer in layers), top)

    def _encoded(self, place: tuple[int, int, int], layers: tuple[str, ...], top: str) -> bytes:
        corner = np.array(place[:0:-1])  # column and row
        grey = self.picture(np.concatenate([corner, corner + 1]) * SIDE * 2.0 ** place[0], (SIDE, SIDE), layers, top)
        bands = [np.rint(np.nan_to_num(grey)), 255 * np.isfinite(grey)]
        return png(Image.merge("LA", [Image.fromarray(band.astype(np.uint8)) for band in bands]))

    def picture(self, box: Array, shape: tuple[int, int], layers: Collection[str], top: str = "") -> Array:
        """Grey values (rows, columns), 0 to 255, from the north downwards, of a box (4,) of x and y, low and high, in m
        on the map; NaN where nothing is shown. Layers: images, and relief where there are none; the image `top` lies
        on the others, of which the finest is shown.
        """
        grey = np.full(shape, np.nan)
        for image in self._order(top) if "images" in layers else []:
            try:
                self._draw(grey, box, image)
            except InputError as error:  # other images are shown all the same
                self._unreadable[self._block.images[image].name] = str(error)
        if "relief" in layers and self._block.terrain is not None:
            grey = np.where(np.isfinite(grey), grey, 40.0 + 200.0 * shaded_relief(self.opened, box, shape[::-1]))
        return grey

    def _order(self, top: str) -> list[int]:
        """Images with pixels from the top downwards."""
        images = self._block.images
        shown = [j for j in np.flatnonzero(np.isfinite(self._sizes)).tolist() if self._tiles.has(images[j].name)]
        return sorted(shown, key=lambda j: (images[j].name != top, self._sizes[j]))

    def _draw(self, grey: Array, box: Array, image: int) -> None:
        """Put an image where nothing is yet in grey values (rows, columns) of a box."""
        pixel, cells = (box[2:] - box[:2]) / grey.shape[::-1], self._empty(grey, box, image)
        if not len(cells):
            return
        record, gsd = self._block.images[image], self._sizes[image]
        step = float(np.clip(0.5 * min(record.lines, record.samples) * gsd / pixel.max(), 1.0, _STEP))
        places = self.projections(image, box, pixel, np.asarray(cells, dtype=np.float64) + 0.5, step)
        picture = self._tiles.picture(record.name)
        level = int(np.clip(np.log2(pixel.max() / gsd), 0, picture.levels - 1))
        places /= 2.0**level
        with np.errstate(invalid="ignore"):
            seen = np.all((places >= 0.0) & (places <= np.array([record.lines, record.samples]) / 2.0**level), axis=1)
        if not np.any(seen):
            return
        places, cells = places[seen] - 0.5, cells[seen]
        start = np.maximum(np.floor(places.min(axis=0)).astype(int), 0)
        end = np.minimum(np.ceil(places.max(axis=0)).astype(int) + 1, picture.shape(level))
        pixels = picture.pixels(level, *(slice(a, b) for a, b in zip(start, end, strict=True)))
        shares = (between_nodes(pixels, places - start) - picture.low) / (picture.high - picture.low)
        grey[tuple(cells.T)] = 255.0 * np.clip(shares, 0.0, 1.0)

    def _empty(self, grey: Array, box: Array, image: int) -> Index:
        """(k, 2) rows and columns around an image's outline where nothing is yet."""
        outline = self.opened.footprints()[image]
        margin = _MARGIN * float(np.ptp(outline, axis=0).max())
        (west, south), (east, north) = outline.min(axis=0) - margin, outline.max(axis=0) + margin
        corners = np.array([[box[3] - north, west - box[0]], [box[3] - south, east - box[0]]])
        corners *= grey.shape / (box[2:] - box[:2])[::-1]
        (top, left), (bottom, right) = np.clip([np.floor(corners[0]), np.ceil(corners[1])], 0, grey.shape).astype(int)
        return np.asarray(np.argwhere(np.isnan(grey[top:bottom, left:right])) + np.array([top, left]), dtype=np.int64)

    def projections(self, image: int, box: Array, pixel: Array, at: Array, step: float = _STEP) -> Array:
        """(n, 2) line and sample in an image of rows and columns (n, 2), in pixels from the north-west of a box: exact
        at nodes of a grid, `step` pixels from one to the next, bilinear between.
        """
        first, counts = at.min(axis=0), np.maximum(np.ceil(np.ptp(at, axis=0) / step).astype(int), 1) + 1
        nodes = np.indices(counts).reshape(2, -1).T * step + first
        plane = np.column_stack([box[0] + nodes[:, 1] * pixel[0], box[3] - nodes[:, 0] * pixel[1]])
        exact = projected(self._block, image, ground_at(self.opened, plane))
        return between_nodes(exact.reshape(*counts, 2), (at - first) / step)


def _pixel_size(outline: Array, image: PushbroomImage) -> float:
    """Root of a pixel's mean area within an outline (k, 2) in m; infinite for an image that sees no ground."""
    x, y = outline.T
    return float(np.sqrt(0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / (image.lines * image.samples))) or np.inf
