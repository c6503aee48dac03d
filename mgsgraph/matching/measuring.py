"""Tracks measured by least-squares matching: from one image's pixel into each of the other images, and back."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import LeastSquaresMatches, match_least_squares
from mgsgraph.matching.patches import Links, opencv
from mgsgraph.matching.scene import Ground, Picture, Scene, by_pair, star
from mgsgraph.matching.settings import MatchSettings

_READY = 8
"""Pictures that stay prepared."""
_BLUR, _CORNER = 1.0, 5
"""pixels: sigma of the filter before corners are measured, and the side of the square over which they are."""
FINEST = 0.01
"""pixels, sigma that no match is better than: pictures are rounded, and one picture given twice has no noise."""
_LEAST_PARALLAX = 1e-3
"""pixels per m of height below which two views see no relief."""
_WAY_BACK = 3.0
"""Sigmas by which matching back may miss the pixel that a match began at."""
_WAY_BACK_PIXELS = 0.1
"""pixels that are added to this limit."""


class Sharp(NamedTuple):
    """A picture prepared for measuring."""

    spline: SplinePicture
    """Grey values between pixels."""
    strength: NDArray[np.float32]
    """(lines, samples) how well each pixel's surroundings tell both directions."""


class SharpPictures:
    """Pictures prepared when they are asked for; some of them stay in memory, for each takes nine bytes a pixel."""

    def __init__(self, pictures: Sequence[Picture]) -> None:
        self._pictures = pictures
        self._ready = dict[int, Sharp]()

    def __getitem__(self, number: int) -> Sharp:
        ready = self._ready.pop(number, None) or sharpened(self._pictures[number])
        self._ready[number] = ready
        if len(self._ready) > _READY:
            del self._ready[next(iter(self._ready))]
        return ready


class Measured(NamedTuple):
    """Pixels found in other pictures from those of one picture, the anchors; k of them."""

    track: Index
    """(k,) which track each belongs to."""
    first: Index
    """(k,) picture of the anchor."""
    other: Index
    """(k,) picture of the pixel that was found."""
    feature: Index
    """(k,) feature from which the search began in the other picture."""
    anchors: Array
    """(k, 2) line and sample, the middle of a pixel."""
    pixels: Array
    """(k, 2) line and sample."""
    affine: Array
    """(k, 2, 2) d pixel / d anchor."""
    covariances: Array
    """(k, 2, 2) pixels^2 of the pixel found, given the anchor."""
    correlation: Array
    """(k,)"""
    status: Index
    """(k,) MatchStatus of the way there."""
    returns: Mask
    """(k,) the way back ended where it should."""

    def some(self, chosen: Mask | Index) -> "Measured":
        """Some of them."""
        return Measured(*(column[chosen] for column in self))  # type: ignore[arg-type]

    @property
    def sigmas(self) -> Array:
        """(k,) pixels, in the direction where it is largest."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.covariances)[:, 1]))


def joined_measures(parts: Sequence[Measured]) -> Measured:
    """Several records as one."""
    return Measured(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def measured(
    scene: Scene, links: Links, tracks: Sequence[list[int]], sharp: SharpPictures, settings: MatchSettings, step: float
) -> Measured:
    """Measure tracks of features, `links`, from the sharpest pixel near their first feature into their other pictures,
    whose orientations agree; `step` in m is the pixel of the ground grid.
    """
    track, first, other = star(tracks)
    parts = [_empty()]
    for i, j, of_pair in by_pair(links.picture[first], links.picture[other]):
        chosen = track[of_pair], first[of_pair], other[of_pair]
        parts.append(_between(scene, links, chosen, (i, j), sharp, settings, step))
    whole = joined_measures(parts)
    return whole.some(np.lexsort([whole.other, whole.track]))


def _between(
    scene: Scene,
    links: Links,
    chosen: tuple[Index, Index, Index],
    pair: tuple[int, int],
    sharp: SharpPictures,
    settings: MatchSettings,
    step: float,
) -> Measured:
    """Measure tracks from one picture into one other."""
    (track, first, other), (template, search) = chosen, (sharp[j] for j in pair)
    left, right = (scene.pictures[j] for j in pair)
    halves = [half_window(scene.ground, scene.pictures[j], settings.half_window * step) for j in pair]
    planes = links.plane[first], links.plane[other]
    begin, end = left.project(scene.ground.points(planes[0])), right.project(scene.ground.points(planes[1]))
    by_plane = left.derivatives(scene.ground, planes[0]), right.derivatives(scene.ground, planes[1])
    affine = np.linalg.solve(by_plane[0].mT, by_plane[1].mT).mT
    anchors = sharpest_pixels(template.strength, np.floor(begin).astype(np.int64), halves[0]) + 0.5
    start = end + np.einsum("nij,nj->ni", affine, anchors - begin)
    parallax = right.height_parallax(scene.ground, start) - left.height_parallax(scene.ground, anchors)
    relief = [_relief(by, away) for by, away in zip(by_plane, (-parallax, parallax), strict=True)]
    forth = match_least_squares(template.spline, search.spline, anchors, start, affine, halves[0], relief[1])
    good = np.flatnonzero(forth.converged)
    back = np.zeros(track.size, dtype=bool)
    back[good] = _returns(forth, good, anchors, (search.spline, template.spline), halves[1], relief[0])
    covariances = forth.covariance if relief[1] is None else forth.covariance_with_relief(relief[1])
    return Measured(
        track, np.full(track.size, pair[0]), np.full(track.size, pair[1]), other, anchors, forth.pixels, forth.affine,
        covariances + FINEST**2 * np.eye(2), forth.correlation, np.asarray(forth.status, dtype=np.int64), back,
    )  # fmt: skip


def _relief(by_plane: Array, parallax: Array) -> Array | None:
    """(n, 2) pixels per m of height, where the two views differ enough for relief to be seen."""
    direction = np.einsum("nij,nj->ni", by_plane, parallax)
    size = np.linalg.norm(direction, axis=1)
    return direction if size.size and float(size.min()) > _LEAST_PARALLAX else None


def sharpened(picture: Picture) -> Sharp:
    """A picture prepared: its spline, and Shi & Tomasi's measure of corners (1994), which is Foerstner's (1987) too."""
    cv2 = opencv()
    spline = SplinePicture.of(picture.pixels, f"picture of {picture.image.name}")
    grey = np.nan_to_num(np.asarray(picture.pixels, dtype=np.float32))
    return Sharp(spline, cv2.cornerMinEigenVal(cv2.GaussianBlur(grey, (0, 0), _BLUR), _CORNER))


def sharpest_pixels(strength: NDArray[np.float32], pixels: Index, half: tuple[int, int]) -> Array:
    """(n, 2) the pixel where the picture is sharpest within half a window of each pixel (n, 2), counted from zero.

    A feature's middle is often where nothing is: of a crater, its floor. What is matched there is the rim's height.
    """
    best, chosen = np.full(len(pixels), -1.0, dtype=np.float32), pixels.copy()
    last = np.array(strength.shape) - 1
    for down in range(-(half[0] // 2), half[0] // 2 + 1):
        for across in range(-(half[1] // 2), half[1] // 2 + 1):
            beside = np.clip(pixels + np.array([down, across]), 0, last)
            values = strength[beside[:, 0], beside[:, 1]]
            better = values > best
            best[better], chosen[better] = values[better], beside[better]
    return chosen.astype(np.float64)


def _returns(
    forward: LeastSquaresMatches, good: Index, anchors: Array, pictures: tuple[SplinePicture, SplinePicture],
    half: tuple[int, int], relief: Array | None,
) -> Mask:
    """Whether matching from the nearest pixel of the other picture ends where the way there says it should."""
    inverse = np.linalg.inv(forward.affine[good])
    begin = np.floor(forward.pixels[good]) + 0.5
    expected = anchors[good] + np.einsum("nij,nj->ni", inverse, begin - forward.pixels[good])
    backward = match_least_squares(*pictures, begin, expected, inverse, half, None if relief is None else relief[good])
    away = np.linalg.norm(backward.pixels - expected, axis=1)
    sigma = np.sqrt(np.trace(backward.covariance, axis1=1, axis2=2))
    return np.asarray((backward.converged) & (away <= _WAY_BACK * sigma + _WAY_BACK_PIXELS))


def half_window(ground: Ground, picture: Picture, size: float) -> tuple[int, int]:
    """Lines and samples from the middle of a window to its edge, `size` m on the ground either way."""
    by_pixel = np.linalg.norm(picture.pixel_on_ground(ground), axis=0)
    lines, samples = np.maximum(np.rint(size / by_pixel), 3).astype(int)
    return int(lines), int(samples)


def _empty() -> Measured:
    whole, real = no_rows(), np.zeros(0)
    pairs, matrices = np.zeros((0, 2)), np.zeros((0, 2, 2))
    return Measured(
        whole, whole, whole, whole, pairs, pairs, matrices, matrices, real, whole, np.zeros(0, dtype=bool)
    )
