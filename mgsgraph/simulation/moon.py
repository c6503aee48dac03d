"""The Moon as it is simulated: size, gravity, and rotation without librations."""

from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.mars import turning_matrix
from mgsgraph.simulation.orbit import CentralBody

MOON = Ellipsoid(1_737_400.0, 1_737_400.0)
"""IAU 2009 (Archinal et al. 2011), the radii of LRO's products."""
GRAVITY = 4.902800e12
"""m^3/s^2, GM of the Moon."""
POLE_RA, POLE_DEC = (269.9949, 0.0031), (66.5392, 0.0130)
"""deg and deg per century, right ascension and declination of the mean pole (IAU 2009)."""
MERIDIAN = (38.3213, 13.17635815)
"""deg and deg per day, the mean prime meridian (IAU 2009)."""


def body_matrix(times: Array) -> Array:
    """J2000 to the Moon's mean axes (n, 3, 3) at times (n,) in s TDB past J2000."""
    return turning_matrix(times, POLE_RA, POLE_DEC, MERIDIAN)


MOON_BODY = CentralBody(MOON, GRAVITY, body_matrix)
"""What circles about the Moon need."""
