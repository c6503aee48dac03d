"""Terrain as control: the height of a point above the terrain model, along the local normal (Ebner et al. 2004).

    F(P) = |P| - R(longitude, latitude),    r = F / |grad F|        m

R is bilinear between the four posts around the point. r is the distance from the patch exact to first order in itself;
its derivative takes the patch's twist, its only second derivative, into account.
"""

from typing import NamedTuple

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import subtract
from mgsgraph.factors.explicit import Linear, StateAt, Vector


@equation
def bilinear(east, south, posts):
    """Value of the patch, and its slopes eastward and southward per cell, and twist; `posts` are (nw, ne, sw, se)."""
    north_west, north_east, south_west, south_east = posts
    to_east, to_south = north_east - north_west, south_west - north_west
    twist = south_east - south_west - to_east
    value = north_west + east * to_east + south * to_south + east * south * twist
    return value, to_east + south * twist, to_south + east * twist, twist


@equation
def cell_position(point, first, step, column, row):
    """Where in its cell a point lies: fractions eastward and southward; `first` and `step` of (longitude, latitude)."""
    x, y, z = point
    angle = np.arctan2(y, x) - first[0] - column * step[0]
    east = (angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)) / step[0]
    return east, (first[1] - np.arctan2(z, np.sqrt(x * x + y * y))) / step[1] - row


@equation
def height_above(point, patch, step):
    """Height r (m) above a patch, as `bilinear` gives it at the point, and its derivative (3) by the point."""
    x, y, z = point
    value, by_longitude, by_latitude, twist = patch[0], patch[1] / step[0], -patch[2] / step[1], -patch[3]
    twist = twist / (step[0] * step[1])
    planar = np.sqrt(x * x + y * y)
    radius = np.sqrt(planar * planar + z * z)
    above = radius - value
    a, b = by_longitude / planar, by_latitude / radius  # slopes eastward and northward, m per m
    norm = np.sqrt(1.0 + a * a + b * b)
    share = above / (norm * norm * norm)
    # derivatives of (a^2 + b^2) / 2 by longitude and latitude, and by the radius -(a^2 + b^2) / radius
    turn_longitude, turn_latitude = b * twist / radius, a * (twist / planar + a * z / planar)
    along_east = (-by_longitude / norm - share * turn_longitude) / planar
    along_north = (-by_latitude / norm - share * turn_latitude) / radius
    up = (1.0 / norm + share * (a * a + b * b) / radius) / radius
    sine, cosine = z / radius, planar / radius
    return above / norm, (
        -along_east * y / planar - along_north * sine * x / planar + up * x,
        along_east * x / planar - along_north * sine * y / planar + up * y,
        along_north * cosine + up * z,
    )


class SurfaceHeight(NamedTuple):
    """One height above the terrain model; called, its row for a GTSAM factor (`explicit.measurement_factor`)."""

    posts: Vector | None
    """(4,) m, radii of the posts around the point: north-west, north-east, south-west, south-east; None for no patch.
    """
    cell: tuple[int, int]
    """Column and row of the first."""
    first: Vector
    """(2,) rad, longitude and latitude of the model's first post."""
    step: Vector
    """(2,) rad, between columns and rows."""

    def __call__(self, state_at: StateAt, position: Vector) -> Linear:
        """Row (m) at a state: where the model itself is (m). Nothing where the point has no patch."""
        if self.posts is None:
            return Linear(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
        moved = subtract(position, state_at(0.0)[0])
        east, south = cell_position(moved, self.first, self.step, *self.cell)
        patch = bilinear(east, south, self.posts)
        height, by_point = height_above(moved, patch, self.step)
        return Linear(np.array([height]), np.array([by_point]), -np.array([by_point]))
