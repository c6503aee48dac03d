"""Conversion factors to SI: the only place that has any. Multiply to come in, divide to go out."""

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
SPEED_OF_LIGHT = 299_792_458.0
"""m/s, exact (CGPM 1983)"""
