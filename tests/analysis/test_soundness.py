"""What converged on too little fails the sanity checks; groups that their sigmas do not explain are named."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from rigs import adjusted_rig, rig
from scipy.stats import chi2
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network, predict
from mgsgraph.adjustment.fit import ABSURD, IMPOSSIBLE
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import residual_tests as module
from mgsgraph.analysis.residual_tests import group_fits
from mgsgraph.analysis.soundness import MOST, Kind, is_result, soundness, unexplained_ranges, unexplained_residuals
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import ImageRays, Network, PointClass, SharedKind, SharedUnknown
from mgsgraph.results.inventory import inventory
from mgsgraph.results.results import solution_json, summary_table
from mgsgraph.results.soundness import (
    beyond_priors_statements,
    range_statements,
    soundness_section,
    state_of,
    weight_unit,
)


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


def test_a_good_solution_is_a_result(good: Solution) -> None:
    assert is_result(good)
    assert not soundness(good).losses
    assert not soundness_section(good).sentences
    assert state_of(good) == "converged"
    assert solution_json(good)["soundness"]["sound"] is True
    assert not is_result(replace(good, converged=False))


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
    losses = [one for one in soundness(found).losses if one.kind is kind]
    assert losses
    assert losses[0].share == pytest.approx(share, abs=0.1)
    assert losses[0].fatal is fatal is (losses[0].share > MOST)
    assert is_result(found) is not fatal
    record = solution_json(found)["soundness"]
    assert record["sound"] is not fatal
    assert {"kind": str(kind), "of": losses[0].total, "count": losses[0].lost, "fatal": fatal}.items() <= next(
        one for one in record["left_out"] if one["kind"] == kind
    ).items()
    assert ("NO RESULT" in summary_table(found)) is fatal
    if kind is Kind.IMAGE:
        assert losses[0].image == good.network.images[1].name


def moved(solution: Solution, sigmas: float) -> Solution:
    """The solution with sigmas by which an orientation has moved by so many at the most."""
    (worst, *_) = replace(solution, network=tightened(solution.network, 1e-3)).strained
    return replace(solution, network=tightened(solution.network, 1e-3 * worst.most / sigmas))


def tightened(net: Network, factor: float) -> Network:
    return replace(net, priors=tuple(replace(prior, sigmas=factor * prior.sigmas) for prior in net.priors))


def test_orientations_that_no_sigma_allows(good: Solution) -> None:
    near, far = moved(good, 0.99 * IMPOSSIBLE), moved(good, 1.01 * IMPOSSIBLE)
    assert near.strained
    assert is_result(near)
    assert not is_result(far)
    (one,) = soundness(far).impossible
    name = far.network.images[one.image].name
    record = solution_json(far)["soundness"]
    assert record["sound"] is False
    assert record["orientations_impossible"] == [{"image": name, "sigmas": pytest.approx(1.01 * IMPOSSIBLE)}]
    assert "NO RESULT" in state_of(far)
    held = replace(far.network, held=np.ones(len(far.network.images), dtype=bool))
    assert is_result(replace(far, network=held))


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
    assert is_result(solution)
    assert not solution.strained


def test_a_sigma0_that_no_sigma_makes(good: Solution) -> None:
    freedom = good.fit.degrees_of_freedom
    wild = replace(good, fit=replace(good.fit, squares=1.01 * ABSURD**2 * freedom))
    assert not is_result(wild)
    assert is_result(replace(good, fit=replace(good.fit, squares=0.99 * ABSURD**2 * freedom)))


# --- sigma0 by group


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


@pytest.fixture(scope="module")
def behind() -> Solution:
    return adjusted(hidden(3))


def test_groups_add_up_to_the_whole() -> None:
    for net in (network(pair()), with_shift_and_surface(network(pair()))):
        solution = adjusted(net)
        fits = group_fits(solution)
        assert fits is not None
        assert sum(one.rows for one in fits) == solution.fit.observations
        assert sum(one.redundancy for one in fits) == pytest.approx(solution.fit.degrees_of_freedom, rel=1e-6)
        assert sum(one.squares for one in fits) == pytest.approx(solution.fit.squares, rel=1e-6)
        assert len({one.name for one in fits}) == len(fits)
        assert group_fits(solution) is fits  # a solution never changes


def test_noisy_ties_are_named_behind_cautious_laser_rows(behind: Solution) -> None:
    """The sigma0 of all is below one: it would have been called cautious."""
    fits = {one.name: one for one in group_fits(behind) or ()}
    assert behind.sigma0 < 1.0
    assert fits[TIES].worse
    assert 1.2 < fits[TIES].sigma0 < 1.8
    assert fits[CAUTIOUS].better
    assert TIES in " ".join(weight_unit(behind))


def test_right_sigmas_name_nothing_and_wrong_ones_always() -> None:
    """Two draws; 100 of each are in docs/analysis.md."""
    for seed in range(2):
        clean = group_fits(adjusted(network(pair(ties=30, shots=60, seed=400 + seed)))) or ()
        assert not [one.name for one in clean if one.worse or one.better]
        wrong = group_fits(adjusted(hidden(500 + seed, 1.8))) or ()
        assert [one.name for one in wrong if one.worse] == [TIES]


def test_all_groups_share_one_probability_of_a_false_alarm(behind: Solution) -> None:
    """What lies beyond all bands together, of chi-square with their redundancies."""
    judged = [one for one in group_fits(behind) or () if one.judged]
    beyond = [
        chi2.cdf(one.redundancy * one.low**2, one.redundancy) + chi2.sf(one.redundancy * one.high**2, one.redundancy)
        for one in judged
    ]
    assert len(judged) > 2
    np.testing.assert_allclose(beyond, module.ODDS / len(judged), rtol=1e-6)


def test_rejection_and_losses_are_allowed_for(behind: Solution) -> None:
    """Tails that rejection takes lower the squares; a robust loss makes of them no chi-square at all."""
    net = network(pair(ties=60, shots=60, seed=8))
    plain = {one.name: one for one in group_fits(adjusted(net)) or ()}
    rejecting = {one.name: one for one in group_fits(adjust_network(net, replace(PLAIN, reject=2.0))) or ()}
    assert rejecting[TIES].low < 0.9 * plain[TIES].low
    robust = group_fits(adjust_network(net, replace(PLAIN, loss="huber")))
    assert robust is not None
    assert not any(one.judged for one in robust)


def test_back_projected_places_are_no_measures() -> None:
    net = network(pair(ties=30, shots=60))
    laser = net.points.classes[net.rays.point] == PointClass.LASER
    own = net.rays
    rays = ImageRays(own.point, own.image, own.places, own.sigmas, back_projected=laser)
    fits = group_fits(adjusted(replace(net, rays=rays))) or ()
    assert any("back-projected" in one.name for one in fits)
    assert not any(one.judged for one in fits if "back-projected" in one.name)


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
