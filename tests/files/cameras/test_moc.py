"""MOC images: labels of both kinds, geometry against SPICE and ISIS's formulas, pixels; faults said in one line."""

import sys
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from mgs import LABEL, START, STOP, changed, image_bytes, kernels
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import NaifKeywords
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.kernels import clock_time, loaded
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.pvl import read_label
from mgsgraph.files.rasters.pictures import PixelArea, pixel_area, read_moc_pixels, require_fragments
from mgsgraph.results.figures.registration import pixels_of

PITCH, FOCAL = 0.0131240578522949e-3, 3.5
"""m, of the ISIS addendum."""


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    path = folder / "M0402852.IMG"
    path.write_bytes(image_bytes(changed(LABEL, changes)))
    return path


def changed_cube(isis_label: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    path = folder / "changed.lbl"
    path.write_text(changed(isis_label.read_text(), changes))
    return path


@pytest.fixture
def isis_label(shared_data: Path) -> Path:
    return shared_data / "mgs_moc_m0402852" / "m0402852_isis.lbl"


# --- labels


def test_pds_label(tmp_path: Path) -> None:
    path = written(tmp_path)
    got, area = read_line_scan_label(path), pixel_area(path, read_label(path))
    assert (got.camera.name, got.product, got.target) == ("MGS MOC-NA", "M04/02852", "MARS")
    assert (got.lines, got.samples, got.first_sample, got.sample_summing) == (6, 256, 512, 2)
    assert got.period == pytest.approx(4 * 4.821e-4, rel=1e-15)
    assert got.start == "619971158:28"
    assert (area.offset, area.encoding) == (2048, "")


def test_isis_label(isis_label: Path) -> None:
    got = read_line_scan_label(isis_label)
    assert (got.camera.name, got.product, got.target) == ("MGS MOC-NA", "M04/02852", "MARS")
    assert (got.lines, got.samples, got.first_sample, got.sample_summing) == (1536, 256, 0, 8)
    assert got.lines * got.period == pytest.approx(STOP - START, abs=1e-7)


def test_real_pds_labels_of_both_encodings(shared_data: Path) -> None:
    paths = [shared_data / "mgs_moc_pair" / f"M0100115.{end}" for end in ("imq", "img")]
    said = read_line_scan_label(paths[0])
    assert (said.product, said.lines, said.samples, said.sample_summing) == ("M01/00115", 4864, 672, 3)
    packed, plain = (pixel_area(path, read_label(path)) for path in paths)
    assert (packed.encoding, packed.offset) == ("MOC-PRED-X-5", 2048)
    assert (plain.encoding, plain.offset) == ("", 4 * 672)


def test_the_published_start_and_length_of_a_real_image(shared_data: Path) -> None:
    """M01/00115: ET -20723097.688171, 7.034798 s (NASA Ames StereoPipeline, TestPEDR)."""
    label = read_line_scan_label(shared_data / "mgs_moc_pair" / "M0100115.img")
    with loaded(kernels(shared_data)):
        assert clock_time(-94, label.start) == pytest.approx(-20723097.688171, abs=2e-6)
    # their length counts from the first line's centre to the last one's
    assert (label.lines - 0.5) * label.period == pytest.approx(7.034798, abs=1e-3)


@pytest.mark.parametrize("pointer", ['"m0402852.img"', '("M0402852.IMG", 9)', '("M0402852.IMG", 2049 <BYTES>)'])
def test_detached_label(tmp_path: Path, pointer: str) -> None:
    whole = image_bytes()
    body = whole[2048:] if "," not in pointer else bytes(2048) + whole[2048:]
    (tmp_path / "M0402852.IMG").write_bytes(body)
    (tmp_path / "M0402852.LBL").write_text(LABEL.replace("^IMAGE = 9", f"^IMAGE = {pointer}"))
    for asked in ("LBL", "IMG"):
        got = read_moc_pixels(tmp_path / f"M0402852.{asked}")
        np.testing.assert_array_equal(got[:, 0], np.arange(6))
        assert got.shape == (6, 256)


def test_wide_angles_are_told_by_their_filter(tmp_path: Path) -> None:
    wide = ('INSTRUMENT_ID = "MOC-NA"', 'INSTRUMENT_ID = "MOC-WA"\nFILTER_NAME = BLUE')
    red = wide[0], wide[1].replace("BLUE", "RED")
    codes = [read_line_scan_label(written(tmp_path, change)).camera.instrument for change in (wide, red)]
    assert codes == [-94033, -94032]
    uneven = ("CROSSTRACK_SUMMING = 2", "CROSSTRACK_SUMMING = 27")
    assert "which changes along the detector" in refused(written(tmp_path, wide, uneven))


CONSTANTS = NaifKeywords("the addendum", {
    "INS-94031_FOCAL_LENGTH": 3500.0, "INS-94031_ITRANSL": (0.0, 76.2, 0.0), "INS-94031_ITRANSS": (0.0, 0.0, 76.2),
})  # fmt: skip


def used(path: Path) -> None:
    label = read_line_scan_label(path)
    label.camera.interior(CONSTANTS, label)
    read_moc_pixels(path)


def refused(path: Path) -> str:
    """What is said of a label whose image can't be used, in one line that begins with its file."""
    with pytest.raises(InputError) as caught:
        used(path)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("LINE_EXPOSURE_DURATION = 0.482100 <MILLISECONDS>\n", "", "no LINE_EXPOSURE_DURATION"),
        ("0.482100", "-0.4821", "-0.0019284 s; expected a positive line period"),
        ("<MILLISECONDS>", "<HOURS>", "the unit <hours>"),
        ("DOWNTRACK_SUMMING = 4", "DOWNTRACK_SUMMING = 9", "9; expected 1 .. 8"),
        ("CROSSTRACK_SUMMING = 2", "CROSSTRACK_SUMMING = 7", "from 513 on end at 2304"),
        ('EDIT_MODE_ID = "512"', 'EDIT_MODE_ID = "-16"', "-16; expected a whole number of detector"),
        ('"MOC-NA"', '"M3"', "M3 is not known by labels; expected one of those known by PDS3 labels: MGS MOC-NA"),
        ('"MOC-NA"', '"MARCI"', "MARCI is a push-frame camera; expected an image of a line scanner"),
        ("^IMAGE = 9", '^IMAGE = ("LOST.IMG", 1)', "the file LOST.IMG, which is not there"),
        ("SAMPLE_BITS = 8", "SAMPLE_BITS = 16", "16; expected 8"),
    ],
)
def test_a_faulty_label_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(written(tmp_path, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("FirstLineSample       = 1", "FirstLineSample       = 2", "end at 2049"),
        ("= 1999-08-24T14:12:13.64", "= 1999-08-24T14:12:11.64", "which is 1.995 s after the label"),
    ],
)
def test_a_faulty_cube_label_is_refused(
    isis_label: Path, shared_data: Path, tmp_path: Path, old: str, new: str, said: str
) -> None:
    refuses(said, read_labelled_image, changed_cube(isis_label, tmp_path, (old, new)), kernels(shared_data))
    projected = ("  Group = BandBin", "  Group = Mapping\n  End_Group\n  Group = BandBin")
    assert "a map-projected cube" in refused(changed_cube(isis_label, tmp_path, projected))


# --- geometry


def test_line_times_of_the_published_image(isis_label: Path, shared_data: Path) -> None:
    image = read_labelled_image(isis_label, kernels(shared_data))
    assert (image.name, image.lines, image.samples) == ("M04/02852", 1536, 256)
    times, periods = image.timing.at(np.array([0.0, 0.5, 1536.0]))
    epoch = image.trajectory.epoch
    np.testing.assert_allclose(times + epoch, [START, START + 0.5 * 0.0038568, STOP], rtol=0, atol=1e-7)
    np.testing.assert_allclose(periods, 8 * 0.4821e-3, rtol=1e-12)


def spice_ground(time: float, detector_pixel: float) -> np.ndarray:
    """Where ISIS's look vector of a detector pixel (counted from 1) meets Mars, by SPICE throughout; m."""
    look = np.array([0.0, PITCH * (detector_pixel - 1024.5), FOCAL])
    attitude, _ = spiceypy.ckgp(-94000, spiceypy.sce2c(-94, time - 1.15), 1.0, "J2000")
    mount = spiceypy.pxform("MGS_MOC_NA", "MGS_SPACECRAFT", time)
    inertial = attitude.T @ mount @ look
    # sincpt would turn a J2000 direction at its own epoch, too: no aberration, so that is the same moment
    point, _, _ = spiceypy.sincpt("ELLIPSOID", "MARS", time, "IAU_MARS", "NONE", "MGS", "J2000", inertial)
    return np.asarray(point) * 1e3


@pytest.mark.parametrize("edit", [1, 513])
def test_ground_points_are_those_of_spice(isis_label: Path, shared_data: Path, tmp_path: Path, edit: int) -> None:
    """Every formula of ISIS's detector against `sincpt`: summing 4 across and 8 along, edit mode included."""
    changes = [("CrosstrackSumming     = 8", "CrosstrackSumming     = 4"),
               ("FirstLineSample       = 1", f"FirstLineSample       = {edit}")]  # fmt: skip
    image = read_labelled_image(changed_cube(isis_label, tmp_path, *changes), kernels(shared_data))
    lines, samples = np.array([1.0, 700.0, 1536.0]), np.array([1.0, 77.0, 256.0])  # as ISIS counts
    got, _ = image.image_to_ground(lines - 0.5, samples - 0.5)
    with loaded(kernels(shared_data)):
        want = [
            spice_ground(START + (line - 0.5) * 0.0038568, (sample - 1) * 4 + 4 / 2 + 0.5 + (edit - 1))
            for line, sample in zip(lines, samples, strict=True)
        ]
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-3)


def test_constants_of_the_instrument_kernel(isis_label: Path, shared_data: Path) -> None:
    """The kernel's field of view is 2 x 0.0038015622659 wide at distance 1, of 2047 pixels between outer centres."""
    image = read_labelled_image(isis_label, kernels(shared_data), constants="ik", name="mine")
    place, slope = image.interior.focal_plane(np.array([0.0, 256.0]))
    assert image.name == "mine"
    np.testing.assert_allclose(place[:, 1] / image.interior.focal_length, [-3.8034286e-3, 3.8034286e-3], rtol=1e-6)
    np.testing.assert_allclose(slope[:, 1], 8 * 13e-6, rtol=1e-12)
    widened = read_labelled_image(isis_label, kernels(shared_data)).interior.focal_plane(np.array([256.0]))[0]
    assert widened[0, 1] / place[1, 1] == pytest.approx(3500.0 / 3466.916, rel=1e-6)


def test_focal_length_in_either_unit(isis_label: Path, shared_data: Path) -> None:
    given = kernels(shared_data, ("mocAddendum004.ti", "moc20.ti"))
    assert read_labelled_image(isis_label, given).interior.focal_length == pytest.approx(3.5, rel=1e-15)
    assert read_labelled_image(isis_label, given, focal_length=3.437).interior.focal_length == 3.437


def test_biases_reach_the_trajectory(isis_label: Path, shared_data: Path) -> None:
    """1.15 s of attitude tag at 8.7e-4 rad/s turn the camera by a milliradian; the position does not care."""
    given = kernels(shared_data)
    plain, unbiased = (read_labelled_image(isis_label, given, attitude_bias=bias) for bias in (-1.15, 0.0))
    line = np.array([700.0])
    product = plain.pose(line).matrix[0] @ unbiased.pose(line).matrix[0].T
    assert np.arccos(0.5 * (np.trace(product) - 1.0)) == pytest.approx(1.0e-3, rel=0.02)
    np.testing.assert_array_equal(plain.pose(line).position, unbiased.pose(line).position)


def test_missing_camera_constants(isis_label: Path, shared_data: Path) -> None:
    fewer = [path for path in kernels(shared_data) if not path.name.startswith("mocAdd")]
    refuses(r"no INS-94031_ITRANSL", read_labelled_image, isis_label, fewer)


# --- pixels


def test_pixels_between_prefix_and_suffix(tmp_path: Path) -> None:
    around = ("PREFIX_BYTES = 0", "PREFIX_BYTES = 4"), ("SUFFIX_BYTES = 0", "SUFFIX_BYTES = 2")
    got = read_moc_pixels(written(tmp_path, ("SAMPLES = 256", "SAMPLES = 250"), *around))
    assert (got.shape, got.dtype) == ((6, 250), np.uint8)
    np.testing.assert_array_equal(got, np.add.outer(np.arange(6), np.arange(4, 254)).astype(np.uint8))


def test_a_file_shorter_than_its_label(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    refuses("3583 bytes; expected 3584 for 6 lines of 256 samples; it is cut short", read_moc_pixels, path)


def test_compressed_pixels_are_those_of_the_decompressed_file(shared_data: Path) -> None:
    """3.3 million pixels, which pdr decompresses in 3 s: no smaller real image is at hand."""
    pytest.importorskip("pdr", reason="pdr is not installed: pip install mgsgraph[moc]")
    folder = shared_data / "mgs_moc_pair"
    got, want = (read_moc_pixels(folder / f"M0100115.{end}") for end in ("imq", "img"))
    assert got.shape == (4864, 672)
    np.testing.assert_array_equal(got, want)


def test_compressed_pixels_without_pdr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pdr.formats.mgs_moc", None)
    path = written(tmp_path, ("OBJECT = IMAGE\n", "OBJECT = IMAGE\n  ENCODING_TYPE = MOC-PRED-X-5\n"))
    refuses(r'compressed as MOC-PRED-X-5.*pip install "mgsgraph\[moc\]"', read_moc_pixels, path)


def fragment(length: int = 9, size: tuple[int, int] = (2, 3), status: int = 0) -> bytes:
    """A fragment of a compressed image of `size` cells of 16 lines and samples."""
    head = bytearray(62)
    head[6:8] = head[40:42] = size[0].to_bytes(2, "little")
    head[13], head[43], head[44], head[58:62] = status, size[1], 1, length.to_bytes(4, "little")
    return bytes(head) + bytes(length + 1)


def test_fragments_of_compressed_images(tmp_path: Path) -> None:
    """By their headers, before anything is decompressed: the last is there, whole, and of no more pixels than said."""
    path = tmp_path / "a.imq"
    area, last = PixelArea(path, 2048, 0, 0, "MOC-PRED-X-5", 0), fragment(status=2)
    path.write_bytes(bytes(2048) + fragment() + last)
    require_fragments(area, 32, 48)
    for content in (fragment() + fragment(), fragment() + last[:-3], fragment(size=(65535, 3)) + last):
        path.write_bytes(bytes(2048) + content)
        refuses("fetch it again", require_fragments, area, 32, 48)


def test_the_label_of_a_cube_that_is_not_there(isis_label: Path) -> None:
    refuses("the label of a cube; expected the cube", read_moc_pixels, isis_label)
    assert pixels_of(isis_label) is None
