"""Position between two samples of a trajectory: the cubic Hermite polynomial through positions and velocities.

    P(s) = P0 + s (v0 + s (3 (P1 - P0) - 2 v0 - v1 + s (2 (P0 - P1) + v0 + v1))),    v = V (t1 - t0)

as ISIS and SPICE (SPK type 13) have it; s runs from 0 to 1 between the samples.
"""

from mgsgraph.compiled import equation
from mgsgraph.factors.algebra import add, scale, subtract


@equation
def hermite(s, step, first, last, first_velocity, last_velocity):
    """Position, m, and velocity, m/s, at the share s of a step in s."""
    begin, end, way = scale(step, first_velocity), scale(step, last_velocity), subtract(last, first)
    total = add(begin, end)
    second = subtract(scale(3.0, way), add(begin, total))
    third = subtract(total, scale(2.0, way))
    position = add(first, scale(s, add(begin, scale(s, add(second, scale(s, third))))))
    motion = add(begin, scale(s, add(scale(2.0, second), scale(3.0 * s, third))))
    return position, scale(1.0 / step, motion)
