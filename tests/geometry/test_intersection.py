"""Rays back to the point they came from; rays and terrain models: the place found lies on the ray and on the model, and
nothing stands before it.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, intersect_ellipsoid
from mgsgraph.geometry.intersection import intersect_rays, meet_terrain
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid

POINT = np.array([1.2e6, -3.0e6, 0.9e6])
"""m, on the scale of Mars."""

seeds = st.integers(0, 2**32 - 1)


def bundle(rng: np.random.Generator, points: int, rays: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places (points, 3), then origins, directions and points of rays from 400 km above, shuffled."""
    places = POINT + rng.normal(size=(points, 3)) * 1e4
    index = rng.permutation(np.repeat(np.arange(points), rays))
    origins = places[index] * 1.12 + rng.normal(size=(index.size, 3)) * 5e4
    return places, origins, (places[index] - origins) * rng.uniform(0.1, 10.0, (index.size, 1)), index


@given(seeds, st.integers(1, 5), st.integers(2, 6))
def test_rays_through_a_point_give_it_back(seed: int, points: int, rays: int) -> None:
    places, origins, directions, index = bundle(np.random.default_rng(seed), points, rays)
    found, skew, angle = intersect_rays(origins, directions, index, points)

    # rounding of 4e5 m in float64, magnified along the rays by normal equations
    assert np.all(np.abs(found - places).max(axis=1) < 1e-8 + 1e-9 / angle**2)
    assert np.all(skew < 1e-8 + 1e-9 / angle)


@given(seeds)
def test_the_place_is_the_nearest_to_all_rays(seed: int) -> None:
    """The sum of squared distances, computed ray by ray, grows in every direction; its mean is skew squared."""
    rng = np.random.default_rng(seed)
    _, origins, directions, index = bundle(rng, 1, 4)
    origins = origins + 100.0 * rng.normal(size=origins.shape)
    found, skew, _ = intersect_rays(origins, directions, index, 1)

    def cost(place: np.ndarray) -> float:
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return float(np.sum(np.linalg.norm(np.cross(place - origins, unit), axis=1) ** 2))

    least = cost(found[0])
    assert np.sqrt(least / 4) == pytest.approx(skew[0], rel=1e-6)
    for step in np.concatenate([np.eye(3), -np.eye(3)]):
        assert cost(found[0] + step) > least


@given(st.floats(0.01, 1.5), st.floats(0.0, 1e3))
def test_two_skew_rays(angle: float, gap: float) -> None:
    """Their common perpendicular is `gap` long: the place is its middle, half of it away from each; angle exact."""
    first, second = np.array([1.0, 0.0, 0.0]), np.array([np.cos(angle), np.sin(angle), 0.0])
    aside = np.array([0.0, 0.0, 0.5 * gap])
    origins = POINT + np.array([-4e5 * first - aside, -5e5 * second + aside])
    found, skew, seen = intersect_rays(origins, np.array([first, 7.0 * second]), np.zeros(2, dtype=int), 1)

    np.testing.assert_allclose(found[0], POINT, atol=1e-8 + 1e-9 / angle**2)
    assert skew[0] == pytest.approx(0.5 * gap, abs=1e-8 + 1e-9 / angle)
    assert seen[0] == pytest.approx(angle, abs=1e-12)


def test_one_ray_no_ray_and_parallel_rays_have_no_place() -> None:
    origins = POINT + np.array([[4e5, 0.0, 0.0], [4e5, 1e3, 0.0], [4e5, 2e3, 0.0], [0.0, 4e5, 0.0]])
    down = np.array([[-1.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    # point 0: two parallel rays; 1: one ray; 2: none; 3: two good ones
    index = np.array([0, 0, 1, 3, 3])
    places, skew, angle = intersect_rays(origins[[0, 1, 2, 0, 3]], down[[0, 1, 2, 0, 3]], index, 4)

    assert np.all(np.isnan(places[:3]))
    assert np.all(np.isnan(skew[:3]))
    np.testing.assert_array_equal(angle[:3], 0.0)
    np.testing.assert_allclose(places[3], POINT, atol=1e-8)


# --- terrain models


STEP = 2e-4
"""rad between posts, 700 m."""


def rough(seed: int = 1, relief: float = 800.0) -> TerrainGrid:
    rng = np.random.default_rng(seed)
    return TerrainGrid("made up", 3.39e6 + relief * rng.standard_normal((60, 70)), 1.0, 0.3, STEP, STEP)


def rays(count: int, tilt: float) -> tuple[Array, Array]:
    """Looks from 400 km at places inside the model, up to a tilt (rad) off the vertical."""
    rng = np.random.default_rng(7)
    places = np.column_stack([1.0 + STEP * rng.uniform(15, 55, count), 0.3 - STEP * rng.uniform(15, 45, count)])
    target = from_planetocentric(np.column_stack([places, np.full(count, 3.39e6)]))
    up = target / np.linalg.norm(target, axis=1, keepdims=True)
    aside = np.cross(up, rng.standard_normal((count, 3)))
    aside *= np.tan(rng.uniform(0.0, tilt, count) )[:, None] / np.linalg.norm(aside, axis=1, keepdims=True)
    origins = target + 400e3 * (up + aside)
    return origins, 3.0 * (target - origins)


@pytest.mark.parametrize("tilt", [0.3, 1.3])
def test_the_place_is_on_the_ray_and_on_the_model_and_the_first_one(tilt: float) -> None:
    terrain, (origins, directions) = rough(), rays(300, tilt)
    points = meet_terrain(origins, directions, terrain)
    assert np.isfinite(points).all(axis=1).mean() > (0.99 if tilt < 1.0 else 0.5)
    found = np.isfinite(points).all(axis=1)
    points, origins, directions = points[found], origins[found], directions[found]
    away = np.linalg.norm(np.cross(points - origins, directions), axis=1) / np.linalg.norm(directions, axis=1)
    assert away.max() < 1e-6
    assert np.abs(np.linalg.norm(points, axis=1) - terrain.at(points)).max() < 1e-6
    for share in np.linspace(0.9, 0.9999, 400):  # nothing before it but what is thinner than half a post
        before = origins + share * (points - origins)
        buried = np.linalg.norm(before, axis=1) - terrain.at(before)
        assert np.nanmin(buried) > -150.0


def test_a_level_model_is_the_sphere() -> None:
    level = TerrainGrid("level", np.full((60, 70), 3.39e6), 1.0, 0.3, STEP, STEP)
    origins, directions = rays(50, 0.5)
    sphere, _, _ = intersect_ellipsoid(origins, directions, Ellipsoid(3.39e6, 3.39e6))
    np.testing.assert_allclose(meet_terrain(origins, directions, level), sphere, atol=1e-5)


def test_no_place_beside_the_model_over_holes_and_past_the_body() -> None:
    origins, directions = rays(20, 0.1)
    posts = np.array(rough().radii)
    posts[:, :] = np.nan
    posts[:3, :3] = 3.39e6
    holes = TerrainGrid("holes", posts, 1.0, 0.3, STEP, STEP)
    assert np.isnan(meet_terrain(origins, directions, holes)).all()
    assert np.isnan(meet_terrain(origins, -directions, rough())).all()
    assert meet_terrain(np.zeros((0, 3)), np.zeros((0, 3)), rough()).shape == (0, 3)
