"""Least-squares matching against textures whose place between pixels is known exactly."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from textures import (
    AFFINE,
    ALONG,
    GAIN,
    HALF,
    HONEST,
    OFFSET,
    SAME,
    SIZE,
    Array,
    affine_pair,
    anchors,
    centres,
    clean_pair,
    match,
    noisy,
    squares,
    texture,
)

import mgsgraph.matching
from mgsgraph.errors import InputError
from mgsgraph.matching import least_squares
from mgsgraph.matching.equations import SplinePicture, spline_at
from mgsgraph.matching.least_squares import LeastSquaresMatches, MatchStatus


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
    with pytest.raises(InputError, match="photo"):
        SplinePicture.of(pixels, "photo")


# ---- the estimate


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

def nees(template: Array, search: Array, points: Array, true: Array) -> tuple[float, LeastSquaresMatches]:
    found = match(template, search, points, true + 0.7, AFFINE)
    good = found.converged
    assert np.mean(good) > 0.98
    return float(np.mean(squares((found.pixels - true)[good], found.covariance[good]))), found


@pytest.mark.parametrize("sigma", [0.5, 1.5, 3.0])
def test_sigmas_are_honest_with_white_noise(pair: tuple[Array, Array, Array, Array], sigma: float) -> None:
    values, places = [], 0
    for seed in range(3):
        mean, found = nees(*noisy(pair, sigma, 20 + seed))
        values.append(mean)
        places += int(found.converged.sum())
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
    with pytest.raises(InputError, match="centre of a pixel"):
        match(template, template, points + 0.2, points, SAME)
    with pytest.raises(InputError, match="finite"):
        match(template, template, points, points * np.nan, SAME)
    with pytest.raises(InputError, match="inverse"):
        match(template, template, points, points, np.ones((2, 2)))
    with pytest.raises(InputError, match="half window"):
        match(template, template, points, points, SAME, half=(2, 9))


def test_kernels_have_a_place_before_numba_asks_for_it(tmp_path: Path) -> None:
    """Importing the package chooses it: an installed one must not be written into."""
    package = tmp_path / "site-packages" / "mgsgraph"
    shutil.copytree(Path(mgsgraph.matching.__file__).parents[1], package, ignore=shutil.ignore_patterns("__pycache__"))
    code = "import os, mgsgraph.matching; print(os.environ['NUMBA_CACHE_DIR'])"
    settings = {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    run = {"capture_output": True, "text": True, "check": True, "env": settings, "cwd": tmp_path}
    done = subprocess.run([sys.executable, "-c", code], **run)  # type: ignore[call-overload]
    assert done.stdout.strip() == str(tmp_path / "mgsgraph")
