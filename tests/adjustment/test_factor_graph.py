"""The factor graph in a GTSAM user's hands: GTSAM's optimizers, iSAM2 and marginals, factors of one's own, and back."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import gtsam
import numpy as np
import pytest
from networks import network, on_passes, pair, with_neighbors, with_shift_and_surface
from outside import refuses
from sharing import with_all_kinds
from stereo_pair import stereo_network

import mgsgraph
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import WeakNetwork
from mgsgraph.network import Network, SharedKind, SharedUnknown

NETWORKS: dict[str, Callable[[], Network]] = {
    "pair": lambda: network(pair()),
    "shifts and terrain": lambda: with_shift_and_surface(network(pair())),
    "first held": lambda: network(pair(), held=(True, False)),
    "nodes": lambda: on_passes(network(pair())),
    "stereo surface": lambda: stereo_network(pair(12, 24)),
    "all shared unknowns": lambda: with_all_kinds(with_shift_and_surface(network(pair()))),
    "neighbors": lambda: with_neighbors(with_shift_and_surface(network(pair(40)))),
}


@cache
def adjusted(name: str) -> Solution:
    return mgsgraph.adjust_network(NETWORKS[name](), SolverSettings(cost_tolerance=1e-13))


def strict(parameters: Any) -> Any:
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    parameters.setMaxIterations(100)
    return parameters


OPTIMIZERS: dict[str, Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], gtsam.Values]] = {
    "Levenberg-Marquardt": lambda graph, values: gtsam.LevenbergMarquardtOptimizer(
        graph, values, strict(gtsam.LevenbergMarquardtParams())
    ).optimize(),
    "Gauss-Newton": lambda graph, values: gtsam.GaussNewtonOptimizer(
        graph, values, strict(gtsam.GaussNewtonParams())
    ).optimize(),
    "dogleg": lambda graph, values: gtsam.DoglegOptimizer(graph, values, strict(gtsam.DoglegParams())).optimize(),
    "ours": lambda graph, values: mgsgraph.optimize(graph, values).values,
}


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("name", ["pair", "shifts and terrain"])
def test_any_optimizer_finds_the_cost_of_the_adjustment(name: str, optimizer: str) -> None:
    graph, values, _ = mgsgraph.factor_graph(NETWORKS[name]())
    found = OPTIMIZERS[optimizer](graph, values)
    assert graph.error(found) == pytest.approx(adjusted(name).cost_final, rel=1e-9)


@pytest.mark.parametrize("name", NETWORKS)
def test_marginals_are_the_covariances_of_the_adjustment(name: str) -> None:
    """Shared effects, which the bundle form takes for constant about a ray, cost the last digits."""
    solution, share = adjusted(name), 1e-5 if name == "all shared unknowns" else 1e-6
    graph, values, keys = mgsgraph.factor_graph(solution.network)
    found = mgsgraph.optimize(graph, values)
    assert found.converged
    assert found.cost == pytest.approx(solution.cost_final, rel=1e-9)
    marginals, joint = mgsgraph.Marginals(graph, found.values), solution.joint_covariance
    for i in np.flatnonzero(solution.determined).tolist():
        right = solution.covariances[i]
        np.testing.assert_allclose(marginals.covariance(keys.point(i)), right, rtol=0.0, atol=share * right.max())
    for j in np.flatnonzero(solution.network.with_polynomial).tolist():
        right = joint.block(j, j)
        off = marginals.covariance(keys.image(j)) - right
        sigmas = np.sqrt(np.diag(right))
        assert np.abs(off / sigmas / sigmas[:, None]).max() < 10.0 * share


def test_joint_covariances_are_those_of_gtsam() -> None:
    """Of points with one another and with an image, in the order asked for."""
    graph, values, keys = mgsgraph.factor_graph(adjusted("pair"))
    asked = [keys.point(3), keys.image(1), keys.point(0)]
    found = mgsgraph.Marginals(graph, values).covariance(*asked)
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(gtsam.KeyVector(asked))
    right = np.block([[joint.at(one, other) for other in asked] for one in asked])
    sigmas = np.sqrt(np.diag(right))
    assert np.abs((found - right) / sigmas / sigmas[:, None]).max() < 1e-6


def test_isam2_comes_to_its_threshold() -> None:
    graph, values, keys = mgsgraph.factor_graph(NETWORKS["pair"]())
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(1e-6)
    parameters.relinearizeSkip = 1
    isam = gtsam.ISAM2(parameters)
    isam.update(graph, values)
    for _ in range(5):
        isam.update()
    found = isam.calculateEstimate()
    assert graph.error(found) == pytest.approx(adjusted("pair").cost_final, rel=1e-6)
    point = isam.marginalCovariance(keys.point(0))
    np.testing.assert_allclose(point, adjusted("pair").covariances[0], rtol=0.0, atol=1e-5 * point.max())


def test_small_sigmas_are_no_singular_system() -> None:
    """Ties of 0.08 px and ranges of 2 cm, whose unknowns of m and of rad GTSAM's elimination takes for undetermined."""
    net = network(pair(ties=40, shots=20))
    net = replace(
        net, rays=replace(net.rays, sigmas=np.full_like(net.rays.sigmas, 0.08)),
        ranges=replace(net.ranges, sigmas=np.full_like(net.ranges.sigmas, 0.02)),
    )  # fmt: skip
    graph, values, keys = mgsgraph.factor_graph(net)
    found = mgsgraph.optimize(graph, values)
    solution = mgsgraph.adjust_network(net, SolverSettings(cost_tolerance=1e-13))
    assert found.cost == pytest.approx(solution.cost_final, rel=1e-9)
    covariance = mgsgraph.Marginals(graph, found.values).covariance(keys.point(3))
    np.testing.assert_allclose(covariance, solution.covariances[3], rtol=0.0, atol=1e-6 * covariance.max())


# --- there and back


@pytest.mark.parametrize("name", NETWORKS)
def test_a_solution_comes_back(name: str) -> None:
    """What `optimize` found is a solution with the adjustment's figures, whose graph begins at the minimum."""
    net, solution = NETWORKS[name](), adjusted(name)
    graph, values, _ = mgsgraph.factor_graph(net)
    found = mgsgraph.solution_of(net, mgsgraph.optimize(graph, values).values)
    assert found.converged, found.message
    assert found.cost_final == pytest.approx(solution.cost_final, rel=1e-9)
    np.testing.assert_allclose(found.places, solution.places, rtol=0.0, atol=5e-3)
    np.testing.assert_allclose(found.residuals, solution.residuals, rtol=0.0, atol=1e-3)
    assert found.fit.degrees_of_freedom == solution.fit.degrees_of_freedom
    again, at, _ = mgsgraph.factor_graph(solution)
    assert again.error(at) == pytest.approx(solution.cost_final, rel=1e-9)


def test_what_was_rejected_has_no_factor() -> None:
    net = network(pair())
    places = net.rays.places.copy()
    places[5] += 300.0
    net = replace(net, rays=replace(net.rays, places=places))
    solution = mgsgraph.adjust_network(net, SolverSettings(reject=3.0))
    whole, left = (mgsgraph.factor_graph(one)[0] for one in (net, solution))
    assert whole.size() - left.size() == np.count_nonzero(~solution.rays_used)
    assert mgsgraph.solution_of(solution, mgsgraph.factor_graph(solution).values).converged


def distance(first: int, second: int, measured: float, sigma: float) -> gtsam.CustomFactor:
    """A surveyed distance between two ground points, m."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        apart = values.atPoint3(second) - values.atPoint3(first)
        length = np.linalg.norm(apart)
        if jacobians is not None:
            for k, sign in enumerate((-1.0, 1.0)):
                jacobians[k] = np.asfortranarray(sign * apart[None] / length)
        return np.array([length - measured])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), [first, second], error)


def test_a_factor_of_ones_own_on_points() -> None:
    """A surveyed distance holds; the solution has what was optimized, with the covariances of that graph."""
    solution = adjusted("pair")
    graph, values, keys = mgsgraph.factor_graph(solution)
    first, second = (keys.point(name) for name in solution.network.points.ids[:2])
    before = float(np.linalg.norm(solution.places[1] - solution.places[0]))
    graph.add(distance(first, second, before + 5.0, 0.01))
    found = mgsgraph.optimize(graph, values)
    with_it = mgsgraph.solution_of(solution, found.values, graph)
    assert with_it.converged, with_it.message
    assert np.linalg.norm(with_it.places[1] - with_it.places[0]) == pytest.approx(before + 5.0, abs=0.05)
    assert with_it.cost_final > solution.cost_final
    marginals = gtsam.Marginals(graph, found.values)
    for i in (0, 1, 7):
        right = marginals.marginalCovariance(keys.point(i))
        np.testing.assert_allclose(with_it.covariances[i], right, rtol=0.0, atol=1e-6 * right.max())
    right = marginals.marginalCovariance(keys.image(1))
    np.testing.assert_allclose(with_it.joint_covariance.block(1, 1), right, rtol=1e-4, atol=1e-6 * right.max())
    assert not mgsgraph.solution_of(solution, found.values).converged  # without it the minimum is elsewhere
    assert (with_it.own_factors, solution.own_factors) == (1, 0)
    refuses("Marginals", mgsgraph.Posterior.of, with_it)
    assert mgsgraph.verdict(with_it).state.value == "suspect"  # nothing of it is tested


def test_a_factor_of_ones_own_in_the_fast_form() -> None:
    """On what points share, it is a linear row of the adjustment: both forms find the same."""
    net = NETWORKS["shifts and terrain"]()
    graph, values, keys = mgsgraph.factor_graph(net)
    key, factors = keys.image(0), gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([np.full(3, 5.0), np.full(3, 1e-6), np.full(12, 1e3)]))
    factors.add(gtsam.PriorFactorVector(key, np.concatenate([[20.0, -10.0, 5.0], np.zeros(15)]), model))
    factors.add(mgsgraph.factors.linear_prior([keys.image(1), key], [np.eye(18)[:3], -np.eye(18)[:3]], np.zeros(3)))
    graph.push_back(factors)
    found = mgsgraph.optimize(graph, values)
    anew = mgsgraph.with_factors(net, [factors.at(0), factors.at(1)])
    solution = mgsgraph.adjust_network(anew, SolverSettings(cost_tolerance=1e-13))
    assert solution.cost_final == pytest.approx(found.cost, rel=1e-9)
    right = mgsgraph.Marginals(graph, found.values).covariance(key)
    sigmas = np.sqrt(np.diag(right))
    off = solution.joint_covariance.block(0, 0) - right
    assert np.abs(off / sigmas / sigmas[:, None]).max() < 1e-5
    assert mgsgraph.factor_graph(anew).graph.size() == graph.size()
    elsewhere = mgsgraph.with_factors(net, [factors.at(0), factors.at(1)], found.values)
    for one, other in zip(anew.linear, elsewhere.linear, strict=True):  # linear factors are the same everywhere
        np.testing.assert_allclose(one.target, other.target, rtol=0.0, atol=1e-6)
    refuses("key p0", mgsgraph.with_factors, net, [distance(keys.point(0), keys.point(1), 1.0, 1.0)])


# --- keys, and what cannot be


def test_keys_are_asked_for_by_names() -> None:
    net = NETWORKS["all shared unknowns"]()
    graph, values, keys = mgsgraph.factor_graph(net)
    named = [
        keys.image(net.images[0].name), keys.point(net.points.ids[3]), keys.profile(net.shift_names[0]),
        keys.shared(net.shared[0].name),
    ]  # fmt: skip
    assert all(values.exists(key) for key in named)
    assert len({keys.name(key) for key in values.keys()}) == values.size()
    assert [keys.name(key).split()[0] for key in named] == ["image", "point", "shift", "shared"]
    assert set(values.keys()) == set(graph.keyVector())
    on = NETWORKS["nodes"]()
    keys = mgsgraph.factor_graph(on).keys
    key = keys.node(on.passes[0].name, 0)
    assert keys.name(key) == f"orientation image 0 of pass {on.passes[0].name}"
    assert keys.number(key) == int(on.first_of_passes[0])


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda keys: keys.image("nothing"), "nothing"),
        (lambda keys: keys.point("nothing"), "nothing"),
        (lambda keys: keys.image(0), "held"),
        (lambda keys: keys.number(gtsam.symbol("z", 3)), "key z3"),
        (lambda keys: keys.number(gtsam.symbol("o", 99)), "key o99"),
        (lambda keys: keys.number(gtsam.symbol("o", 0)), "held"),
    ],
)
def test_keys_of_what_is_not_there(ask: Callable[[Any], Any], said: str) -> None:
    refuses(said, ask, mgsgraph.factor_graph(NETWORKS["first held"]()).keys)


def test_values_that_lack_an_unknown() -> None:
    net = NETWORKS["pair"]()
    values = mgsgraph.factor_graph(net).values
    values.erase(mgsgraph.factor_graph(net).keys.image(1))
    refuses(f"image {net.images[1].name}", mgsgraph.solution_of, net, values)


def test_a_graph_that_is_another_network_s() -> None:
    """Its values fit, its cost does not: not converged, and the message says so. One that lacks a point is refused."""
    net, factors = NETWORKS["pair"](), gtsam.NonlinearFactorGraph()
    graph, values, keys = mgsgraph.factor_graph(net)
    other = replace(net, rays=replace(net.rays, places=net.rays.places + 5.0, sigmas=10.0 * net.rays.sigmas))
    foreign = mgsgraph.factor_graph(other).graph
    found = mgsgraph.solution_of(net, mgsgraph.optimize(foreign, values).values, foreign)
    assert not found.converged
    assert "another network" in found.message
    for i in range(graph.size()):
        if keys.point(2) not in graph.at(i).keys():
            factors.add(graph.at(i))
    refuses(f"no factor on point {net.points.ids[2]}", mgsgraph.solution_of, net, values, factors)
    values.erase(keys.image(0))
    values.insert(keys.image(0), np.zeros(12))
    refuses(f"12 numbers of image {net.images[0].name}; expected 18", mgsgraph.solution_of, net, values)


def test_what_no_graph_is_made_of() -> None:
    refuses("a str; expected a Case, Network or Solution", mgsgraph.factor_graph, "case.toml")
    refuses("no factors", mgsgraph.optimize, gtsam.NonlinearFactorGraph(), gtsam.Values())
    graph, values, keys = mgsgraph.factor_graph(NETWORKS["pair"]())
    left = gtsam.Values(values)
    left.erase(keys.point(0))
    refuses("none of variable p0", mgsgraph.optimize, graph, left)
    values.insert(gtsam.symbol("z", 5), np.zeros(3))  # a further variable stays as it is
    assert mgsgraph.optimize(graph, values).values.exists(gtsam.symbol("z", 5))
    values.update(keys.point(0), 3.0 * values.atPoint3(keys.point(0)))
    refuses(f"point {NETWORKS['pair']().points.ids[0]}.*doesn't see", mgsgraph.optimize, graph, values)


def test_an_unknown_that_nothing_determines_is_named() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorVector(0, np.zeros(2), gtsam.noiseModel.Diagonal.Precisions(np.array([1.0, 0.0]))))
    values.insert(0, np.ones(2))
    with pytest.raises(WeakNetwork):
        mgsgraph.optimize(graph, values)


def test_considered_unknowns_are_held() -> None:
    bias = SharedUnknown("bias", SharedKind.RANGE_BIAS, np.array([0]), np.array([30.0]))
    net = replace(network(pair()), shared=(bias,), considered=("bias",))
    graph, values, keys = mgsgraph.factor_graph(net)
    assert abs(mgsgraph.optimize(graph, values).values.atVector(keys.shared("bias"))[0]) < 1e-3
