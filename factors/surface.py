"""Terrain as control: the height of a point above the terrain model, along the local normal (Ebner et al. 2004).

    F(P) = |P| - R(longitude, latitude),    r = F / |grad F|        m

R is the cubic B-spline with the posts' radii as coefficients (Unser 1999), with continuous slopes and curvatures: the
cost of an adjustment is one function, smooth from cell to cell, and the noise of single posts makes no slopes that say
where the model is. r is the distance from the ground exact to first order in itself; its derivative takes the curvature
into account.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import scale
from mgsgraph.factors.effects import STATE, Effect
from mgsgraph.factors.measurement import Linear, StateAt, Vector, measurement_factor, noise_model
from mgsgraph.factors.records import Array

if TYPE_CHECKING:
    import gtsam


@equation
def bilinear(east, south, posts):
    """Value between four posts (nw, ne, sw, se), and its slopes eastward and southward per cell."""
    north_west, north_east, south_west, south_east = posts
    to_east, to_south = north_east - north_west, south_west - north_west
    twist = south_east - south_west - to_east
    value = north_west + east * to_east + south * to_south + east * south * twist
    return value, to_east + south * twist, to_south + east * twist


@equation
def cubic_weights(t):
    """Cubic B-splines: weights of four coefficients in a row, t of the way from the second to the third, and their
    first and second derivatives by t.
    """
    s = 1.0 - t
    inner, outer = 2.0 / 3.0 + (0.5 * t - 1.0) * t * t, 2.0 / 3.0 + (0.5 * s - 1.0) * s * s
    values = s * s * s / 6.0, inner, outer, t * t * t / 6.0
    slopes = -0.5 * s * s, (1.5 * t - 2.0) * t, (2.0 - 1.5 * s) * s, 0.5 * t * t
    return values, slopes, (s, 3.0 * t - 2.0, 3.0 * s - 2.0, t)


@equation
def weighted(weights, values):
    """Sum of four values with their weights."""
    return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2] + weights[3] * values[3]


@equation
def cubic(east, south, coefficients):
    """Value of the spline, its slopes eastward and southward per cell, and its second derivatives: eastward, mixed,
    southward.

    `coefficients` are four rows from north to south of four from west to east; the place lies between the second and
    the third of both, `east` and `south` of the way.
    """
    (values, slopes, bends), (down, down_slopes, down_bends) = cubic_weights(east), cubic_weights(south)
    first, second, third, fourth = coefficients
    rows = weighted(values, first), weighted(values, second), weighted(values, third), weighted(values, fourth)
    eastward = weighted(slopes, first), weighted(slopes, second), weighted(slopes, third), weighted(slopes, fourth)
    bent = weighted(bends, first), weighted(bends, second), weighted(bends, third), weighted(bends, fourth)
    return (
        weighted(down, rows), weighted(down, eastward), weighted(down_slopes, rows),
        weighted(down, bent), weighted(down_slopes, eastward), weighted(down_bends, rows),
    )  # fmt: skip


@equation
def post_coordinates(point, first, step, shape):
    """Row and column of a point among posts, fractional, in the turn of longitude about the posts' middle.

    `first` and `step` are of (longitude, latitude); of `shape` (rows, columns) the outermost post on each side serves
    cells within: coordinates are kept within those.
    """
    x, y, z = point
    half = 0.5 * (shape[1] - 1.0)
    angle = (np.arctan2(y, x) - first[0]) / step[0] - half
    turn = 2.0 * np.pi / step[0]
    column = angle - turn * np.floor(angle / turn + 0.5) + half
    row = (first[1] - np.arctan2(z, np.sqrt(x * x + y * y))) / step[1]
    return np.minimum(np.maximum(row, 1.0), shape[0] - 2.0), np.minimum(np.maximum(column, 1.0), shape[1] - 2.0)


@equation
def height_above(point, ground, step):
    """Height r (m) above ground, as `cubic` gives it at the point, and its derivative (3) by the point."""
    x, y, z = point
    value, by_longitude, by_latitude = ground[0], ground[1] / step[0], -ground[2] / step[1]
    bend_longitude, twist = ground[3] / (step[0] * step[0]), -ground[4] / (step[0] * step[1])
    bend_latitude = ground[5] / (step[1] * step[1])
    planar = np.sqrt(x * x + y * y)
    radius = np.sqrt(planar * planar + z * z)
    above = radius - value
    a, b = by_longitude / planar, by_latitude / radius  # slopes eastward and northward, m per m
    norm = np.sqrt(1.0 + a * a + b * b)
    share = above / (norm * norm * norm)
    # derivatives of (a^2 + b^2) / 2 by longitude and latitude, and by the radius -(a^2 + b^2) / radius
    turn_longitude = a * bend_longitude / planar + b * twist / radius
    turn_latitude = a * (twist / planar + a * z / planar) + b * bend_latitude / radius
    along_east = (-by_longitude / norm - share * turn_longitude) / planar
    along_north = (-by_latitude / norm - share * turn_latitude) / radius
    up = (1.0 / norm + share * (a * a + b * b) / radius) / radius
    sine, cosine = z / radius, planar / radius
    return above / norm, (
        -along_east * y / planar - along_north * sine * x / planar + up * x,
        along_east * x / planar - along_north * sine * y / planar + up * y,
        along_north * cosine + up * z,
    )


class TerrainSpline(Protocol):
    """A terrain model's radii as a cubic B-spline; `mgsgraph.geometry.terrain.TerrainGrid.spline()` gives it."""

    @property
    def coefficients(self) -> Array:
        """(rows, columns) m."""
        ...

    @property
    def first(self) -> Vector:
        """(2,) rad, longitude and latitude of the first of them."""
        ...

    @property
    def step(self) -> Vector:
        """(2,) rad, between columns and rows."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHeight:
    """One height above the terrain model; called, its row for a GTSAM factor (`measurement.measurement_factor`)."""

    terrain: TerrainSpline
    """Radii."""

    def __call__(self, state_at: StateAt, point: Array) -> Linear:
        """Row (m) at a state: where the model itself is (m)."""
        moved, coefficients = tuple((point - state_at(0.0)[0][:3]).tolist()), self.terrain.coefficients
        row, column = post_coordinates(moved, self.terrain.first, self.terrain.step, coefficients.shape)
        i, j = min(int(row), coefficients.shape[0] - 3), min(int(column), coefficients.shape[1] - 3)
        around = tuple(map(tuple, coefficients[i - 1 : i + 3, j - 1 : j + 3].tolist()))
        height, by_point = height_above(moved, cubic(column - j, row - i, around), self.terrain.step)
        by_state = np.zeros((1, STATE))
        by_state[0, :3] = scale(-1.0, by_point)
        return Linear(np.array([height]), np.array([by_point]), by_state)


def terrain_height(
    point: int | Array, terrain: TerrainSpline, sigma: float, moved: Sequence[Effect] = ()
) -> "gtsam.CustomFactor":
    """Height of a ground point above a terrain model: zero within sigma (Ebner et al. 2004).

    Parameters
    ----------
    point : int or (3,)
        GTSAM key of a Point3, m, body-fixed, or a known one.
    terrain : TerrainSpline
        `TerrainGrid.spline()` of `mgsgraph.geometry.terrain`.
    sigma : float
        m, along the normal.
    moved : sequence of Effect
        What moves the terrain model as a whole.

    Returns
    -------
    gtsam.CustomFactor
        One row (m), the height, positive upward.

    Raises
    ------
    InputError
        For a sigma that is not positive.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import L
    >>> from mgsgraph.geometry.terrain import TerrainGrid
    >>> plain = TerrainGrid("a plain", np.full((9, 9), 3.39e6), 1.4, 0.2, 0.01, 0.01)  # m, rad
    >>> factor = mgsgraph.factors.terrain_height(L(17), plain.spline(), 10.0)
    """
    where = "height above the terrain model"
    return measurement_factor([moved], point, SurfaceHeight(terrain), noise_model(sigma, None, 1, where), where)
