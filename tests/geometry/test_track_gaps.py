"""Posts between tracks: what interpolation misses there, and what errors in common are worth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.terrain import TerrainGrid, common_variances, overlap_variances
from mgsgraph.geometry.terrain_grids import track_gaps
from mgsgraph.units import DEG

STEP = DEG / 128.0
RADIUS = 3_390_000.0
SIDE = RADIUS * STEP


def grids(radii: Array, shots: Array | Mask) -> tuple[TerrainGrid, TerrainGrid]:
    return (
        TerrainGrid("megr", radii, 0.3, 0.0, STEP, STEP),
        TerrainGrid("megc", np.where(shots, 3.0, 0.0), 0.3, 0.0, STEP, STEP, kind="counts"),
    )


def relief(rng: np.random.Generator, hurst: float, size: int = 256) -> Array:
    """(size, size) m, Gaussian, of a spectrum that falls with the frequency to the power 2 H + 2; 30 m a post."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    frequency[0, 0] = 1.0
    white = rng.standard_normal((size, size)) + 1j * rng.standard_normal((size, size))
    found = np.fft.ifft2(frequency ** (-1.0 - hurst) * white).real
    return np.asarray(30.0 * found / np.diff(found, axis=0).std())


def between(radii: Array, tracks: Array) -> Array:
    """The same with all but some columns interpolated between these."""
    return np.array([np.interp(np.arange(row.size), tracks, row[tracks]) for row in radii])


@pytest.mark.parametrize("hurst", [0.5, 0.7, 0.9])
def test_errors_between_tracks_are_as_large_as_stated(hurst: float) -> None:
    """Of fractal ground as Mars is (H of 0.6 to 0.9), with tracks 2 to 18 posts apart: rms within 20 %, and within 30 %
    in narrow and wide gaps, near the tracks and far off.
    """
    rng, errors, stated, halves, nearest = np.random.default_rng(7), [], [], [], []
    for _ in range(12):
        radii = RADIUS + relief(rng, hurst)[:96, :120]
        tracks = np.concatenate([[0], np.cumsum(rng.integers(2, 19, 20))])
        tracks = tracks[tracks < 120]
        shots = np.isin(np.arange(120), tracks) & np.ones((96, 1), dtype=bool)
        gaps = track_gaps(*grids(between(radii, tracks), shots))
        mine = ~shots & (np.arange(120) < tracks[-1])
        assert not gaps.sigmas[shots].any()
        errors.append((between(radii, tracks) - radii)[mine])
        stated.append(gaps.sigmas[mine])
        halves.append(gaps.reaches[mine] / SIDE)
        nearest.append(np.abs(np.arange(120)[:, None] - tracks).min(axis=1)[np.argwhere(mine)[:, 1]])
    error, sigma, half, near = (np.concatenate(part) for part in (errors, stated, halves, nearest))
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.2)
    for some in (half < 5.0, half > 7.0, near < 2.0, near > 4.0):
        assert np.sqrt(np.mean(error[some] ** 2) / np.mean(sigma[some] ** 2)) == pytest.approx(1.0, abs=0.3)


def test_a_reach_is_half_the_distance_between_the_tracks() -> None:
    shots = np.isin(np.arange(30), [0, 10, 14]) & np.ones((40, 1), dtype=bool)
    gaps = track_gaps(*grids(RADIUS + relief(np.random.default_rng(1), 0.7)[:40, :30], shots))
    half = gaps.reaches[20] / SIDE
    assert half[1:10] == pytest.approx(np.full(9, 5.0), rel=1e-3)
    assert half[11:14] == pytest.approx(np.full(3, 2.0), rel=1e-3)
    assert half[20] == pytest.approx(12.0, rel=1e-3)  # six posts beyond the last track: the middle of 24
    assert gaps.sigmas[20, 5] > gaps.sigmas[20, 2] > gaps.sigmas[20, 12] > 0.0
    assert not track_gaps(*grids(gaps.sigmas + RADIUS, np.ones(shots.shape))).sigmas.any()


def test_what_says_nothing_is_refused() -> None:
    radii = np.full((20, 20), RADIUS)
    lonely = np.zeros((20, 20))
    lonely[::7, ::7] = 1.0
    with pytest.raises(InputError, match="hardly any posts with shots in line"):
        track_gaps(*grids(radii, lonely))
    with pytest.raises(InputError, match="other posts"):
        track_gaps(grids(radii, lonely)[0], grids(radii[1:], lonely[1:])[1])


# --- errors in common


@given(st.integers(1, 40), st.integers(0, 1000))
def test_variances_bound_the_covariance_that_they_stand_for(count: int, seed: int) -> None:
    """Whatever is estimated of rows that count as independent is not surer than it would be by the covariance."""
    rng = np.random.default_rng(seed)
    places, sigmas, reaches = rng.uniform(0, 10, (count, 3)), rng.uniform(0, 5, count), rng.uniform(0, 8, count)
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    shared = (apart <= np.minimum(reaches[:, None], reaches)) | np.eye(count, dtype=bool)
    covariance = np.outer(sigmas, sigmas) * shared
    found = common_variances(places, sigmas, reaches)
    np.testing.assert_allclose(found, covariance.sum(axis=1), rtol=1e-9)
    assert np.linalg.eigvalsh(np.diag(found) - covariance).min() > -1e-9 * max(found.max(), 1.0)


@given(st.integers(1, 30), st.integers(0, 1000))
def test_windows_that_overlap_have_that_share_of_their_errors_in_common(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places, sigmas = rng.uniform(0, 60, (count, 2)), rng.uniform(0.1, 2, (count, 2))
    shares = np.prod(np.clip(1.0 - np.abs(places[:, None] - places) / 21.0, 0.0, None), axis=2)
    found = overlap_variances(places, sigmas, 21.0)
    for found_one, sigma in zip(found.T, sigmas.T, strict=True):
        covariance = np.outer(sigma, sigma) * shares
        np.testing.assert_allclose(found_one, covariance.sum(axis=1), rtol=1e-9)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9
        assert np.linalg.eigvalsh(np.diag(found_one) - covariance).min() > -1e-9 * count
