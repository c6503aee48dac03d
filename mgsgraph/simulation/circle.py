"""A camera like MOC-NA on a circular orbit at MGS's mapping altitude, and the relief under it: pair, strip and bridge.

A nadir camera turns with the orbit; one that looks aside is held in inertial space, as MGS did it.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, intersect_ellipsoid, planetocentric
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.units import DEG

MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
"""IAU 2009 (Archinal et al. 2011), the radii of MOLA's products."""

_GRAVITY = 4.282837e13
"""m^3/s^2, GM of Mars."""
_POLE = (317.68143 * DEG, 52.88650 * DEG)
"""rad, right ascension and declination of Mars' pole at J2000 (IAU 2009), kept fixed."""
_MERIDIAN = (176.630 * DEG, 350.89198226 * DEG / 86400.0)
"""rad and rad/s, prime meridian at J2000 and its turning (IAU 2009)."""
_TILT = rotation.exponential(np.array([0.02, -0.03, 0.5]))
"""Frame of the body table to the body-fixed one; only there so that constant rotations are exercised."""
_MOUNT = rotation.exponential(np.array([0.001, -0.002, 0.003]))
"""Spacecraft to camera frame."""

CENTRE = (87.0 * DEG, 4.0 * DEG)
"""rad, longitude and planetocentric latitude from which the relief's waves count: Isidis Planitia."""
HEADING = -3.0 * DEG
"""rad, of the inertial flight direction from north towards east over the equator: 93 degrees of inclination."""
TABLE_STEP = 0.5
"""s between two samples of a table."""
_FOCAL_LENGTH, _PITCH, _SUMMING = 3.5, 13e-6, 2.0
"""m, m, and detector pixels per sample: MOC-NA (Malin et al. 1992), crosstrack summing of its 1024-sample images."""

_WAVES = np.array([[1.0, 0.0, 9e3, 0.3], [0.6, 1.1, 4e3, 1.7], [0.3, 2.0, 2.3e3, 4.1]])
"""Relief: share of the amplitude, direction (rad from east), wavelength (m), phase (rad) of each sine."""


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A flight past a site, whose middle the optical axis meets."""

    epoch: float
    """s TDB past J2000, when it does so."""
    site: Array
    """(3,) m, body-fixed, on the ellipsoid."""
    heading: float
    """rad, of the inertial flight direction from north towards east, at the site's zenith."""
    altitude: float
    """m, of the orbit above the site's distance from the centre."""
    off_nadir: float = 0.0
    """rad, at the spacecraft between the optical axis and nadir, across track; zero for tracking nadir."""

    def __post_init__(self) -> None:
        assign(self, site=frozen(self.site, "passage, site", (3,)))


@dataclass(frozen=True, slots=True, eq=False)
class _Orbit:
    """The circle of a passage, inertial."""

    to_inertial: Array
    """(3, 3) body-fixed to J2000 at the epoch."""
    outward: Array
    """(3,) unit, to the spacecraft at the epoch."""
    flight: Array
    """(3,) unit, direction of flight at the epoch."""
    radius: float
    """m."""
    rate: float
    """rad/s."""

    def state(self, swept: Array) -> tuple[Array, Array]:
        """Positions (n, 3) in m and velocities (n, 3) in m/s at angles (n, 1) past the epoch's."""
        positions = self.radius * (np.cos(swept) * self.outward + np.sin(swept) * self.flight)
        velocities = self.radius * self.rate * (np.cos(swept) * self.flight - np.sin(swept) * self.outward)
        return positions, velocities


def narrow_image(name: str, passage: Passage, lines: int, samples: int, period: float) -> PushbroomImage:
    """Nominal image of a camera like MOC-NA, its middle line at the passage's epoch; `period` in s per line."""
    half = 0.5 * lines * period
    return PushbroomImage(
        name=name,
        lines=lines,
        samples=samples,
        interior=InteriorOrientation(
            focal_length=_FOCAL_LENGTH,
            to_pixel=np.array([[0.0, 1.0 / _PITCH, 0.0], [0.0, 0.0, 1.0 / _PITCH]]),
            centre=np.array([0.0, 0.5 * _SUMMING * samples]),
            first=np.zeros(2),
            sample_summing=_SUMMING,
            distortion=NoDistortion(),
        ),
        timing=LineTiming(np.zeros(1), np.array([-half]), np.array([period])),
        trajectory=circular_trajectory(passage, half),
        body=MARS,
    )


def circular_trajectory(passage: Passage, half: float, step: float = TABLE_STEP) -> Trajectory:
    """The passage, sampled every `step` seconds for `half` seconds and a step either side of its epoch."""
    samples = int(np.ceil(half / step)) + 1
    times: Array = step * np.arange(-samples, samples + 1, dtype=np.float64)
    orbit = _orbit(passage)
    swept = (orbit.rate * times)[:, None]
    positions, velocities = orbit.state(swept)
    look = orbit.to_inertial @ passage.site - orbit.radius * orbit.outward
    look = look / np.linalg.norm(look)
    camera = np.stack([orbit.flight, np.cross(look, orbit.flight), look])
    # nadir: the camera turns with the orbit, about its normal; off-nadir: held, as MGS did
    tracking = passage.off_nadir == 0.0
    turned = swept * np.cross(orbit.outward, orbit.flight) if tracking else np.zeros((times.size, 3))
    return Trajectory(
        passage.epoch,
        PositionTable(times, positions, velocities),
        _attitude(times, camera @ rotation.exponential(-turned), _MOUNT),
        _attitude(times, _body_matrix(passage.epoch + times), _TILT),
    )


def ground_track(passage: Passage, times: Array) -> tuple[Array, Array]:
    """Places (n, 3) in m of the ellipsoid under the spacecraft at times (n,) in s past the epoch, and headings (n,) in
    rad of the flight over them: a passage of the same track is one of these.
    """
    orbit = _orbit(passage)
    positions, velocities = orbit.state((orbit.rate * times)[:, None])
    to_body = _body_matrix(passage.epoch + times)
    up = np.einsum("nij,nj->ni", to_body, positions) / orbit.radius
    along = np.einsum("nij,nj->ni", to_body, velocities)
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(up, east)
    heading = np.arctan2(np.einsum("ni,ni->n", along, east), np.einsum("ni,ni->n", along, north))
    return _on_ellipsoid(up), heading


def site_at(longitude: float, latitude: float) -> Array:
    """Point (3,) in m, body-fixed, of the ellipsoid at a longitude and planetocentric latitude in rad."""
    return np.asarray(_on_ellipsoid(from_planetocentric(np.array([[longitude, latitude, 1.0]])))[0])


def terrain_height(points: Array, relief: float) -> Array:
    """True height (n,) in m above the ellipsoid at body-fixed points (n, 3), a sum of sines of their horizontal place.

    It is what `intersect_ellipsoid` calls height: the ground is where the ellipsoid with radii so much larger passes.
    """
    longitude, latitude, _ = planetocentric(points).T
    east = MARS.equatorial * np.cos(CENTRE[1]) * (longitude - CENTRE[0])
    north = MARS.equatorial * (latitude - CENTRE[1])
    share, direction, wavelength, phase = _WAVES.T[:, :, None]
    along = east * np.cos(direction) + north * np.sin(direction)
    return np.asarray(relief * np.sum(share * np.sin(2.0 * np.pi * along / wavelength + phase), axis=0))


def on_terrain(points: Array, relief: float) -> Array:
    """Points (n, 3) in m of the terrain under or above body-fixed points (n, 3), along the radius."""
    return _on_ellipsoid(points / np.linalg.norm(points, axis=1, keepdims=True), terrain_height(points, relief))


def on_ground(
    image: PushbroomImage, correction: OrientationCorrection, lines: Array, samples: Array, relief: float
) -> Array:
    """Points (n, 3) in m where the rays of places in a nadir image meet the terrain."""
    height = np.zeros_like(lines)
    for _ in range(8):  # the rays are so steep that a step leaves a thousandth of the error
        points, _ = image.image_to_ground(lines, samples, height, correction)
        height = terrain_height(points, relief)
    return points


def _orbit(passage: Passage) -> _Orbit:
    site = passage.site
    radius = float(np.linalg.norm(site)) + passage.altitude
    to_inertial = _body_matrix(np.array([passage.epoch]))[0].T
    zenith = to_inertial @ (site / np.linalg.norm(site))
    east = to_inertial @ (np.cross([0.0, 0.0, 1.0], site) / np.hypot(site[0], site[1]))
    flight = np.cos(passage.heading) * np.cross(zenith, east) + np.sin(passage.heading) * east
    sine = radius / np.linalg.norm(site) * np.sin(passage.off_nadir)
    if passage.off_nadir >= 0.5 * np.pi or sine >= 1.0:
        found = f"{passage.off_nadir / DEG:.1f} deg, which looks past the body"
        raise InputError("simulated orbit, off_nadir", found, "less, about 20 deg")
    aside = np.arcsin(sine) - passage.off_nadir  # angle at the body's centre between the site and the orbit's plane
    outward = np.cos(aside) * zenith + np.sin(aside) * np.cross(flight, zenith)
    return _Orbit(to_inertial, outward, flight, radius, float(np.sqrt(_GRAVITY / radius**3)))


def _body_matrix(times: Array) -> Array:
    """J2000 to body-fixed (n, 3, 3) at times (n,) in s TDB past J2000 (IAU report; SPICE ``tipbod``)."""
    ascension, declination = _POLE
    zero = np.zeros_like(times)
    meridian = np.column_stack([zero, zero, -(_MERIDIAN[0] + _MERIDIAN[1] * times)])
    node = rotation.exponential(np.array([0.0, 0.0, -(ascension + 0.5 * np.pi)]))
    equator = rotation.exponential(np.array([-(0.5 * np.pi - declination), 0.0, 0.0]))
    return rotation.exponential(meridian) @ equator @ node


def _attitude(times: Array, matrices: Array, constant: Array) -> AttitudeTable:
    """Table of which `matrices` (n, 3, 3) come out behind the constant rotation; quaternions without change of sign."""
    quaternions = rotation.from_matrix(constant.T @ matrices)
    turns_over = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.concatenate([[1.0], np.cumprod(np.where(turns_over, -1.0, 1.0))])
    return AttitudeTable(times, quaternions * signs[:, None], constant)


def _on_ellipsoid(directions: Array, height: Array | float = 0.0) -> Array:
    """Points (n, 3) in m at a height above the ellipsoid, towards unit directions (n, 3) from its centre."""
    points, _, _ = intersect_ellipsoid(2.0 * MARS.equatorial * directions, -directions, MARS, height)
    return points
