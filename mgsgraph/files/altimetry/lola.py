"""LOLA Reduced Data Records (RDR) of the Lunar Reconnaissance Orbiter, binary.

One record of 256 bytes, little-endian, per shot of the laser, with five spots on the ground; one file per orbit. Bytes,
units and flags: LOLARDR.FMT and the Software Interface Specification of LRO-L-LOLA-3-RDR-V1.0 (Neumann, 2016). The
coordinates are planetocentric in the Moon's mean-Earth, polar-axis frame.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shot_values import crossings, positions, shots_with
from mgsgraph.geometry.altimetry import LOLA, AltimeterShots
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import tdb_of_tt
from mgsgraph.units import DEG

SPOTS = 5
"""Spots of a shot."""
INVALID = 0xFF
"""Bits of a spot's flag, all of which are zero for a return from the ground."""
_SPOT = np.dtype([
    ("longitude", "<i4"),  # 1e-7 deg, east
    ("latitude", "<i4"),  # 1e-7 deg
    ("radius", "<i4"),  # mm; -1 for none
    ("range", "<u4"),  # mm, one-way
    ("pulse_width", "<i4"),  # ps
    ("energy", "<u4"),  # zJ
    ("noise", "<u4"),  # counts
    ("threshold", "<u4"),
    ("gain", "<u4"),
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
"""mm, between which the radius of the geoid lies."""
_YEARS = (2.8e8, 1.6e9)
"""s past J2000: LRO's mission begins in 2009, and doesn't last until 2050."""
_NO_RADIUS = -1
_NONE = 2**32 - 1
"""Of an unsigned number that is not known."""
_MM, _ANGLE, _OFF_NADIR = 1e-3, 1e-7, 5e-5
"""m, degrees and rad of the records' units."""


def is_lola_rdr(content: bytes) -> bool:
    """Whether a file's records are those of LOLA: the radius of the Moon's geoid is where the format has it."""
    whole = len(content) // RECORD.itemsize * RECORD.itemsize
    radii = np.frombuffer(content[:whole], RECORD)["selenoid_radius"]
    known = radii[radii != _NONE][:64]
    return bool(known.size and np.all((known > _SELENOID[0]) & (known < _SELENOID[1])))


def lola_shots(content: bytes, path: Path, clock_bias: float = 0.0) -> AltimeterShots:
    """Spots with a radius, record by record; a spot's name is its crossing, record (from 1) and number (1 .. 5).

    InputError where the file ends within a record, has no such spot, or where the time of a return from the ground
    can't be.
    """
    whole, rest = divmod(len(content), RECORD.itemsize)
    if rest:
        raise InputError(
            str(path), f"{whole} records and {rest} bytes more", f"records of {RECORD.itemsize} bytes",
            "the file is cut short: fetch it anew",
        )
    records = np.frombuffer(content, RECORD)
    ground = (records["spots"]["radius"] != _NO_RADIUS) & (records["spots"]["flag"] & INVALID == 0)
    outside = (records["seconds"] < _YEARS[0]) | (records["seconds"] > _YEARS[1])
    for k in np.flatnonzero(outside & ground.any(axis=1))[:1]:
        found = f"a time of {records['seconds'][k]} s past J2000"
        raise InputError(f"{path}, record {k + 1}", found, f"{_YEARS[0]:.0f} .. {_YEARS[1]:.0f} s")
    chosen = np.flatnonzero((records["spots"]["radius"] != _NO_RADIUS) & ~outside[:, None])
    if not chosen.size:
        found = f"{ground.size} shots, none of which reached the ground"
        raise InputError(str(path), found, "ground returns")
    return _shots(records, chosen, ground.ravel()[chosen], path, clock_bias)


def _shots(
    records: NDArray[np.void], chosen: NDArray[np.int64], ground: NDArray[np.bool_], path: Path, clock_bias: float
) -> AltimeterShots:
    """Those of all spots whose numbers, record by record, are `chosen`."""
    spots, owners = records["spots"].ravel()[chosen], records[chosen // SPOTS]
    record, spot = chosen // SPOTS + 1, chosen % SPOTS + 1
    times = tdb_of_tt(owners["seconds"] + owners["fraction"] * 2.0**-32)
    def known(values: NDArray[np.unsignedinteger]) -> Array:
        return np.where((values != _NONE) & (values > 0), values * _MM, np.nan)

    return shots_with(
        str(path), LOLA, times + clock_bias, positions(
            np.column_stack([spots["longitude"], spots["latitude"]]) * _ANGLE, spots["radius"] * _MM,
            lambda k: f"{path}, record {record[k]}, spot {spot[k]}",
        ),
        orbits=crossings(times, str(path)), frames=record, shots=spot, areoid_radii=known(owners["selenoid_radius"]),
        ranges=known(spots["range"]), off_nadir=owners["off_nadir"] * _OFF_NADIR, ground=ground,
        spacecraft=from_planetocentric(np.column_stack([
            owners["spacecraft_longitude"] * _ANGLE * DEG, owners["spacecraft_latitude"] * _ANGLE * DEG,
            known(owners["spacecraft_radius"]),
        ])),
    )  # fmt: skip
