"""What a coefficient of the orientation does to image places and to the ground, against central differences."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from increments import NOISE, fan, strip
from strategies import differences

from mgsgraph.adjustment.incremental.state import ground_motion, image_motion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles, OrientationCorrection, OrientationPrior
from mgsgraph.network.parts import KnownImage

IMAGES = [*strip().images[:2], fan().images[1]]
STEPS = np.tile(np.repeat([1.0, 1e-5], 3), 3)


@pytest.mark.parametrize("angles", get_args(Angles))
@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_ground_motion_is_the_derivative_of_the_middle_s_place(image: PushbroomImage, angles: Angles) -> None:
    middle = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])

    def place(coefficients: np.ndarray) -> np.ndarray:
        return image.image_to_ground(*middle, 0.0, OrientationCorrection(coefficients.reshape(-1, 6), angles))[0][0]

    found = ground_motion(KnownImage(image, NOISE.prior), angles)
    expected = differences(place, np.zeros(18), STEPS)
    assert found.shape == (3, 18)
    # m per m, and m per rad of some 400 km
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-6)
    np.testing.assert_allclose(found[:, 3:6], expected[:, 3:6], atol=1.0)
    assert np.abs(expected[:, 3:6]).max() > 3e5
    assert not np.any(found[:, 6:])
    assert np.abs(expected[:, 6:] * np.tile(np.repeat([1.0, 1e-5], 3), 2)).max() < 1e-3  # u = 0 in the middle


@pytest.mark.parametrize("angles", get_args(Angles))
@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_no_image_place_moves_faster_than_stated(image: PushbroomImage, angles: Angles) -> None:
    """At the corners and within, and the fastest moves about as fast as stated."""
    lines, samples = np.meshgrid(np.linspace(1.0, image.lines - 1.0, 5), np.linspace(1.0, image.samples - 1.0, 3))
    points, _ = image.image_to_ground(lines.ravel(), samples.ravel())
    stated = image_motion(KnownImage(image, NOISE.prior))

    def places(coefficients: np.ndarray) -> np.ndarray:
        return image.ground_to_image(points, OrientationCorrection(coefficients.reshape(-1, 6), angles))[0]

    speed = np.linalg.norm(differences(places, np.zeros(18), STEPS), axis=1)
    assert stated.shape == (18,)
    # the pixel's size on the ground along the track is its width to a tenth; ground nearer than the middle moves faster
    assert np.all(speed < 1.15 * stated)
    for kind in (slice(0, 3), slice(3, 6)):
        assert speed[:, kind].max() > 0.8 * stated[kind].max()


def test_higher_terms_move_as_much_at_most() -> None:
    one = KnownImage(IMAGES[0], OrientationPrior(NOISE.prior.sigmas[:1]))
    np.testing.assert_array_equal(image_motion(KnownImage(IMAGES[0], NOISE.prior)), np.tile(image_motion(one), 3))


def test_an_image_that_looks_past_the_body_has_a_motion_and_no_ground() -> None:
    """Turned round: as fast as if the ground were where it would be below."""
    trajectory = IMAGES[0].trajectory
    away = replace(trajectory.camera, constant=np.diag([1.0, -1.0, -1.0]) @ trajectory.camera.constant)
    known = KnownImage(replace(IMAGES[0], trajectory=replace(trajectory, camera=away)), NOISE.prior)
    near = image_motion(KnownImage(IMAGES[0], NOISE.prior))
    assert np.all(np.isfinite(image_motion(known)))
    np.testing.assert_allclose(image_motion(known), near, rtol=0.1)
    assert not np.any(ground_motion(known, "camera"))
