"""Terrain grids: exact on bilinear ground, derivatives against differences, distances along the normal."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses
from scipy.ndimage import map_coordinates
from strategies import differences

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.terrain import TerrainGrid, areoid_grid, areoid_heights
from mgsgraph.network import Surface
from mgsgraph.network.common import common_heights

DEG = np.pi / 180.0
STEP = DEG / 16.0
RADIUS = 3390e3


def rough(seed: int = 1, rows: int = 40, columns: int = 50, wraps: bool = False, **changed: object) -> TerrainGrid:
    heights = np.random.default_rng(seed).normal(0.0, 300.0, (rows, columns))
    step = 2.0 * np.pi / columns if wraps else STEP
    settings: dict[str, object] = {
        "source": "made up", "radii": RADIUS + heights, "first_longitude": 175.0 * DEG, "first_latitude": -14.0 * DEG,
        "longitude_step": step, "latitude_step": STEP, "wraps": wraps,
    }
    return TerrainGrid(**(settings | changed))  # type: ignore[arg-type]


inner = st.floats(0.01, 0.99)
cells = st.tuples(st.integers(0, 38), st.integers(0, 48))


@given(cells, inner, inner)
def test_bilinear_between_the_posts(cell: tuple[int, int], s: float, e: float) -> None:
    grid, (i, j) = rough(), cell
    value, _, _ = grid.radius(
        np.array([grid.first_longitude + (j + e) * STEP]), np.array([grid.first_latitude - (i + s) * STEP])
    )
    posts = grid.radii[i : i + 2, j : j + 2]
    want = np.array([1 - s, s]) @ posts @ np.array([1 - e, e])
    np.testing.assert_allclose(value, want, rtol=0, atol=1e-5)


@given(cells, inner, inner)
def test_derivatives_against_differences(cell: tuple[int, int], s: float, e: float) -> None:
    grid, (i, j) = rough(), cell
    place = np.array([grid.first_longitude + (j + e) * STEP, grid.first_latitude - (i + s) * STEP])
    _, by_longitude, by_latitude = grid.radius(place[:1], place[1:])
    numeric = differences(lambda at: grid.radius(at[:1], at[1:])[0], place, 0.002 * STEP)[0]
    # differences of radii of 3.4e6 m over 4e-6 rad: 1e-9 m of rounding is 1e-3 m/rad in 1e6
    np.testing.assert_allclose([by_longitude[0], by_latitude[0]], numeric, rtol=0, atol=0.1)


@given(cells, inner, inner, st.floats(-400.0, 400.0))
def test_surface_row_derivative(cell: tuple[int, int], s: float, e: float, above: float) -> None:
    """Also where the differences reach over the edge of a cell: the derivative is continuous."""
    grid, (i, j) = rough(), cell
    place = np.array([[grid.first_longitude + (j + e) * STEP, grid.first_latitude - (i + s) * STEP]])
    radius, _, _ = grid.radius(place[:, 0], place[:, 1])
    point = from_planetocentric(np.column_stack([place, radius + above]))[0]
    _, jacobian = grid.height_above(point[None])
    numeric = differences(lambda at: grid.spline().height_above(at[None])[0], point, 5.0)[0]
    np.testing.assert_allclose(jacobian[0], numeric, rtol=0, atol=1e-5)


@given(cells, inner, inner, st.floats(-2.0, 2.0))
def test_height_is_the_distance_along_the_normal(cell: tuple[int, int], s: float, e: float, off: float) -> None:
    """A point moved off the surface along the derivative's direction is that far from it."""
    grid, (i, j) = rough(), cell
    place = np.array([[grid.first_longitude + (j + e) * STEP, grid.first_latitude - (i + s) * STEP]])
    foot = from_planetocentric(np.column_stack([place, grid.radius(place[:, 0], place[:, 1])[0]]))
    for _ in range(8):
        zero, normal = grid.height_above(foot)
        foot -= zero[:, None] * normal
    zero, normal = grid.height_above(foot)
    height, _ = grid.height_above(foot + off * normal)

    np.testing.assert_allclose(zero, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(height, off, rtol=0, atol=2e-3)


@given(st.floats(-10.0, 10.0), st.floats(0.0, 0.999))
def test_wrapping_has_no_seam(turns: float, share: float) -> None:
    grid = rough(wraps=True)
    turn = 2.0 * np.pi * np.floor(turns)
    last = grid.first_longitude + (49.0 + share) * grid.longitude_step
    latitude = np.full(1, grid.first_latitude - 3.0 * STEP)
    value, _, _ = grid.radius(np.array([last + turn]), latitude)
    want = (1.0 - share) * grid.radii[3, 49] + share * grid.radii[3, 0]

    np.testing.assert_allclose(value, want, rtol=0, atol=1e-4)


def test_nothing_outside_and_beside_missing_posts() -> None:
    heights = np.full((5, 6), RADIUS)
    heights[2, 2] = np.nan
    grid = rough(radii=heights)
    longitudes = grid.first_longitude + STEP * np.array([-0.01, 0.0, 5.0, 5.01, 1.5, 3.5, 2.5])
    latitudes = grid.first_latitude - STEP * np.array([1.0, 0.0, 4.0, 1.0, 1.5, 1.5, 4.01])
    value, by_longitude, by_latitude = grid.radius(longitudes, latitudes)

    expected = [False, True, True, False, False, True, False]
    for one in (value, by_longitude, by_latitude):
        assert np.isfinite(one).tolist() == expected
    height, jacobian = grid.height_above(from_planetocentric(np.array([[0.1, 0.2, RADIUS]])))
    assert np.isnan(height[0])
    assert np.all(np.isnan(jacobian))


def test_longitudes_of_any_turn() -> None:
    grid = rough()
    latitude = np.full(3, grid.first_latitude - 3.3 * STEP)
    longitude = 176.234 * DEG
    values, _, _ = grid.radius(longitude + 2.0 * np.pi * np.array([-1.0, 0.0, 1.0]), latitude)
    np.testing.assert_allclose(values, values[1], rtol=0, atol=1e-5)


def test_areoid_from_two_grids() -> None:
    topography = np.random.default_rng(3).normal(-2000.0, 100.0, (40, 50))
    areoid = 3392e3 + np.arange(50.0) * np.ones((40, 1))
    radius = rough(radii=areoid + topography)
    found = areoid_grid(radius, rough(radii=topography, kind="topography"))
    point = from_planetocentric(np.array([[175.0 * DEG + 3.5 * STEP, -14.0 * DEG - 2.5 * STEP, 3390e3]]))

    assert found.kind == "areoid"
    np.testing.assert_allclose(found.at(point), 3392003.5)
    np.testing.assert_allclose(areoid_heights(point, found), -2003.5)
    refuses("radius and topography", areoid_grid, radius, radius)
    with pytest.raises(InputError, match="different posts"):
        areoid_grid(radius, rough(radii=topography, kind="topography", first_latitude=-13.0 * DEG))
    refuses("areoid's radius", areoid_heights, point, radius)
    refuses("grid of radius", found.height_above, point)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"radii": np.full((4, 4), -1900.0)}, "positive"),
        ({"first_latitude": -89.9 * DEG}, "latitudes"),
        ({"longitude_step": 10.0 * DEG}, "at most one"),
    ],
)
def test_what_is_no_terrain(changed: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        rough(**changed)  # type: ignore[arg-type]


@pytest.mark.parametrize("wraps", [False, True])
def test_the_part_around_points_says_the_same(wraps: bool) -> None:
    grid = rough(rows=60, columns=80, wraps=wraps)
    rng = np.random.default_rng(2)
    places = np.stack(
        [
            grid.first_longitude + grid.longitude_step * rng.uniform(20.0, 30.0, 9),
            grid.first_latitude - grid.latitude_step * rng.uniform(30.0, 35.0, 9),
            np.full(9, RADIUS),
        ],
        axis=1,
    )
    points = from_planetocentric(places)
    part = grid.around(points)
    assert part.radii.size < grid.radii.size / 4
    np.testing.assert_allclose(part.height_above(points)[0], grid.height_above(points)[0], atol=1e-6)


def test_a_part_across_the_seam_is_cut_from_both_sides() -> None:
    grid = rough(rows=60, columns=80, wraps=True)
    step = grid.longitude_step
    middle = grid.first_latitude - 30.5 * grid.latitude_step
    places = np.array([[grid.first_longitude + turn, middle, RADIUS] for turn in (-step, step)])
    points = from_planetocentric(places)
    part = grid.around(points)
    assert part.radii.shape[1] <= 20
    assert not part.wraps
    np.testing.assert_allclose(part.at(points), grid.at(points), atol=1e-6)


@pytest.mark.parametrize("pole", [-1, 1])
@pytest.mark.parametrize("turn", [0, 7])
def test_the_part_around_a_pole_has_all_columns_and_the_rows_up_to_it(pole: int, turn: int) -> None:
    """The places are corners of a square around the pole: what is kept holds all that lies in the square."""
    places = {"first_longitude": 0.5 * turn * DEG, "first_latitude": 89.5 * DEG, "latitude_step": 0.5 * DEG}
    grid = rough(rows=359, columns=720, wraps=True, **places)
    across, along = np.meshgrid(np.linspace(-0.12, 0.06, 37), np.linspace(-0.13, 0.2, 37))
    inside = RADIUS * np.column_stack([across.ravel(), along.ravel(), np.full(across.size, float(pole))])
    part = grid.around(inside[[0, 36, -37, -1]])
    assert part.radii.shape[1] == 720
    assert part.radii.shape[0] < 40
    assert grid.holds(inside).mean() > 0.9
    assert np.array_equal(part.holds(inside), grid.holds(inside))


def test_the_surface_is_scipys_b_spline() -> None:
    """That of SciPy's images, with the posts as coefficients."""
    grid, rng = rough(), np.random.default_rng(8)
    row, column = rng.uniform(3.0, 36.0, 50), rng.uniform(3.0, 46.0, 50)
    radii = map_coordinates(grid.radii, [row, column], order=3, prefilter=False)
    np.testing.assert_allclose(grid.height_above(grid.points(row, column, radii))[0], 0.0, atol=1e-5)


def test_points_that_share_posts_share_their_errors() -> None:
    """One sigma for each by itself, twice that for four in a place or four for each post, wherever the posts are."""
    grid = rough(vertical_sigma=10.0)

    def independent(points: np.ndarray) -> np.ndarray:
        surface, common = common_heights(Surface(grid, grid.height_sigmas(points)), points)
        assert common is not None
        sigmas = surface.sigmas.copy()
        sigmas[common.members] *= common.independent
        return sigmas

    row, column = np.array([5.0, 5.0, 5.0, 5.0, 9.5, 12.0, 12.0]), np.array([7.0, 7.0, 7.0, 7.0, 7.4, 20.0, 22.5])
    assert independent(grid.points(row, column, np.full(7, RADIUS))) == pytest.approx([20.0] * 4 + [10.0] * 3)
    even = np.meshgrid(np.arange(5.0, 25.0, 0.5), np.arange(5.0, 25.0, 0.5))
    points = grid.points(*(part.ravel() for part in even), np.full(1600, RADIUS))
    # a circle as large as a cell holds four or five of a lattice
    assert np.mean(independent(points) ** 2) == pytest.approx(400.0, rel=0.3)

