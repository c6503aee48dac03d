"""The images of camera_roads.py: real ones, made-up ones over real orbits, and one that is made up wholly.

Formulas: ISIS's camera models (CTXCamera, LroNarrowAngleCamera, MocNarrowAngleCamera, MocWideAngleCamera,
HiriseCamera, ThemisIrCamera, KaguyaTcCamera, KaguyaMiCamera, HrscCamera and their distortion maps); what ALE writes:
its drivers. SPICE and NumPy alone: nothing of mgsgraph stands in this file.
"""

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import spiceypy as spice
from camera_equations import LIGHT, Optics, Scene, Variant, Vector, pool

HRSC_TIMES = ((255744599.02748165, 0.012800790786743165, 1), (255744684.33197814, 0.012907449722290038, 6665),
              (255744684.34504557, 0.013227428436279297, 6666))  # fmt: skip
"""Table LineScanTimes of h5270_0000_ir2 (DOI-USGS/ale, test of its MEX driver)."""


# --- what programs write otherwise


def without(code: int) -> dict[str, Any]:
    """Keywords for geometric positions."""
    return {f"INS{code}_LIGHTTIME_CORRECTION": "NONE"}


def apparent(code: int) -> Variant:
    """Positions as ALE asks SPICE for them by default."""
    keywords = {} if code == -131351 else {f"INS{code}_LIGHTTIME_CORRECTION": "LT+S"}
    return Variant("positions LT+S", keywords, why="made geometric, the Sun's own motion left out")


def moc_of_ale(isd: dict[str, Any]) -> None:
    """ALE's mgs_drivers: no summing of lines, a pixel pitch for distortion, the first sample 1, but CENTER
    of the instrument kernel from 0 on."""
    (line, start, period), = isd["line_scan_rate"]
    isd["line_scan_rate"] = [[line, start, period / 8.0]]
    isd["detector_line_summing"] = 8.0
    isd["optical_distortion"] = {"radial": {"coefficients": [0.0, 0.0131240578522949, 0.0131240578522949]}}
    isd["detector_center"]["sample"] -= 0.5
    isd["starting_detector_sample"] += 1.0


def hrsc_of_ale(isd: dict[str, Any]) -> None:
    """ALE's mex_drivers: no macropixels."""
    isd["detector_sample_summing"] = 1.0


def themis_of_ale(isd: dict[str, Any]) -> None:
    """ALE's ody_drivers: each band's line and time half a line later, another focal length, no distortion."""
    (line, start, period), = isd["line_scan_rate"]
    isd["line_scan_rate"] = [[line, start + 0.5 * period, period]]
    isd["starting_ephemeris_time"] += 0.5 * period
    isd["starting_detector_line"] -= 0.5
    isd["focal_length_model"] = {"focal_length": 202.059}
    isd["optical_distortion"] = {"radial": {"coefficients": [0.0, 0.0, 0.0]}}


# --- cameras


def by_keywords(code: int, **more: Any) -> Optics:
    """By ITRANSL, ITRANSS, FOCAL_LENGTH, BORESIGHT_LINE and BORESIGHT_SAMPLE of the pool, unless `more` has them."""
    usual: dict[str, Callable[[], Any]] = {
        "focal": lambda: pool(f"INS{code}_FOCAL_LENGTH")[0], "lines": lambda: pool(f"INS{code}_ITRANSL"),
        "samples": lambda: pool(f"INS{code}_ITRANSS"),
        "origin": lambda: tuple(float(pool(f"INS{code}_BORESIGHT_{axis}")[0]) for axis in ("LINE", "SAMPLE")),
    }  # fmt: skip
    return Optics(**{key: more[key] if key in more else make() for key, make in usual.items()} | more)


def radial(code: int) -> dict[str, Any]:
    """ISIS CameraDistortionMap."""
    k = pool(f"INS{code}_OD_K").tolist()

    def undistort(x: float, y: float) -> tuple[float, float]:
        square = x * x + y * y
        factor = 1.0 - (k[0] + square * (k[1] + square * k[2]))
        return x * factor, y * factor

    return {"undistort": undistort, "model": {"radial": {"coefficients": k}}}


def kaguya(code: int, signed: bool) -> dict[str, Any]:
    """ISIS KaguyaTcCameraDistortionMap (the radius) and KaguyaMiCameraDistortionMap (y with its sign)."""
    a, b, shift = (pool(f"INS{code}_{name}") for name in ("DISTORTION_COEF_X", "DISTORTION_COEF_Y", "BORESIGHT"))

    def undistort(x: float, y: float) -> tuple[float, float]:
        powers = (y if signed else np.hypot(x, y)) ** np.arange(a.size)
        return float(x + shift[0] + a @ powers), float(y + shift[1] + b @ powers)

    model = {"x": a.tolist(), "y": b.tolist(), "boresight_x": shift[0], "boresight_y": shift[1]}
    return {"undistort": undistort, "model": {"kaguyalism": model}}


def entry(label: Path, key: str) -> str:
    """Value of a label's key, without quotes and units."""
    match = re.search(rf"^\s*{re.escape(key)}\s*=\s*(.*)$", label.read_text(errors="ignore"), re.MULTILINE)
    assert match is not None, f"{label}: no {key}"
    return re.sub(r"<.*>|[\"()]", "", match[1]).strip()


def number(label: Path, key: str) -> float:
    """A number of a label."""
    return float(entry(label, key))


def kernels_of(data: Path, folder: str, *more: str) -> list[Path]:
    """All of a folder in the order of loading, the addendum after the instrument kernel; then `more`."""
    kinds = (".tls", ".tsc", ".tpc", ".tf", ".ti", ".bsp", ".bc")
    kernels = [path for path in sorted((data / folder).iterdir()) if path.suffix.lower() in kinds]
    kernels.sort(key=lambda path: (kinds.index(path.suffix.lower()), "ddendum" in path.name))
    return kernels + [data / name for name in more]


MOON = (
    "lro_nac_m103595705/moon_080317.tf", "lro_nac_m103595705/moon_assoc_me.tf", "kernels/moon_pa_de421_1900-2050.bpc",
)  # fmt: skip


def ctx(data: Path, _: Path) -> Scene:
    label = data / "mro_ctx_b10" / "B10_013341_1010_XN_79S172W_pds3.lbl"
    start = spice.scs2e(-74, entry(label, "SPACECRAFT_CLOCK_START_COUNT"))
    rate = (0.0, start, number(label, "LINE_EXPOSURE_DURATION") * 1e-3)
    return Scene(
        "MRO CTX", "B10_013341", by_keywords(-74021, **radial(-74021)), (400, 5000), [rate], "-74", -74021,
        ("MRO_SPACECRAFT", "MRO_CTX"), "MARS", "IAU_MARS", "MARS_RECONNAISSANCE_ORBITER", "CONTEXT CAMERA", label=label,
        variants=[apparent(-74021)],
    )  # fmt: skip


def lroc(data: Path, _: Path) -> Scene:
    label = data / "lro_nac_m103595705" / "M103595705LE_pds3.lbl"
    preroll = spice.scs2e(-85, entry(label, "LRO:SPACECRAFT_CLOCK_PREROLL_COUNT"))
    period = number(label, "LINE_EXPOSURE_DURATION") * 1e-3 * 1.0045
    k = float(pool("INS-85600_OD_K")[0])
    optics = by_keywords(
        -85600, undistort=lambda x, y: (x, y / (1.0 + k * y * y)), model={"lrolrocnac": {"coefficients": [k]}}
    )
    return Scene(
        "LRO LROC NAC-L", "M103595705LE", optics, (400, 5064), [(0.0, preroll + 1024.0 * period, period)], "-85",
        -85600, ("LRO_LROCNACL", "LRO_LROCNACL"), "MOON", "MOON_ME", "LUNAR RECONNAISSANCE ORBITER",
        "LUNAR RECONNAISSANCE ORBITER CAMERA", label=label,
    )  # fmt: skip


def moc_narrow(data: Path, _: Path) -> Scene:
    label = data / "mgs_moc_m0402852" / "m0402852_isis.lbl"
    start, period = spice.scs2e(-94, entry(label, "SpacecraftClockCount")), number(label, "LineExposureDuration") * 1e-3
    optics = by_keywords(-94031, origin=(0.0, 1024.5), summing=8.0, model={"radial": {"coefficients": [0.0] * 3}})
    return Scene(
        "MGS MOC-NA", "M04/02852", optics, (1536, 256), [(0.0, start, 8.0 * period)], "-94", -94031,
        ("MGS_SPACECRAFT", "MGS_MOC_NA"), "MARS", "IAU_MARS", "MARS GLOBAL SURVEYOR", "MGS_MOC_NA", -1.15, label,
        margin=2.0, why="tables from 2 s before the first line on; dense ones that begin with it are "
        "refused: ALE's lack the -1.15 s", variants=[apparent(-94031), Variant(
            "as ALE has it", without(-94031), moc_of_ale,
            "line period, pixel pitch for distortion, counting from 1 and 0 are put right",
        )],
    )  # fmt: skip


WIDE = """PDS_VERSION_ID = PDS3
TARGET_NAME = MARS
INSTRUMENT_ID = "MOC-WA"
FILTER_NAME = RED
PRODUCT_ID = "M04/02852"
START_TIME = 1999-08-24T14:12:13.64
SPACECRAFT_CLOCK_START_COUNT = "619971158:28"
LINE_EXPOSURE_DURATION = 80.48 <MILLISECONDS>
DOWNTRACK_SUMMING = 1
CROSSTRACK_SUMMING = 2
EDIT_MODE_ID = "1488"
OBJECT = IMAGE
  LINES = 60
  LINE_SAMPLES = 240
  SAMPLE_BITS = 8
END_OBJECT = IMAGE
END
"""


def wide_optics(**more: Any) -> Optics:
    """ISIS MocWideAngleCamera, MocWideAngleDistortionMap of the red filter."""
    focal, odd = 11.20537656, (0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331)

    def undistort(x: float, y: float) -> tuple[float, float]:
        radius = np.hypot(x, y)
        angle = np.arctan2(radius, focal)
        grown = focal * np.tan(sum(c * angle ** (2 * k + 1) for k, c in enumerate(odd))) / radius
        return float(x * grown), float(y * grown)

    return Optics(
        focal, np.array([0.0, 142.8571429, 0.0]), np.array([0.0, 0.0, -142.8571429]), (0.0, 1674.65), undistort,
        offset=6.7785, first=1489.0, **more,
    )  # fmt: skip


def moc_wide(_: Path, folder: Path) -> Scene:
    label = folder / "wide.lbl"
    label.write_text(WIDE)
    rate = (0.0, spice.scs2e(-94, "619971158:28"), 80.48e-3)
    return Scene(
        "MGS MOC-WA red", "label made up, kernels of M04/02852", wide_optics(summing=2.0), (60, 240), [rate], "-94",
        -94032, ("MGS_SPACECRAFT", "MGS_MOC_WA_RED"), "MARS", "IAU_MARS", bias=-1.15, label=label,
        why="support data have no model of its distortion",
    )  # fmt: skip


def terrain(data: Path, _: Path) -> Scene:
    label = data / "kaguya_tc" / "TC1S2B0_01_06691S820E0465_pds3.lbl"
    start = spice.sct2e(-131, number(label, "CORRECTED_SC_CLOCK_START_COUNT"))
    rate = (0.0, start, number(label, "CORRECTED_SAMPLING_INTERVAL") * 1e-3)
    return Scene(
        "Kaguya TC1", "S820E0465", by_keywords(-131351, **kaguya(-131351, signed=False)), (400, 3208), [rate], "-131",
        -131351, ("SELENE_M_SPACECRAFT", "LISM_TC1_HEAD"), "MOON", "MOON_ME", "SELENE", "TERRAIN CAMERA 1", label=label,
        variants=[apparent(-131351)],
    )  # fmt: skip


def hrsc(data: Path, folder: Path) -> Scene:
    times = folder / "line_times.csv"
    rows = "".join(f"{time!r},{period!r},{line}\n" for time, period, line in HRSC_TIMES)
    times.write_text("EphemerisTime,ExposureTime,LineStart\n" + rows)
    return Scene(
        "MEX HRSC IR", "h5270", by_keywords(-41218, summing=4.0), (15088, 1288),
        [(line - 1.0, time, period) for time, period, line in HRSC_TIMES], "-41", -41218,
        ("MEX_SC_REF", "MEX_HRSC_HEAD"), "MARS", "IAU_MARS", "MARS EXPRESS", "HIGH RESOLUTION STEREO CAMERA",
        label=data / "mex_hrsc_h5270" / "h5270_0000_ir2_pds3.lbl", line_times=times,
        why="times recorded at changes of the line rate are joined by labels, taken as they stand by support data",
        variants=[apparent(-41218), Variant("as ALE has it", without(-41218), hrsc_of_ale, "macropixels by samples")],
    )  # fmt: skip


CUBE = """Object = IsisCube
  Object = Core
    Group = Dimensions
      Samples = {samples}
      Lines = {lines}
      Bands = 1
    End_Group
  End_Object
  Group = Instrument
    TargetName = {target}
    StartTime = {utc}
{words}
  End_Group
  Group = Archive
    ProductId = X
  End_Group
  Group = BandBin
    FilterNumber = 3
  End_Group
  Group = Kernels
    NaifFrameCode = {code}
  End_Group
End_Object
End
"""


def label_of(folder: Path, name: str, size: tuple[int, int], target: str, start: float, code: int, rows: str) -> Path:
    """The label of an ISIS cube, with keywords of its instrument, separated by semicolons."""
    path = folder / f"{name}.lbl"
    utc, rows = spice.et2utc(start, "ISOC", 6), rows.replace("; ", "\n")
    path.write_text(CUBE.format(lines=size[0], samples=size[1], target=target, utc=utc, words=rows, code=code))
    return path


def constants(folder: Path, name: str, code: int, **values: Any) -> Path:
    """A text kernel of an instrument's constants."""
    path = folder / name
    rows = "".join(f"INS{code}_{key} = ( {' '.join(f'{v!r}' for v in value)} )\n" for key, value in values.items())
    path.write_text(f"KPL/IK\n\\begindata\n{rows}\\begintext\n")
    spice.furnsh(str(path))
    return path


def hirise(_: Path, folder: Path) -> Scene:
    """Every second number of a true label of RED5 (ISIS, CameraFixtures.cpp), at a time of CTX B10_013341."""
    near, size = 297088765.0, (4000, 512)
    count, delays, binned = spice.sce2s(-74999, near), 64, 2
    line = (74.0 + 337.0 / 16.0) * 1e-6
    start = spice.scs2e(-74999, count)
    keywords = f"InstrumentId = HIRISE; ObservationStartCount = X; SpacecraftClockStartCount = {count.strip()}; " \
        f"DeltaLineTimerCount = 337; Summing = {binned}; Tdi = {delays}; CpmmNumber = 8; CcdId = RED5; " \
        "ChannelNumber = 0"
    across, along, odk = (-1000.86, -0.0087, -83.333), (7457.9, 83.3333, -0.0087), (-0.0048509, 2.41312e-07, -1.62e-13)
    files = [
        constants(folder, "hirise5.ti", -74605, ITRANSS=across, ITRANSL=along),
        constants(folder, "hirise.ti", -74699, FOCAL_LENGTH=(11994.9988,), OD_K=odk),
    ]
    late = line * (0.5 * (binned - 1) - 0.5 * (delays - 1))
    optics = by_keywords(
        -74605, focal=11994.9988, origin=(0.0, 1024.5), first=1025.0, summing=float(binned),
        offset=-64.0 + 0.5 * delays, **radial(-74699),
    )  # fmt: skip
    return Scene(
        "MRO HiRISE RED5", "label made up, orbit of MRO", optics, size, [(0.0, start + late, line * binned)], "-74",
        -74699, ("MRO_SPACECRAFT", "MRO_HIRISE_OPTICAL_AXIS"), "MARS", "IAU_MARS", "MARS_RECONNAISSANCE_ORBITER",
        "HIRISE", label=label_of(folder, "hirise", size, "Mars", start, -74605, keywords), kernels=files,
    )  # fmt: skip


def multiband(_: Path, folder: Path) -> Scene:
    """Coefficients as large as those of TC; ISIS KaguyaMiCamera counts CENTER's line from 0."""
    code, size, period = -131332, (400, 962), 12.999974e-3
    near = 292234260.0
    file = constants(
        folder, "mi.ti", code, ITRANSL=(0.0, 76.923, 0.0), ITRANSS=(0.0, 0.0, -76.923), FOCAL_LENGTH=(65.4,),
        CENTER=(481.5, 1.0), BORESIGHT=(-0.0725, 0.0214, 65.4), DISTORTION_COEF_X=(-9.6e-4, 9.8e-4, 8.6e-6),
        DISTORTION_COEF_Y=(-1.4e-3, 2.4e-3, 2.7e-6),
    )  # fmt: skip
    keywords = f"InstrumentId = MI-VIS; CorrectedSamplingInterval = {period * 1e3} <msec>"
    label = label_of(folder, "mi", size, "Moon", near, code, keywords)
    start = spice.str2et(entry(label, "StartTime"))
    return Scene(
        "Kaguya MI-VIS MV2", "label and constants made up, orbit of S820E0465",
        by_keywords(code, origin=(0.0, 481.5), **kaguya(code, signed=True)), size, [(0.0, start, period)], "-131", code,
        ("SELENE_M_SPACECRAFT", "LISM_MI_V_HEAD"), "MOON", "MOON_ME", "SELENE", "MULTI-BAND IMAGER", label=label,
        kernels=[file], why="support data call the model kaguyalism, whose radius has no sign; it is known for MI's",
    )  # fmt: skip


THEMIS_FRAME = """KPL/FK
\\begindata
FRAME_M01_THEMIS_IR = -53031
FRAME_-53031_NAME = 'M01_THEMIS_IR'
FRAME_-53031_CLASS = 4
FRAME_-53031_CLASS_ID = -53031
FRAME_-53031_CENTER = -53
TKFRAME_-53031_SPEC = 'ANGLES'
TKFRAME_-53031_RELATIVE = 'MGS_SPACECRAFT'
TKFRAME_-53031_ANGLES = ( 0.0 0.1 180.0 )
TKFRAME_-53031_AXES = ( 1 2 3 )
TKFRAME_-53031_UNITS = 'DEGREES'
\\begintext
"""


def odyssey(data: Path, folder: Path) -> list[Path]:
    """Orbit and clock of MGS under the numbers of Odyssey."""
    frame, clock, orbit = (folder / name for name in ("odyssey.tf", "odyssey.tsc", "odyssey.bsp"))
    frame.write_text(THEMIS_FRAME)
    clock.write_text(re.sub(r"_94\b", "_53", (data / "mgs_moc_m0402852" / "MGS_SCLKSCET.00061.tsc").read_text()))
    times = np.arange(-11224100.0, -11223900.0, 2.0)
    states = np.array([spice.spkezr("-94", time, "J2000", "NONE", "MARS")[0] for time in times])
    orbit.unlink(missing_ok=True)
    file = spice.spkopn(str(orbit), "odyssey", 0)
    spice.spkw13(file, -53, 499, "J2000", times[0], times[-1], "odyssey", 11, times.size, states, times)
    spice.spkcls(file)
    for path in (frame, clock, orbit):
        spice.furnsh(str(path))
    return [frame, clock, orbit]


def themis(data: Path, folder: Path) -> Scene:
    """Band 3 with time delay integration, of ISIS ThemisIrCamera and ThemisIrDistortionMap."""
    files, size, period = odyssey(data, folder), (240, 320), 33.2871e-3
    files.append(constants(folder, "themis.ti", -53031, ITRANSL=(0.0, 20.0, 0.0), ITRANSS=(0.0, 0.0, 20.0)))
    count = spice.sce2s(-53, -11224040.0)
    start, row = spice.scs2e(-53, count), 50.5
    keywords = f"InstrumentId = THEMIS_IR; SpacecraftClockCount = {count.strip()}; TimeDelayIntegration = ENABLED; " \
        "SpacecraftClockOffset = 0.5 <seconds>; SpatialSumming = 1"
    k, a1, a2 = 0.994260, 0.00447623, 0.00107556
    x, y = ([float(power == exponent) * value for power in range(10)] for exponent, value in ((1, k), (2, 1.0 + a1)))
    y[5] = a2
    optics = by_keywords(
        -53031, focal=203.9213, origin=(0.0, 160.5 - 0.005), offset=120.5 - row - 0.089,
        undistort=lambda x, y: (x / k, 2.0 * y / (1.0 + a1 + np.sqrt((1.0 + a1) ** 2 + 4.0 * a2 * y))),
        model={"transverse": {"x": x, "y": y}},
    )  # fmt: skip
    return Scene(
        "Odyssey THEMIS-IR band 3", "label made up, orbit of MGS", optics, size,
        [(0.0, start + 0.5 + (row - 0.5) * period, period)], "-53", -53031, ("MGS_SPACECRAFT", "M01_THEMIS_IR"), "MARS",
        "IAU_MARS", "MARS ODYSSEY", "MARS ODYSSEY", kernels=files,
        label=label_of(folder, "themis", size, "Mars", start, -53031, keywords),
        variants=[Variant("as ALE has it", without(-53031), themis_of_ale, "202.059 mm, no distortion: put right")],
    )  # fmt: skip


class Gimballed(Scene):
    """A circular orbit about a Mars that turns uniformly, and a camera that turns about the orbit's normal."""

    def angle(self, time: float) -> tuple[float, float]:
        """rad, rad/s: of the orbit and, 60 degrees ahead to 60 degrees back, of the gimbal."""
        rate, length = np.sqrt(42828.37 / 3690.0**3), self.time(self.size[0]) - self.time(0.0)
        phase = np.pi * ((time - self.time(0.0)) / length - 0.5)
        swing = np.radians(60.0)
        return rate * time + swing * np.sin(phase), rate + swing * np.cos(phase) * np.pi / length

    def state(self, time: float) -> Vector:
        rate = np.sqrt(42828.37 / 3690.0**3)
        ahead, normal = np.array([0.0, np.cos(1.62), np.sin(1.62)]), np.array([0.0, -np.sin(1.62), np.cos(1.62)])
        assert abs(ahead @ normal) < 1e-15
        out = np.array([1.0, 0.0, 0.0]) * np.cos(rate * time) + ahead * np.sin(rate * time)
        along = ahead * np.cos(rate * time) - np.array([1.0, 0.0, 0.0]) * np.sin(rate * time)
        return np.concatenate([3690.0 * out, 3690.0 * rate * along])

    def turn(self, time: float, frame: str) -> Vector:
        ahead, normal = np.array([0.0, np.cos(1.62), np.sin(1.62)]), np.array([0.0, -np.sin(1.62), np.cos(1.62)])
        turned = spice.axisar(normal, self.angle(time)[0])
        return np.stack([turned @ ahead, turned @ -normal, turned @ np.array([-1.0, 0.0, 0.0])])

    def body_turn(self, time: float) -> Vector:
        return np.array(spice.rotate(7.088e-5 * time, 3))

    def sun(self, time: float) -> Vector:
        return np.array([2.2e8, 0.0, 0.0, 0.0, -24.0, 0.0])

    def radii(self) -> Vector:
        return np.array([3396.19, 3396.19, 3376.2])

    def pointing(self, times: Vector) -> dict[str, Any]:
        rates = [(self.angle(time)[1] * np.array([0.0, -np.sin(1.62), np.cos(1.62)])).tolist() for time in times]
        turns = [spice.m2q(self.turn(time, "")).tolist() for time in times]
        return {"reference_frame": 1, "ephemeris_times": times.tolist(), "quaternions": turns,
                "angular_velocities": rates, "constant_rotation": np.eye(3).ravel().tolist()}  # fmt: skip

    def spinning(self, times: Vector) -> dict[str, Any]:
        turns = [spice.m2q(self.body_turn(time)).tolist() for time in times]
        return {"reference_frame": 1, "ephemeris_times": times.tolist(), "quaternions": turns,
                "angular_velocities": [[0.0, 0.0, 7.088e-5]] * times.size}  # fmt: skip


def crism(_: Path, __: Path) -> Scene:
    optics = Optics(
        441.0, np.array([0.0, 37.037037, 0.0]), np.array([0.0, 0.0, 37.037037]), (0.0, 320.5), first=1.0, summing=10.0
    )
    return Gimballed(
        "like CRISM", "made up: gimbal 60 degrees ahead to 60 back, binned by 10", optics, (480, 64),
        [(0.0, 1000.0, 1.0 / 3.75)], "", -74017, ("", ""), "MARS", "", "MARS_RECONNAISSANCE_ORBITER", "CRISM",
        why="no label; the gimbal turns unevenly between nodes, 0.27 s apart",
    )  # fmt: skip


class Tabled(Scene):
    """A cube, whose tables are samples of apparent positions and of attitudes."""

    def table(self, name: str) -> dict[str, Any]:
        assert self.label is not None
        return dict(json.loads(self.label.with_suffix(".isd").read_text())[name])

    def at(self, name: str, time: float) -> Vector:
        """Rotation between samples, at a uniform rate about one axis (ISIS SpiceRotation)."""
        table = self.table(name)
        times = np.array(table["ephemeris_times"])
        k = int(np.clip(np.searchsorted(times, time) - 1, 0, times.size - 2))
        first, second = (np.array(spice.q2m(table["quaternions"][j])) for j in (k, k + 1))
        axis, angle = spice.raxisa(second @ first.T)
        share = (time - times[k]) / (times[k + 1] - times[k])
        constant = np.array(table.get("constant_rotation", np.eye(3).ravel())).reshape(3, 3)
        return np.asarray(constant @ spice.axisar(axis, angle * share) @ first)

    def turn(self, time: float, frame: str) -> Vector:
        return self.at("instrument_pointing", time)

    def body_turn(self, time: float) -> Vector:
        return self.at("body_rotation", time)

    def radii(self) -> Vector:
        return np.array([3396.19, 3396.19, 3376.2])

    def apparent(self, time: float) -> Vector:
        """km, by Hermite's cubic (ISIS SpicePosition)."""
        table = self.table("instrument_position")
        times, places, speeds = (np.array(table[key]) for key in ("ephemeris_times", "positions", "velocities"))
        k = int(np.clip(np.searchsorted(times, time) - 1, 0, times.size - 2))
        length = times[k + 1] - times[k]
        u = (time - times[k]) / length
        weights = np.array([1.0 - 3.0 * u**2 + 2.0 * u**3, 3.0 * u**2 - 2.0 * u**3])
        slopes = length * np.array([u - 2.0 * u**2 + u**3, u**3 - u**2])
        return np.asarray(weights @ places[k : k + 2] + slopes @ speeds[k : k + 2])

    def state(self, time: float) -> Vector:
        """The body at time + lt sees the craft where it was at time: the light time and NAIF's `stelab` taken back."""
        moving, light = -np.mean(self.table("sun_position")["velocities"], axis=0), 0.0
        place = self.apparent(time)
        for _ in range(6):
            apparent = self.apparent(time + light)
            place = apparent + 0.0
            for _ in range(6):
                place = apparent - (spice.stelab(place, moving) - place)
            light = float(np.linalg.norm(place)) / LIGHT
        return np.concatenate([place + moving * light, moving])


def cube(name: str) -> Callable[[Path, Path], Scene]:
    """One of the three cubes of MOC-WA."""

    def scene(data: Path, _: Path) -> Scene:
        label = data / "mgs_moc_wa_three" / f"{name}.pvl"
        across, down = number(label, "CrosstrackSumming"), number(label, "DowntrackSumming")
        start = json.loads(label.with_suffix(".isd").read_text())["instrument_position"]["ephemeris_times"][0]
        rate = (0.0, start, number(label, "LineExposureDuration") * 1e-3 * down)
        optics = replace(wide_optics(summing=across), first=number(label, "FirstLineSample"))
        return Tabled(
            "MGS MOC-WA red", f"{entry(label, 'ProductId')} (cube)", optics,
            (int(number(label, "Lines")), int(number(label, "Samples"))), [rate], "", -94032, ("", ""), "MARS", "",
            label=label, why="by its cube's tables, at whose samples the equations ask, too",
        )  # fmt: skip

    return scene


CAMERAS: dict[str, tuple[Callable[[Path, Path], Scene], str, Sequence[str]]] = {
    "ctx": (ctx, "mro_ctx_b10", ()), "hirise": (hirise, "mro_ctx_b10", ()),
    "lroc": (lroc, "lro_nac_m103595705", MOON[2:]), "moc": (moc_narrow, "mgs_moc_m0402852", ()),
    "moc_wide": (moc_wide, "mgs_moc_m0402852", ()), "cube1": (cube("cube1"), "", ()), "cube2": (cube("cube2"), "", ()),
    "cube3": (cube("cube3"), "", ()), "themis": (themis, "mgs_moc_m0402852", ()),
    "hrsc": (hrsc, "mex_hrsc_h5270", ()), "terrain": (terrain, "kaguya_tc", MOON),
    "multiband": (multiband, "kaguya_tc", MOON), "crism": (crism, "", ()),
}  # fmt: skip
"""Functions that make scenes, folders of their kernels, and further kernels."""
