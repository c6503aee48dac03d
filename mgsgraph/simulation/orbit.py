"""True and nominal trajectories of a simulated MGS image: an orbit over the site, a camera tracking nadir or held.

The spacecraft flies north by day, as MGS did, on a Kepler orbit of 92.9 degrees of inclination which is at an apse over
the site; its speed is such that the ground speed is the published one. Truth is smooth; what is wrong with the kernels
(`sites.KernelErrors`) is in the nominal trajectory alone.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, intersect_ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.simulation.circle import MARS
from mgsgraph.simulation.sites import ImageSettings, KernelErrors
from mgsgraph.units import DEG, MM

GRAVITY = 4.282837e13
"""m^3/s^2, GM of Mars."""
POLE_RA, POLE_DEC = (317.68143, -0.1061), (52.88650, -0.0609)
"""deg and deg per century, Mars' pole (IAU 2000)."""
MERIDIAN = (176.630, 350.89198226)
"""deg and deg per day, Mars' prime meridian (IAU 2000)."""
FOCAL_LENGTH_MM, PITCH_MM, BORESIGHT_SAMPLE = 3500.0, 0.0131240578522949, 1024.5
"""MOC-NA as ISIS knows it (mocAddendum004.ti): mm, mm, and detector sample counted from 1 at the pixel's centre."""
MOUNT_ANGLES = (-6.28518593581, 0.00125, -0.003141592654)
"""rad, TKFRAME_-94031_ANGLES about the axes 1, 2, 3: camera frame to spacecraft frame (the same file)."""
STEP = 1.0
"""s between the records of a table, and of the CK."""
MARGIN = 20.0
"""s which tables and kernels reach beyond the image; profiles too."""

_INCLINATION = 92.9 * DEG
_DAY, _CENTURY = 86400.0, 36525.0 * 86400.0
_SUN_GRAVITY = 1.32712440018e20
"""m^3/s^2, GM of the Sun."""
_AXIS, _ECCENTRICITY = 1.52371034 * 149_597_870_700.0, 0.09339410
"""m and none, Mars' orbit at J2000 (Standish and Williams, approximate positions of the planets, table 1)."""
_TO_ORBIT, _NODE, _PERIHELION, _LONGITUDE = 1.84969142, 49.55953891, -23.94362959, -4.55343205
"""deg: inclination to the ecliptic, longitudes of the node, of the perihelion, and of Mars at J2000 (the same)."""
_OBLIQUITY = 23.4392911
"""deg, of the ecliptic at J2000."""


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """One flight over the site: the true state at any time."""

    epoch: float
    """s TDB past J2000 when the middle line is taken."""
    outward: Array
    """(3,) unit, inertial: from Mars to the spacecraft at the epoch."""
    flight: Array
    """(3,) unit, inertial, horizontal: the direction of flight at the epoch."""
    radius: float
    """m, distance from Mars' centre at the epoch."""
    speed: float
    """m/s at the epoch, horizontal."""
    look: Array
    """(3, 3) inertial to camera frame at the epoch."""
    held: bool
    """Camera held in inertial space; otherwise it turns with the orbit."""

    def state(self, times: Array) -> tuple[Array, Array]:
        """Position (n, 3) in m and velocity (n, 3) in m/s, inertial, at times (n,) past the epoch."""
        eccentricity = self.speed**2 * self.radius / GRAVITY - 1.0  # negative where the epoch is at the apoapsis
        along, across = kepler(times, self.radius, eccentricity, GRAVITY)
        return (
            along[0][:, None] * self.outward + across[0][:, None] * self.flight,
            along[1][:, None] * self.outward + across[1][:, None] * self.flight,
        )

    def camera(self, times: Array) -> Array:
        """Matrices (n, 3, 3) inertial to camera frame at times (n,) past the epoch."""
        if self.held:
            return np.broadcast_to(self.look, (times.size, 3, 3))
        return self.look @ np.swapaxes(orbit_axes(*self.state(np.zeros(1))), 1, 2) @ orbit_axes(*self.state(times))


def kepler(times: Array, periapsis: float, eccentricity: float, gravity: float) -> tuple[Array, Array]:
    """Place and rate (2, n) along the line of apsides, and (2, n) at right angles to it, at times (n,) past periapsis.

    A negative eccentricity begins at the apoapsis, `periapsis` then being its distance.
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


def orbit_axes(positions: Array, velocities: Array) -> Array:
    """Inertial to orbit frame (n, 3, 3), which is MGS's nadir frame: +Z down, +Y along the orbit's normal, +X back."""
    down = -positions / np.linalg.norm(positions, axis=1, keepdims=True)
    normal = np.cross(positions, velocities)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([np.cross(normal, down), normal, down], axis=1)


def body_matrix(times: Array) -> Array:
    """J2000 to IAU_MARS (n, 3, 3) at times (n,) in s TDB past J2000: R3(W) R1(90 - dec) R3(90 + ra) (SPICE tipbod)."""
    centuries, zero = times / _CENTURY, np.zeros_like(times)
    ascension = (POLE_RA[0] + POLE_RA[1] * centuries + 90.0) * DEG
    tilt = (90.0 - POLE_DEC[0] - POLE_DEC[1] * centuries) * DEG
    turned = np.remainder(MERIDIAN[0] + MERIDIAN[1] * times / _DAY, 360.0) * DEG
    about = [np.stack([zero, zero, turned], 1), np.stack([tilt, zero, zero], 1), np.stack([zero, zero, ascension], 1)]
    spin, lean, node = (rotation.exponential(-vector) for vector in about)
    return spin @ lean @ node


def mars_about_sun(times: Array) -> tuple[Array, Array]:
    """Position (n, 3) in m and velocity (n, 3) in m/s of Mars from the Sun, J2000, at times (n,) in s TDB past J2000.

    A Kepler ellipse with mean elements: right to some minutes of arc, which is enough to light the ground.
    """
    motion = np.sqrt(_SUN_GRAVITY / _AXIS**3)
    past_perihelion = times + (_LONGITUDE - _PERIHELION) * DEG / motion
    along, across = kepler(past_perihelion, _AXIS * (1.0 - _ECCENTRICITY), _ECCENTRICITY, _SUN_GRAVITY)
    turns = ((2, _PERIHELION - _NODE), (0, _TO_ORBIT), (2, _NODE), (0, _OBLIQUITY))
    axes = np.eye(3)
    for axis, angle in turns:
        axes = rotation.exponential(angle * DEG * np.eye(3)[axis]) @ axes
    place, speed = (along[k][:, None] * axes[:, 0] + across[k][:, None] * axes[:, 1] for k in (0, 1))
    return place, speed


def sun_direction(epoch: float) -> Array:
    """Unit vector (3,), body-fixed, from Mars to the Sun at an epoch (s TDB past J2000)."""
    place, _ = mars_about_sun(np.array([epoch]))
    return np.asarray(-body_matrix(np.array([epoch]))[0] @ place[0] / np.linalg.norm(place[0]))


def mount() -> Array:
    """Spacecraft to camera frame (3, 3): the inverse of [a]1 [b]2 [c]3 (SPICE tkfram, class ANGLES)."""
    matrix = np.eye(3)
    for axis, angle in enumerate(MOUNT_ANGLES):
        matrix = matrix @ rotation.exponential(-angle * np.eye(3)[axis])
    return matrix.T


def fly(settings: ImageSettings, epoch: float, site: Array, altitude: float, emission: float | None = None) -> Pass:
    """The flight whose optical axis meets `site` at the epoch, at the emission angle and the published ground speed.

    Parameters
    ----------
    settings : ImageSettings
        Of the image.
    epoch : float
        s TDB past J2000, of the middle line.
    site : (3,)
        m, body-fixed, the image's middle.
    altitude : float
        m, by which the spacecraft is farther from Mars' centre than the ellipsoid at the site.
    emission : float, optional
        rad, other than the published one.

    Notes
    -----
    The spacecraft is west of the site, as at Eos (Shan et al.), and looks east across its flight.
    """
    to_inertial = body_matrix(np.array([epoch]))[0].T
    normal = to_inertial @ (site / np.array([MARS.equatorial, MARS.equatorial, MARS.polar]) ** 2)
    normal /= np.linalg.norm(normal)
    pole, place = to_inertial[:, 2], to_inertial @ site
    radius = _ellipsoid_radius(site) + altitude
    angle = settings.emission if emission is None else emission
    outward, flight = normal, _northbound(normal, pole)
    for _ in range(4):  # the flight's direction at the spacecraft decides which way is across
        across = np.cross(normal, flight)
        towards = np.cos(angle) * normal + np.sin(angle) * across / np.linalg.norm(across)
        half = place @ towards
        outward = place + (np.sqrt(half**2 + radius**2 - place @ place) - half) * towards
        outward /= np.linalg.norm(outward)
        flight = _northbound(outward, pole)
    sight = place - radius * outward
    sight /= np.linalg.norm(sight)
    side = np.cross(outward, flight)
    side -= (side @ sight) * sight
    side /= np.linalg.norm(side)
    look = np.stack([np.cross(side, sight), side, sight])
    found = Pass(epoch, outward, flight, radius, float(np.sqrt(GRAVITY / radius)), look, settings.held)
    for _ in range(5):
        speed = found.speed * settings.spacing / (0.1 * _ground_speed(found, float(np.linalg.norm(site))))
        found = Pass(epoch, outward, flight, radius, speed, look, settings.held)
    return found


def true_trajectory(flown: Pass, duration: float) -> Trajectory:
    """What was flown, sampled; times count from the pass's epoch."""
    times = _node_times(duration)
    return _trajectory(flown, times, *flown.state(times), flown.camera(times))


def nominal_trajectory(flown: Pass, duration: float, errors: KernelErrors, rng: np.random.Generator) -> Trajectory:
    """What the kernels say, with the archive's time tags already undone: true (+) errors."""
    times = _node_times(duration)
    positions, velocities = flown.state(times)
    axes = np.stack([flown.outward, flown.flight, np.cross(flown.outward, flown.flight)])
    u = 2.0 * times / duration
    (p0, p1), (r0, r1), (y0, y1) = errors.pitch, errors.roll, errors.yaw
    # about the camera's axes: +X is back, so that turning about it rolls the axis towards -Y; +Y pitches it back
    turn = np.stack([r0 + r1 * u, -(p0 + p1 * u), y0 + y1 * u], axis=1)
    turn += errors.noise * rng.standard_normal(turn.shape)
    camera = rotation.exponential(-turn) @ flown.camera(times + errors.attitude_time_bias)
    return _trajectory(flown, times, positions + errors.position @ axes, velocities, camera)


def moc_image(settings: ImageSettings, trajectory: Trajectory, start: float) -> PushbroomImage:
    """MOC image on a trajectory; `start` in s past the trajectory's epoch is the time of its upper edge."""
    pitch = PITCH_MM * MM
    return PushbroomImage(
        name=settings.name,
        lines=settings.lines,
        samples=settings.samples,
        interior=InteriorOrientation(
            focal_length=FOCAL_LENGTH_MM * MM,
            to_pixel=np.array([[0.0, 1.0 / pitch, 0.0], [0.0, 0.0, 1.0 / pitch]]),
            centre=np.array([0.0, BORESIGHT_SAMPLE - 0.5]),
            first=np.array([0.0, float(settings.edit_mode)]),
            sample_summing=float(settings.crosstrack_summing),
            distortion=NoDistortion(),
        ),
        timing=LineTiming(np.zeros(1), np.array([start]), np.array([settings.period])),
        trajectory=trajectory,
        body=MARS,
    )


def _node_times(duration: float) -> Array:
    """Whole seconds, so that they are exact in files, to beyond both ends of the image."""
    reach = np.ceil(0.5 * duration + MARGIN)
    return np.arange(-reach, reach + 0.5 * STEP, STEP)


def _trajectory(flown: Pass, times: Array, positions: Array, velocities: Array, camera: Array) -> Trajectory:
    return Trajectory(
        flown.epoch,
        PositionTable(times, positions, velocities),
        AttitudeTable(times, quaternions(mount().T @ camera), mount()),
        AttitudeTable(times, quaternions(body_matrix(flown.epoch + times)), np.eye(3)),
    )


def quaternions(matrices: Array) -> Array:
    """Quaternions (n, 4) of a turning frame (n, 3, 3), without a change of sign."""
    found = rotation.from_matrix(matrices)
    turns_over = np.sum(found[1:] * found[:-1], axis=1) < 0.0
    signs = np.concatenate([[1.0], np.cumprod(np.where(turns_over, -1.0, 1.0))])
    return np.asarray(found * signs[:, None])


def _northbound(outward: Array, pole: Array) -> Array:
    """Horizontal unit vector (3,) of the northbound flight over `outward`, at the orbit's inclination."""
    east = np.cross(pole, outward)
    cosine = np.linalg.norm(east)  # of the latitude
    east = east / cosine
    west_of_north = np.cos(_INCLINATION) / cosine
    return np.asarray(np.sqrt(1.0 - west_of_north**2) * np.cross(outward, east) + west_of_north * east)


def _ellipsoid_radius(point: Array) -> float:
    """m, from the centre to the ellipsoid, towards a body-fixed point (3,)."""
    unit = point / np.linalg.norm(point)
    return float(1.0 / np.sqrt((unit[0] ** 2 + unit[1] ** 2) / MARS.equatorial**2 + unit[2] ** 2 / MARS.polar**2))


def _ground_speed(flown: Pass, radius: float) -> float:
    """m/s of the optical axis over a sphere of the site's radius, at the epoch."""
    times = np.array([-0.5, 0.5])
    positions, _ = flown.state(times)
    sights = flown.camera(times)[:, 2]
    to_body = body_matrix(flown.epoch + times)
    origins, directions = (np.einsum("nij,nj->ni", to_body, vectors) for vectors in (positions, sights))
    points, _, _ = intersect_ellipsoid(origins, directions, Ellipsoid(radius, radius))
    return float(np.linalg.norm(points[1] - points[0]))
