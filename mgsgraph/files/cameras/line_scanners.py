"""Line scanners about Mars but for HRSC, and about the Moon.

Mars: MOC (Mars Global Surveyor), CTX and HiRISE (Mars Reconnaissance Orbiter), the
infrared camera of THEMIS (Mars Odyssey).

* MOC, narrow angle, and the wide angles behind their red and blue filters. Formulas: ISIS MocNarrowAngleCamera,
  MocWideAngleCamera, MocWideAngleDistortionMap, MocLabels. Constants: the addendum mocAddendum004.ti, which keeps the
  nominal focal length of the narrow angle and widens the pitch instead (one pixel is then 3.750 microradians), or, for
  the narrow angle, NAIF's instrument kernel moc20.ti (3.714). Those of the wide angles' place behind the lens stand in
  ISIS's camera models (and in the addendum under BORESIGHT_SAMPLE and ALONGTRACK_OFFSET, which cubes don't hold).
* CTX. Formulas: ISIS CTXCamera, CameraDistortionMap; an image summed 2 x 2 takes twice the label's line time per line
  (mro_ctx_pds_sis.pdf: summing along track is done "by increasing the line time"; ISIS since 2012-12-27). Numbers of
  masked pixels around those that see the ground: ISIS mroctx2isis. Constants: the addendum mroctxAddendum005.ti; NAIF's
  instrument kernel mro_ctx_v11.ti has other names for them (`INS-74021_...`).
* HiRISE, one channel of one of its CCDs. Formulas: ISIS HiriseCamera. The clock count is that of the first line of the
  time delay integration, read by the clock of high precision (-74999); each CCD has an affine map of its own into the
  focal plane (`INS-74605_ITRANSL`).
* THEMIS. Formulas and figures (those of T. Duxbury, 2009, with R. Kirk's offsets of April 2009): ISIS ThemisIrCamera,
  ThemisIrDistortionMap. Each of the ten bands is read from other lines of the detector, some seconds apart: a cube of
  several bands must say which one its pixels were brought to (ReferenceBand).

The Moon: narrow angles of LROC (Lunar Reconnaissance Orbiter), and Terrain Camera and Multiband
Imager of Kaguya (SELENE).

* LROC NAC-L and NAC-R. Formulas: ISIS LroNarrowAngleCamera, LroNarrowAngleDistortionMap. The clock counts the preroll,
  not the first line, and the lines take longer than the label says: the addendum (lro_instrumentAddendum_v04.ti) has
  both corrections.
* Kaguya TC1, TC2 and MI. Formulas: ISIS KaguyaTcCamera, KaguyaMiCamera and their distortion maps; or, for TC, those of
  its instrument kernel SEL_TC_V01.TI, whose radius has a sign. Clock counts (TC) and UTC (MI) are those that the labels
  call corrected; counts are decimal, and lie 0.03 s after the UTC beside them by SEL_M_V01.TSC: ISIS and the CK go by
  the clock. The principal point of TC is at (line 0.5, sample 2048.0) in ISIS's addendum 007, half a sample from the
  kernel's own 2048.5 and half a line ahead; support data that ALE writes have (0.5, 2048.5) with the other sign along
  track: a line from ISIS's. MI's bands are lines of their own, known by NaifFrameCode.
"""

import re
from dataclasses import replace

from mgsgraph.errors import InputError, require
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
    radial,
    scaled_interior,
    uniform,
)
from mgsgraph.files.opening import number_of
from mgsgraph.geometry.camera import (
    Four,
    InteriorOrientation,
    KaguyaDistortion,
    KaguyaMiDistortion,
    LrocNacDistortion,
    MocWideAngleDistortion,
    NoDistortion,
    ThemisIrDistortion,
)
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.units import ISIS_OFFSET, MM

# --- MOC

Six = tuple[float, float, float, float, float, float]
ATTITUDE_BIAS = -1.15
"""s, by which ISIS looks attitude up earlier for MOC (addendum keyword INS-94031_CK_TIME_BIAS)."""
_NARROW, _RED, _BLUE = -94031, -94032, -94033
_VARIABLE_SUMMING = (13, 27)
"""Summings of the wide angles that change along the detector (ISIS mocxtrack.h)."""
_MARS = (3396.19, 3396.19, 3376.2)
"""km, IAU 2000, as in the PCK that spiceinit takes."""
_METRES_BELOW, _METRES_BELOW_WIDE = 100.0, 1.0
"""INS-94031_FOCAL_LENGTH is 3.5 (m) in the instrument kernel and 3500 (mm) in the addendum, and the later one wins; of
the wide angles not the unit alone is another."""
PITCH = 0.0131240578522949
"""mm, the narrow angle's."""


def _whole_pixels(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Check numbers of the label that can have few values only."""
    down = "DowntrackSumming" if block.kind == "isis" else "DOWNTRACK_SUMMING"
    first = "FirstLineSample" if block.kind == "isis" else "EDIT_MODE_ID"
    summed, camera = block.number(down), label.camera
    if not (1.0 <= summed <= camera.summing and summed % 1.0 == 0.0):
        raise InputError(block.where(down), f"{summed:g}", f"1 .. {camera.summing} for {camera.name}")
    if label.first_sample < 0.0 or label.first_sample % 1.0:
        raise InputError(block.where(first), block.text(first), "a whole number of detector pixels")
    return label


def _narrow(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    return interior_by_addendum(keywords, label, NoDistortion(), (0.0, 1024.5), _focal_length(keywords))


def _narrow_by_instrument_kernel(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    """m, first pixel 0."""
    per_metre = 1.0 / number(keywords, f"INS{_NARROW}_PIXEL_SIZE")
    centre = float(keywords.numbers(f"INS{_NARROW}_CENTER", 2)[0]) + ISIS_OFFSET
    return scaled_interior(label, _focal_length(keywords), per_metre, centre, NoDistortion())


def _focal_length(keywords: Keywords) -> float:
    stated = number(keywords, f"INS{_NARROW}_FOCAL_LENGTH")
    return stated if stated < _METRES_BELOW else stated * MM


def _wide(centre: float, offset: float, coefficients: Six, scale: float) -> Interior:
    """Of a wide angle whose principal point is at a detector sample, `offset` lines ahead of the detector."""

    def interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
        if label.sample_summing in _VARIABLE_SUMMING:
            found = f"summing {label.sample_summing:g}, which changes along the detector"
            raise InputError(str(label.path), found, "one that is the same for all samples: 1 to 127 but 13 and 27")
        name = f"INS{label.camera.instrument}_FOCAL_LENGTH"
        if (stated := number(keywords, name)) < _METRES_BELOW_WIDE:
            found, remedy = f"{stated:g} m, the instrument kernel's", "name the addendum after the instrument kernel"
            raise InputError(f"kernels, {name}", found, "the addendum's, such as 11.2 mm", remedy)
        distortion = MocWideAngleDistortion(coefficients, scale, stated * MM)
        return interior_by_addendum(keywords, label, distortion, (-offset, centre))

    return interior


def _moc(
    name: str, instrument: int, identity: dict[str, str], interior: Interior, constants: dict[str, tuple[float, ...]]
) -> Camera:
    pds = {"InstrumentId": "INSTRUMENT_ID", "FilterName": "FILTER_NAME"}
    narrow = instrument == _NARROW
    return Camera(
        name=f"MGS {name}", mission="MGS", spacecraft=-94, instrument=instrument,
        isis=LabelKeys(
            identity, ("SpacecraftClockCount", "InstrumentId", "FilterName"), stop="StopTime",
            period="LineExposureDuration", line_summing="DowntrackSumming", sample_summing="CrosstrackSumming",
            first_sample="FirstLineSample", first_pixel=1,
        ),
        pds3=pds3_keys(
            {pds[key]: value for key, value in identity.items()},
            ("SPACECRAFT_CLOCK_START_COUNT", "INSTRUMENT_ID", "FILTER_NAME"), line_summing="DOWNTRACK_SUMMING",
            sample_summing="CROSSTRACK_SUMMING", first_sample="EDIT_MODE_ID",
        ),
        interior=interior, instrument_kernel=_narrow_by_instrument_kernel if narrow else None,
        addendum="mocAddendum004.ti", source="ISIS MocNarrowAngleCamera, MocWideAngleCamera",
        pixels=2048 if narrow else 3456, summing=8 if narrow else 127,
        label_facts=_whole_pixels, attitude_bias=ATTITUDE_BIAS, constants_target="MARS",
        constants={"BODY499_RADII": _MARS} | {f"INS{instrument}_{key}": value for key, value in constants.items()},
    )  # fmt: skip


MOC = (
    _moc(
        "MOC-NA", _NARROW, {"InstrumentId": "MOC-NA"}, _narrow,
        {"FOCAL_LENGTH": (3500.0,), "ITRANSS": (0.0, 0.0, 1.0 / PITCH), "ITRANSL": (0.0, 1.0 / PITCH, 0.0)},
    ),
    _moc(
        "MOC-WA red", _RED, {"InstrumentId": "MOC-WA", "FilterName": "RED"},
        _wide(1674.65, 6.7785, (0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331), 1.0),
        {"FOCAL_LENGTH": (11.20537656,), "ITRANSS": (0.0, 0.0, -142.8571429), "ITRANSL": (0.0, 142.8571429, 0.0)},
    ),
    _moc(
        "MOC-WA blue", _BLUE, {"InstrumentId": "MOC-WA", "FilterName": "BLUE"},
        _wide(1688.58, -0.8486, (1.000246, 0.4612695, 0.2352545, 0.3535922, -0.2853861, 0.5574971), 1.000452),
        {"FOCAL_LENGTH": (11.22998086,), "ITRANSS": (0.0, 0.0, 142.857), "ITRANSL": (0.0, 142.857, 0.0)},
    ),
)  # fmt: skip

# --- CTX

_LINE, _MASKED, _MASKED_IN_PART = 5056, (38, 18), (16, 0)
"""Pixels of a whole line in the archive's files; masked ones before and after those that see the ground, in a whole
line and in a part of one. Files of summed images have half of each.
"""


def _without_masked(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Samples of the archive's files begin and end with masked pixels, which SAMPLE_FIRST_PIXEL doesn't count."""
    if block.kind == "isis":
        return label
    summing = int(label.sample_summing)
    require(label.sample_summing in (1.0, 2.0), str(label.path), f"summing {label.sample_summing:g}", "1 or 2")
    whole = label.first_sample == 0.0
    if whole and label.samples != _LINE // summing:
        found = f"{label.samples} samples from the first pixel on"
        expected = f"{_LINE // summing}, masked ones included"
        raise InputError(str(label.path), found, expected, "take the archive's file, or its cube (mroctx2isis)")
    masked = sum(_MASKED if whole else _MASKED_IN_PART) // summing
    require(label.samples > masked, str(label.path), f"{label.samples} samples", f"more than the {masked} masked ones")
    return replace(label, samples=label.samples - masked)


CTX = Camera(
    name="MRO CTX", mission="MRO", spacecraft=-74, instrument=-74021,
    isis=LabelKeys(
        {"InstrumentId": "CTX"}, ("InstrumentId", "SpacecraftClockCount"), stop="StopTime",
        period="LineExposureDuration", line_summing="SpatialSumming", sample_summing="SpatialSumming",
        first_sample="SampleFirstPixel",
    ),
    pds3=pds3_keys(
        {"INSTRUMENT_ID": "CTX"}, ("INSTRUMENT_ID", "SPACECRAFT_CLOCK_START_COUNT"), line_summing="SAMPLING_FACTOR",
        sample_summing="SAMPLING_FACTOR", first_sample="SAMPLE_FIRST_PIXEL",
    ),
    interior=by_addendum(radial), label_facts=_without_masked, addendum="mroctxAddendum005.ti",
    source="ISIS CTXCamera", pixels=5000, summing=2,
)  # fmt: skip

# --- HiRISE

_CCD_OF_CPMM = (0, 1, 2, 3, 12, 4, 10, 11, 5, 13, 6, 7, 8, 9)
_RIGHT_CHANNEL = 1024.0
"""Pixels before those that channel 0 reads."""
_CLOCK, _TICK = 74e-6, 1e-6 / 16.0
"""s: line period without any delay count, and what each of these adds."""
_CENTRE_LINE = 64.0
"""Detector lines from the edge of the CCD to its middle."""


def _delayed(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Line period, effective time and place of the first line, by time delay integration and binning."""
    delays, channel, cpmm, unit = (
        block.number(key) for key in ("Tdi", "ChannelNumber", "CpmmNumber", "DeltaLineTimerCount")
    )
    if not (0.0 <= cpmm < len(_CCD_OF_CPMM) and cpmm % 1.0 == 0.0):
        raise InputError(block.where("CpmmNumber"), f"{cpmm:g}", f"0 .. {len(_CCD_OF_CPMM) - 1}")
    line = _CLOCK + unit * _TICK
    return replace(
        label, period=line * label.sample_summing, late=line * 0.5 * (label.sample_summing - delays),
        line_offset=0.5 * delays - _CENTRE_LINE,
        first_sample=label.first_sample + (_RIGHT_CHANNEL if channel == 0.0 else 0.0),
        detector=-74600 - _CCD_OF_CPMM[int(cpmm)],
    )  # fmt: skip


HIRISE = Camera(
    name="MRO HiRISE", mission="MRO", spacecraft=-74, clock=-74999, instrument=-74699,
    frame=-74690,  # MRO_HIRISE_OPTICAL_AXIS
    isis=LabelKeys(
        {"InstrumentId": "HIRISE"}, ("InstrumentId", "ObservationStartCount", "CcdId", "ChannelNumber"),
        start="SpacecraftClockStartCount", sample_summing="Summing",
    ),
    pds3=None, interior=by_addendum(radial, (0.0, 1024.5)), label_facts=_delayed, addendum="hiriseAddendum006.ti",
    source="ISIS HiriseCamera", pixels=2048, summing=16,
)  # fmt: skip

# --- THEMIS

_FOCAL_LENGTH, _CENTRE = 203.9213 * MM, 160.5
_MIDDLE_LINE = 120.5
_PERIOD = 33.2871e-3
"""s per detector line."""
_INTEGRATED = (8.5, 24.5, 50.5, 76.5, 102.5, 128.5, 154.5, 180.5, 205.5, 231.5)
_SINGLE = (9.0, 24.0, 52.0, 77.0, 102.0, 129.0, 155.0, 181.0, 206.0, 232.0)
"""Detector line of each band, with time delay integration and without."""
_ALONG = (-0.076, -0.098, -0.089, -0.022, 0.0, -0.020, -0.005, -0.069, 0.025, 0.0)
_ACROSS = (0.021, 0.027, 0.005, 0.005, 0.0, -0.007, -0.012, -0.039, -0.045, 0.0)
"""Detector lines and samples by which each band lies off its place."""
_K = (0.996005, 0.995358, 0.994260, 0.993290, 0.992389, 0.991474, 0.990505, 0.989611, 0.988653, 0.9877)
_A1, _A2 = 0.00447623, 0.00107556 / MM
"""Of the distortion."""


def _of_band(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Time and detector line of the band, from the label's start."""
    summing = block.number("SpatialSumming") if "SpatialSumming" in block else 1.0
    key = "ReferenceBand" if "ReferenceBand" in block else "FilterNumber"
    stated = block.words(key)
    if len(stated) != 1 or stated[0] not in map(str, range(1, len(_K) + 1)):
        remedy = "take one band out of it, or have all brought to one (ReferenceBand)"
        raise InputError(block.where(key), f"the bands {', '.join(stated)}", "one of 1 .. 10", remedy)
    band = int(stated[0])
    integrated = block.text("TimeDelayIntegration").upper() == "ENABLED"
    line = (_INTEGRATED if integrated else _SINGLE)[band - 1]
    period = _PERIOD * summing
    offset = block.number("SpacecraftClockOffset", {"seconds": 1.0, "s": 1.0, "ms": 1e-3, "": 1.0})
    return replace(
        label, band=band, period=period, sample_summing=summing, late=offset + (line - 0.5) * period / summing,
        line_offset=_MIDDLE_LINE - line + _ALONG[band - 1],
    )  # fmt: skip


def themis_of_line(line: float) -> ThemisIrDistortion | None:
    """Distortion of the band whose place along track ALE's support data give as a detector line from 120 on; None where
    it is no band's.
    """
    for k, (*lines, along) in enumerate(zip(_INTEGRATED, _SINGLE, _ALONG, strict=True)):
        if any(abs(_MIDDLE_LINE - ISIS_OFFSET - detector_line + along - line) < 1e-3 for detector_line in lines):
            return ThemisIrDistortion(_K[k], _A1, _A2)
    return None


def _infrared(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    centre = (0.0, _CENTRE - _ACROSS[label.band - 1])
    distortion = ThemisIrDistortion(_K[label.band - 1], _A1, _A2)
    return interior_by_addendum(keywords, label, distortion, centre, _FOCAL_LENGTH)


THEMIS = Camera(
    name="Odyssey THEMIS-IR", mission="Odyssey", spacecraft=-53, instrument=-53031,
    isis=LabelKeys({"InstrumentId": "THEMIS_IR"}, ("InstrumentId", "SpacecraftClockCount")),
    pds3=None, interior=_infrared, label_facts=_of_band, tables_of_bands=True, addendum="ISIS's addendum of THEMIS",
    source="ISIS ThemisIrCamera", pixels=320, summing=320,
)  # fmt: skip


# --- LROC

_LEFT, _RIGHT = -85600, -85610
_STRAIGHT = 1.3
_PREROLL, _LONGER, _PREROLL_SLACK, _MILLISECOND = 1024.0, 1.0045, 0.002, 0.002
"""Lines before the first one; true line periods by the label's; share, and s of both rounded times, that may be off."""
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
    """ISIS lronac2isis turns lines of the right camera round in files of the archive before version 1.30. The product's
    name says the side, too, and the preroll takes 1,024 line periods.
    """
    side = re.fullmatch(r"[MN]\d+([LR])[EC]", label.product)
    if side and (side[1] == "R") != (label.camera.instrument == _RIGHT):
        found, expected = f"the product {label.product} of {label.camera.name}", "one side: FRAME_ID and PRODUCT_ID"
        raise InputError(str(label.path), found, expected, "fetch the label again")
    if block.kind == "pds3" and all(key in block for key in ("LRO:PREROLL_TIME", "START_TIME")):
        before, after = tdb_of_utc([block.text("LRO:PREROLL_TIME"), block.text("START_TIME")], str(label.path))
        periods = (after - before) / (label.period * _LONGER)
        if abs(periods - _PREROLL) > _PREROLL_SLACK * _PREROLL + _MILLISECOND / label.period:
            found = f"START_TIME {after - before:.3f} s after the preroll, {periods:.1f} line periods"
            raise InputError(block.where("LINE_EXPOSURE_DURATION"), found, f"{_PREROLL:g} of them", "fix one")
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
    require(mode in _FIRST_PIXEL, block.where(key), repr(mode), f"one of {', '.join(_FIRST_PIXEL)}")
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
