"""Simulated pairs of CTX, with planted jitter and observations as noisy as they say, and of LRO's NAC, a rig: its
mounting, how truth is composed, and what an adjustment finds of it.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from ctx_pair import (
    PIXEL,
    CtxSettings,
    JitterSettings,
    Look,
    SimulatedCtxPair,
    image_times,
    simulate_ctx_pair,
)
from nac_pair import (
    ALTITUDE,
    SAMPLES,
    NacSettings,
    PassErrors,
    SimulatedRig,
    TrueRig,
    joined,
    nac_cameras,
    nac_images,
    powers,
    simulate_nac_pair,
)

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import Moments
from mgsgraph.network import Network
from mgsgraph.network.joining import nominal_poses
from mgsgraph.units import DEG

# --- CTX


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


# --- NAC


SETTINGS = NacSettings(ties=120, beside=20, shots=10)


@pytest.fixture(scope="module")
def rig() -> SimulatedRig:
    return simulate_nac_pair(SETTINGS, 3)


def test_the_cameras_are_mounted_as_lro_has_them() -> None:
    """R by half a turn and 2.75 degrees against L, as far to either side of the spacecraft's +Z."""
    left, right = (camera.mount for camera in nac_cameras())
    turn = right @ left.T
    assert np.degrees(np.arccos(turn[2, 2])) == pytest.approx(2.75, abs=0.01)
    assert np.degrees(np.arccos(0.5 * (np.trace(turn) - 1.0))) == pytest.approx(179.6, abs=0.1)
    assert left[2, 2] == pytest.approx(right[2, 2], abs=1e-12)
    assert left[2, 1] == pytest.approx(-right[2, 1], abs=1e-3)


def test_l_and_r_share_a_narrow_strip() -> None:
    """Some 130 of 5064 samples, as near Hadley rille (docs/evidence_real.md), all along."""
    left, right = nac_images()[:2]
    lines, samples = np.repeat([0.1, 0.5, 0.9], SAMPLES) * left.lines, np.tile(np.arange(SAMPLES) + 0.5, 3)
    ground, _ = left.image_to_ground(lines, samples)
    seen = right.ground_to_image(ground)[0][:, 1]
    shared = np.count_nonzero(((seen > 0.0) & (seen < SAMPLES)).reshape(3, -1), axis=1)
    assert np.all((shared > 80) & (shared < 200))


def test_truth_is_the_pass_turned_and_then_the_boresight(rig: SimulatedRig) -> None:
    """C_true = Exp(-b) A Exp(-c) C_first by matrices, without corrections of images."""
    one = rig.network.passes[1]
    lines = np.array([100.0, 30_000.0])
    right = rig.truth.images[3]
    times = right.timing.at(lines)[0] + right.trajectory.epoch
    first = nominal_poses(rig.network.images[2:3], times)
    s = (2.0 * (times - one.nodes.epoch) - sum(one.nodes.coverage)) / np.ptp(one.nodes.coverage)
    turn = np.vander(s, 4, increasing=True) @ np.linalg.solve(powers(one.nodes), rig.truth.nodes[1])[:, 3:]
    axes = one.axes_of(3)
    assert axes is not None
    want = rotation.exponential(-rig.shared[0]) @ axes @ rotation.exponential(-turn) @ first.matrix
    found = right.pose(lines, rig.truth.corrections[3]).matrix
    np.testing.assert_allclose(found, want, atol=1e-9)


def test_positions_of_degree_one_stay_so() -> None:
    errors = PassErrors(position=(30.0, 10.0))
    images = nac_images()[:2]
    one = joined("pass", images, 0, errors)
    truth = TrueRig.drawn(images, [one], errors, np.zeros((2, 3)), np.random.default_rng(1))
    coefficients = np.linalg.solve(powers(one.nodes), truth.nodes[0])
    assert np.abs(coefficients[2:, :3]).max() < 1e-8
    assert np.abs(coefficients[3, 3:]).min() > 1e-8


def adjusted_boresight(network: Network) -> tuple[np.ndarray, np.ndarray]:
    solution = adjust_network(network, SolverSettings(reject=0.0))
    assert solution.converged
    return solution.shared[0], solution.joint_covariance.of([network.first_shared])


def test_eighty_metres_are_found_to_a_metre(rig: SimulatedRig) -> None:
    """Along x and y, 80 m from 50 km; the error normalised by its covariance within 99.9 % of a chi-square."""
    assert np.linalg.norm(rig.shared[0][:2]) * ALTITUDE == pytest.approx(80.0)
    found, covariance = adjusted_boresight(rig.network)
    error = found - rig.shared[0]
    assert np.linalg.norm(error[:2]) * ALTITUDE < 1.0
    assert error @ np.linalg.solve(covariance, error) < 16.3
    wrong = -rig.shared[0] - found  # a sign the wrong way round would be seen
    assert wrong @ np.linalg.solve(covariance, wrong) > 1e4


def test_what_is_found_is_found_in_passes_with_axes_of_the_other_camera(rig: SimulatedRig) -> None:
    """Naming R first lays the same nodes about other axes: rig and result are the same."""
    net = rig.network
    order = [1, 0, 3, 2]
    images = tuple(net.images[j] for j in order)
    passes = tuple(
        joined(one.name, images[2 * k : 2 * k + 2], 2 * k, SETTINGS.errors) for k, one in enumerate(net.passes)
    )
    shared = tuple(replace(one, images=np.array([0, 2])) for one in net.shared)
    swapped = replace(
        net, images=images, passes=passes, shared=shared, priors=tuple(net.priors[j] for j in order),
        rays=replace(net.rays, image=np.array(order)[net.rays.image]),
        ranges=replace(net.ranges, image=np.array(order)[net.ranges.image]),
    )  # fmt: skip
    one, other = (adjust_network(network, SolverSettings(reject=0.0)) for network in (net, swapped))
    assert other.cost_final == pytest.approx(one.cost_final, rel=1e-6)
    np.testing.assert_allclose(other.places, one.places, atol=1e-2)
    np.testing.assert_allclose(other.shared[0], one.shared[0], atol=1e-8)


def test_without_a_mounting_error_the_trajectory_cannot_take_it(rig: SimulatedRig) -> None:
    """Half a turn apart, what L and R want of the pass goes in opposite directions."""
    solution = adjust_network(replace(rig.network, shared=()), SolverSettings(reject=0.0))
    off = (solution.places - rig.points)[np.array(rig.network.points.kinds) == 0]
    assert solution.sigma0 > 20.0
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) > 30.0
