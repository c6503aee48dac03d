"""What all files of laser shots have: places in degrees and some unit of length, crossings between pauses; and what
shots can't be, whatever file they come from.

Medians find a unit that was exchanged; one damaged shot among thousands does not move them, and shows shot by shot.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.altimetry import Altimeter, AltimeterShots, exchanged_units, require_lengths
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, require_near
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import require_years, utc_of_tdb
from mgsgraph.units import DEG, KM

_PAUSE = 1800.0
"""s without a shot, after which another profile begins: an orbit takes two hours or so."""
_LARGEST = 1e9
"""m, larger than any planet."""
_TOLERANCE = 0.1
"""Part of the body's radius by which a file's median radius may differ from it."""

_RELIEF = 0.03
"""Part of a body's radius by which its ground lies at most above or below: 100 km on Mars, 50 km on the Moon."""
_WAY = 0.02
"""Part of the way from the spacecraft to the footprint by which a range may be another: archives compute one of the
other, and LOLA's 52,363 points over Hadley agree to 2e-5."""
_DAMAGED = "the file is damaged: fetch it again, or take that shot out"


def shots_with(
    source: str, altimeter: Altimeter, times: Array, footprints: Array, **stated: Array | Index | Mask
) -> AltimeterShots:
    """Shots of a file; unstated fields are NaN or 0, names are row and 1, and all shots are ground returns."""
    n = times.size
    nothing = np.full(n, np.nan)
    unknown = dict.fromkeys(
        ("areoid_radii", "ranges", "range_corrections", "off_nadir", "clocks", "pulses"), nothing
    ) | {"spacecraft": np.full((n, 3), np.nan), "ground": np.ones(n, dtype=bool), "frames": np.arange(1, n + 1)}
    numbers = {"orbits": np.zeros(n, np.int64), "shots": np.ones(n, np.int64), "channels": np.zeros(n, np.int64)}
    fields: dict[str, Any] = unknown | numbers | stated
    return AltimeterShots(source=source, altimeter=altimeter, times=times, footprints=footprints, **fields)


def unit_of_radii(radii: Array, body: Ellipsoid | None, where: str) -> float:
    """M of the unit in which radii (n,) of a column without unit are those of the body."""
    if body is None:
        raise InputError(where, "a radius without unit", "radius_m or radius_km")
    median = float(np.median(radii))
    for unit in (1.0, KM):
        if abs(median * unit / body.equatorial - 1.0) <= _TOLERANCE:
            return unit
    raise InputError(
        where, f"a median of {median:g}", f"the body's radius, {body.equatorial / KM:.1f} km, in m or km",
        "name the column radius_m or radius_km, and give shots on this body",
    )


def positions(angles: Array, radii: Array, where: Callable[[int], str]) -> Array:
    """(n, 3) m, body-fixed, of longitudes and planetocentric latitudes (n, 2) in degrees and radii (n,) in m.

    `where` names the line or record of the k-th shot in errors.
    """
    for name, values, least, largest in (
        ("longitude", angles[:, 0], -180.0, 360.0), ("latitude", angles[:, 1], -90.0, 90.0),
    ):
        for k in np.flatnonzero((values < least) | (values > largest))[:1]:
            raise InputError(f"{where(int(k))}, {name}", f"{values[k]:g} degrees", f"{least:g} .. {largest:g}")
    for k in np.flatnonzero(~((radii > 0.0) & (radii < _LARGEST)))[:1]:
        raise InputError(f"{where(int(k))}, radius", f"{radii[k]:g} m", "a positive number, that of a body")
    return from_planetocentric(np.column_stack([angles * DEG, radii]))


def known_ranges(ranges: Array, ground: Mask, none: float = 0.0) -> Array:
    """Ranges (n,) in m, NaN where the archive has 0 or less, down to what it writes for none, and where what it has of
    a shot that didn't reach the ground is negative; other negative ones stay, and are refused.
    """
    return np.where((ranges <= 0.0) & ((ranges >= none) | ~ground), np.nan, ranges)


def whole_numbers(values: Array, where: Callable[[int], str], largest: float = 2.0**32) -> Index:
    """Values (n,) as the whole numbers from 0 that they must be; `where` names the k-th in errors."""
    for k in np.flatnonzero(~((values >= 0.0) & (values <= largest)) | (values % 1.0 != 0.0))[:1]:
        raise InputError(where(int(k)), f"{values[k]:g}", f"a whole number, 0 .. {largest:g}")
    return values.astype(np.int64)


def by_pauses(times: Array) -> tuple[Index, Index]:
    """Number (n,) from 0 of each shot's profile, and the first shot (p,) of each: a pause lies between two profiles."""
    order = np.argsort(times, kind="stable")
    begins = np.diff(times[order], prepend=-np.inf) > _PAUSE
    numbers = np.empty(times.size, dtype=np.int64)
    numbers[order] = np.cumsum(begins) - 1
    return numbers, order[begins]


def crossings(times: Array, source: str) -> Index:
    """Number (n,) of each shot's crossing between pauses: year to minute (UTC) in which it began.

    InputError names the `source` of times (s TDB past J2000) that can't be.
    """
    require_years(times, source)
    numbers, first = by_pauses(times)
    minutes = [int(f"{utc_of_tdb(times[k]):%Y%m%d%H%M}") for k in first.tolist()]
    return np.array(minutes, dtype=np.int64)[numbers]


def require_records(label: Block, count: int, before: int = 0) -> None:
    """Raise InputError where a file has another number of records than its label counts (FILE_RECORDS), itself among
    them if it is `before` the others.
    """
    if "FILE_RECORDS" not in label:
        return
    counted = label.count("FILE_RECORDS")
    if count not in (counted, counted + before):  # a few count what is behind the label alone
        remedy = "the file is cut short: fetch it again" if count < counted else "fetch file and label again"
        raise InputError(label.where("FILE_RECORDS"), f"{counted}, and {count} records in the file", "as many", remedy)


def require_radii(radii: Array, body: Ellipsoid | None, where: str) -> None:
    """Raise InputError where the median of radii (n,) in m is not that of a body, which a wrong unit would make, or any
    of them far from it.
    """
    if body is None:
        return
    if abs(float(np.median(radii)) / body.equatorial - 1.0) > _TOLERANCE:
        raise InputError(
            where, f"a median radius of {np.median(radii) / KM:.1f} km",
            f"that of the body, {body.equatorial / KM:.1f} km, to 10 per cent",
            "give shots on this body, or check the unit of their radii",
        )
    require_near(radii, body, lambda k: f"{where}, shot {k + 1}")


def require_possible_shots(shots: AltimeterShots) -> None:
    """Raise InputError for a ground return, by its name, at a time at which its mission didn't fly, at a radius that
    its body doesn't have, at a range that its altimeter doesn't reach or that isn't the way from its spacecraft.
    """
    ways = np.linalg.norm(shots.spacecraft - shots.footprints, axis=1)
    comparable = np.isfinite(ways) & np.isfinite(shots.ranges)
    if np.any(comparable):
        require_lengths(shots.ranges[comparable], ways[comparable], "ranges", shots.source)
    altimeter, body, where = shots.altimeter, shots.altimeter.body, f"{shots.source}, shot"
    radii = np.linalg.norm(shots.footprints, axis=1)
    ground = (0.0, np.inf) if body is None else (body.polar * (1.0 - _RELIEF), body.equatorial * (1.0 + _RELIEF))
    for what, values, (least, largest), unit, name in (
        ("time", shots.times, altimeter.mission, 1.0, "s past J2000"), ("radius", radii, ground, KM, "km"),
        ("range", shots.ranges, altimeter.reach, KM, "km"),
    ):
        for k in np.flatnonzero(shots.ground & ((values < least) | (values > largest)))[:1].tolist():
            ratio = next((factor for factor in (1000.0, 0.001) if least <= values[k] / factor <= largest), 1.0)
            remedy = exchanged_units(ratio) if unit == KM else ""
            found = f"a {what} of {values[k] / unit:.7g} {name}"
            expected = f"{least / unit:.7g} .. {largest / unit:.7g}"
            raise InputError(f"{where} {shots.ids[k]}", found, f"{expected} for {altimeter.name}", remedy or _DAMAGED)
    for k in np.flatnonzero(shots.ground & (np.abs(shots.ranges - ways) > _WAY * ways))[:1].tolist():
        found, expected = f"a range of {shots.ranges[k] / KM:.7g} km", f"about {ways[k] / KM:.7g} km"
        raise InputError(f"{where} {shots.ids[k]}", found, f"{expected}, the way from the spacecraft", _DAMAGED)
