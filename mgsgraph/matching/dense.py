"""Dense matches of overlapping pictures whose orientations are adjusted: one near every post of a regular grid.

Both pictures are resampled to the ground grid, turned so that height displaces along its rows; there semi-global
matching says how high the ground is, to a pixel or so. From that every post is matched by least squares in the pictures
themselves, which are not resampled, and each match has a covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.matching.measuring import SharpPictures
from mgsgraph.matching.pairs import Pair, boxes, pairs_of
from mgsgraph.matching.patches import MOST, Tile
from mgsgraph.matching.posts import DenseSettings, PostMatches, View, matches_on, no_matches
from mgsgraph.matching.scene import GroundChart, Scene
from mgsgraph.matching.tiles import tiling
from mgsgraph.progress import Progress, no_progress

_SPACING = 5.0
"""pixels of the ground grid between posts."""
_COARSER = 2.0
"""How much coarser than the ground grid pictures are compared first."""
_SIGMAS = 3.0
"""Standard deviations of the ground's height about its model within which the parallax is sought."""
_LEAST_REACH = 16
"""pixels to each side within which the parallax is sought at least."""
_MARGIN = 32
"""pixels more that neighbouring tiles share: semi-global matching looks at what is around."""
_LEAST_PARALLAX = 0.02
"""m per m of height: rays that are closer to parallel tell no height."""
_FINER = 2.0
"""How much smaller a pixel's area has to be to count as finer."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMatches:
    """Matches of one pair of pictures."""

    first: int
    """Picture in the scene whose pixels are looked for in the other: the finer one."""
    second: int
    """The other."""
    spacing: float
    """m between posts."""
    posts: int
    """Posts on ground that both show, matched or not."""
    anchors: Array
    """(n, 2) line and sample in the first picture, middles of pixels (k + 0.5)."""
    pixels: Array
    """(n, 2) line and sample in the second."""
    covariances: Array
    """(n, 2, 2) pixels^2 of the second, the anchor given."""
    correlation: Array
    """(n,) of the two windows."""


def dense_matches(
    scene: Scene,
    settings: DenseSettings | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> tuple[DenseMatches, ...]:
    """Match all pairs of pictures that share ground and see it from different sides.

    Parameters
    ----------
    scene : Scene
        Pictures with adjusted orientations (`Picture.correction`), over one ground.
    settings : DenseSettings, optional
        Choices.
    workers : int, optional
        Threads; as many as there are processors when absent.
    progress : callable, optional
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        Where pictures are blank or saturated, none overlap, all look from the same side, or nothing matches.
    """
    settings = settings or DenseSettings()
    step = scene.step
    spacing = settings.spacing or _SPACING * step
    sharp = SharpPictures(scene.pictures)
    scene.require_contrast()
    shown = boxes(scene)
    views = [view for pair in pairs_of(scene) if (view := _view(scene, pair, shown)) is not None]
    if not views:
        found, remedy = "they look at the ground from the same side", "rays that are all but parallel tell no height"
        raise InputError(scene.where, found, "a stereo pair", remedy)
    work = [(view, _tiles(view, step)) for view in views]
    done, most = 0, sum(len(tiles) for _, tiles in work)
    progress("dense matching", 0, most)
    results = list[DenseMatches]()
    for view, tiles in work:
        posts, parts = 0, [no_matches()]
        first, second = (sharp[j].spline for j in view.numbers)
        for tile in tiles:
            reach = _reach(view, tile.step)
            count, matched = matches_on(view, (first, second), tile, reach, spacing, settings, step, workers)
            posts, done = posts + count, done + 1
            parts.append(matched)
            progress("dense matching", done, most)
        matches = PostMatches(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        results.append(DenseMatches(*view.numbers, spacing, posts, *matches))
    if not any(one.pixels.size for one in results):
        raise InputError(
            scene.where, f"none of {sum(one.posts for one in results)} posts matches",
            "images that look alike, with adjusted orientations", "is the solution that of these images?",
        )  # fmt: skip
    return tuple(one for one in results if one.pixels.size)


def _view(scene: Scene, pair: Pair, shown: Sequence[Array]) -> View | None:
    """A pair, the finer picture first; None where the two look from the same side. `shown` has the `boxes` of all."""
    areas = scene.pixel_sizes ** 2
    i, j = pair[:2] if areas[pair.first] <= _FINER * areas[pair.second] else pair[1::-1]
    one, two = scene.pictures[i], scene.pictures[j]
    low, high = np.maximum(shown[i][0], shown[j][0]), np.minimum(shown[i][1], shown[j][1])
    points = scene.ground.points(0.5 * (low + high)[None])
    first, second = (picture.height_parallax(scene.ground, picture.project(points))[0] for picture in (one, two))
    apart = second - first
    rate = float(np.hypot(*apart))
    if not rate > _LEAST_PARALLAX:
        return None
    chart = GroundChart.about(points, np.cross(points[0], (apart / rate) @ scene.ground.chart.axes[:2]))
    ground = replace(scene.ground, chart=chart)
    return View((i, j), (one, two), ground, rate)


def _reach(view: View, step: float) -> int:
    """By how many pixels of a grid the true ground may displace the second picture against the first."""
    return max(int(np.ceil(_SIGMAS * view.ground.height_sigma * view.rate / step)), _LEAST_REACH)


def _tiles(view: View, step: float) -> list[Tile]:
    """Tiles on the ground that both show, of a grid that is coarser than the ground grid, the more the wider the search
    is.
    """
    coarse = max(_COARSER, _reach(view, step) / MOST) * step
    return tiling(boxes(Scene(view.pictures, view.ground)), coarse, (_reach(view, coarse) + _MARGIN) * coarse)
