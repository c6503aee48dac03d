"""What shots of an altimeter can't be, whatever file they come from: a damaged number shows here, shot by shot.

Medians (`places`, `shots`) find a unit that was exchanged; one shot among thousands does not move them.
"""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots, exchanged_units
from mgsgraph.units import KM

_RELIEF = 0.03
"""Part of a body's radius by which its ground lies at most above or below: 100 km on Mars, 50 km on the Moon."""
_WAY = 0.02
"""Part of the way from the spacecraft to the footprint by which a range may be another: archives compute one of the
other, and LOLA's 52,363 points over Hadley agree to 2e-5."""
_DAMAGED = "the file is damaged: fetch it anew, or take that shot out"


def require_possible_shots(shots: AltimeterShots) -> None:
    """Raise InputError for a ground return, by its name, at a time at which its mission didn't fly, at a radius that
    its body doesn't have, at a range that its altimeter doesn't reach or that isn't the way from its spacecraft.
    """
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
    ways = np.linalg.norm(shots.spacecraft - shots.footprints, axis=1)
    for k in np.flatnonzero(shots.ground & (np.abs(shots.ranges - ways) > _WAY * ways))[:1].tolist():
        found, expected = f"a range of {shots.ranges[k] / KM:.7g} km", f"about {ways[k] / KM:.7g} km"
        raise InputError(f"{where} {shots.ids[k]}", found, f"{expected}, the way from the spacecraft", _DAMAGED)
