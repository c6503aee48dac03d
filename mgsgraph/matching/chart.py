"""The plane in which images are compared: Lambert's equal-area plane about the scene's middle (Snyder 1987, p. 182).

Its y axis runs along the flight, so that a swath fills upright tiles. Lengths are true in the middle and off by one
per cent a thousand kilometres from it, which is no matter where two images are compared at the same place.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen


@dataclass(frozen=True, slots=True, eq=False)
class GroundChart:
    """A plane about a middle, in metres."""

    axes: Array
    """(3, 3) rows: directions of x (to the right), y (along the flight) and of the middle, unit, body-fixed."""
    radius: float
    """m, of the sphere that is laid flat."""

    def __post_init__(self) -> None:
        assign(self, axes=frozen(self.axes, "ground chart, axes", (3, 3)))

    @classmethod
    def about(cls, places: Array, flight: Array) -> "GroundChart":
        """The chart about the mean of places (n, 3) in m, body-fixed, with y along the vector `flight` (3,)."""
        middle = places.mean(axis=0)
        radius = float(np.linalg.norm(places, axis=1).mean())
        if not np.linalg.norm(middle) > 0.1 * radius:
            raise InputError("images to match", "ground all around the body", "images of one region")
        up = middle / np.linalg.norm(middle)
        along = flight - (flight @ up) * up
        along /= np.linalg.norm(along)
        return cls(np.stack([np.cross(along, up), along, up]), radius)

    def directions(self, plane: Array) -> Array:
        """(n, 3) unit, body-fixed, of places (n, 2) in the plane in m; NaN beyond the antipode."""
        distance = np.linalg.norm(plane, axis=1)
        half = distance / (2.0 * self.radius)
        with np.errstate(invalid="ignore"):
            cosine = np.where(half <= 1.0, 1.0 - 2.0 * half**2, np.nan)
            sideways = np.sqrt(1.0 - half**2) / self.radius  # sine of the angle over the distance
        return np.asarray(np.column_stack([plane * sideways[:, None], cosine]) @ self.axes)

    def plane(self, points: Array) -> Array:
        """(n, 2) m, places in the plane under points (n, 3) in m, body-fixed."""
        local = (points / np.linalg.norm(points, axis=1, keepdims=True)) @ self.axes.T
        return np.asarray(local[:, :2] * (self.radius * np.sqrt(2.0 / (1.0 + local[:, 2:]))))
