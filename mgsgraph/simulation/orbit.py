"""Orbits of the simulated spacecraft: position and attitude over time, and the tables that a trajectory has of them.

All fly a Kepler orbit that is at an apse at its epoch (`Orbit`). There are two ways to say which one:

* `circular_orbit` and `circular_trajectory`: a circle past a site (pair, strip, bridge image; rigs over the Moon);
* `site_pass`: MGS over a study site, with the published emission angle and ground speed.

A camera at nadir turns with the orbit; one that looks aside is held in inertial space, as MGS did it. Truth is smooth;
what is wrong with the kernels (`sites.KernelErrors`) is in the nominal trajectory of a study site alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, intersect_ellipsoid
from mgsgraph.geometry.orientation import polynomial
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.simulation.sites import ImageSettings, KernelErrors
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
    return turning_matrix(times, (POLE_RA[0], 0.0), (POLE_DEC[0], 0.0), MERIDIAN)


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



HEADING = -3.0 * DEG
"""rad, of a circle's inertial flight direction from north towards east over the equator: inclination 93 degrees."""
TABLE_STEP = 0.5
"""s between two samples of a circle's tables."""
MOUNT_ANGLES = (-6.28518593581, 0.00125, -0.003141592654)
"""rad, TKFRAME_-94031_ANGLES about the axes 1, 2, 3: MOC's camera frame to MGS's frame (mocAddendum004.ti)."""
STEP = 1.0
"""s between the records of a study site's tables, and of its CK."""
MARGIN = 20.0
"""s by which a study site's tables and kernels reach beyond the image."""

_SAMPLES, _ORDER = 31, 2
"""Of the nominal orientation over an image, and order of the polynomials that Yoon & Shan (2005) fit to them."""
_CIRCLE_TILT = rotation.exponential(np.array([0.02, -0.03, 0.5]))
"""Frame of a circle's body table to the body-fixed one; only there so that constant rotations are exercised."""
_CIRCLE_MOUNT = rotation.exponential(np.array([0.001, -0.002, 0.003]))
"""Spacecraft to camera frame on a circle."""
_INCLINATION = 92.9 * DEG
"""Of MGS's orbit over the study sites."""


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """A Kepler orbit, inertial (J2000), which is at one of its apses at the epoch."""

    epoch: float
    """s TDB past J2000."""
    outward: Array
    """(3,) unit: from the body's centre to the spacecraft at the epoch."""
    flight: Array
    """(3,) unit: direction of flight at the epoch."""
    radius: float
    """m, distance from the body's centre at the epoch."""
    eccentricity: float
    """0 for a circle; negative where the epoch is at the apoapsis."""
    gravity: float = GRAVITY
    """m^3/s^2, GM of the body."""

    def state(self, times: Array) -> tuple[Array, Array]:
        """Position (n, 3) in m and velocity (n, 3) in m/s, inertial, at times (n,) in s past the epoch."""
        along, across = kepler(times, self.radius, self.eccentricity, self.gravity)
        return (
            along[0][:, None] * self.outward + across[0][:, None] * self.flight,
            along[1][:, None] * self.outward + across[1][:, None] * self.flight,
        )


def sampled_trajectory(
    epoch: float,
    times: Array,
    state: tuple[Array, Array],
    camera: Array,
    body: Array,
    mount: Array | None = None,
    tilt: Array | None = None,
) -> Trajectory:
    """Trajectory that is sampled at increasing times (n,), s past the epoch (s TDB past J2000).

    `state` has positions and velocities (n, 3), m and m/s, inertial; `camera` and `body` (n, 3, 3) take inertial
    components to those of the camera frame, and to body-fixed ones. `mount` and `tilt` (3, 3) are the constant last
    parts of these rotations, which the tables of quaternions leave out.
    """
    attitude, rotating = (
        AttitudeTable(times, quaternions(full), np.eye(3))
        if constant is None
        else AttitudeTable(times, quaternions(constant.T @ full), constant)
        for full, constant in ((camera, mount), (body, tilt))
    )
    return Trajectory(epoch, PositionTable(times, *state), attitude, rotating)


def quaternions(matrices: Array) -> Array:
    """Quaternions (n, 4) of a turning frame (n, 3, 3), without a change of sign."""
    result = rotation.from_matrix(matrices)
    turns_over = np.sum(result[1:] * result[:-1], axis=1) < 0.0
    signs = np.concatenate([[1.0], np.cumprod(np.where(turns_over, -1.0, 1.0))])
    return np.asarray(result * signs[:, None])


# --- circles: pair, strip and bridge image


class CentralBody(NamedTuple):
    """A body as circles about it need it."""

    ellipsoid: Ellipsoid
    """Its surface."""
    gravity: float
    """m^3/s^2, GM."""
    to_fixed: Callable[[Array], Array]
    """Rotations (n, 3, 3) from J2000 to the body-fixed frame at times (n,) in s TDB past J2000."""


MARS_BODY = CentralBody(MARS, GRAVITY, fixed_pole_matrix)
"""Mars as pair, strip and bridge image have it."""
MOON = Ellipsoid(1_737_400.0, 1_737_400.0)
"""IAU 2009 (Archinal et al. 2011), the radii of LRO's products."""
MOON_BODY = CentralBody(MOON, 4.902800e12, partial(
    turning_matrix, pole_ra=(269.9949, 0.0031), pole_dec=(66.5392, 0.0130), prime_meridian=(38.3213, 13.17635815)
))  # fmt: skip
"""The Moon, its mean pole and meridian without librations (IAU 2009)."""


@dataclass(frozen=True, slots=True, eq=False)
class CircularPass:
    """A flight on a circle past a site, which the optical axis meets at the epoch."""

    epoch: float
    """s TDB past J2000."""
    site: Array
    """(3,) m, body-fixed, on the ellipsoid."""
    heading: float
    """rad, of the inertial flight direction from north towards east, at the site's zenith."""
    altitude: float
    """m, of the orbit above the site's distance from the centre."""
    off_nadir: float = 0.0
    """rad, at the spacecraft between the optical axis and nadir, aside unless `ahead`; zero for tracking nadir."""
    body: CentralBody = MARS_BODY
    """About which it flies."""
    ahead: bool = False
    """Whether the axis looks ahead along the track by `off_nadir`, not aside."""
    turning: bool | None = None
    """Whether the camera turns about the orbit's normal as nadir does; otherwise it is held in inertial space. None:
    held where the axis is off nadir, as MGS did it."""

    def __post_init__(self) -> None:
        assign(self, site=frozen(self.site, "circular pass, site", (3,)))

    @property
    def turns(self) -> bool:
        """Whether the camera turns with the orbit."""
        return self.off_nadir == 0.0 if self.turning is None else self.turning


def circular_orbit(flown: CircularPass) -> Orbit:
    """The circle of a pass; InputError where its off-nadir axis would miss the body."""
    site = flown.site
    radius = float(np.linalg.norm(site)) + flown.altitude
    to_inertial = flown.body.to_fixed(np.array([flown.epoch]))[0].T
    zenith = to_inertial @ (site / np.linalg.norm(site))
    east = to_inertial @ (np.cross([0.0, 0.0, 1.0], site) / np.hypot(site[0], site[1]))
    flight = np.cos(flown.heading) * np.cross(zenith, east) + np.sin(flown.heading) * east
    sine = radius / np.linalg.norm(site) * np.sin(flown.off_nadir)
    if flown.off_nadir >= 0.5 * np.pi or sine >= 1.0:
        found = f"{flown.off_nadir / DEG:.1f} deg, which looks past the body"
        raise InputError("simulated orbit, off_nadir", found, "less, about 20 deg")
    angle = np.arcsin(sine) - flown.off_nadir  # angle at the body's centre between site and spacecraft
    outward = np.cos(angle) * zenith + np.sin(angle) * (-flight if flown.ahead else np.cross(flight, zenith))
    if flown.ahead:
        flight = np.cos(angle) * flight + np.sin(angle) * zenith
    return Orbit(flown.epoch, outward, flight, radius, 0.0, flown.body.gravity)


def circular_attitude(flown: CircularPass, times: Array) -> Array:
    """J2000 to the camera frame (n, 3, 3) at times (n,) in s past the epoch: +X forward, +Z the axis to the site."""
    orbit = circular_orbit(flown)
    axis = flown.body.to_fixed(np.array([flown.epoch]))[0].T @ flown.site - orbit.radius * orbit.outward
    axis = axis / np.linalg.norm(axis)
    side = np.cross(axis, orbit.flight)
    camera = np.stack([orbit.flight, side, axis])
    if flown.ahead:
        side /= np.linalg.norm(side)
        camera = np.stack([np.cross(side, axis), side, axis])
    swept = np.sqrt(orbit.gravity / orbit.radius**3) * times if flown.turns else np.zeros(times.size)
    turned = swept[:, None] * np.cross(orbit.outward, orbit.flight)
    return np.asarray(camera @ rotation.exponential(-turned))


def circular_trajectory(
    flown: CircularPass,
    times: Array,
    camera: Array | None = None,
    mount: Array | None = None,
    tilt: Array | None = None,
) -> Trajectory:
    """The pass at times (n,) in s past its epoch, of a camera that is turned by `camera` (3, 3) against the axes of
    `circular_attitude`; `mount` and `tilt` as `sampled_trajectory` has them.
    """
    turned = circular_attitude(flown, times)
    return sampled_trajectory(
        flown.epoch, times, circular_orbit(flown).state(times), turned if camera is None else camera @ turned,
        flown.body.to_fixed(flown.epoch + times), mount, tilt,
    )  # fmt: skip


def tilted_trajectory(flown: CircularPass, half: float, step: float = TABLE_STEP) -> Trajectory:
    """The pass as pair, strip and bridge have it, sampled about its epoch, with constant parts of its rotations."""
    return circular_trajectory(flown, circle_times(half, step), None, _CIRCLE_MOUNT, _CIRCLE_TILT)


def circle_times(half: float, step: float = TABLE_STEP) -> Array:
    """Times (n,) in s past the epoch, every `step` seconds for `half` seconds and a step either side of it."""
    samples = int(np.ceil(half / step)) + 1
    return np.asarray(step * np.arange(-samples, samples + 1, dtype=np.float64))


def ground_track(flown: CircularPass, times: Array) -> tuple[Array, Array]:
    """Points (n, 3) in m of the ellipsoid under the spacecraft at times (n,) in s past the epoch, and headings (n,) in
    rad of the flight over them: what a later pass along the same track is given.
    """
    orbit = circular_orbit(flown)
    positions, velocities = orbit.state(times)
    to_body = flown.body.to_fixed(flown.epoch + times)
    up = np.einsum("nij,nj->ni", to_body, positions) / orbit.radius
    along = np.einsum("nij,nj->ni", to_body, velocities)
    east = rotation.unit_vectors(np.cross([0.0, 0.0, 1.0], up))
    north = np.cross(up, east)
    heading = np.arctan2(np.einsum("ni,ni->n", along, east), np.einsum("ni,ni->n", along, north))
    return on_ellipsoid(up, body=flown.body.ellipsoid), heading


def on_ellipsoid(directions: Array, height: Array | float = 0.0, body: Ellipsoid = MARS) -> Array:
    """Points (n, 3) in m, body-fixed, at a height above the ellipsoid, towards unit vectors (n, 3) from its centre."""
    points, _, _ = intersect_ellipsoid(2.0 * body.equatorial * directions, -directions, body, height)
    return points


def site_at(longitude: float, latitude: float, body: Ellipsoid = MARS) -> Array:
    """Point (3,) in m, body-fixed, of the ellipsoid at a longitude and planetocentric latitude in rad."""
    return np.asarray(on_ellipsoid(from_planetocentric(np.array([[longitude, latitude, 1.0]])), body=body)[0])


# --- MGS over a study site


@dataclass(frozen=True, slots=True, eq=False)
class SitePass:
    """One flight over a study site, true at any time."""

    orbit: Orbit
    """At an apse when the middle line is taken."""
    axes: Array
    """(3, 3) inertial to camera frame at the epoch."""
    held: bool
    """Camera held in inertial space; otherwise it turns with the orbit."""

    @property
    def epoch(self) -> float:
        """S TDB past J2000 when the middle line is taken."""
        return self.orbit.epoch

    def camera(self, times: Array) -> Array:
        """Matrices (n, 3, 3) inertial to camera frame at times (n,) in s past the epoch."""
        if self.held:
            return np.broadcast_to(self.axes, (times.size, 3, 3))
        first = orbit_axes(*self.orbit.state(np.zeros(1))).mT
        return self.axes @ first @ orbit_axes(*self.orbit.state(times))


def orbit_axes(positions: Array, velocities: Array) -> Array:
    """Inertial to orbit frame (n, 3, 3), which is MGS's nadir frame: +Z down, +Y along the orbit's normal, +X back."""
    down, normal = -rotation.unit_vectors(positions), rotation.unit_vectors(np.cross(positions, velocities))
    return np.stack([np.cross(normal, down), normal, down], axis=1)


def mount() -> Array:
    """Spacecraft to camera frame (3, 3) of MGS: the inverse of [a]1 [b]2 [c]3 (SPICE tkfram, class ANGLES)."""
    matrix = np.eye(3)
    for axis, angle in enumerate(MOUNT_ANGLES):
        matrix = matrix @ rotation.exponential(-angle * np.eye(3)[axis])
    return matrix.T


def site_pass(
    settings: ImageSettings, epoch: float, site: Array, altitude: float, emission: float | None = None
) -> SitePass:
    """The flight whose optical axis meets `site` at the epoch, at the published ground speed and emission angle, or at
    another angle (rad).

    `epoch` (s TDB past J2000) is that of the middle line, `site` (3,) the image's middle in m, body-fixed; `altitude`
    in m is by how much farther the spacecraft is from Mars' centre than the ellipsoid at the site. The spacecraft flies
    north by day at 92.9 degrees of inclination, as MGS did. It is west of the site, as at Eos (Shan et al.), and looks
    east across its flight.
    """
    to_inertial = body_matrix(np.array([epoch]))[0].T
    normal = to_inertial @ (site / np.array([MARS.equatorial, MARS.equatorial, MARS.polar]) ** 2)
    normal /= np.linalg.norm(normal)
    pole, target = to_inertial[:, 2], to_inertial @ site
    radius = float(MARS.radius(site[None] / np.linalg.norm(site))[0]) + altitude
    angle = settings.emission if emission is None else emission
    outward, flight = normal, _northbound(normal, pole)
    for _ in range(4):  # the flight's direction at the spacecraft decides which way is across
        across = np.cross(normal, flight)
        towards = np.cos(angle) * normal + np.sin(angle) * across / np.linalg.norm(across)
        half = target @ towards
        outward = target + (np.sqrt(half**2 + radius**2 - target @ target) - half) * towards
        outward /= np.linalg.norm(outward)
        flight = _northbound(outward, pole)
    axis = target - radius * outward
    axis /= np.linalg.norm(axis)
    side = np.cross(outward, flight)
    side -= (side @ axis) * axis
    side /= np.linalg.norm(side)
    axes = np.stack([np.cross(side, axis), side, axis])

    def at_speed(speed: float) -> SitePass:
        orbit = Orbit(epoch, outward, flight, radius, speed**2 * radius / GRAVITY - 1.0)
        return SitePass(orbit, axes, settings.held)

    speed = float(np.sqrt(GRAVITY / radius))
    for _ in range(5):
        speed = speed * settings.spacing / (0.1 * _ground_speed(at_speed(speed), float(np.linalg.norm(site))))
    return at_speed(speed)


def true_trajectory(flown: SitePass, duration: float) -> Trajectory:
    """True trajectory, sampled; times count from the pass's epoch."""
    times = _table_times(duration)
    return _sampled(flown, times, flown.orbit.state(times), flown.camera(times))


def nominal_trajectory(flown: SitePass, duration: float, errors: KernelErrors, rng: np.random.Generator) -> Trajectory:
    """Trajectory of the kernels, with the archive's time tags already corrected: true (+) errors."""
    times, orbit = _table_times(duration), flown.orbit
    positions, velocities = orbit.state(times)
    axes = np.stack([orbit.outward, orbit.flight, np.cross(orbit.outward, orbit.flight)])
    u = 2.0 * times / duration
    basis, rates = polynomial(u, max(len(errors.position), len(errors.rotation)) - 1)
    terms = len(errors.position)
    positions = positions + basis[:, :terms] @ errors.position @ axes
    velocities = velocities + (2.0 / duration) * rates[:, :terms] @ errors.position @ axes
    # about the camera's axes: +X is back, so that turning about it rolls the axis towards -Y; +Y pitches it back
    turn = basis[:, : len(errors.rotation)] @ errors.rotation * [1.0, -1.0, 1.0]
    turn += _without_trend(errors.noise * rng.standard_normal(turn.shape), u)
    camera = rotation.exponential(-turn) @ flown.camera(times + errors.attitude_time_bias)
    return _sampled(flown, times, (positions, velocities), camera)


def _without_trend(noise: Array, u: Array) -> Array:
    """Noise (n, 3) of records at u (n,) less the polynomial that the papers' fit to samples of the image takes of it
    (`geometry.image`): trends of the attitude are drawn with the other errors, once.
    """
    samples = np.linspace(-1.0, 1.0, _SAMPLES)
    between = np.stack([np.interp(samples, u, column) for column in noise.T], axis=1)
    fitted, *_ = np.linalg.lstsq(polynomial(samples, _ORDER)[0], between)
    return np.asarray(noise - polynomial(u, _ORDER)[0] @ fitted)


def _sampled(flown: SitePass, times: Array, state: tuple[Array, Array], camera: Array) -> Trajectory:
    return sampled_trajectory(flown.epoch, times, state, camera, body_matrix(flown.epoch + times), mount())


def _table_times(duration: float) -> Array:
    """Whole seconds, so that they are exact in files, to beyond both ends of the image."""
    reach = np.ceil(0.5 * duration + MARGIN)
    return np.arange(-reach, reach + 0.5 * STEP, STEP)


def _northbound(outward: Array, pole: Array) -> Array:
    """Horizontal unit vector (3,) of the northbound flight over `outward`, at the orbit's inclination."""
    east = np.cross(pole, outward)
    cosine = np.linalg.norm(east)  # of the latitude
    east = east / cosine
    west_of_north = np.cos(_INCLINATION) / cosine
    return np.asarray(np.sqrt(1.0 - west_of_north**2) * np.cross(outward, east) + west_of_north * east)


def _ground_speed(flown: SitePass, radius: float) -> float:
    """m/s of the optical axis over a sphere of the site's radius, at the epoch."""
    times = np.array([-0.5, 0.5])
    positions, _ = flown.orbit.state(times)
    axes = flown.camera(times)[:, 2]
    to_body = body_matrix(flown.epoch + times)
    origins, directions = (np.einsum("nij,nj->ni", to_body, vectors) for vectors in (positions, axes))
    points, _, _ = intersect_ellipsoid(origins, directions, Ellipsoid(radius, radius))
    return float(np.linalg.norm(points[1] - points[0]))
