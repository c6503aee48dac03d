"""Orientation images: the bundle form against the explicit one and against polynomials."""

from dataclasses import replace

import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import as_nodes, network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import orientation_profile
from mgsgraph.analysis.grouping import group_redundancy, group_rows, scaled
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.weak import spectrum, weak_directions
from mgsgraph.errors import WeakNetwork
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior, evenly_spaced
from mgsgraph.network import Network, NodePrior, Pass
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import PointMatching

TIGHT = {"cost_tolerance": 1e-14, "step_tolerance": 1e-9}
PRIOR = NodePrior(
    np.array([80.0] * 3 + [2e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.array([50.0] * 3 + [1e-4, 0.0, 1e-4]), 4.0
)


def stripped(net: Network, nodes: int = 6, prior: NodePrior = PRIOR) -> Network:
    """Each image a strip of its own."""
    strips = []
    for j, image in enumerate(net.images):
        epoch, (start, stop) = image.trajectory.epoch, image.timing.at(np.array([0.0, float(image.lines)]))[0]
        mine = evenly_spaced("lagrange", epoch, (start, stop), (stop - start) / nodes)
        strips.append(Pass(image.name, np.array([j]), mine, prior))
    return replace(net, passes=tuple(strips))


@pytest.mark.parametrize("line", ["predicted", "measured"])
def test_forms_agree(line: str) -> None:
    net = stripped(network(pair(ties=60, shots=12)))
    settings = SolverSettings(line=line, **TIGHT)  # type: ignore[arg-type]
    bundle = adjust_network(net, settings)
    explicit = by_gtsam(bundle)

    assert bundle.converged
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    assert bundle.fit.squares == pytest.approx(2.0 * bundle.cost_final, rel=1e-7)
    np.testing.assert_allclose(bundle.places, explicit.places, atol=1e-3)
    for one, other in zip(bundle.nodes, explicit.nodes, strict=True):
        assert np.abs((one - other) / PRIOR.sigmas).max() < 1e-5
    covariance, reference = bundle.joint_covariance.dense(), explicit.joint_covariance.dense()
    scale = np.sqrt(np.diagonal(reference))
    assert np.abs((covariance - reference) / np.outer(scale, scale)).max() < 1e-6
    np.testing.assert_allclose(bundle.covariances, explicit.covariances, rtol=1e-4, atol=1e-3)


def test_four_nodes_are_a_cubic_polynomial() -> None:
    """A cubic Lagrange basis on four nodes with the polynomial's prior, transformed: the same cost, everywhere."""
    trend = np.array([1.0, 0.3, 0.1, 0.05])[:, None] * np.array([100.0] * 3 + [3e-4] * 3)
    plain = network(pair(ties=60, shots=12))
    plain = replace(plain, priors=(OrientationPrior(trend),) * 2)
    strips = []
    for j, image in enumerate(plain.images):
        epoch, (start, stop) = image.trajectory.epoch, image.timing.at(np.array([0.0, float(image.lines)]))[0]
        nodes = evenly_spaced("lagrange", epoch, (start, stop), (stop - start) / 3.0)
        u = image.normalised(image.timing.lines(nodes.times))
        strips.append(Pass(image.name, np.array([j]), nodes, as_nodes(plain.priors[j], nodes, u)))
    polynomial = adjust_network(plain, SolverSettings(**TIGHT))
    through_nodes = adjust_network(replace(plain, passes=tuple(strips)), SolverSettings(**TIGHT))

    assert through_nodes.cost_initial == pytest.approx(polynomial.cost_initial, rel=1e-12)
    assert through_nodes.cost_final == pytest.approx(polynomial.cost_final, rel=1e-9)
    np.testing.assert_allclose(through_nodes.places, polynomial.places, atol=1e-4)
    np.testing.assert_allclose(through_nodes.covariances, polynomial.covariances, rtol=1e-5, atol=1e-5)
    for j, image in enumerate(plain.images):
        lines = np.linspace(0.0, image.lines, 7)
        want, found = (one.correction(j).at(image.moments(lines))[0] for one in (polynomial, through_nodes))
        np.testing.assert_allclose((found - want) / trend[0], 0.0, atol=1e-6)


def test_redundancy_of_all_rows_is_that_of_the_network() -> None:
    net = stripped(network(pair(ties=60, shots=12)))
    solution = adjust_network(net, SolverSettings(**TIGHT))
    rows = reliability(solution)

    assert rows.degrees_of_freedom == pytest.approx(solution.fit.degrees_of_freedom, abs=1e-5)
    groups = group_redundancy(at_solution(solution), group_rows(net))
    assert groups.redundancy.sum() == pytest.approx(solution.fit.degrees_of_freedom, abs=1e-5)
    assert groups.squares.sum() == pytest.approx(2.0 * solution.cost_final, rel=1e-6)
    names = rows.names(np.flatnonzero(rows.measures.kind == MeasureKind.PRIOR))
    first = net.images[0].name
    since = 2.0 * net.passes[0].nodes.spacing
    assert f"a-priori rotation x of node 3 of 7 ({since:.6g} s past the first) of pass {first}" in names
    assert f"a-priori X of bias of pass {first}" in names


def test_scaling_a_group_scales_its_rows() -> None:
    net = stripped(network(pair(ties=20, shots=4)))
    grouping = group_rows(net)
    factors = 2.0 ** (1.0 + np.arange(len(grouping.names)))
    after = scaled(net, grouping, factors)
    before, later = (lay_out(one, SolverSettings()) for one in (net, after))
    ratio = factors[grouping.of_columns(before)[before.prior.about]]
    values = np.random.default_rng(1).standard_normal(before.columns) * before.scales

    whole = slice(int(np.count_nonzero(before.prior.weights)), None)
    for k, name in enumerate(grouping.names):
        if "node" in name or "trend" in name:
            mine = np.flatnonzero(ratio == factors[k])
            assert mine.size, name
            assert mine.min() >= whole.start, name
    # rows that join a node with its trend hold two groups: alone, with no trend in the values, they scale as one
    values[~np.isin(grouping.of_columns(before), [k for k, name in enumerate(grouping.names) if "node" in name])] = 0.0
    old, new = (one.prior.residuals(values)[one.columns :] for one in (before, later))
    assert np.count_nonzero(old) > 50
    np.testing.assert_allclose(old, ratio[whole] * new, rtol=1e-9)


def test_a_free_strip_names_its_datum() -> None:
    """Nodes of which nothing is known, and no laser: translation, rotation and scale are free."""
    nothing = NodePrior(np.full(6, np.inf), np.zeros(6), np.zeros(6))
    net = stripped(network(pair(ties=80), laser=False), nodes=3, prior=nothing)
    with pytest.raises(WeakNetwork, match=r"translation.*rotation.*scale"):
        adjust_network(net, SolverSettings())


def test_poses_and_projections_follow_from_the_whole_covariance() -> None:
    """Against J S J' with derivatives of the corrected pose by differences and the dense covariance of all unknowns."""
    net = stripped(network(pair(ties=60, shots=12)))
    solution = adjust_network(net, SolverSettings(**TIGHT))
    posterior, image, line = Posterior.of(solution), net.images[1], np.array([0.37 * net.images[1].lines])
    first, nodes = int(net.first_of_passes[1]), solution.nodes[1]
    covariance = solution.joint_covariance.of(range(first, first + len(nodes)))

    def pose(moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        correction = OrientationCorrection(np.vstack([np.zeros((1, 6)), moved]), nodes=net.passes[1].nodes)
        found = image.pose(line, correction)
        return found.position[0], found.matrix[0]

    place, matrix = pose(nodes)
    steps = np.tile([1.0] * 3 + [1e-6] * 3, len(nodes))
    jacobian = np.zeros((6, nodes.size))
    for k, step in enumerate(steps):
        change = (np.arange(nodes.size) == k).reshape(nodes.shape) * step
        (up, up_matrix), (down, down_matrix) = pose(nodes + change), pose(nodes - change)
        jacobian[:3, k] = (up - down) / (2.0 * step)
        jacobian[3:, k] = -rotation.logarithm(up_matrix @ down_matrix.T) / (2.0 * step)
    found = posterior.pose(image.name, float(line[0]))

    np.testing.assert_allclose(found.position, place, atol=1e-8)
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-14)
    want = jacobian @ covariance @ jacobian.T
    scale = np.sqrt(np.diagonal(want))
    assert np.abs((found.covariance - want) / np.outer(scale, scale)).max() < 1e-6
    profile = orientation_profile(solution, 1, 3)
    middle = posterior.pose(image.name, float(profile.lines[1])).covariance
    np.testing.assert_allclose(profile.position_sigma[1], np.sqrt(np.diagonal(middle))[:3], rtol=1e-9)


def test_no_direction_is_known_less_than_before() -> None:
    """Of nodes that are known together a whole bias of the strip counts by its own a-priori sigma, not a node's."""
    net = stripped(network(pair(ties=60, shots=12)))
    solution = adjust_network(net, SolverSettings(**TIGHT))
    weakest = weak_directions(solution, 12)
    ratios = np.array([one.ratio for one in weakest])

    layout = lay_out(net, SolverSettings())
    root = np.linalg.cholesky(np.linalg.inv(layout.prior.normal()))
    whitened = np.linalg.solve(root, np.linalg.solve(root, solution.joint_covariance.dense()).T)
    values = np.sqrt(np.linalg.eigvalsh(whitened)[::-1])
    assert values[0] <= 1.0 + 1e-9
    assert ratios[0] == pytest.approx(values[0], rel=1e-6)
    assert np.all(ratios <= values[0] * (1.0 + 1e-6))
    few, _ = spectrum(solution.joint_covariance, layout.scales, 5, layout.prior.whitening(layout.scales), dense=0)
    np.testing.assert_allclose(np.sqrt(few[:5]), values[:5], rtol=1e-4)
    assert any("node" in one.sentence or "strip" in one.sentence for one in weakest)


def test_a_blunder_goes_and_the_point_stays() -> None:
    """One bad ray of five pulls its point off the others: these must not go with it."""
    matches = PointMatching(blunders=0.01)
    block = simulate_hrsc_block(BlockSettings(strips=1, length=200e3, points=600, terrain=None, matches=matches), 1)
    solution = adjust_network(block.network, SolverSettings(reject=4.5))
    gone = ~solution.rays_used
    assert np.count_nonzero(block.blunders) >= 20
    assert np.count_nonzero(block.blunders & ~gone) <= 1
    assert np.count_nonzero(gone & ~block.blunders) <= 3
    assert np.count_nonzero(~solution.determined) <= 1
