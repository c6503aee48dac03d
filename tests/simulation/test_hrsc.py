"""Simulated HRSC blocks: published geometry, exact rays, statistics against stated sigmas, jitter; true orientation of
passes against what the prior's own rows state; lines against the kernel that they are taken from.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from block_ground import TerrainErrors
from mex import FOLDER
from mex_block import BlockSettings, SimulatedBlock, TrajectoryErrors, simulate_hrsc_block
from mex_flight import (
    HRSC_LINES,
    HRSC_PIXELS,
    STEREO,
    Jitter,
    PointMatching,
    Readout,
    correction_at,
    drawn_nodes,
    hrsc_interior,
    true_correction,
)
from outside import refuses, require
from redraw import assert_unit_variance

from mgsgraph.geometry.body import east_north, planetocentric
from mgsgraph.geometry.orientation import OrientationCorrection, evenly_spaced
from mgsgraph.network import Network, NodePrior
from mgsgraph.network.passes import LinearFactor, normalised
from mgsgraph.simulation.observations import MARGIN
from mgsgraph.units import DEG, MGON, MM

SMALL = BlockSettings(passes=3, crossing=1, length=300e3, points=1500)

TINY = BlockSettings(passes=1, length=100e3, points=20, terrain=None)

EXACT = PointMatching(sigma=1e-9)


@pytest.fixture(scope="module")
def block() -> SimulatedBlock:
    return simulate_hrsc_block(SMALL)


@pytest.fixture(scope="module")
def seeds() -> list[SimulatedBlock]:
    settings = replace(TINY, points=1, terrain=TerrainErrors(posts_per_degree=4))
    return [simulate_hrsc_block(settings, seed) for seed in range(16)]


def exact_places(network: Network, truth: np.ndarray, corrections: tuple[OrientationCorrection, ...]) -> np.ndarray:
    """(k, 2) where the rays' true points stand."""
    places = np.empty_like(network.rays.places)
    for j, image in enumerate(network.images):
        mine = network.rays.image == j
        places[mine], _ = image.ground_to_image(truth[network.rays.point[mine]], corrections[j])
    return places


def heights(network: Network, places: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(n,) m above the terrain model, the truth lying `shift` (2,) east and north of it; NaN beside posts."""
    assert network.surface is not None
    above, _ = network.surface.grid.height_above(places - shift @ east_north(places))
    return above


# --- flight


@pytest.mark.parametrize(("line", "angle"), [("S1", 18.93), ("P1", 12.75), ("ND", 0.0), ("P2", -12.75), ("S2", -18.94)])
def test_lines_look_ahead_and_back_over_the_ground(block: SimulatedBlock, line: str, angle: float) -> None:
    """At the spacecraft, between its nadir and the ground seen by the middle of the line, along its ground track."""
    for pass_ in block.network.passes:
        image = block.network.images[pass_.images[STEREO.index(line)]]
        middle = np.array([0.5 * image.lines])
        ground, _ = image.image_to_ground(middle, np.array([0.5 * image.samples]))
        pose = image.pose(middle)
        up = pose.position[0] / np.linalg.norm(pose.position)
        forward = pose.velocity[0] - (pose.velocity[0] @ up) * up
        observation = ground[0] - pose.position[0]
        found = np.arctan2(observation @ forward / np.linalg.norm(forward), -observation @ up) / DEG
        assert found == pytest.approx(angle, abs=0.02)
        across = np.cross(up, forward / np.linalg.norm(forward))
        assert abs(np.arcsin(observation @ across / np.linalg.norm(observation))) < 0.05 * DEG


def test_lines_of_a_strip_share_one_trajectory_and_the_swath(block: SimulatedBlock) -> None:
    for pass_ in block.network.passes:
        images = [block.network.images[j] for j in pass_.images]
        assert [image.name.split("/")[-1] for image in images] == list(STEREO)
        assert all(image.trajectory is images[0].trajectory for image in images)
        nadir = images[STEREO.index("ND")]
        lines, samples = np.meshgrid([40.0, 0.5 * nadir.lines, nadir.lines - 40.0], [700.0, 2600.0, 4500.0])
        ground, _ = nadir.image_to_ground(lines.ravel(), samples.ravel(), -1500.0)
        for image in images:
            places, _ = image.ground_to_image(ground)
            assert np.all((places > 0.0) & (places < [image.lines, image.samples]))


def test_line_rates_change_within_every_image_without_a_break(block: SimulatedBlock) -> None:
    for image in block.network.images:
        timing = image.timing
        assert timing.periods.size == 2
        assert timing.periods[0] != timing.periods[1]
        ends = timing.start_times[:-1] + np.diff(timing.first_lines) * timing.periods[:-1]
        np.testing.assert_allclose(ends, timing.start_times[1:], rtol=0, atol=1e-12)
    changes = np.array([image.timing.start_times[1] for image in block.network.images[:5]])
    assert np.ptp(changes) < 0.02  # as far as whole lines allow


def test_pixels_and_heights_are_the_survey_s() -> None:
    """12.5 m along track at 265 km and in proportion to the altitude; 25 m at 500 km are the paper's rounding."""
    readout = Readout(macropixels=(1, 1, 1, 1, 1))
    settings = replace(TINY, passes=2, altitudes=(265e3, 500e3), eccentricity=0.0, readout=readout)
    for number, altitude in zip((0, 1), (265e3, 500e3), strict=True):
        image = simulate_hrsc_block(settings).network.images[5 * number + STEREO.index("ND")]
        middle = 0.5 * image.lines + np.array([-0.5, 0.5])
        ground, _ = image.image_to_ground(middle, np.full(2, 2592.0))
        assert np.linalg.norm(np.diff(ground, axis=0)) == pytest.approx(12.5 * altitude / 265e3, rel=0.01)
        across, _ = image.image_to_ground(np.full(2, middle[0]), np.array([2591.5, 2592.5]))
        assert np.linalg.norm(np.diff(across, axis=0)) == pytest.approx(4e-5 * altitude, rel=0.02)


def test_line_rates_follow_height_and_speed_from_part_to_part() -> None:
    """In the middle of each part lines are 12.5 m apart per 265 km of altitude there, which grows by a third."""
    readout = Readout(macropixels=(1, 1, 1, 1, 1), rates=5)
    made = simulate_hrsc_block(replace(TINY, length=2000e3, pericentre=0.2, readout=readout))
    image = made.network.images[STEREO.index("ND")]
    edges = np.append(image.timing.first_lines, image.lines)
    middle = 0.5 * (edges[1:] + edges[:-1])
    before, after = (image.image_to_ground(middle + off, np.full(5, 2592.0))[0] for off in (-0.5, 0.5))
    altitude = np.linalg.norm(image.pose(middle).position, axis=1) - np.linalg.norm(before, axis=1)
    np.testing.assert_allclose(np.linalg.norm(after - before, axis=1), 12.5 * altitude / 265e3, rtol=0.01)
    assert altitude.max() > 1.3 * altitude.min()


def test_orbits_climb_from_their_pericentre_as_kepler_has_it() -> None:
    """r = q (1 + e) / (1 + e cos nu), nu the angle between position and pericentre."""
    made = simulate_hrsc_block(replace(TINY, length=2800e3, altitudes=(300e3, 300e3)))
    image = made.network.images[STEREO.index("ND")]
    times, _ = image.timing.at(np.linspace(0.0, image.lines, 40))
    place, _ = image.trajectory.position.at(times)  # type: ignore[attr-defined]
    lowest, _ = image.trajectory.position.at(np.zeros(1))  # type: ignore[attr-defined]
    radius, least = np.linalg.norm(place, axis=1), np.linalg.norm(lowest)
    cosine = place @ lowest[0] / (radius * least)
    np.testing.assert_allclose(radius, least * 1.6 / (1.0 + 0.6 * cosine), rtol=0, atol=0.01)
    assert times[0] / times[-1] == pytest.approx(-0.4 / 0.6, rel=0.06)  # it is faster about the pericentre
    assert 300e3 < np.ptp(radius) + 300e3 < 500e3


# --- points and rays


def test_neighbours_overlap_by_the_stated_share() -> None:
    settings = replace(TINY, passes=2, altitudes=(265e3, 265e3), eccentricity=0.0, overlap=0.4, pericentre=0.5)
    first, second = (simulate_hrsc_block(settings).network.images[j] for j in (2, 7))
    edge, _ = first.image_to_ground(np.full(1, 0.5 * first.lines), np.full(1, float(HRSC_PIXELS)))
    place, _ = second.ground_to_image(edge)
    assert place[0, 1] / HRSC_PIXELS == pytest.approx(0.4, abs=0.02)


def test_strips_share_points_and_those_that_cross_fly_the_other_way(block: SimulatedBlock) -> None:
    network = block.network
    seen = np.zeros((len(network.points), 3), dtype=int)
    np.add.at(seen, (network.rays.point, network.pass_of[network.rays.image]), 1)
    assert set(np.unique(seen)) == {0, 3, 4, 5}
    assert np.all(seen.max(axis=1) >= 3)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.count_nonzero((seen[:, a] > 0) & (seen[:, b] > 0)) > 20
    north = [np.sign(network.images[5 * k].pose(np.array([100.0])).velocity[0, 2]) for k in range(3)]
    assert north == [1.0, 1.0, -1.0]


def test_points_are_matched_in_as_many_lines_as_stated() -> None:
    made = simulate_hrsc_block(replace(TINY, points=2000, matches=PointMatching(shares=(0.2, 0.3, 0.5))))
    counts = np.bincount(made.network.ray_counts, minlength=6)[3:] / 2000
    np.testing.assert_allclose(counts, [0.2, 0.3, 0.5], atol=0.06)  # fewer see the points at the swath's edges


@pytest.mark.parametrize("jitter", [None, Jitter(5 * MGON, 0.4, "yaw")])
def test_true_rays_meet_their_true_points(jitter: Jitter | None) -> None:
    """By the corrected sightlines, which know nothing of the way by which points were projected."""
    settings = replace(SMALL, points=300, true_spacing=2.5, jitter=jitter, matches=EXACT)
    made = simulate_hrsc_block(settings)
    network = made.network
    for j, image in enumerate(network.images):
        mine = network.rays.image == j
        lines, samples = network.rays.places[mine].T
        origins, directions = image.sightlines(lines, samples, made.corrections[j])
        offset = made.true_points[network.rays.point[mine]] - origins
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        distance = np.linalg.norm(offset, axis=1)
        miss = np.linalg.norm(np.cross(offset, unit), axis=1) / (distance * image.pixel_angle)
        assert miss.max() < 1e-6
    error = network.rays.places - exact_places(network, made.true_points, made.corrections)
    assert np.abs(error).max() < 1e-6


def test_measures_have_the_stated_noise_and_lie_on_their_images(block: SimulatedBlock) -> None:
    rays = block.network.rays
    error = rays.places - exact_places(block.network, block.true_points, block.corrections)
    assert_unit_variance(error / rays.sigmas)
    size = np.array([(image.lines, image.samples) for image in block.network.images])[rays.image]
    assert np.all((rays.places > 0.9 * MARGIN) & (rays.places < size - 0.9 * MARGIN))
    order = np.lexsort([rays.image, rays.point])
    assert np.array_equal(order, np.arange(order.size))
    assert np.unique(rays.point * 100 + rays.image).size == order.size


def test_blunders_are_those_marked() -> None:
    made = simulate_hrsc_block(replace(SMALL, matches=PointMatching(blunders=0.05)))
    error = made.network.rays.places - exact_places(made.network, made.true_points, made.corrections)
    size = np.linalg.norm(error, axis=1)
    assert np.mean(made.blunders) == pytest.approx(0.05, abs=0.012)
    assert np.all((size > 2.5) == made.blunders)
    assert size.max() < 103.0


def test_true_points_lie_on_the_ground(block: SimulatedBlock) -> None:
    longitude, latitude, radius = planetocentric(block.true_points).T
    np.testing.assert_allclose(radius, block.relief.ground_radius(longitude, latitude), rtol=0, atol=1e-6)
    assert np.ptp(block.relief.height(longitude, latitude)) > 500.0


# --- terrain model


def test_the_terrain_model_is_off_by_its_shift_and_its_noise(block: SimulatedBlock) -> None:
    """10 m rms in height where the shift is undone, its sign as adjustments have it, and worse where it is not."""
    shift = block.shifts[0]
    assert 20.0 < np.linalg.norm(shift) < 700.0
    off = heights(block.network, block.true_points, shift)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(10.0, rel=0.1)
    assert abs(np.mean(off)) < 2.0
    for wrong in (0.0 * shift, -shift):
        assert np.sqrt(np.mean(heights(block.network, block.true_points, wrong) ** 2)) > 11.0
    assert block.network.surface is not None
    grid = block.network.surface.grid
    assert grid.longitude_step == grid.latitude_step == pytest.approx(DEG / 64)
    independent = block.network.independent.surface
    assert independent is not None
    sigmas = independent.sigmas
    assert np.median(sigmas) == 10.0 < sigmas.max(), "points that share posts have larger ones"
    assert block.network.surface.shift_sigma == 200.0


def test_shifts_have_the_stated_sigma(seeds: list[SimulatedBlock]) -> None:
    assert_unit_variance(np.array([made.shifts[0] for made in seeds]) / 200.0)


def test_points_beside_missing_posts_have_no_surface_row() -> None:
    made = simulate_hrsc_block(replace(SMALL, terrain=TerrainErrors(missing=0.05, planimetric=0.0)))
    surface = made.network.surface
    assert surface is not None
    assert np.array_equal(np.isinf(surface.sigmas), np.isnan(surface.grid.at(made.true_points)))
    assert np.mean(np.isinf(surface.sigmas)) == pytest.approx(1.0 - 0.95**4, abs=0.05)
    assert made.shifts.shape == (0, 2)
    assert not made.network.terrain_moves


# --- orientation


def test_attitude_is_known_to_28_milligon_over_seeds(seeds: list[SimulatedBlock]) -> None:
    """As the paper has it, about all three axes, in the middle of the passes; along X, Y, Z positions to 50 m."""
    found = []
    for made in seeds:
        nodes = made.network.passes[0].nodes
        found.append(correction_at(made.corrections[0], np.array([np.mean(nodes.coverage)]), nodes.epoch)[0])
    assert_unit_variance(np.array(found)[:, 3:] / (np.hypot(28.0, 3.0) * MGON))
    assert_unit_variance(np.array(found)[:, :3] / np.hypot(50.0, 1.0))


def test_jitter_is_a_sine_about_one_axis_that_no_prior_knows() -> None:
    jitter = Jitter(4.0 * MGON, 0.7, "roll")
    smooth, shaken = (simulate_hrsc_block(replace(TINY, jitter=one), 3) for one in (None, jitter))
    pass_ = smooth.network.passes[0]
    times = np.linspace(*pass_.nodes.coverage, 4001)
    before, after = (correction_at(made.corrections[0], times, pass_.nodes.epoch) for made in (smooth, shaken))
    added = after - before
    wave = 2.0 * np.pi * 0.7 * times
    basis = np.column_stack([np.sin(wave), np.cos(wave)])
    fitted, *_ = np.linalg.lstsq(basis, added[:, 4])
    assert np.linalg.norm(fitted) == pytest.approx(jitter.amplitude, rel=3e-3)
    assert np.abs(added[:, 4] - basis @ fitted).max() < 0.01 * jitter.amplitude
    assert np.abs(added[:, [3, 5]]).max() < 2e-3 * jitter.amplitude  # what the finer nodes smooth of the draws' kinks
    assert np.abs(added[:, :3]).max() < 1e-2
    prior = shaken.network.passes[0].prior
    assert isinstance(prior, NodePrior)
    assert np.array_equal(prior.sigmas, SMALL.errors.prior.sigmas)
    refuses("other nodes", shaken.true_nodes, 0)


# --- true orientation of passes


def information(prior: NodePrior, count: int, factors: list[LinearFactor]) -> np.ndarray:
    """(6 k, 6 k) of the nodes, the trend eliminated."""
    widths = [6] * count + [prior.trend_sigmas.size]
    edges = np.concatenate([[0], np.cumsum(widths)])
    whole = np.zeros((edges[-1], edges[-1]))
    for factor in factors:
        rows = np.zeros((factor.blocks[0].shape[0], edges[-1]))
        for unknown, part in zip(factor.unknowns, factor.blocks, strict=True):
            rows[:, edges[unknown] : edges[unknown + 1]] = part
        whole += rows.T @ rows
    n = 6 * count
    return np.asarray(whole[:n, :n] - whole[:n, n:] @ np.linalg.solve(whole[n:, n:], whole[n:, :n]))


@pytest.mark.parametrize("correlation_time", [0.0, 30.0])
def test_drawn_nodes_have_the_covariance_that_the_prior_s_rows_state(correlation_time: float) -> None:
    """Draws whitened by the root of the rows' information, the trend eliminated, are standard normal numbers."""
    prior = TrajectoryErrors(correlation_time=correlation_time).prior
    nodes, rng = evenly_spaced("lagrange", 0.0, (-40.0, 60.0), 20.0), np.random.default_rng(4)
    root = np.linalg.cholesky(information(prior, len(nodes), list(prior.factors(nodes))))
    drawn = np.array([drawn_nodes(prior, nodes, rng).ravel() for _ in range(1500)])
    white = drawn @ root
    assert_unit_variance(white)
    assert np.abs(np.cov(white.T) - np.eye(white.shape[1])).max() < 6.0 * np.sqrt(2.0 / 1500)
    spread = drawn.reshape(1500, -1, 6) / prior.node_sigmas(normalised(nodes))
    np.testing.assert_allclose(np.sqrt(np.mean(spread**2, axis=0)), 1.0, atol=4.5 / np.sqrt(2 * 1500))


def test_a_jitter_on_no_correction_is_the_jitter_itself() -> None:
    still = NodePrior(np.full(6, 1e-12), np.zeros(6), np.zeros(6))
    nodes = evenly_spaced("lagrange", 0.0, (-10.0, 10.0), 2.0)
    found = true_correction(still, nodes, None, Jitter(1e-5, 0.5, "pitch"), np.random.default_rng(0))
    values = correction_at(found, np.linspace(-10.0, 10.0, 2001), 0.0)
    assert np.abs(values[:, 3]).max() == pytest.approx(1e-5, rel=0.01)
    assert np.abs(values[:, [0, 1, 2, 4, 5]]).max() < 1e-10


# --- lines without kernels


def test_lines_are_the_addendum_s(shared_data: Path) -> None:
    """Affine maps from mm to pixels and focal lengths as ISIS has them; the published ones have four decimals."""
    kernel = require(shared_data / FOLDER / "hrscAddendum004.ti", "ISIS' addendum for HRSC")
    text = kernel.read_text(encoding="ascii")

    def numbers(code: int, key: str) -> np.ndarray:
        (found,) = re.findall(rf"INS-{code}_{key}\s*=\s*\(?([^)\n]*)", text)
        return np.array(found.replace(",", " ").split(), dtype=np.float64)

    codes = {"S2": 41211, "RED": 41212, "P2": 41213, "BLUE": 41214, "ND": 41215}
    codes |= {"GREEN": 41216, "P1": 41217, "IR": 41218, "S1": 41219}
    assert codes.keys() == HRSC_LINES.keys()
    for name, code in codes.items():
        found = hrsc_interior(name)
        want = np.stack([numbers(code, "ITRANSL"), numbers(code, "ITRANSS")])
        np.testing.assert_allclose(found.to_pixel[:, 0], want[:, 0], rtol=0, atol=1e-3)
        np.testing.assert_allclose(found.to_pixel[:, 1:] * MM, want[:, 1:], rtol=0, atol=1e-5)
        assert found.focal_length / MM == pytest.approx(numbers(code, "FOCAL_LENGTH")[0])
        assert found.centre.tolist() == [0.0, numbers(code, "BORESIGHT_SAMPLE")[0] - 0.5]


def test_macropixels_are_the_same_places() -> None:
    fine, _ = hrsc_interior("S1").focal_plane(np.array([0.0, 1000.0, 5184.0]))
    coarse, _ = hrsc_interior("S1", 4).focal_plane(np.array([0.0, 250.0, 1296.0]))
    np.testing.assert_allclose(coarse, fine, atol=1e-15)
