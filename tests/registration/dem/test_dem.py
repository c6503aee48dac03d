"""Terrain models: points and their covariance, the map against PROJ, heights and sigmas of posts against the truth."""

from dataclasses import replace

import dem_site
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses
from rasterio.warp import transform

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid, east_north_up, from_planetocentric, planetocentric
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.network import ImageRays
from mgsgraph.registration.dem.gridding import DensePoints, HeightGrid, MapGrid, bilinear, gridded, intersected
from mgsgraph.registration.dem.ortho import ortho_accuracy

MARS = Ellipsoid(3396190.0, 3376200.0)
RNG_SEED = 7


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


# ---- points


# above two seconds: adjusts the site, once for all tests of the run
def test_points_lie_where_the_matches_were_made() -> None:
    matches = dem_site.matched(None)
    points = intersected(dem_site.posterior(), dem_site.scene(), [matches])
    true = dem_site.ground(dem_site.scene().pictures[0], matches.anchors)
    np.testing.assert_allclose(points.positions, true, atol=1e-4)
    assert np.abs(points.misses).max() < 1e-4
    empty = {name: getattr(matches, name)[:0] for name in ("anchors", "pixels", "covariances")}
    with pytest.raises(InputError, match="no matches: nothing to make a terrain model from"):
        intersected(dem_site.posterior(), dem_site.scene(), [replace(matches, **empty)])


def test_errors_of_points_are_along_the_first_ray_and_as_stated() -> None:
    matches = dem_site.matched(np.random.default_rng(RNG_SEED))
    points = intersected(dem_site.posterior(), dem_site.scene(), [matches])
    off = points.positions - dem_site.ground(dem_site.scene().pictures[0], matches.anchors)
    length = np.linalg.norm(points.matching, axis=1)
    along = np.einsum("ni,ni->n", off, points.matching) / length
    np.testing.assert_allclose(off, along[:, None] * points.matching / length[:, None], atol=1e-6)
    assert rms(along / length) == pytest.approx(1.0, abs=0.03)
    assert rms(points.misses / points.miss_sigmas) == pytest.approx(1.0, abs=0.03)


def test_the_orientation_s_covariance_is_the_posterior_s() -> None:
    matches = dem_site.matched(None)
    points = intersected(dem_site.posterior(), dem_site.scene(), [matches])
    some = np.arange(0, len(points), 200)
    count = some.size
    places = np.stack([matches.anchors[some], matches.pixels[some]], axis=1).reshape(-1, 2)
    sigmas = np.tile([[1e-5], [1e-3]], (count, 2))
    rays = ImageRays(np.repeat(np.arange(count), 2), np.tile([0, 1], count), places, sigmas)
    _, exact = dem_site.posterior().intersections(rays)
    up = points.positions[some] / np.linalg.norm(points.positions[some], axis=1, keepdims=True)
    for vectors in (up, np.cross(up, [0.0, 0.0, 1.0])):
        ratio = np.einsum("ni,nij,nj->n", vectors, points.orientation[some], vectors)
        ratio /= np.einsum("ni,nij,nj->n", vectors, exact, vectors)
        np.testing.assert_allclose(ratio, 1.0, atol=0.03)


# ---- the map


@settings(max_examples=40, deadline=None)
@given(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), st.sampled_from([MARS, Ellipsoid(1737400.0, 1737400.0)]))
def test_the_map_is_proj_s(longitude: float, latitude: float, body: Ellipsoid) -> None:
    middle = from_planetocentric(np.array([[*np.radians([longitude, latitude]), body.equatorial - 3e3]]))
    around = middle + np.random.default_rng(1).normal(0.0, 2e4, (20, 3))
    grid = MapGrid.around(around, body, 50.0)
    lon, lat, _ = np.degrees(planetocentric(around)).T
    code = {3396190.0: "IAU_2015:49900", 1737400.0: "IAU_2015:30100"}[body.equatorial]
    x, y = transform(code, grid.crs, lon.tolist(), lat.tolist())
    np.testing.assert_allclose(grid.chart.plane(around), np.column_stack([x, y]), atol=2e-3)
    inside = grid.pixels(grid.chart.plane(around))
    assert np.all((inside > -0.51) & (inside < np.array([grid.rows, grid.columns]) - 0.49))


def test_posts_are_whole_multiples_and_north_is_up() -> None:
    middle = from_planetocentric(np.array([[3.0, -0.25, 3.393e6]]))
    grid = MapGrid.around(middle + np.random.default_rng(1).normal(0.0, 500.0, (50, 3)), MARS, 30.0)
    posts = grid.posts().reshape(grid.rows, grid.columns, 2)
    np.testing.assert_allclose(posts / 30.0, np.round(posts / 30.0), atol=1e-9)
    rows_columns = np.indices(posts.shape[:2]).reshape(2, -1).T
    np.testing.assert_allclose(grid.pixels(posts.reshape(-1, 2)), rows_columns, atol=1e-9)
    latitude = planetocentric(grid.points(posts.reshape(-1, 2), np.zeros(grid.rows * grid.columns)))[:, 1]
    assert np.all(np.diff(latitude.reshape(grid.rows, -1), axis=0) < 0.0)
    frames = grid.frames(middle)
    np.testing.assert_allclose(frames[0] @ frames[0].T, np.eye(3), atol=1e-12)
    refuses("give a larger --post", MapGrid.around, middle + np.array([[0.0], [8e5]]), MARS, 1.0)


def test_bilinear_is_exact_on_planes_and_knows_nothing_outside() -> None:
    row, column = np.mgrid[:5, :7].astype(float)
    values = 3.0 + 2.0 * row - column
    places = np.random.default_rng(1).uniform([0.0, 0.0], [4.0, 6.0], (50, 2))
    np.testing.assert_allclose(bilinear(values, places), 3.0 + 2.0 * places[:, 0] - places[:, 1])
    assert np.all(np.isnan(bilinear(values, np.array([[-0.1, 2.0], [4.1, 2.0], [2.0, 6.1], [np.nan, 0.0]]))))
    assert bilinear(values, np.array([[4.0, 6.0]]))[0] == 5.0
    values[2, 2] = np.nan
    assert np.isnan(bilinear(values, np.array([[1.5, 1.5]]))[0])


# ---- posts


def grid_of(rows: int = 60, columns: int = 50, post: float = 20.0) -> MapGrid:
    return MapGrid(175.3, -14.6, 3396190.0, -0.5 * columns * post, 0.5 * rows * post, post, rows, columns)


def points_over(
    grid: MapGrid, heights: np.ndarray, plane: np.ndarray, sigma: float, pair: np.ndarray | None = None
) -> DensePoints:
    """Points of level ground, seen from straight above, with an orientation sigma of 2 m."""
    places = grid.points(plane, heights)
    up = places / np.linalg.norm(places, axis=1, keepdims=True)
    nothing, n = np.zeros(len(places)), len(places)
    pair = np.zeros(n, dtype=np.int64) if pair is None else pair
    return DensePoints(places, sigma * up, np.broadcast_to(4.0 * np.eye(3), (n, 3, 3)), pair, nothing, nothing + 0.1)


def windowed(shape: tuple[int, int], width: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance whose correlation is the overlap of windows of `width` posts."""
    white = rng.standard_normal((shape[0] + width, shape[1] + width))
    return sum(white[i : i + shape[0], j : j + shape[1]] for i in range(width) for j in range(width)) / width


@pytest.mark.parametrize("width", [1, 4])
def test_sigmas_are_those_of_correlated_errors(width: int) -> None:
    """Of windows that overlap, and of such that don't: rms over stated sigma."""
    grid, rng = grid_of(120, 100), np.random.default_rng(3)
    noise = windowed((grid.rows, grid.columns), width, rng).ravel()
    plane = grid.posts()
    points = points_over(grid, -2500.0 + plane @ [0.05, -0.02] + noise, plane, 1.0)
    model = gridded(points, grid, grid.post, width * grid.post)
    off = model.heights.ravel() - (-2500.0 + plane @ [0.05, -0.02])
    assert 0.85 < rms(off / model.matching.ravel()) < 1.15
    if width > 1:
        assert np.nanmedian(model.matching) > 0.8  # not divided by the root of seven points


def test_relief_between_points_is_in_the_sigma() -> None:
    grid, rng = grid_of(120, 100), np.random.default_rng(3)
    plane = grid.posts() + rng.uniform(-8.0, 8.0, (grid.rows * grid.columns, 2))
    rough = 5.0 * rng.standard_normal(len(plane))
    model = gridded(points_over(grid, -2500.0 + rough, plane, 0.1), grid, grid.post, 4.0 * grid.post)
    assert np.nanmedian(model.matching) == pytest.approx(5.0, rel=0.35)


def test_bands_add_up_and_orientation_does_not_average_out() -> None:
    grid = grid_of()
    model = gridded(points_over(grid, np.full(3000, -2500.0), grid.posts(), 1.0), grid, grid.post, 80.0)
    there = np.isfinite(model.heights)
    np.testing.assert_allclose(model.sigmas[there] ** 2, model.matching[there] ** 2 + model.orientation[there] ** 2)
    np.testing.assert_allclose(model.orientation[there], 2.0, rtol=1e-6)
    np.testing.assert_allclose(model.heights[there], -2500.0, atol=1e-6)


def test_a_slope_makes_a_horizontal_error_one_of_height() -> None:
    grid = grid_of()
    plane = grid.posts()
    points = points_over(grid, -2500.0 + 0.5 * plane[:, 0], plane, 1.0)
    frames = grid.frames(points.positions)
    points = replace(points, matching=np.asarray(frames[:, 0] * 3.0 + frames[:, 2] * 1e-3))  # 3 m eastward
    model = gridded(points, grid, grid.post, 1e6)
    assert np.nanmedian(model.matching) == pytest.approx(1.5, rel=0.01)
    assert np.nanmedian(model.orientation) == pytest.approx(2.0 * np.sqrt(1.25), rel=0.01)


def test_single_outliers_count_for_nothing() -> None:
    grid, rng = grid_of(), np.random.default_rng(3)
    heights = -2500.0 + 0.1 * rng.standard_normal(3000)
    clean = gridded(points_over(grid, heights, grid.posts(), 0.2), grid, grid.post, 1e-3)
    wrong = heights.copy()
    wrong[np.ravel_multi_index([[10, 20, 40], [10, 30, 25]], (60, 50))] += [30.0, -200.0, 1e4]
    model = gridded(points_over(grid, wrong, grid.posts(), 0.2), grid, grid.post, 1e-3)
    assert np.nanmax(np.abs(model.heights - clean.heights)) < 0.5
    assert model.counts[20, 30] == clean.counts[20, 30] - 1


def test_nothing_is_extrapolated() -> None:
    """A hole, a far rim, and posts that have points on one side only."""
    grid = grid_of()
    plane = grid.posts()
    kept = (np.abs(plane[:, 0]) < 300.0) & (np.hypot(*plane.T) > 100.0)
    model = gridded(points_over(grid, np.full(kept.sum(), -2500.0), plane[kept] + 7.0, 1.0), grid, grid.post, 80.0)
    there = np.isfinite(model.heights).ravel()
    nearest = np.array([np.hypot(*(plane[kept] + 7.0 - one).T).min() for one in plane])
    assert not np.any(there[nearest > 1.5 * grid.post])
    assert not np.any(there[plane[:, 0] > 307.0])
    assert not np.any(there[plane[:, 0] < -294.0])
    assert np.all(there[(np.abs(plane[:, 0]) < 260.0) & (np.abs(plane[:, 1]) < 560.0) & (np.hypot(*plane.T) > 160.0)])
    for band in (model.matching, model.orientation):
        assert np.array_equal(np.isfinite(band).ravel(), there)
    assert np.array_equal(model.counts.ravel() > 0, there)


def test_several_pairs_count_by_their_weight() -> None:
    grid = grid_of()
    plane = np.concatenate([grid.posts(), grid.posts() + 3.0])
    heights = np.repeat([-2500.0, -2501.0], 3000)
    points = points_over(grid, heights, plane, 1.0, np.repeat([0, 1], 3000))
    sigma = np.repeat([1.0, 2.0], 3000)
    model = gridded(replace(points, matching=points.matching * sigma[:, None]), grid, grid.post, 1e6)
    assert np.nanmedian(model.heights) == pytest.approx(-2500.2, abs=0.02)
    # 0.8 and 0.2 of two errors that have nothing in common, and the metre between them as scatter
    assert np.hypot(0.8, 0.4) < np.nanmedian(model.matching) < 1.2


def test_posts_of_their_own_spacing() -> None:
    """Finer and coarser than the matches: heights are those at the posts, not of the ground in between."""
    matches = dem_site.matched(np.random.default_rng(2))
    points = intersected(dem_site.posterior(), dem_site.scene(), [matches])
    for post in (12.0, 90.0, 200.0):
        grid = MapGrid.around(points.positions, MARS, post)
        model = gridded(points, grid, 20.0, 1e-3)
        assert np.isfinite(model.heights).sum() * post**2 > 4e6
        flat = np.abs(np.nan_to_num(model.slopes, nan=9.0)).max(axis=2) < 0.2
        ratio = (model.heights - dem_site.true_heights(grid))[flat] / model.matching[flat]
        assert 0.7 < rms(ratio) < 1.2, post


@pytest.mark.parametrize("first", [0, 1])
def test_heights_are_within_their_sigmas_of_the_truth(first: int) -> None:
    """Rays of the adjusted images over the true ground, noise of the covariance that is stated."""
    matches = dem_site.matched(np.random.default_rng(RNG_SEED), first)
    points = intersected(dem_site.posterior(), dem_site.scene(), [matches])
    grid = MapGrid.around(points.positions, MARS, 20.0)
    model: HeightGrid = gridded(points, grid, 20.0, 1e-3)
    off = model.heights - dem_site.true_heights(grid)
    assert np.isfinite(off).mean() > 0.5
    assert 0.7 < rms(off / model.matching) < 1.3


# ---- positions in the ortho image


@pytest.mark.parametrize("first", [0, 1])
def test_positions_in_the_ortho_image_scatter_as_stated(first: int) -> None:
    """With 400 draws of both orientations; and as rays meet a model that is a metre too high."""
    matches, posterior, scene = dem_site.matched(None, first), dem_site.posterior(), dem_site.scene()
    points = intersected(posterior, scene, [matches])
    model = gridded(points, MapGrid.around(points.positions, MARS, 20.0), 20.0, 1e-3)
    heights, some = model.heights, np.flatnonzero(np.isfinite(model.slopes).all(axis=2))[::1400]
    ground = model.map.points(model.map.posts()[some], heights.ravel()[some])
    level, pixels = east_north_up(ground)[:, :2], [picture.project(ground) for picture in scene.pictures]
    by_orientation, by_height = (
        ortho_accuracy(posterior, scene, matches, replace(model, matching=np.full_like(heights, error)))
        .reshape(3, -1)[:, some] for error in (0.0, 1e6)
    )  # fmt: skip
    joint, rng, off = dem_site.solution().joint_covariance.of([0, 1]), np.random.default_rng(5), []
    for draw in rng.multivariate_normal(np.zeros(len(joint)), joint, 400):
        parts = np.split(draw, [dem_site.solution().coefficients[0].size])
        (a, u), (b, v) = (
            scene.pictures[j].image.sightlines(*pixels[j].T, OrientationCorrection(c + parts[j].reshape(c.shape)))
            for j in (first, 1 - first) for c in [dem_site.solution().coefficients[j]]
        )  # fmt: skip
        t = (np.linalg.pinv(np.stack([u, -v], axis=2)) @ (b - a)[:, :, None])[:, 0]
        off.append(np.einsum("nij,nj->ni", level, a + t * u - ground))
    np.testing.assert_allclose(np.std(off, axis=0).T / by_orientation[:2], 1.0, atol=0.12)
    correlation = np.mean(np.prod(off, axis=2), axis=0) / np.std(off, axis=0).prod(axis=1)
    np.testing.assert_allclose(correlation, by_orientation[2], atol=0.12)
    _, along = scene.pictures[first].image.sightlines(*pixels[first].T, scene.pictures[first].correction)
    met, along = ground, along / np.linalg.norm(along, axis=1, keepdims=True)
    for _ in range(20):
        higher = bilinear(heights, model.map.pixels(model.map.chart.plane(met))) + 1.0 + model.map.radius
        step = (higher - np.linalg.norm(met, axis=1)) / np.einsum("ni,ni->n", along, east_north_up(met)[:, 2])
        met = met + step[:, None] * along
    moved = np.abs(np.einsum("nij,nj->in", level, met - ground))
    inside = np.isfinite(moved[0])  # not at the rim, where the ray leaves the model
    assert (inside.sum() > 7, moved[:, inside].max() > (0.003, 0.2)[first]) == (True, True)
    np.testing.assert_allclose(by_height[:2, inside] / 1e6, moved[:, inside], atol=0.1 * moved[:, inside].max())
