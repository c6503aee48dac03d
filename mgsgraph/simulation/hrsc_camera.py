"""HRSC's nine lines as published, without kernels: what the simulated block, and anyone without SPICE, looks through.

Numbers are those of ISIS' addendum hrscAddendum004.ti (FOCAL_LENGTH, ITRANSL, ITRANSS), told as what they are made of:
each line is turned by theta in the focal plane of MEX_HRSC_HEAD and crosses its +Y axis (the flight direction; +X is
across, against the samples) at Y0, at detector sample So:

    x = -c p (sample - So),  y = Y0 + s p (sample - So),  c, s = cos, sin theta,  p = 7 um.

Y0 over the focal length is the angle by which a line looks ahead: 18.9 deg for S1 and S2, 12.75 deg for P1 and P2.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.units import MM


class CameraLine(NamedTuple):
    """One line of HRSC."""

    focal_length: float
    """mm."""
    offset: float
    """mm, Y0: ahead of the lens's axis."""
    turn: float
    """rad, theta."""
    crossing: float
    """So: detector sample, first pixel's centre at 1, at which the line crosses the axis of flight."""


LINES: dict[str, CameraLine] = {
    "S1": CameraLine(174.87, 59.9869, 0.00048, 2595.9317),
    "IR": CameraLine(174.82, 49.7918, 0.00044, 2594.8517),
    "P1": CameraLine(174.80, 39.5531, 0.00021, 2597.1421),
    "GREEN": CameraLine(175.23, 10.2130, 0.00095, 2598.8432),
    "ND": CameraLine(175.01, -0.0055, -0.00006, 2597.3376),
    "BLUE": CameraLine(175.01, -10.2417, 0.00019, 2602.0075),
    "P2": CameraLine(174.74, -39.5483, -0.00034, 2589.3140),
    "RED": CameraLine(174.61, -49.7678, -0.00004, 2585.3891),
    "S2": CameraLine(174.80, -59.9927, 0.00011, 2588.7635),
}
"""From the one that looks farthest ahead to the one that looks farthest back."""
STEREO = ("S1", "P1", "ND", "P2", "S2")
"""The five that tie points are matched in."""
PIXELS = 5184
"""Active pixels of a line."""

_PITCH_MM, _MIDDLE = 0.007, 2592.5
"""mm between pixels; detector sample, first pixel's centre at 1, of the lens's axis."""


def line_camera(name: str, macropixel: int = 1) -> InteriorOrientation:
    """Interior orientation of a line whose samples are means of `macropixel` detector pixels each."""
    if name not in LINES:
        raise InputError("HRSC", f"line {name!r}", f"one of {', '.join(LINES)}")
    line, pitch = LINES[name], _PITCH_MM * MM
    sine, cosine, ahead = np.sin(line.turn), np.cos(line.turn), line.offset / _PITCH_MM
    return InteriorOrientation(
        focal_length=line.focal_length * MM,
        to_pixel=np.array([
            [-cosine * ahead, sine / pitch, cosine / pitch],
            [line.crossing - _MIDDLE - sine * ahead, -cosine / pitch, sine / pitch],
        ]),
        centre=np.array([0.0, _MIDDLE - 0.5]),
        first=np.zeros(2),
        sample_summing=float(macropixel),
        distortion=NoDistortion(),
    )  # fmt: skip
