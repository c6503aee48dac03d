"""The ground that a place of an image shows: on the terrain model, else at the height of adjusted points nearby."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from mgsgraph.analysis.places import terrain_slopes
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up, geodetic
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.studio.block import Block
from mgsgraph.text import many
from mgsgraph.units import KM

_NEIGHBOURS = 5
"""Points whose heights count."""
_ROUNDS = 3
"""Of the intersection with ground that is known beneath the place alone."""
_ELLIPSOID = "on the ellipsoid: neither a terrain model nor a point with a place"
_AROUND = 16
"""Posts beyond the images that are kept of a terrain model."""


class NoGround(InputError):
    """A place of an image whose ray goes by the body."""


class Ground(NamedTuple):
    """The ground at one place of an image."""

    point: Array
    """(3,) m, body-fixed."""
    slopes: Array
    """(3, 2) m per px: how it moves on the ground with line and sample."""
    by_height: Array
    """(3,) m per m: how it moves along its ray with the height of the ground."""
    height: float
    """m above the ellipsoid."""
    height_sigma: float
    """m, of that height; NaN where nobody has said it."""
    surface: str
    """What it lies on, in words."""


class GroundModel:
    """The ground of a block.

    Parameters
    ----------
    block : Block
        Its terrain model counts where there is one, else its points that have a place.
    """

    def __init__(self, block: Block) -> None:
        self._block = block

    def under(self, image: int, line: float, sample: float) -> Ground:
        """The ground at a place of an image.

        Raises
        ------
        NoGround
            A ray that goes by the body.
        """
        found = self._on_terrain(image, line, sample) or self._near_points(image, line, sample)
        if not np.all(np.isfinite(found.point)):
            where = f"image {self._block.images[image].name}, line {line:g}, sample {sample:g}"
            raise NoGround(where, "its ray goes by the body", "a place that shows ground")
        return found

    def _on_terrain(self, image: int, line: float, sample: float) -> Ground | None:
        grid = self._grid
        if grid is None:
            return None
        picture, correction = self._block.images[image], self._block.corrections[image]
        rays = picture.rays(np.array([line]), np.array([sample]), correction)
        origins, directions, d_origins, d_directions = rays
        motion = np.zeros((1, 3))
        for _ in range(_ROUNDS):
            point = meet_terrain(origins - motion, directions, grid)
            if not np.all(np.isfinite(point)):
                return None
            moved = self._block.terrain_motion(point)
            if np.abs(moved - motion).max() < 1e-3:
                break
            motion = moved
        slopes = terrain_slopes(point, origins - motion, directions, d_origins, d_directions, grid)
        words = "on the terrain model" + (", as the adjustment has moved it" if np.any(motion) else "")
        sigma = grid.vertical_sigma
        return self._ground(point + motion, slopes, directions, np.nan if sigma is None else sigma, words)

    def _near_points(self, image: int, line: float, sample: float) -> Ground:
        picture, correction = self._block.images[image], self._block.corrections[image]
        where = np.array([line]), np.array([sample])
        height, sigma, words = self._middle, np.nan, _ELLIPSOID
        rounds = _ROUNDS if self._tree is not None else 0
        for _ in range(rounds):
            point, _ = picture.image_to_ground(*where, height, correction)
            if not np.all(np.isfinite(point)):
                break
            height, sigma, words = self._height_by(point[0])
        point, slopes = picture.image_to_ground(*where, height, correction)
        _, directions = picture.sightlines(*where, correction)
        return self._ground(point, slopes, directions, sigma, words)

    def _height_by(self, point: Array) -> tuple[float, float, str]:
        """Height (m), its sigma (m) and what it is, of the nearest points: means weighted by the inverse squares of
        distances (Shepard 1968).
        """
        assert self._tree is not None
        count = min(_NEIGHBOURS, self._heights.size)
        distances, nearest = (np.atleast_1d(one) for one in self._tree.query(point, count))
        heights = self._heights[nearest]
        weights = 1.0 / np.maximum(distances, 1.0) ** 2
        weights /= weights.sum()
        height = float(weights @ heights)
        spread = float(np.sqrt(weights @ (heights - height) ** 2 + weights @ self._sigmas[nearest] ** 2))
        kind = "adjusted point" if self._block.adjusted else "a-priori place"
        words = f"at the height of the nearest {many(count, kind)}, {height:.0f} m with a sigma of {spread:.2g} m"
        return height, spread, f"{words}; the next one is {distances.min() / KM:.2g} km away"

    def _ground(self, point: Array, slopes: Array, directions: Array, sigma: float, words: str) -> Ground:
        up = east_north_up(point)[0, 2]
        direction = directions[0] / (directions[0] @ up)
        height = float(geodetic(point, self._block.images[0].body)[0, 2])
        return Ground(point[0], slopes[0], direction, height, float(sigma), words)

    @cached_property
    def _grid(self) -> TerrainGrid | None:
        """The terrain model about the block."""
        grid, places = self._block.terrain, [self._block.places]
        if grid is None:
            return None
        for picture, correction in zip(self._block.images, self._block.corrections, strict=True):
            lines, samples = np.meshgrid(np.linspace(0.0, picture.lines, 9), np.linspace(0.0, picture.samples, 3))
            places.append(picture.image_to_ground(lines.ravel(), samples.ravel(), 0.0, correction)[0])
        every = np.concatenate(places)
        return grid.around(every[np.all(np.isfinite(every), axis=1)], _AROUND)

    @cached_property
    def _known(self) -> Index:
        """(m,) points with a place."""
        return np.flatnonzero(np.all(np.isfinite(self._block.places), axis=1) & np.any(self._block.places, axis=1))

    @cached_property
    def _heights(self) -> Array:
        """(m,) m above the ellipsoid, of these."""
        return np.asarray(geodetic(self._block.places[self._known], self._block.images[0].body)[:, 2])

    @cached_property
    def _sigmas(self) -> Array:
        """(m,) m, of these."""
        found = self._block.covariances
        if found is None:
            return np.zeros(self._known.size)
        up = east_north_up(self._block.places[self._known])[:, 2]
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", up, found[self._known], up), 0.0)))

    @cached_property
    def _tree(self) -> KDTree | None:
        return KDTree(self._block.places[self._known]) if self._known.size else None

    @cached_property
    def _middle(self) -> float:
        """m, median height."""
        return float(np.median(self._heights)) if self._heights.size else 0.0
