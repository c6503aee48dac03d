"""Grids made of others, and what a grid says of its own sigma and reach."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
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
        with pytest.raises(InputError, match="gaps between tracks"):
            replace(one, gaps=Gaps(wrong, between))


def test_points_in_one_gap_are_worth_no_more_than_one_height() -> None:
    """Points in pairs 1 km apart: each pair shares its posts, and all of them the error between two tracks."""
    one = grid()
    own = replace(one, gaps=Gaps(np.full(one.radii.shape, 30.0), np.full(one.radii.shape, 1e6)))
    apart = 20.0 * STEP * np.arange(1.0, 4.0)[:, None] / 20.0 + [0.0, 1e-6]
    longitude = one.first_longitude + 10.0 * STEP + apart.ravel()
    points = from_planetocentric(np.column_stack([longitude, np.full((6, 2), [9.9 * DEG, RADIUS])]))
    assert one.control_sigmas(points) == pytest.approx(np.full(6, 10.0 * 2**0.5))
    assert own.control_sigmas(points) ** 2 == pytest.approx(np.full(6, 2.0 * 10.0**2 + 6.0 * 30.0**2))


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
