"""Pictures of the simulated ground: Lambert's law at the places that the pixels see."""

from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.simulation.ground import PeriodicSurface, SiteTerrain, make_terrain
from mgsgraph.simulation.imagery import NOISE, Picture, local_sun, render
from mgsgraph.simulation.pair import PairSettings, simulate_pair

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


def test_a_crater_is_lit_on_the_side_that_faces_the_sun() -> None:
    image, isidis = PAIR.images[0], make_terrain("isidis", 1)
    middle, _ = image.image_to_ground(
        np.array([0.5 * image.lines]), np.array([0.5 * image.samples]), isidis.ground.level, TURNED
    )
    east, north = isidis.chart(*planetocentric(middle)[:, :2].T)
    rows, columns = np.meshgrid(np.arange(256) * 16.0, np.arange(256) * 16.0, indexing="ij")
    distance = np.hypot(rows - 2048.0, columns - 2048.0) / 500.0
    bowl = 150.0 * (np.minimum(distance, 1.0) ** 2 - 1.0)
    flat = np.zeros((8, 8), dtype=np.float32)
    shift = (round(float(north[0]) / 16.0) - 128, round(float(east[0]) / 16.0) - 128)
    site = replace(
        isidis,
        waves=np.zeros((0, 4)),
        relief=PeriodicSurface(16.0, np.roll(bowl, shift, (0, 1)).astype(np.float32)),
        detail=PeriodicSurface(5.0, flat),
        brightness=PeriodicSurface(5.0, flat + 1.0),
    )
    half = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
    points = {}
    for direction, aside in (("east", (300.0, 0.0)), ("west", (-300.0, 0.0)), ("outside", (700.0, 700.0))):
        lon, lat = np.array([east[0] + aside[0], north[0] + aside[1]]) / site.metres_per_radian
        place = site.on_ground(np.array([site.centre_lon + lon]), np.array([site.centre_lat + lat]))
        found = image.ground_to_image(place, TURNED, half[0])[0][0]
        points[direction] = tuple(np.floor(found).astype(int))
    for azimuth, bright, dark in ((0.0, "west", "east"), (np.pi, "east", "west")):
        grey = picture(image, site, sun_over(image, 0.8, azimuth))
        seen = {k: grey[line - 3 : line + 4, s - 3 : s + 4].mean() for k, (line, s) in points.items()}
        assert seen[bright] > seen["outside"] + 20.0
        assert seen[dark] < seen["outside"] - 20.0
        assert seen["outside"] == pytest.approx(120.0, abs=2.0)


def test_same_arguments_give_the_same_bytes() -> None:
    image, site = PAIR.images[1], make_terrain("gusev", 1)
    sun = sun_over(image, 0.9, 0.3)
    first = picture(image, site, sun)
    assert picture(image, site, sun).tobytes() == first.tobytes()
    noise = picture(image, site, sun, seed=1).astype(float) - first
    assert np.std(noise) == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.1)


def test_a_sun_below_the_horizon_is_refused() -> None:
    image = PAIR.images[0]
    with pytest.raises(InputError, match=f"picture of {image.name}: the Sun below the horizon"):
        picture(image, make_terrain("gusev", 1), sun_over(image, 1.6, 0.3))


def test_images_past_the_body_are_refused() -> None:
    image = PAIR.images[0]
    away = OrientationCorrection(np.array([[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]]))
    with pytest.raises(InputError, match="misses the body"):
        render(image, make_terrain("gusev", 1), away, sun_over(image, 0.9, 0.3), np.random.default_rng(0))


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
