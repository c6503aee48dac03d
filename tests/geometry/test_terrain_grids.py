"""Grids made of others, and what a grid says of its own sigma and reach; posts between tracks, what interpolation
misses there; dense matches averaged over a footprint.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from outside import refuses
from scipy.interpolate import RectBivariateSpline

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.stereo_surface import StereoSurface, averaged_surface
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.geometry.terrain_grids import above_areoid, mosaic, track_gaps
from mgsgraph.network import Surface
from mgsgraph.network.common import common_heights
from mgsgraph.units import DEG

RADIUS = 3390e3

STEP = DEG / 64.0


def grid(
    rows: int = 40, columns: int = 60, seed: int = 1, slopes: tuple[float, float] = (0.0, 0.0), noise: float = 0.0
) -> TerrainGrid:
    """Posts that rise by `slopes` (m per m) eastward and northward, with noise (m)."""
    latitude = 10.0 * DEG - np.arange(rows)[:, None] * STEP
    east = np.arange(columns) * STEP * RADIUS * np.cos(10.0 * DEG - 0.5 * rows * STEP)
    radii = RADIUS + slopes[0] * east + slopes[1] * (latitude - 10.0 * DEG) * RADIUS
    radii = radii + noise * np.random.default_rng(seed).standard_normal((rows, columns))
    first = 175.0 * DEG, 10.0 * DEG
    return TerrainGrid("made up", radii, *first, STEP, STEP, vertical_sigma=10.0, planimetric_sigma=200.0)


def inside(one: TerrainGrid, count: int = 500, seed: int = 3) -> Array:
    rows, columns = one.radii.shape
    place = np.random.default_rng(seed).uniform(2.0, [columns - 3.0, rows - 3.0], (count, 2))
    longitude, latitude = one.first_longitude + place[:, 0] * STEP, one.first_latitude - place[:, 1] * STEP
    return from_planetocentric(np.column_stack([longitude, latitude, np.full(count, RADIUS)]))


def test_interpolation_between_tracks_adds_to_the_sigma() -> None:
    one = grid()
    between = np.linspace(5.0, 50.0, one.radii.size).reshape(one.radii.shape)
    own = replace(one, gaps=Gaps(between, np.full(between.shape, 1e4)))
    points = inside(one, 20)
    found, more = own.height_sigmas(points), replace(one, radii=between, kind="topography").at(points)
    np.testing.assert_allclose(found, np.hypot(10.0, more), rtol=1e-6)
    cut = own.around(points[:3], margin=1)
    assert cut.radii.size < own.radii.size
    np.testing.assert_allclose(cut.height_sigmas(points[:3]), found[:3], rtol=1e-6)
    for wrong in (between[1:], between - 10.0):
        refuses("gaps between tracks", replace, one, gaps=Gaps(wrong, between))


def test_points_in_one_gap_are_worth_no_more_than_one_height() -> None:
    """Points in pairs 1 km apart: each pair shares its posts, and all of them the error between two tracks."""
    one = grid()
    own = replace(one, gaps=Gaps(np.full(one.radii.shape, 30.0), np.full(one.radii.shape, 1e6)))
    apart = 20.0 * STEP * np.arange(1.0, 4.0)[:, None] / 20.0 + [0.0, 1e-6]
    longitude = one.first_longitude + 10.0 * STEP + apart.ravel()
    points = from_planetocentric(np.column_stack([longitude, np.full((6, 2), [9.9 * DEG, RADIUS])]))
    for model, total, alone in ((one, 10.0**2, 2.0 * 10.0**2), (own, 10.0**2 + 30.0**2, 2.0 * 10.0**2 + 6.0 * 30.0**2)):
        surface, common = common_heights(Surface(model, model.height_sigmas(points)), points)
        assert common is not None
        assert (common.total * surface.sigmas[common.members]) ** 2 == pytest.approx(np.full(6, total))
        assert (common.independent * surface.sigmas[common.members]) ** 2 == pytest.approx(np.full(6, alone), rel=0.15)


@example(row=20, column=30, order=[0, 1, 2, 3], west=-30)  # on either side of the prime meridian
@given(st.integers(2, 38), st.integers(2, 58), st.permutations(range(4)), st.integers(-70000, 70000))
def test_tiles_are_the_grid_that_they_were_cut_from(row: int, column: int, order: list[int], west: int) -> None:
    whole = replace(grid(noise=30.0), first_longitude=west * STEP)
    tiles = [
        replace(whole, radii=whole.radii[rows, columns],
                first_longitude=np.mod(whole.first_longitude + columns.start * STEP, 2.0 * np.pi),
                first_latitude=whole.first_latitude - rows.start * STEP)
        for rows in (slice(0, row), slice(row, 40)) for columns in (slice(0, column), slice(column, 60))
    ]  # fmt: skip
    together = mosaic([tiles[k] for k in order])
    np.testing.assert_array_equal(together.radii, whole.radii)
    turns = (together.first_longitude - whole.first_longitude) / (2.0 * np.pi)
    assert abs(turns - round(turns)) < 1e-9
    assert abs(together.first_latitude - whole.first_latitude) < 1e-12


def test_tiles_may_overlap_wrap_and_leave_holes() -> None:
    whole = grid(noise=30.0)
    one, two = (replace(whole, radii=whole.radii[:20, a:b], first_longitude=whole.first_longitude + a * STEP)
                for a, b in ((0, 35), (30, 60)))  # fmt: skip
    low = replace(whole, radii=whole.radii[20:, :10], first_latitude=whole.first_latitude - 20 * STEP)
    together = mosaic([one, two, low])
    np.testing.assert_array_equal(together.radii[:20], whole.radii[:20])
    np.testing.assert_array_equal(together.radii[20:, :10], whole.radii[20:, :10])
    assert np.all(np.isnan(together.radii[20:, 10:]))
    turn = [TerrainGrid("turn", np.full((3, 180), RADIUS + k), k * np.pi, 0.0, np.pi / 180.0, DEG) for k in range(2)]
    assert mosaic(turn[::-1]).wraps
    assert mosaic(turn).radii.shape == (3, 360)


def test_tiles_of_other_grids_are_refused() -> None:
    one = grid()
    for change, said in (
        ({"latitude_step": 2.0 * STEP}, "other steps"),
        ({"first_longitude": one.first_longitude + 0.4 * STEP}, "between"),
        ({"kind": "areoid"}, "a grid of areoid"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            mosaic([one, replace(one, **change)])  # type: ignore[arg-type]


def test_heights_above_the_areoid_become_radii() -> None:
    areoid = replace(grid(slopes=(0.01, 0.02)), kind="areoid")
    heights = replace(grid(20, 30, noise=50.0), radii=grid(20, 30, noise=50.0).radii - RADIUS, kind="topography",
                      first_longitude=areoid.first_longitude + 10.25 * STEP)  # fmt: skip
    radii = above_areoid(heights, areoid)
    assert radii.kind == "radius"
    assert radii.vertical_sigma == 10.0
    place = heights.first_longitude + 7 * STEP, heights.first_latitude - 5 * STEP
    want, _, _ = areoid.radius(np.array(place[:1]), np.array(place[1:]))
    np.testing.assert_allclose(radii.radii[5, 7] - heights.radii[5, 7], want[0], rtol=0, atol=1e-6)
    refuses("heights above the areoid", above_areoid, grid(), areoid)
    refuses("areoid's radius", above_areoid, heights, grid())


# --- posts between tracks


POST = DEG / 128.0


SIDE = RADIUS * POST


def grids(radii: Array, shots: Array | Mask) -> tuple[TerrainGrid, TerrainGrid]:
    return (
        TerrainGrid("megr", radii, 0.3, 0.0, POST, POST),
        TerrainGrid("megc", np.where(shots, 3.0, 0.0), 0.3, 0.0, POST, POST, kind="counts"),
    )


def fractal(rng: np.random.Generator, hurst: float, size: int = 256) -> Array:
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
        radii = RADIUS + fractal(rng, hurst)[:96, :120]
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
    gaps = track_gaps(*grids(RADIUS + fractal(np.random.default_rng(1), 0.7)[:40, :30], shots))
    half = gaps.reaches[20] / SIDE
    assert half[1:10] == pytest.approx(np.full(9, 5.0), rel=1e-3)
    assert half[11:14] == pytest.approx(np.full(3, 2.0), rel=1e-3)
    assert half[20] == pytest.approx(12.0, rel=1e-3)  # six posts beyond the last track: the middle of 24
    assert gaps.sigmas[20, 5] > gaps.sigmas[20, 2] > gaps.sigmas[20, 12] > 0.0
    assert not track_gaps(*grids(gaps.sigmas + RADIUS, np.ones(shots.shape))).sigmas.any()


# --- errors in common


# --- dense matches averaged over a footprint


WIDTH = 20.0
"""pixels, and m, standard deviation of the footprint: nodes every 10 pixels."""


def wall(anchors: Array) -> Array:
    """Disparity (n, 2): level, but for a wall of 0.6 pixels per pixel between lines 200 and 400."""
    return np.column_stack([np.zeros(len(anchors)), 0.6 * np.clip(anchors[:, 0] - 300.0, -100.0, 100.0)])


def surface(blunders: int = 0, seed: int = 1) -> StereoSurface:
    """Of matches every 5 pixels with noise of 0.1."""
    rng = np.random.default_rng(seed)
    grid = np.meshgrid(np.arange(2.5, 600.0, 5.0), np.arange(2.5, 300.0, 5.0), indexing="ij")
    anchors = np.stack([part.ravel() for part in grid], axis=1)
    places = anchors + wall(anchors) + rng.normal(0.0, 0.1, anchors.shape)
    places[rng.choice(len(anchors), blunders, replace=False)] += 20.0
    return averaged_surface(anchors, places, np.full(len(anchors), 0.01), np.ones(2), WIDTH, 10.0)


def spots() -> Array:
    """(n, 2) on the wall, three standard deviations from its edges."""
    line, sample = np.meshgrid(np.linspace(265.0, 335.0, 30), np.linspace(80.0, 220.0, 20), indexing="ij")
    return np.column_stack([line.ravel(), sample.ravel()])


def test_matches_on_a_steep_wall_and_at_its_edges_are_kept() -> None:
    """They are as far from the nodes' averages as the wall is steep, and yet on it; the average rounds an edge off by
    0.4 of what a standard deviation of the footprint rises.
    """
    found = surface()
    edges = np.array([[200.0, 150.0], [400.0, 150.0]])
    assert np.all(found.at_nodes(np.concatenate([spots(), edges]))[0])
    rounded = (found.disparity(edges)[0] - edges - wall(edges))[:, 1]
    assert rounded == pytest.approx(0.6 * WIDTH * np.array([1.0, -1.0]) / np.sqrt(2.0 * np.pi), rel=0.1)
    off = found.disparity(spots())[0] - spots() - wall(spots())
    assert np.abs(off).max() < 0.05
    np.testing.assert_allclose(found.disparity(spots())[1][:, 1, 0], 0.6, atol=0.02)


def test_blunders_are_left_out() -> None:
    """One match in a hundred, by 20 pixels."""
    off = surface(blunders=70).disparity(spots())[0] - spots() - wall(spots())
    assert np.abs(off).max() < 0.1


def test_disparities_are_those_of_the_splines() -> None:
    """By FITPACK; outside those at the edge."""
    found, (rows, columns) = surface(), surface().covered.shape
    rng = np.random.default_rng(3)
    at = rng.uniform([-2.0, -2.0], [rows + 1.0, columns + 1.0], (300, 2))
    at[:9] = 0.5 * np.arange(9)[:, None]  # the first interval of a spline is twice as wide as the others
    values, slopes = found.disparity(found.first + at * found.step)
    for k in range(2):
        spline = RectBivariateSpline(np.arange(rows), np.arange(columns), found.places[:, :, k])
        np.testing.assert_allclose(values[:, k], spline.ev(*at.T), rtol=0.0, atol=1e-9)
        for axis, step in enumerate(found.step):
            expected = spline.ev(*at.T, dx=1 - axis, dy=axis) / step
            np.testing.assert_allclose(slopes[:, k, axis], expected, rtol=0.0, atol=1e-9)


def test_what_a_search_reads_is_the_surface_but_for_its_bends() -> None:
    """Linear between points of the splines."""
    found = surface()
    finer, (lines, samples) = found.fine
    corner = np.random.default_rng(2).integers(0, np.array(lines.shape) - 1, (500, 2))
    at, beside = (found.disparity(found.first + (corner + off) * found.step / finer)[0] for off in (0.0, [0.5, 0.0]))
    r, c = corner.T
    np.testing.assert_allclose(np.stack([lines[r, c], samples[r, c]], axis=1), at, atol=1e-9)
    between = 0.5 * np.stack([lines[r, c] + lines[r + 1, c], samples[r, c] + samples[r + 1, c]], axis=1)
    off = np.abs(between - beside)
    assert np.quantile(off, 0.9) < 0.05
    assert off.max() < 0.5  # on the wall
