"""Least-squares matching of windows of curved and of rough ground, whose relief displaces in a known direction."""

import numpy as np
import pytest
from textures import (
    AFFINE,
    ALONG,
    HALF,
    HONEST,
    SAME,
    SIZE,
    Array,
    affine_pair,
    anchors,
    centres,
    match,
    noisy,
    squares,
    texture,
)

from mgsgraph.errors import InputError
from mgsgraph.matching.least_squares import EMPHASIS, MatchStatus
from mgsgraph.matching.window import out_of_shape


@pytest.fixture(scope="module")
def pair() -> tuple[Array, Array, Array, Array]:
    return affine_pair()


SIDEWAYS = np.array([-0.8, 0.6])
CURVATURE = np.array([0.006, -0.004, 0.004])
"""pixels along `ALONG` per square pixel: of lines, of both, of samples."""


def curved_pair(seed: int, curvature: Array) -> tuple[Array, Array, Array]:
    """Without noise: about each anchor, template(anchor + d) = search(anchor + d + ALONG curvature(d)); the anchors."""
    line, sample = centres()
    points = anchors(40)
    nearest = np.rint((np.stack([line, sample], axis=-1) - points[0]) / 40.0).clip(0, 7) * 40.0 + points[0]
    down, across = line - nearest[..., 0], sample - nearest[..., 1]
    rise = curvature[0] * down**2 + curvature[1] * down * across + curvature[2] * across**2
    seen = texture(seed, line + ALONG[0] * rise, sample + ALONG[1] * rise)
    return seen, texture(seed, line, sample), points


def with_noise(pictures: tuple[Array, Array], sigma: float, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    one, other = (picture + sigma * rng.standard_normal(picture.shape) for picture in pictures)
    return one, other


def along(points: Array, length: float = 1.0) -> Array:
    return np.broadcast_to(length * ALONG, points.shape)


def planted_bias(curvature: Array) -> float:
    """pixels by which a plane through curved ground misses its middle: the curvature's mean, weighted like pixels.

    Even textures have no part in it, nor has the product of lines and samples.
    """
    down, across = np.meshgrid(np.arange(-HALF[0], HALF[0] + 1), np.arange(-HALF[1], HALF[1] + 1), indexing="ij")
    weights = np.exp(-0.5 * ((down / HALF[0]) ** 2 + (across / HALF[1]) ** 2) / EMPHASIS**2)
    return float(np.average(curvature[0] * down**2 + curvature[2] * across**2, weights=weights))


def test_curved_ground_biases_a_plane_and_not_a_parabola() -> None:
    template, search, points = curved_pair(5, CURVATURE)
    template, search = with_noise((template, search), 1.0, 50)
    plain = match(template, search, points, points, SAME)
    curved = match(template, search, points, points, SAME, relief=along(points))
    assert np.all(plain.converged & curved.converged)
    expected = planted_bias(CURVATURE)
    assert expected > 0.15
    assert ((plain.pixels - points) @ ALONG).mean() == pytest.approx(expected, rel=0.1)
    errors = curved.pixels - points
    assert np.abs(errors.mean(axis=0)).max() < 3.0 * np.sqrt(np.trace(curved.noise.mean(axis=0)) / len(points))
    scatter = 3.0 * 2.0 / np.sqrt(len(points))
    assert 2.0 / HONEST - scatter < squares(errors, curved.noise).mean() < 2.0 * HONEST + scatter


def test_without_noise_curved_ground_is_exact() -> None:
    template, search, points = curved_pair(5, CURVATURE)
    found = match(template, search, points, points + 0.5, SAME, relief=along(points))
    assert np.all(found.converged)
    assert np.abs(found.pixels - points).max() < 0.01


def test_on_flat_ground_relief_costs_sharpness_alone(pair: tuple[Array, Array, Array, Array]) -> None:
    values, errors, total = [], [], 0
    for seed in range(3):
        template, search, points, true = noisy(pair, 1.5, 60 + seed)
        plain = match(template, search, points, true + 0.7, AFFINE)
        found = match(template, search, points, true + 0.7, AFFINE, relief=along(points))
        good = plain.converged & found.converged
        assert np.mean(good) > 0.98
        assert np.mean(np.einsum("i,nij,j->n", ALONG, (found.noise - plain.noise)[good], ALONG) > 0.0) > 0.98
        errors.append((found.pixels - true)[good])
        values.append(squares(errors[-1], found.noise[good]))
        total += int(good.sum())
    scatter = 3.0 * 2.0 / np.sqrt(total)
    assert 2.0 / HONEST - scatter < np.concatenate(values).mean() < 2.0 * HONEST + scatter
    assert np.abs(np.concatenate(errors).mean(axis=0)).max() < 0.01


def rough(seed: int, hurst: float, size: float) -> Array:
    """(SIZE, SIZE) fractal displacement of mean zero, rms of so many pixels over a window and shorter."""
    rng = np.random.default_rng(seed)
    waves = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None])
    waves[0, 0] = np.inf
    strength = np.where(waves > 1.0 / (2.0 * HALF[1]), waves ** -(1.0 + hurst), 0.0)
    displaced = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * strength, s=(SIZE, SIZE))
    return np.asarray(size * displaced / displaced.std())


@pytest.mark.parametrize(("hurst", "relief"), [(0.0, True), (0.5, True), (0.8, True), (0.5, False)])
def test_rough_ground_shows_in_the_sigmas(hurst: float, relief: bool) -> None:
    line, sample = centres()
    displaced = rough(70, hurst, 0.15)
    pictures = texture(6, line + ALONG[0] * displaced, sample + ALONG[1] * displaced), texture(6, line, sample)
    template, search = with_noise(pictures, 1.0, 71)
    points = anchors(16)
    index = np.floor(points).astype(int)
    true = points + displaced[index[:, 0], index[:, 1], None] * ALONG
    found = match(template, search, points, true, SAME, relief=along(points) if relief else None)
    good = found.converged
    errors, stated = (found.pixels - true)[good], found.covariance_with_relief(along(points, 7.0))[good]
    for direction, factor in ((ALONG, 1.5), (SIDEWAYS, 1.3)):
        ratio = np.mean((errors @ direction) ** 2) / np.mean(np.einsum("i,nij,j->n", direction, stated, direction))
        assert 1.0 / factor**2 < ratio < factor**2
    bare = np.mean(np.einsum("i,nij,j->n", ALONG, found.noise[good], ALONG))
    assert np.mean((errors @ ALONG) ** 2) > 1.5**2 * bare
    added = stated - found.noise[good]
    assert np.einsum("nij,j->ni", added, SIDEWAYS) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.eigvalsh(added).min() > -1e-12


def test_only_the_direction_of_relief_counts() -> None:
    template, search, points = curved_pair(5, CURVATURE)
    one, other = (match(template, search, points, points, SAME, relief=along(points, k)) for k in (1.0, -1e-5))
    assert other.pixels == pytest.approx(one.pixels, abs=1e-9)
    assert other.noise == pytest.approx(one.noise, rel=1e-6)
    directions = along(points).copy()
    directions[3] = 0.0
    with pytest.raises(InputError, match="relief 3: no direction"):
        match(template, search, points, points, SAME, relief=directions)
    with pytest.raises(InputError, match="relief 3: no direction"):
        one.covariance_with_relief(directions)
    with pytest.raises(InputError, match="relief"):
        match(template, search, points, points, SAME, relief=directions[1:])


def test_a_gap_that_only_curved_ground_reaches() -> None:
    """Pixels are looked for where the curved window has them, not where a plane one would."""
    template, search, points = curved_pair(5, np.array([0.0, 0.0, 0.03]))
    point, relief = points[27:28], along(points[27:28])
    for side in (-1, 1):
        middle = np.floor(point[0] + [0.0, 10.0 * side] + 3.0 * ALONG).astype(int)
        holed = search.copy()
        holed[middle[0], middle[1]] = np.nan
        whole = match(template, search, point, point, SAME, relief=relief)
        assert whole.converged[0]
        assert match(template, holed, point, point, SAME, relief=relief).status[0] == MatchStatus.LEFT


def test_curved_ground_at_the_edge_of_the_picture() -> None:
    """A search picture two pixels wider than the window on each side, out of which the curved ground reaches."""
    template, search, points = curved_pair(5, np.array([0.0, 0.0, 0.03]))
    for point in points[[0, 27, 63]]:
        line, sample = np.floor(point).astype(int)
        part = search[line - 10 : line + 11, sample - 12 : sample + 13]
        found = match(template, part, point[None], np.array([[10.5, 12.5]]), SAME, relief=ALONG[None])
        assert found.status[0] == MatchStatus.LEFT
        assert match(template, part, point[None], np.array([[10.5, 12.5]]), SAME).status[0] != MatchStatus.LEFT


def test_folded_ground_is_no_match() -> None:
    """The change of scale is looked at where it is largest: against determinants over the whole window."""
    rng = np.random.default_rng(90)
    down, across = (axis.ravel() for axis in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]))
    wrong = 0
    for _ in range(300):
        affine = AFFINE + rng.normal(0.0, 0.2, (2, 2))
        x = np.concatenate([[0.0, 0.0], affine.ravel(), [1.0, 0.0], rng.normal(0.0, 3.0, 3)])
        rise = np.stack([2 * x[8] * down + x[9] * across, x[9] * down + 2 * x[10] * across], axis=-1) / HALF
        scale = np.linalg.det(affine + ALONG[:, None] * rise[:, None, :]) / np.linalg.det(AFFINE)
        bad = bool(scale.min() <= 0.25 or scale.max() >= 4.0)
        assert out_of_shape(x, ALONG, HALF, float(np.linalg.det(AFFINE))) == bad
        wrong += bad
    assert 50 < wrong < 250
