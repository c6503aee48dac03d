"""Dense matches of overlapping pictures whose orientations are adjusted: one near every post of a regular grid.

Both pictures are resampled to the ground grid, turned so that height displaces along its rows; there semi-global
matching says how high the ground is, to a pixel or so. From that every post is matched by least squares in the pictures
themselves, which are not resampled, and each match has a covariance.

One tile of dense matching: from two ortho patches to a match, in the pictures themselves, near each of its posts.

The tile's rows run along the parallax (see `dense`): what lies in column c of the first picture's patch lies in column
c - d of the second's, and d pixels of the tile are d * step / rate metres of height above the ground's model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs
from mgsgraph.geometry.terrain import between_nodes
from mgsgraph.matching.coarse import robust_sigma
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import match_least_squares
from mgsgraph.matching.measuring import FINEST, SharpPictures, half_window
from mgsgraph.matching.patches import MOST, NODE, Tile, disparities, node_pixels, opencv, ortho_patch, tiling
from mgsgraph.matching.scene import Ground, GroundChart, Pair, Picture, Scene, boxes, pairs_of
from mgsgraph.workers import Progress, no_progress

_SMOOTH = 9
"""pixels of the tile over which slopes are taken."""
_STEEPEST = 0.6
"""Change of the displacement per m: a window cannot follow ground that is foreshortened more."""
_REACH, _TOLERANCE = 2.5, 5e-3
"""pixels by which a match may leave its start, and of its last step but one."""
_LIMIT = 4.0
"""Robust standard deviations by which displacements may differ: across the parallax from zero, along it from those of
the neighbours."""
_ACROSS, _ALONG = 0.3, 1.0
"""pixels of the tile: lower bounds of these two limits."""
_AROUND = 2
"""Posts on each side that count as neighbours."""
_FEWEST = 6
"""Least number of neighbours with which a post is compared."""


HALF_WINDOW = 8
"""pixels of the ground grid from the middle of a window of least-squares matching to its edge."""
_LEAST_CORRELATION, _LARGEST_SIGMA = 0.5, 0.5
"""Of the two windows; and pixels, in any direction, beyond which a match isn't kept."""


class View(NamedTuple):
    """Two pictures over the ground, on a chart turned so that height displaces along x."""

    numbers: tuple[int, int]
    """Of the pictures in the scene."""
    pictures: tuple[Picture, Picture]
    """Their pixels and orientations."""
    ground: Ground
    """With the turned chart."""
    rate: float
    """m per m of height, displacement of the second picture's rays against the first's, towards larger x."""


class PostMatches(NamedTuple):
    """Matches of n posts."""

    anchors: Array
    """(n, 2) line and sample in the first picture, middles of pixels."""
    pixels: Array
    """(n, 2) line and sample in the second."""
    covariances: Array
    """(n, 2, 2) pixels^2 of the second, the anchor given."""
    correlation: Array
    """(n,)"""


class _Start(NamedTuple):
    """Pixels of n posts in both pictures, by semi-global matching."""

    row: Index
    """(n,) of the post, counted through the tile's posts."""
    column: Index
    """(n,) the same."""
    disparity: Array
    """(n,) pixels of the tile."""
    first: Array
    """(n, 2) line and sample."""
    second: Array
    """(n, 2) line and sample."""
    affine: Array
    """(n, 2, 2) d second / d first."""
    by_plane: Array
    """(n, 2, 2) d(line, sample) / d(x, y) of the second picture, pixels per m."""


def matches_on(
    view: View, splines: tuple[SplinePicture, SplinePicture], tile: Tile, reach: int, spacing: float, step: float,
    threads: int | None,
) -> tuple[int, PostMatches]:
    """Match the posts of a tile without its margin; their number on ground that both pictures show, and the matches.

    The tile is one of the view's chart, with a margin of `reach` pixels at least: by so many the true ground may
    displace one picture against the other. `splines` are both pictures between their pixels; `spacing` lies between
    posts, and `step` between pixels of the ground grid, in m.
    """
    first, second = (ortho_patch(picture, view.ground, tile) for picture in view.pictures)
    if first is None or second is None:
        return 0, no_matches()
    shift = disparities(first, second, reach)
    rows, columns = tile.nodes(spacing)
    plane = tile.plane(*all_pairs(columns, rows).astype(np.float64).T)
    row, column = (axis.ravel() for axis in np.meshgrid(np.arange(rows.size), np.arange(columns.size), indexing="ij"))
    both = (first.valid > 0) & (second.valid > 0)
    owned = tile.owns(plane) & both[rows[row], columns[column]]
    sought = owned & np.isfinite(shift[rows[row], columns[column]])
    start = _start(view, tile, shift, (row[sought], column[sought]), (rows, columns))
    return int(owned.sum()), _measured(view, splines, tile, start, step, threads)


def no_matches() -> PostMatches:
    """Matches of no posts."""
    return PostMatches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))


def _start(
    view: View, tile: Tile, shift: Array, post: tuple[Index, Index], pixels: tuple[Index, Index]
) -> _Start:
    """Posts by row and column, of which the tile's rows and columns are `pixels`."""
    down, across = pixels[0][post[0]], pixels[1][post[1]]
    disparity = shift[down, across]
    nodes = [node_pixels(picture, view.ground, tile) for picture in view.pictures]
    position = np.column_stack([down, across]).astype(np.float64)
    matched = position - np.column_stack([np.zeros(disparity.size), disparity])
    first, second = between_nodes(nodes[0], position / NODE), between_nodes(nodes[1], matched / NODE)
    by_plane = [_by_plane(lattice, at, tile.step) for lattice, at in zip(nodes, (position, matched), strict=True)]
    turn = np.zeros((disparity.size, 2, 2))
    slopes = np.clip([slope[down, across] for slope in _slopes(shift)], -_STEEPEST, _STEEPEST)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 1] = 1.0 - slopes[1], -slopes[0], 1.0
    affine = by_plane[1] @ turn @ np.linalg.inv(by_plane[0])
    good = np.isfinite(np.concatenate([first, second, affine.reshape(-1, 4)], axis=1)).all(axis=1)
    whole = _Start(post[0], post[1], disparity, first, second, affine, by_plane[1])
    return _Start(*(column[good] for column in whole))


def _by_plane(nodes: Array, at: Array, step: float) -> Array:
    """(n, 2, 2) d(line, sample) / d(x, y) in pixels per m there."""
    ways = 0.5 * NODE * np.eye(2)[::-1]
    moved = [between_nodes(nodes, (at + way) / NODE) - between_nodes(nodes, (at - way) / NODE) for way in ways]
    return np.stack(moved, axis=2) / (NODE * step)


def _slopes(shift: Array) -> tuple[Array, Array]:
    """Change of the disparity from row to row and from column to column, of its mean over a window."""
    cv2 = opencv()
    finite = np.isfinite(shift)
    size = (_SMOOTH, _SMOOTH)
    weight = cv2.blur(finite.astype(np.float64), size)
    mean = cv2.blur(np.where(finite, shift, 0.0), size) / np.maximum(weight, 1e-9)
    down, across = np.gradient(mean)
    return down, across


def _measured(
    view: View, splines: tuple[SplinePicture, SplinePicture], tile: Tile, start: _Start, step: float,
    threads: int | None,
) -> PostMatches:
    anchors = np.floor(start.first) + 0.5
    begin = start.second + np.einsum("nij,nj->ni", start.affine, anchors - start.first)
    half = half_window(view.ground, view.pictures[0], HALF_WINDOW * step)
    matches = match_least_squares(
        *splines, anchors, begin, start.affine, half, reach=_REACH, tolerance=_TOLERANCE, threads=threads
    )
    along = -start.by_plane[:, :, 0]
    covariances = matches.covariance_with_relief(along) + FINEST**2 * np.eye(2)
    moved = np.full(begin.shape, np.nan)
    good = np.flatnonzero(matches.converged)
    moved[good] = np.linalg.solve(start.by_plane[good], (matches.pixels - begin)[good, :, None])[:, :, 0] / tile.step
    sigma = np.sqrt(np.linalg.eigvalsh(covariances[good])[:, 1])
    sound = np.zeros(matches.status.size, dtype=bool)
    sound[good] = (matches.correlation[good] >= _LEAST_CORRELATION) & (sigma <= _LARGEST_SIGMA)
    fits = sound & _coplanar(moved[:, 1], sound)
    fits &= _like_neighbours(start, start.disparity - moved[:, 0], fits)
    return PostMatches(anchors[fits], matches.pixels[fits], covariances[fits], matches.correlation[fits])


def _coplanar(across: Array, sound: Mask) -> Mask:
    """(n,) whether both rays meet: displacements across the parallax, pixels of the tile, are as the others'."""
    if not sound.any():
        return sound
    middle = np.median(across[sound])
    limit = max(_LIMIT * robust_sigma(across[sound]), _ACROSS)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(across - middle) <= limit)


def _like_neighbours(start: _Start, disparity: Array, sound: Mask) -> Mask:
    """(n,) whether the disparity is that of the posts around, nearly."""
    if not sound.any():
        return sound
    shape = start.row.max() + 1 + 2 * _AROUND, start.column.max() + 1 + 2 * _AROUND
    grid = np.full(shape, np.nan)
    row, column = start.row + _AROUND, start.column + _AROUND
    grid[row[sound], column[sound]] = disparity[sound]
    ways = [way for way in np.ndindex(2 * _AROUND + 1, 2 * _AROUND + 1) if way != (_AROUND, _AROUND)]
    beside = np.stack([grid[row + i - _AROUND, column + j - _AROUND] for i, j in ways], axis=1)
    count = np.isfinite(beside).sum(axis=1)
    several = sound & (count >= _FEWEST)
    off = np.full(disparity.size, np.inf)
    off[several] = np.abs(disparity[several] - np.nanmedian(beside[several], axis=1))
    limit = max(_LIMIT * robust_sigma(off[several]), _ALONG)
    return np.asarray(off <= limit)


# --- pairs of pictures


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
    spacing: float | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> tuple[DenseMatches, ...]:
    """Match all pairs of pictures that share ground and see it from different sides.

    Parameters
    ----------
    scene : Scene
        Pictures with adjusted orientations (`Picture.correction`), over one ground.
    spacing : float, optional
        m between posts; five pixels of the ground grid when absent.
    workers : int, optional
        Threads; as many as there are processors when absent.
    progress : callable, optional
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        Where pictures are blank or saturated, none overlap, all look from the same side, or nothing matches.
    """
    require(spacing is None or 0.0 < spacing < np.inf, "dense matching, spacing", f"{spacing}", "a positive number")
    step = scene.step
    spacing = spacing or _SPACING * step
    sharp = SharpPictures(scene.pictures)
    scene.require_contrast()
    extents = boxes(scene)
    views = [view for pair in pairs_of(scene) if (view := _view(scene, pair, extents)) is not None]
    found, remedy = "they look at the ground from the same side", "rays that are all but parallel tell no height"
    require(views, scene.where, found, "a stereo pair", remedy)
    work = [(view, _tiles(view, step)) for view in views]
    done, most = 0, sum(len(tiles) for _, tiles in work)
    progress("dense matching", 0, most)
    results = list[DenseMatches]()
    for view, tiles in work:
        posts, parts = 0, [no_matches()]
        first, second = (sharp[j].spline for j in view.numbers)
        for tile in tiles:
            reach = _reach(view, tile.step)
            count, matched = matches_on(view, (first, second), tile, reach, spacing, step, workers)
            posts, done = posts + count, done + 1
            parts.append(matched)
            progress("dense matching", done, most)
        matches = PostMatches(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        results.append(DenseMatches(*view.numbers, spacing, posts, *matches))
    if not any(result.pixels.size for result in results):
        raise InputError(
            scene.where, f"none of {sum(result.posts for result in results)} posts matches",
            "images that look alike, with adjusted orientations", "is the solution that of these images?",
        )  # fmt: skip
    return tuple(result for result in results if result.pixels.size)


def _view(scene: Scene, pair: Pair, extents: Sequence[Array]) -> View | None:
    """A pair, the finer picture first; None where the two look from the same side. `extents` has the `boxes` of all."""
    areas = scene.pixel_sizes ** 2
    i, j = pair[:2] if areas[pair.first] <= _FINER * areas[pair.second] else pair[1::-1]
    finer, coarser = scene.pictures[i], scene.pictures[j]
    low, high = np.maximum(extents[i][0], extents[j][0]), np.minimum(extents[i][1], extents[j][1])
    points = scene.ground.points(0.5 * (low + high)[None])
    first, second = (picture.height_parallax(scene.ground, picture.project(points))[0] for picture in (finer, coarser))
    parallax = second - first
    rate = float(np.hypot(*parallax))
    if not rate > _LEAST_PARALLAX:
        return None
    chart = GroundChart.about(points, np.cross(points[0], (parallax / rate) @ scene.ground.chart.axes[:2]))
    ground = replace(scene.ground, chart=chart)
    return View((i, j), (finer, coarser), ground, rate)


def _reach(view: View, step: float) -> int:
    """By how many pixels of a grid the true ground may displace the second picture against the first."""
    return max(int(np.ceil(_SIGMAS * view.ground.height_sigma * view.rate / step)), _LEAST_REACH)


def _tiles(view: View, step: float) -> list[Tile]:
    """Tiles on the ground that both show, of a grid that is coarser than the ground grid, the more the wider the search
    is.
    """
    coarse = max(_COARSER, _reach(view, step) / MOST) * step
    return tiling(boxes(Scene(view.pictures, view.ground)), coarse, (_reach(view, coarse) + _MARGIN) * coarse)
