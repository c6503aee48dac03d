"""Matching from end to end on a small simulated pair: against truth, of two and three images."""

from dataclasses import replace

import matched
import numpy as np
import pytest

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.matching.match import Matches, match_scene, matches_of
from mgsgraph.matching.measuring import Measured

FEW = replace(matched.SETTINGS, cells=20, features=400)


# above two seconds: matches two and three pictures whole, once for all tests of the run
@pytest.mark.parametrize("count", [2, 3])
def test_matches_are_where_the_ground_is(count: int) -> None:
    found = matched.matches(count)
    off = matched.errors(found)
    assert np.all(np.sqrt(np.mean(off**2, axis=0)) < 0.3)
    assert np.linalg.norm(off, axis=1).max() < 1.5
    filled, whole = found.cells
    assert whole > 50
    assert filled > 0.8 * whole
    assert len(off) >= 100


@pytest.mark.parametrize("count", [2, 3])
def test_tie_points_are_in_order(count: int) -> None:
    """Free points; the reference first, a pixel's centre; every sigma positive and finite."""
    found = matched.matches(count)
    ties = found.ties
    assert len(set(ties.ids)) == len(ties.ids) == ties.measure_point.max() + 1
    assert np.all(ties.kinds == PointKind.FREE)
    assert np.all(np.diff(ties.measure_point) >= 0)
    begins = np.flatnonzero(np.diff(ties.measure_point, prepend=-1))
    np.testing.assert_array_equal(np.flatnonzero(found.reference), begins)
    np.testing.assert_array_equal(ties.measures[begins] % 1.0, 0.5)
    assert np.all((ties.measure_sigmas > 0.0) & (ties.measure_sigmas < 0.5))
    assert np.all(found.covariances[begins] == 0.0)
    others = ~found.reference
    assert np.all(np.linalg.eigvalsh(found.covariances[others]) > 0.0)
    assert np.all(found.correlation[others] >= matched.SETTINGS.least_correlation)
    assert np.all(np.isfinite(found.misfit) == others)
    pairs = set(zip(ties.measure_point.tolist(), ties.measure_image, strict=True))
    assert len(pairs) == len(ties.measure_image)  # no point twice in an image
    size = [matched.LINES, 1024]
    assert np.all((ties.measures > 0.0) & (ties.measures < size))


def test_what_is_lost_is_counted() -> None:
    found = matched.matches()
    counts = [value for name, value in found.losses._asdict().items() if name != "linked"]
    assert counts == sorted(counts, reverse=True)
    assert found.losses.kept == np.count_nonzero(~found.reference) == len(found.ties.ids)
    (agreement,) = found.agreements
    assert agreement.moved == pytest.approx(229.0, abs=15.0)  # the published contradiction of this pair
    assert agreement.agreed > 0.8 * agreement.candidates
    assert 5.0 < agreement.height_sigma < 40.0
    assert found.step == pytest.approx(4.0, abs=0.3)  # the second image's
    assert repr(found) == f"Matches({len(found.ties.ids)} points in 60 of 60 cells)"


def test_cells_hold_no_more_than_wanted() -> None:
    found, scene = matched.matches(), matched.scene()
    ties = found.ties
    first = np.array([name == scene.pictures[0].image.name for name in ties.measure_image])
    plane = scene.pictures[0].on_chart(scene.ground, ties.measures[first & found.reference])
    cells, counts = np.unique(np.floor(plane / found.cell), axis=0, return_counts=True)
    # the nominal orientation shifts the chart a little: a match at an edge may count as its neighbour's
    assert np.mean(counts > matched.SETTINGS.per_cell) < 0.2
    assert len(cells) > 50


def test_tracks_of_three_agree_with_each_other() -> None:
    found = matched.matches(3)
    rays = np.bincount(found.ties.measure_point)
    assert np.sum(rays == 3) > 50
    assert rays.max() == 3
    names = list(matched.truth())
    by_point = found.ties.measures[np.isin(found.ties.measure_point, np.flatnonzero(rays == 3))].reshape(-1, 3, 2)
    images = [name for name, i in zip(found.ties.measure_image, found.ties.measure_point, strict=True) if rays[i] == 3]
    places = {name: np.full((len(by_point), 2), np.nan) for name in names}
    for row, name in enumerate(images):
        places[name][row // 3] = by_point[row // 3, row % 3]
    again = places[names[2]] - places[names[0]]  # the first image over again
    assert np.all(np.linalg.norm(again, axis=1) < 0.5)
    assert np.all(np.sqrt(np.mean(again**2, axis=0)) < 0.1)
    across = places[names[1]] - matched.true_places(names[2], places[names[2]], names[1])
    assert np.all(np.sqrt(np.mean(across**2, axis=0)) < 0.3)
    assert {frozenset((a.first, a.second)) for a in found.agreements} <= {
        frozenset(pair) for pair in ((0, 1), (0, 2), (1, 2))
    }
    parallel = [a for a in found.agreements if {a.first, a.second} == {0, 2}]
    assert all(np.isnan(a.height_sigma) for a in parallel)  # rays side by side tell no heights


def test_variances_are_shared_half_and_half() -> None:
    """The reference's, carried into the other picture, and the other's add up to the match's."""
    rng = np.random.default_rng(1)
    affine = np.array([[[1.1, 0.1], [-0.2, 0.8]], [[0.9, 0.0], [0.1, 1.2]], [[1.0, 0.3], [0.0, 1.0]]])
    roots = rng.standard_normal((3, 2, 2))
    covariances = 1e-3 * (roots @ np.swapaxes(roots, 1, 2) + np.eye(2))
    whole = np.zeros(3, dtype=np.int64)
    measured = Measured(
        np.array([4, 4, 9]), np.array([1, 1, 0]), np.array([0, 2, 2]), whole,
        np.array([[3.5, 4.5], [3.5, 4.5], [7.5, 8.5]]), rng.uniform(0.0, 9.0, (3, 2)), affine, covariances,
        np.array([0.9, 0.8, 0.7]), whole, np.ones(3, dtype=bool),
    )  # fmt: skip
    ties, told, correlation, misfit = matches_of(measured, np.array([0.1, 0.2, 0.3]), ("a", "b", "c"), np.array([1, 0]))
    assert [name[-7:] for name in ties.ids] == ["_000001", "_000002"]
    assert len({name[:9] for name in ties.ids}) == 1
    assert ties.measure_image == ("a", "c", "b", "a", "c")  # the second track was to be numbered first
    assert ties.measure_point.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_array_equal(ties.measures[[0, 2]], [[7.5, 8.5], [3.5, 4.5]])
    np.testing.assert_array_equal(told[[1, 3, 4]], covariances[[2, 0, 1]])
    np.testing.assert_array_equal(np.isnan(correlation), [True, False, True, False, False])
    np.testing.assert_array_equal(misfit[[1, 3, 4]], [0.3, 0.1, 0.2])
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(ties.measure_sigmas[[1, 3, 4]] ** 2, 0.5 * variance[[2, 0, 1]])
    inverse = np.linalg.inv(affine)
    carried = np.diagonal(inverse @ covariances @ np.swapaxes(inverse, 1, 2), axis1=1, axis2=2)
    np.testing.assert_allclose(ties.measure_sigmas[0] ** 2, 0.5 * carried[2])
    np.testing.assert_allclose(ties.measure_sigmas[2] ** 2, 0.25 * (carried[0] + carried[1]))


# ---- tiles, workers, and what is kept


@pytest.fixture
def many_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mgsgraph.matching.patches._SIZE", 400)


def assert_equal(one: Matches, other: Matches) -> None:
    for name in ("covariances", "correlation", "misfit"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("measures", "measure_sigmas", "measure_point"):
        np.testing.assert_array_equal(getattr(one.ties, name), getattr(other.ties, name))
    assert one.ties.measure_image == other.ties.measure_image
    assert one.losses == other.losses


@pytest.mark.slow
@pytest.mark.usefixtures("many_tiles")
def test_workers_change_nothing() -> None:
    scene, told = matched.scene(), list[tuple[str, int, int]]()
    alone = match_scene(scene, FEW, workers=1)
    assert_equal(match_scene(scene, FEW, 2, lambda *step: told.append(step)), alone)
    count = max(most for what, _, most in told if what == "matching")
    assert count > 3
    assert [done for what, done, _ in told if what == "matching"] == list(range(count + 1))
    assert {what: most for what, done, most in told if done == most} == {
        "coarse grid": 2, "matching": count, "measuring": 2,
    }  # fmt: skip


def test_a_narrow_search_still_finds_what_is_near() -> None:
    """Images whose orientations are known well: a search of less than a few pixels of the coarse grid."""
    found = match_scene(matched.true_scene(), replace(FEW, search=20.0), workers=1)
    assert found.agreements[0].moved < 10.0
    assert np.linalg.norm(matched.errors(found), axis=1).max() < 1.5
