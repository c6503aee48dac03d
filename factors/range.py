"""Laser range: one row on the instrument's place and the footprint. Yoon & Shan 2005, Eq. 3."""

import math

from mgsgraph.factors.lanes import (
    ACTIVE,
    BY_POINT,
    BY_STATE,
    CENTRE,
    DELTA,
    DISTANCE,
    LANES,
    PLACE,
    RESIDUAL,
    WEIGHT,
    lane,
)
from mgsgraph.factors.pose import correct


@lane
def range_rows(rows, sight, x, n, w, s, width):
    """RESIDUAL, BY_POINT and BY_STATE (`width` 3: the instrument's place; 4: and the range bias) of a range."""
    correct(rows, sight, x, n, w, s, width, False)
    for l in range(n):
        d0 = w[PLACE + l] - w[s + CENTRE + l] - w[DELTA + l]
        d1 = w[PLACE + LANES + l] - w[s + CENTRE + LANES + l] - w[DELTA + LANES + l]
        d2 = w[PLACE + 2 * LANES + l] - w[s + CENTRE + 2 * LANES + l] - w[DELTA + 2 * LANES + l]
        bias = w[DELTA + 3 * LANES + l]
        length = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        weight = w[s + WEIGHT + l] * w[ACTIVE + l]
        w[s + RESIDUAL + l] = weight * (w[s + DISTANCE + l] - length - bias)
        p0, p1, p2 = -weight * d0 / length, -weight * d1 / length, -weight * d2 / length
        w[s + BY_POINT + l], w[s + BY_POINT + LANES + l], w[s + BY_POINT + 2 * LANES + l] = p0, p1, p2
        w[s + BY_STATE + l], w[s + BY_STATE + LANES + l], w[s + BY_STATE + 2 * LANES + l] = -p0, -p1, -p2
        w[s + BY_STATE + 3 * LANES + l] = -weight
