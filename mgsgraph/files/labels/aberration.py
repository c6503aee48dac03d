"""Apparent position tables made geometric.

Support data of MGS, HRSC and CTX hold positions corrected for light time and stellar aberration (SPICE "LT+S"): 55 to
220 m away from where the camera was. A range, and a camera, need the geometric position. What is undone here (Park's
and NAIF's definition, ``spkezr`` required reading): the light time, iterated on the table itself, and the aberration by
the observer's velocity about the Sun, which the support data give with the Sun's position. The Sun's own motion about
the barycentre (about 13 m/s) is left out: at most 0.2 m.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mgsgraph.geometry.plausibility import require_slow
from mgsgraph.geometry.records import Array
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
    """The body sees the craft where it was one light time before: ask the table that much later."""
    position, light_time = np.zeros((times.size, 3)), np.zeros((times.size, 1))
    for _ in range(_ITERATIONS):
        seen, velocity = apparent.at(times + light_time[:, 0])
        true = seen if saved is not None else without_aberration(seen, body_velocity)
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
        true = true / np.linalg.norm(true, axis=1, keepdims=True)
    return np.asarray(true * length)


def aberrated(direction: Array, beta: Array) -> Array:
    """Unit directions turned towards the velocity by asin |u x beta| (NAIF ``stelab``)."""
    axis = np.cross(direction, beta)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    across = np.cross(axis, direction) / np.where(sine == 0.0, 1.0, sine)
    return np.asarray(np.sqrt(1.0 - sine**2) * direction + sine * across)
