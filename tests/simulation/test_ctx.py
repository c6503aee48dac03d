"""A simulated CTX pair: its geometry, its planted jitter, and observations that are as noisy as they say."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from mgsgraph.geometry.orientation import Moments
from mgsgraph.simulation.ctx import (
    PIXEL,
    CtxSettings,
    JitterSettings,
    Look,
    SimulatedCtxPair,
    image_times,
    simulate_ctx_pair,
)
from mgsgraph.units import DEG


@cache
def pair(look: Look = "across", seed: int = 3, **changes: Any) -> SimulatedCtxPair:
    return simulate_ctx_pair(CtxSettings(look=look, ties=600, **changes), seed)


@pytest.mark.parametrize("look", ["across", "along"])
def test_second_image_looks_at_the_same_ground_aside_or_ahead(look: Look) -> None:
    first, second = pair(look).network.images
    middle = np.array([0.5 * first.lines]), np.array([0.5 * first.samples])
    site = pair(look).terrain.intersect(*first.sightlines(*middle))
    np.testing.assert_allclose(second.ground_to_image(site)[0][0], [0.5 * second.lines, 0.5 * second.samples], atol=1.0)
    pose = second.pose(middle[0])
    axis = pose.matrix[0, 2]
    down = -pose.position[0] / np.linalg.norm(pose.position[0])
    assert np.degrees(np.arccos(axis @ down)) == pytest.approx(22.0, abs=0.05)
    forward = pose.velocity[0] - (pose.velocity[0] @ down) * down
    ahead = float(axis @ forward) / float(np.linalg.norm(forward)) / np.sin(22.0 * DEG)
    # body-fixed flight differs from the inertial one by the rotation of Mars: 4 degrees
    assert ahead == pytest.approx(0.0 if look == "across" else 1.0, abs=0.08)


def test_a_pixel_is_as_large_as_of_ctx() -> None:
    image = pair().network.images[0]
    lines, samples = np.array([4000.0, 4001.0, 4000.0]), np.array([600.0, 600.0, 601.0])
    places, _ = image.image_to_ground(lines, samples)
    assert 5.5 < np.linalg.norm(places[1] - places[0]) < 6.3
    assert 5.5 < np.linalg.norm(places[2] - places[0]) < 6.3


def test_jitter_is_what_was_asked_for() -> None:
    """Pitch and roll less constants and slow drift are a wave of 0.5 px, in pixels of the image itself."""
    mine = pair()
    image, truth = mine.network.images[0], mine.truth[0]
    lines = np.linspace(0.0, image.lines, 4001)
    times = image.timing.at(lines)[0]
    values = truth.correction.at(Moments.of_times(times, image.trajectory.epoch))[0][:, 3:] / PIXEL
    wave = np.column_stack([np.cos(4.0 * np.pi * times), np.sin(4.0 * np.pi * times)])
    slow = np.polynomial.legendre.legvander(times / times.max(), 5)
    for k, axis in enumerate((1, 0)):  # pitch is about y, roll about x
        found = np.linalg.lstsq(np.hstack([wave, slow]), values[:, axis], rcond=None)[0]
        assert np.hypot(*found[:2]) == pytest.approx(0.5, abs=2e-3)
        np.testing.assert_allclose(found[:2], truth.phasors[k] / PIXEL, atol=2e-3)
        course = slow @ found[2:]
        assert 2.9 < np.ptp(course) < 6.1  # a half wave of 3 px
    assert np.ptp(values[:, 2]) < 1e-9
    start, stop = image_times(image)
    assert stop - start == pytest.approx(8500 * 1.877e-3)


def test_jitter_moves_ground_by_half_a_pixel_in_its_direction() -> None:
    """Pitch along lines, roll along samples: by the images' own projection."""
    for axis, (pitch, roll) in ((0, (0.5, 0.0)), (1, (0.0, 0.5))):
        mine = pair(jitter=JitterSettings(pitch=pitch, roll=roll, drift=0.0, angle=0.0, position=0.0))
        image, true = mine.network.images[0], mine.truth[0].correction
        lines = np.linspace(3000.0, 3600.0, 200)
        places = mine.terrain.intersect(*image.sightlines(lines, np.full(200, 600.0), true))
        moved = image.ground_to_image(places)[0] - np.column_stack([lines, np.full(200, 600.0)])
        assert np.abs(moved[:, axis]).max() == pytest.approx(0.5, rel=0.05)
        assert np.abs(moved[:, 1 - axis]).max() < 0.05


def test_ties_are_true_places_with_noise() -> None:
    mine = pair()
    network = mine.network
    for j in range(2):
        of = network.rays.image == j
        exact = network.images[j].ground_to_image(mine.true_points[network.rays.point[of]], mine.truth[j].correction)[0]
        errors = network.rays.places[of] - exact
        assert errors.std() == pytest.approx(0.2, rel=0.15)


def test_terrain_model_is_as_wrong_as_its_sigmas_say() -> None:
    """At true places, moved by its shift, heights above it scatter as posts do, and not much more for the relief."""
    mine = pair()
    surface = mine.network.surface
    assert surface is not None
    up = mine.true_points / np.linalg.norm(mine.true_points, axis=1, keepdims=True)
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    moved = mine.true_points - mine.shifts[0, 0] * east - mine.shifts[0, 1] * np.cross(up, east)
    above, _ = surface.grid.height_above(moved)
    assert 5.0 < above.std() < 11.0  # posts of 10 m, averaged by the surface between them
    assert abs(above.mean()) < 2.0
