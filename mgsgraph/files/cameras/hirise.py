"""High Resolution Imaging Science Experiment (HiRISE) of Mars Reconnaissance Orbiter, one channel of one of its CCDs.

Formulas: ISIS HiriseCamera. The clock count is that of the first line of the time delay integration, read by the clock
of high precision (-74999); each CCD has an affine map of its own into the focal plane (`INS-74605_ITRANSL`).
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

_INSTRUMENT = -74699
_CCD_OF_CPMM = (0, 1, 2, 3, 12, 4, 10, 11, 5, 13, 6, 7, 8, 9)
_PIXELS, _HIGHEST_SUMMING = 2048, 16
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
        label,
        period=line * label.sample_summing,
        late=line * 0.5 * (label.sample_summing - delays),
        line_offset=0.5 * delays - _CENTRE_LINE,
        first_sample=label.first_sample + (_RIGHT_CHANNEL if channel == 0.0 else 0.0),
        detector=-74600 - _CCD_OF_CPMM[int(cpmm)],
    )


def _interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, _HIGHEST_SUMMING, _PIXELS)
    k0, k1, k2 = keywords.numbers(f"INS{_INSTRUMENT}_OD_K", 3)
    distortion = RadialDistortion(k0, k1 / MM**2, k2 / MM**4)
    return interior_by_addendum(keywords, label, distortion, (0.0, 1024.5))


HIRISE = Camera(
    name="MRO HiRISE",
    mission="MRO",
    spacecraft=-74,
    clock=-74999,
    instrument=_INSTRUMENT,
    frame=-74690,  # MRO_HIRISE_OPTICAL_AXIS
    isis=LabelKeys(
        identity={"InstrumentId": "HIRISE"}, start="SpacecraftClockStartCount", utc="StartTime", period="",
        product="ProductId", target="TargetName",
        serial=("InstrumentId", "ObservationStartCount", "CcdId", "ChannelNumber"), sample_summing="Summing",
    ),
    pds3=None,
    interior=_interior,
    label_facts=_delayed,
    addendum="hiriseAddendum006.ti",
    source="ISIS HiriseCamera",
)  # fmt: skip
