"""The simulated pair: physics against published numbers, statistics against the stated sigmas, files against memory;
instruments that are not as their kernels say.
"""

import json
import tomllib
from pathlib import Path

import networks
import numpy as np
import pytest
import spiceypy
from outside import refuses
from redraw import assert_unit_variance

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.simulation.camera import InstrumentErrors, as_taken, displaced_footprints
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.ground import sine_height
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, SimulatedPair, simulate_pair
from mgsgraph.units import DEG

FILES = ("image_A.isd", "image_B.isd", "network.pvl", "lidar.json", "truth.json", "case.toml")

SEEDS = range(15)


@pytest.fixture(scope="module")
def pair() -> SimulatedPair:
    return simulate_pair()


@pytest.fixture(scope="module")
def folder(pair: SimulatedPair, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pair(pair, tmp_path_factory.mktemp("pair")).parent


@pytest.fixture(scope="module")
def many() -> list[SimulatedPair]:
    return [simulate_pair(PairSettings(ties=20, shots=20), seed) for seed in SEEDS]


# --- physics


def test_body_rotation_is_the_one_of_spice(pair: SimulatedPair) -> None:
    spiceypy.kclear()
    try:
        for key, value in (("RA", 317.68143), ("DEC", 52.88650)):
            spiceypy.pdpool(f"BODY499_POLE_{key}", [value, 0.0, 0.0])
        spiceypy.pdpool("BODY499_PM", [176.630, 350.89198226, 0.0])
        for image in pair.images:
            times = np.array([-3.3, 0.0, 2.71])
            matrices, angular_rate = image.trajectory.body.at(times)
            want = np.array([spiceypy.tipbod("J2000", 499, image.trajectory.epoch + t) for t in times])
            assert np.abs(matrices - want).max() < 1e-12
            assert np.abs(angular_rate - [0.0, 0.0, 7.088218e-5]).max() < 1e-10
    finally:
        spiceypy.kclear()


def test_ground_speeds_are_those_of_the_published_shot_spacings(pair: SimulatedPair) -> None:
    """MOLA at 10 Hz: 305 m on nadir images, 341 m where the spacecraft is held (Yoon & Shan 2005, Table 1)."""
    for image, spacing in zip(pair.images, (305.0, 341.0), strict=True):
        _, per_place = image.image_to_ground(np.array([2500.0]), np.array([512.0]))
        assert 0.1 * np.linalg.norm(per_place[0, :, 0]) / 1.446e-3 == pytest.approx(spacing, rel=0.01)


def test_looks_and_altitude(pair: SimulatedPair) -> None:
    """Off-nadir angle and incidence by the sine rule of the triangle centre, spacecraft, site."""
    for image, angle in zip(pair.images, (0.0, 20.0 * DEG), strict=True):
        origin, look, _, _ = image.rays(np.array([2500.0]), np.array([512.0]))
        ground, _ = image.image_to_ground(np.array([2500.0]), np.array([512.0]))
        radius, craft = np.linalg.norm(ground), np.linalg.norm(origin)
        assert craft - radius == pytest.approx(380e3, abs=1.0)
        look = look[0] / np.linalg.norm(look)
        off_nadir = np.arccos(min(1.0, -look @ origin[0] / craft))
        incidence = np.arccos(min(1.0, -look @ ground[0] / radius))
        assert off_nadir == pytest.approx(angle, abs=1e-5)
        assert radius * np.sin(incidence) == pytest.approx(craft * np.sin(off_nadir), abs=1.0)
        place, height = planetocentric(ground)[0], radius
        assert place[:2] == pytest.approx([87.0 * DEG, 4.0 * DEG], abs=1e-9)
        assert MARS.polar < height < MARS.equatorial


def test_off_nadir_camera_is_held_and_nadir_camera_turns_with_the_orbit(pair: SimulatedPair) -> None:
    rates = [np.linalg.norm(image.trajectory.camera.at(np.zeros(1))[1]) for image in pair.images]
    assert rates[0] == pytest.approx(2.0 * np.pi / 7050.0, rel=0.01)  # about 118 minutes for a revolution, as MGS
    assert rates[1] < 1e-12


def test_position_tables_are_smooth_enough_to_interpolate(pair: SimulatedPair) -> None:
    """Velocity is the derivative of position, and the orbit is round between the samples too."""
    for image in pair.images:
        times = np.linspace(-3.6, 3.6, 97)
        before, after = (image.trajectory.position.at(times + step)[0] for step in (-0.01, 0.01))
        place, velocity = image.trajectory.position.at(times)
        assert np.abs((after - before) / 0.02 - velocity).max() < 1e-4
        assert np.ptp(np.linalg.norm(place, axis=1)) < 1e-6


# --- truth


def test_true_points_lie_on_the_terrain_and_project_back(pair: SimulatedPair) -> None:
    for image, true in zip(pair.images, pair.true_corrections, strict=True):
        for points in (pair.true_ties, pair.true_footprints):
            places, _ = image.ground_to_image(points, true)
            assert np.all((places > 0.0) & (places < [image.lines, image.samples]))
            height = sine_height(points, pair.settings.relief)
            back, _ = image.image_to_ground(places[:, 0], places[:, 1], height, true)
            assert np.abs(back - points).max() < 1e-5  # 2e-6 px


def test_footprints_lie_under_the_first_camera_at_their_time(pair: SimulatedPair) -> None:
    """Seen at the line of the shot's time, on the optical axis of the true orientation."""
    first = pair.images[0]
    places, _ = first.ground_to_image(pair.true_footprints, pair.true_corrections[0])
    lines = first.timing.lines(pair.laser.times - first.trajectory.epoch)
    assert np.abs(places[:, 0] - lines).max() < 1e-5
    assert np.abs(places[:, 1] - 0.5 * first.samples).max() < 1e-5
    assert pair.laser.simultaneous_shot.tolist() == list(range(len(pair.laser.ids)))
    assert pair.laser.simultaneous_image.used == ("SIM/A",)


def test_nominal_orientation_misses_by_as_much_as_the_prior_says(many: list[SimulatedPair]) -> None:
    """30 m, and 0.1 mrad over 380 km, make 48 m or 17 samples in the nadir image; so the adjustment has work to do."""
    misses = []
    for pair in many:
        nominal, _ = pair.images[0].ground_to_image(pair.true_ties)
        true, _ = pair.images[0].ground_to_image(pair.true_ties, pair.true_corrections[0])
        misses.append(np.mean((nominal - true)[:, 1]))
    assert 10.0 < np.sqrt(np.mean(np.square(misses))) < 26.0


# --- statistics


def test_corrections_have_the_prior_as_their_spread(many: list[SimulatedPair]) -> None:
    prior = many[0].settings.noise.prior.sigmas
    assert prior[:, 0].tolist() == [30.0, 3.0, 0.3]
    assert prior[0, 3:].tolist() == [1e-4] * 3
    drawn = np.array([[true.coefficients for true in pair.true_corrections] for pair in many])
    for k in range(3):
        assert_unit_variance(drawn[:, :, k] / prior[k])


def test_measures_have_the_stated_noise(many: list[SimulatedPair]) -> None:
    ties, shots = [], []
    for pair in many:
        for j, (image, true) in enumerate(zip(pair.images, pair.true_corrections, strict=True)):
            ties.append(pair.ties.measures[j::2] - image.ground_to_image(pair.true_ties, true)[0])
            shots.append(pair.laser.measures[j::2] - image.ground_to_image(pair.true_footprints, true)[0])
            assert set(pair.ties.measure_image[j::2]) == {image.name}
    assert_unit_variance(np.array(ties) / 1.0)
    assert_unit_variance(np.array(shots) / 5.0)


def test_footprints_and_ranges_have_the_stated_noise(many: list[SimulatedPair]) -> None:
    """Range by hand: nominal table + position polynomial, not through the image's own pose."""
    ranges, grounds = [], []
    for pair in many:
        first, true = pair.images[0].trajectory, pair.true_corrections[0].coefficients
        elapsed = pair.laser.times - first.epoch
        u = elapsed / (0.5 * pair.settings.lines * pair.settings.period)
        to_body, _ = first.body.at(elapsed)
        camera = np.einsum("nij,nj->ni", to_body, first.position.at(elapsed)[0])
        camera += polynomial(u, 2)[0] @ true[:, :3]
        ranges.append(pair.laser.ranges - np.linalg.norm(pair.true_footprints - camera, axis=1))
        grounds.append(pair.laser.footprints - pair.true_footprints)
        assert np.array_equal(pair.laser.covariances, np.broadcast_to(100.0 * np.eye(3), (20, 3, 3)))
    assert_unit_variance(np.array(ranges) / 1.0)
    assert_unit_variance(np.array(grounds) / 10.0)


def test_settings_reach_the_noise() -> None:
    """Half the tie sigma with the same seed: the same ground, half the error."""
    whole = simulate_pair(PairSettings(ties=10, shots=5))
    half = simulate_pair(PairSettings(ties=10, shots=5, noise=NoiseSettings(tie=0.5)))
    assert np.array_equal(whole.true_ties, half.true_ties)
    image, true = whole.images[0], whole.true_corrections[0]
    exact, _ = image.ground_to_image(whole.true_ties, true)
    assert half.ties.measures[::2] - exact == pytest.approx(0.5 * (whole.ties.measures[::2] - exact), abs=1e-9)
    assert np.all(half.ties.measure_sigmas == 0.5)


# --- files


def test_same_seed_same_bytes_other_seed_other_bytes(folder: Path, tmp_path: Path) -> None:
    again = write_pair(simulate_pair(), tmp_path / "again")
    other = write_pair(simulate_pair(seed=2), tmp_path / "other")
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    for name in FILES:
        assert (again.parent / name).read_bytes() == (folder / name).read_bytes()
    for name in ("network.pvl", "lidar.json", "truth.json"):
        assert (other.parent / name).read_bytes() != (folder / name).read_bytes()


@pytest.mark.parametrize("j", [0, 1])
def test_support_data_read_back_as_the_same_image(pair: SimulatedPair, folder: Path, j: int) -> None:
    image = pair.images[j]
    back = read_isd(folder / ("image_A.isd", "image_B.isd")[j], image.name)
    lines, samples = np.linspace(0.0, 5000.0, 401), np.linspace(0.0, 1024.0, 401)
    want, got = image.pose(lines), back.pose(lines)
    assert np.abs(got.position - want.position).max() < 1e-6
    assert np.abs(got.velocity - want.velocity).max() < 1e-9
    assert np.abs(got.matrix - want.matrix).max() < 1e-12
    assert np.abs(got.angular_rate - want.angular_rate).max() < 1e-12
    assert (back.lines, back.samples, back.body) == (image.lines, image.samples, image.body)
    place, _ = back.image_to_ground(lines, samples, 100.0)
    assert np.abs(place - image.image_to_ground(lines, samples, 100.0)[0]).max() < 1e-5


def test_network_reads_back(pair: SimulatedPair, folder: Path) -> None:
    back = read_control_network(folder / "network.pvl")
    assert (back.ids, back.measure_image) == (pair.ties.ids, pair.ties.measure_image)
    assert np.array_equal(back.kinds, pair.ties.kinds)
    assert np.array_equal(back.measure_point, pair.ties.measure_point)
    assert np.abs(back.measures - pair.ties.measures).max() < 1e-11
    assert np.array_equal(back.measure_sigmas, pair.ties.measure_sigmas)
    assert np.all(np.isnan(back.places))


def test_lidar_reads_back(pair: SimulatedPair, folder: Path) -> None:
    back, want = read_lidar(folder / "lidar.json"), pair.laser
    assert (back.ids, back.simultaneous_image, back.measure_image) == (
        want.ids, want.simultaneous_image, want.measure_image,
    )  # fmt: skip
    np.testing.assert_array_equal(back.simultaneous_shot, want.simultaneous_shot)
    assert np.array_equal(back.times, want.times)
    assert np.array_equal(back.range_sigmas, want.range_sigmas)
    assert np.array_equal(back.measure_shot, want.measure_shot)
    assert np.abs(back.ranges - want.ranges).max() < 1e-8
    assert np.abs(back.footprints - want.footprints).max() < 1e-6
    assert np.abs(back.covariances - want.covariances).max() < 1e-6
    assert np.abs(back.measures - want.measures).max() < 1e-11


def test_case_states_the_sigmas_of_the_simulation(tmp_path: Path) -> None:
    noise = NoiseSettings(0.5, 4.0, 2.0, 20.0, 60.0, 2e-4, (1.0, 0.5))
    path = write_pair(simulate_pair(PairSettings(ties=5, shots=5, noise=noise)), tmp_path)
    case = tomllib.loads(path.read_text())
    assert (path.name, case["format"], case["name"]) == ("case.toml", 1, "simulated pair")
    assert case["images"] == [{"name": "SIM/A", "isd": "image_A.isd"}, {"name": "SIM/B", "isd": "image_B.isd"}]
    assert case["orientation"] == {
        "degree": 1, "position_sigma_m": 60.0, "angle_sigma_mrad": pytest.approx(0.2), "trend": [1.0, 0.5]
    }
    assert case["ties"] == {"network": "network.pvl", "sigma_px": 0.5}
    assert case["laser"] == {
        "file": "lidar.json", "image_sigma_px": 4.0, "range_sigma_m": 2.0, "ground_sigma_m": 20.0
    }


def test_truth_file_holds_the_truth(pair: SimulatedPair, folder: Path) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["seed"] == 1
    for image, true in zip(pair.images, pair.true_corrections, strict=True):
        assert truth["coefficients"][image.name] == true.coefficients.tolist()
    assert [truth["ties"][name] for name in pair.ties.ids] == pair.true_ties.tolist()
    assert [truth["footprints"][name] for name in pair.laser.ids] == pair.true_footprints.tolist()


# --- refusals


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: NoiseSettings(tie=0.0), "noise settings, tie: 0.0; expected a positive number"),
        (lambda: NoiseSettings(trend=(1.0, -0.1)), "noise settings, trend: -0.1"),
        (lambda: PairSettings(lines=100), "pair settings, lines: 100; expected a whole number, at least 240"),
        (lambda: simulate_pair(PairSettings(off_nadir=70.0 * DEG)), "70.0 deg, which looks past the body"),
        (lambda: simulate_pair(PairSettings(ties=1, noise=NoiseSettings(position=2e4))), "share .* footprints"),
    ],
)
def test_impossible_settings_are_refused_in_one_line(make, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        make()
    assert "\n" not in str(caught.value)


# --- instruments that are not as their kernels say


def test_a_late_clock_reads_its_table_later() -> None:
    """Inertial attitude and position at t are those of t + bias; the body turns by its own clock."""
    image, times = networks.pair().images[0], np.array([-1.0, 0.0, 2.0])
    taken = as_taken(image, InstrumentErrors(attitude_time=0.5, position_time=-0.25)).trajectory
    given = image.trajectory
    np.testing.assert_allclose(taken.camera.at(times)[0], given.camera.at(times + 0.5)[0], atol=1e-14)  # type: ignore[attr-defined]
    np.testing.assert_allclose(taken.position.at(times)[0], given.position.at(times - 0.25)[0], atol=1e-8)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(taken.body.at(times)[0], given.body.at(times)[0])  # type: ignore[attr-defined]


def test_a_turned_camera_sees_what_the_vector_says() -> None:
    """M = Exp([theta]x)' M nominal, as the orientation corrections have it."""
    image, theta = networks.pair().images[0], np.array([1e-3, -2e-3, 5e-3])
    taken = as_taken(image, InstrumentErrors(camera_boresight=theta))
    lines = np.array([0.0, 100.0])
    np.testing.assert_allclose(
        taken.pose(lines).matrix, rotation.exponential(theta).T @ image.pose(lines).matrix, atol=1e-14
    )


def test_a_footprint_is_believed_where_the_straight_beam_ends() -> None:
    """As far from the instrument as the true one, and off by the angle times the distance."""
    drawn = networks.pair()
    image, truth = drawn.images[0], drawn.true_footprints
    errors = InstrumentErrors(altimeter_boresight=np.array([0.0, 1e-3, 0.0]))
    times = drawn.laser.times - image.trajectory.epoch
    believed = displaced_footprints(image, times, truth, errors)
    place = image.trajectory.pose(times).position
    far, off = (np.linalg.norm(difference, axis=1) for difference in (truth - place, believed - truth))
    np.testing.assert_allclose(np.linalg.norm(believed - place, axis=1), far, rtol=1e-12)
    np.testing.assert_allclose(off, 1e-3 * far, rtol=1e-4)


def test_the_images_stay_nominal() -> None:
    made = simulate_pair(networks.pair().settings, 1, InstrumentErrors(attitude_time=0.2, range_bias=9.0))
    lines = np.array([10.0, 900.0])
    np.testing.assert_array_equal(made.images[0].pose(lines).matrix, networks.pair().images[0].pose(lines).matrix)
    assert abs(np.mean(made.laser.ranges - networks.pair().laser.ranges) - 9.0) < 5.0
    assert np.abs(made.ties.measures - networks.pair().ties.measures).max() > 1.0


def test_what_cannot_be_simulated_is_said() -> None:
    refuses("attitude_time", InstrumentErrors, attitude_time=float("nan"))
    with pytest.raises(InputError):
        as_taken(networks.pair().images[0], InstrumentErrors(attitude_time=50.0))
