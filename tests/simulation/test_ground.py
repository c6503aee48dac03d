"""The simulated ground: smooth, the same for the same seed, met by rays where it is, as high as the real sites;
pictures of it, by Lambert's law at the places that the pixels see.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.simulation import relief
from mgsgraph.simulation.ground import SITES, PeriodicSurface, SiteTerrain, grid_shift, make_terrain, terrain_grid
from mgsgraph.simulation.imagery import NOISE, Picture, local_sun, render
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.units import DEG


# a site's ground takes a second or two, and two are kept: where it is another's turn it is made anew
@pytest.fixture(scope="module", params=sorted(SITES))
def site(request: pytest.FixtureRequest) -> SiteTerrain:
    return make_terrain(request.param, 1)


def places(site: SiteTerrain, count: int, seed: int = 0, reach: float = 0.4 * DEG) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return site.centre_lon + rng.uniform(-reach, reach, count), site.centre_lat + rng.uniform(-reach, reach, count)


def looks(site: SiteTerrain, count: int, tilt: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from 400 km up that look down within `tilt` rad of nadir at places about the site."""
    rng = np.random.default_rng(seed)
    lon, lat = places(site, count, seed)
    target = from_planetocentric(np.column_stack([lon, lat, np.full(count, 3.39e6)]))
    outward = target / np.linalg.norm(target, axis=1, keepdims=True)
    aside = np.cross(outward, rng.standard_normal((count, 3)))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angle = rng.uniform(0.0, tilt, (count, 1))
    away = np.cos(angle) * outward + np.sin(angle) * aside
    return target + 4e5 * away, -away * rng.uniform(0.5, 2.0, (count, 1))


@given(st.integers(0, 1000), st.sampled_from([np.float32, np.float64]))
@settings(max_examples=20, deadline=None)
def test_surface_repeats_itself_and_has_the_slopes_it_says(seed: int, kind: type) -> None:
    rng = np.random.default_rng(seed)
    surface = PeriodicSurface(3.0, rng.standard_normal((16, 8)).astype(np.float32))
    east, north = rng.uniform(-100.0, 100.0, (2, 50)).astype(kind)
    value, by_east, by_north = surface.at(east, north)
    assert value.dtype == by_east.dtype == kind
    assert surface.period == (24.0, 48.0)
    np.testing.assert_allclose(surface.value(east, north), value, atol=1e-5)
    np.testing.assert_allclose(surface.value(east + kind(24.0), north - kind(96.0)), value, atol=2e-4)
    step, exact = 1e-4, (east.astype(np.float64), north.astype(np.float64))
    slope = (surface.value(exact[0] + step, exact[1]) - surface.value(exact[0] - step, exact[1])) / (2.0 * step)
    np.testing.assert_allclose(by_east, slope, atol=2e-4)
    slope = (surface.value(exact[0], exact[1] + step) - surface.value(exact[0], exact[1] - step)) / (2.0 * step)
    np.testing.assert_allclose(by_north, slope, atol=2e-4)


def test_same_seed_same_ground() -> None:
    site, again = make_terrain("gusev", 1), make_terrain.__wrapped__("gusev", 1)  # not the one that is kept
    lon, lat = places(site, 1000)
    np.testing.assert_array_equal(again.height(lon, lat), site.height(lon, lat))


def test_normals_are_those_of_the_ground(site: SiteTerrain) -> None:
    lon, lat = places(site, 200)
    step = 1e-9  # 3 mm
    east = site.on_ground(lon + step, lat) - site.on_ground(lon - step, lat)
    north = site.on_ground(lon, lat + step) - site.on_ground(lon, lat - step)
    expected = np.cross(east, north)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(site.normal(1.01 * site.on_ground(lon, lat)), expected, atol=3e-3)
    np.testing.assert_allclose(np.median(np.abs(site.normal(site.on_ground(lon, lat)) - expected)), 0.0, atol=1e-5)


def test_rays_meet_the_ground(site: SiteTerrain) -> None:
    origins, directions = looks(site, 5000, 25.0 * DEG)
    points = site.intersect(origins, directions)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), site.radius(points), atol=1e-4)
    way = points - origins
    off = np.linalg.norm(np.cross(way, directions), axis=1) / np.linalg.norm(directions, axis=1)
    assert off.max() < 1e-6
    assert np.einsum("ni,ni->n", way, directions).min() > 0.0


def test_the_place_a_ray_meets_is_the_first(site: SiteTerrain) -> None:
    """All the way down to it the ray is above the ground."""
    origins, directions = looks(site, 300, 25.0 * DEG, seed=3)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = site.intersect(origins, directions)
    for before in np.geomspace(2.0, 2e4, 60):
        above = points - before * unit
        assert np.all(np.linalg.norm(above, axis=1) > site.radius(above))


def test_a_ray_past_the_body_meets_nothing(site: SiteTerrain) -> None:
    origins, directions = looks(site, 3, 0.1)
    directions[1] = -directions[1]
    points = site.intersect(origins, directions)
    assert np.isnan(points[1]).all()
    assert np.isfinite(points[[0, 2]]).all()


def test_sites_lie_as_high_as_the_real_ones(site: SiteTerrain, shared_data: Path) -> None:
    """MOLA grids, 4 posts per degree: radius at the centre, and the areoid as radius minus topography."""
    grids = [
        np.fromfile(shared_data / "mola_megdr" / name, ">i2").reshape(720, 1440).astype(np.float64)
        for name in ("megr90n000cb.img", "megt90n000cb.img")
    ]
    row, column = int((90.0 - site.centre_lat / DEG) * 4.0), int(site.centre_lon / DEG * 4.0)
    patch = (slice(row - 1, row + 2), slice(column - 1, column + 2))
    radius, areoid = grids[0][patch] + 3396e3, grids[0][patch] - grids[1][patch] + 3396e3
    lon, lat = np.array([site.centre_lon]), np.array([site.centre_lat])
    assert radius.min() - 150.0 < site.ground_radius(lon, lat)[0] < radius.max() + 150.0
    assert abs(site.areoid_radius(lon, lat)[0] - np.median(areoid)) < 150.0


def test_relief_is_the_site_s(site: SiteTerrain) -> None:
    lon, lat = places(site, 20000)
    low, high = np.quantile(site.height(lon, lat), [0.001, 0.999])
    upward = np.einsum("ni,ni->n", site.normal(site.on_ground(lon, lat)), _up(lon, lat))
    slopes = np.degrees(np.arccos(np.clip(upward, -1.0, 1.0)))
    if site.site == "eos":
        assert 2500.0 < high - low < 4500.0
    else:
        assert 50.0 < high - low < 700.0
    assert np.quantile(slopes, 0.5) < 12.0
    assert np.quantile(slopes, 0.9999) < 45.0


def _up(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    return from_planetocentric(np.column_stack([lon, lat, np.ones(lon.size)]))


def test_craters_are_a_fifth_as_deep_as_wide() -> None:
    """Fresh ones, from the rim's crest to the floor, the rim above the plain."""
    field = np.zeros((256, 256), dtype=np.float32)
    relief.add_craters(field, 10.0, 10.0, (400.0, 500.0), np.random.default_rng(2))
    assert -2.0 * 0.2 * 500.0 < field.min() < -0.2 * 0.2 * 400.0 * (1.0 - 0.2)  # two of them may fall on one another
    assert 0.2 * 0.2 * 400.0 * 0.2 < field.max() < 2.0 * 0.2 * 0.2 * 500.0


def test_grid_is_the_ground_shifted_with_noise() -> None:
    site = make_terrain("eos", 1)
    grid = terrain_grid(site, 128)
    shift = grid_shift(site)
    assert 0.0 < np.hypot(*shift) < 900.0
    assert np.all(np.abs(np.remainder(grid.first_longitude / DEG * 128.0, 1.0) - 0.5) < 1e-6)
    lon, lat = places(site, 5000, reach=0.25 * DEG)
    off_lon, off_lat = shift / site.metres_per_radian
    values, by_lon, by_lat = grid.radius(lon, lat)
    steep = np.hypot(*np.column_stack([by_lon, by_lat]).T / site.metres_per_radian[:, None]) > 0.1  # the canyon's walls
    places_of = {"moved": (lon - off_lon, lat - off_lat), "unmoved": (lon, lat), "back": (lon + off_lon, lat + off_lat)}
    off = {name: np.median(np.abs(values - site.ground_radius(*at))[steep]) for name, at in places_of.items()}
    assert off["moved"] < 15.0  # 10 m of noise, averaged between posts, and what 460 m posts miss of the relief
    assert off["back"] > 1.5 * off["unmoved"] > 2.0 * off["moved"]


def test_grid_s_noise_is_what_it_says() -> None:
    site = make_terrain("isidis", 1)
    grid = terrain_grid(site, 64, reach=(40e3, 40e3))
    rows, columns = grid.radii.shape
    lon, lat = np.meshgrid(
        grid.first_longitude + grid.longitude_step * np.arange(columns),
        grid.first_latitude - grid.latitude_step * np.arange(rows),
    )
    off_lon, off_lat = grid_shift(site) / site.metres_per_radian
    error = grid.radii.ravel() - site.ground_radius(lon.ravel() - off_lon, lat.ravel() - off_lat)
    spread = 1.4826 * np.median(np.abs(error - np.median(error)))
    assert spread == pytest.approx(10.0, rel=0.25)
    np.testing.assert_array_equal(terrain_grid(site, 64, reach=(40e3, 40e3)).radii, grid.radii)


def test_grid_encloses_its_reach() -> None:
    site = make_terrain("gusev", 1)
    grid = terrain_grid(site, 16, reach=(10e3, 30e3))
    for east, north in ((-10e3, -30e3), (10e3, 30e3)):
        lon, lat = np.array([east, north]) / site.metres_per_radian + (site.centre_lon, site.centre_lat)
        assert np.isfinite(grid.radius(np.array([lon]), np.array([lat]))[0]).all()
    refuses("posts per degree", terrain_grid, site, 0)


# --- pictures


# not multiples of the distance between nodes
PAIR = simulate_pair(PairSettings(lines=2011, samples=701, ties=5, shots=5), seed=1)

TURNED = OrientationCorrection(np.array([[30.0, -20.0, 10.0, 2e-4, -3e-4, 1e-3]]))


def sun_over(image: PushbroomImage, incidence: float, azimuth: float) -> np.ndarray:
    """Direction to the Sun (azimuth from east to north) seen from the image's middle."""
    middle, _ = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    up = middle[0] / np.linalg.norm(middle)
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    aside = np.cos(azimuth) * east + np.sin(azimuth) * np.cross(up, east)
    return np.cos(incidence) * up + np.sin(incidence) * aside


def picture(image: PushbroomImage, site: SiteTerrain, sun: np.ndarray, seed: int = 0) -> Picture:
    return render(image, site, TURNED, sun, np.random.default_rng(seed))


@pytest.mark.parametrize(("name", "image"), [*zip(("eos", "isidis"), PAIR.images, strict=True)])
def test_pixels_show_the_ground_they_look_at(name: str, image: PushbroomImage) -> None:
    """Each pixel's ray, met exactly with the ground, its normal and the soil there, against the picture."""
    site, sun = make_terrain(name, 1), sun_over(image, 0.9, 0.3)
    grey = picture(image, site, sun)
    assert grey.shape == (image.lines, image.samples)
    rng = np.random.default_rng(5)
    line, sample = rng.integers(0, image.lines, 4000), rng.integers(0, image.samples, 4000)
    origins, directions, _, _ = image.rays(line + 0.5, sample + 0.5, TURNED)
    points = site.intersect(origins, directions)
    lon, lat, _ = planetocentric(points).T
    facing = np.maximum(site.normal(points) @ sun, 0.0) / np.cos(0.9)
    off = grey[line, sample] - (10.0 + 110.0 * site.albedo(*site.chart(lon, lat)) * facing)
    assert 1.4826 * np.median(np.abs(off)) == pytest.approx(np.hypot(NOISE, 12**-0.5), rel=0.1)
    assert abs(np.median(off)) < 0.3
    assert np.quantile(np.abs(off), 0.99) < 8.0  # small craters on slopes, between nodes
    assert np.corrcoef(facing, grey[line, sample])[0, 1] > 0.7


def test_same_arguments_give_the_same_bytes() -> None:
    image, site = replace(PAIR.images[1], lines=301), make_terrain("gusev", 1)
    sun = sun_over(image, 0.9, 0.3)
    first = picture(image, site, sun)
    assert picture(image, site, sun).tobytes() == first.tobytes()
    noise = picture(image, site, sun, seed=1).astype(float) - first
    assert np.std(noise) == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.1)


def test_a_sun_below_the_horizon_is_refused() -> None:
    image = PAIR.images[0]
    with pytest.raises(InputError, match=f"picture of {image.name}: the Sun below the horizon"):
        picture(image, make_terrain("gusev", 1), sun_over(image, 1.6, 0.3))


def test_east_is_where_longitudes_grow() -> None:
    """The local Sun's east, north and up against body-fixed places."""
    site = make_terrain("gusev", 1)
    lon, lat = np.array([site.centre_lon]), np.array([site.centre_lat])
    point = site.on_ground(lon, lat)[0]
    places = np.array([[lon[0], lat[0], 3.39e6], [lon[0] + 1e-4, lat[0], 3.39e6], [lon[0], lat[0] + 1e-4, 3.39e6]])
    corners = from_planetocentric(places)
    for axis, direction in enumerate((corners[1] - corners[0], corners[2] - corners[0], corners[0])):
        local = local_sun(point, site, direction / np.linalg.norm(direction))
        np.testing.assert_allclose(local, np.eye(3)[axis], atol=5e-3)  # the regional level tilts by 1 in 400
