"""Image support data: real LRO images in our units, HRSC's, and the ground of all real ones by usgscsm's algorithm."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usgscsm
from mex import CHANGES, LINES, SAMPLES
from outside import refuses
from pass_files import block

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.isd_layout import support_optics
from mgsgraph.geometry.camera import LrocNacDistortion, RadialDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.simulation.case_files import support_data
from mgsgraph.units import KM

# --- two real LRO images, and the offsets known of these data


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
    # ISIS's sample of the boresight, 1-based, is 2548 (INS-85600_BORESIGHT_SAMPLE), which nothing of ours reads
    np.testing.assert_array_equal(image.interior.focal_plane(np.array([2548.0 - 0.5]))[0], 0.0)


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
        naif_keywords={"INS-99999_LIGHTTIME_CORRECTION": "NONE"},
    )  # fmt: skip
    place, slope = image.interior.focal_plane(np.array([10.0]))

    y = (10.0 * 2.0 + 100.0 - 2547.5) / 142.857  # mm
    np.testing.assert_allclose(1e3 * place[0], [0.0, y * (1.0 - 1e-3 - 2e-6 * y**2 - 3e-9 * y**4)], rtol=1e-13)
    assert slope[0, 1] > 1.9 * 7e-6
    assert isinstance(image.interior.distortion, RadialDistortion)


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


# --- the ground of 25 pixels by `usgscsm.py`, which shares nothing with reader or geometry


FILES = (
    *(f"lro_nac_lola/lidarObservationImage{k}.isd" for k in (1, 2)),
    *(f"lro_nac_hadley/observationImage{side}.isd" for side in "LR"),
    *(f"mro_ctx_isds/{name}.crop.json" for name in (
        "B10_013615_2178_XI_37N117W", "G02_019154_1800_XN_00N133W", "G02_019154_1800_XN_00N133W.ellipsoid",
        "G17_024823_2204_XI_40N109W", "K12_058001_2177_XI_37N117W", "N06_064753_1800_XN_00S133W",
        "N11_066770_2192_XN_39N109W", "N12_067021_2177_XN_37N117W", "P10_005031_2197_XI_39N109W",
    )),
)  # fmt: skip
DENSE = 4001
"""Even samples of tables resampled.

usgscsm takes no light time off, so that positions are compared as the files have them. It lays tables out in as many
even steps as they have uneven ones (constructStateFromIsd; ALE States.cpp, getState, Orientations.cpp, operator*), goes
through eight of these, and near the ends through two: up to 0.13 pixels of CTX, 0.03 of LROC are lost. Laid out densely
from the very tables, by Hermite's cubic and great arcs, nothing is lost; then both agree. What is right is the table,
between whose times ISIS interpolates so, as we do.
"""
ORIGINS = {2548: {"line": 0.0, "sample": 2547.5}, 2496: {"line": 0.0, "sample": 2495.5}}


def as_isis_takes_it(isd: dict[str, Any]) -> dict[str, Any]:
    """LROC's own files of ISIS: its tables begin with the first line and end with the last, whatever the label's times
    in line_scan_rate are; the middle of the principal point's pixel is at 2547.5 and 2495.5, counted from 0 at the edge
    of the first one (lro_instrumentAddendum: pixels 2548 and 2496, the first one's middle at 1).
    """
    if isd["detector_center"]["sample"] not in ORIGINS:
        return isd
    first, *_, last = isd["instrument_position"]["ephemeris_times"]
    rate = [[0.5, first - isd["center_ephemeris_time"], (last - first) / isd["image_lines"]]]
    return isd | {"line_scan_rate": rate, "detector_center": ORIGINS[isd["detector_center"]["sample"]]}


def laid_out(isd: dict[str, Any]) -> dict[str, Any]:
    """The same with many even samples, over the image alone, on the cubics and great arcs of the tables."""
    ((_, start, period),) = isd["line_scan_rate"]
    first = isd["center_ephemeris_time"] + start
    times = np.linspace(first, first + isd["image_lines"] * period, DENSE)
    tables = {"instrument_position": isd["instrument_position"] | hermite(isd["instrument_position"], times)}
    for key in ("instrument_pointing", "body_rotation"):
        table = isd[key]
        quaternions = usgscsm.great_arc(np.array(table["ephemeris_times"]), np.array(table["quaternions"]), times)
        tables[key] = table | {"ephemeris_times": times, "quaternions": quaternions}
    return isd | tables


def hermite(table: dict[str, Any], times: np.ndarray) -> dict[str, Any]:
    given, places, motions = (np.array(table[key]) for key in ("ephemeris_times", "positions", "velocities"))
    k = np.clip(np.searchsorted(given, times, side="right") - 1, 0, given.size - 2)
    span = (given[k + 1] - given[k])[:, None]
    t = (times - given[k])[:, None] / span
    a, b = places[k + 1] - places[k] - span * motions[k], span * (motions[k + 1] - motions[k])
    place = places[k] + t * span * motions[k] + t**2 * (3.0 * a - b) + t**3 * (b - 2.0 * a)
    motion = motions[k] + (2.0 * t * (3.0 * a - b) + 3.0 * t**2 * (b - 2.0 * a)) / span
    return {"ephemeris_times": times, "positions": place, "velocities": motion}


@pytest.mark.parametrize("file", FILES)
def test_ground_is_usgscsms(shared_data: Path, file: str) -> None:
    image = read_isd(shared_data / file, "image", Aberration("NONE"))
    isd = as_isis_takes_it(json.loads((shared_data / file).read_text()))
    for content, most in ((laid_out(isd), 1e-3), (isd, 0.15)):
        assert usgscsm.largest_difference(image, usgscsm.state_of_support_data(content)) < most


CAMERAS: dict[str, tuple[str, dict[str, Any]]] = {
    "MOC-NA": ("mgs_moc_m0402852/m0402852_isis.lbl", {}),
    "HRSC": ("mex_hrsc_h5270/h5270_0000_ir2_pds3.lbl", {"line_times": "mean"}),
    "CTX": ("mro_ctx_b10/B10_013341_1010_XN_79S172W_pds3.lbl", {}),
    "LROC NAC": ("lro_nac_m103595705/M103595705LE_pds3.lbl", {}),
    "Kaguya TC": ("kaguya_tc/TC1S2B0_01_06691S820E0465_pds3.lbl", {}),
}
_ORDER = (".tls", ".tsc", ".tpc", ".bpc", ".tf", ".ti", ".bsp", ".bc")


def by_kernels(shared_data: Path, camera: str, **more: Any) -> PushbroomImage:
    file, its_own = CAMERAS[camera]
    folder = (shared_data / file).parent
    found = [path for path in (*folder.iterdir(), shared_data / "kernels" / "moon_pa_de421_1900-2050.bpc")
             if path.suffix.lower() in _ORDER]  # fmt: skip
    kernels = sorted(found, key=lambda path: (_ORDER.index(path.suffix.lower()), "ddendum" in path.name, path.name))
    return read_labelled_image(shared_data / file, kernels, camera, **its_own, **more)


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_ground_of_each_camera_is_usgscsms(shared_data: Path, camera: str) -> None:
    """By label and kernels, written as support data: line times, detector and distortion of each in usgscsm's terms."""
    image = by_kernels(shared_data, camera)
    isd = support_data(image) | {"optical_distortion": support_optics(image.interior.distortion, camera)}
    content = isd if camera == "HRSC" else laid_out(isd)  # HRSC's line periods change
    assert usgscsm.largest_difference(image, usgscsm.state_of_support_data(content)) < 1e-3


# --- HRSC, in the layout that ALE documents and writes


CENTRE = 255744697.39357847
"""center_ephemeris_time of h5270_0000_ir2."""
RATES = [[line - 0.5, time - CENTRE, period] for time, period, line in CHANGES]


def hrsc(**changes: Any) -> dict[str, Any]:
    """Support data like ALE's of h5270_0000_ir2. No complete file of a real HRSC image is at hand: numbers of the
    detector and the line rates are its own (ISIS addendum, ALE's test of its driver), the rest of a simulated pass.
    """
    simulated = support_data(block().network.images[0])
    long = np.linspace(CENTRE - 120.0, CENTRE + 120.0, 41)
    tables = {}
    for name in ("instrument_position", "instrument_pointing", "body_rotation"):
        table = dict(simulated[name])
        rows = np.arange(len(table["ephemeris_times"]))
        at = np.linspace(0, rows[-1], 41)
        slower = (table["ephemeris_times"][-1] - table["ephemeris_times"][0]) / 240.0
        for key in ("positions", "velocities", "quaternions"):
            if key in table:
                columns = [np.interp(at, rows, column) for column in np.array(table[key]).T]
                table[key] = (np.stack(columns, axis=1) * (slower if key == "velocities" else 1.0)).tolist()
        tables[name] = table | {"ephemeris_times": long.tolist()}
    return simulated | tables | {
        "name_platform": "MARS EXPRESS", "name_sensor": "MEX_HRSC_IR",
        "image_lines": LINES, "image_samples": SAMPLES, "line_scan_rate": RATES,
        "center_ephemeris_time": CENTRE, "starting_ephemeris_time": CHANGES[0][0],
        "focal_length_model": {"focal_length": 174.82}, "detector_center": {"line": 0.0, "sample": 2592.0},
        "focal2pixel_lines": [-7113.11359717265, 0.062856784318668, 142.857129028729],
        "focal2pixel_samples": [-0.778052433438109, -142.857129028729, 0.062856784318668],
        "detector_sample_summing": 4, "detector_line_summing": 4,
        "starting_detector_line": 0, "starting_detector_sample": 0,
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "naif_keywords": {"INS-41218_LIGHTTIME_CORRECTION": "NONE"},
    } | changes  # fmt: skip


def read(folder: Path, **changes: Any) -> PushbroomImage:
    path = folder / "h5270.json"
    path.write_text(json.dumps(hrsc(**changes)))
    return read_isd(path, "h5270")


def test_line_rates(tmp_path: Path) -> None:
    """Three of them: a line's time is that of its change plus whole periods of its own."""
    image = read(tmp_path)
    lines = np.array([0.0, 6663.0, 6664.0, 6664.5, 6665.0, 10000.0])
    times, periods = image.timing.at(lines)
    owner = [0, 0, 1, 1, 2, 2]
    start, period, first = np.array(CHANGES)[owner].T
    want = start - CENTRE + (lines - (first - 1.0)) * period
    np.testing.assert_allclose(times, want, rtol=0, atol=1e-7)
    assert periods.tolist() == period.tolist()
    np.testing.assert_allclose(image.timing.lines(times), lines, atol=1e-5)
    np.testing.assert_allclose(np.diff(image.moments(lines).times), np.diff(times))


def test_what_ale_writes_otherwise_is_understood(tmp_path: Path) -> None:
    """Ephemeris times of lines (its test data's mexhrsc_isd.json) and no macropixels: the same image, and a remark."""
    odd = read(tmp_path, line_scan_rate=[[line - 0.5, time, period] for time, period, line in CHANGES])
    np.testing.assert_allclose(odd.timing.start_times, read(tmp_path).timing.start_times, rtol=0, atol=1e-7)
    single = read(tmp_path, detector_sample_summing=1)
    assert single.interior.sample_summing == 4.0
    assert len(odd.remarks) == len(single.remarks) == 1


def test_the_detector_lies_where_the_addendum_puts_it(tmp_path: Path) -> None:
    """Y0 = 49.7918 mm ahead along track (facts of the addendum), its samples 28 micrometres apart towards -X."""
    place, slope = read(tmp_path).interior.focal_plane(np.array([0.0, 648.0, 1288.0]))
    np.testing.assert_allclose(place[:, 1], 49.7918e-3, rtol=0, atol=1e-5)
    np.testing.assert_allclose(slope[:, 0], -28e-6, rtol=1e-6)
    assert place[1, 0] == pytest.approx(0.0, abs=2e-5)


def test_what_is_wrong_with_hrsc_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"111.111 pixels per mm; expected HRSC's 142.857"):
        read(tmp_path, focal2pixel_samples=[0.0, 111.111111111111, 0.0])
    refuses("line timing, first lines", read, tmp_path, line_scan_rate=[RATES[0], RATES[2], RATES[1]])
