"""Contradictions of orientations at matches made from truth: heights left aside, blunders told, corrections found."""

from dataclasses import replace

import matched
import numpy as np
import pytest

from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.matching.checks import checked_measures
from mgsgraph.matching.coarse import (
    Displacements,
    consensus,
    displacements,
    increased,
    match_offsets,
    sigmas_between,
)
from mgsgraph.matching.match import checked_matches, ground_cells
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.scene import Pair, first_picture, next_pair, pairs_of

PLANTED = OrientationCorrection(np.array([[40.0, 90.0, -30.0, 3e-4, -2e-4, 3e-4], [5.0, -8.0, 3.0, 3e-5, 4e-5, 0.0]]))


def planted(count: int = 200, lift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Places in both pictures of points of the model's ground, lifted; the second is truly turned as planted."""
    scene = matched.scene()
    points = scene.ground.points(scene.ground.chart.plane(matched.inner(count)))
    points = points * (1.0 + lift / np.linalg.norm(points, axis=1, keepdims=True))
    first, second = scene.pictures
    return first.project(points), second.image.ground_to_image(points, PLANTED)[0]


def found(places: tuple[np.ndarray, np.ndarray], degree: int = 1) -> tuple[Displacements, np.ndarray]:
    scene = matched.scene()
    sigmas = sigmas_between(*scene.pictures, degree)
    return displacements(*scene.pictures, places, scene.ground, sigmas), sigmas


def test_coplanarity_is_untouched_by_heights() -> None:
    low, middle, high = (found(planted(60, lift))[0] for lift in (-50.0, 0.0, 50.0))
    for one in (low, high):
        across, along = np.abs(one.offsets - middle.offsets).T
        assert np.all(along > 15.0)  # 50 m times 0.4
        assert np.all(across < 1e-3 * along)
    np.testing.assert_allclose(high.offsets[:, 1] - middle.offsets[:, 1], -50.0 * middle.parallax, rtol=0.05)


def test_without_errors_nothing_contradicts() -> None:
    scene = matched.scene()
    points = scene.ground.points(scene.ground.chart.plane(matched.inner()))
    places = tuple(picture.project(points) for picture in scene.pictures)
    assert np.abs(match_offsets(*scene.pictures, places, scene.ground)).max() < 0.02


def test_designs_are_differences() -> None:
    scene = matched.scene()
    level = replace(scene.ground, terrain=None)
    sigmas, places = sigmas_between(*scene.pictures, 1), planted(20)
    one = displacements(*scene.pictures, places, level, sigmas)
    coefficients = np.random.default_rng(1).standard_normal(12) * 0.1
    turned = increased(scene.pictures[1].correction, coefficients.reshape(sigmas.shape) * sigmas)
    told = one.residuals(coefficients)
    moved = match_offsets(scene.pictures[0], replace(scene.pictures[1], correction=turned), places, level)
    away = np.abs(one.design @ coefficients).max()
    np.testing.assert_allclose(told, moved, atol=1e-3 * away)
    np.testing.assert_allclose(one.of(np.arange(3)).residuals(coefficients), told[:3])


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_planted_correction_is_found(share: float) -> None:
    """Within its effect on the ground; blunders of up to 300 m are told from matches."""
    first, second = planted(250)
    rng = np.random.default_rng(3)
    second = second + 0.3 * rng.standard_normal(second.shape)
    wrong = rng.uniform(size=len(second)) < share
    second[wrong] += rng.uniform(-100.0, 100.0, (wrong.sum(), 2))
    one, sigmas = found((first, second))
    taken, fits = consensus(one, 4.0, 5.0, np.random.default_rng(0))
    assert np.all(fits[~wrong])
    assert np.mean(fits[wrong]) < 0.05 if share else True
    scene = matched.scene()
    more = increased(scene.pictures[1].correction, taken.reshape(sigmas.shape) * sigmas)
    turned = replace(scene.pictures[1], correction=more)
    true = replace(scene.pictures[1], correction=PLANTED)
    at = planted(250)[1]
    off = turned.on_chart(scene.ground, at) - true.on_chart(scene.ground, at)
    before = scene.pictures[1].on_chart(scene.ground, at) - true.on_chart(scene.ground, at)
    assert np.sqrt(np.mean(before**2)) > 30.0
    assert np.sqrt(np.mean(off**2)) < 0.5  # a pixel is 3 m
    again = consensus(one, 4.0, 5.0, np.random.default_rng(0))
    np.testing.assert_array_equal(again[0], taken)


def test_heights_are_no_blunders_but_what_lies_across_is() -> None:
    first, second = planted(200)
    raised = planted(200, 30.0)[1][:40]
    one, _ = found((np.vstack([planted(200, 30.0)[0][:40], first[40:]]), np.vstack([raised, second[40:]])))
    _, fits = consensus(one, 1.0, 15.0, np.random.default_rng(0))
    assert fits.all()  # 30 m is two sigmas of the height
    moved = second.copy()
    moved[:40, 0] += 1.0  # the second looks aside: lines are across
    scene = matched.scene()
    after, before = (match_offsets(*scene.pictures, (first, to), scene.ground) for to in (moved, second))
    assert np.all(np.abs((after - before)[:40, 0]) > 2.0)
    one, _ = found((first, moved))
    _, fits = consensus(one, 0.5, 15.0, np.random.default_rng(0))
    assert not fits[:40].any()
    assert fits[40:].all()


def measures(places: tuple[np.ndarray, np.ndarray], returns: np.ndarray | None = None) -> Measured:
    """Measures at places, all alike and sharp."""
    n = len(places[0])
    zeros, whole = np.zeros(n, dtype=np.int64), np.arange(n)
    matrices = np.broadcast_to(np.eye(2), (n, 2, 2))
    back = np.ones(n, dtype=bool) if returns is None else returns
    return Measured(whole, zeros, zeros + 1, whole, *places, matrices, 1e-3 * matrices, np.full(n, 0.9), zeros, back)


def test_measures_that_do_not_meet_or_stand_out_are_told() -> None:
    """Lines of the second are across its looks, samples along: the one is a blunder, the other a height."""
    first, second = planted(200)
    second = second + 0.05 * np.random.default_rng(1).standard_normal(second.shape)
    second[:10, 0] += 3.0
    second[10:20, 1] += 10.0
    found = checked_measures(matched.scene(), measures((first, second)), 4.0, 0)
    assert np.flatnonzero(~found.coplanar).tolist() == list(range(10))
    assert np.flatnonzero(found.coplanar & ~found.steady).tolist() == list(range(10, 20))
    assert np.all(np.abs(found.misfit[:10]) > 8.0)
    assert np.quantile(np.abs(found.misfit[10:]), 0.95) < 1.2


def test_what_does_not_come_back_is_not_kept() -> None:
    scene, places = matched.scene(), planted(100)
    returns = np.arange(100) >= 30
    cells = ground_cells(scene, pairs_of(scene), 10)
    settings = replace(matched.SETTINGS, per_cell=100)
    kept, losses, misfit = checked_matches(scene, measures(places, returns), np.ones(100), settings, 4.0, cells, 123)
    assert set(kept.track.tolist()) == set(range(30, 100))
    assert losses == (123, 100, 100, 100, 70, 70, 70, 70)
    assert misfit.shape == (70,)


def test_corrections_add() -> None:
    picture = matched.scene().pictures[0]
    long = np.arange(18.0).reshape(3, 6) * 1e-6
    for before, step in ((long, long[:1]), (long[:1], long)):
        total = increased(OrientationCorrection(before), step).coefficients
        np.testing.assert_allclose(total[:1], before[:1] + step[:1])
        np.testing.assert_allclose(total[1:], long[1:])
    np.testing.assert_array_equal(increased(picture.correction, long).coefficients, long)


def test_sigmas_between_are_those_of_both() -> None:
    first, second = matched.scene().pictures
    both = sigmas_between(first, second, 2)
    np.testing.assert_allclose(both, np.hypot(first.prior.sigmas, second.prior.sigmas))
    assert sigmas_between(first, second, 3).shape == (4, 6)


def test_pictures_join_by_their_largest_overlap() -> None:
    pairs = [Pair(0, 1, 5.0), Pair(1, 2, 9.0), Pair(0, 2, 1.0), Pair(3, 4, 2.0)]
    for given in (pairs, pairs[::-1]):
        assert first_picture(given, range(6)) == 1
        assert next_pair(given, {1}, {0, 2, 3, 4, 5}, set()) == Pair(1, 2, 9.0)
        assert next_pair(given, {1, 2}, {0, 3, 4, 5}, set()) == Pair(1, 0, 5.0)
        assert next_pair(given, {1, 2}, {0, 3, 4, 5}, {Pair(1, 0, 5.0)}) == Pair(2, 0, 1.0)  # another way
        assert next_pair(given, {0, 1, 2}, {3, 4, 5}, set()) is None
        assert first_picture(given, {3, 4, 5}) == 3
        assert next_pair(given, {4}, {3, 5}, set()) == Pair(4, 3, 2.0)
