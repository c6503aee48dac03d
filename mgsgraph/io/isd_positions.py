"""What the position table of support data holds: geometric or apparent positions, by its own keywords or by the sensor.

ISIS and ALE ask SPICE with "LT+S" and the body as observer unless an addendum's keywords INS..._LIGHTTIME_CORRECTION,
..._SWAP_OBSERVER_TARGET and ..._LT_SURFACE_CORRECT say otherwise (ISIS LightTimeCorrectionState, SpicePosition; ALE
ale/base/data_naif.py), and write what they found into naif_keywords. Where nothing stands there, the sensor decides.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import PositionTable
from mgsgraph.io.aberration import Aberration, Observer, geometric
from mgsgraph.io.isd_layout import J2000, UNITS, RotationTable, StateTable, SupportData

_DEFAULT = "ISIS and ALE take their default, no keyword being in its addendum"


@dataclass(frozen=True, slots=True)
class _Sensors:
    """The line scanners of one spacecraft."""

    spacecraft: int
    """NAIF's code, thousandths of the instruments'."""
    names: tuple[str, ...]
    """As name_platform says them, capitals, blanks for anything else."""
    stated: Aberration
    source: str
    """Why."""


_SENSORS = (
    _Sensors(-94, ("MARS GLOBAL SURVEYOR", "MGS"), Aberration("LT+S"), f"MGS: {_DEFAULT}"),
    _Sensors(-41, ("MARS EXPRESS", "MEX"), Aberration("LT+S"), f"MEX: {_DEFAULT}"),
    _Sensors(-74, ("MARS RECONNAISSANCE ORBITER", "MRO"), Aberration("LT+S"), f"MRO: {_DEFAULT}"),
    _Sensors(-53, ("MARS ODYSSEY", "ODYSSEY", "ODY", "M01"), Aberration("LT+S"), f"ODY: {_DEFAULT}"),
    _Sensors(-131, ("KAGUYA", "SELENE", "SELENE M"), Aberration("LT+S"),
             "Kaguya: ALE's selene_drivers take their default where the addendum says nothing"),
    _Sensors(-85, ("LUNAR RECONNAISSANCE ORBITER", "LRO"), Aberration("NONE"),
             "LRO: lro_drivers of ALE and lro_instrumentAddendum say NONE"),
    _Sensors(-155, ("KPLO", "KOREA PATHFINDER LUNAR ORBITER", "DANURI"), Aberration("NONE"),
             "KPLO: kplo_drivers of ALE say NONE"),
)  # fmt: skip


def positions(
    isd: SupportData, body: Ellipsoid, given: Aberration | None, source: str
) -> tuple[PositionTable, list[str]]:
    """Geometric positions at times past ``center_ephemeris_time``, and how they were come by, in sentences.

    Parameters
    ----------
    isd : SupportData
        What the file says.
    body : Ellipsoid
        For light time to the surface.
    given : Aberration, optional
        Overrules file and sensor.
    source : str
        The file, for messages.
    """
    table, where = isd.instrument_position, f"{source}, instrument_position"
    if table.velocities is None:
        raise InputError(where, "no velocities", "one per position", "write the support data with velocities")
    unit = UNITS[table.unit]
    apparent = PositionTable(
        np.array(table.ephemeris_times) - isd.center_ephemeris_time,
        np.array(table.positions).reshape(-1, 3) * unit, np.array(table.velocities).reshape(-1, 3) * unit,
    )  # fmt: skip
    stated, why = (given, "as the case says") if given else _stated(isd, source)
    if stated.correction == "NONE":
        return apparent, [f"positions are taken as geometric ({why})"] if why else []
    radius = 0.5 * (body.equatorial + body.polar)
    found = geometric(apparent, _body_velocity(isd, f"{source}, sun_position"), stated, radius)
    seen = "light time to the surface" if stated.to_surface else "light time and stellar aberration"
    return found, [f"{seen} taken off positions, the {stated.observer} being the observer ({why or 'naif_keywords'})"]


def require_j2000(table: StateTable | RotationTable, where: str) -> None:
    """Raise InputError for a table in another frame than J2000."""
    if table.reference_frame not in (msgspec.UNSET, J2000):
        raise InputError(f"{where}, reference_frame", f"{table.reference_frame:g}", "1 (J2000)")


def _stated(isd: SupportData, source: str) -> tuple[Aberration, str]:
    """By the keywords in the file, or else by the sensor; never a guess. Why, where it was not the keywords."""
    keywords = isd.naif_keywords
    correction = _keyword(keywords, "_LIGHTTIME_CORRECTION", source)
    if correction is None:
        sensors = _sensors(isd)
        if sensors is None:
            raise InputError(
                f"{source}, naif_keywords", f"no INS..._LIGHTTIME_CORRECTION, and the platform {isd.name_platform!r}",
                "a statement whether the positions are geometric or apparent",
                "set aberration = 'NONE' or 'LT+S' (and observer = 'body' or 'spacecraft') for this image in the case "
                "file",
            )  # fmt: skip
        return sensors.stated, sensors.source
    if not isinstance(correction, str) or correction.upper() not in ("NONE", "LT+S"):
        raise InputError(f"{source}, INS..._LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    swapped, to_surface = (
        _truth(keywords, key, source) for key in ("_SWAP_OBSERVER_TARGET", "_LT_SURFACE_CORRECT")
    )
    observer: Observer = "spacecraft" if swapped else "body"
    return (Aberration("NONE") if correction.upper() == "NONE" else Aberration("LT+S", observer, to_surface)), ""


def _keyword(keywords: Mapping[str, Any], end: str, source: str) -> Any:
    """Value of the instrument's keyword; None where there is none."""
    values = [value for key, value in keywords.items() if key.endswith(end)]
    if any(value != values[0] for value in values):
        found = f"keywords of several instruments that differ: {values}"
        raise InputError(f"{source}, naif_keywords", found, "those of the instrument that took the image")
    return ("" if values[0] is None else values[0]) if values else None


def _truth(keywords: Mapping[str, Any], end: str, source: str) -> bool:
    value = _keyword(keywords, end, source)
    if value is not None and str(value).upper() not in ("TRUE", "FALSE"):
        raise InputError(f"{source}, INS...{end}", repr(value), "true or false")
    return str(value).upper() == "TRUE"


def _sensors(isd: SupportData) -> _Sensors | None:
    """By name_platform, or by the one spacecraft whose instruments the keywords are of."""
    name = " ".join(re.split(r"[^A-Z0-9]+", (isd.name_platform or "").upper())).strip()
    codes = {int(key[3:].partition("_")[0]) // -1000 for key in isd.naif_keywords if re.match(r"INS-\d{5,6}_", key)}
    found = [one for one in _SENSORS if name in one.names]
    if not found and len(codes) == 1:
        found = [one for one in _SENSORS if -one.spacecraft in codes]
    return found[0] if found else None


def _body_velocity(isd: SupportData, where: str) -> Array:
    """m/s, (3,), of the body about the Sun at the image's middle: minus the Sun's about the body."""
    sun = isd.sun_position
    if sun is None or sun.velocities is None:
        found, expected = "no velocities", "the Sun's velocity, to undo the stellar aberration of positions"
        raise InputError(where, found, expected)
    require_j2000(sun, where)
    times, velocities = np.array(sun.ephemeris_times), np.array(sun.velocities).reshape(-1, 3) * UNITS[sun.unit]
    if np.any(np.diff(times) <= 0.0) or len(velocities) != times.size:
        found = f"{times.size} times and {len(velocities)} velocities"
        raise InputError(f"{where}, ephemeris_times", found, "increasing times, and a velocity for each")
    return np.array([-np.interp(isd.center_ephemeris_time, times, axis) for axis in velocities.T])
