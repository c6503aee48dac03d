"""Cubes with SPICE tables: what was written is read, and the real one agrees with its clock and with other readers."""

import json
from pathlib import Path

import numpy as np
import pytest
from cubes import LINES, MAPPED, PERIOD, START, tables, written
from mgs import kernels

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration, geometric
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.kernels import clock_time, loaded
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.geometry.rotation import exponential
from mgsgraph.units import KM


@pytest.mark.parametrize("order", ["Lsb", "Msb"])
def test_tables_are_read_as_written(tmp_path: Path, order: str) -> None:
    image = read_isis_cube(written(tmp_path, order=order), apparent=True)
    pointing, position = tables()["InstrumentPointing"][1], tables()["InstrumentPosition"][1]

    assert (image.name, image.lines, image.samples) == ("MGS/100:0/MOC-NA", LINES, 64)
    assert image.trajectory.epoch == pytest.approx(START + 0.5 * LINES * PERIOD, abs=1e-9)
    np.testing.assert_array_equal(image.trajectory.position.positions, position[:, :3] * KM)
    np.testing.assert_array_equal(image.trajectory.position.velocities, position[:, 3:6] * KM)
    np.testing.assert_allclose(image.trajectory.camera.quaternions, pointing[:, :4], atol=1e-15)
    np.testing.assert_allclose(image.trajectory.camera.times + image.trajectory.epoch, pointing[:, 7], atol=1e-9)
    np.testing.assert_allclose(image.timing.at(np.array([0.0, 100.0]))[0], [-50 * PERIOD, 50 * PERIOD], atol=1e-9)


def test_the_mount_comes_after_the_spacecraft(tmp_path: Path) -> None:
    """Camera = ConstantRotation times what the quaternions turn to."""
    mount = exponential(np.array([0.002, -0.001, 0.003]))
    said = f"  Name = InstrumentPointing\n  ConstantRotation = ({', '.join(map(repr, mount.ravel().tolist()))})"
    plain = read_isis_cube(written(tmp_path)).pose(np.array([50.0])).matrix
    turned = read_isis_cube(written(tmp_path, ("  Name = InstrumentPointing", said))).pose(np.array([50.0])).matrix
    np.testing.assert_allclose(turned, mount @ plain, atol=1e-12)


def test_positions_are_made_geometric(tmp_path: Path) -> None:
    path = written(tmp_path)
    apparent, image = read_isis_cube(path, apparent=True), read_isis_cube(path)
    velocity = KM * np.array([15.0, -15.0, -8.0])  # the body's about the Sun, opposite to the Sun's about it
    want = geometric(apparent.trajectory.position, velocity, Aberration("LT+S"))
    np.testing.assert_array_equal(image.trajectory.position.positions, want.positions)
    assert np.linalg.norm(want.positions - apparent.trajectory.position.positions, axis=1).min() > 100.0


def test_a_map_gives_the_image_it_was_made_of(tmp_path: Path) -> None:
    """A crop of a map is refused by nobody: its tables are the whole image's."""
    smaller = ("      Lines = 100", "      Lines = 7")
    image = read_isis_cube(written(tmp_path, MAPPED, smaller), name="mine")
    assert (image.name, image.lines, image.samples) == ("mine", LINES, 64)
    with pytest.raises(InputError, match=r"7 of 100 lines"):
        read_isis_cube(written(tmp_path, (MAPPED[0], MAPPED[1].replace("Mapping", "Other")), smaller))


FAULTS: dict[str, tuple[tuple[str, str], str]] = {
    "another camera": (("= MOC-NA", "= MARCI"), "the camera 'MARCI'; expected one of those known by ISIS cubes"),
    "another body": (("= Mars", "= Phobos"), "no NaifKeywords"),
    "other constants": (
        ("End\n", "Object = NaifKeywords\n BODY301_RADII = (3396.19, 3396.19, 3376.2)\nEnd_Object\nEnd\n"),
        "no INS-94031",
    ),
    "no spiceinit": (("Name = InstrumentPointing", "Name = Sun"), "no table InstrumentPointing; expected the tables"),
    "no Sun": (("Name = SunPosition", "Name = Sun"), "no table SunPosition; expected the Sun's velocity"),
    "no quaternions": (("J2000Q0", "J2000Ang1"), "J2000Q0, J2000Q1, J2000Q2, J2000Q3; run spiceinit on the cube"),
    "no velocities": (("Name = J2000XV", "Name = Other"), "J2000XV, J2000YV, J2000ZV"),
    "another image": (("0.482100", "0.521000"), "s from first to last; expected the image's 0.104200 s"),
    "no exposure": (("0.482100", "0.0"), "expected a positive line period"),
    "records": (("Records = 3", "Records = 4"), "168 bytes; expected 4 records of 7 doubles"),
    "integers": (("Type = Double", "Type = Integer"), "a field of 1 Integer; expected one Double"),
    "beyond the end": (("StartByte = 65537", "StartByte = 99999"), "0 bytes from byte 99999 on; expected 192"),
    "a mount that is none": (
        ("  Name = InstrumentPointing", "  Name = InstrumentPointing\n  ConstantRotation = (1,0,0, 0,1,0, 0,0,2)"),
        "a matrix that is no rotation",
    ),
    "not a list": (("  Name = BodyRotation", "  Name = BodyRotation\n  ConstantRotation = 1"), "a list of 9 numbers"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_in_one_line(tmp_path: Path, fault: str) -> None:
    change, said = FAULTS[fault]
    path = written(tmp_path, change)
    with pytest.raises(InputError) as caught:
        read_isis_cube(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("kept", [0, 1, 100, 400, 3000, 65536, 65537, 66000])
def test_a_cube_cut_short(tmp_path: Path, kept: int) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError):
        read_isis_cube(path)


def test_numbers_that_are_none(tmp_path: Path) -> None:
    path = written(tmp_path)
    raw = bytearray(path.read_bytes())
    raw[65536:65544] = np.array([np.nan]).tobytes()
    path.write_bytes(raw)
    with pytest.raises(InputError, match="table InstrumentPointing: values that are no numbers"):
        read_isis_cube(path)


# --- the real one


@pytest.fixture
def cube(shared_data: Path) -> Path:
    return shared_data / "mgs_moc_pair" / "E0201461.tiny.cub"


def test_the_first_line_is_when_the_clock_says(cube: Path, shared_data: Path) -> None:
    """The label's clock count by NAIF's SCLK kernel, which the reader doesn't see."""
    image = read_isis_cube(cube)
    with loaded(kernels(shared_data)):
        want = clock_time(-94, "669329623:36")
    times, _ = image.timing.at(np.zeros(1))
    assert image.trajectory.epoch + times[0] == pytest.approx(want, abs=1e-6)
    assert (image.name, image.lines, image.samples) == ("MGS/669329623:36/MOC-NA/BROAD_BAND", 8064, 1024)


def test_camera_constants_are_those_of_the_kernels(cube: Path, shared_data: Path) -> None:
    """Line of observation of a detector pixel: image of the cube, summed 2, against one by kernels, summed 8."""
    by_tables = read_isis_cube(cube).interior
    label = shared_data / "mgs_moc_m0402852" / "m0402852_isis.lbl"
    by_kernels = read_labelled_image(label, kernels(shared_data)).interior
    pixels = np.linspace(0.0, 2048.0, 9)
    for got, want in zip(by_tables.focal_plane(pixels / 2), by_kernels.focal_plane(pixels / 8), strict=True):
        scale = 4.0 if np.abs(want).max() < 1e-3 else 1.0  # slopes are per sample
        np.testing.assert_allclose(got * scale / by_tables.focal_length, want / by_kernels.focal_length, rtol=1e-9)


def test_tables_are_those_that_were_taken_out_of_it(cube: Path, shared_data: Path) -> None:
    found = json.loads((shared_data / "mgs_moc_pair" / "E0201461_spice_tables.json").read_text())
    image = read_isis_cube(cube, apparent=True)
    position, pointing = (np.array(found[f"Instrument{name}"]["rows"]) for name in ("Position", "Pointing"))
    np.testing.assert_array_equal(image.trajectory.position.positions, position[:, :3] * KM)
    np.testing.assert_allclose(image.trajectory.camera.quaternions, pointing[:, :4], atol=1e-12)
