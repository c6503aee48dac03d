"""Cameras of the table: what their labels say, where their detectors lie by ISIS's formulas."""

from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import Camera, LabelKind, LineScanLabel, NaifKeywords, times_of_label
from mgsgraph.files.cameras.label import CAMERAS, read_line_scan_label
from mgsgraph.files.cameras.other_sensors import sensor_kind
from mgsgraph.files.kinds import Kind, image_kind, kind_of
from mgsgraph.files.labels.aberration import spacecraft_of
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.kernels import ck_frame, clock_time, fixed_rotation, loaded
from mgsgraph.geometry.camera import KaguyaMiDistortion, NoDistortion, RadialDistortion

MM = 1e-3
CUBE = """Object = IsisCube
  Object = Core
    Group = Dimensions
      Samples = {samples}
      Lines = 100
      Bands = 1
    End_Group
  End_Object
  Group = Instrument
    TargetName = {target}
    StartTime = 2008-05-17T09:37:24.7300819
{instrument}
  End_Group
  Group = Archive
    ProductId = X
{archive}
  End_Group
  Group = BandBin
{bands}
  End_Group
  Group = Kernels
    NaifFrameCode = {code}
  End_Group
End_Object
End
"""


def label(
    folder: Path, instrument: str, samples: int = 64, target: str = "Mars", archive: str = "", bands: str = "",
    code: int = 0,
) -> LineScanLabel:  # fmt: skip
    """Of a cube with these keywords, separated by semicolons."""
    lines = (text.replace("; ", "\n").replace(";", "\n") for text in (instrument, archive, bands))
    text = CUBE.format(
        samples=samples, target=target, code=code, **dict(zip(("instrument", "archive", "bands"), lines, strict=True))
    )
    path = folder / "image.lbl"
    path.write_text(text)
    return read_line_scan_label(path)


def isis_place(
    said: LineScanLabel, keywords: NaifKeywords, origin: tuple[float, float], offset: float, pixels: np.ndarray
) -> np.ndarray:
    """mm, (n, 2): ISIS CameraFocalPlaneMap of detector samples (the first pixel's centre at 1): ITRANS of x and y are
    sample and line relative to the origin, the line that of the detector offset.
    """
    code = said.detector or said.camera.instrument
    line, sample = (keywords.numbers(f"INS{code}_ITRANS{axis}", 3) for axis in "LS")
    wanted = np.stack([np.full(pixels.size, offset - origin[0]) - line[0], pixels - origin[1] - sample[0]])
    return np.linalg.solve(np.stack([line[1:], sample[1:]]), wanted).T


def keywords_of(code: int, **values: object) -> NaifKeywords:
    return NaifKeywords("here", {f"INS{code}_{name}": value for name, value in values.items()})


def require_place(
    said: LineScanLabel, keywords: NaifKeywords, origin: tuple[float, float], offset: float, first: float
) -> None:
    """ISIS CameraDetectorMap: detector sample = (image sample - 1) * summing + first + (summing - 1) / 2, from 1 on."""
    interior = replace(said.camera.interior(keywords, said), distortion=NoDistortion())
    samples = np.array([1.0, 2.0, float(said.samples)])
    pixels = (samples - 1.0) * said.sample_summing + first + 0.5 * (said.sample_summing - 1.0)
    got, slope = interior.focal_plane(samples - 0.5)
    want = isis_place(said, keywords, origin, offset, pixels)
    np.testing.assert_allclose(got, want * MM, rtol=0, atol=1e-12)
    np.testing.assert_allclose(slope[0], (want[1] - want[0]) * MM, rtol=0, atol=1e-14)


# --- HiRISE

RED5 = (
    "InstrumentId = HIRISE; ObservationStartCount = 895484264:44383; SpacecraftClockStartCount = 895484264:57342; "
    "DeltaLineTimerCount = 337; Summing = 1; Tdi = 128; CpmmNumber = 8; CcdId = RED5; ChannelNumber = 0"
)
BG12 = (
    "InstrumentId = HIRISE; ObservationStartCount = 848201291:54379; SpacecraftClockStartCount = 848201291:62546; "
    "DeltaLineTimerCount = 155; Summing = 4; Tdi = 64; CpmmNumber = 4; CcdId = BG12; ChannelNumber = 0"
)
HIRISE = {
    "INS-74605_ITRANSS": (-1000.86, -0.0087, -83.333), "INS-74605_ITRANSL": (7457.9, 83.3333, -0.0087),
    "INS-74699_FOCAL_LENGTH": 11994.9988, "INS-74699_OD_K": (-0.0048509, 2.41312e-07, -1.62369e-13),
}  # fmt: skip
"""Labels and constants of tests of ISIS (CameraFixtures.cpp, MroHiriseCube) and ALE (test_isis_spice.py)."""


def test_hirise(tmp_path: Path) -> None:
    """The line period is the label's LineExposureDuration, 95.0625 us: 74 us and 337 sixteenths."""
    said = label(tmp_path, RED5)
    assert (said.serial, said.detector) == ("MRO/HIRISE/895484264:44383/RED5/0", -74605)
    assert said.period == pytest.approx(95.0625e-6, rel=1e-12)
    assert said.late == pytest.approx(-95.0625e-6 * 63.5, rel=1e-12)  # ISIS: minus line (tdi / 2 - 0.5)
    keywords = NaifKeywords("here", HIRISE)
    require_place(said, keywords, (0.0, 1024.5), 0.0, 1025.0)
    bent = said.camera.interior(keywords, said).distortion  # coefficients of powers of mm
    assert bent == RadialDistortion(-0.0048509, pytest.approx(0.241312), pytest.approx(-0.162369))


def test_hirise_binned(tmp_path: Path) -> None:
    """Its LineExposureDuration is 334.75 us; with 64 lines integrated, the place is 32 lines off the middle."""
    said = label(tmp_path, BG12)
    line = 334.75e-6 / 4
    assert said.period == pytest.approx(334.75e-6, rel=1e-12)
    assert said.late == pytest.approx(line * (-31.5 + 1.5), rel=1e-12)
    assert said.detector == -74612
    keywords = {name.replace("-74605", "-74612"): value for name, value in HIRISE.items()}
    require_place(said, NaifKeywords("here", keywords), (0.0, 1024.5), -32.0, 1025.0)


def test_hirise_begins_when_isis_says(tmp_path: Path, shared_data: Path) -> None:
    """PSP_001446_1790_BG12_0: CkTableStartTime 217006138.29611 (ISIS), and to the last digit by ALE (hirise_isd.json);
    ConstantRotation there of the mount.
    """
    said, folder = label(tmp_path, BG12), shared_data / "mro_ctx_b10"
    with loaded([folder / "naif0012.tls", folder / "mro_sclkscet_00082_65536.tsc", folder / "mro_v16.tf"]):
        start = clock_time(said.camera.clock, said.start) + said.late
        mount = fixed_rotation(ck_frame(said.camera.frame), said.camera.frame, start)
    assert start == pytest.approx(217006138.29611498, abs=1e-7)
    published = [
        [0.9999703083413012, 0.0, -0.007705999987217688],
        [8.815848890311187e-06, 0.9999993456043353, 0.0011439900269605027],
        [0.007705994944444704, -0.0011440239949305033, 0.9999696539650667],
    ]  # fmt: skip
    np.testing.assert_allclose(mount, published, rtol=0, atol=1e-12)


# --- CTX

CTX = """PDS_VERSION_ID = PDS3
INSTRUMENT_ID = CTX
PRODUCT_ID = X
TARGET_NAME = MARS
START_TIME = 2009-06-01T00:38:16.057
STOP_TIME = N/A
SPACECRAFT_CLOCK_START_COUNT = "0928283918:060"
LINE_EXPOSURE_DURATION = 1.877 <MSEC>
SAMPLING_FACTOR = {}
SAMPLE_FIRST_PIXEL = {}
OBJECT = IMAGE
  LINES = 400
  LINE_SAMPLES = {}
END_OBJECT = IMAGE
END
"""


def ctx(folder: Path, summing: int, first: int, samples: int) -> LineScanLabel:
    path = folder / "X.IMG"
    path.write_text(CTX.format(summing, first, samples))
    return read_line_scan_label(path)


@pytest.mark.parametrize(
    ("summing", "first", "samples", "seeing"),
    [(1, 0, 5056, 5000), (2, 0, 2528, 2500), (1, 1000, 1016, 1000), (2, 1000, 1008, 1000)],
)
def test_ctx_without_its_masked_pixels(tmp_path: Path, summing: int, first: int, samples: int, seeing: int) -> None:
    """ISIS mroctx2isis; lines take `summing` of the label's line times (mro_ctx_pds_sis.pdf, ISIS CTXCamera), so that
    pixels stay square: 6 m and 12 m.
    """
    said = ctx(tmp_path, summing, first, samples)
    assert (said.samples, said.stop) == (seeing, "")
    assert said.period == pytest.approx(1.877e-3 * summing, rel=1e-12)


def test_cubes_of_ctx_and_lroc_that_are_summed(tmp_path: Path) -> None:
    """LROC sums across track alone: its label has the period as it is (ISIS LroNarrowAngleCamera)."""
    text = "InstrumentId = CTX; SpacecraftClockCount = 1:0; LineExposureDuration = 1.877; SampleFirstPixel = 0; "
    assert label(tmp_path, f"{text}SpatialSumming = 2").period == pytest.approx(3.754e-3, rel=1e-12)
    text = "InstrumentId = NACL; SpacecraftClockPrerollCount = 1; LineExposureDuration = 0.986133; "
    text += "SampleFirstPixel = 0; "
    assert label(tmp_path, f"{text}SpatialSumming = 2", target="MOON").period == pytest.approx(0.986133e-3, rel=1e-12)


# --- LROC

NAC_RIGHT = """PDS_VERSION_ID = PDS3
INSTRUMENT_ID = LROC
FRAME_ID = RIGHT
PRODUCT_ID = M1RE
PRODUCT_VERSION_ID = "{}"
TARGET_NAME = MOON
LRO:PREROLL_TIME = 2009-07-30T12:20:37.127
LRO:SPACECRAFT_CLOCK_PREROLL_COUNT = "1/270649237:07208"
SPACECRAFT_CLOCK_START_COUNT = "1/270649238:11024"
CROSSTRACK_SUMMING = 1
LINE_EXPOSURE_DURATION = 1.028800 <ms>
OBJECT = IMAGE
  LINES = 400
  LINE_SAMPLES = 5064
END_OBJECT = IMAGE
END
"""


def test_early_images_of_the_right_camera_run_the_other_way(tmp_path: Path) -> None:
    """ISIS lronac2isis turns lines of versions before 1.30 round."""
    path = tmp_path / "M1RE.IMG"
    path.write_text(NAC_RIGHT.format("v1.8"))
    assert read_line_scan_label(path).serial == "LRO/1/270649238:11024/NACR"
    path.write_text(NAC_RIGHT.format("v1.2"))
    refuses(r"v1\.2; expected v1\.3 or later", read_line_scan_label, path)


# --- THEMIS

THEMIS = keywords_of(-53031, ITRANSL=(0.0, 0.0, 20.0), ITRANSS=(0.0, 20.0, 0.0))
BAND_9 = (
    "InstrumentId = THEMIS_IR; SpacecraftClockCount = 763079637.076; TimeDelayIntegration = ENABLED; "
    "SpacecraftClockOffset = 0.5 <seconds>; SpatialSumming = {}"
)


@pytest.mark.parametrize("summing", [1, 2])
def test_themis(tmp_path: Path, summing: int) -> None:
    """Band 9 is read from detector line 205.5, 205 detector lines after the clock count, whatever the summing."""
    said = label(tmp_path, BAND_9.format(summing), bands="FilterNumber = 9")
    assert said.serial == "Odyssey/THEMIS_IR/763079637.076"
    assert said.period == pytest.approx(0.0332871 * summing, rel=1e-12)
    assert said.late == pytest.approx(0.5 + 205.0 * 0.0332871, rel=1e-12)
    require_place(said, THEMIS, (0.0, 160.5 + 0.045), 120.5 - 205.5 + 0.025, 1.0)


def test_themis_of_several_bands(tmp_path: Path) -> None:
    bands = "FilterNumber = (1, 2, 3)"
    refuses(r"the bands 1, 2, 3; expected one of 1 \.\. 10", label, tmp_path, BAND_9.format(1), bands=bands)
    assert label(tmp_path, BAND_9.format(1), bands=f"{bands}; ReferenceBand = 2").band == 2


# --- Kaguya


@pytest.mark.parametrize(("mode", "first"), [("FULL", 1.0), ("NOMINAL", 297.0), ("HALF", 1172.0)])
def test_terrain_camera(tmp_path: Path, mode: str, first: float) -> None:
    said = label(
        tmp_path, "InstrumentId = TC1; SpacecraftClockStartCount = 922997380.174174 <s>; "
        f"LineSamplingInterval = 6.5 <ms>; SwathModeId = {mode}", target="MOON",
    )  # fmt: skip
    assert said.start == "922997380.174174"
    assert said.period == pytest.approx(6.5e-3, rel=1e-12)
    assert said.serial == "KAGUYA/TC1/2008-05-17T09:37:24.7300819"
    keywords = keywords_of(
        -131351, ITRANSL=(0.0, -142.857142857, 0.0), ITRANSS=(0.0, 0.0, -142.857142857), FOCAL_LENGTH=72.45,
        BORESIGHT_LINE=0.5, BORESIGHT_SAMPLE=2048.0, BORESIGHT=(-0.0725, 0.0214), DISTORTION_COEF_X=(0.0,) * 4,
        DISTORTION_COEF_Y=(0.0,) * 4,
    )  # fmt: skip
    require_place(said, keywords, (0.5, 2048.0), 0.0, first)
    place, _ = said.camera.interior(keywords, said).focal_plane(np.array([0.5]))
    bare = isis_place(said, keywords, (0.5, 2048.0), 0.0, np.array([first]))
    np.testing.assert_allclose(place, (bare + np.array([-0.0725, 0.0214])) * MM, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("code", "name", "terms"), [(-131332, "MI-VIS", 3), (-131344, "MI-NIR", 4)])
def test_multiband_imager(tmp_path: Path, code: int, name: str, terms: int) -> None:
    """Each band by its frame code; the principal point is CENTER, its line counted from 0 (ISIS KaguyaMiCamera)."""
    text = f"InstrumentId = {name}; CorrectedSamplingInterval = 12.999974 <msec>"
    said = label(tmp_path, text, target="MOON", code=code)
    assert said.camera.instrument == code
    assert said.period == pytest.approx(12.999974e-3, rel=1e-12)
    keywords = keywords_of(
        code, ITRANSL=(0.0, 76.9, 0.0), ITRANSS=(0.0, 0.0, -76.9), FOCAL_LENGTH=65.4, CENTER=(481.5, 1.0),
        BORESIGHT=(0.01, 0.02, 65.4), DISTORTION_COEF_X=(1e-3,) * terms, DISTORTION_COEF_Y=(1e-3,) * terms,
    )  # fmt: skip
    require_place(said, keywords, (0.0, 481.5), 0.0, 1.0)
    distortion = said.camera.interior(keywords, said).distortion
    assert isinstance(distortion, KaguyaMiDistortion)
    assert distortion.x[3] == (0.0 if terms == 3 else pytest.approx(1e3))


# --- the table of docs/cameras.md, made of the records: this file run as a program prints it

HEAD = ("camera", "NAIF id", "first line", "line period", "constants", "positions of cubes", "attitude")


def _labels(camera: Camera, says: str) -> str:
    keys = [one for one in (camera.isis, camera.pds3) if one is not None]
    return "<br>".join(dict.fromkeys(f"`{getattr(one, says)}`" for one in keys))


def _period(camera: Camera) -> str:
    if not camera.isis.period:
        return "formula" if camera.line_times is times_of_label else "each line's own"
    if camera.isis.line_summing:
        return "label, times summing"
    return "label" if camera.line_times is times_of_label else "label, corrected"


def _cells(camera: Camera) -> tuple[str, ...]:
    """All but the camera's name and number."""
    spacecraft = spacecraft_of(camera.spacecraft)
    assert spacecraft is not None
    return (
        _labels(camera, "start"),
        _period(camera),
        camera.addendum + ("" if camera.instrument_kernel is None else "; IK"),
        spacecraft.stated.correction,
        f"{camera.attitude_bias:g} s" if camera.attitude_bias else "",
    )


def table() -> str:
    """One row for cameras that differ in name and number only."""
    rows = [HEAD, tuple("---" for _ in HEAD)]
    for cells, group in groupby(CAMERAS, _cells):
        alike = list(group)
        names = alike[0].name if len(alike) == 1 else f"{alike[0].name} … {alike[-1].name.split()[-1]}"
        first, last = alike[0].instrument, alike[-1].instrument
        codes = f"{first}" if first == last else f"{first} … {last}"
        rows.append((names, codes, *cells))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


# --- all of them


def test_each_camera_is_told_from_the_others() -> None:
    kinds: tuple[LabelKind, ...] = ("isis", "pds3")
    for kind in kinds:
        identities = [tuple(keys.identity.items()) for one in CAMERAS if (keys := one.keys(kind)) is not None]
        assert len(set(identities)) == len(identities)
    assert len({camera.name for camera in CAMERAS}) == len(CAMERAS)
    assert len({camera.instrument for camera in CAMERAS}) == len(CAMERAS)


def test_the_page_has_the_table() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "cameras.md").read_text(encoding="utf-8")
    assert table() in page


if __name__ == "__main__":
    print(table())


# --- images that are refused as what they are


PDS3 = "PDS_VERSION_ID = PDS3\n{keys}\nOBJECT = IMAGE\n  LINES = 10\n  LINE_SAMPLES = 10\nEND_OBJECT\n{end}END\n"
ISIS = "Object = IsisCube\n  Group = Instrument\n    {keys}\n  End_Group\nEnd_Object\nEnd\n"
SENSORS = {
    "INSTRUMENT_ID = MDIS-NAC": "a frame camera",
    "INSTRUMENT_NAME = VISUAL_IMAGING_SUBSYSTEM_CAMERA_B": "a frame camera",
    'INSTRUMENT_ID = SSI\nINSTRUMENT_NAME = "SOLID-STATE IMAGING"': "a frame camera",
    "INSTRUMENT_ID = FC2": "a frame camera",
    'INSTRUMENT_ID = "FRONT_HAZCAM_LEFT"': "a frame camera",
    'INSTRUMENT_ID = MI\nINSTRUMENT_NAME = "MICROSCOPIC IMAGER"': "a frame camera",
    "INSTRUMENT_ID = MAST_LEFT": "a frame camera",
    "INSTRUMENT_ID = HRSC\nDETECTOR_ID = MEX_HRSC_SRC": "a frame camera",
    'INSTRUMENT_ID = ("ISSNA")': "a frame camera",
    "INSTRUMENT_ID = LROC\nINSTRUMENT_MODE_ID = COLOR": "a push-frame camera",
    'INSTRUMENT_ID = "THEMIS"\nDETECTOR_ID = "VIS"': "a push-frame camera",
    "INSTRUMENT_ID = MARCI": "a push-frame camera",
    "INSTRUMENT_ID = JNC": "a push-frame camera",
    "INSTRUMENT_ID = SHARAD": "radar",
    "INSTRUMENT_ID = MARSIS": "radar",
    "INSTRUMENT_ID = MRFLRO": "radar",
    'INSTRUMENT_NAME = "RADAR SYSTEM"': "radar",
    "InstrumentId = WAC-VIS": "a push-frame camera",
    "InstrumentId = THEMIS_VIS": "a push-frame camera",
    "InstrumentId = Marci": "a push-frame camera",
    "InstrumentId = FC1": "a frame camera",
    'InstrumentId = "SOLID STATE IMAGING SYSTEM"': "a frame camera",
}


@pytest.mark.parametrize("keys", SENSORS)
def test_no_line_scanner_is_refused_as_what_it_is(tmp_path: Path, keys: str) -> None:
    """Without the advice to make support data, which would be refused, too."""
    path = tmp_path / "a.lbl"
    path.write_text((ISIS if keys.startswith("InstrumentId") else PDS3).format(keys=keys, end=""), encoding="utf-8")
    for read in (read_line_scan_label, *([read_isis_cube] if keys.startswith("InstrumentId") else [])):
        with pytest.raises(InputError, match=f" is {SENSORS[keys]};") as caught:
            read(path)
        assert not caught.value.remedy


def test_no_line_scanner_of_the_table_is_taken_for_something_else() -> None:
    for camera in CAMERAS:
        for keys in (camera.isis, camera.pds3):
            assert keys is None or not sensor_kind(" ".join(keys.identity.values()))
    assert not sensor_kind("USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL")
    assert [sensor_kind(name) for name in ("MI-VIS", "MI-NIR", "CRISM", "M3", "")] == [""] * 5


MAP = "OBJECT = IMAGE_MAP_PROJECTION\n  MAP_SCALE = 6.0\nEND_OBJECT\n"
MAPS = {
    "pds3": PDS3.format(keys="INSTRUMENT_ID = CTX\n^IMAGE = 9", end=MAP),
    "inside": PDS3.format(keys=f"INSTRUMENT_ID = CTX\nOBJECT = IMAGE_FILE\n{MAP}END_OBJECT", end=""),
    "isis": ISIS.replace("Instrument", "Mapping").format(keys="ProjectionName = Sinusoidal"),
}


@pytest.mark.parametrize("which", MAPS)
def test_a_map_is_no_raw_image_and_stays_a_raster(tmp_path: Path, which: str) -> None:
    path = tmp_path / "a.lbl"
    path.write_text(MAPS[which], encoding="utf-8")
    assert kind_of(path) is Kind.RASTER
    refuses("a georeferenced raster", image_kind, path)
    refuses("a map-projected image", read_line_scan_label, path)
