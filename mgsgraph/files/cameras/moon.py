"""Line scanners about the Moon: narrow angles of LROC (Lunar Reconnaissance Orbiter), and Terrain Camera and Multiband
Imager of Kaguya (SELENE).

* LROC NAC-L and NAC-R. Formulas: ISIS LroNarrowAngleCamera, LroNarrowAngleDistortionMap. The clock counts the preroll,
  not the first line, and the lines take longer than the label says: the addendum (lro_instrumentAddendum_v04.ti) has
  both corrections.
* Kaguya TC1, TC2 and MI. Formulas: ISIS KaguyaTcCamera, KaguyaMiCamera and their distortion maps; or, for TC, those of
  its instrument kernel SEL_TC_V01.TI, whose radius has a sign. Clock counts (TC) and UTC (MI) are those that the labels
  call corrected; counts are decimal, and lie 0.03 s after the UTC beside them by SEL_M_V01.TSC: ISIS and the CK go by
  the clock. The principal point of TC is at (line 0.5, sample 2048.0) in ISIS's addendum 007, half a sample from the
  kernel's own 2048.5 and half a line ahead; support data that ALE writes have (0.5, 2048.5) with the other sign along
  track: a line from ISIS's. MI's bands are lines of their own, told by NaifFrameCode.
"""

from dataclasses import replace

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    Interior,
    Keywords,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    LineTimes,
    by_addendum,
    interior_by_addendum,
    number,
    pds3_keys,
    scaled_interior,
    uniform,
)
from mgsgraph.files.opening import number_of
from mgsgraph.geometry.camera import Four, InteriorOrientation, KaguyaDistortion, KaguyaMiDistortion, LrocNacDistortion
from mgsgraph.units import ISIS_OFFSET, MM

# --- LROC

_LEFT, _RIGHT = -85600, -85610
_STRAIGHT = 1.3
CORRECTIONS = ("CONSTANT_TIME_OFFSET", "ADDITIONAL_PREROLL", "ADDITIVE_LINE_ERROR", "MULTIPLI_LINE_ERROR")
"""Names of the addendum."""


def _along_detector(keywords: Keywords, label: LineScanLabel) -> LrocNacDistortion:
    return LrocNacDistortion(number(keywords, f"INS{label.camera.instrument}_OD_K") / MM**2)


def corrected(keywords: Keywords, code: int, start: float, period: float) -> tuple[float, float]:
    """Time of the first line and its period (s) by those of the label: the line comes 1,024 lines after the preroll's
    clock count, and each takes 0.45 % longer than the label says.
    """
    offset, preroll, addend, factor = (number(keywords, f"INS{code}_{name}") for name in CORRECTIONS)
    period = period * (1.0 + factor) + addend
    return start + preroll * period + offset, period


def _line_times(keywords: Keywords, label: LineScanLabel, start: float, stop: float) -> LineTimes:
    first, period = corrected(keywords, label.camera.instrument, start, label.period)
    return uniform(first, period, label.lines, label.first_line)


def _not_turned(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """ISIS lronac2isis turns lines of the right camera round in files of the archive before version 1.30."""
    key = "PRODUCT_VERSION_ID"
    if block.kind == "pds3" and label.camera.instrument == _RIGHT and key in block:
        version = number_of(block.text(key).lower().removeprefix("v"), block.where(key))
        if version < _STRAIGHT:
            remedy = "its samples run the other way: take the newer file, or the cube of lronac2isis"
            raise InputError(block.where(key), block.text(key), f"v{_STRAIGHT:g} or later", remedy)
    return label


NAC = tuple(
    Camera(
        name=f"LRO LROC {name}", mission="LRO", spacecraft=-85, instrument=instrument,
        isis=LabelKeys(
            {"InstrumentId": identity}, ("SpacecraftClockStartCount", "InstrumentId"),
            start="SpacecraftClockPrerollCount", utc="PrerollTime", stop="StopTime", period="LineExposureDuration",
            sample_summing="SpatialSumming", first_sample="SampleFirstPixel",
        ),
        pds3=pds3_keys(
            {"INSTRUMENT_ID": "LROC", "FRAME_ID": side}, ("SPACECRAFT_CLOCK_START_COUNT",), serial_end=identity,
            start="LRO:SPACECRAFT_CLOCK_PREROLL_COUNT", utc="LRO:PREROLL_TIME", sample_summing="CROSSTRACK_SUMMING",
        ),
        interior=by_addendum(_along_detector), line_times=_line_times, label_facts=_not_turned,
        addendum="lro_instrumentAddendum_v04.ti", source="ISIS LroNarrowAngleCamera", pixels=5064, summing=2,
    )
    for name, instrument, identity, side in (("NAC-L", _LEFT, "NACL", "LEFT"), ("NAC-R", _RIGHT, "NACR", "RIGHT"))
)  # fmt: skip

# --- Kaguya

_KAGUYA = -131
_FIRST_PIXEL = {"FULL": 0, "NOMINAL": 296, "HALF": 1171}
"""Pixels before the first one of each swath mode (instrument kernel SEL_TC_V01.TI: 1, 297, 1172)."""


def _polynomials(keywords: Keywords, code: int, terms: int = 4) -> tuple[Four, Four]:
    """Distortion of x and y by powers of the place in m, the boresight in the first."""
    both = []
    for axis, centre in zip("XY", keywords.numbers(f"INS{code}_BORESIGHT", 2), strict=True):
        a = [*keywords.numbers(f"INS{code}_DISTORTION_COEF_{axis}", terms), *[0.0] * (4 - terms)]
        both.append(((a[0] + centre) * MM, float(a[1]), a[2] / MM, a[3] / MM**2))
    return both[0], both[1]


def _terrain(keywords: Keywords, label: LineScanLabel) -> KaguyaDistortion:
    return KaguyaDistortion(*_polynomials(keywords, label.camera.instrument))


def _terrain_by_instrument_kernel(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    """mm, first pixel 1; a pixel's place is r = -(n - centre) times its size."""
    code = label.camera.instrument
    per_metre = -1.0 / (number(keywords, f"INS{code}_PIXEL_SIZE") * MM)
    centre = float(keywords.numbers(f"INS{code}_CENTER", 1)[0]) - ISIS_OFFSET
    distortion = KaguyaMiDistortion(*_polynomials(keywords, code))
    return scaled_interior(label, number(keywords, f"INS{code}_FOCAL_LENGTH") * MM, per_metre, centre, distortion)


def _swath(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    key = "SwathModeId" if block.kind == "isis" else "SWATH_MODE_ID"
    mode = block.text(key).upper()
    if mode not in _FIRST_PIXEL:
        raise InputError(block.where(key), repr(mode), f"one of {', '.join(_FIRST_PIXEL)}")
    return replace(label, first_sample=label.first_sample + _FIRST_PIXEL[mode])


def _bands(terms: int) -> Interior:
    def interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
        code = label.camera.instrument
        sample, line = keywords.numbers(f"INS{code}_CENTER", 2)
        distortion = KaguyaMiDistortion(*_polynomials(keywords, code, terms))
        return interior_by_addendum(keywords, label, distortion, (line - 1.0, sample))

    return interior


TC = tuple(
    Camera(
        name=f"Kaguya {name}", mission="KAGUYA", spacecraft=_KAGUYA, instrument=instrument,
        frame=instrument + 1,  # LISM_TC1_HEAD -131350, LISM_TC2_HEAD -131370
        isis=LabelKeys(
            {"InstrumentId": name}, ("InstrumentId", "StartTime"), start="SpacecraftClockStartCount", stop="StopTime",
            period="LineSamplingInterval",
        ),
        pds3=pds3_keys(
            {"INSTRUMENT_ID": name}, ("INSTRUMENT_ID", "CORRECTED_START_TIME"), start="CORRECTED_SC_CLOCK_START_COUNT",
            utc="CORRECTED_START_TIME", stop="CORRECTED_STOP_TIME", period="CORRECTED_SAMPLING_INTERVAL",
        ),
        interior=by_addendum(_terrain), instrument_kernel=_terrain_by_instrument_kernel, label_facts=_swath,
        addendum="kaguyaTcAddendum007.ti", source="ISIS KaguyaTcCamera", pixels=4096, summing=1,
    )
    for name, instrument in (("TC1", -131351), ("TC2", -131371))
)  # fmt: skip
MI = tuple(
    Camera(
        name=f"Kaguya {name}{k + 1}", mission="KAGUYA", spacecraft=_KAGUYA, instrument=first - k,
        frame=frame,  # LISM_MI_V_HEAD, LISM_MI_N_HEAD
        isis=LabelKeys(
            {"InstrumentId": name.split()[0], "NaifFrameCode": str(first - k)}, ("InstrumentId", "StartTime"),
            start="StartTime", period="CorrectedSamplingInterval",
        ),
        pds3=None, interior=_bands(terms), start_is_utc=True, addendum="ISIS's addendum of MI",
        source="ISIS KaguyaMiCamera", pixels=pixels, summing=1,
    )
    for name, first, count, frame, terms, pixels in (
        ("MI-VIS MV", -131331, 5, -131330, 3, 962), ("MI-NIR MN", -131341, 4, -131340, 4, 320)
    )
    for k in range(count)
)  # fmt: skip
