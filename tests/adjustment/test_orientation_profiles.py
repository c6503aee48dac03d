"""Orientation of all images at once: against the whole correction of each and the covariance of its coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from sharing import with_all_kinds

from mgsgraph.adjustment import solution as of_solution
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import Angles, SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profiles
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Network, NodePrior, Pass

PLACES = 7


def on_strips(net: Network) -> Network:
    """Each image a strip of its own, its camera turned against the strip's axes."""
    prior = NodePrior(
        np.array([80.0] * 3 + [2e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.array([50.0] * 3 + [1e-4] * 3), 4.0
    )
    axes, strips = rotation.exponential(np.array([[0.1, 0.2, 3.0]]))[0], []
    for j, image in enumerate(net.images):
        start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", image.trajectory.epoch, (start, stop), (stop - start) / 6.0)
        strips.append(Pass(image.name, np.array([j]), nodes, prior, axes=axes[None]))
    return replace(net, passes=tuple(strips))


def solved(kind: str, angles: Angles) -> Solution:
    """Polynomials, nodes, or all kinds of shared unknowns with one image held."""
    net = network(pair(ties=20, shots=6))
    if kind == "nodes":
        net = on_strips(net)
    elif kind == "shared":
        net = with_all_kinds(with_shift_and_surface(network(pair(), held=(True, False))))
    return adjust_network(net, SolverSettings(angles=angles))


@pytest.mark.parametrize(
    ("kind", "angles"),
    [("polynomial", "camera"), ("polynomial", "opk-paper"), ("nodes", "camera"), ("shared", "camera")],
)
def test_images_together_are_each_by_itself(kind: str, angles: Angles, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = solved(kind, angles)
    monkeypatch.setattr(of_solution, "_TOGETHER", 1)  # block by block
    found = orientation_profiles(solution, [1, 0], PLACES)
    for k, image in enumerate([1, 0]):
        picture, correction = solution.network.images[image], solution.correction(image)
        lines, at = np.linspace(0.0, picture.lines, PLACES), slice(k * PLACES, (k + 1) * PLACES)
        np.testing.assert_array_equal(found.lines[at], lines)
        np.testing.assert_array_equal(found.position_before[at], picture.pose(lines).position)
        np.testing.assert_allclose(found.position_after[at], picture.pose(lines, correction).position, rtol=1e-14)
        basis = np.kron(correction.basis(picture.moments(lines)), np.eye(6)).reshape(PLACES, 6, -1)
        covariance = basis @ solution.correction_covariance(image) @ np.swapaxes(basis, 1, 2)
        sigmas = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
        np.testing.assert_allclose(found.position_sigma[at], sigmas, rtol=1e-9, atol=1e-12)
        axes = correction.axes(picture.pose(lines), picture.moments(lines))
        turned = axes @ covariance[:, 3:, 3:] @ np.swapaxes(axes, 1, 2)
        sigmas = np.sqrt(np.diagonal(turned, axis1=1, axis2=2))
        np.testing.assert_allclose(found.rotation_sigma[at], sigmas, rtol=1e-9, atol=1e-15)
