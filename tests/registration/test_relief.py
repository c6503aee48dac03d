"""Search of a laser profile on the surface that two images show: synthetic relief, no pixels."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from networks import pair

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.stereo_surface import averaged_surface
from mgsgraph.registration.search import CostSurface, StereoPair, minima, search, together

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
    points = _ground(ground, lines, np.linspace(0.35, 0.65, SHOTS) * first.samples)
    noise = np.random.default_rng(seed).normal(0.0, sigma, SHOTS)
    points = points * (1.0 + noise / np.linalg.norm(points, axis=1))[:, None]
    return points - np.einsum("k,nkj->nj", shift, east_north(points))


def found(ground: Ground, footprints: Array, reach: float = 1700.0, sigma: float = SIGMA) -> CostSurface:
    return search(stereo(ground), footprints, np.full(len(footprints), sigma), "profile", reach)


@pytest.mark.parametrize("degrees", range(20, 380, 90))
def test_a_shift_is_found_from_1500_m_off_in_any_direction(degrees: int) -> None:
    shift = 1500.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    cost = found(hills, track(hills, shift, seed=degrees))
    assert cost.clear
    best = cost.minima[0]
    off = best.shift - shift
    assert np.linalg.norm(off) < 25.0
    assert off @ np.linalg.solve(best.covariance, off) < 13.8  # 99.9 % of chi-square with two degrees of freedom


def test_a_plain_does_not_tie_a_profile() -> None:
    """2 m of relief under shots of 10 m, what cases state of MOLA's: never a confident wrong place."""
    for seed in range(5):
        cost = found(plain, track(plain, np.zeros(2), seed, 10.0), 800.0, 10.0)
        assert not cost.tied
        assert not cost.clear


def test_nor_does_it_where_shifts_leave_the_surface() -> None:
    """Up to 1500 m, the half width of the surface."""
    assert not any(found(plain, track(plain, np.zeros(2), seed, 10.0), 1500.0, 10.0).tied for seed in range(5))


def test_a_level_and_a_slope_along_the_track_are_the_orientation_s() -> None:
    shift = np.array([300.0, -420.0])
    footprints = track(hills, shift)
    raised = footprints * (1.0 + (40.0 + np.linspace(-25.0, 25.0, SHOTS)) / np.linalg.norm(footprints[0]))[:, None]
    one, other = (found(hills, points, 800.0).minima[0] for points in (footprints, raised))
    assert np.linalg.norm(one.shift - shift) < 15.0
    assert np.linalg.norm(one.shift - other.shift) < 3.0
    assert other.misfit == pytest.approx(one.misfit, rel=0.1)


def test_profiles_beside_the_images_have_no_minimum() -> None:
    """20 km, and half of Mars, away."""
    footprints = track(hills, np.zeros(2))
    for away in (footprints + 20e3 * _frame()[1][0], -footprints):
        cost = found(hills, away, 400.0)
        assert not cost.minima
        assert not cost.tied
        assert cost.shots == 0


def test_two_profiles_together_have_the_sum_of_their_misfits() -> None:
    shift = np.array([-250.0, 130.0])
    each = [found(hills, track(hills, shift, seed), 600.0) for seed in (1, 2)]
    both = together("both", each)
    assert both.shots == each[0].shots + each[1].shots
    assert np.linalg.norm(both.minima[0].shift - shift) < 12.0
    assert np.all(np.diag(both.minima[0].covariance) < np.diag(each[0].minima[0].covariance))


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


def test_weights_are_probabilities_of_the_minima() -> None:
    """exp(-chi^2 / 2) times the root of the covariance's determinant."""
    shifts, misfits = bowls((56.0, 60.0), (30.0, 30.0))
    first, second = minima(shifts, misfits, shots=60)
    assert first.shift == pytest.approx([-200.0, 0.0], abs=1e-6)
    assert second.shift == pytest.approx([200.0, 0.0], abs=1e-6)
    assert first.weight + second.weight == pytest.approx(1.0)
    assert second.weight / first.weight == pytest.approx(np.exp(-2.0))
    assert first.covariance == pytest.approx(np.eye(2) * 30.0**2, rel=1e-6, abs=1e-6)

    narrow, wide = minima(*bowls((56.0, 56.001), (30.0, 60.0)), shots=60)
    assert wide.weight / narrow.weight == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_weights_and_covariances_count_in_units_of_the_best_misfit_per_shot(scale: float) -> None:
    shifts, misfits = bowls((60.0 * scale, 66.0 * scale), (30.0, 30.0))
    first, second = minima(shifts, misfits, shots=64)
    assert second.weight / first.weight == pytest.approx(np.exp(-3.0))
    assert first.covariance == pytest.approx(scale * np.eye(2) * 30.0**2, rel=1e-6, abs=1e-6)


def test_shifts_that_say_nothing_are_no_minima() -> None:
    shifts, misfits = bowls((40.0, 44.0), (30.0, 30.0))
    misfits[shifts > 0.0] = np.nan
    assert len(minima(shifts, misfits, shots=60)) == 1
    assert minima(shifts, np.full_like(misfits, np.nan), shots=0) == ()
