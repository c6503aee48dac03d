"""The planner: what it predicts is what one gets; gains add up; candidates on the trajectory of a pass."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from increments import NOISE, network_of, strip
from mex_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from networks import network, pair, with_shift_and_surface
from once import once
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.settings import Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import TERRAIN, Network
from mgsgraph.network.joining import definitions
from mgsgraph.network.parts import KnownImage, Unknown, joined, known_images, with_images, without_images
from mgsgraph.planning.candidates import (
    Candidate,
    PlannedShots,
    PlannedTies,
    planned_image,
    planned_point,
    planned_profile,
)
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.plan import Evaluator, TargetSigmas, plan, targets_of
from mgsgraph.planning.state import (
    CurrentState,
    NetworkState,
    added,
    correction_of,
    joined_networks,
    state_of_solution,
    updated,
)
from mgsgraph.simulation.strip import SimulatedStrip
from mgsgraph.units import MGON

TOLERANCE = 0.01
"""Share by which a predicted sigma may differ from the one really had: the issue's."""
SMALL = 0.02
"""Share of the usual sigmas that a well-known orientation has."""


@cache
def made(images: int = 11) -> SimulatedStrip:
    """A strip, of which the first images are there and the others are candidates."""
    return strip(images, 40, 6)


@once
def solved(images: int = 8) -> Solution:
    """The first images, adjusted."""
    return adjust_network(network_of(made(), range(images)), SolverSettings())


@cache
def coverage(images: int = 8) -> ImageCoverage:
    """Their ground."""
    return ImageCoverage(state_of_solution(solved(images)))


def state(images: int = 8) -> NetworkState:
    """Where they stand."""
    return coverage(images).state


@cache
def candidate(k: int, count: int = 12, existing: bool = False, images: int = 8, sigma: float = NOISE.tie) -> Candidate:
    """One of the strip's other images."""
    ties = PlannedTies(count, sigma=sigma, existing=existing)
    return planned_image(coverage(images), KnownImage(made().images[k], NOISE.prior), ties)


def well_known(k: int, existing: bool = False) -> tuple[Candidate, dict[str, OrientationCorrection]]:
    """The same with an orientation that is known fifty times better, so that it does much; and all true corrections."""
    prior = OrientationPrior(NOISE.prior.sigmas * SMALL)
    image, true = made().images[k], truth(made())
    ties = PlannedTies(12, sigma=NOISE.tie, existing=existing)
    corrections = true | {image.name: OrientationCorrection(true[image.name].coefficients * SMALL)}
    return planned_image(coverage(), KnownImage(image, prior), ties), corrections


def addition(chosen: Candidate) -> Network:
    """Its measures, of which it has some."""
    assert chosen.addition is not None
    return chosen.addition


def truth(simulated: SimulatedStrip) -> dict[str, OrientationCorrection]:
    """True corrections of all images."""
    return {image.name: true for image, true in zip(simulated.images, simulated.true_corrections, strict=True)}


def measured(
    planned: Network, true: Mapping[str, OrientationCorrection], places: Mapping[str, Array], noise: float = 1.0
) -> Network:
    """Planned measures as they would really be had: the ground seen with the true orientation, and noise.

    `places` are true places (3,) in m of points by name; new points are where they were planned.
    """
    rng = np.random.default_rng(1)
    ground = np.array([
        places.get(name, place) for name, place in zip(planned.points.ids, planned.points.places, strict=True)
    ])
    seen = planned.rays.places.copy()
    for j, image in enumerate(planned.images):
        mine = planned.rays.image == j
        seen[mine], _ = image.ground_to_image(ground[planned.rays.point[mine]], true[image.name])
    seen += noise * planned.rays.sigmas * rng.standard_normal(seen.shape)
    values = planned.ranges.values.copy()
    for j, image in enumerate(planned.images):
        mine = planned.ranges.image == j
        lines = image.timing.lines(planned.ranges.times[mine] - image.trajectory.epoch)
        eye = image.pose(lines, true[image.name]).position
        values[mine] = np.linalg.norm(eye - ground[planned.ranges.point[mine]], axis=1)
    values += noise * planned.ranges.sigmas * rng.standard_normal(values.size)
    return replace(planned, rays=replace(planned.rays, places=seen), ranges=replace(planned.ranges, values=values))


def really(solution: Solution, planned: Network, true: Mapping[str, OrientationCorrection]) -> Solution:
    """Batch over everything, the planned measures really taken."""
    simulated = made()
    places = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    return adjust_network(joined([solution.network, measured(planned, true, places)]), solution.settings)


def totals(solution: Solution, names: tuple[str, ...]) -> Array:
    """(n,) m, roots of the traces of the points' covariances."""
    place = {name: i for i, name in enumerate(solution.network.points.ids)}
    chosen = [place[name] for name in names]
    return np.asarray(np.sqrt(np.trace(solution.covariances[chosen], axis1=1, axis2=2)))


# --- what is predicted is what one gets


def prediction(planned: Network, wanted: str = "all") -> tuple[tuple[str, ...], np.ndarray]:
    """Targets, and their sigmas (n,) in m as planned."""
    targets, present = targets_of(state(), [wanted]), CurrentState(state())
    return targets.points, TargetSigmas(present, targets).after(updated(present, added(present, [planned])))[:, 0]


def assert_kept(names: tuple[str, ...], predicted: np.ndarray, after: np.ndarray) -> None:
    """The result is the predicted one; so is the drop itself, where it is large."""
    before = totals(solved(), names)
    assert predicted == pytest.approx(after, rel=TOLERANCE)
    large = predicted < 0.9 * before
    assert np.count_nonzero(large) > 10  # else nothing was predicted
    assert (before - predicted)[large] == pytest.approx((before - after)[large], rel=5.0 * TOLERANCE)


@pytest.mark.parametrize("existing", [False, True])
def test_an_image_brings_what_was_predicted(existing: bool) -> None:
    chosen, true = well_known(8, existing)
    names, predicted = prediction(addition(chosen))
    assert_kept(names, predicted, totals(really(solved(), addition(chosen), true), names))


def test_incremental_adjustment_gets_it_too() -> None:
    chosen, true = well_known(8, existing=True)
    names, predicted = prediction(addition(chosen))
    adjustment = IncrementalAdjustment.of(solved())
    places = dict(zip(made().ties.ids, made().true_ties, strict=True))
    adjustment.add(measured(addition(chosen), true, places))
    _, _, covariances = adjustment.points(names)
    assert_kept(names, predicted, np.sqrt(np.trace(covariances, axis1=1, axis2=2)))


def test_a_profile_brings_what_was_predicted() -> None:
    view = coverage().views[made().images[2].name]
    edges = view.image.timing.at(np.array([0.0, float(view.image.lines)]))[0] + view.image.trajectory.epoch
    times = np.linspace(edges[0] + 0.1, edges[1] - 0.1, 8)
    ground, n = coverage().below(view.positions(times), view.height), times.size
    spread = np.broadcast_to(np.eye(3), (n, 3, 3))
    shots = PlannedShots(times, ground, view.image.name, np.full(n, 1.0), spread, 2.0, 1.0)
    chosen = planned_profile(coverage(), "new profile", shots)
    assert chosen.ranges == n
    names, predicted = prediction(addition(chosen))
    assert_kept(names, predicted, totals(really(solved(), addition(chosen), truth(made())), names))


def test_a_control_point_brings_what_was_predicted() -> None:
    chosen = planned_point(coverage(), "surveyed", state().places[3], 0.04 * np.eye(3), 0.3)
    names, predicted = prediction(addition(chosen))
    assert_kept(names, predicted, totals(really(solved(), addition(chosen), truth(made())), names))


def test_the_ground_under_an_image_is_that_of_the_solution() -> None:
    name = made().images[7].name
    targets = targets_of(state(), [name])
    chosen = candidate(8)
    present = CurrentState(state())
    watch = TargetSigmas(present, targets)
    after = really(solved(), addition(chosen), truth(made()))
    planned = watch.after(updated(present, added(present, [addition(chosen)])))
    for sigmas, solution in ((watch.before(), solved()), (planned, after)):
        one = IncrementalAdjustment.of(solution)._engine.shared[Unknown("image", name)]
        assert sigmas[0, 0] == pytest.approx(np.sqrt(np.trace(one.ground @ one.covariance @ one.ground.T)), rel=0.01)
        assert sigmas[0, 3] < 1e-2 * sigmas[0, 0]


@pytest.mark.parametrize(("loss", "considered"), [("none", ()), ("huber", ()), ("none", ("profile", TERRAIN))])
def test_terrain_shifts_and_a_robust_loss_hold_too(loss: Loss, considered: tuple[str, ...]) -> None:
    settings = SolverSettings(loss=loss)
    whole = replace(with_shift_and_surface(network(pair(ties=24, shots=9))), considered=considered)
    place = ImageCoverage(state_of_solution(adjust_network(whole, settings)))
    chosen = planned_point(place, "surveyed", place.state.places[0], np.eye(3), 0.5)
    present = CurrentState(place.state)
    targets = targets_of(place.state, ["all"])
    predicted = TargetSigmas(present, targets).after(updated(present, added(present, [addition(chosen)])))
    both = adjust_network(place.state.extended([addition(chosen)]).network, settings)
    assert predicted[:, 0] == pytest.approx(totals(both, targets.points), rel=TOLERANCE)


# --- the update is exact linear algebra


def joint(present: CurrentState) -> np.ndarray:
    return present.held_with(present.adjusted)


def schmidt(present: CurrentState) -> np.ndarray:
    """Dense P = N_xx^-1 + S C S' of all shared unknowns (Schmidt 1966), with S = -N_xx^-1 N_xc."""
    normal, prior = present.information(present.adjusted), present.layout.sigmas**2
    c = present.columns(present.considered)
    x = np.setdiff1d(np.arange(prior.size), c)
    noise = np.linalg.inv(normal[np.ix_(x, x)] + np.diag(1.0 / prior[x]))
    follows = np.zeros((prior.size, c.size))
    follows[x], follows[c] = -noise @ normal[np.ix_(x, c)], np.eye(c.size)
    found = follows * prior[c] @ follows.T
    found[np.ix_(x, x)] += noise
    return found


@pytest.mark.parametrize("considered", [("profile",), ("profile", TERRAIN)])
def test_considered_unknowns_are_carried_before_and_after(considered: tuple[str, ...]) -> None:
    whole = replace(with_shift_and_surface(network(pair(ties=24, shots=9))), considered=considered)
    place = ImageCoverage(state_of_solution(adjust_network(whole, SolverSettings())))
    chosen = planned_point(place, "surveyed", place.state.places[0], np.eye(3), 0.5)
    present, anew = (CurrentState(one) for one in (place.state, place.state.extended([addition(chosen)])))
    update, scale = updated(present, added(present, [addition(chosen)])), np.sqrt(np.diagonal(schmidt(present)))
    for one in (present, anew):
        np.testing.assert_allclose(one.joint.dense() / scale / scale[:, None], schmidt(one) / scale / scale[:, None],
                                   atol=1e-6)
    found = present.joint.dense() + (update.change * update.signs) @ update.change.T
    np.testing.assert_allclose(found / scale / scale[:, None], schmidt(anew) / scale / scale[:, None], atol=1e-6)
    logs = [np.linalg.slogdet(schmidt(one) / np.outer(scale, scale))[1] for one in (present, anew)]
    assert update.bits == pytest.approx(0.5 * (logs[0] - logs[1]) / np.log(2.0), rel=1e-6)
    targets = targets_of(place.state, ["all"])
    assert TargetSigmas(present, targets).after(update) == pytest.approx(TargetSigmas(anew, targets).before(), rel=1e-5)
    c = present.columns(present.considered)
    np.testing.assert_allclose(np.diagonal(found)[c], present.layout.sigmas[c] ** 2, rtol=1e-7)


@pytest.mark.parametrize("existing", [False, True])
def test_the_update_equals_the_network_put_together_anew(existing: bool) -> None:
    chosen, present = candidate(8, existing=existing), CurrentState(state())
    update = updated(present, added(present, [addition(chosen)]))
    anew = CurrentState(state().extended([addition(chosen)]))
    old = anew.columns(present.adjusted)
    expected = joint(anew)[np.ix_(old, old)]
    scale = np.sqrt(np.diagonal(expected))
    found = joint(present) + (update.change * update.signs) @ update.change.T
    assert np.max(np.abs(found - expected) / np.outer(scale, scale)) < 1e-6
    logs = [np.linalg.slogdet(one / np.outer(scale, scale))[1] for one in (joint(present), expected)]
    assert update.bits == pytest.approx(0.5 * (logs[0] - logs[1]) / np.log(2.0), rel=1e-6)
    targets = targets_of(state(), ["all"])
    assert TargetSigmas(present, targets).after(update) == pytest.approx(TargetSigmas(anew, targets).before(), rel=1e-6)


@pytest.mark.parametrize("existing", [False, True])
def test_gains_of_a_chain_add_up(existing: bool) -> None:
    """Candidates 8 and 9 measure the same points of the network again: what one says changes what the other adds."""
    chain = [candidate(8, existing=existing), candidate(9, existing=existing)]
    chain.append(planned_point(coverage(), "surveyed", state().places[3], np.eye(3), 0.3))
    found = plan(state(), chain, 3)
    assert len(found.chosen) == 3
    together = Evaluator(state(), found.targets, "mean").of(*chain)
    assert found.bits == pytest.approx(together.bits, rel=1e-9)
    assert found.after.total == pytest.approx(together.after.total, rel=1e-7)
    assert min(step.bits for step in found.chosen) > 0.0


# --- the choice


def test_greedy_is_as_good_as_every_pair() -> None:
    controls = [planned_point(coverage(), f"c{i}", state().places[i], np.eye(3), 0.5) for i in (0, 120, 240)]
    every = [candidate(8), candidate(9), *controls]
    found = plan(state(), every, 2)
    judge = Evaluator(state(), found.targets, "mean")
    best = min(judge.of(*two).after.total for two in combinations(every, 2))
    assert found.after.total <= best * (1.0 + 1e-9)


def test_a_redundant_candidate_falls() -> None:
    """Two control points on the same ground head the ranking; the second is worth little beside the first."""
    here = state().places[100]
    twins = [planned_point(coverage(), name, here, 0.01 * np.eye(3), 0.3) for name in ("one", "other")]
    far = planned_point(coverage(), "far", state().places[300], 0.01 * np.eye(3), 0.5)
    found = plan(state(), [*twins, far], 2)
    assert {one.name for one in found.ranking[:2]} in ({"one", "other"}, {"one", "far"})
    assert {one.name for one in found.chosen} == {"one", "far"}


# --- candidates


def test_sigmas_are_those_asked_for() -> None:
    known = KnownImage(made().images[8], NOISE.prior)
    planned = addition(planned_image(coverage(), known, PlannedTies(5, sigma=0.7, own_sigma=0.3)))
    own = np.array([one.name for one in planned.images])[planned.rays.image] == known.image.name
    assert set(planned.rays.sigmas[own].ravel()) == {0.3}
    assert set(planned.rays.sigmas[~own].ravel()) == {0.7}


def test_fixed_points_are_no_targets() -> None:
    net = network(pair(ties=24, shots=9))
    kinds = net.points.kinds.copy()
    kinds[-1] = PointKind.FIXED
    fixed = replace(net, points=replace(net.points, kinds=kinds))
    where = state_of_solution(adjust_network(fixed, SolverSettings()))
    assert fixed.points.ids[-1] not in targets_of(where, ["all"]).points
    refuses("held and has no sigma", targets_of, where, [fixed.points.ids[-1]])
    refuses("'ties' beside names", targets_of, where, ["ties", net.images[0].name])


# --- candidates over images that share a trajectory


LATE = "HRSC/00/S2"
"""The last one of the strip."""


@cache
def pass_strip() -> Network:
    """One strip of a trajectory that is known well but for what changes on the way."""
    errors = TrajectoryErrors(attitude=1.0 * MGON, attitude_drift=0.5 * MGON, position=2.0, position_drift=1.0)
    settings = BlockSettings(passes=1, length=80e3, points=300, terrain=None, spacing=5.0, errors=errors)
    return simulate_hrsc_block(settings, seed=2).network


@cache
def pass_coverage() -> ImageCoverage:
    """The strip without its last image."""
    left = without_images(pass_strip(), {LATE})
    assert left is not None
    assert left.passes
    return ImageCoverage(state_of_solution(adjust_network(left, SolverSettings())))


def late() -> KnownImage:
    """The image that is missing, with an orientation of its own."""
    known = next(one for one in known_images(pass_strip()) if one.image.name == LATE)
    return replace(known, prior=OrientationPrior(np.array([[2.0] * 3 + [2e-5] * 3])))


def expected_measures(planned: Network) -> Network:
    """Planned measures as the orientation that is expected gives them, without noise."""
    state = pass_coverage().state
    known = definitions(state.network)
    corrections = {
        one.image.name: correction_of(one, state.settings, state.values, known.of([one.image.name]))
        for one in known_images(planned)
    }
    return measured(planned, corrections, {}, noise=0.0)


@pytest.mark.parametrize("existing", [False, True])
def test_an_image_over_a_strip_brings_what_was_predicted(existing: bool) -> None:
    known = late()
    chosen = planned_image(pass_coverage(), known, PlannedTies(12, sigma=0.3, existing=existing))
    assert chosen.addition is not None
    state = pass_coverage().state
    present, targets = CurrentState(state), targets_of(state, ["all"])
    update = updated(present, added(present, [chosen.addition]))
    predicted = TargetSigmas(present, targets).after(update)[:, 0]

    whole = joined_networks([state.network, expected_measures(chosen.addition)])
    whole = with_images(whole, [*known_images(state.network), known])
    had = totals(adjust_network(whole, SolverSettings()), targets.points)
    assert predicted == pytest.approx(had, rel=TOLERANCE)
    before = TargetSigmas(present, targets).before()[:, 0]
    large = had < 0.97 * before
    assert np.count_nonzero(large) > 10  # else nothing was predicted
    assert (before - predicted)[large] == pytest.approx((before - had)[large], rel=TOLERANCE)


def test_it_is_ranked_and_an_image_is_a_target() -> None:
    chosen = planned_image(pass_coverage(), late(), PlannedTies(12, sigma=0.3))
    found = plan(pass_coverage().state, [chosen], 1)
    assert [one.name for one in found.chosen] == [LATE]
    assert found.drop > 0.0
    name = pass_coverage().network.images[0].name
    ground = plan(pass_coverage().state, [chosen], 1, [name])
    assert 0.0 < ground.after.total < ground.now.total
