"""The two real LRO images: the file's numbers in our units, ties that meet, and the offsets known of these data."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spiceypy

from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.camera import LrocNacDistortion, RadialDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.units import KM

NAMES = ("LRO/1/286265995:36824/NACL", "LRO/1/286272781:34203/NACL")


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    return shared_data / "lro_nac_lola"


@pytest.fixture(scope="module")
def images(folder: Path) -> dict[str, PushbroomImage]:
    return {name: read_isd(folder / f"lidarObservationImage{k + 1}.isd", name) for k, name in enumerate(NAMES)}


def with_edits(folder: Path, new: Path, **edits: Any) -> PushbroomImage:
    isd = json.loads((folder / "lidarObservationImage1.isd").read_text())
    new.write_text(json.dumps(isd | edits))
    return read_isd(new, "edited")


def test_numbers_in_our_units(images: dict[str, PushbroomImage]) -> None:
    image = images[NAMES[0]]

    assert (image.name, image.lines, image.samples) == (NAMES[0], 52224, 5064)
    assert (image.body.equatorial, image.body.polar) == (1737.4 * KM, 1737.4 * KM)
    assert image.interior.focal_length == pytest.approx(0.69962, rel=1e-15)
    assert image.interior.distortion == LrocNacDistortion(pytest.approx(1.81e-5 * 1e6))
    np.testing.assert_allclose(image.interior.to_pixel, [[0.0, 142857.0, 0.0], [0.0, 0.0, 142857.0]], rtol=1e-15)
    np.testing.assert_array_equal(image.interior.centre, [0.0, 2547.5])
    assert image.trajectory.epoch == 317845271.29134554


def test_the_boresight_is_that_of_isis(folder: Path, images: dict[str, PushbroomImage]) -> None:
    """ISIS's sample of the boresight, 1-based, is 2548: its own keyword, which nothing of ours reads."""
    keywords = json.loads((folder / "lidarObservationImage1.isd").read_text())["naif_keywords"]
    sample = keywords["INS-85600_BORESIGHT_SAMPLE"] - 0.5
    place, _ = images[NAMES[0]].interior.focal_plane(np.array([sample]))

    assert keywords["INS-85600_BORESIGHT_SAMPLE"] == 2548.0
    np.testing.assert_array_equal(place, 0.0)


def test_the_first_line_begins_when_the_file_says(images: dict[str, PushbroomImage]) -> None:
    """ISIS line 0.5 is our 0.0: start of exposure 9.5265 s before the middle; the last line ends as long after."""
    image = images[NAMES[0]]
    times, period = image.timing.at(np.array([0.0, 52224.0]))

    np.testing.assert_allclose(times, [-9.526529610157013, 9.526529610157013], atol=2e-7)
    np.testing.assert_array_equal(period, 0.00036483339549999995)


def test_ties_meet(folder: Path, images: dict[str, PushbroomImage]) -> None:
    """311 ties of the stereo pair: rays pass each other at about half a metre in the median (README, trap 4)."""
    ties = read_control_network(folder / "network.pvl")
    k = ties.measures.shape[0]
    origins, directions = np.empty((k, 3)), np.empty((k, 3))
    for name, image in images.items():
        mine = np.array([measured == name for measured in ties.measure_image])
        origins[mine], directions[mine], _, _ = image.rays(*ties.measures[mine].T)
    places, skew, angle = intersect_rays(origins, directions, ties.measure_point, len(ties.ids))
    distances = 2.0 * skew  # between two rays

    assert len(ties.ids) == 311
    assert np.median(distances) == pytest.approx(0.58, abs=0.02)
    # the Moon's relief, north of 60 degrees
    assert np.all(np.abs(np.linalg.norm(places, axis=1) - 1737.4 * KM) < 6 * KM)
    assert np.all(angle > 0.1)


def test_laser_points_lie_beside_their_measures_by_a_constant(folder: Path, images: dict[str, PushbroomImage]) -> None:
    """-13.2 and -18.6 lines, as README (trap 4) says. Its -3.2 and -3.0 samples are ours but for half a pixel and a
    first-order inverse of the distortion; ours are by ISIS's boresight (below). What counts is that they are constant
    to hundredths of a pixel over the whole image: timing, focal length and distortion are those of ISIS.
    """
    shots = read_lidar(folder / "lidarData.json")
    for name, offset in zip(NAMES, ((-13.22, -2.80), (-18.61, -2.53)), strict=True):
        mine = np.array([measured == name for measured in shots.measure_image])
        places, _ = images[name].ground_to_image(shots.footprints[shots.measure_shot[mine]])
        apart = shots.measures[mine] - places

        assert mine.sum() == 52
        np.testing.assert_allclose(apart, np.broadcast_to(offset, apart.shape), atol=0.03)


def test_ground_places_are_those_that_spice_would_find(images: dict[str, PushbroomImage]) -> None:
    """Boresight of both cameras on the sphere, by hand from pose and NAIF surfpt, 1 mm."""
    for image in images.values():
        pose = image.pose(np.array([26112.0]))
        want = spiceypy.surfpt(pose.position[0], pose.matrix[0].T @ [0.0, 0.0, 1.0], *[1737.4 * KM] * 3)
        points, _ = image.image_to_ground(np.array([26112.0]), np.array([2547.5]))
        np.testing.assert_allclose(points[0], want, atol=1e-3)


def test_metres_read_like_kilometres(folder: Path, tmp_path: Path, images: dict[str, PushbroomImage]) -> None:
    isd = json.loads((folder / "lidarObservationImage1.isd").read_text())
    table = isd["instrument_position"]
    metres = {key: (KM * np.array(table[key])).tolist() for key in ("positions", "velocities")} | {"unit": "m"}
    radii = {"semimajor": 1737400.0, "semiminor": 1737400.0, "unit": "m"}
    image = with_edits(folder, tmp_path / "m.isd", instrument_position=table | metres, radii=radii)

    want = images[NAMES[0]].trajectory.position
    np.testing.assert_allclose(image.trajectory.position.positions, want.positions, rtol=1e-15)
    np.testing.assert_allclose(image.trajectory.position.velocities, want.velocities, rtol=1e-15)
    assert image.body == images[NAMES[0]].body


def test_radial_optics_and_summing(folder: Path, tmp_path: Path) -> None:
    image = with_edits(
        folder, tmp_path / "r.isd", optical_distortion={"radial": {"coefficients": [1e-3, 2e-6, 3e-9]}},
        detector_sample_summing=2, starting_detector_sample=100, detector_line_summing=2,
    )  # fmt: skip
    place, slope = image.interior.focal_plane(np.array([10.0]))

    y = (10.0 * 2.0 + 100.0 - 2547.5) / 142.857  # mm
    np.testing.assert_allclose(1e3 * place[0], [0.0, y * (1.0 - 1e-3 - 2e-6 * y**2 - 3e-9 * y**4)], rtol=1e-13)
    assert slope[0, 1] > 1.9 * 7e-6
    assert isinstance(image.interior.distortion, RadialDistortion)


def test_no_optics_at_all(folder: Path, tmp_path: Path) -> None:
    place, _ = with_edits(folder, tmp_path / "n.isd", optical_distortion={}).interior.focal_plane(np.array([10.0]))

    np.testing.assert_allclose(place[0], [0.0, (10.0 - 2547.5) / 142857.0], rtol=1e-14)


def test_the_caller_may_overrule_the_file(folder: Path, images: dict[str, PushbroomImage]) -> None:
    """LT+S undone moves the Moon's orbiter by metres; the file says that there is nothing to undo."""
    path = folder / "lidarObservationImage1.isd"
    stated = images[NAMES[0]].trajectory.position.positions
    body, craft = Aberration("LT+S", "body"), Aberration("LT+S", "spacecraft")
    undone = [read_isd(path, "x", chosen).trajectory.position.positions for chosen in (body, craft)]

    np.testing.assert_array_equal(read_isd(path, "x", Aberration("NONE")).trajectory.position.positions, stated)
    for positions in undone:
        assert 10.0 < np.linalg.norm(positions - stated, axis=1).max() < 300.0
    assert np.linalg.norm(undone[0] - undone[1], axis=1).max() > 1.0


REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "two models": (
        {"optical_distortion": {"radial": {"coefficients": [0, 0, 0]}, "lrolrocnac": {"coefficients": [0]}}},
        "2 models: radial, lrolrocnac; expected one",
    ),
    "two instruments": (
        {"naif_keywords": {"INS-1_LIGHTTIME_CORRECTION": "NONE", "INS-2_LIGHTTIME_CORRECTION": "LT+S"}},
        "keywords of several instruments that differ",
    ),
    "Sun goes back": (
        {
            "naif_keywords": {"INS-1_LIGHTTIME_CORRECTION": "LT+S"},
            "sun_position": {"ephemeris_times": [2.0, 1.0], "velocities": [[0.0, 1.0, 0.0]] * 2},
        },
        "sun_position, ephemeris_times: 2 times and 2 velocities",
    ),
}


@pytest.mark.parametrize("fault", REFUSALS)
def test_what_is_ambiguous_is_refused(folder: Path, tmp_path: Path, fault: str) -> None:
    edits, said = REFUSALS[fault]
    with pytest.raises(ValueError, match=r"edited\.isd") as caught:
        with_edits(folder, tmp_path / "edited.isd", **edits)
    assert said in str(caught.value)


HADLEY = ("LRO/1/269182000:51104/NACL", "LRO/1/269182000:51104/NACR")


@pytest.fixture(scope="module")
def hadley(shared_data: Path) -> dict[str, PushbroomImage]:
    """Two images of one moment, side by side, whose support data are by ISIS."""
    folder = shared_data / "lro_nac_hadley"
    return {name: read_isd(folder / f"observationImage{name[-1]}.isd", name) for name in HADLEY}


def test_line_times_by_isis_get_their_preroll(hadley: dict[str, PushbroomImage]) -> None:
    """Its own tables begin with the corrected first line and end with the last one."""
    for image in hadley.values():
        times, periods = image.timing.at(np.array([0.0, image.lines]))

        np.testing.assert_allclose(times, image.trajectory.coverage, rtol=0, atol=1e-6)
        np.testing.assert_allclose(periods, 0.986133e-3 * 1.0045, rtol=1e-12)


def test_a_coefficient_by_isis_is_a_number(hadley: dict[str, PushbroomImage]) -> None:
    left, right = hadley.values()

    assert left.interior.distortion == LrocNacDistortion(pytest.approx(1.81e-5 * 1e6))
    assert right.interior.distortion == LrocNacDistortion(pytest.approx(1.83e-5 * 1e6))


def test_images_side_by_side_meet_at_their_tie_points(shared_data: Path, hadley: dict[str, PushbroomImage]) -> None:
    """46 points of ISIS's control network: pixels of about a metre."""
    network = read_control_network(shared_data / "lro_nac_hadley" / "observationPair.net")
    names = np.array(network.measure_image)
    origins, directions = np.empty((2, names.size, 3))
    for name, image in hadley.items():
        its = names == name
        origins[its], directions[its] = image.sightlines(*network.measures[its].T)
    points, _, _ = intersect_rays(origins, directions, network.measure_point, len(network.ids))
    beside = np.cross(directions, points[network.measure_point] - origins)
    distances = np.linalg.norm(beside, axis=1) / np.linalg.norm(directions, axis=1)

    assert len(network.ids) == 46
    assert np.median(distances) < 0.5
    assert distances.max() < 1.0


def test_times_that_hold_the_preroll_are_left_alone(folder: Path, images: dict[str, PushbroomImage]) -> None:
    isd = json.loads((folder / "lidarObservationImage1.isd").read_text())
    start = isd["line_scan_rate"][0][1]

    assert isd["naif_keywords"]["INS-85600_ADDITIONAL_PREROLL"] == 1024
    np.testing.assert_array_equal(images[NAMES[0]].timing.start_times, [start])
