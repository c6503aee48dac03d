"""Stereo surfaces of images, averaged over laser footprints and over cells of terrain models."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.case_file import decode
from mgsgraph.case.scene import read_scene
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import SPOT_WIDTHS
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.stereo_surface import LEAST_SHARE, StereoSurface, averaged_surface
from mgsgraph.matching.scene import Scene
from mgsgraph.network import PointClass
from mgsgraph.network.footprints import points_in_images
from mgsgraph.network.observations import Posts, TerrainModel, posts_of
from mgsgraph.registration.dem.ortho import adjusted_scene, densely_matched, expected_ground
from mgsgraph.registration.minima import ReliefSettings
from mgsgraph.registration.search import StereoPair
from mgsgraph.workers import Progress

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

_SCATTERS = 3.0
"""Robust standard deviations of the tie points about the ground, within which the ground is sought."""
_CLOSEST = 5.0
"""pixels of the ground grid between dense matches, at least."""
_MATCHES_ACROSS = 12.0
"""Matches across the cell of a terrain model, whose mean they are to show, not its roughness."""
_CELL_SHARE = 0.9
"""Of the usual weight of matches about a node of a cell, below which it is not covered: what a plane through part of a
cell's ground makes of the rest is no mean of it."""
_CELL_PIXELS = 20.0
"""pixels of the images across a cell, at least: what is finer is averaged first."""
_MARGIN = 500.0
"""pixels by which posts may lie beside an image, as shots of [[altimetry]]."""

Cells = tuple[TerrainModel, Posts]
"""A terrain model, and those of its posts that images may show."""


def cells_of(
    models: Sequence[TerrainModel], posterior: Posterior, settings: ReliefSettings
) -> tuple[Cells, ...]:
    """Posts of terrain models in two images at least, or a margin beside them, by the orientation of an adjustment.

    Raises
    ------
    InputError
        Where a model has none.
    """
    images = range(len(posterior.network.images))
    pixel = max(float(_ground_pixel(posterior, j).max()) for j in images)
    least = max(_CELL_PIXELS * pixel, SPOT_WIDTHS * (settings.spacing or 0.0))
    cells = list[Cells]()
    for model in models:
        posts = posts_of(model, least)
        inside = points_in_images(
            [posterior.image(j) for j in images], posts.points, _MARGIN, [posterior.correction(j) for j in images]
        )
        chosen = np.flatnonzero(np.count_nonzero(inside, axis=0) > 1)
        if not chosen.size:
            raise InputError(
                model.lattice.source, f"{len(posts.ids)} posts, none in two images", "a model of the images' ground"
            )
        cells.append((model, posts.chosen(chosen)))
    return tuple(cells)


def _ground_pixel(posterior: Posterior, image: int, place: Array | None = None) -> Array:
    """(2,) m on the ground of a line and of a sample, at a line and sample (2,), or in the middle of an image."""
    picture = posterior.image(image)
    line, sample = place if place is not None else 0.5 * np.array([picture.lines, picture.samples])
    points = posterior.linearised.points
    ground = ellipsoidal_heights(points[np.linalg.norm(points, axis=1) > 0.0], picture.body)
    at = np.array([line]), np.array([sample])
    slopes = picture.image_to_ground(*at, float(np.median(ground)), posterior.correction(image))[1]
    return np.asarray(np.linalg.norm(slopes[0], axis=0), dtype=np.float64)


class AveragedPair(NamedTuple):
    """The surface that two images show, averaged over one size of footprint."""

    surface: StereoSurface
    """What they show."""
    images: tuple[int, int]
    """First and second, in the network."""
    footprint: float
    """m."""

    def oriented(self, posterior: Posterior) -> StereoPair:
        """With the orientation of an adjustment."""
        first, second = self.images
        return StereoPair(
            self.surface,
            (posterior.image(first), posterior.image(second)),
            (posterior.correction(first), posterior.correction(second)),
        )


def stereo_surfaces(
    path: Path,
    posterior: Posterior,
    footprints: Sequence[float],
    cells: Sequence[Cells],
    settings: ReliefSettings,
    workers: int | None,
    progress: Progress,
) -> tuple[AveragedPair, ...]:
    """Match the pictures of a case densely, as they are adjusted, and average the disparities of each stereo pair over
    each size of footprint (m), of laser spots and of the cells of terrain models.
    """
    tables = decode(path)
    _, scene = read_scene(path, *expected_ground(posterior, tables))
    scene = _over_adjusted_ground(adjusted_scene(scene, posterior, settings.images), posterior)
    of_cells = [posts.footprint for _, posts in cells]
    closest = min([size / SPOT_WIDTHS for size in footprints] + [size / _MATCHES_ACROSS for size in of_cells])
    spacing = settings.spacing or max(closest, _CLOSEST * scene.step)
    matches, window = densely_matched(scene, spacing, workers, progress)
    pairs, sizes = list[AveragedPair](), sorted({*footprints, *of_cells})
    for pair in matches:
        i, j = (posterior.network.image_number(scene.pictures[k].image.name) for k in (pair.first, pair.second))
        for size in sizes:
            progress("stereo surface", len(pairs), len(matches) * len(sizes))
            pairs.append(averaged_pair(posterior, pair, (i, j), size, spacing, window, size in of_cells))
    return tuple(pairs)


def _over_adjusted_ground(scene: Scene, posterior: Posterior) -> Scene:
    """The scene with its ground raised to where the adjusted tie points lie, and as uncertain as they scatter about it:
    before registration the images' heights may be hundreds of metres off the terrain model's.
    """
    network, places = posterior.network, posterior.linearised.points
    ties = places[(network.points.classes == PointClass.TIE) & (np.linalg.norm(places, axis=1) > 0.0)]
    if not len(ties):
        return scene
    ground = scene.ground
    above = np.linalg.norm(ties, axis=1) - np.linalg.norm(ground.points(ground.chart.plane(ties)), axis=1)
    above = above[np.isfinite(above)]
    level = float(np.median(above))
    scatter = 1.4826 * float(np.median(np.abs(above - level)))
    terrain = None if ground.terrain is None else replace(ground.terrain, radii=ground.terrain.radii + level)
    sigma = max(ground.height_sigma, _SCATTERS * scatter)
    return replace(scene, ground=replace(ground, terrain=terrain, height=ground.height + level, height_sigma=sigma))


def averaged_pair(
    posterior: Posterior,
    matches: "DenseMatches",
    images: tuple[int, int],
    size: float,
    spacing: float,
    window: float,
    cells: bool = False,
) -> AveragedPair:
    """Matches of two images of a network, `spacing` m apart and made with windows of `window` m, averaged over
    footprints of `size` m, or over cells, which have to be covered as a whole.
    """
    # noise alone: by what relief a match is off along the disparity, means over windows and footprints are not
    variances = np.asarray(np.linalg.eigvalsh(matches.covariances)[:, 0], dtype=np.float64)
    pixel = _ground_pixel(posterior, images[0], matches.anchors.mean(axis=0))
    width = max(size / SPOT_WIDTHS, spacing)
    return AveragedPair(
        averaged_surface(
            matches.anchors, matches.pixels, variances, pixel, width, window, _CELL_SHARE if cells else LEAST_SHARE
        ),
        images,
        size,
    )
