"""Mars as it is simulated: size, gravity, rotation and path about the Sun; and the motion on a Kepler ellipse."""

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG

Pair = tuple[float, float]
"""A value at J2000 and its change."""
MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
"""IAU 2009 (Archinal et al. 2011), the radii of MOLA's products."""
GRAVITY = 4.282837e13
"""m^3/s^2, GM of Mars."""
POLE_RA, POLE_DEC = (317.68143, -0.1061), (52.88650, -0.0609)
"""deg and deg per century, right ascension and declination of Mars' pole (IAU 2000)."""
MERIDIAN = (176.630, 350.89198226)
"""deg and deg per day, Mars' prime meridian (IAU 2000)."""

_DAY, _CENTURY = 86400.0, 36525.0 * 86400.0
_SUN_GRAVITY = 1.32712440018e20
"""m^3/s^2, GM of the Sun."""
_AXIS, _ECCENTRICITY = 1.52371034 * 149_597_870_700.0, 0.09339410
"""m and none, Mars' orbit at J2000 (Standish and Williams, approximate positions of the planets, table 1)."""
_TO_ORBIT, _NODE, _PERIHELION, _LONGITUDE = 1.84969142, 49.55953891, -23.94362959, -4.55343205
"""deg: inclination to the ecliptic, longitudes of the node, of the perihelion, and of Mars at J2000 (the same)."""
_OBLIQUITY = 23.4392911
"""deg, of the ecliptic at J2000."""


def kepler(times: Array, periapsis: float, eccentricity: float, gravity: float) -> tuple[Array, Array]:
    """Motion on a Kepler ellipse at times (n,) in s past periapsis: coordinate (m) and its rate (m/s), (2, n) each,
    along the line of apsides and at right angles to it in the orbit's plane.

    `periapsis` (m) is the distance from the central body there, `gravity` (m^3/s^2) the body's GM; the eccentricity is
    below 1. A negative one begins at the apoapsis, whose distance `periapsis` then is.
    """
    axis = periapsis / (1.0 - eccentricity)
    motion = np.sqrt(gravity / abs(axis) ** 3)
    mean = motion * times
    anomaly = mean + eccentricity * np.sin(mean)
    for _ in range(20):
        anomaly = anomaly - (anomaly - eccentricity * np.sin(anomaly) - mean) / (1.0 - eccentricity * np.cos(anomaly))
    cosine, sine, rate = np.cos(anomaly), np.sin(anomaly), motion / (1.0 - eccentricity * np.cos(anomaly))
    minor = axis * np.sqrt(1.0 - eccentricity**2)
    along = np.stack([axis * (cosine - eccentricity), -axis * sine * rate])
    return along, np.stack([minor * sine, minor * cosine * rate])


def body_matrix(times: Array) -> Array:
    """J2000 to IAU_MARS (n, 3, 3) at times (n,) in s TDB past J2000."""
    return turning_matrix(times, POLE_RA, POLE_DEC, MERIDIAN)


def turning_matrix(times: Array, pole_ra: Pair, pole_dec: Pair, prime_meridian: Pair) -> Array:
    """J2000 to body-fixed (n, 3, 3) at times (n,) in s TDB past J2000: R3(W) R1(90 - dec) R3(90 + ra) (SPICE tipbod).

    Right ascension and declination of the pole are in deg and deg per century, the meridian in deg and deg per day.
    """
    centuries, zero = times / _CENTURY, np.zeros_like(times)
    ascension = (pole_ra[0] + pole_ra[1] * centuries + 90.0) * DEG
    tilt = (90.0 - pole_dec[0] - pole_dec[1] * centuries) * DEG
    meridian = np.remainder(prime_meridian[0] + prime_meridian[1] * times / _DAY, 360.0) * DEG
    angles = ((2, meridian), (0, tilt), (2, ascension))
    about = [np.stack([angle if axis == k else zero for k in range(3)], 1) for axis, angle in angles]
    spin, equator, node = (rotation.exponential(-vector) for vector in about)
    return spin @ equator @ node


def fixed_pole_matrix(times: Array) -> Array:
    """As `body_matrix`, with the pole kept where it was at J2000: the rotation of pair, strip and bridge image.

    The pole moves by 1.5e-5 rad a year. Files and numbers of these campaigns rest on this rotation, so it stays theirs.
    """
    zero = np.zeros_like(times)
    meridian = np.column_stack([zero, zero, -(MERIDIAN[0] * DEG + MERIDIAN[1] * DEG / _DAY * times)])
    node = rotation.exponential(np.array([0.0, 0.0, -(POLE_RA[0] * DEG + 0.5 * np.pi)]))
    equator = rotation.exponential(np.array([-(0.5 * np.pi - POLE_DEC[0] * DEG), 0.0, 0.0]))
    return rotation.exponential(meridian) @ equator @ node


def mars_about_sun(times: Array) -> tuple[Array, Array]:
    """Position (n, 3) in m and velocity (n, 3) in m/s of Mars from the Sun, J2000, at times (n,) in s TDB past J2000.

    A Kepler ellipse with mean elements: right to some minutes of arc, which is enough to light the ground.
    """
    motion = np.sqrt(_SUN_GRAVITY / _AXIS**3)
    past_perihelion = times + (_LONGITUDE - _PERIHELION) * DEG / motion
    along, across = kepler(past_perihelion, _AXIS * (1.0 - _ECCENTRICITY), _ECCENTRICITY, _SUN_GRAVITY)
    rotations = ((2, _PERIHELION - _NODE), (0, _TO_ORBIT), (2, _NODE), (0, _OBLIQUITY))
    axes = np.eye(3)
    for axis, angle in rotations:
        axes = rotation.exponential(angle * DEG * np.eye(3)[axis]) @ axes
    position, velocity = (along[k][:, None] * axes[:, 0] + across[k][:, None] * axes[:, 1] for k in (0, 1))
    return position, velocity


def sun_direction(epoch: float) -> Array:
    """Unit vector (3,), body-fixed, from Mars to the Sun at an epoch (s TDB past J2000)."""
    position, _ = mars_about_sun(np.array([epoch]))
    return np.asarray(-body_matrix(np.array([epoch]))[0] @ position[0] / np.linalg.norm(position[0]))
