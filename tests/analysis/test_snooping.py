"""`analyze --snoop`: planted blunders go, good measures stay, what is inseparable goes together."""

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
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.network import Network
from mgsgraph.results.analysis import Wanted, analysed
from mgsgraph.results.section import Section
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
def snooped() -> Section:
    (found,) = analysed(Posterior.of(adjust_network(planted(), SolverSettings())), Wanted(snooped=True), "pair")
    return found


def test_planted_blunders_go_and_nothing_else_does() -> None:
    """A tie with two rays goes as a point, and so does what contradicts a wrong a-priori place."""
    record = snooped().numbers
    removed = [one["measures"] for one in record["removed"]]
    assert [f"ray of point TIE00004 in image SIM/{image}" for image in "AB"] in removed
    assert {names[0].split()[3] for names in removed} == {"TIE00004", "SHOT00006", "SHOT00009", "SHOT00011"}
    assert record["still_over"] == []
    assert record["sigma0"] == pytest.approx(adjust_network(clean(), SolverSettings()).sigma0, abs=0.1)
    assert record["limit"] == pytest.approx(3.29, abs=0.001)
    assert "measurements of 4 points" in snooped().text(None)


def test_a_clean_network_is_left_alone() -> None:
    (found,) = analysed(Posterior.of(adjust_network(clean(), SolverSettings())), Wanted(snooped=True), "pair")
    assert found.numbers["removed"] == found.numbers["still_over"] == []


def test_known_blunders_stay_out_of_honest_sigmas() -> None:
    solution = adjust_network(planted(), SolverSettings(reject=4.0))
    rays, ranges = solution.rays_rejected, solution.ranges_rejected
    assert rays is not None and ranges is not None and np.any(rays)  # noqa: PT018
    marked = planted().with_rejected(rays, ranges, solution.stereo_rejected)
    settings = SolverSettings()
    one = components_of(at_values(marked, settings, solution.values, solution.places))
    first = iterated_components(marked, settings, most=1)
    assert not np.any(first.solution.rays_used & rays)
    assert not np.any(first.solution.ranges_used & ranges)
    for group, again in zip(one.groups, first.components.groups, strict=True):
        assert (again.name, again.rows) == (group.name, group.rows)
        assert again.squares == pytest.approx(group.squares, rel=1e-4)
    rest = iterated_components(marked, settings)
    assert rest.components["tie image points"].factor == pytest.approx(one["tie image points"].factor, rel=0.05)
    judged_anew = iterated_components(marked, replace(settings, reject=1e4), most=1).solution
    assert np.any(judged_anew.rays_used & rays)


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
