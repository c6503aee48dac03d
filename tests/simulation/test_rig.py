"""Simulated rigs: the mounting of the real cameras, how truth is composed, and what an adjustment finds of it."""

from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry import rotation
from mgsgraph.network import Network
from mgsgraph.network.joining import nominal_poses
from mgsgraph.simulation.rig import (
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
    """Some 130 of 5064 samples, as near Hadley rille (docs/real_networks.md), all along."""
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


def test_seeds_are_seeds() -> None:
    one, same, other = (simulate_nac_pair(SETTINGS, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.network.rays.places, same.network.rays.places)
    assert one.shared[0].tolist() != other.shared[0].tolist()
