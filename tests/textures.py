"""Pictures of textures whose place between pixels is known exactly, for least-squares matching."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import LeastSquaresMatches, match_least_squares

Array = NDArray[np.float64]

SIZE, MIDDLE = 400, 200.0
AFFINE = np.array([[1.08, 0.04], [-0.05, 0.93]])
GAIN, OFFSET = 1.25, -20.0
HALF = (8, 10)
SAME = np.eye(2)
ALONG = np.array([0.6, 0.8])
"""A direction in which height displaces."""
HONEST = 1.2**2
"""Squared factor by which sigmas and true errors may differ; the rest is the scatter of so many windows."""


def texture(seed: int, line: Array, sample: Array, contrast: float = 15.0, shortest: float = 3.0) -> Array:
    """Grey values at any place: plane waves longer than so many pixels, of random directions, longer ones stronger."""
    rng = np.random.default_rng(seed)
    frequency = np.exp(rng.uniform(np.log(0.02), np.log(1.0 / shortest), 70))
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 70))
    strength = frequency**-0.5
    strength *= contrast * np.sqrt(2.0) / np.linalg.norm(strength)
    grey = np.full(line.shape, 120.0)
    for f, a, p, s in zip(2.0 * np.pi * frequency, angle, phase, strength, strict=True):
        grey += s * np.cos(f * np.sin(a) * line + f * np.cos(a) * sample + p)
    return grey


def centres() -> tuple[Array, Array]:
    line, sample = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5, indexing="ij")
    return line, sample


def clean_pair(seed: int, affine: Array, shift: Array, contrast: float = 15.0) -> tuple[Array, Array]:
    """Without noise: template(x) = GAIN search(middle + A (x - middle) + shift) + OFFSET."""
    line, sample = centres()
    inverse = np.linalg.inv(affine)
    down, across = line - MIDDLE - shift[0], sample - MIDDLE - shift[1]
    back, aside = (inverse[k, 0] * down + inverse[k, 1] * across + MIDDLE for k in range(2))
    return texture(seed, line, sample, contrast), (texture(seed, back, aside, contrast) - OFFSET) / GAIN


def anchors(step: int = 24) -> Array:
    at = np.arange(40, SIZE - 40, step) + 0.5
    return np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)


def conjugates(points: Array, affine: Array, shift: Array) -> Array:
    return np.asarray((points - MIDDLE) @ affine.T + MIDDLE + shift)


def affine_pair() -> tuple[Array, Array, Array, Array]:
    """Clean pictures, anchors and true places of an affine pair."""
    shift = np.array([0.37, -0.21])
    return *clean_pair(1, AFFINE, shift), anchors(), conjugates(anchors(), AFFINE, shift)


def match(
    template: NDArray[Any], search: NDArray[Any], points: Array, starts: Array, affine: Array, **kw: Any
) -> LeastSquaresMatches:
    matrices, half = np.broadcast_to(affine, (len(points), 2, 2)), kw.pop("half", HALF)
    pictures = SplinePicture.of(template), SplinePicture.of(search)
    return match_least_squares(*pictures, points, starts, matrices, half, **kw)


def squares(errors: Array, covariance: Array) -> Array:
    """Normalised squared errors (n,): 2 on average when the covariance is right."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[:, :, None])[:, :, 0]))


def noisy(pair: tuple[Array, Array, Array, Array], sigma: float, seed: int) -> tuple[Array, Array, Array, Array]:
    template, search, points, true = pair
    rng = np.random.default_rng(seed)
    return (
        template + sigma * rng.standard_normal(template.shape),
        search + sigma / GAIN * rng.standard_normal(search.shape),
        points,
        true,
    )
