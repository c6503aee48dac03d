"""Data snooping: planted blunders go, good measures stay, what is inseparable goes together."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.rounds import everything
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.components import components_of, iterated_components
from mgsgraph.analysis.linearised import at_solution, at_values
from mgsgraph.analysis.measures import Levels, MeasureKind
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.snooping import Snooping, removals, snoop
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.results.analysis import Wanted, analysed
from mgsgraph.simulation.observations import NoiseSettings

TIE, SHOT, RANGE = 3, 45, 8


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
    values = net.ranges.values.copy()
    values[RANGE] += 300.0
    return replace(net, ranges=replace(net.ranges, values=values))


@cache
def snooped() -> Snooping:
    return snoop(planted())


def test_planted_blunders_go_and_nothing_else_does() -> None:
    found = snooped()
    ties = np.flatnonzero(planted().rays.point == TIE).tolist()
    shot = int(np.flatnonzero(planted().rays.point == SHOT)[0])
    assert np.flatnonzero(found.solution.rays_rejected).tolist() == sorted([*ties, shot])
    assert np.flatnonzero(found.solution.ranges_rejected).tolist() == [RANGE]
    assert {one.point for one in found.removals} == {TIE, SHOT, int(planted().ranges.point[RANGE])}
    assert all(one.test > one.critical for one in found.removals)
    assert reliability(found.solution).severity.max() <= 1.0
    assert found.solution.sigma0 == pytest.approx(adjust_network(clean(), SolverSettings()).sigma0, abs=0.1)


def test_it_is_the_search_of_adjust_at_the_critical_value() -> None:
    same = adjust_network(planted(), SolverSettings(reject=Levels().critical))
    assert np.array_equal(snooped().solution.rays_rejected, same.rays_rejected)
    assert np.allclose(snooped().solution.places, same.places, equal_nan=True)


def test_the_report_lists_what_is_out_the_worst_first() -> None:
    posterior = Posterior.of(adjust_network(planted(), SolverSettings(loss="huber")))
    (section,) = analysed(posterior, Wanted(snooped=True), "planted")
    assert "By plain least squares, without the loss and the blunder limit of this solution" in section.text()
    assert "3 points, by the search of adjust --reject" in section.text()
    assert "(limit 3.29): range of point SHOT00009 in image SIM/A" in section.text()
    tests = [one["test"] / one["critical"] for one in section.numbers["removed"]]
    assert tests == sorted(tests, reverse=True)
    with pytest.raises(InputError, match=r"data snooping, alpha: critical value 1\.96; expected 2 or more"):
        snoop(planted(), levels=Levels(alpha=0.05))


def test_a_tie_with_two_rays_goes_as_a_point() -> None:
    one = next(one for one in snooped().removals if one.point == TIE)
    assert len(one.names) == 2
    assert not snooped().solution.determined[TIE]
    assert one.names[0].startswith("ray of point TIE00004 in image SIM/")


def test_known_blunders_stay_out_of_honest_sigmas() -> None:
    solution = replace(snooped().solution, settings=SolverSettings())
    rays, ranges = solution.rays_rejected, solution.ranges_rejected
    marked = solution.network.with_rejected(rays, ranges, solution.stereo_rejected)
    one = components_of(at_values(marked, solution.settings, solution.values, solution.places))
    first = iterated_components(marked, solution.settings, most=1)
    assert not np.any(first.solution.rays_used & rays)
    assert not np.any(first.solution.ranges_used & ranges)
    for group, again in zip(one.groups, first.components.groups, strict=True):
        assert (again.name, again.rows) == (group.name, group.rows)
        assert again.squares == pytest.approx(group.squares, rel=1e-4)
    rest = iterated_components(marked, solution.settings)
    assert rest.components["tie image points"].factor == pytest.approx(one["tie image points"].factor, rel=0.05)
    judged_anew = iterated_components(marked, replace(solution.settings, reject=1e4), most=1).solution
    assert np.any(judged_anew.rays_used & rays)


def test_degrees_of_freedom_are_those_of_what_is_left() -> None:
    found = snooped()
    freedom = reliability(found.solution).degrees_of_freedom
    assert freedom == pytest.approx(found.solution.fit.degrees_of_freedom, abs=1e-4)


def test_a_clean_network_is_left_alone() -> None:
    assert snoop(clean()).removals == ()


def test_wider_levels_take_less() -> None:
    net, _ = ray(clean(), SHOT, (0.0, 35.0))
    assert len(snoop(net, levels=Levels(alpha=0.04)).removals) >= len(snoop(net, levels=Levels(alpha=1e-9)).removals)


def test_many_blunders_go() -> None:
    net = network(pair(ties=150, shots=20))
    rng, places = np.random.default_rng(4), net.rays.places.copy()
    wrong = rng.choice(150, 12, replace=False)
    for point in wrong:
        places[np.flatnonzero(net.rays.point == point)[0], 0] += rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 40.0)
    found = snoop(replace(net, rays=replace(net.rays, places=places)))
    alarms = reliability(adjust_network(net, SolverSettings()))
    alarms = alarms.measures.point[alarms.suspected]  # there are some among 300 tests, whatever is planted
    assert {one.point for one in found.removals} - set(alarms.tolist()) == set(wrong.tolist())


@pytest.mark.parametrize(("point", "which"), [(SHOT, [0]), (TIE, [0, 1])])
def test_what_is_out_is_judged_as_it_would_be_if_it_were_in(point: int, which: list[int]) -> None:
    """The test of an error of prediction is the joint test that the rows, or the point, have when they take part."""
    net, settings = clean(), SolverSettings()
    table = reliability(adjust_network(net, settings)).measures
    rays = np.flatnonzero(net.rays.point == point)[which].tolist()
    joint = table.joint[(table.kind == MeasureKind.RAY) & (table.row == rays[0])][0]
    out = np.isin(np.arange(net.rays.point.size), rays)
    whole = everything(net)
    solution = adjust_network(net, settings, left_in=replace(whole, rays=~out))
    (one,) = removals(replace(solution, rays_rejected=out), 3.0)
    assert one.point == point
    assert one.test == pytest.approx(joint, rel=0.03)


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
    found = snoop(off_the_surface())
    one = found.removals[0]
    assert one.names == (f"height above the stereo surface of point {off_the_surface().points.ids[SHOT]}",)
    assert np.sqrt(one.test) == pytest.approx(30.0 / np.hypot(4.0, 0.7), rel=0.25)
    assert np.flatnonzero(found.solution.stereo_rejected).tolist() == [SHOT]
    assert not found.solution.stereo_used[SHOT]
    table = reliability(found.solution).measures
    assert table.redundancy.sum() == pytest.approx(found.solution.fit.degrees_of_freedom, abs=1e-4)


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
