"""Least-squares matching against textures whose place between pixels is known exactly; of curved and rough ground."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from numpy.typing import NDArray
from outside import refuses

import mgsgraph.matching
from mgsgraph.matching import equations, least_squares, window
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import EMPHASIS, LeastSquaresMatches, MatchStatus, match_least_squares

Array = NDArray[np.float64]
spline_at = njit(lambda c, line, sample: equations.spline_at(c, line, sample))
solve = njit(lambda system: equations.solve(system))
raised = njit(lambda a, floor: equations.raised(a, floor))
out_of_shape = njit(lambda x, e, half, scale: window.out_of_shape(x, e, half, scale))

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


@pytest.fixture(scope="module")
def pair() -> tuple[Array, Array, Array, Array]:
    return affine_pair()


# ---- the spline


def test_the_spline_goes_through_its_pixels_and_has_its_own_derivatives() -> None:
    pixels = np.random.default_rng(3).uniform(0.0, 255.0, (30, 40)).astype(np.float32)
    c = SplinePicture.of(pixels).coefficients
    corners = [(0, 0), (0, 39), (29, 0), (29, 39), (12, 17)]
    for i, j in corners:
        assert spline_at(c, i + 0.5, j + 0.5)[0] == pytest.approx(pixels[i, j], abs=1e-3)
    step = 1e-4
    _, by_line, by_sample = spline_at(c, 11.3, 17.8)
    along = spline_at(c, 11.3 + step, 17.8)[0] - spline_at(c, 11.3 - step, 17.8)[0]
    across = spline_at(c, 11.3, 17.8 + step)[0] - spline_at(c, 11.3, 17.8 - step)[0]
    assert (by_line, by_sample) == pytest.approx((along / (2 * step), across / (2 * step)), abs=1e-4)


def test_the_spline_is_scipys() -> None:
    from scipy.ndimage import map_coordinates

    pixels = np.random.default_rng(4).uniform(0.0, 255.0, (25, 35))
    c = SplinePicture.of(pixels).coefficients
    places = np.random.default_rng(5).uniform(0.0, 1.0, (50, 2)) * [24.0, 34.0] + 0.5
    ours = [spline_at(c, line, sample)[0] for line, sample in places]
    assert ours == pytest.approx(map_coordinates(pixels, places.T - 0.5, order=3, mode="mirror"), abs=1e-3)


@pytest.mark.parametrize("pixels", [np.zeros(5), np.zeros((3, 9)), np.full((9, 9), np.nan), np.full((9, 9), "a")])
def test_what_is_no_picture(pixels: NDArray[np.generic]) -> None:
    refuses("photo", SplinePicture.of, pixels, "photo")


# ---- the estimate


# above two seconds: the first that matches in a process, the kernel is loaded or compiled
def test_a_picture_with_itself(pair: tuple[Array, Array, Array, Array]) -> None:
    template, _, points, _ = pair
    starts = points + np.random.default_rng(0).uniform(-1.5, 1.5, points.shape)
    found = match(template, template, points, starts, SAME * 1.05)
    assert np.all(found.converged)
    assert np.abs(found.pixels - points).max() < 1e-6
    assert np.abs(found.affine - SAME).max() < 1e-6
    assert found.gain == pytest.approx(1.0, abs=1e-6)
    assert found.correlation == pytest.approx(1.0, abs=1e-9)


def test_all_eight_unknowns_come_back(pair: tuple[Array, Array, Array, Array]) -> None:
    template, search, points, true = pair
    found = match(template, search, points, true + 1.0, 0.95 * AFFINE)
    assert np.all(found.converged)
    assert np.abs(found.pixels - true).max() < 0.02
    assert np.abs(found.affine - AFFINE).max() < 0.01
    assert np.median(found.gain) == pytest.approx(GAIN, abs=0.005)
    assert np.median(found.offset) == pytest.approx(OFFSET, abs=0.6)


@pytest.mark.parametrize("tenth", range(0, 10, 3))
def test_no_bias_at_any_part_of_a_pixel(tenth: int) -> None:
    shift = np.full(2, tenth / 10.0)
    template, search = clean_pair(2, SAME, shift)
    rng, points = np.random.default_rng(tenth), anchors(16)
    search = search + 2.0 / GAIN * rng.standard_normal(search.shape)
    template = template + 2.0 * rng.standard_normal(template.shape)
    found = match(template, search, points, points + shift + 0.4, SAME)
    errors = (found.pixels - points - shift)[found.converged]
    assert len(errors) > 0.99 * len(points)
    assert np.abs(errors.mean(axis=0)).max() < 0.01


def test_swapping_lines_and_samples_swaps_the_result(pair: tuple[Array, Array, Array, Array]) -> None:
    template, search, points, true = noisy(pair, 1.5, 7)
    one = match(template, search, points, true, AFFINE)
    other = match(template.T, search.T, points[:, ::-1], true[:, ::-1], AFFINE[::-1, ::-1], half=HALF[::-1])
    assert np.all(one.status == other.status)
    assert other.pixels[:, ::-1] == pytest.approx(one.pixels, abs=1e-6, nan_ok=True)
    assert other.covariance[:, ::-1, ::-1] == pytest.approx(one.covariance, rel=2e-3, abs=1e-7, nan_ok=True)
    assert other.affine[:, ::-1, ::-1] == pytest.approx(one.affine, abs=1e-6, nan_ok=True)


def test_threads_and_company_do_not_matter(pair: tuple[Array, Array, Array, Array]) -> None:
    template, search, points, true = noisy(pair, 1.5, 9)
    one = match(template, search, points, true, AFFINE, threads=1)
    many = match(template, search, points, true, AFFINE, threads=4)
    alone = match(template, search, points[5:6], true[5:6], AFFINE)
    for name in ("pixels", "affine", "gain", "offset", "correlation", "residual", "covariance", "bend", "status"):
        assert np.array_equal(getattr(one, name), getattr(many, name), equal_nan=True)
        assert np.array_equal(getattr(one, name)[5:6], getattr(alone, name), equal_nan=True)


# ---- the covariance

@pytest.mark.parametrize("sigma", [0.5, 1.5, 3.0])
def test_sigmas_are_honest_with_white_noise(pair: tuple[Array, Array, Array, Array], sigma: float) -> None:
    values, places = [], 0
    for seed in range(3):
        template, search, points, true = noisy(pair, sigma, 20 + seed)
        found = match(template, search, points, true + 0.7, AFFINE)
        good = found.converged
        assert np.mean(good) > 0.98
        values.append(np.mean(squares((found.pixels - true)[good], found.covariance[good])))
        places += int(good.sum())
        assert np.median(found.residual) == pytest.approx(np.sqrt(2.0) * sigma, rel=0.25)
    scatter = 3.0 * 2.0 / np.sqrt(places)
    assert 2.0 / HONEST - scatter < np.mean(values) < 2.0 * HONEST + scatter


def test_relief_within_the_window_shows_in_the_sigmas() -> None:
    """A bump of disparity at the anchors: the affine place is off, and says so."""
    line, sample = centres()
    points = anchors(56)
    bump = sum(0.8 * np.exp(-((line - p[0]) ** 2 + (sample - p[1]) ** 2) / 120.0) for p in points)
    rng = np.random.default_rng(6)
    search = texture(3, line, sample)
    template = texture(3, line, sample + bump) + 1.5 * rng.standard_normal(line.shape)
    search += 1.5 * rng.standard_normal(line.shape)
    true = points + np.array([0.0, 0.8])
    found = match(template, search, points, true, SAME)
    errors = found.pixels - true
    assert np.median(np.abs(errors[:, 1])) > 0.15
    ratio = np.mean(errors[:, 1] ** 2) / np.mean(found.covariance[:, 1, 1])
    assert 1.0 / 1.5**2 < ratio < 1.5**2
    flat = match(search, texture(3, line, sample), points, points, SAME)
    assert np.median(found.covariance[:, 1, 1]) > 10.0 * np.median(flat.covariance[:, 1, 1])


@given(st.integers(0, 2**32 - 1), st.integers(1, 11), st.booleans())
def test_the_elimination_is_numpys(seed: int, unknowns: int, zeros: bool) -> None:
    """Of matrices whose rows differ in size, also with zeros on the diagonal: residuals are rounding."""
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((unknowns, unknowns)), rng.standard_normal((unknowns, unknowns + 2))
    if zeros and unknowns > 1:
        np.fill_diagonal(a, 0.0)
    a *= 10.0 ** rng.uniform(-3.0, 3.0, unknowns)
    system = np.hstack([a, b])
    assert solve(system)
    x = system[:, unknowns:]
    assert np.all(np.abs(a @ x - b) < 1e-12 * (np.abs(a) @ np.abs(x) + np.abs(b)).max())
    assert x == pytest.approx(np.linalg.solve(a, b), rel=1e-12 * np.linalg.cond(a), abs=1e-12 * np.linalg.cond(a))


@pytest.mark.parametrize("wrong", [0.0, np.nan])
def test_a_matrix_with_an_empty_or_missing_column_is_singular(wrong: float) -> None:
    a = np.random.default_rng(0).standard_normal((8, 8))
    a[:, 5] = wrong
    assert not solve(np.hstack([a, np.eye(8)]))


@given(st.integers(0, 2**32 - 1), st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-9.0, 3.0))
def test_a_raised_covariance_is_above_its_floor(seed: int, one: float, other: float, size: float) -> None:
    """Against the eigenvalues of L^-1 a L^-T, where the floor is L L'."""
    unit = np.tril(np.random.default_rng(seed).uniform(0.3, 2.0, (2, 2)) * 10.0**size)
    turn = np.linalg.qr(np.random.default_rng(seed + 1).standard_normal((2, 2)))[0]
    a = unit @ turn @ np.diag([10.0**one, 10.0**other]) @ turn.T @ unit.T
    floor = unit @ unit.T
    got = np.array(raised((a[0, 0], a[0, 1], a[1, 1]), (floor[0, 0], floor[0, 1], floor[1, 1])))[[[0, 1], [1, 2]]]
    ratios, ways = np.linalg.eigh(np.linalg.solve(unit, np.linalg.solve(unit, a).T))
    wanted = unit @ ways @ np.diag(np.maximum(ratios, 1.0)) @ ways.T @ unit.T
    assert got == pytest.approx(wanted, rel=1e-10, abs=1e-10 * max(np.abs(a).max(), np.abs(floor).max()))


# ---- what can go wrong


def one(
    template: NDArray[Any], search: NDArray[Any], at: float = 100.5, start: float = 100.5, **kw: Any
) -> MatchStatus:
    found = match(template, search, np.full((1, 2), at), np.full((1, 2), start), SAME, **kw)
    numbers = (found.pixels, found.affine, found.gain, found.correlation, found.covariance)
    assert all(np.all(np.isfinite(n) == found.converged[0]) for n in numbers)
    return MatchStatus(int(found.status[0]))


WAYS = pytest.mark.parametrize("relief", [None, ALONG[None]])


@WAYS
def test_every_way_to_fail(
    pair: tuple[Array, Array, Array, Array], relief: Array | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    template, even = pair[0], np.full_like(pair[0], 80.0)
    way: dict[str, Any] = {"relief": relief}
    assert one(template, template, **way) == MatchStatus.CONVERGED
    assert one(template, template, at=5.5, **way) == MatchStatus.LEFT
    assert one(template, template, start=SIZE - 5.0, **way) == MatchStatus.LEFT
    assert one(template, template, at=1e9 + 0.5, **way) == MatchStatus.LEFT
    assert one(template, even, **way) == one(even, template, **way) == MatchStatus.FLAT
    assert one(template, template, start=101.5, reach=0.5, **way) == MatchStatus.WANDERED
    monkeypatch.setattr(least_squares, "ITERATIONS", 1)
    assert one(template, template, start=101.5, **way) == MatchStatus.NOT_CONVERGED


@pytest.mark.parametrize("relief", [None, np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])])
def test_an_edge_does_not_tell_both_directions(relief: Array | None) -> None:
    line, _ = centres()
    stripes = 120.0 + 30.0 * np.sin(0.5 * line)
    assert one(stripes, stripes, relief=relief) == MatchStatus.FLAT


@WAYS
def test_saturated_pixels_and_gaps(
    pair: tuple[Array, Array, Array, Array], relief: Array | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    template = np.clip(np.rint(pair[0]), 1, 254).astype(np.uint8)
    bright, holed = template.copy(), pair[0].copy()
    bright[95:100, 90:112] = 255
    holed[104, 104] = np.nan
    way: dict[str, Any] = {"relief": relief}
    assert one(template, template, **way) == MatchStatus.CONVERGED
    assert one(bright, template, **way) == one(template, bright, **way) == MatchStatus.SATURATED
    assert one(holed, pair[0], **way) == one(pair[0], holed, **way) == MatchStatus.LEFT
    monkeypatch.setattr(least_squares, "SATURATED", 1.0)
    assert one(bright, bright, **way) == MatchStatus.CONVERGED


def test_noise_alone_is_no_good_match() -> None:
    rng = np.random.default_rng(12)
    template, search = rng.normal(120.0, 5.0, (2, SIZE, SIZE))
    found = match(template, search, anchors(), anchors(), SAME)
    assert not np.any(found.correlation[found.converged] > 0.6)


def test_bad_arguments(pair: tuple[Array, Array, Array, Array]) -> None:
    template, points = pair[0], np.full((1, 2), 100.5)
    refuses("centre of a pixel", match, template, template, points + 0.2, points, SAME)
    refuses("finite", match, template, template, points, points * np.nan, SAME)
    refuses("inverse", match, template, template, points, points, np.ones((2, 2)))
    refuses("half window", match, template, template, points, points, SAME, half=(2, 9))


def test_kernels_have_a_place_before_numba_asks_for_it(tmp_path: Path) -> None:
    """Importing the package chooses it: an installed one must not be written into."""
    package = tmp_path / "site-packages" / "mgsgraph"
    shutil.copytree(Path(mgsgraph.matching.__file__).parents[1], package, ignore=shutil.ignore_patterns("__pycache__"))
    code = "import os, mgsgraph.matching; print(os.environ['NUMBA_CACHE_DIR'])"
    settings = {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    run = {"capture_output": True, "text": True, "check": True, "env": settings, "cwd": tmp_path}
    done = subprocess.run([sys.executable, "-c", code], **run)  # type: ignore[call-overload]
    assert done.stdout.strip() == str(tmp_path / "mgsgraph")


# --- windows of curved and of rough ground


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
    refuses("relief 3: no direction", match, template, search, points, points, SAME, relief=directions)


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
