"""Terrain as control: the height of a point above the terrain model, along the local normal (Ebner et al. 2004)."""

import math

import numpy as np

from mgsgraph.factors.lanes import ACTIVE, BY_POINT, BY_STATE, DELTA, LANES, PLACE, RESIDUAL, WEIGHT, lane
from mgsgraph.factors.pose import correct


@lane
def surface_rows(rows, sight, x, first, n, w, s):
    """RESIDUAL, BY_POINT and BY_STATE (3: the terrain model's own place) of n points' heights above it.

    Nothing where a point has no patch: off the terrain model, or beside missing posts.
    """
    correct(rows, sight, x, n, w, s, 3, False)
    by_place = np.empty(3)
    for l in range(n):
        weight = w[s + WEIGHT + l] * w[ACTIVE + l]
        height, there = height_above(
            rows,
            first + l,
            w[PLACE + l] - w[DELTA + l],
            w[PLACE + LANES + l] - w[DELTA + LANES + l],
            w[PLACE + 2 * LANES + l] - w[DELTA + 2 * LANES + l],
            by_place,
        )
        w[s + RESIDUAL + l] = weight * height if there else 0.0
        for j in range(3):
            slope = weight * by_place[j] if there else 0.0
            w[s + BY_POINT + j * LANES + l] = slope
            w[s + BY_STATE + j * LANES + l] = -slope


@lane
def height_above(rows, i, x, y, z, by_place):
    """Height (m) of a place over the bilinear patch of point i's four posts, along its normal, and its derivative.

    F / |grad F| with F = r - R(lon, lat): `geometry.terrain.TerrainGrid.height_above` says the same for arrays. False
    where the point has no patch (Ebner et al. 2004).
    """
    row, column, right = rows.terrain_cell[i, 0], rows.terrain_cell[i, 1], rows.terrain_cell[i, 2]
    if row < 0:
        return 0.0, False
    planar = math.sqrt(x * x + y * y)
    radius = math.sqrt(planar * planar + z * z)
    posts, frame = rows.terrain, rows.terrain_frame
    turn = math.atan2(y, x) - frame[0] - column * frame[2]
    e = (turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)) / frame[2]
    s = (frame[1] - math.atan2(z, planar)) / frame[3] - row
    corner = posts[row, column]
    to_east, to_south = posts[row, right] - corner, posts[row + 1, column] - corner
    twist = posts[row + 1, right] - posts[row + 1, column] - to_east
    value = corner + e * to_east + s * to_south + e * s * twist
    by_longitude, by_latitude = (to_east + s * twist) / frame[2], -(to_south + e * twist) / frame[3]
    twist = -twist / (frame[2] * frame[3])
    a, b = by_longitude / planar, by_latitude / radius
    norm = math.sqrt(1.0 + a * a + b * b)
    share = (radius - value) / norm**3
    turn_longitude, turn_latitude = b * twist / radius, a * (twist / planar + a * z / planar)
    along_east = (-by_longitude / norm - share * turn_longitude) / planar
    along_north = (-by_latitude / norm - share * turn_latitude) / radius
    up = (1.0 / norm + share * (a * a + b * b) / radius) / radius
    sine, cosine = z / radius, planar / radius
    by_place[0] = -along_east * y / planar - along_north * sine * x / planar + up * x
    by_place[1] = along_east * x / planar - along_north * sine * y / planar + up * y
    by_place[2] = along_north * cosine + up * z
    return (radius - value) / norm, True
