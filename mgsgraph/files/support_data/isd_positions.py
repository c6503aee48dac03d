"""Geometric positions of support data, whose tables hold what their keywords or their platform say."""

import re

import msgspec
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration, geometric
from mgsgraph.files.labels.stated_aberration import SPACECRAFT, Spacecraft, aberration_of, remarks_on
from mgsgraph.files.support_data.isd_layout import J2000, UNITS, RotationTable, StateTable, SupportData
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.plausibility import require_flight
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import PositionTable


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
        return apparent, list(remarks_on(stated, why))
    require_flight(apparent, where)
    radius = 0.5 * (body.equatorial + body.polar)
    found = geometric(apparent, _body_velocity(isd, f"{source}, sun_position"), stated, radius)
    return found, list(remarks_on(stated, why))


def require_j2000(table: StateTable | RotationTable, where: str) -> None:
    """Raise InputError for a table in another frame than J2000."""
    if table.reference_frame not in (msgspec.UNSET, J2000):
        raise InputError(f"{where}, reference_frame", f"{table.reference_frame:g}", "1 (J2000)")


def _stated(isd: SupportData, source: str) -> tuple[Aberration, str]:
    """By the keywords in the file, or else by the platform; never a guess. Why, where it was not the keywords."""
    if (stated := aberration_of(isd.naif_keywords, source)) is not None:
        return stated, ""
    spacecraft = _spacecraft(isd)
    if spacecraft is None:
        raise InputError(
            f"{source}, naif_keywords", f"no INS..._LIGHTTIME_CORRECTION, and the platform {isd.name_platform!r}",
            "a statement whether the positions are geometric or apparent",
            "set aberration = 'NONE' or 'LT+S' (and observer = 'body' or 'spacecraft') for this image in the case file",
        )  # fmt: skip
    return spacecraft.stated, spacecraft.source


def _spacecraft(isd: SupportData) -> Spacecraft | None:
    """By name_platform, or by the one whose instruments the keywords are of."""
    name = " ".join(re.split(r"[^A-Z0-9]+", (isd.name_platform or "").upper())).strip()
    codes = {int(key[3:].partition("_")[0]) // -1000 for key in isd.naif_keywords if re.match(r"INS-\d{5,6}_", key)}
    found = [one for one in SPACECRAFT if name in one.names]
    if not found and len(codes) == 1:
        found = [one for one in SPACECRAFT if -one.code in codes]
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
