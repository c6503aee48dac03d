"""Cameras mounted against the axes of their pass: it does not matter by how much, where the prior has no axes."""

from dataclasses import replace

import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, NodePrior, Pass, SharedKind, SharedUnknown
from mgsgraph.network.corrections import correction_parts, designs

TIGHT = {"cost_tolerance": 1e-14, "step_tolerance": 1e-9}
ROUND = NodePrior(np.array([80.0] * 3 + [2e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.zeros(6), 4.0)
"""Of no preferred axis."""


def turned(angles: tuple[float, float, float]) -> Array:
    """(3, 3) rotation."""
    return rotation.exponential(np.array([angles]))[0]


LIKE_NAC = turned((0.0, 0.05, 0.0)) @ turned((0.0, 0.0, 3.1))
"""Upside down, as NAC-R beside NAC-L, and 50 mrad beside it."""


def passes(net: Network, axes: Array | None) -> Network:
    """Each image a pass of its own, the second one's camera mounted like that."""
    found = []
    for j, image in enumerate(net.images):
        epoch, (start, stop) = image.trajectory.epoch, image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", epoch, (start, stop), (stop - start) / 5)
        mounted = axes[None] if j == 1 and axes is not None else None
        found.append(Pass(image.name, np.array([j]), nodes, ROUND, mounted))
    return replace(net, passes=tuple(found))


@pytest.mark.parametrize(("line", "optics"), [("predicted", False), ("measured", False), ("predicted", True)])
def test_a_mounting_changes_nothing_but_the_axes(line: str, optics: bool) -> None:
    """Of the optics, neither: focal length, principal point and distortion are about the camera's own axis."""
    net = network(pair(ties=60, shots=12))
    boresight = SharedUnknown("boresight", SharedKind.CAMERA_BORESIGHT, np.array([1]), np.array([1e-4, 2e-4, 3e-4]))
    interior = [
        SharedUnknown(str(kind), kind, np.array([1]), np.full(kind.width, 1e-3))
        for kind in SharedKind
        if kind.is_interior and optics
    ]
    net = replace(net, shared=(boresight, *interior))
    settings = SolverSettings(line=line, **TIGHT)  # type: ignore[arg-type]
    plain, mounted = (adjust_network(passes(net, axes), settings) for axes in (None, LIKE_NAC))

    assert mounted.cost_initial == pytest.approx(plain.cost_initial, rel=1e-4)
    linear = 1e-5 if line == "measured" else 1e-6  # misplacements count in the plane of other axes
    assert mounted.cost_final == pytest.approx(plain.cost_final, rel=linear)
    np.testing.assert_allclose(mounted.places, plain.places, atol=2e3 * linear)
    np.testing.assert_allclose(mounted.covariances, plain.covariances, rtol=1e-3, atol=1e-3)
    for k, one in enumerate(net.shared):
        np.testing.assert_allclose(mounted.shared[k] / one.sigmas, plain.shared[k] / one.sigmas, atol=1e-4)
        sigmas = [np.sqrt(np.diag(solution.shared_covariance(k))) for solution in (mounted, plain)]
        np.testing.assert_allclose(*sigmas, rtol=1e-3)
    turn = np.eye(6)
    turn[3:, 3:] = LIKE_NAC
    np.testing.assert_allclose(mounted.nodes[1] @ turn.T / ROUND.sigmas, plain.nodes[1] / ROUND.sigmas, atol=1e-4)
    moments = net.images[1].moments(np.linspace(0.0, net.images[1].lines, 9))
    want, found = (one.correction(1).at(moments)[0] for one in (plain, mounted))
    np.testing.assert_allclose(found / ROUND.sigmas, want / ROUND.sigmas, atol=1e-4)


def test_forms_agree() -> None:
    net = passes(network(pair(ties=40, shots=12)), LIKE_NAC)
    bundle = adjust_network(net, SolverSettings(**TIGHT))
    explicit = by_gtsam(bundle)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    np.testing.assert_allclose(bundle.places, explicit.places, atol=1e-3)


def test_corrections_at_lines_are_those_of_all_coefficients() -> None:
    net = passes(network(pair(ties=10, shots=4)), LIKE_NAC)
    rng, lines = np.random.default_rng(3), np.array([10.0, 333.3])
    values = [np.zeros(prior.sigmas.size) for prior in net.priors]
    values += [np.zeros(0)] * (int(net.first_of_passes[0]) - len(values))
    values += [rng.standard_normal(width) * 1e-4 for one in net.passes for width in one.widths]
    whole = sum(part @ values[v] for v, part in correction_parts(net, 1, "camera").items())
    moments = net.images[1].moments(lines)
    basis = net.passes[1].nodes.dense(moments.times, moments.epoch)[0]
    want = basis @ np.reshape(whole, (-1, 6))[1:]
    found = [sum(part @ values[v] for v, part in at.items()) for at in designs(net, 1, "camera", lines)]
    np.testing.assert_allclose(found, want, atol=1e-12)


def test_rays_of_a_detector_are_the_same_in_all_axes() -> None:
    rng = np.random.default_rng(2)
    detector, focal_length = Detector(rng.uniform(-0.02, 0.02, (5, 2)), rng.uniform(-1e-5, 1e-5, (5, 2))), 0.7
    found = detector.in_axes(LIKE_NAC, focal_length)
    want = np.hstack([detector.place, np.full((5, 1), focal_length)]) @ LIKE_NAC
    np.testing.assert_allclose(found.place / focal_length, want[:, :2] / want[:, 2:], atol=1e-15)
    step = 1e-3
    ahead = Detector(detector.place + step * detector.slope, detector.slope).in_axes(LIKE_NAC, focal_length)
    np.testing.assert_allclose((ahead.place - found.place) / step, found.slope, rtol=1e-6, atol=1e-12)
    with pytest.raises(InputError, match="looks away"):
        detector.in_axes(turned((1.7, 0.0, 0.0)), focal_length)


def test_angles_that_are_added_have_no_mountings() -> None:
    with pytest.raises(InputError, match="solver, angles"):
        adjust_network(passes(network(pair(ties=10, shots=4)), LIKE_NAC), SolverSettings(angles="opk-paper"))
