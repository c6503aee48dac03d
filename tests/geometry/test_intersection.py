"""Rays back to the point they came from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.geometry.intersection import intersect_rays

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


@given(seeds)
def test_order_of_rays_and_points_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, origins, directions, index = bundle(rng, 3, 3)
    origins = origins + rng.normal(size=origins.shape)
    mixed, names = rng.permutation(9), rng.permutation(3)
    want = intersect_rays(origins, directions, index, 3)
    got = intersect_rays(origins[mixed], directions[mixed], names[index[mixed]], 3)

    for was, now in zip(want, got, strict=True):
        np.testing.assert_allclose(now[names], was, rtol=1e-7, atol=1e-7)


def test_a_common_shift_of_the_world_shifts_the_places() -> None:
    """Body-fixed numbers are large; precision must not depend on where the origin lies."""
    _, origins, directions, index = bundle(np.random.default_rng(2), 2, 3)
    near = intersect_rays(origins - POINT, directions, index, 2)[0]

    np.testing.assert_allclose(intersect_rays(origins, directions, index, 2)[0], near + POINT, atol=1e-8)


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


def test_no_rays_at_all() -> None:
    places, skew, angle = intersect_rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=int), 2)

    assert np.all(np.isnan(places))
    assert np.all(np.isnan(skew))
    np.testing.assert_array_equal(angle, 0.0)
