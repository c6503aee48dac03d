"""Instruments that are no line scanners: their images can't be adjusted here, and support data would not change that.

Names are those of INSTRUMENT_ID (with DETECTOR_ID and INSTRUMENT_MODE_ID behind it, where one camera has several
detectors) or INSTRUMENT_NAME of PDS3 labels, InstrumentId of ISIS cubes, and the sensor models of usgscsm.
"""

import re

_SENSORS = {
    "a push-frame camera": (
        "JNC", "JUNOCAM", "LROC BW", "LROC COLOR", "LROC UV", "LROC VIS", "MARCI", "MARS COLOR IMAGER", "THEMIS VIS",
        "USGS ASTRO PUSH FRAME", "WAC UV", "WAC VIS",
    ),
    "a frame camera": (
        "AMICA", "FC1", "FC2", "FHAZ", "FRONT HAZCAM", "HIGH RESOLUTION CAMERA", "HIRES", "HRSC MEX HRSC SRC",
        "HRSC SRC", "ICC", "IDC", "IMP", "ISSN", "ISSNA", "ISSW", "ISSWA", "LORRI", "LWIR", "M10", "MAHLI", "MAPCAM",
        "MARDI", "MAST", "MDIS", "MEDIUM RESOLUTION CAMERA", "MERCURY DUAL IMAGING", "METRIC", "MICROSCOPIC IMAGER",
        "MSI", "MULTI SPECTRAL IMAGER", "NARROW ANGLE CAMERA", "NAV LEFT", "NAV RIGHT", "NAVCAM", "NIR", "OCAMS",
        "ONC", "OSINAC", "OSIWAC", "PANCAM", "POLYCAM", "REAR HAZCAM", "RHAZ", "SAMCAM", "SOLID STATE IMAGING", "SRC",
        "SSI", "STAR TRACKER", "USGS ASTRO FRAME", "UVVIS", "VIS 1A", "VIS 1B", "VIS 2A", "VIS 2B", "VISA", "VISB",
        "VISUAL IMAGING SUBSYSTEM", "VMC", "WIDE ANGLE CAMERA",
    ),
    "radar": (
        "LRS", "MARSIS", "MINI RF", "MRFFR", "MRFLRO", "RADAR", "RDRS", "SAR", "SHALLOW RADAR", "SHARAD",
        "SYNTHETIC APERTURE RADAR", "USGS ASTRO SAR",
    ),
    "a map": ("USGS ASTRO PROJECTED",),
}  # fmt: skip


def sensor_kind(name: str) -> str:
    """What an instrument or sensor model is, by the words that its name begins with; empty for a line scanner, and for
    one that is not in the table.
    """
    words = " ".join(re.findall("[A-Z0-9]+", name.upper())) + " "
    kinds = (kind for kind, names in _SENSORS.items() if words.startswith(tuple(f"{prefix} " for prefix in names)))
    return next(kinds, "")


def model_words(model: object) -> str:
    """A sensor model as messages name it, with what it is for."""
    kind = sensor_kind(str(model))
    return repr(model)[:60] + (f", the model of {kind}" if kind else "")
