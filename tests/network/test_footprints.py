"""Registration against the truth of a simulated pair: places, and what the discrepancy must show."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import networks
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.network.footprints import crossings, discrepancy, footprints_in_images, misregistration
from mgsgraph.simulation.ground import sine_height
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import SimulatedPair

SHIFT = 6e-4
"""rad of pitch: 228 m along the flight from 380 km."""


def made_pair(tie: float = 1.0) -> SimulatedPair:
    return networks.pair(ties=150, shots=40, seed=5, noise=NoiseSettings(tie=tie))


@cache
def shots() -> AltimeterShots:
    """The pair's true footprints as shots of the first image's orbit."""
    pair = made_pair()
    n = pair.true_footprints.shape[0]
    nan = np.full(n, np.nan)
    return AltimeterShots(
        source="simulated", orbits=np.full(n, 18933), frames=np.arange(1, n + 1), shots=np.ones(n),
        times=pair.laser.times, footprints=pair.true_footprints, areoid_radii=nan, ranges=pair.laser.ranges,
        range_corrections=nan, spacecraft=np.full((n, 3), np.nan), off_nadir=nan, ground=np.ones(n, dtype=bool),
        channels=np.ones(n), clocks=nan, pulses=nan,
    )


def true_places(pair: SimulatedPair, image: int) -> np.ndarray:
    return pair.images[image].ground_to_image(pair.true_footprints, pair.true_corrections[image])[0]


def pitched(correction: OrientationCorrection, pitch: float) -> OrientationCorrection:
    """The correction with one more turn about the camera's y axis, which lies across the flight."""
    coefficients = np.array(correction.coefficients)
    coefficients[0, 4] += pitch
    return replace(correction, coefficients=coefficients)


def test_every_footprint_in_every_image() -> None:
    pair = made_pair()
    found = footprints_in_images(pair.images, shots(), pair.true_corrections)
    for j in range(2):
        np.testing.assert_allclose(found.places[j], true_places(pair, j), rtol=0, atol=1e-6)
    assert found.inside.all()
    assert found.simultaneous.tolist() == [[True] * 40, [False] * 40]
    first, second = crossings(found)
    assert (first.simultaneous, first.inside, first.profile) == (40, 40, "18933")
    assert (second.simultaneous, second.inside) == (0, 40)


def test_profiles_are_told_apart_and_the_far_side_is_hidden() -> None:
    pair, own = made_pair(), shots()
    half = np.arange(40) < 20
    mixed = replace(
        own, orbits=np.where(half, 18933, 20001), times=np.where(half, own.times, own.times + 1e6),
        footprints=np.where((np.arange(40) < 5)[:, None], -own.footprints, own.footprints),
    )
    found = footprints_in_images(pair.images[:1], mixed)

    assert not found.inside[0, :5].any()
    assert np.isnan(found.places[0, :5]).all()
    profiles = [(one.profile, one.simultaneous, one.inside, one.shots) for one in crossings(found)]
    assert profiles == [("18933", 20, 15, 20), ("20001", 0, 20, 20)]


def test_an_image_that_sees_the_limb_doesnt_see_through_the_body() -> None:
    pair, own = made_pair(), shots()
    image = pair.images[0]
    wide = replace(image, interior=replace(image.interior, focal_length=0.005))
    far = replace(own, footprints=np.concatenate([-own.footprints[:20], own.footprints[20:]]))

    assert footprints_in_images([wide], far).inside[0].tolist() == [False] * 20 + [True] * 20


def test_misregistration_against_truth_along_the_flight() -> None:
    pair = made_pair()
    wrong = pitched(pair.true_corrections[0], SHIFT)
    found = misregistration(pair.images[0], shots(), true_places(pair, 0), wrong)
    right = misregistration(pair.images[0], shots(), true_places(pair, 0), pair.true_corrections[0])

    np.testing.assert_allclose(np.abs(found.metres[:, 0]), 228.0, rtol=0.02)
    # a turn moves the place along the inertial flight; over the turning body the ground track runs 4.5 deg off it
    assert np.abs(found.metres[:, 1]).max() < 228.0 * np.tan(np.radians(5.0))
    scale = found.metres[0, 0] / found.pixels[0, 0]
    np.testing.assert_allclose(found.pixels[:, 0] * scale, found.metres[:, 0], rtol=0.02)
    np.testing.assert_allclose(found.spacings, found.metres / shots().spacing, equal_nan=True)
    np.testing.assert_allclose(right.pixels, 0.0, atol=1e-6)


def test_metres_are_those_between_the_ground_points() -> None:
    """A footprint moved by known metres along the flight and to the right moves its place by as much."""
    pair, own = made_pair(), shots()
    image, correction = pair.images[0], pair.true_corrections[0]
    places = true_places(pair, 0)
    up = own.footprints / np.linalg.norm(own.footprints, axis=1, keepdims=True)
    flight = image.pose(places[:, 0], correction).velocity
    flight -= np.einsum("ni,ni->n", flight, up)[:, None] * up
    flight /= np.linalg.norm(flight, axis=1, keepdims=True)
    moved = own.footprints + 30.0 * flight + 20.0 * np.cross(flight, up)
    found = misregistration(image, own, places, correction, moved)

    np.testing.assert_allclose(found.metres, np.broadcast_to([30.0, 20.0], (40, 2)), rtol=0, atol=0.1)


def expected_discrepancy(pair: SimulatedPair, corrections: tuple[OrientationCorrection, ...]) -> np.ndarray:
    """What the ties must tell: misplacement in the second image minus that of the first, carried over the true ground.

    The place of the footprint's projection into the first image shows other ground, at the terrain's height there.
    """
    first, second = pair.images
    in_first, _ = first.ground_to_image(pair.true_footprints, corrections[0])
    in_second, _ = second.ground_to_image(pair.true_footprints, corrections[1])
    height = np.zeros(in_first.shape[0])
    for _ in range(8):
        shown, _ = first.image_to_ground(in_first[:, 0], in_first[:, 1], height, pair.true_corrections[0])
        height = sine_height(shown, pair.settings.relief)
    homologous, _ = second.ground_to_image(shown, pair.true_corrections[1])
    return in_second - homologous


CASES: dict[str, Callable[[SimulatedPair], tuple[OrientationCorrection, ...]]] = {
    "nominal": lambda pair: tuple(OrientationCorrection(np.zeros((3, 6))) for _ in pair.images),
    "pitch": lambda pair: (pitched(pair.true_corrections[0], SHIFT), pair.true_corrections[1]),
    "pitch of the second": lambda pair: (pair.true_corrections[0], pitched(pair.true_corrections[1], -SHIFT)),
    "true": lambda pair: pair.true_corrections,
}


@pytest.mark.parametrize("case", CASES)
def test_discrepancy_is_what_homologous_places_tell(case: str) -> None:
    pair = made_pair()
    corrections = CASES[case](pair)
    found = discrepancy((pair.images[0], pair.images[1]), shots(), pair.ties, corrections)
    error = found.pixels - expected_discrepancy(pair, corrections)[found.shots]
    ratio = error / found.pixel_sigmas
    print(case, found, "error", np.sqrt(np.mean(error**2, axis=0)), "px, in sigmas", np.abs(ratio).max(axis=0))
    assert found.shots.size == 40
    assert np.abs(ratio).max() < 3.5
    assert np.all(np.sqrt(np.mean(ratio**2, axis=0)) > 0.4)  # the sigmas are no safe lies, either
    assert np.sqrt(np.mean(error[:, 0] ** 2)) < 0.5
    along = {"pitch": 228.0, "pitch of the second": 244.0, "true": 0.0}  # the second looks from 407 km
    if case in along:
        np.testing.assert_allclose(found.metres[:, 0].mean(), along[case], rtol=0, atol=4.0)


def test_a_profile_moved_over_the_ground_is_no_discrepancy() -> None:
    """The ties don't know where the footprints should be: a common horizontal error of 80 m doesn't show."""
    pair, own = made_pair(), shots()
    corrections = (pair.true_corrections[0], pair.true_corrections[1])
    images = (pair.images[0], pair.images[1])
    up = own.footprints / np.linalg.norm(own.footprints, axis=1, keepdims=True)
    east = np.cross([0.0, 0.0, 1.0], up)
    moved = own.footprints + 80.0 * east / np.linalg.norm(east, axis=1, keepdims=True)
    places, _ = images[0].ground_to_image(moved, corrections[0])
    height = np.zeros(40)
    for _ in range(8):
        moved, _ = images[0].image_to_ground(places[:, 0], places[:, 1], height, corrections[0])
        height = sine_height(moved, pair.settings.relief)
    found = discrepancy(images, own, pair.ties, corrections, moved)

    assert np.linalg.norm(moved - own.footprints, axis=1).min() > 75.0
    assert np.abs(found.pixels / found.pixel_sigmas).max() < 3.5
    assert np.abs(found.metres[:, 0]).max() < 10.0


def test_too_few_ties_and_too_few_for_a_sigma() -> None:
    pair = made_pair()
    images = (pair.images[0], pair.images[1])

    def first(count: int) -> TiePoints:
        kept = pair.ties.measure_point < count
        return replace(
            pair.ties, measure_point=pair.ties.measure_point[kept], measures=pair.ties.measures[kept],
            measure_image=pair.ties.measure_image[: 2 * count], measure_sigmas=pair.ties.measure_sigmas[kept],
        )

    with pytest.raises(InputError, match="2 common tie points"):
        discrepancy(images, shots(), first(2))
    found = discrepancy(images, shots(), first(3))
    assert np.all(np.isfinite(found.pixels))
    assert np.all(np.isnan(found.pixel_sigmas))


def test_as_many_corrections_as_images() -> None:
    pair = made_pair()
    with pytest.raises(InputError, match="1 corrections"):
        footprints_in_images(pair.images, shots(), pair.true_corrections[:1])
