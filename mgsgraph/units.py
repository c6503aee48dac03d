"""Conversion factors to SI and origins of pixel coordinates: the only place that has any.

Multiply by a factor to come in, divide to go out; take an offset off to come in, add it to go out.
"""

from math import pi

KM = 1e3
"""metre per kilometre"""
MM = 1e-3
"""metre per millimetre"""
MILLISECOND = 1e-3
"""second per millisecond"""
DEG = pi / 180.0
"""radian per degree"""
ARCMIN = DEG / 60.0
"""radian per minute of arc"""
ARCSEC = DEG / 3600.0
"""radian per second of arc"""
MGON = 1e-3 * pi / 200.0
"""radian per milligon; 400 gon are a turn"""
MRAD = 1e-3
"""radian per milliradian"""
PPM = 1e-6
"""ratio per part per million"""
SPEED_OF_LIGHT = 299_792_458.0
"""m/s, exact (CGPM 1983)"""
ISIS_OFFSET = 0.5
"""pixels: the first pixel's centre is (0.5, 0.5) here and (1, 1) in ISIS"""
ASP_OFFSET = -0.5
"""pixels: that centre is (0, 0) in the Ames Stereo Pipeline"""
