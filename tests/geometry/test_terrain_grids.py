"""Grids made of others, and what a grid says of its own sigma and reach."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.geometry.terrain_grids import above_areoid, mosaic
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


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_sigma_is_that_of_height_and_of_place_on_a_slope(east: float, north: float) -> None:
    one = grid(slopes=(east, north))
    points = inside(one, 50)
    want = np.hypot(10.0, 200.0 * np.hypot(east, north))
    np.testing.assert_allclose(one.height_sigmas(points, False), want, rtol=1e-2)
    assert np.all(one.height_sigmas(points, True) == 10.0)


def test_the_height_moves_by_as_much_as_the_sigma_says() -> None:
    """Rough ground moved 200 m in random directions: the heights' rms of change is what the sigma allows for."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[0:40, 0:60]
    radii = RADIUS + 300.0 * np.sin(x / 6.0) * np.cos(y / 8.0)
    one = replace(grid(), radii=radii, vertical_sigma=1e-3)
    points = inside(one, 4000)
    step = rng.standard_normal((4000, 2)) * 200.0 / RADIUS
    far = from_planetocentric(np.stack([
        np.arctan2(points[:, 1], points[:, 0]) + step[:, 0] / np.cos(10.0 * DEG),
        np.arcsin(points[:, 2] / RADIUS) + step[:, 1], np.full(4000, RADIUS),
    ], axis=1))  # fmt: skip
    ratio = (one.at(far) - one.at(points)) / one.height_sigmas(points, False)
    usual = np.median(np.abs(ratio)) / 0.6745
    assert 0.85 < usual < 1.25


def test_the_slope_is_not_that_of_the_posts_noise() -> None:
    """10 m of noise on flat ground, posts 925 m apart: per direction 10 / 925 / sqrt(20), unsmoothed 10 / 925."""
    one = grid(noise=10.0)
    rise = one.rise(*np.array([np.arctan2(*inside(one).T[1::-1]), np.arcsin(inside(one)[:, 2] / RADIUS)]))
    spacing = STEP * RADIUS
    np.testing.assert_allclose(np.sqrt(np.mean(rise**2)), np.sqrt(2.0 / 20.0) * 10.0 / spacing, rtol=0.15)


def test_the_edge_and_holes_take_the_patchs_own_slope() -> None:
    one = grid(slopes=(0.1, 0.0))
    radii = one.radii.copy()
    radii[10, 10] = np.nan
    holed = replace(one, radii=radii)
    longitude = one.first_longitude + np.array([0.5, 11.5, 9.5]) * STEP
    latitude = one.first_latitude - np.array([0.5, 10.5, 9.5]) * STEP
    rise = holed.rise(longitude, latitude)
    np.testing.assert_allclose(rise[:2], 0.1, rtol=5e-3)
    assert np.isnan(rise[2])


def test_posts_may_have_sigmas_of_their_own() -> None:
    one = grid()
    sigmas = np.linspace(5.0, 50.0, one.radii.size).reshape(one.radii.shape)
    own = replace(one, post_sigmas=sigmas)
    points = inside(one, 20)
    found = own.height_sigmas(points, True)
    assert found.min() > 5.0
    np.testing.assert_allclose(found, replace(one, radii=sigmas, kind="topography").at(points), rtol=1e-6)
    cut = own.around(points[:3], margin=1)
    assert cut.radii.size < own.radii.size
    np.testing.assert_allclose(cut.height_sigmas(points[:3], True), found[:3], rtol=1e-6)
    with pytest.raises(InputError, match="sigmas of the posts"):
        replace(one, post_sigmas=sigmas[1:])
    with pytest.raises(InputError, match="sigmas of the posts"):
        replace(one, post_sigmas=sigmas - 5.0)


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
    turn = [
        TerrainGrid("turn", np.full((3, 180), RADIUS + k), k * np.pi, 0.0, np.pi / 180.0, DEG) for k in range(2)
    ]
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
    with pytest.raises(InputError, match="heights above the areoid"):
        above_areoid(grid(), areoid)
    with pytest.raises(InputError, match="areoid's radius"):
        above_areoid(heights, grid())
