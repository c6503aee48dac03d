"""Terrain Camera (TC1, TC2) and Multiband Imager (MI) of Kaguya (SELENE).

Formulas: ISIS KaguyaTcCamera, KaguyaMiCamera and their distortion maps. Times are those that the labels call corrected.
ISIS puts TC's principal point one detector line ahead of the line (2048.5, 1.0), ALE half a line: support data of TC
that ALE writes look half a pixel elsewhere along track. MI's bands are lines of their own, told by NaifFrameCode.
"""

from dataclasses import replace

from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import Four, KaguyaDistortion, KaguyaMiDistortion
from mgsgraph.io.cameras.camera import (
    Camera,
    Interior,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    require_summing,
)
from mgsgraph.io.cameras.keywords import Keywords
from mgsgraph.units import MM

_KAGUYA, _STRUCTURE = -131, -131000
_TC_PIXELS = 4096
_FIRST_PIXEL = {"FULL": 0, "NOMINAL": 296, "HALF": 1171}
"""Pixels before the first one of each swath mode (instrument kernel SEL_TC_V01.TI: 1, 297, 1172)."""
_TC_CENTRE = (1.0, 2048.5)
_VISIBLE, _INFRARED = range(-131331, -131336, -1), range(-131341, -131345, -1)
_VISIBLE_PIXELS, _INFRARED_PIXELS = 962, 320


def _polynomials(keywords: Keywords, code: int, terms: int) -> tuple[Four, Four]:
    """Distortion of x and y by powers of the place in m, the boresight in the first."""
    boresight = keywords.numbers(f"INS{code}_BORESIGHT", 3)
    both = []
    for axis, centre in zip("XY", boresight[:2], strict=True):
        a = [*keywords.numbers(f"INS{code}_DISTORTION_COEF_{axis}", terms), *[0.0] * (4 - terms)]
        both.append(((a[0] + centre) * MM, float(a[1]), a[2] / MM, a[3] / MM**2))
    return both[0], both[1]


def _terrain(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, 1, _TC_PIXELS)
    distortion = KaguyaDistortion(*_polynomials(keywords, label.camera.instrument, 4))
    return interior_by_addendum(keywords, label, distortion, _TC_CENTRE)


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
        structure=_STRUCTURE,
        frame=instrument + 1,  # LISM_TC1_HEAD -131350, LISM_TC2_HEAD -131370
        isis=LabelKeys(
            identity={"InstrumentId": name}, start="StartTime", utc="StartTime", period="LineSamplingInterval",
            product="ProductId", target="TargetName", serial=("InstrumentId", "StartTime"),
        ),
        pds3=LabelKeys(
            identity={"INSTRUMENT_ID": name}, start="CORRECTED_START_TIME", utc="CORRECTED_START_TIME",
            period="CORRECTED_SAMPLING_INTERVAL", product="PRODUCT_ID", target="TARGET_NAME",
            serial=("INSTRUMENT_ID", "CORRECTED_START_TIME"),
        ),
        interior=_terrain,
        label_facts=_swath,
        start_is_utc=True,
        addendum="kaguyaTcAddendum007.ti",
        source="ISIS KaguyaTcCamera",
    )  # fmt: skip


def _mi(name: str, instrument: int, terms: int, pixels: int) -> Camera:
    return Camera(
        name=f"Kaguya {name}",
        mission="KAGUYA",
        spacecraft=_KAGUYA,
        instrument=instrument,
        structure=_STRUCTURE,
        frame=-131330 if instrument in _VISIBLE else -131340,  # LISM_MI_V_HEAD, LISM_MI_N_HEAD
        isis=LabelKeys(
            identity={"InstrumentId": name.split()[0], "NaifFrameCode": str(instrument)}, start="StartTime",
            utc="StartTime", period="CorrectedSamplingInterval", product="ProductId", target="TargetName",
            serial=("InstrumentId", "StartTime"),
        ),
        pds3=None,
        interior=_bands(terms, pixels),
        start_is_utc=True,
        addendum="kaguyaMiAddendum003.ti",
        source="ISIS KaguyaMiCamera",
    )  # fmt: skip


TC1, TC2 = _tc("TC1", -131351), _tc("TC2", -131371)
MI = (
    *(_mi(f"MI-VIS MV{k + 1}", code, 3, _VISIBLE_PIXELS) for k, code in enumerate(_VISIBLE)),
    *(_mi(f"MI-NIR MN{k + 1}", code, 4, _INFRARED_PIXELS) for k, code in enumerate(_INFRARED)),
)
