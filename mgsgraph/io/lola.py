"""LOLA Reduced Data Records (RDR) of the Lunar Reconnaissance Orbiter, binary.

One record of 256 bytes, little-endian, per shot of the laser, with five spots on the ground; one file per orbit. Bytes,
units and flags: LOLARDR.FMT and the Software Interface Specification of LRO-L-LOLA-3-RDR-V1.0 (Neumann, 2016). The
coordinates are planetocentric in the Moon's mean-Earth, polar-axis frame.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError

SPOTS = 5
"""Spots of a shot."""
INVALID = 0xFF
"""Bits of a spot's flag, all of which are zero for a return from the ground."""
NO_RADIUS = -1
"""Where a spot has none."""
_SPOT = np.dtype([
    ("longitude", "<i4"),  # 1e-7 deg, east
    ("latitude", "<i4"),  # 1e-7 deg
    ("radius", "<i4"),  # mm; -1 for none
    ("range", "<u4"),  # mm, one-way
    ("pulse_width", "<i4"),  # ps
    ("energy", "<u4"),  # zJ
    ("noise", "<u4"),  # counts
    ("threshold", "<u4"),  # microvolt
    ("gain", "<u4"),  # 1e-6
    ("flag", "<u4"),
])
RECORD: np.dtype[np.void] = np.dtype([
    ("met_seconds", "<i4"),  # mission elapsed time
    ("met_fraction", "<u4"),  # 2^-32 s
    ("seconds", "<u4"),  # terrestrial time past J2000, at which the laser fired
    ("fraction", "<u4"),  # 2^-32 s
    ("laser_energy", "<i4"),  # nJ
    ("transmit_width", "<i4"),  # ps
    ("spacecraft_longitude", "<i4"),  # 1e-7 deg
    ("spacecraft_latitude", "<i4"),
    ("spacecraft_radius", "<u4"),  # mm
    ("selenoid_radius", "<u4"),  # mm, of the geoid under the spacecraft
    ("spots", _SPOT, (SPOTS,)),
    ("off_nadir", "<u2"),  # 5e-5 rad, as are the next three
    ("emission", "<u2"),
    ("incidence", "<u2"),
    ("phase", "<u2"),
    ("earth_range", "<u4"),
    ("earth_pulse_width", "<u2"),
    ("earth_energy", "<u2"),
])
"""One record as it lies in the file."""
_SELENOID = (1.72e9, 1.755e9)
"""mm, between which its radius lies."""
_YEARS = (2.8e8, 1.6e9)
"""s past J2000: LRO's mission begins in 2009, and doesn't last until 2050."""
_NO_SELENOID = 2**32 - 1


def is_lola_rdr(content: bytes) -> bool:
    """Whether a file's first records are those of LOLA: its selenoid's radius is where the format has it."""
    radii = np.frombuffer(content, RECORD, count=min(len(content) // RECORD.itemsize, 64))["selenoid_radius"]
    known = radii[radii != _NO_SELENOID]
    return bool(known.size and np.all((known > _SELENOID[0]) & (known < _SELENOID[1])))


def lola_records(content: bytes, path: Path) -> NDArray[np.void]:
    """Records (n,) of a file; InputError where it ends within one or the shots' times can't be."""
    size = RECORD.itemsize
    whole, rest = divmod(len(content), size)
    if rest:
        raise InputError(
            str(path), f"{whole} records and {rest} bytes more", f"records of {size} bytes",
            "the file is cut short: fetch it anew",
        )
    records = np.frombuffer(content, RECORD)
    outside = (records["seconds"] < _YEARS[0]) | (records["seconds"] > _YEARS[1])
    for k in np.flatnonzero(outside)[:1]:
        found = f"a time of {records['seconds'][k]} s past J2000"
        raise InputError(f"{path}, record {k + 1}", found, f"{_YEARS[0]:.0f} .. {_YEARS[1]:.0f} s")
    return records
