"""Passes with nodes and mounted cameras: the bundle form against the explicit one, against polynomials, and against
cameras along the axes of their pass; what is said of such a solution.
"""

from dataclasses import replace

import numpy as np
import pytest
from explicit_form import by_gtsam
from mex_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from networks import NODES, network, on_passes, pair, with_shift_and_surface
from outside import refuses
from redraw import forward_intersection, redraw
from sharing import with_all_kinds

from mgsgraph.adjustment import solution as of_solution
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.covariances import prior_covariance
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.settings import Angles, Line, SolverSettings
from mgsgraph.adjustment.solution import orientation_profiles
from mgsgraph.analysis.grouping import group_redundancy, group_rows, scaled
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.weak import spectrum, weak_directions
from mgsgraph.errors import InputError, WeakNetwork
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import Detector
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, NodePrior, PolynomialPrior, SharedKind, SharedUnknown

TIGHT = {"cost_tolerance": 1e-14, "step_tolerance": 1e-9}
ROUND = NodePrior(np.array([80.0] * 3 + [2e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.zeros(6), 4.0)
"""Of no preferred axis."""


def turned(*angles: float) -> Array:
    """(3, 3) rotation."""
    return rotation.exponential(np.array([angles]))[0]


LIKE_NAC = turned(0.0, 0.05, 0.0) @ turned(0.0, 0.0, 3.1)
"""Upside down, as NAC-R beside NAC-L, and 50 mrad beside it."""


def mounted(net: Network) -> Network:
    """The second image's camera mounted like that."""
    return on_passes(net, ROUND, 5, {1: LIKE_NAC})


@pytest.mark.parametrize(
    ("net", "line"),
    [(on_passes(network(pair(60, 12))), "predicted"), (on_passes(network(pair(60, 12))), "measured"),
     (mounted(network(pair(40, 12))), "predicted")],
)  # fmt: skip
def test_forms_agree(net: Network, line: Line) -> None:
    bundle = adjust_network(net, SolverSettings(line=line, **TIGHT))  # type: ignore[arg-type]
    explicit = by_gtsam(bundle)
    assert bundle.converged
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    assert bundle.fit.squares == pytest.approx(2.0 * bundle.cost_final, rel=1e-7)
    np.testing.assert_allclose(bundle.places, explicit.places, atol=1e-3)
    for one, other in zip(bundle.nodes, explicit.nodes, strict=True):
        assert np.abs((one - other) / NODES.sigmas).max() < 1e-5
    covariance, reference = bundle.joint_covariance.dense(), explicit.joint_covariance.dense()
    scale = np.sqrt(np.diagonal(reference))
    assert np.abs((covariance - reference) / np.outer(scale, scale)).max() < 1e-6
    np.testing.assert_allclose(bundle.covariances, explicit.covariances, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize(("line", "optics"), [("predicted", False), ("measured", False), ("predicted", True)])
def test_a_mounting_changes_nothing_but_the_axes(line: Line, optics: bool) -> None:
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
    plain, other = (adjust_network(one, settings) for one in (on_passes(net, ROUND, 5), mounted(net)))

    assert other.cost_initial == pytest.approx(plain.cost_initial, rel=1e-4)
    linear = 1e-5 if line == "measured" else 1e-6  # misplacements count in the plane of other axes
    assert other.cost_final == pytest.approx(plain.cost_final, rel=linear)
    np.testing.assert_allclose(other.places, plain.places, atol=2e3 * linear)
    np.testing.assert_allclose(other.covariances, plain.covariances, rtol=1e-3, atol=1e-3)
    for k, one in enumerate(net.shared):
        np.testing.assert_allclose(other.shared[k] / one.sigmas, plain.shared[k] / one.sigmas, atol=1e-4)
        sigmas = [np.sqrt(np.diag(solution.shared_covariance(k))) for solution in (other, plain)]
        np.testing.assert_allclose(*sigmas, rtol=1e-3)
    turn = np.eye(6)
    turn[3:, 3:] = LIKE_NAC
    np.testing.assert_allclose(other.nodes[1] @ turn.T / ROUND.sigmas, plain.nodes[1] / ROUND.sigmas, atol=1e-4)
    moments = net.images[1].moments(np.linspace(0.0, net.images[1].lines, 9))
    want, found = (one.correction(1).at(moments)[0] for one in (plain, other))
    np.testing.assert_allclose(found / ROUND.sigmas, want / ROUND.sigmas, atol=1e-4)


def test_mountings_that_cannot_be() -> None:
    refuses("looks away", Detector(np.zeros((1, 2)), np.ones((1, 2))).in_axes, turned(1.7, 0.0, 0.0), 0.7)
    with pytest.raises(InputError, match="solver, angles"):  # angles that are added have none
        adjust_network(mounted(network(pair(ties=10, shots=4))), SolverSettings(angles="opk-paper"))


@pytest.mark.parametrize("degrees", [(0, 1), (1, 3), (2, 2)], ids=str)
def test_a_polynomial_of_a_pass_is_that_of_its_image(degrees: tuple[int, int]) -> None:
    """Through four nodes. Where the degrees differ, an image's prior holds the higher terms."""
    shares, units = np.array([1.0, 0.3, 0.1, 0.05])[:, None], np.array([100.0] * 3 + [3e-4] * 3)
    sigmas = np.tile(1e-4 * units, (max(degrees) + 1, 1))
    for degree, mine in zip(degrees, (slice(0, 3), slice(3, 6)), strict=True):
        sigmas[: degree + 1, mine] = shares[: degree + 1] * units[mine]
    plain = replace(network(pair(ties=60, shots=12)), priors=(OrientationPrior(sigmas),) * 2)
    prior = PolynomialPrior(sigmas[: degrees[0] + 1, :3], sigmas[: degrees[1] + 1, 3:])
    one, other = (adjust_network(net, SolverSettings(**TIGHT)) for net in (plain, on_passes(plain, prior, 3)))
    assert other.cost_final == pytest.approx(one.cost_final, rel=1e-6)
    scale = np.sqrt(np.diagonal(one.covariances, axis1=1, axis2=2))
    np.testing.assert_allclose((other.places - one.places) / scale, 0.0, atol=1e-4)
    np.testing.assert_allclose(np.diagonal(other.covariances, axis1=1, axis2=2) / scale**2, 1.0, atol=1e-4)
    for j, image in enumerate(plain.images):
        lines = np.linspace(0.0, image.lines, 7)
        want, found = (each.correction(j).at(image.moments(lines))[0] for each in (one, other))
        np.testing.assert_allclose((found - want) / units, 0.0, atol=1e-5)


def test_a_free_pass_names_its_datum() -> None:
    """Nodes of which nothing is known, and no laser: translation, rotation and scale are free."""
    nothing = NodePrior(np.full(6, np.inf), np.zeros(6), np.zeros(6))
    with pytest.raises(WeakNetwork, match=r"translation.*rotation.*scale"):
        adjust_network(on_passes(network(pair(ties=80), laser=False), nothing, 3), SolverSettings())


# --- what is said of it


def test_redundancy_of_all_rows_is_that_of_the_network() -> None:
    net = on_passes(network(pair(ties=60, shots=12)))
    solution = adjust_network(net, SolverSettings(**TIGHT))
    assert reliability(solution).degrees_of_freedom == pytest.approx(solution.fit.degrees_of_freedom, abs=1e-5)
    groups = group_redundancy(at_solution(solution), group_rows(net))
    assert groups.redundancy.sum() == pytest.approx(solution.fit.degrees_of_freedom, abs=1e-5)
    assert groups.sums_of_squares.sum() == pytest.approx(2.0 * solution.cost_final, rel=1e-6)


def test_scaling_groups_scales_their_rows() -> None:
    """Rows that join a node with its trend hold two groups: with no trend in the values they scale as the node's."""
    net = on_passes(network(pair(ties=20, shots=4)))
    grouping = group_rows(net)
    factors = 2.0 ** (1.0 + np.arange(len(grouping.names)))
    before, after = (lay_out(one, SolverSettings()) for one in (net, scaled(net, grouping, factors)))
    of_nodes = [k for k, name in enumerate(grouping.names) if "node" in name]
    values = np.random.default_rng(1).standard_normal(before.columns) * before.scales
    values[~np.isin(grouping.of_columns(before), of_nodes)] = 0.0
    old, new = (one.prior.residuals(values)[one.columns :] for one in (before, after))
    ratio = factors[grouping.of_columns(before)[before.prior.about]][np.count_nonzero(before.prior.weights) :]
    assert np.count_nonzero(old) > 50
    np.testing.assert_allclose(old, ratio * new, rtol=1e-9)


def test_no_direction_is_known_less_than_before() -> None:
    """Of nodes that are known together a whole bias of the pass counts by its own a-priori sigma, not a node's."""
    net = on_passes(network(pair(ties=30, shots=12)), intervals=4)
    solution = adjust_network(net, SolverSettings(**TIGHT))
    ratios = np.array([one.ratio for one in weak_directions(solution, 12)])
    layout = lay_out(net, SolverSettings())
    root = np.linalg.cholesky(np.linalg.inv(layout.prior.normal()))
    whitened = np.linalg.solve(root, np.linalg.solve(root, solution.joint_covariance.dense()).T)
    values = np.sqrt(np.linalg.eigvalsh(whitened)[::-1])
    assert values[0] <= 1.0 + 1e-9
    assert ratios[0] == pytest.approx(values[0], rel=1e-6)
    assert np.all(ratios <= values[0] * (1.0 + 1e-6))
    few, _ = spectrum(solution.joint_covariance, layout.scales, 5, layout.prior.whitening(layout.scales), dense=0)
    np.testing.assert_allclose(np.sqrt(few[:5]), values[:5], rtol=1e-4)


PLACES = 7
AXES = turned(0.1, 0.2, 3.0)
PROFILED = {
    "polynomials": network(pair(20, 6)),
    "nodes": on_passes(network(pair(20, 6)), mounted={0: AXES, 1: AXES}),
    "shared unknowns": with_all_kinds(with_shift_and_surface(network(pair(), held=(True, False)))),
}


@pytest.mark.parametrize(
    ("name", "angles"),
    [("polynomials", "camera"), ("polynomials", "opk-paper"), ("nodes", "camera"), ("shared unknowns", "camera")],
)
def test_profiles_of_images_together_are_each_by_itself(
    name: str, angles: Angles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the whole correction of each and the covariance of its coefficients, and against single poses."""
    solution = adjust_network(PROFILED[name], SolverSettings(angles=angles))
    monkeypatch.setattr(of_solution, "_TOGETHER", 1)  # block by block
    found, posterior = orientation_profiles(solution, [1, 0], PLACES), Posterior.of(solution)
    for k, image in enumerate([1, 0]):
        picture, correction = solution.network.images[image], solution.correction(image)
        lines, at = np.linspace(0.0, picture.lines, PLACES), slice(k * PLACES, (k + 1) * PLACES)
        np.testing.assert_array_equal(found.lines[at], lines)
        np.testing.assert_array_equal(found.position_before[at], picture.pose(lines).position)
        np.testing.assert_allclose(found.position_after[at], picture.pose(lines, correction).position, rtol=1e-14)
        basis = np.kron(correction.basis(picture.moments(lines)), np.eye(6)).reshape(PLACES, 6, -1)
        covariance = basis @ solution.correction_covariance(image) @ basis.mT
        sigmas = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
        np.testing.assert_allclose(found.position_sigma[at], sigmas, rtol=1e-9, atol=1e-12)
        axes = correction.axes(picture.pose(lines), picture.moments(lines))
        turned = axes @ covariance[:, 3:, 3:] @ axes.mT
        sigmas = np.sqrt(np.diagonal(turned, axis1=1, axis2=2))
        np.testing.assert_allclose(found.rotation_sigma[at], sigmas, rtol=1e-9, atol=1e-15)
        one = posterior.pose(picture.name, float(lines[2])).covariance
        np.testing.assert_allclose(found.position_sigma[at][2], np.sqrt(np.diagonal(one))[:3], rtol=1e-6, atol=1e-9)


# --- covariances a priori


def test_an_image_of_which_nothing_is_known_has_no_a_priori_covariance() -> None:
    net = network(pair())
    unknown = OrientationPrior(np.full_like(net.priors[0].sigmas, np.inf))
    net = replace(net, priors=(unknown, net.priors[1]))
    assert prior_covariance(lay_out(net, SolverSettings())) is None


@pytest.mark.parametrize(("share", "forgets"), [(1.0, 0.0), (1e-2, 60.0), (1e-6, 0.0), (1e-6, 60.0)])
def test_a_priori_covariance_of_nodes_that_hardly_leave_their_trend(share: float, forgets: float) -> None:
    """In closed form: bias, drift, and departures that are correlated by the time between them."""
    errors = TrajectoryErrors()
    errors = replace(errors, attitude_wander=share * errors.attitude_wander, correlation_time=forgets,
                     position_wander=share * errors.position_wander)  # fmt: skip
    settings = BlockSettings(passes=2, length=120e3, points=100, terrain=None, errors=errors)
    net = simulate_hrsc_block(settings, seed=4).network
    joint = prior_covariance(lay_out(net, SolverSettings()))
    assert joint is not None
    for pass_, first in zip(net.passes, net.first_of_passes.tolist(), strict=False):
        times = pass_.nodes.times
        ago = np.abs(times[:, None] - times)
        along = 2.0 * (times - times[0]) / (times[-1] - times[0]) - 1.0
        course = np.exp(-ago / forgets) if forgets else np.eye(times.size)
        sizes = [(errors.position, errors.position_drift, errors.position_wander)] * 3
        sizes += [(errors.attitude, errors.attitude_drift, errors.attitude_wander)] * 3
        found = joint.of(range(first, first + times.size))
        for axis, (bias, drift, wander) in enumerate(sizes):
            want = bias**2 + drift**2 * np.multiply.outer(along, along) + wander**2 * course
            np.testing.assert_allclose(found[axis::6, axis::6], want, rtol=1e-9)
    first, second, end = net.first_of_passes.tolist()
    assert not np.any(joint.of(range(first, end))[: joint.of(range(first, second)).shape[0], -6:])


# above two seconds: every unknown is moved by itself


# above two seconds: many draws
def test_forward_intersection_carries_the_orientation_on() -> None:
    """Covariances of points a priori, against places of the simulated truth and many others by the same prior."""
    settings = BlockSettings(passes=2, length=40e3, points=20, spacing=20.0, terrain=None)
    net, squares = simulate_hrsc_block(settings, seed=4).network, []
    covariances = forward_intersection(net)[1]
    for seed in range(30):
        drawn = redraw(net, np.random.default_rng(seed))
        error = forward_intersection(drawn.network)[2] - drawn.places
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariances), error).mean() / 3.0)
    assert np.mean(squares) == pytest.approx(1.0, abs=5.0 * np.std(squares) / np.sqrt(len(squares)))
