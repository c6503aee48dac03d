"""Data snooping: planted blunders go, good measures stay, what can't be told apart goes together."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.components import components_of, iterated_components
from mgsgraph.analysis.linearised import at_solution, at_values
from mgsgraph.analysis.measures import Levels, MeasureKind
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.snooping import Removal, Snooping, nothing_rejected, readmissible, selection, snoop
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.simulation.observations import NoiseSettings

TIE, SHOT, RANGE, PLACE = 3, 45, 8, 50


@cache
def clean() -> Network:
    return with_shift_and_surface(network(pair(ties=40, shots=20)))


def ray(net: Network, point: int, move: tuple[float, float]) -> tuple[Network, int]:
    """A network with a blunder in the first ray of a point."""
    k = int(np.flatnonzero(net.rays.point == point)[0])
    places = net.rays.places.copy()
    places[k] += move
    return replace(net, rays=replace(net.rays, places=places)), k


@cache
def planted() -> Network:
    net, _ = ray(clean(), TIE, (40.0, 5.0))
    net, _ = ray(net, SHOT, (-1.0, 90.0))
    values, places = net.ranges.values.copy(), net.points.places.copy()
    values[RANGE] += 300.0
    places[PLACE] += [0.0, 300.0, 200.0]
    return replace(net, ranges=replace(net.ranges, values=values), points=replace(net.points, places=places))


@cache
def snooped() -> Snooping:
    return snoop(planted())


def test_planted_blunders_go_and_nothing_else_does() -> None:
    found = snooped()
    gone = {observation for one in found.removals for observation in one.observations}
    ties = np.flatnonzero(planted().rays.point == TIE).tolist()
    shot = int(np.flatnonzero(planted().rays.point == SHOT)[0])
    assert gone == {
        *((MeasureKind.RAY, k) for k in (*ties, shot)),
        (MeasureKind.RANGE, RANGE),
        (MeasureKind.GROUND, PLACE),
    }
    assert found.complete
    assert found.reliability.severity.max() <= 1.0
    assert found.solution.sigma0 == pytest.approx(adjust_network(clean(), SolverSettings()).sigma0, abs=0.1)


def test_a_tie_with_two_rays_goes_as_a_point() -> None:
    one = next(one for one in snooped().removals if one.point == TIE)
    assert len(one.observations) == len(one.names) == 2
    assert not snooped().solution.determined[TIE]
    assert one.names[0].startswith("ray of point TIE00004 in image SIM/")


def test_several_go_at_a_time_where_they_do_not_disturb_each_other() -> None:
    found = snooped()
    assert found.adjustments <= 4
    assert len({one.point for one in found.removals if one.adjustment == 1}) > 1


def test_what_only_seemed_wrong_is_taken_back() -> None:
    """The point with a wrong place has a precise range: that seems wrong first."""
    found = snooped()
    assert [one.observations for one in found.readmitted] == [((MeasureKind.RANGE, PLACE - 40),)]
    assert not found.taken.ranges[PLACE - 40]


def test_marks_are_those_of_a_network() -> None:
    found = snooped()
    marked = found.taken.marked(planted())
    again = at_values(marked, found.solution.settings, found.solution.values, found.solution.places)
    table = reliability(again).measures
    assert np.allclose(table.test, found.reliability.measures.test, atol=1e-3, equal_nan=True)
    assert np.array_equal(found.solution.rays_rejected, found.taken.rays)
    assert np.array_equal(found.solution.ranges_rejected, found.taken.ranges)


def test_known_blunders_stay_out_of_honest_sigmas() -> None:
    taken, solution = snooped().taken, snooped().solution
    marked = solution.network
    assert np.array_equal(marked.rays.rejected, taken.rays)
    one = components_of(at_values(marked, solution.settings, solution.values, solution.places))
    first = iterated_components(marked, solution.settings, most=1)
    assert not np.any(first.solution.rays_used & taken.rays)
    assert not np.any(first.solution.ranges_used & taken.ranges)
    for group, again in zip(one.groups, first.components.groups, strict=True):
        assert (again.name, again.rows) == (group.name, group.rows)
        assert again.squares == pytest.approx(group.squares, rel=1e-4)
    rest = iterated_components(marked, solution.settings)
    assert rest.components["tie image points"].factor == pytest.approx(one["tie image points"].factor, rel=0.05)
    judged_anew = iterated_components(marked, replace(solution.settings, reject=1e4), most=1).solution
    assert np.any(judged_anew.rays_used & taken.rays)


def test_degrees_of_freedom_are_those_of_what_is_left() -> None:
    found = snooped()
    assert found.reliability.degrees_of_freedom == pytest.approx(found.solution.fit.degrees_of_freedom, abs=1e-4)


def test_a_clean_network_is_left_alone() -> None:
    found = snoop(clean())
    assert found.removals == ()
    assert found.adjustments == 1


def test_no_more_goes_than_is_allowed() -> None:
    found = snoop(planted(), most=2)
    assert len(found.removals) <= 2
    assert not found.complete


def test_wider_levels_take_less() -> None:
    net, _ = ray(clean(), SHOT, (0.0, 35.0))
    assert len(snoop(net, levels=Levels(alpha=0.05)).removals) >= len(snoop(net, levels=Levels(alpha=1e-9)).removals)


def test_many_blunders_need_few_adjustments() -> None:
    net = network(pair(ties=150, shots=20))
    rng, places = np.random.default_rng(4), net.rays.places.copy()
    wrong = rng.choice(150, 12, replace=False)
    for point in wrong:
        places[np.flatnonzero(net.rays.point == point)[0], 0] += rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 40.0)
    found = snoop(replace(net, rays=replace(net.rays, places=places)))
    alarms = reliability(adjust_network(net, SolverSettings()))
    alarms = alarms.measures.point[alarms.suspected]  # there are some among 300 tests, whatever is planted
    assert {one.point for one in found.removals} - set(alarms.tolist()) == set(wrong.tolist())
    assert found.adjustments <= 6


@pytest.mark.parametrize(("point", "which"), [(SHOT, [0]), (TIE, [0, 1])])
def test_what_is_out_is_judged_as_it_would_be_if_it_were_in(point: int, which: list[int]) -> None:
    """The test of an error of prediction is the joint test that the rows, or the point, have when they take part."""
    net, settings = clean(), SolverSettings()
    table = reliability(adjust_network(net, settings)).measures
    rays = np.flatnonzero(net.rays.point == point)[which].tolist()
    joint = table.joint[(table.kind == MeasureKind.RAY) & (table.row == rays[0])][0]
    taken = nothing_rejected(net).changed([(MeasureKind.RAY, k) for k in rays], True)
    solution = adjust_network(net, settings, left_in=selection(net, taken))
    names = tuple((MeasureKind.RAY, k) for k in rays)
    removal = Removal(names, ("ray",) * len(rays), point, 0.0, 2, 0.0, 1)
    for share, agrees in ((0.97, False), (1.03, True)):
        limit = share * float(joint)
        back = readmissible(net, at_solution(solution), solution, taken, [removal], lambda _, limit=limit: limit)
        assert bool(back) is agrees


def test_it_presumes_least_squares() -> None:
    with pytest.raises(InputError, match="data snooping: loss 'huber'; expected 'none'"):
        snoop(clean(), SolverSettings(loss="huber"))
    with pytest.raises(InputError, match="data snooping: reject = 3; expected 0"):
        snoop(clean(), SolverSettings(reject=3.0))
    with pytest.raises(InputError, match="most: -1; expected 0 or more"):
        snoop(clean(), most=-1)


@cache
def off_the_surface() -> Network:
    """Shots on a stereo surface with sigmas of 4 m; range and a-priori place of SHOT put it 30 m too low."""
    net = stereo_network(pair(40, 24, 1, NoiseSettings(range=1.0, ground=1.0)), displaced=False)
    assert net.stereo is not None
    values, places = net.ranges.values.copy(), net.points.places.copy()
    places[SHOT] -= 30.0 * places[SHOT] / np.linalg.norm(places[SHOT])
    values[net.ranges.point == SHOT] += 30.0
    sigmas = np.where(net.stereo.surface >= 0, 4.0, np.inf)
    return replace(
        net, ranges=replace(net.ranges, values=values), points=replace(net.points, places=places),
        stereo=replace(net.stereo, sigmas=sigmas),
    )  # fmt: skip


def test_a_shot_beside_the_stereo_surface_is_found_by_the_test_of_its_height() -> None:
    """No ray says where it is, so that it may as well lie elsewhere on the slope: its place goes with the height."""
    found = snoop(off_the_surface())
    one = found.removals[0]
    assert one.observations == ((MeasureKind.STEREO, SHOT), (MeasureKind.GROUND, SHOT))
    assert np.sqrt(one.test) == pytest.approx(30.0 / np.hypot(4.0, 0.7), rel=0.2)
    assert np.flatnonzero(found.solution.stereo_rejected).tolist() == [SHOT]
    assert not found.solution.stereo_used[SHOT]
    assert found.reliability.measures.redundancy.sum() == pytest.approx(found.solution.fit.degrees_of_freedom, abs=1e-4)


@pytest.mark.parametrize("settings", [SolverSettings(reject=4.0), SolverSettings(loss="tukey")])
def test_rejection_and_robust_losses_judge_heights_above_stereo_surfaces(settings: SolverSettings) -> None:
    """Where the sigma of the height is not the smallest, so that the residual shows the blunder."""
    whole = off_the_surface()
    found, plain = (adjust_network(whole, one) for one in (settings, SolverSettings()))
    assert found.converged
    assert (np.flatnonzero(found.stereo_rejected).tolist() == [SHOT]) is (settings.reject > 0.0)
    others = np.delete(np.arange(40, 64), SHOT - 40)
    assert found.stereo_heights[SHOT] < -25.0 < plain.stereo_heights[SHOT]
    assert np.sqrt(np.mean(found.stereo_heights[others] ** 2)) < np.sqrt(np.mean(plain.stereo_heights[others] ** 2))
    again = at_solution(found)
    assert again.fit().squares == pytest.approx(found.fit.squares, rel=1e-6)
    assert again.fit().observations == found.fit.observations
