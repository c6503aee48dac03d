"""Narrow angles (NAC-L, NAC-R) of the Lunar Reconnaissance Orbiter's camera.

Formulas: ISIS LroNarrowAngleCamera, LroNarrowAngleDistortionMap. The clock counts the preroll, not the first line, and
the lines take longer than the label says: the addendum (lro_instrumentAddendum_v04.ti) has both corrections.
"""

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    require_summing,
)
from mgsgraph.files.cameras.keywords import Keywords, number
from mgsgraph.files.cameras.line_times import LineTimes, uniform
from mgsgraph.files.opening import number_of
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import LrocNacDistortion
from mgsgraph.units import MM

_LEFT, _RIGHT = -85600, -85610
_STRAIGHT = 1.3
_PIXELS, _HIGHEST_SUMMING = 5064, 2
CORRECTIONS = ("CONSTANT_TIME_OFFSET", "ADDITIONAL_PREROLL", "ADDITIVE_LINE_ERROR", "MULTIPLI_LINE_ERROR")
"""Names of the addendum."""


def _interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, _HIGHEST_SUMMING, _PIXELS)
    k = number(keywords, f"INS{label.camera.instrument}_OD_K")
    return interior_by_addendum(keywords, label, LrocNacDistortion(k / MM**2))


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


def _camera(name: str, instrument: int, identity: str, side: str) -> Camera:
    return Camera(
        name=f"LRO {name}",
        mission="LRO",
        spacecraft=-85,
        instrument=instrument,
        isis=LabelKeys(
            identity={"InstrumentId": identity}, start="SpacecraftClockPrerollCount", utc="PrerollTime",
            stop="StopTime", period="LineExposureDuration", product="ProductId", target="TargetName",
            serial=("SpacecraftClockStartCount", "InstrumentId"),
            sample_summing="SpatialSumming", first_sample="SampleFirstPixel",
        ),
        pds3=LabelKeys(
            identity={"INSTRUMENT_ID": "LROC", "FRAME_ID": side}, start="LRO:SPACECRAFT_CLOCK_PREROLL_COUNT",
            utc="LRO:PREROLL_TIME", stop="STOP_TIME", period="LINE_EXPOSURE_DURATION", product="PRODUCT_ID",
            target="TARGET_NAME",
            serial=("SPACECRAFT_CLOCK_START_COUNT",), serial_end=identity, sample_summing="CROSSTRACK_SUMMING",
        ),
        interior=_interior,
        addendum="lro_instrumentAddendum_v04.ti",
        source="ISIS LroNarrowAngleCamera",
        line_times=_line_times,
        label_facts=_not_turned,
    )  # fmt: skip


NAC_LEFT = _camera("LROC NAC-L", _LEFT, "NACL", "LEFT")
NAC_RIGHT = _camera("LROC NAC-R", _RIGHT, "NACR", "RIGHT")
