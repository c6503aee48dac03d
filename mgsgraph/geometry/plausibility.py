"""Whether the geometry of an image can be: units that were mistaken, and tables that contradict themselves."""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import PositionTable
from mgsgraph.units import KM

_FARTHEST = 400
"""Radii of the body, from farther than which no line scanner looks; a low orbit in metres for kilometres is farther."""
_CONTRADICTION = 0.2
"""Share of the velocities by which positions may change otherwise: of sparse tables of a bent orbit it is far less."""


def require_plausible(image: PushbroomImage, where: str) -> None:
    """Raise InputError, naming `where`, unless the image was taken from outside the body, from not hundreds of its
    radii away, with velocities that lead from position to position, and sees the ellipsoid in its middle.
    """
    body, unit = image.body, "check the units of positions and radii (km, or m where the file says so)"
    middle = np.array([0.5 * image.lines])
    distance = float(np.linalg.norm(image.pose(middle).position))
    if not body.polar < distance < _FARTHEST * body.equatorial:
        found = f"a camera {distance / KM:.6g} km from the body's centre, whose radius is {body.equatorial / KM:.6g} km"
        raise InputError(where, found, f"one outside the body and not {_FARTHEST} radii away", unit)
    if not 0.5 < body.polar / body.equatorial <= 1.0 + 1e-9:
        found = f"radii of {body.equatorial / KM:.6g} km on the equator and {body.polar / KM:.6g} km at the pole"
        raise InputError(where, found, "a body that is a little flattened, or not at all", "check their order")
    table = getattr(image.trajectory, "position", None)
    if isinstance(table, PositionTable):
        _require_led_by_velocities(table, where)
    ground, _ = image.image_to_ground(middle, np.array([0.5 * image.samples]), 0.0)
    if not np.isfinite(ground).all():
        remedy = f"check attitudes, focal length and units; {unit}"
        raise InputError(where, "a middle that looks past the body", "one that sees the ellipsoid", remedy)


def _require_led_by_velocities(table: PositionTable, where: str) -> None:
    steps = np.diff(table.times)[:, None]
    chords, means = np.diff(table.positions, axis=0) / steps, 0.5 * (table.velocities[1:] + table.velocities[:-1])
    speed = np.linalg.norm(chords, axis=1)
    off = np.median(np.linalg.norm(chords - means, axis=1) / np.where(speed > 0.0, speed, np.inf))
    if off > _CONTRADICTION:
        stated = np.median(np.linalg.norm(table.velocities, axis=1))
        found = f"velocities of {stated:.6g} m/s where positions move by {np.median(speed):.6g} m/s, or another way"
        raise InputError(where, found, "those of the positions", "check units and signs of both")
