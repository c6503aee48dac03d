"""The verdict: what converged on too little is invalid; what the stated sigmas do not explain is named; what nothing
tests is said, with what it could hide.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from redraw import redraw
from rigs import adjusted_rig, rig
from scipy.stats import norm
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network, predict
from mgsgraph.adjustment.fit import ABSURD, IMPOSSIBLE
from mgsgraph.adjustment.frames import flight_frame
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.geometry_checks import deviating_heights, misplaced_profiles
from mgsgraph.analysis.group_tests import GroupTest, fit_of_groups, numbers_of_groups, quadratic_tail
from mgsgraph.analysis.grouping import Grouping, group_rows
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.analysis.residual_rows import ResidualRows, residual_rows
from mgsgraph.analysis.sanity import MOST, Kind, losses, unexplained_ranges, unexplained_residuals
from mgsgraph.analysis.verdict import Cause, State, is_valid, verdict
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.names import Names
from mgsgraph.network import ImageRays, Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.network.parts import joined, select_points
from mgsgraph.results.inventory import inventory
from mgsgraph.results.results import solution_json, summary_table
from mgsgraph.results.verdict import beyond_priors_statements, range_statements, state_of


@pytest.fixture(scope="module")
def good() -> Solution:
    return adjust_network(network(pair(ties=20, shots=10)), SolverSettings(starts=0))


def parallel(only_ties: bool = False) -> Network:
    """Ties whose two rays are the same ray, in an image and its twin; laser shots hold the datum."""
    net = network(pair(ties=12, shots=30))
    first, places = net.images[0], net.rays.places.copy()
    ties = net.points.classes[net.rays.point] == PointClass.TIE
    for k in np.flatnonzero(ties & (net.rays.image == 1)).tolist():
        (twin,) = np.flatnonzero((net.rays.point == net.rays.point[k]) & (net.rays.image == 0))
        places[k] = places[twin]
    rays = replace(net.rays, places=places).chosen(ties if only_ties else ties | (net.rays.image == 0))
    priors = (net.priors[0],) * 2
    return replace(net, images=(first, replace(first, name="twin")), priors=priors, rays=rays)


def test_a_good_solution_is_valid(good: Solution) -> None:
    assert verdict(good).state is State.VALID
    assert not verdict(good).reasons
    assert solution_json(good)["verdict"]["state"] == "valid"
    assert not is_valid(replace(good, converged=False))


def test_no_tie_left_is_refused() -> None:
    """It came to rest on the laser alone, and was called converged with all its ties left out."""
    with pytest.raises(InputError, match=r"none of 12 tie points is left \(0 rejected, 12 not determined"):
        adjust_network(parallel(), SolverSettings(starts=0))


def test_parallel_rays_are_said_in_one_line_without_warnings() -> None:
    """Warnings are errors here; `nan` is no figure."""
    said = inventory(Case("x", Path("x"), parallel(), SolverSettings()))
    assert "nan" not in said
    assert said.count("points have parallel rays, and stay out") == 1


def lost(solution: Solution, kind: Kind, share: float) -> Solution:
    """The solution with a share of one kind left out."""
    net = solution.network
    if kind is Kind.RANGES:
        return replace(solution, ranges_used=np.arange(net.ranges.point.size) >= share * net.ranges.point.size)
    if kind is Kind.IMAGE:
        mine = np.flatnonzero(net.rays.image == 1)
        used = solution.rays_used.copy()
        used[mine[: round(share * mine.size)]] = False
        return replace(solution, rays_used=used)
    mine = np.flatnonzero(net.points.classes == (PointClass.TIE if kind is Kind.TIES else PointClass.LASER))
    determined = solution.determined.copy()
    determined[mine[: round(share * mine.size)]] = False
    return replace(solution, determined=determined)


@pytest.mark.parametrize(
    ("kind", "share", "fatal"),
    [(Kind.TIES, 0.6, True), (Kind.LASER, 0.3, False), (Kind.RANGES, 1.0, True), (Kind.IMAGE, 0.6, True),
     (Kind.IMAGE, 0.3, False)],
)  # fmt: skip
def test_what_is_left_out_is_said(good: Solution, kind: Kind, share: float, fatal: bool) -> None:
    found = lost(good, kind, share)
    (one, *_) = [one for one in losses(found) if one.kind is kind]
    assert one.share == pytest.approx(share, abs=0.1)
    assert one.fatal is fatal is (one.share > MOST)
    assert is_valid(found) is not fatal
    record = solution_json(found)["verdict"]
    assert record["state"] == ("invalid" if fatal else "suspect")
    assert {"cause": "observations left out", "count": one.left_out, "size": one.share}.items() <= next(
        each for each in record["reasons"] if each["what"].startswith(str(kind))
    ).items()
    assert ("INVALID" in summary_table(found)) is fatal
    if kind is Kind.IMAGE:
        assert one.image == good.network.images[1].name


def moved(solution: Solution, sigmas: float) -> Solution:
    """The solution with sigmas by which an orientation has moved by so many at the most."""
    (worst, *_) = replace(solution, network=tightened(solution.network, 1e-3)).strained
    return replace(solution, network=tightened(solution.network, 1e-3 * worst.most / sigmas))


def tightened(net: Network, factor: float) -> Network:
    return replace(net, priors=tuple(replace(prior, sigmas=factor * prior.sigmas) for prior in net.priors))


def test_orientations_that_no_sigma_allows(good: Solution) -> None:
    near, far = moved(good, 0.99 * IMPOSSIBLE), moved(good, 1.01 * IMPOSSIBLE)
    assert near.strained
    assert is_valid(near)
    assert not is_valid(far)
    (one,) = [one for one in verdict(far).of(Cause.ORIENTATION) if one.state is State.INVALID]
    assert one.what in far.network.image_names
    assert one.size == pytest.approx(1.01 * IMPOSSIBLE)
    assert "INVALID" in state_of(far)
    held = replace(far.network, held=np.ones(len(far.network.images), dtype=bool))
    assert not replace(far, network=held).strained


def test_what_a_shared_boresight_does_is_measured_by_its_own_sigma() -> None:
    """Both images look elsewhere by 0.01 rad, hundreds of their own sigmas: the camera's, which is little known."""
    net, turn = network(pair(ties=20, shots=10)), rotation.exponential(np.array([[0.01, 0.0, 0.0]]))[0]
    images = []
    for image in net.images:
        camera = image.trajectory.camera  # type: ignore[attr-defined]
        turned = replace(camera, constant=turn @ camera.constant)
        images.append(replace(image, trajectory=replace(image.trajectory, camera=turned)))  # type: ignore[type-var]
    net = replace(net, images=tuple(images), shared=(shared(SharedKind.CAMERA_BORESIGHT, [0, 1], 0.1),))
    solution = adjust_network(net, SolverSettings(starts=0))
    assert np.linalg.norm(solution.shared[0]) > IMPOSSIBLE * net.priors[0].sigmas[0, 3:].max()
    assert is_valid(solution)
    assert not solution.strained


def test_a_sigma0_that_no_sigma_makes(good: Solution) -> None:
    freedom = good.fit.degrees_of_freedom
    wild = replace(good, fit=replace(good.fit, squares=1.01 * ABSURD**2 * freedom))
    assert not is_valid(wild)
    assert is_valid(replace(good, fit=replace(good.fit, squares=0.99 * ABSURD**2 * freedom)))


# --- groups


PLAIN = SolverSettings(starts=0)
TIES, CAUTIOUS = "tie image points, lines", "ground priors"


def noisier(net: Network, factor: float, seed: int) -> Network:
    """Ties with errors so many times larger than stated."""
    rays = net.rays
    ties = net.points.classes[rays.point] == PointClass.TIE
    more = np.random.default_rng([seed, 5]).normal(0.0, math.sqrt(factor**2 - 1.0), rays.places.shape) * rays.sigmas
    return replace(net, rays=replace(rays, places=rays.places + more * ties[:, None]))


def hidden(seed: int, factor: float = 1.5) -> Network:
    """Ties with larger errors than stated, behind many laser rows whose sigmas are three times too large."""
    net = noisier(network(pair(ties=60, shots=200, seed=seed)), factor, seed)
    points = replace(net.points, covariances=9.0 * net.points.covariances)
    return replace(net, points=points, ranges=replace(net.ranges, sigmas=3.0 * net.ranges.sigmas))


def adjusted(net: Network) -> Solution:
    return adjust_network(net, PLAIN)


def groups(solution: Solution) -> dict[str, GroupTest]:
    return {one.name: one for one in verdict(solution).groups}


@pytest.fixture(scope="module")
def behind() -> Solution:
    return adjusted(hidden(3))


def test_groups_add_up_to_the_whole() -> None:
    for net in (network(pair()), with_shift_and_surface(network(pair()))):
        solution = adjusted(net)
        found = verdict(solution)
        assert sum(one.rows for one in found.groups) == solution.fit.observations
        assert sum(one.redundancy for one in found.groups) == pytest.approx(solution.fit.degrees_of_freedom, rel=1e-6)
        assert sum(one.sum_of_squares for one in found.groups) == pytest.approx(solution.fit.squares, rel=1e-6)
        assert len({one.name for one in found.groups}) == len(found.groups)
        assert verdict(solution) is found  # a solution never changes


def test_noisy_ties_are_named_behind_cautious_laser_rows(behind: Solution) -> None:
    """The sigma0 of all is below one."""
    assert behind.sigma0 < 1.0
    assert 1.2 < groups(behind)[TIES].sigma0 < 1.8
    assert groups(behind)[CAUTIOUS].p_value > 0.99
    assert [one.what for one in verdict(behind).of(Cause.GROUP)] == [TIES]
    assert verdict(behind).state is State.SUSPECT
    assert is_valid(behind)


def test_a_group_is_tested_by_the_law_of_its_squares() -> None:
    """Covariance of a group's residuals as I - A N^-1 A' in full, and draws from it."""
    solution = adjusted(with_shift_and_surface(network(pair(ties=12, shots=8))))
    at = at_solution(solution)
    rows = residual_rows(at, np.arange(len(solution.network.points)))
    every = rows.variance(np.arange(rows.kind.size), np.eye(rows.kind.size))
    values, vectors = np.linalg.eigh(every)
    assert -1e-3 < values.min() <= values.max() < 1.0 + 1e-3
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(1).standard_normal((20_000, values.size)) @ root.T
    grouping = group_rows(solution.network)
    for test in fit_of_groups(rows, prior_rows(at), grouping):
        mine = np.flatnonzero(np.array([name == test.name for name in row_names(rows, grouping)]))
        assert np.trace(every[np.ix_(mine, mine)]) == pytest.approx(test.redundancy, rel=1e-6)
        if test.tested:
            larger = np.mean(np.sum(draws[:, mine] ** 2, axis=1) > test.sum_of_squares)
            assert test.p_value == pytest.approx(larger, abs=0.02), test.name


def test_of_many_rows_mean_and_variance_are_those_of_their_squares() -> None:
    solution = adjusted(network(pair(ties=60, shots=40)))
    at = at_solution(solution)
    rows = residual_rows(at, np.arange(len(solution.network.points)))
    grouping, large = group_rows(solution.network), 0
    names = np.array(row_names(rows, grouping))
    for test in fit_of_groups(rows, prior_rows(at), grouping):
        if test.weights.size == 1 and test.rows > 1:
            mine = np.flatnonzero(names == test.name)
            part = rows.variance(mine, np.eye(mine.size))
            assert test.weights[0] * test.redundancy == pytest.approx(np.sum(part**2), rel=1e-6)
            large += 1
    assert large >= 2


def row_names(rows: ResidualRows, grouping: Grouping) -> list[str]:
    """Name of the group of each row."""
    number, names = numbers_of_groups(rows, grouping)
    return [names[k] for k in number.tolist()]


@pytest.mark.parametrize("weights", [[1.0], [1.0] * 7, [1.0, 1e-3], [0.9, 0.5, 0.2, 0.1], [1e-4] * 40 + [0.3]])
def test_the_tail_of_a_quadratic_form(weights: list[float]) -> None:
    sums = np.random.default_rng(2).standard_normal((200_000, len(weights))) ** 2 @ np.array(weights)
    for share in (0.02, 0.3, 0.5, 0.8, 0.99, 0.9999):
        value = float(np.quantile(sums, share))
        assert quadratic_tail(value, np.array(weights)) == pytest.approx(1.0 - share, rel=0.12, abs=0.004)
    assert quadratic_tail(1e4, np.array(weights)) < 1e-30


def test_errors_of_the_hidden_factor_are_found() -> None:
    """Draws with errors so many times larger than stated, by the covariance C + (k^2 - 1) C^2 in full."""
    solution = adjusted(network(pair(ties=12, shots=8)))
    at = at_solution(solution)
    rows = residual_rows(at, np.arange(len(solution.network.points)))
    grouping, rng = group_rows(solution.network), np.random.default_rng(3)
    names = np.array(row_names(rows, grouping))
    for test in fit_of_groups(rows, prior_rows(at), grouping):
        mine = np.flatnonzero(names == test.name)
        part = rows.variance(mine, np.eye(mine.size))
        factor = test.hidden_factor(1e-3, 0.9)
        larger = part + (factor**2 - 1.0) * part @ part
        sums = np.sum(rng.multivariate_normal(np.zeros(mine.size), larger, 2000, method="eigh") ** 2, axis=1)
        weights = np.linalg.eigvalsh(part)
        weights = weights[weights > 1e-12]
        shares = np.mean([quadratic_tail(float(one), weights) < 1e-3 for one in sums[:400]])
        assert shares == pytest.approx(0.9, abs=0.12), test.name


def test_right_sigmas_are_valid_and_wrong_ones_suspect() -> None:
    """A few draws; 200 of each of five cases are in docs/evidence_errors.md."""
    for seed in range(3):
        draw = redraw(network(pair(ties=30, shots=30)), np.random.default_rng(seed))
        assert verdict(adjusted(draw.network)).state is State.VALID
        wrong = verdict(adjusted(hidden(500 + seed, 1.8)))
        assert TIES in [one.what for one in wrong.of(Cause.GROUP)]


def test_back_projected_positions_are_not_tested() -> None:
    net = network(pair(ties=30, shots=60))
    laser = net.points.classes[net.rays.point] == PointClass.LASER
    own = net.rays
    rays = ImageRays(own.point, own.image, own.places, own.sigmas, back_projected=laser)
    found = groups(adjusted(replace(net, rays=rays)))
    assert [name for name, one in found.items() if not one.tested] == [name for name in found if "back-proj" in name]


# --- corrections, common errors, offsets, outliers


def biased(size: float, component: int, every: bool) -> Solution:
    """Nominal orientations off by a constant size, in prior sigmas, of one image or of all."""
    net = network(pair(ties=40, shots=30))

    def change(j: int, one: OrientationCorrection) -> OrientationCorrection:
        wrong = np.zeros_like(one.coefficients)
        wrong[0, component] = size * net.priors[j].sigmas[0, component]
        return replace(one, coefficients=one.coefficients + wrong) if every or j == 0 else one

    return adjusted(redraw(net, np.random.default_rng(5), "camera", change).network)


@pytest.mark.parametrize("every", [False, True])
def test_a_wrong_orientation_is_named_by_its_correction(every: bool) -> None:
    """sigma0 doesn't show it."""
    found = verdict(biased(12.0, 2, every))
    assert found.state is State.SUSPECT
    assert found.of(Cause.CORRECTION) or found.of(Cause.ORIENTATION)
    assert abs(found.corrections[0].test) > 4.0
    assert found.corrections[0].p_value == pytest.approx(2.0 * norm.sf(abs(found.corrections[0].test)))


def test_an_offset_of_all_coordinates_of_a_class_is_named() -> None:
    net = network(pair(ties=40, shots=30))
    laser = (net.points.classes[net.rays.point] == PointClass.LASER) & (net.rays.image == 1)
    rays = replace(net.rays, places=net.rays.places + 300.0 * laser[:, None] * np.array([0.0, 1.0]))
    found = verdict(adjusted(replace(net, rays=rays)))
    assert found.state is State.SUSPECT
    assert any(net.images[1].name in one.what and "laser" in one.what for one in found.of(Cause.OFFSET))


def test_one_blunder_is_named() -> None:
    net = network(pair(ties=40, shots=30))
    k = int(np.flatnonzero(net.points.classes[net.rays.point] == PointClass.TIE)[7])
    places = net.rays.places.copy()
    places[k] += 40.0
    (one,) = verdict(adjusted(replace(net, rays=replace(net.rays, places=places)))).of(Cause.OBSERVATION)
    assert one.what == net.points.ids[net.rays.point[k]]
    assert one.count == 1


def test_observations_given_twice_are_named() -> None:
    """Field case 17."""
    net = network(pair(ties=20, shots=12))
    twice = with_shots_again(net)
    (one,) = verdict(adjusted(twice)).of(Cause.DUPLICATE)
    assert one.count == 12
    assert not verdict(adjusted(net)).of(Cause.DUPLICATE)


def with_shots_again(net: Network) -> Network:
    """The network with its laser shots a second time."""
    mine = np.flatnonzero(net.points.classes == PointClass.LASER)
    again = select_points(net, mine)
    ids = Names.of(f"{name}B" for name in again.points.ids)
    return joined([net, replace(again, points=replace(again.points, ids=ids))])


# --- what errors of inputs could hide


def test_an_undetected_error_is_what_it_does_to_the_adjustment() -> None:
    """Ranges 1 m longer: the points of an adjustment move as stated, to first order."""
    net = network(pair(ties=20, shots=30))
    before = adjusted(net)
    after = adjusted(replace(net, ranges=replace(net.ranges, values=net.ranges.values + 1.0)))
    (one,) = [one for one in verdict(before).undetected if one.what == "range"]
    moved = np.linalg.norm(after.places - before.places, axis=1)
    assert one.moves == pytest.approx(np.sqrt(np.mean(moved**2)), rel=0.02)
    radii = np.linalg.norm(net.points.places, axis=1)[:, None]
    places = replace(net.points, places=net.points.places * (1.0 + 1.0 / radii))
    raised = adjusted(replace(net, points=places))
    (up,) = [one for one in verdict(before).undetected if one.what == "upward shift"]
    moved = np.linalg.norm(raised.places - before.places, axis=1)
    assert up.moves == pytest.approx(np.sqrt(np.mean(moved**2)), rel=0.02)
    assert up.of == "laser shots"
    points = replace(net.points, classes=np.full(len(net.points), PointClass.TIE))  # Constrained in a network alone
    (up,) = [one for one in verdict(adjusted(replace(net, points=points))).undetected if one.what == "upward shift"]
    assert up.of == "control points"


def test_an_undetected_error_of_orientation_is_that_of_its_prior() -> None:
    """A nominal orientation that is off along the flight: points are off, from where the right one has them."""
    net = network(pair(ties=20, shots=30))
    (one,) = [one for one in verdict(adjusted(net)).undetected if (one.what, one.of) == ("roll", net.images[0].name)]
    size = 1e-5
    column = np.linalg.inv(flight_frame(net.images[0]).turn)[:, 3]

    def change(j: int, own: OrientationCorrection) -> OrientationCorrection:
        wrong = np.zeros_like(own.coefficients)
        wrong[0] = size * column
        return replace(own, coefficients=own.coefficients + wrong * (j == 0))

    right, wrong = (redraw(net, np.random.default_rng(7), "camera", each) for each in (None, change))
    off = (adjusted(wrong.network).places - wrong.places) - (adjusted(right.network).places - right.places)
    assert size * one.moves == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=0.03)
    assert one.tested
    assert one.size > 0.0


def test_errors_of_the_stated_size_are_found() -> None:
    """The least roll that is found with a probability of 99.9 %, at its size and at a third of it."""
    net = network(pair(ties=30, shots=30))
    first = verdict(adjusted(net)).undetected
    name = net.images[0].name
    (one,) = [each for each in first if (each.what, each.of) == ("roll", name)]
    column = np.linalg.inv(flight_frame(net.images[0]).turn)[:, 3]
    for factor, expected in ((1.0, 10), (0.2, 0)):

        def change(j: int, own: OrientationCorrection, size: float = factor * one.size) -> OrientationCorrection:
            wrong = np.zeros_like(own.coefficients)
            wrong[0] = size * column
            return replace(own, coefficients=own.coefficients + wrong * (j == 0))

        draws = [redraw(net, np.random.default_rng(seed), "camera", change).network for seed in range(10)]
        named = sum(verdict(adjusted(each)).state is not State.VALID for each in draws)
        assert abs(named - expected) <= 1


# --- common sense


def test_a_height_far_from_its_neighbors_is_named() -> None:
    net = network(pair(ties=60, shots=10))
    solution = adjusted(net)
    ties = np.flatnonzero(net.points.classes == PointClass.TIE)
    found = deviating_heights(net, solution.places, solution.covariances)
    assert not found.points.size
    places = solution.places.copy()
    places[ties[5]] *= 1.0 - 12e3 / np.linalg.norm(places[ties[5]])
    found = deviating_heights(net, places, solution.covariances)
    assert found.points.tolist() == [ties[5]]
    assert found.deviations[0] == pytest.approx(-12e3, rel=0.1)
    unknown = np.broadcast_to(1e8 * np.eye(3), solution.covariances.shape)
    assert not deviating_heights(net, places, unknown).points.size


def test_shots_that_are_not_where_the_camera_looks_are_named() -> None:
    net = network(pair(ties=20, shots=10))
    assert not misplaced_profiles(net)
    image = net.images[0]
    ahead = image.pose(image.middle[0])
    off = 60e3 * ahead.velocity[0] / np.linalg.norm(ahead.velocity[0])
    places = net.points.places + off * (net.points.classes == PointClass.LASER)[:, None]
    (one, *_) = misplaced_profiles(replace(net, points=replace(net.points, places=places)))
    assert one.angle > 0.05
    assert one.shots == np.count_nonzero(net.ranges.image == 0)


# --- residuals before anything is solved


def found(net: Network) -> tuple[str, ...]:
    residuals = predict(net, SolverSettings()).residuals
    named = tuple(net.images[one.image].name for one in unexplained_residuals(net, residuals))
    assert bool(beyond_priors_statements(net, residuals)) == bool(named)
    return named


@pytest.mark.parametrize("seed", range(20, 22))
def test_what_the_priors_explain_is_let_be(seed: int) -> None:
    assert not found(network(pair(seed=seed)))


def turned(net: Network, image: int, columns: bool) -> Network:
    """The network with an image's measures of two ties, or lines and samples, interchanged."""
    places, mine = net.rays.places.copy(), np.flatnonzero(net.rays.image == image)
    places[mine] = places[mine][:, ::-1] if columns else places[np.roll(mine, 1)]
    return replace(net, rays=replace(net.rays, places=places))


@pytest.mark.parametrize("columns", [True, False])
def test_interchanged_measures_are_named(columns: bool) -> None:
    net = network(pair(ties=30, shots=4))
    assert net.images[1].name in found(turned(net, 1, columns))


def test_unknown_orientations_explain_anything() -> None:
    net = turned(network(pair(ties=30, shots=4)), 1, columns=False)
    unknown = OrientationPrior(np.full_like(net.priors[1].sigmas, np.inf))
    residuals = predict(net, SolverSettings()).residuals
    assert not unexplained_residuals(replace(net, priors=(net.priors[0], unknown)), residuals)


def test_unlimited_sigmas_of_positions_are_tested_without_a_warning() -> None:
    net = network(pair(ties=30, shots=8))
    sigmas = net.priors[1].sigmas.copy()
    sigmas[0, :3] = np.inf
    assert verdict(adjusted(replace(net, priors=(net.priors[0], OrientationPrior(sigmas))))).tests > 100


def test_what_a_pass_and_its_boresight_explain_is_let_be_and_interchanged_measures_are_not() -> None:
    net = rig(seed=20)
    assert not found(net)
    assert not range_statements(net, predict(net, SolverSettings()).range_residuals)
    assert not adjusted_rig(20).strained
    assert found(turned(rig(), 1, columns=True))[0] == "R"
    residuals = predict(scaled(rig(), 1.02), SolverSettings()).range_residuals
    assert [one.image for one in unexplained_ranges(rig(), residuals)] == [0]


def test_nodes_that_are_moved_beyond_their_sigmas_are_named() -> None:
    solution = adjusted_rig()
    sigmas = solution.network.passes[0].prior.own_sigmas(solution.network.passes[0].nodes)
    moved = solution.nodes[0] + 8.0 * sigmas * (np.arange(6) == 4)
    (one,) = replace(solution, nodes=(moved,)).strained
    assert one.image == 0
    assert one.most == pytest.approx(8.0, abs=1.0)


def scaled(net: Network, factor: float) -> Network:
    """The network with all its laser ranges so many times longer."""
    return replace(net, ranges=replace(net.ranges, values=factor * net.ranges.values))


def test_ranges_are_let_be_unless_their_mean_is_beyond_the_orbit() -> None:
    for seed in range(20, 24):
        net = network(pair(seed=seed))
        assert not range_statements(net, predict(net, SolverSettings()).range_residuals)
    residuals = predict(scaled(net, 1.02), SolverSettings()).range_residuals
    (one,) = unexplained_ranges(net, residuals)
    assert one.image == 0
    assert one.size == pytest.approx(0.02 * net.ranges.values.mean(), rel=0.1)
    assert net.images[0].name in range_statements(net, residuals)[0]


def test_of_images_that_share_a_range_bias_nothing_is_said() -> None:
    net = scaled(network(pair(seed=20)), 1.02)
    residuals = predict(net, SolverSettings()).range_residuals
    bias = SharedUnknown("bias", SharedKind.RANGE_BIAS, np.array([0]), np.array([1e4]))
    assert unexplained_ranges(net, residuals)
    assert not unexplained_ranges(replace(net, shared=(bias,)), residuals)
