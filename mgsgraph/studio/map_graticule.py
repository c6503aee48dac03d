"""Graticule of the map: meridians and parallels (planetocentric) of round steps in a window, anywhere on the body."""

from typing import Any

import numpy as np

from mgsgraph.geometry.body import from_planetocentric, in_turn
from mgsgraph.geometry.records import Array, all_pairs
from mgsgraph.studio.map_points import longitude_latitude
from mgsgraph.studio.opened import Opened
from mgsgraph.units import DEG

_WANTED = 8
"""Most steps between meridians, and between parallels, in a window."""
_STEPS = np.array([*(k * 10.0**p for p in range(-7, 1) for k in (1, 2, 5)), 10.0, 15.0, 30.0, 45.0, 90.0])
"""deg."""
_SAMPLED, _DRAWN = 33, 121
"""Places along each side of a window, which give its extent; vertices of a line."""


def graticule(opened: Opened, box: Array) -> list[dict[str, Any]]:
    """Lines in a box (4,) of x and y, low and high, in m on the map, and a little beyond, as JSON: label, meridian
    (whether it is one), places (k, 2) in m on the map.
    """
    radius = float(np.linalg.norm(opened.centre))
    x, y = np.linspace(box[:2], box[2:], _SAMPLED).T
    plane = all_pairs(x, y)
    plane = plane[np.linalg.norm(plane, axis=1) < np.pi * radius]  # where the map ends
    if not len(plane):
        return []
    longitudes, latitudes = longitude_latitude(opened, plane).T
    longitudes = in_turn(longitudes, longitudes[len(plane) // 2])
    low, high = (np.array([end(longitudes), end(latitudes)]) / DEG for end in (np.min, np.max))
    for pole, end in ((-90.0, low), (90.0, high)):
        place = opened.map_places(np.array([[0.0, 0.0, np.sign(pole) * radius]]))[0]
        if np.all((place >= box[:2]) & (place <= box[2:])):
            end[1], low[0], high[0] = pole, 0.0, 359.999
    steps = _STEPS[np.minimum(np.searchsorted(_STEPS, (high - low) / _WANTED), _STEPS.size - 1)]
    lines = []
    for k, step in enumerate(steps.tolist()):
        values = np.arange(np.ceil(low[k] / step), np.floor(high[k] / step) + 0.5) * step
        vertices = np.linspace(low[1 - k] - steps[1 - k] / 5.0, high[1 - k] + steps[1 - k] / 5.0, _DRAWN)
        for value in values.tolist():
            line = np.insert(np.column_stack([vertices, np.full(_DRAWN, radius)]), k, value, axis=1)
            line[:, 1] = np.clip(line[:, 1], -90.0, 90.0)
            places = np.round(opened.map_places(from_planetocentric(line * [DEG, DEG, 1.0])), 2)
            lines.append({"label": _label(value, step, k == 0), "meridian": k == 0, "places": places.tolist()})
    return lines


def _label(degrees: float, step: float, is_meridian: bool) -> str:
    decimals = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    if is_meridian:
        return f"{degrees % 360.0:.{decimals}f}° E"
    return f"{abs(degrees):.{decimals}f}° {'N' if degrees > 0.0 else 'S'}" if degrees else "0°"
