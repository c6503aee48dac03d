"""Cubes with SPICE tables of all forms: what was written is read; real ones agree with clock and other readers."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spiceypy
from cubes import LINES, MAPPED, PERIOD, START, tables, written
from mgs import kernels
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.kinds import image_kind, image_name
from mgsgraph.files.labels.aberration import Aberration, geometric
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.kernels import clock_time, loaded
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("Name = InstrumentPointing", "Name = Sun"), "no table InstrumentPointing; expected the tables"),
        (("Name = SunPosition", "Name = Sun"), "no table SunPosition; expected the Sun's velocity"),
        (("J2000Q0", "J2000Ang1"), "J2000Q0, J2000Q1, J2000Q2, J2000Q3; run spiceinit on the cube"),
        (("0.482100", "0.521000"), "s from first to last; expected the image's 0.104200 s"),
        (("Records = 3", "Records = 4"), "168 bytes; expected 4 records of 7 doubles"),
        (("StartByte = 65537", "StartByte = 99999"), "0 bytes from byte 99999 on; expected 192"),
        (("  Name = InstrumentPointing", "  Name = InstrumentPointing\n  ConstantRotation = (1,0,0, 0,1,0, 0,0,2)"),
         "a matrix that is no rotation"),
    ],
)  # fmt: skip
def test_faults_are_said_in_one_line(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_isis_cube(written(tmp_path, change))
    assert said in str(caught.value)


def test_numbers_that_are_none(tmp_path: Path) -> None:
    path = written(tmp_path)
    raw = bytearray(path.read_bytes())
    raw[65536:65544] = np.array([np.nan]).tobytes()
    path.write_bytes(raw)
    refuses("table InstrumentPointing: values that are no numbers", read_isis_cube, path)


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


# --- polynomials of jigsaw, JSON, parts of images


STOP = START + LINES * PERIOD
BASE, SCALE = START + 0.3 * LINES * PERIOD, 0.37 * LINES * PERIOD
ANGLES = np.array([[2.16, 1.83, -0.4], [-0.026, -0.024, 0.31], [0.0047, -0.0046, 0.02], [0.021, 0.0064, -0.01]])
PLACES = np.array([[3800.0, 10.0, -20.0], [0.1, -0.2, 0.15], [0.003, 0.001, -0.002]])


def pixels(image: PushbroomImage) -> np.ndarray:
    """(25, 2) lines and samples over the image."""
    lines, samples = np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5)
    return np.stack(np.meshgrid(lines, samples), axis=-1).reshape(-1, 2)


def largest_difference(seen: PushbroomImage, other: PushbroomImage) -> float:
    """Largest distance in pixels between where two images see the ground of 25 pixels of the first."""
    places = pixels(seen)
    ground, _ = seen.image_to_ground(places[:, 0], places[:, 1], 0.0)
    line, sample = other.ground_to_image(ground)[0].T
    return float(np.hypot(line - places[:, 0], sample - places[:, 1]).max())


def of_polynomials(name: str, fields: tuple[str, ...], coefficients: np.ndarray) -> dict:
    last = [BASE, SCALE, len(coefficients) - 1.0]
    return {name: (fields, np.vstack([coefficients, last]))}


def test_angles_of_jigsaw_are_those_of_naif(tmp_path: Path) -> None:
    """SPICE's eul2m about the axes 3, 1, 3, last angle first, at times between nodes."""
    other = of_polynomials("InstrumentPointing", ("J2000Ang1", "J2000Ang2", "J2000Ang3"), ANGLES)
    said = "  Name = InstrumentPointing"
    ends = f"{said}\n  CkTableStartTime = {START!r}\n  CkTableEndTime = {STOP!r}"
    image = read_isis_cube(written(tmp_path, (said, ends), other=other))
    times = np.linspace(START, STOP, 17)[1:-1] + 1e-4
    got, _ = image.trajectory.camera.at(times - image.trajectory.epoch)
    for time, matrix in zip(times, got, strict=True):
        first, second, third = np.polynomial.polynomial.polyval((time - BASE) / SCALE, ANGLES)
        np.testing.assert_allclose(matrix, spiceypy.eul2m(third, second, first, 3, 1, 3), atol=5e-8)


def test_positions_of_jigsaw(tmp_path: Path) -> None:
    other = of_polynomials("InstrumentPosition", ("J2000SVX", "J2000SVY", "J2000SVZ"), PLACES)
    said = "  Name = InstrumentPosition"
    ends = f"{said}\n  CacheType = PolyFunction\n  SpkTableStartTime = {START!r}\n  SpkTableEndTime = {STOP!r}"
    image = read_isis_cube(written(tmp_path, (said, ends), other=other), apparent=True)
    times = np.linspace(START, STOP, 17)[1:-1] + 1e-4
    got, rate = image.trajectory.position.at(times - image.trajectory.epoch)
    want = np.polynomial.polynomial.polyval((times - BASE) / SCALE, PLACES).T * KM
    later = np.polynomial.polynomial.polyval((times + 1e-3 - BASE) / SCALE, PLACES).T * KM
    np.testing.assert_allclose(got, want, atol=1e-6)
    np.testing.assert_allclose(rate, (later - want) / 1e-3, rtol=1e-3, atol=1.0)


def test_a_part_of_an_image_sees_the_same_ground(tmp_path: Path) -> None:
    """ISIS crop: line 31, sample 11 of the whole image is the first pixel of the part."""
    whole = read_isis_cube(written(tmp_path))
    cut = ("  Group = Archive", "  Group = AlphaCube\n    AlphaSamples = 64\n    AlphaLines = 100\n"
           "    AlphaStartingSample = 10.5\n    AlphaEndingSample = 30.5\n    AlphaStartingLine = 30.5\n"
           "    AlphaEndingLine = 70.5\n  End_Group\n  Group = Archive")  # fmt: skip
    smaller = (("      Samples = 64", "      Samples = 20"), ("      Lines = 100", "      Lines = 40"))
    keys = struct.pack("<d", START).hex()
    known = ("End\n", f"Object = NaifKeywords\n BODY499_RADII = (3396.19, 3396.19, 3376.2)\n"
             f" CLOCK_ET_-94_100:0_COMPUTED = {keys}\n INS-94031_FOCAL_LENGTH = 3500.0\n"
             " INS-94031_ITRANSS = (0, 0, 76.1959457398412)\n INS-94031_ITRANSL = (0, 76.1959457398412, 0)\n"
             "End_Object\nEnd\n")  # fmt: skip
    part = read_isis_cube(written(tmp_path, cut, *smaller, ("End_Object\nEnd\n", "End_Object\n" + known[1])))
    assert (part.lines, part.samples) == (40, 20)
    places = pixels(part)
    ours, _ = part.image_to_ground(places[:, 0], places[:, 1], 0.0)
    same, _ = whole.image_to_ground(places[:, 0] + 30.0, places[:, 1] + 10.0, 0.0)
    np.testing.assert_allclose(ours, same, atol=1e-4)


def as_json() -> dict:
    found: dict = {"isis_camera_version": 1, "naif_keywords": {"BODY499_RADII": [3396.19, 3396.19, 3376.2]}}
    found["naif_keywords"] |= {
        "INS-94031_FOCAL_LENGTH": 3500.0, "INS-94031_ITRANSS": [0.0, 0.0, 76.1959457398412],
        "INS-94031_ITRANSL": [0.0, 76.1959457398412, 0.0],
    }  # fmt: skip
    for name, key in (("InstrumentPointing", "instrument_pointing"), ("BodyRotation", "body_rotation")):
        rows = tables()[name][1]
        found[key] = {"quaternions": rows[:, :4].tolist(), "ephemeris_times": rows[:, 7].tolist()}
    for name, key in (("InstrumentPosition", "instrument_position"), ("SunPosition", "sun_position")):
        rows = tables()[name][1]
        found[key] = {"positions": rows[:, :3].tolist(), "velocities": rows[:, 3:6].tolist(),
                      "ephemeris_times": rows[:, 6].tolist()}  # fmt: skip
    return found


def test_json_beside_a_label_is_the_cube(tmp_path: Path) -> None:
    cube, tables_file = written(tmp_path), clocked(tmp_path, START)
    whole = read_isis_cube(cube)
    for path in (tmp_path / "image.pvl", tables_file):
        assert image_kind(path) == "cube"
        assert image_name(path, "cube") == whole.name == "MGS/100:0/MOC-NA"
        assert largest_difference(whole, read_isis_cube(path)) < 1e-9
    (tmp_path / "image.pvl").unlink()
    cube.unlink()
    refuses(r"without its label; expected image.pvl", read_isis_cube, tables_file)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("instrument_position", {"positions": [[1, 2]]}, "instrument_position, positions: numbers of shape"),
        ("naif_keywords", {}, "no INS-94031_"),
    ],
)
def test_json_that_is_no_table(tmp_path: Path, key: str, value: dict[str, Any], said: str) -> None:
    refuses(said, read_isis_cube, clocked(tmp_path, START, **{key: value}))


def test_the_clock_is_eight_bytes(tmp_path: Path) -> None:
    """Time of the label's start as ISIS keeps it: it goes before the table's first time. Of another count, the label is
    another image's; without any, as in older cubes, the tables' own times are taken.
    """
    path = clocked(tmp_path, START + 0.00005)
    image = read_isis_cube(path)
    assert image.trajectory.epoch + image.timing.start_times[0] == pytest.approx(START + 0.00005, abs=1e-9)
    content = json.loads(path.read_text())
    keywords = content["naif_keywords"]
    keywords["CLOCK_ET_-94_101:0_COMPUTED"] = keywords.pop("CLOCK_ET_-94_100:0_COMPUTED")
    path.write_text(json.dumps(content))
    refuses("CLOCK_ET_-94_101:0_COMPUTED; expected CLOCK_ET_-94_100:0_COMPUTED", read_isis_cube, path)
    del keywords["CLOCK_ET_-94_101:0_COMPUTED"]
    path.write_text(json.dumps(content))
    assert read_isis_cube(path).trajectory.epoch > START


def clocked(folder: Path, start: float, *changes: tuple[str, str], **more: dict[str, Any]) -> Path:
    """A cube's tables as JSON whose label's clock count ISIS has read as `start`, s TDB past J2000."""
    content = as_json() | more
    content["naif_keywords"]["CLOCK_ET_-94_100:0_COMPUTED"] = struct.pack("<d", start).hex()
    (folder / "image.pvl").write_bytes(written(folder, *changes).read_bytes().split(b"Object = Table")[0] + b"End\n")
    (folder / "image.isd").write_text(json.dumps(content))
    return folder / "image.isd"


PERIOD_OF_LABEL = "LineExposureDuration = 0.482100"


@pytest.mark.parametrize(
    ("start", "period"), [(START + 0.0002, PERIOD), (START - 0.0002, PERIOD), (START + 5.0, PERIOD),
                          (START, 2 * PERIOD), (START, 0.5 * PERIOD)],
)  # fmt: skip
def test_tables_of_another_image_are_refused_whatever_the_clock(tmp_path: Path, start: float, period: float) -> None:
    stated = (PERIOD_OF_LABEL, f"LineExposureDuration = {500.0 * period!r}")
    refuses("the table is not of this image", read_isis_cube, clocked(tmp_path, start, stated))


def test_tables_agree_within_a_part_of_a_line(tmp_path: Path) -> None:
    """HiRISE's lines take 74 microseconds; 50 off the end of 7.4 ms are two thirds of a line."""
    fields, rows = tables()["InstrumentPosition"]
    label = (PERIOD_OF_LABEL, "LineExposureDuration = 0.037")
    for late, refused in ((0.0, False), (5e-5, True)):
        times = START + np.array([0.0, 0.5, 1.0])[:, None] * (LINES * 74e-6 + late)
        faster = np.ptp(rows[:, 6]) / np.ptp(times) * rows[:, 3:6]
        table = np.hstack([rows[:, :3], faster, times])
        cube = written(tmp_path, label, other={"InstrumentPosition": (fields, table)})
        if refused:
            refuses("the table is not of this image", read_isis_cube, cube)
        else:
            assert read_isis_cube(cube).timing.periods == pytest.approx([74e-6])


def test_tables_that_spiceinit_was_told_to_pad(tmp_path: Path) -> None:
    """ISIS Spice: the group Kernels says by how much (StartPadding, EndPadding)."""
    archive = "  Group = Archive"
    said = f"    StartPadding = 0.0 <seconds>\n    EndPadding = {20 * PERIOD!r} <seconds>\n"
    padded = (archive, f"  Group = Kernels\n{said}  End_Group\n{archive}")
    fewer = ("      Lines = 100", "      Lines = 80")
    assert read_isis_cube(written(tmp_path, padded, fewer)).lines == 80
    refuses("the table is not of this image", read_isis_cube, written(tmp_path, fewer))


def test_where_the_clock_is_missing_a_preroll_is_not_counted_twice(tmp_path: Path, shared_data: Path) -> None:
    """ISIS's tables begin with the first line of LROC, 1,024 lines after the label's clock count."""
    place = shared_data / "lro_nac_hadley" / "observationImageL"
    (tmp_path / "x.pvl").write_bytes(place.with_suffix(".pvl").read_bytes())
    content = json.loads(place.with_suffix(".isd").read_text())
    for key in [key for key in content["naif_keywords"] if key.startswith("CLOCK_ET")]:
        del content["naif_keywords"][key]
    (tmp_path / "x.isd").write_text(json.dumps(content))
    refuses(r"no CLOCK_ET_-85_1/269181999:50462_COMPUTED; .* run spiceinit again", read_isis_cube, tmp_path / "x.pvl")


def test_cubes_say_what_was_done_with_positions(tmp_path: Path) -> None:
    """In the words of support data; geometric ones by a keyword go without."""
    assert "MGS" in read_isis_cube(written(tmp_path)).remarks[0]
    assert "as the case says" in read_isis_cube(written(tmp_path), None, Aberration("NONE")).remarks[0]
    keywords = as_json()["naif_keywords"] | {"INS-94031_LIGHTTIME_CORRECTION": "NONE"}
    assert read_isis_cube(clocked(tmp_path, START, naif_keywords=keywords)).remarks == ()


# --- real ones


def test_wide_angles_see_the_ground_as_isis_does(shared_data: Path) -> None:
    """Measures of this network are candidates: ISIS projected seeded points into the cubes with its own camera, so that
    ours must let them intersect, far from the ellipsoid or not.
    """
    folder = shared_data / "mgs_moc_wa_three"
    images = {image.name: image for image in (read_isis_cube(folder / f"cube{k}.isd") for k in (1, 2, 3))}
    ties = read_control_network(folder / "controlnetwork.net")
    assert set(ties.measure_image) == set(images)
    seeing = [images[name] for name in ties.measure_image]
    rays = [image.sightlines(*place[:, None]) for image, place in zip(seeing, ties.measures, strict=True)]
    origins, directions = (np.concatenate(one) for one in zip(*rays, strict=True))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    places, _, _ = intersect_rays(origins, directions, ties.measure_point, len(ties.ids))
    seen = [image.ground_to_image(places[None, i])[0][0] for image, i in zip(seeing, ties.measure_point, strict=True)]
    assert np.abs(seen - ties.measures).max() < 0.05


FOOTPRINT = np.array([
    [1.4317786218566084, 0.6095425026978355, -1.0, 480.0], [1.0725817324502032, 0.59035409176203, 0.0, 400.5],
    [0.6333705158720591, 0.5645661174075771, 0.0, 300.5], [0.2019133179258006, 0.5356150310380419, 0.0, 200.5],
    [-0.2283928778095, 0.5089446558422063, 0.0, 100.5], [-0.6637864831562, 0.4792397862652102, 0.0, 0.0],
    [-0.7598161526592, 1.215649153671729, -1.0, 0.0], [-0.86865153975486, 2.0293670422097247, -1.0, 0.0],
])  # fmt: skip
"""East longitude and latitude in degrees of vertices of E09/02065's footprint that ISIS made over MOLA's 128 pixels per
degree (DOI-USGS/ISIS3, isis/tests/data/threeImageNetwork/threeImageOverlaps.lis), and the line and sample of the edge
or of every hundredth sample that they stand for; -1 where it stands for none.
"""


def test_wide_angles_footprint_is_that_of_isis(shared_data: Path) -> None:
    """Positions as ISIS takes them; heights by the coarse grid, which is good for a tenth of a pixel here."""
    image = read_isis_cube(shared_data / "mgs_moc_wa_three" / "cube1.isd", apparent=True)
    terrain = read_megdr(shared_data / "mola_megdr" / "megr90n000cb.img")
    places = np.radians(FOOTPRINT[:, :2])
    radii, *_ = terrain.radius(places[:, 0] % (2.0 * np.pi), places[:, 1])
    seen, _ = image.ground_to_image(from_planetocentric(np.column_stack([places, radii])))
    said = FOOTPRINT[:, 2:]
    assert np.abs(seen - said)[said >= 0.0].max() < 0.2


@pytest.mark.parametrize("side", ["L", "R"])
def test_label_and_tables_of_lroc_are_the_support_data_of_isis(shared_data: Path, side: str) -> None:
    """Preroll, line error and the half pixel of the boresight: by the camera's record, and by the file's reader."""
    place = shared_data / "lro_nac_hadley" / f"observationImage{side}"
    by_label = read_isis_cube(place.with_suffix(".pvl"))
    assert by_label.name == f"LRO/1/269182000:51104/NAC{side}"
    assert largest_difference(by_label, read_isd(place.with_suffix(".isd"), "x")) < 1e-3
