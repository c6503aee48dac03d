"""Rays and terrain models: the place found lies on the ray and on the model, and nothing stands before it."""

import numpy as np
import pytest

from mgsgraph.geometry.body import from_planetocentric, intersect_ellipsoid
from mgsgraph.geometry.intersection import meet_terrain
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.simulation.mars import MARS

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
    from mgsgraph.geometry.body import Ellipsoid

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
    assert MARS.polar < 3.39e6
