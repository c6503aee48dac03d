"""Places on the body against NAIF's routines, Jacobians against differences."""

import numpy as np
import pytest
import spiceypy
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses
from strategies import MARS, MOON, differences, heights, latitudes, orbits

from mgsgraph.geometry.body import (
    Ellipsoid,
    from_geodetic,
    from_planetocentric,
    geodetic,
    intersect_ellipsoid,
    planetocentric,
    planetocentric_jacobian,
)

longitudes = st.floats(-3.14, 3.14)
bodies = st.sampled_from([MARS, MOON])
places = st.tuples(longitudes, latitudes, st.floats(1.7e6, 3.9e6)).map(np.array)


@given(places)
def test_planetocentric_places_are_those_of_spice(place: np.ndarray) -> None:
    point = from_planetocentric(place)
    radius, longitude, latitude = spiceypy.reclat(point)

    np.testing.assert_allclose(point, spiceypy.latrec(place[2], place[0], place[1]), atol=1e-8)
    np.testing.assert_allclose(planetocentric(point), [longitude, latitude, radius], rtol=1e-14, atol=1e-15)


@given(places)
def test_planetocentric_jacobian_against_differences(place: np.ndarray) -> None:
    want = differences(from_planetocentric, place, np.array([1e-3, 1e-3, 1e3]))

    assert np.all(np.abs(planetocentric_jacobian(place) - want) < 1e-4 * np.array([1.0, 1.0, 1e-6]))


@given(longitudes, latitudes, st.one_of(heights, orbits), bodies)
def test_geodetic_places_are_those_of_spice(longitude: float, latitude: float, height: float, body: Ellipsoid) -> None:
    flattening = (body.equatorial - body.polar) / body.equatorial
    place = np.array([longitude, latitude, height])
    point = from_geodetic(place, body)

    np.testing.assert_allclose(
        point, spiceypy.georec(longitude, latitude, height, body.equatorial, flattening), atol=4e-9
    )
    found = geodetic(point, body)
    want = spiceypy.recgeo(point, body.equatorial, flattening)
    np.testing.assert_allclose(found[1:], want[1:], rtol=1e-14, atol=4e-9)
    np.testing.assert_allclose(from_geodetic(found, body), point, atol=4e-9)
    np.testing.assert_allclose(found[1:], place[1:], rtol=1e-14, atol=4e-9)


def look(place: np.ndarray, nadir: np.ndarray, off_nadir: float, azimuth: float) -> np.ndarray:
    """A direction `off_nadir` from the way down to the centre."""
    down = -place / np.linalg.norm(place)
    aside = np.cross(down, nadir)
    aside /= np.linalg.norm(aside)
    across = np.cos(azimuth) * aside + np.sin(azimuth) * np.cross(down, aside)
    return np.asarray(np.cos(off_nadir) * down + np.sin(off_nadir) * across)


@st.composite
def views(draw: st.DrawFn, largest: float = 0.5) -> tuple[np.ndarray, np.ndarray, float]:
    """Origin 350 to 450 km above Mars, direction (any length), height of the ground."""
    place = np.array([draw(longitudes), draw(st.floats(-1.5, 1.5)), MARS.equatorial + draw(orbits)])
    origin = from_planetocentric(place)
    azimuth, off = draw(st.floats(0.0, 6.28)), draw(st.floats(0.0, largest))
    direction = look(origin, np.array([0.01, 0.02, 1.0]), off, azimuth) * draw(st.floats(0.1, 1e3))
    return origin, direction, draw(heights)


@given(views())
def test_rays_meet_the_ellipsoid_where_spice_says(view: tuple[np.ndarray, np.ndarray, float]) -> None:
    origin, direction, height = view
    points, _, _ = intersect_ellipsoid(origin[None], direction[None], MARS, height)
    want = spiceypy.surfpt(
        origin, direction, MARS.equatorial + height, MARS.equatorial + height, MARS.polar + height
    )

    np.testing.assert_allclose(points[0], want, atol=2e-8)


@given(views())
def test_derivatives_of_the_meeting_point(view: tuple[np.ndarray, np.ndarray, float]) -> None:
    origin, direction, height = view
    direction = direction / np.linalg.norm(direction)
    _, by_origin, by_direction = intersect_ellipsoid(origin[None], direction[None], MARS, height)

    def point(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return np.asarray(intersect_ellipsoid(origin[None], direction[None], MARS, height)[0][0])

    want = differences(lambda o: point(o, direction), origin, 100.0)
    np.testing.assert_allclose(by_origin[0], want, atol=1e-8)
    want = differences(lambda d: point(origin, d), direction, 3e-5)
    np.testing.assert_allclose(by_direction[0], want, atol=1e-8 * 4e5)


@given(views(largest=3.1))
def test_a_ray_meets_or_misses_as_spice_finds(view: tuple[np.ndarray, np.ndarray, float]) -> None:
    origin, direction, _ = view
    points, _, _ = intersect_ellipsoid(origin[None], direction[None], MARS)
    try:
        want = spiceypy.surfpt(origin, direction, MARS.equatorial, MARS.equatorial, MARS.polar)
    except spiceypy.utils.exceptions.NotFoundError:
        want = np.full(3, np.nan)

    np.testing.assert_allclose(points[0], want, atol=1e-4)  # near the limb the point runs along the ray


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ([4e6, 0.0, 0.0], [1.0, 0.0, 0.0]),  # away
        ([4e6, 0.0, 0.0], [0.0, 1.0, 0.0]),  # past
        ([4e6, 0.0, 0.0], [0.0, 0.0, 0.0]),  # nowhere
        ([1e6, 1e6, 0.0], [-1.0, 0.0, 0.3]),  # from inside
        ([3_396_190.0 * (1 + 2e-16), 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([np.nan, 0.0, 0.0], [1.0, 0.0, 0.0]),
    ],
)  # fmt: skip
def test_misses_are_nan_without_a_warning(origin: list[float], direction: list[float]) -> None:
    points, by_origin, by_direction = intersect_ellipsoid(np.array([origin]), np.array([direction]), MARS)

    assert np.all(np.isnan(points))
    assert np.all(np.isnan(by_origin))
    assert np.all(np.isnan(by_direction))


def test_each_ray_has_its_own_height() -> None:
    heights = np.array([-5e3, 0.0, 1e4])
    origins, directions = np.tile([4e6, 0.0, 0.0], (3, 1)), np.tile([-2.0, 0.0, 0.0], (3, 1))
    points, _, _ = intersect_ellipsoid(origins, directions, MARS, heights)

    np.testing.assert_allclose(points[:, 0], MARS.equatorial + heights, rtol=1e-15)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_radii_are_positive_numbers(radius: float) -> None:
    for radii in ((radius, 1.0), (1.0, radius)):
        refuses("expected a positive number", Ellipsoid, *radii)
