"""Questions to the posterior, held against the explicit graph's dense inverse at the same place; likelihood ratios.

The dense system is GTSAM's linearisation of the explicit graph; what a pose or a pixel is a function of comes from
finite differences of the geometry itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from statistics import NormalDist

import gtsam
import numpy as np
import pytest
from explicit_form import of_layout
from networks import network, pair, with_shift_and_surface, with_tilting_surface
from odd_networks import with_fixed
from outside import refuses
from sharing import shared, with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.factor_graph import prior_factors
from mgsgraph.adjustment.settings import Angles, Line, Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.estimates import correlation
from mgsgraph.analysis.likelihood import LEVELS, Likelihood, linearity_of
from mgsgraph.analysis.linearised import at_solution, at_values
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Pixel, Posterior, cross_covariances, is_self_contained, posterior_of_points
from mgsgraph.analysis.reliability import reliability
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.network import Network, SharedKind

TIGHT = 1e-8


@dataclass(eq=False)
class Dense:
    """All unknowns of a solution, and their covariance by a dense inverse of the explicit graph."""

    posterior: Posterior
    covariance: np.ndarray
    shared: dict[int, slice]
    points: dict[int, slice]

    def columns(self, name: str) -> slice:
        """Columns of a point by its name."""
        network = self.posterior.network
        place = self.posterior.linearised.layout.patterns.point_index[network.points.ids.index(name)]
        return self.points[int(place)]

    def of(self, jacobian: np.ndarray, *parts: slice) -> np.ndarray:
        """Covariance of linear functions of some parts."""
        own = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        return jacobian @ self.covariance[np.ix_(own, own)] @ jacobian.T


def dense(solution: Solution) -> Dense:
    at = at_values(solution.network, solution.settings, solution.values, solution.places)
    posterior = Posterior(at)
    (factors, named), graph = of_layout(at.layout, at.rows).graph, gtsam.NonlinearFactorGraph()
    for factor in (*prior_factors(solution.network, named), *factors):
        graph.add(factor)
    values = of_layout(at.layout, at.rows).values(at.orientation, at.points)
    variables = at.layout.variables.adjusted()
    keys = [named.variable(int(v)) for v in variables]
    of_points = [named.point(i) for i in at.layout.point_order.tolist()]
    free = [i for i, key in enumerate(of_points) if graph.keys().count(key)]
    ordering = gtsam.Ordering()
    for key in keys + [of_points[i] for i in free]:
        ordering.push_back(key)
    information = graph.linearize(values).hessian(ordering)[0]
    scale = 1.0 / np.sqrt(np.diag(information))
    root = np.linalg.solve(np.linalg.cholesky(information * scale[:, None] * scale), np.diag(scale))
    count = at.layout.columns
    return Dense(
        posterior,
        root.T @ root,
        {v: at.layout.columns_of(v) for v in variables},
        {i: slice(count + 3 * k, count + 3 * k + 3) for k, i in enumerate(free)},
    )


@cache
def solved(name: str, loss: Loss = "none") -> Solution:
    nets: dict[str, Network] = {
        "pair": network(pair()),
        "shift and surface": with_shift_and_surface(network(pair())),
        "surface that tilts": with_tilting_surface(network(pair())),
        "one held": network(pair(), held=(True, False)),
        "both held": network(pair(), held=(True, True)),
        "fixed points": with_fixed(network(pair())),
        "all kinds shared": with_all_kinds(with_shift_and_surface(network(pair()))),
    }
    return adjust_network(nets[name], SolverSettings(loss=loss))


NAMES = ["shift and surface", "surface that tilts", "both held", "fixed points", "all kinds shared"]


def assert_alike(found: np.ndarray, right: np.ndarray, share: float = TIGHT) -> None:
    sigmas = np.sqrt(np.diag(right))
    assert np.abs(found - right).max() <= share * np.outer(sigmas, sigmas).max()
    assert np.all(np.abs(found - right) <= 1e3 * share * np.outer(sigmas, sigmas) + 1e-30)


@pytest.mark.parametrize("name", NAMES)
def test_points_and_pairs_of_points_have_the_dense_covariance(name: str) -> None:
    """The kernel takes what shared unknowns do for constant about a ray: so all kinds to 1e-5."""
    whole, share = dense(solved(name)), 1e-5 if name == "all kinds shared" else TIGHT
    ids = [whole.posterior.network.points.ids[whole.posterior.linearised.layout.point_order[i]] for i in whole.points]
    for one, other in [(ids[0], ids[1]), (ids[0], ids[-1]), (ids[-1], ids[-2])]:
        parts = whole.columns(one), whole.columns(other)
        assert_alike(whole.posterior.point(one).covariance, whole.of(np.eye(3), parts[0]), share)
        assert_alike(whole.posterior.difference(one, other).joint, whole.of(np.eye(6), *parts), share)
        away = np.hstack([-np.eye(3), np.eye(3)])
        assert_alike(whole.posterior.difference(one, other).covariance, whole.of(away, *parts), share)


def test_points_with_a_robust_loss_have_the_covariance_of_the_weighted_rows() -> None:
    solution = solved("pair", "huber")
    posterior = Posterior.of(solution)
    for i in (0, 5, 14):
        assert_alike(posterior.point(solution.network.points.ids[i]).covariance, solution.covariances[i], 1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_points_are_those_of_the_solution(name: str) -> None:
    solution = solved(name)
    posterior = Posterior.of(solution)
    for i in np.flatnonzero(solution.determined):
        found = posterior.point(solution.network.points.ids[i])
        assert np.array_equal(found.position, solution.places[i])
        # not the same linearisation: the last inner step, of less than a thousandth of a sigma, lies between the two
        assert np.abs(found.covariance - solution.covariances[i]).max() <= 1e-5 * max(found.covariance.max(), 1e-9)


def moved(posterior: Posterior, image: int, line: float, step: np.ndarray) -> np.ndarray:
    """Position, and rotation about the camera's axes against the adjusted one, when the coefficients are moved."""
    picture, correction = posterior.network.images[image], posterior.correction(image)
    before = picture.pose(np.array([line]), correction)
    shape = correction.coefficients.shape
    after = picture.pose(
        np.array([line]), OrientationCorrection(correction.coefficients + step.reshape(shape), correction.angles)
    )
    twist = after.matrix[0] @ before.matrix[0].T
    turn = 0.5 * np.array([twist[1, 2] - twist[2, 1], twist[2, 0] - twist[0, 2], twist[0, 1] - twist[1, 0]])
    return np.concatenate([after.position[0] - before.position[0], turn])


def pose_jacobian(posterior: Posterior, image: int, line: float) -> np.ndarray:
    columns = posterior.linearised.layout.columns_of(image)
    steps = np.tile([1.0] * 3 + [1e-5] * 3, (columns.stop - columns.start) // 6)
    return np.stack(
        [
            (moved(posterior, image, line, row) - moved(posterior, image, line, -row)) / (2.0 * step)
            for row, step in zip(np.diag(steps), steps, strict=True)
        ],
        axis=1,
    )


@pytest.mark.parametrize("name", ["pair", "shift and surface"])
def test_poses_and_pairs_of_poses_have_the_dense_covariance(name: str) -> None:
    whole = dense(solved(name))
    posterior = whole.posterior
    names = posterior.network.image_names
    lines = [0.0, 700.0]
    jacobians = [pose_jacobian(posterior, j, line) for j, line in enumerate(lines)]
    for j in range(2):
        right = whole.of(jacobians[j], whole.shared[j])
        assert_alike(posterior.pose(names[j], lines[j]).covariance, right, 1e-7)
    both = np.zeros((12, sum(part.shape[1] for part in jacobians)))
    both[:6, : jacobians[0].shape[1]], both[6:, jacobians[0].shape[1] :] = jacobians
    quantities = [posterior.of_pose(names[j], lines[j]) for j in range(2)]
    right = whole.of(both, whole.shared[0], whole.shared[1])
    assert_alike(posterior.covariance(quantities), right, 1e-7)
    assert np.allclose(posterior.joint(quantities).correlation, correlation(right), atol=1e-6)


def test_poses_with_shared_unknowns_are_those_of_the_orientation_profile() -> None:
    solution = solved("all kinds shared")
    profile, name = orientation_profile(solution, 1, 3), solution.network.images[1].name
    for k, pose in enumerate(Posterior.of(solution).poses(name, profile.lines)):
        sigmas = np.sqrt(np.diag(pose.covariance))
        assert np.allclose(pose.position, profile.position_after[k], atol=1e-6)
        assert np.allclose(sigmas[:3], profile.position_sigma[k], rtol=1e-6)
        assert np.allclose(sigmas[3:], profile.rotation_sigma[k], rtol=1e-6)


def test_a_pose_and_a_point_share_what_they_share() -> None:
    whole = dense(solved("shift and surface"))
    posterior = whole.posterior
    name, image = posterior.network.points.ids[0], posterior.network.images[1].name
    jacobian = pose_jacobian(posterior, 1, 300.0)
    both = np.zeros((9, 3 + jacobian.shape[1]))
    both[:3, :3], both[3:, 3:] = np.eye(3), jacobian
    found = posterior.covariance([posterior.of_point(name), posterior.of_pose(image, 300.0)])
    assert_alike(found, whole.of(both, whole.columns(name), whole.shared[1]), 1e-7)


def test_projections_with_shared_unknowns_are_those_of_the_rows() -> None:
    # a measured ray's predicted place: its variance is the share H of the kernel's reliability, in px
    solution = solved("all kinds shared")
    posterior = Posterior.of(solution)
    found = reliability(posterior.linearised)
    rays, mine = solution.network.rays, 7
    point, image = solution.network.points.ids[rays.point[mine]], solution.network.images[rays.image[mine]].name
    rows = np.flatnonzero((found.measures.kind == MeasureKind.RAY) & (found.measures.row == mine))
    right = np.sqrt(1.0 - found.measures.redundancy[rows]) * rays.sigmas[mine]
    projection = posterior.projection(point, image)
    assert np.allclose(projection.sigmas, right, rtol=1e-4)
    assert np.allclose(rays.places[mine] - projection.pixel, solution.residuals[mine], atol=1e-3)


@pytest.mark.parametrize(
    ("line", "angles"), [("measured", "camera"), ("measured", "opk-paper"), ("predicted", "opk-peer")]
)
def test_projections_are_of_places_in_every_form_of_the_model(line: Line, angles: Angles) -> None:
    # two forms of the rows, one question: what is asked of is the geometry, not the rows
    net = network(pair())
    posterior = Posterior.of(adjust_network(net, SolverSettings(line=line, angles=angles)))
    name, image = net.points.ids[0], net.images[1].name
    quantity = posterior.of_projection(name, image)
    ground, picture, correction = posterior.of_point(name), net.images[1], posterior.correction(1)
    _, by_point = picture.ground_to_image(ground.values[None], correction)
    assert np.allclose(next(iter(quantity.noise.values())), by_point[0] @ next(iter(ground.noise.values())), rtol=1e-5)


def test_projections_into_a_held_image_have_the_points_covariance_alone() -> None:
    posterior = Posterior.of(solved("one held"))
    name, picture = posterior.network.points.ids[0], posterior.network.images[0]
    point = posterior.point(name)
    _, by_point = picture.ground_to_image(point.position[None])
    right = by_point[0] @ point.covariance @ by_point[0].T
    assert_alike(posterior.projection(name, picture.name).covariance, right, 1e-5)


def test_new_rays_that_miss_each_other_say_by_how_much_or_are_refused() -> None:
    posterior = Posterior.of(solved("pair"))
    rays, images = posterior.network.rays, posterior.network.images
    mine = np.flatnonzero(rays.point == 0)
    pixels = [Pixel(images[rays.image[k]].name, *rays.places[k].tolist()) for k in mine]
    misfit = posterior.intersection(pixels).misfit
    assert misfit is not None
    assert misfit < 4.0
    refuses("miss each other by", posterior.intersection, [pixels[0], replace(pixels[1], line=pixels[1].line + 200.0)])
    refuses("a place in the image of", posterior.intersection, [pixels[0], replace(pixels[1], sample=99999.0)])


@pytest.mark.parametrize("name", ["pair", "shift and surface", "fixed points"])
def test_projections_have_the_dense_covariance(name: str) -> None:
    whole = dense(solved(name))
    posterior = whole.posterior
    place_of = posterior.linearised.layout.point_order
    point, image = posterior.network.points.ids[place_of[next(iter(whole.points))]], 1
    picture, correction = posterior.network.images[image], posterior.correction(image)
    ground = posterior.of_point(point).values
    columns = posterior.linearised.layout.columns_of(image)
    steps = np.concatenate([np.full(3, 1.0), np.tile([1.0] * 3 + [1e-6] * 3, (columns.stop - columns.start) // 6)])

    def project(step: np.ndarray) -> np.ndarray:
        coefficients = correction.coefficients + step[3:].reshape(correction.coefficients.shape)
        return picture.ground_to_image((ground + step[:3])[None], OrientationCorrection(coefficients))[0][0]

    jacobian = np.stack(
        [(project(row) - project(-row)) / (2 * s) for row, s in zip(np.diag(steps), steps, strict=True)], axis=1
    )
    found = posterior.projection(point, picture.name)
    assert np.allclose(found.pixel, project(np.zeros(steps.size)))
    assert_alike(found.covariance, whole.of(jacobian, whole.columns(point), whole.shared[image]), 1e-5)


def test_a_new_intersection_has_the_noise_of_its_rays_and_of_the_orientation() -> None:
    solution = solved("pair")
    posterior = Posterior.of(solution)
    rays = solution.network.rays
    i = 0
    mine = np.flatnonzero(rays.point == i)
    pixels = [
        Pixel(solution.network.images[rays.image[k]].name, *rays.places[k].tolist(), sigma=0.7) for k in mine
    ]
    found = posterior.intersection(pixels, "again")
    whole = dense(solution)
    at = posterior.linearised
    rows = at.rows_of(i)
    # normal equations of the two rays alone in plain NumPy, their noise scaled to 0.7 px
    scale = rays.sigmas[mine].ravel()[:, None] / 0.7
    by_point, by_shared = (part[0][: 2 * mine.size] * scale for part in (rows.by_point, rows.by_shared))
    normal = by_point.T @ by_point
    carried = np.linalg.solve(normal, by_point.T @ by_shared)
    own = np.concatenate([np.arange(whole.shared[v].start, whole.shared[v].stop) for v in rows.variables])
    right = np.linalg.inv(normal) + carried @ whole.covariance[np.ix_(own, own)] @ carried.T
    assert np.linalg.norm(found.position - solution.places[i]) < 3.0 * np.sqrt(np.trace(found.covariance))
    assert_alike(found.covariance, right, 1e-5)


def test_many_intersections_are_single_ones() -> None:
    solution = solved("shift and surface")
    posterior = Posterior.of(solution)
    rays = solution.network.rays.chosen(solution.network.rays.point < 5)
    rays = replace(rays, sigmas=np.full_like(rays.sigmas, 1.5))
    places, covariances = posterior.intersections(rays)
    for i in range(5):
        mine = np.flatnonzero(rays.point == i)
        one = posterior.intersection(
            [Pixel(solution.network.images[rays.image[k]].name, *rays.places[k].tolist(), sigma=1.5) for k in mine]
        )
        assert np.allclose(places[i], one.position, atol=1e-3)
        assert_alike(covariances[i], one.covariance, 1e-6)


def test_ellipsoids_hold_what_they_promise() -> None:
    found = Posterior.of(solved("pair")).point(solved("pair").network.points.ids[0])
    ellipsoid = found.ellipsoid(0.9)
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(3), found.east_north_up, 20000)
    inside = np.sum((draws @ ellipsoid.directions.T / ellipsoid.semi_axes) ** 2, axis=1) < 1.0
    assert abs(inside.mean() - 0.9) < 4.0 * np.sqrt(0.09 / draws.shape[0])
    assert np.all(np.diff(ellipsoid.semi_axes) <= 0.0)
    assert np.all(ellipsoid.elevations >= 0.0)


def test_neighbours_share_errors_so_their_height_difference_is_better_known_than_their_heights() -> None:
    solution = solved("shift and surface")
    posterior = Posterior.of(solution)
    found = posterior.difference(solution.network.points.ids[0], solution.network.points.ids[1])
    assert found.height_sigma < found.height_sigma_if_independent
    assert found.height == pytest.approx(np.linalg.norm(solution.places[1]) - np.linalg.norm(solution.places[0]))


# --- some points alone, and one with all others


@cache
def small() -> Solution:
    return adjust_network(with_shift_and_surface(network(pair(ties=16, shots=6))), SolverSettings(starts=0))


def measures(posterior: Posterior, names: Sequence[str]) -> dict[tuple[str, int, int], tuple[float, ...]]:
    """Redundancy, test and least detectable error of the rays of some points, by point, image and component."""
    every, found = reliability(posterior.linearised).measures, dict[tuple[str, int, int], tuple[float, ...]]()
    for k in np.flatnonzero(every.kind == MeasureKind.RAY).tolist():
        name = posterior.network.points.ids[int(every.point[k])]
        if name in names:
            image = posterior.network.images[int(every.image[k])].name
            key = name, small().network.image_names.index(image), int(every.component[k])
            found[key] = float(every.redundancy[k]), float(every.test[k]), float(every.detectable[k])
    return found


def test_some_points_alone_say_what_the_whole_says() -> None:
    whole = Posterior.of(small())
    chosen = np.arange(0, len(small().network.points), 3)
    near = posterior_of_points(small(), chosen)
    assert near is not None
    names = near.network.points.ids.tolist()
    assert names == [small().network.points.ids[i] for i in chosen]
    for name in names:
        one, other = near.point(name), whole.point(name)
        np.testing.assert_allclose(one.position, other.position, rtol=0.0, atol=1e-4)  # to the last step
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-6)
    first, second = names[:2]
    np.testing.assert_allclose(
        near.difference(first, second).joint, whole.difference(first, second).joint, rtol=1e-5, atol=1e-6
    )
    mine, theirs = measures(near, names), measures(whole, names)
    assert mine.keys() == theirs.keys()
    assert mine
    for key, values in mine.items():
        np.testing.assert_allclose(values, theirs[key], rtol=1e-4, atol=1e-4)


def test_considered_unknowns_need_the_whole() -> None:
    considered = adjust_network(
        small().network.considering(small().network.shift_names), SolverSettings(starts=0)
    )
    assert is_self_contained(small().network)
    assert posterior_of_points(considered, np.arange(4)) is None


def test_covariances_with_all_others_are_those_of_pairs() -> None:
    net = with_fixed(network(pair(ties=16, shots=6)))
    posterior = Posterior.of(adjust_network(net, SolverSettings()))
    ids = posterior.network.points.ids.tolist()
    free = next(k for k, kind in enumerate(posterior.network.points.kinds) if kind == 0)
    found = cross_covariances(posterior.linearised, free)
    seen = 0
    for k, name in enumerate(ids):
        if k == free:
            np.testing.assert_allclose(found[k], posterior.point(name).covariance, rtol=1e-9)
            continue
        joint = posterior.covariance([posterior.of_point(ids[free]), posterior.of_point(name)])
        np.testing.assert_allclose(found[k], joint[:3, 3:], rtol=1e-8, atol=1e-10)
        seen += bool(np.any(found[k]))
    assert 0 < seen < len(ids) - 1  # fixed points go along with nothing


# --- likelihood ratios


EXACT = SolverSettings(cost_tolerance=1e-15, step_tolerance=1e-9)


@cache
def net() -> Network:
    """The pair, its profile and terrain model of unknown shift, and a bias of its ranges."""
    found = with_shift_and_surface(network(pair()))
    return replace(found, shared=(shared(SharedKind.RANGE_BIAS, np.unique(found.ranges.image).tolist()),))


@cache
def exact() -> Solution:
    return adjust_network(net(), EXACT)


@cache
def likelihood() -> Likelihood:
    return Likelihood(at_solution(exact()))


def test_an_image_held_at_its_nominal_orientation() -> None:
    """Twice the cost of an adjustment that holds it, less that of one that doesn't; a shift and a bias held beside it
    cost more.
    """
    name, zeros = net().images[0].name, np.zeros_like(exact().coefficients[0])
    held = adjust_network(replace(net(), held=np.array([True, False])), EXACT)
    found = likelihood().ratio({name: zeros})
    assert found.degrees == zeros.size
    rise = held.cost_final - exact().cost_final
    assert found.chi_square == pytest.approx(2.0 * rise, abs=2e-4)  # lines are exact to 1e-5
    more = likelihood().ratio({name: zeros, "profile": np.zeros(2), "range bias": np.zeros(1)})
    assert more.degrees == zeros.size + 3
    assert more.chi_square > found.chi_square + 1e-3


def test_near_the_optimum_it_is_the_ellipsoids() -> None:
    """Of all unknowns, of some with the others free (whose marginal covariance counts), and of none."""
    solution, rng = exact(), np.random.default_rng(1)
    names = {image.name: (j, solution.coefficients[j]) for j, image in enumerate(net().images)}
    names |= {"profile": (2, solution.shifts[0]), "terrain model": (3, solution.shifts[1])}
    names["range bias"] = 4, solution.shared[0]
    for chosen in (list(names), list(names)[1:3], list(names)[4:]):
        covariance = solution.joint_covariance.of([names[name][0] for name in chosen])
        move = 0.1 * np.linalg.cholesky(covariance) @ rng.standard_normal(covariance.shape[0])
        parts = np.split(move, np.cumsum([names[name][1].size for name in chosen])[:-1])
        values = {name: names[name][1].ravel() + part for name, part in zip(chosen, parts, strict=True)}
        found = likelihood().ratio(values)
        assert found.chi_square == pytest.approx(move @ np.linalg.solve(covariance, move), rel=2e-2)
        assert 0.9 < found.p <= 1.0
    assert likelihood().ratio({}).chi_square == pytest.approx(0.0, abs=1e-9)


def test_profiles_are_the_ellipsoids_where_all_is_linear_and_end_where_the_ratio_says() -> None:
    (found,) = likelihood().profiles(net().images[1].name, "constant radial position")
    for level, (low, high) in zip(LEVELS, found.intervals, strict=True):
        wide = 2.0 * NormalDist().inv_cdf(0.5 + 0.5 * level) * found.sigma
        assert high - low == pytest.approx(wide, rel=0.02)
    assert found.ratio == pytest.approx(1.0, abs=0.02)
    (shift,) = likelihood().profiles("range bias")
    for level, ends in zip(LEVELS, shift.intervals, strict=True):
        for end in ends:
            square = likelihood().ratio({"range bias": np.array([end])}).chi_square
            assert np.sqrt(square) == pytest.approx(NormalDist().inv_cdf(0.5 + 0.5 * level), abs=2e-3)


def test_wide_priors_are_not_linear_and_narrow_ones_are() -> None:
    assert exact().linearity is not None
    assert exact().linearity.linear
    free = network(pair())
    priors = tuple(replace(prior, sigmas=100.0 * prior.sigmas) for prior in free.priors)
    wide = adjust_network(replace(free, priors=priors), SolverSettings())
    assert wide.linearity is not None
    assert not wide.linearity.linear
    assert wide.linearity.ratio > 2.0
    again = linearity_of(at_solution(wide))
    assert again is not None
    assert again.ratio == pytest.approx(wide.linearity.ratio, rel=1e-6)


def test_a_considered_unknown_is_held_in_the_draws_and_has_no_likelihood() -> None:
    found = adjust_network(replace(net(), considered=("profile",)), SolverSettings())
    assert found.linearity is not None
    assert found.linearity.linear
    with pytest.raises(InputError, match="'profile'"):
        _ = Posterior.of(found).likelihood


def test_robust_losses_and_held_networks_say_nothing() -> None:
    assert adjust_network(net(), SolverSettings(loss="huber")).linearity is None
    assert adjust_network(network(pair(), (True, True)), SolverSettings()).linearity is None


@pytest.mark.parametrize(
    ("values", "says"), [({"nobody": np.zeros(3)}, "nobody"), ({"profile": np.zeros(3)}, "3 values"),
                         ({"profile": np.array([np.nan, 0.0])}, "2 finite numbers")],
)  # fmt: skip
def test_what_nothing_is_known_of_is_refused(values: dict[str, np.ndarray], says: str) -> None:
    refuses(says, likelihood().ratio, values)
