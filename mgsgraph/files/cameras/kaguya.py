"""Terrain Camera (TC1, TC2) and Multiband Imager (MI) of Kaguya (SELENE).

Formulas: ISIS KaguyaTcCamera, KaguyaMiCamera and their distortion maps; or, for TC, those of its instrument kernel
SEL_TC_V01.TI, whose radius has a sign. Clock counts (TC) and UTC (MI) are those that the labels call corrected; counts
are decimal, and lie 0.03 s after the UTC beside them by SEL_M_V01.TSC: ISIS and the CK go by the clock. The principal
point of TC is at (line 0.5, sample 2048.0) in ISIS's addendum 007, half a sample from the kernel's own 2048.5 and half
a line ahead; support data that ALE writes have (0.5, 2048.5) with the other sign along track: a line from ISIS's. MI's
bands are lines of their own, told by NaifFrameCode.
"""

from dataclasses import replace

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    Interior,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    require_summing,
)
from mgsgraph.files.cameras.keywords import Keywords, number
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import Four, KaguyaDistortion, KaguyaMiDistortion
from mgsgraph.units import ISIS_OFFSET, MM

_KAGUYA = -131
_TC_PIXELS = 4096
_FIRST_PIXEL = {"FULL": 0, "NOMINAL": 296, "HALF": 1171}
"""Pixels before the first one of each swath mode (instrument kernel SEL_TC_V01.TI: 1, 297, 1172)."""
_VISIBLE, _INFRARED = range(-131331, -131336, -1), range(-131341, -131345, -1)
_VISIBLE_PIXELS, _INFRARED_PIXELS = 962, 320


def _polynomials(keywords: Keywords, code: int, terms: int) -> tuple[Four, Four]:
    """Distortion of x and y by powers of the place in m, the boresight in the first."""
    both = []
    for axis, centre in zip("XY", keywords.numbers(f"INS{code}_BORESIGHT", 2), strict=True):
        a = [*keywords.numbers(f"INS{code}_DISTORTION_COEF_{axis}", terms), *[0.0] * (4 - terms)]
        both.append(((a[0] + centre) * MM, float(a[1]), a[2] / MM, a[3] / MM**2))
    return both[0], both[1]


def _terrain(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, 1, _TC_PIXELS)
    distortion = KaguyaDistortion(*_polynomials(keywords, label.camera.instrument, 4))
    return interior_by_addendum(keywords, label, distortion)


def _terrain_by_instrument_kernel(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    """mm, first pixel 1; a pixel's place is r = -(n - centre) times its size."""
    require_summing(label, 1, _TC_PIXELS)
    code = label.camera.instrument
    per_metre = 1.0 / (number(keywords, f"INS{code}_PIXEL_SIZE") * MM)
    return InteriorOrientation(
        focal_length=number(keywords, f"INS{code}_FOCAL_LENGTH") * MM,
        to_pixel=np.array([[0.0, -per_metre, 0.0], [0.0, 0.0, -per_metre]]),
        centre=np.array([0.0, keywords.numbers(f"INS{code}_CENTER", 1)[0] - ISIS_OFFSET]),
        first=np.array([0.0, label.first_sample]),
        sample_summing=1.0,
        distortion=KaguyaMiDistortion(*_polynomials(keywords, code, 4)),
    )


def _swath(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    key = "SwathModeId" if block.kind == "isis" else "SWATH_MODE_ID"
    mode = block.text(key).upper()
    if mode not in _FIRST_PIXEL:
        raise InputError(block.where(key), repr(mode), f"one of {', '.join(_FIRST_PIXEL)}")
    return replace(label, first_sample=label.first_sample + _FIRST_PIXEL[mode])


def _bands(terms: int, pixels: int) -> Interior:
    def interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
        code = label.camera.instrument
        require_summing(label, 1, pixels)
        sample, line = keywords.numbers(f"INS{code}_CENTER", 2)
        distortion = KaguyaMiDistortion(*_polynomials(keywords, code, terms))
        return interior_by_addendum(keywords, label, distortion, (line - 1.0, sample))

    return interior


def _tc(name: str, instrument: int) -> Camera:
    return Camera(
        name=f"Kaguya {name}",
        mission="KAGUYA",
        spacecraft=_KAGUYA,
        instrument=instrument,
        frame=instrument + 1,  # LISM_TC1_HEAD -131350, LISM_TC2_HEAD -131370
        isis=LabelKeys(
            identity={"InstrumentId": name}, start="SpacecraftClockStartCount", utc="StartTime",
            stop="StopTime", period="LineSamplingInterval", product="ProductId", target="TargetName",
            serial=("InstrumentId", "StartTime"),
        ),
        pds3=LabelKeys(
            identity={"INSTRUMENT_ID": name}, start="CORRECTED_SC_CLOCK_START_COUNT",
            utc="CORRECTED_START_TIME", stop="CORRECTED_STOP_TIME", period="CORRECTED_SAMPLING_INTERVAL",
            product="PRODUCT_ID", target="TARGET_NAME",
            serial=("INSTRUMENT_ID", "CORRECTED_START_TIME"),
        ),
        interior=_terrain,
        instrument_kernel=_terrain_by_instrument_kernel,
        label_facts=_swath,
        addendum="kaguyaTcAddendum007.ti",
        source="ISIS KaguyaTcCamera",
    )  # fmt: skip


def _mi(name: str, instrument: int, terms: int, pixels: int) -> Camera:
    return Camera(
        name=f"Kaguya {name}",
        mission="KAGUYA",
        spacecraft=_KAGUYA,
        instrument=instrument,
        frame=-131330 if instrument in _VISIBLE else -131340,  # LISM_MI_V_HEAD, LISM_MI_N_HEAD
        isis=LabelKeys(
            identity={"InstrumentId": name.split()[0], "NaifFrameCode": str(instrument)}, start="StartTime",
            utc="StartTime", period="CorrectedSamplingInterval", product="ProductId", target="TargetName",
            serial=("InstrumentId", "StartTime"),
        ),
        pds3=None,
        interior=_bands(terms, pixels),
        start_is_utc=True,
        addendum="ISIS's addendum of MI",
        source="ISIS KaguyaMiCamera",
    )  # fmt: skip


TC1, TC2 = _tc("TC1", -131351), _tc("TC2", -131371)
MI = (
    *(_mi(f"MI-VIS MV{k + 1}", code, 3, _VISIBLE_PIXELS) for k, code in enumerate(_VISIBLE)),
    *(_mi(f"MI-NIR MN{k + 1}", code, 4, _INFRARED_PIXELS) for k, code in enumerate(_INFRARED)),
)
