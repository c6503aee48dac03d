"""Search of a laser profile on the surface that two images show: synthetic relief, no pixels."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import pair
from outside import refuses

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.stereo_surface import averaged_surface
from mgsgraph.registration.minima import CostSurface, Minimum, ReliefSettings, local_minima, merged, weighted
from mgsgraph.registration.search import Expected, StereoPair, search

NOISE = 0.05
"""pixels, of a dense match."""
WIDTH = 84.0
"""m, standard deviation of the footprint: shifts every 42 m."""
SIGMA = 3.0
"""m, of a shot's height."""
SHOTS = 60


def hills(points: Array) -> Array:
    """(n,) m, height of 150 hills and hollows, 200 to 700 m wide, about the middle of the first image."""
    rng = np.random.default_rng(11)
    middle, ways = _frame()
    plane = (points - middle) @ ways.T
    height = np.zeros(len(points))
    for _ in range(150):
        at, width, size = rng.uniform([-4e3, -13e3], [4e3, 13e3]), rng.uniform(200.0, 700.0), rng.normal(0.0, 50.0)
        height += size * np.exp(-0.5 * np.sum((plane - at) ** 2, axis=1) / width**2)
    return height


def plain(points: Array) -> Array:
    """The same with 2 m rms of relief, from 30."""
    return hills(points) / 15.0


Ground = Callable[[Array], Array]


@cache
def _frame() -> tuple[Array, Array]:
    """(3,) m, ground in the middle of the first image, and (2, 3) east and north there."""
    first = pair().images[0]
    middle, _ = first.image_to_ground(np.array([0.5 * first.lines]), np.array([0.5 * first.samples]))
    return middle[0], east_north(middle)[0]


def _ground(ground: Ground, lines: Array, samples: Array) -> Array:
    """(n, 3) m, what the first image shows at some pixels."""
    made, height = pair(), np.zeros(lines.size)
    for _ in range(6):  # the image looks down: heights hardly move a point
        points, _ = made.images[0].image_to_ground(lines, samples, height, made.true_corrections[0])
        height = ground(points)
    return points


@cache
def stereo(ground: Ground) -> StereoPair:
    """The surface that the pair shows of it, by matches every 24 pixels."""
    made = pair()
    first, second = made.images
    grid = np.meshgrid(np.arange(6.5, first.lines, 24.0), np.arange(6.5, first.samples, 24.0), indexing="ij")
    anchors = np.stack([part.ravel() for part in grid], axis=1)
    points = _ground(ground, *anchors.T)
    pixels, _ = second.ground_to_image(points, made.true_corrections[1])
    seen = np.all((pixels > 0.0) & (pixels < [second.lines, second.samples]), axis=1)
    pixels = pixels[seen] + np.random.default_rng(5).normal(0.0, NOISE, (int(seen.sum()), 2))
    pixel = np.array([22020.0 / first.lines, 3.0])
    variances = np.full(len(pixels), NOISE**2)
    surface = averaged_surface(anchors[seen], pixels, variances, pixel, WIDTH, 24.0 * 3.0)
    return StereoPair(surface, made.images, made.true_corrections)


def track(ground: Ground, shift: Array, seed: int = 1, sigma: float = SIGMA) -> Array:
    """(n, 3) m, footprints along the first image, their heights with noise, which lie on the ground after a shift (2,)
    in m.
    """
    first = pair().images[0]
    lines = np.linspace(0.1, 0.9, SHOTS) * first.lines
    return misplaced(_ground(ground, lines, np.linspace(0.35, 0.65, SHOTS) * first.samples), shift, seed, sigma)


def misplaced(points: Array, shift: Array, seed: int, sigma: float) -> Array:
    """Ground points (n, 3) with noise in their heights, which lie there after a shift (2,)."""
    noise = np.random.default_rng(seed).normal(0.0, sigma, len(points))
    points = points * (1.0 + noise / np.linalg.norm(points, axis=1))[:, None]
    return points - np.einsum("k,nkj->nj", shift, east_north(points))


def found(ground: Ground, footprints: Array, reach: float = 1700.0, sigma: float = SIGMA) -> CostSurface:
    return search(stereo(ground), footprints, np.full(len(footprints), sigma), "profile", reach)


# above two seconds: a search over 3 km by 3 km
@pytest.mark.parametrize("degrees", range(20, 380, 120))
def test_a_shift_is_found_from_1500_m_off_in_any_direction(degrees: int) -> None:
    shift = 1500.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    cost = found(hills, track(hills, shift, seed=degrees))
    assert cost.clear
    best = cost.minima[0]
    off = best.shift - shift
    assert np.linalg.norm(off) < 30.0
    assert off @ np.linalg.solve(best.covariance, off) < 13.8  # 99.9 % of chi-square with two degrees of freedom


def test_shifts_are_searched_20_km_at_most() -> None:
    refuses("reach", ReliefSettings, reach=1e6)


def test_a_minimum_that_adjustments_do_not_reach_is_not_clear() -> None:
    cost = found(hills, track(hills, np.zeros(2)), 400.0)
    assert cost.clear
    never = replace(cost, reached=False)
    assert never.tied
    assert not never.clear


def test_a_plain_does_not_tie_a_profile() -> None:
    """2 m of relief under shots of 10 m, what cases state of MOLA's: never a confident wrong place; nor where shifts
    leave the surface, whose half width is 1500 m.
    """
    for seed, reach in ((0, 800.0), (1, 800.0), (2, 1500.0)):
        cost = found(plain, track(plain, np.zeros(2), seed, 10.0), reach, 10.0)
        assert not cost.tied
        assert not cost.clear


@pytest.mark.parametrize("seed", range(3))
def test_a_plain_under_exact_shots_has_no_confident_wrong_place(seed: int) -> None:
    """2 m of relief under shots of 3 m."""
    cost = found(plain, track(plain, np.zeros(2), seed), 1500.0)
    best = cost.minima[0]
    assert not cost.clear or best.shift @ np.linalg.solve(best.covariance, best.shift) < 13.8


def test_a_shift_that_changes_along_the_track_is_found() -> None:
    """As where the yaw of an image is wrong: by 60 m from the middle to the end."""
    shift, change = np.array([-300.0, 200.0]), np.array([60.0, -40.0])
    footprints = track(hills, shift)
    along = np.linspace(-1.0, 1.0, SHOTS)[:, None]
    bent = footprints - np.einsum("nk,nkj->nj", along * change, east_north(footprints))
    cost = found(hills, bent, 800.0)
    assert cost.clear
    assert np.abs(cost.best(SHOTS) - shift - along * change).max() < 40.0
    assert np.linalg.norm(cost.minima[0].change - change) < 30.0


def test_a_level_and_a_slope_along_the_track_are_the_orientation_s() -> None:
    shift = np.array([300.0, -420.0])
    footprints = track(hills, shift)
    raised = footprints * (1.0 + (40.0 + np.linspace(-25.0, 25.0, SHOTS)) / np.linalg.norm(footprints[0]))[:, None]
    one, other = (found(hills, points, 800.0).minima[0] for points in (footprints, raised))
    assert np.linalg.norm(one.shift - shift) < 15.0
    assert np.linalg.norm(one.shift - other.shift) < 3.0
    assert other.misfit == pytest.approx(one.misfit, rel=0.1)


def posts(ground: Ground, shift: Array, seed: int, sigma: float) -> Array:
    """(n, 3) m, posts every 460 m over the first image, as `track` has its footprints."""
    first = pair().images[0]
    made = np.meshgrid(np.linspace(0.05, 0.95, 44) * first.lines, np.linspace(0.05, 0.95, 6) * first.samples)
    return misplaced(_ground(ground, made[0].ravel(), made[1].ravel()), shift, seed, sigma)


def low_hills(points: Array) -> Array:
    """The same with 3 m rms of relief."""
    return hills(points) / 10.0


@pytest.mark.parametrize("seed", range(5, 8))
def test_minima_with_few_posts_on_the_surface_are_no_better(seed: int) -> None:
    """Far from where a model fits, a third of its posts are beside the images."""
    shift = np.random.default_rng(seed).normal(0.0, 200.0, 2)
    points = posts(low_hills, shift, seed, 10.0)
    cost = search(stereo(low_hills), points, np.full(len(points), 10.0), "model", 1500.0, Expected(np.zeros(2), 400.0))
    best = cost.minima[0]
    off = best.shift - shift
    assert off @ np.linalg.solve(best.covariance, off) < 13.8
    assert np.abs(best.change).max() < 1e-6
    assert sum(one.weight for one in cost.minima) == pytest.approx(1.0)


def test_what_is_known_of_a_model_decides_between_minima() -> None:
    """Of two minima that fit alike, by the chi-square of what is known."""
    shifts, misfits = bowls((56.0, 56.0), (30.0, 30.0))
    found = local_minima(shifts, misfits)
    known = Expected(np.array([-200.0, 0.0]), 100.0).misfits(np.array([one.shift for one in found]))
    first, second = weighted(found, np.full(2, 56.0), np.full(2, 56.0), np.full(2, 60), np.zeros(2), 1.0, known)
    assert first.shift == pytest.approx([-200.0, 0.0], abs=1e-6)
    assert second.weight / first.weight == pytest.approx(np.exp(-8.0))


def test_profiles_beside_the_images_have_no_minimum() -> None:
    """20 km, and half of Mars, away."""
    footprints = track(hills, np.zeros(2))
    for away in (footprints + 20e3 * _frame()[1][0], -footprints):
        cost = found(hills, away, 400.0)
        assert not cost.minima
        assert not cost.tied
        assert cost.shots == 0


# --- minima of a surface that is given


def bowls(depths: tuple[float, ...], widths: tuple[float, ...]) -> tuple[Array, Array]:
    """Shifts (k,) and a misfit (k, k) with paraboloids about (-200, 0), (200, 0), ... m, of some widths in m."""
    shifts = np.arange(-500.0, 501.0, 20.0)
    east, north = np.meshgrid(shifts, shifts, indexing="ij")
    each = [
        depth + ((east - (400.0 * k - 200.0)) / width) ** 2 + (north / width) ** 2
        for k, (depth, width) in enumerate(zip(depths, widths, strict=True))
    ]
    return shifts, np.min(each, axis=0)


PRIOR = 10.0
"""Shots as stated, which the scale's prior counts as."""


def alone(misfits: Array, shifts: Array, shots: int, alike: float = 1.0) -> tuple[Minimum, ...]:
    """Minima of a misfit, all of them over the same shots."""
    bowls = local_minima(shifts, misfits)
    lowest = np.full(len(bowls), bowls[0].misfit)
    each = np.array([one.misfit for one in bowls])
    nothing = np.zeros(len(bowls))
    return weighted(bowls, each, lowest, np.full(len(bowls), shots), nothing, alike, nothing)


@pytest.mark.parametrize("scale", [0.25, 1.0, 4.0])
def test_weights_are_probabilities_of_the_minima(scale: float) -> None:
    """(chi^2_1 / chi^2_2)^(freedom / 2) times the root of the covariance's determinant, by unknown scale."""
    shifts, misfits = bowls((56.0 * scale, 60.0 * scale), (30.0, 30.0))
    first, second = alone(misfits, shifts, 60)
    assert first.shift == pytest.approx([-200.0, 0.0], abs=1e-6)
    assert second.shift == pytest.approx([200.0, 0.0], abs=1e-6)
    assert first.weight + second.weight == pytest.approx(1.0)
    ratio = (56.0 * scale + PRIOR) / (60.0 * scale + PRIOR)
    assert second.weight / first.weight == pytest.approx(ratio ** ((56.0 + PRIOR) / 2.0))
    found = (56.0 * scale + PRIOR) / (56.0 + PRIOR)
    assert first.covariance == pytest.approx(found * np.eye(2) * 30.0**2, rel=1e-6, abs=1e-6)

    shifts, misfits = bowls((56.0, 56.001), (30.0, 60.0))
    wide, narrow = alone(misfits, shifts, 60)
    assert wide.weight / narrow.weight == pytest.approx(4.0, rel=1e-3)


def test_a_place_of_several_minima_is_as_wide_as_they_are() -> None:
    """Of two equally good ones 60 m apart the mean square about the first; one that ended at the same place counts
    once; what fits much worse hardly counts, and what is a place of its own not at all.
    """
    shifts = np.array([[0.0, 0.0], [60.0, 0.0], [60.5, 0.0], [0.0, 90.0], [500.0, 0.0]])
    covariances = np.tile(np.diag([4.0, 9.0]), (5, 1, 1))
    misfits, owner = np.array([100.0, 100.0, 100.0, 200.0, 300.0]), np.array([0, 0, 0, 0, 4])
    found = merged(shifts, covariances, misfits, owner, 2.0)
    np.testing.assert_allclose(found[0], np.diag([4.0 + 0.5 * 60.0**2 / 2.0, 9.0]), rtol=1e-6)
    np.testing.assert_array_equal(found[4], covariances[4])


def test_weights_of_shots_that_count_as_one() -> None:
    shifts, misfits = bowls((56.0, 60.0), (30.0, 30.0))
    (first, second), (one, other) = (alone(misfits, shifts, 60, alike) for alike in (1.0, 3.0))
    assert other.weight / one.weight == pytest.approx((second.weight / first.weight) ** (1.0 / 3.0))
    assert one.covariance == pytest.approx(3.0 * first.covariance)


def test_rough_ground_is_no_better_fit() -> None:
    """Twice the variance of each shot, and so half the misfit, is the same likelihood but for the scale's prior."""
    shifts, misfits = bowls((56.0, 56.0), (30.0, 30.0))
    found = local_minima(shifts, misfits)
    doubled = np.array([0.0, 60.0 * np.log(2.0)])
    by_shift = {
        float(one.shift[0]): one.weight
        for one in weighted(found, np.array([56.0, 28.0]), np.full(2, 56.0), np.full(2, 60), doubled, 1.0, np.zeros(2))
    }
    rough, smooth = (by_shift[float(one.shift[0])] for one in reversed(found))
    assert rough / smooth == pytest.approx(2.0**-30 * ((56.0 + PRIOR) / (28.0 + PRIOR)) ** 33, rel=1e-6)


def test_shifts_that_say_nothing_are_no_minima() -> None:
    shifts, misfits = bowls((40.0, 44.0), (30.0, 30.0))
    misfits[shifts > 0.0] = np.nan
    assert len(local_minima(shifts, misfits)) == 1
    assert not local_minima(shifts, np.full_like(misfits, np.nan))
