"""A stereo pair over Isidis Planitia with laser ranges: a nadir image, and a held off-nadir one from another orbit.

The orbit is a circle at MGS's mapping altitude, the camera is like MOC-NA without distortion. The nadir image turns
with the orbit, the off-nadir one is held in inertial space, as MGS did it. The TRUE orientation is the nominal
trajectory (+) a correction drawn from the stated prior; every observation is the true value plus noise drawn from the
stated sigma, so that an adjustment with these sigmas has honest statistics.
"""

from dataclasses import dataclass, field

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, intersect_ellipsoid, planetocentric
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import DEG

MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
"""IAU 2009 (Archinal et al. 2011), the radii of MOLA's products."""
SOURCE = "simulated pair"
"""What messages call observations that were not read from a file."""

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

_EPOCHS = (-11_000_000.0, -9_759_012.0)
"""s TDB past J2000 of the images' middles, 14 sols apart; whole numbers, so that table times are exact in files."""
_SITE = (87.0 * DEG, 4.0 * DEG)
"""rad, longitude and planetocentric latitude of the images' middle."""
_HEADING = -3.0 * DEG
"""rad, of the inertial flight direction from north towards east: 93 degrees of inclination."""
_TABLE_STEP = 0.5
"""s between two samples of a table."""
_FOCAL_LENGTH, _PITCH, _SUMMING = 3.5, 13e-6, 2.0
"""m, m, and detector pixels per sample: MOC-NA (Malin et al. 1992), crosstrack summing of its 1024-sample images."""

_WAVES = np.array([[1.0, 0.0, 9e3, 0.3], [0.6, 1.1, 4e3, 1.7], [0.3, 2.0, 2.3e3, 4.1]])
"""Relief: share of the amplitude, direction (rad from east), wavelength (m), phase (rad) of each sine."""
_MARGIN = 30.0
"""pixels which true places keep from the edges: six default sigmas of the shots' image places."""
_NO_OVERLAP = "take longer images, a smaller off_nadir or smaller position and angle sigmas"


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Sigmas from which everything uncertain is drawn, and which the written case states; one sigma, zero mean."""

    tie: float = 1.0
    """pixels, line and sample of a tie point's measure."""
    shot_image: float = 5.0
    """pixels, line and sample of a footprint's measure."""
    range: float = 1.0
    """m, of a laser range."""
    ground: float = 10.0
    """m, of a footprint in each direction."""
    position: float = 30.0
    """m, of the constant position correction in each direction."""
    angle: float = 1e-4
    """rad, of the constant rotation correction about each axis."""
    trend: tuple[float, ...] = (1.0, 0.1, 0.01)
    """Sigma of the coefficients of u^0, u^1, ... in units of the constant ones; its length says the degree."""

    def __post_init__(self) -> None:
        for name in ("tie", "shot_image", "range", "ground", "position", "angle"):
            _require_positive(f"noise settings, {name}", getattr(self, name))
        if not self.trend:
            raise InputError("noise settings, trend", "no factors", "one for each power of u")
        for value in self.trend:
            _require_positive("noise settings, trend", value)

    @property
    def prior(self) -> OrientationPrior:
        """Prior of each image's orientation corrections."""
        constant = np.array([self.position] * 3 + [self.angle] * 3)
        return OrientationPrior(np.array(self.trend)[:, None] * constant)


@dataclass(frozen=True, slots=True)
class PairSettings:
    """What pair to simulate."""

    lines: int = 5000
    """Lines of each image."""
    samples: int = 1024
    """Samples of each image."""
    period: float = 1.446e-3
    """s per line."""
    altitude: float = 380e3
    """m, of the orbit above the ellipsoid at the site."""
    off_nadir: float = 20.0 * DEG
    """rad, angle at the spacecraft of the second image's optical axis from nadir, across track."""
    relief: float = 100.0
    """m, amplitude of the largest of three sines."""
    ties: int = 150
    """Number of tie points."""
    shots: int = 60
    """Number of laser shots."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    """Sigmas."""

    def __post_init__(self) -> None:
        for name, least in (("lines", 8 * _MARGIN), ("samples", 8 * _MARGIN), ("ties", 1), ("shots", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"pair settings, {name}", f"{value}", f"a whole number, at least {least:.0f}")
        for name in ("period", "altitude", "off_nadir"):
            _require_positive(f"pair settings, {name}", getattr(self, name))
        if not (np.isfinite(self.relief) and self.relief >= 0.0):
            raise InputError("pair settings, relief", f"{self.relief} m", "zero or a positive number")


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPair:
    """A simulated stereo pair: what an adjustment is given, and the truth it should find."""

    settings: PairSettings
    """As simulated."""
    seed: int
    """Of the random generator."""
    images: tuple[PushbroomImage, ...]
    """Nominal, nadir one first."""
    true_corrections: tuple[OrientationCorrection, ...]
    """One per image: true orientation = nominal (+) correction."""
    ties: TiePoints
    """Tie points, all free, each measured in both images."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""
    laser: LaserProfile
    """Laser shots taken from the first image's spacecraft, measured in both images."""
    true_footprints: Array
    """(m, 3) m, body-fixed, in the order of `laser.ids`."""

    def __post_init__(self) -> None:
        assign(
            self,
            true_ties=frozen(self.true_ties, "simulated pair, true ties", (len(self.ties.ids), 3)),
            true_footprints=frozen(self.true_footprints, "simulated pair, footprints", (len(self.laser.ids), 3)),
        )

    def __repr__(self) -> str:
        names = ", ".join(image.name for image in self.images)
        return f"SimulatedPair({names}; {self.ties!r}; {self.laser!r}; seed {self.seed})"


def simulate_pair(settings: PairSettings | None = None, seed: int = 1) -> SimulatedPair:
    """Simulate a stereo pair with laser ranges; the same settings and seed give the same pair.

    Parameters
    ----------
    settings : PairSettings, optional
        The default pair when absent.
    seed : int
        zero or positive; orientation, ties and shots are drawn from streams of their own.

    Raises
    ------
    InputError
        Where the images do not share enough ground for the ties and shots asked for.
    """
    settings = settings or PairSettings()
    if seed < 0:
        raise InputError("simulated pair, seed", f"{seed}", "zero or a positive whole number")
    of_orientation, of_ties, of_shots = np.random.default_rng(seed).spawn(3)
    sigmas = settings.noise.prior.sigmas
    images = (
        _image("SIM/A", _EPOCHS[0], 0.0, settings),
        _image("SIM/B", _EPOCHS[1], settings.off_nadir, settings),
    )
    true = tuple(OrientationCorrection(sigmas * of_orientation.standard_normal(sigmas.shape)) for _ in images)
    ties, true_ties = _tie_points(images, true, settings, of_ties)
    laser, footprints = _laser_profile(images, true, settings, of_shots)
    return SimulatedPair(settings, seed, images, true, ties, true_ties, laser, footprints)


def terrain_height(points: Array, relief: float) -> Array:
    """True height (n,) in m above the ellipsoid at body-fixed points (n, 3), a sum of sines of their horizontal place.

    It is what `intersect_ellipsoid` calls height: the ground is where the ellipsoid with radii so much larger passes.
    """
    longitude, latitude, _ = planetocentric(points).T
    east = MARS.equatorial * np.cos(_SITE[1]) * (longitude - _SITE[0])
    north = MARS.equatorial * (latitude - _SITE[1])
    share, direction, wavelength, phase = _WAVES.T[:, :, None]
    along = east * np.cos(direction) + north * np.sin(direction)
    return np.asarray(relief * np.sum(share * np.sin(2.0 * np.pi * along / wavelength + phase), axis=0))


def _require_positive(where: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(where, f"{value}", "a positive number")


def _body_matrix(times: Array) -> Array:
    """J2000 to body-fixed (n, 3, 3) at times (n,) in s TDB past J2000 (IAU report; SPICE ``tipbod``)."""
    ascension, declination = _POLE
    zero = np.zeros_like(times)
    meridian = np.column_stack([zero, zero, -(_MERIDIAN[0] + _MERIDIAN[1] * times)])
    node = rotation.exponential(np.array([0.0, 0.0, -(ascension + 0.5 * np.pi)]))
    equator = rotation.exponential(np.array([-(0.5 * np.pi - declination), 0.0, 0.0]))
    return rotation.exponential(meridian) @ equator @ node


def _image(name: str, epoch: float, off_nadir: float, settings: PairSettings) -> PushbroomImage:
    """Nominal image whose optical axis meets the site at its middle; zero `off_nadir` means tracking nadir."""
    half = 0.5 * settings.lines * settings.period
    return PushbroomImage(
        name=name,
        lines=settings.lines,
        samples=settings.samples,
        interior=InteriorOrientation(
            focal_length=_FOCAL_LENGTH,
            to_pixel=np.array([[0.0, 1.0 / _PITCH, 0.0], [0.0, 0.0, 1.0 / _PITCH]]),
            centre=np.array([0.0, 0.5 * _SUMMING * settings.samples]),
            first=np.zeros(2),
            sample_summing=_SUMMING,
            distortion=NoDistortion(),
        ),
        timing=LineTiming(np.zeros(1), np.array([-half]), np.array([settings.period])),
        trajectory=_trajectory(epoch, half, off_nadir, settings.altitude),
        body=MARS,
    )


def _trajectory(epoch: float, half: float, off_nadir: float, altitude: float) -> Trajectory:
    """Circular orbit that passes the site, sampled for `half` seconds and a step either side of the epoch."""
    samples = int(np.ceil(half / _TABLE_STEP)) + 1
    times: Array = _TABLE_STEP * np.arange(-samples, samples + 1, dtype=np.float64)
    site = _site()
    radius = float(np.linalg.norm(site)) + altitude
    to_inertial = _body_matrix(np.array([epoch]))[0].T
    zenith = to_inertial @ (site / np.linalg.norm(site))
    east = np.cross([0.0, 0.0, 1.0], site) / np.hypot(site[0], site[1])
    flight = np.cos(_HEADING) * np.cross(zenith, to_inertial @ east) + np.sin(_HEADING) * (to_inertial @ east)

    sine = radius / np.linalg.norm(site) * np.sin(off_nadir)
    if off_nadir >= 0.5 * np.pi or sine >= 1.0:
        raise InputError(
            "pair settings, off_nadir", f"{off_nadir / DEG:.1f} deg, which looks past the body", "less, about 20 deg"
        )
    aside = np.arcsin(sine) - off_nadir  # angle at the body's centre between the site and the orbit's plane
    outward = np.cos(aside) * zenith + np.sin(aside) * np.cross(flight, zenith)
    rate = np.sqrt(_GRAVITY / radius**3)
    swept = (rate * times)[:, None]
    positions = radius * (np.cos(swept) * outward + np.sin(swept) * flight)
    velocities = radius * rate * (np.cos(swept) * flight - np.sin(swept) * outward)

    look = to_inertial @ site - radius * outward
    look = look / np.linalg.norm(look)
    camera = np.stack([flight, np.cross(look, flight), look])
    # nadir: the camera turns with the orbit, about its normal; off-nadir: held, as MGS did
    turned = swept * np.cross(outward, flight) if off_nadir == 0.0 else np.zeros((times.size, 3))
    return Trajectory(
        epoch,
        PositionTable(times, positions, velocities),
        _attitude(times, camera @ rotation.exponential(-turned), _MOUNT),
        _attitude(times, _body_matrix(epoch + times), _TILT),
    )


def _attitude(times: Array, matrices: Array, constant: Array) -> AttitudeTable:
    """Table of which `matrices` (n, 3, 3) come out behind the constant rotation; quaternions without change of sign."""
    quaternions = rotation.from_matrix(constant.T @ matrices)
    back = quaternions @ quaternions[0] < 0.0
    return AttitudeTable(times, np.where(back[:, None], -quaternions, quaternions), constant)


def _site() -> Array:
    """The images' middle (3,) in m, body-fixed, on the ellipsoid."""
    direction = from_planetocentric(np.array([*_SITE, 1.0]))
    points, _, _ = intersect_ellipsoid(2.0 * MARS.equatorial * direction[None], -direction[None], MARS)
    return np.asarray(points[0])


def _on_ground(
    image: PushbroomImage, correction: OrientationCorrection, lines: Array, samples: Array, relief: float
) -> Array:
    """Points (n, 3) in m where the rays of places in a nadir image meet the terrain."""
    height = np.zeros_like(lines)
    for _ in range(8):  # the rays are so steep that a step leaves a thousandth of the error
        points, _ = image.image_to_ground(lines, samples, height, correction)
        height = terrain_height(points, relief)
    return points


def _project(
    images: tuple[PushbroomImage, ...], corrections: tuple[OrientationCorrection, ...], points: Array
) -> tuple[Array, Array]:
    """Line and sample of points (n, 3) in each image (n, images, 2), and which points (n,) all images see."""
    places = np.stack(
        [image.ground_to_image(points, true)[0] for image, true in zip(images, corrections, strict=True)], axis=1
    )
    size = np.array([[image.lines, image.samples] for image in images])
    return places, np.all((places >= _MARGIN) & (places <= size - _MARGIN), axis=(1, 2))


def _tie_points(
    images: tuple[PushbroomImage, ...],
    corrections: tuple[OrientationCorrection, ...],
    settings: PairSettings,
    rng: np.random.Generator,
) -> tuple[TiePoints, Array]:
    """Tie points at random places of the first image that the others see too, and their true places (n, 3) in m."""
    first, n, k = images[0], settings.ties, settings.ties * len(images)
    drawn = rng.uniform(_MARGIN, np.array([first.lines, first.samples]) - _MARGIN, (4 * n, 2))
    points = _on_ground(first, corrections[0], drawn[:, 0], drawn[:, 1], settings.relief)
    places, seen = _project(images, corrections, points)
    kept = np.flatnonzero(seen)[:n]
    if kept.size < n:
        raise InputError(SOURCE, f"images that share ground for {kept.size} of {n} tie points", remedy=_NO_OVERLAP)
    ties = TiePoints(
        source=SOURCE,
        ids=tuple(f"TIE{i + 1:05d}" for i in range(n)),
        kinds=np.full(n, PointKind.FREE, dtype=np.int64),
        places=np.full((n, 3), np.nan),
        covariances=np.zeros((n, 3, 3)),
        measure_point=np.repeat(np.arange(n), len(images)),
        measure_image=tuple(image.name for image in images) * n,
        measures=places[kept].reshape(k, 2) + settings.noise.tie * rng.standard_normal((k, 2)),
        measure_sigmas=np.full((k, 2), settings.noise.tie),
    )
    return ties, points[kept]


def _laser_profile(
    images: tuple[PushbroomImage, ...],
    corrections: tuple[OrientationCorrection, ...],
    settings: PairSettings,
    rng: np.random.Generator,
) -> tuple[LaserProfile, Array]:
    """Shots along the first image's optical axis, evenly spaced in time, and their true footprints (n, 3) in m."""
    first, noise, n = images[0], settings.noise, settings.shots
    k, epoch = n * len(images), first.trajectory.epoch
    elapsed, _ = first.timing.at(np.linspace(2.0 * _MARGIN, first.lines - 2.0 * _MARGIN, n))
    times = epoch + elapsed
    lines = first.timing.lines(times - epoch)  # of the time as the file can state it
    points = _on_ground(first, corrections[0], lines, np.full(n, 0.5 * first.samples), settings.relief)
    places, seen = _project(images, corrections, points)
    if not np.all(seen):
        raise InputError(SOURCE, f"images that share {seen.sum()} of {n} laser footprints", remedy=_NO_OVERLAP)
    ranges = np.linalg.norm(points - first.pose(lines, corrections[0]).position, axis=1)
    laser = LaserProfile(
        source=SOURCE,
        ids=tuple(f"SHOT{i + 1:05d}" for i in range(n)),
        times=times,
        ranges=ranges + noise.range * rng.standard_normal(n),
        range_sigmas=np.full(n, noise.range),
        footprints=points + noise.ground * rng.standard_normal((n, 3)),
        covariances=np.broadcast_to(noise.ground**2 * np.eye(3), (n, 3, 3)),
        simultaneous=((first.name,),) * n,
        measure_shot=np.repeat(np.arange(n), len(images)),
        measure_image=tuple(image.name for image in images) * n,
        measures=places.reshape(k, 2) + noise.shot_image * rng.standard_normal((k, 2)),
    )
    return laser, points
