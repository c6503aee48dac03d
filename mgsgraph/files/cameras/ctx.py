"""Context Camera (CTX) of Mars Reconnaissance Orbiter.

Formulas and sources: ISIS CTXCamera, CameraDistortionMap; an image summed 2 x 2 takes twice the label's line time per
line (mro_ctx_pds_sis.pdf: summing along track is done "by increasing the line time"; ISIS since 2012-12-27). Numbers
of masked pixels around those that see the ground: ISIS mroctx2isis. Constants: the addendum mroctxAddendum005.ti, which
cubes hold in their keywords; NAIF's instrument kernel mro_ctx_v11.ti has other names for them (`INS-74021_...`).
"""

from dataclasses import replace

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    require_summing,
)
from mgsgraph.files.cameras.keywords import Keywords
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import RadialDistortion
from mgsgraph.units import MM

MRO_CTX = -74021
_PIXELS, _HIGHEST_SUMMING = 5000, 2
_LINE, _MASKED, _MASKED_IN_PART = 5056, (38, 18), (16, 0)
"""Pixels of a whole line in the archive's files; masked ones before and after those that see the ground, in a whole
line and in a part of one. Files of summed images have half of each.
"""


def _interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, _HIGHEST_SUMMING, _PIXELS)
    k0, k1, k2 = keywords.numbers(f"INS{MRO_CTX}_OD_K", 3)
    return interior_by_addendum(keywords, label, RadialDistortion(k0, k1 / MM**2, k2 / MM**4))


def _without_masked(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
    """Samples of the archive's files begin and end with masked pixels, which SAMPLE_FIRST_PIXEL doesn't count."""
    if block.kind == "isis":
        return label
    summing = int(label.sample_summing)
    if label.sample_summing not in (1.0, 2.0):
        raise InputError(str(label.path), f"summing {label.sample_summing:g}", "1 or 2")
    whole = label.first_sample == 0.0
    if whole and label.samples != _LINE // summing:
        found = f"{label.samples} samples from the first pixel on"
        expected = f"{_LINE // summing}, masked ones included"
        raise InputError(str(label.path), found, expected, "take the archive's file, or its cube (mroctx2isis)")
    masked = sum(_MASKED if whole else _MASKED_IN_PART) // summing
    if label.samples <= masked:
        raise InputError(str(label.path), f"{label.samples} samples", f"more than the {masked} masked ones")
    return replace(label, samples=label.samples - masked)


CTX = Camera(
    name="MRO CTX",
    mission="MRO",
    spacecraft=-74,
    instrument=MRO_CTX,
    isis=LabelKeys(
        identity={"InstrumentId": "CTX"}, start="SpacecraftClockCount", utc="StartTime",
        stop="StopTime", period="LineExposureDuration",
        product="ProductId", target="TargetName", serial=("InstrumentId", "SpacecraftClockCount"),
        line_summing="SpatialSumming", sample_summing="SpatialSumming", first_sample="SampleFirstPixel",
    ),
    pds3=LabelKeys(
        identity={"INSTRUMENT_ID": "CTX"}, start="SPACECRAFT_CLOCK_START_COUNT", utc="START_TIME", stop="STOP_TIME",
        period="LINE_EXPOSURE_DURATION", product="PRODUCT_ID", target="TARGET_NAME",
        serial=("INSTRUMENT_ID", "SPACECRAFT_CLOCK_START_COUNT"),
        line_summing="SAMPLING_FACTOR", sample_summing="SAMPLING_FACTOR", first_sample="SAMPLE_FIRST_PIXEL",
    ),
    interior=_interior,
    addendum="mroctxAddendum005.ti",
    source="ISIS CTXCamera",
    label_facts=_without_masked,
)  # fmt: skip
