"""Patches of images around the measures of tie points, on one grid of the ground for each point; their similarity.

A point's grid lies in the tangent plane at the point: rows go south, columns east, and a chip pixel is as large as a
pixel of the coarsest image that shows the point. An affine map from the nominal orientation takes chip pixels to the
image; its middle is the measure, so that a right match shows the same thing in the middle of all of its chips.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.body import east_north, ellipsoidal_heights
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.records import Array, Index, Mask, by_value
from mgsgraph.matching.scene import Pixels
from mgsgraph.names import grouped
from mgsgraph.network.observations import require_inside
from mgsgraph.workers import Count, no_progress

Pictures = Callable[[int], Pixels]
"""Pixels of an image by its number; asked for again and again, one image after the other."""

SIDE = 81
"""Chip pixels a side."""
REACH = 3
"""Chip pixels, how far around the measure a better match is looked for."""
_MOST_STEPS = 4
"""Places that a chip pixel is averaged of, each way, at the most."""
_AT_ONCE = 32
"""Pairs of chips that are correlated at a time: so few that they stay in the cache."""
_FLAT = 1e-10
"""Variance over mean square below which a chip has no texture."""
_LEAST_SHARE = 0.5
"""Of a chip's pixels that must lie in both images."""
_HIGHEST = 0.05
"""Heights beyond this share of the body's radius come from rays that hardly differ, and are taken for zero."""
_NEIGHBOURS, _LEAST_NEIGHBOURS = 16, 5
"""With which a point's misfit is compared."""


@dataclass(frozen=True, slots=True, eq=False)
class ChipFrames:
    """The grids of n tie points on the ground, and the images of these at k measures."""

    image: Index
    """(k,) number of each measure's image."""
    reference: Index
    """(n,) the first measure of each point, with which the others are compared; -1 of a point without any."""
    count: Index
    """(n,) measures of each point."""
    spacing: Array
    """(n,) m, size of a chip pixel; NaN where no ray of the point meets the body."""
    step: Array
    """(k, 2, 2) d(line, sample) / d(row, column) of the chip; NaN where a ray misses the body."""
    skew: Array
    """(n,) m, rms distance of the rays, nominal orientation, from the position nearest to them all; NaN for one ray."""

    @property
    def skew_pixels(self) -> Array:
        """(n,) the same in chip pixels."""
        return np.asarray(self.skew / self.spacing)


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """Similarity of the chips of k measures to those of their points' reference measures; NaN for these themselves, and
    where a chip has no texture, or half of it lies outside its image.
    """

    correlation: Array
    """(k,) normalised cross-correlation with both chips centred on their measures."""
    best: Array
    """(k,) the highest one within REACH chip pixels."""
    shift: Array
    """(k, 2) row, column in chip pixels from the measure to where that is, in the measure's own chip."""
    at_edge: Mask
    """(k,) True where it lies at the edge of the search: a better one may lie beyond."""

    def chosen(self, rows: Index) -> "Likeness":
        """Of some of the measures."""
        return Likeness(self.correlation[rows], self.best[rows], self.shift[rows], self.at_edge[rows])


# --- the grids


def chip_frames(images: Sequence[PushbroomImage], ties: TiePoints) -> ChipFrames:
    """Grids of all points on the ground, with the nominal orientation.

    Raises
    ------
    InputError
        If a measure is of an image that isn't among `images`, or lies outside it.
    """
    n, point = len(ties.ids), ties.measure_point
    image = _images_of(images, ties)
    origins, directions = np.empty((2, point.size, 3))
    for j, of_image in by_value(image):
        origins[of_image], directions[of_image] = images[j].sightlines(*ties.measures[of_image].T)
    positions, skew, _ = intersect_rays(origins, directions, point, n)
    heights = _heights(images, positions)
    to_ground = np.empty((point.size, 2, 2))
    for j, of_image in by_value(image):
        lines, samples = ties.measures[of_image].T
        ground, by_pixel = images[j].image_to_ground(lines, samples, heights[point[of_image]])
        to_ground[of_image] = east_north(ground) @ by_pixel
    size = np.sqrt(np.abs(np.linalg.det(to_ground)))
    spacing = np.full(n, -np.inf)
    np.fmax.at(spacing, point, size)
    spacing[~np.isfinite(spacing)] = np.nan
    return ChipFrames(image, _first_measures(point, n), np.bincount(point, minlength=n), spacing,
                      _steps(to_ground, spacing[point]), skew)


def _images_of(images: Sequence[PushbroomImage], ties: TiePoints) -> Index:
    """(k,) number of each measure's image; all of them are there, and hold their measures."""
    names = [image.name for image in images]
    image = ties.measure_image.over(names)
    for k in np.flatnonzero(image < 0)[:1].tolist():
        where, found = f"{ties.source}, point {ties.ids[int(ties.measure_point[k])]}", ties.measure_image[k]
        raise InputError(where, f"the image {found!r}", f"one of the case's images ({', '.join(names[:4])})")
    require_inside(images, image, ties.measures, ties.ids, ties.measure_point, ties.source)
    return image


def _heights(images: Sequence[PushbroomImage], positions: Array) -> Array:
    """(n,) m above the ellipsoid; zero where it isn't known, which the affine map hardly feels."""
    body = images[0].body
    finite = np.isfinite(positions[:, 0])
    heights = np.zeros(positions.shape[0])
    heights[finite] = ellipsoidal_heights(positions[finite], body)
    return np.where(np.abs(heights) < _HIGHEST * body.equatorial, heights, 0.0)


def _first_measures(point: Index, points: int) -> Index:
    first = np.full(points, -1, dtype=np.int64)
    numbers, where = np.unique(point, return_index=True)
    first[numbers] = where
    return first


def _steps(to_ground: Array, spacing: Array) -> Array:
    """(k, 2, 2) pixels of the image per chip pixel southward and eastward."""
    step = np.full_like(to_ground, np.nan)
    good = np.isfinite(spacing) & np.all(np.isfinite(to_ground), axis=(1, 2))
    good[good] = np.abs(np.linalg.det(to_ground[good])) > 0.0
    south_east = spacing[good, None, None] * np.array([[0.0, 1.0], [-1.0, 0.0]])
    step[good] = np.linalg.solve(to_ground[good], south_east)
    return step


def misfit_beside_neighbours(frames: ChipFrames, ties: TiePoints) -> Array:
    """(n,) chip pixels, each point's misfit of rays less the median of its nearest neighbours' in the same images: what
    is wrong with the orientation is much the same for all of them. NaN where there are fewer than five of these.
    """
    from scipy.spatial import cKDTree  # takes half a second

    misfit, excess = frames.skew_pixels, np.full(len(ties.ids), np.nan)
    for members in _of_same_images(frames, ties):
        finite = members[np.isfinite(misfit[members])]
        if finite.size > _LEAST_NEIGHBOURS:
            near = min(_NEIGHBOURS, finite.size - 1)
            pixels = ties.measures[frames.reference[finite]]
            beside = cKDTree(pixels).query(pixels, near + 1)[1]
            around = np.where(beside == np.arange(finite.size)[:, None], np.nan, misfit[finite][beside])
            around[~np.any(np.isnan(around), axis=1), -1] = np.nan  # of many at one pixel, itself isn't among them
            excess[finite] = misfit[finite] - np.nanmedian(around, axis=1)
    return excess


def _of_same_images(frames: ChipFrames, ties: TiePoints) -> list[Index]:
    """Points (m,) that were measured in the same images, for each set of these."""
    order = np.lexsort((frames.image, ties.measure_point))
    sets = np.split(frames.image[order], np.cumsum(frames.count)[:-1])
    groups = grouped((images.tobytes(), i) for i, images in enumerate(sets))
    return [np.array(members, dtype=np.int64) for members in groups.values()]


# --- the patches


def chips(pixels: Pixels, measures: Array, step: Array) -> Array:
    """Patches (m, SIDE, SIDE) of one image's grey values around some of its measures: bilinear; where a chip pixel
    covers several of the image's, their mean. NaN outside the image.

    `pixels` are the image's (lines, samples), `measures` (m, 2) line and sample, the first pixel's centre at (0.5,
    0.5); `step` (m, 2, 2) is d(line, sample) / d(row, column), as `ChipFrames` has it.
    """
    patches = np.full((measures.shape[0], SIDE, SIDE), np.nan)
    reach = np.linalg.norm(step, axis=1).max(axis=1)
    steps = np.clip(np.rint(np.nan_to_num(reach, nan=1.0)), 1, _MOST_STEPS).astype(int)
    for k in np.flatnonzero(np.isfinite(reach)):  # thousands of numbers each: arrays of all would only fill the memory
        patches[k] = _patch(pixels, measures[k], step[k], int(steps[k]))
    return patches


def _patch(pixels: Pixels, middle: Array, step: Array, steps: int) -> Array:
    """(SIDE, SIDE) grey values, each the mean of `steps` by `steps` positions in its chip pixel."""
    from scipy.ndimage import map_coordinates  # takes half a second

    grid = (np.arange(SIDE * steps) + 0.5) / steps - 0.5 * SIDE
    lines = middle[0] + step[0, 0] * grid[:, None] + step[0, 1] * grid
    samples = middle[1] + step[1, 0] * grid[:, None] + step[1, 1] * grid
    inside = (lines >= 0.0) & (lines <= pixels.shape[0]) & (samples >= 0.0) & (samples <= pixels.shape[1])
    grey = map_coordinates(pixels, [lines - 0.5, samples - 0.5], np.float64, order=1, mode="nearest")
    grey[~inside] = np.nan
    return np.asarray(grey.reshape(SIDE, steps, SIDE, steps).mean(axis=(1, 3)) if steps > 1 else grey)


def stretched(patches: Array, levels: int = 256) -> NDArray[np.uint8]:
    """Patches (m, a, b) as bytes, each from its darkest to its brightest hundredth; of so many grey `levels`, and black
    where there is none.
    """
    grey = np.zeros(patches.shape, dtype=np.uint8)
    for patch, drawn in zip(patches, grey, strict=True):
        finite = np.isfinite(patch)
        if np.any(finite):
            low, high = np.quantile(patch[finite], (0.01, 0.99))
            share = (patch[finite] - low) / (high - low) if high > low else np.full(finite.sum(), 0.5)
            drawn[finite] = np.rint(np.clip(share, 0.0, 1.0) * (levels - 1)) * (255.0 / (levels - 1))
    return grey


# --- their similarity


def likeness(
    pictures: Pictures,
    ties: TiePoints,
    frames: ChipFrames,
    points: Index | None = None,
    progress: Count = no_progress,
) -> Likeness:
    """Compare the chips of measures with those of their points' reference measures, of the points with numbers `points`
    (m,) or of all. `pictures` gives the pixels of an image by its number; `progress` is called with the number of pairs
    compared, and of all.
    """
    k = ties.measure_point.size
    result = Likeness(np.full(k, np.nan), np.full(k, np.nan), np.full((k, 2), np.nan), np.zeros(k, dtype=np.bool_))
    first = frames.reference[ties.measure_point]
    chosen = np.ones(k, dtype=np.bool_) if points is None else np.isin(ties.measure_point, points)
    compared = np.flatnonzero(chosen & (first != np.arange(k)))
    compared = compared[np.lexsort((frames.image[compared], frames.image[first[compared]]))]  # each picture few times
    pair = np.stack([frames.image[first[compared]], frames.image[compared]])
    cuts = np.flatnonzero(np.any(np.diff(pair, axis=1) != 0, axis=0)) + 1
    done = 0
    for group in np.split(compared, cuts) if compared.size else ():
        pixels = [pictures(int(frames.image[rows[0]])) for rows in (first[group], group)]
        for begin in range(0, group.size, _AT_ONCE):
            some = group[begin : begin + _AT_ONCE]
            two = [
                chips(grey, ties.measures[rows], frames.step[rows])
                for grey, rows in zip(pixels, (first[some], some), strict=True)
            ]
            result.correlation[some], result.best[some], result.shift[some], result.at_edge[some] = compare(*two)
            done += some.size
            progress(done, compared.size)
    return result


def compare(first: Array, second: Array) -> tuple[Array, Array, Array, Mask]:
    """Normalised cross-correlation of chips at shifts up to REACH.

    Parameters
    ----------
    first, second : (m, s, s)
        Grey values, NaN where there are none.

    Returns
    -------
    correlation : (m,)
        Without a shift.
    best : (m,)
        The highest one of all shifts.
    shift : (m, 2)
        row, column from the second chip's middle to where it shows what the first one shows in its middle, to fractions
        of a pixel (parabola through the neighbours) unless at the edge.
    at_edge : (m,)
        True where the highest one is at the edge of the search.
    """
    surface = _correlations(first, second)
    flat = np.where(np.isnan(surface), -np.inf, surface).reshape(len(surface), -1)
    index = np.stack(np.unravel_index(flat.argmax(axis=1), surface.shape[1:]), axis=1)
    best = flat.max(axis=1)
    finite = np.isfinite(best)
    at_edge = finite & np.any((index == 0) | (index == 2 * REACH), axis=1)
    shift = np.where(finite[:, None], index - REACH, np.nan)
    inner = np.flatnonzero(finite & ~at_edge)
    for axis, (up, right) in enumerate(((1, 0), (0, 1))):
        row, column = index[inner].T
        low, high = surface[inner, row - up, column - right], surface[inner, row + up, column + right]
        bend = low - 2.0 * best[inner] + high
        ways = bend < 0.0  # NaN neighbours leave the whole pixel
        shift[inner[ways], axis] += 0.5 * (low - high)[ways] / bend[ways]
    return surface[:, REACH, REACH], np.where(finite, best, np.nan), shift, at_edge


def _correlations(first: Array, second: Array) -> Array:
    """(m, 2 REACH + 1, 2 REACH + 1) normalised cross-correlation of the first chip's inner part with the second chip at
    all shifts; NaN where fewer than half of the pixels have grey values in both, or one has no texture. Sums over the
    pixels known in both, by Fourier transforms (Padfield 2012, Masked object registration, eqs. 20 to 23).
    """
    inner = np.zeros(first.shape[1:], dtype=np.bool_)
    inner[REACH:-REACH, REACH:-REACH] = True
    a, of_a, square_a = _moments(first, inner)
    b, of_b, square_b = _moments(second, np.ones_like(inner))
    whole = slice(None)
    shape = first.shape[1:]

    def sums(left: NDArray[np.complex128], right: NDArray[np.complex128]) -> Array:
        correlations = np.fft.irfft2(left.conj() * right, shape)
        near = np.arange(-REACH, REACH + 1)
        return np.asarray(correlations[whole, near[:, None], near])

    count = sums(a, b)
    enough = np.rint(count) >= max(_LEAST_SHARE * inner.sum(), 2.0)
    count = np.where(enough, count, np.nan)
    mean_a, mean_b = sums(of_a, b) / count, sums(a, of_b) / count
    variance_a, variance_b = sums(square_a, b) / count - mean_a**2, sums(a, square_b) / count - mean_b**2
    covariance = sums(of_a, of_b) / count - mean_a * mean_b
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations = covariance / np.sqrt(variance_a * variance_b)
    textured = (variance_a > _flatness(first)) & (variance_b > _flatness(second))
    return np.where(textured, np.clip(correlations, -1.0, 1.0), np.nan)


def _moments(patches: Array, where: Mask) -> tuple[NDArray[np.complex128], ...]:
    """Fourier transforms of the marks of known pixels, of the grey values less their mean, and of their squares."""
    finite = np.isfinite(patches) & where
    total = np.maximum(finite.sum(axis=(1, 2), keepdims=True), 1)
    grey = np.where(finite, patches, 0.0)
    grey = np.where(finite, grey - grey.sum(axis=(1, 2), keepdims=True) / total, 0.0)
    return tuple(np.fft.rfft2(part) for part in (finite.astype(np.float64), grey, grey**2))


def _flatness(patches: Array) -> Array:
    """(m, 1, 1) variance below which what is left is rounding."""
    square = np.where(np.isfinite(patches), patches, 0.0) ** 2
    return np.asarray(_FLAT * square.max(axis=(1, 2))[:, None, None] + np.finfo(np.float64).tiny)
