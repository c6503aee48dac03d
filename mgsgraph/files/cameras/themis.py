"""Infrared camera of the Thermal Emission Imaging System (THEMIS) of Mars Odyssey.

Formulas and figures (those of T. Duxbury, 2009, with R. Kirk's offsets of April 2009): ISIS ThemisIrCamera,
ThemisIrDistortionMap. Each of the ten bands is read from other lines of the detector, some seconds apart: a cube of
several bands must say which one its pixels were brought to (ReferenceBand).
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
from mgsgraph.geometry.distortion import ThemisIrDistortion
from mgsgraph.units import MM

_INSTRUMENT = -53031
_PIXELS, _HIGHEST_SUMMING = 320, 320
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
    """When and where the band's line sees what the label's start says."""
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


def _interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, _HIGHEST_SUMMING, _PIXELS)
    centre = (0.0, _CENTRE - _ACROSS[label.band - 1])
    distortion = ThemisIrDistortion(_K[label.band - 1], _A1, _A2)
    return interior_by_addendum(keywords, label, distortion, centre, _FOCAL_LENGTH)


THEMIS = Camera(
    name="Odyssey THEMIS-IR",
    mission="Odyssey",
    spacecraft=-53,
    instrument=_INSTRUMENT,
    isis=LabelKeys(
        identity={"InstrumentId": "THEMIS_IR"}, start="SpacecraftClockCount", utc="StartTime", period="",
        product="ProductId", target="TargetName", serial=("InstrumentId", "SpacecraftClockCount"),
    ),
    pds3=None,
    interior=_interior,
    label_facts=_of_band,
    tables_of_bands=True,
    addendum="ISIS's addendum of THEMIS",
    source="ISIS ThemisIrCamera",
)  # fmt: skip
