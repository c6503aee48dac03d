"""The first image over the terrain model: every pixel where the model says its ground is seen.

The scene of a terrain model: images with their adjusted orientation, the expected ground, dense matches.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.schema import CaseInput
from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import east_north_up, ellipsoidal_heights
from mgsgraph.geometry.records import Array, Mask, sigmas_of
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.matching.patches import Tile, ortho_patch
from mgsgraph.matching.scene import Ground, Picture, Scene
from mgsgraph.names import image_names
from mgsgraph.registration.dem.gridding import HeightGrid, MapGrid, bilinear, orientation_nodes
from mgsgraph.text import some
from mgsgraph.workers import Progress, no_progress

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_SIDE = 1024
"""pixels of a tile."""
_REACH = 64
"""posts over which holes and the model's rim are filled to project a picture's pixels between them; they stay empty."""


@dataclass(frozen=True, slots=True, eq=False)
class _ModelGround(Ground):
    """The ground as a terrain model has it, over its map."""

    map: MapGrid = field(kw_only=True)
    """Where its posts are."""
    filled: Array = field(kw_only=True)
    """(rows, columns) m above the map's sphere, without holes."""

    def points(self, plane: Array) -> Array:
        """(n, 3) m, body-fixed, at positions (n, 2) of the map."""
        size = np.array(self.filled.shape) - 1.0
        return self.map.points(plane, bilinear(self.filled, np.clip(self.map.pixels(plane), 0.0, size)))


def ortho_tiles(
    picture: Picture, model: HeightGrid, ground: Ground, grid: MapGrid,
    progress: Progress = no_progress,
) -> Iterator[tuple[int, int, NDArray[np.uint8]]]:
    """A picture, with its adjusted orientation, on the pixels of a map, tile after tile.

    `ground` is the a-priori one, of the same body, and `grid` of the same projection as the model's map. Yields
    the first row and column of a tile and its grey values (rows, columns): 1 .. 255 between the picture's levels, 0
    where the model has no height or the picture no pixel.
    """
    over = _ModelGround(
        grid.chart, ground.body, ground.height, ground.height_sigma, map=model.map, filled=_filled(model.heights)
    )
    has_height = np.isfinite(model.heights)
    corners = [(row, column) for row in range(0, grid.rows, _SIDE) for column in range(0, grid.columns, _SIDE)]
    for k, (row, column) in enumerate(corners):
        rows, columns = min(_SIDE, grid.rows - row), min(_SIDE, grid.columns - column)
        part = MapGrid(
            grid.longitude, grid.latitude, grid.radius, grid.west + column * grid.post, grid.north - row * grid.post,
            grid.post, rows, columns,
        )  # fmt: skip
        inside = _nearest(has_height, model.map, part)
        west, south = part.west + 0.5 * grid.post, part.north - (rows - 0.5) * grid.post
        patch = ortho_patch(picture, over, Tile(k, west, south, grid.post, rows, columns, 0))
        progress("ortho image", k + 1, len(corners))
        if patch is not None and np.any(inside):
            visible = (patch.valid[::-1] > 0) & inside
            yield row, column, np.where(visible, np.maximum(patch.grey[::-1], 1), 0).astype(np.uint8)


def _nearest(has_height: Mask, model: MapGrid, part: MapGrid) -> Mask:
    """(rows, columns) whether the post of the model in whose cell each pixel of `part` lies has a height."""
    y = part.north - (np.arange(part.rows) + 0.5) * part.post
    x = part.west + (np.arange(part.columns) + 0.5) * part.post
    rows = np.clip(((model.north - y) / model.post).astype(np.int64), 0, model.rows - 1)
    columns = np.clip(((x - model.west) / model.post).astype(np.int64), 0, model.columns - 1)
    return np.asarray(has_height[np.ix_(rows, columns)])


def _filled(heights: Array) -> Array:
    """(rows, columns) m without NaN: holes and the rim take the mean of what is next to them, ring by ring; what is
    far away takes the mean of all.
    """
    filled = heights.copy()
    for _ in range(_REACH):
        holes = np.isnan(filled)
        if not holes.any():
            return filled
        padded = np.pad(filled, 1, constant_values=np.nan)
        near = [padded[i : i + filled.shape[0], j : j + filled.shape[1]][holes] for i in range(3) for j in range(3)]
        finite = np.isfinite(near)
        count = finite.sum(axis=0)
        filled[holes] = np.where(count > 0, np.where(finite, near, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    return np.where(np.isnan(filled), np.nanmean(heights), filled)


def ortho_accuracy(posterior: Posterior, scene: Scene, matched: "DenseMatches", model: HeightGrid) -> Array:
    """Sigma east and north in m of positions in the ortho image, the first picture of a matched pair, and their
    correlation: (3, rows, columns) at the model's posts, for sigma0 = 1; NaN where the model has no height.

    The orientation moves rays and model together, by the covariance of the point where the rays of a match meet. An
    error e of the height by matching moves a pixel along its ray u, by e u / (u v), v = (-slope east, -slope north, 1).
    """
    picture, nodes, grid = scene.pictures[matched.first], orientation_nodes(posterior, scene, matched), model.map
    posts, slopes, heights = grid.posts(), np.nan_to_num(model.slopes).reshape(-1, 2), model.heights.ravel()
    bands, known = np.full((3, heights.size), np.nan), np.flatnonzero(np.isfinite(heights))
    for part in np.array_split(known, known.size // _SIDE // _REACH + 1):  # as many as find room
        points = grid.points(posts[part], heights[part])
        pixels = picture.project(points)
        along = unit_vectors(picture.image.sightlines(pixels[:, 0], pixels[:, 1], picture.correction)[1])
        normal = np.einsum("ni,nij->nj", np.column_stack([-slopes[part], np.ones(part.size)]), grid.frames(points))
        moved = along * (model.matching.ravel()[part] / np.einsum("ni,ni->n", along, normal))[:, None]
        level = east_north_up(points)[:, :2]
        spread = nodes.at(np.nan_to_num(pixels)) + moved[:, :, None] * moved[:, None]
        covariances = level @ spread @ level.mT
        bands[:2, part] = sigmas_of(covariances).T
        bands[2, part] = covariances[:, 0, 1] / bands[:2, part].prod(axis=0)
    return bands.reshape(3, grid.rows, grid.columns)


_LEAST_SIGMA = 100.0
"""m, by how much the ground may leave the mean height of the adjusted points, at least."""


def expected_ground(posterior: Posterior, tables: CaseInput) -> tuple[float | None, float | None]:
    """Height of the ground above the ellipsoid in m, and by how much it may leave that: of the adjusted points, where
    the case has no terrain model that says more.
    """
    points = posterior.linearised.points
    points = points[np.linalg.norm(points, axis=1) > 0.0]
    if tables.terrain_models or not len(points):
        return None, None
    heights = ellipsoidal_heights(points, posterior.network.body)
    return float(np.median(heights)), max(_LEAST_SIGMA, 2.0 * float(heights.std()))


def densely_matched(
    scene: Scene, spacing: float | None, workers: int | None, progress: Progress
) -> tuple[tuple["DenseMatches", ...], float]:
    """Dense matches, and the width of the windows in m."""
    from mgsgraph.matching.dense import HALF_WINDOW, dense_matches

    return dense_matches(scene, spacing, workers, progress), (2 * HALF_WINDOW + 1) * scene.step


def adjusted_names(
    available: Sequence[str], posterior: Posterior, chosen: Sequence[str] = (), where: str = "the case"
) -> list[str]:
    """Of the images `available`, those `chosen` (all when empty); `where` names their case in errors.

    Raises
    ------
    InputError
        Where one was not adjusted, isn't there, or there are fewer than two.
    """
    with errors_from(where):
        names = image_names(chosen, available) or list(available)
    if len(names) < 2:
        raise InputError(where, f"one image for a terrain model ({names[0]})", "two different ones, at least")
    adjusted = posterior.network.image_names
    if missing := [name for name in names if name not in adjusted]:
        both = sum(name in adjusted for name in available) > 1
        raise InputError(
            where, f"images that the solution doesn't have: {some(missing)}",
            f"those that were adjusted ({some(adjusted)})",
            "adjust this case, or give --image" if both else "give the case that was adjusted",
        )  # fmt: skip
    return names


def adjusted_scene(scene: Scene, posterior: Posterior, chosen: Sequence[str] = ()) -> Scene:
    """A scene whose pictures, those of the names `chosen` (all when empty), have the images and corrections that an
    adjustment found, by name.

    Raises
    ------
    InputError
        As `adjusted_names`.
    """
    by_name = {picture.image.name: picture for picture in scene.pictures}
    pictures = [
        replace(by_name[name], image=posterior.image(j), correction=posterior.correction(j))
        for name in adjusted_names(list(by_name), posterior, chosen)
        for j in [posterior.network.image_number(name)]
    ]
    return replace(scene, pictures=tuple(pictures))
