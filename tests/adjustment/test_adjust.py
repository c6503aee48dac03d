"""The bundle form and GTSAM's optimiser on the explicit one agree; sigmas are realistic; blunders go and return."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from explicit_form import by_gtsam, explicit_covariances
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network, predict
from mgsgraph.adjustment.covariances import orientation_covariance, point_covariances
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.graph.forms import explicit_graph, variable_key
from mgsgraph.adjustment.rounds import all_rows, solve_in_rounds
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError, PointBehindCamera, WeakNetwork
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts
from mgsgraph.simulation.demo.demonstration import nees

TIGHT = {"cost_tolerance": 1e-14, "step_tolerance": 1e-9}


def with_measures(net: Network, places: np.ndarray) -> Network:
    rays = ImageRays(net.rays.point, net.rays.image, places, net.rays.sigmas)
    return replace(net, rays=rays)


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


@pytest.mark.parametrize("held", [(False, False), (True, True)])
def test_forms_agree_with_shift_and_surface(held: tuple[bool, bool]) -> None:
    net = with_shift_and_surface(network(pair(), held))
    bundle = adjust_network(net, SolverSettings(**TIGHT))
    explicit = by_gtsam(bundle)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    assert bundle.fit.observations == 2 * 36 + 6 + 18 + 4 + 12 + 36 * (not held[0])
    assert bundle.fit.squares == pytest.approx(2.0 * bundle.cost_final, rel=1e-9)
    np.testing.assert_allclose(bundle.shifts, explicit.shifts, atol=1e-4)
    np.testing.assert_allclose(bundle.shift_covariance(0), explicit.shift_covariance(0), rtol=1e-5)
    np.testing.assert_allclose(bundle.places, explicit.places, atol=1e-3)


def test_a_profiles_shift_is_found() -> None:
    """All footprints moved by 80 m east and -50 m north: the shift takes them back (but for what its prior holds)."""
    drawn = pair(ties=40, shots=20)
    net = network(drawn)
    laser = net.points.classes == PointClass.LASER
    shifts = ProfileShifts(("p",), np.where(laser, 0, -1), np.array([100.0]))
    longitude, latitude, _ = planetocentric(net.points.places[laser]).T
    east = np.stack([-np.sin(longitude), np.cos(longitude), 0.0 * longitude], axis=1)
    north = np.stack(
        [-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude), np.cos(latitude)], axis=1
    )
    places = net.points.places.copy()
    places[laser] += 80.0 * east - 50.0 * north
    points = GroundPoints(net.points.ids, net.points.classes, net.points.kinds, places, net.points.covariances)
    solution = adjust_network(replace(net, points=points, shifts=shifts), SolverSettings())
    plain = adjust_network(replace(net, shifts=shifts), SolverSettings())
    np.testing.assert_allclose(solution.shifts - plain.shifts, [[-80.0, 50.0]], atol=12.0)
    error = solution.shifts[0] - plain.shifts[0] + [80.0, -50.0]
    sigma = np.sqrt(np.diag(solution.shift_covariance(0)))
    assert np.all(np.abs(error) < 3.0 * sigma)
    assert np.all(sigma < 60.0)


def test_covariances_agree_at_one_linearisation_point() -> None:
    """Joint covariance of the orientation and 3x3 of every point, against gtsam.Marginals of the explicit graph."""
    layout = lay_out(network(pair()), SolverSettings())
    rng = np.random.default_rng(1)
    orientation = rng.standard_normal(layout.columns) * layout.sigmas
    graph = BundleGraph(layout)
    points = graph.reduction(orientation).points
    joint = orientation_covariance(graph, graph.reduction(orientation))
    mine = point_covariances(layout, layout.rows, orientation, points, joint)
    explicit, values = explicit_graph(layout, layout.rows, orientation, points)
    explicit_joint, theirs = explicit_covariances(layout, explicit, values)
    keys = [variable_key(layout, v) for v in layout.variables.adjusted()]
    authority = gtsam.Marginals(explicit, values).jointMarginalCovariance(keys).fullMatrix()
    scale = np.sqrt(np.outer(np.diag(authority), np.diag(authority)))
    assert np.abs((joint.dense() - authority) / scale).max() < 1e-6
    assert np.abs((explicit_joint.dense() - authority) / scale).max() < 1e-9
    assert np.abs(mine - theirs).max(axis=(1, 2)).max() <= 1e-6 * np.abs(theirs).max(axis=(1, 2)).min()
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-6 * np.abs(theirs).max(axis=(1, 2)).min())


def test_angle_conventions_reach_the_same_ground() -> None:
    """Parametrisations differ by second-order terms and by what the prior is on; the points hardly notice."""
    net = network(pair())
    found = {
        angles: adjust_network(net, SolverSettings(angles=angles)) for angles in ("camera", "opk-paper", "opk-peer")
    }
    for angles in ("opk-paper", "opk-peer"):
        assert found[angles].cost_final == pytest.approx(found["camera"].cost_final, rel=2e-2)
        offset = (found[angles].places - found["camera"].places) / found["camera"].sigmas
        assert np.abs(offset).max() < 0.3


def test_honest_sigmas_over_ten_seeds() -> None:
    """NEES per degree of freedom of orientation and points, and cost per degree of freedom, near 1."""
    orientation, points, cost = [], [], []
    for seed in range(10):
        drawn = pair(ties=30, shots=12, seed=100 + seed)
        solution = adjust_network(network(drawn), SolverSettings())
        errors = np.concatenate(
            [
                (mine - true.coefficients).ravel()
                for mine, true in zip(solution.coefficients, drawn.true_corrections, strict=True)
            ]
        )
        orientation.append(nees(errors[None], solution.joint_covariance.dense()[None])[0] / errors.size)
        true_places = np.concatenate([drawn.true_ties, drawn.true_footprints])
        points.append(nees(solution.places - true_places, solution.covariances).mean() / 3.0)
        cost.append(2.0 * solution.cost_final / solution.fit.degrees_of_freedom)
    # 99.9% bands: chi-square with 360 and about 10 x 63 degrees of freedom; points of a draw share their orientation
    assert 0.77 < np.mean(orientation) < 1.27
    assert 0.6 < np.mean(points) < 1.5
    assert 0.82 < np.mean(cost) < 1.2


def test_planted_blunders_are_rejected_and_others_kept() -> None:
    net = network(pair(ties=40))
    places = net.rays.places.copy()
    bad = [4, 11, 30]
    places[bad, 0] += np.array([25.0, -40.0, 15.0])  # along track: across, an error of a two-ray point is its height
    solution = adjust_network(with_measures(net, places), SolverSettings(reject=5.0))
    rejected = np.flatnonzero(~solution.rays_used)
    assert set(bad) <= set(rejected.tolist())
    # the two rays of a tie point share its misfit, so that the partner goes too; hardly anything else does
    assert set(net.rays.point[rejected].tolist()) == set(net.rays.point[bad].tolist())
    clean = adjust_network(net, SolverSettings())
    assert np.abs((solution.coefficients[0] - clean.coefficients[0]) / net.priors[0].sigmas).max() < 0.3
    assert "rejected rows" in solution.message


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
    points = GroundPoints(net.points.ids, net.points.classes, np.full(n, kind), places, covariances)
    return replace(net, points=points)


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
    points = GroundPoints(net.points.ids, net.points.classes, net.points.kinds, places, net.points.covariances)
    with pytest.raises(PointBehindCamera, match=net.points.ids[laser]):
        adjust_network(replace(net, points=points), SolverSettings())


def test_undetermined_points_stay_out_and_change_nothing() -> None:
    net = network(pair())
    keep = np.ones(net.rays.point.size, dtype=bool)
    keep[1] = False
    fewer = ImageRays(*(getattr(net.rays, name)[keep] for name in ("point", "image", "places", "sigmas")))
    lone = int(net.rays.point[1])
    solution = adjust_network(replace(net, rays=fewer), SolverSettings())
    assert not solution.determined[lone]
    assert np.all(np.isnan(solution.places[lone]))
    assert np.all(np.isnan(solution.residuals[fewer.point == lone]))
    assert not np.any(solution.rays_used[fewer.point == lone])
    without = net.rays.point != lone
    none = ImageRays(*(getattr(net.rays, name)[without] for name in ("point", "image", "places", "sigmas")))
    assert adjust_network(replace(net, rays=none), SolverSettings()).cost_final == pytest.approx(
        solution.cost_final, rel=1e-12
    )


def test_result_does_not_depend_on_the_order_of_the_input() -> None:
    net = network(pair())
    rng = np.random.default_rng(7)
    order = rng.permutation(net.rays.point.size)
    rays = ImageRays(*(getattr(net.rays, name)[order] for name in ("point", "image", "places", "sigmas")))
    one, other = (
        adjust_network(net, SolverSettings(**TIGHT)),
        adjust_network(replace(net, rays=rays), SolverSettings(**TIGHT)),
    )
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
    chosen = np.concatenate([np.flatnonzero(first)[1:], second])
    rays = ImageRays(*(getattr(net.rays, name)[chosen] for name in ("point", "image", "places", "sigmas")))
    with pytest.raises(InputError, match="none of"):
        adjust_network(replace(net, rays=rays), SolverSettings())


def test_settings_refuse_what_makes_no_sense() -> None:
    for wrong in ({"loss": "l1"}, {"loss_width": 0.0}, {"reject": 1.0}, {"reject": float("nan")}, {"line": "m"}):
        with pytest.raises(InputError, match="solver"):
            SolverSettings(**wrong)


def test_iteration_limit_is_said() -> None:
    solution = adjust_network(network(pair()), SolverSettings(max_iterations=1, **TIGHT))
    assert not solution.converged
    assert "max_iterations" in solution.message
