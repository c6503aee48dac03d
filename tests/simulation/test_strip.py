"""The simulated strip: what its images share, statistics against stated sigmas, additions against the whole, files."""

import json
from pathlib import Path

import numpy as np
import pytest
from redraw import assert_unit_variance

from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.network import PointClass
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_strip
from mgsgraph.simulation.ground import sine_height
from mgsgraph.simulation.observations import MARGIN, NoiseSettings
from mgsgraph.simulation.strip import SimulatedStrip, StripSettings, simulate_strip
from mgsgraph.units import DEG

Measures = dict[tuple[str, str], tuple[float, float]]
"""Place by point and image."""


@pytest.fixture(scope="module")
def strip() -> SimulatedStrip:
    return simulate_strip(StripSettings(images=7, ties=60, shots=12))


@pytest.fixture(scope="module")
def many() -> list[SimulatedStrip]:
    return [simulate_strip(StripSettings(images=5, ties=25, shots=10), seed) for seed in range(8)]


def of_ties(ties: TiePoints) -> Measures:
    rows = zip(ties.measure_point.tolist(), ties.measure_image, ties.measures.tolist(), strict=True)
    return {(ties.ids[point], image): tuple(place) for point, image, place in rows}


def of_laser(laser: LaserProfile) -> Measures:
    rows = zip(laser.measure_shot.tolist(), laser.measure_image, laser.measures.tolist(), strict=True)
    return {(laser.ids[shot], image): tuple(place) for shot, image, place in rows}


def common(strip: SimulatedStrip) -> np.ndarray:
    """(images, images) number of ties that both measure."""
    number = {image.name: j for j, image in enumerate(strip.images)}
    seen = np.zeros((len(strip.ties.ids), len(number)), dtype=int)
    seen[strip.ties.measure_point, [number[name] for name in strip.ties.measure_image]] = 1
    return seen.T @ seen


# --- geometry


def test_the_track_is_one_orbit_s(strip: SimulatedStrip) -> None:
    """Its inclination is the same over every site: cos i = sin(heading) cos(latitude) (Clairaut), and it is 93 deg."""
    for image in strip.images[::2]:
        place, velocity = image.trajectory.position.at(np.zeros(1))
        to_body, _ = image.trajectory.body.at(np.zeros(1))
        normal = to_body[0] @ np.cross(place[0], velocity[0])
        assert np.arccos(normal[2] / np.linalg.norm(normal)) == pytest.approx(93.0 * DEG, abs=1e-4)


@pytest.mark.parametrize("overlap", [0.1, 0.7])
def test_nadir_images_overlap_by_the_stated_share(overlap: float) -> None:
    """Along their length, which the ground of one ends in the next shows: a tenth to seven tenths of the lines."""
    made = simulate_strip(StripSettings(images=5, ties=20, shots=4, overlap=overlap))
    for before, after in ((0, 2), (2, 4)):
        end, _ = made.images[before].image_to_ground(np.array([5000.0]), np.array([512.0]))
        place, _ = made.images[after].ground_to_image(end)
        assert place[0, 0] / 5000.0 == pytest.approx(overlap, abs=0.01)
        assert place[0, 1] == pytest.approx(512.0, abs=20.0)


def test_every_image_shares_ground_with_its_neighbours_and_no_others(strip: SimulatedStrip) -> None:
    shared = common(strip)
    for k in range(1, 7):
        assert shared[k, k - 1] >= 20
        assert np.count_nonzero(shared[k, :k]) == min(k, 2 + k % 2)
    assert all(shared[k, k + 2] >= 20 for k in range(5))
    assert not np.any(np.triu(shared, 4))
    assert {1, 2, 3, 4}.issuperset(np.bincount(strip.ties.measure_point).tolist())
    assert np.bincount(strip.ties.measure_point).max() == 4


def test_points_are_measured_in_all_images_that_show_them_and_in_no_other(strip: SimulatedStrip) -> None:
    """By the images' own geometry, which the simulation takes polynomials for."""
    ties = of_ties(strip.ties)
    shots: Measures = {}
    for laser in strip.lasers:
        shots |= of_laser(laser)
    footprints = np.concatenate(strip.true_footprints)
    names = tuple(name for laser in strip.lasers for name in laser.ids)
    for image, true in zip(strip.images, strip.true_corrections, strict=True):
        size = np.array([image.lines, image.samples])
        for measured, ids, points in ((ties, strip.ties.ids, strip.true_ties), (shots, names, footprints)):
            places, _ = image.ground_to_image(points, true)
            inside = np.all((places > MARGIN) & (places < size - MARGIN), axis=1)
            assert inside.tolist() == [(name, image.name) in measured for name in ids]


def test_true_points_lie_on_the_terrain(strip: SimulatedStrip) -> None:
    """Height as the difference of radii along the same direction; ellipsoids that grow by h are h apart to 1e-4."""
    for points in (strip.true_ties, *strip.true_footprints):
        height = sine_height(points, strip.settings.relief)
        image, true = strip.images[0], strip.true_corrections[0]
        near = np.linalg.norm(points - points[0], axis=1) < 8e3
        places, _ = image.ground_to_image(points[near], true)
        back, _ = image.image_to_ground(places[:, 0], places[:, 1], height[near], true)
        inside = np.isfinite(places[:, 0])
        assert np.abs(back - points[near])[inside].max(initial=0.0) < 1e-5
        assert np.ptp(height) > 100.0
        assert np.all(np.abs(np.linalg.norm(points, axis=1) - 3_387_000.0) < 10e3)
    assert np.ptp(planetocentric(strip.true_ties)[:, 1]) > 0.5 * DEG


# --- statistics


def test_corrections_have_the_prior_as_their_spread(many: list[SimulatedStrip]) -> None:
    sigmas = many[0].settings.noise.prior.sigmas
    drawn = np.array([true.coefficients / sigmas for made in many for true in made.true_corrections])
    for k in range(3):
        assert_unit_variance(drawn[:, k])
    one, other = drawn[0::5].reshape(-1, 18), drawn[1::5].reshape(-1, 18)
    assert abs(np.mean(one * other)) < 4.5 / np.sqrt(one.size)


def test_measures_have_the_stated_noise(many: list[SimulatedStrip]) -> None:
    ties, shots = [], []
    for made in many:
        truth = dict(zip(made.ties.ids, made.true_ties, strict=True))
        found: list[tuple[list[np.ndarray], Measures]] = [(ties, of_ties(made.ties))]
        for laser, places in zip(made.lasers, made.true_footprints, strict=True):
            truth |= dict(zip(laser.ids, places, strict=True))
            found.append((shots, of_laser(laser)))
        for errors, measures in found:
            for image, true in zip(made.images, made.true_corrections, strict=True):
                mine = {point: place for (point, name), place in measures.items() if name == image.name}
                if mine:
                    exact, _ = image.ground_to_image(np.array([truth[point] for point in mine]), true)
                    errors.append(np.array(list(mine.values())) - exact)
    assert_unit_variance(np.concatenate(ties) / 1.0)
    assert_unit_variance(np.concatenate(shots) / 5.0)


def test_shots_have_the_stated_noise_and_lie_under_their_image(many: list[SimulatedStrip]) -> None:
    ranges, grounds = [], []
    for made in many:
        for j, (laser, points) in enumerate(zip(made.lasers, made.true_footprints, strict=True)):
            image, true = made.images[2 * j], made.true_corrections[2 * j]
            lines = image.timing.lines(laser.times - image.trajectory.epoch)
            places, _ = image.ground_to_image(points, true)
            assert np.abs(places - np.column_stack([lines, np.full(lines.size, 512.0)])).max() < 1e-4
            assert laser.simultaneous_shot.tolist() == list(range(len(laser.ids)))
            assert laser.simultaneous_image.used == (image.name,)
            eye = image.trajectory.pose(laser.times - image.trajectory.epoch).position
            eye = eye + true.at(image.moments(lines))[0][:, :3]
            ranges.append(laser.ranges - np.linalg.norm(points - eye, axis=1))
            grounds.append(laser.footprints - points)
    assert_unit_variance(np.concatenate(ranges) / 1.0)
    assert_unit_variance(np.concatenate(grounds) / 10.0)


# --- image after image


def test_additions_are_the_whole(strip: SimulatedStrip) -> None:
    ties, shots, ranges = dict[tuple[str, str], tuple[float, float]](), {}, []
    known: set[str] = set()
    for k, image in enumerate(strip.images):
        added = strip.steps[k]
        assert added.image is image
        rows, fired = of_ties(added.ties), of_laser(added.laser) if added.laser else {}
        there = {one.name for one in strip.images[: k + 1]}
        assert {name for _, name in [*rows, *fired]} <= there
        new = set(added.ties.ids) - known
        assert len(new) == (60 if k else 0)
        for name in set(added.ties.ids) & known:  # known points bring their measure in the new image and nothing else
            assert [image for point, image in rows if point == name] == [image.name]
        assert not rows.keys() & ties.keys()
        assert not fired.keys() & shots.keys()
        known |= new
        ties |= rows
        shots |= fired
        ranges += added.laser.ids[added.laser.simultaneous_shot].tolist()
    assert ties == of_ties(strip.ties)
    whole: Measures = {}
    for laser in strip.lasers:
        whole |= of_laser(laser)
    assert shots == whole
    assert ranges == [name for laser in strip.lasers for name in laser.ids]


def test_known_shots_come_again_as_they_were_and_without_a_range_that_counts(strip: SimulatedStrip) -> None:
    given = {
        name: (laser.times[i], laser.ranges[i], *laser.footprints[i])
        for laser in strip.lasers
        for i, name in enumerate(laser.ids)
    }
    again = 0
    for k in range(7):
        laser = strip.steps[k].laser
        assert laser is not None
        for i, name in enumerate(laser.ids):
            assert given[name] == (laser.times[i], laser.ranges[i], *laser.footprints[i])
            own = int(name[1:4]) == k
            images = laser.simultaneous_image[laser.simultaneous_shot == i]
            assert images == ((strip.images[k].name,) if own else ())
            again += not own
    assert again > 30


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_shorter_strip_is_the_beginning_of_a_longer_one(strip: SimulatedStrip, count: int) -> None:
    early = strip.upto(count)
    assert [image.name for image in early.images] == [image.name for image in strip.images[:count]]
    assert len(early.ties.ids) == 60 * (count - 1)
    assert len(early.lasers) == (count + 1) // 2
    if count > 1:
        alone = simulate_strip(StripSettings(images=count, ties=60, shots=12))
        assert of_ties(alone.ties) == of_ties(early.ties)
        assert np.array_equal(alone.true_ties, early.true_ties)
        for one, other in zip(alone.lasers, early.lasers, strict=True):
            assert of_laser(one) == of_laser(other)
        for true, same in zip(alone.true_corrections, early.true_corrections, strict=True):
            assert np.array_equal(true.coefficients, same.coefficients)


# --- files


def test_files_read_back(strip: SimulatedStrip, tmp_path: Path) -> None:
    folder = write_strip(strip, tmp_path / "strip").parent
    assert not list(folder.glob("step_*"))
    network = read_control_network(folder / "network.pvl")
    assert network.ids == strip.ties.ids
    assert of_ties(network).keys() == of_ties(strip.ties).keys()
    assert np.abs(network.measures - strip.ties.measures).max() < 1e-9
    assert len(read_lidar(folder / "lidar.json").ids) == 48
    truth = json.loads((folder / "truth.json").read_text())
    assert [truth["ties"][name] for name in strip.ties.ids] == strip.true_ties.tolist()
    assert [truth["footprints"][name] for name in strip.lasers[2].ids] == strip.true_footprints[2].tolist()
    assert truth["coefficients"]["STRIP/004N"] == strip.true_corrections[4].coefficients.tolist()
    image: PushbroomImage = read_isd(folder / "image_005X.isd", "STRIP/005X")
    lines = np.linspace(0.0, 5000.0, 101)
    place, _ = image.image_to_ground(lines, np.full(101, 500.0), 100.0)
    assert np.abs(place - strip.images[5].image_to_ground(lines, np.full(101, 500.0), 100.0)[0]).max() < 1e-5


def test_step_files_are_the_whole(strip: SimulatedStrip, tmp_path: Path) -> None:
    folder = write_strip(strip, tmp_path, steps=True).parent
    ties: Measures = {}
    shots: Measures = {}
    for k in range(7):
        step = folder / f"step_{k:03d}"
        assert (step / "ties.pvl").is_file() == (k > 0)
        ties |= of_ties(read_control_network(step / "ties.pvl")) if k else {}
        shots |= of_laser(read_lidar(step / "lidar.json"))
    assert ties == of_ties(read_control_network(folder / "network.pvl"))
    assert shots == of_laser(read_lidar(folder / "lidar.json"))


def test_the_case_adjusts_and_its_sigmas_are_honest(tmp_path: Path) -> None:
    """Six small strips; 99.9% bands: chi-square with 648 degrees of freedom for the orientation. Points of a strip
    share its orientation: at worst one point per pair of images counts, with 54.
    """
    orientation, ties, laser, fit = [], [], [], []
    for seed in range(200, 206):  # 4 s: with fewer strips the bands hold nothing
        made = simulate_strip(StripSettings(images=6, ties=40, shots=10), seed)
        case = read_case(write_strip(made, tmp_path))
        solution = adjust(case)
        assert solution.converged
        assert len(case.network.points) == 5 * 40 + 3 * 10
        assert case.network.ranges.point.size == 30
        truth = dict(zip(made.ties.ids, made.true_ties, strict=True))
        for shots, places in zip(made.lasers, made.true_footprints, strict=True):
            truth |= dict(zip(shots.ids, places, strict=True))
        pairs = zip(solution.coefficients, made.true_corrections, strict=True)
        error = np.concatenate([(found - true.coefficients).ravel() for found, true in pairs])
        orientation.append(nees(error[None], solution.joint_covariance.of(range(6))[None])[0] / error.size)
        off = solution.places - np.array([truth[name] for name in case.network.points.ids])
        for found, kind in ((ties, PointClass.TIE), (laser, PointClass.LASER)):
            members = solution.members(kind)
            found.append(nees(off[members], solution.covariances[members]).mean() / 3.0)
        fit.append(2.0 * solution.cost_final / solution.fit.degrees_of_freedom)
    assert 0.82 < np.mean(orientation) < 1.19
    assert 0.47 < np.mean(ties) < 1.75
    assert 0.47 < np.mean(laser) < 1.75
    assert 0.95 < np.mean(fit) < 1.05


# --- refusals


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: StripSettings(images=501), "strip settings, images: 501; expected 2 .. 500"),
        (lambda: StripSettings(overlap=1.0), "strip settings, overlap: 1.0"),
        (lambda: simulate_strip(StripSettings(images=500, lines=20_000)), "turns back at the pole"),
        (
            lambda: simulate_strip(StripSettings(images=4, ties=20, noise=NoiseSettings(position=1e5))),
            "STRIP/00.*ground shared with earlier images for .* of 20 tie points",
        ),
    ],
)
def test_impossible_settings_are_refused_in_one_line(make, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        make()
    assert "\n" not in str(caught.value)
