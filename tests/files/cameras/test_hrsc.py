"""HRSC's nine lines: constants against the kernels' tables, trajectory against SPICE, places against publications."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from mex import CHANGES, FOLDER, LINES, SAMPLES, kernels, times_file

from mgsgraph.case.case_file import read_image
from mgsgraph.case.schema import ImageInput
from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import DETECTORS, HRSC_HEAD
from mgsgraph.files.labels.kernels import loaded, pool_numbers
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory

MM, DEG = 1e-3, np.pi / 180.0
DETECTOR_IDS = {name: HRSC_HEAD - 1 - k for k, name in enumerate(DETECTORS)}
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


@pytest.fixture
def label(shared_data: Path) -> Path:
    return shared_data / FOLDER / "h5270_0000_ir2_pds3.lbl"


@pytest.fixture
def image(label: Path, shared_data: Path, tmp_path: Path) -> PushbroomImage:
    return read_labelled_image(label, kernels(shared_data), interval=0.1, line_times=times_file(tmp_path))


@pytest.fixture
def labels(label: Path, tmp_path: Path) -> list[Path]:
    """The real label in the name of each line."""
    text = label.read_text()
    paths = [tmp_path / f"{name}.lbl" for name in DETECTORS]
    for name, path in zip(DETECTORS, paths, strict=True):
        path.write_text(text.replace("MEX_HRSC_IR", f"MEX_HRSC_{name}"))
    return paths


@pytest.fixture
def strip(labels: Sequence[Path], shared_data: Path, tmp_path: Path) -> dict[str, PushbroomImage]:
    times, given = times_file(tmp_path), kernels(shared_data)
    return {name: read_labelled_image(label, given, name, times) for label, name in zip(labels, DETECTORS, strict=True)}


def turned(one: np.ndarray, other: np.ndarray) -> float:
    """rad, largest angle between rotations (n, 3, 3)."""
    return float(np.linalg.norm(rotation.logarithm(one @ np.swapaxes(other, 1, 2)), axis=1).max())


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


@pytest.mark.parametrize(("interval", "inertial"), [(0.1, 1e-6), (5.0, 5e-5)])
def test_between_the_nodes(
    label: Path, shared_data: Path, tmp_path: Path, interval: float, inertial: float
) -> None:
    """Inertial positions to 1e-6 m with nodes at 0.1 s. Body-fixed ones scatter by 2e-5 m in SPICE itself, which turns
    Mars by the 1e6 degrees since J2000, in one float64 of degrees; attitude by 3e-11 rad, as the clock's ticks do.
    """
    image = read_labelled_image(label, kernels(shared_data), interval=interval, line_times=times_file(tmp_path))
    trajectory = sampled(image)
    edges = image.timing.at(np.array([0.0, LINES]))[0] + trajectory.epoch
    times = np.random.default_rng(7).uniform(edges[0], edges[1], 300)
    with loaded(kernels(shared_data)):
        free, fixed, pointing = spice_poses(times)
    since = times - trajectory.epoch
    pose = trajectory.pose(since)
    assert np.abs(trajectory.position.at(since)[0] - free).max() < inertial
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
def test_a_line_is_where_the_addendum_has_it(strip: dict[str, PushbroomImage], name: str) -> None:
    """Focal length; x = 0, y = Y0 at pixel So; the pitch of 7 um turned by theta. Pixel 1 is on the +X side."""
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


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_line_is_where_the_kernels_other_map_has_it(
    strip: dict[str, PushbroomImage], shared_data: Path, name: str
) -> None:
    """x, y = TRANSX, TRANSY . (1, sample, line), centred; the reader takes the inverse, ITRANSS and ITRANSL."""
    with loaded(kernels(shared_data)):
        maps = [pool_numbers(f"INS{DETECTOR_IDS[name]}_TRANS{axis}", 3) for axis in "XY"]  # type: ignore[index]
    samples = np.linspace(0.0, SAMPLES, 9)
    pixels = 4.0 * samples + 0.5 - 2592.5
    expected = np.stack([one[0] + one[1] * pixels for one in maps], axis=1) * MM
    np.testing.assert_allclose(strip[name].interior.focal_plane(samples)[0], expected, rtol=0, atol=1e-12)


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


@pytest.mark.parametrize("name", PUBLISHED)
def test_there_and_back(strip: dict[str, PushbroomImage], name: str) -> None:
    image = strip[name]
    axes = np.linspace(0, LINES, 61), np.linspace(0, SAMPLES, 5), [-4e3, 8e3]
    lines, samples, heights = (axis.ravel() for axis in np.meshgrid(*axes))
    ground, _ = image.image_to_ground(lines, samples, heights)
    back, _ = image.ground_to_image(ground)
    assert np.abs(back - np.column_stack([lines, samples])).max() < 1e-6


def test_the_footprint_is_the_archives(image: PushbroomImage) -> None:
    """Corners as in FOOTPRINT_POINT_... of the label (DLR's own, on other terrain): within 0.03 degrees, 1.8 km."""
    corners = [(0.0, 0.0), (0.0, SAMPLES), (LINES, SAMPLES), (LINES, 0.0)]
    published = [(78.2107, 25.9975), (76.9405, 25.9916), (76.9246, 13.0429), (78.2514, 13.0306)]
    ground, _ = image.image_to_ground(*np.array(corners).T)
    np.testing.assert_allclose(planetocentric(ground)[:, :2] / DEG, published, rtol=0, atol=0.03)


# --- what is missing or wrong


def refused(label: Path, given: list[Path], folder: Path, **more: object) -> str:
    """What is said of an image that is refused, in one line that names its label."""
    with pytest.raises(InputError) as caught:
        read_labelled_image(label, given, line_times=times_file(folder), **more)  # type: ignore[arg-type]
    assert str(label) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_addendum_must_come_after_the_instrument_kernel(label: Path, shared_data: Path, tmp_path: Path) -> None:
    """Both call the focal length the same, and 175 mm would be taken for 174.82 without a word."""
    turned_round = kernels(shared_data, ["hrscAddendum004.ti", "MEX_HRSC_V03.TI"])
    assert "175 mm, the instrument kernel's" in refused(label, turned_round, tmp_path)


def test_settings_are_heard(label: Path, shared_data: Path, tmp_path: Path) -> None:
    times, given = times_file(tmp_path), kernels(shared_data)
    image = read_labelled_image(
        label, given, "IR/5270", times, focal_length=0.1749, attitude_bias=0.1, position_bias=0.2
    )
    plain = read_labelled_image(label, given, line_times=times)
    assert (image.name, plain.name) == ("IR/5270", "H5270_0000_IR2.IMG")
    assert image.interior.focal_length == 0.1749
    moved = image.pose(np.array([7000.0])).position - plain.pose(np.array([7000.0])).position
    assert np.linalg.norm(moved) == pytest.approx(0.2 * 4234.0, rel=0.01)


# --- in a case


def entry(shared_data: Path, label: Path | str, **more: object) -> ImageInput:
    names = tuple(str(path) for path in kernels(shared_data))
    return ImageInput(name="h5270", label=str(label), kernels=names, **more)  # type: ignore[arg-type]


def test_a_case_knows_the_instrument_by_the_label(label: Path, image: PushbroomImage, tmp_path: Path) -> None:
    times_file(tmp_path)
    shared = label.parent.parent
    for kind in ("pds3", "isis3"):
        found = label.with_name(f"h5270_0000_ir2_{kind}.lbl")
        got = read_image(entry(shared, found, line_times="line_times.csv"), None, tmp_path, "here")
        places = np.array([0.0, 9000.0]), np.array([5.0, 900.0])
        ground, expected = got.image_to_ground(*places)[0], image.image_to_ground(*places)[0]
        np.testing.assert_allclose(ground, expected, rtol=0, atol=1e-4)
        rough = read_image(entry(shared, found, line_times="mean"), None, tmp_path, "here")
        assert rough.timing.periods.size == 1


def test_a_case_says_what_is_wrong_with_a_label(label: Path, shared_data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a label without the times of its lines"):
        read_image(entry(shared_data, label), None, tmp_path, "here")
    other = tmp_path / "ctx.lbl"
    other.write_text(label.read_text().replace("= HRSC\n", "= OMEGA\n"))
    with pytest.raises(InputError, match=r"ctx\.lbl: the camera 'OMEGA'; expected one of those known by PDS3 labels"):
        read_image(entry(shared_data, other), None, tmp_path, "here")
    moc = shared_data / "mgs_moc_m0402852" / "m0402852_isis.lbl"
    with pytest.raises(InputError, match="line times for MGS MOC-NA; expected none"):
        read_image(entry(shared_data, moc, line_times="mean"), None, tmp_path, "here")
