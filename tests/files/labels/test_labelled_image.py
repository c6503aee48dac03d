"""Labels and kernels of all cameras whose real kernels are at hand: against ISIS's tables, ALE's and SPICE itself."""

import re
from dataclasses import replace
from pathlib import Path

import mgs
import numpy as np
import pytest
import spiceypy
from outside import refuses
from strategies import turned

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels import labelled_image
from mgsgraph.files.labels.isis_cube import attitude_table, position_table, tables_of_label
from mgsgraph.files.labels.kernels import loaded
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.pvl import read_label
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory

KINDS = (".tls", ".tpc", ".tsc", ".tf", ".ti", ".bsp", ".bc")
CTX, LROC, KAGUYA = "mro_ctx_b10/B10_013341_1010_XN_79S172W", "lro_nac_m103595705/M103595705LE", (
    "kaguya_tc/TC1S2B0_01_06691S820E0465"
)  # fmt: skip


def kernels(shared_data: Path, image: str, without: str = " ") -> list[Path]:
    """All kernels of an image's folder, its addendum last; of the Moon, with those of MOON_ME."""
    folder = (shared_data / image).parent
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in KINDS and without not in path.name)
    if folder.name == "kaguya_tc":
        found += [shared_data / "lro_nac_m103595705" / name for name in ("moon_080317.tf", "moon_assoc_me.tf")]
    if folder.name != "mro_ctx_b10":
        found.append(shared_data / "kernels" / "moon_pa_de421_1900-2050.bpc")
    return sorted(found, key=lambda path: "ddendum" in path.name)


def image_of(shared_data: Path, image: str, kind: str = "pds3", **more: object) -> PushbroomImage:
    label = shared_data / f"{image}_{kind}.lbl"
    return read_labelled_image(label, kernels(shared_data, image), interval=0.1, **more)  # type: ignore[arg-type]


def tables(image: PushbroomImage) -> Trajectory:
    assert isinstance(image.trajectory, Trajectory)
    return image.trajectory


# --- stop times

MOC = "mgs_moc_m0402852/m0402852"
TRUE_LINES = {f"{LROC}_pds3": 52224, f"{CTX}_pds3": 24576, f"{KAGUYA}_pds3": 4656, f"{MOC}_isis": 1536}
"""Of the whole images: their files here have the label's stop time, but 400 lines but for MOC's."""


@pytest.mark.parametrize("image", TRUE_LINES)
def test_lines_end_by_the_stop_time_of_the_label(shared_data: Path, image: str) -> None:
    """True ones do so by 0.01 s; a tenth more, such as a wrong line period would make, are refused."""
    label = read_line_scan_label(shared_data / f"{image}.lbl")
    names = mgs.kernels(shared_data) if image.startswith(MOC) else kernels(shared_data, image)
    with loaded(names):
        words = labelled_image._Constants.of(label, "iak")
        whole = labelled_image._line_times(replace(label, lines=TRUE_LINES[image]), words)
        assert whole.lines == TRUE_LINES[image]
        with pytest.raises(InputError, match="past the stop time"):
            labelled_image._line_times(replace(label, lines=TRUE_LINES[image] * 11 // 10), words)


# --- LROC


def test_lroc_is_where_isis_has_it(shared_data: Path) -> None:
    """Poses at the nodes of the tables that spiceinit made: 1e-5 m, 1e-10 rad (1e-5 pixels). Between these, 67 ms
    apart, the camera turns with the CK's records as ISIS's tables do not: up to 4e-7 rad, 0.04 pixels.
    """
    image = image_of(shared_data, LROC)
    trajectory, cube = tables(image), shared_data / f"{LROC}.cub"
    found = tables_of_label(cube, read_label(cube))
    start = image.timing.start_times[0] + trajectory.epoch
    assert start == pytest.approx(found["InstrumentPosition"].start, abs=1e-7)
    assert image.timing.periods[0] == pytest.approx(1.0288e-3 * 1.0045, rel=1e-12)
    pointing, body = (attitude_table(found[name], trajectory.epoch) for name in ("InstrumentPointing", "BodyRotation"))
    since = pointing.times[:7]
    position = position_table(found["InstrumentPosition"], trajectory.epoch)
    assert np.abs(trajectory.position.at(since)[0] - position.at(since)[0]).max() < 1e-5
    assert turned(trajectory.camera.at(since)[0], pointing.at(since)[0]) < 1e-10
    assert turned(trajectory.body.at(since)[0], body.at(since)[0]) < 1e-9
    between = 0.5 * (since[1:] + since[:-1])
    assert turned(trajectory.camera.at(between)[0], pointing.at(between)[0]) < 5e-7


def test_an_older_frames_kernel_has_the_camera_fixed(shared_data: Path, tmp_path: Path) -> None:
    """As before lro_frames_2014049_v01.tf: no CK of the camera's own is asked for, its angles to the bus stay."""
    older = tmp_path / "lro_frames_2012.tf"
    older.write_text(
        "KPL/FK\n\\begindata\nFRAME_LRO_LROCNACL = -85600\nFRAME_-85600_NAME = 'LRO_LROCNACL'\nFRAME_-85600_CLASS = 4\n"
        "FRAME_-85600_CLASS_ID = -85600\nFRAME_-85600_CENTER = -85\nTKFRAME_-85600_SPEC = 'ANGLES'\n"
        "TKFRAME_-85600_RELATIVE = 'LRO_SC_BUS'\nTKFRAME_-85600_ANGLES = (0.0, 0.0, -1.0)\n"
        "TKFRAME_-85600_AXES = (3, 2, 1)\nTKFRAME_-85600_UNITS = 'DEGREES'\n"
    )
    given = [*kernels(shared_data, LROC, "lrolc_"), older]
    trajectory = tables(read_labelled_image(shared_data / f"{LROC}_pds3.lbl", given))
    camera = trajectory.camera
    with loaded(given):
        want = spiceypy.pxform("LRO_SC_BUS", "LRO_LROCNACL", trajectory.epoch)
    np.testing.assert_allclose(camera.constant, want, rtol=0, atol=1e-15)
    assert np.arccos(0.5 * (np.trace(camera.constant) - 1.0)) == pytest.approx(np.radians(1.0), rel=1e-9)


# --- CTX

ALE_CTX = {
    297088762.24158406: (0.42061124835443375, 0.1860622266332136, -0.23980124331599867, 0.8549633847610767),
    297088762.3917441: (0.42062260840195603, 0.186123564618581, -0.23976950628253949, 0.8549533460089124),
    297088762.9923841: (0.4206714374933977, 0.1863668684529047, -0.23964184692167076, 0.8549121108185723),
}
"""J2000 to MRO_SPACECRAFT (DOI-USGS/ale, ctx_isd.json)."""


def test_ctx_stands_as_ale_has_it(shared_data: Path) -> None:
    image = image_of(shared_data, CTX)
    assert (image.lines, image.samples) == (400, 5000)  # without the 38 + 18 masked ones, as in ISIS
    trajectory, times = tables(image), np.array(list(ALE_CTX))
    assert image.timing.start_times[0] + trajectory.epoch == pytest.approx(times[0], abs=1e-7)
    got, _ = trajectory.camera.at(times - trajectory.epoch)
    assert turned(trajectory.camera.constant.T @ got, rotation.to_matrix(np.array(list(ALE_CTX.values())))) < 1e-10


def test_constants_of_a_cubes_label_stand_in_for_the_addendum(shared_data: Path) -> None:
    """The real cube's NaifKeywords hold what the addendum has; without either, it is named."""
    label, bare = shared_data / f"{CTX}_isis3.lbl", kernels(shared_data, CTX, "mro_ctx_v11")
    image, whole = read_labelled_image(label, bare), image_of(shared_data, CTX, "isis3")
    assert len(image.remarks) == 1
    assert whole.remarks == ()
    places = np.array([0.0, 400.0]), np.array([3.0, 4990.0])
    got, want = (one.image_to_ground(*places)[0] for one in (image, whole))
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)
    refuses(r"no INS-74021_OD_K; .*mroctxAddendum005\.ti", read_labelled_image, shared_data / f"{CTX}_pds3.lbl", bare)
    with pytest.raises(InputError, match=r"constants = 'ik' for MRO CTX; expected 'iak'.*mroctxAddendum005\.ti"):
        image_of(shared_data, CTX, constants="ik")


# --- Kaguya

ALE_TC = {
    292234259.82293594: (-0.11368345174719045, 0.09298596444784424, 0.2013930267438065, -0.9684371595480613),
    292234259.9984359: (-0.11369854984877158, 0.09290637151041517, 0.20138419780992423, -0.9684448620171975),
}
"""J2000 to SELENE_M_SPACECRAFT (DOI-USGS/ale, kaguyatc_isd.json); the first is the first line's time."""


def test_terrain_camera_begins_and_stands_as_ale_has_it(shared_data: Path) -> None:
    """By the clock, as ISIS's cube of the image (SpkTableStartTime 292234259.82294): 0.03 s after the label's UTC."""
    image = image_of(shared_data, KAGUYA)
    trajectory, times = tables(image), np.array(list(ALE_TC))
    assert image.timing.start_times[0] + trajectory.epoch == pytest.approx(times[0], abs=1e-7)
    got, _ = trajectory.camera.at(times - trajectory.epoch)
    assert turned(trajectory.camera.constant.T @ got, rotation.to_matrix(np.array(list(ALE_TC.values())))) < 1e-10


def test_corners_are_those_of_the_archives_label(shared_data: Path) -> None:
    """UPPER_LEFT_... and UPPER_RIGHT_..., JAXA's own on other terrain, 15 degrees off nadir: within 0.5 km."""
    image = image_of(shared_data, KAGUYA)
    ground, _ = image.image_to_ground(np.zeros(2), np.array([0.0, 3208.0]))
    longitude, latitude = np.radians([[44.883039, 48.534829], [-81.172073, -81.200350]])
    unit = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    assert np.linalg.norm(ground - 1737.4e3 * np.array(unit).T, axis=1).max() < 500.0


def test_the_instrument_kernels_own_formula(shared_data: Path) -> None:
    """SEL_TC_V01.TI: r = -(n - CENTER) PIXEL_SIZE; v = BOREsight + (a(r), r + b(r))."""
    interior = image_of(shared_data, KAGUYA, constants="ik").interior
    n = np.array([1.0, 700.0, 2048.5, 3208.0])
    r = -(n - 2048.5) * 0.007
    a, b = (-9.6499e-4, 9.8441e-4, 8.5773e-6, -3.7438e-6), (-1.3796e-3, 1.3502e-5, 2.7251e-6, -6.1938e-6)
    powers = r ** np.arange(4)[:, None]
    want = np.column_stack([-0.0725 + np.array(a) @ powers, 0.0214 + r + np.array(b) @ powers])
    np.testing.assert_allclose(interior.focal_plane(n - 0.5)[0], want * 1e-3, rtol=0, atol=1e-11)


def test_the_moon_turns_as_the_kernels_say_and_it_is_told(shared_data: Path) -> None:
    image = image_of(shared_data, KAGUYA)
    assert any("MOON_ME" in remark and "IAU_MOON" not in remark for remark in image.remarks)
    other = read_labelled_image(
        shared_data / f"{KAGUYA}_pds3.lbl", [path for path in kernels(shared_data, KAGUYA) if "moon" not in path.name]
    )
    assert any("IAU_MOON" in remark for remark in other.remarks)
    times = np.zeros(1) + tables(image).epoch
    for one, frame in ((image, "MOON_ME"), (other, "IAU_MOON")):
        with loaded(kernels(shared_data, KAGUYA)):
            want = np.array(spiceypy.pxform("J2000", frame, times[0]))[None]
        assert turned(tables(one).body.at(np.zeros(1))[0], want) < 1e-12


# --- MOC wide angle


def test_wide_angle_by_kernels_is_spices(shared_data: Path, tmp_path: Path) -> None:
    """ISIS's look vector of a red detector pixel, ideal angle by its polynomial, meets Mars where SPICE says."""
    path = tmp_path / "red.img"
    text = mgs.LABEL.replace('"MOC-NA"', '"MOC-WA"\nFILTER_NAME = RED').replace('ID = "512"', "ID = 0")
    path.write_bytes(mgs.image_bytes(text))
    image = read_labelled_image(path, mgs.kernels(shared_data))
    line, sample = 3.0, 100.0
    pixel = 0.5 + 2 * sample  # counted from 1
    x, y = 0.007 * 6.7785, -0.007 * (pixel - 1674.65)
    angle, radius = np.arctan2(np.hypot(x, y), 11.20537656), np.hypot(x, y)
    odd = (0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331)
    ideal = np.tan(sum(c * angle ** (2 * k + 1) for k, c in enumerate(odd)))
    look = np.array([x / radius * ideal, y / radius * ideal, 1.0])
    with loaded(mgs.kernels(shared_data)):
        time = mgs.START + line * 4 * 0.4821e-3
        attitude, _ = spiceypy.ckgp(-94000, spiceypy.sce2c(-94, time - 1.15), 1.0, "J2000")
        mount = spiceypy.pxform("MGS_MOC_WA_RED", "MGS_SPACECRAFT", time)
        place = attitude.T @ mount @ look
        point, _, _ = spiceypy.sincpt("ELLIPSOID", "MARS", time, "IAU_MARS", "NONE", "MGS", "J2000", place)
    got, _ = image.image_to_ground(np.array([line]), np.array([sample]))
    np.testing.assert_allclose(got[0], np.asarray(point) * 1e3, rtol=0, atol=1e-2)


# --- damaged kernels


@pytest.mark.parametrize(
    ("name", "at", "content"),
    [
        ("mgs_sc_map2_0_sliced_-94000.bc", 12, b"\x06\x20\x00\x00"),  # integers of a summary
        ("m0402852.ale_1.bsp", 2064, b"\x00\x00\x00\x00\x65\xcd\xcd\x41"),  # number of summaries
    ],
)
def test_a_kernel_that_kills_spice_is_an_error(
    shared_data: Path, tmp_path: Path, name: str, at: int, content: bytes
) -> None:
    """Of these CSPICE dies by SIGSEGV and SIGABRT."""
    given = mgs.kernels(shared_data)
    (place,) = (k for k, path in enumerate(given) if path.name == name)
    whole = given[place].read_bytes()
    given[place] = tmp_path / name
    given[place].write_bytes(whole[:at] + content + whole[at + len(content) :])
    refuses(re.escape(name), read_labelled_image, shared_data / f"{MOC}_isis.lbl", given)


@pytest.mark.parametrize(
    ("variable", "radii"),
    [("BODY499_RADII", "3.39619 3.39619 3.3762"), ("BODY499_RADII", "1737.4 1737.4 1737.4"),
     ("BODY499_RADII +", "3396.19 3396.19 3376.2")],
)  # fmt: skip
def test_radii_of_another_body_are_refused(shared_data: Path, tmp_path: Path, variable: str, radii: str) -> None:
    other = tmp_path / "other.tpc"
    other.write_text(f"KPL/PCK\n\\begindata\n{variable}= ( {radii} )\n\\begintext\n")
    with pytest.raises(InputError, match=r"radii of MARS|BODY499_RADII"):
        read_labelled_image(shared_data / f"{MOC}_isis.lbl", [*mgs.kernels(shared_data), other])


def test_meta_kernels_name_no_meta_kernels(shared_data: Path, tmp_path: Path) -> None:
    meta = tmp_path / "itself.tm"
    meta.write_text("KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'itself.tm' )\n")
    refuses(r"itself\.tm", read_labelled_image, shared_data / f"{MOC}_isis.lbl", [meta])
