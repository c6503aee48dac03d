"""Apparent position tables made geometric.

Support data of MGS, HRSC and CTX hold positions corrected for light time and stellar aberration (SPICE "LT+S"): 55 to
220 m away from where the camera was. A range, and a camera, need the geometric position. What is undone here (Park's
and NAIF's definition, ``spkezr`` required reading): the light time, iterated on the table itself, and the aberration by
the observer's velocity about the Sun, which the support data give with the Sun's position. The Sun's own motion about
the barycentre (about 13 m/s) is left out: at most 0.2 m.

Whether a table holds geometric or apparent positions its keywords say, or the spacecraft. ISIS and ALE ask SPICE with
"LT+S" and the body as observer unless an addendum's keywords INS..._LIGHTTIME_CORRECTION, ..._SWAP_OBSERVER_TARGET and
..._LT_SURFACE_CORRECT say otherwise (ISIS LightTimeCorrectionState, SpicePosition with its m_swapObserverTarget; ALE
ale/base/data_naif.py).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.plausibility import require_slow
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import PositionTable
from mgsgraph.units import SPEED_OF_LIGHT

Observer = Literal["body", "spacecraft"]
_VELOCITY_STEP = 0.05
"""s, step of the central difference that gives the velocities of the geometric table."""
_ITERATIONS = 5
"""Each leaves about v / c, 1e-4, of the error."""
_FASTEST_BODY = 1e5
"""m/s about the Sun; Mercury's perihelion has 5.9e4."""


@dataclass(frozen=True, slots=True)
class Aberration:
    """How the position table of an image was asked from SPICE."""

    correction: Literal["NONE", "LT+S"]
    """Aberration correction."""
    observer: Observer = "body"
    """Who observed whom; without meaning for "NONE"."""
    to_surface: bool = False
    """Light time from the body's surface, not its centre, and no stellar aberration then (ISIS SpacecraftPosition,
    ALE data_naif, sensor_position: the state of the target so long before, both about the barycentre)."""


def geometric(apparent: PositionTable, body_velocity: Array, stated: Aberration, radius: float = 0.0) -> PositionTable:
    """Geometric table, at the same times, of an apparent one.

    Parameters
    ----------
    apparent : PositionTable
        Camera relative to the body's centre, inertial.
    body_velocity : (3,)
        m/s, of the body's centre relative to the Sun, inertial.
    stated : Aberration
        How it was asked for.
    radius : float
        m, mean of the body's equatorial and polar one: where light is taken from that goes to the surface.
    """
    if stated.correction == "NONE":
        return apparent
    require_slow(body_velocity, "velocity of the Sun", _FASTEST_BODY)
    undo = _seen_from_body if stated.observer == "body" else _seen_from_spacecraft
    saved = radius / SPEED_OF_LIGHT if stated.to_surface else None

    def positions(times: Array) -> Array:
        return undo(apparent, times, body_velocity, saved)

    before, after = positions(apparent.times - _VELOCITY_STEP), positions(apparent.times + _VELOCITY_STEP)
    return PositionTable(apparent.times, positions(apparent.times), (after - before) / (2.0 * _VELOCITY_STEP))


def _seen_from_body(apparent: PositionTable, times: Array, body_velocity: Array, saved: float | None) -> Array:
    """The body sees the craft where it was one light time before: the table is read that much later."""
    position, light_time = np.zeros((times.size, 3)), np.zeros((times.size, 1))
    for _ in range(_ITERATIONS):
        vector, velocity = apparent.at(times + light_time[:, 0])
        true = vector if saved is not None else without_aberration(vector, body_velocity)
        position = true + light_time * body_velocity
        light_time = _light_time(position + light_time * velocity) - (saved or 0.0)
    return position


def _seen_from_spacecraft(apparent: PositionTable, times: Array, body_velocity: Array, saved: float | None) -> Array:
    """The craft sees the body where that was one light time before; the table holds the opposite vector."""
    position, velocity = apparent.at(times)
    to_body = -position if saved is not None else without_aberration(-position, body_velocity + velocity)
    for _ in range(_ITERATIONS):
        position = -(to_body + (_light_time(position) - (saved or 0.0)) * body_velocity)
    return position


def _light_time(position: Array) -> Array:
    """s, (n, 1), of geometric positions (n, 3) at the time asked for: SPICE's "LT" iterates once, so it takes these."""
    return np.asarray(np.linalg.norm(position, axis=1, keepdims=True) / SPEED_OF_LIGHT)


def without_aberration(seen: Array, observer_velocity: Array) -> Array:
    """Directions before stellar aberration (inverse of NAIF ``stelab``), lengths kept; seen (n, 3), velocity (n, 3)."""
    length = np.linalg.norm(seen, axis=1, keepdims=True)
    target = seen / length
    beta = observer_velocity / SPEED_OF_LIGHT
    true = target
    for _ in range(_ITERATIONS):
        true = target + (true - aberrated(true, beta))
        true = unit_vectors(true)
    return np.asarray(true * length)


def aberrated(direction: Array, beta: Array) -> Array:
    """Unit directions turned towards the velocity by asin |u x beta| (NAIF ``stelab``)."""
    axis = np.cross(direction, beta)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    across = np.cross(axis, direction) / np.where(sine == 0.0, 1.0, sine)
    return np.asarray(np.sqrt(1.0 - sine**2) * direction + sine * across)


# --- what is stated

_DEFAULT = "ISIS and ALE take their default, no keyword being in its addendum"
_OTHERWISE = "its drivers in ALE say NONE"


@dataclass(frozen=True, slots=True)
class Spacecraft:
    """What tables of its line scanners hold where no keyword says it."""

    code: int
    """NAIF's, thousandths of the instruments'."""
    names: tuple[str, ...]
    """As name_platform says them, capitals, blanks for anything else; by the last one messages call it."""
    stated: Aberration

    @property
    def source(self) -> str:
        """Why."""
        return f"{self.names[-1]}: {_OTHERWISE if self.stated.correction == 'NONE' else _DEFAULT}"


SPACECRAFT = (
    Spacecraft(-94, ("MARS GLOBAL SURVEYOR", "MGS"), Aberration("LT+S")),
    Spacecraft(-41, ("MARS EXPRESS", "MEX"), Aberration("LT+S")),
    Spacecraft(-74, ("MARS RECONNAISSANCE ORBITER", "MRO"), Aberration("LT+S")),
    Spacecraft(-53, ("MARS ODYSSEY", "ODYSSEY", "M01", "ODY"), Aberration("LT+S")),
    Spacecraft(-131, ("SELENE", "SELENE M", "KAGUYA"), Aberration("LT+S")),
    Spacecraft(-85, ("LUNAR RECONNAISSANCE ORBITER", "LRO"), Aberration("NONE")),
    Spacecraft(-155, ("KOREA PATHFINDER LUNAR ORBITER", "DANURI", "KPLO"), Aberration("NONE")),
)
"""Of LRO lro_instrumentAddendum says it, too."""


def spacecraft_of(code: int) -> Spacecraft | None:
    """By NAIF's code."""
    return next((spacecraft for spacecraft in SPACECRAFT if spacecraft.code == code), None)


def spacecraft_named(platform: str) -> Spacecraft | None:
    """By its name in support data."""
    name = " ".join(re.split(r"[^A-Z0-9]+", platform.upper())).strip()
    return next((spacecraft for spacecraft in SPACECRAFT if name in spacecraft.names), None)


def aberration_of(values: Mapping[str, Any], source: str, instrument: int | None = None) -> Aberration | None:
    """By keywords, of one instrument or of any; None where they don't say.

    Parameters
    ----------
    values : mapping
        Words by keyword, in capitals or not.
    source : str
        Where they stand, for messages.
    instrument : int, optional
        NAIF's code; keywords of others are left alone.

    Raises
    ------
    InputError
        Words that are none of ISIS's, or keywords of several instruments that differ.
    """
    start = "INS" if instrument is None else f"INS{instrument}"
    correction = _keyword(values, start, "_LIGHTTIME_CORRECTION", source)
    if correction is None:
        return None
    if not isinstance(correction, str) or correction.upper() not in ("NONE", "LT+S"):
        raise InputError(f"{source}, {start}..._LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    swapped, to_surface = (
        _truth(values, start, key, source) for key in ("_SWAP_OBSERVER_TARGET", "_LT_SURFACE_CORRECT")
    )
    observer: Observer = "spacecraft" if swapped else "body"
    return Aberration("NONE") if correction.upper() == "NONE" else Aberration("LT+S", observer, to_surface)


def remarks_on(stated: Aberration, why: str) -> tuple[str, ...]:
    """Corrections of positions, in sentences; `why` is empty where keywords state them."""
    if stated.correction == "NONE":
        return (f"positions are taken as geometric ({why})",) if why else ()
    effects = "light time to the surface" if stated.to_surface else "light time and stellar aberration"
    return (f"{effects} taken off positions, the {stated.observer} being the observer ({why or 'naif_keywords'})",)


def _keyword(values: Mapping[str, Any], start: str, end: str, source: str) -> Any:
    """Value of the instrument's keyword; None where there is none."""
    matches = [value for key, value in values.items() if key.upper().startswith(start) and key.upper().endswith(end)]
    if any(value != matches[0] for value in matches):
        words = f"keywords of several instruments that differ: {matches}"
        raise InputError(f"{source}, naif_keywords", words, "those of the instrument that took the image")
    return ("" if matches[0] is None else matches[0]) if matches else None


def _truth(values: Mapping[str, Any], start: str, end: str, source: str) -> bool:
    value = _keyword(values, start, end, source)
    if value is not None and str(value).upper() not in ("TRUE", "FALSE"):
        raise InputError(f"{source}, {start}...{end}", repr(value), "true or false")
    return str(value).upper() == "TRUE"
