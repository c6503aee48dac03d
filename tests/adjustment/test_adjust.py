"""The bundle form and GTSAM's optimiser on the explicit one agree; sigmas are realistic; blunders go and return."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from explicit_form import by_gtsam
from increments import network_of, strip
from networks import network, pair
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network, predict
from mgsgraph.adjustment.factor_graph import factor_graph
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.optimize import optimize
from mgsgraph.adjustment.rounds import all_rows, solve_in_rounds
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError, PointBehindCamera, WeakNetwork
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import Network, PointClass, ProfileShifts
from mgsgraph.network.parts import select_points, without_images
from mgsgraph.simulation.demo.demonstration import nees

TIGHT = {"cost_tolerance": 1e-14, "step_tolerance": 1e-9}


@pytest.mark.parametrize(
    ("loss", "line", "held"),
    [("none", "predicted", (True, False)), ("huber", "measured", (False, False)),
     ("cauchy", "predicted", (False, False)), ("none", "measured", (True, False))],
)  # fmt: skip
def test_forms_agree(loss: str, line: str, held: tuple[bool, bool]) -> None:
    net = network(pair(), held)
    settings = SolverSettings(loss=loss, line=line, **TIGHT)
    bundle = adjust_network(net, settings)
    explicit = by_gtsam(bundle)
    assert bundle.converged
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    for first, second, prior in zip(bundle.coefficients, explicit.coefficients, net.priors, strict=True):
        assert np.abs((first - second) / prior.sigmas).max() < 1e-5
    np.testing.assert_allclose(bundle.places, explicit.places, atol=1e-3)


def test_a_profiles_shift_is_found() -> None:
    """All footprints moved by 80 m east and -50 m north: the shift takes them back (but for what its prior holds)."""
    drawn = pair(ties=40, shots=20)
    net = network(drawn)
    laser = net.points.classes == PointClass.LASER
    shifts = ProfileShifts(("p",), np.where(laser, 0, -1), np.array([100.0]))
    places = net.points.places.copy()
    places[laser] += [80.0, -50.0] @ east_north(places[laser])
    points = replace(net.points, places=places)
    solution = adjust_network(replace(net, points=points, shifts=shifts), SolverSettings())
    plain = adjust_network(replace(net, shifts=shifts), SolverSettings())
    np.testing.assert_allclose(solution.shifts - plain.shifts, [[-80.0, 50.0]], atol=12.0)
    error = solution.shifts[0] - plain.shifts[0] + [80.0, -50.0]
    sigma = np.sqrt(np.diag(solution.shift_covariance(0)))
    assert np.all(np.abs(error) < 3.0 * sigma)
    assert np.all(sigma < 60.0)


def test_honest_sigmas_over_ten_seeds() -> None:
    """NEES per degree of freedom of orientation and points, and cost per degree of freedom, near 1."""
    orientation, points, cost = [], [], []
    for seed in range(10):
        drawn = pair(ties=30, shots=12, seed=100 + seed)
        solution = adjust_network(network(drawn), SolverSettings())
        pairs = zip(solution.coefficients, drawn.true_corrections, strict=True)
        errors = np.concatenate([(mine - true.coefficients).ravel() for mine, true in pairs])
        orientation.append(nees(errors[None], solution.joint_covariance.dense()[None])[0] / errors.size)
        true_places = np.concatenate([drawn.true_ties, drawn.true_footprints])
        points.append(nees(solution.places - true_places, solution.covariances).mean() / 3.0)
        cost.append(2.0 * solution.cost_final / solution.fit.degrees_of_freedom)
    # 99.9% bands: chi-square with 360 and about 10 x 63 degrees of freedom; points of a draw share their orientation
    assert 0.77 < np.mean(orientation) < 1.27
    assert 0.6 < np.mean(points) < 1.5
    assert 0.82 < np.mean(cost) < 1.2


def test_rows_are_admitted_again() -> None:
    """What is out returns where what is left agrees with it."""
    net = network(pair(ties=40))
    layout = lay_out(net, SolverSettings())
    whole = all_rows(net)
    without = replace(whole, rays=np.arange(net.rays.point.size) % 7 != 0)
    before = BundleGraph(layout, without.rows(layout)).reduction(np.zeros(layout.columns))
    solved = solve_in_rounds(layout, SolverSettings(reject=6.0), without, before, lambda _: None)
    assert np.all(solved.selection.rays)


def test_held_image_does_not_move() -> None:
    solution = adjust_network(network(pair(), (True, False)), SolverSettings())
    assert not np.any(solution.coefficients[0])
    assert np.any(solution.coefficients[1])
    assert solution.joint_covariance.adjusted.tolist() == [1]
    assert not np.any(solution.image_covariance(0))


def test_all_images_held_is_intersection() -> None:
    solution = adjust_network(network(pair(), (True, True)), SolverSettings())
    assert solution.converged
    assert solution.iterations == 0
    ties = solution.members(PointClass.TIE)
    np.testing.assert_allclose(solution.places[ties], solution.places_before[ties], atol=1e-9)
    assert np.all(np.isfinite(solution.sigmas))


def fixed_points(net: Network, kind: PointKind, places: np.ndarray, sigma: float) -> Network:
    n = len(net.points)
    covariances = (
        np.broadcast_to(np.eye(3) * sigma**2, (n, 3, 3)) if kind == PointKind.CONSTRAINED else np.zeros((n, 3, 3))
    )
    return replace(net, points=replace(net.points, kinds=np.full(n, kind), places=places, covariances=covariances))


def test_tightly_constrained_points_tend_to_fixed_ones() -> None:
    drawn = pair(ties=30)
    net = network(drawn)
    places = np.concatenate([drawn.true_ties, drawn.true_footprints])
    fixed = adjust_network(fixed_points(net, PointKind.FIXED, places, 0.0), SolverSettings())
    tight = adjust_network(fixed_points(net, PointKind.CONSTRAINED, places, 1e-4), SolverSettings())
    assert fixed.cost_final == pytest.approx(tight.cost_final, rel=1e-6)
    for one, other, prior in zip(fixed.coefficients, tight.coefficients, net.priors, strict=True):
        assert np.abs((one - other) / prior.sigmas).max() < 1e-5
    assert not np.any(fixed.covariances)
    np.testing.assert_array_equal(fixed.places, places)
    assert by_gtsam(fixed).cost_final == pytest.approx(fixed.cost_final, rel=1e-9)


def test_ground_control_replaces_an_orientation_prior() -> None:
    """Nothing known of the positions' constant terms, but control points on the ground: the truth is found."""
    drawn = pair(ties=30)
    net = fixed_points(
        network(drawn), PointKind.CONSTRAINED, np.concatenate([drawn.true_ties, drawn.true_footprints]), 1.0
    )
    sigmas = net.priors[0].sigmas.copy()
    sigmas[0, :3] = np.inf
    unknown = OrientationPrior(sigmas)
    solution = adjust_network(replace(net, priors=(unknown, unknown)), SolverSettings())
    assert solution.converged
    assert np.sqrt(np.mean((solution.places - net.points.places) ** 2)) < 1.0


def test_a_datum_that_nothing_holds_is_named() -> None:
    net = network(pair(), laser=False)
    unknown = OrientationPrior(np.full((3, 6), np.inf))
    with pytest.raises(WeakNetwork, match=r"image SIM/[AB]") as caught:
        adjust_network(replace(net, priors=(unknown, unknown)), SolverSettings())
    assert "\n" not in str(caught.value)
    assert caught.value.directions


def test_a_point_behind_the_camera_is_named() -> None:
    net = network(pair())
    places = net.points.places.copy()
    laser = np.flatnonzero(net.points.kinds == PointKind.CONSTRAINED)[2]
    places[laser] *= 2.0
    points = replace(net.points, places=places)
    with pytest.raises(PointBehindCamera, match=net.points.ids[laser]):
        adjust_network(replace(net, points=points), SolverSettings())


def test_undetermined_points_stay_out_and_change_nothing() -> None:
    net = network(pair())
    fewer = net.rays.chosen(np.arange(net.rays.point.size) != 1)
    lone = int(net.rays.point[1])
    solution = adjust_network(replace(net, rays=fewer), SolverSettings())
    assert not solution.determined[lone]
    assert np.all(np.isnan(solution.places[lone]))
    assert np.all(np.isnan(solution.residuals[fewer.point == lone]))
    assert not np.any(solution.rays_used[fewer.point == lone])
    none = adjust_network(replace(net, rays=net.rays.chosen(net.rays.point != lone)), SolverSettings())
    assert none.cost_final == pytest.approx(solution.cost_final, rel=1e-12)


def test_result_does_not_depend_on_the_order_of_the_input() -> None:
    net = network(pair())
    order = np.random.default_rng(7).permutation(net.rays.point.size)
    nets = net, replace(net, rays=net.rays.chosen(order))
    one, other = (adjust_network(each, SolverSettings(**TIGHT)) for each in nets)
    assert one.cost_final == pytest.approx(other.cost_final, rel=1e-11)
    np.testing.assert_allclose(one.residuals[order], other.residuals, atol=1e-7)
    np.testing.assert_allclose(one.places, other.places, atol=1e-5)


def test_prediction_is_the_posterior_of_the_same_geometry() -> None:
    net = network(pair(ties=30))
    expected, solution = predict(net, SolverSettings()), adjust_network(net, SolverSettings())
    sigmas = np.sqrt(np.diagonal(expected.covariances, axis1=1, axis2=2))
    np.testing.assert_allclose(sigmas, solution.sigmas, rtol=0.02)


def test_nothing_is_determined() -> None:
    net = network(pair(), laser=False)
    first = net.rays.image == 0
    second = np.flatnonzero(net.rays.image == 1)[:1]
    rays = net.rays.chosen(np.concatenate([np.flatnonzero(first)[1:], second]))
    refuses("none of", adjust_network, replace(net, rays=rays), SolverSettings())


def test_settings_refuse_what_makes_no_sense() -> None:
    for wrong in ({"loss": "l1"}, {"loss_width": 0.0}, {"reject": 1.0}, {"reject": float("nan")}, {"line": "m"}):
        refuses("solver", SolverSettings, **wrong)


def test_iteration_limit_is_said() -> None:
    solution = adjust_network(network(pair()), SolverSettings(max_iterations=1, **TIGHT))
    assert not solution.converged
    assert "max_iterations" in solution.message


# --- Tukey's loss


@pytest.mark.parametrize("seed", range(8000, 8005))
def test_tukeys_loss_loses_nothing_of_clean_data(seed: int) -> None:
    """Nominal orientations are hundreds of its widths off."""
    net = network(pair(60, 20, seed))
    solution = adjust_network(net, SolverSettings(loss="tukey"))
    assert solution.converged
    assert not np.any(solution.rays_rejected)
    assert not np.any(solution.ranges_rejected)
    assert np.all(solution.determined)
    plain = adjust_network(net, SolverSettings())
    assert np.max(np.abs(solution.places - plain.places) / plain.sigmas) < 1.5


def blundered(seed: int, share: float = 0.3) -> tuple[Network, np.ndarray]:
    """A pair with a share of its ties' image coordinates hundreds of pixels off, and which of its rays are good."""
    net, rng = network(pair(60, 20, seed)), np.random.default_rng(seed)
    rows, places = rng.choice(120, round(120 * share), replace=False), net.rays.places.copy()
    places[rows] += np.where(places[rows] < 1000.0, 1.0, -1.0) * rng.uniform(100.0, 600.0, (rows.size, 2))
    return replace(net, rays=replace(net.rays, places=places)), np.isin(np.arange(len(places)), rows, invert=True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_points_whose_rays_are_good_are_as_good_as_if_blunders_were_known(seed: int) -> None:
    (net, good), drawn = blundered(seed), pair(60, 20, seed)
    settings = SolverSettings(loss="tukey")
    solution = adjust_network(net, settings)
    told = adjust_network(net, settings, left_in=replace(all_rows(net), rays=good))
    mine = np.bincount(net.rays.point[~good], minlength=len(net.points))[:60] == 0
    assert solution.converged
    assert np.all(solution.determined[:60][mine])
    error, known = (np.sum((one.places[:60] - drawn.true_ties)[mine] ** 2) for one in (solution, told))
    assert error < 1.05**2 * known
    assert solution.fit.degrees_of_freedom <= told.fit.degrees_of_freedom + np.count_nonzero(~good)


@pytest.mark.parametrize("wrong", [False, True])
def test_both_forms_agree_with_tukeys_loss(wrong: bool) -> None:
    """The explicit form begins at the nominal orientation; with what the bundle form has left out, near its optimum."""
    net, settings = blundered(4)[0] if wrong else network(pair(20, 8)), SolverSettings(loss="tukey", **TIGHT)
    bundle = adjust_network(net, settings)
    source = bundle if wrong else SimpleNamespace(network=net, settings=settings)
    graph, values, keys = factor_graph(source)
    for j in range(2 if wrong else 0):
        off = 1e-3 * np.random.default_rng(j).normal(size=18) * net.priors[j].sigmas.ravel()
        values.update(keys.variable(j), values.atVector(keys.variable(j)) + off)
    found = optimize(graph, values, cost_tolerance=1e-13)
    assert bundle.cost_final == pytest.approx(found.cost, rel=1e-10)
    for i in np.flatnonzero(bundle.determined).tolist():
        np.testing.assert_allclose(found.values.atPoint3(keys.point(i)), bundle.places[i], atol=2e-3)


def test_a_blunder_among_many_rays_leaves_its_point_where_the_others_put_it() -> None:
    """At any orientation: plain squares put it where Tukey's loss is flat. Across the epipolar lines: two of its rays
    look nearly along one another, so that along them two rays stand against two.
    """
    net = network_of(strip(), range(6))
    counts = np.bincount(net.rays.point, minlength=len(net.points))
    row = int(np.flatnonzero(counts[net.rays.point] == counts.max())[0])
    assert counts.max() >= 4
    solution = adjust_network(net, SolverSettings())
    places = net.rays.places.copy()
    places[row, 0] += 300.0
    wrong = replace(net, rays=replace(net.rays, places=places))
    layout = lay_out(wrong, SolverSettings(loss="tukey"))
    x, every = layout.variables.joined(solution.values), all_rows(wrong)
    without = replace(every, rays=np.arange(counts.sum()) != row)
    first, second = (BundleGraph(layout, one.rows(layout)).reduction(x) for one in (every, without))
    np.testing.assert_allclose(first.points, second.points, atol=1e-3)
    np.testing.assert_array_equal(first.states, 0)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_a_robust_loss_without_redundancy_is_refused(loss: str) -> None:
    """An image of which nothing is known, and three known points: six rows for six unknowns."""
    net = without_images(select_points(network(pair()), [0, 5, 11]), ["SIM/B"])
    assert net is not None
    points = replace(net.points, kinds=np.full(3, PointKind.FIXED), places=pair().true_ties[[0, 5, 11]])
    net = replace(net, points=points, priors=(OrientationPrior(np.full((1, 6), np.inf)),))
    with pytest.raises(InputError, match="redundancy") as caught:
        adjust_network(net, SolverSettings(loss=loss))
    assert "\n" not in str(caught.value)
