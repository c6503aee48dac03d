"""Errors that neighbors have in common: groups with factors, against the covariances that they stand for."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from networks import network, pair, with_echoes, with_neighbors, with_shift_and_surface
from outside import refuses
from redraw import common_noise, redraw
from scipy.spatial import cKDTree

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.analysis.grouping import group_rows
from mgsgraph.analysis.verdict import is_valid
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.common import MOST, SPHERE, CommonErrors, common_errors, common_matches, correlation
from mgsgraph.network.parts import select_points


def spread(count: int, neighbors: float, dimensions: int, seed: int) -> tuple[Array, list[tuple[Array, Array]]]:
    """Places in a square, with windows of side 1 that overlap with so many others on average."""
    area = 4.0 if dimensions == 2 else np.pi
    places = np.random.default_rng(seed).uniform(0.0, np.sqrt(count * area / neighbors), (count, 2))
    places = places if dimensions == 2 else np.column_stack([places, 0.1 * places[:, 0]])
    return places, [(np.ones(count), np.ones(count))]


def implied(common: CommonErrors, own: Array) -> Array:
    """(n, n) covariance that groups state, by their priors' rows: dense, for all rows in whole sigmas."""
    first = np.cumsum(common.widths) - common.widths
    count = int(common.widths.sum())
    linked = {row.variables[-1] for row in common.links}
    alone = [g for g in range(common.widths.size) if g not in linked]
    free = np.concatenate([np.zeros(0, int), *(first[g] + np.arange(common.widths[g]) for g in alone)])
    rows = [np.eye(count)[free]]
    for one in common.links:
        rows.append(np.zeros((one.target.size, count)))
        for group, block in zip(one.variables, one.blocks, strict=True):
            rows[-1][:, first[group] : first[group] + block.shape[1]] = block
    every, loads = np.concatenate(rows), np.zeros((own.size, count))
    for member, group, load in zip(common.members, common.group, common.loads, strict=True):
        width = common.widths[group]
        loads[member, first[group] : first[group] + width] = load[:width] * own[member]
    return np.diag(own**2) + loads @ np.linalg.solve(every.T @ every, loads.T)


@example(300, 12.0, 3, 1)
@example(300, 5.0, 2, 0)
@given(st.integers(2, 120), st.floats(0.1, 12.0), st.sampled_from([2, 3]), st.integers(0, 4999))
def test_groups_have_the_covariance_that_they_stand_for(count: int, neighbors: float, dims: int, seed: int) -> None:
    """Of single rows, of sums over neighbors and of all; exactly of pairs."""
    places, parts = spread(count, neighbors, dims, seed)
    common, own = common_errors(places, parts, np.arange(count))
    every = np.arange(count)
    exact = correlation(places, parts, every[:, None], every)
    assert np.linalg.eigvalsh(exact)[0] > -1e-9
    if common is None:
        return
    assert np.bincount(common.group).max() <= MOST
    found = implied(common, own)
    np.testing.assert_allclose(common.total * own[common.members], 1.0)
    alone = (common.independent * own[common.members]) ** 2  # without correlations of a hundredth
    np.testing.assert_allclose(alone, exact.sum(axis=1)[common.members], rtol=0.05)
    assert np.abs(np.diag(found) - 1.0).max() < 0.25
    assert np.mean(np.diag(found)) == pytest.approx(1.0, abs=0.02)
    assert found.sum() == pytest.approx(exact.sum(), rel=0.06)
    near = cKDTree(places).query(places, min(30, count))[1]
    of_means = [(found[np.ix_(mine, mine)].sum(), exact[np.ix_(mine, mine)].sum()) for mine in near]
    assert np.divide(*np.array(of_means).T) == pytest.approx(np.ones(count), abs=0.15)
    if not common.links and np.bincount(common.group).max() == 2:
        np.testing.assert_allclose(found, exact, atol=0.06)


def test_two_windows_have_what_they_overlap_in_common() -> None:
    """Half a window apart along lines, a quarter along samples: 3/8; a third one is alone."""
    places = np.array([[0.0, 0.0], [5.0, 2.5], [50.0, 50.0]])
    common, own = common_errors(places, [(np.full(3, np.sqrt(0.8)), np.full(3, 10.0))], np.array([7, 3, 5]))
    assert common is not None
    assert sorted(common.members.tolist()) == [3, 7]
    share = 0.8 * 0.5 * 0.75
    np.testing.assert_allclose(own**2, [1.0 - share, 1.0 - share, 1.0])
    np.testing.assert_allclose(common.loads[:, 0] ** 2, share / (1.0 - share))


def test_windows_of_two_images_have_nothing_in_common() -> None:
    rays = network(pair(1, 1)).rays.chosen(np.array([0, 1]))
    assert rays.image.tolist() == [0, 1]
    rays = replace(rays, places=np.full((2, 2), 100.0))
    assert common_matches(rays, np.full(2, 50.0), np.ones(2))[1] is None


def test_draws_have_the_stated_correlations() -> None:
    """The mean square of sums over groups, in whole sigmas: what many draws of the factors give."""
    net, rng = with_neighbors(with_shift_and_surface(network(pair(20)))), np.random.default_rng(5)
    common = net.common_rays
    assert common is not None
    drawn = np.array([common_noise(net, rng, 2) for _ in range(400)]) / net.ray_sigmas
    mine = common.members[common.group == 0]
    seen = np.mean(drawn[:, mine].sum(axis=1) ** 2)
    own = net.rays.sigmas[:, 0] / net.ray_sigmas[:, 0]
    exact = implied(replace(common, members=common.members), own)[np.ix_(mine, mine)].sum()
    assert seen == pytest.approx(exact, rel=0.25)


@pytest.fixture(scope="module")
def neighbors() -> Network:
    return with_neighbors(with_shift_and_surface(network(pair(30))))


def test_an_adjustment_counts_factors_and_their_priors(neighbors: Network) -> None:
    """As many degrees of freedom as without; residuals are those of the whole errors."""
    solution, plain = adjust_network(neighbors), adjust_network(neighbors.independent)
    assert solution.fit.degrees_of_freedom == plain.fit.degrees_of_freedom
    assert len(solution.common) == sum(one.widths.size for one, _, _ in neighbors.common)
    ties = np.flatnonzero(solution.rays_used)[:10]
    for k in ties.tolist():
        image, point = neighbors.images[neighbors.rays.image[k]], solution.places[neighbors.rays.point[[k]]]
        correction = solution.correction(int(neighbors.rays.image[k]))
        seen = image.ground_to_image(point, correction)[0][0]
        np.testing.assert_allclose(neighbors.rays.places[k] - seen, solution.residuals[k], atol=1e-3)


def test_what_is_kept_point_by_point_has_larger_sigmas(neighbors: Network) -> None:
    part = select_points(neighbors, np.arange(5))
    assert not part.common
    assert neighbors.common_rays is not None
    np.testing.assert_allclose(part.rays.sigmas, neighbors.independent.rays.sigmas[neighbors.rays.point < 5])
    assert np.all(part.rays.sigmas >= neighbors.ray_sigmas[neighbors.rays.point < 5] - 1e-12)


@pytest.fixture(scope="module")
def echoes() -> Network:
    return with_echoes(with_shift_and_surface(network(pair())), 2.0)


def test_ranges_and_footprints_by_themselves_have_the_common_error_twice(echoes: Network) -> None:
    """Two sigmas of a range: 1 + 4 of its variance with the echo, 1 + 8 where rows are independent; a part keeps these.
    """
    plain, alone, of = network(pair()), echoes.independent, echoes.ranges.point
    assert alone.ranges.shares is None
    assert (echoes.range_sigmas / plain.ranges.sigmas) ** 2 == pytest.approx(np.full(of.size, 5.0), rel=1e-6)
    assert (alone.ranges.sigmas / plain.ranges.sigmas) ** 2 == pytest.approx(np.full(of.size, 9.0), rel=1e-6)
    known = plain.points.covariances[of]
    once, twice = echoes.points.covariances[of] - known, alone.points.covariances[of] - known
    assert np.trace(once, axis1=1, axis2=2) == pytest.approx(4.0 * plain.ranges.sigmas**2, rel=1e-6)
    np.testing.assert_allclose(twice, 2.0 * once, atol=1e-6)
    part = select_points(echoes, of[:2])
    np.testing.assert_allclose(part.points.covariances, alone.points.covariances[of[:2]])
    np.testing.assert_allclose(part.ranges.sigmas, alone.ranges.sigmas[:2])


def test_residuals_of_ranges_are_those_of_the_whole_errors(echoes: Network) -> None:
    """The distance to the adjusted footprint, whatever is known of it beforehand; the fit counts the same rows."""
    solution, alone = adjust_network(echoes), adjust_network(echoes.independent)
    ranges, image = echoes.ranges, echoes.images[0]
    since = ranges.times - image.trajectory.epoch
    correction = solution.correction(0).at(image.moments(image.timing.lines(since)))[0]
    eyes = image.trajectory.pose(since).position + correction[:, :3]
    away = np.linalg.norm(solution.places[ranges.point] - eyes, axis=1)
    np.testing.assert_allclose(solution.range_residuals, ranges.values - away, atol=1e-6)
    assert solution.fit.degrees_of_freedom == alone.fit.degrees_of_freedom


def test_footprints_with_common_errors_are_realistic() -> None:
    """With three sigmas of a range in common, heights have a NEES of 1: 0.65 by independent rows of larger sigmas, 1.44
    where footprints are off the other way.
    """
    plain, found = network(pair(12, 20), held=(True, True)), []
    for seed in range(30):
        draw = redraw(with_echoes(plain, 3.0), np.random.default_rng(7000 + seed))
        solution, mine = adjust_network(draw.network), draw.network.ranges.point
        up = draw.places[mine] / np.linalg.norm(draw.places[mine], axis=1, keepdims=True)
        off = np.einsum("nc,nc->n", solution.places[mine] - draw.places[mine], up)
        found.append(np.mean(off**2 / np.einsum("nc,ncd,nd->n", up, solution.covariances[mine], up)))
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)


def test_a_group_may_lose_all_its_rows(neighbors: Network) -> None:
    """As by a rejection: its factors stay, with their priors."""
    common = neighbors.common_rays
    assert common is not None
    number = np.arange(neighbors.rays.point.size)
    number[common.members[common.group == 0]] = -1
    thinned = replace(neighbors, common_rays=common.renumbered(number))
    assert len(group_rows(thinned).unknowns) == len(group_rows(neighbors).unknowns)
    assert is_valid(adjust_network(thinned))


def test_a_row_of_two_groups_is_refused() -> None:
    twice = np.array([3, 3])
    refuses("two groups", CommonErrors, twice, np.array([0, 1]), np.ones((2, 1)), np.ones(2, dtype=int), np.ones(2))


def test_the_range_of_heights_counts_as_much_as_a_circle() -> None:
    """The spherical model over a plane: 1/5 of its circle's area, and that of the radius 1 is pi."""
    step = 0.01
    axis = np.arange(-SPHERE, SPHERE, step)
    places = np.zeros((axis.size**2 + 1, 3))
    places[1:, :2] = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    parts = [(np.ones(len(places)), np.full(len(places), SPHERE))]
    one, other = np.zeros(axis.size**2, dtype=int), np.arange(1, len(places))
    assert correlation(places, parts, one, other).sum() * step**2 == pytest.approx(np.pi, rel=1e-3)
