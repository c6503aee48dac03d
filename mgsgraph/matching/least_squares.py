"""Least-squares matching: sub-pixel positions of template windows in another picture, with consistent covariances.

Ackermann, F. (1984): Digital image correlation, Photogrammetric Record 11(64). Gruen, A. (1985): Adaptive least squares
correlation, S. Afr. J. Photogrammetry 14(3). How this differs from theirs, and why, stands in `window`.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, Index, Mask, frozen
from mgsgraph.matching import equations, window
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.record import Record

_SMALLEST = 3
"""Half a window, pixels: fewer do not tell eight unknowns and their covariance."""
_NARROW = 0.5
"""Part of the weights' reach within which the middle of a window lies."""
_CHANCE = 6.0
"""Square of a bend in its sigmas that noise alone exceeds once in twenty (chi square, two degrees of freedom)."""
_TAIL = 0.01
"""Share of the largest residuals, mismatches among them, that don't count for the roughness of the ground."""
_PIECE = 64
"""Matches that a thread takes at once."""
ITERATIONS = 30
"""At most."""
SATURATED = 0.05
"""Part of a window's pixels that may be saturated."""
EMPHASIS = 0.5
"""Standard deviation of the pixels' Gaussian weights about the anchor, in units of half the window. Smaller: less of
the relief that the affine model does not follow, more noise."""


class MatchStatus(IntEnum):
    """How a match ended."""

    CONVERGED = window.CONVERGED
    """Found."""
    LEFT = window.LEFT
    """A part of its window lies outside one of the pictures, or where that has no grey values."""
    NOT_CONVERGED = window.UNFINISHED
    """It still moved after the last iteration."""
    WANDERED = window.WANDERED
    """It went farther from its start, or became larger or smaller, than it may."""
    FLAT = window.FLAT
    """No texture, or none that tells both directions."""
    SATURATED = window.SATURATED
    """Too many pixels at an end of the grey scale."""


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresMatches(Record):
    """Result of each match; numbers are NaN where it has not converged.

    Examples
    --------
    >>> from mgsgraph.matching.least_squares import match_least_squares
    >>> from mgsgraph.matching.equations import SplinePicture
    >>> picture = SplinePicture.of(np.random.default_rng(1).normal(128.0, 30.0, (60, 60)))
    >>> found = match_least_squares(picture, picture, [[30.5, 30.5]], [[30.5, 30.5]], np.eye(2)[None], (10, 10))
    >>> found.converged, found.pixels.round(3), found.correlation.round(3)
    (array([ True]), array([[30.5, 30.5]]), array([1.]))
    """

    status: Index
    """(n,) MatchStatus."""
    pixels: Array
    """(n, 2) line and sample in the search picture, first pixel's centre at (0.5, 0.5)."""
    affine: Array
    """(n, 2, 2) pixels of the search picture per pixel of the template, both as line, sample."""
    gain: Array
    """(n,) grey values of the template per grey value of the search picture."""
    offset: Array
    """(n,) grey values of the template."""
    correlation: Array
    """(n,) of the template with the resampled search window."""
    residual: Array
    """(n,) grey values of the template, weighted rms, by the degrees of freedom."""
    noise: Array
    """(n, 2, 2) px^2 of the position, the anchor being given, but for relief that the model doesn't follow."""
    bend: Array
    """(n, 2) px by which the position would move if the middle of the window alone counted."""
    bend_noise: Array
    """(n, 2, 2) px^2 of the bend, if it is nothing but noise."""
    misfit: Array
    """(n, 3, 4) Normal equations, the last column their right side: of squared residuals in the middle of a window over
    squares of derivatives. Their solution (3,) is the covariance px^2 by which pixels are displaced beside the model:
    of line, of both, of sample.
    """
    growth: float
    """By what the square of a bend is grown to that of what the whole window misses of a parabola, which it does not
    where its ground may be curved: too much then."""

    @property
    def converged(self) -> Mask:
        """(n,) Whether a match was found."""
        return np.asarray(self.status == MatchStatus.CONVERGED)

    @property
    def covariance(self) -> Array:
        """(n, 2, 2) px^2 of the position, the anchor being given: noise, and of each match what its own bend has above
        its noise. For matches of one kind of ground `covariance_with_relief` knows more.
        """
        (a, b), (c, d) = np.moveaxis(self.bend_noise, 0, -1)
        sound = a * d - b * c > 0.0
        inverse = np.linalg.inv(np.where(sound[:, None, None], self.bend_noise, np.eye(2)))
        square = np.einsum("ni,nij,nj->n", self.bend, inverse, self.bend)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(sound, self.growth * np.fmax(0.0, 1.0 - _CHANCE / square), 0.0)
        return np.asarray(self.noise + part[:, None, None] * self.bend[:, :, None] * self.bend[:, None, :])

    def covariance_with_relief(self, directions: ArrayLike) -> Array:
        """(n, 2, 2) px^2: noise, and along the direction (n, 2) in which height displaces the roughness of the ground.

        A position is that of its window's ground, smoothed; the anchor's own differs by what relief displaces one pixel
        beside the model. That shows in residuals: they are larger where grey values change along the direction. It is
        one number for all matches, since one window says little.

        Raises
        ------
        InputError
            If there are more or fewer directions than matches, or one has no length.
        """
        unit = _directions(directions, self.status.size, "covariance with relief")
        good = np.flatnonzero(self.converged)
        if not good.size:
            return self.noise
        residual = self.residual[good]
        usual = residual <= np.quantile(residual, 1.0 - _TAIL, method="higher")
        normal = self.misfit[good[usual]].sum(axis=0)
        (line, both, sample), *_ = np.linalg.lstsq(normal[:, :3], normal[:, 3])
        common = line * unit[:, 0] ** 2 + 2.0 * both * unit[:, 0] * unit[:, 1] + sample * unit[:, 1] ** 2
        return np.asarray(self.noise + np.fmax(common, 0.0)[:, None, None] * unit[:, :, None] * unit[:, None, :])


def match_least_squares(
    template: SplinePicture,
    search: SplinePicture,
    anchors: ArrayLike,
    pixels: ArrayLike,
    affine: ArrayLike,
    half: tuple[int, int],
    relief: ArrayLike | None = None,
    reach: float = 4.0,
    tolerance: float = 1e-3,
    threads: int | None = None,
) -> LeastSquaresMatches:
    """Match windows of the template picture: template(anchor + d) = gain search(position + A d) + offset.

    The result does not depend on the number of threads, nor does a match on the others.

    Parameters
    ----------
    template, search : SplinePicture
        The pictures.
    anchors : (n, 2)
        line, sample in the template picture, centres of pixels (k + 0.5).
    pixels : (n, 2)
        line, sample in the search picture to start from, good to some 2 px.
    affine : (n, 2, 2)
        A to start from, good to some 10 %.
    half : (2,)
        lines and samples of a window on each side of its anchor's: (10, 15) is 21 x 31 pixels.
    relief : (n, 2), optional
        direction in the search picture in which height displaces, of any length: the window's ground may be curved.
    reach : float, optional
        pixels by which a match may leave its start.
    tolerance : float, optional
        pixels: a step that moves the position less, and the corners less than ten times that, is the last but one.
    threads : int, optional
        All processors when left out.

    Raises
    ------
    InputError
        If arrays differ in length or hold NaN, an anchor is no centre of a pixel, an A has no inverse, a direction no
        length, or the window is smaller than 7 x 7.

    Examples
    --------
    >>> from mgsgraph.matching.least_squares import match_least_squares
    >>> from mgsgraph.matching.equations import SplinePicture
    >>> line, sample = np.mgrid[:60, :60]
    >>> def waves(x, y):
    ...     return SplinePicture.of(128.0 + 40.0 * np.sin(0.4 * x + 0.2 * y) + 30.0 * np.cos(0.1 * x - 0.5 * y))
    >>> first, second = waves(line, sample), waves(line + 0.4, sample - 0.7)
    >>> found = match_least_squares(first, second, [[30.5, 30.5]], [[30.5, 30.5]], np.eye(2)[None], (10, 10))
    >>> found.pixels.round(2)
    array([[30.1, 31.2]])
    """
    where = "least-squares matching"
    anchors = frozen(anchors, f"{where}, anchors", (None, 2))
    n = anchors.shape[0]
    pixels, affine = frozen(pixels, f"{where}, pixels", (n, 2)), frozen(affine, f"{where}, affine", (n, 2, 2))
    _require_centres(anchors, where)
    _require_windows(affine, half, where)
    weights, growth = _weights(half)
    directions = np.zeros((n, 0)) if relief is None else _directions(relief, n, f"{where}, relief")
    starts = np.concatenate([pixels, affine.reshape(n, 4), directions], axis=1)
    rows, states = np.full((n, equations.NUMBERS), np.nan), np.empty(n, dtype=np.int64)

    def match(first: int) -> None:
        part = slice(first, first + _PIECE)
        window.match_windows(
            template.coefficients, template.marks, search.coefficients, search.marks, anchors[part], starts[part],
            (int(half[0]), int(half[1])), weights, ITERATIONS, tolerance, reach, SATURATED,
            rows[part], states[part],
        )  # fmt: skip

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        for _ in pool.map(match, range(0, n, _PIECE)):
            pass
    return _matches(rows, states, growth)


def _directions(directions: ArrayLike, n: int, where: str) -> Array:
    """(n, 2) of length one."""
    given = frozen(directions, where, (n, 2))
    length = np.linalg.norm(given, axis=1)
    for k in np.flatnonzero(length <= 0.0)[:1]:
        raise InputError(f"{where} {k}", "no direction", "that in which height displaces")
    return np.asarray(given / length[:, None])


def _require_centres(anchors: Array, where: str) -> None:
    """Raise InputError for an anchor beside the centre of a pixel: the template is not interpolated."""
    off = np.flatnonzero(np.any(np.abs(anchors - np.floor(anchors) - 0.5) > 1e-6, axis=1))
    for k in off[:1]:
        raise InputError(f"{where}, anchor {k}", f"{anchors[k].tolist()}", "the centre of a pixel (k + 0.5)")


def _require_windows(affine: Array, half: tuple[int, int], where: str) -> None:
    """Raise InputError for an A without an inverse, or a window that is too small."""
    require(min(half) >= _SMALLEST, f"{where}, half window", f"{half}", f"at least {_SMALLEST} lines and samples")
    scale = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
    for k in np.flatnonzero(np.abs(scale) < 1e-6)[:1]:
        raise InputError(f"{where}, affine {k}", f"{affine[k].tolist()}", "a matrix with an inverse")


def _weights(half: tuple[int, int]) -> tuple[Array, float]:
    """Weights (n, 2) of a window's pixels, and of the same sum those that count its middle alone; by what the square of
    a bend, the difference of both, is grown to that of what the first misses of a parabola.
    """
    down, across = (np.arange(-size, size + 1) / size for size in half)
    square = np.add.outer(down * down, across * across).ravel()
    weights = np.exp(-0.5 * square[:, None] / (EMPHASIS * np.array([1.0, _NARROW])) ** 2)
    weights[:, 1] *= weights[:, 0].sum() / weights[:, 1].sum()
    wide, narrow = (square @ weights) / weights.sum(axis=0)
    return weights, float((wide / (wide - narrow)) ** 2)


def _matches(rows: Array, status: Index, growth: float) -> LeastSquaresMatches:
    rows.flags.writeable = status.flags.writeable = False
    n = status.size
    return LeastSquaresMatches(
        status=status,
        pixels=rows[:, equations.POSITION : equations.AFFINE],
        affine=rows[:, equations.AFFINE : equations.GAIN].reshape(n, 2, 2),
        gain=rows[:, equations.GAIN],
        offset=rows[:, equations.OFFSET],
        correlation=rows[:, equations.CORRELATION],
        residual=rows[:, equations.RESIDUAL],
        noise=rows[:, equations.NOISE : equations.BEND].reshape(n, 2, 2),
        bend=rows[:, equations.BEND : equations.OF_BEND],
        bend_noise=rows[:, equations.OF_BEND : equations.MISFIT].reshape(n, 2, 2),
        misfit=rows[:, equations.MISFIT : equations.NUMBERS].reshape(n, 3, 4),
        growth=growth,
    )
