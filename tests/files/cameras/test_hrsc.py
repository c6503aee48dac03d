"""HRSC's nine lines: labels and times of lines, constants, trajectory and places by kernels, SPICE and publications."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mex import CHANGES, CUBE, FOLDER, LABEL, LINES, SAMPLES, START, cube_bytes, image_bytes, kernels, times_file
from mgs import changed
from outside import refuses
from strategies import turned

from mgsgraph.case.case_file import read_image
from mgsgraph.case.schema import ImageInput
from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import LineTimes, LineTimesLocation, LineTimesSource, NaifKeywords
from mgsgraph.files.cameras.label import DETECTORS, HRSC, HRSC_HEAD, read_line_scan_label
from mgsgraph.files.labels.kernels import loaded, pool_numbers
from mgsgraph.files.labels.labelled_image import read_labelled_image, read_pass_images
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory

# --- labels, and times of lines out of prefixes, tables and text


STOP = START + 19 * 0.0128
STOP_OF_H5270 = CHANGES[2][0] + (LINES - CHANGES[2][2]) * CHANGES[2][1]


def written(folder: Path, *changes: tuple[str, str], times: np.ndarray | None = None) -> Path:
    path = folder / "H5270_0000_IR2.IMG"
    times = START + 0.0128 * np.arange(20) if times is None else times
    path.write_bytes(image_bytes(times.tolist(), [12.8] * 20, changed(LABEL, changes)))
    return path


def cube(folder: Path, *changes: tuple[str, str]) -> Path:
    path = folder / "h5270.cub"
    path.write_bytes(cube_bytes(changed(CUBE, changes)))
    return path


ADDENDUM = NaifKeywords("the addendum", {
    "INS-41218_ITRANSL": (0.0, 0.0, 142.86), "INS-41218_ITRANSS": (0.0, -142.86, 0.0), "INS-41218_FOCAL_LENGTH": 174.8,
    "INS-41218_BORESIGHT_LINE": 0.0, "INS-41218_BORESIGHT_SAMPLE": 2592.0,
})  # fmt: skip


def times_of(path: Path, source: LineTimesSource = None, stop: float = STOP_OF_H5270) -> LineTimes:
    label = read_line_scan_label(path)
    label.camera.interior(ADDENDUM, label)
    return label.camera.line_times(ADDENDUM, replace(label, times=source or label.times), START, stop)


def refused(path: Path, source: LineTimesSource = None, stop: float = STOP_OF_H5270) -> str:
    """What is said of a file that is refused, in one line that begins with its folder."""
    with pytest.raises(InputError) as caught:
        times_of(path, source, stop)
    assert str(caught.value).startswith(str(path.parent))
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- labels


def test_pds_label(tmp_path: Path) -> None:
    got = read_line_scan_label(written(tmp_path))
    assert (got.camera.instrument, got.product, got.target) == (-41218, "H5270_0000_IR2.IMG", "MARS")
    assert (got.lines, got.samples, got.sample_summing) == (20, 222, 4)
    assert isinstance(got.times, LineTimesLocation)
    assert (got.times.kind, got.times.offset, got.times.count, got.times.stride) == ("prefixes", 2048, 20, 512)


def test_each_line_is_known(tmp_path: Path) -> None:
    for name in DETECTORS:
        camera = read_line_scan_label(written(tmp_path, ("MEX_HRSC_IR", f"MEX_HRSC_{name}"))).camera
        assert camera.name == f"MEX HRSC {name}"
        assert camera in HRSC
    assert read_line_scan_label(written(tmp_path, ("MACROPIXEL_SIZE              = 4\n", ""))).sample_summing == 1


def test_real_labels_of_both_kinds_say_the_same(shared_data: Path) -> None:
    """They were cut off their images, so the times of the lines are not there."""
    paths = [shared_data / FOLDER / f"h5270_0000_ir2_{kind}.lbl" for kind in ("pds3", "isis3")]
    pds, isis = map(read_line_scan_label, paths)
    for label in (pds, isis):
        assert (label.camera.name, label.product, label.sample_summing) == ("MEX HRSC IR", "H5270_0000_IR2.IMG", 4)
        assert (label.lines, label.samples, label.times) == (15088, 1288, None)
        assert label.start.rstrip("Z") == "2008-02-08T12:08:53.843"
        assert label.stop.rstrip("Z") == "2008-02-08T12:12:10.561"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("MEX_HRSC_IR", "MEX_HRSC_UV", "known by PDS3 labels: MEX HRSC MEX_HRSC_S2, MEX HRSC MEX_HRSC_RED"),
        ("PROCESSING_LEVEL_ID          = 2", "PROCESSING_LEVEL_ID          = 3", "a map (level 3)"),
        ("MACROPIXEL_SIZE              = 4", "MACROPIXEL_SIZE = 3", "macropixels of 3; expected"),
        ("LINE_SAMPLES       = 222", "LINE_SAMPLES = 1297", "pixels from 1 on end at 5188"),
        ("LINE_PREFIX_BYTES  = 68", "LINE_PREFIX_BYTES = 0", "a label without the times"),
    ],
)
def test_a_faulty_label_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(written(tmp_path, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Summing        = 4", "Summing = 8", "1288 samples of 8 pixels"),
        ("Name = ExposureTime", "Name = Exposures", "expected EphemerisTime, ExposureTime (Double)"),
        ("ByteOrder = Lsb", "ByteOrder = Msb", "ByteOrder = Lsb"),
    ],
)
def test_a_faulty_cube_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(cube(tmp_path, (old, new)))


# --- times of lines


def test_the_last_line_ends_when_isis_says(shared_data: Path, tmp_path: Path) -> None:
    """CkTableStartTime and CkTableEndTime of the real cube are the edges of its first and last line, to 1e-5 s."""
    text = (shared_data / FOLDER / "h5270_0000_ir2_isis3.lbl").read_text()
    first, last = (float(text.split(f"CkTable{end}Time")[1].split()[1]) for end in ("Start", "End"))
    times = times_of(cube(tmp_path))
    assert times.start == pytest.approx(first, abs=1e-5)
    assert times.stop == pytest.approx(last, abs=1e-5)
    at, period = times.timing(times.start).at(np.array([LINES - 1.0, LINES]))
    assert at[1] == pytest.approx(last - times.start, abs=1e-5)
    np.testing.assert_allclose(period, CHANGES[2][1], rtol=1e-12)


def test_two_rates_join_at_the_change(tmp_path: Path) -> None:
    """Recorded times stand at the changes, and the lines' times run through them; rates are the exposures to 2%."""
    timing = times_of(cube(tmp_path)).timing(START)
    first = np.array([change[2] - 1.0 for change in CHANGES])
    just_before, _ = timing.at(np.nextafter(first[1:], 0.0))
    at, period = timing.at(first)
    np.testing.assert_allclose(just_before, at[1:], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(at, np.array([change[0] for change in CHANGES]) - START)
    np.testing.assert_allclose(period, [change[1] for change in CHANGES], rtol=0.02)
    assert period[0] == pytest.approx(CHANGES[0][1], rel=1e-6)
    np.testing.assert_allclose(timing.lines(at), first, rtol=0, atol=1e-9)


def test_table_and_text_are_the_same(tmp_path: Path) -> None:
    path = cube(tmp_path)
    table, text = times_of(path), times_of(path, times_file(tmp_path))
    for name in ("first_lines", "starts", "periods"):
        np.testing.assert_array_equal(getattr(table, name), getattr(text, name))


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    exposures=st.lists(st.sampled_from([8.96, 12.8, 13.25]), min_size=20, max_size=20),
    pause=st.one_of(st.none(), st.integers(1, 19)),
    noise=st.floats(0.0, 0.1),
)
def test_every_line_is_at_the_time_of_its_prefix(
    tmp_path: Path, exposures: list[float], pause: int | None, noise: float
) -> None:
    """Changes of the rate, a pause of three lines and clocks uneven by up to a tenth of a line included."""
    waits = np.array(exposures[:-1]) * 1e-3
    if pause is not None:
        waits[pause - 1] *= 4.0
    times = START + np.concatenate([[0.0], np.cumsum(waits)])
    uneven = times + 0.5 * noise * 8.96e-3 * (-1.0) ** np.arange(20)
    path = tmp_path / "H5270_0000_IR2.IMG"
    path.write_bytes(image_bytes(uneven.tolist(), exposures))
    got = times_of(path, stop=float(times[-1]))
    at, _ = got.timing(START).at(np.arange(20.0))
    np.testing.assert_allclose(at, uneven - START, rtol=0, atol=noise * 8.96e-3 + 3e-6)  # exposures are float32
    assert got.last == pytest.approx(uneven[-1], abs=noise * 8.96e-3 + 3e-6)
    if pause is not None:
        after, _ = got.timing(START).at(np.array([pause - 1e-9, float(pause)]))
        assert after[1] - after[0] == pytest.approx(waits[pause - 1] * 0.75, abs=2 * noise * 8.96e-3 + 3e-6)


def test_the_mean_of_a_label(tmp_path: Path) -> None:
    """STOP_TIME is when the last line begins; the middle of h5270 is then 1.6 s late."""
    mean = times_of(cube(tmp_path), "mean")
    assert mean.periods[0] == pytest.approx((STOP_OF_H5270 - START) / (LINES - 1), rel=1e-12)
    assert mean.last == pytest.approx(STOP_OF_H5270, abs=1e-6)
    true = times_of(cube(tmp_path)).timing(START)
    late = mean.timing(START).at(np.array([6665.0]))[0] - true.at(np.array([6665.0]))[0]
    assert late[0] == pytest.approx(1.587, abs=1e-3)


first, second, third = CHANGES


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (((first[0], 12.8, 1),), "a line rate of 12800 ms per line from line 1 on; expected 1 .. 500 ms"),
        ((first, third, second), "changes at lines 1, 6666, 6665; expected lines from 1 up to 15088"),
        ((first, (first[0] + 1.0, 0.0128, 6665)), "line 6665 begins 6.59e+03 lines before the one ahead"),
        (((first[0] - 25000.0, 0.0130389, 1),), "-25000.000 s off the label's START_TIME"),
        (((first[0], 0.0132, 1),), "+2.429 s off the label's STOP_TIME"),
        ((), "changes at lines none; expected lines from 1"),
    ],
)
def test_line_times_that_make_no_sense(
    tmp_path: Path, changes: tuple[tuple[float, float, float], ...], said: str
) -> None:
    assert said in refused(cube(tmp_path), times_file(tmp_path, changes))


def test_prefixes_that_are_none(tmp_path: Path) -> None:
    """NaN, a signalling one for an exposure (warnings are errors here), and times of another clock."""
    times = START + 0.0128 * np.arange(20)
    times[7] = np.nan
    assert "prefix of line 8: nan s and 0.0128 s" in refused(written(tmp_path, times=times), stop=STOP)
    path = written(tmp_path)
    damaged = bytearray(path.read_bytes())
    damaged[11 * 512 + 8 : 11 * 512 + 11] = b"\1\0\x80"
    path.write_bytes(damaged[: 11 * 512 + 11] + b"\x7f" + damaged[11 * 512 + 12 :])
    assert "prefix of line 8" in refused(path, stop=STOP)
    assert "the label's START_TIME" in refused(written(tmp_path, times=0.0128 * np.arange(20)), stop=STOP)


def test_a_mean_needs_two_lines_and_a_sensible_span(tmp_path: Path) -> None:
    single = written(tmp_path, ("LINES              = 20", "LINES = 1"))
    assert "one line; expected at least" in refused(single, "mean", STOP)
    assert "a line rate of 10353.6 ms per line" in refused(written(tmp_path), "mean")


# --- geometry


MM, DEG = 1e-3, np.pi / 180.0
DETECTOR_IDS = {name: HRSC_HEAD - 1 - k for k, name in enumerate(map(str, DETECTORS))}
PUBLISHED = {
    "S2": (174.80, -59.9927, 0.00011, 2588.7635, -18.94), "RED": (174.61, -49.7678, -0.00004, 2585.3891, -15.9),
    "P2": (174.74, -39.5483, -0.00034, 2589.3140, -12.75), "BLUE": (175.01, -10.2417, 0.00019, 2602.0075, -3.34),
    "NADIR": (175.01, -0.0055, -0.00006, 2597.3376, 0.0), "GREEN": (175.23, 10.2130, 0.00095, 2598.8432, 3.34),
    "P1": (174.80, 39.5531, 0.00021, 2597.1421, 12.75), "IR": (174.82, 49.7918, 0.00044, 2594.8517, 15.9),
    "S1": (174.87, 59.9869, 0.00048, 2595.9317, 18.94),
}  # fmt: skip
"""Of each line: focal length and Y0 in mm, theta in rad, So in pixels (table in hrscAddendum004.ti), and the angle from
nadir in degrees, ahead positive (ISIS and ALE's numbers; the stereo angle of the instrument kernel is 18.9)."""


@pytest.fixture(autouse=True)
def _empty_pool() -> Iterator[None]:
    spiceypy.kclear()
    yield
    assert spiceypy.ktotal("ALL") == 0


@pytest.fixture(scope="module")
def label(shared_data: Path) -> Path:
    return shared_data / FOLDER / "h5270_0000_ir2_pds3.lbl"


@pytest.fixture(scope="module")
def times(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return times_file(tmp_path_factory.mktemp("times"))


@pytest.fixture(scope="module")
def image(label: Path, shared_data: Path, times: Path) -> PushbroomImage:
    return read_labelled_image(label, kernels(shared_data), interval=0.1, line_times=times)


@pytest.fixture(scope="module")
def labels(label: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The real label in the name of each line."""
    folder, text = tmp_path_factory.mktemp("labels"), label.read_text()
    paths = [folder / f"{name}.lbl" for name in DETECTORS]
    for name, path in zip(DETECTORS, paths, strict=True):
        path.write_text(text.replace("MEX_HRSC_IR", f"MEX_HRSC_{name}"))
    return paths


@pytest.fixture(scope="module")
def strip(labels: Sequence[Path], shared_data: Path, times: Path) -> dict[str, PushbroomImage]:
    images = read_pass_images(labels, kernels(shared_data), DETECTORS, line_times=[times] * 9)
    return {image.name: image for image in images}


# --- the trajectory


def sampled(image: PushbroomImage) -> Trajectory:
    assert isinstance(image.trajectory, Trajectory)
    return image.trajectory


def spice_poses(times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n, 3) in m in J2000 and in IAU_MARS, and rotations (n, 3, 3) IAU_MARS to camera, by SPICE alone."""
    inertial, fixed = (
        np.array([spiceypy.spkpos("MEX", time, frame, "NONE", "MARS")[0] for time in times]) * 1e3
        for frame in ("J2000", "IAU_MARS")
    )
    return inertial, fixed, np.stack([spiceypy.pxform("IAU_MARS", "MEX_HRSC_HEAD", time) for time in times])


def test_at_the_nodes_it_is_spice(image: PushbroomImage, shared_data: Path) -> None:
    """1e-6 m and 1e-9 rad, body-fixed; it is 3e-9 m and 1e-15 rad."""
    trajectory = sampled(image)
    since = np.intersect1d(trajectory.position.times, trajectory.camera.times)[::10]
    assert since.size > 150
    with loaded(kernels(shared_data)):
        _, fixed, pointing = spice_poses(since + trajectory.epoch)
    pose = trajectory.pose(since)
    assert np.abs(pose.position - fixed).max() < 1e-6
    assert turned(pose.matrix, pointing) < 1e-9


def test_between_the_nodes(image: PushbroomImage, shared_data: Path) -> None:
    """Inertial positions to 1e-6 m with nodes at 0.1 s. Body-fixed ones scatter by 2e-5 m in SPICE itself, which turns
    Mars by the 1e6 degrees since J2000, in one float64 of degrees; attitude by 3e-11 rad, as the clock's ticks do.
    """
    trajectory = sampled(image)
    edges = image.timing.at(np.array([0.0, LINES]))[0] + trajectory.epoch
    times = np.random.default_rng(7).uniform(edges[0], edges[1], 300)
    with loaded(kernels(shared_data)):
        free, fixed, pointing = spice_poses(times)
    since = times - trajectory.epoch
    pose = trajectory.pose(since)
    assert np.abs(trajectory.position.at(since)[0] - free).max() < 1e-6
    assert np.abs(pose.position - fixed).max() < 5e-5
    assert turned(pose.matrix, pointing) < 1e-9


def test_the_mount_is_that_of_the_real_cube(image: PushbroomImage, shared_data: Path) -> None:
    """ConstantRotation in the ISIS label, from MEX_V16.TF, is what MEX_V14.TF gives here."""
    text = (shared_data / FOLDER / "h5270_0000_ir2_isis3.lbl").read_text()
    words = text.split("ConstantRotation    = (")[1].split(")")[0].replace(",", " ").split()
    np.testing.assert_allclose(sampled(image).camera.constant.ravel(), np.array(words, dtype=float), atol=1e-11)


def test_attitude_is_that_of_ale(image: PushbroomImage) -> None:
    """J2000 to MEX_SC_REF at the three changes of the line rate: support data of DOI-USGS (ISIS3, CubeTests)."""
    quaternions = np.array([
        [-0.34147103254256284, 0.4600620001156389, -0.4826410643063962, -0.662418367068051],
        [-0.3659838104244632, 0.44394513387664625, -0.4497912009709326, -0.6831225689022163],
        [-0.3659874882249891, 0.4439426152453299, -0.4497860930062306, -0.6831255985322837],
    ])  # fmt: skip
    camera = sampled(image).camera
    got, _ = camera.at(np.array([change[0] for change in CHANGES]) - image.trajectory.epoch)
    assert turned(camera.constant.T @ got, rotation.to_matrix(quaternions)) < 1e-9


# --- the nine lines


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_line_is_where_the_kernels_have_it(
    strip: dict[str, PushbroomImage], shared_data: Path, name: str
) -> None:
    """By the addendum's table: focal length; x = 0, y = Y0 at pixel So; the pitch of 7 um turned by theta; pixel 1 on
    the +X side. By the other map: x, y = TRANSX, TRANSY . (1, sample, line), centred; the reader takes its inverse.
    """
    focal, y0, theta, so, _ = PUBLISHED[name]
    interior = strip[name].interior
    assert interior.focal_length == pytest.approx(focal * MM, rel=1e-12)
    samples = np.array([so - 0.5, 0.125, SAMPLES - 0.125]) / [4.0, 1.0, 1.0]  # ISIS counts centres from 1
    place, slope = interior.focal_plane(samples)
    np.testing.assert_allclose(place[0], [0.0, y0 * MM], rtol=0, atol=2e-9)
    along = 4 * 0.007 * MM * np.array([-np.cos(theta), np.sin(theta)])
    np.testing.assert_allclose(slope[0], along, rtol=0, atol=3e-12)  # its sines are rounded: 1e-7 rad of theta
    assert place[1, 0] > 18.0 * MM
    assert interior.sample_summing == 4.0
    with loaded(kernels(shared_data)):
        maps = [pool_numbers(f"INS{DETECTOR_IDS[name]}_TRANS{axis}", 3) for axis in "XY"]
    pixels = 4.0 * samples + 0.5 - 2592.5
    expected = np.stack([one[0] + one[1] * pixels for one in maps], axis=1) * MM
    np.testing.assert_allclose(place, expected, rtol=0, atol=1e-12)


def test_lines_look_ahead_and_back_on_the_ground(strip: dict[str, PushbroomImage], shared_data: Path) -> None:
    """Each line's centre pixel to the ground from one place, and the angle there along the flight from nadir's line."""
    middle = np.array([0.5 * LINES])
    nadir = strip["NADIR"]
    with loaded(kernels(shared_data)):
        time = float(nadir.timing.at(middle)[0][0]) + nadir.trajectory.epoch
        state, _ = spiceypy.spkezr("MEX", time, "IAU_MARS", "NONE", "MARS")
    origin = np.asarray(state[:3]) * 1e3
    down = -origin / np.linalg.norm(origin)
    ahead = state[3:] - (state[3:] @ down) * down
    ahead /= np.linalg.norm(ahead)

    def angle(image: PushbroomImage) -> float:
        ground, _ = image.image_to_ground(middle, np.array([0.5 * SAMPLES]))
        observation = ground[0] - origin
        return float(np.arctan2(observation @ ahead, observation @ down)) / DEG

    got = {name: angle(image) - angle(nadir) for name, image in strip.items()}
    for name, (*_, published) in PUBLISHED.items():
        assert got[name] == pytest.approx(published, abs=0.02), name
    assert got["S1"] == pytest.approx(18.9, abs=0.05)
    assert got["S2"] == pytest.approx(-18.9, abs=0.05)
    assert abs(angle(nadir)) < 0.35  # the camera is mounted 0.334 degrees off


def test_there_and_back(strip: dict[str, PushbroomImage]) -> None:
    axes = np.linspace(0, LINES, 21), np.linspace(0, SAMPLES, 5), [-4e3, 8e3]
    lines, samples, heights = (axis.ravel() for axis in np.meshgrid(*axes))
    for name, image in strip.items():
        ground, _ = image.image_to_ground(lines, samples, heights)
        back, _ = image.ground_to_image(ground)
        assert np.abs(back - np.column_stack([lines, samples])).max() < 1e-6, name


def test_all_lines_are_on_one_trajectory(
    labels: list[Path], strip: dict[str, PushbroomImage], shared_data: Path, times: Path
) -> None:
    """A strip's images share the record, and see what they see when they are read alone."""
    assert len({id(image.trajectory) for image in strip.values()}) == 1
    alone = read_labelled_image(labels[0], kernels(shared_data), line_times=times)
    places = np.array([0.0, 7000.3, LINES]), np.array([3.0, 600.0, 1288.0])
    ours, theirs = (image.image_to_ground(*places)[0] for image in (strip["S2"], alone))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-4)


def test_a_strip_spans_lines_taken_at_other_times(
    labels: list[Path], shared_data: Path, times: Path, tmp_path: Path
) -> None:
    """The second image here is the first one's, 3 s later."""
    text = labels[1].read_text().replace("T12:08:53.843Z", "T12:08:56.843Z").replace("T12:12:10.561Z", "T12:12:13.561Z")
    (tmp_path / "late.lbl").write_text(text)
    late = times_file(tmp_path, [(time + 3.0, period, line) for time, period, line in CHANGES])
    one, other = read_pass_images([labels[0], tmp_path / "late.lbl"], kernels(shared_data), line_times=[times, late])
    assert one.trajectory is other.trajectory
    np.testing.assert_allclose(other.timing.start_times - one.timing.start_times, 3.0, rtol=0, atol=1e-7)
    first, last = one.timing.at(np.zeros(1))[0][0], other.timing.at(np.array([LINES]))[0][0]
    assert one.trajectory.coverage == pytest.approx((first - 2.0, last + 2.0), abs=1e-6)


def test_the_footprint_is_the_archives(image: PushbroomImage) -> None:
    """Corners as in FOOTPRINT_POINT_... of the label (DLR's own, on other terrain): within 0.03 degrees, 1.8 km."""
    corners = [(0.0, 0.0), (0.0, SAMPLES), (LINES, SAMPLES), (LINES, 0.0)]
    published = [(78.2107, 25.9975), (76.9405, 25.9916), (76.9246, 13.0429), (78.2514, 13.0306)]
    ground, _ = image.image_to_ground(*np.array(corners).T)
    np.testing.assert_allclose(planetocentric(ground)[:, :2] / DEG, published, rtol=0, atol=0.03)


# --- what is missing or wrong


def test_the_addendum_must_come_after_the_instrument_kernel(label: Path, shared_data: Path, times: Path) -> None:
    """Both call the focal length the same, and 175 mm would be taken for 174.82 without a word."""
    turned_round = kernels(shared_data, ["hrscAddendum004.ti", "MEX_HRSC_V03.TI"])
    refuses("175 mm, the instrument kernel's", read_labelled_image, label, turned_round, line_times=times)


def test_settings_are_heard(label: Path, shared_data: Path, times: Path, image: PushbroomImage) -> None:
    said = {"focal_length": 0.1749, "attitude_bias": 0.1, "position_bias": 0.2}
    moved = read_labelled_image(label, kernels(shared_data), "IR/5270", times, **said)  # type: ignore[arg-type]
    assert (moved.name, image.name) == ("IR/5270", "H5270_0000_IR2.IMG")
    assert moved.interior.focal_length == 0.1749
    apart = moved.pose(np.array([7000.0])).position - image.pose(np.array([7000.0])).position
    assert np.linalg.norm(apart) == pytest.approx(0.2 * 4234.0, rel=0.01)


def test_strips_that_do_not_belong_together(labels: list[Path], shared_data: Path, tmp_path: Path) -> None:
    refuses("1 names and 0 line times for 9 labels", read_pass_images, labels, kernels(shared_data), ["one"])
    other = tmp_path / "BLUE.lbl"
    other.write_text(labels[3].read_text().replace("= MARS\n", "= PHOBOS\n"))
    with pytest.raises(InputError, match=r"BLUE\.lbl: an image of PHOBOS; expected one of MARS"):
        read_pass_images([labels[0], other], kernels(shared_data))


# --- in a case


def in_case(shared_data: Path, label: Path, folder: Path, **more: object) -> PushbroomImage:
    """As a case reads it."""
    names = tuple(str(path) for path in kernels(shared_data))
    given = ImageInput(name="h5270", label=str(label), kernels=names, **more)  # type: ignore[arg-type]
    return read_image(given, None, folder, "here")


def test_a_case_knows_the_instrument_by_the_label(
    label: Path, image: PushbroomImage, shared_data: Path, times: Path
) -> None:
    for kind in ("pds3", "isis3"):
        found = label.with_name(f"h5270_0000_ir2_{kind}.lbl")
        got = in_case(shared_data, found, times.parent, line_times=times.name)
        places = np.array([0.0, 9000.0]), np.array([5.0, 900.0])
        ground, expected = got.image_to_ground(*places)[0], image.image_to_ground(*places)[0]
        np.testing.assert_allclose(ground, expected, rtol=0, atol=1e-4)
    assert in_case(shared_data, label, times.parent, line_times="mean").timing.periods.size == 1
    with pytest.raises(InputError, match="line times for MGS MOC-NA; expected none"):
        in_case(shared_data, shared_data / "mgs_moc_m0402852" / "m0402852_isis.lbl", times.parent, line_times="mean")
